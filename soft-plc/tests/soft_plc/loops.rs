//! Variables that loops hold in registers: nobody can tell.

use fam_soft_plc::{CheckOptions, TrapKind, Value, compile};

use crate::common::{Machine, compiled, show, spec, typed_with};

#[test]
fn return_and_exit_from_a_loop_leave_the_variables_as_they_were() {
    let text = "
VAR_GLOBAL g : INT; END_VAR
FUNCTION_BLOCK B
VAR_INPUT stop : INT; END_VAR VAR_OUTPUT n : INT; b : BYTE; END_VAR VAR i, j : INT; END_VAR
n := 0;
FOR i := 1 TO 100 DO
  FOR j := 1 TO 3 DO
    n := n + 1;
    b.1 := NOT b.1;
    IF n = 10 THEN EXIT; END_IF;
    IF n = stop THEN RETURN; END_IF;
  END_FOR;
  IF n > 200 THEN CONTINUE; END_IF;
END_FOR;
n := n + 1000;
END_FUNCTION_BLOCK
PROGRAM P
VAR one, two : B; k : INT; END_VAR
WHILE k < 5 DO k := k + 1; g := g + k; END_WHILE;
one(stop := 17);
two(stop := -1);
END_PROGRAM";
    let mut m = Machine::new(text);
    m.scan();
    let names = [
        "one.n", "one.i", "one.j", "one.b", "two.n", "two.i", "two.j", "k", "g",
    ];
    let values: Vec<String> = names.iter().map(|n| m.text(n)).collect();
    assert_eq!(values, ["17", "7", "1", "2", "1298", "101", "4", "5", "15"]);
}

#[test]
fn what_others_touch_is_read_afresh() {
    let text = "
VAR_GLOBAL g : INT; END_VAR
FUNCTION Bump : INT VAR_IN_OUT x : INT; END_VAR x := x + 1; g := g + 1; Bump := g; END_FUNCTION
FUNCTION_BLOCK Peek VAR_OUTPUT seen : INT; END_VAR VAR_IN_OUT other : INT; END_VAR seen := P.total; other := other + 100; END_FUNCTION_BLOCK
PROGRAM P
VAR_OUTPUT total : INT; END_VAR
VAR i, x, sum, last, y : INT; peek1 : Peek; END_VAR
FOR i := 1 TO 5 DO
  total := total + i;
  sum := sum + Bump(x) + g;
  peek1(other := y);
  last := peek1.seen;
END_FOR;
END_PROGRAM";
    let mut m = Machine::new(text);
    m.scan();
    let names = ["total", "x", "sum", "last", "y", "g"];
    let values: Vec<String> = names.iter().map(|n| m.text(n)).collect();
    assert_eq!(values, ["15", "5", "30", "15", "500", "5"]);
}

#[test]
fn a_parameter_by_reference_may_be_another_name() {
    let text = "
FUNCTION_BLOCK Sum
VAR_INPUT step : INT := 1; END_VAR VAR_IN_OUT acc : INT; END_VAR VAR i : INT; END_VAR
FOR i := 1 TO 4 DO acc := acc + step; END_FOR;
END_FUNCTION_BLOCK
PROGRAM P VAR s : Sum; END_VAR s(acc := s.step); END_PROGRAM";
    let mut m = Machine::new(text);
    m.scan();
    assert_eq!(m.text("s.step"), "16");
}

#[test]
fn a_region_copied_in_a_loop_sees_the_present_values() {
    let text = "
VAR_GLOBAL image : ARRAY[0..7] OF BYTE; END_VAR
PROGRAM S VAR_OUTPUT n : INT; END_VAR VAR i : INT; END_VAR
FOR i := 1 TO 3 DO n := n + 1; Save(); END_FOR;
END_PROGRAM
PROGRAM Save VAR k : INT; END_VAR __REGION_TO_BYTES('s', image); END_PROGRAM
PROGRAM P S(); END_PROGRAM";
    let options = CheckOptions {
        allow_internal_access: true,
        ..CheckOptions::default()
    };
    let spec = fam_soft_plc::CompileSpec {
        entry: "P".into(),
        regions: vec![fam_soft_plc::RegionSpec {
            name: "s".into(),
            programs: vec!["S".into()],
            globals: vec![],
            markers: false,
        }],
        ..Default::default()
    };
    let mc = compile(&typed_with(text, options), &spec).unwrap_or_else(|d| panic!("{}", show(&d)));
    let mut m = Machine::of(&mc);
    m.scan();
    assert_eq!(m.text("image[0]"), "3");
}

