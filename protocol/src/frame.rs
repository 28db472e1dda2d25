//! How a message crosses a serial line: postcard, then CRC-32, inside COBS, between two zero bytes.
//!
//! The zero in front costs a byte and ends whatever noise came before, so that damage costs one frame and never two.

use crc::{CRC_32_ISO_HDLC, Crc};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// The largest message, bytes, before CRC and framing.
pub const LARGEST_PAYLOAD: usize = 80;

/// The largest frame, bytes: the message, its CRC, one byte of COBS and two zeros.
pub const LARGEST_FRAME: usize = LARGEST_PAYLOAD + CRC_BYTES + 3;

const CRC_BYTES: usize = 4;
const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Why a frame, or a message, is no good.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameError {
    /// Longer than [`LARGEST_FRAME`].
    TooLong,
    /// Not COBS, or too short to hold a CRC.
    Broken,
    /// The CRC-32 does not belong to the bytes.
    Checksum,
    /// The bytes arrived whole but are no message of this table of words.
    Unknown,
}

impl core::fmt::Display for FrameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::TooLong => "the frame is longer than any message",
            Self::Broken => "the frame is broken",
            Self::Checksum => "the frame's checksum is wrong",
            Self::Unknown => "the message is not in the table of words",
        })
    }
}

impl core::error::Error for FrameError {}

/// Writes the frame of `message` into `buffer` and returns the part of it that is to be sent.
///
/// # Errors
/// [`FrameError::TooLong`] for a message that does not fit; none of the words does that.
pub fn encode<'a>(
    message: &impl Serialize,
    buffer: &'a mut [u8; LARGEST_FRAME],
) -> Result<&'a [u8], FrameError> {
    let mut plain = [0; LARGEST_PAYLOAD + CRC_BYTES];
    let length =
        postcard::to_slice(message, &mut plain[..LARGEST_PAYLOAD]).map_err(|_| FrameError::TooLong)?.len();
    let crc = CRC.checksum(&plain[..length]).to_le_bytes();
    plain[length..length + CRC_BYTES].copy_from_slice(&crc);
    buffer[0] = 0;
    let encoded = cobs::try_encode(&plain[..length + CRC_BYTES], &mut buffer[1..LARGEST_FRAME - 1])
        .map_err(|_| FrameError::TooLong)?;
    buffer[1 + encoded] = 0;
    Ok(&buffer[..encoded + 2])
}

/// Reads a message from the bytes that [`Decoder::push`] delivered.
///
/// # Errors
/// [`FrameError::Unknown`] when the bytes are no such message, or more than one.
pub fn decode<M: DeserializeOwned>(payload: &[u8]) -> Result<M, FrameError> {
    match postcard::take_from_bytes(payload) {
        Ok((message, [])) => Ok(message),
        _ => Err(FrameError::Unknown),
    }
}

/// Version and schema of an answer that says hello, whatever its version has put behind them; `None` for other answers.
pub fn identity(payload: &[u8]) -> Option<(u16, u32)> {
    let ((_sequence, reply, version, schema), _) =
        postcard::take_from_bytes::<(u16, u32, u16, u32)>(payload).ok()?;
    (reply == 0).then_some((version, schema))
}

/// Finds the frames in a stream of bytes.
pub struct Decoder {
    buffer: [u8; LARGEST_FRAME],
    length: usize,
    too_long: bool,
}

impl Decoder {
    /// A decoder that has heard nothing.
    pub const fn new() -> Self {
        Self { buffer: [0; LARGEST_FRAME], length: 0, too_long: false }
    }

