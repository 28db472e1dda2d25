//! What of the sphere was photographed so far, in cells of a degree, and where to point next.

use std::f64::consts::{FRAC_PI_2, PI};
use std::path::Path;

use glam::{DQuat, DVec2, DVec3};
use rayon::prelude::*;

use crate::geometry::{LatLong, Lens, world_from_camera};
use crate::picture::Picture;
use crate::{Error, Result, file};

/// Rows of cells.
const ROWS: u32 = 180;
/// Directions that are thought of as the next lie no farther apart, degrees, and by no more than half of what a photograph shows.
const STEP_DEG: f64 = 10.0;
/// Of directions that show nearly as much new as the best one, the nearest is taken.
const NEARLY: f64 = 0.9;
/// Less than this part of what is wanted is not worth a photograph.
const REST: f64 = 0.001;
/// Pixels of the picture along a cell's side.
const SIDE: usize = 3;

const UNSEEN: [u8; 3] = [70, 70, 76];
const UNWANTED: [u8; 3] = [30, 30, 34];
const LAST: [u8; 3] = [255, 255, 255];
const NEXT: [u8; 3] = [255, 150, 0];

/// A direction as one points: `azimuth_rad` to the right of where an unturned camera looks (-z), `elevation_rad` above the horizon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pointing {
    /// To the right of -z, -π to π.
    pub azimuth_rad: f64,
    /// Above the horizon.
    pub elevation_rad: f64,
}

impl Pointing {
    /// Of a direction of any length in the world of environments.
    pub fn of(direction: DVec3) -> Self {
        let level = direction.x.hypot(direction.z);
        let azimuth_rad = if level > 0.0 { direction.x.atan2(-direction.z) } else { 0.0 };
        Self { azimuth_rad, elevation_rad: direction.y.atan2(level) }
    }

    /// A camera that points there, upright: its frame (y down, z forward) to the world.
    pub fn camera(self) -> DQuat {
        world_from_camera(
            DQuat::from_rotation_y(-self.azimuth_rad) * DQuat::from_rotation_x(self.elevation_rad),
        )
    }

    /// By how much to turn right and up from here to there, radians; left and down are negative.
    pub fn to(self, there: Self) -> (f64, f64) {
        let right = (there.azimuth_rad - self.azimuth_rad + PI).rem_euclid(2.0 * PI) - PI;
        (right, there.elevation_rad - self.elevation_rad)
    }
}

/// Where to point next, and why there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Next {
    /// The camera upright.
    pub pointing: Pointing,
    /// The part of the sphere that shows there for the first time.
    pub gain: f64,
    /// The part of that photograph that was seen already.
    pub overlap: f64,
}

/// What is wanted of the sphere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wanted {
    /// From this elevation, radians.
    pub lowest_rad: f64,
    /// To this one.
    pub highest_rad: f64,
    /// The part of the next photograph that shows what was seen already.
    pub overlap: f64,
}

/// All elevations, with an overlap of 30 %.
impl Default for Wanted {
    fn default() -> Self {
        Self { lowest_rad: -FRAC_PI_2, highest_rad: FRAC_PI_2, overlap: 0.3 }
    }
}

impl Wanted {
    /// Refuses what cannot be wanted.
    ///
    /// # Errors
    /// [`Error::Request`] where no elevation is wanted, or no photograph could overlap another as much as is wanted.
    pub fn require(&self) -> Result<()> {
        let Self { lowest_rad, highest_rad, overlap } = *self;
        let band = lowest_rad..=highest_rad;
        let is_on_sphere = lowest_rad >= -FRAC_PI_2 - 1e-9 && highest_rad <= FRAC_PI_2 + 1e-9;
        let has_cells =
            (0..ROWS).any(|row| band.contains(&(FRAC_PI_2 - (f64::from(row) + 0.5) * PI / f64::from(ROWS))));
        if is_on_sphere && has_cells && (0.0..0.95).contains(&overlap) {
            return Ok(());
        }
        Err(Error::request(
            format!(
                "elevations from {:.1} to {:.1} degrees with an overlap of {:.0} %",
                lowest_rad.to_degrees(),
                highest_rad.to_degrees(),
                100.0 * overlap
            ),
            "give elevations from -90 to 90 degrees, the lowest one at least a degree below the highest one, and an overlap below 95 %",
        ))
    }
}

#[derive(Clone, Copy)]
struct Cell {
    direction: DVec3,
    is_wanted: bool,
    seen: Option<[u8; 3]>,
}

