//! The listening half of a link: a thread that always drains the line, so that nothing is lost because somebody waits for
//! something else.

use std::collections::VecDeque;
use std::io::{ErrorKind, Read};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use rigel_protocol::{Answer, Command, Decoder, Record, Reply, SCHEMA, VERSION, frame};

use super::clock::{Clock, Moment};
use super::notice::Notices;

/// Events that nobody waits for are forgotten, the oldest first; a bracket has thirteen.
const MOST_EVENTS: usize = 256;

/// What was heard of one line, and who waits for it.
pub(super) struct Ear {
    heard: Mutex<Heard>,
    news: Condvar,
    notices: Arc<Notices>,
    /// The scale of the clock's times.
    start: (Instant, SystemTime),
}

#[derive(Default)]
struct Heard {
    asked: Option<(u16, Command)>,
    reply: Option<(Reply, Instant)>,
    events: VecDeque<Answer>,
    lost: Option<String>,
    stranger: Option<(u16, u32)>,
    bytes: u64,
    frames: u64,
    records: Option<Sender<(Record, Option<Moment>)>>,
    /// The request that started the tracker, to which its records belong.
    track: Option<u16>,
    clock: Clock,
}

/// What waiting for a reply came to.
pub(super) enum Heeded {
    /// The reply, and when it was heard.
    Reply(Reply, Instant),
    /// Nothing within the time.
    Silence,
    /// The line has ended, and why.
    Lost(String),
    /// The rig speaks this version and schema.
    Stranger(u16, u32),
}

impl Ear {
    pub fn new(notices: Arc<Notices>) -> Arc<Self> {
        let start = (Instant::now(), SystemTime::now());
        Arc::new(Self { heard: Mutex::default(), news: Condvar::new(), notices, start })
    }

    /// Drains a line until it ends or is `closed`. Read times out often enough to notice.
    pub fn listen(&self, mut reader: impl Read, closed: &AtomicBool) {
        let (mut decoder, mut buffer) = (Decoder::new(), [0; 1024]);
        while !closed.load(Ordering::Relaxed) {
            let why = match reader.read(&mut buffer) {
                Ok(0) => "end of file".to_string(),
                Ok(count) => {
                    self.take(&mut decoder, &buffer[..count], Instant::now());
                    continue;
                }
                Err(e)
                    if matches!(
                        e.kind(),
                        ErrorKind::TimedOut | ErrorKind::Interrupted | ErrorKind::WouldBlock
                    ) =>
                {
                    continue;
                }
                Err(e) => e.to_string(),
            };
            self.lock().lost = Some(why);
            self.news.notify_all();
            return;
        }
    }

    fn take(&self, decoder: &mut Decoder, bytes: &[u8], at: Instant) {
        let mut told = vec![];
        let mut heard = self.lock();
        heard.bytes += bytes.len() as u64;
        for &byte in bytes {
            let Some(Ok(payload)) = decoder.push(byte) else { continue };
            // Before anything else: of another version nothing but this can be trusted.
            match frame::identity(payload) {
                Some(found) if found != (VERSION, SCHEMA) => heard.stranger = Some(found),
                _ => {}
            }
            if let Ok(answer) = frame::decode::<Answer>(payload) {
                heard.frames += 1;
                told.extend(heard.sort(answer, at));
            }
        }
        drop(heard);
        self.news.notify_all();
        // Whoever listens to notices may take their time.
        told.into_iter().for_each(|text| self.notices.tell(text));
    }

    /// A new line: what was heard of the old one counts no longer.
    pub fn reopen(&self) {
        let mut heard = self.lock();
        (heard.lost, heard.stranger, heard.bytes, heard.frames) = (None, None, 0, 0);
    }

    /// A new conversation with a rig whose clock may start anew.
    pub fn forget(&self) {
        let mut heard = self.lock();
        heard.events.clear();
        heard.track = None;
        heard.clock = Clock::new();
    }

    /// From now on the reply to this is awaited.
    pub fn expect(&self, sequence: u16, command: &Command) {
        let mut heard = self.lock();
        // Numbers come again: what was said of an older request of this number is no news of this one.
        heard.events.retain(|event| event.sequence != sequence);
        if matches!(command, Command::Track(_)) {
            heard.track = Some(sequence);
        }
        heard.asked = Some((sequence, command.clone()));
        heard.reply = None;
    }

    /// The expected reply, or what else came of it until `deadline`.
    pub fn reply(&self, deadline: Instant) -> Heeded {
        self.wait(deadline, |heard| {
            if let Some((version, schema)) = heard.stranger {
                return Some(Heeded::Stranger(version, schema));
            }
            if let Some((reply, at)) = heard.reply.take() {
                heard.asked = None;
                return Some(Heeded::Reply(reply, at));
            }
            heard.lost.clone().map(Heeded::Lost)
        })
        .unwrap_or(Heeded::Silence)
    }

    /// An event of a request, or `None` when none comes within `time` or the line has ended.
    pub fn event(&self, sequence: u16, time: Duration) -> Option<Reply> {
        self.wait(Instant::now() + time, |heard| {
            let found = heard.events.iter().position(|event| event.sequence == sequence);
            match found.and_then(|index| heard.events.remove(index)) {
                Some(event) => Some(Some(event.reply)),
                None => heard.lost.is_some().then_some(None),
            }
        })
        .flatten()
    }

