//! Function block diagrams, ladder diagrams and charts of PLCopen XML: connections, order, modifiers, jumps.

use fam_soft_plc::standalone::{self, Options};
use fam_soft_plc::{CompiledMc, SourceFile, Value};

use crate::common::{Machine, show};

/// A project with program P: variables as `name:TYPE`, and a body.
pub fn project(vars: &[&str], body: &str, more: &str) -> String {
    let vars: String = vars
        .iter()
        .filter_map(|v| v.split_once(':'))
        .map(|(name, ty)| {
            let ty = if ty.chars().all(|c| c.is_ascii_uppercase())
                && !["TON", "CTU", "SR"].contains(&ty)
            {
                format!("<{ty}/>")
            } else {
                format!("<derived name=\"{ty}\"/>")
            };
            format!("<variable name=\"{name}\"><type>{ty}</type></variable>")
        })
        .collect();
    format!(
        "<project xmlns=\"http://www.plcopen.org/xml/tc6_0201\" xmlns:xhtml=\"http://www.w3.org/1999/xhtml\"><types><dataTypes/><pous>
<pou name=\"P\" pouType=\"program\"><interface><localVars>{vars}</localVars></interface>{more}<body>{body}</body></pou>
</pous></types><instances><configurations/></instances></project>"
    )
}

pub fn compile(text: &str) -> Result<CompiledMc, String> {
    let options = Options {
        program: Some("P".into()),
        ..Options::default()
    };
    standalone::prepare(&[SourceFile::new("p.xml", text)], &options)
        .map(|p| p.mc)
        .map_err(|d| show(&d))
}

fn machine(vars: &[&str], body: &str) -> Machine {
    let text = project(vars, body, "");
    Machine::of(&compile(&text).unwrap_or_else(|e| panic!("{e}")))
}

pub fn input(id: u32, text: &str) -> String {
    format!(
        "<inVariable localId=\"{id}\"><connectionPointOut/><expression>{text}</expression></inVariable>"
    )
}

pub fn from(ids: &[&str]) -> String {
    let list: String = ids
        .iter()
        .map(|id| match id.split_once('.') {
            Some((id, pin)) => {
                format!("<connection refLocalId=\"{id}\" formalParameter=\"{pin}\"/>")
            }
            None => format!("<connection refLocalId=\"{id}\"/>"),
        })
        .collect();
    format!("<connectionPointIn>{list}</connectionPointIn>")
}

pub fn output(id: u32, text: &str, source: &[&str]) -> String {
    format!(
        "<outVariable localId=\"{id}\">{}<expression>{text}</expression></outVariable>",
        from(source)
    )
}

/// Inputs as `pin=source` or `pin!=source` (negated), `pin/=source` (rising edge); outputs by their names.
pub fn block(id: u32, ty: &str, instance: &str, inputs: &[&str], outputs: &[&str]) -> String {
    let ins: String = inputs
        .iter()
        .filter_map(|i| i.split_once('='))
        .map(|(pin, source)| {
            let (pin, more) = match (pin.strip_suffix('!'), pin.strip_suffix('/')) {
                (Some(pin), _) => (pin, "negated=\"true\""),
                (_, Some(pin)) => (pin, "edge=\"rising\""),
                _ => (pin, ""),
            };
            format!(
                "<variable formalParameter=\"{pin}\" {more}>{}</variable>",
                from(&[source])
            )
        })
        .collect();
    let outs: String = outputs
        .iter()
        .map(|pin| format!("<variable formalParameter=\"{pin}\"><connectionPointOut/></variable>"))
        .collect();
    let instance = if instance.is_empty() {
        String::new()
    } else {
        format!("instanceName=\"{instance}\"")
    };
    format!(
        "<block localId=\"{id}\" typeName=\"{ty}\" {instance}><inputVariables>{ins}</inputVariables><inOutVariables/><outputVariables>{outs}</outputVariables></block>"
    )
}

