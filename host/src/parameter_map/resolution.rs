//! How fine texels the data support.

use super::Selection;
use super::fitted::leave_out;
use crate::Result;
use crate::fit::{Selector, candidates};
use crate::geometry::Texels;
use crate::observation::ObservationMap;
use crate::progress::Progress;

/// So many tiles, spread over the surface, stand for it.
const TILES: usize = 8;
/// Coarser texels do whose error in unseen views is greater by this part at most.
const SLACK: f64 = 0.02;

/// What coarser texels would do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coarser {
    /// How many there would be.
    pub texels: Texels,
    /// By how much the mean error in views that the fit has not seen would grow, relative.
    pub growth: f64,
}

impl Coarser {
    /// Whether they would do as well.
    pub fn suffices(&self) -> bool {
        self.growth <= SLACK
    }
}

/// What texels of twice, four times and eight times the side would do, without the views `without`; as far as the first that do
/// not suffice.
///
/// # Errors
/// As [`select_surface`](super::select_surface).
pub fn coarser(
    map: &ObservationMap,
    selection: &Selection,
    without: &[u32],
    progress: &dyn Progress,
) -> Result<Vec<Coarser>> {
    let go_on = || progress.step(0, TILES + 3);
    let sample = map.sample(without)?;
    let selector = Selector::new(&candidates(), &selection.fit, selection.tolerance, &sample, &go_on)
        .map_err(|error| error.about(map.path()))?;
    let all = map.header().tiles().count();
    let looked_at = all.min(TILES);
    let mut tiles = vec![];
    for i in 0..looked_at {
        progress.step(i, TILES + 3)?;
        // From the middle of the surface's parts.
        let mut texels = map.tile((2 * i + 1) * all / (2 * looked_at))?;
        leave_out(&mut texels, without);
        let Some(top) = texels.first().map(|((_, row), _)| *row) else { continue };
        let columns = texels.iter().filter(|((_, row), _)| *row == top).count();
        tiles.push((columns, texels.into_iter().map(|(_, texel)| texel).collect()));
    }
    let mut found: Vec<Coarser> = vec![];
    for (step, side) in [2, 4, 8].into_iter().enumerate() {
        progress.step(TILES + step, TILES + 3)?;
        if found.last().is_some_and(|coarser| !coarser.suffices()) {
            break;
        }
        let Some(growth) = selector.growth(&tiles, side) else { break };
        let Texels { columns, rows } = map.header().texels;
        let texels = Texels { columns: columns.div_ceil(side as u32), rows: rows.div_ceil(side as u32) };
        found.push(Coarser { texels, growth });
    }
    progress.step(TILES + 3, TILES + 3)?;
    Ok(found)
}