    fn wait<T>(&self, deadline: Instant, mut look: impl FnMut(&mut Heard) -> Option<T>) -> Option<T> {
        let mut heard = self.lock();
        loop {
            if let Some(found) = look(&mut heard) {
                return Some(found);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            heard = self.news.wait_timeout(heard, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// How much was heard since the line was opened: bytes, and whole messages among them.
    pub fn amount(&self) -> (u64, u64) {
        let heard = self.lock();
        (heard.bytes, heard.frames)
    }

    /// The tracker's records go there from now on, each with its time if the clock is known.
    pub fn send_records(&self, to: Sender<(Record, Option<Moment>)>) {
        self.lock().records = Some(to);
    }

    /// Takes a ping: when it was said and answered, and the rig's time.
    pub fn ping(&self, said: Instant, rig_us: u64, heard: Instant) {
        let seconds = |at: Instant| at.saturating_duration_since(self.start.0).as_secs_f64();
        self.lock().clock.ping(seconds(said), rig_us, seconds(heard));
    }

    /// When the rig's clock showed `rig_us`.
    pub fn moment(&self, rig_us: u64) -> Option<Moment> {
        self.lock().clock.at(rig_us)
    }

    /// The host's clock at a moment.
    pub fn system_time(&self, moment: Moment) -> SystemTime {
        let way = Duration::try_from_secs_f64(moment.host_s.abs()).unwrap_or_default();
        if moment.host_s < 0.0 { self.start.1 - way } else { self.start.1 + way }
    }

    fn lock(&self) -> MutexGuard<'_, Heard> {
        self.heard.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Heard {
    /// Puts an answer where it is waited for; what is for people is returned.
    fn sort(&mut self, answer: Answer, at: Instant) -> Option<String> {
        let is_reply = self.asked.as_ref().is_some_and(|(sequence, command)| {
            *sequence == answer.sequence && answers(command, &answer.reply)
        });
        if is_reply {
            // Said twice, answered twice: the first one counts.
            self.reply.get_or_insert((answer.reply, at));
            return None;
        }
        match answer.reply {
            Reply::Arrived { .. }
            | Reply::Stopped { .. }
            | Reply::Halted { .. }
            | Reply::Exposed { .. }
            | Reply::Triggered { .. } => {
                if self.events.len() == MOST_EVENTS {
                    self.events.pop_front();
                }
                self.events.push_back(answer);
            }
            Reply::Record(record) => {
                // What an earlier start of the tracker still says has other counts, and perhaps another meaning.
                if let (Some(records), true) = (&self.records, self.track == Some(answer.sequence)) {
                    // Where nobody receives any more there is nobody to miss it.
                    let _ = records.send((record, self.clock.at(record.at_us)));
                }
            }
            Reply::Tracker(status) => return Some(format!("the tracker is now {:?}", status.state)),
            Reply::Log { text } => return Some(format!("the rig says: {text}")),
            // The reply to something older, late or repeated.
            Reply::Hello(_)
            | Reply::Accepted { .. }
            | Reply::Refused(_)
            | Reply::Status(_)
            | Reply::Pong { .. } => {}
        }
        None
    }
}

/// Whether a reply can be the one to a command: an older conversation used the same numbers.
fn answers(command: &Command, reply: &Reply) -> bool {
    match reply {
        Reply::Refused(_) => true,
        Reply::Hello(_) => matches!(command, Command::Hello { .. }),
        Reply::Status(_) => matches!(command, Command::Status),
        Reply::Pong { .. } => matches!(command, Command::Ping),
        // To `Track` it is the event that it was obeyed.
        Reply::Tracker(_) => matches!(command, Command::Tracker | Command::Track(_)),
        Reply::Accepted { .. } => {
            !matches!(command, Command::Hello { .. } | Command::Status | Command::Ping | Command::Tracker)
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use rigel_protocol::{Format, LARGEST_FRAME, Orientation, Output, Tracking, encode};

    use super::*;

    fn say(ear: &Ear, sequence: u16, reply: Reply) {
        let mut buffer = [0; LARGEST_FRAME];
        let answer = Answer { sequence, reply };
        ear.take(&mut Decoder::new(), encode(&answer, &mut buffer).unwrap(), Instant::now());
    }

    #[test]
    fn an_event_of_an_older_request_of_the_same_number_is_no_news() {
        let ear = Ear::new(Arc::default());
        let arrived = |pan_mdeg| Reply::Arrived { pan_mdeg, tilt_mdeg: 0 };
        let heard = |sequence| match ear.event(sequence, Duration::ZERO) {
            Some(Reply::Arrived { pan_mdeg, .. }) => Some(pan_mdeg),
            _ => None,
        };
        say(&ear, 7, arrived(1));
        say(&ear, 8, arrived(2));
        ear.expect(7, &Command::Home);
        assert_eq!(heard(7), None);
        assert_eq!(heard(8), Some(2), "another request's event stays");
        say(&ear, 7, arrived(3));
        assert_eq!(heard(7), Some(3));
    }

    #[test]
    fn only_records_of_the_last_start_of_the_tracker_are_passed_on() {
        let ear = Ear::new(Arc::default());
        let (sender, receiver) = std::sync::mpsc::channel();
        ear.send_records(sender);
        let record = |count| {
            let orientation = Orientation::Quaternion([1_000_000, 0, 0, 0]);
            Reply::Record(Record { at_us: 0, count, station: 1, status: 0, position_um: [0; 3], orientation })
        };
        let track = |sequence| {
            let tracking = Tracking { stations: 1, format: Format::Binary, output: Output::Quaternion };
            ear.expect(sequence, &Command::Track(tracking));
        };
        say(&ear, 3, record(1));
        track(4);
        say(&ear, 4, record(2));
        track(9);
        say(&ear, 4, record(3));
        say(&ear, 9, record(4));
        ear.forget();
        say(&ear, 9, record(5));
        let counts: Vec<u32> = receiver.try_iter().map(|(record, _)| record.count).collect();
        assert_eq!(counts, [2, 4]);
    }
}
