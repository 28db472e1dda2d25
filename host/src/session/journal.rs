//! The append-only journal of a session: one JSON object per line, flushed to the disk before the next step.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use crc::{CRC_32_ISO_HDLC, Crc};

use super::event::{Event, Exposed, Photograph};
use crate::{Error, Result, file};

/// What a line ends with after its event: `,"crc":"` and eight hexadecimal digits and `"}`.
const CHECK: (&str, &str) = (",\"crc\":\"", "\"}");
/// CRC-32 as of Ethernet.
const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// The journal, open for appending.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: Option<File>,
    events: Vec<Event>,
}

impl Journal {
    /// Reads the journal at `path`, which need not exist. A last line without its end was torn by a crash: its
    /// photograph is taken again.
    ///
    /// # Errors
    /// [`Error::Input`] when another line is damaged.
    pub fn open(path: &Path) -> Result<Self> {
        let bytes = match std::fs::read(path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => vec![],
            Err(error) => return Err(Error::io("read", path)(error)),
        };
        Ok(Self { path: path.into(), file: None, events: Self::parse(&bytes, path)?.0 })
    }

    /// The events of a journal's bytes, and how many of the bytes they are: the rest is a torn last line. `path` is named in
    /// errors.
    ///
    /// # Errors
    /// [`Error::Input`] when a whole line is damaged.
    pub fn parse(bytes: &[u8], path: &Path) -> Result<(Vec<Event>, usize)> {
        let whole = bytes.iter().rposition(|&byte| byte == b'\n').map_or(0, |end| end + 1);
        let events = bytes[..whole]
            .split_inclusive(|&byte| byte == b'\n')
            .enumerate()
            .map(|(index, line)| {
                read_line(line).map_err(|why| {
                    Error::input(
                        path,
                        format!("line {} is damaged ({why})", index + 1),
                        "restore the file from a copy, or remove that line and the `view_done` line of its view: `rigel capture --resume` then takes the photograph again",
                    )
                })
            })
            .collect::<Result<_>>()?;
        Ok((events, whole))
    }

    /// An event as it is written: its JSON object, with the CRC-32 of that in hexadecimal digits as the last field `crc`.
    pub fn line(event: &Event) -> String {
        let event = serde_json::to_string(event).expect("events are plain data");
        let open = event.strip_suffix('}').expect("an event is an object");
        format!("{open}{}{:08x}{}\n", CHECK.0, CRC.checksum(event.as_bytes()), CHECK.1)
    }

    /// Appends an event and waits until it is on the disk. After a failure the next one takes the place of what was torn.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be written.
    pub fn append(&mut self, event: Event) -> Result<()> {
        let line = Self::line(&event);
        if let Err(source) = self.append_line(&line) {
            // Opened anew, the journal loses what was torn.
            self.file = None;
            return Err(Error::io("write", &self.path)(source));
        }
        self.events.push(event);
        Ok(())
    }

    fn append_line(&mut self, line: &str) -> std::io::Result<()> {
        if self.file.is_none() {
            let is_new = !self.path.exists();
            let file = OpenOptions::new().create(true).read(true).append(true).open(&self.path)?;
            // Cut a torn last line, so that the next one does not join it.
            let text = std::fs::read(&self.path)?;
            let whole = text.iter().rposition(|&byte| byte == b'\n').map_or(0, |end| end + 1);
            if whole < text.len() {
                file.set_len(whole as u64)?;
            }
            if is_new {
                file::sync_folder_of(&self.path)?;
            }
            self.file = Some(file);
        }
        let file = self.file.as_mut().expect("opened above");
        file.write_all(line.as_bytes())?;
        file.sync_data()
    }

    /// All photographs, in order. Of a file that was taken again the last record counts, in place of the first.
    pub fn photographs(&self) -> impl Iterator<Item = &Photograph> {
        let mut photographs: Vec<&Photograph> = vec![];
        let (mut places, moved) = (HashMap::new(), self.moved());
        for (index, event) in self.events.iter().enumerate() {
            let Event::Photograph(photograph) = event else { continue };
            if index < moved.get(&photograph.view).copied().unwrap_or(0) {
                continue;
            }
            match places.entry(&photograph.file) {
                Entry::Occupied(place) => photographs[*place.get()] = photograph,
                Entry::Vacant(place) => {
                    place.insert(photographs.len());
                    photographs.push(photograph);
                }
            }
        }
        photographs.into_iter()
    }

    /// What was exposed and not collected since, in order.
    pub fn waiting(&self) -> Vec<&Exposed> {
        let (mut waiting, moved) = (BTreeMap::new(), self.moved());
        for (index, event) in self.events.iter().enumerate() {
            match event {
                Event::Exposed(exposed) if index < moved.get(&exposed.view).copied().unwrap_or(0) => {}
                Event::Exposed(exposed) => {
                    waiting.insert(exposed.stem.as_str(), (index, exposed));
                }
                Event::Photograph(photograph) => {
                    waiting.remove(stem(&photograph.file));
                }
                Event::Run(_) | Event::ViewDone { .. } | Event::ViewMoved { .. } | Event::Notice { .. } => {}
            }
        }
        let mut waiting: Vec<_> = waiting.into_values().collect();
        waiting.sort_by_key(|&(index, _)| index);
        waiting.into_iter().map(|(_, exposed)| exposed).collect()
    }

