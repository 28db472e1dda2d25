//! Pictures that the processor draws: text, curves, photographs. They are laid over what the device draws, or written as they are.

use std::f32::consts::TAU;

use glam::Vec2;

use crate::font::{ADVANCE, LINE, ROWS, has_ink};

/// RGB and opacity, each 0 to 255.
pub type Colour = [u8; 4];

/// Behind text and curves: what lies below shines through a little.
pub(crate) const DIM: Colour = [16, 17, 20, 205];
/// Text.
pub(crate) const INK: Colour = [236, 236, 230, 255];
/// Text that matters less, and axes.
pub(crate) const FAINT: Colour = [150, 152, 158, 255];

/// The radius of a ring of scale 1, pixels.
const RING_PX: f32 = 7.0;

/// A picture that may be transparent, row by row from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Raster {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Colours times opacity, and opacity: laid over something, a pixel is this and the rest of what was there.
    pub(crate) pixels: Vec<Colour>,
}

/// Width and height of lines of text with pixels of `scale` x `scale`.
pub(crate) fn text_size(lines: &[String], scale: u32) -> (u32, u32) {
    let longest = lines.iter().map(|line| line.chars().count()).max().unwrap_or(0) as u32;
    (longest * ADVANCE * scale, lines.len() as u32 * LINE * scale)
}

impl Raster {
    /// A transparent picture.
    pub fn new(width: u32, height: u32) -> Self {
        Self { width, height, pixels: vec![[0; 4]; width as usize * height as usize] }
    }

    /// Lays a colour over a pixel; beside the picture nothing happens.
    pub(crate) fn put(&mut self, x: i32, y: i32, [r, g, b, opacity]: Colour) {
        if x < 0 || y < 0 || x >= self.width as i32 || y >= self.height as i32 {
            return;
        }
        let part = |value: u8, of: u8| ((u32::from(value) * u32::from(of) + 127) / 255) as u8;
        let pixel = &mut self.pixels[y as usize * self.width as usize + x as usize];
        let over = [part(r, opacity), part(g, opacity), part(b, opacity), opacity];
        *pixel = std::array::from_fn(|c| over[c].saturating_add(part(pixel[c], 255 - opacity)));
    }

    /// A rectangle.
    pub(crate) fn fill(&mut self, (x, y): (i32, i32), (width, height): (u32, u32), colour: Colour) {
        for row in y.max(0)..(y + height as i32).min(self.height as i32) {
            for column in x.max(0)..(x + width as i32).min(self.width as i32) {
                self.put(column, row, colour);
            }
        }
    }

    /// A straight line of squares of `side` pixels.
    pub(crate) fn line(&mut self, from: Vec2, to: Vec2, side: u32, colour: Colour) {
        let steps = (to - from).abs().max_element().ceil();
        // What is not a number, or far beside the picture, is not drawn for hours.
        if !steps.is_finite() || steps > 16.0 * (self.width + self.height) as f32 {
            return;
        }
        let half = (side / 2) as i32;
        for step in 0..=steps as u32 {
            let at = from.lerp(to, step as f32 / steps.max(1.0)).round().as_ivec2();
            self.fill((at.x - half, at.y - half), (side, side), colour);
        }
    }

    /// A ring around a place, to be seen on bright and dark.
    pub fn ring(&mut self, centre: Vec2, scale: u32) {
        let on_ring =
            |step: u16| centre + RING_PX * scale as f32 * Vec2::from_angle(f32::from(step) * TAU / 32.0);
        for (side, colour) in [(3, DIM), (1, INK)] {
            (0..32).for_each(|step| self.line(on_ring(step), on_ring(step + 1), side * scale, colour));
        }
    }

    /// A line of text from its top-left corner.
    pub(crate) fn text(&mut self, (x, y): (i32, i32), scale: u32, text: &str, colour: Colour) {
        for (place, letter) in text.chars().enumerate() {
            let left = x + (place as u32 * ADVANCE * scale) as i32;
            for row in 0..ROWS {
                for column in (0..ADVANCE).filter(|column| has_ink(letter, *column, row)) {
                    let at = (left + (column * scale) as i32, y + (row * scale) as i32);
                    self.fill(at, (scale, scale), colour);
                }
            }
        }
    }

    /// Lines of text on a dim ground; returns the ground's size.
    pub(crate) fn note(&mut self, (x, y): (i32, i32), scale: u32, lines: &[String]) -> (u32, u32) {
        let margin = 3 * scale;
        let (width, height) = text_size(lines, scale);
        let ground = (width + 2 * margin, height + 2 * margin);
        self.fill((x, y), ground, DIM);
        for (number, line) in lines.iter().enumerate() {
            let top = y + (margin + number as u32 * LINE * scale) as i32;
            self.text((x + margin as i32, top), scale, line, INK);
        }
        ground
    }

