//! A folder that fills with photographs while somebody turns: where each was pointed, and what the sphere shows by now.
//!
//! The folder's table says how the camera was turned, or when; without a table the tracker's records at the time when a photograph was written do, and
//! without a tracker its corners, beside those of earlier photographs. What is needed to make the map afterwards is written as `frames.csv`.

mod table;
mod views;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, UNIX_EPOCH};

use glam::{DQuat, DVec3};

use super::coverage::{Coverage, Pointing, Wanted};
use super::mosaic::{Options, lens_of};
use super::shots::{Frame, Shots, Tracking, is_tracked};
use super::tracked::{DELAY_SIGMA_S, STATED_DELAY_SIGMA_S};
use crate::camera::folder::list;
use crate::geometry::{Lens, world_from_camera};
use crate::picture::Picture;
use crate::tracker::{Causal, Tail};
use crate::{Error, Result};
use table::{Row, ended, name, table_in, write};
use views::{View, Views};

/// The tracker's jitter is forgotten in so many seconds.
pub const MEMORY_S: f64 = 0.1;
/// A tracker that said nothing new for so long is not heard, seconds.
const SILENT_S: f64 = 0.25;
/// Records may come so much later than the photograph.
const PATIENCE: Duration = Duration::from_secs(1);
/// A file that cannot be read and has not grown for so long is no photograph, or a table with a fault.
const BROKEN: Duration = Duration::from_secs(3);
/// Pixels across for a look.
const LOOK: u32 = 320;

/// A photograph that has come, or what is to be said of the table.
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
    /// Photographs that were read, or never will be.
    known: BTreeSet<PathBuf>,
    waiting: Vec<Waiting>,
    /// Why photographs have no place, and what is wrong with the table.
    left: BTreeMap<PathBuf, String>,
    is_settled: bool,
    /// The first photograph's size, and its lens.
    first: Option<((u32, u32), Lens)>,
    coverage: Option<Coverage>,
    views: Views,
    placed: Vec<Row>,
}

/// A photograph whose place is not known yet.
struct Waiting {
    line: Line,
    small: Picture,
    view: Option<View>,
    /// With so many it was compared in vain.
    compared: usize,
    since: Instant,
    why: Option<&'static str>,
}

/// A photograph as the table, or the folder, has it.
struct Line {
    path: PathBuf,
    turn: Option<DQuat>,
    sigma_rad: Option<f64>,
    time_s: Option<f64>,
}