    /// Everything that it remembers, in order.
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// Whether all photographs of `view` were taken.
    pub fn is_done(&self, view: usize) -> bool {
        let counts_from = self.moved().get(&view).copied().unwrap_or(0);
        self.events[counts_from..]
            .iter()
            .any(|event| matches!(event, Event::ViewDone { view: done } if *done == view))
    }

    /// Where the rig has moved while a view was photographed, by view: what is before it does not count.
    fn moved(&self) -> HashMap<usize, usize> {
        let moved = |(index, event): (usize, &Event)| match event {
            Event::ViewMoved { view } => Some((*view, index)),
            _ => None,
        };
        self.events.iter().enumerate().filter_map(moved).collect()
    }
}

/// The event of a line, or what is wrong with it. What was written before lines had a checksum has none.
fn read_line(line: &[u8]) -> std::result::Result<Event, String> {
    let line = line.strip_suffix(b"\n").unwrap_or(line);
    let checked = line.strip_suffix(CHECK.1.as_bytes()).and_then(|line| {
        let (rest, told) = line.split_at_checked(line.len().checked_sub(8)?)?;
        Some((rest.strip_suffix(CHECK.0.as_bytes())?, told))
    });
    let parse = |event: &[u8]| serde_json::from_slice(event).map_err(|error| error.to_string());
    let Some((open, told)) = checked else { return parse(line) };
    let event = [open, b"}"].concat();
    let found = format!("{:08x}", CRC.checksum(&event));
    if found.as_bytes() != told {
        return Err(format!("its checksum is {found} and was {}", String::from_utf8_lossy(told)));
    }
    parse(&event)
}

/// A file's name without its extension; in the journal the separator is `/` on every system.
pub(super) fn stem(file: &str) -> &str {
    match file.rfind('.') {
        Some(dot) if !file[dot..].contains('/') => &file[..dot],
        _ => file,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_flipped_bit_is_an_error_with_its_line_or_a_torn_tail() {
        let path = Path::new("journal.jsonl");
        let photograph = Photograph {
            view: 12,
            file: "photographs/JJ*.png".into(),
            exposure_s: Some(0.011),
            ..Photograph::default()
        };
        let notice = Event::Notice { at: std::time::UNIX_EPOCH, text: "J \"quoted\", * and {}".into() };
        let events = [Event::Photograph(photograph), notice, Event::ViewDone { view: 12 }];
        let journal: String = events.iter().map(Journal::line).collect();
        assert_eq!(Journal::parse(journal.as_bytes(), path).unwrap(), (events.to_vec(), journal.len()));
        let mut line = 1;
        for at in 0..journal.len() {
            for bit in 0..8 {
                let mut damaged = journal.clone().into_bytes();
                damaged[at] ^= 1 << bit;
                match Journal::parse(&damaged, path) {
                    Ok((read, _)) => {
                        assert_eq!(at, journal.len() - 1, "bit {bit} of byte {at}");
                        assert_eq!(read, events[..2]);
                    }
                    Err(error) => {
                        let named = format!("line {line} is damaged");
                        assert!(error.to_string().contains(&named), "bit {bit} of byte {at}: {error}");
                    }
                }
            }
            line += usize::from(journal.as_bytes()[at] == b'\n');
        }
    }

    #[test]
    fn a_line_from_before_there_were_checksums_is_read() {
        let old = "{\"view_done\":{\"view\":3}}\n";
        let (events, _) = Journal::parse(old.as_bytes(), Path::new("journal.jsonl")).unwrap();
        assert_eq!(events, [Event::ViewDone { view: 3 }]);
        assert_eq!(Journal::line(&events[0]), "{\"view_done\":{\"view\":3},\"crc\":\"ebf050d7\"}\n");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_line_that_a_failed_write_tore_is_cut_by_the_next_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal.jsonl");
        let mut journal = Journal::open(&path).unwrap();
        journal.append(Event::ViewDone { view: 0 }).unwrap();
        // A disk that is full after a few bytes of the line.
        std::fs::write(&path, "{\"view_done\":{\"view\":0}}\n{\"view_d").unwrap();
        journal.file = Some(OpenOptions::new().write(true).open("/dev/full").unwrap());
        assert!(journal.append(Event::ViewDone { view: 1 }).is_err());
        journal.append(Event::ViewDone { view: 2 }).unwrap();
        let reopened = Journal::open(&path).unwrap();
        assert_eq!([0, 1, 2].map(|view| reopened.is_done(view)), [true, false, true]);
        assert_eq!(journal.events, reopened.events);
    }
}
