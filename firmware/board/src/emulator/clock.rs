//! The time in QEMU, whose timers count but do not compare: TIM2 tells the time, SysTick wakes.

use core::cell::{Cell, RefCell};
use core::task::Waker;

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use critical_section::{CriticalSection, Mutex};
use embassy_stm32::pac;
use embassy_time_driver::{Driver, time_driver_impl};
use embassy_time_queue_utils::Queue;

/// QEMU's timers are fed with 1 GHz, whatever the clocks are set to.
const TIMER_HZ: u32 = 1_000_000_000;
/// SysTick's slower source, an eighth of the processor's 168 MHz.
const SYSTICK_PER_US: u32 = 21;
/// SysTick has 24 bits. Waking at least as often also notices every wrap of TIM2's 32.
const LONGEST_US: u64 = (0x00ff_ffff / SYSTICK_PER_US) as u64;
/// QEMU makes shorter periods longer.
const SHORTEST_US: u64 = 10;

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

    /// Wakes whom the time has come for, and sets SysTick to the next.
    fn advance(&self, token: CriticalSection<'_>) {
        let now_us = self.now_us(token);
        let next_us = self.queue.borrow(token).borrow_mut().next_expiration(now_us);
        let wait_us = next_us.saturating_sub(now_us).clamp(SHORTEST_US, LONGEST_US);
        // SAFETY: SysTick belongs to this module, and interrupts are off.
        let mut systick = unsafe { cortex_m::Peripherals::steal() }.SYST;
        systick.set_reload(wait_us as u32 * SYSTICK_PER_US);
        systick.clear_current();
        // QEMU takes the reload for an expiry: that one is not meant. A true one comes again after the same time.
        while SYST::get_current() == 0 {}
        SCB::clear_pendst();
    }
}

impl Driver for Clock {
    fn now(&self) -> u64 {
        critical_section::with(|token| self.now_us(token))
    }

    fn schedule_wake(&self, at_us: u64, waker: &Waker) {
        critical_section::with(|token| {
            if self.queue.borrow(token).borrow_mut().schedule_wake(at_us, waker) {
                self.advance(token);
            }
        });
    }
}

#[cortex_m_rt::exception]
fn SysTick() {
    critical_section::with(|token| CLOCK.advance(token));
}

/// Starts the clock.
pub fn start(mut systick: SYST) {
    pac::TIM2.psc().write_value((TIMER_HZ / 1_000_000 - 1) as u16);
    pac::TIM2.cr1().modify(|w| w.set_cen(true));
    systick.set_clock_source(SystClkSource::External);
    systick.set_reload(LONGEST_US as u32 * SYSTICK_PER_US);
    systick.clear_current();
    systick.enable_counter();
    systick.enable_interrupt();
}
