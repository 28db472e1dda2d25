//! One function for each verb: it calls the library and says what was written.

mod bench;
mod calibrate;
mod camera;
mod capture;
mod chart;
mod cube;
mod demo;
mod export;
mod fit;
mod import;
mod info;
mod lights;
mod live;
mod mosaic;
mod plan;
mod register;
mod room;
mod update;
#[cfg(feature = "viewer")]
mod view;

pub use bench::{devices, rig, tracker};
pub use calibrate::calibrate;
pub use capture::{capture, collect};
pub use chart::chart;
pub use cube::cube;
pub use demo::demo;
pub use export::export;
pub use fit::{evaluate, fit, render};
pub use import::{import, observe, radiance};
pub use info::info;
pub use lights::lights;
pub use mosaic::mosaic;
pub use plan::plan;
pub use register::register;
pub use room::room;
pub use update::update;
#[cfg(feature = "viewer")]
pub use view::view;

use std::path::{Path, PathBuf};

use rigel::info::{Info, Kind};
use rigel::parameter_map::ParameterMap;
use rigel::session::Session;
use rigel::{Error, Result};

/// Views by their names.
fn views_by_name<'a>(
    names: impl Iterator<Item = &'a str>,
    wanted: &[String],
    where_: &str,
) -> Result<Vec<usize>> {
    let names: Vec<&str> = names.collect();
    let find = |name: &String| {
        let name = name.trim();
        names.iter().position(|known| *known == name).ok_or_else(|| {
            Error::request(
                format!("{where_} has no view {name}"),
                format!(
                    "choose among {} to {}",
                    names.first().unwrap_or(&"none"),
                    names.last().unwrap_or(&"none")
                ),
            )
        })
    };
    wanted.iter().map(find).collect()
}

/// Makes sure, before the work, that a result can be written at `path`: its folder is there and may be written, and nothing stands
/// in its place or it may be replaced.
fn require_place(path: &Path, force: bool) -> Result<()> {
    if path.exists() && !force {
        return Err(Error::input(
            path,
            "is there already",
            "choose another name, or replace it with --force",
        ));
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let trial = path.with_file_name(format!("{name}.{}.rigel-tmp", std::process::id()));
    let tried = std::fs::File::create(&trial).map(drop).and_then(|()| std::fs::remove_file(&trial));
    tried.map_err(Error::io("write", path))
}

/// The same for results in a folder, which is made where it does not exist; it goes again, for the work may still fail.
fn require_places(folder: &Path, names: impl IntoIterator<Item = String>, force: bool) -> Result<()> {
    let _new = NewFolders::below(folder);
    std::fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
    names.into_iter().try_for_each(|name| require_place(&folder.join(name), force))
}

/// The folders on the way to a result that were not there before: those that are empty at the end are removed.
struct NewFolders(Vec<PathBuf>);

impl NewFolders {
    fn below(folder: &Path) -> Self {
        Self(folder.ancestors().take_while(|folder| !folder.exists()).map(Path::to_path_buf).collect())
    }
}

impl Drop for NewFolders {
    fn drop(&mut self) {
        // What is not empty stays: that is an error here, and nothing to tell.
        self.0.iter().for_each(|folder| drop(std::fs::remove_dir(folder)));
    }
}

/// The same for a result that can be made again: it replaces an earlier one without asking, but no file of another kind.
fn require_place_of(path: &Path, kind: Kind) -> Result<()> {
    require_place(path, true)?;
    if !path.exists() || rigel::info::info(path).is_ok_and(|info| info.kind == kind) {
        return Ok(());
    }
    Err(Error::input(path, "is there already, and is something else", "choose another name, or delete it"))
}

/// Refuses to write a file under a name that says something else: a slip must not overwrite a session or its observations.
fn require_extension(path: &Path, extension: &str) -> Result<()> {
    match path.extension() {
        Some(given) if given.eq_ignore_ascii_case(extension) => Ok(()),
        _ => Err(Error::input(
            path,
            format!("does not end in .{extension}"),
            format!("name a .{extension} file"),
        )),
    }
}

/// Reads a parameter map; of a file or folder of another kind it says what that is.
fn read_map(path: &Path) -> Result<ParameterMap> {
    ParameterMap::read(path).map_err(|error| match rigel::info::info(path) {
        Ok(Info { kind, title, .. }) if kind != Kind::ParameterMap => Error::input(
            path,
            format!("is no parameter map but {title}"),
            "give a parameter map as `rigel fit` writes it",
        ),
        _ => error,
    })
}

fn session_views(session: &Session, wanted: &[String]) -> Result<Vec<usize>> {
    let names = session.manifest.views.iter().map(|view| view.name.as_str());
    views_by_name(names, wanted, &session.folder().display().to_string())
}
