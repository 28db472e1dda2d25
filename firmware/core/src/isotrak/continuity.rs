//! Does a record follow from those before it?
//!
//! A leap that nothing could have made is held until [`LEAP_WITNESSES`] records agree; a change of the status character
//! until the next record repeats it.
//!
//! Position and orientation are also followed by a filter that learns how far they usually are from where it expects
//! them. A record farther off is held until the next one: if that comes back to the old course the held one was
//! damaged; if it follows the held one, the tracker did move, and both are good.

use rigel_protocol::{Orientation, Record};

use super::{Rejected, turn};

/// How many records in a row must agree before a leap is believed.
const LEAP_WITNESSES: u8 = 4;
/// Nobody swings a receiver faster than five metres per second …
const SPEED_UM_S: i64 = 5_000_000;
/// … or twenty radians per second: in a quaternion's components half as fast.
const TURN_MILLIONTHS_S: i64 = 10_000_000;
/// Half a centimetre and half a degree are no leap after however short a time.
const SLACK: [i64; 2] = [5_000, 5_000];
/// Stamps jitter: records are thought to be at least so far apart, about the time of one.
const SHORTEST_US: i64 = 16_667;
/// After so long without a good record nothing is known any more.
const FORGOTTEN_US: i64 = 1_000_000;
/// What is never suspicious: three units of the formats' last digits where a record says everything once …
const STRICT: Allowance = Allowance { floor: [300, 300], jitter_us: 1_000 };
/// … and half a centimetre and half a degree where two copies agree: only damage to both must be seen.
const LENIENT: Allowance = Allowance { floor: [5_000, 5_000], jitter_us: 100_000 };
/// How many times the usual distance is suspicious; for normal noise 5.6 standard deviations.
const SUSPICIOUS: i64 = 7;
/// The usual distance at first, until it is learnt.
const UNKNOWN: [i64; 2] = [2_000, 2_000];

/// How far a record may be from where it is expected: micrometres and millionths.
#[derive(Clone, Copy)]
struct Allowance {
    floor: [i64; 2],
    /// A stamp may be so late, and the record thus so much farther.
    jitter_us: i64,
}

/// What became of a record, and of one that was held before it: at most two verdicts, the older first.
pub(super) type Pair = [Option<Result<Record, Rejected>>; 2];

/// x, y, z in micrometres and w, x, y, z in millionths.
type Pose = [i64; 7];

fn pose(record: &Record) -> Pose {
    let [x, y, z] = record.position_um.map(i64::from);
    let [a, b, c, d] = match record.orientation {
        Orientation::Quaternion(q) => q.map(i64::from),
        Orientation::Euler(angles) => turn::quaternion(angles),
    };
    [x, y, z, a, b, c, d]
}

/// `pose` with its quaternion on the side of `other`'s: q and -q are the same orientation.
fn beside(mut pose: Pose, other: &Pose) -> Pose {
    if (3..7).map(|i| pose[i] * other[i]).sum::<i64>() < 0 {
        pose[3..].iter_mut().for_each(|q| *q = -*q);
    }
    pose
}

/// One station's course.
pub(super) struct Continuity {
    /// Whether the records' numbers are not proven by a second copy.
    strict: bool,
    course: Option<Course>,
    held: Option<Held>,
}

#[derive(Clone, Copy)]
struct Course {
    at_us: u64,
    status: u8,
    /// The last good record.
    last: Pose,
    /// Where the filter believes it to be.
    filtered: Pose,
    /// Units per second.
    velocity: Pose,
    /// The usual distance of a coordinate, of a component, sixteenfold.
    usual: [i64; 2],
}

#[derive(Clone, Copy)]
struct Held {
    record: Record,
    why: Rejected,
    /// How many records in a row agree with it, itself included, and how many must.
    witnesses: u8,
    needed: u8,
}

impl Continuity {
    pub(super) const fn new(strict: bool) -> Self {
        Self { strict, course: None, held: None }
    }

    /// Nothing follows any more: the verdict on the record that is held.
    pub(super) fn end(&mut self) -> Option<Result<Record, Rejected>> {
        self.held.take().map(|held| Err(held.why))
    }