    /// Takes one byte; delivers a message's bytes, for [`decode`], with the zero that ends its frame.
    ///
    /// An error means that something was lost; the decoder is ready for the next frame.
    pub fn push(&mut self, byte: u8) -> Option<Result<&[u8], FrameError>> {
        if byte != 0 {
            if let Some(slot) = self.buffer.get_mut(self.length) {
                *slot = byte;
                self.length += 1;
            } else {
                self.too_long = true;
            }
            return None;
        }
        let (length, too_long) = (self.length, self.too_long);
        (self.length, self.too_long) = (0, false);
        if too_long {
            return Some(Err(FrameError::TooLong));
        }
        // Two zeros in a row: the end of one frame and the start of the next.
        (length > 0).then(|| open(&mut self.buffer[..length]))
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

fn open(frame: &mut [u8]) -> Result<&[u8], FrameError> {
    let length = cobs::decode_in_place(frame).map_err(|_| FrameError::Broken)?;
    let (payload, crc) = frame[..length].split_last_chunk::<CRC_BYTES>().ok_or(FrameError::Broken)?;
    if CRC.checksum(payload) == u32::from_le_bytes(*crc) { Ok(payload) } else { Err(FrameError::Checksum) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::*;

    /// Every command, with the numbers that take the most and the fewest bytes.
    fn requests() -> Vec<Request> {
        let mut commands =
            vec![Command::Home, Command::Stop, Command::Status, Command::Ping, Command::Tracker];
        for n in [0, 1, -90_000, i32::MIN, i32::MAX] {
            commands.push(Command::MoveTo { pan_mdeg: n, tilt_mdeg: n.wrapping_neg() });
            commands.push(Command::DeadMan { silence_ms: n as u32 });
        }
        for (version, schema, conversation) in [(VERSION, SCHEMA, 0), (u16::MAX, u32::MAX, u32::MAX)] {
            commands.push(Command::Hello { version, schema, conversation });
        }
        for length in [0, 1, LONGEST_BRACKET] {
            let pulses_us = core::iter::repeat_n(u32::MAX, length).collect();
            let (half_press_ms, pause_ms, confirm_ms) = (u16::MAX, 0, u16::MAX);
            commands.push(Command::Trigger(Bracket { half_press_ms, pulses_us, pause_ms, confirm_ms }));
        }
        for (format, output) in [(Format::Ascii, Output::Euler), (Format::Binary, Output::Quaternion)] {
            commands.push(Command::Track(Tracking { stations: 2, format, output }));
        }
        commands
            .into_iter()
            .flat_map(|command| {
                [0, 255, u16::MAX].map(|sequence| Request { sequence, command: command.clone() })
            })
            .collect()
    }

    fn answers() -> Vec<Answer> {
        let (pan_mdeg, tilt_mdeg) = (i32::MIN, i32::MAX);
        let (asked_mdeg, min_mdeg, max_mdeg) = (i32::MAX, i32::MIN, i32::MIN);
        let limits = Limits {
            pan_min_mdeg: i32::MIN,
            pan_max_mdeg: i32::MAX,
            winding_mdeg: i32::MAX,
            tilt_min_mdeg: i32::MIN,
            tilt_max_mdeg: i32::MAX,
            speed_mdeg_s: u32::MAX,
            acceleration_mdeg_s2: u32::MAX,
            settle_ms: u32::MAX,
        };
        let board = "a board of 24 characters".try_into().unwrap();
        let (version, schema, at_us) = (u16::MAX, u32::MAX, u64::MAX);
        let mut replies = vec![
            Reply::Hello(Hello { version, schema, board, limits, restart: Restart::Panic }),
            Reply::Accepted { duration_ms: u32::MAX },
            Reply::Pong { at_us },
            Reply::Arrived { pan_mdeg, tilt_mdeg },
            Reply::Stopped { pan_mdeg: 0, tilt_mdeg: 0 },
            Reply::Exposed { index: u8::MAX, at_us, confirmed: true },
            Reply::Triggered { exposed: u8::MAX, confirmed: u8::MAX },
            Reply::Log { text: core::iter::repeat_n('x', 60).collect() },
        ];
        for fault in [
            Fault::NoHello,
            Fault::NotHomed,
            Fault::Busy,
            Fault::Stale,
            Fault::Senseless,
            Fault::PanOutside { asked_mdeg, min_mdeg, max_mdeg },
            Fault::TiltOutside { asked_mdeg, min_mdeg, max_mdeg },
            Fault::Winding { asked_mdeg, limit_mdeg: max_mdeg },
        ] {
            replies.push(Reply::Refused(fault));
        }
        let halts = [Axis::Pan, Axis::Tilt]
            .map(|axis| [Halt::Switch(axis), Halt::NoSwitch(axis), Halt::StuckSwitch(axis)])
            .into_iter()
            .flatten()
            .chain([Halt::TooLong, Halt::SilentHost]);
        for halt in halts {
            replies.push(Reply::Halted { halt, pan_mdeg, tilt_mdeg });
            replies.push(Reply::Status(Status {
                state: State::Exposing,
                pan_mdeg,
                tilt_mdeg,
                halt: Some(halt),
                lost_steps: [i32::MIN; 2],
                exposed: u8::MAX,
                confirmed: u8::MAX,
                bad_frames: u32::MAX,
            }));
        }
        for state in [TrackerState::Off, TrackerState::Starting, TrackerState::Running, TrackerState::Silent]
        {
            let n = u32::MAX;
            replies.push(Reply::Tracker(TrackerStatus {
                state,
                forwarded: n,
                rejected: n,
                skipped_bytes: n,
                overrun: n,
                restarts: u16::MAX,
            }));
        }
        for orientation in [Orientation::Quaternion([i32::MIN; 4]), Orientation::Euler([i32::MAX; 3])] {
            replies.push(Reply::Record(Record {
                count: u32::MAX,
                at_us,
                station: 2,
                status: u8::MAX,
                position_um: [i32::MIN; 3],
                orientation,
            }));
        }
        replies.into_iter().map(|reply| Answer { sequence: u16::MAX, reply }).collect()
    }

    fn framed(message: &impl Serialize) -> Vec<u8> {
        encode(message, &mut [0; LARGEST_FRAME]).unwrap().to_vec()
    }

    /// Everything that a decoder finds in a stream.
    fn heard<M: DeserializeOwned>(bytes: &[u8]) -> Vec<Result<M, FrameError>> {
        let mut decoder = Decoder::new();
        bytes.iter().filter_map(|&b| decoder.push(b).map(|frame| frame.and_then(decode::<M>))).collect()
    }

    #[test]
    fn every_message_survives_the_round_trip() {
        let stream: Vec<u8> = requests().iter().flat_map(framed).collect();
        assert_eq!(heard::<Request>(&stream), requests().into_iter().map(Ok).collect::<Vec<_>>());
        let stream: Vec<u8> = answers().iter().flat_map(framed).collect();
        assert_eq!(heard::<Answer>(&stream), answers().into_iter().map(Ok).collect::<Vec<_>>());
    }

    #[test]
    fn every_wrong_bit_is_noticed_and_costs_one_message() {
        let next = Answer { sequence: 77, reply: Reply::Pong { at_us: 5 } };
        for answer in answers() {
            let frame = framed(&answer);
            for bit in 0..frame.len() * 8 {
                let mut stream = frame.clone();
                stream[bit / 8] ^= 1 << (bit % 8);
                stream.extend(framed(&next));
                let good: Vec<Answer> = heard(&stream).into_iter().flatten().collect();
                // A wrong bit in the zero in front becomes one byte of noise inside the frame: lost like any other.
                assert_eq!(good, std::slice::from_ref(&next), "bit {bit} of {answer:?}");
            }
        }
    }

    #[test]
    fn a_request_is_found_after_any_noise() {
        let request = Request { sequence: 3, command: Command::MoveTo { pan_mdeg: -1, tilt_mdeg: 2 } };
        let mut state = 1_u32;
        for length in 0..3 * LARGEST_FRAME {
            let mut stream: Vec<u8> = (0..length)
                .map(|_| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (state >> 24) as u8
                })
                .collect();
            stream.extend(framed(&request));
            let good: Vec<Request> = heard(&stream).into_iter().flatten().collect();
            assert_eq!(good, std::slice::from_ref(&request));
        }
    }

    #[test]
    fn a_frame_without_end_is_refused_once_and_the_next_is_heard() {
        let mut stream = vec![0x55; 10 * LARGEST_FRAME];
        stream.extend(framed(&Request { sequence: 1, command: Command::Ping }));
        let found = heard::<Request>(&stream);
        assert_eq!(found, [Err(FrameError::TooLong), Ok(Request { sequence: 1, command: Command::Ping })]);
    }

    #[test]
    fn a_message_that_does_not_fit_is_an_error() {
        assert_eq!(encode(&[[1_u8; 32]; 3], &mut [0; LARGEST_FRAME]), Err(FrameError::TooLong));
        assert!(encode(&([1_u8; 32], [1_u8; 32], [1_u8; 16]), &mut [0; LARGEST_FRAME]).is_ok());
    }

    #[test]
    fn a_message_with_something_behind_it_is_unknown() {
        let mut payload = [0; 16];
        let length =
            postcard::to_slice(&Request { sequence: 1, command: Command::Ping }, &mut payload).unwrap().len();
        assert!(decode::<Request>(&payload[..length]).is_ok());
        assert_eq!(decode::<Request>(&payload[..length + 1]), Err(FrameError::Unknown));
    }

    #[test]
    fn the_hello_of_another_version_still_tells_its_version() {
        // A later version that says much more, in other types, behind the frozen beginning.
        let frame = framed(&(5_u16, 0_u32, 9_u16, 0xabcd_ef01_u32, "another board", [1.5_f64; 3]));
        let mut decoder = Decoder::new();
        let found: Vec<_> =
            frame.iter().filter_map(|&b| decoder.push(b).map(|f| identity(f.unwrap()))).collect();
        assert_eq!(found, [Some((9, 0xabcd_ef01))]);
        let mut buffer = [0; LARGEST_PAYLOAD];
        for answer in answers() {
            let payload = postcard::to_slice(&answer, &mut buffer).unwrap();
            assert_eq!(identity(payload).is_some(), matches!(answer.reply, Reply::Hello(_)));
        }
    }
}
