//! A map as the faces of a cube: `cube`.

use rigel::environment::{Cube, EnvironmentMap};
use rigel::{Error, Result};

use crate::arguments::Cube as Arguments;
use crate::say::say;
use crate::verbs::require_place;

/// `rigel cube`.
pub fn cube(arguments: &Arguments) -> Result<()> {
    let out = &arguments.out;
    std::fs::create_dir_all(out).map_err(Error::io("create", out))?;
    for name in Cube::NAMES {
        require_place(&out.join(format!("{name}.exr")), arguments.force)?;
        require_place(&out.join(format!("{name}.png")), arguments.force)?;
    }
    let map = EnvironmentMap::read(&arguments.map)?;
    // As fine as the map along its horizon.
    let size = arguments.size.unwrap_or((map.size.width() as u32 / 4).max(1));
    Cube::new(&map, size)?.write(out)?;
    say!("wrote {}: px nx py ny pz nz, {size}x{size} pixels each, as OpenEXR and PNG", out.display());
    Ok(())
}
