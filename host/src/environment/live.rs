//! A folder that fills with photographs while somebody turns: where each was pointed, and what the sphere shows by now.
//!
//! The folder's table says how the camera was turned, or when; without a table the tracker's records at the time when a photograph was written do, and
//! without a tracker its corners, beside those of earlier photographs. What is needed to make the map afterwards is written as `frames.csv`.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, UNIX_EPOCH};

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use super::align::between;
use super::coverage::{Coverage, Pointing, Wanted};
use super::features::{Corners, Gray};
use super::mosaic::{Options, lens_of};
use super::shots::{TABLES, Tracking, read_frames};
use super::tracked::{DELAY_SIGMA_S, STATED_DELAY_SIGMA_S};
use crate::camera::folder::list;
use crate::geometry::{Lens, world_from_camera};
use crate::picture::Picture;
use crate::tracker::{Causal, Tail};
use crate::{Error, Result, file};

/// The tracker's jitter is forgotten in so many seconds.
pub const MEMORY_S: f64 = 0.1;
/// A tracker that said nothing new for so long is not heard, seconds.
const SILENT_S: f64 = 0.25;
/// Records may come so much later than the photograph.
const PATIENCE: Duration = Duration::from_secs(1);
/// A file that cannot be read and has not grown for so long is no photograph.
const BROKEN: Duration = Duration::from_secs(3);
/// Pixels across for corners, and for a look.
const GRAY: u32 = 640;
const LOOK: u32 = 320;
/// Photographs that are compared with a new one: the last ones, how far apart they may point (standard deviation about each axis, radians), and then those
/// that know their own place best.
const BESIDE: usize = 6;
const APART_RAD: f64 = 0.3;
const AROUND: usize = 4;
/// Turns that were added up are no surer than this, radians.
const SUREST_RAD: f64 = 0.017;

/// A photograph that has come.
#[derive(Debug, Clone, PartialEq)]
pub struct Arrival {
    /// Its file's name.
    pub name: String,
    /// Where it was pointed, or why that is not known.
    pub place: std::result::Result<Place, String>,
}

/// Where a photograph was pointed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Camera frame (y down, z forward) to the world.
    pub turn: DQuat,
    /// How sure that is about each axis, radians, beside what all share and the filter's lag ([`Causal::lag_s2`]); `None` where the table does not say.
    pub sigma_rad: Option<f64>,
    /// The part of the sphere that it shows for the first time.
    pub gained: f64,
}

/// How photographs become a map, of which the lens counts, for the first of them.
type OptionsOf<'a> = dyn Fn(&Path) -> Result<Options> + 'a;

/// A folder that fills.
pub struct Live<'a> {
    folder: PathBuf,
    tracking: Tracking,
    options: Box<OptionsOf<'a>>,
    wanted: Wanted,
    /// What says which photographs there are, where somebody else writes it.
    table: Option<PathBuf>,
    /// The table's lens.
    lens: Option<Lens>,
    tracker: Option<(Tail, Causal)>,
    said: Option<DQuat>,
    /// Sizes of files when they were last looked at, and since when.
    sizes: BTreeMap<PathBuf, (u64, Instant)>,
    known: BTreeSet<PathBuf>,
    waiting: Vec<Waiting>,
    /// The first photograph's size, and its lens.
    first: Option<((u32, u32), Lens)>,
    coverage: Option<Coverage>,
    views: Vec<View>,
    placed: Vec<Row>,
}

/// A photograph whose place is not known yet.
struct Waiting {
    line: Line,
    small: Picture,
    corners: Option<(Gray, Corners)>,
    since: Instant,
    is_told: bool,
}

/// A photograph as the table, or the folder, has it.
struct Line {
    path: PathBuf,
    turn: Option<DQuat>,
    sigma_rad: Option<f64>,
    time_s: Option<f64>,
}

/// A photograph with its corners and its place.
struct View {
    gray: Gray,
    corners: Corners,
    turn: DQuat,
    sigma_rad: f64,
}

struct Row {
    path: PathBuf,
    turn: DQuat,
    sigma_rad: f64,
    time_s: Option<f64>,
}

