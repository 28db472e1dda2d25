//! A simulated rig, camera and surface with a known truth.

pub mod rig;
