//! Questions and answers across a serial port: said until answered, damage skipped, every error naming the port.

use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::time::{Duration, Instant};

use rigel_protocol::{
    Answer, Command, Decoder, LARGEST_FRAME, Reply, Request, SCHEMA, VERSION, encode, frame,
};
use serialport::{ClearBuffer, SerialPort};

use crate::{Error, Result};

/// Ignored by USB, right for the others.
const BAUD: u32 = 115_200;
/// How long the rig may take to answer before the request is said again: a frame takes a few milliseconds.
const REPLY_TIME: Duration = Duration::from_millis(100);
/// How often a request is said before the rig is given up: two seconds cover a board that starts.
const ATTEMPTS: u32 = 20;

/// A serial port with a rig at its other end, asked one thing at a time.
pub(super) struct Line {
    pub(super) name: String,
    port: Box<dyn SerialPort>,
    decoder: Decoder,
    /// What was heard and not yet looked at.
    heard: VecDeque<Answer>,
    sequence: u16,
}

impl Line {
    pub(super) fn open(name: &str) -> Result<Self> {
        let mut port = serialport::new(name, BAUD).timeout(REPLY_TIME).open().map_err(|e| Error::Device {
            device: name.into(),
            what: format!("cannot open the port: {e}"),
            remedy: "check the name and the cable, and close other programs that use it".into(),
        })?;
        // A board may wait for this line before it talks; a pseudo-terminal does not have it.
        let _ = port.write_data_terminal_ready(true);
        // What was said before this conversation is of no interest; where it cannot be cleared, the framing copes.
        let _ = port.clear(ClearBuffer::All);
        Ok(Self { name: name.into(), port, decoder: Decoder::new(), heard: VecDeque::new(), sequence: 0 })
    }

    /// The sequence number of the last request.
    pub(super) fn sequence(&self) -> u16 {
        self.sequence
    }

    /// Says a request until it is answered.
    pub(super) fn ask(&mut self, command: Command) -> Result<Reply> {
        self.sequence = self.sequence.wrapping_add(1);
        let request = Request { sequence: self.sequence, command: command.clone() };
        for _ in 0..ATTEMPTS {
            self.say(&request)?;
            let deadline = Instant::now() + REPLY_TIME;
            loop {
                let left = deadline.saturating_duration_since(Instant::now());
                match self.hear(left)? {
                    None => break,
                    // The end of a move is no reply; whoever waits for it learns it from the status.
                    Some(Answer { reply: Reply::Arrived { .. } | Reply::Stopped { .. }, .. }) => {}
                    Some(answer) if answer.sequence == request.sequence => return Ok(answer.reply),
                    // Answered twice because it was said twice.
                    Some(_) => {}
                }
            }
        }
        let waited_s = (REPLY_TIME * ATTEMPTS).as_secs_f64();
        Err(self.error(
            format!("no answer to {command:?} within {waited_s:.0} s, said {ATTEMPTS} times"),
            "check that this is the rig's port, that the rig has power, and that its firmware runs",
        ))
    }

    fn say(&mut self, request: &Request) -> Result<()> {
        let mut buffer = [0; LARGEST_FRAME];
        let frame = encode(request, &mut buffer).map_err(|e| {
            self.error(format!("cannot say {request:?}: {e}"), "report this as a defect of Rigel")
        })?;
        self.port.write_all(frame).map_err(|e| self.lost(&e))
    }

    /// The next answer, or `None` when nothing comes within `time`. Damaged frames are skipped: what they said is asked
    /// for again.
    pub(super) fn hear(&mut self, time: Duration) -> Result<Option<Answer>> {
        let deadline = Instant::now() + time;
        let mut buffer = [0; 256];
        loop {
            if let Some(answer) = self.heard.pop_front() {
                return Ok(Some(answer));
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            self.port.set_timeout(left).map_err(|e| self.lost(&e))?;
            let count = match self.port.read(&mut buffer) {
                Ok(0) => return Err(self.lost(&"end of file")),
                Ok(count) => count,
                Err(e) if matches!(e.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => continue,
                Err(e) => return Err(self.lost(&e)),
            };
            self.take(&buffer[..count])?;
        }
    }

    fn take(&mut self, bytes: &[u8]) -> Result<()> {
        for &byte in bytes {
            let Some(Ok(payload)) = self.decoder.push(byte) else { continue };
            // Before anything else: of another version nothing but this can be trusted.
            if let Some((version, schema)) = frame::identity(payload)
                && (version, schema) != (VERSION, SCHEMA)
            {
                return Err(self.error(
                    format!(
                        "the rig speaks version {version} (schema {schema:08x}) and this program speaks version \
                         {VERSION} (schema {SCHEMA:08x})"
                    ),
                    "install firmware and program of the same release",
                ));
            }
            if let Ok(answer) = frame::decode(payload) {
                self.heard.push_back(answer);
            }
        }
        Ok(())
    }

    pub(super) fn error(&self, what: impl Into<String>, remedy: &str) -> Error {
        Error::Device { device: self.name.clone(), what: what.into(), remedy: remedy.into() }
    }

    fn lost(&self, cause: &dyn std::fmt::Display) -> Error {
        self.error(format!("the rig was unplugged or switched off ({cause})"), "connect it and start again")
    }
}
