//! What a lab does to a cable: pulled and plugged in again, noisy, slow, or leading to something else.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::io::{ErrorKind, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use rigel::rig::{Contact, Rig, SerialPlace, SerialRig, State, Timing};
use rigel_protocol::{Limits, Restart};
use rigel_simulated::rig::{Faults, RigOptions, SimulatedRig};
use serialport::{SerialPort, TTYPort};

/// A rig whose port is looked for among `names` once it is lost.
fn greet_among(simulated: &SimulatedRig, names: &Names, timing: Timing) -> SerialRig {
    let names = names.0.clone();
    let place = SerialPlace::among(simulated.port_name(), move || names.lock().unwrap().clone());
    SerialRig::greet_at(Box::new(place), timing).unwrap()
}

/// Where a port may have come back.
#[derive(Clone, Default)]
struct Names(Arc<Mutex<Vec<String>>>);

impl Names {
    fn now(&self, name: &str) {
        *self.0.lock().unwrap() = vec![name.into()];
    }
}

/// The simulated rig, in slow motion where something is to happen in a move.
fn simulated(speed_factor: f64, faults: Faults) -> SimulatedRig {
    SimulatedRig::start(RigOptions { speed_factor, faults, ..Default::default() }).unwrap()
}

fn until(what: &str, mut happened: impl FnMut() -> bool) {
    let start = Instant::now();
    while !happened() {
        assert!(start.elapsed() < Duration::from_secs(10), "{what} did not happen");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn assert_at(simulated: &SimulatedRig, [pan_rad, tilt_rad]: [f64; 2]) {
    let at = simulated.position().now();
    // Half a step.
    let is_there = |is: f64, asked: f64| (is - asked).abs() < 6.2e-5;
    assert!(!at.moving && is_there(at.pan_rad, pan_rad) && is_there(at.tilt_rad, tilt_rad), "{at:?}");
}

const GOAL_RAD: [f64; 2] = [2.5, 0.8];
const RESTARTED: &str = "the rig has restarted";

fn move_in_background(mut rig: SerialRig) -> JoinHandle<rigel::Result<SerialRig>> {
    std::thread::spawn(move || rig.move_to(GOAL_RAD[0], GOAL_RAD[1]).map(|_| rig))
}

#[test]
fn a_cable_pulled_in_a_move_and_plugged_in_elsewhere_costs_time_and_nothing_else() {
    let (mut simulated, names) = (simulated(6.0, Faults::default()), Names::default());
    let mut rig = greet_among(&simulated, &names, Timing::default());
    rig.home().unwrap();
    let old_name = simulated.port_name().to_string();
    let mover = move_in_background(rig);
    until("the move", || simulated.position().now().pan_rad > 0.5);
    simulated.unplug();
    let new_name = simulated.replug().unwrap().to_string();
    names.now(&new_name);
    let mut rig = mover.join().unwrap().unwrap();
    assert_at(&simulated, GOAL_RAD);
    let notices = rig.take_notices().join("\n");
    assert!(notices.contains(&format!("{old_name}: the rig was unplugged")), "{notices}");
    assert!(notices.contains(&format!("plugged in again as {new_name}")), "{notices}");
    assert!(!notices.contains(RESTARTED), "{notices}");
    assert!(rig.describe().contains(&new_name));
    assert!(rig.take_notices().is_empty(), "told once");
}

#[test]
fn a_cable_pulled_in_homing_does_not_end_it() {
    let (mut simulated, names) = (simulated(8.0, Faults::default()), Names::default());
    let mut rig = greet_among(&simulated, &names, Timing::default());
    let homing = std::thread::spawn(move || rig.home().map(|()| rig));
    until("homing", || simulated.position().state() == State::Homing);
    std::thread::sleep(Duration::from_millis(50));
    names.now(simulated.replug().unwrap());
    homing.join().unwrap().unwrap();
    assert_at(&simulated, [0.0; 2]);
}

#[test]
fn a_cable_pulled_in_a_bracket_loses_no_photograph() {
    let (mut simulated, names) = (simulated(1.0, Faults::default()), Names::default());
    let rig = greet_among(&simulated, &names, Timing::default());
    let mut line = rig.trigger_line();
    line.contact = Contact { half_press_s: 0.02, pause_s: 0.05, confirm_s: 0.02 };
    let times_s = [0.1, 0.2, 0.05, 0.025];
    let start = SystemTime::now();
    let exposing = std::thread::spawn(move || line.expose(&times_s));
    until("a photograph", || simulated.position().photographs().len() == 1);
    simulated.unplug();
    // The camera does not know of the cable.
    until("the bracket", || simulated.position().photographs().len() == times_s.len());
    names.now(simulated.replug().unwrap());
    let exposed = exposing.join().unwrap().unwrap();
    let photographs = simulated.position().photographs();
    assert_eq!(photographs.len(), times_s.len(), "each once");
    assert!(exposed.iter().all(|e| e.confirmed));
    let first = exposed[0].at;
    for (exposed, photograph) in exposed.iter().zip(&photographs) {
        let since_first = exposed.at.duration_since(first).unwrap().as_secs_f64();
        let truly = (photograph.closed_us - photographs[0].closed_us) as f64 * 1e-6;
        assert!((since_first - truly).abs() < 0.02, "{since_first} {truly}");
    }
    assert!(first > start);
}

#[test]
fn the_times_of_photographs_are_those_of_the_rig() {
    let simulated = simulated(1.0, Faults::default());
    let rig = SerialRig::greet(simulated.port_name()).unwrap();
    let mut line = rig.trigger_line();
    line.contact = Contact { half_press_s: 0.0, pause_s: 0.01, confirm_s: 0.0 };
    // More than one message holds.
    let times_s: Vec<f64> = (0..15).map(|i| 1e-3 * f64::from(i + 1)).collect();
    let before = SystemTime::now();
    let exposed = line.expose(&times_s).unwrap();
    let after = SystemTime::now();
    let photographs = simulated.position().photographs();
    assert_eq!([exposed.len(), photographs.len()], [15; 2]);
    assert!(exposed.iter().all(|e| e.at > before && e.at < after && !e.confirmed));
    for (i, photograph) in photographs.iter().enumerate() {
        let closed_s = (photograph.opened_us - photograph.closed_us) as f64 * 1e-6;
        assert!((closed_s - times_s[i]).abs() < 1e-9);
        let since_first = exposed[i].at.duration_since(exposed[0].at).unwrap().as_secs_f64();
        let truly = (photograph.closed_us - photographs[0].closed_us) as f64 * 1e-6;
        assert!((since_first - truly).abs() < 0.02, "{since_first} {truly}");
    }
}

#[test]
fn a_rig_that_restarts_in_a_move_is_homed_again_and_goes_on() {
    for replug in [false, true] {
        let (mut simulated, names) = (simulated(8.0, Faults::default()), Names::default());
        let mut rig = greet_among(&simulated, &names, Timing::default());
        rig.home().unwrap();
        let mover = move_in_background(rig);
        until("the move", || simulated.position().now().pan_rad > 0.5);
        simulated.restart(Restart::Watchdog);
        if replug {
            names.now(simulated.replug().unwrap());
        }
        let mut rig = mover.join().unwrap().unwrap();
        assert_at(&simulated, GOAL_RAD);
        let notices = rig.take_notices().join("\n");
        assert!(notices.contains(RESTARTED) && notices.contains("watchdog"), "{notices}");
    }
}

#[test]
fn a_rig_that_restarts_between_moves_is_homed_again() {
    let mut simulated = simulated(30.0, Faults::default());
    let mut rig = SerialRig::open(simulated.port_name()).unwrap();
    rig.move_to(1.0, 0.5).unwrap();
    simulated.restart(Restart::Panic);
    rig.move_to(GOAL_RAD[0], GOAL_RAD[1]).unwrap();
    assert_at(&simulated, GOAL_RAD);
    assert!(rig.take_notices().join("\n").contains("panicked"));
}

#[test]
fn a_cable_that_is_out_for_longer_than_the_dead_man_bears_stops_the_rig_until_it_is_homed() {
    let (mut simulated, names) = (simulated(2.0, Faults::default()), Names::default());
    let timing = Timing { dead_man: Duration::from_millis(800), ..Timing::default() };
    let mut rig = greet_among(&simulated, &names, timing);
    rig.home().unwrap();
    let mover = move_in_background(rig);
    until("the move", || simulated.position().now().pan_rad > 0.3);
    simulated.unplug();
    until("the halt", || simulated.position().state() == State::Lost);
    assert!(simulated.position().now().pan_rad < GOAL_RAD[0] - 0.1);
    names.now(simulated.replug().unwrap());
    let mut rig = mover.join().unwrap().unwrap();
    assert_at(&simulated, GOAL_RAD);
    let notices = rig.take_notices().join("\n");
    assert!(notices.contains("heard nothing for 0.8 s") && !notices.contains(RESTARTED), "{notices}");
}

#[test]
fn whoever_listens_hears_of_the_cable_while_it_is_out() {
    let (mut simulated, names) = (simulated(30.0, Faults::default()), Names::default());
    let mut rig = greet_among(&simulated, &names, Timing::default());
    rig.home().unwrap();
    let told = Arc::new(Mutex::new(Vec::<String>::new()));
    rig.on_notice({
        let told = told.clone();
        move |text| told.lock().unwrap().push(text.into())
    });
    simulated.unplug();
    let mover = move_in_background(rig);
    until("the word", || told.lock().unwrap().iter().any(|text| text.contains("waiting 30 s")));
    names.now(simulated.replug().unwrap());
    mover.join().unwrap().unwrap();
}

#[test]
fn a_rig_that_does_not_come_back_is_an_error_in_time() {
    let (mut simulated, names) = (simulated(8.0, Faults::default()), Names::default());
    let timing = Timing { return_time: Duration::from_secs(2), ..Timing::default() };
    let mut rig = greet_among(&simulated, &names, timing);
    rig.home().unwrap();
    simulated.unplug();
    let start = Instant::now();
    let error = rig.move_to(1.0, 0.0).unwrap_err().to_string();
    assert!(start.elapsed() < Duration::from_secs(20), "it hung");
    assert!(error.starts_with(simulated.port_name()) && error.contains("did not come back"), "{error}");
    // It has not been forgotten since when: the next request does not wait as long again.
    let start = Instant::now();
    assert!(rig.move_to(1.0, 0.0).is_err() && start.elapsed() < Duration::from_secs(1));
}

#[test]
fn another_rig_in_the_place_of_the_first_is_refused() {
    let (mut first, names) = (simulated(30.0, Faults::default()), Names::default());
    let mut rig = greet_among(&first, &names, Timing::default());
    rig.home().unwrap();
    first.unplug();
    let limits = Limits { pan_max_mdeg: 90_000, ..RigOptions::default().limits };
    let second = SimulatedRig::start(RigOptions { limits, ..Default::default() }).unwrap();
    names.now(second.port_name());
    let before = second.position().now();
    let error = rig.move_to(1.0, 0.0).unwrap_err().to_string();
    assert!(error.contains("another rig is plugged in"), "{error}");
    assert_eq!(second.position().now(), before, "nothing moves");
}

#[test]
fn greeting_and_asking_move_nothing_and_the_first_move_homes() {
    let simulated = simulated(30.0, Faults::default());
    let before = simulated.position().now();
    let mut rig = SerialRig::greet(simulated.port_name()).unwrap();
    assert_eq!(rig.status().unwrap().state, State::Lost);
    assert_eq!(simulated.position().now(), before);
    rig.move_to(GOAL_RAD[0], GOAL_RAD[1]).unwrap();
    assert_at(&simulated, GOAL_RAD);
    let status = rig.status().unwrap();
    assert_eq!((status.state, status.halt, status.lost_steps), (State::Still, None, [0; 2]));
    assert!((status.pan_rad - GOAL_RAD[0]).abs() < 1e-4);
}

#[test]
fn a_rig_is_there_until_it_restarts_stops_or_stands_elsewhere() {
    let mut simulated = simulated(60.0, Faults::default());
    let mut rig = SerialRig::greet(simulated.port_name()).unwrap();
    assert!(!rig.is_there(0.0, 0.0).unwrap(), "nobody knows before it is homed");
    rig.move_to(0.5, 0.3).unwrap();
    assert!(rig.is_there(0.5, 0.3).unwrap() && rig.is_there(0.5, 0.3).unwrap());

    simulated.restart(Restart::Watchdog);
    rig.take_notices();
    assert!(!rig.is_there(0.5, 0.3).unwrap());
    assert!(rig.take_notices().join(" ").contains(RESTARTED));
    assert!(!rig.is_there(0.5, 0.3).unwrap(), "it is not there before it was sent there again");
    rig.move_to(0.5, 0.3).unwrap();
    assert!(rig.is_there(0.5, 0.3).unwrap());
    assert_at(&simulated, [0.5, 0.3]);

    rig.take_notices();
    assert!(!rig.is_there(0.6, 0.3).unwrap());
    let told = rig.take_notices().join(" ");
    assert!(told.contains("although nobody moved it"), "{told}");
    // It does not trust itself any more: it homes, although it is told to stay.
    rig.move_to(0.5, 0.3).unwrap();
    assert!(rig.is_there(0.5, 0.3).unwrap());

    // Somebody else's hello: the rig has restarted in between and answers, but is lost.
    simulated.restart(Restart::Power);
    rig.status().unwrap();
    assert!(!rig.is_there(0.5, 0.3).unwrap() && !rig.is_there(0.0, 0.0).unwrap());
}

#[test]
fn lost_steps_are_told() {
    let simulated = simulated(30.0, Faults::default());
    let mut rig = SerialRig::open(simulated.port_name()).unwrap();
    assert!(rig.take_notices().is_empty());
    simulated.position().slip([40, 0]);
    rig.home().unwrap();
    let notices = rig.take_notices().join("\n");
    assert!(notices.contains("off by") && notices.contains("40"), "{notices}");
}

/// Every move is made once and ends where it should.
fn survives(faults: Faults) {
    let simulated = simulated(60.0, faults);
    let mut rig = SerialRig::open(simulated.port_name()).unwrap();
    for goal in [[0.5, 0.3], [-2.0, 1.2], [1.0, 0.0], GOAL_RAD] {
        rig.move_to(goal[0], goal[1]).unwrap();
        assert_at(&simulated, goal);
    }
    rig.trigger_line().expose(&[0.01, 0.02]).unwrap();
    assert_eq!(simulated.position().photographs().len(), 2);
}

#[test]
fn frames_that_come_twice_are_obeyed_once() {
    survives(Faults { duplicate_every: 2, ..Faults::default() });
}

#[test]
fn frames_out_of_order_are_obeyed_once() {
    survives(Faults { reorder_every: 3, ..Faults::default() });
}

#[test]
fn frames_lost_spoilt_doubled_and_out_of_order_are_obeyed_once() {
    let (drop_every, corrupt_every, duplicate_every, reorder_every) = (5, 7, 3, 4);
    survives(Faults { drop_every, corrupt_every, duplicate_every, reorder_every, ..Faults::default() });
}

#[test]
fn answers_that_come_after_the_next_request_are_no_answers_to_it() {
    survives(Faults { delay_ms: 130, ..Faults::default() });
}

#[test]
fn a_rig_that_falls_silent_is_given_up() {
    let simulated = simulated(30.0, Faults { silent_after: Some(12), ..Faults::default() });
    let start = Instant::now();
    let outcome = SerialRig::open(simulated.port_name())
        .and_then(|mut rig| rig.move_to(1.0, 0.0).and_then(|_| rig.move_to(0.0, 0.0)));
    let error = outcome.unwrap_err().to_string();
    assert!(error.contains("no answer") && error.contains("other messages were heard"), "{error}");
    assert!(start.elapsed() < Duration::from_secs(60), "it hung");
}

/// Something else at the other end of a line: it hears bytes and says others.
struct Other {
    name: String,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Other {
    fn start(mut answer: impl FnMut(&[u8]) -> Vec<u8> + Send + 'static) -> Self {
        let (mut line, far_end) = TTYPort::pair().unwrap();
        line.set_timeout(Duration::from_millis(1)).unwrap();
        let (name, ended) = (far_end.name().unwrap(), Arc::<AtomicBool>::default());
        let thread = std::thread::spawn({
            let ended = ended.clone();
            move || {
                let (_far_end, mut buffer) = (far_end, [0; 256]);
                while !ended.load(Ordering::Relaxed) {
                    let count = match line.read(&mut buffer) {
                        Ok(count) => count,
                        Err(e) if e.kind() == ErrorKind::TimedOut => 0,
                        Err(_) => return,
                    };
                    // Where nobody reads, it is lost.
                    let _ = line.write_all(&answer(&buffer[..count]));
                }
            }
        });
        Self { name, ended, thread: Some(thread) }
    }
}

impl Drop for Other {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        let _ = self.thread.take().unwrap().join();
    }
}

/// The error of greeting what is at that port.
fn refused(name: &str) -> String {
    let start = Instant::now();
    let error = SerialRig::greet(name).err().unwrap().to_string();
    assert!(start.elapsed() < Duration::from_secs(30), "it hung");
    assert!(error.starts_with(name), "{error}");
    error
}

#[test]
fn a_port_where_nothing_is_heard_is_told_from_one_that_babbles() {
    let silent = Other::start(|_| vec![]);
    let error = refused(&silent.name);
    assert!(error.contains("nothing at all is heard") && error.contains("power"), "{error}");

    let mut state = 1_u32;
    let babbling = Other::start(move |_| {
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        (0..200).map(|_| noise()).collect()
    });
    let error = refused(&babbling.name);
    assert!(error.contains("bytes were heard and no message") && error.contains("115200 baud"), "{error}");
}

#[test]
fn a_wrong_baud_rate_is_named_as_what_it_may_be() {
    // At half the rate every bit is seen twice and a byte becomes two.
    let garbled = Other::start(|heard| {
        let stretch = |nibble: u8| (0..4).fold(0, |byte, i| byte | ((nibble >> i & 1) * 3) << (2 * i));
        heard.iter().flat_map(|&byte| [stretch(byte & 15), stretch(byte >> 4)]).collect()
    });
    let error = refused(&garbled.name);
    assert!(error.contains("no message") && error.contains("115200 baud"), "{error}");
}

#[test]
fn a_line_that_only_echoes_is_no_rig() {
    let echo = Other::start(<[u8]>::to_vec);
    let error = refused(&echo.name);
    assert!(error.contains("no rig answers") && !error.contains('{'), "{error}");
}
