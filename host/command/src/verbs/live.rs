//! `rigel mosaic --live`: while one turns, what was seen and where to point next.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use glam::DVec3;
use rigel::capture::TrackerLog;
use rigel::environment::{Coverage, Live, MEMORY_S, Next, Place, Pointing, Shots, Tracking, Wanted};
use rigel::geometry::LatLong;
use rigel::rig::{Format, Output, Tracking as Receivers};
use rigel::view_file::Calibration;
use rigel::{Error, Result};

use crate::arguments::{Mosaic, Photographs};
use crate::bench::greet_named;
use crate::progress::{Line, interrupted, take_interrupt};
use crate::say::{count_of, say};
use crate::verbs::require_place;

/// How often the folder is looked into.
const LOOK: Duration = Duration::from_millis(150);
/// What came just before the end is waited for so long.
const REST: Duration = Duration::from_secs(2);
/// Records per second of a tracker with one receiver.
const USUAL_S: f64 = 1.0 / 60.0;

/// The picture of what was seen, beside the map.
fn picture_of(arguments: &Mosaic) -> PathBuf {
    let name = arguments.out.file_stem().unwrap_or_default().to_string_lossy();
    arguments.out.with_file_name(format!("{name}-coverage.png"))
}

/// Follows the folder until everything wanted was seen, or Ctrl-C: the photographs that have a place then.
pub(super) fn turn(arguments: &Mosaic, tracking: &Tracking, size: LatLong) -> Result<Shots> {
    let folder = &arguments.shots;
    if !folder.is_dir() {
        return Err(Error::input(
            folder,
            "is no folder that could fill",
            "name the folder in which photographs arrive",
        ));
    }
    let picture = picture_of(arguments);
    let place = |path: &Path| path.canonicalize().ok();
    if place(picture.parent().filter(|parent| *parent != Path::new("")).unwrap_or(Path::new(".")))
        == place(folder)
    {
        return Err(Error::input(
            &arguments.out,
            "would be taken for a photograph, as the folder is watched",
            "name a map in another folder",
        ));
    }
    require_place(&picture, arguments.force)?;
    let wanted = Wanted {
        lowest_rad: arguments.lowest_deg.to_radians(),
        highest_rad: arguments.highest_deg.to_radians(),
        overlap: arguments.overlap,
    };
    // Before a rig is bothered.
    wanted.require()?;
    let photographs = &arguments.photographs;
    require_lens(photographs, folder)?;
    let mut rig = arguments.rig.as_deref().map(greet_named).transpose()?;
    let mut log = None;
    if let Some((rig, _)) = &mut rig {
        let records = rig.records();
        let stations = arguments.receiver.unwrap_or(1);
        rig.track(Receivers { stations, format: Format::Binary, output: Output::Quaternion })?;
        log = Some(TrackerLog::start(records, folder)?);
    }
    let options = |first: &Path| photographs.options(first, size);
    let mut live = Live::open(folder, tracking, wanted, options)?;
    say!("orientations: {}", live.source());
    if let Some(filter) = live.filter() {
        say!(
            "tracker, live: no delay at an even speed; behind by {:.4} s² times the angular acceleration where the speed changes; jitter falls to {:.0} % \
             (memory {:.0} ms, {:.0} records per second){}",
            filter.lag_s2(USUAL_S),
            100.0 * filter.noise_factor(USUAL_S),
            1e3 * MEMORY_S,
            1.0 / USUAL_S,
            match (tracking.delay_s, tracking.mount) {
                (Some(_), Some(_)) => "",
                _ =>
                    "; without --delay and --mount the receiver is taken to sit straight and photographs to be as old as their files: the map's own adjustment knows better",
            }
        );
    }
    say!("waiting for photographs in {}; Ctrl-C ends the turning and begins the map", folder.display());
    let line = Line::new();
    let mut next: Option<Next> = None;
    let mut looked = Instant::now();
    let mut until = Instant::now() + REST;
    let mut is_shown = true;
    let ended = loop {
        // What came before that is still looked at.
        let is_ended = interrupted();
        let is_written = log.as_mut().map_or(Ok(()), TrackerLog::check);
        let arrivals = match is_written.and_then(|()| live.look()) {
            Ok(arrivals) => arrivals,
            Err(error) => break Err(error),
        };
        let has_news = !arrivals.is_empty();
        // After a table that came late all begins anew.
        if live.coverage().is_none() {
            next = None;
        }
        let last = arrivals.iter().rposition(|arrival| arrival.place.is_ok());
        for (i, arrival) in arrivals.into_iter().enumerate() {
            let words = match (arrival.place, live.coverage()) {
                (Ok(place), Some(coverage)) if Some(i) == last => {
                    next = coverage.next();
                    let written = coverage.write_png(&picture, next.as_ref());
                    if let Some(error) = written.as_ref().err().filter(|_| is_shown) {
                        line.aside(|| say!("note: {error}; the turning goes on without this picture"));
                    }
                    is_shown = written.is_ok();
                    format!("{}; {}", told(&place), ahead(coverage, next.as_ref()))
                }
                (Ok(place), _) => told(&place),
                (Err(why), _) => why,
            };
            line.aside(|| say!("{}: {words}", arrival.name));
        }
        if let (Some(now), Some(next)) = (live.pointing(), &next) {
            line.show(&format!("{}: {}", pointed(now), way(now, next)));
        }
        let is_whole = live.coverage().is_some_and(Coverage::is_done);
        let is_over = is_whole || is_ended;
        live.close(is_over);
        // Of many each look reads some.
        if has_news || !is_over {
            until = Instant::now() + REST;
        }
        if is_over && (live.is_settled() || looked > until) {
            break Ok(is_whole);
        }
        // What is due is looked at at even intervals.
        std::thread::sleep(LOOK.saturating_sub(looked.elapsed()));
        looked = Instant::now();
    };
    line.end();
    take_interrupt();
    let recorded = log.map(TrackerLog::finish).transpose();
    let (is_whole, recorded) = match ended.and_then(|is_whole| Ok((is_whole, recorded?))) {
        Ok(ended) => ended,
        Err(error) => {
            keep(live);
            return Err(error);
        }
    };
    if let Some(recorded) = recorded {
        say!("{} of the tracker", count_of(recorded as usize, "record"));
    }
    let seen = live.coverage().map_or((0.0, 0.0), Coverage::seen);
    let (shots, notes) = live.finish()?;
    for note in notes {
        say!("note: {note}");
    }
    say!(
        "{}: {} with {:.1} % of the sphere, {:.1} % of what is wanted; {}now the map",
        if is_whole { "everything wanted was seen" } else { "ended by Ctrl-C" },
        count_of(shots.shots.len(), "photograph"),
        100.0 * seen.0,
        100.0 * seen.1,
        if is_shown { format!("{} shows it; ", picture.display()) } else { String::new() }
    );
    Ok(shots)
}

