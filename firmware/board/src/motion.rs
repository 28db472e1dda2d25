//! The task that owns the rig: it alone steps, and nothing but the time and a request wakes it.

use core::sync::atomic::{AtomicBool, Ordering};

use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Instant, Timer};
use heapless::String;
use rigel_firmware_core::{Controller, Pins};
use rigel_protocol::{Answer, Command, Reply};

use crate::host::{ANSWERS, HEARD};

/// Set by this task, cleared by the one that feeds the watchdog.
pub static ALIVE: AtomicBool = AtomicBool::new(false);

/// Obeys the host and steps the motors.
pub async fn run(mut controller: Controller, mut pins: impl Pins, mut last_words: Option<String<60>>) -> ! {
    loop {
        match select(HEARD.receive(), Timer::after(Duration::from_millis(1))).await {
            Either::First(Some(request)) => {
                let sequence = request.sequence;
                let greeting = matches!(request.command, Command::Hello { .. });
                say(controller.handle(request, now_us()));
                if greeting && let Some(text) = last_words.take() {
                    say(Answer { sequence, reply: Reply::Log { text } });
                }
            }
            Either::First(None) => {}
            Either::Second(()) => {}
        }
        if let Some(event) = controller.tick(now_us()) {
            say(event);
        }
        let _ = &mut pins;
        ALIVE.store(true, Ordering::Relaxed);
    }
}

fn say(answer: Answer) {
    // What finds no room is lost; the host asks for it.
    let _ = ANSWERS.try_send(answer);
}

fn now_us() -> u64 {
    Instant::now().as_micros()
}
