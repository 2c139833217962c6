//! Namespaces: each has names of its own; paths, USING, nested ones, INTERNAL.

use fam_soft_plc::syntax::print::Words;
use fam_soft_plc::{CheckOptions, SourceFile, check, parse_project};

use crate::common::Machine;

const SPACES: &str = "
NAMESPACE Left
TYPE Color : (Red, Green, Blue) := Green; Pair : STRUCT a : INT := 1; END_STRUCT; END_TYPE
FUNCTION Value : INT Value := 1; END_FUNCTION
FUNCTION Twice : INT Twice := 2 * Value(); END_FUNCTION
FUNCTION_BLOCK Counter VAR_OUTPUT n : INT; END_VAR n := n + Value(); END_FUNCTION_BLOCK
NAMESPACE Inner
FUNCTION Value : INT Value := 10 + Left.Value(); END_FUNCTION
FUNCTION Both : INT Both := Value() + Twice(); END_FUNCTION
FUNCTION_BLOCK Counter EXTENDS Left.Counter
METHOD PUBLIC Plus : INT VAR_INPUT x : INT; END_VAR Plus := n + x + Value(); END_METHOD
END_FUNCTION_BLOCK
END_NAMESPACE
END_NAMESPACE
NAMESPACE Right
TYPE Color : (Blue, Black); Pair : STRUCT a : LREAL := 0.5; END_STRUCT; END_TYPE
FUNCTION Value : INT Value := 2; END_FUNCTION
FUNCTION Own : INT VAR c : Color; END_VAR c := Black; Own := Color_TO_INT(c) + Color_TO_INT(Blue); END_FUNCTION
END_NAMESPACE
NAMESPACE Left.Far
FUNCTION Value : INT Value := 100; END_FUNCTION
FUNCTION Near : INT Near := Value() + Inner.Value() + Right.Value(); END_FUNCTION
END_NAMESPACE
FUNCTION Value : INT Value := 1000; END_FUNCTION
";

fn value(usings: &str, vars: &str, body: &str) -> String {
    let text = format!("{SPACES}PROGRAM P\n{usings}\nVAR {vars} END_VAR\n{body}\nEND_PROGRAM\n");
    let mut m = Machine::new(&text);
    m.scan();
    m.text("r")
}

#[test]
fn names_mean_what_stands_nearest() {
    for (usings, vars, body, expected) in [
        ("", "r : INT;", "r := Value();", "1000"),
        ("", "r : INT;", "r := Left.Value();", "1"),
        ("", "r : INT;", "r := left.INNER.value();", "11"),
        ("", "r : INT;", "r := Right.Value();", "2"),
        ("", "r : INT;", "r := Left.Twice();", "2"),
        ("", "r : INT;", "r := Left.Inner.Both();", "13"),
        ("", "r : INT;", "r := Left.Far.Near();", "113"),
        ("", "r : INT;", "r := Right.Own();", "1"),
        // What stands outside of all namespaces is further away than what USING in the POU names.
        ("USING Right;", "r : INT;", "r := Value();", "2"),
        ("USING Left;", "r : INT;", "r := Twice();", "2"),
        ("USING Left.Inner;", "r : INT;", "r := Both();", "13"),
        (
            "USING Left, Left.Far;",
            "r : INT;",
            "r := Near() + Twice();",
            "115",
        ),
        ("", "r : Left.Color;", ";", "1"),
        ("", "r : Right.Color;", ";", "0"),
        (
            "",
            "c : Right.Color; r : INT;",
            "c := Right.Color#Black; r := Right.Color_TO_INT(c);",
            "1",
        ),
        (
            "",
            "c : Left.Color; r : INT;",
            "c := Left.Color.Blue; IF c = Left.Color#Blue THEN r := 5; END_IF;",
            "5",
        ),
        (
            "",
            "c : Left.Color := Left.Color#Blue; r : INT;",
            "CASE c OF Left.Color#Red: r := 1; Left.Color#Blue: r := 3; END_CASE;",
            "3",
        ),
        (
            "USING Left;",
            "c : Color; r : INT;",
            "c := Blue; r := Color_TO_INT(c);",
            "2",
        ),
        (
            "USING Right;",
            "c : Color := Black; r : INT;",
            "r := Color_TO_INT(c) * 10 + Color_TO_INT(Blue);",
            "10",
        ),
        (
            "",
            "a : Left.Pair; b : Right.Pair; r : LREAL;",
            "r := INT_TO_LREAL(a.a) + b.a;",
            "1.5",
        ),
        ("", "c : Left.Counter; r : INT;", "c(); c(); r := c.n;", "2"),
        (
            "",
            "c : Left.Inner.Counter; r : INT;",
            "c(); r := c.Plus(100);",
            "112",
        ),
        // A variable hides a namespace.
        ("", "Left : Right.Pair; r : LREAL;", "r := Left.a;", "0.5"),
    ] {
        assert_eq!(
            value(usings, vars, body),
            expected,
            "{usings} {vars} {body}"
        );
    }
}

