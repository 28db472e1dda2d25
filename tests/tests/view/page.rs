//! The page in a browser without a network: what it draws, what it weighs, what it asks for.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

mod common;

use std::path::Path;
use std::process::{Command, Output};

use common::{cameras, fitted, mixed, observed};
use glam::DVec3;
use rigel::fit::Model;
use rigel::geometry::{Lens, Pose, Texels};
use rigel::parameter_map::ParameterMap;
use rigel::progress::Silent;
use rigel::render::{Rendering, expose, gamma_for_median, render};
use rigel::web::{Exhibit, page};
use serde_json::json;

const TEXELS: Texels = Texels { columns: 48, rows: 36 };

/// Chromium with a new profile; `None`, after saying so, where there is none.
fn chromium(arguments: &[String]) -> Option<Output> {
    let profile = tempfile::tempdir().unwrap();
    let ran = Command::new("chromium")
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-sync",
        ])
        .args(["--disable-background-networking", "--disable-component-update", "--force-color-profile=srgb"])
        .args([
            "--use-gl=angle",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--hide-scrollbars",
        ])
        .args(["--virtual-time-budget=20000", "--enable-logging=stderr"])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .args(arguments)
        .output();
    match ran {
        Ok(output) => Some(output),
        Err(error) => {
            assert!(
                std::env::var_os("CI").is_none(),
                "chromium cannot be run: {error}; apt install chromium"
            );
            eprintln!("skipped: chromium cannot be run ({error}); apt install chromium");
            None
        }
    }
}

