//! The host's rig against the firmware's core, across a pseudo-terminal.

use std::io::Write;
use std::time::{Duration, Instant};

use rigel::rig::{Rig, SerialPlace, SerialRig, Timing};
use rigel_firmware_core::{Controller, Handled, Pins};
use rigel_protocol::{
    Answer, Axis, Command, LARGEST_FRAME, Reply, Request, Restart, SCHEMA, VERSION, encode,
};
use rigel_simulated::rig::{Faults, RigOptions, SimulatedRig, mechanics};

/// A rig at `speed_factor` times the real speed, with faults on its line.
fn simulated(faults: Faults) -> SimulatedRig {
    SimulatedRig::start(RigOptions { speed_factor: 60.0, faults, ..Default::default() }).expect("it starts")
}

/// Half a step of the simulated rig, and half of the unit in which angles are said: 3.5 thousandths of a degree.
const HALF_STEP_RAD: f64 = 6.2e-5;

const VIEWS_RAD: [[f64; 2]; 5] = [[0.5, 0.3], [-2.0, 1.2], [3.1, 1.57], [-3.1, -0.17], [0.0, 0.0]];

#[test]
fn moves_arrive_and_the_position_is_true() {
    let simulated = simulated(Faults::default());
    let mut rig = SerialRig::open(simulated.port_name()).unwrap();
    assert!(rig.describe().contains(simulated.port_name()), "{}", rig.describe());
    let position = simulated.position();
    for [pan_rad, tilt_rad] in VIEWS_RAD {
        rig.move_to(pan_rad, tilt_rad).unwrap();
        let at = position.now();
        assert!(!at.moving);
        assert!(
            (at.pan_rad - pan_rad).abs() < HALF_STEP_RAD && (at.tilt_rad - tilt_rad).abs() < HALF_STEP_RAD,
            "{at:?}"
        );
    }
}

#[test]
fn the_surface_moves_while_the_host_waits() {
    let simulated = simulated(Faults::default());
    let mut rig = SerialRig::open(simulated.port_name()).unwrap();
    let position = simulated.position();
    let mover = std::thread::spawn(move || rig.move_to(3.0, 0.5).map(|_| rig));
    let mut seen = Vec::new();
    while !mover.is_finished() {
        seen.push(position.now());
        std::thread::sleep(Duration::from_millis(1));
    }
    mover.join().unwrap().unwrap();
    assert!(seen.windows(2).all(|s| s[0].pan_rad <= s[1].pan_rad));
    assert!(seen.iter().any(|s| s.moving && s.pan_rad > 0.1 && s.pan_rad < 2.9));
}

#[test]
fn the_mount_error_shows_in_the_true_position_alone() {
    let options = RigOptions { speed_factor: 30.0, mount_error_rad: 0.005, ..Default::default() };
    let simulated = SimulatedRig::start(options).unwrap();
    let mut rig = SerialRig::open(simulated.port_name()).unwrap();
    for [pan_rad, tilt_rad] in VIEWS_RAD {
        rig.move_to(pan_rad, tilt_rad).unwrap();
        let at = simulated.position().now();
        let error_rad = (at.pan_rad - pan_rad).abs().max((at.tilt_rad - tilt_rad).abs());
        assert!((1e-4..5.1e-3).contains(&error_rad), "{error_rad}");
    }
}

#[test]
fn a_move_beyond_the_limits_is_refused_with_its_value_and_nothing_moves() {
    let simulated = simulated(Faults::default());
    let mut rig = SerialRig::open(simulated.port_name()).unwrap();
    for ([pan_rad, tilt_rad], told) in [
        ([3.5, 0.0], "a pan of 200.535° is outside the rig's limits of -180.000° to 180.000°"),
        ([0.0, -0.5], "a tilt of -28.648° is outside the rig's limits of -10.000° to 90.000°"),
        ([f64::NAN, 0.0], "a pan of NaN°"),
        ([0.0, 1e12], "a tilt of"),
    ] {
        let error = rig.move_to(pan_rad, tilt_rad).unwrap_err().to_string();
        assert!(error.contains(told) && error.starts_with(simulated.port_name()), "{error}");
        let at = simulated.position().now();
        assert_eq!((at.pan_rad, at.tilt_rad, at.moving), (0.0, 0.0, false));
    }
    rig.move_to(0.1, 0.1).unwrap();
}

