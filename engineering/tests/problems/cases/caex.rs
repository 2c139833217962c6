//! AutomationML (M8xx), and what every model can have wrong as it stands there.

use super::{AML, Case};

pub const CASES: &[Case] = &[
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
    (
        "deleted elements",
        &[(
            AML,
            "<InternalElement Name=\"A\"",
            "<InternalElement Name=\"c2\" ChangeMode=\"delete\" />\n    <InternalElement Name=\"A\"",
        )],
    ),
    (
        "unknown change",
        &[(AML, "ID=\"lit\"", "ID=\"lit\" ChangeMode=\"removed\"")],
    ),
    (
        "a file that is deleted",
        &[(
            "own.aml",
            "SchemaVersion",
            "ChangeMode=\"delete\" SchemaVersion",
        )],
    ),
    (
        "versions",
        &[(
            AML,
            "<Attribute Name=\"worst",
            "<Version>1.2</Version><Copyright>ours</Copyright>\n      <Attribute Name=\"worst",
        )],
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
        "an MC that hosts itself",
        &[
            (
                AML,
                "<ExternalInterface Name=\"Go\" ID=\"a-go\"",
                "<ExternalInterface Name=\"Hosting\" ID=\"a-host\" RefBaseClassPath=\"FAMInterfaceClassLib/Hosting\" />\n      <ExternalInterface Name=\"Go\" ID=\"a-go\"",
            ),
            (
                AML,
                "<InternalLink Name=\"go\"",
                "<InternalLink Name=\"self\" RefPartnerSideA=\"a-host\" RefPartnerSideB=\"a-host\" />\n      <InternalLink Name=\"go\"",
            ),
        ],
    ),
    (
        "attributes that nobody reads",
        &[
            (
                AML,
                "Name=\"worstCaseLoad\" Unit=\"us\"><Value>10</Value></Attribute>",
                "Name=\"worstCaseLoad\" Unit=\"us\"><Value>10</Value></Attribute>\n      <Attribute Name=\"critcality\"><Value>7</Value></Attribute>\n      <Attribute Name=\"Colour\"><Value>red</Value></Attribute>",
            ),
            (
                AML,
                "Name=\"failSafe\"><Value>false</Value></Attribute>",
                "Name=\"failSafe\"><Value>false</Value></Attribute>\n        <Attribute Name=\"Exported\"><Value>true</Value></Attribute>\n        <Attribute Name=\"wire\"><Value>12</Value></Attribute>",
            ),
            (
                AML,
                "Name=\"kind\">",
                "Name=\"repeatible\"><Value>true</Value></Attribute>\n        <Attribute Name=\"kind\">",
            ),
        ],
    ),
    (
        "an attribute twice",
        &[(
            AML,
            "<Attribute Name=\"hosts\">",
            "<Attribute Name=\"hosts\"><Value>c1</Value></Attribute>\n      <Attribute Name=\"hosts\">",
        )],
    ),
    (
        "a controller that is an MC",
        &[(
            AML,
            "    </InternalElement>\n  </InstanceHierarchy>",
            "      <RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/Controller\" />\n    </InternalElement>\n  </InstanceHierarchy>",
        )],
    ),
    (
        "two outputs that are joined",
        &[(
            AML,
            "<InternalLink Name=\"go\"",
            "<InternalLink Name=\"out\" RefPartnerSideA=\"a-lamp\" RefPartnerSideB=\"a-lamp\" />\n      <InternalLink Name=\"go\"",
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
];
