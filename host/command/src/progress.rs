//! Progress on the terminal, and Ctrl-C.

use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use rigel::progress::Progress;
use rigel::{Error, Result};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);
static HANDLER: Once = Once::new();

/// From now on Ctrl-C is a wish that [`interrupted`] tells; the second one ends the program.
pub fn heed_interrupts() {
    HANDLER.call_once(|| {
        // Without a handler Ctrl-C still ends the program, only less gently.
        let _ = ctrlc::set_handler(|| {
            if INTERRUPTED.swap(true, Ordering::Relaxed) {
                std::process::exit(130);
            }
            eprintln!("rigel: stopping; Ctrl-C again ends it at once");
        });
    });
}

/// Whether the user asked to stop.
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// Whether the user asked to stop; from then on that is forgotten, as something else begins.
pub fn take_interrupt() -> bool {
    INTERRUPTED.swap(false, Ordering::Relaxed)
}

/// A line that always says how things stand now; nothing where the output is not a terminal.
pub struct Line(ProgressBar);

impl Line {
    /// An empty line.
    pub fn new() -> Self {
        heed_interrupts();
        let bar = ProgressBar::new_spinner();
        if let Ok(style) = ProgressStyle::with_template("{msg}") {
            bar.set_style(style);
        }
        Self(bar)
    }

    /// Says something else from now on.
    pub fn show(&self, text: &str) {
        self.0.set_message(text.to_owned());
        self.0.tick();
    }

    /// Lets something be printed above it.
    pub fn aside(&self, print: impl FnOnce()) {
        self.0.suspend(print);
    }

    /// Takes it away.
    pub fn end(&self) {
        self.0.finish_and_clear();
    }
}

/// A bar with the remaining time; nothing where the output is not a terminal.
pub struct Bar(ProgressBar);

impl Bar {
    /// A bar named after what is being done.
    pub fn new(doing: &'static str) -> Self {
        heed_interrupts();
        let style = ProgressStyle::with_template("{prefix:>12} {wide_bar} {pos}/{len}  {eta} left");
        let bar = ProgressBar::new(1).with_prefix(doing);
        if let Ok(style) = style {
            bar.set_style(style);
        }
        bar.enable_steady_tick(Duration::from_millis(200));
        Self(bar)
    }
}

impl Progress for Bar {
    fn step(&self, done: usize, total: usize) -> Result<()> {
        self.0.set_length(total as u64);
        // Threads report out of order; the bar only grows.
        if done as u64 > self.0.position() {
            self.0.set_position(done as u64);
        }
        if interrupted() { Err(Error::Interrupted) } else { Ok(()) }
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
