//! Everything of the rig's firmware that needs no chip: motion in whole numbers and the state machine of commands.
//!
//! A board's loop hands every [`rigel_protocol::Request`] that it hears to [`Controller::handle`] and calls
//! [`Controller::advance`] whenever [`Controller::next_us`] has come; the core works the [`Pins`].

#![cfg_attr(not(test), no_std)]

mod controller;
mod conversation;
mod drive;
mod homing;
pub mod isotrak;
mod mechanics;
mod motion;
mod notice;
mod pins;
mod trigger;

pub use controller::{Controller, Handled};
pub use mechanics::Mechanics;
pub use notice::Notice;
pub use pins::Pins;
