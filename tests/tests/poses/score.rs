//! How far cameras are from where they truly are, but for what nobody can know without a mark on the surface.

use glam::{DMat3, DQuat, DVec3};

/// Median, 95th percentile and maximum of the direction errors (degrees) that are left when all centres (found, true) together
/// may be turned, shifted and scaled: Gauss and Newton's steps.
pub fn gauge_free(centres_m: &[(DVec3, DVec3)]) -> [f64; 3] {
    let n = centres_m.len() as f64;
    let mean = |pick: &dyn Fn(&(DVec3, DVec3)) -> DVec3| centres_m.iter().map(pick).sum::<DVec3>() / n;
    let (found, truth) = (mean(&|pair| pair.0), mean(&|pair| pair.1));
    let (mut turn, mut scale) = (DMat3::IDENTITY, 1.0);
    for _ in 0..20 {
        let (mut matrix, mut right, mut along, mut square) = (DMat3::ZERO, DVec3::ZERO, 0.0, 0.0);
        for (from, to) in centres_m {
            let arm = turn * (*from - found) * scale;
            let off = *to - truth - arm;
            right += arm.cross(off);
            let outer = DMat3::from_cols(arm * arm.x, arm * arm.y, arm * arm.z);
            matrix += DMat3::from_diagonal(DVec3::splat(arm.length_squared())) - outer;
            along += arm.dot(off);
            square += arm.length_squared();
        }
        turn = DMat3::from_quat(DQuat::from_scaled_axis(matrix.inverse() * right)) * turn;
        scale *= 1.0 + along / square;
    }
    let left = |(from, to): &(DVec3, DVec3)| {
        (turn * (*from - found) * scale + truth).angle_between(*to).to_degrees()
    };
    let mut errors: Vec<f64> = centres_m.iter().map(left).collect();
    errors.sort_by(f64::total_cmp);
    [0.5, 0.95, 1.0].map(|part| errors[(part * (errors.len() - 1) as f64).round() as usize])
}
