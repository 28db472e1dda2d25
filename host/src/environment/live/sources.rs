//! What says how the camera was turned, while it comes, grows and goes: the table and the tracker's records.

use std::path::Path;

use super::ended::{Ended, ended};
use super::files::{Line, by_time};
use super::table::{begun, name};
use super::views::Views;
use super::{Arrival, Live, MEMORY_S};
use crate::camera::folder::list;
use crate::environment::shots::is_tracked;
use crate::tracker::{Causal, Tail};
use crate::{Error, Result};

impl Live<'_> {
    /// Somebody else's table may come later; then it counts from the beginning.
    pub(super) fn find_table(&mut self, told: &mut Vec<Arrival>) {
        if self.ended.as_ref().is_some_and(|ended| !ended.frames.is_empty()) {
            return;
        }
        let Some(table) = begun(&self.folder).filter(|table| self.table.as_ref() != Some(table)) else {
            return;
        };
        if !self.known.is_empty() {
            let why = "has come: it says how the camera was turned, and all photographs are placed anew";
            told.push(Arrival { name: name(&table), place: Err(why.into()) });
            self.forget();
        }
        (self.table, self.ended) = (Some(table), None);
    }

    /// Records may come later, as long as nothing has a place without them.
    pub(super) fn find_tracker(&mut self, told: &mut Vec<Arrival>) {
        if self.tracker.is_some() || (self.table.is_some() && self.is_tracked != Some(true)) {
            return;
        }
        let [records, other] = ["tracker.jsonl", "tracker.csv"].map(|name| self.folder.join(name));
        if records.exists() && self.placed.is_empty() {
            let why = "has come: the tracker says how the camera was turned";
            told.push(Arrival { name: name(&records), place: Err(why.into()) });
            self.tracker = Some((Tail::new(&records, self.tracking.receiver), Causal::new(MEMORY_S)));
            self.forget();
        } else if records.exists() {
            let why = "it came when photographs had places without it; the next --live counts it";
            self.leave(records, why.into(), told);
        } else if other.exists() {
            let why = "it cannot be followed while it grows; --live takes a tracker.jsonl";
            self.leave(other, why.into(), told);
        }
    }

    /// All begins anew.
    fn forget(&mut self) {
        (self.first, self.coverage, self.views) = (None, None, Views::default());
        self.known.clear();
        self.refused.clear();
        self.waiting.clear();
        self.left.clear();
        self.placed.clear();
    }

    /// The photographs that there are, in the order in which they were taken; nothing is settled while the table is being written.
    pub(super) fn lines(&mut self, told: &mut Vec<Arrival>) -> Result<Vec<Line>> {
        let Some(table) = self.table.clone() else {
            return by_time(&self.folder, &self.known);
        };
        let there = list(&self.folder)?.0;
        if table.exists() && !self.sizes.is_whole(&table) {
            self.is_settled = false;
        } else {
            let wrong = self.read(&table).unwrap_or_else(|error| {
                self.is_settled = false;
                Some(self.before(&error))
            });
            match wrong {
                None => drop(self.left.remove(&table)),
                // A writer may have stopped anywhere.
                Some(wrong) if self.sizes.has_stayed(&table, 0) => self.leave(table.clone(), wrong, told),
                Some(_) => {}
            }
        }
        let Some(ended) = self.ended.take() else { return Ok(vec![]) };
        let faults = self.faults(&ended, &table)?;
        let listed = ended.files(&self.folder);
        for path in there {
            // Its line may be written after it.
            if !listed.contains(&path) && !self.known.contains(&path) {
                self.sizes.is_whole(&path);
                if self.sizes.has_stayed(&path, 1) {
                    self.leave(path, format!("{} does not list it", name(&table)), told);
                }
            }
        }
        for (file, why) in &ended.broken {
            self.leave(self.folder.join(file), why.clone(), told);
        }
        let is_tracked = self.is_tracked == Some(true);
        let mut lines = vec![];
        for (frame, fault) in ended.frames.iter().zip(faults) {
            let path = self.folder.join(&frame.file);
            match fault {
                Some(fault) => self.leave(path, fault, told),
                None => lines.push(Line::of(path, frame, is_tracked)),
            }
        }
        self.ended = Some(ended);
        Ok(lines)
    }

    /// Reads the table; tells what is wrong with it. Where it cannot be read, or lists nothing any more, what it said before counts.
    pub(super) fn read(&mut self, table: &Path) -> Result<Option<String>> {
        let now = ended(table)?;
        if now.frames.is_empty() && self.ended.as_ref().is_some_and(|last| !last.frames.is_empty()) {
            return Err(Error::input(table, "lists no photograph any more", "write its lines again"));
        }
        self.lens = now.lens.or(self.lens);
        let wrong = now.wrong.clone();
        self.ended = Some(now);
        Ok(wrong)
    }

    /// What is wrong with a table that cannot be read now.
    pub(super) fn before(&self, error: &Error) -> String {
        let last = self.ended.as_ref().map_or("", |_| "; what it said before counts");
        format!("{error}{last}")
    }

    /// Of each line of the table what is wrong with it. What says how the camera was turned, turns or times, is settled once a photograph has its place.
    pub(super) fn faults(&mut self, ended: &Ended, table: &Path) -> Result<Vec<Option<String>>> {
        let is_tracked = match self.is_tracked.filter(|_| !self.placed.is_empty()) {
            Some(is_tracked) => is_tracked,
            None => is_tracked(&ended.frames, table, &self.tracking)?,
        };
        if self.is_tracked.is_some_and(|before| before != is_tracked) {
            self.forget();
        }
        self.is_tracked = (!ended.frames.is_empty()).then_some(is_tracked);
        Ok(ended.faults(is_tracked, self.tracking.file.is_some(), table))
    }
}
