//! Macro steps of PLCopen charts (TC6 v2.01, IEC 60848): their steps, nested ones, jumps into, inside and out of them.

use fam_soft_plc::Value;

use crate::common::Machine;
use crate::diagrams::{compile, project};

fn from(ids: &[u32]) -> String {
    ids.iter()
        .map(|id| {
            format!("<connectionPointIn><connection refLocalId=\"{id}\"/></connectionPointIn>")
        })
        .collect()
}

fn step(id: u32, name: &str, before: &[u32]) -> String {
    format!(
        "<step localId=\"{id}\" name=\"{name}\">{}</step>",
        from(before)
    )
}

fn initial(id: u32, name: &str, before: &[u32]) -> String {
    step(id, name, before).replacen("<step", "<step initialStep=\"true\"", 1)
}

fn transition(id: u32, condition: &str, before: &[u32]) -> String {
    format!(
        "<transition localId=\"{id}\">{}<condition><inline name=\"\"><ST><xhtml:p>{condition}</xhtml:p></ST></inline></condition></transition>",
        from(before)
    )
}

fn jump(id: u32, target: &str, before: &[u32]) -> String {
    format!(
        "<jumpStep localId=\"{id}\" targetName=\"{target}\">{}</jumpStep>",
        from(before)
    )
}

fn macro_step(id: u32, name: &str, before: &[u32], chart: &[String]) -> String {
    format!(
        "<macroStep localId=\"{id}\" name=\"{name}\">{}<body><SFC>{}</SFC></body></macroStep>",
        from(before),
        chart.concat()
    )
}

fn action(id: u32, at: u32, text: &str) -> String {
    format!(
        "<actionBlock localId=\"{id}\">{}<action localId=\"1\" qualifier=\"P\"><inline><ST><xhtml:p>{text}</xhtml:p></ST></inline></action></actionBlock>",
        from(&[at])
    )
}

fn text(chart: &[String]) -> String {
    let vars = ["go:BOOL", "back:BOOL", "leave:BOOL", "n:INT"];
    project(&vars, &format!("<SFC>{}</SFC>", chart.concat()), "")
}

/// The active ones of `names` after each scan; before scan k the variables of `set[k]` are set.
fn run(chart: &[String], names: &[&str], set: &[&[(&str, bool)]]) -> Vec<String> {
    let mut m = Machine::of(&compile(&text(chart)).unwrap_or_else(|e| panic!("{e}")));
    let mut seen = Vec::new();
    for values in set {
        for (name, value) in *values {
            m.set(name, Value::Bool(*value));
        }
        m.scan();
        let active: Vec<&str> = names
            .iter()
            .copied()
            .filter(|s| m.text(&format!("{s}.X")) == "TRUE")
            .collect();
        seen.push(active.join(" "));
    }
    seen
}

#[test]
fn a_macro_step_is_entered_at_its_first_step_and_left_from_its_last() {
    // Numbers count within one chart: those inside are the same as those outside.
    let inside = [
        step(1, "A", &[]),
        transition(2, "TRUE", &[1]),
        "<simultaneousDivergence localId=\"3\"><connectionPointIn><connection refLocalId=\"2\"/></connectionPointIn></simultaneousDivergence>".into(),
        step(4, "B", &[3]),
        step(5, "C", &[3]),
        "<simultaneousConvergence localId=\"6\"><connectionPointIn><connection refLocalId=\"4\"/></connectionPointIn><connectionPointIn><connection refLocalId=\"5\"/></connectionPointIn></simultaneousConvergence>".into(),
        transition(7, "TRUE", &[6]),
        step(8, "D", &[7]),
        action(9, 5, "n := n + 1;"),
    ];
    let chart = [
        initial(1, "Start", &[5]),
        transition(2, "go", &[1]),
        macro_step(3, "M", &[2], &inside),
        transition(5, "leave", &[3]),
    ];
    let seen = run(
        &chart,
        &["Start", "M", "A", "B", "C", "D"],
        &[
            &[],
            &[("go", true)],
            &[("leave", true)],
            &[("leave", false)],
            &[],
            &[("leave", true)],
            &[],
        ],
    );
    // `leave` counts in D only.
    assert_eq!(
        seen,
        ["Start", "M A", "M B C", "M D", "M D", "Start", "M A"]
    );
}

