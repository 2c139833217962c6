#![no_main]
//! The reader of PLCopen XML, and what follows: names, types, Wasm.

use fam_soft_plc::{CheckOptions, SourceFile, diagnose};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let mut text = String::from_utf8_lossy(bytes).into_owned();
    if !text.trim_start().starts_with('<') {
        // Bytes without a frame get one, so that the reader sees them.
        text = format!(
            "<project xmlns=\"http://www.plcopen.org/xml/tc6_0201\"><types><dataTypes/><pous>{text}</pous></types></project>"
        );
    }
    let files = [SourceFile::new("fuzz.xml", text)];
    for problem in diagnose(&files, CheckOptions::default()) {
        assert!(!problem.code.is_empty());
    }
});
