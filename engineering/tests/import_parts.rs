//! What of a PLC project goes to which proposed MC, and what the engineer is told to decide.

use fam_engineering::import::{Proposal, ProposedInput, ProposedMc, propose};
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

/// Three programs: `Feed` writes, `Press` reads and writes back, `Lamp` reads.
const EXCHANGE: &str = "
VAR_GLOBAL
    Unseen AT %IX0.3 : BOOL;
    Level AT %IW1 : INT;
    Ready AT %QX0.0 : BOOL;
    Lit AT %QX0.1 : BOOL;
    Request : BOOL := TRUE;
    Count : LREAL := 2.5;
    Both : INT;
    Table : ARRAY[0..3] OF INT;
    Note : STRING[8];
END_VAR
PROGRAM Feed
VAR_EXTERNAL Unseen, Ready, Request : BOOL; Level : INT; Count : LREAL; Both : INT; Table : ARRAY[0..3] OF INT; Note : STRING[8]; END_VAR
    IF Request THEN Count := Count + 1.0; END_IF;
    Ready := Level > 3; Both := Both + 1; Table[1] := 4; Note := 'x';
END_PROGRAM
PROGRAM Press
VAR_EXTERNAL Ready, Request : BOOL; Count : LREAL; Both : INT; Table : ARRAY[0..3] OF INT; Note : STRING[8]; Level : INT; END_VAR
    Request := NOT Ready AND Count < 9.0 AND Level > Table[1]; Both := 0;
    IF Note = 'x' OR %QX9.0 THEN Request := FALSE; END_IF;
END_PROGRAM
PROGRAM Lamp
VAR_EXTERNAL Ready, Lit : BOOL; END_VAR
    Lit := Ready;
END_PROGRAM
";

#[test]
fn what_one_program_writes_is_exported_to_those_that_read_it() {
    let proposal = of(EXCHANGE);
    let [feed, press, lamp] = proposal.mcs.as_slice() else {
        panic!("{:?}", names(&proposal));
    };
    let inputs = |mc: &ProposedMc| -> Vec<(String, String)> {
        let from = |i: &ProposedInput| i.from.clone().map_or(String::new(), |f| f.0 + "." + &f.1);
        mc.inputs
            .iter()
            .map(|i| (i.name.clone(), from(i)))
            .collect()
    };
    let outputs = |mc: &ProposedMc| -> Vec<(String, bool, bool)> {
        let outputs = mc.outputs.iter();
        outputs
            .map(|o| (o.name.clone(), o.field, o.export))
            .collect()
    };
    let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
    let output = |name: &str, field, export| (name.to_owned(), field, export);
    assert_eq!(
        inputs(feed),
        [
            pair("Unseen", ""),
            pair("Level", ""),
            pair("Request", "Press.Request")
        ]
    );
    assert_eq!(
        outputs(feed),
        [output("Ready", true, true), output("Count", false, true)]
    );
    assert_eq!(
        inputs(press),
        [
            pair("Level", ""),
            pair("Ready", "Feed.Ready"),
            pair("Count", "Feed.Count")
        ]
    );
    assert_eq!(outputs(press), [output("Request", false, true)]);
    assert_eq!(inputs(lamp), [pair("Ready", "Feed.Ready")]);
    assert_eq!(outputs(lamp), [output("Lit", true, false)]);
    // Behind what lies in the images already, also what bodies name directly.
    for (mc, places) in [
        (
            feed,
            [
                ("Request", "%IX4.0"),
                ("Count", "%QL1"),
                ("Ready", "%QX0.0"),
            ],
        ),
        (
            press,
            [
                ("Ready", "%IX4.0"),
                ("Count", "%IL1"),
                ("Request", "%QX17.0"),
            ],
        ),
    ] {
        for (name, at) in places {
            let said = format!("<variable name=\"{name}\" address=\"{at}\">");
            assert!(mc.logic.contains(&said), "{said} in {}", mc.logic);
        }
    }
    let said: Vec<&String> = proposal
        .to_do
        .iter()
        .filter(|t| !t.contains(": "))
        .collect();
    assert!(said.is_empty(), "{said:?}");
    for sentence in [
        "Feed exports Ready to Press, Lamp: what it writes is seen there a cycle later",
        "Feed exports Count to Press: what it writes is seen there a cycle later",
        "Press exports Request to Feed: what it writes is seen there a cycle later",
        "the global variable Both is used by Feed, Press: MCs share no memory",
        "the global variable Table is used by Feed, Press: MCs share no memory",
        "the global variable Note is used by Feed, Press: MCs share no memory",
    ] {
        let is_there = |t: &&String| t.starts_with(sentence);
        assert_eq!(
            proposal.to_do.iter().filter(is_there).count(),
            1,
            "{sentence}: {:?}",
            proposal.to_do
        );
    }
}

#[test]
fn two_writers_of_an_output_are_to_be_decided() {
    let program = |name: &str, body: &str| {
        format!("PROGRAM {name}\nVAR_EXTERNAL Out : BOOL; END_VAR\n {body}\nEND_PROGRAM\n")
    };
    let proposal = of(&format!(
        "VAR_GLOBAL Out AT %QX0.0 : BOOL; END_VAR\nVAR_GLOBAL n : INT; END_VAR\n{}{}{}",
        program("P", "Out := TRUE;"),
        program("Q", "Out := FALSE;"),
        program("R", "IF Out THEN n := 1; END_IF;")
    ));
    let sentence = "the output Out is used by P, Q, R and written by P, Q: let one of them drive it, and export to it what the others want";
    assert!(
        proposal.to_do.iter().any(|t| t == sentence),
        "{:?}",
        proposal.to_do
    );
}
