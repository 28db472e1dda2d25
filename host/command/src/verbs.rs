//! One function for each verb: it calls the library and says what was written.

mod bench;
mod calibrate;
mod capture;
mod chart;
mod demo;
mod fit;
mod import;
mod register;

pub use bench::{devices, rig, tracker};
pub use calibrate::calibrate;
pub use capture::{capture, collect};
pub use chart::chart;
pub use demo::demo;
pub use fit::{evaluate, fit, render};
pub use import::{import, observe, radiance};
pub use register::register;

use std::path::Path;

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

fn session_views(session: &Session, wanted: &[String]) -> Result<Vec<usize>> {
    let names = session.manifest.views.iter().map(|view| view.name.as_str());
    views_by_name(names, wanted, &session.folder().display().to_string())
}
