//! How far cameras are from where they truly are, but for what nobody can know without a mark on the surface.

use glam::{DMat3, DQuat, DVec3};
use rigel::calibration::RegisteredView;
use rigel::geometry::Pose;

/// Of the direction errors that are left when all views together may be turned, shifted and scaled: median, 95th percentile and
/// maximum (degrees), and the part of them within one sigma of what the views say of that.
pub fn gauge_free(views: &[(&RegisteredView, Pose)]) -> ([f64; 3], f64) {
    let centres_m: Vec<_> = views.iter().map(|(view, truth)| (view.pose.centre_m, truth.centre_m)).collect();
    let to_found = similarity(&centres_m);
    let (mut errors, mut scores) = (vec![], vec![]);
    for (view, truth) in views {
        let truth = Pose { centre_m: to_found(truth.centre_m), ..*truth };
        errors.push(view.direction_error_rad(&truth).to_degrees());
        let given = RegisteredView { covariance: view.covariance_given_lens, ..(*view).clone() };
        scores.extend(given.direction_scores(&truth));
    }
    errors.sort_by(f64::total_cmp);
    let within = scores.iter().filter(|score| score.abs() < 1.0).count() as f64 / scores.len() as f64;
    ([0.5, 0.95, 1.0].map(|part| errors[(part * (errors.len() - 1) as f64).round() as usize]), within)
}

/// Where true centres are found, of (found, true) ones, as nearly as a turn, a shift and a scale allow: Gauss and Newton's
/// steps.
fn similarity(centres_m: &[(DVec3, DVec3)]) -> impl Fn(DVec3) -> DVec3 {
    let n = centres_m.len() as f64;
    let mean = |pick: &dyn Fn(&(DVec3, DVec3)) -> DVec3| centres_m.iter().map(pick).sum::<DVec3>() / n;
    let (found, truth) = (mean(&|pair| pair.0), mean(&|pair| pair.1));
    let (mut turn, mut scale) = (DMat3::IDENTITY, 1.0);
    for _ in 0..20 {
        let (mut matrix, mut right, mut along, mut square) = (DMat3::ZERO, DVec3::ZERO, 0.0, 0.0);
        for (to, from) in centres_m {
            let arm = turn * (*from - truth) * scale;
            let off = *to - found - arm;
            right += arm.cross(off);
            let outer = DMat3::from_cols(arm * arm.x, arm * arm.y, arm * arm.z);
            matrix += DMat3::from_diagonal(DVec3::splat(arm.length_squared())) - outer;
            along += arm.dot(off);
            square += arm.length_squared();
        }
        turn = DMat3::from_quat(DQuat::from_scaled_axis(matrix.inverse() * right)) * turn;
        scale *= 1.0 + along / square;
    }
    move |centre_m| turn * (centre_m - truth) * scale + found
}
