//! Everything of the rig's firmware that needs no chip: motion in whole numbers and the state machine of commands.
//!
//! A board's loop hands every [`rigel_protocol::Request`] that it hears to [`Controller::handle`], calls
//! [`Controller::tick`] often, and steps its motors to [`Controller::position_udeg`].

#![cfg_attr(not(test), no_std)]

mod controller;
pub mod isotrak;
mod motion;
mod pins;

pub use controller::Controller;
pub use motion::Motion;
pub use pins::Pins;
