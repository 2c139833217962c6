//! Recursion through methods: refused where some instance can lead a method back to itself, and nowhere else.

use fam_soft_plc::Value;

use crate::common::{Machine, show};
use crate::diagnostics::diagnose;

/// A base whose M calls N, and a derived block with an instance of the base inside; `%` stands for what the latter adds.
fn project(derived: &str) -> String {
    let frame = "FUNCTION_BLOCK B\nMETHOD PUBLIC M : INT\nM := 1 + N();\nEND_METHOD\nMETHOD PUBLIC N : INT\nN := 5;\nEND_METHOD\nEND_FUNCTION_BLOCK\n\
        FUNCTION_BLOCK D EXTENDS B\nVAR inner : B; END_VAR\n%\nEND_FUNCTION_BLOCK\n\
        PROGRAM P\nVAR d : D; r : INT; END_VAR\nr := d.M();\nEND_PROGRAM\n";
    frame.replace('%', derived)
}

const N_CALLS_INNER: &str = "METHOD PUBLIC OVERRIDE N : INT\nN := 10 + inner.M();\nEND_METHOD\n";

#[test]
fn an_instance_of_the_base_inside_is_no_recursion_where_its_method_is_overridden() {
    let own = "METHOD PUBLIC OVERRIDE M : INT\nM := 100 + N();\nEND_METHOD\n";
    let mut machine = Machine::new(&project(&format!("{N_CALLS_INNER}{own}")));
    machine.scan();
    // D.M: 100 + D.N: 10 + B.M: 1 + B.N: 5
    assert_eq!(machine.get("r"), Value::Int(116));
}

#[test]
fn a_method_that_can_come_back_to_itself_is_refused() {
    for (derived, message) in [
        // B.M runs for `d`, and again for `d.inner`.
        (N_CALLS_INNER.to_owned(), "B.M calls itself: B.M > D.N > B.M"),
        (
            format!(
                "{N_CALLS_INNER}METHOD PUBLIC OVERRIDE M : INT\nM := SUPER.M();\nEND_METHOD\n"
            ),
            "B.M calls itself: B.M > D.N > B.M",
        ),
        // What is passed may be the instance itself.
        (
            "METHOD PUBLIC OVERRIDE N : INT\nN := K(other := inner);\nEND_METHOD\nMETHOD PUBLIC K : INT\nVAR_IN_OUT other : B; END_VAR\nK := other.N();\nEND_METHOD\n"
                .to_owned(),
            "D.N calls itself: D.N > D.K > D.N",
        ),
    ] {
        let diagnostics = diagnose(&project(&derived));
        let found = diagnostics
            .iter()
            .any(|d| d.code == "E410" && d.message.contains(message));
        assert!(found, "{derived}\nexpected {message}\n{}", show(&diagnostics));
    }
}
