//! The camera that options describe.

use std::path::Path;

use rigel::geometry::{Lens, Pose, Surface};
use rigel::render::{Rendering, gamma_for_median};
use rigel::view_file::read_camera;
use rigel::{Error, Result};

use crate::arguments::Camera;

impl Camera {
    /// Lens and pose for a look at `surface`.
    pub fn place(&self, surface: &Surface) -> Result<(Lens, Pose)> {
        if let Some(path) = &self.camera {
            return read_camera(path, self.pixel_centre);
        }
        let (width, height) = (surface.width_m, surface.height_m);
        let distance_m = self.distance.unwrap_or(4.0 * width.max(height));
        // The surface's diagonal fits the picture's shorter side, however it is turned.
        let pixels = f64::from(self.size.columns.min(self.size.rows));
        let focal_px = 0.95 * pixels * distance_m / width.hypot(height);
        let lens = Lens::pinhole(self.size.columns, self.size.rows, focal_px);
        Ok((lens, Pose::from_rig(self.pan.to_radians(), self.tilt.to_radians(), distance_m)))
    }

    /// The gamma that was asked for, or the one that shows the median of `rendering` half grey; `out` is named in errors.
    pub fn gamma_for(&self, rendering: &Rendering, out: &Path) -> Result<f32> {
        let inside = rendering.inside.iter().zip(&rendering.radiance).filter(|(inside, _)| **inside);
        let values: Vec<f32> = inside.flat_map(|(_, radiance)| *radiance).collect();
        if values.is_empty() {
            return Err(Error::request(
                format!("no pixel of {} would show the front of the surface", out.display()),
                "turn it to the camera (--pan, --tilt, --distance), or check the camera of --camera",
            ));
        }
        self.gamma.map_or_else(|| gamma_for_median(&values), Ok)
    }
}
