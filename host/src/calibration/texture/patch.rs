//! How far a patch of a view's texture is from where the others have it: Lucas and Kanade's method ("An iterative image
//! registration technique", 1981) on patterns, with the reference's gradient (Baker and Matthews, "Lucas-Kanade 20 years on",
//! 2004, section 3.2), a gain, and Huber's weights.

use glam::DVec2;
use nalgebra::{Matrix2, Vector2};

use super::pattern::{Pattern, Reference};
use super::search::TOGETHER;

const STEPS: usize = 6;
/// Steps shorter than this (nodes) are the last.
const SHORT: f64 = 0.005;
/// A patch that is further off than this (nodes) was not found.
const FURTHEST: f64 = 2.5;
/// What is less like the others' is not the same.
const LEAST: f64 = 0.4;
/// Every so many nodes are looked at in either direction: those between say hardly more.
const STRIDE: usize = 2;
/// Fewer nodes are no patch, part of it.
const FEWEST: f64 = 0.5;
/// A residual counts in full up to so many standard deviations.
const HUBER: f64 = 1.5;
/// Along an edge nothing is known: no more than this (nodes, standard deviation).
const WEAKEST: f64 = 3.0;
/// A patch whose best known direction is worse than this (nodes, standard deviation) says nothing.
const DOUBTFUL: f64 = 0.5;

/// A box of nodes of a grid, ends excluded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    pub columns: (usize, usize),
    pub rows: (usize, usize),
}

/// Where a patch is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tracked {
    /// By how many nodes it is further on than in the reference.
    pub shift: DVec2,
    /// Covariance of that, nodes².
    pub covariance: Matrix2<f64>,
    /// Correlation with the reference there.
    pub likeness: f64,
}

struct Node {
    at: DVec2,
    reference: f64,
    gradient: Vector2<f64>,
}

impl Patch {
    /// The middle, as a node.
    pub fn centre(&self) -> DVec2 {
        let middle = |(from, to): (usize, usize)| (from + to - 1) as f64 / 2.0;
        DVec2::new(middle(self.columns), middle(self.rows))
    }

    fn nodes(&self, reference: &Reference, own: Option<&Pattern>) -> Vec<Node> {
        let columns = reference.grid.columns;
        let others = |x: usize, y: usize| {
            let i = y * columns + x;
            let (value, weight) = own.map_or((0.0, 0.0), |own| (own.value[i], own.weight[i]));
            let (value, weight) = reference.without(i, value, weight);
            (weight > 0.0).then_some(f64::from(value))
        };
        let mut nodes = vec![];
        for y in (self.rows.0.max(1)..self.rows.1.min(reference.grid.rows - 1)).step_by(STRIDE) {
            for x in (self.columns.0.max(1)..self.columns.1.min(columns - 1)).step_by(STRIDE) {
                let node = || {
                    let gradient = Vector2::new(
                        others(x + 1, y)? - others(x - 1, y)?,
                        others(x, y + 1)? - others(x, y - 1)?,
                    ) / 2.0;
                    Some(Node { at: DVec2::new(x as f64, y as f64), reference: others(x, y)?, gradient })
                };
                nodes.extend(node());
            }
        }
        nodes
    }

    /// Looks for the patch in a pattern; `own` is that pattern where it is part of the reference. `None` where it is not
    /// there, or has no texture.
    pub fn track(&self, reference: &Reference, pattern: &Pattern, own: Option<&Pattern>) -> Option<Tracked> {
        let nodes_of = |(from, to): (usize, usize)| (to - from) as f64 / STRIDE as f64;
        let whole = nodes_of(self.columns) * nodes_of(self.rows);
        let nodes = self.nodes(reference, own);
        let mut shift = DVec2::ZERO;
        let mut gain = 1.0;
        let mut sigma = f64::INFINITY;
        for step in 0..STEPS {
            let (mut matrix, mut right) = (Matrix2::zeros(), Vector2::zeros());
            let (mut squared, mut weighed, mut known) = (0.0, 0.0, 0.0);
            let (mut with, mut of_view, mut of_others) = (0.0, 0.0, 0.0);
            for node in &nodes {
                let Some(value) = between(pattern, node.at + shift) else { continue };
                let residual = value - gain * node.reference;
                let weight =
                    if residual.abs() > HUBER * sigma { HUBER * sigma / residual.abs() } else { 1.0 };
                matrix += node.gradient * node.gradient.transpose() * weight;
                right -= node.gradient * (residual * weight);
                squared += weight * residual * residual;
                weighed += weight;
                known += 1.0;
                with += weight * value * node.reference;
                of_view += weight * value * value;
                of_others += weight * node.reference * node.reference;
            }
            if known < FEWEST * whole || of_others <= 0.0 || of_view <= 0.0 {
                return None;
            }
            let likeness = with / (of_view * of_others).sqrt();
            let first_gain = step == 0;
            gain = with / of_others;
            sigma = (squared / weighed).sqrt();
            if gain <= 0.0 {
                return None;
            }
            if first_gain {
                // The residuals were those of a gain of 1: once more with the right one.
                continue;
            }
            let eigen = (matrix * (gain * gain)).symmetric_eigen();
            let variance = sigma * sigma * (TOGETHER / (STRIDE * STRIDE) as f64).max(1.0);
            // Along each axis as far as it is known.
            let mut covariance = Matrix2::zeros();
            let mut by = Vector2::zeros();
            for (value, axis) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
                let of_axis = (variance / value.max(f64::MIN_POSITIVE)).min(WEAKEST * WEAKEST);
                // What is hardly known stays where it was.
                let damped = axis.dot(&right) * gain / (value + variance / (WEAKEST * WEAKEST));
                by += axis * damped;
                covariance += axis * axis.transpose() * of_axis;
            }
            shift += DVec2::new(by[0], by[1]).clamp_length_max(1.0);
            if shift.length() > FURTHEST {
                return None;
            }
            if by.norm() < SHORT || step + 1 == STEPS {
                let best = variance / eigen.eigenvalues.max();
                let is_found = likeness >= LEAST && best < DOUBTFUL * DOUBTFUL && by.norm() < 0.1;
                return is_found.then_some(Tracked { shift, covariance, likeness });
            }
        }
        None
    }
}

fn between(pattern: &Pattern, node: DVec2) -> Option<f64> {
    let (x, y) = (node.x.floor(), node.y.floor());
    let (columns, rows) = (pattern.grid.columns, pattern.grid.rows);
    if x < 0.0 || y < 0.0 || x + 1.0 >= columns as f64 || y + 1.0 >= rows as f64 {
        return None;
    }
    let (fx, fy) = ((node.x - x) as f32, (node.y - y) as f32);
    let first = y as usize * columns + x as usize;
    let corners = [first, first + 1, first + columns, first + columns + 1];
    if corners.iter().any(|&i| pattern.weight[i] == 0.0) {
        return None;
    }
    let [a, b, c, d] = corners.map(|i| pattern.value[i]);
    Some(f64::from((a + fx * (b - a)) * (1.0 - fy) + (c + fx * (d - c)) * fy))
}
