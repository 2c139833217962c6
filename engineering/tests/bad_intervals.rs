//! Critical intervals, their actions and checkpoint states: what is wrong with them, and what is worth a look.

mod common;

use common::{Case, changed, hold};

const CELL: &str = "cell.toml";
const FEEDER: &str = "feeder.st";
const PRESS: &str = "press.st";

const CASES: &[Case] = &[
    Case {
        name: "recovery POU missing",
        changes: &[(
            CELL,
            "recovery = \"Feeder_Retract\"",
            "recovery = \"Feeder_Retrakt\"",
        )],
        message: &[
            "error[M504]: critical interval Pushing of MC Feeder: the logic has no recovery action `Feeder_Retrakt`",
            "did you mean `Feeder_Retract`?",
        ],
    },
    Case {
        name: "stop POU missing",
        changes: &[(CELL, "stop = \"Feeder_Stop\"", "stop = \"Halt\"")],
        message: &[
            "MC Feeder: the logic has no stop POU `Halt`",
            "there are: Feeder_Retract, Feeder_Stop",
        ],
    },
    Case {
        name: "recovery POU without end",
        changes: &[
            (PRESS, "    end : BOOL;", "    ended : BOOL;"),
            (PRESS, "end := RamUp", "ended := RamUp"),
        ],
        message: &[
            "error[M506]: critical interval Pressing of MC Press: the recovery action `Press_RamUp` has no output `end`",
            "VAR_OUTPUT end : BOOL",
        ],
    },
    Case {
        name: "recovery POU whose end is a number",
        changes: &[
            (PRESS, "    end : BOOL;", "    end : INT;"),
            (PRESS, "end := RamUp", "end := 1"),
        ],
        message: &[
            "the output `end` of the recovery action `Press_RamUp` is INT",
            "make it BOOL",
        ],
    },
    Case {
        name: "recovery POU with an input",
        changes: &[(
            PRESS,
            "VAR_OUTPUT\n    end",
            "VAR_INPUT\n    slow : BOOL;\nEND_VAR\nVAR_OUTPUT\n    end",
        )],
        message: &["has the input `slow`, but nothing gives it a value"],
    },
    Case {
        name: "recovery action over state",
        changes: &[
            (
                FEEDER,
                "    PusherHome, PusherExtend : BOOL;\n",
                "    PusherHome, PusherExtend : BOOL;\n    fed : UINT;\n",
            ),
            (
                FEEDER,
                "    end := dwell.Q;",
                "    IF fed > 3 THEN end := dwell.Q; END_IF;",
            ),
        ],
        message: &[
            "error[M512]: critical interval Pushing of MC Feeder: the recovery action `Feeder_Retract` uses the global variable `fed`, which is state",
        ],
    },
    Case {
        name: "recovery action that is a program",
        changes: &[(CELL, "recovery = \"Press_RamUp\"", "recovery = \"Press\"")],
        message: &["the recovery action `Press` is a PROGRAM", "FUNCTION_BLOCK"],
    },
    Case {
        name: "checkpoint interval without recovery",
        changes: &[(CELL, "recovery = \"Feeder_Retract\"\n", "")],
        message: &["error[M502]: critical interval Pushing of MC Feeder has no recovery action"],
    },
    Case {
        name: "unrecoverable interval without a way to stop",
        changes: &[(CELL, "recovery = \"Press_RamUp\"\n", "")],
        message: &[
            "critical interval Pressing of MC Press has no way to stop safely",
            "or the MC a `stop` POU",
        ],
    },
    Case {
        name: "unknown kind",
        changes: &[(CELL, "kind = \"checkpoint\"", "kind = \"recoverable\"")],
        message: &["`recoverable` is no kind", "checkpoint or unrecoverable"],
    },
    Case {
        name: "checkpoint state of an unrecoverable interval",
        changes: &[(
            CELL,
            "recovery = \"Press_RamUp\"",
            "recovery = \"Press_RamUp\"\n[mc.critical_interval.checkpoint_state]\nstep = 0",
        )],
        message: &["error[M503]", "there is no checkpoint state to go back to"],
    },
    Case {
        name: "condition over an input",
        changes: &[(
            CELL,
            "condition = \"step = 10\"",
            "condition = \"step = 10 AND RamUp\"",
        )],
        message: &[
            "error[M507]: critical interval Pressing of MC Press: `RamUp` is not part of the state",
            "cell.toml:85:28",
            "process image",
        ],
    },
    Case {
        name: "condition over something unknown",
        changes: &[(
            CELL,
            "condition = \"step = 10\"",
            "condition = \"stop = 10\"",
        )],
        message: &[
            "error[M507]: critical interval Pressing of MC Press: ",
            "stop",
            "cell.toml:85:14",
        ],
    },
    Case {
        name: "condition that is no BOOL",
        changes: &[(CELL, "condition = \"step = 10\"", "condition = \"step\"")],
        message: &[
            "error[M507]: critical interval Pressing of MC Press",
            "TRUE or FALSE",
        ],
    },
    Case {
        name: "condition that masks cannot say",
        changes: &[(
            CELL,
            "condition = \"step = 10\"",
            "condition = \"step + 1 = 10\"",
        )],
        message: &[
            "masks cannot say this",
            "let the program compute it into a variable",
        ],
    },
    Case {
        name: "condition with a variable index",
        changes: &[(CELL, "AND NOT (arrived OR alarm)", "AND weights[next] > 0")],
        message: &["the index is not constant"],
    },
    Case {
        name: "condition that never holds",
        changes: &[(
            CELL,
            "condition = \"step = 10\"",
            "condition = \"step = 10 AND step > 10\"",
        )],
        message: &[
            "error[M508]: critical interval Pressing of MC Press: the condition can never hold",
        ],
    },
    Case {
        name: "condition that is no expression",
        changes: &[(CELL, "condition = \"step = 10\"", "condition = \"step = \"")],
        message: &["error[M507]: critical interval Pressing of MC Press"],
    },
    Case {
        name: "overlapping intervals",
        changes: &[(
            CELL,
            "[[mc]]\nname = \"Press\"",
            "[[mc.critical_interval]]\nname = \"Alarmed\"\ncondition = \"alarm\"\nkind = \"unrecoverable\"\n[[mc.critical_interval]]\nname = \"Fed\"\ncondition = \"step = Feeding\"\nkind = \"unrecoverable\"\n[[mc]]\nname = \"Press\"",
        )],
        message: &[
            "error[M510]: MC Feeder: the critical intervals Pushing and Fed overlap, and their recoveries differ",
        ],
    },
    Case {
        name: "two intervals of one name",
        changes: &[(
            CELL,
            "[[mc]]\nname = \"Press\"",
            "[[mc.critical_interval]]\nname = \"Pushing\"\ncondition = \"alarm\"\nkind = \"unrecoverable\"\n[[mc]]\nname = \"Press\"",
        )],
        message: &["there are two critical intervals of MC Feeder named `Pushing`"],
    },
    Case {
        name: "checkpoint state of an unknown variable",
        changes: &[(CELL, "step = \"Waiting\"", "stop = \"Waiting\"")],
        message: &["error[M509]: critical interval Pushing of MC Feeder: checkpoint state: "],
    },
    Case {
        name: "checkpoint state of an output",
        changes: &[(CELL, "step = \"Waiting\"", "PusherExtend = false")],
        message: &["checkpoint state: `PusherExtend` is not part of the state"],
    },
    Case {
        name: "checkpoint state of another type",
        changes: &[(CELL, "step = \"Waiting\"", "step = \"Pushing\"")],
        message: &[
            "checkpoint state of `step`: \"Pushing\" is no FeederStep",
            "one of \"Waiting\", \"Feeding\"",
        ],
    },
];

