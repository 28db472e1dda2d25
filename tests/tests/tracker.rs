//! The tracker's parser and driver against a simulated Isotrak II.

#[path = "tracker/ladder.rs"]
mod ladder;
#[path = "tracker/sweep.rs"]
mod sweep;
