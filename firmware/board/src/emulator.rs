//! What QEMU needs (`netduinoplus2`, an STM32F405): nothing of this is in the image for the chip.

mod clock;
pub mod line;
mod registers;
pub mod rig;

/// Before anything touches a register.
pub fn start() {
    let core = cortex_m::Peripherals::take().expect("the first to take them");
    registers::intercept(&core.MPU);
    clock::start(core.SYST);
}

/// When what is due at `due_us` is done: at its time. QEMU is as late as its machine is busy; taken for the board's own, this
/// would slow the motors down until their moves take too long.
pub fn done_us(due_us: u64) -> u64 {
    due_us
}