#[test]
fn functions_run_after_what_they_take_values_from() {
    // r := (a + b) * a, drawn backwards in the file.
    let body = [
        output(9, "r", &["8"]),
        block(8, "MUL", "", &["IN1=7.OUT", "IN2=1"], &["OUT"]),
        block(7, "ADD", "", &["IN1=1", "IN2=2"], &["OUT"]),
        input(1, "a"),
        input(2, "b"),
        output(10, "s", &["7.OUT"]),
    ]
    .concat();
    let mut m = machine(
        &["a:INT", "b:INT", "r:INT", "s:INT"],
        &format!("<FBD>{body}</FBD>"),
    );
    m.set("a", Value::Int(3));
    m.set("b", Value::Int(4));
    m.scan();
    assert_eq!((m.text("r"), m.text("s")), ("21".into(), "7".into()));
}

#[test]
fn function_blocks_are_called_once_and_feed_back() {
    // A counter of the rising edges of its own parity: CTU with CU := NOT parity, parity := odd CV.
    let body = [
        block(
            3,
            "CTU",
            "count",
            &["CU/=1", "R=9.OUT", "PV=2"],
            &["Q", "CV"],
        ),
        input(1, "go"),
        input(2, "3"),
        block(9, "AND", "", &["IN1=3.Q", "IN2=1"], &["OUT"]),
        output(4, "q", &["3.Q"]),
        output(5, "cv", &["3.CV"]),
    ]
    .concat();
    let mut m = machine(
        &["go:BOOL", "q:BOOL", "cv:INT", "count:CTU"],
        &format!("<FBD>{body}</FBD>"),
    );
    let mut seen = Vec::new();
    for go in [true, false, true, false, true, true, false] {
        m.set("go", Value::Bool(go));
        m.scan();
        seen.push(m.text("cv"));
    }
    // In the sixth scan Q of the scan before resets it.
    assert_eq!(seen, ["1", "1", "2", "2", "3", "0", "0"]);
}

fn in_out(id: u32, more: &str, text: &str, source: &[&str]) -> String {
    format!(
        "<inOutVariable localId=\"{id}\" {more}>{}<connectionPointOut/><expression>{text}</expression></inOutVariable>",
        from(source)
    )
}

/// A loop through functions has its memory in a variable that stands in it; wherever the loop is entered.
#[test]
fn a_variable_in_a_loop_of_functions_feeds_back() {
    let parts = [
        block(5, "ADD", "", &["IN1=2", "IN2=6"], &["OUT"]),
        in_out(6, "", "count", &["5.OUT"]),
        input(2, "step"),
        output(7, "twice", &["8.OUT"]),
        block(8, "ADD", "", &["IN1=5.OUT", "IN2=5.OUT"], &["OUT"]),
    ];
    for first in 0..parts.len() {
        let turned = [&parts[first..], &parts[..first]].concat().concat();
        let mut m = machine(
            &["step:INT", "count:INT", "twice:INT"],
            &format!("<FBD>{turned}</FBD>"),
        );
        m.set("step", Value::Int(3));
        let mut seen = Vec::new();
        for _ in 0..3 {
            m.scan();
            seen.push((m.text("count"), m.text("twice")));
        }
        let expected = [("3", "6"), ("6", "12"), ("9", "18")];
        let expected = expected.map(|(a, b)| (a.to_owned(), b.to_owned()));
        assert_eq!(seen, expected, "begun with part {first}");
    }
}

#[test]
fn both_sides_of_a_variable_are_modified() {
    let body = [
        input(1, "go"),
        in_out(2, "negatedIn=\"true\" negatedOut=\"true\"", "kept", &["1"]),
        output(3, "out", &["2"]),
        in_out(4, "storageIn=\"set\"", "once", &["1"]),
        in_out(5, "edgeOut=\"rising\"", "echo", &["1"]),
        output(6, "edge", &["5"]),
    ]
    .concat();
    let vars = [
        "go:BOOL",
        "kept:BOOL",
        "out:BOOL",
        "once:BOOL",
        "echo:BOOL",
        "edge:BOOL",
    ];
    let mut m = machine(&vars, &format!("<FBD>{body}</FBD>"));
    let mut seen = Vec::new();
    for go in [false, true, true, false] {
        m.set("go", Value::Bool(go));
        m.scan();
        seen.push(["kept", "out", "once", "edge"].map(|v| m.text(v)).join(" "));
    }
    assert_eq!(
        seen,
        [
            "TRUE FALSE FALSE FALSE",
            "FALSE TRUE TRUE TRUE",
            "FALSE TRUE TRUE FALSE",
            "TRUE FALSE TRUE FALSE"
        ]
    );
}