/// Its picture of a page.
fn screenshot(page: &Path, hash: &str, size: (u32, u32), out: &Path) -> Option<()> {
    let output = chromium(&[
        format!("--window-size={},{}", size.0, size.1),
        format!("--screenshot={}", out.display()),
        format!("file://{}#{hash}", page.display()),
    ])?;
    assert!(out.exists(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(())
}

fn truth(map: &ParameterMap, lens: &Lens, pose: &Pose) -> (Rendering, f32) {
    let radiance = |point, direction| map.radiance_at(map.surface.texel_at(map.texels, point), direction);
    let picture = render(&map.surface, lens, pose, radiance, &Silent).unwrap();
    let inside = picture.inside.iter().zip(&picture.radiance).filter(|(inside, _)| **inside);
    let gamma = gamma_for_median(&inside.flat_map(|(_, radiance)| *radiance).collect::<Vec<f32>>()).unwrap();
    (picture, gamma)
}

/// A link that shows the page's map number `map` as a camera sees it.
fn link(map: usize, lens: &Lens, pose: &Pose, gamma: f32) -> String {
    let axis = |axis: DVec3| pose.direction_to_surface(axis).to_array();
    json!({
        "map": map, "fx": lens.fx, "fy": lens.fy, "cx": lens.cx, "cy": lens.cy, "width": lens.width, "height": lens.height,
        "right": axis(DVec3::X), "down": axis(DVec3::Y), "forward": axis(DVec3::Z), "centre": pose.centre_m.to_array(), "gamma": gamma,
    })
    .to_string()
    .bytes()
    .map(|byte| if byte.is_ascii_alphanumeric() { char::from(byte).to_string() } else { format!("%{byte:02X}") })
    .collect()
}

#[test]
fn the_page_shows_what_the_processor_draws() {
    let Some(cameras) = cameras() else { return };
    let (surface, observed) = observed(TEXELS);
    let models = ["phong", "phong3", "phong2-shared", "log-quadratic", "msh36", "hsh16", "sh16"]
        .map(|name| Model::parse(name).unwrap());
    let mut maps = models.map(|model| fitted(surface, TEXELS, model, &observed)).to_vec();
    maps.push(mixed(&maps));
    let exhibits: Vec<Exhibit> = maps
        .iter()
        .map(|map| Exhibit { name: map.models[0].name(), map: map.clone(), facts: map.facts() })
        .collect();
    let made = page("</script> & all", &exhibits, &Silent).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("page.html");
    std::fs::write(&path, &made.html).unwrap();
    let mut bad = vec![];
    for (i, map) in maps.iter().enumerate() {
        assert!(made.errors_255[i] <= 0.4, "{}: {}", exhibits[i].name, made.errors_255[i]);
        let (lens, pose) = cameras[i % cameras.len()];
        let (truth, gamma) = truth(map, &lens, &pose);
        let out = folder.path().join(format!("{i}.png"));
        if screenshot(&path, &link(i, &lens, &pose, gamma), (lens.width, lens.height + 90), &out).is_none() {
            return;
        }
        let picture = image::open(&out).unwrap().into_rgb8();
        let (mut sum, mut count) = (0.0, 0.0);
        for (k, radiance) in truth.radiance.iter().enumerate() {
            let pixel = picture.get_pixel(k as u32 % lens.width, k as u32 / lens.width);
            for c in 0..3 {
                sum += f64::from((255.0 * expose(radiance[c], gamma) - f32::from(pixel[c])).abs());
                count += f64::from(u8::from(truth.inside[k]));
            }
        }
        let mean = sum / count;
        println!(
            "{:>14}{}: page {mean:.2} of 255, quantisation {:.2}",
            exhibits[i].name,
            if map.models.len() > 1 { " and others" } else { "" },
            made.errors_255[i]
        );
        // The bar is 2; what it is on this machine, with some room.
        if mean > 0.7 {
            bad.push(format!("{}: {mean}", exhibits[i].name));
        }
    }
    assert!(bad.is_empty(), "{bad:?}");
}

/// Presses keys once the page has drawn, and writes into its title what came of it.
const PRESS: &str = r#"<script>
const wait = () => document.documentElement.dataset.drawn === undefined ? setTimeout(wait, 50) : press();
const key = (key) => document.activeElement.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
const picture = () => document.getElementById("picture").toDataURL();
async function press() {
  const seen = [];
  // What a key asks for is drawn in a later frame, and frames are rare without a display.
  const frame = async (before) => {
    for (let i = 0; i < 50 && picture() === before; i++) await new Promise((done) => setTimeout(done, 100));
  };
  let before = picture();
  for (const one of ["ArrowLeft", "ArrowUp", "+", "]", "f", "m", "0", "h"]) {
    key(one);
    await frame(before);
    const after = picture();
    seen.push(`${one}:${after === before ? "same" : "other"}`);
    before = after;
  }
  document.title = `keys ${seen.join(" ")} hidden:${document.getElementById("controls").hidden} map:${document.documentElement.dataset.drawn} requests:${performance.getEntriesByType("resource").length}`;
}
wait();
</script></body>"#;

#[test]
fn keys_alone_do_everything_and_nothing_is_asked_for() {
    let texels = Texels { columns: 12, rows: 9 };
    let (surface, observed) = observed(texels);
    let exhibit = |name: &str| {
        let map = fitted(surface, texels, Model::parse(name).unwrap(), &observed);
        Exhibit { name: name.into(), facts: map.facts(), map }
    };
    let made = page("keys", &[exhibit("phong"), exhibit("constant")], &Silent).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("page.html");
    std::fs::write(&path, made.html.replace("</body>", PRESS)).unwrap();
    let Some(output) = chromium(&["--dump-dom".into(), format!("file://{}", path.display())]) else { return };
    let (dom, told) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    let title =
        dom.split_once("<title>").and_then(|(_, rest)| rest.split_once("</title>")).map(|(title, _)| title);
    let want = "keys ArrowLeft:other ArrowUp:other +:other ]:other f:other m:other 0:other h:same hidden:true map:1 requests:0";
    assert_eq!(title, Some(want), "{told}");
    assert!(!told.contains("Content Security Policy"), "{told}");
}

#[test]
fn a_page_asks_for_nothing_and_holds_no_foreign_script() {
    let (surface, observed) = observed(Texels { columns: 4, rows: 3 });
    let map = fitted(surface, Texels { columns: 4, rows: 3 }, Model::Constant, &observed);
    let made =
        page("<b>a</b></script>", &[Exhibit { name: "</script>".into(), facts: vec![], map }], &Silent)
            .unwrap();
    assert!(made.html.contains("default-src 'none'"));
    for address in ["http:", "https:", "src=", "url(", "import(", "fetch("] {
        assert!(!made.html.contains(address), "{address}");
    }
    assert!(made.html.contains("<h1>&lt;b>a"));
    assert_eq!(made.html.matches("</script>").count(), 2);
    assert!(page("none", &[], &Silent).is_err());
}
