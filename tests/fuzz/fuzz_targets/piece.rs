#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fam_hostile::piece(bytes));