#[test]
fn enable_inputs_stop_a_function_and_keep_its_value() {
    let body = [
        input(1, "go"),
        input(2, "a"),
        input(3, "10"),
        block(4, "ADD", "", &["EN=1", "IN1=2", "IN2=3"], &["ENO", "OUT"]),
        output(5, "r", &["4.OUT"]),
        output(6, "ok", &["4.ENO"]),
    ]
    .concat();
    let mut m = machine(
        &["go:BOOL", "a:INT", "r:INT", "ok:BOOL"],
        &format!("<FBD>{body}</FBD>"),
    );
    m.set("r", Value::Int(77));
    m.scan();
    assert_eq!((m.text("r"), m.text("ok")), ("77".into(), "FALSE".into()));
    m.set("go", Value::Bool(true));
    m.set("a", Value::Int(5));
    m.scan();
    assert_eq!((m.text("r"), m.text("ok")), ("15".into(), "TRUE".into()));
    // A variable that somebody else writes meanwhile is left alone.
    m.set("r", Value::Int(78));
    m.set("go", Value::Bool(false));
    m.set("a", Value::Int(6));
    m.scan();
    assert_eq!((m.text("r"), m.text("ok")), ("78".into(), "FALSE".into()));
}

#[test]
fn a_result_of_any_integer_has_the_type_of_what_it_goes_to() {
    let body = [
        input(1, "x"),
        block(2, "TRUNC", "", &["IN=1"], &["OUT"]),
        output(3, "r", &["2.OUT"]),
        output(4, "wide", &["2.OUT"]),
    ]
    .concat();
    let mut m = machine(
        &["x:REAL", "r:INT", "wide:LINT"],
        &format!("<FBD>{body}</FBD>"),
    );
    m.set("x", Value::Real(-3.7));
    m.scan();
    assert_eq!((m.text("r"), m.text("wide")), ("-3".into(), "-3".into()));
}

fn contact(id: u32, more: &str, variable: &str, source: &[&str]) -> String {
    format!(
        "<contact localId=\"{id}\" {more}>{}<connectionPointOut/><variable>{variable}</variable></contact>",
        from(source)
    )
}

fn coil(id: u32, more: &str, variable: &str, source: &[&str]) -> String {
    format!(
        "<coil localId=\"{id}\" {more}>{}<connectionPointOut/><variable>{variable}</variable></coil>",
        from(source)
    )
}

#[test]
fn rungs_have_series_parallel_negated_edges_set_and_reset() {
    let body = [
        "<leftPowerRail localId=\"1\"><connectionPointOut/></leftPowerRail>".to_owned(),
        contact(2, "", "a", &["1"]),
        contact(3, "negated=\"true\"", "b", &["2"]),
        contact(4, "", "c", &["1"]),
        coil(5, "", "q", &["3", "4"]),
        coil(6, "negated=\"true\"", "nq", &["3", "4"]),
        contact(7, "edge=\"rising\"", "a", &["1"]),
        coil(8, "storage=\"set\"", "s", &["7"]),
        contact(9, "", "c", &["1"]),
        coil(10, "storage=\"reset\"", "s", &["9"]),
        contact(11, "edge=\"falling\"", "a", &["1"]),
        coil(12, "", "f", &["11"]),
        format!(
            "<rightPowerRail localId=\"13\">{}</rightPowerRail>",
            from(&["5", "6", "8", "10", "12"])
        ),
    ]
    .concat();
    let vars = [
        "a:BOOL", "b:BOOL", "c:BOOL", "q:BOOL", "nq:BOOL", "s:BOOL", "f:BOOL",
    ];
    let mut m = machine(&vars, &format!("<LD>{body}</LD>"));
    let mut rows = Vec::new();
    for (a, b, c) in [(1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 0, 0)] {
        for (name, value) in [("a", a), ("b", b), ("c", c)] {
            m.set(name, Value::Bool(value == 1));
        }
        m.scan();
        let row: String = ["q", "nq", "s", "f"]
            .iter()
            .map(|n| if m.text(n) == "TRUE" { '1' } else { '0' })
            .collect();
        rows.push(row);
    }
    assert_eq!(rows, ["1010", "0110", "0111", "1000", "1010"]);
}

