//! The simulated board's line to a tracker: the firmware's own driver at the one end and a simulated tracker at the other.

use std::collections::VecDeque;

use rigel_firmware_core::isotrak::{Driver, TrackerOutput};
use rigel_protocol::{Answer, Command, Record, Reply, Request};

use crate::tracker::Tracker;

/// The line and both of its ends.
pub(super) struct SecondLine {
    driver: Driver,
    tracker: Tracker,
    /// What the tracker has said and the driver has not heard yet, each byte with its time.
    on_the_way: VecDeque<(u64, u8)>,
    now_us: u64,
}

impl SecondLine {
    pub fn new(tracker: Tracker) -> Self {
        Self { driver: Driver::new(), tracker, on_the_way: VecDeque::new(), now_us: 0 }
    }

    /// What the driver replies to a request.
    pub fn reply(&mut self, request: &Request, now_us: u64) -> Reply {
        let outcome = match request.command {
            Command::Track(tracking) => self.driver.track(tracking, request.sequence, now_us),
            _ => Ok(()),
        };
        outcome.map_or_else(Reply::Refused, |()| Reply::Tracker(self.driver.status()))
    }

    /// Does everything that was due until now, each thing at its own time.
    pub fn catch_up(&mut self, now_us: u64, said: &mut VecDeque<Answer>) {
        loop {
            while let Some(output) = self.driver.advance(self.now_us) {
                let reply = match output {
                    TrackerOutput::Send(bytes) => {
                        for &byte in bytes {
                            self.on_the_way.extend(self.tracker.hear(byte, self.now_us));
                        }
                        continue;
                    }
                    TrackerOutput::Record(record) => Reply::Record(record),
                    TrackerOutput::Status(status) => Reply::Tracker(status),
                    TrackerOutput::Log(text) => Reply::Log { text: text.try_into().unwrap_or_default() },
                };
                said.push_back(Answer { sequence: self.driver.sequence(), reply });
            }
            let first = self.on_the_way.front().map(|&(at_us, _)| at_us);
            let due = [first, self.tracker.next_us(), self.driver.next_us()];
            match due.into_iter().flatten().min() {
                Some(due_us) if due_us <= now_us => self.now_us = self.now_us.max(due_us),
                _ => break,
            }
            self.on_the_way.extend(self.tracker.advance(self.now_us));
            while let Some(&(at_us, byte)) =
                self.on_the_way.front().filter(|(at_us, _)| *at_us <= self.now_us)
            {
                self.driver.byte(byte, at_us);
                self.on_the_way.pop_front();
            }
        }
        self.now_us = now_us;
    }

    /// The records that the tracker has truly said since this was last asked.
    pub fn take_said(&mut self) -> Vec<Record> {
        self.tracker.take_said()
    }
}