#[test]
fn indices_that_can_leave_the_array_are_still_checked() {
    for (body, index) in [
        ("FOR i := 0 TO 10 DO a[i] := 1; END_FOR;", Some(10)),
        ("FOR i := 0 TO 9 DO a[i] := 1; END_FOR;", None),
        ("FOR i := 0 TO 9 DO a[i + 1] := 1; END_FOR;", Some(10)),
        ("FOR i := 0 TO 8 DO a[i + 1] := a[9 - i]; END_FOR;", None),
        ("FOR i := 9 TO 0 BY -1 DO a[i] := 1; END_FOR;", None),
        ("FOR i := 9 TO -1 BY -1 DO a[i] := 1; END_FOR;", Some(-1)),
        (
            "FOR i := 0 TO 9 DO i := i + 5; a[i] := 1; END_FOR;",
            Some(11),
        ),
        (
            "FOR i := 0 TO 9 DO IF i = 4 THEN Set(i); END_IF; a[i] := 1; END_FOR;",
            Some(40),
        ),
        (
            "FOR i := 0 TO 9 DO b(x := i); a[i] := 1; END_FOR;",
            Some(40),
        ),
        ("FOR i := 0 TO 99 DO a[i MOD 10] := 1; END_FOR;", None),
        ("FOR i := -3 TO 3 DO a[i MOD 10] := 1; END_FOR;", Some(-3)),
        ("FOR i := 0 TO 9 DO a[i * 2] := 1; END_FOR;", Some(10)),
        ("FOR i := 0 TO 9 DO END_FOR; a[i] := 1;", Some(10)),
        ("n := 12; FOR i := 0 TO n DO a[i] := 1; END_FOR;", Some(10)),
    ] {
        let text = format!(
            "FUNCTION Set VAR_IN_OUT x : INT; END_VAR x := 40; END_FUNCTION
FUNCTION_BLOCK B VAR_IN_OUT x : INT; END_VAR IF x = 3 THEN x := 40; END_IF; END_FUNCTION_BLOCK
PROGRAM P VAR a : ARRAY[0..9] OF INT; i, n : INT; b : B; END_VAR {body} END_PROGRAM"
        );
        match (Machine::new(&text).try_scan(), index) {
            (Ok(()), None) => {}
            (Err(trap), Some(index)) => {
                assert_eq!(trap.kind, TrapKind::Index, "{body}");
                assert_eq!(
                    trap.message,
                    format!("the index {index} is outside 0..9"),
                    "{body}"
                );
            }
            (result, _) => panic!("{body}: {result:?}"),
        }
    }
}

#[test]
fn an_index_known_to_fit_is_not_checked() {
    let sites = |body: &str| {
        let text =
            format!("PROGRAM P VAR a : ARRAY[0..9] OF INT; i, k : INT; END_VAR {body} END_PROGRAM");
        compiled(&text, &spec("P")).sites.len()
    };
    assert_eq!(sites("FOR i := 0 TO 9 DO a[i] := a[9 - i]; END_FOR;"), 0);
    assert_eq!(sites("FOR i := 0 TO 9 DO a[k] := 1; END_FOR;"), 1);
}

#[test]
fn a_value_of_the_last_scan_goes_on_in_the_next() {
    let text = "PROGRAM P VAR x : REAL := 1.0; i : INT; END_VAR FOR i := 1 TO 3 DO x := x * 2.0; END_FOR; END_PROGRAM";
    let mut m = Machine::new(text);
    m.scan();
    m.scan();
    assert_eq!(m.text("x"), "64.0");
    m.set("x", Value::Real(1.0));
    m.scan();
    assert_eq!(m.text("x"), "8.0");
}
