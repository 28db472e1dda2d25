//! The time on the tracker's line. QEMU hands over byte by byte when its machine gets to it: a pause within a record says
//! something about the machine and nothing about the tracker. Bytes that come soon after each other are taken for a burst at the
//! line's speed.

use crate::tracker::BYTE_US;

/// Shorter than the pause between two records at 60 per second.
const SOON_US: u64 = 12_000;

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
    pub fn stamp_us(&mut self, now_us: u64, _after: u64) -> u64 {
        self.stamp_us = self.now_us(now_us);
        self.heard_us = now_us;
        self.stamp_us
    }

    /// The line's time at `now_us`.
    pub fn now_us(&self, now_us: u64) -> u64 {
        let soon = now_us < self.heard_us + SOON_US;
        if soon { (self.stamp_us + BYTE_US).min(now_us) } else { now_us }
    }

    /// When to look again for what is due at `due_us` of the line's time.
    pub fn wake_us(&self, due_us: u64, now_us: u64) -> u64 {
        due_us.max(now_us + 1_000)
    }
}
