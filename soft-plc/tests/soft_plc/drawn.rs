//! Small drawn programs that use the elements of TC6 in combination; values worked out by hand.

use fam_soft_plc::{CheckOptions, SourceFile, Value, diagnose};

use crate::common::Machine;
use crate::diagrams::{block, compile, from, input, output, project};

fn rail() -> String {
    "<leftPowerRail localId=\"1\"><connectionPointOut formalParameter=\"\"/></leftPowerRail>".into()
}

fn contact(id: u32, more: &str, variable: &str, before: &[&str]) -> String {
    format!(
        "<contact localId=\"{id}\" {more}>{}<connectionPointOut/><variable>{variable}</variable></contact>",
        from(before)
    )
}

fn coil(id: u32, more: &str, variable: &str, before: &[&str]) -> String {
    format!(
        "<coil localId=\"{id}\" {more}>{}<connectionPointOut/><variable>{variable}</variable></coil>",
        from(before)
    )
}

/// The value of `r` after each scan; before scan k `a`, `b` and `c` get the bits of `inputs[k]`.
fn run(vars: &[&str], body: &str, inputs: &[&str]) -> String {
    let mut all = vec!["a:BOOL", "b:BOOL", "c:BOOL"];
    all.extend(vars);
    let mut m = Machine::of(&compile(&project(&all, body, "")).unwrap_or_else(|e| panic!("{e}")));
    let mut seen = Vec::new();
    for bits in inputs {
        for (name, bit) in ["a", "b", "c"].into_iter().zip(bits.chars()) {
            m.set(name, Value::Bool(bit == '1'));
        }
        m.scan();
        seen.push(m.text("r"));
    }
    seen.join(" ")
}

#[test]
fn rungs_do_what_relays_would() {
    let four = ["000", "100", "110", "010"];
    for (name, rung, inputs, expected) in [
        (
            "in series",
            [
                contact(2, "", "a", &["1"]),
                contact(3, "", "b", &["2"]),
                coil(4, "", "r", &["3"]),
            ]
            .concat(),
            &four[..],
            "FALSE FALSE TRUE FALSE",
        ),
        (
            "in parallel, one of them negated",
            [
                contact(2, "", "a", &["1"]),
                contact(3, "negated=\"true\"", "b", &["1"]),
                coil(4, "", "r", &["2", "3"]),
            ]
            .concat(),
            &four,
            "TRUE TRUE TRUE FALSE",
        ),
        (
            "a negated coil",
            [
                contact(2, "", "a", &["1"]),
                coil(4, "negated=\"true\"", "r", &["2"]),
            ]
            .concat(),
            &four,
            "TRUE FALSE FALSE TRUE",
        ),
        (
            "set and reset, the later one wins",
            [
                contact(2, "", "a", &["1"]),
                coil(3, "storage=\"set\"", "r", &["2"]),
                contact(4, "", "b", &["1"]),
                coil(5, "storage=\"reset\"", "r", &["4"]),
            ]
            .concat(),
            &["000", "100", "000", "110", "000", "100", "010"],
            "FALSE TRUE TRUE FALSE FALSE TRUE FALSE",
        ),
        (
            "rising and falling contacts",
            [
                contact(2, "edge=\"rising\"", "a", &["1"]),
                contact(3, "edge=\"falling\"", "a", &["1"]),
                coil(4, "", "r", &["2", "3"]),
            ]
            .concat(),
            &["100", "100", "000", "000", "100"],
            "TRUE FALSE TRUE FALSE TRUE",
        ),
        (
            "a rising coil",
            [
                contact(2, "", "a", &["1"]),
                coil(3, "edge=\"rising\"", "r", &["2"]),
            ]
            .concat(),
            &["100", "100", "000", "100"],
            "TRUE FALSE FALSE TRUE",
        ),
        (
            "power goes on behind a coil",
            [
                contact(2, "", "a", &["1"]),
                coil(3, "", "b", &["2"]),
                contact(4, "", "b", &["3"]),
                coil(5, "", "r", &["4"]),
            ]
            .concat(),
            &["000", "100", "010"],
            "FALSE TRUE FALSE",
        ),
    ] {
        let body = format!("<LD>{}{rung}</LD>", rail());
        assert_eq!(run(&["r:BOOL"], &body, inputs), expected, "{name}");
    }
}

