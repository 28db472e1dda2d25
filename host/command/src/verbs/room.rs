//! From maps of a room to its surfaces: `room`.

use std::path::Path;

use glam::{DQuat, DVec3};
use rigel::environment::EnvironmentMap;
use rigel::room::{Capture, FILES, Model, Pair, Room as Lit, read_pairs, register, texture};
use rigel::{Error, Result};

use crate::arguments::Room;
use crate::progress::Bar;
use crate::say::{count_of, say};
use crate::verbs::{NewFolders, require_places};

/// `rigel room`.
pub fn room(arguments: &Room) -> Result<()> {
    let (maps, centres, pairs) = (arguments.map.len(), arguments.centre.len(), arguments.pairs.len());
    if !(centres == maps || centres == 0 && pairs == maps) || !(pairs == maps || pairs == 0) {
        return Err(Error::request(
            format!("{maps} maps, {centres} places (--centre) and {pairs} tables of pairs (--pairs)"),
            "give for each --map its --centre x,y,z, its --pairs, or both",
        ));
    }
    let out = &arguments.out;
    let names = FILES.into_iter().chain(arguments.look.map(|_| "look.exr"));
    require_places(out, names.map(str::to_owned), arguments.force)?;
    for own in arguments.map.iter().chain(&arguments.pairs).chain([&arguments.model]) {
        let place = out.join(own.file_name().unwrap_or_default());
        if FILES.iter().any(|name| place.ends_with(name)) && is_same(&place, own) {
            return Err(Error::input(own, "would be replaced", "choose another folder with --out"));
        }
    }
    let model = Model::read(&arguments.model)?;
    let maps: Vec<EnvironmentMap> =
        arguments.map.iter().map(|path| EnvironmentMap::read(path)).collect::<Result<_>>()?;
    let mut captures = vec![];
    for (i, map) in maps.iter().enumerate() {
        let centre = arguments.centre.get(i).copied();
        let (centre_m, map_from_model) = match (arguments.pairs.get(i), centre) {
            (Some(path), _) => {
                place(path, &read_pairs(path, map.size)?, centre).map_err(|error| error.about(path))?
            }
            (None, Some(centre)) => (centre, DQuat::IDENTITY),
            (None, None) => continue,
        };
        captures.push(Capture { map, centre_m, map_from_model });
    }
    let mut lit = texture(model, &captures, arguments.size, &Bar::new("room"))
        .map_err(|error| error.about(&arguments.model))?;
    for note in &lit.notes {
        say!("note: {note}");
    }
    let unseen = lit.share(EnvironmentMap::UNSEEN);
    if arguments.fill {
        lit.fill();
    }
    let _new = NewFolders::below(out);
    lit.write(out)?;
    let patches = lit.patches();
    for patch in &patches {
        let DVec3 { x, y, z } = patch.centre_m;
        say!(
            "light at {x:.2}, {y:.2}, {z:.2} m: {:.2} x {:.2} m, {:.1} % of the light{}",
            patch.size_m[0],
            patch.size_m[1],
            100.0 * patch.share,
            if patch.is_lower_bound { ", at least: photographs were saturated there" } else { "" }
        );
    }
    say!(
        "wrote {}: {} with a texture of {}x{}, {}; of the surface {:.1} % were seen by no map{}, {:.1} % are lower bounds",
        out.display(),
        count_of(lit.model.faces.len(), "face"),
        arguments.size,
        arguments.size,
        count_of(patches.len(), "light source"),
        100.0 * unseen,
        if arguments.fill { " and filled" } else { "" },
        100.0 * lit.share(EnvironmentMap::LOWER_BOUND)
    );
    if let Some(centre) = arguments.look {
        look(&lit, centre, maps[0].size, &out.join("look.exr"))?;
    }
    Ok(())
}

fn is_same(a: &Path, b: &Path) -> bool {
    a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b))
}

fn look(lit: &Lit, centre: DVec3, size: rigel::geometry::LatLong, file: &Path) -> Result<()> {
    lit.look(centre, size, &Bar::new("look"))?.write(file)?;
    say!("wrote {}: what a camera sees at {centre}", file.display());
    Ok(())
}

/// Says where a map was taken, and how far each pair is off.
fn place(path: &Path, pairs: &[Pair], centre: Option<DVec3>) -> Result<(DVec3, DQuat)> {
    let found = register(pairs, centre)?;
    for (number, (off, wrong)) in found.residuals_rad.iter().zip(&found.wrong).enumerate() {
        let verdict = if *wrong { ": contradicts the others and was left out" } else { "" };
        say!("{} line {}: {:.2} degrees off{verdict}", path.display(), number + 2, off.to_degrees());
    }
    let DVec3 { x, y, z } = found.centre_m;
    say!(
        "{}: taken at {x:.3}, {y:.3}, {z:.3} ± {:.3} m, turned to ± {:.2} degrees",
        path.display(),
        found.centre_sigma_m,
        found.turn_sigma_rad.to_degrees()
    );
    Ok((found.centre_m, found.map_from_model))
}
