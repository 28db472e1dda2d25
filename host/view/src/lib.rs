//! Parameter maps on a graphics device: as a picture and in a window.
//!
//! The shader is [`rigel::shader`]'s. [`Graphics`] is a device, [`Scene`] a map on it, and [`View`] what is to be seen of it. Beside it the
//! processor draws: a [`Raster`] holds text and curves, such as a texel's [`Profile`], and a [`ContactSheet`].

mod contact_sheet;
mod flip;
mod font;
mod graphics;
mod pipelines;
mod plain;
mod profile;
mod raster;
mod scene;
mod shift;
mod window;

pub use contact_sheet::{ContactSheet, Flipped, contact_sheet, spread};
pub use flip::{difference, matched, photograph};
pub use graphics::Graphics;
pub use plain::Plain;
pub use profile::{PANEL, Profile};
pub use raster::{Colour, Raster};
pub use scene::{PICTURE, Scene, Shading, View};
pub use shift::{FAR_PX, Shift, shift_px};
pub use window::{KEYS, Show, open};
