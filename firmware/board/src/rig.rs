//! The rig that this board is made for: everything that another mechanism or another crystal changes.

use rigel_firmware_core::{Controller, Mechanics};
use rigel_protocol::{Limits, Restart};

/// What the rig calls itself.
pub const NAME: &str = "rigel f405";

/// The crystal beside the chip, an even number of MHz from 4 to 26: the clock of every stamp.
pub const CRYSTAL_HZ: u32 = 8_000_000;

/// Motors of 200 steps, drivers set to 16 microsteps, belts of 1 to 5: a step is 22.5 thousandths of a degree.
const STEPS_PER_TURN: u32 = 200 * 16 * 5;

/// Pairs are pan and tilt.
pub const MECHANICS: Mechanics = Mechanics {
    limits: Limits {
        pan_min_mdeg: -180_000,
        pan_max_mdeg: 180_000,
        winding_mdeg: 180_000,
        tilt_min_mdeg: -10_000,
        tilt_max_mdeg: 90_000,
        speed_mdeg_s: 60_000,
        acceleration_mdeg_s2: 120_000,
        settle_ms: 300,
    },
    steps_per_turn: [STEPS_PER_TURN; 2],
    // A belt has little play: a tenth of a degree.
    backlash_steps: [4; 2],
    // Both switches are at the lower end, five degrees beyond the limit.
    switch_mdeg: [-185_000, -15_000],
    // From which the axis brakes within 1.7 degrees.
    seek_mdeg_s: 20_000,
    approach_mdeg_s: 2_000,
    back_off_mdeg: 5_000,
    longest_way_mdeg: [380_000, 120_000],
};

const _: () = {
    let controller = Controller::new(NAME, MECHANICS, Restart::Power);
    assert!(controller.is_some(), "there can be no such rig");
    core::mem::forget(controller);
};
