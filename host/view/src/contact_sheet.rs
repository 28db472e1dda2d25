//! A contact sheet: photographs of a session, what the map says of them, and the difference, each on the surface's rectangle.

use glam::DVec2;
use rigel::evaluate::Reference;
use rigel::geometry::{Texels, azimuth_zenith};
use rigel::parameter_map::ParameterMap;
use rigel::progress::Progress;
use rigel::shader::{Look, false_colour};
use rigel::{Error, Result};

use crate::flip::{MOST, apart, matched, photograph, shows};
use crate::font::LINE;
use crate::graphics::Graphics;
use crate::raster::{FAINT, INK, Raster, text_size};
use crate::scene::{Scene, View};
use crate::shift::{FAR_PX, Shift, shift_px};

/// The wider side of a picture, pixels.
const SIDE: u32 = 132;
/// Between pictures.
const GAP: u32 = 4;
/// Places along each side of a pixel that are averaged.
const PARTS: u32 = 3;
/// What stands before the rows.
const ROWS: [&str; 3] = ["photograph", "reconstruction", "difference"];
const GROUND: [u8; 4] = [16, 17, 20, 255];

/// What flipping from a photograph to its reconstruction shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Flipped {
    /// The view's name.
    pub name: String,
    /// Where the camera was, from the surface's normal, degrees.
    pub zenith_deg: f64,
    /// How far the photograph is shifted against the reconstruction, its own pixels.
    pub shift_px: Shift,
    /// Mean absolute difference, of 255, over the pixels that were measured.
    pub mean_255: f64,
    /// Whether the fit has seen the view, where the map knows.
    pub was_seen: Option<bool>,
}

/// The sheet, and what it shows in numbers.
pub struct ContactSheet {
    /// The picture.
    pub picture: Raster,
    /// Column by column.
    pub views: Vec<Flipped>,
}

/// `count` of the views whose zeniths are given (degrees; by index), spread evenly over them in the order of their zeniths.
pub fn spread(zeniths_deg: &[f64], count: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..zeniths_deg.len()).collect();
    order.sort_by(|&a, &b| zeniths_deg[a].total_cmp(&zeniths_deg[b]));
    let count = count.min(order.len());
    (0..count).map(|i| order[i * (order.len() - 1) / (count - 1).max(1)]).collect()
}

/// Draws the sheet as the window would show its views: `view` has the exposure and the shading. `progress` counts views.
///
/// # Errors
/// [`Error::Request`] when a view shows nothing of the surface; what `references` and [`Scene::picture`] report;
/// [`Error::Interrupted`].
pub fn contact_sheet(
    graphics: &Graphics,
    map: &ParameterMap,
    references: impl ExactSizeIterator<Item = Result<Reference>>,
    view: &View,
    progress: &dyn Progress,
) -> Result<ContactSheet> {
    let scene = Scene::new(graphics, map, crate::scene::PICTURE)?;
    let by = f64::from(SIDE) / map.surface.width_m.max(map.surface.height_m);
    let tile = Texels {
        columns: (map.surface.width_m * by).round().max(1.0) as u32,
        // No lower than its name beside it.
        rows: (map.surface.height_m * by).round().max(LINE.into()) as u32,
    };
    let count = references.len();
    let look = Look { false_colour: false, ..view.look };
    let (left, _) = text_size(&ROWS.map(str::to_owned), 1);
    let (left, top) = (left + 2 * GAP, 2 * LINE + 2 * GAP);
    // No narrower than its label above it.
    let pitch = SIDE + GAP;
    let across = left + count as u32 * pitch;
    let mut sheet = Raster::new(across.max(left + 300), top + 3 * (tile.rows + GAP) + 2 * LINE + GAP);
    sheet.fill((0, 0), (sheet.width, sheet.height), GROUND);
    for (row, name) in ROWS.iter().enumerate() {
        let y = top + row as u32 * (tile.rows + GAP) + (tile.rows - LINE) / 2;
        sheet.text((GAP as i32, y as i32), 1, name, INK);
    }
    let mut views = vec![];
    for (column, reference) in references.enumerate() {
        progress.step(column, count)?;
        let reference = matched(reference?, map);
        let drawn = View { lens: reference.lens, pose: reference.pose, look, ..*view };
        let reconstruction = scene.picture(graphics, &drawn)?;
        let photograph = photograph(&reference, &look);
        let flipped = flipped(map, &reference, &photograph, &reconstruction)?;

        let x = (left + column as u32 * pitch) as i32;
        let seen = |levels: &[[u8; 3]]| on_the_surface(map, &reference, levels, tile);
        let (above, below) = (seen(&photograph), seen(&reconstruction));
        let measured = reference.radiance.mask.iter().map(|mask| [if *mask == 0 { 255 } else { 0 }; 3]);
        let coloured = coloured((&above, &below), &seen(&measured.collect::<Vec<_>>()));
        for (row, levels) in [&above, &below, &coloured].into_iter().enumerate() {
            let y = (top + row as u32 * (tile.rows + GAP)) as i32;
            let size = (tile.columns, tile.rows);
            sheet.picture((x, y), size, levels, size);
        }
        let [first, second] = flipped.label();
        sheet.text((x, GAP as i32), 1, &first, INK);
        sheet.text((x, (GAP + LINE) as i32), 1, &second, FAINT);
        views.push(flipped);
    }
    scale(&mut sheet, (left as i32, (top + 3 * (tile.rows + GAP) + GAP) as i32));
    progress.step(count, count)?;
    Ok(ContactSheet { picture: sheet, views })
}

