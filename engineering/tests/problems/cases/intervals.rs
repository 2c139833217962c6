//! Critical intervals, recoveries and state (M5xx), and what is only worth a look (W8xx).

use super::{CELL, Case};

pub const CASES: &[Case] = &[
    (
        "no kind",
        &[(CELL, "kind = \"checkpoint\"", "kind = \"critical\"")],
    ),
    ("no recovery", &[(CELL, "recovery = \"Off\"\n", "")]),
    (
        "no stop",
        &[(
            CELL,
            "kind = \"checkpoint\"\nrecovery = \"Off\"\n[mc.critical_interval.checkpoint_state]\nstep = 0",
            "kind = \"unrecoverable\"",
        )],
    ),
    (
        "unrecoverable with a checkpoint",
        &[(CELL, "kind = \"checkpoint\"", "kind = \"unrecoverable\"")],
    ),
    (
        "no such action",
        &[(CELL, "recovery = \"Off\"", "recovery = \"Of\"")],
    ),
    (
        "action of another kind",
        &[(CELL, "recovery = \"Off\"", "recovery = \"A\"")],
    ),
    (
        "action with an input",
        &[(
            "a.st",
            "VAR_OUTPUT end",
            "VAR_INPUT how : INT; END_VAR\nVAR_OUTPUT end",
        )],
    ),
    (
        "action without end",
        &[
            ("a.st", "end : BOOL", "done : BOOL"),
            ("a.st", "end := TRUE", "done := TRUE"),
        ],
    ),
    (
        "end of another type",
        &[
            ("a.st", "end : BOOL", "end : INT"),
            ("a.st", "end := TRUE", "end := 1"),
        ],
    ),
    (
        "action over the state",
        &[
            (
                "a.st",
                "END_VAR\nPROGRAM",
                "    parts : INT;\nEND_VAR\nPROGRAM",
            ),
            (
                "a.st",
                "Lamp : BOOL; END_VAR\nVAR_OUTPUT",
                "Lamp : BOOL; parts : INT; END_VAR\nVAR_OUTPUT",
            ),
            ("a.st", "Lamp := FALSE;", "Lamp := parts > 0;"),
        ],
    ),
    (
        "action that never ends",
        &[("a.st", "    end := TRUE;\n", "")],
    ),
    (
        "always true of its type",
        &[(
            CELL,
            "condition = \"step = 5\"",
            "condition = \"step <= 32767\"",
        )],
    ),
    (
        "checkpoint state in the interval",
        &[(CELL, "step = 0", "step = 5")],
    ),
    (
        "checkpoint state in a wider interval",
        &[
            (
                CELL,
                "condition = \"step = 5\"",
                "condition = \"step > 3 AND step < 9 OR step = 12\"",
            ),
            (CELL, "step = 0", "step = 8"),
        ],
    ),
    (
        "program of an action",
        &[
            (
                "a.st",
                "    Lamp := FALSE;\n    end",
                "    Lamp := FALSE;\n    Helper();\n    end",
            ),
            (
                "a.st",
                "FUNCTION_BLOCK Off",
                "PROGRAM Helper\nVAR x : INT; END_VAR\n    x := x + 1;\nEND_PROGRAM\nFUNCTION_BLOCK Off",
            ),
        ],
    ),
    (
        "condition that is no expression",
        &[(CELL, "\"step = 5\"", "\"step = \"")],
    ),
    (
        "condition over no variable",
        &[(CELL, "\"step = 5\"", "\"stop = 5\"")],
    ),
    (
        "condition over an input",
        &[(CELL, "\"step = 5\"", "\"Go\"")],
    ),
    (
        "condition that never holds",
        &[(CELL, "\"step = 5\"", "\"step = 5 AND step = 6\"")],
    ),
    (
        "condition that always holds",
        &[(CELL, "\"step = 5\"", "\"step = 5 OR TRUE\"")],
    ),
    (
        "initial state is critical",
        &[(CELL, "\"step = 5\"", "\"step = 0\"")],
    ),
    (
        "checkpoint state of no variable",
        &[(CELL, "\nstep = 0", "\nstop = 0")],
    ),
    (
        "checkpoint state of another type",
        &[(CELL, "\nstep = 0", "\nstep = \"zero\"")],
    ),
    (
        "checkpoint state over an output",
        &[(CELL, "\nstep = 0", "\nLamp = false")],
    ),
    (
        "overlapping intervals",
        &[(
            CELL,
            "[[mc]]\nname = \"B\"",
            "[[mc.critical_interval]]\nname = \"High\"\ncondition = \"step > 3\"\nkind = \"unrecoverable\"\nrecovery = \"Off\"\n[[mc]]\nname = \"B\"",
        )],
    ),
    (
        "intervals that nobody can decide",
        &[
            (
                "a.st",
                "VAR step : INT;",
                "VAR step : INT; x1, x2, x3 : REAL;",
            ),
            (CELL, "\"step = 5\"", "\"x1 < x2 AND x2 < x3\""),
            (
                CELL,
                "[[mc]]\nname = \"B\"",
                "[[mc.critical_interval]]\nname = \"High\"\ncondition = \"x3 < x1\"\nkind = \"unrecoverable\"\nrecovery = \"Off\"\n[[mc]]\nname = \"B\"",
            ),
        ],
    ),
    (
        "state of no variable",
        &[(
            CELL,
            "hosts = \"all\"",
            "hosts = \"all\"\nstate = [\"count\", \"cout\"]",
        )],
    ),
    (
        "narrowed state",
        &[
            ("b.st", "count : UDINT;", "count, other : UDINT;"),
            (
                CELL,
                "hosts = \"all\"",
                "hosts = \"all\"\nstate = [\"count\"]",
            ),
        ],
    ),
    (
        "drive of no actuator",
        &[
            (
                "a.st",
                "PROGRAM A",
                "INTERFACE IGeneralizedActuator\nEND_INTERFACE\nFUNCTION_BLOCK Actuator IMPLEMENTS IGeneralizedActuator\nVAR_OUTPUT on : BOOL; END_VAR\n    on := NOT on;\nEND_FUNCTION_BLOCK\nPROGRAM A",
            ),
            ("a.st", "step : INT;", "step : INT; drive : Actuator;"),
        ],
    ),
    (
        "drive of an actuator and others",
        &[
            (
                "a.st",
                "PROGRAM A",
                "INTERFACE IGeneralizedActuator\nEND_INTERFACE\nFUNCTION_BLOCK Actuator IMPLEMENTS IGeneralizedActuator\nVAR_OUTPUT on : BOOL; END_VAR\n    on := NOT on;\nEND_FUNCTION_BLOCK\nPROGRAM A",
            ),
            ("a.st", "step : INT;", "step : INT; drive : Actuator;"),
            (
                "a.st",
                "    Lamp := step = 5;",
                "    drive(on => Lamp);\n    Lamp := step = 5;",
            ),
        ],
    ),
    (
        "idle program",
        &[(
            "b.st",
            "END_PROGRAM",
            "END_PROGRAM\nPROGRAM Idle\nVAR x : INT; END_VAR\n    x := 1;\nEND_PROGRAM",
        )],
    ),
];

/// Of the portable form.
pub const PORTABLE: &[Case] = &[(
    "reference",
    &[
        (
            "b.st",
            "count : UDINT;",
            "count : UDINT; which : REF_TO UDINT;",
        ),
        (
            "b.st",
            "    IF Seen",
            "    which := REF(count);\n    IF Seen",
        ),
    ],
)];
