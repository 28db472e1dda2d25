//! What a file that Rigel wrote is, where it came from, and a small picture of it.

mod thumbnail;

use std::io::Read;
use std::path::Path;

use exr::meta::MetaData;
use exr::meta::header::Header;
use exr::prelude::attribute::AttributeValue;

pub use thumbnail::thumbnail;

use crate::environment::EnvironmentMap;
use crate::observation::{ObservationMap, exr_file, zarr};
use crate::parameter_map::ParameterMap;
use crate::radiance::{RadianceImage, Response};
use crate::session::Session;
use crate::splats;
use crate::{Error, Result};

/// What kind of file it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A session's folder.
    Session,
    /// Coefficients for every texel.
    ParameterMap,
    /// Radiance of one view.
    Radiance,
    /// Radiance from every direction.
    Environment,
    /// A picture in OpenEXR that `rigel render` or another program wrote.
    Picture,
    /// Radiance against direction for every texel.
    Observations,
    /// The same for other programs: an OpenEXR file or a Zarr store.
    Exchange,
    /// What a camera's levels are worth.
    Response,
    /// A lens with its covariance.
    Lens,
    /// Where every view was taken from.
    Registration,
    /// Lamp and vignetting of a session.
    Photometry,
    /// A table.
    Table,
    /// A session's journal, or the tracker's records.
    Journal,
    /// A page or a report.
    Page,
    /// Gaussian splats.
    Splats,
}

/// What is known of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Info {
    /// What kind of file it is.
    pub kind: Kind,
    /// The same in words.
    pub title: String,
    /// What it holds and where it came from, a line each.
    pub facts: Vec<String>,
}

/// First lines of tables, and what such a table is.
const TABLES: [(&str, &str); 10] = [
    ("view,pixels,mean_of_255,", "errors of a parameter map (rigel evaluate)"),
    ("file,column,row,x_px,", "residuals of a lens (rigel calibrate)"),
    ("azimuth_deg,zenith_deg", "directions for a capture (rigel plan)"),
    ("kind,longitude_deg,latitude_deg,", "lights (rigel lights)"),
    ("file,view,pan_deg,", "photographs and their views (for rigel import)"),
    ("file,qw,", "photographs and how the camera was turned (for rigel mosaic)"),
    ("level,R,G,B", "a response"),
    ("file,time_s", "photographs and their times on a tracker's clock (for rigel mosaic)"),
    ("time_s,qw,", "a tracker's records (for rigel mosaic)"),
    ("x_m,y_m,z_m,normal_x,", "light sources of a room (rigel room)"),
];

/// Tells what the file or folder at `path` is.
///
/// # Errors
/// [`Error::Io`] when it cannot be read; [`Error::Input`] when it is damaged, or nothing that is known here.
pub fn info(path: &Path) -> Result<Info> {
    if zarr::is_store(path) {
        return store(path);
    }
    if path.is_dir() {
        return session(path);
    }
    let mut start = vec![0; 4096];
    let mut file = std::fs::File::open(path).map_err(Error::io("read", path))?;
    let length = file.metadata().map_err(Error::io("read", path))?.len();
    let mut read = 0;
    loop {
        match file.read(&mut start[read..]).map_err(Error::io("read", path))? {
            0 => break,
            count => read += count,
        }
    }
    start.truncate(read);
    let text = String::from_utf8_lossy(&start).into_owned();
    let found = |kind, title: &str, facts| Ok(Info { kind, title: title.into(), facts });
    if start.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        return open_exr(path);
    }
    if start.starts_with(b"RIGELOBS") {
        return observations(path, length);
    }
    if text.starts_with("ply\n") && text.contains("f_rest_44") {
        let count = text.lines().find_map(|line| line.strip_prefix("element vertex ")).unwrap_or("?");
        let is_ours = text.contains("comment made by Rigel");
        if is_ours && splats::length(&start) != Some(length) {
            return Err(Error::input(path, "holds splats and was cut short, or changed", "export it again"));
        }
        let by = if is_ours { "rigel export --splats" } else { "another program" };
        return found(
            Kind::Splats,
            "Gaussian splats",
            vec![format!("{count} splats"), format!("made by {by}")],
        );
    }
    if text.trim_start().to_lowercase().starts_with("<!doctype html") {
        let title = text.split_once("<title>").and_then(|(_, rest)| rest.split_once("</title>"));
        let title = title.map_or("without a title", |(title, _)| title).to_owned();
        return found(Kind::Page, "a page", vec![title, "open it in a browser".into()]);
    }
    if text.starts_with("level,R,G,B") {
        let response = Response::read_csv(path)?;
        return found(Kind::Response, "a response", vec![format!("levels 0 to {}", response.white())]);
    }
    let first = text.lines().next().unwrap_or_default();
    if let Some((_, title)) = TABLES.iter().find(|(columns, _)| first.starts_with(columns)) {
        let rows = lines(path)?.saturating_sub(1);
        return found(Kind::Table, title, vec![format!("{rows} rows"), format!("columns {first}")]);
    }
    if first.starts_with('{') && path.extension().is_some_and(|extension| extension == "jsonl") {
        let facts = vec![format!("{} lines", lines(path)?)];
        return found(Kind::Journal, "a journal: a JSON object per line", facts);
    }
    if path.extension().is_some_and(|extension| extension == "toml") {
        return toml(path);
    }
    Err(Error::input(
        path,
        "is nothing that `rigel info` knows",
        "give a session, a map (.exr), observations.rigel, lens.toml, registration.toml, a table or a page",
    ))
}

