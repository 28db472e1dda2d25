//! A map as the faces of a cube: `cube`.

use rigel::Result;
use rigel::environment::{Cube, EnvironmentMap};

use crate::arguments::Cube as Arguments;
use crate::say::say;
use crate::verbs::{NewFolders, require_places};

/// `rigel cube`.
pub fn cube(arguments: &Arguments) -> Result<()> {
    let out = &arguments.out;
    let names = Cube::NAMES.iter().flat_map(|name| [format!("{name}.exr"), format!("{name}.png")]);
    require_places(out, names, arguments.force)?;
    let map = EnvironmentMap::read(&arguments.map)?;
    // As fine as the map along its horizon.
    let size = arguments.size.unwrap_or((map.size.width() as u32 / 4).max(1));
    let cube = Cube::new(&map, size)?;
    let _new = NewFolders::below(out);
    cube.write(out)?;
    say!("wrote {}: px nx py ny pz nz, {size}x{size} pixels each, as OpenEXR and PNG", out.display());
    Ok(())
}
