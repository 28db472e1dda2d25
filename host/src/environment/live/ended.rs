//! What a table says by now: its ended lines, one by one, and what is wrong with them.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use csv::{ByteRecord, StringRecord};

use super::table::name;
use crate::environment::shots::{Frame, read_frames};
use crate::geometry::Lens;
use crate::{Error, Result};

/// The ended lines of a table.
#[derive(Default)]
pub(super) struct Ended {
    /// Each photograph once.
    pub frames: Vec<Frame>,
    pub lens: Option<Lens>,
    /// Why lines cannot be used, by their photographs.
    pub broken: BTreeMap<PathBuf, String>,
    /// Lengths of quaternions: those that are no turns have another one than 1.
    lengths: BTreeMap<PathBuf, f64>,
    /// What is wrong with it as a whole.
    pub wrong: Option<String>,
}

/// A line of a table with the length of its quaternion, or why it cannot be used.
type Line = std::result::Result<(Frame, Option<f64>), String>;

/// Reads the ended lines of a table.
///
/// # Errors
/// [`Error::Io`], or [`Error::Input`] for what is no table.
pub(super) fn ended(table: &Path) -> Result<Ended> {
    let bytes = fs::read(table).map_err(Error::io("read", table))?;
    let (mut ended, mut wrong) = (Ended::default(), vec![]);
    let mut end = bytes.len();
    let lines: Vec<(PathBuf, Line)> = if table.extension().is_some_and(|kind| kind == "csv") {
        // Of what is half written not even the letters need be whole.
        end = bytes.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
        rows(table, &bytes[..end], &mut wrong)?
    } else {
        let text = std::str::from_utf8(&bytes);
        let text = text.map_err(|_| Error::input(table, "is no UTF-8 text", "write it as UTF-8"))?;
        let (frames, lens) = read_frames(table, text)?;
        ended.lens = lens;
        frames.into_iter().map(|frame| (frame.file.clone(), Ok((frame, None)))).collect()
    };
    let mut files = BTreeSet::new();
    for (file, line) in lines {
        if !files.insert(file.clone()) {
            wrong.push(format!("lists {} twice: its first line counts", file.display()));
            continue;
        }
        match line {
            Ok((frame, length)) => {
                ended.lengths.extend(length.map(|length| (file, length)));
                ended.frames.push(frame);
            }
            Err(why) => drop(ended.broken.insert(file, why)),
        }
    }
    if ended.frames.is_empty() {
        wrong.insert(0, "lists no photograph yet".into());
    }
    if end < bytes.len() {
        wrong.push("what follows its last line break is left out, as it may be half written".into());
    }
    ended.wrong = (!wrong.is_empty()).then(|| wrong.join("; "));
    Ok(ended)
}

/// The photographs of a table's lines; which lines name none goes to what is `wrong`.
fn rows(table: &Path, text: &[u8], wrong: &mut Vec<String>) -> Result<Vec<(PathBuf, Line)>> {
    let failed = |error: csv::Error| {
        let remedy = "give UTF-8 text whose first line names the columns, such as file,qw,qx,qy,qz";
        Error::input(table, format!("cannot be used ({error})"), remedy)
    };
    let mut csv = csv::ReaderBuilder::new().flexible(true).from_reader(text);
    let head = csv.headers().map_err(failed)?.clone();
    let column = head.iter().position(|word| word == "file");
    let (mut lines, mut nameless) = (vec![], vec![]);
    for line in csv.byte_records() {
        let line = line.map_err(failed)?;
        let at = line.position().map_or(0, csv::Position::line);
        let file = column.and_then(|column| std::str::from_utf8(line.get(column)?).ok());
        match file.filter(|file| !file.is_empty()).map(PathBuf::from) {
            Some(file) => {
                let what = |what| format!("{}, line {at}, has for it {what}", name(table));
                lines.push((file, row(&head, line).map_err(what)));
            }
            None => nameless.push(at.to_string()),
        }
    }
    if !nameless.is_empty() {
        wrong.push(format!("names no photograph in line {}", nameless.join(", ")));
    }
    Ok(lines)
}

/// A line below its head.
fn row(head: &StringRecord, line: ByteRecord) -> Line {
    let line = StringRecord::from_byte_record(line).map_err(|_| "what is no UTF-8 text")?;
    if line.len() != head.len() {
        let (fields, columns) = (line.len(), head.len());
        return Err(format!(
            "{fields} fields, of {columns} columns: give one for each, if only an empty one"
        ));
    }
    let frame = line.deserialize(Some(head)).map_err(|error| {
        let csv::ErrorKind::Deserialize { err, .. } = error.kind() else { return error.to_string() };
        let field = err.field().and_then(|field| usize::try_from(field).ok());
        let word = field.and_then(|field| Some((head.get(field)?, line.get(field)?)));
        word.map_or(err.to_string(), |(word, is)| format!("{word} = {is}: give a number, or leave it out"))
    })?;
    let number = |word| line.get(head.iter().position(|column| column == word)?)?.parse::<f64>().ok();
    let parts: Option<Vec<f64>> = ["qw", "qx", "qy", "qz"].into_iter().map(number).collect();
    Ok((frame, parts.map(|parts| parts.iter().map(|part| part * part).sum::<f64>().sqrt())))
}

impl Ended {
    /// All that it lists, in this folder.
    pub fn files(&self, folder: &Path) -> BTreeSet<PathBuf> {
        let files = self.frames.iter().map(|frame| &frame.file).chain(self.broken.keys());
        files.map(|file| folder.join(file)).collect()
    }

    /// Of each of its frames what is wrong with it, beside those before it; `is_tracked` by times, `has_records` where turns do not count.
    pub fn faults(&self, is_tracked: bool, has_records: bool, table: &Path) -> Vec<Option<String>> {
        let table = name(table);
        let mut last: Option<(f64, &Path)> = None;
        let fault = |frame| self.fault(frame, &mut last, (is_tracked, has_records), &table);
        self.frames.iter().map(fault).collect()
    }

    fn fault<'a>(
        &self,
        frame: &'a Frame,
        last: &mut Option<(f64, &'a Path)>,
        (is_tracked, has_records): (bool, bool),
        table: &str,
    ) -> Option<String> {
        if let Some(fault) = frame.fault() {
            return Some(format!("{table} has for it {fault}: give a positive number, or leave it out"));
        }
        let time_s = frame.time_s.filter(|time_s| is_tracked && time_s.is_finite());
        if let Some(length) = self.lengths.get(&frame.file)
            && time_s.is_none()
            && frame.orientation().is_none()
        {
            return Some(format!(
                "{table} has for it a quaternion of length {length:.3}: that of a turn has 1"
            ));
        }
        if is_tracked && !has_records && frame.orientation().is_some() {
            return Some(format!("{table} says how it was turned, of those before only when"));
        }
        let time_s = time_s?;
        if let Some((last_s, before)) = last.filter(|(last_s, _)| *last_s > time_s) {
            let (by_s, before) = (last_s - time_s, before.display());
            return Some(format!(
                "{table} has it at {time_s:.4} s, {by_s:.4} s earlier than {before} before it"
            ));
        }
        *last = Some((time_s, &frame.file));
        None
    }
}
