//! Actions of PLCopen XML outside of charts: called by their names from the body of their POU.

use fam_soft_plc::Value;

use crate::common::Machine;
use crate::diagrams::{block, compile, input, output};

/// A program P that calls an instance `fb` of a block with VAR_IN_OUT `v`, VAR_TEMP `t` and output `n`.
fn project(actions: &[(&str, &str)], body: &str, main: &str) -> String {
    let actions: String = actions
        .iter()
        .map(|(name, body)| format!("<action name=\"{name}\"><body>{body}</body></action>"))
        .collect();
    let variable =
        |name: &str, ty: &str| format!("<variable name=\"{name}\"><type>{ty}</type></variable>");
    let st = |text: &str| format!("<ST><xhtml:p>{text}</xhtml:p></ST>");
    format!(
        "<project xmlns=\"http://www.plcopen.org/xml/tc6_0201\" xmlns:xhtml=\"http://www.w3.org/1999/xhtml\"><types><dataTypes/><pous>
<pou name=\"Block\" pouType=\"functionBlock\"><interface><inOutVars>{}</inOutVars><outputVars>{}</outputVars><localVars>{}</localVars><tempVars>{}</tempVars></interface>
<actions>{actions}</actions>
<body>{body}</body></pou>
<pou name=\"P\" pouType=\"program\"><interface><localVars>{}{}</localVars></interface><body>{}</body></pou>
</pous></types><instances><configurations/></instances></project>",
        variable("v", "<INT/>"),
        variable("n", "<INT/>"),
        variable("k", "<INT/>"),
        variable("t", "<INT/>"),
        variable("x", "<INT/>"),
        variable("fb", "<derived name=\"Block\"/>"),
        st(main),
    )
}

fn st(text: &str) -> String {
    format!("<ST><xhtml:p>{text}</xhtml:p></ST>")
}

fn machine(text: &str) -> Machine {
    Machine::of(&compile(text).unwrap_or_else(|e| panic!("{e}")))
}

#[test]
fn an_action_sees_what_exists_while_the_body_runs() {
    let actions = [
        (
            "Double",
            "v := v * 2; IF v &gt; 10 THEN RETURN; END_IF; t := t + 1;",
        ),
        (
            "Nested",
            "Double(); IF k = 0 THEN THIS.Double(); END_IF; v := v + 1;",
        ),
        ("Count", "k := k + 1;"),
    ];
    let actions: Vec<_> = actions.iter().map(|(n, t)| (*n, st(t))).collect();
    let actions: Vec<_> = actions.iter().map(|(n, t)| (*n, t.as_str())).collect();
    let body = st("t := 0; Double(); Nested(); Count(); n := t;");
    let mut m = machine(&project(&actions, &body, "fb(v := x);"));
    m.set("x", Value::Int(3));
    m.scan();
    // 3 * 2 = 6 counts; 12 and 24 return from the action; then 1 is added.
    assert_eq!(
        (m.text("x"), m.text("fb.n"), m.text("fb.k")),
        ("25".into(), "1".into(), "1".into())
    );
    m.set("x", Value::Int(2));
    m.scan();
    // 2 * 2 and 4 * 2 count; 1 is added.
    assert_eq!((m.text("x"), m.text("fb.n")), ("9".into(), "2".into()));
}

#[test]
fn diagrams_of_actions_keep_their_wires_apart() {
    let add = |by: &str| {
        [
            input(1, "v"),
            input(2, by),
            block(3, "ADD", "", &["IN1=1", "IN2=2"], &["OUT"]),
            block(4, "MUL", "", &["IN1=3.OUT", "IN2=3.OUT"], &["OUT"]),
            output(5, "v", &["4.OUT"]),
        ]
        .concat()
    };
    let (one, two) = (
        format!("<FBD>{}</FBD>", add("1")),
        format!("<FBD>{}</FBD>", add("k")),
    );
    let actions = [("One", one.as_str()), ("Two", two.as_str())];
    let mut m = machine(&project(
        &actions,
        &st("One(); k := -3; Two(); n := v;"),
        "fb(v := x);",
    ));
    m.set("x", Value::Int(1));
    m.scan();
    // (1 + 1)² = 4, (4 - 3)² = 1.
    assert_eq!((m.text("x"), m.text("fb.n")), ("1".into(), "1".into()));
    m.set("x", Value::Int(2));
    m.scan();
    // (2 + 1)² = 9, (9 - 3)² = 36.
    assert_eq!(m.text("x"), "36");
}

#[test]
fn an_action_that_calls_itself_is_refused() {
    let body = st("v := v + 1; Again();");
    let text = project(&[("Again", &body)], &st("Again();"), "fb(v := x);");
    let Err(failed) = compile(&text) else {
        panic!("it has no end");
    };
    assert!(failed.contains("Again"), "{failed}");
}

#[test]
fn an_action_without_such_variables_can_be_called_from_outside() {
    let body = st("k := k + 5; n := k;");
    let text = project(&[("Step", &body)], &st("Step();"), "fb(v := x); fb.Step();");
    let mut m = machine(&text);
    m.scan();
    assert_eq!(m.text("fb.n"), "10");
}