fn problems(text: &str) -> String {
    let text = format!("{SPACES}{text}");
    let (project, diagnostics) = parse_project(&[SourceFile::new("test.st", text)]);
    let of_text: String = diagnostics.iter().map(ToString::to_string).collect();
    match check(&project, CheckOptions::default()) {
        Ok(_) => of_text,
        Err(all) => of_text + &all.iter().map(ToString::to_string).collect::<String>(),
    }
}

#[test]
fn what_a_name_does_not_mean_is_said_with_what_to_write() {
    let hidden = "NAMESPACE Work
NAMESPACE INTERNAL Deep FUNCTION Secret : INT Secret := 1; END_FUNCTION END_NAMESPACE
FUNCTION_BLOCK INTERNAL Tool VAR_OUTPUT q : INT; END_VAR q := Deep.Secret(); END_FUNCTION_BLOCK
FUNCTION_BLOCK Machine VAR t : Tool; END_VAR
METHOD INTERNAL Own : INT Own := t.q; END_METHOD
END_FUNCTION_BLOCK
FUNCTION_BLOCK User VAR m : Machine; r : INT; END_VAR r := m.Own(); END_FUNCTION_BLOCK
END_NAMESPACE
";
    let program = |usings: &str, vars: &str, body: &str| {
        problems(&format!(
            "{hidden}PROGRAM P {usings} VAR {vars} r : INT; END_VAR {body} END_PROGRAM"
        ))
    };
    for (usings, vars, body, expected) in [
        ("", "", "r := 1;", &[][..]),
        ("", "u : Work.User;", "u();", &[]),
        ("", "", "r := Twice();", &["E402", "LEFT.TWICE"]),
        ("", "", "r := Left.Nothing();", &["E402", "Left.Nothing"]),
        (
            "",
            "c : Color;",
            "r := 1;",
            &["E202", "LEFT.COLOR or RIGHT.COLOR"],
        ),
        (
            "USING Left; USING Right;",
            "c : Color;",
            "r := 1;",
            &["E202", "LEFT.COLOR or RIGHT.COLOR"],
        ),
        ("USING Nowhere;", "", "r := 1;", &["E235", "Nowhere"]),
        ("", "", "r := Work.Deep.Secret();", &["E402", "INTERNAL"]),
        ("", "t : Work.Tool;", "r := 1;", &["E202", "INTERNAL"]),
        ("USING Work;", "t : Tool;", "r := 1;", &["E202", "INTERNAL"]),
        (
            "",
            "m : Work.Machine;",
            "r := m.Own();",
            &["E416", "INTERNAL"],
        ),
    ] {
        let found = program(usings, vars, body);
        let errors = found.matches("error[").count();
        assert_eq!(
            errors,
            usize::from(!expected.is_empty()),
            "{body} {vars}: {found}"
        );
        for part in expected {
            assert!(found.contains(part), "{part}: {found}");
        }
    }
    for (text, code) in [
        ("NAMESPACE A FUNCTION f : INT f := 1; END_FUNCTION", "E118"),
        ("END_NAMESPACE", "E119"),
        (
            "NAMESPACE Left FUNCTION Value : INT Value := 1; END_FUNCTION END_NAMESPACE",
            "E201",
        ),
        (
            "NAMESPACE A FUNCTION f : INT f := ; END_FUNCTION END_NAMESPACE FUNCTION g : INT g := 1; END_FUNCTION",
            "E110",
        ),
    ] {
        let found = problems(&format!("{text} PROGRAM P ; END_PROGRAM"));
        assert_eq!(found.matches("error[").count(), 1, "{found}");
        assert!(found.contains(code), "{found}");
    }
}

#[test]
fn a_pou_written_out_on_its_own_means_the_same() {
    let text = format!(
        "{SPACES}NAMESPACE Left
USING Right;
FUNCTION Sum : INT VAR c : Color; END_VAR Sum := Color_TO_INT(c) + Own() + Inner.Value() + Value(); END_FUNCTION
END_NAMESPACE
PROGRAM P VAR r : INT; END_VAR r := Left.Sum(); END_PROGRAM"
    );
    let (project, _) = parse_project(&[SourceFile::new("test.st", text)]);
    let words = Words {
        name: &|name| name.to_owned(),
        variable: &|_| None,
        wire: &|_| None,
    };
    let written = |pou| fam_soft_plc::syntax::print::pou(pou, &words);
    let written: String = project.pous.iter().map(written).collect();
    let types = "NAMESPACE Left TYPE Color : (Red, Green, Blue) := Green; END_TYPE END_NAMESPACE
NAMESPACE Right TYPE Color : (Blue, Black); END_TYPE END_NAMESPACE\n";
    let mut m = Machine::new(&format!("{types}{written}"));
    m.scan();
    // Green, Black, 11, 1
    assert_eq!(m.text("r"), "14");
}

#[test]
fn paths_have_an_end() {
    let long = vec!["a"; 20_000].join(".");
    let deep = "NAMESPACE a ".repeat(20_000);
    for text in [
        format!("NAMESPACE {long} END_NAMESPACE"),
        format!("FUNCTION {long} : INT END_FUNCTION"),
        format!("PROGRAM P USING {long}; END_PROGRAM"),
        deep,
    ] {
        assert!(problems(&text).contains("E113"), "{}", &text[..40]);
    }
}
