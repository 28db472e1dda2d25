//! `rigel devices`, `rigel rig` and `rigel tracker`: what is attached, and does it work.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rigel::rig::{Format, Output, Port, Rig, RigStatus, SerialRig, StopLine, TrackerState, Tracking, ports};
use rigel::tracker::{StationSummary, Summary, Watch};
use rigel::{Error, Result};

use crate::arguments::{self, RigVerb, TrackerVerb, TrackerWatch};
use crate::bench::greet_named;
use crate::progress::{heed_interrupts, interrupted};
use crate::say::say;

/// How often something that changes is looked at.
const LOOK: Duration = Duration::from_millis(200);
/// How soon Ctrl-C stops a rig that moves.
const HEED: Duration = Duration::from_millis(20);
/// How often the tracker's figures are shown.
const SHOW: Duration = Duration::from_secs(1);

/// `rigel devices`: only a hello is said; nothing moves.
pub fn devices() -> Result<()> {
    let ports = ports()?;
    if ports.is_empty() {
        say!("no serial ports");
    }
    // All at once: where nobody answers, it takes two seconds to know.
    let answers: Vec<_> = std::thread::scope(|scope| {
        let asked: Vec<_> = ports.iter().map(|port| scope.spawn(|| answer(port))).collect();
        asked.into_iter().map(|thread| thread.join().unwrap_or_else(|_| "cannot be asked".into())).collect()
    });
    for (port, answer) in ports.iter().zip(answers) {
        let usb = port.usb.as_ref().map_or_else(|| "no USB device".into(), ToString::to_string);
        say!("{}: {usb}: {answer}", port.name);
    }
    #[cfg(feature = "webcam")]
    for camera in rigel::camera::webcam::list() {
        say!("webcam:{}: {}", camera.index, camera.name);
    }
    Ok(())
}

/// Who answers at a port.
fn answer(port: &Port) -> String {
    match SerialRig::greet(&port.name) {
        Ok(rig) => rig.describe(),
        // The remedy is for those who know that a rig is there.
        Err(Error::Device { what, .. }) => what,
        Err(error) => error.to_string(),
    }
}

/// `rigel rig`.
pub fn rig(arguments: &arguments::Rig) -> Result<()> {
    match &arguments.verb {
        RigVerb::Home(bench) => {
            let (mut rig, _simulated) = greet_named(&bench.rig)?;
            let line = rig.stop_line();
            stopped_by_interrupt(&line, || rig.home())?;
            tell(&rig.status()?);
        }
        RigVerb::Move(to) => {
            let (mut rig, _simulated) = greet_named(&to.bench.rig)?;
            let start = Instant::now();
            let line = rig.stop_line();
            stopped_by_interrupt(&line, || rig.move_to(to.pan.to_radians(), to.tilt.to_radians()))?;
            tell(&rig.status()?);
            say!("homed and moved in {:.1} s", start.elapsed().as_secs_f64());
        }
        RigVerb::Status(bench) => {
            let (mut rig, _simulated) = greet_named(&bench.rig)?;
            say!("{}", rig.describe());
            tell(&rig.status()?);
        }
        RigVerb::Watch(bench) => {
            heed_interrupts();
            let (mut rig, _simulated) = greet_named(&bench.rig)?;
            say!("{}", rig.describe());
            let mut last = None;
            while !interrupted() {
                let status = rig.status()?;
                if last != Some(status) {
                    tell(&status);
                    last = Some(status);
                }
                std::thread::sleep(LOOK);
            }
        }
    }
    Ok(())
}

/// Does something that moves the rig; Ctrl-C stops the rig, and then it is [`Error::Interrupted`].
fn stopped_by_interrupt<T>(line: &StopLine, moving: impl FnOnce() -> Result<T>) -> Result<T> {
    heed_interrupts();
    let ended = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let watch = scope.spawn(|| {
            while !ended.load(Ordering::Relaxed) && !interrupted() {
                std::thread::sleep(HEED);
            }
            // Again and again: the move may begin only now.
            while !ended.load(Ordering::Relaxed) {
                line.stop()?;
                std::thread::sleep(LOOK);
            }
            Ok(())
        });
        let outcome = moving();
        ended.store(true, Ordering::Relaxed);
        let stopped = watch.join().unwrap_or(Ok(()));
        if interrupted() { stopped.and_then(|()| line.stop()).and(Err(Error::Interrupted)) } else { outcome }
    })
}

