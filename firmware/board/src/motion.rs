//! The task that owns the rig: it alone works the pins, and only the time and a message wake it.

use core::sync::atomic::{AtomicBool, Ordering};

use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_time::{Duration, Instant, Timer};
use heapless::String;
use rigel_firmware_core::{Controller, Handled, Notice, Pins};
use rigel_protocol::{Answer, Reply, Request};

use crate::{host, tracker};

/// How often this task shows that it lives.
const PULSE: Duration = Duration::from_millis(100);

/// What this task is told.
pub enum Heard {
    /// By the host.
    Request(Request),
    /// By the line to the host: a damaged or unknown frame.
    Noise,
    /// By the tracker's task, about the request that was passed to it.
    Tracker(Reply),
}

/// What this task is told.
pub static HEARD: Channel<CriticalSectionRawMutex, Heard, 4> = Channel::new();

/// Set by this task, cleared by the one that feeds the watchdog.
pub static ALIVE: AtomicBool = AtomicBool::new(false);

/// Obeys the host and steps the motors.
pub async fn run(mut controller: Controller, mut pins: impl Pins, last_words: Option<String<60>>) -> ! {
    let mut last_words = Notice::new(last_words);
    // The request that the tracker's task has not answered: said again meanwhile, it is not passed on again.
    let mut with_tracker = None;
    loop {
        let pulse = Instant::now() + PULSE;
        let due = controller.next_us().map_or(pulse, |us| Instant::from_micros(us).min(pulse));
        match select(HEARD.receive(), Timer::at(due)).await {
            Either::First(Heard::Request(request)) => {
                let handled = controller.handle(&request, now_us(), &mut pins);
                let words = last_words.after(&request, &handled);
                match handled {
                    Handled::Answer(answer) => say(answer),
                    Handled::Tracker if with_tracker == Some(request.sequence) => {}
                    // One that finds no room is passed on when it is said again.
                    Handled::Tracker => {
                        if tracker::REQUESTS.try_send(request.clone()).is_ok() {
                            with_tracker = Some(request.sequence);
                        }
                    }
                }
                if let Some(words) = words {
                    say(words);
                }
            }
            Either::First(Heard::Noise) => controller.bad_frame(),
            Either::First(Heard::Tracker(reply)) => {
                with_tracker = None;
                say(controller.remember(reply));
            }
            Either::Second(()) => {}
        }
        while let Some(due_us) = controller.next_us().filter(|&due_us| due_us <= now_us()) {
            if let Some(event) = controller.advance(done_us(due_us), &mut pins) {
                say(event);
            }
        }
        ALIVE.store(true, Ordering::Relaxed);
    }
}

fn say(answer: Answer) {
    let _ = host::ANSWERS.try_send(answer);
}

/// The rig's clock.
pub fn now_us() -> u64 {
    Instant::now().as_micros()
}

/// When what is due at `due_us` is done: now, at last.
#[cfg(not(feature = "emulator"))]
fn done_us(_due_us: u64) -> u64 {
    now_us()
}

#[cfg(feature = "emulator")]
use crate::emulator::done_us;
