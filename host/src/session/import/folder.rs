//! A folder of photographs, without anything that says where they were taken from.

use std::collections::BTreeMap;
use std::path::Path;

use super::{Found, Options, exif_exposure_s};
use crate::camera::folder::{EXTENSIONS, list};
use crate::session::{Manifest, View};
use crate::{Error, Result};

/// Lists the photographs in the order of their names and groups them into views.
pub(super) fn read(
    folder: &Path,
    options: &Options,
    notes: &mut Vec<String>,
) -> Result<(Manifest, Vec<Found>)> {
    let (paths, others) = list(folder)?;
    if paths.is_empty() {
        return Err(Error::input(
            folder,
            "holds no photograph",
            format!("give a folder of {} files", EXTENSIONS.join(", ")),
        ));
    }
    if others > 0 {
        notes.push(format!("{others} files in {} are no photographs: passed over", folder.display()));
    }
    let times = options.exposure_times.as_deref().map(read_exposure_times).transpose()?;
    let mut found = vec![];
    let mut members: Vec<Option<f64>> = vec![];
    let mut view = 0;
    for path in paths {
        let exposure_s = match &times {
            Some(times) => Some(listed_s(times, &path)?),
            None => exif_exposure_s(&path),
        };
        let full = match options.bracket {
            Some(bracket) => members.len() >= bracket,
            // A bracket takes each time once, so a time that comes again begins the next view.
            None => exposure_s.is_none() || members.contains(&exposure_s),
        };
        if full && !members.is_empty() {
            view += 1;
            members.clear();
        }
        members.push(exposure_s);
        found.push(Found { path, view, exposure_s });
    }
    let views = (0..=view)
        .map(|view| View {
            name: format!("view{view:03}"),
            pan_deg: None,
            tilt_deg: None,
            lens: 0,
            pose: None,
        })
        .collect();
    notes.push(format!("{} photographs make {} views", found.len(), view + 1));
    Ok((Manifest { views, ..Manifest::new("folder") }, found))
}

/// The exposure time of a photograph in a list, seconds.
pub(super) fn listed_s(times: &BTreeMap<String, f64>, photograph: &Path) -> Result<f64> {
    let name = photograph.file_name().unwrap_or_default().to_string_lossy();
    times.get(&*name).copied().ok_or_else(|| {
        Error::input(photograph, "is not in the list of exposure times", "add a line for it or move it away")
    })
}

/// Reads OpenCV's list of exposure times: on each line a file name and the reciprocal of its time in seconds.
pub(super) fn read_exposure_times(path: &Path) -> Result<BTreeMap<String, f64>> {
    let text = std::fs::read_to_string(path).map_err(Error::io("read", path))?;
    let mut times = BTreeMap::new();
    for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let mut words = line.split_whitespace();
        let entry = (words.next(), words.next().and_then(|word| word.parse::<f64>().ok()));
        match entry {
            (Some(name), Some(reciprocal)) if reciprocal.is_finite() && reciprocal > 0.0 => {
                if times.insert(name.to_owned(), 1.0 / reciprocal).is_some() {
                    return Err(Error::input(
                        path,
                        format!("line {} lists {name} a second time", index + 1),
                        "remove one of its lines",
                    ));
                }
            }
            _ => {
                return Err(Error::input(
                    path,
                    format!("line {} is not a file name and one over its exposure time", index + 1),
                    "write it as `memorial00.png 0.03125` (that is 32 s)",
                ));
            }
        }
    }
    Ok(times)
}
