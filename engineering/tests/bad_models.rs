//! What is wrong with a model is said so that a person can mend it: what, where, what was expected.

mod common;

use common::{Case, changed, hold};

const CELL: &str = "cell.toml";
const FEEDER: &str = "feeder.st";
const PRESS: &str = "press.st";

const CASES: &[Case] = &[
    Case {
        name: "unknown field",
        changes: &[(CELL, "criticality = 2", "critical = 2")],
        message: &[
            "error[M101]: unknown field `critical`",
            "cell.toml:32:1",
            "critical = 2",
            "= expected: one of `name`",
        ],
    },
    Case {
        name: "unknown field of an output",
        changes: &[(CELL, "FedParts = { field =", "FedParts = { fields =")],
        message: &["unknown field `fields`", "`field`, `export`, `fail_safe`"],
    },
    Case {
        name: "not TOML",
        changes: &[(CELL, "tick_ms = 5", "tick_ms = = 5")],
        message: &["error[M101]", "cell.toml:6"],
    },
    Case {
        name: "another format",
        changes: &[(CELL, "format = 1", "format = 2")],
        message: &["error[M102]: the file has format 2", "expected: format = 1"],
    },
    Case {
        name: "wrong type",
        changes: &[(CELL, "worst_case_us = 50", "worst_case_us = \"much\"")],
        message: &[
            "error[M101]: invalid type: string \"much\"",
            "expected: a whole number from 0",
        ],
    },
    Case {
        name: "bad name",
        changes: &[(CELL, "name = \"controller1\"", "name = \"1st controller\"")],
        message: &[
            "`1st controller` is not a valid name of a controller",
            "expected: 1 to 64 letters",
        ],
    },
    Case {
        name: "an MC's name must be one of IEC 61131-3",
        changes: &[(CELL, "name = \"Press\"", "name = \"Press-1\"")],
        message: &[
            "`Press-1` cannot be the name of an MC",
            "single underscores",
        ],
    },
    Case {
        name: "a controller twice",
        changes: &[(CELL, "name = \"controller2\"", "name = \"controller1\"")],
        message: &[
            "error[M202]: there are two controllers named `controller1`",
            "first one stands in line 17",
        ],
    },
    Case {
        name: "an MC twice",
        changes: &[(CELL, "name = \"Press\"", "name = \"FEEDER\"")],
        message: &["there are two MCs named `FEEDER`", "rename one of them"],
    },
    Case {
        name: "unknown driver",
        changes: &[(CELL, "driver = \"image\"", "driver = \"profinet\"")],
        message: &["`profinet` is no field driver", "expected: modbus or image"],
    },
    Case {
        name: "Modbus without an address",
        changes: &[(CELL, "driver = \"image\"", "driver = \"modbus\"")],
        message: &["the driver `modbus` needs an address"],
    },
    Case {
        name: "points of another driver",
        changes: &[(
            CELL,
            "driver = \"image\"",
            "driver = \"modbus\"\naddress = \"127.0.0.1:1502\"",
        )],
        message: &[
            "error[M301]: input Start of MC Feeder: an image point, but its gateway has the driver `modbus`",
        ],
    },
    Case {
        name: "a register for a bit",
        changes: &[
            (
                CELL,
                "driver = \"image\"",
                "driver = \"modbus\"\naddress = \"127.0.0.1:1502\"",
            ),
            (CELL, "\"image:Start\"", "\"modbus:1/input/0\""),
            (CELL, "\"image:PusherExtend\"", "\"modbus:1/discrete/0\""),
            (CELL, "\"image:FedParts\"", "\"modbus:1/coil/1\""),
        ],
        message: &[
            "error[M314]: input Start of MC Feeder: `modbus:1/input/0` is a register, but `Start` is one bit",
            "error[M303]: output PusherExtend of MC Feeder: discrete inputs cannot be written",
            "error[M314]: output FedParts of MC Feeder: `modbus:1/coil/1` is one bit, but `FedParts` is UINT",
        ],
    },
    Case {
        name: "registers over each other",
        changes: &[
            (
                CELL,
                "driver = \"image\"",
                "driver = \"modbus\"\naddress = \"127.0.0.1:1502\"",
            ),
            (CELL, "\"image:LastWeight\"", "\"modbus:1/holding/4\""),
            (CELL, "\"image:FedParts\"", "\"modbus:1/holding/5\""),
        ],
        message: &[
            "error[M317]: `modbus:1/holding/4` has two writers: output FedParts of MC Feeder and output LastWeight of MC Press",
        ],
    },
    Case {
        name: "no gateway of this name",
        changes: &[(
            CELL,
            "gateway = \"gateway1\"\nhosts",
            "gateway = \"gatway1\"\nhosts",
        )],
        message: &[
            "error[M205]: MC Feeder: there is no gateway `gatway1`",
            "did you mean `gateway1`?",
        ],
    },
    Case {
        name: "hosted on no controller",
        changes: &[(CELL, "hosts = \"all\"", "hosts = []")],
        message: &[
            "error[M208]: MC Feeder is hosted on no controller",
            "or a list of: controller1, controller2",
        ],
    },
    Case {
        name: "hosts left out",
        changes: &[(CELL, "hosts = \"all\"\n", "")],
        message: &["MC Feeder is hosted on no controller"],
    },
    Case {
        name: "unknown controller",
        changes: &[(CELL, "\"controller2\"]", "\"controller3\"]")],
        message: &[
            "error[M207]: MC Press: there is no controller `controller3`",
            "did you mean `controller1`?",
        ],
    },
    Case {
        name: "hosts is another word",
        changes: &[(CELL, "hosts = \"all\"", "hosts = \"controller1\"")],
        message: &[
            "`controller1` is no list of controllers",
            "hosts = [\"controller1\"]",
        ],
    },
    Case {
        name: "a cycle that is no multiple of the tick",
        changes: &[(CELL, "cycle_ms = 5", "cycle_ms = 7")],
        message: &[
            "error[M403]: MC Feeder: a cycle of 7 ms is no multiple of the tick",
            "expected: a multiple of 5 ms",
        ],
    },
    Case {
        name: "watchdog within the time of a failover",
        changes: &[(CELL, "watchdog_ms = 500", "watchdog_ms = 130")],
        message: &[
            "error[M405]: MC Feeder: a watchdog of 130 ms would strike before a failover could end",
            "50 ms",
            "80 ms",
        ],
    },
    Case {
        name: "suspect too short",
        changes: &[(CELL, "suspect_ms = 50", "suspect_ms = 15")],
        message: &[
            "error[M404]: MC Feeder: after 15 ms of silence",
            "at least 4 cycles, 20 ms",
        ],
    },
    Case {
        name: "no time at all",
        changes: &[(CELL, "suspect_ms = 50", "suspect_ms = 0")],
        message: &["error[M401]: suspect_ms cannot be 0 ms"],
    },
    Case {
        name: "reports lost before the next could come",
        changes: &[(
            CELL,
            "report_ms = 100",
            "report_ms = 100\nreport_lost_ms = 150",
        )],
        message: &[
            "report_lost_ms (150) leaves no room",
            "at least twice report_ms (100)",
        ],
    },
    Case {
        name: "more than a controller may do",
        changes: &[(CELL, "worst_case_us = 50", "worst_case_us = 4000")],
        message: &[
            "MC Feeder alone is above the limit of every controller that hosts it",
            "4000 us every 5 ms",
        ],
    },
    Case {
        name: "two writers",
        changes: &[(
            CELL,
            "RamDown = { field = \"image:RamDown\"",
            "RamDown = { field = \"image:PusherExtend\"",
        )],
        message: &[
            "error[M317]: `image:PusherExtend` has two writers: output PusherExtend of MC Feeder and output RamDown of MC Press",
            "one writer for each output",
        ],
    },
    Case {
        name: "two writers within one MC",
        changes: &[(
            CELL,
            "FedParts = { field = \"image:FedParts\"",
            "FedParts = { field = \"image:PusherExtend\"",
        )],
        message: &[
            "has two writers: output FedParts of MC Feeder and output PusherExtend of MC Feeder",
        ],
    },
    Case {
        name: "unknown output",
        changes: &[(CELL, "RamDown = {", "RamDwn = {")],
        message: &[
            "error[M313]: MC Press: its logic has no output `RamDwn`",
            "did you mean `RamDown`?",
            "error[M312]: MC Press: the output `RamDown` (at %QX0.0) of its logic is not listed",
        ],
    },
    Case {
        name: "an input listed as output",
        changes: &[(CELL, "RamDown = {", "RamUp = {")],
        message: &["`RamUp` is at %IX0.1, so that it is no output"],
    },
    Case {
        name: "located variable not listed",
        changes: &[(CELL, "Weight = \"image:Weight\"\n", "")],
        message: &[
            "error[M312]: MC Feeder: the input `Weight` (at %IW1) of its logic is not listed",
            "add `Weight = \"...\"` to [mc.inputs]",
        ],
    },
    Case {
        name: "no fail-safe value",
        changes: &[(
            CELL,
            "RamDown = { field = \"image:RamDown\", fail_safe = false }",
            "RamDown = { field = \"image:RamDown\" }",
        )],
        message: &["error[M305]: output RamDown of MC Press has no fail-safe value"],
    },
    Case {
        name: "fail-safe value of another type",
        changes: &[(
            CELL,
            "FedParts = { field = \"image:FedParts\", export = true, fail_safe = 0",
            "FedParts = { field = \"image:FedParts\", export = true, fail_safe = -1",
        )],
        message: &[
            "error[M315]: fail-safe value of output FedParts of MC Feeder: -1 is no UINT",
            "a number from 0 to 65535",
        ],
    },
    Case {
        name: "an output that goes nowhere",
        changes: &[(
            CELL,
            "PartReady = { export = true,",
            "PartReady = { export = false,",
        )],
        message: &[
            "error[M304]: output PartReady of MC Feeder goes nowhere",
            "`export = true`",
        ],
    },
    Case {
        name: "input from an unknown MC",
        changes: &[(CELL, "mc:Press.Taken", "mc:Pres.Taken")],
        message: &[
            "error[M306]: input Taken of MC Feeder: there is no MC `Pres`",
            "did you mean `Press`?",
        ],
    },
    Case {
        name: "input from an unknown export",
        changes: &[(CELL, "mc:Press.Taken", "mc:Press.Token")],
        message: &[
            "error[M309]: input Taken of MC Feeder: MC Press exports no `Token`",
            "did you mean `Taken`?",
        ],
    },
    Case {
        name: "input from an input of another MC",
        changes: &[(CELL, "mc:Press.Taken", "mc:Press.RamUp")],
        message: &["`RamUp` is an input of MC Press; only outputs can be exported"],
    },
    Case {
        name: "input from an output that is not exported",
        changes: &[(CELL, "mc:Press.Taken", "mc:Press.RamDown")],
        message: &[
            "error[M307]",
            "it is not exported",
            "add `export = true` to it in MC Press",
        ],
    },
    Case {
        name: "input of another type than the export",
        changes: &[(CELL, "mc:Feeder.PartWeight", "mc:Feeder.FedParts")],
        message: &[
            "error[M316]: input PartWeight of MC Press is REAL, but `FedParts` of MC Feeder is UINT",
        ],
    },
    Case {
        name: "logic that is not there",
        changes: &[(CELL, "logic = [\"press.st\"]", "logic = [\"pres.st\"]")],
        message: &["error[M209]: MC Press: `pres.st` cannot be read"],
    },
    Case {
        name: "an error in the logic",
        changes: &[(PRESS, "pressed := pressed + 1;", "pressed := presed + 1;")],
        message: &["press.st:33", "presed"],
    },
    Case {
        name: "no main program",
        changes: &[(PRESS, "PROGRAM Press", "PROGRAM Presse")],
        message: &[
            "error[M210]: MC Press: its logic has no PROGRAM `Press`",
            "did you mean `Presse`?",
        ],
    },
    Case {
        name: "a generated name is taken",
        changes: &[(
            PRESS,
            "FUNCTION_BLOCK Press_RamUp",
            "FUNCTION_BLOCK Press_Serialize\nVAR_OUTPUT end : BOOL; END_VAR\nend := TRUE;\nEND_FUNCTION_BLOCK\nFUNCTION_BLOCK Press_RamUp",
        )],
        message: &[
            "error[M211]: MC Press: its logic declares `Press_Serialize`, which is generated",
        ],
    },
    Case {
        name: "addresses over each other",
        changes: &[(FEEDER, "Weight AT %IW1", "Weight AT %IW0")],
        message: &[
            "error[M311]: MC Feeder: `Start` (at %IX0.0) and `Weight` (at %IW0) lie over each other",
        ],
    },
    Case {
        name: "an address without a declaration",
        changes: &[(
            PRESS,
            "RamDown := step = 10;",
            "RamDown := step = 10; %QX0.5 := TRUE;",
        )],
        message: &["error[M318]: MC Press: Press uses %QX0.5, which no located variable declares"],
    },
    Case {
        name: "frames beyond the link",
        changes: &[(CELL, "link_mbit_s = 1000", "link_mbit_s = 0.5")],
        message: &[
            "error[M410]: all MCs together may send",
            "the link carries 0.5",
        ],
    },
    Case {
        name: "frames beyond a message",
        changes: &[(
            PRESS,
            "pressed : UDINT;",
            "pressed : UDINT; log : ARRAY[0..9000000] OF LREAL;",
        )],
        message: &[
            "error[M408]: MC Press: its frames would have 720",
            "a message has at most 67108864",
        ],
    },
    Case {
        name: "more memory than a controller has",
        changes: &[
            (
                PRESS,
                "pressed : UDINT;",
                "pressed : UDINT; log : ARRAY[0..1000000] OF LREAL;",
            ),
            (CELL, "memory_mb = 64", "memory_mb = 4"),
        ],
        message: &[
            "error[M409]: MC Press: an instance needs",
            "controller controller1 has 4096 kB",
        ],
    },
];