impl Flipped {
    fn label(&self) -> [String; 2] {
        let unseen = if self.was_seen == Some(false) { " unseen" } else { "" };
        let shift = match self.shift_px {
            Shift::By(shift) => format!("{:.2} px, ", shift.length()),
            Shift::Far => format!("> {FAR_PX:.0} px, "),
            Shift::Untold => String::new(),
        };
        [
            format!("{} {:.0} deg{unseen}", self.name, self.zenith_deg),
            format!("{shift}{:.1} of 255", self.mean_255),
        ]
    }
}

fn flipped(
    map: &ParameterMap,
    reference: &Reference,
    photograph: &[[u8; 3]],
    reconstruction: &[[u8; 3]],
) -> Result<Flipped> {
    let counts = shows(map, reference)?;
    let off = |i: usize| {
        let levels = photograph[i].iter().zip(&reconstruction[i]);
        levels.map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / 3.0
    };
    let pixels: Vec<usize> = (0..counts.len()).filter(|&i| counts[i]).collect();
    if pixels.is_empty() {
        return Err(Error::request(
            format!("view {} shows nothing of the surface", reference.name),
            "register the session again",
        ));
    }
    let seen = map.diagnostics.as_ref().map(|diagnostics| &diagnostics.seen).filter(|seen| !seen.is_empty());
    Ok(Flipped {
        name: reference.name.clone(),
        zenith_deg: azimuth_zenith(reference.pose.centre_m).1.to_degrees(),
        shift_px: shift_px(photograph, reconstruction, &reference.lens, &counts),
        mean_255: pixels.iter().map(|&i| off(i)).sum::<f64>() / pixels.len() as f64,
        was_seen: seen.map(|seen| seen.contains(&reference.name)),
    })
}

/// How far two pictures are apart; black where not all was `measured` (white).
fn coloured((above, below): (&[[u8; 3]], &[[u8; 3]]), measured: &[[u8; 3]]) -> Vec<[u8; 3]> {
    let pairs = above.iter().zip(below).zip(measured);
    pairs.map(|((a, b), measured)| if *measured == [255; 3] { apart(a, b) } else { [0; 3] }).collect()
}