/// Refuses before a rig is bothered what no photograph could be turned by.
fn require_lens(photographs: &Photographs, folder: &Path) -> Result<()> {
    let beside = match (&photographs.lens, photographs.fov_deg) {
        // Without the photographs' size, it is looked at with the first one.
        (Some(file), _) => {
            Some(Calibration::read(file, 0.0)?.lens(0, 0)).filter(|lens| lens.width > 0 && lens.height > 0)
        }
        (None, Some(fov_deg)) if (2.0..=170.0).contains(&fov_deg) => None,
        (None, Some(fov_deg)) => {
            return Err(Error::request(
                format!("--live with a field of view of {fov_deg} degrees"),
                "give the angle across the picture, from 2 to 170 degrees",
            ));
        }
        (None, None) => Some(Live::lens_in(folder).ok_or_else(|| {
            Error::request(
                "nothing tells the lens",
                "give --lens FILE, --fov DEGREES, or a frames.json with intrinsics",
            )
        })?),
    };
    beside.as_ref().map_or(Ok(()), Live::require)
}

/// What was found before something failed is not lost.
fn keep(live: Live) {
    if live.count() == 0 {
        return;
    }
    match live.finish() {
        Ok((shots, notes)) => {
            for note in notes {
                say!("note: {note}");
            }
            say!(
                "{} found a place, which the table says: without --live it becomes the map, with --live all are placed anew",
                count_of(shots.shots.len(), "photograph")
            );
        }
        Err(error) => say!("note: {error}"),
    }
}

/// Where a photograph was pointed.
fn told(place: &Place) -> String {
    let sigma = place.sigma_rad.map_or(String::new(), |sigma| format!(" ± {:.1}", sigma.to_degrees()));
    format!(
        "{}{sigma}, {:.1} % of the sphere new",
        pointed(Pointing::of(place.turn * DVec3::Z)),
        100.0 * place.gained
    )
}

/// What is seen by now, and where to go.
fn ahead(coverage: &Coverage, next: Option<&Next>) -> String {
    let (seen, wanted) = coverage.seen();
    format!(
        "{:.1} % seen, {:.1} % of what is wanted; {}",
        100.0 * seen,
        100.0 * wanted,
        next.map_or(
            if coverage.is_done() {
                "nothing is left"
            } else {
                "what is left shows in no upright photograph"
            }
            .into(),
            |next| format!(
                "next {}: {} ({:.1} % new, {:.0} % overlap)",
                pointed(next.pointing),
                way(coverage.last(), next),
                100.0 * next.gain,
                100.0 * next.overlap
            )
        )
    )
}

fn pointed(pointing: Pointing) -> String {
    // No minus before 0.
    let degrees = |angle: f64| angle.to_degrees().round() + 0.0;
    format!("azimuth {:.0}, elevation {:.0}", degrees(pointing.azimuth_rad), degrees(pointing.elevation_rad))
}

/// In words of somebody who turns.
fn way(from: Pointing, next: &Next) -> String {
    let (right, up) = from.to(next.pointing);
    let (right, up) = (right.to_degrees().round(), up.to_degrees().round());
    let side = if right < 0.0 { "left" } else { "right" };
    let height = if up < 0.0 { "down" } else { "up" };
    format!("turn {side} {:.0} degrees, {height} {:.0}", right.abs(), up.abs())
}
