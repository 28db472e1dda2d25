//! Photographs for a map of the room, with their orientations.

use super::*;

const TURNED: &str = "file,qw,qx,qy,qz,exposure_s\na.png,1,0,0,0,0.1\nb.png,1,0,0,0,0.1\n";
const MOSAIC: &[&str] = &["mosaic", "frames.csv", "--out", "map.exr"];

#[test]
fn orientations_and_places_that_cannot_be_used() {
    hold(&[
        Case {
            spoil: nothing,
            arguments: &["lights", "session/radiance/view001.exr"],
            names: &["view001.exr", "twice as wide"],
        },
        Case { spoil: nothing, arguments: &["lights", "map.exr"], names: &["map.exr"] },
        Case {
            spoil: nothing,
            arguments: &["lights", "map.exr", "--out", "map.exr"],
            names: &["map.exr", ".csv"],
        },
        Case {
            spoil: nothing,
            arguments: &["mosaic", "photos", "--out", "map.exr"],
            names: &["frames.json"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("frames.csv"), TURNED.replace("b.png", "a.png")).unwrap(),
            arguments: MOSAIC,
            names: &["frames.csv", "a.png", "twice"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("frames.csv"), TURNED.replace("0.1\nb", "-3\nb")).unwrap(),
            arguments: MOSAIC,
            names: &["frames.csv", "a.png", "exposure_s = -3"],
        },
        Case {
            spoil: |folder| {
                fs::write(folder.join("frames.csv"), TURNED.replace("b.png,1", "b.png,nan")).unwrap()
            },
            arguments: MOSAIC,
            names: &["frames.csv", "b.png", "orientation"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("frames.csv"), TURNED).unwrap(),
            arguments: &["mosaic", "frames.csv", "--out", "map.exr", "--sigma", "0"],
            names: &["--sigma 0", "--no-refine"],
        },
        Case {
            spoil: |folder| {
                fs::write(folder.join("frames.csv"), TURNED).unwrap();
                fs::write(folder.join("map.png"), "somebody's").unwrap();
            },
            arguments: &["mosaic", "frames.csv", "--out", "map.exr", "--png"],
            names: &["map.png", "is there already"],
        },
        Case {
            spoil: |folder| {
                fs::write(folder.join("frames.csv"), TURNED).unwrap();
                fs::write(folder.join("a.png"), "a photograph").unwrap();
            },
            arguments: &["mosaic", "frames.csv", "--out", "a.exr", "--png", "--force"],
            names: &["a.png", "is one of the photographs"],
        },
    ]);
}

const TIMED: &str = "file,time_s\na.png,10\nb.png,11\n";

fn timed(folder: &Path) {
    fs::write(folder.join("frames.csv"), TIMED).unwrap();
}

#[test]
fn tracked_sessions_that_cannot_be_used() {
    hold(&[
        Case { spoil: timed, arguments: MOSAIC, names: &["frames.csv", "tracker.jsonl", "--tracker"] },
        Case {
            spoil: timed,
            arguments: &["mosaic", "frames.csv", "--out", "map.exr", "--tracker", "none.jsonl"],
            names: &["none.jsonl", "check the path"],
        },
        Case {
            spoil: timed,
            arguments: &["mosaic", "frames.csv", "--out", "map.exr", "--mount", "1,2,3"],
            names: &["1,2,3", "w,x,y,z"],
        },
        Case {
            spoil: timed,
            arguments: &["mosaic", "frames.csv", "--out", "map.exr", "--delay", "80"],
            names: &["--delay 80", "seconds"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("frames.csv"), TURNED).unwrap(),
            arguments: &["mosaic", "frames.csv", "--out", "map.exr", "--delay", "0.1"],
            names: &["frames.csv", "--tracker"],
        },
        Case {
            spoil: |folder| {
                timed(folder);
                fs::write(folder.join("tracker.csv"), "time_s,qw,qx,qy,qz\n1,1,0,0,0\n0,1,0,0,0\n").unwrap();
            },
            arguments: MOSAIC,
            names: &["tracker.csv", "line 3", "backwards"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("frames.csv"), TIMED.replace("11", "9")).unwrap(),
            arguments: MOSAIC,
            names: &["frames.csv", "b.png", "backwards"],
        },
    ]);
}
