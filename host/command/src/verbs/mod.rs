//! One function for each verb: it calls the library and says what was written.

mod capture;
mod demo;
mod fit;
mod import;

pub use capture::capture;
pub use demo::demo;
pub use fit::{evaluate, fit, render};
pub use import::{import, observe, radiance};

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
        names.iter().position(|known| known == name).ok_or_else(|| {
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

fn session_views(session: &Session, wanted: &[String]) -> Result<Vec<usize>> {
    let names = session.manifest.views.iter().map(|view| view.name.as_str());
    views_by_name(names, wanted, &session.folder().display().to_string())
}
