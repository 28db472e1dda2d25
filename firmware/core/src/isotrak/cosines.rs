//! An orientation against its own direction cosines: what the one says in four numbers the others say in nine.

/// How far a quaternion's components may be from the truth, millionths: a unit of the last digit, for the tracker may
/// round or cut off.
pub(super) const QUATERNION_ERROR: i64 = 100;
/// The same for a quaternion that was computed from three angles, each wrong by a hundredth of a degree at most.
pub(super) const EULER_ERROR: i64 = 272;
/// The same for a cosine.
const COSINE_ERROR: i64 = 100;
const ONE: i64 = 1_000_000;

/// Whether the unit quaternion w, x, y, z, wrong by at most `error` in each component, is the rotation of which these are the
/// cosines (millionths): first the receiver's X axis in the transmitter's axes, then its Y axis, then its Z axis.
///
/// The documents leave open whose axes are written in whose, so the inverse rotation is one, too: damage that inverts a
/// rotation is small, for it changes the sign of w alone. The ten products of two components are compared, each with the sum of cosines that is four times as much.
pub(super) fn agree(q: [i64; 4], error: i64, cosines: &[i64; 9]) -> bool {
    let [xx, yx, zx, xy, yy, zy, xz, yz, zz] = *cosines;
    let even = [
        (0, 0, ONE + xx + yy + zz),
        (1, 1, ONE + xx - yy - zz),
        (2, 2, ONE - xx + yy - zz),
        (3, 3, ONE - xx - yy + zz),
        (1, 2, yx + xy),
        (1, 3, zx + xz),
        (2, 3, zy + yz),
    ];
    let odd = [(0, 1, zy - yz), (0, 2, xz - zx), (0, 3, yx - xy)];
    let near = |&(i, j, sum): &(usize, usize, i64), sign: i64| {
        let product = 4 * q[i] * q[j] / ONE;
        // The product of two errors and the rounding of ours are a few millionths.
        let tolerance = 4 * (q[i].abs() + q[j].abs()) * error / ONE + 3 * COSINE_ERROR + 5;
        (product - sign * sum).abs() <= if i == j { tolerance } else { tolerance - COSINE_ERROR }
    };
    even.iter().all(|sum| near(sum, 1))
        && (odd.iter().all(|sum| near(sum, 1)) || odd.iter().all(|sum| near(sum, -1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The cosines of w, x, y, z, column by column.
    fn cosines([w, x, y, z]: [f64; 4]) -> [f64; 9] {
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y + w * z),
            2.0 * (x * z - w * y),
            2.0 * (x * y - w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z + w * x),
            2.0 * (x * z + w * y),
            2.0 * (y * z - w * x),
            1.0 - 2.0 * (x * x + y * y),
        ]
    }

    fn quaternions() -> impl Iterator<Item = [f64; 4]> {
        (0..20_000).map(|i| {
            let [a, b, c] = [0.1234, 0.777, 1.913].map(|s| s * f64::from(i));
            [a.cos() * b.cos(), a.cos() * b.sin(), a.sin() * c.cos(), a.sin() * c.sin()]
        })
    }

    #[test]
    fn every_rotation_agrees_with_itself_rounded_or_cut_off_either_way_round() {
        for q in quaternions() {
            for say in [f64::round, f64::trunc] {
                let four = |value: f64| (say(value * 1e4) * 100.0) as i64;
                let [xx, yx, zx, xy, yy, zy, xz, yz, zz] = cosines(q).map(four);
                assert!(agree(q.map(four), QUATERNION_ERROR, &[xx, yx, zx, xy, yy, zy, xz, yz, zz]), "{q:?}");
                assert!(agree(q.map(four), QUATERNION_ERROR, &[xx, xy, xz, yx, yy, yz, zx, zy, zz]), "{q:?}");
            }
        }
    }

    #[test]
    fn a_component_that_is_wrong_by_four_units_does_not() {
        let four = |value: f64| (value * 1e4).round() as i64 * 100;
        // Where w is next to nothing its sign is the inverse's.
        for q in quaternions().filter(|q| q[0].abs() > 0.01) {
            for i in 0..4 {
                for off in [-400, 400, 800, 10_000] {
                    let mut wrong = q.map(four);
                    wrong[i] += off;
                    assert!(!agree(wrong, QUATERNION_ERROR, &cosines(q).map(four)), "{q:?} {i} {off}");
                }
            }
        }
    }
}
