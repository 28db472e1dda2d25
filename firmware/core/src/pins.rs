//! The wires between the firmware's core and the rig: a board, a simulated rig and a test each have their own.

use rigel_protocol::Axis;

/// What the core can do to the rig and feel of it. Nothing here waits.
pub trait Pins {
    /// One step of a motor in the direction that was last set.
    fn step(&mut self, axis: Axis);
    /// Sets the direction of a motor's next steps.
    fn set_direction(&mut self, axis: Axis, positive: bool);
    /// Whether an axis' limit switch is pressed, or its wire is broken (switches open a closed circuit).
    fn is_switch_pressed(&mut self, axis: Axis) -> bool;
    /// The camera's half-press contact.
    fn set_half_press(&mut self, closed: bool);
    /// The camera's shutter contact.
    fn set_shutter(&mut self, closed: bool);
    /// Whether a flash-sync has come since this was last asked.
    fn take_flash_sync(&mut self) -> bool;
}
