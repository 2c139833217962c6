//! What of a PLC project goes to which proposed MC, and what the engineer is told to decide.

use fam_engineering::import::{Proposal, propose};
use fam_soft_plc::source::SourceFile;

fn of(text: &str) -> Proposal {
    propose(&[SourceFile::new("a.st", text)]).unwrap_or_else(|p| panic!("{p:?}"))
}

fn names(proposal: &Proposal) -> Vec<&str> {
    proposal.mcs.iter().map(|m| m.name.as_str()).collect()
}

const PROGRAMS: &str = "PROGRAM P\nVAR n : INT; END_VAR\n n := n + 1;\nEND_PROGRAM\nPROGRAM Q\nVAR n : INT; END_VAR\n n := n + 2;\nEND_PROGRAM\n";

#[test]
fn instances_of_one_name_are_kept_apart() {
    let one = |r: &str, p: &str| {
        format!(
            "RESOURCE {r} ON PLC\nTASK t(INTERVAL := T#20ms, PRIORITY := 1);\nPROGRAM main WITH t : {p};\nEND_RESOURCE\n"
        )
    };
    let proposal = of(&format!(
        "{PROGRAMS}CONFIGURATION c\n{}{}END_CONFIGURATION\n",
        one("r1", "P"),
        one("r2", "Q")
    ));
    assert_eq!(names(&proposal), ["main", "main_2"]);
    assert_eq!(proposal.mcs[1].program, "Q");
    assert_eq!(proposal.mcs[0].cycle_ms, Some(20.0));
    assert!(
        !proposal
            .to_do
            .iter()
            .any(|t| t.contains("gives it no cycle"))
    );
}

#[test]
fn without_a_configuration_what_no_other_calls_is_run() {
    let proposal = of(&format!(
        "{PROGRAMS}PROGRAM Main\nVAR n : INT; END_VAR\n n := 1; P();\nEND_PROGRAM\n"
    ));
    assert_eq!(names(&proposal), ["Q", "Main"]);
    let logic = &proposal.mcs[1].logic;
    assert!(
        logic.contains("name=\"P\"") && !logic.contains("name=\"Q\""),
        "{logic}"
    );
    for name in ["Q", "Main"] {
        let sentence = format!("{name}: the project gives it no cycle; it has the tick's now");
        assert!(proposal.to_do.contains(&sentence), "{:?}", proposal.to_do);
    }
}

#[test]
fn what_is_declared_and_never_used_goes_along() {
    let proposal = of(
        "VAR_GLOBAL CONSTANT Size : INT := 3; END_VAR\nVAR_GLOBAL Seen : BOOL; Other : BOOL; END_VAR\n\
         FUNCTION_BLOCK F\nVAR n : INT; END_VAR\n n := n + 1;\nEND_FUNCTION_BLOCK\n\
         PROGRAM P\nVAR_EXTERNAL Seen : BOOL; END_VAR\nVAR idle : ARRAY[1..Size] OF F; n : INT; END_VAR\n n := n + 1;\nEND_PROGRAM\n",
    );
    let logic = &proposal.mcs[0].logic;
    for name in ["F", "Seen", "Size"] {
        assert!(
            logic.contains(&format!("name=\"{name}\"")),
            "{name} in {logic}"
        );
    }
    assert!(!logic.contains("\"Other\""), "{logic}");
}

#[test]
fn shared_variables_are_to_be_decided_and_shared_constants_are_not() {
    let program = |name: &str| {
        format!(
            "PROGRAM {name}\nVAR_EXTERNAL CONSTANT Limit : INT; END_VAR\nVAR_EXTERNAL Count : INT; END_VAR\n Count := Count + Limit;\nEND_PROGRAM\n"
        )
    };
    let proposal = of(&format!(
        "VAR_GLOBAL CONSTANT Limit : INT := 3; END_VAR\nVAR_GLOBAL Count : INT; END_VAR\n{}{}",
        program("P"),
        program("Q")
    ));
    let shared: Vec<&String> = proposal
        .to_do
        .iter()
        .filter(|t| t.starts_with("the global"))
        .collect();
    assert_eq!(shared.len(), 1, "{shared:?}");
    assert!(shared[0].contains("Count is used by P, Q"), "{shared:?}");
}

#[test]
fn a_task_without_an_interval_gives_no_cycle() {
    let proposal = of(&format!(
        "{PROGRAMS}CONFIGURATION c\nRESOURCE r ON PLC\nTASK t(INTERVAL := T#0s, PRIORITY := 1);\nPROGRAM main WITH t : P;\nEND_RESOURCE\nEND_CONFIGURATION\n"
    ));
    assert_eq!(proposal.mcs[0].cycle_ms, None);
    assert!(
        proposal
            .to_do
            .iter()
            .any(|t| t.contains("gives it no cycle"))
    );
}
