//! The rig that this board is made for: everything that another mechanism or crystal changes.

use rigel_protocol::Limits;

/// What the rig calls itself.
pub const NAME: &str = "rigel f405";

/// The crystal beside the chip, an even number of MHz from 4 to 26: the clock of every stamp.
pub const CRYSTAL_HZ: u32 = 8_000_000;

/// How far and how fast it goes.
pub const LIMITS: Limits = Limits {
    pan_min_mdeg: -180_000,
    pan_max_mdeg: 180_000,
    winding_mdeg: 180_000,
    tilt_min_mdeg: -10_000,
    tilt_max_mdeg: 90_000,
    speed_mdeg_s: 60_000,
    acceleration_mdeg_s2: 120_000,
    settle_ms: 300,
};