#[test]
fn blocks_stand_in_rungs_and_diagrams() {
    let enabled = block(5, "ADD", "", &["EN=2", "IN1=3", "IN2=4"], &["ENO", "OUT"]);
    for (name, vars, body, inputs, expected) in [
        (
            "a function with EN in a rung",
            &["r:INT"][..],
            format!(
                "<LD>{}{}{}{}{enabled}{}</LD>",
                rail(),
                contact(2, "", "a", &["1"]),
                input(3, "r"),
                input(4, "5"),
                output(6, "r", &["5.OUT"])
            ),
            &["000", "100", "000", "100"][..],
            "0 5 5 10",
        ),
        (
            "ENO goes on as power",
            &["r:BOOL", "n:INT"],
            format!(
                "<LD>{}{}{}{}{enabled}{}{}</LD>",
                rail(),
                contact(2, "", "a", &["1"]),
                input(3, "n"),
                input(4, "1"),
                output(6, "n", &["5.OUT"]),
                coil(7, "", "r", &["5.ENO"])
            ),
            &["000", "100"],
            "FALSE TRUE",
        ),
        (
            "a timer in a rung",
            &["r:BOOL", "t:TON"],
            format!(
                "<LD>{}{}{}{}{}</LD>",
                rail(),
                contact(2, "", "a", &["1"]),
                input(3, "T#20ms"),
                block(4, "TON", "t", &["IN=2", "PT=3"], &["Q", "ET"]),
                coil(5, "", "r", &["4.Q"])
            ),
            &["100", "100", "100", "000"],
            "FALSE FALSE TRUE FALSE",
        ),
        (
            "as many inputs as one likes, one negated",
            &["r:BOOL"],
            format!(
                "<FBD>{}{}{}{}{}</FBD>",
                input(1, "a"),
                input(2, "b"),
                input(3, "c"),
                block(4, "AND", "", &["IN1=1", "IN2!=2", "IN3=3"], &["OUT"]),
                output(5, "r", &["4.OUT"])
            ),
            &["101", "111", "100"],
            "TRUE FALSE FALSE",
        ),
        (
            "selection by a number",
            &["r:INT"],
            format!(
                "<FBD>{}{}{}{}{}{}</FBD>",
                input(1, "BOOL_TO_INT(a) + BOOL_TO_INT(b)"),
                input(2, "7"),
                input(3, "8"),
                input(4, "9"),
                block(5, "MUX", "", &["K=1", "IN0=2", "IN1=3", "IN2=4"], &["OUT"]),
                output(6, "r", &["5.OUT"])
            ),
            &["000", "010", "110"],
            "7 8 9",
        ),
        (
            "a value through a connector",
            &["r:INT", "n:INT"],
            format!(
                "<FBD>{}<connector name=\"far\" localId=\"2\">{}</connector><continuation name=\"far\" localId=\"3\"><connectionPointOut/></continuation>{}{}{}</FBD>",
                input(1, "4"),
                from(&["1"]),
                input(4, "n"),
                block(5, "ADD", "", &["IN1=3", "IN2=4"], &["OUT"]),
                output(6, "r", &["5.OUT"]) + &output(7, "n", &["5.OUT"])
            ),
            &["000", "000"],
            "4 8",
        ),
        (
            "a counter of edges",
            &["r:INT", "k:CTU"],
            format!(
                "<FBD>{}{}{}{}{}</FBD>",
                input(1, "a"),
                input(2, "b"),
                input(3, "2"),
                block(4, "CTU", "k", &["CU=1", "R=2", "PV=3"], &["Q", "CV"]),
                output(5, "r", &["4.CV"])
            ),
            &["100", "100", "000", "100", "010"],
            "1 1 1 2 0",
        ),
        (
            "strings",
            &["r:INT"],
            format!(
                "<FBD>{}{}{}{}{}</FBD>",
                input(1, "'x'"),
                input(2, "'ab'"),
                block(3, "CONCAT", "", &["IN1=1", "IN2=2"], &["OUT"]),
                block(4, "LEN", "", &["IN=3.OUT"], &["OUT"]),
                output(6, "r", &["4.OUT"])
            ),
            &["000"],
            "3",
        ),
        (
            "instruction list",
            &["r:INT"],
            "<IL><xhtml:p>LD a\nAND( b\nOR c\n)\nJMPC on\nLD 0\nST r\nRET\non: LD r\nADD 1\nST r</xhtml:p></IL>".into(),
            &["110", "101", "100", "111"],
            "1 2 0 1",
        ),
        (
            "structured text with CDATA",
            &["r:INT"],
            "<ST><xhtml:p><![CDATA[IF a AND r < 2 THEN r := r + 1; END_IF;]]></xhtml:p></ST>".into(),
            &["100", "100", "100"],
            "1 2 2",
        ),
    ] {
        assert_eq!(run(vars, &body, inputs), expected, "{name}");
    }
}

#[test]
fn what_nothing_is_connected_to_is_told() {
    let vars = ["a:BOOL", "b:BOOL", "c:BOOL", "r:BOOL", "n:INT"];
    let whole = [
        contact(2, "", "a", &["1"]),
        coil(3, "", "r", &["2"]),
        input(4, "5"),
        output(5, "n", &["4"]),
    ]
    .concat();
    let loose = [
        contact(2, "", "a", &[]),
        coil(3, "", "r", &["2"]),
        contact(4, "", "b", &["1"]),
        coil(5, "", "c", &[]),
        input(6, "5"),
        output(7, "n", &[]),
    ]
    .concat();
    let said = |body: &str| -> Vec<String> {
        let text = project(&vars, &format!("<LD>{}{body}</LD>", rail()), "");
        let files = [SourceFile::new("p.xml", text)];
        let found = diagnose(&files, CheckOptions::default()).into_iter();
        let loose = found.filter(|d| d.code == "W719").map(|d| d.message);
        loose.collect()
    };
    assert_eq!(said(&whole), Vec::<String>::new());
    assert_eq!(
        said(&loose),
        [
            "no power comes to this contact: nothing is connected to it",
            "the power of this contact goes nowhere",
            "no power comes to this coil: nothing is connected to it",
            "the value of this variable goes nowhere",
            "this variable is not written: nothing is connected to it",
        ]
    );
}
