//! The command line itself.

use super::*;

#[test]
fn words_that_mean_nothing() {
    hold(&[
        Case { spoil: nothing, arguments: &["develop"], names: &["develop", "rigel --help"] },
        Case {
            spoil: nothing,
            arguments: &["radiance", "session", "--speed", "9"],
            names: &["--speed", "rigel radiance --help"],
        },
        Case { spoil: nothing, arguments: &["radiance"], names: &["SESSION", "rigel radiance --help"] },
        Case { spoil: nothing, arguments: &["fit"], names: &["OBSERVATIONS", "rigel fit --help"] },
        Case {
            spoil: nothing,
            arguments: &["observe", "session", "--texels", "many"],
            names: &["--texels", "many", "512x512"],
        },
        Case {
            spoil: nothing,
            arguments: &["observe", "session", "--texels", "0x5"],
            names: &["--texels", "0x5"],
        },
        Case {
            spoil: nothing,
            arguments: &["import", "photos", "new", "--distance", "900"],
            names: &["--distance", "900", "unit"],
        },
        Case {
            spoil: nothing,
            arguments: &["import", "photos", "new", "--csv", "views.csv", "--colmap", "model"],
            names: &["--csv", "--colmap"],
        },
        Case {
            spoil: nothing,
            arguments: &["import", "photos", "new", "--colmap", "model", "--bracket", "2"],
            names: &["--bracket", "--colmap"],
        },
        Case {
            spoil: nothing,
            arguments: &["capture", "new", "--rig", "/dev/null", "--dry-run"],
            names: &["/dev/null", "cannot open the port", "cable"],
        },
        Case {
            spoil: nothing,
            arguments: &["rig", "status", "--rig", "/dev/no-such-port"],
            names: &["/dev/no-such-port", "cannot open the port", "cable"],
        },
        Case {
            spoil: nothing,
            arguments: &["rig", "move", "--rig", "simulated", "--pan", "400"],
            names: &["400.000°", "-180.000° to 180.000°"],
        },
        Case {
            spoil: nothing,
            arguments: &["tracker", "watch", "--rig", "simulated", "--stations", "3"],
            names: &["--stations", "3", "rigel tracker --help"],
        },
        Case {
            spoil: nothing,
            arguments: &["capture", "new", "--views", "0"],
            names: &["no views", "at least one"],
        },
        Case {
            spoil: nothing,
            arguments: &["capture", "new", "--views", "4000000000"],
            names: &["4000000000", "at most"],
        },
        Case {
            spoil: nothing,
            arguments: &["evaluate", "phong.exr"],
            names: &["--references", "rigel evaluate --help"],
        },
        Case {
            spoil: nothing,
            arguments: &["evaluate", "phong.exr", "--session", "session"],
            names: &["--views"],
        },
        Case {
            spoil: nothing,
            arguments: &["evaluate", "phong.exr", "--session", "session", "--views", "view123"],
            names: &["session", "view123", "view000"],
        },
    ]);
}

#[test]
fn plans_that_cannot_be_made() {
    const PLAN: [&str; 2] = ["plan", "session/observations.rigel"];
    hold(&[
        Case { spoil: nothing, arguments: &["plan", "none.rigel"], names: &["none.rigel", "check the path"] },
        Case {
            spoil: nothing,
            arguments: &["plan", "phong.exr"],
            names: &["phong.exr", "not an observation map", "rigel observe"],
        },
        Case {
            spoil: nothing,
            arguments: &[PLAN[0], PLAN[1], "--views", "0"],
            names: &["no views", "at least one"],
        },
        Case {
            spoil: nothing,
            arguments: &[PLAN[0], PLAN[1], "--views", "5000"],
            names: &["5000 views", "within reach", "ask for at most"],
        },
        Case {
            spoil: nothing,
            arguments: &[PLAN[0], PLAN[1], "--zenith-limit", "95"],
            names: &["95", "up to 90"],
        },
        Case {
            spoil: nothing,
            arguments: &[PLAN[0], PLAN[1], "--out", "session/session.toml"],
            names: &["session.toml", ".csv"],
        },
        Case {
            spoil: nothing,
            arguments: &[PLAN[0], PLAN[1], "--rig", "/dev/no-such-port"],
            names: &["/dev/no-such-port", "cannot open the port"],
        },
        Case {
            spoil: nothing,
            arguments: &["capture", "new", "--directions", "none.csv"],
            names: &["none.csv", "check the path"],
        },
        Case {
            spoil: nothing,
            arguments: &["capture", "new", "--directions", "views.csv"],
            names: &["views.csv", "azimuth_deg"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("next.csv"), "azimuth_deg,zenith_deg\n10,120\n").unwrap(),
            arguments: &["capture", "new", "--directions", "next.csv"],
            names: &["next.csv", "line 2", "120", "0 to 90"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("next.csv"), "azimuth_deg,zenith_deg\n10,20\n").unwrap(),
            arguments: &["capture", "session", "--resume", "--dry-run", "--directions", "next.csv"],
            names: &["only be added to a session that a rig captures", "rigel capture"],
        },
        Case {
            spoil: nothing,
            arguments: &["capture", "new", "--directions", "next.csv", "--views", "9"],
            names: &["--directions", "--views"],
        },
    ]);
}

