//! Observations leave Rigel as OpenEXR and as Zarr, and another program reads what the observation map holds.

use std::path::Path;
use std::process::Command;

use rigel::observation::ObservationMap;

use crate::common::{IMPORT, assert_refused, assert_untouched, rigel, snapshot, succeed, workshop};

/// What Python reads; `None`, after saying so, where there is none.
fn read_by_python(kind: &str, path: &Path) -> Option<(u32, u32, Vec<String>, Vec<f32>)> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/tests/command/see/observations.py");
    let output = match Command::new("python3").args([script, kind]).arg(path).output() {
        Ok(output) => output,
        Err(error) => {
            assert!(std::env::var_os("CI").is_none(), "python3 cannot be run: {error}");
            eprintln!("skipped: python3 cannot be run ({error})");
            return None;
        }
    };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let end = output.stdout.iter().position(|byte| *byte == b'\n').unwrap();
    let (rows, columns, names) = serde_json::from_slice(&output.stdout[..end]).unwrap();
    let float = |four: &[u8]| f32::from_le_bytes(four.try_into().unwrap());
    Some((rows, columns, names, output.stdout[end + 1..].chunks_exact(4).map(float).collect()))
}

#[test]
fn python_reads_the_observations_as_they_are() {
    let folder = workshop();
    // More than the board: what is dark is not measured. Several tiles, which do not divide the map evenly.
    let wide =
        [&["import", "photos", "wide", "--csv", "views.csv", "--surface", "300mmx225mm"], &IMPORT[2..]];
    succeed(folder.path(), &wide.concat());
    succeed(folder.path(), &["radiance", "wide", "--response", "srgb"]);
    succeed(folder.path(), &["observe", "wide", "--texels", "50x53"]);
    let map = ObservationMap::open(&folder.path().join("wide/observations.rigel")).unwrap();
    let header = map.header();
    assert!(header.tiles().count() > 1 && !header.texels.rows.is_multiple_of(header.tile.rows));
    let mut want = vec![[f32::NAN; 4]; header.texels.count() * header.views.len()];
    for tile in 0..header.tiles().count() {
        for ((column, row), texel) in map.tile(tile).unwrap() {
            for (i, view) in texel.view.iter().enumerate() {
                let index = (row * header.texels.columns + column) as usize * header.views.len();
                let [r, g, b] = texel.radiance[i];
                want[index + *view as usize] = [r, g, b, texel.sigma[i]];
            }
        }
    }
    assert!(want.iter().any(|values| values[0].is_nan()) && want.iter().any(|values| values[3] > 0.0));
    for (kind, source) in [("exr", "wide"), ("zarr", "wide/observations.rigel")] {
        let out = format!("out.{kind}");
        let told = succeed(folder.path(), &["export", source, &format!("--{kind}"), &out]);
        assert!(told.contains("7 views of 50x53 texels"), "{told}");
        let Some((rows, columns, names, values)) = read_by_python(kind, &folder.path().join(&out)) else {
            return;
        };
        assert_eq!((columns, rows), (header.texels.columns, header.texels.rows));
        assert!(names.iter().eq(header.views.iter().map(|view| &view.name)));
        let bits = |value: &f32| if value.is_nan() { None } else { Some(value.to_bits()) };
        let same = values.iter().map(bits).eq(want.as_flattened().iter().map(bits));
        assert!(same && values.len() == 4 * want.len(), "{kind}");
        let told = succeed(folder.path(), &["info", &out]);
        assert!(told.contains("observations: radiance of every texel") && told.contains("7 views"), "{told}");
        // The same picture as that of the file that it was made from.
        let pictures = ["wide/observations.rigel", &out].map(|of| {
            succeed(folder.path(), &["info", of, "--png", "mean.png", "--force"]);
            let picture = image::open(folder.path().join("mean.png")).unwrap().into_rgb8();
            std::fs::remove_file(folder.path().join("mean.png")).unwrap();
            picture
        });
        assert_eq!(pictures[0].dimensions(), (header.texels.columns, header.texels.rows));
        // OpenEXR's is read as half floats.
        let differs = |(a, b): (&u8, &u8)| a.abs_diff(*b) > 1;
        assert!(!pictures[0].as_raw().iter().zip(pictures[1].as_raw()).any(differs), "{kind}");
        assert_eq!(pictures[0].dimensions(), pictures[1].dimensions());
        if kind == "zarr" {
            refuses_other_shapes(folder.path(), &out);
        }
        // Nothing is replaced unasked.
        let before = snapshot(folder.path());
        let again = rigel(folder.path(), &["export", source, &format!("--{kind}"), &out]).output().unwrap();
        assert_refused(kind, &again, &["--force", &out]);
        assert_untouched(kind, &before, &snapshot(folder.path()));
        // A damaged file is made whole, and what does not belong to a store goes.
        let (whole, stale) = (folder.path().join(&out), folder.path().join(&out).join("stale"));
        let damaged = if whole.is_dir() { whole.join("radiance/0.0.0.0") } else { whole };
        std::fs::write(damaged, "damaged").unwrap();
        if stale.parent().unwrap().is_dir() {
            std::fs::write(stale, "stale").unwrap();
        }
        succeed(folder.path(), &["export", source, &format!("--{kind}"), &out, "--force"]);
        assert_untouched(kind, &before, &snapshot(folder.path()));
    }
}

