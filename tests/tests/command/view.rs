//! `rigel view`: a picture without a window, a window on a virtual display, and what it says where there is neither device nor
//! display.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rigel::fit::Model;
use rigel::geometry::{Surface, Texels};
use rigel::parameter_map::ParameterMap;

/// How long a window may take to open and draw on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

fn write_map(path: &Path) {
    let texels = Texels { columns: 32, rows: 24 };
    let of = |i: usize| [0.1 + 0.01 * (i % 32) as f32, 0.3, 0.4, 1.0, 0.5, 0.2, 12.0, 0.0, 0.6, 0.8];
    ParameterMap {
        surface: Surface { width_m: 0.2, height_m: 0.15 },
        texels,
        models: vec![Model::Phong { lobes: 1 }],
        choice: vec![],
        parameters: (0..texels.count()).flat_map(of).collect(),
        diagnostics: None,
        uncertainty: None,
    }
    .write(path)
    .unwrap();
}

fn rigel(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rigel"));
    command.current_dir(folder).env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY");
    command
}

#[test]
fn without_a_window_the_picture_is_the_renderer_s() {
    let folder = tempfile::tempdir().unwrap();
    write_map(&folder.path().join("map.exr"));
    let options = ["--pan", "30", "--tilt", "35", "--gamma", "1.5", "--size", "200x150"];
    let drawn = rigel(folder.path())
        .args(["view", "map.exr", "--headless", "--screenshot", "a.png"])
        .args(options)
        .output();
    let drawn = drawn.unwrap();
    let said = String::from_utf8_lossy(&drawn.stderr).into_owned();
    if said.contains("no device with Vulkan") {
        assert!(std::env::var_os("CI").is_none(), "{said}");
        eprintln!("skipped: {said}");
        return;
    }
    assert!(drawn.status.success(), "{said}");
    assert!(
        rigel(folder.path())
            .args(["render", "map.exr", "--out", "b.png"])
            .args(options)
            .status()
            .unwrap()
            .success()
    );
    let [a, b] = ["a.png", "b.png"].map(|name| image::open(folder.path().join(name)).unwrap().into_rgb8());
    let off = a.iter().zip(b.iter()).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64;
    assert!(off <= 0.5, "{off}");
}

#[test]
fn no_device_and_no_display_are_told_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    write_map(&folder.path().join("map.exr"));
    let no_device = rigel(folder.path())
        .env("VK_ICD_FILENAMES", "/nowhere.json")
        .env("VK_DRIVER_FILES", "/nowhere.json")
        .args(["view", "map.exr", "--headless", "--screenshot", "a.png"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&no_device.stderr).into_owned();
    assert!(!no_device.status.success() && said.contains("apt install mesa-vulkan-drivers"), "{said}");
    let no_display = rigel(folder.path()).args(["view", "map.exr"]).output().unwrap();
    let said = String::from_utf8_lossy(&no_display.stderr).into_owned();
    assert!(!no_display.status.success() && said.contains("--headless"), "{said}");
}

/// Ends with the test, whatever becomes of it.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_window_opens_and_draws() {
    let display = Command::new("Xvfb")
        .args(["-displayfd", "1", "-screen", "0", "1024x768x24", "-nolisten", "tcp"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn();
    let mut display = match display {
        Ok(display) => Ended(display),
        Err(error) => {
            assert!(std::env::var_os("CI").is_none(), "Xvfb cannot be run: {error}; apt install xvfb");
            eprintln!("skipped: Xvfb cannot be run ({error}); apt install xvfb");
            return;
        }
    };
    let mut number = String::new();
    BufReader::new(display.0.stdout.take().unwrap()).read_line(&mut number).unwrap();
    let folder = tempfile::tempdir().unwrap();
    write_map(&folder.path().join("map.exr"));
    let window = rigel(folder.path())
        .env("DISPLAY", format!(":{}", number.trim()))
        .args(["view", "map.exr", "--screenshot", "a.png", "--size", "320x240", "--gamma", "1.5"])
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut window = Ended(window);
    let (start, out) = (Instant::now(), folder.path().join("a.png"));
    while !out.exists() {
        if let Some(status) = window.0.try_wait().unwrap() {
            let said = std::io::read_to_string(window.0.stderr.take().unwrap()).unwrap();
            panic!("the window closed by itself ({status}): {said}");
        }
        assert!(start.elapsed() < PATIENCE, "no picture");
        std::thread::sleep(Duration::from_millis(100));
    }
    let picture = image::open(&out).unwrap().into_rgb8();
    let lit = picture.pixels().filter(|pixel| pixel[1] > 40).count();
    assert!(lit > 5_000, "{lit} pixels of {:?} are lit", picture.dimensions());
    // It goes on until somebody ends it.
    assert!(window.0.try_wait().unwrap().is_none());
}

fn succeeded(folder: &Path, arguments: &[&str]) -> Option<String> {
    let output = rigel(folder).args(arguments).output().unwrap();
    let said =
        [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text).into_owned()).concat();
    if said.contains("no device with Vulkan") {
        assert!(std::env::var_os("CI").is_none(), "{said}");
        eprintln!("skipped: {said}");
        return None;
    }
    assert!(output.status.success(), "{arguments:?}: {said}");
    Some(said)
}

