//! A folder that fills with photographs while somebody turns: where each was pointed, and what the sphere shows by now.
//!
//! The folder's table says how the camera was turned, or when; without a table the tracker's records at the time when a photograph was written do, and
//! without a tracker its corners, beside those of earlier photographs. What is needed to make the map afterwards is written as `frames.csv`, which the
//! next session in the folder replaces.

mod files;
mod table;
mod views;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

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
use files::{Line, Sizes, by_time};
use table::{Ended, Row, begun, ended, faults, name, notes, table_in, words, write};
use views::{View, Views, smaller};

/// The tracker's jitter is forgotten in so many seconds.
pub const MEMORY_S: f64 = 0.1;
/// A tracker that said nothing new for so long is not heard, seconds.
const SILENT_S: f64 = 0.25;
/// Records may come so much later than the photograph.
const PATIENCE: Duration = Duration::from_secs(1);
/// A look that lasted so long comes to its end.
const ENOUGH: Duration = Duration::from_millis(500);
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
    /// The table's lens, and whether it leaves turns to the tracker, once it lists a photograph.
    lens: Option<Lens>,
    is_tracked: Option<bool>,
    tracker: Option<(Tail, Causal)>,
    said: Option<DQuat>,
    sizes: Sizes,
    /// Photographs that were read, or refused as they are.
    known: BTreeSet<PathBuf>,
    refused: BTreeSet<PathBuf>,
    waiting: Vec<Waiting>,
    /// Why photographs have no place, and what is wrong with the table.
    left: BTreeMap<PathBuf, String>,
    is_settled: bool,
    /// The first photograph's size and highest level, and its lens.
    first: Option<((u32, u32, u16), Lens)>,
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
            is_tracked: None,
            tracker,
            said: None,
            sizes: Sizes::default(),
            known: BTreeSet::new(),
            refused: BTreeSet::new(),
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

    /// What has come since it was last asked. A photograph counts when it has not grown since the last time; of many some wait for the next look.
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
        let started = Instant::now();
        for line in lines.into_iter().flatten().filter(|line| line.path.exists()) {
            let path = line.path.clone();
            let is_new = !self.known.contains(&path) && self.sizes.is_whole(&path);
            if is_new && started.elapsed() < ENOUGH {
                self.receive(line, &mut told)?;
            }
            self.is_settled &= self.known.contains(&path);
        }
        // One that was refused is read again once it has changed.
        let refused = self.refused.len();
        self.refused.retain(|path| self.sizes.is_whole(path) || !self.known.remove(path));
        self.is_settled &= self.refused.len() == refused;
        // One that has its place now may tell that of others.
        while self.place(&mut told) {
            if started.elapsed() > ENOUGH {
                self.is_settled = false;
                break;
            }
        }
        self.is_settled &= self.waiting.iter().all(|waiting| waiting.why.is_some());
        Ok(told)
    }

    /// Ends: gives the photographs that have a place, and tells which were left out and why. Writes `frames.csv` where nobody else has written a table, or
    /// `frames-live.csv` beside one that lists nothing.
    ///
    /// # Errors
    /// [`Error::Input`] where no photograph has a place, [`Error::Io`] where the table cannot be written, or what [`Shots::read_tracked`] refuses.
    pub fn finish(mut self) -> Result<(Shots, Vec<String>)> {
        let (there, gone): (Vec<Row>, Vec<Row>) =
            std::mem::take(&mut self.placed).into_iter().partition(|row| row.path.exists());
        self.placed = there;
        self.left.extend(gone.into_iter().map(|row| (row.path, "it is not there any more".into())));
        if self.placed.is_empty() {
            return Err(Error::input(
                &self.folder,
                "holds no photograph whose direction is known",
                "put photographs there while --live waits, with frames.csv, a tracker's records, or details that overlap",
            ));
        }
        let others = self.table.take().or_else(|| begun(&self.folder));
        let is_ours = others.is_none();
        let table =
            others.map_or_else(|| write(&self.folder, &mut self.placed, self.tracker.is_some()), Ok)?;
        if let Some(other) = table_in(&self.folder).filter(|other| is_ours && *other != table) {
            let why = format!(
                "is of no use: it lists no photograph, or cannot be read; {} says how the camera was turned",
                name(&table)
            );
            self.left.insert(other, why);
        }
        let Ended { frames, lens, wrong } = ended(&table)?;
        self.left.remove(&table);
        self.left.extend(wrong.map(|wrong| (table.clone(), wrong)));
        let faults = self.faults(&frames, &table)?;
        let placed: BTreeSet<PathBuf> = self.placed.iter().map(|row| row.path.clone()).collect();
        let listed: BTreeSet<PathBuf> = frames.iter().map(|frame| self.folder.join(&frame.file)).collect();
        let mut used = vec![];
        for (frame, fault) in frames.into_iter().zip(faults) {
            let path = self.folder.join(&frame.file);
            match fault {
                Some(fault) => drop(self.left.insert(path, fault)),
                None if placed.contains(&path) => {
                    self.left.remove(&path);
                    used.push(frame);
                }
                None => {}
            }
        }
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
        Ok((Shots::of((used, lens), &table, &self.tracking)?, notes(self.left)))
    }

    /// Somebody else's table may come later; then it counts from the beginning.
    fn find_table(&mut self, told: &mut Vec<Arrival>) {
        if self.table.is_some() {
            return;
        }
        self.table = begun(&self.folder);
        let Some(table) = self.table.as_ref().filter(|_| !self.known.is_empty()) else { return };
        let why = "has come: it says how the camera was turned, and all photographs are placed anew";
        told.push(Arrival { name: name(table), place: Err(why.into()) });
        (self.first, self.coverage, self.views) = (None, None, Views::default());
        self.known.clear();
        self.refused.clear();
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
            return by_time(&self.folder, &self.known).map(Some);
        };
        if !self.sizes.is_whole(&table) {
            return Ok(None);
        }
        let read = ended(&table);
        let wrong = match &read {
            Ok(ended) => ended.wrong.clone(),
            Err(error) => Some(error.to_string()),
        };
        match wrong {
            None => drop(self.left.remove(&table)),
            // A writer may have stopped anywhere.
            Some(wrong) if self.sizes.has_stayed(&table, 0) => self.leave(table.clone(), wrong, told),
            Some(_) => {}
        }
        let Ok(Ended { frames, lens, .. }) = read else { return Ok(None) };
        self.lens = lens;
        let listed: BTreeSet<PathBuf> = frames.iter().map(|frame| self.folder.join(&frame.file)).collect();
        for path in list(&self.folder)?.0 {
            // Its line may be written after it.
            if !listed.contains(&path) && !self.known.contains(&path) {
                self.sizes.is_whole(&path);
                if self.sizes.has_stayed(&path, 1) {
                    self.leave(path, format!("{} does not list it", name(&table)), told);
                }
            }
        }
        let faults = self.faults(&frames, &table)?;
        let is_tracked = self.is_tracked == Some(true);
        let mut lines = vec![];
        for (frame, fault) in frames.into_iter().zip(faults) {
            let path = self.folder.join(&frame.file);
            match fault {
                Some(fault) => self.leave(path, fault, told),
                None => lines.push(Line::of(path, &frame, is_tracked)),
            }
        }
        Ok(Some(lines))
    }

    /// Of each line of the table what is wrong with it; its first lines settle what it says.
    fn faults(&mut self, frames: &[Frame], table: &Path) -> Result<Vec<Option<String>>> {
        let is_tracked = match self.is_tracked {
            Some(is_tracked) => is_tracked,
            None => is_tracked(frames, table, &self.tracking)?,
        };
        self.is_tracked = (!frames.is_empty()).then_some(is_tracked);
        Ok(faults(frames, is_tracked, self.tracking.file.is_some(), table))
    }

    /// Tells what is wrong with a table, or why a photograph is left out as long as it is so.
    fn leave(&mut self, path: PathBuf, why: String, told: &mut Vec<Arrival>) {
        if self.left.get(&path) != Some(&why) {
            told.push(Arrival { name: name(&path), place: Err(words(&path, &why)) });
            self.left.insert(path, why);
        }
    }

    /// Leaves a photograph out as long as its file stays as it is.
    fn refuse(&mut self, path: PathBuf, why: String, told: &mut Vec<Arrival>) {
        self.left.remove(&path);
        self.known.insert(path.clone());
        self.refused.insert(path.clone());
        self.leave(path, why, told);
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
                // What is empty may be begun.
                if self.sizes.has_stayed(&line.path, 1) {
                    self.refuse(line.path, error.to_string(), told);
                } else {
                    self.left.insert(line.path, error.to_string());
                }
                return Ok(());
            }
        };
        self.left.remove(&line.path);
        let size = (picture.width, picture.height, picture.white);
        let lens = match self.first {
            Some((first, _)) if first != size => {
                let words = |(width, height, white)| format!("{width}x{height} pixels to level {white}");
                let why = format!("it is {}, the first one {}", words(size), words(first));
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
