//! Small dense systems on the stack: a lobe's fit solves thousands of them a second.
#![expect(clippy::needless_range_loop, reason = "indices name rows and columns of small matrices")]

/// What cancellation leaves of a dependent column is no pivot: sums over views run in single precision.
const SMALLEST_PIVOT: f64 = 1e-7;

/// The lower Cholesky factor of the leading `n` × `n` block of a symmetric positive definite matrix, of which the
/// lower triangle is read; `None` where it is not.
pub(super) fn cholesky<const N: usize>(matrix: &[[f64; N]; N], n: usize) -> Option<[[f64; N]; N]> {
    let mut lower = [[0.0; N]; N];
    for i in 0..n {
        for j in 0..=i {
            let mut sum = matrix[i][j];
            for k in 0..j {
                sum -= lower[i][k] * lower[j][k];
            }
            if i == j {
                if sum <= SMALLEST_PIVOT * matrix[i][i] || !sum.is_finite() {
                    return None;
                }
                lower[i][i] = sum.sqrt();
            } else {
                lower[i][j] = sum / lower[j][j];
            }
        }
    }
    Some(lower)
}

/// Solves a system by its Cholesky factor.
pub(super) fn substitute<const N: usize>(lower: &[[f64; N]; N], right: &[f64; N], n: usize) -> [f64; N] {
    let mut solution = *right;
    for i in 0..n {
        for k in 0..i {
            solution[i] -= lower[i][k] * solution[k];
        }
        solution[i] /= lower[i][i];
    }
    for i in (0..n).rev() {
        for k in i + 1..n {
            solution[i] -= lower[k][i] * solution[k];
        }
        solution[i] /= lower[i][i];
    }
    solution
}

/// Solves the leading `n` × `n` block of a symmetric positive definite system by Cholesky; `None` where it is not.
pub(super) fn solve<const N: usize>(matrix: &[[f64; N]; N], right: &[f64; N], n: usize) -> Option<[f64; N]> {
    cholesky(matrix, n).map(|lower| substitute(&lower, right, n))
}

/// Non-negative least squares in the leading `n` unknowns (few) from normal equations: the values, the set of those
/// not held at zero (bit per unknown) and by how much they lower the sum of squares.
pub(super) fn nonnegative<const N: usize>(
    gram: &[[f64; N]; N],
    right: &[f64; N],
    n: usize,
) -> ([f64; N], u8, f64) {
    let all = (1_u8 << n) - 1;
    if let Some(values) = solve(gram, right, n).filter(|values| values[..n].iter().all(|value| *value >= 0.0))
    {
        let gain = values.iter().zip(right).take(n).map(|(value, right)| value * right).sum();
        return (values, all, gain);
    }
    // So few unknowns that trying every set is the simplest exact method.
    let mut best = ([0.0; N], 0, 0.0);
    for set in 1..all {
        if let Some(found) = on_set(gram, right, n, set)
            && found.2 > best.2
        {
            best = found;
        }
    }
    best
}

fn on_set<const N: usize>(
    gram: &[[f64; N]; N],
    right: &[f64; N],
    n: usize,
    set: u8,
) -> Option<([f64; N], u8, f64)> {
    let (small, index, count) = block(gram, n, set);
    let mut small_right = [0.0; N];
    for a in 0..count {
        small_right[a] = right[index[a]];
    }
    let solution = solve(&small, &small_right, count)?;
    let (mut values, mut gain) = ([0.0; N], 0.0);
    for a in 0..count {
        if solution[a] < 0.0 {
            return None;
        }
        values[index[a]] = solution[a];
        gain += solution[a] * small_right[a];
    }
    Some((values, set, gain))
}

/// The rows and columns of a set (bit per unknown) moved to the front, which they are, and how many.
pub(super) fn block<const N: usize>(
    matrix: &[[f64; N]; N],
    n: usize,
    set: u8,
) -> ([[f64; N]; N], [usize; N], usize) {
    let (mut index, mut count) = ([0; N], 0);
    for i in (0..n).filter(|i| set & (1 << i) != 0) {
        index[count] = i;
        count += 1;
    }
    let mut small = [[0.0; N]; N];
    for a in 0..count {
        for b in 0..count {
            small[a][b] = matrix[index[a]][index[b]];
        }
    }
    (small, index, count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_solution_reproduces_the_right_side() {
        let matrix = [[4.0, 1.0, 0.5], [1.0, 3.0, -1.0], [0.5, -1.0, 2.0]];
        let solution = solve(&matrix, &[1.0, 2.0, 3.0], 3).unwrap();
        for (row, want) in matrix.iter().zip([1.0, 2.0, 3.0]) {
            let got: f64 = row.iter().zip(solution).map(|(a, b)| a * b).sum();
            assert!((got - want).abs() < 1e-12);
        }
        assert!(
            solve(&[[1.0, 1.0], [1.0, 1.0]], &[1.0, 1.0], 2).is_none(),
            "a singular system has no solution"
        );
    }

    #[test]
    fn what_would_be_negative_is_zero_and_the_rest_is_still_best() {
        let mut gram = [[0.0; 4]; 4];
        (gram[0][0], gram[0][1], gram[1][0], gram[1][1]) = (2.0, 1.0, 1.0, 1.0);
        // Without bounds the solution is (2, -1).
        let (values, active, gain) = nonnegative(&gram, &[3.0, 1.0, 0.0, 0.0], 2);
        assert_eq!((values[1], active), (0.0, 1));
        assert!((values[0] - 1.5).abs() < 1e-12);
        assert!((gain - 4.5).abs() < 1e-12);
    }
}
