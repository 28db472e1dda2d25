//! What QEMU needs (`netduinoplus2`, an STM32F405): nothing of this is in the image for the chip.

mod clock;
mod registers;
pub mod rig;

/// Before anything touches a register.
pub fn start() {
    let core = cortex_m::Peripherals::take().expect("the first to take them");
    registers::intercept(&core.MPU);
    clock::start(core.SYST);
}