fn tell(status: &RigStatus) {
    let mut more = String::new();
    if let Some(halt) = status.halt {
        more += &format!(", stopped by {halt:?}");
    }
    if status.lost_steps != [0, 0] {
        more += &format!(
            ", off by {} and {} steps at the last homing",
            status.lost_steps[0], status.lost_steps[1]
        );
    }
    if status.exposed > 0 {
        more += &format!(", last bracket {} photographs, {} confirmed", status.exposed, status.confirmed);
    }
    if status.bad_frames > 0 {
        more += &format!(", {} damaged messages heard", status.bad_frames);
    }
    say!(
        "{:?} at pan {:.3}°, tilt {:.3}°{more}",
        status.state,
        status.pan_rad.to_degrees(),
        status.tilt_rad.to_degrees()
    );
}

/// `rigel tracker`.
pub fn tracker(arguments: &arguments::Tracker) -> Result<()> {
    let TrackerVerb::Watch(arguments) = &arguments.verb;
    heed_interrupts();
    let (mut rig, _simulated) = greet_named(&arguments.bench.rig)?;
    let records = rig.records();
    rig.track(tracking(arguments))?;
    let (mut watch, mut bound_s) = (Watch::default(), 0.0_f64);
    let mut shown = Instant::now();
    while !interrupted() {
        if let Some(record) = records.next(LOOK) {
            watch.push(&record);
            bound_s = record.bound_s;
        }
        if shown.elapsed() >= SHOW {
            shown = Instant::now();
            // Also what tells a rig that has restarted to start its tracker again.
            let status = rig.tracker()?;
            if status.state == TrackerState::Running {
                show(&watch.summary(), bound_s);
            } else {
                say!("the tracker is {:?}, started {} times again", status.state, status.restarts);
            }
        }
    }
    say!("in all:");
    show(&watch.summary(), bound_s);
    let status = rig.tracker()?;
    say!(
        "{} records forwarded, {} refused by a check, {} bytes belonged to none, {} found no room, {} restarts",
        status.forwarded,
        status.rejected,
        status.skipped_bytes,
        status.overrun,
        status.restarts
    );
    rig.track(Tracking { stations: 0, ..tracking(arguments) })
}

fn tracking(arguments: &TrackerWatch) -> Tracking {
    Tracking {
        stations: arguments.stations,
        format: if arguments.ascii { Format::Ascii } else { Format::Binary },
        output: if arguments.euler { Output::Euler } else { Output::Quaternion },
    }
}

fn show(summary: &Summary, bound_s: f64) {
    if summary.stations.is_empty() {
        say!("no records yet");
    }
    for StationSummary {
        station,
        records,
        rate_hz,
        position_noise_m,
        angle_noise_rad,
        gaps,
        longest_gap_s,
        ..
    } in &summary.stations
    {
        say!(
            "station {station}: {records} records, {rate_hz:.1}/s, noise {:.3} mm and {:.3}°, {gaps} gaps, longest {:.0} ms; \
             {} lost on the way, time known within {:.2} ms",
            position_noise_m * 1e3,
            angle_noise_rad.to_degrees(),
            longest_gap_s * 1e3,
            summary.lost,
            bound_s * 1e3
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rigel_simulated::rig::{Faults, RigOptions, SimulatedRig};

    fn answer_of(faults: Faults) -> String {
        let simulated = SimulatedRig::start(RigOptions { faults, ..Default::default() }).unwrap();
        answer(&Port { name: simulated.port_name().into(), usb: None })
    }

    #[test]
    fn a_port_without_a_rig_is_told_in_a_few_words() {
        let silent = Faults { drop_every: 1, ..Default::default() };
        assert_eq!(answer_of(silent), "no rig answers: nothing at all is heard there");
        let stranger = Faults { version: Some(rigel_protocol::VERSION + 1), ..Default::default() };
        assert!(answer_of(stranger).starts_with("the rig speaks version"));
        assert!(answer_of(Faults::default()).starts_with("simulated rig on"));
        let nowhere = answer(&Port { name: "/dev/no-such-port".into(), usb: None });
        assert!(nowhere.starts_with("cannot open the port: "), "{nowhere}");
    }
}
