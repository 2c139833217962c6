#![no_main]

use libfuzzer_sys::fuzz_target;
use std::sync::Once;

fuzz_target!(|bytes: &[u8]| {
    // libFuzzer ends the process at any panic; the repository catches those of its database over a file that contradicts
    // itself. One that is not caught still ends the run.
    static ONCE: Once = Once::new();
    ONCE.call_once(|| std::panic::set_hook(Box::new(|_| {})));
    fam_hostile::repository(bytes)
});
