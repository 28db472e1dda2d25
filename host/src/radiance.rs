//! From bracketed photographs to radiance with its variance, on one scale for a whole session.
//!
//! The road: [`Picture`](crate::picture::Picture)s of one view make a [`Stack`]; a few blocks of pixels of every stack go into [`Samples`];
//! from these come the camera's [`Response`] and its [`NoiseModel`]; [`merge`] then turns each stack into a
//! [`RadianceImage`]. The response is normalised once, so all views of a session share one unit.

mod classical;
mod exr_file;
mod ghost;
mod image;
mod merge;
mod noise;
pub mod others;
mod prior;
mod recover;
mod response;
mod rows;
mod samples;
#[cfg(test)]
mod simulated;
mod stack;
mod times;
mod weights;

pub use classical::{debevec, debevec_response};
pub use image::{Mask, RadianceImage};
pub use merge::merge;
pub use noise::NoiseModel;
pub use response::Response;
pub use samples::Samples;
pub use stack::Stack;
pub use times::{Learnt, MeasuredTime};
