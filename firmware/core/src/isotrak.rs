//! The Polhemus Isotrak II: bytes in, records out, and the ladder that starts it.
//!
//! [`Parser`] reads records and doubts them: the format has no checksum. [`Driver`] starts the tracker, watches it and
//! starts it again. Whole numbers only; nothing here waits, allocates or panics.
//!
//! A record is the header `0`, the station, a status character and the numbers of the output list: position (code 2)
//! and a quaternion (code 11) or azimuth, elevation, roll (code 4). The driver asks for the list twice in one record
//! where the tracker obeys: two copies that differ are the only proof of damage that is smaller than the tracker's noise.
//! Where it does not, the direction cosines (codes 5, 6, 7) say the orientation a second time in other words.

mod ascii;
mod binary;
mod checks;
mod continuity;
mod cosines;
mod driver;
mod ladder;
mod parser;
#[cfg(test)]
mod tests;
mod turn;
mod watch;

pub use driver::{Driver, TrackerOutput};
pub use parser::{Parser, Verdicts};

use rigel_protocol::{Format, Output};

/// How a tracker was told to write its records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// In characters or in packed numbers.
    pub format: Format,
    /// How an orientation is said.
    pub output: Output,
    /// What else a record says.
    pub list: List,
}

/// What else than a position and an orientation a record says, so that damage shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum List {
    /// Nothing.
    Once,
    /// Both a second time.
    Twice,
    /// The orientation's direction cosines, column by column. In characters only: no source says how they are packed.
    Cosines,
}

impl Layout {
    /// The largest number of bytes of a record.
    pub const LONGEST: usize = 117;

    /// The number of bytes of a record on the line.
    pub const fn length(self) -> usize {
        match self.format {
            Format::Ascii => 3 + 7 * self.numbers() + 2,
            Format::Binary => {
                let plain = 3 + 2 * self.numbers();
                plain + plain.div_ceil(7)
            }
        }
    }

    /// Whether every number has a copy.
    const fn is_proven(self) -> bool {
        matches!(self.list, List::Twice)
    }

    /// The numbers of one copy: x, y, z and the orientation.
    const fn numbers_once(self) -> usize {
        match self.output {
            Output::Quaternion => 7,
            Output::Euler => 6,
        }
    }

    const fn numbers(self) -> usize {
        match self.list {
            List::Once => self.numbers_once(),
            List::Twice => 2 * self.numbers_once(),
            List::Cosines => self.numbers_once() + 9,
        }
    }
}

/// Why a record was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rejected {
    /// It does not begin with `0` and a station that was asked for.
    Header,
    /// A column holds what does not belong there.
    Column,
    /// Its two copies differ, or its orientation and the cosines of it.
    Copies,
    /// A position beyond the tracker's range, or an angle or component that cannot be.
    Range,
    /// Its quaternion is not of length one.
    Norm,
    /// It does not follow from the records before it, and those after it did not bear it out.
    Continuity,
    /// Its status character stood in this record alone.
    Status,
    /// It looks good, but the line has just damaged others: see [`Parser`].
    Doubtful,
}
