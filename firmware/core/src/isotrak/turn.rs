//! Euler angles as a quaternion, in whole numbers, to compare records with each other: near the poles azimuth and roll
//! jump while the orientation hardly changes. What is forwarded stays as it was said.

/// A quarter turn, in which the sine's polynomial is written.
const QUARTER_MDEG: i64 = 90_000;
/// One, as a fixed-point number.
const ONE: i64 = 1 << 30;

/// w, x, y, z in millionths of R = Rz(azimuth) Ry(elevation) Rx(roll), thousandths of a degree; wrong by at most 10
/// millionths.
pub(super) fn quaternion([azimuth, elevation, roll]: [i32; 3]) -> [i64; 4] {
    let [(sa, ca), (se, ce), (sr, cr)] = [azimuth, elevation, roll].map(|mdeg| {
        // Half of the angle, counted in half thousandths.
        let half = i64::from(mdeg);
        (sine(half), sine(half + 2 * QUARTER_MDEG))
    });
    let product = |a: i64, b: i64, c: i64| a * b / ONE * c / ONE;
    [
        product(ca, ce, cr) + product(sa, se, sr),
        product(ca, ce, sr) - product(sa, se, cr),
        product(ca, se, cr) + product(sa, ce, sr),
        product(sa, ce, cr) - product(ca, se, sr),
    ]
    .map(|q| q * 1_000_000 / ONE)
}

/// The sine of an angle in half thousandths of a degree, in 2⁻³⁰.
fn sine(half_mdeg: i64) -> i64 {
    let quarter = 2 * QUARTER_MDEG;
    let angle = half_mdeg.rem_euclid(4 * quarter);
    let (angle, sign) = if angle >= 2 * quarter { (angle - 2 * quarter, -1) } else { (angle, 1) };
    let angle = if angle > quarter { 2 * quarter - angle } else { angle };
    let z = angle * ONE / quarter;
    let square = z * z / ONE;
    // The series of sin(z π/2), up to the ninth power: wrong by less than 4e-6.
    let mut sum = 0;
    for coefficient in [172_272, -5_026_995, 85_569_306, -693_598_668, 1_686_629_713] {
        sum = coefficient + sum * square / ONE;
    }
    sign * (sum * z / ONE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_agrees_with_floating_point() {
        for i in 0..20_000 {
            let euler =
                [i * 7919 % 360_001 - 180_000, i * 104_729 % 180_001 - 90_000, i * 1_299 % 360_001 - 180_000];
            let [a, e, r] = euler.map(|mdeg| (f64::from(mdeg) / 2e3).to_radians().sin_cos());
            let expected = [
                a.1 * e.1 * r.1 + a.0 * e.0 * r.0,
                a.1 * e.1 * r.0 - a.0 * e.0 * r.1,
                a.1 * e.0 * r.1 + a.0 * e.1 * r.0,
                a.0 * e.1 * r.1 - a.1 * e.0 * r.0,
            ];
            for (said, expected) in quaternion(euler).into_iter().zip(expected) {
                assert!((said as f64 - expected * 1e6).abs() < 10.0, "{euler:?}: {said} {expected}");
            }
        }
    }
}
