//! The words that the rig's firmware and the host share.
//!
//! [`words`] is the table of everything that is said; [`frame`] is how it crosses a serial line. A [`Request`] goes to
//! the rig, an [`Answer`] comes back with the request's sequence number. A host that hears nothing says the same
//! request again: the rig executes a repeated request once and answers it again. What takes time is accepted first,
//! and its end is told later by an answer with the same sequence number.
//!
//! `no_std` and without allocation: the same code runs on the chip and on the host.

#![cfg_attr(not(test), no_std)]

pub mod frame;
pub mod words;

pub use frame::{Decoder, FrameError, LARGEST_FRAME, LARGEST_PAYLOAD, encode};
pub use words::{
    Answer, Axis, Bracket, Command, Fault, Format, Halt, Hello, LONGEST_BRACKET, Limits, Orientation, Output,
    Record, Reply, Request, Restart, State, Status, TrackerState, TrackerStatus, Tracking,
};

/// The version of the conversation: what the words mean. Raised by hand when a word's meaning changes.
pub const VERSION: u16 = 2;

/// A fingerprint of the table of words: changes whenever [`words`] changes, so that nobody can forget to raise it.
pub const SCHEMA: u32 = fingerprint(include_bytes!("words.rs"));

/// FNV-1a of a source text without its comments, spaces and line ends: rewording a docstring changes nothing.
const fn fingerprint(text: &[u8]) -> u32 {
    let mut hash = 0x811c_9dc5_u32;
    let mut comment = false;
    let mut i = 0;
    while i < text.len() {
        let byte = text[i];
        if byte == b'\n' {
            comment = false;
        } else if byte == b'/' && i + 1 < text.len() && text[i + 1] == b'/' {
            comment = true;
        }
        if !comment && !byte.is_ascii_whitespace() {
            hash = (hash ^ byte as u32).wrapping_mul(0x0100_0193);
        }
        i += 1;
    }
    hash
}

#[cfg(test)]
mod tests {
    use super::fingerprint;

    #[test]
    fn the_fingerprint_follows_the_words_and_nothing_else() {
        let table = b"enum A {\n    /// One.\n    B { c: u8 },\n}\n";
        assert_eq!(fingerprint(table), fingerprint(b"enum A {\r\n B { c: u8 }, // same\r\n}"));
        assert_ne!(fingerprint(table), fingerprint(b"enum A { B { c: u16 }, }"));
        assert_ne!(fingerprint(table), fingerprint(b"enum A { C { c: u8 }, }"));
    }
}
