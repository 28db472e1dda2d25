//! The search: Levenberg-Marquardt in shininess and direction, radiance eliminated.
#![expect(clippy::needless_range_loop, reason = "indices name rows and columns of small matrices")]

use glam::DVec3;

use super::super::model::SHININESS;
use super::super::small::{block, cholesky, nonnegative, solve, substitute};
use super::lanes::{self, LaneLobe};
use super::views::Views;
use super::{Lobe, MOST_LOBES};

/// Constant and lobes.
pub(super) const TERMS: usize = 1 + MOST_LOBES;

/// Values below exp(-CUT) are zero: nothing to see.
const CUT: f64 = 18.0;
const MOST_STEPS: usize = 60;
/// The longest last step that is taken on trust: radians, or logarithm of shininess.
const LAST_STEP: f64 = 0.02;
/// Blocks of views whose columns fit into the first cache.
const CHUNK: usize = 40;
/// Single precision hides what is smaller, as a part of the energy.
pub(super) const ROUNDING: f64 = 1e-13;

/// Inner products at one place of the search, and the radiance that is best there. `L` lobes, `N` = 3 `L` searched
/// numbers, `R` = 4 `L` + 4 columns and residuals.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place<const L: usize, const N: usize, const R: usize> {
    pub lobes: [Lobe; L],
    /// The two turns of each lobe.
    pub turns: [[DVec3; 2]; L],
    /// Columns: 1, the lobes' values, the lobes' derivatives (log shininess, two turns).
    pub gram: [[f64; R]; R],
    /// Columns against the residual of each channel.
    pub right: [[f64; 3]; R],
    /// Radiance of the constant and of each lobe, by channel.
    pub linear: [[f64; TERMS]; 3],
    /// Bit for each term that is not held at zero.
    pub active: [u8; 3],
    /// Weighted sum of squared residuals, by channel.
    pub squares: [f64; 3],
    /// Beside those, what no lobe can explain.
    pub beyond: f64,
}

/// A turn within the horizontal plane and one towards the zenith: the horizon is then a bound of the second alone.
pub(super) fn turns(direction: DVec3) -> [DVec3; 2] {
    let level = DVec3::new(-direction.y, direction.x, 0.0).try_normalize().unwrap_or(DVec3::X);
    [level, direction.cross(level)]
}

pub(super) fn lane_lobe(lobe: &Lobe, turns: &[DVec3; 2]) -> LaneLobe {
    LaneLobe {
        direction: lobe.direction.as_vec3().to_array(),
        turns: turns.map(|turn| turn.as_vec3().to_array()),
        shininess: lobe.shininess as f32,
        cosine_cut: (-CUT / lobe.shininess).exp() as f32,
    }
}

impl<const L: usize, const N: usize, const R: usize> Place<L, N, R> {
    /// Looks at the views from `lobes`, with `linear` as a first guess of the radiance.
    pub fn new(views: &mut Views, lobes: [Lobe; L], linear: &[[f64; TERMS]; 3]) -> Self {
        let turns = lobes.map(|lobe| turns(lobe.direction));
        let guess = linear.map(|values| values.map(|value| value as f32));
        let mut gram = [[0.0; R]; R];
        let Views { blocks, rows, beyond, .. } = views;
        rows.resize(rows.len().max(R * CHUNK), [0.0; lanes::WIDTH]);
        let (rows, _) = rows.as_chunks_mut::<R>();
        for blocks in blocks.chunks(CHUNK) {
            let rows = &mut rows[..blocks.len()];
            for l in 0..L {
                lanes::columns(blocks, &lane_lobe(&lobes[l], &turns[l]), rows, 1 + l, 1 + L + 3 * l);
            }
            lanes::residuals(blocks, rows, &guess, 1 + L);
            lanes::products(rows, &mut gram);
        }
        for i in 0..R {
            for j in 0..i {
                gram[i][j] = gram[j][i];
            }
        }
        let mut right = [[0.0; 3]; R];
        for i in 0..R {
            right[i].copy_from_slice(&gram[i][R - 3..]);
        }
        let mut place = Self {
            lobes,
            turns,
            gram,
            right,
            // What was in single precision is what the residuals are of.
            linear: guess.map(|values| values.map(f64::from)),
            active: [0; 3],
            squares: [gram[R - 3][R - 3], gram[R - 2][R - 2], gram[R - 1][R - 1]],
            beyond: *beyond,
        };
        place.settle();
        place
    }

