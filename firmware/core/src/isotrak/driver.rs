//! Starts a tracker, watches it, starts it again.

use heapless::Deque;
use rigel_protocol::{Fault, Format, Output, Record, TrackerState, TrackerStatus, Tracking};

use super::ladder::{self, Step, Wait};
use super::watch::Watch;
use super::{Layout, List, Parser, Verdicts};

/// A running tracker that says nothing for so long, sixty periods, is silent.
const SILENT_US: u64 = 1_000_000;
/// A running tracker that talks for so long without a whole record babbles.
const BABBLE_US: u64 = 1_000_000;
/// A tracker that ran for so long has recovered: the next failure is its first.
const RECOVERED_US: u64 = 10_000_000;
/// At which failure in a row the tracker's own program is started again.
const FAILURES_BEFORE_REINITIALISING: u8 = 3;
/// Records that wait to be fetched.
const ROOM: usize = 8;

/// What the driver wants done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TrackerOutput {
    /// These bytes are to be sent to the tracker.
    Send(&'static [u8]),
    /// A record is to be forwarded, see [`Driver::sequence`].
    Record(Record),
    /// The tracker's state has changed.
    Status(TrackerStatus),
    /// People should know this; at most 60 characters.
    Log(&'static str),
}

/// The mind that owns the tracker's line. It does no input or output: it is told what was heard and when, and asked what
/// to do.
pub struct Driver {
    tracking: Tracking,
    sequence: u16,
    phase: Phase,
    status: TrackerStatus,
    parser: Parser,
    records: Deque<Record, ROOM>,
    watch: Watch,
    count: u32,
    status_due: bool,
    log: Option<&'static str>,
    /// For what the next start asks.
    list: List,
    failures: u8,
    since_us: u64,
    heard_us: u64,
    whole_us: u64,
    whole: u32,
    /// The skipped bytes of the parsers before this one.
    skipped: u32,
    reply: [u8; 8],
    reply_length: usize,
}

/// What the driver is about.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    Off,
    /// The step is to be sent.
    Enter(u8),
    /// The step was sent at `since_us`.
    Within(u8),
    /// The tracker's own program is to be started.
    Reinitialise,
    /// It starts, since `since_us`.
    Reinitialising,
    /// Records come, since `since_us`.
    Running,
}

const OFF: Tracking = Tracking { stations: 0, format: Format::Ascii, output: Output::Quaternion };
const STATUS: TrackerStatus = TrackerStatus {
    state: TrackerState::Off,
    forwarded: 0,
    rejected: 0,
    skipped_bytes: 0,
    overrun: 0,
    restarts: 0,
};

const fn layout(tracking: Tracking, list: List) -> Layout {
    let format = if matches!(list, List::Cosines) { Format::Ascii } else { tracking.format };
    Layout { format, output: tracking.output, list }
}

const fn parser(tracking: Tracking, list: List) -> Parser {
    Parser::new(layout(tracking, list), tracking.stations)
}

impl Default for Driver {
    fn default() -> Self {
        Self::new()
    }
}

impl Driver {
    /// A driver whose tracker nobody has asked for.
    pub const fn new() -> Self {
        Self {
            tracking: OFF,
            sequence: 0,
            phase: Phase::Off,
            status: STATUS,
            parser: parser(OFF, List::Once),
            records: Deque::new(),
            watch: Watch::new(),
            count: 0,
            status_due: false,
            log: None,
            list: List::Twice,
            failures: 0,
            since_us: 0,
            heard_us: 0,
            whole_us: 0,
            whole: 0,
            skipped: 0,
            reply: [0; 8],
            reply_length: 0,
        }
    }

    /// Starts the tracker anew, or switches it off with 0 stations: then its counts stay. `sequence` is that of the request.
    ///
    /// # Errors
    /// [`Fault::Senseless`] for more than two stations; nothing has changed then.
    pub fn track(&mut self, tracking: Tracking, sequence: u16, now_us: u64) -> Result<(), Fault> {
        if tracking.stations > 2 {
            return Err(Fault::Senseless);
        }
        let off = tracking.stations == 0;
        let counts = if off { self.status() } else { STATUS };
        *self = Self { tracking, sequence, since_us: now_us, heard_us: now_us, ..Self::new() };
        // Its parser is a new one.
        self.skipped = counts.skipped_bytes;
        self.status = counts;
        self.parser = parser(tracking, self.list);
        // Off takes the first steps of the ladder too: a return and the end of continuous output.
        self.phase = Phase::Enter(0);
        self.status.state = if off { TrackerState::Off } else { TrackerState::Starting };
        self.status_due = true;
        Ok(())
    }

