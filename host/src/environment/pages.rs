//! Memory on large pages, where the system has them on request: bringing small ones in took a fifth of a mosaic's time.

use bytemuck::Zeroable;

/// So many zeros.
pub(super) fn zeros<T: Zeroable + Clone>(count: usize) -> Vec<T> {
    let mut memory = vec![T::zeroed(); count];
    on_large_pages(&mut memory);
    memory
}

/// Asks that what was not touched yet of this memory be brought in by large pages. Small ones do as well, but for the time.
#[cfg(target_os = "linux")]
#[expect(unsafe_code, reason = "the system's advice for memory that a vector holds")]
fn on_large_pages<T>(memory: &mut [T]) {
    const PAGE: usize = 4096;
    let bytes = size_of_val(memory);
    let start = memory.as_mut_ptr().cast::<u8>();
    let skipped = start.align_offset(PAGE);
    if bytes > 1 << 21 && skipped < bytes {
        // SAFETY: whole pages inside this memory, whose contents this advice leaves as they are.
        unsafe {
            libc::madvise(start.add(skipped).cast(), (bytes - skipped) / PAGE * PAGE, libc::MADV_HUGEPAGE)
        };
    }
}

#[cfg(not(target_os = "linux"))]
fn on_large_pages<T>(_: &mut [T]) {}
