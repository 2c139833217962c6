//! What is wrong with each model: file, what stands there, what stands there instead.

/// A change: file, text, new text; a file that is not there is made.
pub type Change = (&'static str, &'static str, &'static str);
/// Name and changes.
pub type Case = (&'static str, &'static [Change]);

const CELL: &str = "cell.toml";
const AML: &str = "cell.aml";

/// Of the `cell.toml`.
pub const TOML: &[Case] = &[
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
        "located structure",
        &[(
            "b.st",
            "Seen AT %IX0.0 : BOOL;",
            "Seen AT %IX0.0 : BOOL;\n    both AT %IB2 : ARRAY[0..1] OF BYTE;",
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

/// Of the `cell.toml`, for `--target portable`.
pub const PORTABLE: &[Case] = &[
    (
        "chart",
        &[(
            "b.st",
            "    IF Seen THEN count := count + 1; END_IF;\n",
            "INITIAL_STEP Waiting:\nEND_STEP\nSTEP Counting:\n    Add(N);\nEND_STEP\nTRANSITION FROM Waiting TO Counting := Seen;\nEND_TRANSITION\nTRANSITION FROM Counting TO Waiting := NOT Seen;\nEND_TRANSITION\nACTION Add:\n    count := count + 1;\nEND_ACTION\n",
        )],
    ),
    (
        "edge",
        &[
            (
                "b.st",
                "count : UDINT;",
                "count : UDINT; counter : Counter;",
            ),
            (
                "b.st",
                "PROGRAM B",
                "FUNCTION_BLOCK Counter\nVAR_INPUT part : BOOL R_EDGE; END_VAR\nVAR n : INT; END_VAR\n    IF part THEN n := n + 1; END_IF;\nEND_FUNCTION_BLOCK\nPROGRAM B",
            ),
            (
                "b.st",
                "    IF Seen",
                "    counter(part := Seen);\n    IF Seen",
            ),
        ],
    ),
    (
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
    ),
];

/// Of the AutomationML model.
pub const CAEX: &[Case] = &[
    ("no XML", &[(AML, "<CAEXFile xmlns", "CAEXFile xmlns")]),
    ("broken XML", &[(AML, "</InstanceHierarchy>", "")]),
    (
        "document type",
        &[(
            AML,
            "<CAEXFile",
            "<!DOCTYPE a [<!ENTITY b \"c\">]><CAEXFile",
        )],
    ),
    (
        "another kind of XML",
        &[
            (AML, "<CAEXFile", "<Project"),
            (AML, "</CAEXFile>", "</Project>"),
        ],
    ),
    (
        "another namespace",
        &[(AML, "http://www.dke.de/CAEX", "http://example.org")],
    ),
    ("another version", &[(AML, "\"3.0\"", "\"4.0\"")]),
    ("no version", &[(AML, "SchemaVersion=\"3.0\" ", "")]),
    (
        "unknown element",
        &[(
            AML,
            "<Attribute Name=\"hosts\"><Value>all</Value></Attribute>",
            "<Hosts>all</Hosts>",
        )],
    ),
    (
        "missing name",
        &[(AML, "<InternalElement Name=\"Lit\"", "<InternalElement")],
    ),
    ("an ID twice", &[(AML, "ID=\"lit\"", "ID=\"a\"")]),
    ("missing library", &[(AML, "own.aml\" />", "mine.aml\" />")]),
    (
        "library of a scheme",
        &[(
            AML,
            "Path=\"own.aml\"",
            "Path=\"http://example.org/own.aml\"",
        )],
    ),
    (
        "library outside",
        &[(AML, "Path=\"own.aml\"", "Path=\"../own.aml\"")],
    ),
    (
        "library of the standard that is missing",
        &[(
            AML,
            "<InstanceHierarchy",
            "<ExternalReference Alias=\"Base\" Path=\"AutomationMLBase.aml\" />\n  <InstanceHierarchy",
        )],
    ),
    ("logic outside", &[(AML, "a.xml#A<", "../a.xml#A<")]),
    ("unknown class", &[(AML, "Own@Units/Plc", "Own@Units/Pcl")]),
    ("unknown alias", &[(AML, "Own@Units/Plc", "Owm@Units/Plc")]),
    (
        "circle of classes",
        &[(
            "own.aml",
            "Name=\"Plc\"",
            "Name=\"Plc\" RefBaseClassPath=\"Units/Plc\"",
        )],
    ),
    (
        "circle of files",
        &[(
            "own.aml",
            "  <SystemUnitClassLib",
            "  <ExternalReference Alias=\"Cell\" Path=\"cell.aml\" />\n  <SystemUnitClassLib",
        )],
    ),
    (
        "link to nothing",
        &[(
            AML,
            "RefPartnerSideA=\"gate-go\"",
            "RefPartnerSideA=\"gate-stop\"",
        )],
    ),
    (
        "link to no interface",
        &[(
            AML,
            "RefPartnerSideA=\"gate-go\"",
            "RefPartnerSideA=\"gate:Goo\"",
        )],
    ),
    (
        "link to an element",
        &[(
            AML,
            "RefPartnerSideA=\"gate-go\"",
            "RefPartnerSideA=\"gate\"",
        )],
    ),
    (
        "link of a class to nothing",
        &[(
            "own.aml",
            "<SystemUnitClass Name=\"Plc\">",
            "<SystemUnitClass Name=\"Plc\">\n      <InternalLink Name=\"x\" RefPartnerSideA=\"gone\" RefPartnerSideB=\"gone:too\" />",
        )],
    ),
    (
        "no number",
        &[(AML, "<Value>10</Value>", "<Value>ten</Value>")],
    ),
    (
        "no whole number",
        &[(AML, "<Value>10</Value>", "<Value>10.5</Value>")],
    ),
    ("another unit", &[(AML, "Unit=\"us\"", "Unit=\"h\"")]),
    (
        "neither true nor false",
        &[(
            AML,
            "<Attribute Name=\"kind\">",
            "<Attribute Name=\"repeatable\"><Value>maybe</Value></Attribute>\n        <Attribute Name=\"kind\">",
        )],
    ),
    (
        "no setting",
        &[(
            AML,
            "<InternalElement Name=\"gate\"",
            "<InternalElement Name=\"small\" ID=\"cell\">\n      <Attribute Name=\"settings\"><Attribute Name=\"reprt\"><Value>1</Value></Attribute></Attribute>\n      <RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/Cell\" />\n    </InternalElement>\n    <InternalElement Name=\"gate\"",
        )],
    ),
    (
        "two cells",
        &[(
            AML,
            "<InternalElement Name=\"gate\"",
            "<InternalElement Name=\"one\" ID=\"one\"><RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/Cell\" /></InternalElement>\n    <InternalElement Name=\"two\" ID=\"two\"><RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/Cell\" /></InternalElement>\n    <InternalElement Name=\"gate\"",
        )],
    ),
    (
        "no gateway",
        &[(AML, "FAMRoleClassLib/Gateway", "FAMRoleClassLib/Controller")],
    ),
    (
        "two gateways of one MC",
        &[
            (
                AML,
                "<InternalElement Name=\"c1\"",
                "<InternalElement Name=\"gate2\" ID=\"gate2\">\n      <ExternalInterface Name=\"Go\" ID=\"gate2-go\" RefBaseClassPath=\"FAMInterfaceClassLib/FieldPoint\" />\n      <RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/Gateway\" />\n    </InternalElement>\n    <InternalElement Name=\"c1\"",
            ),
            (
                AML,
                "RefPartnerSideA=\"gate-go\"",
                "RefPartnerSideA=\"gate2-go\"",
            ),
        ],
    ),
    (
        "two cycles",
        &[(
            AML,
            "RefBaseSystemUnitPath=\"Own@Units/Plc\" />",
            "RefBaseSystemUnitPath=\"Own@Units/Plc\"><Attribute Name=\"cycle\" Unit=\"ms\"><Value>5</Value></Attribute></InternalElement>\n    <InternalElement Name=\"c2\" ID=\"c2\" RefBaseSystemUnitPath=\"Own@Units/Plc\"><Attribute Name=\"cycle\" Unit=\"ms\"><Value>10</Value></Attribute></InternalElement>",
        )],
    ),
    (
        "hosted nowhere",
        &[(
            AML,
            "<Attribute Name=\"hosts\"><Value>all</Value></Attribute>",
            "",
        )],
    ),
    (
        "input from nowhere",
        &[(
            AML,
            "<InternalLink Name=\"go\" RefPartnerSideA=\"gate-go\" RefPartnerSideB=\"a-go\" />",
            "",
        )],
    ),
    (
        "input from two",
        &[(
            AML,
            "RefPartnerSideA=\"gate-lamp\" RefPartnerSideB=\"a-lamp\"",
            "RefPartnerSideA=\"gate-lamp\" RefPartnerSideB=\"a-go\"",
        )],
    ),
    (
        "output to two",
        &[(
            AML,
            "RefPartnerSideA=\"gate-go\" RefPartnerSideB=\"a-go\"",
            "RefPartnerSideA=\"gate-go\" RefPartnerSideB=\"a-lamp\"",
        )],
    ),
    (
        "output to nowhere",
        &[(
            AML,
            "<InternalLink Name=\"lamp\" RefPartnerSideA=\"gate-lamp\" RefPartnerSideB=\"a-lamp\" />",
            "",
        )],
    ),
    (
        "no fail-safe value",
        &[(
            AML,
            "<Attribute Name=\"failSafe\"><Value>false</Value></Attribute>",
            "",
        )],
    ),
    (
        "a variable twice",
        &[(
            AML,
            "<ExternalInterface Name=\"Go\" ID=\"a-go\"",
            "<ExternalInterface Name=\"Go\" ID=\"a-go2\" RefBaseClassPath=\"FAMInterfaceClassLib/Input\" />\n      <ExternalInterface Name=\"Go\" ID=\"a-go\"",
        )],
    ),
    (
        "no worst case",
        &[(AML, "Name=\"worstCaseLoad\"", "Name=\"worst\"")],
    ),
    (
        "no condition",
        &[(AML, "Name=\"condition\"", "Name=\"cond\"")],
    ),
    (
        "no kind",
        &[(
            AML,
            "<Attribute Name=\"kind\"><Value>checkpoint</Value></Attribute>",
            "",
        )],
    ),
    (
        "checkpoint state without value",
        &[(
            AML,
            "<Attribute Name=\"kind\">",
            "<Attribute Name=\"checkpointState\"><Attribute Name=\"step\" /></Attribute>\n        <Attribute Name=\"kind\">",
        )],
    ),
    (
        "logic that is no action",
        &[(
            AML,
            "FAMInterfaceClassLib/RecoveryAction",
            "AutomationMLInterfaceClassLib/AutomationMLBaseInterface/ExternalDataConnector/PLCopenXMLInterface",
        )],
    ),
    (
        "no logic",
        &[(
            AML,
            "PLCopenXMLInterface\">\n        <Attribute Name=\"refURI\"><Value>a.xml#A</Value>",
            "PLCopenXMLInterface\">\n        <Attribute Name=\"refURL\"><Value>a.xml#A</Value>",
        )],
    ),
    ("empty reference", &[(AML, "a.xml#A<", "<")]),
    ("action without POU", &[(AML, "a.xml#Off", "a.xml")]),
    ("no such POU", &[(AML, "a.xml#Off", "a.xml#Of")]),
    ("a variable as action", &[(AML, "a.xml#Off", "a.xml#step")]),
    ("missing logic", &[(AML, "a.xml#A<", "b.xml#A<")]),
    (
        "state of no variable",
        &[(
            AML,
            "<ExternalInterface Name=\"Go\" ID=\"a-go\"",
            "<ExternalInterface Name=\"stop\" ID=\"a-stop\" RefBaseClassPath=\"FAMInterfaceClassLib/State\" />\n      <ExternalInterface Name=\"Go\" ID=\"a-go\"",
        )],
    ),
    (
        "foreign: no controller",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (
                "own.aml",
                "FAMRoleClassLib/Controller",
                "FAMRoleClassLib/Gateway",
            ),
        ],
    ),
    (
        "foreign: no logic",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (AML, "PLCopenXMLInterface\">", "COLLADAInterface\">"),
            (
                AML,
                "<Attribute Name=\"refURI\"><Value>a.xml#Off</Value></Attribute>",
                "",
            ),
            (
                AML,
                "FAMInterfaceClassLib/RecoveryAction",
                "FAMInterfaceClassLib/Input",
            ),
        ],
    ),
    (
        "foreign: no reference",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (AML, "refURI\"><Value>a.xml#A<", "refURL\"><Value>a.xml#A<"),
        ],
    ),
    (
        "foreign: malformed reference",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (AML, "a.xml#A<", "http://example.org/a.xml<"),
        ],
    ),
    (
        "foreign: logic outside",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (AML, "a.xml#A<", "../a.xml#A<"),
        ],
    ),
    (
        "foreign: no such POU",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (AML, "a.xml#A<", "a.xml#Aa<"),
        ],
    ),
    (
        "foreign: missing logic",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (AML, "a.xml#A<", "b.xml<"),
        ],
    ),
    (
        "foreign: no program",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            ("a.xml", "pouType=\"program\"", "pouType=\"functionBlock\""),
        ],
    ),
    (
        "foreign: what is assumed",
        &[(
            AML,
            "FAMRoleClassLib/MechatronicComponent",
            "FAMRoleClassLib/Gateway",
        )],
    ),
];

/// Of the deployment.
pub const DEPLOYMENT: &[(&str, &str, &str)] = &[
    ("no endpoint", "tcp/127.0.0.1:7447", "127.0.0.1:7447"),
    (
        "no address",
        "name = \"gate\"",
        "name = \"gate\"\n[plant]\nmodbus = \"1502\"",
    ),
    ("unknown gateway", "\"gate\"", "\"gat\""),
    ("unknown controller", "\"c2\"", "\"c3\""),
    (
        "address of the driver image",
        "name = \"gate\"",
        "name = \"gate\"\naddress = \"127.0.0.1:1502\"",
    ),
    ("a controller twice", "\"c2\"", "\"c1\""),
];