    /// Moves the radiance to where it is best.
    fn settle(&mut self) {
        let mut terms = [[0.0; TERMS]; TERMS];
        for i in 0..=L {
            terms[i][..=L].copy_from_slice(&self.gram[i][..=L]);
        }
        let lower = cholesky(&terms, 1 + L);
        for c in 0..3 {
            let mut right = [0.0; TERMS];
            for i in 0..=L {
                right[i] = self.right[i][c];
            }
            let free = lower.as_ref().map(|lower| substitute(lower, &right, 1 + L));
            let mut change = free.unwrap_or_default();
            let mut active = (1 << (1 + L)) - 1;
            if free.is_none() || (0..=L).any(|i| self.linear[c][i] + change[i] < 0.0) {
                for i in 0..=L {
                    for j in 0..=L {
                        right[i] += terms[i][j] * self.linear[c][j];
                    }
                }
                let (values, set, _) = nonnegative(&terms, &right, 1 + L);
                for i in 0..=L {
                    change[i] = values[i] - self.linear[c][i];
                }
                active = set;
            }
            // Before and after together: the change times the sum of both right sides.
            for i in 0..=L {
                self.squares[c] -= change[i] * self.right[i][c];
            }
            for i in 0..1 + 4 * L {
                for j in 0..=L {
                    self.right[i][c] -= self.gram[i][j] * change[j];
                }
            }
            for i in 0..=L {
                self.squares[c] -= change[i] * self.right[i][c];
                self.linear[c][i] = (self.linear[c][i] + change[i]).max(0.0);
            }
            self.squares[c] = self.squares[c].max(0.0);
            self.active[c] = active;
        }
    }

    /// Weighted sum of squared residuals.
    pub fn total(&self) -> f64 {
        self.squares.iter().sum::<f64>() + self.beyond
    }

    /// Takes a short step on trust: the radiance follows as the derivatives say.
    fn follow(&mut self, step: &[f64; N], lobes: [Lobe; L]) {
        for c in 0..3 {
            let (small, index, count) = block(&self.gram, 1 + L, self.active[c]);
            let mut right = [0.0; R];
            for a in 0..count {
                for j in 0..N {
                    right[a] -= self.gram[index[a]][1 + L + j] * self.linear[c][1 + j / 3] * step[j];
                }
            }
            if let Some(change) = solve(&small, &right, count) {
                for a in 0..count {
                    let value = &mut self.linear[c][index[a]];
                    *value = (*value + change[a]).max(0.0);
                }
            }
        }
        self.lobes = lobes;
    }

    /// Gauss-Newton matrix and negative gradient in shininess and turns alone: what the radiance can absorb is taken
    /// away (Kaufman 1975).
    pub fn reduced(&self) -> ([[f64; N]; N], [f64; N]) {
        let (mut hessian, mut gradient) = ([[0.0; N]; N], [0.0; N]);
        let mut left = [[0.0; N]; N];
        for c in 0..3 {
            if c == 0 || self.active[c] != self.active[c - 1] {
                left = self.unabsorbed(self.active[c]);
            }
            for j in 0..3 * L {
                let scale = self.linear[c][1 + j / 3];
                gradient[j] += scale * self.right[1 + L + j][c];
                for k in 0..=j {
                    hessian[j][k] += scale * self.linear[c][1 + k / 3] * left[j][k];
                }
            }
        }
        (hessian, gradient)
    }

