//! The program's text and the numbers that it is given.

use std::fmt::Write as _;

use glam::DVec3;

use super::packed::Stored;
use crate::fit::Model;
use crate::fit::harmonics::Written;
use crate::geometry::{Lens, Pose, Surface, Texels};
use crate::render::expose;

/// WGSL that shows maps of these models. Entry points: the vertices `everywhere` (three of them), and the fragments `by_pixel`
/// (exact), `shade_texel` (the radiance of each texel, to a texture of one pixel for each) and `by_texel` (blends that).
pub fn source(models: &[Stored]) -> String {
    let mut text = include_str!("surface.wgsl").to_owned();
    for (number, stored) in models.iter().enumerate() {
        let (name, body) = (stored.model.name(), body(stored));
        let _ = write!(
            text,
            "\n// {name}\nfn model{number}(place: u32, d: vec3<f32>) -> vec3<f32> {{\n{body}}}\n"
        );
    }
    text += "\nfn radiance(number: u32, place: u32, d: vec3<f32>) -> vec3<f32> {\n";
    if let [_] = models {
        text += "    return model0(place, d);\n}\n";
        return text;
    }
    text += "    switch (number) {\n";
    for number in 0..models.len() {
        let _ = writeln!(text, "        case {number}u: {{ return model{number}(place, d); }}");
    }
    text += "        default: { return vec3<f32>(0.0); }\n    }\n}\n";
    text
}

fn body(stored: &Stored) -> String {
    let mut text = String::new();
    for i in 0..if stored.is_half() { 0 } else { stored.vectors() } {
        let _ = writeln!(text, "let v{i} = bitcast<vec4<f32>>(load(place + {i}u));");
    }
    // Number `i` of the parameters.
    let p = |i: usize| format!("v{}.{}", i / 4, ["x", "y", "z", "w"][i % 4]);
    let p3 = |i: usize| format!("vec3<f32>({}, {}, {})", p(i), p(i + 1), p(i + 2));
    let lobes = |text: &mut String, lobes: u8, first: usize, shared: Option<usize>| {
        let size = if shared.is_some() { 6 } else { 7 };
        let _ = writeln!(text, "var s = {};", p3(0));
        for lobe in 0..usize::from(lobes) {
            let start = first + size * lobe;
            let (shininess, axis) = shared.map_or((start + 3, start + 4), |shared| (shared, start + 3));
            let _ = writeln!(
                text,
                "s += {} * power(clamp(dot({}, d), 0.0, 1.0), {});",
                p3(start),
                p3(axis),
                p(shininess)
            );
        }
        *text += "return s;\n";
    };
    match &stored.model {
        Model::Constant => lobes(&mut text, 0, 3, None),
        Model::Phong { lobes: count } => lobes(&mut text, *count, 3, None),
        Model::SharedPhong { lobes: count } => lobes(&mut text, *count, 4, Some(3)),
        Model::LogQuadratic => {
            let terms = ["", " * d.x", " * d.y", " * (d.x * d.x)", " * (d.x * d.y)", " * (d.y * d.y)"];
            let sum: Vec<String> =
                terms.iter().enumerate().map(|(i, t)| format!("{}{t}", p3(3 * i))).collect();
            let _ = writeln!(text, "return exp(min({}, {}));", sum.join(" + "), p3(18));
        }
        Model::Harmonics { order, method } if stored.is_half() => {
            harmonics(&mut text, &method.written(*order))
        }
        Model::Harmonics { order, method } => {
            text += "var s = vec3<f32>(0.0);\n";
            for (i, function) in method.written(*order).iter().enumerate() {
                let _ = writeln!(text, "{}s += {} * {};", function.statements, function.value, p3(3 * i));
            }
            text += "return s;\n";
        }
    }
    text
}

fn harmonics(text: &mut String, functions: &[Written]) {
    *text += "var s = vec3<f32>(0.0);\n";
    // Eight half floats arrive together.
    let mut loaded = 0;
    for (i, function) in functions.iter().enumerate() {
        *text += &function.statements;
        while loaded < 3 * (i + 1) {
            if loaded.is_multiple_of(8) {
                let vector = loaded / 8;
                let _ = writeln!(text, "let v{vector} = load(place + {vector}u);");
                for (word, name) in ["x", "y", "z", "w"].iter().enumerate() {
                    let _ = writeln!(text, "let h{vector}_{word} = unpack2x16float(v{vector}.{name});");
                }
            }
            loaded += 8 - loaded % 8;
        }
        let half = |i: usize| format!("h{}_{}.{}", i / 8, i % 8 / 2, ["x", "y"][i % 2]);
        let [r, g, b] = [0, 1, 2].map(|c| half(3 * i + c));
        let _ = writeln!(text, "s += {} * vec3<f32>({r}, {g}, {b});", function.value);
    }
    *text += "return s * camera.look.y;\n";
}

