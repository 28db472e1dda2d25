//! The steps that bring a tracker from any state to sending records.

use rigel_protocol::{Format, Output, Tracking};

use super::{Layout, List};

/// What is sent, and what is then waited for.
pub(super) struct Step {
    pub(super) send: &'static [u8],
    pub(super) wait: Wait,
}

/// What a step waits for; every wait has an end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Wait {
    /// Nothing: the tracker has time to obey.
    Pause,
    /// That the line falls silent; what still comes is thrown away.
    Quiet,
    /// The status record: it begins with `2`.
    Status,
    /// Which receivers are active: `2`, station, `l`, one flag each.
    Stations,
    /// The first record.
    Record,
}

/// Time to obey a command.
pub(super) const PAUSE_US: u64 = 50_000;
/// A line that says nothing for so long has said everything.
pub(super) const QUIET_US: u64 = 100_000;
/// The end of every other wait.
pub(super) const LIMIT_US: u64 = 1_500_000;
/// Starts the tracker's own program again, and how long that takes.
pub(super) const REINITIALISE: &[u8] = b"\x19";
pub(super) const REINITIALISE_US: u64 = 20_000_000;

/// The step of this number; the last one waits for a record. The receivers are taken to start in front of the
/// transmitter (hemisphere of +x).
pub(super) fn step(number: u8, tracking: Tracking, layout: Layout) -> Step {
    let two = tracking.stations == 2;
    let pause = |send| Step { send, wait: Wait::Pause };
    match number {
        // Ctrl-Q, should the line have been suspended; the return ends a command that was half said.
        0 => pause(b"\x11\r"),
        1 => pause(b"c"),
        2 => Step { send: b"", wait: Wait::Quiet },
        3 => Step { send: b"S", wait: Wait::Status },
        4 => pause(if two { b"R1\rR2\r" } else { b"R1\r" }),
        5 => pause(if two { b"b1\rb2\r" } else { b"b1\r" }),
        6 => pause(b"u"),
        7 => pause(if two { b"H1,1,0,0\rH2,1,0,0\r" } else { b"H1,1,0,0\r" }),
        8 => pause(list(layout)),
        9 => pause(if two { b"l1,1\rl2,1\r" } else { b"l1,1\rl2,0\r" }),
        10 => Step { send: b"l1\r", wait: Wait::Stations },
        11 => pause(if layout.format == Format::Ascii { b"F" } else { b"f" }),
        12 => Step { send: b"", wait: Wait::Quiet },
        _ => Step { send: b"C", wait: Wait::Record },
    }
}

fn list(layout: Layout) -> &'static [u8] {
    match (layout.format, layout.output, layout.list) {
        (_, Output::Quaternion, List::Cosines) => b"O2,11,5,6,7,1\r",
        (_, Output::Euler, List::Cosines) => b"O2,4,5,6,7,1\r",
        (Format::Ascii, Output::Quaternion, List::Once) => b"O2,11,1\r",
        (Format::Ascii, Output::Quaternion, List::Twice) => b"O2,11,2,11,1\r",
        (Format::Ascii, Output::Euler, List::Once) => b"O2,4,1\r",
        (Format::Ascii, Output::Euler, List::Twice) => b"O2,4,2,4,1\r",
        // A binary record needs no end of line: its first byte is marked.
        (Format::Binary, Output::Quaternion, List::Once) => b"O2,11\r",
        (Format::Binary, Output::Quaternion, List::Twice) => b"O2,11,2,11\r",
        (Format::Binary, Output::Euler, List::Once) => b"O2,4\r",
        (Format::Binary, Output::Euler, List::Twice) => b"O2,4,2,4\r",
    }
}