/// The sphere in cells of a degree.
pub struct Coverage {
    size: LatLong,
    lens: Lens,
    wanted: Wanted,
    cells: Vec<Cell>,
    last: DQuat,
    /// How far from its axis a photograph shows anything.
    reach_rad: f64,
    /// Steps from pole to pole between directions that are thought of.
    steps: usize,
}

impl Coverage {
    /// Of photographs with this lens, nothing seen yet.
    ///
    /// # Errors
    /// What [`Wanted::require`] refuses.
    pub fn new(lens: Lens, wanted: Wanted) -> Result<Self> {
        wanted.require()?;
        let Wanted { lowest_rad, highest_rad, .. } = wanted;
        let size = LatLong::new(2 * ROWS, ROWS)?;
        let cell = |i: usize| {
            let (column, row) = (i % size.width(), i / size.width());
            let direction = size.direction(DVec2::new(column as f64, row as f64));
            let is_wanted = (lowest_rad..=highest_rad).contains(&size.latitude(row as f64));
            Cell { direction, is_wanted, seen: None }
        };
        let cells = (0..size.count()).map(cell).collect();
        let last = world_from_camera(DQuat::IDENTITY);
        let reach_rad = border(lens).map(|ray| ray.z.clamp(-1.0, 1.0).acos()).fold(0.0, f64::max);
        let (across, down) = (f64::from(lens.width) - 0.5, f64::from(lens.height) - 0.5);
        let angle = |from: DVec2, to: DVec2| {
            Some(lens.unproject(from)?.angle_between(lens.unproject(to)?)).filter(|angle| *angle > 0.0)
        };
        let middle = DVec2::new(across - 0.5, down - 0.5) / 2.0;
        let sides = [
            angle(DVec2::new(-0.5, middle.y), DVec2::new(across, middle.y)),
            angle(DVec2::new(middle.x, -0.5), DVec2::new(middle.x, down)),
        ];
        let shortest = sides.into_iter().flatten().fold(f64::INFINITY, f64::min).to_degrees();
        // Nothing is told apart that is smaller than a cell.
        let step_deg = (shortest / 2.0).clamp(180.0 / f64::from(ROWS), STEP_DEG);
        let steps = (180.0 / step_deg).ceil() as usize;
        Ok(Self { size, lens, wanted, cells, last, reach_rad, steps })
    }

    /// Adds a photograph, `turn` its camera frame (y down, z forward) to the world; tells the part of the sphere that it shows for the first time.
    pub fn add(&mut self, turn: DQuat, picture: &Picture) -> f64 {
        self.last = turn;
        let scale = |length: u32, lens: u32| f64::from(length) / f64::from(lens);
        let (x, y) = (scale(picture.width, self.lens.width), scale(picture.height, self.lens.height));
        let mut gained = 0.0;
        for i in self.shown(turn).collect::<Vec<_>>() {
            let Some(at) = self.lens.project(turn.inverse() * self.cells[i].direction) else { continue };
            let column = ((at.x + 0.5) * x).clamp(0.0, f64::from(picture.width) - 1.0) as usize;
            let row = ((at.y + 0.5) * y).clamp(0.0, f64::from(picture.height) - 1.0) as usize;
            let level = picture.levels[row * picture.width as usize + column];
            let shade = level.map(|level| (255.0 * f64::from(level) / f64::from(picture.white)) as u8);
            if self.cells[i].seen.replace(shade).is_none() {
                gained += self.angle(i);
            }
        }
        gained / (4.0 * PI)
    }

    /// The parts of the sphere, and of what is wanted of it, that were seen.
    pub fn seen(&self) -> (f64, f64) {
        let sum = |which: &dyn Fn(&Cell) -> bool| -> f64 {
            (0..self.cells.len()).filter(|&i| which(&self.cells[i])).map(|i| self.angle(i)).sum()
        };
        let wanted = sum(&|cell| cell.is_wanted);
        let seen = sum(&|cell| cell.seen.is_some());
        (seen / (4.0 * PI), sum(&|cell| cell.is_wanted && cell.seen.is_some()) / wanted)
    }

    /// Whether less than is worth a photograph is left of what is wanted.
    pub fn is_done(&self) -> bool {
        1.0 - self.seen().1 < REST
    }

    /// Where the camera last pointed.
    pub fn last(&self) -> Pointing {
        Pointing::of(self.last * DVec3::Z)
    }

