//! A simulated tracker on a real line: a pseudo-terminal, a socket, a pipe.

use std::io::{ErrorKind, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::Tracker;

/// Longest sleep between two looks at the line.
const ROUND: Duration = Duration::from_millis(1);

/// A tracker that runs in a thread of its own, in real time, until this value is dropped.
pub struct TrackerRunner {
    tracker: Arc<Mutex<Tracker>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl TrackerRunner {
    /// Runs `tracker` on a line. `line` must not block for long when there is nothing to read (a read time-out or
    /// non-blocking mode); its end, or an error, ends the thread.
    pub fn start(tracker: Tracker, mut line: impl Read + Write + Send + 'static) -> Self {
        let tracker = Arc::new(Mutex::new(tracker));
        let stop = Arc::new(AtomicBool::new(false));
        let thread = {
            let (tracker, stop) = (tracker.clone(), stop.clone());
            std::thread::spawn(move || {
                // An error here is the line's end, like an unplugged cable.
                let _ = serve(&tracker, &mut line, &stop);
            })
        };
        Self { tracker, stop, thread: Some(thread) }
    }

    /// The tracker: to change its behaviour, or to ask what it has said. Its clock counts from the start of the thread.
    pub fn tracker(&self) -> MutexGuard<'_, Tracker> {
        self.tracker.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for TrackerRunner {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn serve(tracker: &Mutex<Tracker>, line: &mut (impl Read + Write), stop: &AtomicBool) -> std::io::Result<()> {
    let started = Instant::now();
    let mut buffer = [0; 64];
    while !stop.load(Ordering::Relaxed) {
        let heard = match line.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(count) => &buffer[..count],
            Err(e)
                if matches!(
                    e.kind(),
                    ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
                ) =>
            {
                &[]
            }
            Err(e) => return Err(e),
        };
        let now_us = started.elapsed().as_micros() as u64;
        let said: Vec<u8> = {
            let mut tracker = tracker.lock().unwrap_or_else(PoisonError::into_inner);
            let mut said: Vec<_> = heard.iter().flat_map(|&byte| tracker.hear(byte, now_us)).collect();
            said.extend(tracker.advance(now_us));
            said.into_iter().map(|(_, byte)| byte).collect()
        };
        if said.is_empty() {
            std::thread::sleep(ROUND);
        } else {
            line.write_all(&said)?;
            line.flush()?;
        }
    }
    Ok(())
}
