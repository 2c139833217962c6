#![no_main]
//! The parser: a tree or messages that point into the text.

use fam_soft_plc::{SourceFile, parse_expression, parse_project};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let text = String::from_utf8_lossy(bytes);
    let _ = parse_expression("fuzz", &text);
    let lines = text.lines().count() as u32 + 1;
    let (_, problems) = parse_project(&[SourceFile::new("fuzz.st", text)]);
    for problem in problems {
        assert!(problem.line <= lines, "{problem}");
    }
});
