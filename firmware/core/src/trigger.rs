//! A bracket of photographs on the camera's contacts.
//!
//! The half-press is held from the start to the end of the bracket, a pause after the last contact has opened:
//! a slow camera still exposes then. Every photograph's contact is closed for its time,
//! counted from the moment at which it did close. Where a flash-sync is wired, the next photograph does not begin before
//! this one was confirmed or its time to be confirmed was over: a flash-sync within that time never confirms another one.

use rigel_protocol::Bracket;

use crate::pins::Pins;

/// How often the flash-sync is looked at while it may come.
const LOOK_US: u64 = 1_000;

/// A bracket on its way.
pub(crate) struct Trigger {
    bracket: Bracket,
    index: u8,
    confirmed: u8,
    phase: Phase,
    /// When there is something to do.
    pub due_us: u64,
}

#[derive(Debug, Clone, Copy)]
enum Phase {
    /// The next photograph begins when it is due.
    Waiting,
    /// The contact is closed.
    Closed { at_us: u64, confirmed: bool },
    /// The contact is open again; its flash-sync may still come.
    Open { at_us: u64, opened_us: u64, confirmed: bool },
    /// Every photograph is taken; the pause after the last is not over.
    Taken,
    /// Told to stop.
    Stopped,
}

/// What is to be told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Event {
    Exposed { index: u8, at_us: u64, confirmed: bool },
    Triggered { exposed: u8, confirmed: u8 },
    Stopped,
}

impl Trigger {
    /// Begins a bracket; `None` when it has no photograph, or one of no time.
    pub fn start(bracket: &Bracket, now_us: u64, pins: &mut impl Pins) -> Option<Self> {
        if bracket.pulses_us.is_empty() || bracket.pulses_us.contains(&0) {
            return None;
        }
        if bracket.half_press_ms > 0 {
            pins.set_half_press(true);
        }
        let due_us = now_us.saturating_add(us(bracket.half_press_ms));
        Some(Self { bracket: bracket.clone(), index: 0, confirmed: 0, phase: Phase::Waiting, due_us })
    }

    /// The longest time that it can take, microseconds.
    pub fn longest_us(&self) -> u64 {
        let Bracket { half_press_ms, pulses_us, pause_ms, confirm_ms } = &self.bracket;
        let each_us = |pulse_us: &u32| (u64::from(*pulse_us) + us(*pause_ms)).max(us(*confirm_ms));
        us(*half_press_ms) + pulses_us.iter().map(each_us).sum::<u64>()
    }

    /// How many photographs were taken and how many of them were confirmed.
    pub fn taken(&self) -> (u8, u8) {
        (self.index, self.confirmed)
    }

    /// Opens the contacts and ends the bracket. A photograph whose contact has closed was taken.
    pub fn stop(&mut self, now_us: u64, pins: &mut impl Pins) {
        if let Phase::Closed { at_us, confirmed } | Phase::Open { at_us, confirmed, .. } = self.phase {
            let confirmed = confirmed || self.look(at_us, now_us, pins);
            self.index += 1;
            self.confirmed += u8::from(confirmed);
        }
        pins.set_shutter(false);
        pins.set_half_press(false);
        self.phase = Phase::Stopped;
        self.due_us = now_us;
    }

    /// Does what is due, if anything is.
    pub fn advance(&mut self, now_us: u64, pins: &mut impl Pins) -> Option<Event> {
        if now_us < self.due_us {
            return None;
        }
        match self.phase {
            Phase::Waiting => {
                // A flash-sync from before belongs to no photograph.
                pins.take_flash_sync();
                pins.set_shutter(true);
                self.enter(Phase::Closed { at_us: now_us, confirmed: false }, now_us);
                None
            }
            Phase::Closed { at_us, confirmed } => {
                let confirmed = confirmed || self.look(at_us, now_us, pins);
                if now_us >= at_us.saturating_add(self.pulse_us()) {
                    pins.set_shutter(false);
                    self.enter(Phase::Open { at_us, opened_us: now_us, confirmed }, now_us);
                } else {
                    self.enter(Phase::Closed { at_us, confirmed }, now_us);
                }
                None
            }
            Phase::Open { at_us, opened_us, confirmed } => {
                let confirmed = confirmed || self.look(at_us, now_us, pins);
                if !confirmed && now_us < self.window_us(at_us) {
                    self.enter(Phase::Open { at_us, opened_us, confirmed }, now_us);
                    return None;
                }
                let index = self.index;
                self.index += 1;
                self.confirmed += u8::from(confirmed);
                let more = usize::from(self.index) < self.bracket.pulses_us.len();
                self.phase = if more { Phase::Waiting } else { Phase::Taken };
                self.due_us = opened_us.saturating_add(us(self.bracket.pause_ms));
                Some(Event::Exposed { index, at_us, confirmed })
            }
            Phase::Taken => {
                pins.set_half_press(false);
                Some(Event::Triggered { exposed: self.index, confirmed: self.confirmed })
            }
            Phase::Stopped => Some(Event::Stopped),
        }
    }

    fn enter(&mut self, phase: Phase, now_us: u64) {
        self.phase = phase;
        self.due_us = match phase {
            Phase::Closed { at_us, confirmed } => {
                let end_us = at_us.saturating_add(self.pulse_us());
                if self.may_be_confirmed(at_us, now_us, confirmed) {
                    end_us.min(now_us + LOOK_US)
                } else {
                    end_us
                }
            }
            Phase::Open { at_us, confirmed, .. } if self.may_be_confirmed(at_us, now_us, confirmed) => {
                self.window_us(at_us).min(now_us + LOOK_US)
            }
            _ => now_us,
        };
    }

    /// The end of the time in which a photograph can be confirmed.
    fn window_us(&self, at_us: u64) -> u64 {
        at_us.saturating_add(us(self.bracket.confirm_ms))
    }

    fn may_be_confirmed(&self, at_us: u64, now_us: u64, confirmed: bool) -> bool {
        !confirmed && now_us < self.window_us(at_us)
    }

    /// Whether the flash-sync has come, if it still counts: a call that comes late still counts what came before it.
    fn look(&self, at_us: u64, now_us: u64, pins: &mut impl Pins) -> bool {
        self.bracket.confirm_ms > 0 && now_us <= self.window_us(at_us) + LOOK_US && pins.take_flash_sync()
    }

    fn pulse_us(&self) -> u64 {
        self.bracket.pulses_us.get(usize::from(self.index)).copied().unwrap_or(0).into()
    }
}

fn us(ms: u16) -> u64 {
    u64::from(ms) * 1_000
}