/// Every request is obeyed all the same, once.
fn survives(faults: Faults) {
    let simulated = simulated(faults);
    let mut rig = SerialRig::open(simulated.port_name()).expect("it answers");
    for [pan_rad, tilt_rad] in VIEWS_RAD {
        rig.move_to(pan_rad, tilt_rad).expect("it arrives");
        let at = simulated.position().now();
        assert!(!at.moving);
        assert!(
            (at.pan_rad - pan_rad).abs() < HALF_STEP_RAD && (at.tilt_rad - tilt_rad).abs() < HALF_STEP_RAD
        );
    }
}

#[test]
fn lost_frames_cost_time_and_nothing_else() {
    survives(Faults { drop_every: 3, ..Faults::default() });
}

#[test]
fn damaged_frames_cost_time_and_nothing_else() {
    survives(Faults { corrupt_every: 4, ..Faults::default() });
}

#[test]
fn lost_and_damaged_frames_cost_time_and_nothing_else() {
    survives(Faults { drop_every: 7, corrupt_every: 3, ..Faults::default() });
}

#[test]
fn an_unplugged_rig_is_an_error_that_names_the_port() {
    for frames in [0, 1, 3, 7, 9] {
        let simulated = simulated(Faults { unplug_after: Some(frames), ..Faults::default() });
        let start = Instant::now();
        let timing = Timing { return_time: Duration::from_millis(200), ..Timing::default() };
        // Another test's rig may take over the name of a port that is gone.
        let place = Box::new(SerialPlace::among(simulated.port_name(), Vec::new));
        let outcome = SerialRig::greet_at(place, timing).and_then(|mut rig| {
            VIEWS_RAD.iter().try_for_each(|&[pan, tilt]| rig.move_to(pan, tilt).map(|_| ()))
        });
        let error = outcome.unwrap_err().to_string();
        assert!(error.starts_with(simulated.port_name()) && error.contains("unplugged"), "{error}");
        assert!(start.elapsed() < Duration::from_secs(10), "it hung");
    }
}

#[test]
fn a_stuck_limit_switch_is_an_error_that_names_it_and_nothing_hangs() {
    for (axis, name) in [(Axis::Pan, "pan"), (Axis::Tilt, "tilt")] {
        let stuck_switch = Some(axis);
        let options = RigOptions { speed_factor: 60.0, stuck_switch, ..Default::default() };
        let simulated = SimulatedRig::start(options).unwrap();
        let start = Instant::now();
        let error = SerialRig::open(simulated.port_name()).err().unwrap().to_string();
        assert!(error.contains(name) && error.contains("switch does not open"), "{error}");
        assert!(start.elapsed() < Duration::from_secs(10), "it hung");
        assert!(!simulated.position().now().moving);
    }
}

#[test]
fn a_rig_that_says_nothing_is_given_up() {
    let simulated = simulated(Faults { drop_every: 1, ..Faults::default() });
    let error = SerialRig::open(simulated.port_name()).err().unwrap().to_string();
    assert!(error.starts_with(simulated.port_name()) && error.contains("no rig answers"), "{error}");
}

#[test]
fn firmware_of_another_version_is_refused_naming_both() {
    let simulated = simulated(Faults { version: Some(VERSION + 8), ..Faults::default() });
    let error = SerialRig::open(simulated.port_name()).err().unwrap().to_string();
    let both = [format!("version {} ", VERSION + 8), format!("version {VERSION} "), format!("{SCHEMA:08x}")];
    assert!(both.iter().all(|part| error.contains(part)), "{error}");
}