    /// The sequence number of the request that records belong to.
    pub fn sequence(&self) -> u16 {
        self.sequence
    }

    /// How the tracker is.
    pub fn status(&self) -> TrackerStatus {
        let skipped_bytes = self.skipped.saturating_add(self.parser.skipped_bytes());
        TrackerStatus { skipped_bytes, ..self.status.clone() }
    }

    /// The record that [`Driver::advance`] gave last found no room on its way.
    pub fn lost(&mut self) {
        self.status.forwarded = self.status.forwarded.saturating_sub(1);
        self.status.overrun = self.status.overrun.saturating_add(1);
    }

    /// Hears bytes of which the first came at `at_us`. Fetch what [`Driver::advance`] has to say at least every 128 bytes:
    /// eight records wait, further ones are counted as overrun.
    pub fn bytes(&mut self, bytes: &[u8], at_us: u64) {
        for &byte in bytes {
            self.byte(byte, at_us);
        }
    }

    /// Hears a byte that came at `at_us`.
    pub fn byte(&mut self, byte: u8, at_us: u64) {
        self.heard_us = at_us;
        match self.phase {
            Phase::Running => self.parse(|parser| parser.push(byte, at_us), at_us),
            Phase::Within(number) if self.step(number).wait == Wait::Record => {
                self.parse(|parser| parser.push(byte, at_us), at_us);
            }
            Phase::Within(_) => {
                if let Some(place) = self.reply.get_mut(self.reply_length) {
                    *place = byte;
                    self.reply_length += 1;
                }
            }
            _ => {}
        }
    }

    /// When [`Driver::advance`] wants to be called at the latest; `None` while there is nothing to wait for.
    pub fn next_us(&self) -> Option<u64> {
        if self.status_due || self.log.is_some() || !self.records.is_empty() {
            return Some(0);
        }
        match self.phase {
            Phase::Off => None,
            Phase::Enter(_) | Phase::Reinitialise => Some(0),
            Phase::Reinitialising => Some(self.since_us.saturating_add(ladder::REINITIALISE_US)),
            Phase::Running => {
                let silent_us = self.heard_us.saturating_add(SILENT_US);
                let due_us = silent_us.min(self.whole_us.saturating_add(BABBLE_US));
                Some(self.parser.next_us().map_or(due_us, |us| us.min(due_us)))
            }
            Phase::Within(number) => {
                let limit_us = self.since_us.saturating_add(ladder::LIMIT_US);
                let quiet_us = self.heard_us.max(self.since_us).saturating_add(ladder::QUIET_US);
                Some(match self.step(number).wait {
                    Wait::Pause => self.since_us.saturating_add(ladder::PAUSE_US),
                    Wait::Quiet => quiet_us.min(limit_us),
                    Wait::Status | Wait::Stations if self.reply_length > 0 => quiet_us.min(limit_us),
                    Wait::Status | Wait::Stations => limit_us,
                    Wait::Record => self.parser.next_us().map_or(limit_us, |us| us.min(limit_us)),
                })
            }
        }
    }

