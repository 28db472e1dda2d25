//! What the surface's texture adds to what squares and commanded angles say of the poses, and whether it adds anything.

use glam::DVec2;

use super::adjust::{Adjusted, Frame, ViewData, adjust, adjust_from};
use super::median;
use super::register::settle;
use super::texture::{Candidate, FEWEST_PATCHES, Plate, Texture, Unplaced, align, place};
use crate::{Error, Result};

/// So many views make a texture that all have in common.
const FEWEST_VIEWS: usize = 3;
/// Squares are held out of views that show so many.
const SQUARES_TO_HOLD_OUT: usize = 3;
/// An adjustment that differs from another by these few squares has settled after so many rounds.
const SETTLED_BY: usize = 8;
/// Fewer held-out squares tell nothing.
const FEWEST_HELD_OUT: usize = 5;

/// What came of it.
pub(super) struct Refined {
    pub adjusted: Adjusted,
    /// What people should know, one sentence each.
    pub notes: Vec<String>,
}

/// A trial: the views that take part (indices of all), and what the texture says of them.
struct Trial<'a> {
    frame: Frame<'a>,
    all: Vec<usize>,
    views: Vec<ViewData>,
    state: Adjusted,
    unplaced: Vec<(usize, Unplaced)>,
}

/// Aligns the views by texture: those that are not `dropped`, and those that are but only because their squares are
/// `hidden`. Where that is of use, `frame`, `data` and `dropped` are then as the adjustment has them; else they are left as
/// they were.
///
/// # Errors
/// Those of [`settle`], but for [`Error::Request`]: poses that were good without texture are not lost by it.
pub(super) fn refine(
    texture: &Texture,
    frame: &mut Frame,
    data: &mut Vec<ViewData>,
    dropped: &mut Vec<Option<String>>,
    (plates, hidden): (&[Plate], &[usize]),
    before: Adjusted,
    name: &dyn Fn(usize) -> String,
) -> Result<Refined> {
    let has_squares = data.iter().any(|view| !view.squares.is_empty());
    let all: Vec<usize> =
        (0..data.len()).filter(|view| dropped[*view].is_none() || hidden.contains(view)).collect();
    let trial = match attempt(texture, frame, data, all, plates) {
        Ok(trial) => trial,
        Err(why) => {
            let notes = if has_squares { vec![] } else { vec![why] };
            return Ok(Refined { adjusted: before, notes });
        }
    };
    let mut with = data.clone();
    let mut still_dropped = dropped.clone();
    for (&view, found) in trial.all.iter().zip(&trial.views) {
        if hidden.contains(&view) && !found.points.is_empty() {
            still_dropped[view] = None;
        }
        with[view] = found.clone();
    }
    if !has_squares {
        for (view, _) in trial.unplaced.iter().filter(|(_, why)| *why == Unplaced::Unlike) {
            still_dropped[*view] = Some(
                "shows a texture, but not that of the others where its angles put it: its angles are not its own, or it shows something else"
                    .into(),
            );
        }
    } else if !is_better(&trial, still_dropped.iter().zip(dropped.iter()).any(|(now, then)| now != then)) {
        let lost: Vec<String> = (0..dropped.len())
            .filter(|view| dropped[*view].is_some() && still_dropped[*view].is_none())
            .map(name)
            .collect();
        let why = format!(
            "the texture would place {}, but does not foretell the other views' squares better than squares alone: left out",
            lost.join(", ")
        );
        return Ok(Refined { adjusted: before, notes: if lost.is_empty() { vec![] } else { vec![why] } });
    }
    let notes = if has_squares { vec![] } else { left_alone(&trial.unplaced, name) };
    match settle(&trial.frame, &with, &mut still_dropped, Some(trial.state)) {
        Ok(adjusted) => {
            (*frame, *data, *dropped) = (trial.frame, with, still_dropped);
            Ok(Refined { adjusted, notes })
        }
        Err(Error::Request { what, .. }) => {
            let where_else = if has_squares { "squares" } else { "commanded angles" };
            let why = format!(
                "the surface's texture does not align the views ({what}): they are where their {where_else} put them"
            );
            Ok(Refined { adjusted: before, notes: vec![why] })
        }
        Err(error) => Err(error),
    }
}