    /// Another picture, its top-left corner at (`x`, `y`).
    pub fn place(&mut self, (x, y): (i32, i32), other: &Raster) {
        for (i, pixel) in other.pixels.iter().enumerate() {
            let (column, row) =
                (x + (i % other.width as usize) as i32, y + (i / other.width as usize) as i32);
            if (0..self.width as i32).contains(&column) && (0..self.height as i32).contains(&row) {
                let below = &mut self.pixels[row as usize * self.width as usize + column as usize];
                *below = laid_over(*pixel, *below);
            }
        }
    }

    /// An opaque picture of this size, enlarged or reduced to `width` x `height` at (`x`, `y`) by its nearest pixels.
    pub fn picture(
        &mut self,
        (x, y): (i32, i32),
        (width, height): (u32, u32),
        levels: &[[u8; 3]],
        (columns, rows): (u32, u32),
    ) {
        for row in 0..height {
            let from = (u64::from(row) * u64::from(rows) / u64::from(height)) as usize * columns as usize;
            for column in 0..width {
                let [r, g, b] =
                    levels[from + (u64::from(column) * u64::from(columns) / u64::from(width)) as usize];
                self.put(x + column as i32, y + row as i32, [r, g, b, 255]);
            }
        }
    }

    /// What is seen where this lies on a picture of the same size.
    pub(crate) fn on(&self, picture: Vec<[u8; 3]>) -> Vec<[u8; 3]> {
        let seen = |([r, g, b], over): ([u8; 3], &Colour)| {
            let [r, g, b, _] = laid_over(*over, [r, g, b, 255]);
            [r, g, b]
        };
        picture.into_iter().zip(&self.pixels).map(seen).collect()
    }

    /// What is seen where this lies on black.
    pub fn levels(&self) -> Vec<[u8; 3]> {
        self.pixels.iter().map(|&[r, g, b, _]| [r, g, b]).collect()
    }
}

fn laid_over(over: Colour, below: Colour) -> Colour {
    let rest = 255 - u32::from(over[3]);
    std::array::from_fn(|c| over[c].saturating_add(((u32::from(below[c]) * rest + 127) / 255) as u8))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn every_letter_looks_different_and_stays_in_its_cell() {
        let drawn = |letter: char| {
            let mut raster = Raster::new(ADVANCE, LINE);
            raster.text((0, 0), 1, &letter.to_string(), INK);
            // Beside its neighbours, and above the next line.
            let width = ADVANCE as usize;
            assert!(raster.pixels.iter().skip(width - 1).step_by(width).all(|pixel| pixel[3] == 0));
            assert!(raster.pixels[width * (LINE as usize - 2)..].iter().all(|pixel| pixel[3] == 0));
            raster.pixels
        };
        let letters: Vec<char> = (' '..='~').chain(['\u{fc}']).collect();
        assert_eq!(letters.iter().map(|letter| drawn(*letter)).collect::<HashSet<_>>().len(), letters.len());
    }

    #[test]
    fn what_lies_on_a_picture_is_mixed_with_it() {
        let mut raster = Raster::new(3, 1);
        raster.put(0, 0, [200, 100, 0, 255]);
        raster.put(1, 0, [200, 100, 0, 128]);
        let seen = raster.on(vec![[10, 20, 250]; 3]);
        assert_eq!((seen[0], seen[2]), ([200, 100, 0], [10, 20, 250]));
        for (c, want) in [105u8, 60, 125].into_iter().enumerate() {
            assert!(seen[1][c].abs_diff(want) <= 1, "{:?}", seen[1]);
        }
        // Twice the same veil hides more; beside the picture is nothing.
        raster.put(1, 0, [200, 100, 0, 128]);
        raster.put(-1, 0, INK);
        raster.put(3, 0, INK);
        assert!(raster.on(vec![[10, 20, 250]; 3])[1][2] < 70);
    }

    #[test]
    fn lines_and_rectangles_are_cut_at_the_edge() {
        let mut raster = Raster::new(8, 6);
        raster.fill((-5, -5), (100, 7), [255, 0, 0, 255]);
        raster.line(Vec2::new(-20.0, 4.0), Vec2::new(30.0, 4.0), 1, [0, 255, 0, 255]);
        raster.line(Vec2::new(0.0, f32::NAN), Vec2::new(7.0, 5.0), 1, INK);
        let levels = raster.levels();
        assert!(levels[..16].iter().all(|pixel| *pixel == [255, 0, 0]));
        assert!(levels[32..40].iter().all(|pixel| *pixel == [0, 255, 0]));
        assert_eq!(levels.iter().filter(|pixel| **pixel == [0; 3]).count(), 24);
    }
}