#[test]
fn problems_say_what_is_wrong_and_where() {
    hold(CASES);
}

#[test]
fn what_is_worth_a_look_is_a_warning() {
    let interval = |condition: &str| {
        format!(
            "[[mc.critical_interval]]\nname = \"Other\"\ncondition = \"{condition}\"\nkind = \"unrecoverable\"\n[[mc]]\nname = \"Press\""
        )
    };
    for (changes, message) in [
        (
            vec![(
                CELL,
                "[[mc]]\nname = \"Press\"",
                interval("sum > next AND step = Feeding"),
            )],
            "warning[W805]: MC Feeder: it cannot be decided whether the critical intervals Pushing and Other overlap",
        ),
        (
            vec![(CELL, "[[mc]]\nname = \"Press\"", interval("step = Waiting"))],
            "warning[W804]: critical interval Other of MC Feeder: the initial state is critical",
        ),
        (
            vec![(
                CELL,
                "condition = \"step = 10\"",
                "condition = \"step = 10 OR step <> 10\"".to_owned(),
            )],
            "warning[W803]: critical interval Pressing of MC Press: the condition always holds",
        ),
        (
            vec![(
                CELL,
                "condition = \"step = 10\"",
                "condition = \"TRUE\"".to_owned(),
            )],
            "warning[W803]: critical interval Pressing of MC Press: the condition always holds",
        ),
        (
            vec![(
                CELL,
                "description = \"second of two equal controllers\"",
                "limit_percent = 0.5".to_owned(),
            )],
            "warning[W801]: MC Feeder alone is above the limit of controller controller2",
        ),
        (
            vec![(
                PRESS,
                "PROGRAM Press",
                "PROGRAM Idle\nVAR x : INT; END_VAR\n x := 1;\nEND_PROGRAM\nPROGRAM Press"
                    .to_owned(),
            )],
            "warning[W802]: MC Press: the PROGRAM `Idle` is not run: `Press` does not call it",
        ),
    ] {
        let changes: Vec<(&str, &str, &str)> = changes
            .iter()
            .map(|(f, o, n)| (*f, *o, n.as_str()))
            .collect();
        let (_dir, built) = changed(&changes);
        let built = built.unwrap_or_else(|p| panic!("{changes:?}: {p}"));
        let texts: Vec<String> = built.warnings.iter().map(ToString::to_string).collect();
        assert!(
            texts.iter().any(|t| t.contains(message)),
            "expected `{message}` in:\n{}",
            texts.join("\n")
        );
    }
}
