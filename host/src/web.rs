//! Parameter maps as one web page that needs nothing else: coefficients, shader and controls in a single file.
//!
//! The shader is [`crate::shader`]'s, translated to GLSL ES 3.00 for WebGL 2. Coefficients are quantised so that this changes a
//! picture by no more than a stated part of a level, compressed, and packed into textures by the page.

mod glsl;
mod quantise;
#[cfg(test)]
mod tests;

use base64::Engine;
use serde_json::{Value, json};

pub use quantise::Quantised;

use crate::parameter_map::ParameterMap;
use crate::progress::Progress;
use crate::shader::{Packed, SMOOTH, sharpness};
use crate::{Error, Result};

/// A map and what a page says of it.
#[derive(Debug, Clone)]
pub struct Exhibit {
    /// What the page calls it.
    pub name: String,
    /// The map.
    pub map: ParameterMap,
    /// What is known of it, line by line.
    pub facts: Vec<String>,
}

/// A page.
#[derive(Debug, Clone)]
pub struct Page {
    /// The file's content.
    pub html: String,
    /// What quantisation costs for each map: mean absolute difference of exposed levels, of 255.
    pub errors_255: Vec<f64>,
}

/// Mean difference of levels, of 255, that quantisation may cost.
const ALLOWED_255: f64 = 0.4;

/// Makes a page of these maps; the first is shown first. `progress` counts maps.
///
/// # Errors
/// [`Error::Request`] when there is no map, one is too large for a shader to number, or its radiance has no median;
/// [`Error::Interrupted`].
pub fn page(title: &str, exhibits: &[Exhibit], progress: &dyn Progress) -> Result<Page> {
    if exhibits.is_empty() {
        return Err(Error::request("a page of no map", "name at least one parameter map"));
    }
    let (mut maps, mut errors_255) = (vec![], vec![]);
    for (i, exhibit) in exhibits.iter().enumerate() {
        progress.step(i, exhibits.len())?;
        // Too large for the page's shader is said before the work.
        Packed::require(&exhibit.map)?;
        let quantised = Quantised::within(&exhibit.map, ALLOWED_255)?;
        let packed = Packed::new(&quantised.map)?;
        maps.push(described(exhibit, &packed, &quantised)?);
        errors_255.push(quantised.error_255);
    }
    progress.step(exhibits.len(), exhibits.len())?;
    let data = json!({ "title": title, "maps": maps }).to_string();
    // What a page could take for the end of a script, or for a comment in it, is written in another way.
    let html = include_str!("web/page.html")
        .replace("/*STYLE*/", include_str!("web/page.css"))
        .replace("/*SCRIPT*/", include_str!("web/page.js"))
        .replace("/*DATA*/", &data.replace('<', "\\u003c"))
        .replace("TITLE", &escaped(title));
    Ok(Page { html, errors_255 })
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

fn described(exhibit: &Exhibit, packed: &Packed, quantised: &Quantised) -> Result<Value> {
    let map = &exhibit.map;
    let program = |fragment| glsl::program(&packed.models, fragment);
    let mut facts = exhibit.facts.clone();
    facts.push(format!("quantisation costs {:.2} of 255 on average", quantised.error_255));
    Ok(json!({
        "name": exhibit.name,
        "facts": facts,
        "columns": map.texels.columns,
        "rows": map.texels.rows,
        "width_m": map.surface.width_m,
        "height_m": map.surface.height_m,
        "gamma": quantised.gamma,
        "scale": packed.scale,
        // By texel where texels are no larger, per distance from the surface.
        "smooth": SMOOTH / sharpness(map).sqrt(),
        "models": quantised.layout(&packed.models),
        "shaders": {
            "vertex": glsl::vertex(&packed.models)?,
            "by_pixel": program("by_pixel")?,
            "shade_texel": program("shade_texel")?,
            "by_texel": program("by_texel")?,
        },
        "data": base64::engine::general_purpose::STANDARD.encode(quantised.compressed()),
    }))
}
