//! How far from its place in the picture a texel may appear.

use crate::calibration::RegisteredView;
use crate::geometry::{Lens, Surface, Texels};

/// Nodes along each side: what a pose's error moves varies slowly over the surface.
const NODES: u32 = 9;

/// Covariance (xx, xy, yy; pixels²) of where the surface appears in one view.
pub(super) struct PlaceError {
    nodes: Vec<[f32; 3]>,
}

impl PlaceError {
    /// Of a registered view. Where a node does not appear in the picture, neither do the texels around it.
    pub fn of(view: &RegisteredView, lens: &Lens, surface: &Surface) -> Self {
        let texels = Texels { columns: NODES, rows: NODES };
        let node = |i: u32| {
            let point = surface.texel_centre(texels, i % NODES, i / NODES);
            view.place_covariance_px2(lens, point).unwrap_or_default().map(|value| value as f32)
        };
        Self { nodes: (0..NODES * NODES).map(node).collect() }
    }

    /// Between the nodes bilinear.
    pub fn at(&self, texels: Texels, column: u32, row: u32) -> [f32; 3] {
        let along = |index: u32, count: u32| {
            let at = (index as f32 + 0.5) / count as f32 * NODES as f32 - 0.5;
            let first = at.clamp(0.0, (NODES - 2) as f32).floor();
            (first as usize, at - first)
        };
        let ((x, fx), (y, fy)) = (along(column, texels.columns), along(row, texels.rows));
        let node = |x: usize, y: usize| &self.nodes[y * NODES as usize + x];
        std::array::from_fn(|i| {
            let upper = node(x, y)[i] * (1.0 - fx) + node(x + 1, y)[i] * fx;
            let lower = node(x, y + 1)[i] * (1.0 - fx) + node(x + 1, y + 1)[i] * fx;
            upper * (1.0 - fy) + lower * fy
        })
    }

    #[cfg(test)]
    pub fn constant(value: [f32; 3]) -> Self {
        Self { nodes: vec![value; (NODES * NODES) as usize] }
    }
}