    /// Products (lower triangle) of the parts of the derivatives that the active terms cannot absorb.
    fn unabsorbed(&self, active: u8) -> [[f64; N]; N] {
        let (small, index, count) = block(&self.gram, 1 + L, active);
        let mut left = [[0.0; N]; N];
        let lower = cholesky(&small, count);
        // Forward substitution alone: G - Zᵀ Z with L Z = the cross products.
        let mut half = [[0.0; TERMS]; N];
        if let Some(lower) = &lower {
            for j in 0..3 * L {
                for a in 0..count {
                    let mut sum = self.gram[index[a]][1 + L + j];
                    for b in 0..a {
                        sum -= lower[a][b] * half[j][b];
                    }
                    half[j][a] = sum / lower[a][a];
                }
            }
        }
        for j in 0..3 * L {
            for k in 0..=j {
                let mut sum = self.gram[1 + L + j][1 + L + k];
                for a in 0..count {
                    sum -= half[j][a] * half[k][a];
                }
                left[j][k] = sum;
            }
        }
        left
    }

    /// The lobes after a step, within their bounds.
    fn moved(&self, step: &[f64; N], shininess_max: f64) -> [Lobe; L] {
        std::array::from_fn(|l| {
            let step = &step[3 * l..3 * l + 3];
            // Far steps leave the region where the derivative means anything.
            let limit = 0.5 / (step[1].hypot(step[2])).max(0.5);
            let turned =
                self.lobes[l].direction + (self.turns[l][0] * step[1] + self.turns[l][1] * step[2]) * limit;
            // A flat surface reflects light from above to above.
            let direction = turned.with_z(turned.z.max(0.0)).normalize_or(DVec3::Z);
            let shininess = (self.lobes[l].shininess * step[0].clamp(-1.0, 1.0).exp())
                .clamp(*SHININESS.start(), shininess_max);
            Lobe { direction, shininess }
        })
    }

    /// Takes away from matrix and gradient what would leave the bounds.
    fn hold(&self, hessian: &mut [[f64; N]; N], gradient: &mut [f64; N], shininess_max: f64) {
        for l in 0..L {
            let Lobe { direction, shininess } = self.lobes[l];
            let (shine, up) = (gradient[3 * l], gradient[3 * l + 2]);
            let held = [
                (shininess >= shininess_max && shine > 0.0)
                    || (shininess <= *SHININESS.start() && shine < 0.0),
                false,
                direction.z <= 0.0 && up < 0.0,
            ];
            for i in (0..3).filter(|i| held[*i]).map(|i| 3 * l + i) {
                for k in 0..3 * L {
                    hessian[i][k] = 0.0;
                    hessian[k][i] = 0.0;
                }
                (hessian[i][i], gradient[i]) = (1.0, 0.0);
            }
        }
    }
}

/// What bounds a search.
#[derive(Debug, Clone, Copy)]
pub(super) struct Search {
    pub shininess_max: f64,
    /// All lobes have the first one's shininess.
    pub shared: bool,
    /// Ends where the next step promises to lower the squares by less than this part of their mean for one
    /// observation; that step is still taken. 0.1: the parameters were within a third of their own uncertainty
    /// before it.
    pub small: f64,
    /// Says how sure the result is.
    pub covariance: bool,
}

