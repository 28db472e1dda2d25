//! A small session of the simulated camera with everything that follows from it, and the command to try on copies of it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use rigel::camera::Camera;
use rigel::geometry::Lens;
use rigel_simulated::camera::{Options, SimulatedCamera};
use rigel_simulated::scene::Scene;

/// How many views it has.
pub const VIEWS: usize = 7;
const TIMES_S: [f64; 2] = [0.03, 0.01];

/// The camera's lens: no distortion, so that COLMAP's simplest model describes it.
pub fn lens() -> Lens {
    Lens::pinhole(80, 60, 175.0)
}

/// Pan and tilt of a view, radians.
pub fn angles(view: usize) -> (f64, f64) {
    (0.9 * view as f64, 0.12 * view as f64)
}

/// The command, which works in `folder`.
pub fn rigel(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rigel"));
    command.current_dir(folder).args(arguments);
    command
}

/// Runs the command, which must succeed.
pub fn succeed(folder: &Path, arguments: &[&str]) -> String {
    let output = rigel(folder, arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// One sentence on stderr that has all of `names` in it and a remedy, and an exit code that says so.
pub fn assert_refused(what: &str, output: &Output, names: &[&str]) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    let code = output.status.code();
    assert!(code.is_some_and(|code| code != 0 && code != 101), "{what}: exit code {code:?}: {stderr}");
    assert!(stderr.starts_with("rigel: ") && stderr.ends_with('\n'), "{what}: {stderr}");
    assert_eq!(stderr.lines().count(), 1, "{what}: {stderr}");
    assert!(stderr.contains("; "), "{what} has no remedy: {stderr}");
    for name in names {
        assert!(stderr.contains(name), "{what} does not say {name:?}: {stderr}");
    }
}

/// Every file below `folder` with its bytes, every folder without; other things (sockets, pipes) without.
pub fn snapshot(folder: &Path) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let bytes = path.is_file().then(|| std::fs::read(&path).unwrap());
            if path.is_dir() {
                folders.push(path.clone());
            }
            found.insert(path, bytes);
        }
    }
    found
}

/// Says which file a command has touched, not only that it did.
pub fn assert_untouched(
    what: &str,
    before: &BTreeMap<PathBuf, Option<Vec<u8>>>,
    after: &BTreeMap<PathBuf, Option<Vec<u8>>>,
) {
    let names = before.keys().chain(after.keys());
    let touched: Vec<&PathBuf> = names.filter(|name| before.get(*name) != after.get(*name)).collect();
    assert!(touched.is_empty(), "{what}: these are not as they were: {touched:?}");
}

/// A copy of the workshop: `photos/`, `views.csv`, `lens.json`, `session/` with radiance and `observations.rigel`,
/// `phong.exr`.
pub fn workshop() -> tempfile::TempDir {
    static MADE: OnceLock<PathBuf> = OnceLock::new();
    let made = MADE.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(env!("CARGO_CRATE_NAME"));
        // What an earlier run has left.
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        make(&folder);
        folder
    });
    let folder = tempfile::tempdir().unwrap();
    for (path, bytes) in snapshot(made) {
        let copy = folder.path().join(path.strip_prefix(made).unwrap());
        match bytes {
            Some(bytes) => {
                std::fs::create_dir_all(copy.parent().unwrap()).unwrap();
                std::fs::write(&copy, bytes).unwrap();
            }
            None => std::fs::create_dir_all(copy).unwrap(),
        }
    }
    folder
}

fn make(folder: &Path) {
    std::fs::create_dir(folder.join("photos")).unwrap();
    let mut table = String::from("file,view,pan_deg,tilt_deg,exposure_s\n");
    for view in 0..VIEWS {
        let options = Options {
            lens: lens(),
            noise: false,
            vignetting: false,
            jpeg_quality: None,
            ..Options::default()
        };
        let (pan_rad, tilt_rad) = angles(view);
        let mut camera = SimulatedCamera::new(Scene::one_lobe(), options, || (pan_rad, tilt_rad));
        for (index, time_s) in TIMES_S.into_iter().enumerate() {
            let name = format!("view{view:03}_{index}");
            let taken =
                camera.photograph(time_s, &folder.join("photos").join(&name)).unwrap().taken().unwrap();
            let (pan, tilt) = (pan_rad.to_degrees(), tilt_rad.to_degrees());
            table += &format!("{name}.png,{view},{pan},{tilt},{:.5}\n", taken.exposure_s);
        }
    }
    std::fs::write(folder.join("views.csv"), table).unwrap();
    let Lens { fx, fy, cx, cy, width, height, .. } = lens();
    let json = format!(
        r#"{{"fx": {fx}, "fy": {fy}, "cx": {cx}, "cy": {cy}, "width": {width}, "height": {height}}}"#
    );
    std::fs::write(folder.join("lens.json"), json).unwrap();
    succeed(folder, &[&["import", "photos", "session", "--csv", "views.csv"], &IMPORT[..]].concat());
    succeed(folder, &["radiance", "session", "--response", "srgb"]);
    succeed(folder, &["observe", "session", "--texels", "16x12"]);
    succeed(folder, &["fit", "session/observations.rigel", "--model", "phong", "--out", "phong.exr"]);
}

/// What an import needs beside its table.
pub const IMPORT: [&str; 6] =
    ["--surface", "200mmx150mm", "--distance", "900mm", "--calibration", "lens.json"];