    /// Where the next photograph, upright, shows most of what is wanted and was not seen, and as much that was as is wanted; if nowhere, where it
    /// overlaps most of those that show something new. `None` where what is left is not worth a photograph ([`Self::is_done`]), or shows in no upright one.
    pub fn next(&self) -> Option<Next> {
        if self.is_done() {
            return None;
        }
        let (reach, steps) = (self.reach_rad, self.steps);
        let step_rad = PI / steps as f64;
        let places = (0..=steps).flat_map(|i| {
            let is_pole = i == 0 || i == steps;
            (0..if is_pole { 1 } else { 2 * steps }).map(move |k| Pointing {
                azimuth_rad: k as f64 * step_rad - PI,
                elevation_rad: i as f64 * step_rad - FRAC_PI_2,
            })
        });
        let low = self.wanted.lowest_rad - reach;
        let high = self.wanted.highest_rad + reach;
        let places: Vec<Pointing> =
            places.filter(|place| (low..=high).contains(&place.elevation_rad)).collect();
        let thought = |&pointing: &Pointing| {
            let (mut new, mut seen, mut all) = (0.0, 0.0, 0.0);
            for i in self.shown(pointing.camera()) {
                let angle = self.angle(i);
                all += angle;
                match self.cells[i] {
                    Cell { seen: Some(_), .. } => seen += angle,
                    Cell { is_wanted: true, .. } => new += angle,
                    _ => {}
                }
            }
            Next { pointing, gain: new / (4.0 * PI), overlap: seen / all.max(f64::MIN_POSITIVE) }
        };
        let mut thought: Vec<Next> = places.par_iter().map(thought).filter(|next| next.gain > 0.0).collect();
        // Slivers only where nothing else is left.
        let most = thought.iter().map(|next| next.gain).fold(0.0, f64::max);
        thought.retain(|next| next.gain > (0.1 * REST).min(0.5 * most));
        let linked: Vec<&Next> = thought.iter().filter(|next| next.overlap >= self.wanted.overlap).collect();
        let best = linked.iter().map(|next| next.gain).fold(0.0, f64::max);
        let axis = self.last * DVec3::Z;
        let away = |next: &Next| axis.angle_between(next.pointing.camera() * DVec3::Z);
        let nearest = linked.into_iter().filter(|next| next.gain >= NEARLY * best);
        let nearest = nearest.min_by(|a, b| away(a).total_cmp(&away(b)));
        nearest.or_else(|| thought.iter().max_by(|a, b| a.overlap.total_cmp(&b.overlap))).copied()
    }

    /// Writes what was seen as a PNG, laid out as the map will be, with the outlines of the last photograph (white) and of the next (orange).
    ///
    /// # Errors
    /// [`Error::Io`] where the file cannot be written; what stood there then stays.
    pub fn write_png(&self, path: &Path, next: Option<&Next>) -> Result<()> {
        let (width, height) = (SIDE * self.size.width(), SIDE * self.size.height());
        let mut picture = image::RgbImage::from_fn(width as u32, height as u32, |x, y| {
            let cell = &self.cells[y as usize / SIDE * self.size.width() + x as usize / SIDE];
            image::Rgb(match cell {
                Cell { seen: Some(shade), .. } => *shade,
                Cell { is_wanted: true, .. } => UNSEEN,
                _ => UNWANTED,
            })
        });
        let whole = LatLong::new(width as u32, height as u32)?;
        let is_any = self.cells.iter().any(|cell| cell.seen.is_some());
        let outlines = [(is_any.then_some(self.last), LAST), (next.map(|next| next.pointing.camera()), NEXT)];
        for (turn, ink) in outlines.into_iter().filter_map(|(turn, ink)| Some((turn?, ink))) {
            for ray in border(self.lens) {
                let at = whole.pixel(turn * ray).round();
                for (i, k) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let column = (at.x as i64 + i).rem_euclid(width as i64);
                    let row = (at.y as i64 + k).clamp(0, height as i64 - 1);
                    picture.put_pixel(column as u32, row as u32, image::Rgb(ink));
                }
            }
        }
        let mut bytes = std::io::Cursor::new(vec![]);
        let written = picture.write_to(&mut bytes, image::ImageFormat::Png);
        written.map_err(|error| Error::io("write", path)(std::io::Error::other(error.to_string())))?;
        file::write_bytes(path, &bytes.into_inner())
    }

    /// The cells that a photograph shows.
    fn shown(&self, turn: DQuat) -> impl Iterator<Item = usize> {
        let (axis, back) = (turn * DVec3::Z, turn.inverse());
        let reach = self.reach_rad + 1e-3;
        let near = reach.cos();
        let middle = self.size.pixel(axis).y;
        let rows = reach / PI * self.size.height() as f64 + 1.0;
        let first = (middle - rows).max(0.0) as usize;
        let last = ((middle + rows).max(0.0) as usize).min(self.size.height() - 1);
        let (width, height) = (f64::from(self.lens.width), f64::from(self.lens.height));
        let cells = first * self.size.width()..(last + 1) * self.size.width();
        cells.filter(move |&i| {
            let direction = self.cells[i].direction;
            if direction.dot(axis) < near {
                return false;
            }
            let within =
                |at: DVec2| (-0.5..width - 0.5).contains(&at.x) && (-0.5..height - 0.5).contains(&at.y);
            self.lens.project(back * direction).is_some_and(within)
        })
    }

    fn angle(&self, cell: usize) -> f64 {
        self.size.solid_angle(cell / self.size.width())
    }
}

