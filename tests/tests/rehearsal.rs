//! The dry run against the simulated rig: the same moves, in the rig's own time.

use rigel::rig::{Rig, RigLimits, SerialRig};
use rigel::sampling::{icosphere, spiral, tour};
use rigel_protocol::{Fault, Reply};
use rigel_simulated::rig::{RigOptions, SimulatedRig, rehearse};

#[test]
fn a_rehearsal_takes_as_long_as_the_rig_then_does() {
    let options = RigOptions { speed_factor: 200.0, ..RigOptions::default() };
    let simulated = SimulatedRig::start(options).unwrap();
    let mut rig = SerialRig::open(simulated.port_name()).unwrap();
    let mut stops = tour(&icosphere(1, 1.3).unwrap(), &rig.limits()).unwrap();
    // Small moves and turning back, too.
    stops.extend(tour(&spiral(20, 0.2).unwrap(), &rig.limits()).unwrap());
    let targets: Vec<[f64; 2]> = stops.iter().map(|stop| [stop.pan_rad, stop.tilt_rad]).collect();
    let rehearsal = rehearse(&rig.limits(), &targets).unwrap();
    for &[pan_rad, tilt_rad] in &targets {
        rig.move_to(pan_rad, tilt_rad).unwrap();
    }
    let moves = simulated.position().moves();
    assert_eq!(moves.len(), targets.len());
    let (mut rehearsed_s, mut taken_s, mut planned_s, mut at) = (0.0, 0.0, 0.0, [0.0; 2]);
    for ((outcome, taken), to) in rehearsal.moves.iter().zip(&moves).zip(&targets) {
        let (outcome_s, move_s) =
            (*outcome.as_ref().unwrap(), (taken.settled_us - taken.began_us) as f64 / 1e6);
        assert!(
            (outcome_s - move_s).abs() < 1e-3,
            "{at:?} to {to:?}: {outcome_s} s rehearsed, {move_s} s taken"
        );
        (rehearsed_s, taken_s) = (rehearsed_s + outcome_s, taken_s + move_s);
        planned_s += rig.limits().travel_time_s(at, *to);
        at = *to;
    }
    println!(
        "{} moves: {rehearsed_s:.3} s rehearsed, {taken_s:.3} s taken, {planned_s:.3} s by limits",
        moves.len()
    );
    assert!(rehearsal.homing_s > 1.0 && rehearsal.homing_s < 60.0);
}

#[test]
fn what_the_firmware_refuses_is_told_for_every_target_and_the_rest_goes_on() {
    let limits = RigLimits {
        pan_rad: [-3.0, 3.0],
        tilt_rad: [-0.1, 1.5],
        speed_rad_s: 1.0,
        acceleration_rad_s2: 2.0,
        settle_s: 0.3,
    };
    let targets = [[1.0, 0.5], [3.2, 0.5], [2.0, 1.0], [0.0, -0.2], [f64::NAN, 1e9], [0.0, 0.0]];
    let rehearsal = rehearse(&limits, &targets).unwrap();
    let refused: Vec<bool> = rehearsal.moves.iter().map(Result::is_err).collect();
    assert_eq!(refused, [false, true, false, true, true, false]);
    assert!(matches!(rehearsal.moves[3], Err(Reply::Refused(Fault::TiltOutside { .. }))));
    assert!(matches!(
        rehearsal.moves[1],
        Err(Reply::Refused(Fault::PanOutside { .. } | Fault::Winding { .. }))
    ));
    let without: Vec<[f64; 2]> = [0, 2, 5].map(|index| targets[index]).to_vec();
    let times =
        |rehearsal: &rigel_simulated::rig::Rehearsal| -> f64 { rehearsal.moves.iter().flatten().sum() };
    assert_eq!(times(&rehearsal), times(&rehearse(&limits, &without).unwrap()));
    assert_eq!(rehearse(&RigLimits { speed_rad_s: 0.0, ..limits }, &targets), Err(None));
}