#[test]
fn problems_say_what_is_wrong_and_where() {
    hold(CASES);
}

#[test]
fn all_problems_come_at_once() {
    let (_dir, built) = changed(&[
        (CELL, "cycle_ms = 5", "cycle_ms = 7"),
        (CELL, "recovery = \"Press_RamUp\"", "recovery = \"Nothing\""),
        (CELL, "condition = \"step = 10\"", "condition = \"RamUp\""),
        (CELL, "mc:Press.Taken", "mc:Press.Nothing"),
        (FEEDER, "fed := fed + 1;", "fed := fed + one;"),
    ]);
    let problems = built.unwrap_err();
    let codes: Vec<&str> = problems.list.iter().map(|p| p.code.as_str()).collect();
    for code in ["M403", "M504", "M507", "M309"] {
        assert!(codes.contains(&code), "{code} is missing: {codes:?}");
    }
    assert!(
        codes.iter().any(|c| c.starts_with('E')),
        "the logic's error is missing: {codes:?}"
    );
    assert!(
        problems
            .to_string()
            .ends_with(&format!("{} errors", problems.errors()))
    );
}

#[test]
fn plain_globals_in_a_file_of_two_mcs_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let folder = common::two_stations().parent().unwrap().to_owned();
    for file in ["feeder.st", "press.st"] {
        std::fs::copy(folder.join(file), dir.path().join(file)).unwrap();
    }
    let cell = std::fs::read_to_string(folder.join("cell.toml"))
        .unwrap()
        .replace(
            "logic = [\"press.st\"]",
            "logic = [\"common.st\", \"press.st\"]",
        )
        .replace(
            "logic = [\"feeder.st\"]",
            "logic = [\"common.st\", \"feeder.st\"]",
        );
    std::fs::write(dir.path().join("cell.toml"), cell).unwrap();
    let path = dir.path().join("cell.toml");
    let common = |text: &str| {
        std::fs::write(dir.path().join("common.st"), text).unwrap();
        fam_engineering::build(&path)
    };
    let problems = common("VAR_GLOBAL\n    partsInCell : INT;\nEND_VAR\n")
        .unwrap_err()
        .to_string();
    assert!(problems.contains("error[M212]: the global variable `partsInCell` in `common.st` would be shared by the MCs Feeder and Press"), "{problems}");
    assert!(
        problems.contains("export it as an output of one of them"),
        "{problems}"
    );
    assert!(common("VAR_GLOBAL CONSTANT\n    LIMIT : INT := 3;\nEND_VAR\n").is_ok());
}

#[test]
fn a_missing_model_is_named() {
    let problems = fam_engineering::build(std::path::Path::new("/nowhere/cell.toml"))
        .unwrap_err()
        .to_string();
    assert!(
        problems.contains("error[M103]: the model cannot be read"),
        "{problems}"
    );
    assert!(problems.contains("/nowhere/cell.toml"), "{problems}");
}