impl<'a> Live<'a> {
    /// Looks into a folder; `options`, of which the lens counts, may depend on the first photograph.
    ///
    /// # Errors
    /// [`Error::Io`] where the folder cannot be read, [`Error::Input`] for records that are no `tracker.jsonl`, [`Error::Request`] where a tracker is described
    /// and there are none, or what [`Wanted::require`] refuses.
    pub fn open(
        folder: &Path,
        tracking: &Tracking,
        wanted: Wanted,
        options: impl Fn(&Path) -> Result<Options> + 'a,
    ) -> Result<Self> {
        wanted.require()?;
        list(folder)?;
        let beside = folder.join("tracker.jsonl");
        let records = tracking.file.clone().or_else(|| beside.exists().then_some(beside));
        if let Some(records) =
            records.as_ref().filter(|file| file.extension().is_none_or(|kind| kind != "jsonl"))
        {
            let remedy = "give the tracker.jsonl that a capture writes";
            return Err(Error::input(records, "cannot be followed while it grows", remedy));
        }
        if records.is_none() && *tracking != Tracking::default() {
            return Err(Error::request(
                format!("there is no tracker.jsonl in {}, so that no tracker is looked at", folder.display()),
                "name the tracker's records with --tracker, record them with --rig, or leave --receiver, --delay and --mount out",
            ));
        }
        let tracker = records.map(|records| (Tail::new(&records, tracking.receiver), Causal::new(MEMORY_S)));
        Ok(Self {
            folder: folder.into(),
            tracking: tracking.clone(),
            options: Box::new(options),
            wanted,
            table: table_in(folder),
            lens: None,
            tracker,
            said: None,
            sizes: BTreeMap::new(),
            known: BTreeSet::new(),
            waiting: vec![],
            left: BTreeMap::new(),
            is_settled: false,
            first: None,
            coverage: None,
            views: Views::default(),
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

    /// Whether all that had come when it was last asked was read, and has its place or will have it only when more has come.
    pub fn is_settled(&self) -> bool {
        self.is_settled
    }

    /// What has come since it was last asked. A photograph counts when it has not grown since the last time.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Input`] for records that cannot be used, a table with orientations although a tracker was described, or a lens for another
    /// size of photographs.
    pub fn look(&mut self) -> Result<Vec<Arrival>> {
        let mut told = vec![];
        self.find_table(&mut told);
        self.hear()?;
        let lines = self.lines(&mut told)?;
        self.is_settled = lines.is_some();
        for line in lines.into_iter().flatten().filter(|line| line.path.exists()) {
            let path = line.path.clone();
            if !self.known.contains(&path) && self.is_whole(&path) {
                self.receive(line, &mut told)?;
            }
            self.is_settled &= self.known.contains(&path);
        }
        // One that has its place now may tell that of others.
        while self.place(&mut told) {}
        self.is_settled &= self.waiting.iter().all(|waiting| waiting.why.is_some());
        Ok(told)
    }

    /// Ends: gives the photographs that have a place, and tells which were left out and why. Writes `frames.csv` where nobody else has written a table.
    ///
    /// # Errors
    /// [`Error::Input`] where no photograph has a place, [`Error::Io`] where the table cannot be written, or what [`Shots::read_tracked`] refuses.
    pub fn finish(mut self) -> Result<(Shots, Vec<String>)> {
        if self.placed.is_empty() {
            return Err(Error::input(
                &self.folder,
                "holds no photograph whose direction is known",
                "put photographs there while --live waits, with frames.csv, a tracker's records, or details that overlap",
            ));
        }
        let others = self.table.take().or_else(|| table_in(&self.folder));
        let is_ours = others.is_none();
        let table =
            others.map_or_else(|| write(&self.folder, &mut self.placed, self.tracker.is_some()), Ok)?;
        let ((mut frames, lens), _) = ended(&table)?;
        let placed: BTreeSet<PathBuf> = self.placed.iter().map(|row| row.path.clone()).collect();
        let path_of = |frame: &Frame| self.folder.join(&frame.file);
        let listed: BTreeSet<PathBuf> = frames.iter().map(path_of).collect();
        frames.retain(|frame| placed.contains(&path_of(frame)));
        let all =
            list(&self.folder)?.0.into_iter().chain(listed.iter().cloned()).chain(placed.iter().cloned());
        for path in all.filter(|path| !(placed.contains(path) && listed.contains(path))) {
            let why = if !is_ours && !listed.contains(&path) {
                format!("{} does not list it", name(&table))
            } else if !path.exists() {
                "it is not there".into()
            } else {
                "it came too late".into()
            };
            self.left.entry(path).or_insert(why);
        }
        let mut notes: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for (path, why) in self.left {
            let why = if path == table { why } else { format!("left out: {why}") };
            notes.entry(why).or_default().push(name(&path));
        }
        let notes = notes.into_iter().map(|(why, names)| format!("{}: {why}", names.join(", "))).collect();
        Ok((Shots::of((frames, lens), &table, &self.tracking)?, notes))
    }

    /// Somebody else's table may come later; then it counts from the beginning.
    fn find_table(&mut self, told: &mut Vec<Arrival>) {
        if self.table.is_some() {
            return;
        }
        self.table = table_in(&self.folder);
        let Some(table) = self.table.as_ref().filter(|_| !self.known.is_empty()) else { return };
        let why = "has come: it says how the camera was turned, and all photographs are placed anew";
        told.push(Arrival { name: name(table), place: Err(why.into()) });
        (self.first, self.coverage, self.views) = (None, None, Views::default());
        self.known.clear();
        self.waiting.clear();
        self.left.clear();
        self.placed.clear();
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

    /// The photographs that there are, in the order in which they were taken; `None` while the table is being written.
    fn lines(&mut self, told: &mut Vec<Arrival>) -> Result<Option<Vec<Line>>> {
        let Some(table) = self.table.clone() else {
            let mut lines = vec![];
            for path in list(&self.folder)?.0.into_iter().filter(|path| !self.known.contains(path)) {
                // Between two looks another program may take its file away again.
                let Ok(written) = fs::metadata(&path).and_then(|data| data.modified()) else { continue };
                let time_s = written.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
                lines.push(Line { path, turn: None, sigma_rad: None, time_s: Some(time_s) });
            }
            lines.sort_by(|a, b| {
                let time_s = |line: &Line| line.time_s.unwrap_or(0.0);
                time_s(a).total_cmp(&time_s(b)).then_with(|| a.path.cmp(&b.path))
            });
            return Ok(Some(lines));
        };
        if !self.is_whole(&table) {
            return Ok(None);
        }
        let read = ended(&table);
        let wrong = match &read {
            Ok((_, true)) => {
                Some("what follows its last line break is left out, as it may be half written".into())
            }
            Ok(_) => None,
            // A writer may have stopped anywhere.
            Err(error) => Some(error.to_string()),
        };
        match wrong {
            None => drop(self.left.remove(&table)),
            Some(wrong) if self.has_stayed(&table) && self.left.get(&table) != Some(&wrong) => {
                told.push(Arrival { name: name(&table), place: Err(wrong.clone()) });
                self.left.insert(table.clone(), wrong);
            }
            Some(_) => {}
        }
        let Ok(((frames, lens), _)) = read else { return Ok(None) };
        let is_tracked = is_tracked(&frames, &table, &self.tracking)?;
        self.lens = lens;
        let line = |frame: Frame| Line {
            path: self.folder.join(&frame.file),
            turn: frame.orientation().filter(|_| !is_tracked),
            sigma_rad: frame.sigma_deg.map(f64::to_radians),
            time_s: frame.time_s.filter(|_| is_tracked),
        };
        Ok(Some(frames.into_iter().map(line).collect()))
    }

    /// Whether a file is there and has not grown since it was last looked at.
    fn is_whole(&mut self, path: &Path) -> bool {
        let Ok(size) = fs::metadata(path).map(|data| data.len()) else { return false };
        let before = self.sizes.get(path).map(|(size, _)| *size);
        if before != Some(size) {
            self.sizes.insert(path.into(), (size, Instant::now()));
        }
        size > 0 && before == Some(size)
    }

    /// Whether a file has not grown for long.
    fn has_stayed(&self, path: &Path) -> bool {
        self.sizes.get(path).is_some_and(|(_, since)| since.elapsed() > BROKEN)
    }

    /// Leaves a photograph out.
    fn refuse(&mut self, path: PathBuf, why: String, told: &mut Vec<Arrival>) {
        told.push(Arrival { name: name(&path), place: Err(format!("left out: {why}")) });
        self.left.insert(path.clone(), why);
        self.known.insert(path);
    }

    /// Reads a photograph; one that cannot be read yet comes again.
    fn receive(&mut self, line: Line, told: &mut Vec<Arrival>) -> Result<()> {
        if line.path.file_name().is_none_or(|name| name.to_str().is_none()) {
            let why = "its name is no Unicode text, as a table must have it; give it another name";
            self.refuse(line.path, why.into(), told);
            return Ok(());
        }
        let picture = match Picture::read(&line.path) {
            Ok(picture) => picture,
            Err(error) => {
                if self.has_stayed(&line.path) {
                    self.refuse(line.path, error.to_string(), told);
                }
                return Ok(());
            }
        };
        let size = (picture.width, picture.height);
        let lens = match self.first {
            Some((first, _)) if first != size => {
                let why =
                    format!("it is {}x{} pixels, the first one {}x{}", size.0, size.1, first.0, first.1);
                self.refuse(line.path, why, told);
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
        let is_by_corners = self.table.is_none() && self.tracker.is_none();
        let view = is_by_corners.then(|| View::new(&lens, &picture));
        self.known.insert(line.path.clone());
        let small = smaller(&picture);
        self.waiting.push(Waiting { line, small, view, compared: 0, since: Instant::now(), why: None });
        Ok(())
    }

    /// Gives those that wait their places, as far as these are known; whether that may tell those of others.
    fn place(&mut self, told: &mut Vec<Arrival>) -> bool {
        let mut is_again = false;
        for mut waiting in std::mem::take(&mut self.waiting) {
            match self.verdict(&waiting) {
                Ok(Some((turn, sigma_rad))) => {
                    let gained =
                        self.coverage.as_mut().map_or(0.0, |coverage| coverage.add(turn, &waiting.small));
                    let place = Place { turn, sigma_rad, gained };
                    told.push(Arrival { name: name(&waiting.line.path), place: Ok(place) });
                    let sigma_rad = sigma_rad.unwrap_or(0.0);
                    let Line { path, time_s, .. } = waiting.line;
                    self.left.remove(&path);
                    self.placed.push(Row { path, turn, sigma_rad, time_s });
                    if let Some(view) = waiting.view {
                        is_again = true;
                        self.views.add(view, turn, sigma_rad);
                    }
                }
                Ok(None) => self.waiting.push(waiting),
                Err(why) => {
                    if waiting.why.replace(why) != Some(why) {
                        told.push(Arrival { name: name(&waiting.line.path), place: Err(why.into()) });
                        self.left.insert(waiting.line.path.clone(), why.into());
                    }
                    waiting.compared = self.views.count();
                    self.waiting.push(waiting);
                }
            }
        }
        is_again && !self.waiting.is_empty()
    }

    /// How a photograph was turned and how sure that is, if that is known, or why it is not; `None` where it has yet to be seen.
    fn verdict(&self, waiting: &Waiting) -> std::result::Result<Option<(DQuat, Option<f64>)>, &'static str> {
        let Line { turn, sigma_rad, time_s, .. } = waiting.line;
        if let Some(turn) = turn {
            return Ok(Some((turn, sigma_rad)));
        }
        if let Some(view) = &waiting.view {
            return match waiting.why.filter(|_| waiting.compared == self.views.count()) {
                Some(why) => Err(why),
                None => {
                    let (turn, sigma_rad) = self.views.turn_of(view, waiting.compared)?;
                    Ok(Some((turn, Some(sigma_rad))))
                }
            };
        }
        let (Some((_, filter)), Some(time_s)) = (&self.tracker, time_s) else {
            return Err("the table says neither how it was turned nor when, or there is no tracker");
        };
        let taken_s = time_s - self.tracking.delay_s.unwrap_or(0.0);
        if filter.last_s().is_none_or(|last_s| last_s < taken_s) && waiting.since.elapsed() < PATIENCE {
            return Ok(None);
        }
        let heard_s = filter.heard_s(taken_s).filter(|heard_s| taken_s - heard_s < SILENT_S);
        let Some((at, _)) = filter.at(taken_s).zip(heard_s).filter(|(at, _)| at.sigma_rad.is_finite()) else {
            return Err("the tracker said nothing, or always the same, when it was taken");
        };
        let late_s = if self.tracking.delay_s.is_some() { STATED_DELAY_SIGMA_S } else { DELAY_SIGMA_S };
        let sigma_rad = at.sigma_rad.hypot(at.rate.length() * late_s);
        Ok(Some((at.orientation * self.mount(), Some(sigma_rad))))
    }
}

/// Every so many pixels of a picture.
fn smaller(picture: &Picture) -> Picture {
    let by = picture.width.div_ceil(LOOK).max(1);
    let (width, height) = (picture.width.div_ceil(by), picture.height.div_ceil(by));
    let at = |i: u32| picture.levels[((i / width * by) * picture.width + i % width * by) as usize];
    let levels = (0..width * height).map(at).collect();
    Picture { path: picture.path.clone(), width, height, levels, white: picture.white }
}
