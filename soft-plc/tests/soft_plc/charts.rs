//! Sequential function charts: evolution and every action qualifier, scan by scan.

use crate::common::Machine;

/// Values of the variables after each scan, as 0 and 1.
fn trace(m: &mut Machine, scans: usize, names: &[&str]) -> Vec<String> {
    let mut rows = vec![String::new(); names.len()];
    for _ in 0..scans {
        m.scan();
        for (row, name) in rows.iter_mut().zip(names) {
            row.push(if m.text(name) == "TRUE" { '1' } else { '0' });
        }
    }
    rows
}

#[test]
fn every_qualifier_acts_as_the_standard_says() {
    // A cycle is 10 ms. A is active in scans 1 to 5, B in 6 to 10, C from 11 on: the step is left when its time has passed.
    let text = "
PROGRAM P
VAR n, l, d, p, p1, p0, s, sd, ds, sl, r2 : BOOL; runs : INT; END_VAR
INITIAL_STEP A:
  n(N); l(L, T#20ms); d(D, T#20ms); p(P); p1(P1); p0(P0); s(S); sd(SD, T#70ms); ds(DS, T#20ms); sl(SL, T#30ms); act(N);
END_STEP
STEP B: END_STEP
STEP C: s(R); sd(R); ds(R); END_STEP
TRANSITION FROM A TO B := A.T >= T#50ms; END_TRANSITION
TRANSITION FROM B TO C := B.T >= T#50ms; END_TRANSITION
ACTION act: runs := runs + 1; END_ACTION
END_PROGRAM";
    let mut m = Machine::new(text);
    let names = [
        "A.X", "B.X", "C.X", "n", "l", "d", "p", "p1", "p0", "s", "sd", "ds", "sl",
    ];
    let rows = trace(&mut m, 12, &names);
    let expected = [
        "111110000000", // A
        "000001111100", // B
        "000000000011", // C
        "111110000000", // N: while A
        "110000000000", // L: the first 20 ms of A
        "001110000000", // D: from 20 ms on
        "100000000000", // P
        "100000000000", // P1
        "000001000000", // P0: when A is left
        "111111111100", // S until R in C
        "000000011100", // SD: 70 ms after A, until R
        "001111111100", // DS: stored after 20 ms of A, until R
        "111000000000", // SL: 30 ms
    ];
    for ((name, row), expected) in names.iter().zip(&rows).zip(expected) {
        assert_eq!(row, expected, "{name}");
    }
    assert_eq!(m.text("runs"), "5");
}

#[test]
fn branches_diverge_converge_and_jump() {
    let text = "
PROGRAM P
VAR go, left, right : BOOL; END_VAR
INITIAL_STEP Start: END_STEP
STEP L1: END_STEP
STEP R1: END_STEP
STEP Both1: END_STEP
STEP Both2: END_STEP
STEP Wait1: END_STEP
TRANSITION (PRIORITY := 2) FROM Start TO R1 := right; END_TRANSITION
TRANSITION (PRIORITY := 1) FROM Start TO L1 := left; END_TRANSITION
TRANSITION FROM L1 TO (Both1, Both2) := go; END_TRANSITION
TRANSITION FROM R1 TO Start := TRUE; END_TRANSITION
TRANSITION FROM Both1 TO Wait1 := go; END_TRANSITION
TRANSITION FROM (Wait1, Both2) TO Start := NOT go; END_TRANSITION
END_PROGRAM";
    let mut m = Machine::new(text);
    let active = |m: &Machine| -> String {
        ["Start", "L1", "R1", "Both1", "Both2", "Wait1"]
            .into_iter()
            .filter(|s| m.text(&format!("{s}.X")) == "TRUE")
            .collect::<Vec<_>>()
            .join(" ")
    };
    let t = fam_soft_plc::Value::Bool(true);
    let f = fam_soft_plc::Value::Bool(false);
    m.scan();
    assert_eq!(active(&m), "Start");
    m.set("right", t);
    m.scan();
    assert_eq!(active(&m), "R1");
    m.scan();
    assert_eq!(active(&m), "Start");
    // Both are true: the priority decides, and only one branch is taken.
    m.set("left", t);
    m.scan();
    assert_eq!(active(&m), "L1");
    m.set("go", t);
    m.scan();
    assert_eq!(active(&m), "Both1 Both2");
    m.scan();
    assert_eq!(active(&m), "Both2 Wait1");
    m.scan();
    assert_eq!(active(&m), "Both2 Wait1");
    m.set("go", f);
    m.scan();
    assert_eq!(active(&m), "Start");
}

#[test]
fn mistakes_in_charts_are_named() {
    for (body, code) in [
        ("STEP A: END_STEP", "E704"),
        (
            "INITIAL_STEP A: END_STEP TRANSITION FROM A TO B := TRUE; END_TRANSITION",
            "E705",
        ),
        ("INITIAL_STEP A: x(L); END_STEP", "E703"),
        ("INITIAL_STEP A: x(Q); END_STEP", "E708"),
        ("INITIAL_STEP A: END_STEP STEP A: END_STEP", "E702"),
    ] {
        let text = format!("PROGRAM P VAR x : BOOL; END_VAR {body} END_PROGRAM");
        let files = [fam_soft_plc::SourceFile::new("chart.st", text)];
        let (_, diagnostics) = fam_soft_plc::parse_project(&files);
        assert!(
            diagnostics.iter().any(|d| d.code == code),
            "{body}: {}",
            crate::common::show(&diagnostics)
        );
    }
}
