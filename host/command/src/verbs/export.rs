//! `rigel export`: maps for programs that have never heard of Rigel.

use std::path::Path;

use rigel::file::write_bytes;
use rigel::parameter_map::ParameterMap;
use rigel::splats::splats;
use rigel::web::{Exhibit, Quantised, page};
use rigel::{Error, Result};

use crate::arguments::Export;
use crate::progress::Bar;
use crate::say::say;
use crate::verbs::{require_extension, require_place};

/// `rigel export`.
pub fn export(arguments: &Export) -> Result<()> {
    match (&arguments.web, &arguments.splats) {
        (Some(out), _) => web(arguments, out),
        (None, Some(out)) => write_splats(arguments, out),
        (None, None) => Err(Error::request("nothing to export to", "give --web FILE or --splats FILE")),
    }
}

fn name(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn web(arguments: &Export, out: &Path) -> Result<()> {
    require_extension(out, "html")?;
    require_place(out, arguments.force)?;
    let exhibit = |path: &std::path::PathBuf| {
        let map = ParameterMap::read(path)?;
        Ok(Exhibit { name: name(path), facts: map.facts(), map })
    };
    let exhibits: Vec<Exhibit> = arguments.maps.iter().map(exhibit).collect::<Result<_>>()?;
    let title = arguments.title.clone().unwrap_or_else(|| exhibits[0].name.clone());
    let page = page(&title, &exhibits, &Bar::new("quantising"))?;
    write_bytes(out, page.html.as_bytes())?;
    for (exhibit, error) in exhibits.iter().zip(&page.errors_255) {
        say!("{}: quantisation costs {error:.2} of 255", exhibit.name);
    }
    say!("wrote {}: {:.1} MB; open it in a browser", out.display(), page.html.len() as f64 / 1e6);
    Ok(())
}

fn write_splats(arguments: &Export, out: &Path) -> Result<()> {
    let [path] = arguments.maps.as_slice() else {
        return Err(Error::request(
            format!("{} maps are not one file of splats", arguments.maps.len()),
            "name one map, and a file of its own for each other",
        ));
    };
    require_extension(out, "ply")?;
    require_place(out, arguments.force)?;
    let map = ParameterMap::read(path)?;
    let gamma = arguments.gamma.map_or_else(|| Quantised::gamma_of(&map), Ok)?;
    let splats = splats(&map, gamma, &Bar::new("reducing"))?;
    write_bytes(out, &splats.ply)?;
    say!(
        "wrote {}: {} splats, {:.1} MB, exposed with gamma {gamma:.4}; harmonics up to degree 3 cost {:.1} of 255 (95 % within {:.1}) down to zenith 80 degrees",
        out.display(),
        splats.count,
        splats.ply.len() as f64 / 1e6,
        splats.mean_255,
        splats.most_255
    );
    Ok(())
}