#[test]
fn a_texel_s_radiance_is_drawn_beside_the_picture_and_one_beside_the_map_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    write_map(&folder.path().join("map.exr"));
    let picture = ["view", "map.exr", "--headless", "--size", "200x150", "--screenshot"];
    let with = |more: &[&str]| succeeded(folder.path(), &[&picture, more].concat());
    if with(&["alone.png"]).is_none() {
        return;
    }
    with(&["dim.png", "--texel", "0,0"]).unwrap();
    with(&["bright.png", "--texel", "31,23"]).unwrap();
    let [alone, dim, bright] = ["alone.png", "dim.png", "bright.png"]
        .map(|name| image::open(folder.path().join(name)).unwrap().into_rgb8());
    assert!(dim.width() > alone.width() + 200);
    // A ring around the texel and nothing else.
    let ring = |with: &image::RgbImage| {
        let is_drawn = |(x, y, pixel): &(u32, u32, &image::Rgb<u8>)| with.get_pixel(*x, *y) != *pixel;
        let (x, y): (Vec<u32>, Vec<u32>) =
            alone.enumerate_pixels().filter(is_drawn).map(|(x, y, _)| (x, y)).unzip();
        let [x, y] = [x, y].map(|at| (*at.iter().min().unwrap(), *at.iter().max().unwrap()));
        assert!(x.1 - x.0 < 20 && y.1 - y.0 < 20, "{x:?} {y:?}");
        [(x.0 + x.1) / 2, (y.0 + y.1) / 2]
    };
    // From the first texel to the last.
    let (first, last) = (ring(&dim), ring(&bright));
    assert!(last[0] > first[0] + 60 && last[1] > first[1] + 40, "{first:?} {last:?}");
    assert_ne!(dim, bright);
    for (texel, wanted) in [("32,0", "31,23"), ("0,24", "31,23"), ("5", "12,34"), ("-1,0", "12,34")] {
        let refused = rigel(folder.path())
            .args([&picture[..], &["none.png", &format!("--texel={texel}")]].concat())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(!refused.status.success() && said.contains(wanted), "{said}");
        assert!(!folder.path().join("none.png").exists());
    }
}

/// Flipping from a photograph to its reconstruction moves nothing.
#[test]
fn a_contact_sheet_of_a_simulated_session_shows_no_jump() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| succeeded(folder.path(), arguments);
    run(&["capture", "session", "--sampling", "spiral", "--views", "48"]).unwrap();
    let refused =
        rigel(folder.path()).args(["view", "map.exr", "--contact-sheet", "a.png"]).output().unwrap();
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--session"));
    run(&["radiance", "session"]).unwrap();
    run(&["observe", "session", "--texels", "128x96"]).unwrap();
    run(&["fit", "session/observations.rigel", "--model", "phong2"]).unwrap();
    let sheet = ["view", "session/phong2.exr", "--session", "session", "--contact-sheet", "sheet.png"];
    let Some(said) = run(&sheet) else { return };
    let shifts: Vec<f64> = said
        .lines()
        .filter_map(|line| line.split_once("shifted by ")?.1.strip_suffix(" pixels"))
        .map(|pair| {
            let (x, y) = pair.split_once(", ").unwrap();
            x.parse::<f64>().unwrap().hypot(y.parse().unwrap())
        })
        .collect();
    let worst = shifts.iter().copied().fold(0.0, f64::max);
    println!("photograph against reconstruction, ten views: at worst {worst:.2} pixels apart");
    assert_eq!(shifts.len(), 10, "{said}");
    assert!(worst < 0.25, "{said}");
    let picture = image::open(folder.path().join("sheet.png")).unwrap().into_rgb8();
    assert!(picture.width() > 1200 && picture.height() > 300);
    let again = rigel(folder.path()).args(sheet).output().unwrap();
    assert!(String::from_utf8_lossy(&again.stderr).contains("--force"));
}
