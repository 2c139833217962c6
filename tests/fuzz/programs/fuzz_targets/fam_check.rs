#![no_main]
//! All that `fam check` does with a file of logic: kind from the content, syntax, names, types, warnings, Wasm; in both dialects.

use fam_soft_plc::{CheckOptions, Dialect, SourceFile, diagnose};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let text = String::from_utf8_lossy(bytes);
    let dialect = if bytes.len() % 2 == 0 { Dialect::Standard } else { Dialect::Codesys };
    let options = CheckOptions { dialect, ..CheckOptions::default() };
    for problem in diagnose(&[SourceFile::new("fuzz", text)], options) {
        assert!(!problem.to_string().is_empty());
    }
});
