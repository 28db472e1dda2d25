//! What once went wrong: what fuzzing found and is meant to find (every file below `tests/fuzz/regressions` by its target's property),
//! and what reading found.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

#[path = "../fuzz/src/lib.rs"]
mod properties;
#[path = "regressions/radiance.rs"]
mod radiance;

use std::path::Path;

fn hold(target: &str, property: fn(&[u8])) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/regressions").join(target);
    let mut count = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        println!("{}", path.display());
        property(&std::fs::read(path).unwrap());
        count += 1;
    }
    assert!(count > 0, "{target} has no regressions");
}

#[test]
fn frames() {
    hold("frame", properties::frame);
}

#[test]
fn journals() {
    hold("journal", properties::journal);
}

#[test]
fn manifests() {
    hold("manifest", properties::manifest);
}

#[test]
fn trackers() {
    hold("tracker", properties::tracker);
}
