//! How far from its place in the picture a texel may appear.

use crate::calibration::RegisteredView;
use crate::geometry::{Lens, Surface, Texels};

/// Nodes along each side: what a pose's error moves varies slowly over the surface.
const NODES: u32 = 9;

/// Covariance (xx, xy, yy; pixels²) of where the surface appears in one view.
pub(super) struct PlaceError {
    nodes: Vec<Option<[f32; 3]>>,
}

impl PlaceError {
    /// Of a registered view.
    pub fn of(view: &RegisteredView, lens: &Lens, surface: &Surface) -> Self {
        let texels = Texels { columns: NODES, rows: NODES };
        let node = |i: u32| {
            let point = surface.texel_centre(texels, i % NODES, i / NODES);
            Some(view.place_covariance_px2(lens, point)?.map(|value| value as f32))
        };
        Self { nodes: (0..NODES * NODES).map(node).collect() }
    }

    /// Between the nodes bilinear; `None` where the lens does not show one of them.
    pub fn at(&self, texels: Texels, column: u32, row: u32) -> Option<[f32; 3]> {
        let along = |index: u32, count: u32| {
            let at = (index as f32 + 0.5) / count as f32 * NODES as f32 - 0.5;
            let first = at.clamp(0.0, (NODES - 2) as f32).floor();
            (first as usize, at - first)
        };
        let ((x, fx), (y, fy)) = (along(column, texels.columns), along(row, texels.rows));
        let node = |x: usize, y: usize| self.nodes[y * NODES as usize + x];
        let [a, b, c, d] = [node(x, y)?, node(x + 1, y)?, node(x, y + 1)?, node(x + 1, y + 1)?];
        Some(std::array::from_fn(|i| {
            let upper = a[i] * (1.0 - fx) + b[i] * fx;
            let lower = c[i] * (1.0 - fx) + d[i] * fx;
            upper * (1.0 - fy) + lower * fy
        }))
    }

    #[cfg(test)]
    pub fn constant(value: [f32; 3]) -> Self {
        Self { nodes: vec![Some(value); (NODES * NODES) as usize] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beside_a_place_that_the_lens_does_not_show_nothing_is_known() {
        let mut place = PlaceError::constant([0.1, 0.0, 0.1]);
        place.nodes[0] = None;
        let texels = Texels { columns: 90, rows: 90 };
        assert_eq!(place.at(texels, 0, 0), None);
        assert_eq!(place.at(texels, 12, 3), None);
        assert!(place.at(texels, 20, 3).is_some());
    }
}
