//! The wires to motors, switches and camera.

use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::asm::delay;
use embassy_stm32::gpio::{Input, Output};
use embassy_stm32::pac;
use rigel_firmware_core::Pins;
use rigel_protocol::Axis;

/// How long a step's pulse is high, and how long a direction stands before a step, in processor cycles: 2 µs, which the
/// slowest common driver (DRV8825: 1.9 µs and 0.65 µs) takes.
const PULSE_CYCLES: u32 = 336;

/// Set by the flash-sync's interrupt.
pub static FLASHED: AtomicBool = AtomicBool::new(false);

/// Pan first, then tilt.
pub struct Wires {
    pub step: [Output<'static>; 2],
    pub direction: [Output<'static>; 2],
    pub switch: [Input<'static>; 2],
    pub half_press: Output<'static>,
    pub shutter: Output<'static>,
}

impl Pins for Wires {
    fn step(&mut self, axis: Axis) {
        self.step[axis as usize].set_high();
        delay(PULSE_CYCLES);
        self.step[axis as usize].set_low();
    }

    fn set_direction(&mut self, axis: Axis, positive: bool) {
        self.direction[axis as usize].set_level(positive.into());
        delay(PULSE_CYCLES);
    }

    fn is_switch_pressed(&mut self, axis: Axis) -> bool {
        // The closed switch pulls down: what is high is pressed, or has a broken wire.
        self.switch[axis as usize].is_high()
    }

    fn set_half_press(&mut self, closed: bool) {
        self.half_press.set_level(closed.into());
    }

    fn set_shutter(&mut self, closed: bool) {
        self.shutter.set_level(closed.into());
    }

    fn take_flash_sync(&mut self) -> bool {
        FLASHED.swap(false, Ordering::Relaxed)
    }
}

/// Takes the current from the motors and opens the camera's contacts, whoever holds the pins: the program is at its end.
pub fn let_go() {
    // PC4: the motors' enable, high for off. PB12, PB13: half-press and shutter.
    pac::GPIOC.bsrr().write(|w| w.set_bs(4, true));
    pac::GPIOB.bsrr().write(|w| {
        w.set_br(12, true);
        w.set_br(13, true);
    });
}
