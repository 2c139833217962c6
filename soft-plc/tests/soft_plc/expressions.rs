//! Conditions that stand outside of any POU, as engineering uses them.

use fam_soft_plc::check::tree::{ExprKind, visit_expr};
use fam_soft_plc::{Value, check_expression, evaluate};

use crate::common::{show, typed};

const TEXT: &str = "
TYPE Phase : (Idle, Gripping, Placing); END_TYPE
VAR_GLOBAL speed : REAL; END_VAR
PROGRAM S3
VAR phase : Phase; n : INT; pos : ARRAY[1..4] OF LREAL; t : TON; END_VAR
n := n + 1;
END_PROGRAM";

#[test]
fn a_condition_gives_paths_constants_and_its_value() {
    let project = typed(TEXT);
    let text = "phase = Gripping AND (n > 3 OR NOT t.Q) AND pos[2] >= 1.5";
    let expr = check_expression(&project, Some("S3"), "cell.toml", text)
        .unwrap_or_else(|d| panic!("{}", show(&d)));
    let mut paths = Vec::new();
    visit_expr(&expr, &mut |place| paths.extend(project.path_of(place)));
    assert_eq!(paths, ["S3.phase", "S3.n", "S3.t.Q", "S3.pos[2]"]);
    let value = |n: i64| {
        evaluate(&project, &expr, &|place| {
            Some(match project.path_of(place)?.as_str() {
                "S3.phase" => Value::Int(1),
                "S3.n" => Value::Int(n),
                "S3.t.Q" => Value::Bool(true),
                _ => Value::Lreal(2.0),
            })
        })
    };
    assert_eq!(value(4), Ok(Value::Bool(true)));
    assert_eq!(value(3), Ok(Value::Bool(false)));
}

#[test]
fn programs_and_globals_are_seen_from_outside() {
    let project = typed(TEXT);
    let expr = check_expression(&project, None, "x", "speed * 2.0").expect("globals");
    assert!(matches!(expr.kind, ExprKind::Binary(..)));
    let failed = check_expression(&project, None, "x", "S3.n > 1").expect_err("internal");
    assert!(
        show(&failed).contains("`n` is internal to S3 (VAR)"),
        "{}",
        show(&failed)
    );
}

#[test]
fn a_wrong_condition_is_shown_in_its_own_text() {
    let project = typed(TEXT);
    let failed = check_expression(
        &project,
        Some("S3"),
        "cell.toml: S3.gripping",
        "phase = Griping",
    )
    .expect_err("typo");
    assert_eq!(
        show(&failed),
        "error[E301]: `Griping` is not declared
  --> cell.toml: S3.gripping:1:9 (in S3)
  |
1 | phase = Griping
  |         ^^^^^^^
  = hint: did you mean `GRIPPING`?
"
    );
}
