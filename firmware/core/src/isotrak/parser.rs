//! From bytes to records that can be believed.

use rigel_protocol::{Format, Record};

use super::continuity::{Continuity, Pair};
use super::{Layout, Rejected, checks};

/// A record's bytes follow each other, 87 microseconds each at 115 200 baud; a line may stall for so long within one. The
/// same byte of the next record comes later (60 records per second), so that halves of two are never joined.
const LONGEST_PAUSE_US: u64 = 10_000;
/// After so long without a byte, the time of 46, a binary record of the right length has ended.
const SILENCE_US: u64 = 4_000;
/// How many whole records in a row a line must deliver after a broken one before it is trusted again, about half a
/// second, where records hold their numbers once: lost and doubled bytes in one record can leave its length right.
const DOUBT: u8 = 32;

/// Reads a tracker's bytes and gives out records, each once it is certain to have ended where it should and to agree with
/// its neighbours.
///
/// A record that surprises, or has another status, waits for the next to bear it out. Where a layout does not say everything twice
/// the first record waits too, and whole records within half a second of a broken one are refused as
/// [`Rejected::Doubtful`]. Each station's records come in order; one that waited may come after the other station's.
pub struct Parser {
    layout: Layout,
    stations: u8,
    buffer: [u8; Layout::LONGEST],
    /// How many bytes the record has so far, those beyond the buffer included.
    length: usize,
    first_us: u64,
    last_us: u64,
    doubt: u8,
    skipped: u32,
    whole: u32,
    courses: [Continuity; 2],
}

/// What became of the records that a byte completed: at most two.
pub struct Verdicts(Pair);

impl Verdicts {
    const NONE: Self = Self([None, None]);
}

impl Iterator for Verdicts {
    type Item = Result<Record, Rejected>;

    fn next(&mut self) -> Option<Self::Item> {
        let [first, second] = &mut self.0;
        first.take().or_else(|| second.take())
    }
}

impl Parser {
    /// A parser at the beginning of a record, of one or two stations.
    pub const fn new(layout: Layout, stations: u8) -> Self {
        Self {
            layout,
            stations,
            buffer: [0; Layout::LONGEST],
            length: 0,
            first_us: 0,
            last_us: 0,
            doubt: 0,
            skipped: 0,
            whole: 0,
            courses: [Continuity::new(!layout.is_proven()), Continuity::new(!layout.is_proven())],
        }
    }

    /// Hears a byte that came at `at_us`; records are given with count 0.
    pub fn push(&mut self, byte: u8, at_us: u64) -> Verdicts {
        let mut verdicts = self.advance(at_us);
        if self.length > 0 && at_us.saturating_sub(self.last_us) > LONGEST_PAUSE_US {
            self.abandon();
        }
        match self.layout.format {
            Format::Ascii => {
                self.keep(byte, at_us);
                if byte == b'\n' {
                    verdicts = self.end();
                }
            }
            // Only a record's first byte has its highest bit set.
            Format::Binary if byte & 0x80 != 0 => {
                if self.length > 0 {
                    verdicts = self.end();
                }
                self.keep(byte & 0x7f, at_us);
            }
            Format::Binary if self.length > 0 => self.keep(byte, at_us),
            Format::Binary => self.skip(1),
        }
        self.last_us = at_us;
        verdicts
    }

    /// Ends a binary record that silence has completed.
    pub fn advance(&mut self, now_us: u64) -> Verdicts {
        match self.next_us() {
            Some(due_us) if due_us <= now_us => self.end(),
            _ => Verdicts::NONE,
        }
    }

    /// When [`Parser::advance`] wants to be called if no byte comes.
    pub fn next_us(&self) -> Option<u64> {
        let waits = self.layout.format == Format::Binary && self.length == self.layout.length();
        waits.then(|| self.last_us.saturating_add(SILENCE_US))
    }

    /// Nothing follows any more: refuses what still waits to be borne out.
    pub fn finish(&mut self) -> Verdicts {
        self.abandon();
        let [first, second] = &mut self.courses;
        Verdicts([first.end(), second.end()])
    }

    /// How many bytes belonged to no record of the right length.
    pub fn skipped_bytes(&self) -> u32 {
        self.skipped
    }

    /// How many records came that were records by themselves, whatever their neighbours said.
    pub fn whole_records(&self) -> u32 {
        self.whole
    }

    fn keep(&mut self, byte: u8, at_us: u64) {
        if self.length == 0 {
            self.first_us = at_us;
        }
        if let Some(place) = self.buffer.get_mut(self.length) {
            *place = byte;
        }
        self.length = self.length.saturating_add(1);
    }

    /// The bytes so far are all of a record, or of none.
    fn end(&mut self) -> Verdicts {
        let wire = match self.buffer.get(..self.layout.length()) {
            Some(wire) if wire.len() == self.length => wire,
            _ => {
                self.abandon();
                return Verdicts::NONE;
            }
        };
        self.length = 0;
        match checks::read(wire, self.layout, self.stations, self.first_us) {
            Err(rejected) => {
                self.doubt = DOUBT;
                Verdicts([Some(Err(rejected)), None])
            }
            Ok(record) => {
                self.whole = self.whole.saturating_add(1);
                let doubtful = self.doubt > 0;
                self.doubt = self.doubt.saturating_sub(1);
                let course = if record.station == 2 { &mut self.courses[1] } else { &mut self.courses[0] };
                let pair = course.judge(record, doubtful);
                Verdicts(pair.map(|verdict| match verdict {
                    Some(Ok(_)) if doubtful && !self.layout.is_proven() => Some(Err(Rejected::Doubtful)),
                    other => other,
                }))
            }
        }
    }

    fn abandon(&mut self) {
        self.skip(self.length);
        self.length = 0;
    }

    fn skip(&mut self, bytes: usize) {
        self.skipped = self.skipped.saturating_add(u32::try_from(bytes).unwrap_or(u32::MAX));
        self.doubt = DOUBT;
    }
}
