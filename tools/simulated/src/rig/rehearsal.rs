//! A capture's moves on the firmware's own core, in no time and without a rig.

use rigel::rig::RigLimits;
use rigel_firmware_core::{Controller, Handled};
use rigel_protocol::{Command, Limits, Reply, Request, Restart, SCHEMA, VERSION};

use super::board::{Bench, mechanics};

/// What became of the moves of a capture.
#[derive(Debug, Clone, PartialEq)]
pub struct Rehearsal {
    /// How long the rig takes to find its switches and its zero from where a simulated one stands, seconds.
    pub homing_s: f64,
    /// For each target how long it takes from the one before until the rig has settled, seconds; or what the firmware says
    /// instead, and then the rig stays where it is.
    pub moves: Vec<Result<f64, Reply>>,
}

/// Homes a rig of these limits and sends it to each of the targets (pan and tilt, radians), one after the other. Of what the
/// limits do not tell (steps, backlash, switches) the rig has what a simulated one has: see [`mechanics`].
///
/// # Errors
/// What the firmware says when it cannot be homed, and `None` when there can be no rig with these limits.
pub fn rehearse(limits: &RigLimits, targets: &[[f64; 2]]) -> Result<Rehearsal, Option<Reply>> {
    let mechanics = mechanics(in_words(limits));
    let mut stage = Stage {
        controller: Controller::new("rehearsal", mechanics, Restart::Power).ok_or(None)?,
        bench: Bench::new(&mechanics),
        sequence: 0,
    };
    stage.ask(Command::Hello { version: VERSION, schema: SCHEMA, conversation: 1 });
    let homing_s = stage.perform(Command::Home).map_err(Some)?;
    let moves = targets.iter().map(|&[pan_rad, tilt_rad]| {
        let [pan_mdeg, tilt_mdeg] = [pan_rad, tilt_rad].map(mdeg);
        stage.perform(Command::MoveTo { pan_mdeg, tilt_mdeg })
    });
    Ok(Rehearsal { homing_s, moves: moves.collect() })
}

/// The core, what it moves, and a clock that is always where something is due.
struct Stage {
    controller: Controller,
    bench: Bench,
    sequence: u16,
}

impl Stage {
    fn ask(&mut self, command: Command) -> Option<Reply> {
        self.sequence = self.sequence.wrapping_add(1);
        let request = Request { sequence: self.sequence, command };
        let now_us = self.bench.now_us;
        match self.controller.handle(&request, now_us, &mut self.bench) {
            Handled::Answer(answer) => Some(answer.reply),
            Handled::Tracker => None,
        }
    }

    /// Asks for a motion and waits for its end, seconds; or the reply that is none.
    fn perform(&mut self, command: Command) -> Result<f64, Reply> {
        let began_us = self.bench.now_us;
        match self.ask(command) {
            Some(Reply::Accepted { .. }) | None => {}
            Some(reply) => return Err(reply),
        }
        while let Some(due_us) = self.controller.next_us() {
            self.bench.now_us = self.bench.now_us.max(due_us);
            match self.controller.advance(self.bench.now_us, &mut self.bench).map(|answer| answer.reply) {
                Some(Reply::Arrived { .. }) => break,
                Some(reply @ (Reply::Halted { .. } | Reply::Stopped { .. })) => return Err(reply),
                _ => {}
            }
        }
        Ok((self.bench.now_us - began_us) as f64 / 1e6)
    }
}

/// A rig's limits as it says them.
fn in_words(limits: &RigLimits) -> Limits {
    let [pan_min_mdeg, pan_max_mdeg] = limits.pan_rad.map(mdeg);
    let [tilt_min_mdeg, tilt_max_mdeg] = limits.tilt_rad.map(mdeg);
    Limits {
        pan_min_mdeg,
        pan_max_mdeg,
        winding_mdeg: pan_max_mdeg.max(pan_min_mdeg.saturating_neg()),
        tilt_min_mdeg,
        tilt_max_mdeg,
        speed_mdeg_s: mdeg(limits.speed_rad_s).unsigned_abs(),
        acceleration_mdeg_s2: mdeg(limits.acceleration_rad_s2).unsigned_abs(),
        settle_ms: (limits.settle_s * 1e3).round() as u32,
    }
}

/// The nearest thousandth of a degree; what does not fit is as far as it goes, which no rig reaches.
fn mdeg(angle_rad: f64) -> i32 {
    (angle_rad.to_degrees() * 1e3).round() as i32
}
