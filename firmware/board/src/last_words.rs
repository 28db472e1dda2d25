//! What a program that panics says to the next one, in memory that a reset keeps.

use core::mem::MaybeUninit;
use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use embassy_stm32::pac;
use heapless::{String, Vec};
use rigel_protocol::Restart;

use crate::pins;

/// As long as a `Log`.
const LONGEST: usize = 60;

/// Tells words from what memory holds when the power comes.
const SAID: u64 = 0x5249_4745_4c20_4641;

struct LastWords {
    said: u64,
    words: Vec<u8, LONGEST>,
}

#[unsafe(link_section = ".uninit.LAST_WORDS")]
static mut LAST_WORDS: MaybeUninit<LastWords> = MaybeUninit::uninit();

/// Why the board has started, and what the last program said when it panicked. To be called once, at the start.
pub fn take() -> (Restart, Option<String<LONGEST>>) {
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    // SAFETY: nothing else runs yet. The words are looked at only where a panic has written them.
    let words = unsafe {
        let last = (*(&raw mut LAST_WORDS)).as_mut_ptr();
        let said = (&raw mut (*last).said).replace(0) == SAID && !flags.porrstf();
        said.then(|| (&raw const (*last).words).read())
    };
    // A text that was cut within a character loses it all: file and line are ASCII, the rest is English.
    let words = words.map(|words| String::from_utf8(words).unwrap_or_default());
    let restart = match words {
        Some(_) => Restart::Panic,
        None if flags.wdgrstf() => Restart::Watchdog,
        None => Restart::Power,
    };
    (restart, words)
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    let mut words = Vec::new();
    if let Some(place) = info.location() {
        // Of a long path the end tells more.
        let file = place.file().as_bytes();
        add(&mut words, file.last_chunk::<30>().map_or(file, |end| end));
        add(&mut words, b":");
        add_number(&mut words, place.line(), 10);
    }
    end(words)
}

/// A fault is a panic, too.
#[cfg(not(feature = "emulator"))]
#[cortex_m_rt::exception]
unsafe fn HardFault(frame: &cortex_m_rt::ExceptionFrame) -> ! {
    fault(frame.pc())
}

/// The end of a program whose instruction at `pc` was impossible.
pub fn fault(pc: u32) -> ! {
    let mut words = Vec::new();
    add(&mut words, b"fault at 0x");
    add_number(&mut words, pc, 16);
    end(words)
}

fn end(words: Vec<u8, LONGEST>) -> ! {
    cortex_m::interrupt::disable();
    pins::let_go();
    // SAFETY: interrupts are off, and this program ends here.
    unsafe { (*(&raw mut LAST_WORDS)).write(LastWords { said: SAID, words }) };
    SCB::sys_reset()
}

/// Adds what fits.
fn add(words: &mut Vec<u8, LONGEST>, text: &[u8]) {
    for &byte in text {
        let _ = words.push(byte);
    }
}

fn add_number(words: &mut Vec<u8, LONGEST>, number: u32, base: u32) {
    if number >= base {
        add_number(words, number / base, base);
    }
    add(words, &[b"0123456789abcdef"[(number % base) as usize]]);
}