fn store(path: &Path) -> Result<Info> {
    let about = zarr::attributes(path).ok_or_else(|| {
        Error::input(path, "is a Zarr store, but none that Rigel wrote", "open it with zarr or xarray")
    })?;
    let views: Vec<&str> =
        about["views"].as_array().into_iter().flatten().filter_map(|v| v.as_str()).collect();
    let mut facts = vec![
        format!("{} views{}", views.len(), listed(&views)),
        "radiance and sigma as arrays, with their axes; open it with zarr or xarray".into(),
    ];
    facts.extend(about[zarr::MADE_BY].as_str().map(|name| format!("made by {name}")));
    Ok(Info {
        kind: Kind::Exchange,
        title: "observations: radiance of every texel, a Zarr store".into(),
        facts,
    })
}

fn lines(path: &Path) -> Result<usize> {
    let bytes = std::fs::read(path).map_err(Error::io("read", path))?;
    Ok(bytes.iter().filter(|byte| **byte == b'\n').count())
}

fn session(path: &Path) -> Result<Info> {
    let session = Session::open(path)?;
    let manifest = &session.manifest;
    let photographs: usize = (0..manifest.views.len()).map(|view| session.photographs(view).len()).sum();
    let measured = (0..manifest.views.len()).filter(|&view| session.radiance_path(view).exists()).count();
    let mut facts = vec![
        format!("from {}", manifest.source),
        format!(
            "{} views, {} of them done, {photographs} photographs",
            manifest.views.len(),
            session.done_views().len()
        ),
        format!("radiance of {measured} views"),
    ];
    if let Some(surface) = manifest.surface {
        facts.push(format!(
            "a surface of {:.4} mm x {:.4} mm",
            1e3 * surface.width_m,
            1e3 * surface.height_m
        ));
    }
    for (name, what) in [
        ("registration.toml", "registered"),
        ("photometry.toml", "lamp or vignetting found"),
        ("observations.rigel", "observed"),
        ("tracker.jsonl", "with the tracker's records"),
    ] {
        if path.join(name).exists() {
            facts.push(format!("{what} ({name})"));
        }
    }
    Ok(Info { kind: Kind::Session, title: "a session".into(), facts })
}

fn observations(path: &Path, length: u64) -> Result<Info> {
    let map = ObservationMap::open(path)?;
    let header = map.header();
    let views: Vec<&str> = header.views.iter().map(|view| view.name.as_str()).collect();
    let mut facts = vec![
        format!(
            "{}x{} texels on {:.4} mm x {:.4} mm",
            header.texels.columns,
            header.texels.rows,
            1e3 * header.surface.width_m,
            1e3 * header.surface.height_m
        ),
        format!("{} views{}", header.views.len(), listed(&views)),
        format!("{:.1} MB", length as f64 / 1e6),
    ];
    if header.photometry.is_some() {
        facts.push("the lamp's drift or the vignetting was removed".into());
    }
    Ok(Info {
        kind: Kind::Observations,
        title: "observations: radiance against direction for every texel".into(),
        facts,
    })
}

/// So many ranges of names are told.
const RANGES: usize = 12;

/// Names, those whose numbers follow one another as a range: "view000 to view002, view004".
fn listed(names: &[&str]) -> String {
    let ranges: Vec<&[&str]> =
        names.chunk_by(|name, next| following(name).as_deref() == Some(next)).collect();
    let told = ranges.iter().take(RANGES).map(|range| match range {
        [first, .., last] => format!("{first} to {last}"),
        one => one.concat(),
    });
    let told = told.collect::<Vec<_>>().join(", ");
    match ranges.iter().skip(RANGES).map(|range| range.len()).sum() {
        0 if names.is_empty() => String::new(),
        0 => format!(": {told}"),
        others => format!(": {told} and {others} others"),
    }
}

/// The name with the next number.
fn following(name: &str) -> Option<String> {
    let (stem, number) = name.split_at(name.trim_end_matches(|letter: char| letter.is_ascii_digit()).len());
    let next = number.parse::<u64>().ok()?.checked_add(1)?;
    Some(format!("{stem}{next:0width$}", width = number.len()))
}