/// What is to be done with a photograph.
enum Verdict {
    At(DQuat, Option<f64>),
    Later,
    Unknown(&'static str),
}

impl<'a> Live<'a> {
    /// Looks into a folder; `options`, of which the lens counts, may depend on the first photograph.
    ///
    /// # Errors
    /// [`Error::Io`] where the folder cannot be read, [`Error::Input`] for records that are no `tracker.jsonl`, or what [`Wanted::require`] refuses.
    pub fn open(
        folder: &Path,
        tracking: &Tracking,
        wanted: Wanted,
        options: impl Fn(&Path) -> Result<Options> + 'a,
    ) -> Result<Self> {
        wanted.require()?;
        list(folder)?;
        let table = TABLES.iter().map(|name| folder.join(name)).find(|table| table.exists());
        let beside = folder.join("tracker.jsonl");
        let records = tracking.file.clone().or_else(|| beside.exists().then_some(beside));
        if let Some(records) =
            records.as_ref().filter(|file| file.extension().is_none_or(|kind| kind != "jsonl"))
        {
            let remedy = "give the tracker.jsonl that a capture writes";
            return Err(Error::input(records, "cannot be followed while it grows", remedy));
        }
        let tracker = records.map(|records| (Tail::new(&records, tracking.receiver), Causal::new(MEMORY_S)));
        Ok(Self {
            folder: folder.into(),
            tracking: tracking.clone(),
            options: Box::new(options),
            wanted,
            table,
            lens: None,
            tracker,
            said: None,
            sizes: BTreeMap::new(),
            known: BTreeSet::new(),
            waiting: vec![],
            first: None,
            coverage: None,
            views: vec![],
            placed: vec![],
        })
    }

    /// What was seen so far; `None` before the first photograph.
    pub fn coverage(&self) -> Option<&Coverage> {
        self.coverage.as_ref()
    }

    /// What says how the camera is turned, in words.
    pub fn source(&self) -> &'static str {
        match (&self.table, &self.tracker) {
            (Some(_), Some(_)) => {
                "the table and the tracker's records; photographs that the table does not list are left out"
            }
            (Some(_), None) => "the table; photographs that it does not list are left out",
            (None, Some(_)) => "the tracker's records at the time when a photograph was written",
            (None, None) => "the photographs; the first one is taken to look straight ahead, level",
        }
    }

    /// The filter of the tracker's records, where there are any.
    pub fn filter(&self) -> Option<&Causal> {
        self.tracker.as_ref().map(|(_, filter)| filter)
    }

    /// Where the camera points now, by the tracker's last record.
    pub fn pointing(&self) -> Option<Pointing> {
        let (_, filter) = self.tracker.as_ref()?;
        let now = filter.at(filter.last_s()?)?;
        Some(Pointing::of(now.orientation * self.mount() * DVec3::Z))
    }

    /// How many photographs have a place.
    pub fn count(&self) -> usize {
        self.placed.len()
    }

    /// What has come since it was last asked. A photograph counts when it has not grown since the last time.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Input`] for a table or records that cannot be used, or a lens for another size of photographs.
    pub fn look(&mut self) -> Result<Vec<Arrival>> {
        self.hear()?;
        let mut told = vec![];
        for line in self.lines()? {
            if !self.known.contains(&line.path) && self.is_whole(&line.path)? {
                self.receive(line, &mut told)?;
            }
        }
        // One that has its place now may tell that of others.
        while self.place(&mut told) {}
        Ok(told)
    }

    /// Ends: writes `frames.csv` where somebody else has not written a table, and tells which photographs were left out.
    ///
    /// # Errors
    /// [`Error::Request`] where no photograph came, [`Error::Io`] where the table cannot be written.
    pub fn finish(mut self) -> Result<Vec<String>> {
        if self.placed.is_empty() {
            return Err(Error::input(
                &self.folder,
                "holds no photograph whose direction is known",
                "put photographs there while --live waits, with frames.csv, a tracker's records, or details that overlap",
            ));
        }
        let mut notes = vec![];
        let left: Vec<String> = self.waiting.iter().map(|waiting| name(&waiting.line.path)).collect();
        if !left.is_empty() {
            notes.push(format!("{}: direction not known, left out", left.join(", ")));
        }
        if let Some(table) = &self.table {
            let strange: Vec<String> = list(&self.folder)?
                .0
                .iter()
                .filter(|path| !self.known.contains(*path))
                .map(|p| name(p))
                .collect();
            if !strange.is_empty() {
                notes.push(format!("{} does not list {}: left out", name(table), strange.join(", ")));
            }
            return Ok(notes);
        }
        self.placed.sort_by(|a, b| {
            a.time_s.unwrap_or(0.0).total_cmp(&b.time_s.unwrap_or(0.0)).then_with(|| a.path.cmp(&b.path))
        });
        let is_timed = self.tracker.is_some();
        let mut csv = String::from(if is_timed { "file,time_s\n" } else { "file,qw,qx,qy,qz,sigma_deg\n" });
        for Row { path, turn, sigma_rad, time_s } in &self.placed {
            let name = name(path);
            let _ = match time_s.filter(|_| is_timed) {
                Some(time_s) => writeln!(csv, "{name},{time_s:.6}"),
                None => {
                    let q = *turn * world_from_camera(DQuat::IDENTITY).inverse();
                    let sigma_deg = sigma_rad.max(SUREST_RAD).to_degrees();
                    writeln!(csv, "{name},{:.9},{:.9},{:.9},{:.9},{sigma_deg:.3}", q.w, q.x, q.y, q.z)
                }
            };
        }
        file::write_bytes(&self.folder.join(TABLES[1]), csv.as_bytes())?;
        Ok(notes)
    }

