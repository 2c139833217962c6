#![no_main]
//! The lexer: tokens lie one behind the other inside the text.

use fam_soft_plc::syntax::lexer::lex;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let text = String::from_utf8_lossy(bytes);
    let mut problems = Vec::new();
    let tokens = lex(0, &text, 0, &mut problems);
    let mut end = 0;
    for token in tokens {
        assert!(token.span.start >= end && token.span.end >= token.span.start);
        assert!(token.span.end as usize <= text.len());
        end = token.span.end;
    }
});
