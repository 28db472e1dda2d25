#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| rigel_fuzz::tracker(bytes));