#[test]
fn jumps_and_returns_leave_out_what_lies_between() {
    let jump = |id: u32, label: &str, source: &str| {
        format!(
            "<jump localId=\"{id}\" label=\"{label}\">{}</jump>",
            from(&[source])
        )
    };
    let body = [
        input(1, "skip"),
        input(2, "1"),
        input(3, "stop"),
        input(4, "2"),
        jump(5, "behind", "1"),
        output(6, "a", &["2"]),
        "<label localId=\"7\" label=\"behind\"/>".to_owned(),
        format!("<return localId=\"8\">{}</return>", from(&["3"])),
        output(9, "b", &["4"]),
    ]
    .concat();
    let vars = ["skip:BOOL", "stop:BOOL", "a:INT", "b:INT"];
    for (skip, stop, a, b) in [
        (false, false, "1", "2"),
        (true, false, "0", "2"),
        (true, true, "0", "0"),
    ] {
        let mut m = machine(&vars, &format!("<FBD>{body}</FBD>"));
        m.set("skip", Value::Bool(skip));
        m.set("stop", Value::Bool(stop));
        m.scan();
        assert_eq!(
            (m.text("a").as_str(), m.text("b").as_str()),
            (a, b),
            "{skip} {stop}"
        );
    }
}

#[test]
fn drawn_charts_run_with_conditions_in_any_language() {
    let step = |id: u32, name: &str, initial: bool, source: &[&str]| {
        format!(
            "<step localId=\"{id}\" name=\"{name}\" initialStep=\"{initial}\">{}<connectionPointOut formalParameter=\"\"/></step>",
            from(source)
        )
    };
    let transition = |id: u32, condition: &str, source: &[&str]| {
        format!(
            "<transition localId=\"{id}\">{}<condition>{condition}</condition></transition>",
            from(source)
        )
    };
    let body = [
        step(1, "Start", true, &["20"]),
        "<selectionDivergence localId=\"2\"><connectionPointIn><connection refLocalId=\"1\"/></connectionPointIn></selectionDivergence>".into(),
        transition(3, "<inline name=\"\"><ST><xhtml:p>go AND n &lt; 1</xhtml:p></ST></inline>", &["2"]),
        transition(4, "<reference name=\"other\"/>", &["2"]),
        "<simultaneousDivergence localId=\"5\"><connectionPointIn><connection refLocalId=\"3\"/></connectionPointIn></simultaneousDivergence>".into(),
        step(6, "Left", false, &["5"]),
        step(7, "Right", false, &["5"]),
        "<simultaneousConvergence localId=\"8\"><connectionPointIn><connection refLocalId=\"6\"/></connectionPointIn><connectionPointIn><connection refLocalId=\"7\"/></connectionPointIn></simultaneousConvergence>".into(),
        "<contact localId=\"9\"><connectionPointIn><connection refLocalId=\"10\"/></connectionPointIn><variable>go</variable></contact><leftPowerRail localId=\"10\"/>".into(),
        transition(11, "<connectionPointIn><connection refLocalId=\"9\"/></connectionPointIn>", &["8"]),
        "<jumpStep localId=\"12\" targetName=\"Start\"><connectionPointIn><connection refLocalId=\"11\"/></connectionPointIn></jumpStep>".into(),
        step(13, "Third", false, &["4"]),
        transition(20, "<inline name=\"\"><ST><xhtml:p>:= TRUE;</xhtml:p></ST></inline>", &["13"]),
        "<actionBlock localId=\"14\"><connectionPointIn><connection refLocalId=\"6\"/></connectionPointIn><action localId=\"1\" qualifier=\"N\"><reference name=\"lamp\"/></action><action localId=\"2\" qualifier=\"P\"><inline><ST><xhtml:p>n := n + 1;</xhtml:p></ST></inline></action><action localId=\"3\"><reference name=\"Work\"/></action></actionBlock>".into(),
    ]
    .concat();
    let more = "<actions><action name=\"Work\"><body><ST><xhtml:p>work := work + 10;</xhtml:p></ST></body></action></actions>
<transitions><transition name=\"other\"><body><FBD><inVariable localId=\"1\"><expression>go</expression></inVariable><outVariable localId=\"2\"><connectionPointIn><connection refLocalId=\"1\"/></connectionPointIn><expression>other</expression></outVariable></FBD></body></transition></transitions>";
    let text = project(
        &["go:BOOL", "lamp:BOOL", "n:INT", "work:INT"],
        &format!("<SFC>{body}</SFC>"),
        more,
    );
    let mut m = Machine::of(&compile(&text).unwrap_or_else(|e| panic!("{e}")));
    let active = |m: &Machine| -> String {
        ["Start", "Left", "Right", "Third"]
            .into_iter()
            .filter(|s| m.text(&format!("{s}.X")) == "TRUE")
            .collect::<Vec<_>>()
            .join(" ")
    };
    m.scan();
    assert_eq!(
        (active(&m).as_str(), m.text("lamp").as_str()),
        ("Start", "FALSE")
    );
    m.set("go", Value::Bool(true));
    let mut seen = Vec::new();
    for _ in 0..4 {
        m.scan();
        seen.push(active(&m));
    }
    assert_eq!(seen, ["Left Right", "Start", "Third", "Start"]);
    assert_eq!(
        (m.text("n"), m.text("work"), m.text("lamp")),
        ("1".into(), "10".into(), "FALSE".into())
    );
}

