//! A folder that fills with photographs while somebody turns: where each was pointed, and what the sphere shows by now.
//!
//! The folder's table says how the camera was turned, or when; without a table the tracker's records at the time when a photograph was written do, and
//! without a tracker its corners, beside those of earlier photographs. What is needed to make the map afterwards is written as `frames.csv`, which the
//! next session in the folder replaces.

mod end;
mod ended;
mod files;
mod sources;
mod table;
mod views;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use glam::{DQuat, DVec3};

use super::coverage::{Coverage, Pointing, Wanted};
use super::mosaic::{Options, lens_of};
use super::shots::Tracking;
use super::tracked::{DELAY_SIGMA_S, STATED_DELAY_SIGMA_S};
use crate::camera::folder::list;
use crate::geometry::{Lens, world_from_camera};
use crate::picture::Picture;
use crate::tracker::{Causal, Tail};
use crate::{Error, Result};
use ended::Ended;
use files::{Line, Sizes};
use table::{Row, begun, lens_beside, name, table_in, words};
use views::{View, Views, smaller};

/// The tracker's jitter is forgotten in so many seconds.
pub const MEMORY_S: f64 = 0.1;
/// A tracker that said nothing new for so long is not heard, seconds.
const SILENT_S: f64 = 0.25;
/// Records may come so much later than the photograph.
const PATIENCE: Duration = Duration::from_secs(1);
/// A look that lasted so long comes to its end.
const ENOUGH: Duration = Duration::from_millis(500);
/// Nothing narrower is sure to show a cell of [`Coverage`] wherever it is pointed, degrees.
const NARROWEST_DEG: f64 = 2.0;

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
    /// What it said when it could last be read.
    ended: Option<Ended>,
    /// The table's lens, or that of a `frames.json` beside it.
    lens: Option<Lens>,
    /// Whether the table leaves turns to the tracker, once it lists a photograph.
    is_tracked: Option<bool>,
    tracker: Option<(Tail, Causal)>,
    /// Whether the tracker's records have come to what is none.
    is_deaf: bool,
    said: Option<DQuat>,
    sizes: Sizes,
    /// Photographs that were read, or refused as they are.
    known: BTreeSet<PathBuf>,
    refused: BTreeSet<PathBuf>,
    waiting: Vec<Waiting>,
    /// Why photographs have no place, and what is wrong with the table.
    left: BTreeMap<PathBuf, String>,
    is_settled: bool,
    is_closed: bool,
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
        let lens = lens_beside(folder);
        Ok(Self {
            folder: folder.into(),
            tracking: tracking.clone(),
            options: Box::new(options),
            wanted,
            // What gives only a lens is no table.
            table: begun(folder).or_else(|| table_in(folder).filter(|_| lens.is_none())),
            ended: None,
            lens,
            is_tracked: None,
            tracker,
            is_deaf: false,
            said: None,
            sizes: Sizes::default(),
            known: BTreeSet::new(),
            refused: BTreeSet::new(),
            waiting: vec![],
            left: BTreeMap::new(),
            is_settled: false,
            is_closed: false,
            first: None,
            coverage: None,
            views: Views::default(),
            placed: vec![],
        })
    }

    /// The lens that a folder tells by itself, in a `frames.json`.
    pub fn lens_in(folder: &Path) -> Option<Lens> {
        lens_beside(folder)
    }

    /// Refuses a lens that shows too little to find a way with.
    ///
    /// # Errors
    /// [`Error::Request`] for less than 2 degrees across or down.
    pub fn require(lens: &Lens) -> Result<()> {
        let side = |pixels: u32, focal: f64| 2.0 * (f64::from(pixels) / 2.0 / focal).atan().to_degrees();
        let (across, down) = (side(lens.width, lens.fx), side(lens.height, lens.fy));
        if across >= NARROWEST_DEG && down >= NARROWEST_DEG {
            return Ok(());
        }
        Err(Error::request(
            format!("a lens that sees {across:.2} by {down:.2} degrees shows too little to be led by"),
            format!("turn without --live, or take a lens that sees at least {NARROWEST_DEG} degrees"),
        ))
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

    /// Whether photographs are left out from now on that were not there when it was last asked: those that go on coming never settle.
    pub fn close(&mut self, is_closed: bool) {
        self.is_closed = is_closed;
    }

    /// What has come since it was last asked. A photograph counts when it has not grown since the last time; of many some wait for the next look.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Input`] for records that cannot be used, a table with orientations although a tracker was described, or a lens for another
    /// size of photographs or one that [`Self::require`] refuses.
    pub fn look(&mut self) -> Result<Vec<Arrival>> {
        let mut told = vec![];
        self.find_table(&mut told);
        self.find_tracker(&mut told);
        self.hear()?;
        self.is_settled = true;
        let lines = self.lines(&mut told)?;
        let started = Instant::now();
        for line in lines.into_iter().filter(|line| line.path.exists()) {
            let path = line.path.clone();
            if self.is_closed && !self.sizes.was_there(&path) {
                continue;
            }
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

    fn mount(&self) -> DQuat {
        world_from_camera(self.tracking.mount.unwrap_or(DQuat::IDENTITY))
    }

    /// Takes the tracker's new records.
    fn hear(&mut self) -> Result<()> {
        let Some((tail, filter)) = &mut self.tracker else { return Ok(()) };
        for (time_s, turn) in tail.take().inspect_err(|_| self.is_deaf = true)? {
            // Who says exactly the same again is not alive: a tracker has noise.
            if self.said != Some(turn) {
                filter.push(time_s, turn);
                self.said = Some(turn);
            }
        }
        Ok(())
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
                Self::require(&lens)?;
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