#[test]
fn what_is_wrong_is_said_before_the_work() {
    hold(&[
        Case {
            spoil: nothing,
            arguments: &["render", "none.exr", "--out", "picture.gif"],
            names: &["picture.gif", ".png or .exr"],
        },
        Case {
            spoil: nothing,
            arguments: &["render", "none.exr", "--out", "nowhere/picture.png"],
            names: &["nowhere/picture.png", "cannot write"],
        },
        Case {
            spoil: nothing,
            arguments: &["render", "phong.exr", "--gamma", "0"],
            names: &["--gamma", "positive number"],
        },
        Case {
            spoil: nothing,
            arguments: &["render", "phong.exr", "--tilt", "nan"],
            names: &["--tilt", "nan", "12.5"],
        },
        Case {
            spoil: nothing,
            arguments: &["rig", "move", "--rig", "simulated", "--pan", "nan"],
            names: &["--pan", "nan", "12.5"],
        },
        Case {
            spoil: nothing,
            arguments: &["fit", "session/observations.rigel", "--model", "lobes"],
            names: &["lobes", "auto", "phong2"],
        },
        Case {
            spoil: nothing,
            arguments: &["fit", "session/observations.rigel", "--model", "phong", "--out", "nowhere/map.exr"],
            names: &["nowhere/map.exr", "cannot write"],
        },
        Case {
            spoil: nothing,
            arguments: &["import", "photos", "new", "--distance", "9in"],
            names: &["9in", "unknown unit", "200mm"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("errors"), "mine").unwrap(),
            arguments: &[
                "evaluate",
                "none.exr",
                "--session",
                "session",
                "--views",
                "view001",
                "--out",
                "errors",
            ],
            names: &["errors", "is a file", "folder"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("lens.toml"), "title = \"none\"").unwrap(),
            arguments: &["render", "phong.exr", "--camera", "lens.toml", "--out", "picture.png"],
            names: &["lens.toml", "cannot be used", "width, height, centre"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("peers.csv"), "# none\nmodel,us\nphong,1,2\n").unwrap(),
            arguments: &["chart", "--peers", "peers.csv"],
            names: &["peers.csv", "line 3", "tools/peers/texels.py"],
        },
        Case {
            spoil: |folder| {
                fs::copy(folder.join("session/radiance/view000.exr"), folder.join("view.exr"))
                    .map(drop)
                    .unwrap()
            },
            arguments: &["fit", "session/observations.rigel", "--model", "constant", "--out", "view.exr"],
            names: &["view.exr", "something else", "another name"],
        },
        Case {
            spoil: nothing,
            arguments: &["radiance", "session", "--response", "srgb", "--exposure-times", "measured"],
            names: &["--exposure-times measured", "--response", "leave one"],
        },
        Case {
            spoil: nothing,
            arguments: &["evaluate", "phong.exr", "--references", "list.json", "--views", "view001"],
            names: &["--references", "--views"],
        },
        Case {
            spoil: nothing,
            arguments: &["render", "phong.exr", "--camera", "camera.toml", "--size", "9x9"],
            names: &["--camera", "--size"],
        },
    ]);
}