#[test]
fn one_mistake_is_told_once() {
    let body = [
        input(1, "nowhere"),
        block(2, "ADD", "", &["IN1=1", "IN2=1"], &["OUT"]),
        block(3, "ADD", "", &["IN1=2.OUT", "IN2=2.OUT"], &["OUT"]),
        output(4, "r", &["3.OUT"]),
    ];
    let text = project(&["r:INT"], &format!("<FBD>{}</FBD>", body.concat()), "");
    let failed = compile(&text).expect_err("`nowhere` is not declared");
    assert_eq!(failed.matches("error[").count(), 1, "{failed}");
}

#[test]
fn what_a_diagram_lacks_is_an_error_with_its_line() {
    for (body, code) in [
        (output(1, "r", &["7"]), "E610"),
        (
            block(1, "ADD", "", &["IN1=1.OUT", "IN2=1.OUT"], &["OUT"])
                + &output(2, "r", &["1.OUT"]),
            "E611",
        ),
        ("<unheardOf localId=\"1\"/>".into(), "E609"),
        (
            format!("<jump localId=\"1\" label=\"x\">{}</jump>", from(&[])),
            "E711",
        ),
        (block(1, "TON", "t", &[], &["Q"]), "E613"),
        (
            block(1, "AND", "", &["IN1=2", "IN2=2"], &["OUT"])
                + &input(2, "TRUE")
                + &output(3, "b", &["1.QQ"]),
            "E610",
        ),
    ] {
        let text = project(
            &["r:INT", "b:BOOL", "t:TOF"],
            &format!("<FBD>\n{body}</FBD>"),
            "",
        );
        let failed = compile(&text).expect_err(code);
        assert!(failed.contains(code), "{code}: {failed}");
        assert!(failed.contains("p.xml:3:"), "{failed}");
    }
}

#[test]
fn elements_of_one_name_are_told_apart_by_nobody() {
    let label = |id: u32| format!("<label localId=\"{id}\" label=\"x\"/>");
    let connector = |id: u32| {
        format!(
            "<connector localId=\"{id}\" name=\"c\">{}</connector>",
            from(&[])
        )
    };
    for (body, code) in [
        (label(1) + &label(2), "E711"),
        (connector(1) + &connector(2), "E610"),
        (input(1, "r") + &input(1, "2"), "E610"),
    ] {
        let text = project(&["r:INT"], &format!("<FBD>{body}</FBD>"), "");
        let failed = compile(&text).expect_err(code);
        assert_eq!(failed.matches("stands twice").count(), 1, "{failed}");
        assert!(failed.contains(code), "{code}: {failed}");
    }
}
