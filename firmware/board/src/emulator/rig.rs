//! The rig around the emulated board, whose inputs QEMU does not model: switches that follow from the steps, and a
//! camera whose flash-sync follows its shutter. Outputs go to the real registers.

use rigel_firmware_core::Pins;
use rigel_protocol::Axis;

/// Where the axes stand when the power comes, steps from the edges of their switches.
const START_STEPS: [i32; 2] = [900, 500];

/// The board's outputs, with the rig's answers.
pub struct Rig<P> {
    pins: P,
    /// Steps from the edge of the switch; at and below 0 it is pressed.
    at: [i32; 2],
    positive: [bool; 2],
    flashed: bool,
}

impl<P: Pins> Rig<P> {
    /// The rig as it was left yesterday.
    pub fn new(pins: P) -> Self {
        Self { pins, at: START_STEPS, positive: [false; 2], flashed: false }
    }
}

impl<P: Pins> Pins for Rig<P> {
    fn step(&mut self, axis: Axis) {
        self.pins.step(axis);
        self.at[axis as usize] += if self.positive[axis as usize] { 1 } else { -1 };
    }

    fn set_direction(&mut self, axis: Axis, positive: bool) {
        self.pins.set_direction(axis, positive);
        self.positive[axis as usize] = positive;
    }

    fn is_switch_pressed(&mut self, axis: Axis) -> bool {
        self.at[axis as usize] <= 0
    }

    fn set_half_press(&mut self, closed: bool) {
        self.pins.set_half_press(closed);
    }

    fn set_shutter(&mut self, closed: bool) {
        self.pins.set_shutter(closed);
        self.flashed |= closed;
    }

    fn take_flash_sync(&mut self) -> bool {
        core::mem::take(&mut self.flashed)
    }
}
