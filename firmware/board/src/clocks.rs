//! The clocks: 168 MHz from the crystal.

use embassy_stm32::Config;
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllSource, Sysclk,
};
use embassy_stm32::time::Hertz;

use crate::rig::CRYSTAL_HZ;

/// What the phase-locked loop compares: the fastest that it takes, which jitters least.
const COMPARED_HZ: u32 = 2_000_000;

const _: () =
    assert!(CRYSTAL_HZ.is_multiple_of(COMPARED_HZ) && CRYSTAL_HZ >= 4_000_000 && CRYSTAL_HZ <= 26_000_000);

/// The chip's fastest clocks.
pub fn config() -> Config {
    let mut config = Config::default();
    let rcc = &mut config.rcc;
    rcc.hse = Some(Hse { freq: Hertz(CRYSTAL_HZ), mode: HseMode::Oscillator });
    rcc.pll_src = PllSource::HSE;
    rcc.pll = Some(Pll {
        prediv: PllPreDiv::from_bits((CRYSTAL_HZ / COMPARED_HZ) as u8),
        mul: PllMul::MUL168,
        divp: Some(PllPDiv::DIV2),
        divq: None,
        divr: None,
    });
    rcc.sys = Sysclk::PLL1_P;
    rcc.ahb_pre = AHBPrescaler::DIV1;
    rcc.apb1_pre = APBPrescaler::DIV4;
    rcc.apb2_pre = APBPrescaler::DIV2;
    config
}