/// A picture of a view, as it looks from straight above: black where the view does not show the surface.
fn on_the_surface(
    map: &ParameterMap,
    reference: &Reference,
    levels: &[[u8; 3]],
    tile: Texels,
) -> Vec<[u8; 3]> {
    let fine = Texels { columns: tile.columns * PARTS, rows: tile.rows * PARTS };
    let seen = |column: u32, row: u32| {
        let point_m = map.surface.texel_centre(fine, column, row);
        let pixel = reference.lens.project(reference.pose.to_camera(point_m))?;
        between(levels, (reference.lens.width, reference.lens.height), pixel)
    };
    let pixel = |i: u32| {
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for part in 0..PARTS * PARTS {
            let column = i % tile.columns * PARTS + part % PARTS;
            let row = i / tile.columns * PARTS + part / PARTS;
            if let Some(seen) = seen(column, row) {
                (sum, count) = (std::array::from_fn(|c| sum[c] + seen[c]), count + 1.0);
            }
        }
        sum.map(|sum: f64| (sum / f64::max(count, 1.0)).round() as u8)
    };
    (0..tile.columns * tile.rows).map(pixel).collect()
}

/// The picture between four pixels.
fn between(levels: &[[u8; 3]], (width, height): (u32, u32), pixel: DVec2) -> Option<[f64; 3]> {
    let first = pixel.floor();
    if first.x < 0.0
        || first.y < 0.0
        || first.x + 1.0 >= f64::from(width)
        || first.y + 1.0 >= f64::from(height)
    {
        return None;
    }
    let part = pixel - first;
    let at = first.y as usize * width as usize + first.x as usize;
    let corners = [at, at + 1, at + width as usize, at + width as usize + 1];
    let shares =
        [(1.0 - part.x) * (1.0 - part.y), part.x * (1.0 - part.y), (1.0 - part.x) * part.y, part.x * part.y];
    Some(std::array::from_fn(|c| (0..4).map(|k| shares[k] * f64::from(levels[corners[k]][c])).sum()))
}

/// What the colours of a difference mean.
pub(crate) fn scale(raster: &mut Raster, (x, y): (i32, i32)) {
    const WIDTH: i32 = 128;
    raster.text((x, y), 1, "0", INK);
    for step in 0..WIDTH {
        let [r, g, b] = false_colour(step as f32 / (WIDTH - 1) as f32);
        raster.fill((x + 10 + step, y), (1, LINE - 2), [r, g, b, 255]);
    }
    raster.text((x + WIDTH + 14, y), 1, &format!("{MOST:.0} of 255, mean of the channels"), INK);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_spread_from_the_steepest_to_the_flattest_without_repetition() {
        let zeniths = [70.0, 0.0, 35.0, 10.0, 60.0, 20.0, 50.0];
        assert_eq!(spread(&zeniths, 3), [1, 2, 0]);
        assert_eq!(spread(&zeniths, 1), [1]);
        let all = spread(&zeniths, 10);
        assert_eq!(all, [1, 3, 5, 2, 6, 4, 0]);
        assert!(spread(&[], 10).is_empty());
    }

    #[test]
    fn beside_the_photograph_and_where_it_was_not_measured_no_difference_is_claimed() {
        let (map, tile) = (crate::flip::tests::map([0.5; 3]), Texels { columns: 40, rows: 30 });
        let mut reference = crate::flip::tests::reference([0.5; 3]);
        let (width, height) = (reference.lens.width, reference.lens.height);
        // The right half of the surface is beside the picture, and the lower half was too bright.
        reference.lens.cx = f64::from(width);
        reference.radiance.mask[(width * height / 2) as usize..].fill(1);
        let levels = vec![[100; 3]; (width * height) as usize];
        let seen = on_the_surface(&map, &reference, &levels, tile);
        let measured = reference.radiance.mask.iter().map(|mask| [if *mask == 0 { 255 } else { 0 }; 3]);
        let measured = on_the_surface(&map, &reference, &measured.collect::<Vec<_>>(), tile);
        let coloured = coloured((&seen, &seen), &measured);
        let is_known = |column: usize, row: usize| coloured[row * 40 + column] == apart(&[9; 3], &[9; 3]);
        assert!(is_known(5, 5) && !is_known(35, 5) && !is_known(5, 25) && !is_known(35, 25));
    }
}
