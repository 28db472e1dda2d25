//! Opening a rig so that nothing about it stays untold.

use std::io::Write;

use rigel::Result;
use rigel::rig::SerialRig;
use rigel_simulated::rig::SimulatedRig;

use crate::devices::simulated_rig;

/// Says hello to the rig at a port; nothing moves. What people should know of it is told as it happens.
///
/// # Errors
/// Those of [`SerialRig::greet`].
pub fn greet(port: &str) -> Result<SerialRig> {
    let mut rig = SerialRig::greet(port)?;
    rig.on_notice(|text| {
        // Where nobody reads it there is nobody to tell; a session's journal has it too.
        let _ = writeln!(std::io::stderr(), "rigel: {text}");
    });
    Ok(rig)
}

/// Says hello to the rig that the user named: `simulated` or a port. The simulated one is unplugged when its value is dropped.
///
/// # Errors
/// Those of [`greet`] and [`simulated_rig`].
pub fn greet_named(rig: &str) -> Result<(SerialRig, Option<SimulatedRig>)> {
    if rig != "simulated" {
        return Ok((greet(rig)?, None));
    }
    let simulated = simulated_rig()?;
    Ok((greet(simulated.port_name())?, Some(simulated)))
}
