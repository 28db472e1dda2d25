//! A map as the six faces of a cube.

use std::path::Path;

use glam::DVec3;
use rayon::prelude::*;

use super::map::{EnvironmentMap, Flag, tone_mapped, write_exr};
use crate::{Error, Result, file};

/// Directions across a face's pixel, at least: two across each of the map's pixels.
const PLACES: usize = 2;

/// Radiance on the six sides of a cube about the place of the map.
#[derive(Debug, Clone, PartialEq)]
pub struct Cube {
    /// Pixels along a side.
    pub size: u32,
    /// Linear red, green and blue of [`Cube::NAMES`] in this order, each row by row from the top left; 0 where nothing was seen.
    pub radiance: [Vec<[f32; 3]>; 6],
    /// [`EnvironmentMap`]'s flags, all that lie in a pixel.
    pub flags: [Vec<Flag>; 6],
}

impl Cube {
    /// The faces: towards +x, -x, +y, -y, +z and -z.
    pub const NAMES: [&str; 6] = ["px", "nx", "py", "ny", "pz", "nz"];

    /// The vector to a point of a face, columns and rows from 0 to 1, as OpenGL, Vulkan and WebGPU lay out cube maps (OpenGL 4.6, table 8.19):
    /// a sampler that is given a direction of the map's axes finds it.
    pub fn direction(face: usize, column: f64, row: f64) -> DVec3 {
        let (s, t) = (2.0 * column - 1.0, 2.0 * row - 1.0);
        match face {
            0 => DVec3::new(1.0, -t, -s),
            1 => DVec3::new(-1.0, -t, s),
            2 => DVec3::new(s, 1.0, t),
            3 => DVec3::new(s, -1.0, -t),
            4 => DVec3::new(s, -t, 1.0),
            _ => DVec3::new(-s, -t, -1.0),
        }
    }

    /// The mean of the map over each pixel of a face, by solid angle; what was not seen does not count.
    ///
    /// # Errors
    /// [`Error::Request`] for a size that is none.
    pub fn new(map: &EnvironmentMap, size: u32) -> Result<Self> {
        if !(1..=8192).contains(&size) {
            return Err(Error::request(format!("faces of {size}x{size} pixels"), "choose 1 to 8192"));
        }
        let side = f64::from(size);
        // A pixel in the middle of a face is the largest.
        let finer = 2.0 / side / (std::f64::consts::PI / map.size.height() as f64);
        let places = ((2.0 * finer).ceil() as usize).max(PLACES);
        let pixel = |face: usize, number: usize| {
            let (column, row) = ((number % size as usize) as f64, (number / size as usize) as f64);
            let (mut sum, mut all, mut flags) = ([0.0; 3], 0.0, 0);
            for i in 0..places * places {
                let step = |k: usize| (k as f64 + 0.5) / places as f64;
                let to = Self::direction(
                    face,
                    (column + step(i % places)) / side,
                    (row + step(i / places)) / side,
                );
                let (radiance, known, flag) = map.toward(to);
                // A place's solid angle.
                let weight = known * to.length_squared().powf(-1.5);
                (0..3).for_each(|c| sum[c] += weight * radiance[c]);
                all += weight;
                flags |= flag;
            }
            if all > 0.0 {
                (sum.map(|sum| (sum / all) as f32), flags)
            } else {
                ([0.0; 3], EnvironmentMap::UNSEEN)
            }
        };
        let count = (size * size) as usize;
        let mut cube = Self { size, radiance: Default::default(), flags: Default::default() };
        for face in 0..6 {
            (cube.radiance[face], cube.flags[face]) =
                (0..count).into_par_iter().map(|number| pixel(face, number)).unzip();
        }
        Ok(cube)
    }

    /// Writes each face to a folder, which is made where it does not exist: `px.exr` with `R G B` and `flags`, `px.png` for a look (one
    /// brightness for all), and so on.
    ///
    /// # Errors
    /// [`Error::Io`] where it cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let levels = tone_mapped(&self.radiance.concat());
        let mut pictures = vec![];
        for (face, levels) in levels.chunks_exact(levels.len() / 6).enumerate() {
            let name = format!("{}.png", Self::NAMES[face]);
            let mut png = std::io::Cursor::new(vec![]);
            image::RgbImage::from_raw(self.size, self.size, levels.to_vec())
                .map(|picture| picture.write_to(&mut png, image::ImageFormat::Png))
                .transpose()
                .map_err(|error| {
                    Error::io("write", folder.join(&name))(std::io::Error::other(error.to_string()))
                })?;
            pictures.push((name, png.into_inner()));
        }
        std::fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
        for (face, name) in Self::NAMES.iter().enumerate() {
            let comments = format!(
                "The face {name} of a cube map as OpenGL, Vulkan and WebGPU lay it out, y up. flags: 1 a lower bound (saturated), 2 never \
                 seen, 4 never seen and filled."
            );
            let place = folder.join(format!("{name}.exr"));
            write_exr(&place, self.size as usize, (&self.radiance[face], &self.flags[face]), &comments)?;
        }
        file::write_together(folder, &pictures)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;
    use crate::geometry::LatLong;