    fn mount(&self) -> DQuat {
        world_from_camera(self.tracking.mount.unwrap_or(DQuat::IDENTITY))
    }

    /// Takes the tracker's new records.
    fn hear(&mut self) -> Result<()> {
        let Some((tail, filter)) = &mut self.tracker else { return Ok(()) };
        for (time_s, turn) in tail.take()? {
            // Who says exactly the same again is not alive: a tracker has noise.
            if self.said != Some(turn) {
                filter.push(time_s, turn);
                self.said = Some(turn);
            }
        }
        Ok(())
    }

    /// The photographs that there are, in the order in which they were taken.
    fn lines(&mut self) -> Result<Vec<Line>> {
        let Some(table) = self.table.clone() else {
            let mut lines = vec![];
            for path in list(&self.folder)?.0.into_iter().filter(|path| !self.known.contains(path)) {
                // Between two looks another program may take its file away again.
                let Ok(written) = std::fs::metadata(&path).and_then(|data| data.modified()) else { continue };
                let time_s = written.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
                lines.push(Line { path, turn: None, sigma_rad: None, time_s: Some(time_s) });
            }
            lines.sort_by(|a, b| {
                let time_s = |line: &Line| line.time_s.unwrap_or(0.0);
                time_s(a).total_cmp(&time_s(b)).then_with(|| a.path.cmp(&b.path))
            });
            return Ok(lines);
        };
        // While it grows it may end anywhere.
        if !self.is_whole(&table)? {
            return Ok(vec![]);
        }
        let (frames, lens) = read_frames(&table)?;
        self.lens = lens;
        let line = |frame: super::shots::Frame| Line {
            path: self.folder.join(&frame.file),
            turn: frame.orientation(),
            sigma_rad: frame.sigma_deg.map(f64::to_radians),
            time_s: frame.time_s,
        };
        Ok(frames.into_iter().map(line).collect())
    }

    /// Whether a file is there and has not grown since it was last looked at.
    fn is_whole(&mut self, path: &Path) -> Result<bool> {
        let Ok(size) = std::fs::metadata(path).map(|data| data.len()) else { return Ok(false) };
        let before = self.sizes.get(path).map(|(size, _)| *size);
        if before != Some(size) {
            self.sizes.insert(path.into(), (size, Instant::now()));
        }
        Ok(size > 0 && before == Some(size))
    }

    /// Reads a photograph; one that cannot be read yet comes again.
    fn receive(&mut self, line: Line, told: &mut Vec<Arrival>) -> Result<()> {
        let refused = |what: String| Arrival { name: name(&line.path), place: Err(what) };
        let picture = match Picture::read(&line.path) {
            Ok(picture) => picture,
            Err(error) => {
                if self.sizes.get(&line.path).is_some_and(|(_, since)| since.elapsed() > BROKEN) {
                    told.push(refused(format!("left out: {error}")));
                    self.known.insert(line.path);
                }
                return Ok(());
            }
        };
        let size = (picture.width, picture.height);
        let lens = match self.first {
            Some((first, _)) if first != size => {
                let what = format!(
                    "left out: it is {}x{} pixels, the first one {}x{}",
                    size.0, size.1, first.0, first.1
                );
                told.push(refused(what));
                self.known.insert(line.path);
                return Ok(());
            }
            Some((_, lens)) => lens,
            None => {
                let (lens, _) = lens_of(self.lens, &(self.options)(&line.path)?, &picture)?;
                self.coverage = Some(Coverage::new(lens, self.wanted)?);
                self.first = Some((size, lens));
                lens
            }
        };
        let white = f32::from(picture.white) * 3.0;
        let is_by_corners = self.table.is_none() && self.tracker.is_none();
        let corners = is_by_corners.then(|| {
            let level =
                |i: usize| picture.levels[i].iter().map(|&level| f32::from(level)).sum::<f32>() / white;
            let gray = Gray::new(&lens, level, GRAY);
            let corners = gray.corners();
            (gray, corners)
        });
        self.known.insert(line.path.clone());
        let small = smaller(&picture);
        self.waiting.push(Waiting { line, small, corners, since: Instant::now(), is_told: false });
        Ok(())
    }

