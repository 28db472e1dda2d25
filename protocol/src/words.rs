//! Every word of the conversation, one table. Angles are thousandths of a degree (`mdeg`), times microseconds (`us`) or
//! milliseconds (`ms`), whole numbers throughout. The rig's clock counts microseconds since it was switched on.
//!
//! The order of the variants is the wire format: add at the end. `Hello` stays first, and [`Hello`] keeps beginning with
//! `version` and `schema`: that much is understood across versions (see [`crate::frame::identity`]).

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

/// The largest number of photographs of one [`Command::Trigger`].
pub const LONGEST_BRACKET: usize = 12;

/// What the host says.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request {
    /// Counts the host's requests from 1 in every conversation, 0 follows 65535; the same number again is the same
    /// request again, an older one is too late.
    pub sequence: u16,
    /// What is asked for.
    pub command: Command,
}

/// What the rig can be asked for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Command {
    /// Opens a conversation: nothing else is obeyed before the versions and schemas agree.
    Hello {
        /// The host's [`crate::VERSION`].
        version: u16,
        /// The host's [`crate::SCHEMA`].
        schema: u32,
        /// Drawn anew by every host that opens a conversation; the same number again is the same conversation.
        conversation: u32,
    },
    /// Find the switches of both axes, then go to pan 0, tilt 0; told by `Arrived`.
    Home,
    /// Go to a position, both axes arriving together; told by `Arrived`.
    MoveTo {
        /// The surface's turn about its normal.
        pan_mdeg: i32,
        /// The surface's turn about the rig's horizontal axis.
        tilt_mdeg: i32,
    },
    /// Brake to a standstill and end a bracket; told by `Stopped`, with the sequence number of what it ends.
    Stop,
    /// Tell where you are and what has happened: everything that an event says can be asked for.
    Status,
    /// Tell the time.
    Ping,
    /// Photograph a bracket; each photograph is told by `Exposed`, the end by `Triggered`.
    Trigger(Bracket),
    /// Start the tracker anew and forward its records; told by `Tracker` when they come.
    Track(Tracking),
    /// Tell how the tracker is.
    Tracker,
    /// Stop the motors, and say why, when the host says nothing for so long while something moves.
    DeadMan {
        /// Milliseconds; 0 for never.
        silence_ms: u32,
    },
}

/// Photographs in a row.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bracket {
    /// How long the half-press (focus, wake-up) is held before the first photograph; 0 for none.
    pub half_press_ms: u16,
    /// How long each photograph's contact is closed: the exposure time in bulb mode, else the length of a pulse.
    pub pulses_us: Vec<u32, LONGEST_BRACKET>,
    /// From the end of one contact to the start of the next, and after the last to the end of the bracket.
    pub pause_ms: u16,
    /// How long after its contact closed a photograph's flash-sync may come; 0 where no flash-sync is wired.
    pub confirm_ms: u16,
}

/// What the tracker is to send.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tracking {
    /// How many receivers: 1 or 2; 0 switches the tracker's records off.
    pub stations: u8,
    /// How its records are written.
    pub format: Format,
    /// How they say an orientation.
    pub output: Output,
}

/// How a tracker writes its records.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Format {
    /// Columns of seven characters.
    Ascii,
    /// Sixteen-bit numbers, seven bits to the byte.
    Binary,
}

/// How a tracker says an orientation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Output {
    /// w, x, y, z.
    Quaternion,
    /// Azimuth, elevation, roll.
    Euler,
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
    /// Where the rig is and what has happened.
    Status(Status),
    /// What time it is.
    Pong {
        /// The rig's clock when it read the request.
        at_us: u64,
    },
    /// Event: the move (or the homing) of this sequence number has ended and the rig has settled.
    Arrived {
        /// Where.
        pan_mdeg: i32,
        /// Where.
        tilt_mdeg: i32,
    },
    /// Event: what this sequence number began was ended early by `Stop`, and the rig has settled.
    Stopped {
        /// Where.
        pan_mdeg: i32,
        /// Where.
        tilt_mdeg: i32,
    },
    /// Event: what this sequence number began was ended by the rig itself, and the rig has settled.
    Halted {
        /// Why.
        halt: Halt,
        /// Where.
        pan_mdeg: i32,
        /// Where.
        tilt_mdeg: i32,
    },
    /// Event: a photograph of this sequence number's bracket was taken.
    Exposed {
        /// Which one, from 0.
        index: u8,
        /// When its contact closed, by the rig's clock.
        at_us: u64,
        /// Whether its flash-sync came; false where none is wired.
        confirmed: bool,
    },
    /// Event: the bracket of this sequence number has ended.
    Triggered {
        /// How many photographs were taken.
        exposed: u8,
        /// How many of them the flash-sync confirmed.
        confirmed: u8,
    },
    /// The reply to `Tracker`, and the event that the tracker's state has changed.
    Tracker(TrackerStatus),
    /// Event: the tracker's record, with the sequence number of its `Track`.
    Record(Record),
    /// Event: something that people should know.
    Log {
        /// In words.
        text: String<60>,
    },
}

