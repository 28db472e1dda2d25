//! The end: what becomes the map, and why the rest does not.

use std::collections::BTreeSet;
use std::path::PathBuf;

use super::Live;
use super::table::{Row, begun, name, notes, table_in, write};
use crate::camera::folder::list;
use crate::environment::shots::{Shots, Tracking};
use crate::{Error, Result};

impl Live<'_> {
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
        // The table of an earlier session is worth more.
        if is_ours && self.placed.len() < 2 {
            return Err(Error::input(
                &self.folder,
                format!(
                    "holds one photograph that has a place, {}, and no other that overlaps it",
                    self.placed[0].path.display()
                ),
                "take more between it and the others, and check the lens (--lens, --fov): a wrong one lets none fit",
            ));
        }
        if is_ours && self.is_deaf {
            // Records that cannot be read to their end place nothing: the turns that they told so far do.
            self.tracker = None;
            self.tracking = Tracking::default();
        }
        let table =
            others.map_or_else(|| write(&self.folder, &mut self.placed, self.tracker.is_some()), Ok)?;
        // One that gives the lens is of use.
        let is_vain = is_ours && self.lens.is_none();
        if let Some(other) = table_in(&self.folder).filter(|other| is_vain && *other != table) {
            let why = format!(
                "is of no use: it lists no photograph, or cannot be read; {} says how the camera was turned",
                name(&table)
            );
            self.left.insert(other, why);
        }
        let wrong = match self.read(&table) {
            Err(error) if self.ended.is_none() => return Err(error),
            read => read.unwrap_or_else(|error| Some(self.before(&error))),
        };
        let ended = self.ended.take().unwrap_or_default();
        self.left.remove(&table);
        self.left.extend(wrong.map(|wrong| (table.clone(), wrong)));
        let faults = self.faults(&ended, &table)?;
        let placed: BTreeSet<PathBuf> = self.placed.iter().map(|row| row.path.clone()).collect();
        let listed = ended.files(&self.folder);
        for (file, why) in ended.broken {
            self.left.insert(self.folder.join(file), why);
        }
        let mut used = vec![];
        for (frame, fault) in ended.frames.into_iter().zip(faults) {
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
            } else if self.known.contains(&path) {
                "its place was not known by the end".into()
            } else if self.sizes.was_there(&path) {
                "it was there, and had not been read by the end".into()
            } else {
                "it came too late".into()
            };
            self.left.entry(path).or_insert(why);
        }
        Ok((Shots::of((used, self.lens), &table, &self.tracking)?, notes(self.left)))
    }
}
