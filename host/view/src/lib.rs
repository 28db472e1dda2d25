//! Parameter maps on a graphics device: as a picture and in a window.
//!
//! The shader is [`rigel::shader`]'s. [`Graphics`] is a device, [`Scene`] a map on it, and [`View`] what is to be seen of it.

mod graphics;
mod pipelines;
mod plain;
mod scene;
mod window;

pub use graphics::Graphics;
pub use plain::Plain;
pub use scene::{PICTURE, Scene, Shading, View};
pub use window::{KEYS, Show, open};