/// Where the rig is and what has happened.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// What it is doing.
    pub state: State,
    /// Its pan.
    pub pan_mdeg: i32,
    /// Its tilt.
    pub tilt_mdeg: i32,
    /// Why it ended the last thing that moved by itself; `None` when it did not.
    pub halt: Option<Halt>,
    /// By how many steps pan and tilt were off at the last homing; 0 at the first.
    pub lost_steps: [i32; 2],
    /// How many photographs of the last bracket were taken.
    pub exposed: u8,
    /// How many of them the flash-sync confirmed.
    pub confirmed: u8,
    /// How many damaged or unknown frames it has heard since it was switched on.
    pub bad_frames: u32,
}

/// How the tracker is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrackerStatus {
    /// What it is doing.
    pub state: TrackerState,
    /// Records forwarded since `Track`.
    pub forwarded: u32,
    /// Records refused since `Track` because a check failed.
    pub rejected: u32,
    /// Bytes since `Track` that belong to no record.
    pub skipped_bytes: u32,
    /// Good records since `Track` that found no room on the way to the host.
    pub overrun: u32,
    /// How often it was started again since `Track`.
    pub restarts: u16,
}

/// What the tracker is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum TrackerState {
    /// Nobody has asked for it.
    Off,
    /// It is being started.
    Starting,
    /// Its records come.
    Running,
    /// It does not answer; it is tried again.
    Silent,
}

/// A tracker's record, as it was said.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Record {
    /// Counts the records since `Track`, from 0: a gap was lost on the way.
    pub count: u32,
    /// When its first byte came, by the rig's clock.
    pub at_us: u64,
    /// The receiver: 1 or 2.
    pub station: u8,
    /// The tracker's status character, whatever it is.
    pub status: u8,
    /// x, y, z in the tracker's axes, micrometres.
    pub position_um: [i32; 3],
    /// The orientation.
    pub orientation: Orientation,
}

/// An orientation as the tracker says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Orientation {
    /// w, x, y, z, millionths.
    Quaternion([i32; 4]),
    /// Azimuth, elevation, roll, thousandths of a degree.
    Euler([i32; 3]),
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
    /// Why it last started.
    pub restart: Restart,
}

/// Why a rig started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Restart {
    /// It was switched on, or its reset button was pressed.
    Power,
    /// Its program hung and the watchdog ended it.
    Watchdog,
    /// Its program panicked; a `Log` says where.
    Panic,
}

/// How far and how fast a rig can go; both axes share speed and acceleration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Smallest pan.
    pub pan_min_mdeg: i32,
    /// Largest pan.
    pub pan_max_mdeg: i32,
    /// Largest turn of the pan from 0, either way, that the cables bear.
    pub winding_mdeg: i32,
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

/// What a rig is doing: always exactly one of these.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum State {
    /// Standing, and does not know where: it was not homed since it was switched on, or was halted since.
    Lost,
    /// Standing still.
    Still,
    /// Looking for its switches.
    Homing,
    /// Moving.
    Moving,
    /// Braking because it was told to stop or had to halt.
    Braking,
    /// Swinging after a move.
    Settling,
    /// Photographing a bracket.
    Exposing,
}

/// Pan or tilt.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Axis {
    /// The surface's turn about its normal.
    Pan,
    /// The surface's turn about the rig's horizontal axis.
    Tilt,
}

/// Why a rig stopped by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Halt {
    /// A limit switch closed in a move.
    Switch(Axis),
    /// Homing did not find the switch.
    NoSwitch(Axis),
    /// Homing found a switch that does not open.
    StuckSwitch(Axis),
    /// A move took longer than it can take.
    TooLong,
    /// The host was silent for longer than `DeadMan` allows.
    SilentHost,
}

/// Why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Fault {
    /// No `Hello` with the rig's own version and schema was heard since it was switched on.
    NoHello,
    /// The rig does not know where it is.
    NotHomed,
    /// The rig is not standing still.
    Busy,
    /// A later request was heard before: this one is too late.
    Stale,
    /// The request contradicts itself: an empty bracket, three stations.
    Senseless,
    /// The pan that was asked for winds the cables too far.
    Winding {
        /// What was asked for.
        asked_mdeg: i32,
        /// The largest turn, either way.
        limit_mdeg: i32,
    },
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
