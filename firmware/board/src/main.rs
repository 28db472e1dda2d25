//! The firmware of Rigel's rig for an STM32F405: pins, clocks and tasks. What it does is in `rigel-firmware-core`.
//!
//! Three levels of urgency, each above the one before: the lines' tasks (frames, checksums, the tracker), the task that
//! steps the motors, and the USARTs' interrupts, which take a byte each in a microsecond: it would be overwritten by the
//! next. Below all of them the processor sleeps.

#![no_std]
#![no_main]

mod clocks;
#[cfg(feature = "emulator")]
mod emulator;
mod host;
mod last_words;
mod motion;
mod pins;
mod rig;
mod tracker;

use core::sync::atomic::Ordering;

use embassy_executor::InterruptExecutor;
use embassy_stm32::exti::{self, ExtiInput};
use embassy_stm32::gpio::{Input, Level, Output, Pull, Speed};
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::usart::{self, BufferedUart};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{bind_interrupts, peripherals};
use embassy_time::Timer;
use heapless::String;
use rigel_firmware_core::Controller;
use static_cell::ConstStaticCell;

use crate::pins::Wires;

const BAUD: u32 = 115_200;
/// What the tracker may say until it is read. A line cannot say more than its speed allows, but QEMU hands over at once what came
/// while its machine was busy.
const TRACKER_ROOM: usize = if cfg!(feature = "emulator") { 16_384 } else { 1024 };
/// How long the program may hang before it is started again.
const WATCHDOG_US: u32 = 1_000_000;

bind_interrupts!(struct Interrupts {
    USART1 => usart::BufferedInterruptHandler<peripherals::USART1>;
    USART2 => usart::BufferedInterruptHandler<peripherals::USART2>;
    EXTI15_10 => exti::InterruptHandler<embassy_stm32::interrupt::typelevel::EXTI15_10>;
});

/// Runs the motors. UART4 itself is not used: its interrupt is.
static URGENT: InterruptExecutor = InterruptExecutor::new();
/// Runs the lines. The same of UART5.
static PATIENT: InterruptExecutor = InterruptExecutor::new();

#[embassy_stm32::interrupt]
unsafe fn UART4() {
    // SAFETY: this is the executor's own interrupt.
    unsafe { URGENT.on_interrupt() }
}

#[embassy_stm32::interrupt]
unsafe fn UART5() {
    // SAFETY: this is the executor's own interrupt.
    unsafe { PATIENT.on_interrupt() }
}

#[cortex_m_rt::entry]
fn main() -> ! {
    #[cfg(feature = "emulator")]
    emulator::start();
    // Before anything that can hang: a crystal that does not swing is waited for.
    // SAFETY: nobody else takes this peripheral.
    let mut watchdog = IndependentWatchdog::new(unsafe { peripherals::IWDG::steal() }, WATCHDOG_US);
    watchdog.unleash();
    let (restart, last_words) = last_words::take();
    let chip = embassy_stm32::init(clocks::config());

    let wires = Wires {
        step: [output(chip.PC0), output(chip.PC2)],
        direction: [output(chip.PC1), output(chip.PC3)],
        switch: [Input::new(chip.PB0, Pull::Up), Input::new(chip.PB1, Pull::Up)],
        half_press: output(chip.PB12),
        shutter: output(chip.PB13),
    };
    // Low: the motors hold from here on. For good: a panic ends it, see `pins::let_go`.
    core::mem::forget(output(chip.PC4));
    let flash_sync = ExtiInput::new(chip.PB14, chip.EXTI14, Pull::Up, Interrupts);

    static HOST: ConstStaticCell<([u8; 256], [u8; 256])> = ConstStaticCell::new(([0; 256], [0; 256]));
    static TRACKER: ConstStaticCell<([u8; 64], [u8; TRACKER_ROOM])> =
        ConstStaticCell::new(([0; 64], [0; TRACKER_ROOM]));
    let mut config = usart::Config::default();
    config.baudrate = BAUD;
    // Every byte wakes its reader: the tracker's are stamped.
    config.eager_reads = Some(1);
    // A line that is not plugged in is quiet.
    config.rx_pull = Pull::Up;
    let (sent, received) = HOST.take();
    let host = BufferedUart::new(chip.USART1, chip.PA10, chip.PA9, sent, received, Interrupts, config)
        .expect("115200 baud fit the clock");
    let (sent, received) = TRACKER.take();
    let tracker = BufferedUart::new(chip.USART2, chip.PA3, chip.PA2, sent, received, Interrupts, config)
        .expect("115200 baud fit the clock");

    let controller = Controller::new(rig::NAME, rig::MECHANICS, restart).expect("the rig is possible");
    interrupt::USART1.set_priority(Priority::P2);
    interrupt::USART2.set_priority(Priority::P2);
    interrupt::EXTI15_10.set_priority(Priority::P3);
    interrupt::UART4.set_priority(Priority::P4);
    interrupt::UART5.set_priority(Priority::P8);

    #[cfg(feature = "emulator")]
    let wires = emulator::rig::Rig::new(wires);
    let urgent = URGENT.start(interrupt::UART4);
    urgent.spawn(motion(controller, wires, last_words).expect("one such task"));
    urgent.spawn(hear_flash_sync(flash_sync).expect("one such task"));
    let patient = PATIENT.start(interrupt::UART5);
    let (say, hear) = host.split();
    patient.spawn(host::hear(hear).expect("one such task"));
    patient.spawn(host::say(say).expect("one such task"));
    let (say, hear) = tracker.split();
    patient.spawn(tracker::run(say, hear).expect("one such task"));
    patient.spawn(feed_watchdog(watchdog).expect("one such task"));
    loop {
        cortex_m::asm::wfi();
    }
}

fn output(pin: embassy_stm32::Peri<'static, impl embassy_stm32::gpio::Pin>) -> Output<'static> {
    Output::new(pin, Level::Low, Speed::Low)
}

#[cfg(not(feature = "emulator"))]
type TheWires = Wires;
#[cfg(feature = "emulator")]
type TheWires = emulator::rig::Rig<Wires>;

#[embassy_executor::task]
async fn motion(controller: Controller, wires: TheWires, last_words: Option<String<60>>) -> ! {
    motion::run(controller, wires, last_words).await
}

/// The camera's contact closes to ground for some milliseconds.
#[embassy_executor::task]
async fn hear_flash_sync(mut contact: ExtiInput<'static, embassy_stm32::mode::Async>) -> ! {
    loop {
        contact.wait_for_falling_edge().await;
        pins::FLASHED.store(true, Ordering::Relaxed);
    }
}

/// Only while both executors run: this task is one's, and hears from the other.
#[embassy_executor::task]
async fn feed_watchdog(mut watchdog: IndependentWatchdog<'static, peripherals::IWDG>) -> ! {
    loop {
        if motion::ALIVE.swap(false, Ordering::Relaxed) {
            watchdog.pet();
        }
        Timer::after_micros(u64::from(WATCHDOG_US / 8)).await;
    }
}