/// A store whose numbers somebody has changed has no picture, and is none of Rigel's crashes.
fn refuses_other_shapes(folder: &Path, out: &str) {
    let path = folder.join(out).join("radiance/.zarray");
    let own = std::fs::read_to_string(&path).unwrap();
    for shape in ["4294967296,4294967296,7,3", "0,53,7,3", "50,53,7", "50,53,7,4", "53,50,9,3"] {
        let mut meta: serde_json::Value = serde_json::from_str(&own).unwrap();
        meta["shape"] = serde_json::from_str(&format!("[{shape}]")).unwrap();
        std::fs::write(&path, meta.to_string()).unwrap();
        let output = rigel(folder, &["info", out, "--png", "none.png"]).output().unwrap();
        assert_refused(shape, &output, &["radiance", "export it again"]);
    }
    std::fs::write(&path, own).unwrap();
}

#[test]
fn what_is_no_observations_is_not_exported_and_a_folder_of_another_kind_stays() {
    let folder = workshop();
    std::fs::create_dir(folder.path().join("mine.zarr")).unwrap();
    std::fs::write(folder.path().join("mine.zarr/letter.txt"), "Dear reader").unwrap();
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    std::fs::create_dir(folder.path().join("foreign.zarr")).unwrap();
    std::fs::write(folder.path().join("foreign.zarr/.zgroup"), "{\"zarr_format\": 2}").unwrap();
    std::fs::write(folder.path().join("foreign.zarr/.zattrs"), "{\"made_by\": \"another\"}").unwrap();
    // A name of as many bytes, which OpenEXR cannot hold.
    let mut observations = std::fs::read(folder.path().join("session/observations.rigel")).unwrap();
    let name = observations.windows(9).position(|bytes| bytes == b"\"view000\"").unwrap();
    observations[name..name + 9].copy_from_slice("\"viewΩ0\"".as_bytes());
    std::fs::write(folder.path().join("omega.rigel"), observations).unwrap();
    let before = snapshot(folder.path());
    assert_refused(
        "info",
        &rigel(folder.path(), &["info", "foreign.zarr"]).output().unwrap(),
        &["foreign.zarr"],
    );
    for (arguments, names) in [
        (vec!["phong.exr", "--zarr", "a.zarr"], vec!["phong.exr", "rigel observe"]),
        (vec!["phong.exr", "--exr", "a.exr"], vec!["phong.exr", "rigel observe"]),
        (vec!["empty", "--exr", "a.exr"], vec!["empty", "check the path"]),
        (vec!["session", "--zarr", "a.folder"], vec!["a.folder", ".zarr"]),
        (vec!["session", "session", "--exr", "a.exr"], vec!["2 files", "name one"]),
        (vec!["session", "--zarr", "mine.zarr", "--force"], vec!["mine.zarr", "no Zarr store"]),
        (vec!["session", "--zarr", "foreign.zarr", "--force"], vec!["foreign.zarr", "no Zarr store"]),
        (vec!["omega.rigel", "--exr", "a.exr"], vec!["viewΩ0", "--zarr"]),
        (vec!["session", "--exr", "none/a.exr"], vec!["a.exr", "check the path"]),
    ] {
        let what = arguments.join(" ");
        let output = rigel(folder.path(), &[&["export"], &arguments[..]].concat()).output().unwrap();
        assert_refused(&what, &output, &names);
        assert_untouched(&what, &before, &snapshot(folder.path()));
    }
}
