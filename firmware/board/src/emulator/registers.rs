//! Registers that QEMU does not model as the chip has them.
//!
//! PWR, FLASH and RCC read as zero there, so that the ready bits which the start-up waits for never come. And QEMU
//! feeds the next byte while the USART's SR is read: the driver's read-modify-write of SR then clears the RXNE of a byte
//! that it has not seen. The MPU makes these blocks fault, and the fault handler does the access in their place.

use core::arch::naked_asm;
use core::ptr::{read_volatile, write_volatile};

use cortex_m::peripheral::{MPU, SCB};

/// A block of registers: its first address, and the logarithm of its size in bytes.
struct Block {
    start: u32,
    size_log2: u32,
}

const RCC: u32 = 0x4002_3800;
const BLOCKS: [Block; 4] = [
    Block { start: 0x4001_1000, size_log2: 5 },  // USART1
    Block { start: 0x4000_4400, size_log2: 5 },  // USART2
    Block { start: RCC, size_log2: 11 },         // RCC and FLASH
    Block { start: 0x4000_7000, size_log2: 10 }, // PWR
];
/// What was written to RCC (64 words), FLASH (16) and PWR (16).
static mut REMEMBERED: [u32; 96] = [0; 96];

const RXNE: u32 = 1 << 5;

/// What an instruction does to memory.
struct Access {
    load: bool,
    bytes: u32,
    register: u32,
    length: u32,
}

impl Access {
    /// The plain loads and stores that rustc makes of volatile accesses; `None` for others.
    fn of(first: u16, second: u16) -> Option<Self> {
        let (first, second) = (u32::from(first), u32::from(second));
        let narrow = |load, bytes| Some(Self { load, bytes, register: first & 7, length: 2 });
        match first >> 11 {
            0b01100 => narrow(false, 4),
            0b01101 => narrow(true, 4),
            0b01110 => narrow(false, 1),
            0b01111 => narrow(true, 1),
            0b10000 => narrow(false, 2),
            0b10001 => narrow(true, 2),
            // Register offset; the signed loads are not among what volatile accesses become.
            0b01010 => narrow(false, [4, 2, 1, 0][(first >> 9 & 3) as usize]).filter(|a| a.bytes > 0),
            0b01011 => narrow(true, [4, 2, 1, 0][(first >> 9 & 3) as usize]).filter(|a| a.bytes > 0),
            _ if first & 0xff00 == 0xf800 => {
                let (immediate12, register_offset) = (first & 0x80 != 0, second & 0x0fc0 == 0);
                // Without write-back: 1100 is the negative offset.
                (immediate12 || register_offset || second >> 8 & 0xf == 0b1100).then_some(Self {
                    load: first & 0x10 != 0,
                    bytes: 1 << (first >> 5 & 3),
                    register: second >> 12,
                    length: 4,
                })
            }
            _ => None,
        }
    }
}

/// The handler of faults: hands the registers that the exception has stacked, and those that it has not, to [`access`].
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() {
    naked_asm!(
        "mrs r0, msp",
        "push {{r3-r11, lr}}", // r3 for the alignment
        "add r1, sp, #4",
        "bl {access}",
        "pop {{r3-r11, pc}}",
        access = sym access,
    );
}

/// Does the access that has faulted, and goes on behind it. `stacked`: r0 to r3, r12, lr, pc, psr; `kept`: r4 to r11.
extern "C" fn access(stacked: &mut [u32; 8], kept: &mut [u32; 8]) {
    const DATA_ADDRESS_VALID: u32 = 0x82;
    // SAFETY: these are the processor's own, nothing else runs in a hard fault, and the MPU is off in it.
    let scb = unsafe { &*SCB::PTR };
    let (status, address, pc) = (scb.cfsr.read(), scb.mmfar.read(), stacked[6]);
    // SAFETY: the program counter points into code.
    let code = unsafe { [read_volatile(pc as *const u16), read_volatile((pc + 2) as *const u16)] };
    let block = BLOCKS.iter().find(|block| address >> block.size_log2 == block.start >> block.size_log2);
    let (DATA_ADDRESS_VALID, Some(block), Some(access)) =
        (status & DATA_ADDRESS_VALID, block, Access::of(code[0], code[1]))
    else {
        crate::last_words::fault(pc)
    };
    // SAFETY: writing ones clears.
    unsafe { scb.cfsr.write(status) };
    let register = match access.register {
        r @ 0..4 => &mut stacked[r as usize],
        r @ 4..12 => &mut kept[r as usize - 4],
        12 => &mut stacked[4],
        _ => &mut stacked[5],
    };
    let mask = u32::MAX >> (32 - 8 * access.bytes);
    if block.size_log2 == 5 {
        let pointer = address as *mut u32;
        // SAFETY: a USART's register, which QEMU reads and writes by the word.
        unsafe {
            if access.load {
                *register = read_volatile(pointer) & mask;
            } else {
                // With a high bit set, QEMU clears the bits that are zero, as the chip does.
                let others = if address & 0x1f == 0 { !0x3ff | RXNE } else { 0 };
                write_volatile(pointer, *register & mask | others);
            }
        }
    } else {
        let word = match address & 0xfff {
            offset @ 0x800..0xc00 => offset - 0x800,
            offset @ 0xc00.. => offset - 0xc00 + 0x100,
            offset => offset + 0x140,
        } as usize
            / 4;
        // SAFETY: nothing else touches it, and nothing runs beside a hard fault.
        let remembered = unsafe { &mut *(&raw mut REMEMBERED) };
        let cell = &mut remembered[word];
        if access.load { *register = with_ready_bits(address, *cell) } else { *cell = *register }
    }
    stacked[6] += access.length;
    stacked[7] = after_one_conditional(stacked[7]);
}

/// What the chip would say some microseconds after `written` was written.
fn with_ready_bits(address: u32, written: u32) -> u32 {
    const ON: u32 = 1 << 0 | 1 << 16 | 1 << 24 | 1 << 26; // HSI, HSE, PLL, PLLI2S
    match address.wrapping_sub(RCC) {
        0x00 => written | (written & ON) << 1,
        0x08 => written & !0xc | (written & 3) << 2, // the source that is switched to is the one in use
        0x70 | 0x74 => written | (written & 1) << 1, // LSE, LSI
        _ => written,
    }
}

/// The program status after an instruction that may be one of an `IT` block.
fn after_one_conditional(psr: u32) -> u32 {
    let it = psr >> 25 & 3 | psr >> 8 & 0xfc;
    let it = if it & 7 == 0 { 0 } else { it & 0xe0 | it << 1 & 0x1f };
    psr & !0x0600_fc00 | (it & 3) << 25 | (it & 0xfc) << 8
}

/// Makes every access to the blocks fault.
pub fn intercept(mpu: &MPU) {
    const EXECUTE_NEVER: u32 = 1 << 28;
    const ENABLED_WITH_DEFAULT_MAP: u32 = 0b101;
    // SAFETY: the regions cover registers alone, and the fault handler answers for them.
    unsafe {
        for (number, block) in (0..).zip(&BLOCKS) {
            mpu.rbar.write(block.start | 1 << 4 | number);
            mpu.rasr.write(EXECUTE_NEVER | (block.size_log2 - 1) << 1 | 1);
        }
        mpu.ctrl.write(ENABLED_WITH_DEFAULT_MAP);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}
