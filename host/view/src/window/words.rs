//! What is written in the window.

use rigel::geometry::azimuth_zenith;
use rigel::parameter_map::ParameterMap;

use crate::scene::{Shading, View};

/// The keys, and what each does.
pub const KEYS: [(&str, &str); 14] = [
    ("drag, arrows", "turn"),
    ("wheel, + -", "distance"),
    ("0", "as at first"),
    ("click", "a texel's radiance"),
    ("[ ]", "exposure"),
    ("f", "false colours"),
    ("m", "next map"),
    ("r", "coarser texels"),
    ("x", "by pixel, by texel"),
    ("l", "light a floor"),
    ("n p", "photographed views"),
    ("space", "photograph or map"),
    ("s", "screenshot"),
    ("h q", "hide this, end"),
];

/// What the keys do, line by line.
pub(super) fn keys() -> Vec<String> {
    KEYS.iter().map(|(key, what)| format!("{key:<13}{what}")).collect()
}

/// More lines of facts would hide the surface.
const MOST_FACTS: usize = 9;
/// No line is longer.
const LONGEST: usize = 52;

/// A map in lines: its name, then its facts.
pub(super) fn facts(name: &str, map: &ParameterMap) -> Vec<String> {
    let mut lines: Vec<String> = [name.to_owned()].into_iter().chain(map.facts()).collect();
    if lines.len() > MOST_FACTS {
        // At the end stands how good it is.
        lines.splice(MOST_FACTS - 3..lines.len() - 2, ["... (rigel info)".to_owned()]);
    }
    lines.iter_mut().for_each(|line| *line = shortened(line));
    lines
}

fn shortened(line: &str) -> String {
    if line.chars().count() <= LONGEST {
        return line.to_owned();
    }
    line.chars().take(LONGEST - 3).chain("...".chars()).collect()
}

/// What is seen, and how; `of` is the photographed view and which picture of it.
pub(super) fn seen(view: &View, is_by_texel: bool, of: Option<&str>, is_floor_lit: bool) -> Vec<String> {
    let (azimuth_rad, zenith_rad) = azimuth_zenith(view.pose.centre_m);
    let shading = if is_by_texel { "by texel" } else { "by pixel" };
    let is_chosen = view.shading != Shading::Automatic || view.halvings > 0;
    let chosen = if is_chosen { "" } else { " (automatic)" };
    let texels = match view.halvings {
        0 => String::new(),
        halvings => format!(", texels / {}", 1u32 << halvings),
    };
    let colours = if view.look.false_colour { ", false colours" } else { "" };
    let floor = if is_floor_lit { ", floor lit" } else { "" };
    let lines = [
        of.map_or_else(|| "the map, from anywhere".to_owned(), str::to_owned),
        format!(
            "zenith {:.1}, azimuth {:.1} deg, {:.3} m",
            zenith_rad.to_degrees(),
            azimuth_rad.to_degrees(),
            view.pose.centre_m.length()
        ),
        format!("gamma {:.3}{colours}", view.look.gamma),
        format!("shaded {shading}{chosen}{texels}{floor}"),
    ];
    lines.iter().map(|line| shortened(line)).collect()
}
