//! The line to the tracker.

use embassy_futures::select::{Either3, select3};
use embassy_stm32::usart::{BufferedUartRx, BufferedUartTx};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_time::{Instant, Timer};
use embedded_io_async::{Read, Write};
use rigel_firmware_core::isotrak::{Driver, TrackerOutput};
use rigel_protocol::{Answer, Command, Reply, Request};

use crate::motion::{HEARD, Heard, now_us};
use crate::{BAUD, host};

/// The requests that are the tracker's: of two at once one is not answered, and asked again.
pub static REQUESTS: Channel<CriticalSectionRawMutex, Request, 1> = Channel::new();

/// Start, eight bits, stop.
pub const BYTE_US: u64 = 10 * 1_000_000 / BAUD as u64;

/// Runs the tracker's driver.
#[embassy_executor::task]
pub async fn run(mut say: BufferedUartTx<'static>, mut hear: BufferedUartRx<'static>) -> ! {
    let mut driver = Driver::new();
    let mut bytes = [0; 64];
    let mut line = Line::new();
    loop {
        let due = driver.next_us().map(|us| line.wake_us(us, now_us()));
        let due = due.map_or(Instant::MAX, Instant::from_micros);
        match select3(REQUESTS.receive(), hear.read(&mut bytes), Timer::at(due)).await {
            Either3::First(Request { sequence, command }) => {
                let outcome = match command {
                    Command::Track(tracking) => driver.track(tracking, sequence, line.now_us(now_us())),
                    _ => Ok(()),
                };
                let reply = outcome.map_or_else(Reply::Refused, |()| Reply::Tracker(driver.status()));
                HEARD.send(Heard::Tracker(reply)).await;
            }
            Either3::Second(count) => {
                // An error is noise on the line: the driver's checks tell.
                let count = count.unwrap_or(0);
                let now_us = now_us();
                for (&byte, after) in bytes[..count].iter().zip((0..count as u64).rev()) {
                    driver.byte(byte, line.stamp_us(byte, now_us, after));
                }
            }
            Either3::Third(()) => {}
        }
        while let Some(output) = driver.advance(line.now_us(now_us())) {
            let reply = match output {
                // There is no error that this line could tell.
                TrackerOutput::Send(bytes) => {
                    let _ = say.write_all(bytes).await;
                    continue;
                }
                TrackerOutput::Record(record) => {
                    let answer = Answer { sequence: driver.sequence(), reply: Reply::Record(record) };
                    if cfg!(feature = "emulator") {
                        // What came at once waits: see `TRACKER_ROOM`.
                        host::RECORDS.send(answer).await;
                    } else if host::RECORDS.try_send(answer).is_err() {
                        driver.lost();
                    }
                    continue;
                }
                TrackerOutput::Status(status) => Reply::Tracker(status),
                // No text of the driver's is longer than a log.
                TrackerOutput::Log(text) => Reply::Log { text: text.try_into().unwrap_or_default() },
            };
            let _ = host::ANSWERS.try_send(Answer { sequence: driver.sequence(), reply });
        }
    }
}

#[cfg(feature = "emulator")]
use crate::emulator::line::Line;

/// The time on the line, which is the time.
#[cfg(not(feature = "emulator"))]
struct Line {
    read_us: u64,
}

#[cfg(not(feature = "emulator"))]
impl Line {
    const fn new() -> Self {
        Self { read_us: 0 }
    }

    /// The stamp of a byte that was read at `now_us` with so many after it, of which the last has just ended.
    fn stamp_us(&mut self, _byte: u8, now_us: u64, after: u64) -> u64 {
        let stamp_us = now_us.saturating_sub(BYTE_US * after).max(self.read_us);
        if after == 0 {
            self.read_us = now_us;
        }
        stamp_us
    }

    fn now_us(&self, now_us: u64) -> u64 {
        now_us
    }

    fn wake_us(&self, due_us: u64, _now_us: u64) -> u64 {
        due_us
    }
}
