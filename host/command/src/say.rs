//! What the command tells on standard output.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write, stdout};

/// Prints a line. A reader that went away (`rigel ... | head`) is no error; a full disk behind the output is told.
pub fn line(text: Arguments) {
    match writeln!(stdout().lock(), "{text}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            // Standard error may be as full; then there is nobody left to tell.
            let _ = writeln!(std::io::stderr(), "rigel: the output cannot be written: {error}");
        }
        _ => {}
    }
}

/// `1 view`, `2 views`.
pub fn count_of(count: usize, thing: &str) -> String {
    format!("{count} {thing}{}", if count == 1 { "" } else { "s" })
}

/// `println!` that does not panic.
macro_rules! say {
    ($($argument:tt)*) => { $crate::say::line(format_args!($($argument)*)) };
}
pub(crate) use say;