    fn map(rows: u32, radiance: impl Fn(DVec3) -> f64) -> EnvironmentMap {
        let size = LatLong::new(2 * rows, rows).unwrap();
        let at = |i: usize| DVec2::new((i % size.width()) as f64, (i / size.width()) as f64);
        let radiance = (0..size.count()).map(|i| [radiance(size.direction(at(i))) as f32; 3]).collect();
        EnvironmentMap {
            size,
            radiance,
            variance: vec![],
            coverage: vec![],
            flags: vec![],
            unit: Default::default(),
            curve: vec![],
        }
    }

    #[test]
    fn a_direction_is_found_where_a_sampler_looks() {
        // OpenGL 4.6, table 8.19: face, sc, tc, ma.
        for (direction, face, s, t) in [
            (DVec3::new(1.0, 0.2, 0.3), 0, -0.3, -0.2),
            (DVec3::new(-1.0, 0.2, 0.3), 1, 0.3, -0.2),
            (DVec3::new(0.1, 1.0, 0.3), 2, 0.1, 0.3),
            (DVec3::new(0.1, -1.0, 0.3), 3, 0.1, -0.3),
            (DVec3::new(0.1, 0.2, 1.0), 4, 0.1, -0.2),
            (DVec3::new(0.1, 0.2, -1.0), 5, -0.1, -0.2),
        ] {
            assert!(Cube::direction(face, 0.5 * (s + 1.0), 0.5 * (t + 1.0)).distance(direction) < 1e-12);
        }
    }

    #[test]
    fn faces_show_the_map_and_hold_its_power_larger_or_smaller() {
        let truth = |d: DVec3| 1.0 + 0.8 * (5.0 * d.x).sin() * (4.0 * d.y).cos() + 0.5 * d.z;
        let map = map(128, truth);
        for size in [8, 64, 300] {
            let cube = Cube::new(&map, size).unwrap();
            let (mut power, mut sphere) = (0.0, 0.0);
            for (face, pixels) in cube.radiance.iter().enumerate() {
                for (i, pixel) in pixels.iter().enumerate() {
                    let step = |i: u32| (f64::from(i) + 0.5) / f64::from(size);
                    let to = Cube::direction(face, step(i as u32 % size), step(i as u32 / size));
                    let angle = 4.0 / f64::from(size * size) * to.length_squared().powf(-1.5);
                    power += angle * f64::from(pixel[0]);
                    sphere += angle;
                    let error = (f64::from(pixel[0]) - truth(to.normalize())).abs();
                    assert!(size == 8 || error < 0.02, "{size} {face} {i} {error}");
                }
            }
            let expected: f64 = (0..map.size.count())
                .map(|i| map.size.solid_angle(i / map.size.width()) * f64::from(map.radiance[i][0]))
                .sum();
            assert!((power / sphere / (expected / (4.0 * std::f64::consts::PI)) - 1.0).abs() < 3e-3);
        }
        assert!(Cube::new(&map, 0).is_err());
    }

    #[test]
    fn what_was_not_seen_is_told_and_does_not_darken_what_was() {
        let mut map = map(64, |_| 2.0);
        map.flags = (0..map.size.count())
            .map(|i| if i / map.size.width() < 32 { EnvironmentMap::UNSEEN } else { 0 })
            .collect();
        for (i, flag) in map.flags.iter().enumerate() {
            map.radiance[i] = if *flag == 0 { [2.0; 3] } else { [0.0; 3] };
        }
        let cube = Cube::new(&map, 16).unwrap();
        assert!(cube.flags[2].iter().all(|flag| *flag == EnvironmentMap::UNSEEN));
        for face in 0..6 {
            for (pixel, flag) in cube.radiance[face].iter().zip(&cube.flags[face]) {
                assert_eq!(*pixel, if flag & EnvironmentMap::UNSEEN != 0 { [0.0; 3] } else { [2.0; 3] });
            }
        }
        let folder = tempfile::tempdir().unwrap();
        cube.write(&folder.path().join("cube")).unwrap();
        assert_eq!(std::fs::read_dir(folder.path().join("cube")).unwrap().count(), 12);
    }
}
