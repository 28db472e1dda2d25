//! The time in QEMU, whose timers count but do not compare: TIM2 tells the time, SysTick looks a thousand times per second
//! whom to wake. (To set SysTick anew for every alarm costs QEMU a third of a millisecond.)

use core::cell::{Cell, RefCell};
use core::task::Waker;

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use critical_section::{CriticalSection, Mutex};
use embassy_stm32::pac;
use embassy_time_driver::{Driver, time_driver_impl};
use embassy_time_queue_utils::Queue;

/// QEMU's timers are fed with 1 GHz, whatever the clocks are set to.
const TIMER_HZ: u32 = 1_000_000_000;
/// SysTick's slower source, an eighth of the processor's 168 MHz.
const SYSTICK_HZ: u32 = 21_000_000;
const LOOKS_HZ: u32 = 1_000;

struct Clock {
    /// What TIM2 said when it was last looked at, and how often it had wrapped by then.
    seen: Mutex<Cell<(u32, u32)>>,
    queue: Mutex<RefCell<Queue>>,
}

time_driver_impl!(static CLOCK: Clock = Clock {
    seen: Mutex::new(Cell::new((0, 0))),
    queue: Mutex::new(RefCell::new(Queue::new())),
});

impl Clock {
    fn now_us(&self, token: CriticalSection<'_>) -> u64 {
        let count = pac::TIM2.cnt().read();
        let (seen, wraps) = self.seen.borrow(token).get();
        let wraps = wraps + u32::from(count < seen);
        self.seen.borrow(token).set((count, wraps));
        u64::from(wraps) << 32 | u64::from(count)
    }
}

impl Driver for Clock {
    fn now(&self) -> u64 {
        critical_section::with(|token| self.now_us(token))
    }

    fn schedule_wake(&self, at_us: u64, waker: &Waker) {
        // The next look finds whom the time has come for already.
        critical_section::with(|token| self.queue.borrow(token).borrow_mut().schedule_wake(at_us, waker));
    }
}

#[cortex_m_rt::exception]
fn SysTick() {
    critical_section::with(|token| {
        let now_us = CLOCK.now_us(token);
        CLOCK.queue.borrow(token).borrow_mut().next_expiration(now_us)
    });
}

/// Starts the clock.
pub fn start(mut systick: SYST) {
    pac::TIM2.psc().write_value((TIMER_HZ / 1_000_000 - 1) as u16);
    pac::TIM2.cr1().modify(|w| w.set_cen(true));
    systick.set_clock_source(SystClkSource::External);
    systick.set_reload(SYSTICK_HZ / LOOKS_HZ - 1);
    systick.clear_current();
    systick.enable_counter();
    systick.enable_interrupt();
}
