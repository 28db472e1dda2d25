//! A room as files that other programs open.

use std::fmt::Write as _;
use std::path::Path;

use super::patches::patches_csv;
use super::texture::Room;
use crate::environment::{tone_mapped, write_exr};
use crate::{Error, Result, file};

/// The names of the files.
pub const FILES: [&str; 5] = ["room.obj", "room.mtl", "room.png", "lights.csv", "room.exr"];

impl Room {
    /// Writes to a folder, which is made where it does not exist: `room.exr` (radiance of the texels, `R G B`, and `flags`),
    /// `room.obj` with `room.mtl` and `room.png` for a look, and `lights.csv`, the light sources.
    ///
    /// # Errors
    /// [`Error::Io`] where it cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let side = self.charts.size;
        let picture = image::RgbImage::from_raw(side, side, tone_mapped(&self.radiance));
        let mut png = std::io::Cursor::new(vec![]);
        let written = picture.map(|picture| picture.write_to(&mut png, image::ImageFormat::Png));
        if let Some(Err(error)) = written {
            return Err(Error::io("write", folder)(std::io::Error::other(error.to_string())));
        }
        let material = "newmtl room\nKd 1 1 1\nmap_Kd room.png\n";
        let contents = [
            self.obj().into_bytes(),
            material.into(),
            png.into_inner(),
            patches_csv(&self.patches()).into_bytes(),
        ];
        let files: Vec<(String, Vec<u8>)> =
            FILES.iter().map(|name| (*name).to_owned()).zip(contents).collect();
        file::write_together(folder, &files)?;
        self.write_exr(&folder.join(FILES[4]))
    }

    fn obj(&self) -> String {
        let mut text = String::from(
            "# Lengths in metres. Radiance: room.exr, which lies as room.png does.\nmtllib room.mtl\nusemtl room\n",
        );
        for point in &self.model.points_m {
            let _ = writeln!(text, "v {} {} {}", point.x, point.y, point.z);
        }
        let side = f64::from(self.charts.size);
        for corner in self.charts.corners.iter().flatten() {
            let _ = writeln!(text, "vt {:.7} {:.7}", (corner.x + 0.5) / side, 1.0 - (corner.y + 0.5) / side);
        }
        for (number, [a, b, c]) in self.model.faces.iter().enumerate() {
            let first = 3 * number + 1;
            let _ = writeln!(text, "f {}/{first} {}/{} {}/{}", a + 1, b + 1, first + 1, c + 1, first + 2);
        }
        text
    }

    fn write_exr(&self, path: &Path) -> Result<()> {
        let comments = "Radiance of a room's surfaces (linear RGB), one texel per pixel. flags: 1 a lower bound (saturated), 2 never seen, 4 never \
             seen and filled, 8 no surface, 16 seen from behind, 32 two maps contradict each other.";
        write_exr(path, self.charts.size as usize, (&self.radiance, &self.flags), comments)
    }
}