fn open_exr(path: &Path) -> Result<Info> {
    let damaged =
        |error| Error::input(path, format!("is no complete OpenEXR file ({error})"), "make it again");
    let meta = MetaData::read_from_file(path, false).map_err(damaged)?;
    let Some(header) = meta.headers.first() else {
        return Err(Error::input(path, "holds no picture", "make it again"));
    };
    let text = |name: &str| match attribute(header, name) {
        Some(AttributeValue::Text(text)) => Some(text.to_string()),
        _ => None,
    };
    let has = |name: &str| attribute(header, name).is_some();
    let software = header.own_attributes.software_name.as_ref().map(|name| format!("made by {name}"));
    let size = format!("{}x{} pixels", header.layer_size.width(), header.layer_size.height());
    let made = |kind, title: &str, facts: Vec<String>| Info { kind, title: title.into(), facts };
    Ok(if has("rigelModel") {
        let map = ParameterMap::read(path)?;
        let mut facts = map.facts();
        let seen = map.diagnostics.iter().flat_map(|diagnostics| &diagnostics.seen);
        let seen: Vec<&str> = seen.map(String::as_str).collect();
        if !seen.is_empty() {
            facts.push(format!("the {} views that the fit has seen{}", seen.len(), listed(&seen)));
        }
        facts.extend(text("rigelVersion").map(|version| format!("made by rigel {version}")));
        made(Kind::ParameterMap, "a parameter map: a model's coefficients for every texel", facts)
    } else if has("rigelRadiance") {
        let image = RadianceImage::read_exr(path)?;
        let masked = image.mask.iter().filter(|mask| **mask != 0).count();
        let mut facts = vec![
            size,
            format!("stored with {}", header.compression),
            format!("{:.2} % of the pixels masked", 100.0 * masked as f64 / image.mask.len().max(1) as f64),
        ];
        facts.extend(text("rigelResponse").map(|response| format!("response: {response}")));
        facts.extend(software);
        made(Kind::Radiance, "the radiance of a view, with variance and mask", facts)
    } else if has("rigelEnvironment") {
        let map = EnvironmentMap::read(path)?;
        let share = |flag| 100.0 * map.share(flag);
        let mut facts = vec![
            size,
            format!("radiance in {}", map.unit.words()),
            format!("{:.2} % of the sphere never seen", share(EnvironmentMap::UNSEEN)),
            format!("{:.2} % of the sphere a lower bound (saturated)", share(EnvironmentMap::LOWER_BOUND)),
        ];
        facts.extend(software);
        made(Kind::Environment, "radiance from every direction, latitude-longitude, y up", facts)
    } else if has(exr_file::KIND) {
        let views =
            header.channels.list.iter().filter(|channel| channel.name.to_string().ends_with(".sigma"));
        let mut facts = vec![size, format!("{} views, a layer each, and their mean", views.count())];
        facts.extend(software);
        made(Kind::Exchange, "observations: radiance of every texel, a layer for each view", facts)
    } else {
        let channels: Vec<String> =
            header.channels.list.iter().map(|channel| channel.name.to_string()).collect();
        let mut facts = vec![size, format!("channels {}", channels.join(" "))];
        facts.extend(software);
        made(
            Kind::Picture,
            "a picture in OpenEXR that does not say what it is, such as `rigel render` writes",
            facts,
        )
    })
}

fn attribute<'a>(header: &'a Header, name: &str) -> Option<&'a AttributeValue> {
    let of = |(key, value): (&exr::prelude::Text, &'a AttributeValue)| key.eq(name).then_some(value);
    header
        .own_attributes
        .other
        .iter()
        .find_map(of)
        .or_else(|| header.shared_attributes.other.iter().find_map(of))
}

fn toml(path: &Path) -> Result<Info> {
    let text = std::fs::read_to_string(path).map_err(Error::io("read", path))?;
    let table: toml::Table = toml::from_str(&text).map_err(|error| {
        Error::input(path, error.message().to_owned(), "correct the line or make the file again")
    })?;
    let count = |name: &str| table.get(name).and_then(toml::Value::as_array).map_or(0, Vec::len);
    let said =
        |name: &str| table.get(name).map(|value| format!("{name}: {}", value.to_string().trim_matches('"')));
    let facts = |names: &[&str]| names.iter().filter_map(|name| said(name)).collect::<Vec<String>>();
    let has = |name: &str| table.contains_key(name);
    let (kind, title, facts) = if has("made_from") && has("rig") {
        let mut facts = vec![format!("{} views placed, {} left out", count("view"), count("dropped"))];
        let notes = table.get("notes").and_then(toml::Value::as_array).into_iter().flatten();
        facts.extend(notes.filter_map(|note| Some(note.as_str()?.to_owned())));
        (Kind::Registration, "a registration: where each view was taken from", facts)
    } else if has("made_from") {
        let mut facts = vec![format!("the lamp in {} views", count("view"))];
        facts.extend(has("vignetting").then(|| "vignetting found from overlapping views".to_owned()));
        (Kind::Photometry, "photometry: lamp and vignetting of a session", facts)
    } else if has("fx") {
        let mut names = facts(&["width", "height", "model", "fx", "fy", "cx", "cy", "rms_px", "verdict"]);
        names.extend((count("boards") > 0).then(|| format!("from {} boards", count("boards"))));
        (Kind::Lens, "a lens in OpenCV's names", names)
    } else if has("source") && has("format") {
        return session(path.parent().unwrap_or(Path::new(".")));
    } else {
        return Err(Error::input(
            path,
            "is a TOML file, but none that Rigel writes",
            "give lens.toml, registration.toml, photometry.toml or session.toml",
        ));
    };
    Ok(Info { kind, title: title.into(), facts })
}