    /// Judges a record and the one that was held before it. The first record, with nothing to compare it to, is believed
    /// unless `doubtful` or strict.
    pub(super) fn judge(&mut self, record: Record, doubtful: bool) -> Pair {
        let pose = pose(&record);
        let course = self.course.filter(|c| since_us(record.at_us, c.at_us) < FORGOTTEN_US);
        let suspicion = match &course {
            Some(course) => course.suspicion(&record, &pose, self.strict),
            None if self.strict || doubtful => Some((Rejected::Continuity, 2)),
            None => None,
        };
        let held = self.held.take();
        let Some((why, needed)) = suspicion else {
            self.course = Some(match course {
                Some(course) => course.followed(&record, &pose),
                None => Course::started(&record, &record, None),
            });
            return [held.map(|h| Err(h.why)), Some(Ok(record))];
        };
        match held {
            Some(held) if agree(&held.record, &record) => {
                let (witnesses, needed) = (held.witnesses + 1, held.needed);
                if witnesses >= needed {
                    self.course = Some(Course::started(&held.record, &record, course.map(|c| c.usual)));
                    return [Some(Ok(held.record)), Some(Ok(record))];
                }
                self.held = Some(Held { record, why, witnesses, needed });
                [Some(Err(held.why)), None]
            }
            held => {
                self.held = Some(Held { record, why, witnesses: 1, needed });
                [held.map(|h| Err(h.why)), None]
            }
        }
    }
}

impl Course {
    /// Why a record is suspicious, and how many must agree before it is believed; `None` if it is not.
    fn suspicion(&self, record: &Record, pose: &Pose, strict: bool) -> Option<(Rejected, u8)> {
        let pose = beside(*pose, &self.filtered);
        let elapsed_us = since_us(record.at_us, self.at_us);
        if !reachable(&self.last, &pose, elapsed_us) {
            return Some((Rejected::Continuity, LEAP_WITNESSES));
        }
        let allowance = if strict { STRICT } else { LENIENT };
        let expected = self.expected(elapsed_us);
        for (i, (at, expected)) in pose.iter().zip(expected).enumerate() {
            let kind = usize::from(i >= 3);
            let bound = allowance.floor[kind].max(SUSPICIOUS * self.usual[kind] / 16)
                + self.velocity[i].abs() * allowance.jitter_us / 1_000_000;
            if (at - expected).abs() > bound {
                return Some((Rejected::Continuity, 2));
            }
        }
        (record.status != self.status).then_some((Rejected::Status, 2))
    }

    fn expected(&self, elapsed_us: i64) -> Pose {
        core::array::from_fn(|i| self.filtered[i] + self.velocity[i] * elapsed_us / 1_000_000)
    }

    /// The course after a record that is not suspicious: an alpha-beta filter with alpha 1/2 and beta 1/6, which damps
    /// critically.
    fn followed(&self, record: &Record, pose: &Pose) -> Self {
        let pose = beside(*pose, &self.filtered);
        let elapsed_us = since_us(record.at_us, self.at_us).max(1_000);
        let expected = self.expected(elapsed_us);
        let off: Pose = core::array::from_fn(|i| pose[i] - expected[i]);
        let mean = |range: core::ops::Range<usize>| {
            let count = range.len() as i64;
            range.map(|i| off[i].abs() * 16).sum::<i64>() / count
        };
        Self {
            at_us: record.at_us,
            status: record.status,
            last: pose,
            filtered: core::array::from_fn(|i| expected[i] + off[i] / 2),
            velocity: core::array::from_fn(|i| self.velocity[i] + off[i] * 1_000_000 / (6 * elapsed_us)),
            usual: [
                self.usual[0] + (mean(0..3) - self.usual[0]) / 16,
                self.usual[1] + (mean(3..7) - self.usual[1]) / 16,
            ],
        }
    }

    /// The course that begins with two records that agree.
    fn started(first: &Record, second: &Record, usual: Option<[i64; 2]>) -> Self {
        let from = pose(first);
        let to = beside(pose(second), &from);
        let elapsed_us = since_us(second.at_us, first.at_us).max(SHORTEST_US);
        Self {
            at_us: second.at_us,
            status: second.status,
            last: to,
            filtered: to,
            velocity: core::array::from_fn(|i| (to[i] - from[i]) * 1_000_000 / elapsed_us),
            usual: core::array::from_fn(|kind| (16 * UNKNOWN[kind]).max(usual.map_or(0, |u| u[kind]))),
        }
    }
}

/// Whether something that is held and moved could have gone so far.
fn reachable(from: &Pose, to: &Pose, elapsed_us: i64) -> bool {
    let elapsed_us = elapsed_us.clamp(SHORTEST_US, FORGOTTEN_US);
    let speeds = [SPEED_UM_S, TURN_MILLIONTHS_S];
    (0..7).all(|i| {
        let kind = usize::from(i >= 3);
        (to[i] - from[i]).abs() <= SLACK[kind] + speeds[kind] * elapsed_us / 1_000_000
    })
}

/// Whether two suspicious records bear each other out.
fn agree(first: &Record, second: &Record) -> bool {
    let from = pose(first);
    let elapsed_us = since_us(second.at_us, first.at_us);
    first.status == second.status
        && elapsed_us < FORGOTTEN_US
        && reachable(&from, &beside(pose(second), &from), elapsed_us)
}

fn since_us(later: u64, earlier: u64) -> i64 {
    i64::try_from(later.saturating_sub(earlier)).unwrap_or(i64::MAX)
}
