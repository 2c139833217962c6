//! Names, hosting, logic, inputs and outputs, times and sizes (M1xx to M4xx).

use super::{CELL, Case};

pub const CASES: &[Case] = &[
    ("unknown key", &[(CELL, "driver =", "drivr =")]),
    (
        "format of another version",
        &[(CELL, "format = 1", "format = 7")],
    ),
    (
        "name of no controller",
        &[(CELL, "name = \"c1\"", "name = \"c/1\"")],
    ),
    (
        "name of no MC",
        &[(CELL, "name = \"B\"", "name = \"B__b\"")],
    ),
    (
        "name of no interval",
        &[(CELL, "name = \"Lit\"", "name = \"1st\"")],
    ),
    ("a name twice", &[(CELL, "name = \"c2\"", "name = \"c1\"")]),
    (
        "driver without address",
        &[(CELL, "\"image\"", "\"modbus\"")],
    ),
    (
        "driver with address",
        &[(CELL, "\"image\"", "\"image\"\naddress = \"127.0.0.1:1502\"")],
    ),
    (
        "unknown driver",
        &[(CELL, "driver = \"image\"", "driver = \"profinet\"")],
    ),
    (
        "no gateway",
        &[(
            CELL,
            "[[gateway]]\nname = \"gate\"\ndriver = \"image\"\n",
            "",
        )],
    ),
    (
        "unknown gateway",
        &[(CELL, "gateway = \"gate\"", "gateway = \"gat\"")],
    ),
    ("no logic", &[(CELL, "logic = [\"b.st\"]", "logic = []")]),
    (
        "unknown controller",
        &[(CELL, "[\"c1\", \"c2\"]", "[\"c1\", \"c3\"]")],
    ),
    (
        "hosts of another form",
        &[(CELL, "hosts = \"all\"", "hosts = \"c1\"")],
    ),
    ("hosted nowhere", &[(CELL, "hosts = \"all\"\n", "")]),
    ("missing logic", &[(CELL, "\"b.st\"", "\"bb.st\"")]),
    ("no such program", &[("b.st", "PROGRAM B", "PROGRAM Bee")]),
    (
        "generated name",
        &[
            ("b.st", "VAR count", "VAR c : B_Control; count"),
            (
                "b.st",
                "END_PROGRAM",
                "END_PROGRAM\nFUNCTION_BLOCK B_Control\nVAR x : INT; END_VAR\n    x := 1;\nEND_FUNCTION_BLOCK",
            ),
        ],
    ),
    (
        "shared globals",
        &[
            (CELL, "[\"a.st\"]", "[\"a.st\", \"common.st\"]"),
            (CELL, "[\"b.st\"]", "[\"b.st\", \"common.st\"]"),
            ("common.st", "", "VAR_GLOBAL\n    total : INT;\nEND_VAR\n"),
        ],
    ),
    (
        "point of another driver",
        &[(CELL, "\"image:Go\"", "\"modbus:1/coil/0\"")],
    ),
    ("no point", &[(CELL, "\"image:Go\"", "\"Go\"")]),
    (
        "read-only point",
        &[
            (
                CELL,
                "driver = \"image\"",
                "driver = \"modbus\"\naddress = \"127.0.0.1:1502\"",
            ),
            (CELL, "\"image:Go\"", "\"modbus:1/discrete/0\""),
            (CELL, "\"image:Lamp\"", "\"modbus:1/discrete/0\""),
        ],
    ),
    (
        "output to nowhere",
        &[(CELL, "field = \"image:Lamp\", export = true, ", "")],
    ),
    ("no fail-safe value", &[(CELL, ", fail_safe = false", "")]),
    ("input of no MC", &[(CELL, "mc:A.Lamp", "mc:C.Lamp")]),
    ("input of no export", &[(CELL, "export = true, ", "")]),
    ("input of an input", &[(CELL, "mc:A.Lamp", "mc:A.Go")]),
    ("input of no variable", &[(CELL, "mc:A.Lamp", "mc:A.Lmp")]),
    (
        "located array that is not listed",
        &[(
            "b.st",
            "Seen AT %IX0.0 : BOOL;",
            "Seen AT %IX0.0 : BOOL;\n    both AT %IB2 : ARRAY[0..1] OF BYTE;",
        )],
    ),
    (
        "located array of too many values",
        &[(
            "b.st",
            "Seen AT %IX0.0 : BOOL;",
            "Seen AT %IX0.0 : BOOL;\n    all AT %IB2 : ARRAY[0..4096] OF BYTE;",
        )],
    ),
    (
        "overlapping addresses",
        &[
            (
                "a.st",
                "Lamp AT %QX0.0 : BOOL;",
                "Lamp AT %QX0.0 : BOOL;\n    All AT %QB0 : BYTE;",
            ),
            (
                CELL,
                "[mc.outputs]",
                "[mc.outputs]\nAll = { field = \"image:All\", fail_safe = 0 }",
            ),
        ],
    ),
    ("unlisted variable", &[(CELL, "Go = \"image:Go\"\n", "")]),
    (
        "no located variable",
        &[(
            CELL,
            "Go = \"image:Go\"",
            "Go = \"image:Go\"\nGoo = \"image:Goo\"",
        )],
    ),
    (
        "bit and register",
        &[
            (
                CELL,
                "driver = \"image\"",
                "driver = \"modbus\"\naddress = \"127.0.0.1:1502\"",
            ),
            (CELL, "\"image:Go\"", "\"modbus:1/input/0\""),
            (CELL, "\"image:Lamp\"", "\"modbus:1/holding/0\""),
        ],
    ),
    (
        "fail-safe value of another type",
        &[(CELL, "fail_safe = false", "fail_safe = 7")],
    ),
    (
        "input of another type",
        &[
            ("b.st", "Seen AT %IX0.0 : BOOL", "Seen AT %IB0 : USINT"),
            ("b.st", "Seen : BOOL", "Seen : USINT"),
            ("b.st", "IF Seen", "IF Seen > 0"),
        ],
    ),
    (
        "two writers",
        &[
            (
                "b.st",
                "END_VAR\nPROGRAM",
                "    Other AT %QX0.0 : BOOL;\nEND_VAR\nPROGRAM",
            ),
            (
                CELL,
                "Seen = \"mc:A.Lamp\"",
                "Seen = \"mc:A.Lamp\"\n[mc.outputs]\nOther = { field = \"image:Lamp\", fail_safe = false }",
            ),
        ],
    ),
    (
        "points that differ in case",
        &[(CELL, "\"mc:A.Lamp\"", "\"image:lamp\"")],
    ),
    (
        "two gateways to one device",
        &[
            (
                CELL,
                "driver = \"image\"\n",
                "driver = \"modbus\"\naddress = \"localhost:1502\"\n[[gateway]]\nname = \"second\"\ndriver = \"modbus\"\naddress = \"127.0.0.1:01502\"\n",
            ),
            (CELL, "\"image:Go\"", "\"modbus:1/discrete/0\""),
            (CELL, "\"image:Lamp\"", "\"modbus:1/coil/0\""),
            (
                "b.st",
                "END_VAR\nPROGRAM",
                "    Other AT %QX0.0 : BOOL;\nEND_VAR\nPROGRAM",
            ),
            (
                CELL,
                "logic = [\"b.st\"]\ngateway = \"gate\"",
                "logic = [\"b.st\"]\ngateway = \"second\"",
            ),
            (
                CELL,
                "Seen = \"mc:A.Lamp\"",
                "Seen = \"mc:A.Lamp\"\n[mc.outputs]\nOther = { field = \"modbus:1/coil/0\", fail_safe = false }",
            ),
        ],
    ),
    (
        "address without variable",
        &[("b.st", "    IF Seen", "    %QX0.7 := TRUE;\n    IF Seen")],
    ),
    (
        "no tick",
        &[(CELL, "name = \"small\"", "name = \"small\"\ntick_ms = 0")],
    ),
    (
        "no link",
        &[(
            CELL,
            "name = \"small\"",
            "name = \"small\"\nlink_mbit_s = -1",
        )],
    ),
    (
        "no CPU",
        &[(CELL, "name = \"c2\"", "name = \"c2\"\ncpu_factor = 0")],
    ),
    (
        "no memory",
        &[(CELL, "name = \"c2\"", "name = \"c2\"\nmemory_mb = 0")],
    ),
    (
        "reports lost at once",
        &[(
            CELL,
            "[[gateway]]",
            "[settings]\nreport_ms = 100\nreport_lost_ms = 150\n[[gateway]]",
        )],
    ),
    (
        "no multiple of the tick",
        &[(CELL, "hosts = \"all\"", "hosts = \"all\"\ncycle_ms = 7")],
    ),
    (
        "suspect at once",
        &[(CELL, "hosts = \"all\"", "hosts = \"all\"\nsuspect_ms = 6")],
    ),
    (
        "watchdog before the failover",
        &[(
            CELL,
            "hosts = \"all\"",
            "hosts = \"all\"\nwatchdog_ms = 100",
        )],
    ),
    (
        "no worst case",
        &[(
            CELL,
            "worst_case_us = 10\n[mc.inputs]\nSeen",
            "worst_case_us = 0\n[mc.inputs]\nSeen",
        )],
    ),
    (
        "worst case above all",
        &[(
            CELL,
            "worst_case_us = 10\n[mc.inputs]\nSeen",
            "worst_case_us = 4000\n[mc.inputs]\nSeen",
        )],
    ),
    (
        "worst case above one",
        &[(CELL, "name = \"c2\"", "name = \"c2\"\ncpu_factor = 0.001")],
    ),
    (
        "frames above a message",
        &[
            (CELL, "name = \"c1\"", "name = \"c1\"\nmemory_mb = 4096"),
            (CELL, "name = \"c2\"", "name = \"c2\"\nmemory_mb = 4096"),
            (
                "b.st",
                "count : UDINT",
                "count : UDINT; table : ARRAY[0..9999999] OF LREAL",
            ),
        ],
    ),
    (
        "memory above the controller",
        &[(CELL, "name = \"c2\"", "name = \"c2\"\nmemory_mb = 0.01")],
    ),
    (
        "frames above the link",
        &[(
            CELL,
            "name = \"small\"",
            "name = \"small\"\nlink_mbit_s = 0.1",
        )],
    ),
];
