//! Every word of the conversation, one table. Angles are thousandths of a degree (`mdeg`), whole numbers throughout.
//!
//! The order of the variants is the wire format: add at the end. `Hello` stays first, and [`Hello`] keeps beginning with
//! `version` and `schema`: that much is understood across versions (see [`crate::frame::identity`]).

use heapless::String;
use serde::{Deserialize, Serialize};

/// What the host says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request {
    /// Counts the host's requests; the same number again is the same request again.
    pub sequence: u16,
    /// What is asked for.
    pub command: Command,
}

/// What the rig can be asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Command {
    /// Opens a conversation: nothing else is obeyed before the versions and schemas agree.
    Hello {
        /// The host's [`crate::VERSION`].
        version: u16,
        /// The host's [`crate::SCHEMA`].
        schema: u32,
    },
    /// Find the zero of both axes and go there; told by `Arrived`.
    Home,
    /// Go to a position, both axes arriving together; told by `Arrived`.
    MoveTo {
        /// The surface's turn about its normal.
        pan_mdeg: i32,
        /// The surface's turn about the rig's horizontal axis.
        tilt_mdeg: i32,
    },
    /// Brake to a standstill; told by `Stopped`, with the sequence number of the move that it ends.
    Stop,
    /// Tell where you are.
    Status,
    /// Tell that you are there.
    Ping,
}

/// What the rig says: the reply to a request, or the end of what a request began.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Answer {
    /// The sequence number of the request that this belongs to.
    pub sequence: u16,
    /// What is said.
    pub reply: Reply,
}

/// What the rig can say.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reply {
    /// Who is there.
    Hello(Hello),
    /// The request is obeyed; its end is expected after this time, settling included.
    Accepted {
        /// Milliseconds from now.
        duration_ms: u32,
    },
    /// The request is not obeyed, and nothing has changed.
    Refused(Fault),
    /// Where the rig is.
    Status {
        /// What it is doing.
        state: State,
        /// Its pan.
        pan_mdeg: i32,
        /// Its tilt.
        tilt_mdeg: i32,
    },
    /// It is there.
    Pong,
    /// Event: the move (or the homing) of this sequence number has ended and the rig has settled.
    Arrived {
        /// Where.
        pan_mdeg: i32,
        /// Where.
        tilt_mdeg: i32,
    },
    /// Event: the move of this sequence number was ended early by `Stop`, and the rig has settled.
    Stopped {
        /// Where.
        pan_mdeg: i32,
        /// Where.
        tilt_mdeg: i32,
    },
}

/// Who is there.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// The rig's [`crate::VERSION`].
    pub version: u16,
    /// The rig's [`crate::SCHEMA`].
    pub schema: u32,
    /// The board's name.
    pub board: String<24>,
    /// What it can do.
    pub limits: Limits,
}

/// How far and how fast a rig can go; both axes share speed and acceleration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Smallest pan.
    pub pan_min_mdeg: i32,
    /// Largest pan.
    pub pan_max_mdeg: i32,
    /// Smallest tilt.
    pub tilt_min_mdeg: i32,
    /// Largest tilt.
    pub tilt_max_mdeg: i32,
    /// Largest speed of an axis, thousandths of a degree per second.
    pub speed_mdeg_s: u32,
    /// Acceleration and braking of an axis, thousandths of a degree per second squared.
    pub acceleration_mdeg_s2: u32,
    /// How long the rig swings after a move, milliseconds.
    pub settle_ms: u32,
}

/// What a rig is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum State {
    /// Standing, and does not know where: it was not homed since it was switched on.
    Lost,
    /// Standing still.
    Still,
    /// Moving.
    Moving,
    /// Swinging after a move.
    Settling,
}

/// Why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Fault {
    /// No `Hello` with the rig's own version and schema was heard since it was switched on.
    NoHello,
    /// The rig does not know where it is.
    NotHomed,
    /// The rig is moving or settling.
    Busy,
    /// The pan that was asked for is beyond a limit.
    PanOutside {
        /// What was asked for.
        asked_mdeg: i32,
        /// The limit.
        min_mdeg: i32,
        /// The limit.
        max_mdeg: i32,
    },
    /// The tilt that was asked for is beyond a limit.
    TiltOutside {
        /// What was asked for.
        asked_mdeg: i32,
        /// The limit.
        min_mdeg: i32,
        /// The limit.
        max_mdeg: i32,
    },
}