#[test]
fn macro_steps_stand_in_macro_steps_and_their_time_is_that_of_their_steps() {
    let innermost = [
        step(1, "X1", &[]),
        transition(2, "X1.T &gt;= T#20ms", &[1]),
        step(3, "X2", &[2]),
    ];
    let inner = [
        macro_step(1, "Inner", &[], &innermost),
        transition(2, "Inner.T &gt;= T#40ms", &[1]),
        step(3, "After", &[2]),
    ];
    let chart = [
        initial(1, "Start", &[4]),
        transition(2, "go", &[1]),
        macro_step(3, "Outer", &[2], &inner),
        transition(4, "Outer.T &gt;= T#60ms", &[3]),
    ];
    let mut set: Vec<&[(&str, bool)]> = vec![&[("go", true)]];
    set.resize(8, &[]);
    let seen = run(
        &chart,
        &["Start", "Outer", "Inner", "X1", "X2", "After"],
        &set,
    );
    // 10 ms a scan; entered in the second one.
    assert_eq!(
        seen,
        [
            "Start",
            "Outer Inner X1",
            "Outer Inner X1",
            "Outer Inner X2",
            "Outer Inner X2",
            "Outer After",
            "Outer After",
            "Start"
        ]
    );
}

#[test]
fn jumps_lead_to_macro_steps_and_to_divergences_and_out_of_macro_steps() {
    let inside = [
        step(1, "A", &[]),
        transition(2, "TRUE", &[1]),
        step(3, "B", &[2]),
        transition(4, "back", &[3]),
        jump(5, "A", &[4]),
        transition(6, "leave", &[3]),
        jump(7, "Split", &[6]),
        transition(8, "go", &[3]),
        step(9, "Z", &[8]),
    ];
    let chart = [
        initial(1, "Start", &[]),
        transition(2, "go", &[1]),
        jump(3, "M", &[2]),
        macro_step(4, "M", &[], &inside),
        transition(5, "TRUE", &[4]),
        "<simultaneousDivergence localId=\"6\" name=\"Split\"><connectionPointIn><connection refLocalId=\"5\"/></connectionPointIn></simultaneousDivergence>".into(),
        step(7, "P", &[6]),
        step(8, "Q", &[6]),
        "<simultaneousConvergence localId=\"9\"><connectionPointIn><connection refLocalId=\"7\"/></connectionPointIn><connectionPointIn><connection refLocalId=\"8\"/></connectionPointIn></simultaneousConvergence>".into(),
        transition(10, "TRUE", &[9]),
        jump(11, "Start", &[10]),
    ];
    let seen = run(
        &chart,
        &["Start", "M", "A", "B", "Z", "P", "Q"],
        &[
            &[],
            &[("go", true)],
            &[("go", false)],
            &[("back", true)],
            &[("back", false)],
            &[("leave", true)],
            &[("go", true), ("leave", false)],
            &[],
            &[],
            &[],
        ],
    );
    assert_eq!(
        seen,
        [
            "Start", "M A", "M B", "M A", "M B", "P Q", "Start", "M A", "M B", "M Z"
        ]
    );
}

#[test]
fn a_chart_may_begin_inside_a_macro_step() {
    let inside = [
        initial(1, "A", &[]),
        transition(2, "TRUE", &[1]),
        step(3, "B", &[2]),
    ];
    let chart = [
        macro_step(1, "M", &[4], &inside),
        transition(2, "TRUE", &[1]),
        step(3, "Rest", &[2]),
        transition(4, "TRUE", &[3]),
    ];
    let seen = run(&chart, &["M", "A", "B", "Rest"], &[&[], &[], &[], &[]]);
    assert_eq!(seen, ["M A", "M B", "Rest", "M A"]);
}

#[test]
fn a_condition_may_be_negated() {
    let negated = transition(2, "go", &[1]).replace("<condition>", "<condition negated=\"true\">");
    let chart = [
        initial(1, "Start", &[4]),
        negated,
        step(3, "Next", &[2]),
        transition(4, "go", &[3]),
    ];
    let seen = run(
        &chart,
        &["Start", "Next"],
        &[&[("go", true)], &[("go", false)], &[]],
    );
    assert_eq!(seen, ["Start", "Next", "Next"]);
}

#[test]
fn a_macro_step_without_one_beginning_and_one_end_is_an_error() {
    let with = |inside: &[String]| {
        text(&[
            initial(1, "Start", &[4]),
            transition(2, "go", &[1]),
            macro_step(3, "M", &[2], inside),
            transition(4, "TRUE", &[3]),
        ])
    };
    let two_first = with(&[
        step(1, "A", &[]),
        step(2, "B", &[]),
        transition(3, "TRUE", &[1]),
        step(4, "C", &[3]),
    ]);
    let two_last = with(&[
        step(1, "A", &[]),
        transition(2, "go", &[1]),
        step(3, "B", &[2]),
        transition(4, "back", &[1]),
        step(5, "C", &[4]),
    ]);
    let twice = with(&[step(1, "Start", &[])]);
    let same_name = with(&[step(1, "M", &[])]);
    let empty = with(&[]).replace("<body><SFC></SFC></body>", "");
    for (text, code) in [
        (two_first, "E706"),
        (two_last, "E706"),
        (twice, "E702"),
        (same_name, "E702"),
        (empty, "E602"),
    ] {
        let failed = compile(&text).expect_err(code);
        assert!(failed.contains(code), "{code}: {failed}");
        assert_eq!(failed.matches("error[").count(), 1, "{failed}");
    }
}