    /// Gives those that wait their places, as far as these are known; whether that may tell those of others.
    fn place(&mut self, told: &mut Vec<Arrival>) -> bool {
        let mut is_again = false;
        for mut waiting in std::mem::take(&mut self.waiting) {
            match self.verdict(&waiting) {
                Verdict::At(turn, sigma_rad) => {
                    let gained =
                        self.coverage.as_mut().map_or(0.0, |coverage| coverage.add(turn, &waiting.small));
                    let place = Place { turn, sigma_rad, gained };
                    told.push(Arrival { name: name(&waiting.line.path), place: Ok(place) });
                    let sigma_rad = sigma_rad.unwrap_or(0.0);
                    let Line { path, time_s, .. } = waiting.line;
                    self.placed.push(Row { path, turn, sigma_rad, time_s });
                    if let Some((gray, corners)) = waiting.corners {
                        is_again = true;
                        self.views.push(View { gray, corners, turn, sigma_rad });
                    }
                }
                Verdict::Later => self.waiting.push(waiting),
                Verdict::Unknown(why) => {
                    if !std::mem::replace(&mut waiting.is_told, true) {
                        told.push(Arrival { name: name(&waiting.line.path), place: Err(why.into()) });
                    }
                    self.waiting.push(waiting);
                }
            }
        }
        is_again && !self.waiting.is_empty()
    }

    fn verdict(&self, waiting: &Waiting) -> Verdict {
        let Line { turn, sigma_rad, time_s, .. } = waiting.line;
        if let Some(turn) = turn {
            return Verdict::At(turn, sigma_rad);
        }
        if let Some((gray, corners)) = &waiting.corners {
            return match self.by_corners(gray, corners) {
                Some((turn, sigma_rad)) => Verdict::At(turn, Some(sigma_rad)),
                None => Verdict::Unknown(
                    "shows too little of what earlier photographs show; it counts once one between them has come",
                ),
            };
        }
        let (Some((_, filter)), Some(time_s)) = (&self.tracker, time_s) else {
            return Verdict::Unknown(
                "the table says neither how it was turned nor when, or there is no tracker: left out",
            );
        };
        let taken_s = time_s - self.tracking.delay_s.unwrap_or(0.0);
        if filter.last_s().is_none_or(|last_s| last_s < taken_s) && waiting.since.elapsed() < PATIENCE {
            return Verdict::Later;
        }
        let heard_s = filter.heard_s(taken_s).filter(|heard_s| taken_s - heard_s < SILENT_S);
        let Some((at, _)) = filter.at(taken_s).zip(heard_s).filter(|(at, _)| at.sigma_rad.is_finite()) else {
            return Verdict::Unknown(
                "the tracker said nothing, or always the same, when it was taken: left out",
            );
        };
        let late_s = if self.tracking.delay_s.is_some() { STATED_DELAY_SIGMA_S } else { DELAY_SIGMA_S };
        Verdict::At(at.orientation * self.mount(), Some(at.sigma_rad.hypot(at.rate.length() * late_s)))
    }

    /// How a photograph was turned, by what it shares with others.
    fn by_corners(&self, gray: &Gray, corners: &Corners) -> Option<(DQuat, f64)> {
        if self.views.is_empty() {
            return Some((world_from_camera(DQuat::IDENTITY), SUREST_RAD));
        }
        let beside = |view: &View, expected: (DQuat, f64)| {
            let pair = between([&view.gray, gray], [&view.corners, corners], [0, 1], expected)?;
            Some(((view.turn * pair.turn).normalize(), view.sigma_rad.hypot(pair.sigma_rad)))
        };
        let surest = |found: Vec<(DQuat, f64)>| found.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
        // The last ones first, then all in turn.
        let order: Vec<&View> = self.views.iter().rev().collect();
        let found = order.chunks(BESIDE).find_map(|some| {
            let found = some.par_iter().filter_map(|view| beside(view, (DQuat::IDENTITY, APART_RAD)));
            surest(found.collect())
        })?;
        // It may meet one that was there long ago, and is surer.
        let mut near: Vec<&View> = self
            .views
            .iter()
            .filter(|view| {
                view.sigma_rad < found.1 && (view.turn * DVec3::Z).angle_between(found.0 * DVec3::Z) < 0.7
            })
            .collect();
        near.sort_by(|a, b| a.sigma_rad.total_cmp(&b.sigma_rad));
        let again = near.into_iter().take(AROUND).filter_map(|view| {
            let doubt = view.sigma_rad.hypot(found.1).max(0.01);
            beside(view, ((view.turn.inverse() * found.0).normalize(), doubt))
        });
        surest(again.chain([found]).collect())
    }
}

/// A file's name, for messages.
fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Every so many pixels of a picture.
fn smaller(picture: &Picture) -> Picture {
    let by = picture.width.div_ceil(LOOK).max(1);
    let (width, height) = (picture.width.div_ceil(by), picture.height.div_ceil(by));
    let at = |i: u32| picture.levels[((i / width * by) * picture.width + i % width * by) as usize];
    let levels = (0..width * height).map(at).collect();
    Picture { path: picture.path.clone(), width, height, levels, white: picture.white }
}
