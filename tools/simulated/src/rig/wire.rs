//! The cable between the simulated board and the host, with everything that goes wrong on it.

use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Result, Write};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rigel_protocol::{Answer, Decoder, LARGEST_FRAME, Reply, Request, encode, frame};
use serialport::{SerialPort, TTYPort};

use super::board::Board;
use super::{Faults, lock};

/// How often the simulated board looks at its line and its clock.
const ROUND: Duration = Duration::from_millis(1);

/// Both ends of a new pseudo-terminal: the board's and the host's.
pub(super) fn open_line() -> serialport::Result<(TTYPort, TTYPort)> {
    let (mut line, far_end) = TTYPort::pair()?;
    line.set_timeout(ROUND)?;
    Ok((line, far_end))
}

/// The cable, with its faults.
pub(super) struct Wire {
    line: TTYPort,
    faults: Faults,
    frames: u32,
    /// A request that is overtaken by the next one.
    late_request: Option<Request>,
    /// An answer that is overtaken by the next one.
    late_answer: Option<Vec<u8>>,
    /// What is on its way, and when it arrives.
    on_the_way: VecDeque<(Instant, Vec<u8>)>,
}

enum Fate {
    Whole,
    Lost,
    Spoilt,
    Twice,
    Late,
    Unplugged,
}

impl Wire {
    pub fn new(line: TTYPort, faults: Faults) -> Self {
        let on_the_way = VecDeque::new();
        Self { line, faults, frames: 0, late_request: None, late_answer: None, on_the_way }
    }

    /// Counts a frame and tells what becomes of it.
    fn fate(&mut self) -> Fate {
        self.frames += 1;
        let Faults { drop_every, corrupt_every, duplicate_every, reorder_every, .. } = self.faults;
        let every = |n: u32| n > 0 && self.frames.is_multiple_of(n);
        let after = |last: Option<u32>| last.is_some_and(|last| self.frames > last);
        if after(self.faults.unplug_after) {
            Fate::Unplugged
        } else if after(self.faults.silent_after) || every(drop_every) {
            Fate::Lost
        } else if every(corrupt_every) {
            Fate::Spoilt
        } else if every(duplicate_every) {
            Fate::Twice
        } else if every(reorder_every) {
            Fate::Late
        } else {
            Fate::Whole
        }
    }

    fn send(&mut self, mut answer: Answer) -> Result<()> {
        if let (Reply::Hello(hello), Some(version)) = (&mut answer.reply, self.faults.version) {
            hello.version = version;
        }
        let mut buffer = [0; LARGEST_FRAME];
        let mut bytes = encode(&answer, &mut buffer).map_err(std::io::Error::other)?.to_vec();
        let overtaken = self.late_answer.take();
        match self.fate() {
            Fate::Unplugged => return Err(ErrorKind::BrokenPipe.into()),
            Fate::Lost => bytes.clear(),
            Fate::Spoilt => {
                let bit = self.frames as usize * 7 % (bytes.len() * 8);
                bytes[bit / 8] ^= 1 << (bit % 8);
            }
            Fate::Twice => bytes.extend(bytes.clone()),
            Fate::Late => self.late_answer = Some(std::mem::take(&mut bytes)),
            Fate::Whole => {}
        }
        bytes.extend(overtaken.into_iter().flatten());
        let arrives = Instant::now() + Duration::from_millis(self.faults.delay_ms.into());
        self.on_the_way.push_back((arrives, bytes));
        Ok(())
    }

    fn deliver(&mut self) -> Result<()> {
        while self.on_the_way.front().is_some_and(|(arrives, _)| *arrives <= Instant::now()) {
            let Some((_, bytes)) = self.on_the_way.pop_front() else { break };
            match self.line.write_all(&bytes) {
                // Nobody reads: what does not fit is lost, as on a real line.
                Err(e) if e.kind() == ErrorKind::TimedOut => {}
                outcome => outcome?,
            }
        }
        Ok(())
    }

    /// The board's loop: what a real board does between its interrupts.
    pub fn serve(&mut self, board: &Mutex<Board>, unplug: &AtomicBool) -> Result<()> {
        let mut decoder = Decoder::new();
        let mut buffer = [0; 256];
        while !unplug.load(Ordering::Relaxed) {
            let count = match self.line.read(&mut buffer) {
                Ok(count) => count,
                Err(e) if matches!(e.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => 0,
                Err(e) => return Err(e),
            };
            for &byte in &buffer[..count] {
                let request = match decoder.push(byte) {
                    None => continue,
                    Some(heard) => heard.and_then(frame::decode::<Request>),
                };
                match request {
                    Ok(request) => self.hear(request, board)?,
                    Err(_) => lock(board).bad_frame(),
                }
                self.answer(board)?;
            }
            lock(board).catch_up();
            self.answer(board)?;
            self.deliver()?;
        }
        Ok(())
    }

    fn hear(&mut self, request: Request, board: &Mutex<Board>) -> Result<()> {
        let overtaken = self.late_request.take();
        match self.fate() {
            Fate::Unplugged => return Err(ErrorKind::BrokenPipe.into()),
            Fate::Lost => {}
            // The checksum of a spoilt request is wrong.
            Fate::Spoilt => lock(board).bad_frame(),
            Fate::Late => self.late_request = Some(request),
            Fate::Twice => {
                lock(board).hear(&request);
                lock(board).hear(&request);
            }
            Fate::Whole => lock(board).hear(&request),
        }
        if let Some(request) = overtaken {
            lock(board).hear(&request);
        }
        Ok(())
    }

    fn answer(&mut self, board: &Mutex<Board>) -> Result<()> {
        loop {
            let Some(answer) = lock(board).said.pop_front() else { return Ok(()) };
            self.send(answer)?;
        }
    }
}