/// Directions (camera frame) along the edge of a photograph.
fn border(lens: Lens) -> impl Iterator<Item = DVec3> {
    const STEPS: u32 = 400;
    let (width, height) = (f64::from(lens.width), f64::from(lens.height));
    let corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)];
    (0..4 * STEPS).filter_map(move |i| {
        let (side, part) = ((i / STEPS) as usize, f64::from(i % STEPS) / f64::from(STEPS));
        let (from, to) = (corners[side], corners[(side + 1) % 4]);
        let at = DVec2::new(from.0, from.1).lerp(DVec2::new(to.0, to.1), part);
        lens.unproject(at - 0.5)
    })
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    use super::*;

    fn lens() -> Lens {
        Lens::pinhole(320, 240, 240.0)
    }

    fn picture() -> Picture {
        Picture { path: "".into(), width: 32, height: 24, levels: vec![[90, 100, 110]; 32 * 24], white: 255 }
    }

    /// The part of the sphere in a pyramid whose sides have these halves at the distance 1.
    fn pyramid(a: f64, b: f64) -> f64 {
        4.0 * (a * b / ((1.0 + a * a) * (1.0 + b * b)).sqrt()).asin() / (4.0 * PI)
    }

    #[test]
    fn a_photograph_shows_its_solid_angle_wherever_it_points_and_once() {
        let truth = pyramid(160.0 / 240.0, 120.0 / 240.0);
        let mut random = StdRng::seed_from_u64(2);
        for _ in 0..20 {
            let mut turn = || random.random_range(-3.0..3.0);
            let turn = DQuat::from_scaled_axis(DVec3::new(turn(), turn(), turn()));
            let mut coverage = Coverage::new(lens(), Wanted::default()).unwrap();
            let gained = coverage.add(turn, &picture());
            assert!((gained / truth - 1.0).abs() < 0.02, "{gained} {truth}");
            assert!((coverage.seen().0 - gained).abs() < 1e-12 && coverage.add(turn, &picture()) == 0.0);
        }
    }

    #[test]
    fn the_next_direction_overlaps_as_stated_and_no_other_that_does_shows_much_more() {
        let mut random = StdRng::seed_from_u64(3);
        let mut coverage = Coverage::new(lens(), Wanted::default()).unwrap();
        for _ in 0..6 {
            coverage.add(coverage.next().map_or(DQuat::IDENTITY, |next| next.pointing.camera()), &picture());
            let next = coverage.next().unwrap();
            assert!(next.overlap >= 0.3);
            for _ in 0..60 {
                let pointing = Pointing {
                    azimuth_rad: random.random_range(-PI..PI),
                    elevation_rad: random.random_range(-1.5..1.5),
                };
                let (mut seen, mut new, mut all) = (0.0, 0.0, 0.0);
                for i in coverage.shown(pointing.camera()) {
                    let angle = coverage.angle(i);
                    all += angle;
                    if coverage.cells[i].seen.is_some() { seen += angle } else { new += angle }
                }
                // Directions lie ten degrees apart, of 67 and 53, and one in ten is forgone for a shorter turn.
                assert!(seen / all < 0.3 || new / (4.0 * PI) < 1.35 * next.gain, "{pointing:?} {next:?}");
            }
            // Whoever turns as told points there.
            let (right, up) = coverage.last().to(next.pointing);
            let from = coverage.last();
            let there =
                Pointing { azimuth_rad: from.azimuth_rad + right, elevation_rad: from.elevation_rad + up };
            let apart = (there.camera() * DVec3::Z).angle_between(next.pointing.camera() * DVec3::Z);
            assert!(apart < 1e-6);
        }
    }

    #[test]
    fn who_follows_has_seen_everything_wanted_after_few_photographs() {
        for (wanted, fewest) in [
            (Wanted::default(), 1.0),
            (Wanted { lowest_rad: -0.5, highest_rad: 0.7, ..Wanted::default() }, 0.56),
        ] {
            let mut coverage = Coverage::new(lens(), wanted).unwrap();
            let mut count = 0;
            coverage.add(DQuat::IDENTITY, &picture());
            while let Some(next) = coverage.next() {
                assert!(coverage.add(next.pointing.camera(), &picture()) > 0.0, "after {count}");
                count += 1;
                assert!(count < 100);
            }
            println!("{count} photographs");
            assert!(coverage.seen().1 > 0.998, "{:?}", coverage.seen());
            // Each shows 0.7 of itself anew at best.
            let least = fewest / (0.7 * pyramid(160.0 / 240.0, 0.5));
            assert!(f64::from(count) < 2.2 * least, "{count} {least}");
        }
    }

    #[test]
    fn who_follows_with_a_long_lens_misses_nothing() {
        // 9 by 7 degrees: directions ten degrees apart would leave gaps.
        let wanted = Wanted { lowest_rad: -0.1, highest_rad: 0.1, overlap: 0.1 };
        let mut coverage = Coverage::new(Lens::pinhole(320, 240, 2000.0), wanted).unwrap();
        coverage.add(coverage.last, &picture());
        for count in 0.. {
            let Some(next) = coverage.next() else { break };
            assert!(count < 400 && coverage.add(next.pointing.camera(), &picture()) > 0.0, "after {count}");
        }
        assert!(coverage.is_done() && coverage.seen().1 > 0.998, "{:?}", coverage.seen());
    }

    #[test]
    fn right_is_clockwise_from_above_and_up_is_up() {
        let ahead = Pointing::of(DVec3::NEG_Z);
        let (right, up) = ahead.to(Pointing::of(DVec3::X));
        assert!((right - FRAC_PI_2).abs() < 1e-12 && up.abs() < 1e-12);
        let (_, up) = ahead.to(Pointing::of(DVec3::new(0.0, 1.0, -1.0)));
        assert!((up - PI / 4.0).abs() < 1e-12);
        // The short way round.
        let (right, _) = Pointing { azimuth_rad: 3.0, ..ahead }.to(Pointing { azimuth_rad: -3.0, ..ahead });
        assert!((right - (2.0 * PI - 6.0)).abs() < 1e-12);
    }

    #[test]
    fn the_picture_shows_what_was_seen_and_where_to_look() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("coverage.png");
        let mut coverage = Coverage::new(lens(), Wanted { lowest_rad: -0.7, ..Wanted::default() }).unwrap();
        coverage.add(Pointing::of(DVec3::Z).camera(), &picture());
        coverage.write_png(&path, coverage.next().as_ref()).unwrap();
        let made = image::open(&path).unwrap().to_rgb8();
        assert_eq!(made.dimensions(), (1080, 540));
        // The map's centre is +z.
        assert_eq!(made.get_pixel(540, 270).0, [90, 100, 110]);
        assert_eq!((made.get_pixel(5, 270).0, made.get_pixel(540, 530).0), (UNSEEN, UNWANTED));
        assert!(made.pixels().any(|pixel| pixel.0 == LAST) && made.pixels().any(|pixel| pixel.0 == NEXT));
    }

    #[test]
    fn what_cannot_be_wanted_is_refused() {
        for wanted in [
            Wanted { lowest_rad: 0.5, highest_rad: -0.5, ..Wanted::default() },
            Wanted { overlap: 1.0, ..Wanted::default() },
            // Between two rows of cells, and beyond the zenith.
            Wanted { lowest_rad: 0.0, highest_rad: 0.3f64.to_radians(), ..Wanted::default() },
            Wanted { lowest_rad: 95f64.to_radians(), highest_rad: 100f64.to_radians(), ..Wanted::default() },
            Wanted { lowest_rad: -2.0, ..Wanted::default() },
            Wanted { highest_rad: f64::INFINITY, ..Wanted::default() },
            Wanted { overlap: f64::NAN, ..Wanted::default() },
        ] {
            let message = Coverage::new(lens(), wanted).err().unwrap().to_string();
            assert!(message.contains("; "), "{message}");
        }
    }
}