/// What one would write first, to compare speeds with: every coefficient in a layer of a float texture (`coefficients`, RGB)
/// that the device interpolates, each function evaluated at every pixel. For harmonics, and for `phong` (layers diffuse,
/// specular with the shininess, lobe). Entry points `everywhere` and `plain`.
pub fn plain_source(model: &Model) -> Option<String> {
    let shared = include_str!("surface.wgsl");
    // Rays and exposure are the same; nothing is loaded as words.
    let shared = shared
        .replace("var coefficients: texture_2d<u32>", "var coefficients: texture_2d_array<f32>")
        .replace(
            "textureLoad(coefficients, vec2<i32>(i32(place & 4095u), i32(place >> 12u)), 0)",
            "vec4<u32>(place)",
        );
    let mut text =
        shared + "\nfn radiance(number: u32, place: u32, d: vec3<f32>) -> vec3<f32> { return d; }\n";
    text += "@fragment fn plain(corner: Corner) -> @location(0) vec4<f32> {\nlet hit = meet(corner.pixel);\nif (!hit.is_inside) { return vec4<f32>(camera.beside.xyz, 1.0); }\nlet d = hit.direction; let uv = (hit.at + 0.5) / camera.surface.zw;\n";
    let layer = |i: usize| format!("textureSampleLevel(coefficients, smooth_sampler, uv, {i}, 0.0)");
    match model {
        Model::Harmonics { order, method } => {
            text += "var s = vec3<f32>(0.0);\n";
            for (i, function) in method.written(*order).iter().enumerate() {
                let _ = writeln!(text, "{}s += {} * {}.xyz;", function.statements, function.value, layer(i));
            }
        }
        Model::Phong { lobes: 1 } => {
            let _ = writeln!(text, "let k = {}; var s = {}.xyz;", layer(1), layer(0));
            let _ = writeln!(text, "s += k.xyz * pow(max(dot(normalize({}.xyz), d), 1e-6), k.w);", layer(2));
        }
        _ => return None,
    }
    text += "return exposed(max(s, vec3<f32>(0.0)));\n}\n";
    Some(text)
}

/// How a picture is made of radiance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// Of the exposure function 1 - exp(-gamma x).
    pub gamma: f32,
    /// Show the exposed luminance on a scale of colours.
    pub false_colour: bool,
    /// What is seen beside the surface, RGB between 0 and 1.
    pub beside: [f32; 3],
}

impl Look {
    /// What the shader shows of a linear RGB radiance.
    pub fn levels(&self, radiance: [f32; 3]) -> [u8; 3] {
        let exposed = radiance.map(|radiance| expose(radiance, self.gamma));
        if self.false_colour {
            let [r, g, b] = exposed;
            return false_colour(0.2126 * r + 0.7152 * g + 0.0722 * b);
        }
        exposed.map(|y| (255.0 * y).round() as u8)
    }
}

/// The colour of a number between 0 and 1 in false-colour pictures: the shader's polynomial.
pub fn false_colour(y: f32) -> [u8; 3] {
    let of = |c: [f32; 6]| c.iter().rev().fold(0.0, |sum, coefficient| sum * y + coefficient);
    [
        of([0.135_721_4, 4.615_392_6, -42.660_324, 132.131_1, -152.942_4, 59.286_38]),
        of([0.091_402_6, 2.194_188_4, 4.842_966_6, -14.185_033, 4.277_298_6, 2.829_566]),
        of([0.106_673_3, 12.641_946, -60.582_05, 110.362_77, -89.903_11, 27.348_25]),
    ]
    .map(|value: f32| (255.0 * value.clamp(0.0, 1.0)).round() as u8)
}

/// The numbers of the shader's `Camera`, ten vectors; `scale` is that of [`Packed`](super::Packed), `levels` how many halvings
/// of the shaded texels there are.
pub fn camera_numbers(
    surface: &Surface,
    texels: Texels,
    lens: &Lens,
    pose: &Pose,
    look: &Look,
    scale: f32,
    levels: u32,
) -> [[f32; 4]; 10] {
    let axis = |axis: DVec3| pose.direction_to_surface(axis).as_vec3().extend(0.0).to_array();
    let four = |numbers: [f64; 4]| numbers.map(|number| number as f32);
    let [r, g, b] = look.beside;
    let false_colour = if look.false_colour { 1.0 } else { 0.0 };
    [
        axis(DVec3::X),
        axis(DVec3::Y),
        axis(DVec3::Z),
        pose.centre_m.as_vec3().extend(0.0).to_array(),
        four([lens.fx, lens.fy, lens.cx, lens.cy]),
        four([lens.k1, lens.k2, lens.p1, lens.p2]),
        four([surface.width_m, surface.height_m, texels.columns.into(), texels.rows.into()]),
        [look.gamma, scale, lens.k3 as f32, false_colour],
        [r, g, b, levels as f32],
        [lens.width as f32, lens.height as f32, 0.0, 0.0],
    ]
}
