//! Where a rig is plugged in: the only thing that knows how a line is opened, and found again.

use std::io::{Read, Write};
use std::time::Duration;

/// Both directions of an open line. A read that finds nothing ends within a tenth of a second with
/// [`std::io::ErrorKind::TimedOut`]; so does a write that finds no room.
pub struct Ends {
    /// What the rig says.
    pub reader: Box<dyn Read + Send>,
    /// What the rig hears.
    pub writer: Box<dyn Write + Send>,
}

/// Where a rig is plugged in.
pub trait Place: Send {
    /// What people call it: the port's name. It can change when the line is opened again.
    fn name(&self) -> String;

    /// Opens the line; again after it was lost, wherever the rig has come back.
    ///
    /// # Errors
    /// Why it cannot be opened (now), in words.
    fn open(&mut self) -> Result<Ends, String>;
}

/// How long a rig is waited for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timing {
    /// How long the rig may take to answer before the request is said again.
    pub reply: Duration,
    /// How often a request is said before the rig is given up.
    pub attempts: u32,
    /// How long an unplugged rig may take to come back.
    pub return_time: Duration,
    /// The rig stops by itself when it hears nothing for so long while it moves; the host asks five times a second.
    pub dead_man: Duration,
}

impl Timing {
    /// How long a rig that is at work may be silent before it is asked: its word that it is done can be lost.
    pub(super) fn silence(&self) -> Duration {
        2 * self.reply
    }
}

impl Default for Timing {
    /// A tenth of a second, where a frame takes a few milliseconds; twenty times, which covers a board that starts; half a
    /// minute to push a plug back in; five seconds of silence.
    fn default() -> Self {
        Self {
            reply: Duration::from_millis(100),
            attempts: 20,
            return_time: Duration::from_secs(30),
            dead_man: Duration::from_secs(5),
        }
    }
}