/// Looks for the texture in all views. Otherwise why it does not tell where they are.
fn attempt<'a>(
    texture: &Texture,
    frame: &Frame<'a>,
    data: &[ViewData],
    all: Vec<usize>,
    plates: &[Plate],
) -> std::result::Result<Trial<'a>, String> {
    let has_squares = data.iter().any(|view| !view.squares.is_empty());
    let mut frame = Frame { is_rig_s: !has_squares, ..frame.clone() };
    let mut views: Vec<ViewData> = all.iter().map(|&view| data[view].clone()).collect();
    let unsolved = || "the poses cannot be computed from the texture".to_owned();
    let mut state = adjust(&frame, &views).ok_or_else(unsolved)?;
    let (lens, rig) = (frame.lens(&state.shared), frame.rig(&state.shared));
    let candidate = |((&view, data), &deviation): ((&usize, &ViewData), _)| Candidate {
        plate: &plates[view],
        pan_rad: data.pan_rad,
        tilt_rad: data.tilt_rad,
        deviation,
        is_placed: !data.squares.is_empty(),
    };
    let mut candidates: Vec<Candidate> =
        all.iter().zip(&views).zip(&state.deviations).map(candidate).collect();
    let found = place(texture, &lens, &rig, &mut candidates);
    let mut unplaced: Vec<(usize, Unplaced)> =
        all.iter().zip(&found).filter_map(|(&view, why)| Some((view, (*why)?))).collect();
    let count = |which: Unplaced| unplaced.iter().filter(|(_, why)| *why == which).count();
    if candidates.len() - unplaced.len() < FEWEST_VIEWS.max(count(Unplaced::Unlike)) {
        let reasons = [
            (Unplaced::Even, "shows hardly any"),
            (Unplaced::Repeated, "is the same again a little further on"),
            (
                Unplaced::Unlike,
                "is not the same where their angles put it; check the table of angles, the distance and the lens",
            ),
        ];
        let usual = reasons.into_iter().max_by_key(|(which, _)| count(*which));
        let why = usual.map_or("", |(_, why)| why);
        return Err(format!("the surface's texture does not align the views: in most of them it {why}"));
    }
    let placed: Vec<bool> = candidates.iter().map(|view| view.is_placed).collect();
    for (deviation, candidate) in state.deviations.iter_mut().zip(&candidates) {
        *deviation = candidate.deviation;
    }
    let own: Vec<&Plate> = all.iter().map(|&view| &plates[view]).collect();
    let state =
        align(texture, &mut frame, &mut views, (&own, &placed), state, has_squares).ok_or_else(unsolved)?;
    for ((&view, found), is_placed) in all.iter().zip(&views).zip(&placed) {
        if *is_placed && found.points.len() < FEWEST_PATCHES {
            unplaced.push((view, Unplaced::Even));
        }
    }
    if views.iter().filter(|view| !view.points.is_empty()).count() < FEWEST_VIEWS {
        return Err(
            "the surface's texture does not align the views: too few patches of it are the same in several"
                .into(),
        );
    }
    Ok(Trial { frame, all, views, state, unplaced })
}

/// Leaves a square out of every view that has enough, and tells whether the texture foretells it better than the other
/// squares alone. Where there are too few, it is believed if it saves a view.
fn is_better(trial: &Trial, saves_a_view: bool) -> bool {
    let mut left = trial.views.clone();
    let mut held = vec![];
    for (index, view) in left.iter_mut().enumerate() {
        let count = view.squares.len();
        if count >= SQUARES_TO_HOLD_OUT {
            held.push((index, view.squares.remove(index % count)));
        }
    }
    if held.len() < FEWEST_HELD_OUT {
        return saves_a_view;
    }
    let off = |frame: &Frame, adjusted: &Adjusted| -> f64 {
        let lens = frame.lens(&adjusted.shared);
        let off = held.iter().filter_map(|(index, measured)| {
            let seen = adjusted.seen(frame, *index, &left[*index]);
            let corners = frame.corners(measured.square, &seen, &lens, 0.0, 0.0)?;
            let found = measured.corners.as_slice().chunks_exact(2).map(|at| DVec2::new(at[0], at[1]));
            Some((found.sum::<DVec2>() - corners.iter().sum::<DVec2>()).length() / 4.0)
        });
        median(&off.collect::<Vec<_>>())
    };
    let mut state = trial.state.clone();
    state.misfit = left.iter().map(|view| vec![[1.0; 2]; view.squares.len()]).collect();
    let Some(with) = adjust_from(&trial.frame, &left, state, SETTLED_BY) else { return false };
    let bare = Frame { points_m: vec![], ..trial.frame.clone() };
    let squares: Vec<ViewData> =
        left.iter().map(|view| ViewData { points: vec![], ..view.clone() }).collect();
    let Some(without) = adjust(&bare, &squares) else { return true };
    off(&trial.frame, &with) < off(&bare, &without)
}

/// What is to be said of the views that stay where their commanded angles put them.
fn left_alone(unplaced: &[(usize, Unplaced)], name: &dyn Fn(usize) -> String) -> Vec<String> {
    let reasons = [
        (Unplaced::Even, "too little texture is seen there"),
        (Unplaced::Repeated, "the texture there is the same again a little further on"),
    ];
    let note = |(which, why): (Unplaced, &str)| {
        let views: Vec<String> =
            unplaced.iter().filter(|(_, why)| *why == which).map(|(view, _)| name(*view)).collect();
        let s = if views.len() == 1 { "s" } else { "" };
        (!views.is_empty()).then(|| {
            format!("{} stay{s} where the commanded angles say, with a larger error: {why}", views.join(", "))
        })
    };
    reasons.into_iter().filter_map(note).collect()
}