    /// Does what is due; call again until `None`.
    pub fn advance(&mut self, now_us: u64) -> Option<TrackerOutput> {
        self.parse(|parser| parser.advance(now_us), now_us);
        if let Some(record) = self.records.pop_front() {
            self.status.forwarded = self.status.forwarded.saturating_add(1);
            return Some(TrackerOutput::Record(record));
        }
        // A step without bytes is followed by the next at once, and a wait that has ended by a step: a few rounds.
        for _ in 0..4 {
            if core::mem::take(&mut self.status_due) {
                return Some(TrackerOutput::Status(self.status()));
            }
            if let Some(text) = self.log.take() {
                return Some(TrackerOutput::Log(text));
            }
            match self.phase {
                Phase::Off => return None,
                Phase::Enter(number) => {
                    (self.since_us, self.reply_length) = (now_us, 0);
                    let Step { send, wait } = self.step(number);
                    self.phase = Phase::Within(number);
                    if wait == Wait::Record {
                        self.start_listening(now_us);
                    }
                    if !send.is_empty() {
                        return Some(TrackerOutput::Send(send));
                    }
                }
                Phase::Reinitialise => {
                    self.since_us = now_us;
                    self.phase = Phase::Reinitialising;
                    return Some(TrackerOutput::Send(ladder::REINITIALISE));
                }
                Phase::Reinitialising => {
                    if now_us < self.since_us.saturating_add(ladder::REINITIALISE_US) {
                        return None;
                    }
                    self.phase = Phase::Enter(0);
                }
                Phase::Running => self.supervise(now_us),
                Phase::Within(number) if self.next_us().is_none_or(|due_us| now_us < due_us) => {
                    let running = self.step(number).wait == Wait::Record && self.whole > 0;
                    if !running {
                        return None;
                    }
                    self.phase = Phase::Running;
                    self.since_us = now_us;
                    self.set(TrackerState::Running);
                    self.log = match self.list {
                        List::Twice => None,
                        List::Cosines => Some("tracker: no copies, a damaged position may pass"),
                        List::Once => Some("tracker: it lists once only, damage may pass"),
                    };
                }
                Phase::Within(number) => self.wait_ended(number, now_us),
            }
            if self.phase == Phase::Running && !self.status_due && self.log.is_none() {
                return None;
            }
        }
        None
    }

    fn step(&self, number: u8) -> Step {
        ladder::step(number, self.tracking, layout(self.tracking, self.list))
    }

    /// A step's time is over: was it what was waited for?
    fn wait_ended(&mut self, number: u8, now_us: u64) {
        let talks = now_us < self.heard_us.saturating_add(ladder::QUIET_US);
        let reply = self.reply.get(..self.reply_length).unwrap_or_default();
        let failure = match self.step(number).wait {
            Wait::Quiet if talks => Some("tracker: it does not fall silent"),
            Wait::Status if reply.is_empty() => Some("tracker: it does not answer"),
            Wait::Status if reply.first() != Some(&b'2') => Some("tracker: its status is not understood"),
            Wait::Record => Some("tracker: no record came"),
            Wait::Stations => {
                // Not every tracker tells; one that does is believed.
                if let [b'2', _, b'l', first, second, ..] = *reply
                    && (first != b'1' || (self.tracking.stations == 2 && second != b'1'))
                {
                    self.log = Some("tracker: a receiver that was asked for is not there");
                }
                None
            }
            Wait::Pause | Wait::Quiet | Wait::Status => None,
        };
        match failure {
            Some(text) => {
                // Perhaps the list was not to its liking.
                if self.step(number).wait == Wait::Record {
                    self.list = match self.list {
                        List::Twice => List::Cosines,
                        List::Cosines => List::Once,
                        List::Once => List::Twice,
                    };
                }
                self.fail(text);
            }
            None if self.tracking.stations == 0 && number == 1 => self.phase = Phase::Off,
            None => self.phase = Phase::Enter(number + 1),
        }
    }

    fn start_listening(&mut self, now_us: u64) {
        self.refuse_the_rest();
        self.parser = parser(self.tracking, self.list);
        self.watch = Watch::new();
        (self.whole, self.heard_us, self.whole_us) = (0, now_us, now_us);
    }

    /// Looks after a running tracker.
    fn supervise(&mut self, now_us: u64) {
        if now_us >= self.heard_us.saturating_add(SILENT_US) {
            self.fail("tracker: it has fallen silent");
        } else if now_us >= self.whole_us.saturating_add(BABBLE_US) {
            self.fail("tracker: it talks but no record is whole");
        } else {
            if now_us >= self.since_us.saturating_add(RECOVERED_US) {
                self.failures = 0;
            }
            self.log = self.watch.finding(self.tracking.stations, now_us);
        }
    }

