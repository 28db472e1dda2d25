//! Questions and answers across a line: said with the same number until answered, on whatever port the rig comes back.

use std::io::{ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rigel_protocol::{Command, LARGEST_FRAME, Reply, Request, SCHEMA, VERSION, encode};

use super::ear::{Ear, Heeded};
use super::notice::Notices;
use super::place::{Place, Timing};
use super::serial::BAUD;
use crate::{Error, Result};

/// How often one request may lose the line before it is given up: a loose plug.
const MOST_LOSSES: u32 = 5;
/// How often a port that is gone is looked for.
const LOOK_TIME: Duration = Duration::from_millis(100);

/// A line to a rig that several threads may use, asked one thing at a time.
#[derive(Clone)]
pub(super) struct Link(Arc<Shared>);

struct Shared {
    timing: Timing,
    mouth: Mutex<Mouth>,
    ear: Arc<Ear>,
    notices: Arc<Notices>,
    name: Mutex<String>,
}

/// The asking half.
struct Mouth {
    place: Box<dyn Place>,
    line: Option<Line>,
    /// When and why the line was lost that is not back yet.
    lost: Option<(Instant, String)>,
    sequence: u16,
}

/// An open line with the thread that listens to it.
struct Line {
    writer: Box<dyn Write + Send>,
    closed: Arc<AtomicBool>,
    listener: Option<JoinHandle<()>>,
}

impl Drop for Line {
    fn drop(&mut self) {
        self.closed.store(true, Ordering::Relaxed);
        if let Some(listener) = self.listener.take() {
            // Only then is the port closed: an open one keeps its name from coming back.
            let _ = listener.join();
        }
    }
}

/// A request's reply.
pub(super) struct Asked {
    pub sequence: u16,
    pub reply: Reply,
    /// When the request was said, and when its reply was heard.
    pub said: Instant,
    pub heard: Instant,
    /// Whether it was said once: else nobody knows which one was answered.
    pub once: bool,
}

impl Link {
    /// Opens a place; nothing is said yet.
    pub fn open(mut place: Box<dyn Place>, timing: Timing) -> Result<Self> {
        let notices = Arc::<Notices>::default();
        let ear = Ear::new(notices.clone());
        let line = open(&mut *place, &ear).map_err(|why| Error::Device {
            device: place.name(),
            what: format!("cannot open the port: {why}"),
            remedy: "check the name and the cable, and close other programs that use it".into(),
        })?;
        let name = Mutex::new(place.name());
        let mouth = Mutex::new(Mouth { place, line: Some(line), lost: None, sequence: 0 });
        Ok(Self(Arc::new(Shared { timing, mouth, ear, notices, name })))
    }

    pub fn ear(&self) -> &Ear {
        &self.0.ear
    }

    pub fn notices(&self) -> &Notices {
        &self.0.notices
    }

    pub fn timing(&self) -> Timing {
        self.0.timing
    }

    /// The port's name now.
    pub fn name(&self) -> String {
        lock(&self.0.name).clone()
    }

    pub fn error(&self, what: impl Into<String>, remedy: &str) -> Error {
        Error::Device { device: self.name(), what: what.into(), remedy: remedy.into() }
    }

    pub fn confused(&self, reply: &Reply) -> Error {
        self.error(
            format!("the rig answered something else than was asked: {reply:?}"),
            "report this as a defect of its firmware",
        )
    }

    /// Opens a conversation: the next request has number 1, and is this hello.
    pub fn hello(&self, conversation: u32) -> Result<Reply> {
        let mut mouth = lock(&self.0.mouth);
        mouth.sequence = 0;
        self.0.ear.forget();
        let hello = Command::Hello { version: VERSION, schema: SCHEMA, conversation };
        Ok(self.say_until_answered(&mut mouth, &hello)?.reply)
    }

    /// Says a request until it is answered. A rig that was unplugged meanwhile and comes back hears it again, with the same
    /// number: it is executed once, or refused by a rig that has restarted.
    pub fn ask(&self, command: &Command) -> Result<Asked> {
        self.say_until_answered(&mut lock(&self.0.mouth), command)
    }

    /// Asks for the time; a ping that had to be repeated teaches nothing.
    pub fn ping(&self) -> Result<()> {
        let asked = self.ask(&Command::Ping)?;
        if let (Reply::Pong { at_us }, true) = (&asked.reply, asked.once) {
            self.0.ear.ping(asked.said, *at_us, asked.heard);
        }
        Ok(())
    }

    fn say_until_answered(&self, mouth: &mut Mouth, command: &Command) -> Result<Asked> {
        let Timing { reply: reply_time, attempts, .. } = self.0.timing;
        mouth.sequence = mouth.sequence.wrapping_add(1);
        let request = Request { sequence: mouth.sequence, command: command.clone() };
        let mut buffer = [0; LARGEST_FRAME];
        let frame = encode(&request, &mut buffer).map_err(|e| {
            self.error(format!("cannot say {request:?}: {e}"), "report this as a defect of Rigel")
        })?;
        self.0.ear.expect(request.sequence, command);
        let (mut said_times, mut losses) = (0, 0);
        while said_times < attempts {
            let said = Instant::now();
            let outcome = match self.say(mouth, frame) {
                Ok(()) => {
                    said_times += 1;
                    self.0.ear.reply(said + reply_time)
                }
                Err(why) => Heeded::Lost(why),
            };
            match outcome {
                Heeded::Reply(reply, heard) => {
                    let once = said_times == 1 && losses == 0;
                    return Ok(Asked { sequence: request.sequence, reply, said, heard, once });
                }
                Heeded::Silence => {}
                Heeded::Stranger(version, schema) => return Err(self.stranger(version, schema)),
                Heeded::Lost(why) => {
                    losses += 1;
                    if losses > MOST_LOSSES {
                        return Err(self.error(
                            format!("the line was lost {losses} times within one request ({why})"),
                            "push the plug in firmly or try another cable, then start again",
                        ));
                    }
                    self.reopen(mouth, why)?;
                    // A board that comes back may have to start.
                    said_times = 0;
                }
            }
        }
        Err(self.silent(command))
    }

    /// Says a frame. A line that takes nothing now is no error: the frame is lost as on the way.
    fn say(&self, mouth: &mut Mouth, frame: &[u8]) -> std::result::Result<(), String> {
        let Some(line) = &mut mouth.line else {
            return Err(mouth.lost.as_ref().map_or_else(String::new, |(_, why)| why.clone()));
        };
        match line.writer.write_all(frame) {
            Ok(()) => Ok(()),
            Err(e) if matches!(e.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock) => Ok(()),
            Err(e) => Err(e.to_string()),
        }
    }

    /// Opens the line again wherever the rig comes back.
    fn reopen(&self, mouth: &mut Mouth, why: String) -> Result<()> {
        // Closed first: an open one keeps its name from coming back.
        mouth.line = None;
        let old_name = self.name();
        let patience = self.0.timing.return_time;
        let (since, why) = match mouth.lost.clone() {
            Some(lost) => lost,
            None => {
                self.0.notices.tell(format!(
                    "{old_name}: the rig was unplugged or switched off ({why}); waiting {:.0} s for it to come back",
                    patience.as_secs_f64()
                ));
                mouth.lost = Some((Instant::now(), why.clone()));
                (Instant::now(), why)
            }
        };
        loop {
            match open(&mut *mouth.place, &self.0.ear) {
                Ok(line) => {
                    mouth.line = Some(line);
                    mouth.lost = None;
                    let name = mouth.place.name();
                    let elsewhere = if name == old_name { String::new() } else { format!(" as {name}") };
                    *lock(&self.0.name) = name;
                    self.0.notices.tell(format!(
                        "{old_name}: something is plugged in again{elsewhere} after {:.1} s",
                        since.elapsed().as_secs_f64()
                    ));
                    return Ok(());
                }
                Err(cause) if since.elapsed() >= patience => {
                    return Err(self.error(
                        format!(
                            "the rig was unplugged or switched off ({why}) and did not come back within {:.0} s ({cause})",
                            patience.as_secs_f64()
                        ),
                        "connect it and start again",
                    ));
                }
                Err(_) => std::thread::sleep(LOOK_TIME),
            }
        }
    }

    fn stranger(&self, version: u16, schema: u32) -> Error {
        self.error(
            format!(
                "the rig speaks version {version} (schema {schema:08x}) and this program speaks version {VERSION} \
                 (schema {SCHEMA:08x})"
            ),
            "install firmware and program of the same release",
        )
    }

    fn silent(&self, command: &Command) -> Error {
        let Timing { reply, attempts, .. } = self.0.timing;
        let waited_s = (reply * attempts).as_secs_f64();
        let nothing = match command {
            Command::Hello { .. } => "no rig answers".to_owned(),
            // Its name alone: what it is made of helps nobody.
            command => {
                let words = format!("{command:?}");
                let name = words.split([' ', '(']).next().unwrap_or_default();
                format!("no answer to {name} within {waited_s:.1} s, said {attempts} times")
            }
        };
        match self.0.ear.amount() {
            (0, _) => self.error(
                format!("{nothing}: nothing at all is heard there"),
                "check that this is the rig's port, that the rig has power, and that its firmware runs",
            ),
            (bytes, 0) => self.error(
                format!("{nothing}: {bytes} bytes were heard and no message among them"),
                &format!("check that this is the rig's port and that both ends talk at {BAUD} baud"),
            ),
            (_, frames) => self.error(
                format!("{nothing}, although {frames} other messages were heard"),
                "check the cable, then switch the rig off and on again",
            ),
        }
    }
}

fn open(place: &mut dyn Place, ear: &Arc<Ear>) -> std::result::Result<Line, String> {
    let ends = place.open()?;
    ear.reopen();
    let closed = Arc::new(AtomicBool::new(false));
    let listener = {
        let (ear, closed) = (ear.clone(), closed.clone());
        std::thread::Builder::new()
            .name("rig listener".into())
            .spawn(move || ear.listen(ends.reader, &closed))
            .map_err(|e| e.to_string())?
    };
    Ok(Line { writer: ends.writer, closed, listener: Some(listener) })
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
