//! The tracker on the rig: its records with the host's time.

use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use rigel_protocol::{Command, Fault, Format, Output, Record, Reply, TrackerStatus, Tracking};

use super::clock::Moment;
use super::conversation::SerialRig;
use super::link::Link;
use crate::Result;
use crate::tracker::TrackerRecord;

/// How often the rig is asked for the time until its clock is known well, and from then on.
const SOON: Duration = Duration::from_millis(50);
const LATER: Duration = Duration::from_millis(500);
/// After so long its clock is known well.
const WELL_KNOWN: Duration = Duration::from_secs(10);
/// How often it is asked before the first record: the shortest round trip counts.
const PINGS: u32 = 8;

/// How long the asking in the background may take to end.
const GOODBYE: Duration = Duration::from_millis(250);

/// Where a tracker's records arrive, whoever else talks to the rig meanwhile.
pub struct Records {
    link: Link,
    receiver: Receiver<(Record, Option<Moment>)>,
    /// Of each station the last record's time, and by how much that can be wrong, seconds.
    last: Cell<[Option<(SystemTime, f64)>; 2]>,
}

impl Records {
    /// The next record, or `None` when none comes within `time`. A station's times grow: where the rig's clock was learnt
    /// better since the last record, the next one waits for it within the bounds of both, and its bound says so.
    pub fn next(&self, time: Duration) -> Option<TrackerRecord> {
        let deadline = Instant::now() + time;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let (record, moment) = match self.receiver.recv_timeout(left) {
                Ok(received) => received,
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => return None,
            };
            // A record from before the first ping of a rig that has restarted has no time: it is the old conversation's.
            let Some(moment) = moment else { continue };
            let at = self.link.ear().system_time(moment);
            let mut last = self.last.get();
            let before = &mut last[usize::from(record.station == 2)];
            let (at, bound_s) = after(*before, at, moment.bound_s);
            *before = Some((at, bound_s));
            // No rig forwards the quaternion zero: it is left out, and its number is a gap.
            if let Some(record) = TrackerRecord::new(at, bound_s, &record) {
                self.last.set(last);
                return Some(record);
            }
        }
    }
}

impl Records {
    /// Switches the tracker off; what has not been received by now is lost. A rig that does not answer is no more than a
    /// notice: the records are here.
    pub(crate) fn switch_off(&self) {
        let off = Tracking { stations: 0, format: Format::Binary, output: Output::Quaternion };
        if let Err(error) = self.link.ask(&Command::Track(off)) {
            self.link.notices().tell(format!("the tracker was not switched off: {error}"));
        }
    }
}

impl SerialRig {
    /// Starts the tracker anew (or switches it off: 0 stations); its records go to [`SerialRig::records`]. A rig that
    /// restarts is told again.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the rig does not answer or refuses.
    pub fn track(&mut self, tracking: Tracking) -> Result<()> {
        self.tracking = Some(tracking);
        if !self.begin(tracking)? {
            self.greet_again()?;
        }
        self.pinger = (tracking.stations > 0).then(|| Pinger::start(self.link.clone()));
        Ok(())
    }

    /// What [`SerialRig::greet_again`] owes to the tracker.
    pub(super) fn track_again(&mut self) -> Result<()> {
        match self.tracking {
            Some(tracking) if !self.begin(tracking)? => {
                Err(self.link.error("the rig restarts again and again", "check its power supply"))
            }
            _ => Ok(()),
        }
    }

    /// False when the rig has restarted.
    fn begin(&self, tracking: Tracking) -> Result<bool> {
        for _ in 0..PINGS {
            self.link.ping()?;
        }
        match self.link.ask(&Command::Track(tracking))?.reply {
            Reply::Accepted { .. } | Reply::Tracker(_) => Ok(true),
            Reply::Refused(Fault::NoHello) => Ok(false),
            Reply::Refused(fault) => {
                let what = format!("the rig refuses to start its tracker: {fault:?}");
                Err(self.link.error(what, "choose 1 or 2 stations"))
            }
            reply => Err(self.link.confused(&reply)),
        }
    }

    /// Where the tracker's records arrive from now on; who asked before hears no more.
    pub fn records(&mut self) -> Records {
        let (sender, receiver) = channel();
        self.link.ear().send_records(sender);
        Records { link: self.link.clone(), receiver, last: Cell::default() }
    }

    /// How the tracker is.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the rig does not answer.
    pub fn tracker(&mut self) -> Result<TrackerStatus> {
        for _ in 0..2 {
            match self.link.ask(&Command::Tracker)?.reply {
                Reply::Tracker(status) => return Ok(status),
                Reply::Refused(Fault::NoHello) => self.greet_again()?,
                reply => return Err(self.link.confused(&reply)),
            }
        }
        Err(self.link.error("the rig restarts again and again", "check its power supply"))
    }
}

/// A record's time and its bound, seconds, after the one before it: one that seems to be earlier, by no more than both can
/// be wrong, is put right behind it.
fn after(before: Option<(SystemTime, f64)>, at: SystemTime, bound_s: f64) -> (SystemTime, f64) {
    let Some((last, last_bound_s)) = before else { return (at, bound_s) };
    let next = last + Duration::from_micros(1);
    match next.duration_since(at) {
        Ok(early) if !early.is_zero() && early.as_secs_f64() <= bound_s + last_bound_s => {
            (next, bound_s + early.as_secs_f64())
        }
        _ => (at, bound_s),
    }
}

/// Asks the rig for the time, in the background, as long as records come.
pub(super) struct Pinger {
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Pinger {
    fn start(link: Link) -> Self {
        let ended = Arc::new(AtomicBool::new(false));
        let thread = {
            let ended = ended.clone();
            std::thread::spawn(move || {
                let start = Instant::now();
                while !ended.load(Ordering::Relaxed) {
                    // What goes wrong here goes wrong for whoever needs the rig, and is told there.
                    let _ = link.ping();
                    std::thread::park_timeout(if start.elapsed() < WELL_KNOWN { SOON } else { LATER });
                }
            })
        };
        Self { ended, thread: Some(thread) }
    }
}

impl Drop for Pinger {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // The port is closed when it has ended; where it waits for a rig that is unplugged nobody waits for it.
            let patience = Instant::now() + GOODBYE;
            while !thread.is_finished() && Instant::now() < patience {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_grow_as_far_as_the_bounds_allow() {
        let time = |ms: u64| SystemTime::UNIX_EPOCH + Duration::from_millis(ms);
        assert_eq!(after(None, time(5), 0.001), (time(5), 0.001));
        assert_eq!(after(Some((time(4), 0.001)), time(5), 0.001), (time(5), 0.001));
        let (at, bound_s) = after(Some((time(7), 0.002)), time(5), 0.001);
        assert!(at > time(7) && at < time(8), "{at:?}");
        // The bound still holds what was measured.
        assert!((0.003..0.0031).contains(&bound_s), "{bound_s}");
        // Something else than the bounds is wrong: nothing is covered up.
        assert_eq!(after(Some((time(90), 0.002)), time(5), 0.001), (time(5), 0.001));
    }
}
