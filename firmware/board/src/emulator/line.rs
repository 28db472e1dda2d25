//! The time on the tracker's line. QEMU hands over byte by byte when its machine gets to it: a pause within a record says
//! something about the machine and nothing about the tracker. The bytes of a record are taken to follow each other at the line's
//! speed, from the first, which is marked in binary records.

use crate::tracker::BYTE_US;

/// A line that is silent for longer than any machine is busy.
const SILENT_US: u64 = 200_000;

/// Stamps bytes.
pub struct Line {
    heard_us: u64,
    stamp_us: u64,
}

impl Line {
    /// A line that was never heard.
    pub const fn new() -> Self {
        Self { heard_us: 0, stamp_us: 0 }
    }

    /// The stamp of a byte that was read at `now_us`.
    pub fn stamp_us(&mut self, byte: u8, now_us: u64, _after: u64) -> u64 {
        let marked = byte & 0x80 != 0;
        self.stamp_us = if marked { now_us } else { self.now_us(now_us) };
        self.heard_us = now_us;
        self.stamp_us
    }

    /// The line's time at `now_us`.
    pub fn now_us(&self, now_us: u64) -> u64 {
        let busy = now_us < self.heard_us + SILENT_US;
        if busy { (self.stamp_us + BYTE_US).min(now_us) } else { now_us }
    }

    /// When to look again for what is due at `due_us` of the line's time.
    pub fn wake_us(&self, due_us: u64, now_us: u64) -> u64 {
        due_us.max(now_us + 1_000)
    }
}
