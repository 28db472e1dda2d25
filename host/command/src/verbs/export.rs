//! `rigel export`: maps for programs that have never heard of Rigel.

use std::path::Path;

use rigel::file::write_bytes;
use rigel::observation::ObservationMap;
use rigel::splats::splats;
use rigel::web::{Exhibit, Quantised, page};
use rigel::{Error, Result};

use crate::arguments::Export;
use crate::progress::Bar;
use crate::say::{count_of, say};
use crate::verbs::{read_map, require_extension, require_place};

/// A mean difference that is plain to see beside the map, of 255.
const VISIBLE_255: f64 = 2.0;

/// `rigel export`.
pub fn export(arguments: &Export) -> Result<()> {
    let Export { web, splats, exr, zarr, .. } = arguments;
    match (web, splats, exr, zarr) {
        (Some(out), ..) => write_page(arguments, out),
        (_, Some(out), ..) => write_splats(arguments, out),
        (_, _, Some(out), _) => write_observations(arguments, out, "exr"),
        (.., Some(out)) => write_observations(arguments, out, "zarr"),
        (None, None, None, None) => Err(Error::request(
            "nothing to export to",
            "give --web FILE, --splats FILE, --exr FILE or --zarr FOLDER",
        )),
    }
}

/// The only one of the files, where `what` holds one.
fn only<'a>(arguments: &'a Export, what: &str) -> Result<&'a Path> {
    match arguments.maps.as_slice() {
        [path] => Ok(path),
        maps => Err(Error::request(
            format!("{} files are not one {what}", maps.len()),
            "name one, and a result of its own for each other",
        )),
    }
}

fn write_observations(arguments: &Export, out: &Path, extension: &str) -> Result<()> {
    let path = only(arguments, "observation map")?;
    require_extension(out, extension)?;
    require_place(out, arguments.force)?;
    let of_session = path.join("observations.rigel");
    let map = ObservationMap::open(if path.is_dir() { &of_session } else { path })?;
    let bar = Bar::new("writing");
    if extension == "exr" { map.write_exr(out, &bar) } else { map.write_zarr(out, &bar) }?;
    let header = map.header();
    say!(
        "wrote {}: {} of {}x{} texels, in the session's radiance; not a number where a view measured none",
        out.display(),
        count_of(header.views.len(), "view"),
        header.texels.columns,
        header.texels.rows
    );
    Ok(())
}

fn name(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn write_page(arguments: &Export, out: &Path) -> Result<()> {
    require_extension(out, "html")?;
    require_place(out, arguments.force)?;
    let exhibit = |path: &std::path::PathBuf| {
        let map = read_map(path)?;
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
    let path = only(arguments, "file of splats")?;
    require_extension(out, "ply")?;
    require_place(out, arguments.force)?;
    let map = read_map(path)?;
    let gamma = arguments.gamma.map_or_else(|| Quantised::gamma_of(&map), Ok)?;
    let splats = splats(&map, gamma, &Bar::new("reducing"))?;
    write_bytes(out, &splats.ply)?;
    let overlap = splats.overlap_255.map_or_else(|| "is not judged".into(), |cost| format!("{cost:.1}"));
    say!(
        "wrote {}: {} splats, {:.1} MB, exposed with gamma {gamma:.4}; harmonics up to degree 3 cost {:.1} of 255 (95 % within {:.1}) down to zenith 80 degrees, their overlap {overlap}",
        out.display(),
        splats.count,
        splats.ply.len() as f64 / 1e6,
        splats.mean_255,
        splats.most_255
    );
    if splats.mean_255 > VISIBLE_255 {
        say!(
            "warning: such soft harmonics do not show what shines here; a page (--web) keeps the map's own model"
        );
    }
    Ok(())
}