    fn fail(&mut self, text: &'static str) {
        self.refuse_the_rest();
        self.failures = self.failures.saturating_add(1);
        self.status.restarts = self.status.restarts.saturating_add(1);
        self.log = Some(text);
        self.set(TrackerState::Silent);
        self.phase = if self.failures >= FAILURES_BEFORE_REINITIALISING {
            self.failures = 0;
            Phase::Reinitialise
        } else {
            Phase::Enter(0)
        };
    }

    fn set(&mut self, state: TrackerState) {
        self.status_due |= self.status.state != state;
        self.status.state = state;
    }

    /// Ends the parser: what it still holds is refused, what it counted is kept.
    fn refuse_the_rest(&mut self) {
        let rest = self.parser.finish();
        self.status.rejected = self.status.rejected.saturating_add(rest.count() as u32);
        self.skipped = self.skipped.saturating_add(self.parser.skipped_bytes());
        self.parser = parser(self.tracking, self.list);
    }

    fn parse(&mut self, hear: impl FnOnce(&mut Parser) -> Verdicts, at_us: u64) {
        for verdict in hear(&mut self.parser) {
            match verdict {
                Ok(record) => self.accept(record),
                Err(_) => self.status.rejected = self.status.rejected.saturating_add(1),
            }
        }
        if self.parser.whole_records() != self.whole {
            self.whole = self.parser.whole_records();
            self.whole_us = at_us;
        }
    }

    fn accept(&mut self, record: Record) {
        self.watch.push(&record);
        let record = Record { count: self.count, ..record };
        self.count = self.count.wrapping_add(1);
        if self.records.push_back(record).is_err() {
            self.status.overrun = self.status.overrun.saturating_add(1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONCE_ONLY: &str = "tracker: it lists once only, damage may pass";
    const NO_COPIES: &str = "tracker: no copies, a damaged position may pass";

    /// What the driver logs about a tracker that sends a record where this is the list that it was told.
    fn logs(list: &[u8]) -> std::vec::Vec<&'static str> {
        let (mut driver, mut now_us, mut obeys, mut logs) = (Driver::new(), 0, false, std::vec::Vec::new());
        let tracking = Tracking { stations: 1, format: Format::Ascii, output: Output::Euler };
        driver.track(tracking, 1, now_us).unwrap();
        let numbers = "   0.89   0.04   1.82   0.00   0.00   0.00";
        let line = match list {
            b"O2,4,1\r" => numbers.into(),
            b"O2,4,5,6,7,1\r" => {
                let [zero, one] = [" 0.0000", " 1.0000"];
                format!("{numbers}{one}{zero}{zero}{zero}{one}{zero}{zero}{zero}{one}")
            }
            _ => numbers.repeat(2),
        };
        while driver.status().state != TrackerState::Running || logs.is_empty() && now_us < 3_000_000 {
            now_us = driver.next_us().unwrap().max(now_us + 1_000);
            while let Some(output) = driver.advance(now_us) {
                match output {
                    TrackerOutput::Send(sent @ [b'O', ..]) => obeys = sent == list,
                    TrackerOutput::Send(b"S") => driver.bytes(b"2\r\n", now_us),
                    TrackerOutput::Send(b"C") if obeys => {
                        driver.bytes(format!("01 {line}\r\n").as_bytes(), now_us);
                    }
                    TrackerOutput::Log(text) => logs.push(text),
                    _ => {}
                }
            }
            assert!(now_us < 20_000_000, "it does not run: {logs:?}");
        }
        logs
    }

    #[test]
    fn a_list_without_copies_is_told() {
        let none = "tracker: no record came";
        assert_eq!(logs(b"O2,4,5,6,7,1\r"), [none, NO_COPIES]);
        assert_eq!(logs(b"O2,4,1\r"), [none, none, ONCE_ONLY]);
        assert!(!logs(b"O2,4,2,4,1\r").contains(&ONCE_ONLY));
        assert!(ONCE_ONLY.len() <= 60 && NO_COPIES.len() <= 60);
    }

    #[test]
    fn it_is_small() {
        // Of the rig's 16 KiB of memory.
        assert!(size_of::<Driver>() <= 1_536, "{}", size_of::<Driver>());
    }
}
