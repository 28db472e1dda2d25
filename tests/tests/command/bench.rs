//! `rigel devices`, `rigel rig` and `rigel tracker` on the simulated rig.

#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

fn rigel(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rigel"));
    command.args(arguments);
    command
}

fn succeed(arguments: &[&str]) -> String {
    let output = rigel(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Runs until it has said a line, then presses Ctrl-C: that ends it well.
fn until_interrupted(arguments: &[&str]) -> String {
    let mut child = rigel(arguments).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut said = vec![lines.next().unwrap().unwrap(), lines.next().unwrap().unwrap()];
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    said.extend(lines.map_while(Result::ok));
    assert!(child.wait().unwrap().success(), "{said:?}");
    said.join("\n")
}

#[test]
fn a_rig_is_asked_without_moving() {
    let said = succeed(&["rig", "status", "--rig", "simulated"]);
    assert!(said.contains("simulated rig on") && said.contains("\nLost at pan 0.000°"), "{said}");
}

#[test]
fn a_rig_goes_home_and_elsewhere() {
    let said = succeed(&["rig", "home", "--rig", "simulated"]);
    assert!(said.contains("Still at pan 0.000°, tilt 0.000°"), "{said}");
    // To the nearest step, and that is what is said.
    let said = succeed(&["rig", "move", "--pan", "-30", "--tilt", "20", "--rig", "simulated"]);
    assert!(said.contains("Still at pan -30.000°, tilt 19.998°"), "{said}");
}

#[test]
fn watching_ends_with_ctrl_c() {
    let said = until_interrupted(&["rig", "watch", "--rig", "simulated"]);
    assert!(said.contains("Lost at pan 0.000°"), "{said}");
}

#[test]
fn watching_a_tracker_ends_with_a_summary() {
    let said = until_interrupted(&["tracker", "watch", "--rig", "simulated"]);
    let summary = said.split("in all:").nth(1).unwrap();
    assert!(summary.contains("records forwarded") && summary.contains("refused by a check"), "{said}");
}

#[test]
fn only_a_camera_on_the_trigger_line_has_a_flash_sync() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("s");
    let output = rigel(&["capture", session.to_str().unwrap(), "--flash-sync"]).output().unwrap();
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && told.contains("--camera trigger"), "{told}");
    assert!(!session.exists());
}

#[test]
fn what_is_attached_is_listed() {
    // Every line names what is attached and what it is, or there is nothing: what is there differs from machine to machine.
    let said = succeed(&["devices"]);
    let ports = said.lines().filter(|line| !line.starts_with("webcam:")).collect::<Vec<_>>();
    match &ports[..] {
        ["no serial ports"] => {}
        [] => panic!("not even that there are no serial ports: {said}"),
        ports => {
            for port in ports {
                let parts: Vec<_> = port.splitn(3, ": ").collect();
                let [name, usb, answer] = parts[..] else { panic!("{port}") };
                assert!(!name.is_empty() && (usb == "no USB device" || usb.starts_with("USB ")), "{port}");
                let told = ["no rig answers", "cannot open the port", "the rig speaks version"];
                let refused = told.iter().any(|told| answer.starts_with(told));
                assert!(refused || answer.contains("(protocol "), "{port}");
            }
        }
    }
}