#[test]
fn a_host_may_take_over_a_rig_that_another_left_moving() {
    let options = RigOptions { speed_factor: 16.0, ..Default::default() };
    let simulated = SimulatedRig::start(options).unwrap();
    let position = simulated.position();
    // A host that starts a move and dies. It does not listen, so it asks until it sees the move.
    let mut port = std::fs::OpenOptions::new().write(true).open(simulated.port_name()).unwrap();
    let hello = Command::Hello { version: VERSION, schema: SCHEMA, conversation: 1 };
    let away = Command::MoveTo { pan_mdeg: 180_000, tilt_mdeg: 0 };
    let deadline = Instant::now() + Duration::from_secs(5);
    for (sequence, command) in (1..).zip([hello, Command::Home].into_iter().chain(std::iter::repeat(away))) {
        port.write_all(encode(&Request { sequence, command }, &mut [0; LARGEST_FRAME]).unwrap()).unwrap();
        if position.now().pan_rad > 0.3 {
            break;
        }
        assert!(Instant::now() < deadline, "the rig did not move");
        std::thread::sleep(Duration::from_millis(20));
    }
    drop(port);

    let mut rig = SerialRig::open(simulated.port_name()).unwrap();
    let at = position.now();
    assert_eq!((at.pan_rad, at.moving), (0.0, false), "homed");
    rig.move_to(0.2, 0.2).unwrap();
    // One host at a time; the next may come when this one has gone.
    assert!(SerialRig::open(simulated.port_name()).is_err());
    drop(rig);
    SerialRig::open(simulated.port_name()).unwrap();
}

#[test]
fn host_and_firmware_agree_on_the_time_of_a_move() {
    let simulated = simulated(Faults::default());
    let limits = SerialRig::open(simulated.port_name()).unwrap().limits();
    let mechanics = mechanics(RigOptions::default().limits);
    let mut firmware = Controller::new("clockwork", mechanics, Restart::Power).unwrap();
    let (mut pins, mut now_us) = (Switches { at: [0; 2], rising: [true; 2] }, 0);
    let hello = Command::Hello { version: VERSION, schema: SCHEMA, conversation: 1 };
    let views_mdeg = VIEWS_RAD.map(|view| view.map(|angle: f64| (angle.to_degrees() * 1e3).round() as i32));
    let moves = views_mdeg.map(|[pan_mdeg, tilt_mdeg]| Command::MoveTo { pan_mdeg, tilt_mdeg });
    let mut durations_s = Vec::new();
    for (sequence, command) in (1..).zip([hello, Command::Home].into_iter().chain(moves)) {
        let handled = firmware.handle(&Request { sequence, command }, now_us, &mut pins);
        if let Handled::Answer(Answer { reply: Reply::Accepted { duration_ms }, .. }) = handled {
            durations_s.push(f64::from(duration_ms) / 1e3);
        }
        while let Some(due_us) = firmware.next_us() {
            now_us = due_us;
            firmware.advance(now_us, &mut pins);
        }
    }
    assert_eq!(durations_s.len(), 1 + VIEWS_RAD.len());
    let mut from = [0.0; 2];
    for (view, duration_s) in VIEWS_RAD.into_iter().zip(&durations_s[1..]) {
        let late_s = duration_s - limits.travel_time_s(from, view);
        // Whatever falls comes up again by the backlash: four steps, at most 30 ms.
        assert!((-2e-3..32e-3).contains(&late_s), "{late_s} s later than the host believes");
        from = view;
    }
}

/// Switches that are pressed beyond both lower limits.
struct Switches {
    at: [i32; 2],
    rising: [bool; 2],
}

impl Pins for Switches {
    fn step(&mut self, axis: Axis) {
        self.at[axis as usize] += if self.rising[axis as usize] { 1 } else { -1 };
    }

    fn set_direction(&mut self, axis: Axis, positive: bool) {
        self.rising[axis as usize] = positive;
    }

    fn is_switch_pressed(&mut self, axis: Axis) -> bool {
        self.at[axis as usize] < -2_000
    }

    fn set_half_press(&mut self, _closed: bool) {}

    fn set_shutter(&mut self, _closed: bool) {}

    fn take_flash_sync(&mut self) -> bool {
        false
    }
}