/// Refines lobes together until nothing more is to be gained; whether that was reached. The last step is taken on trust:
/// radiance, products and squares are those before it.
pub(super) fn refine<const L: usize, const N: usize, const R: usize>(
    views: &mut Views,
    start: [Lobe; L],
    linear: &[[f64; TERMS]; 3],
    search: &Search,
) -> (Place<L, N, R>, bool) {
    let mut place = Place::<L, N, R>::new(views, start, linear);
    let rounding = ROUNDING * views.energy;
    let small = search.small / (3.0 * views.count as f64);
    let mut damping = 1e-4;
    let mut known = None;
    for _ in 0..MOST_STEPS {
        if place.total() <= rounding {
            return (place, true);
        }
        let (hessian, gradient) = *known.get_or_insert_with(|| {
            let (mut hessian, mut gradient) = place.reduced();
            if search.shared {
                tie(&mut hessian, &mut gradient);
            }
            place.hold(&mut hessian, &mut gradient, search.shininess_max);
            (hessian, gradient)
        });
        let mut damped = hessian;
        for (i, row) in damped.iter_mut().enumerate().take(3 * L) {
            row[i] += damping * row[i] + 1e-12 * views.energy;
        }
        let Some(mut step) = solve(&damped, &gradient, 3 * L) else {
            damping *= 10.0;
            continue;
        };
        let promised: f64 = step.iter().zip(&gradient).take(3 * L).map(|(s, g)| s * g).sum();
        if search.shared {
            for l in 1..L {
                step[3 * l] = step[0];
            }
        }
        let moved = place.moved(&step, search.shininess_max);
        // Where the views say little, a step that promises little may go far.
        let short = step.iter().take(3 * L).all(|step| step.abs() < LAST_STEP);
        if promised <= small * place.total() && short {
            place.follow(&step, moved);
            return (place, true);
        }
        let trial = Place::<L, N, R>::new(views, moved, &place.linear);
        if trial.total() < place.total() {
            place = trial;
            known = None;
            damping = (damping * 0.1).max(1e-9);
        } else {
            damping *= 10.0;
        }
        if promised <= small * place.total() || damping > 1e6 {
            return (place, true);
        }
    }
    (place, false)
}

/// One shininess for all lobes: the first one's stands for the sum.
pub(super) fn tie<const N: usize>(hessian: &mut [[f64; N]; N], gradient: &mut [f64; N]) {
    let n = N;
    for i in 0..n {
        for j in 0..i {
            hessian[j][i] = hessian[i][j];
        }
    }
    for other in (3..n).step_by(3) {
        gradient[0] += gradient[other];
        gradient[other] = 0.0;
        for k in 0..n {
            hessian[0][k] += hessian[other][k];
        }
        for k in 0..n {
            hessian[k][0] += hessian[k][other];
        }
        for k in 0..n {
            hessian[other][k] = 0.0;
            hessian[k][other] = 0.0;
        }
        hessian[other][other] = 1.0;
    }
}

/// Turns a lobe of given shininess to where it is best.
pub(super) fn hold_shininess(views: &mut Views, lobe: Lobe, linear: &[[f64; TERMS]; 3]) -> Place<1, 3, 8> {
    let mut place = Place::<1, 3, 8>::new(views, [lobe], linear);
    let mut damping = 1e-4;
    for _ in 0..12 {
        let (hessian, gradient) = place.reduced();
        let [a, b, c] = [hessian[1][1] * (1.0 + damping), hessian[2][1], hessian[2][2] * (1.0 + damping)];
        let determinant = a * c - b * b;
        if determinant <= 1e-12 * a * c {
            break;
        }
        let mut step = [0.0; 3];
        step[1] = (c * gradient[1] - b * gradient[2]) / determinant;
        step[2] = (a * gradient[2] - b * gradient[1]) / determinant;
        let promised = step[1] * gradient[1] + step[2] * gradient[2];
        if promised <= 0.05 / (3.0 * views.count as f64) * place.total() {
            break;
        }
        let [moved] = place.moved(&step, f64::INFINITY);
        let trial = Place::<1, 3, 8>::new(views, [moved], &place.linear);
        if trial.total() < place.total() {
            place = trial;
            damping = (damping * 0.1).max(1e-9);
        } else {
            damping = (damping * 10.0).max(1e-2);
        }
    }
    place
}

/// Leaves what lobes of given radiance do not explain in `left`.
pub(super) fn leave(views: &mut Views, lobes: &[Lobe], linear: &[[f64; TERMS]; 3]) {
    let Views { blocks, left, .. } = views;
    left.resize(blocks.len(), [[0.0; lanes::WIDTH]; 3]);
    let term = |t: usize| linear.map(|values| values[t] as f32);
    lanes::leave(blocks, term(0), left);
    for (l, lobe) in lobes.iter().enumerate() {
        lanes::deduct(blocks, &lane_lobe(lobe, &turns(lobe.direction)), term(1 + l), left);
    }
}
