//! AutomationML models that are wrong: each is refused with what is wrong, where, and what to do.

use super::{OLD, old_model};
use fam_engineering::build;
use fam_engineering::caex::container;
use std::collections::BTreeMap;

/// Changes of the old model (file, what stands there, what is to stand there), and parts of the message.
type Case = (
    &'static str,
    &'static [(&'static str, &'static str, &'static str)],
    &'static [&'static str],
);

const BAD: &[Case] = &[
    (
        "not XML",
        &[(
            "old.aml",
            "<?xml version=\"1.0\" encoding=\"utf-8\"?>",
            "no model",
        )],
        &["error[M801]", "this is no XML", "CAEX"],
    ),
    (
        "broken XML",
        &[("old.aml", "</InstanceHierarchy>", "")],
        &["error[M801]", "no well-formed XML", "old.aml:"],
    ),
    (
        "another kind",
        &[("old.aml", "CAEXFile", "Project")],
        &["error[M802]", "no AutomationML model", "<Project>"],
    ),
    (
        "another version",
        &[("old.aml", "\"2.15\"", "\"2.0\"")],
        &["error[M802]", "CAEX 2.0 is not supported", "3.0 or 2.15"],
    ),
    (
        "entities",
        &[(
            "old.aml",
            "<CAEXFile",
            "<!DOCTYPE x [<!ENTITY a \"aa\"><!ENTITY b \"&a;&a;\">]><CAEXFile",
        )],
        &[
            "error[M801]",
            "document type",
            "expand without end",
            "old.aml:2",
        ],
    ),
    (
        "unknown element",
        &[(
            "old.aml",
            "<RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/Gateway\" />",
            "<RoleRequirement RefBaseRoleClassPath=\"FAMRoleClassLib/Gateway\" />",
        )],
        &[
            "error[M803]",
            "<RoleRequirement> cannot stand in <InternalElement>",
            "RoleRequirements",
            "old/gate",
        ],
    ),
    (
        "missing name",
        &[(
            "old.aml",
            "<InternalElement Name=\"Lit\"",
            "<InternalElement",
        )],
        &["error[M803]", "<InternalElement> has no `Name`"],
    ),
    (
        "an ID twice",
        &[(
            "old.aml",
            "ID=\"{00000000-0000-0000-0000-000000000006}\"",
            "ID=\"00000000-0000-0000-0000-000000000005\"",
        )],
        &["error[M803]", "used twice", "new ID"],
    ),
    (
        "missing library",
        &[("old.aml", "lib/Own.aml", "lib/Mine.aml")],
        &[
            "error[M804]",
            "library `Own`",
            "`lib/Mine.aml` cannot be read",
            "old.aml:4",
        ],
    ),
    (
        "library outside",
        &[("old.aml", "lib/Own.aml", "../Own.aml")],
        &[
            "error[M805]",
            "`../Own.aml` leaves the model's folder",
            "copy the file",
        ],
    ),
    (
        "library of a scheme",
        &[("old.aml", "lib/Own.aml", "http://x/Own.aml")],
        &["error[M804]", "does not lead to a file"],
    ),
    (
        "unknown alias",
        &[(
            "old.aml",
            "RefBaseSystemUnitPath=\"Own@OwnUnits/FastController\">\n      <InternalElement",
            "RefBaseSystemUnitPath=\"Owm@OwnUnits/FastController\">\n      <InternalElement",
        )],
        &[
            "error[M806]",
            "no ExternalReference with the alias `Owm`",
            "did you mean `Own`",
        ],
    ),
    (
        "unknown class",
        &[("old.aml", "Own@OwnRoles/Danger", "Own@OwnRoles/Dangr")],
        &[
            "error[M806]",
            "`Own@OwnRoles/Dangr`, which does not exist",
            "OwnRoles/Danger",
            "old/M/Lit",
        ],
    ),
    (
        "circle of classes",
        &[(
            "lib/Own.aml",
            "<SystemUnitClass Name=\"AnyController\">",
            "<SystemUnitClass Name=\"AnyController\" RefBaseClassPath=\"OwnUnits/FastController\">",
        )],
        &[
            "error[M807]",
            "derives from itself: AnyController > FastController > AnyController",
            "Own.aml:",
        ],
    ),
    (
        "circle of files",
        &[("lib/Own.aml", "../FAM.aml", "../old.aml")],
        &[
            "error[M807]",
            "refer to each other in a circle: old.aml > lib/Own.aml > old.aml",
        ],
    ),
    (
        "link to nothing",
        &[(
            "old.aml",
            "00000000-0000-0000-0000-000000000005:go",
            "00000000-0000-0000-0000-0000000000ff:go",
        )],
        &["error[M808]", "no object with this ID", "old/wires/a"],
    ),
    (
        "link to no interface",
        &[(
            "old.aml",
            "00000000-0000-0000-0000-000000000005:go",
            "00000000-0000-0000-0000-000000000005:goo",
        )],
        &[
            "error[M808]",
            "`M` has no interface `goo`",
            "did you mean `go`",
        ],
    ),
    (
        "no number",
        &[("old.aml", "<Value>0.5</Value>", "<Value>half</Value>")],
        &[
            "error[M809]",
            "`cpuFactor` cannot be `half`",
            "a number",
            "old/second",
        ],
    ),
    (
        "unknown unit",
        &[("old.aml", "Unit=\"ms\"", "Unit=\"h\"")],
        &[
            "error[M809]",
            "`worstCaseLoad` cannot be given in `h`",
            "us",
        ],
    ),
    (
        "no condition",
        &[("old.aml", "Name=\"condition\"", "Name=\"conditon\"")],
        &[
            "error[M810]",
            "critical interval Lit of MC M has no `condition`",
            "step = 50",
        ],
    ),
    (
        "no worst case",
        &[("old.aml", "Name=\"worstCaseLoad\"", "Name=\"load\"")],
        &["error[M810]", "how long a scan takes", "worstCaseLoad"],
    ),
    (
        "empty reference",
        &[(
            "old.aml",
            "<Value>file:///the%20logic/m.xml#main-pou</Value>",
            "<Value></Value>",
        )],
        &[
            "error[M811]",
            "logic of MC M",
            "refers to no file",
            "refURI",
        ],
    ),
    (
        "malformed reference",
        &[(
            "old.aml",
            "file:///the%20logic/m.xml#main-pou",
            "\"\\the logic\\m.xml\"#Main",
        )],
        &["error[M811]", "malformed", "logic/station1.xml#Station1"],
    ),
    (
        "action without POU",
        &[("old.aml", "m.xml#Off", "m.xml")],
        &[
            "error[M811]",
            "critical interval Lit of MC M",
            "names no POU",
        ],
    ),
    (
        "missing file",
        &[(
            "old.aml",
            "file:///the%20logic/m.xml#main-pou",
            "file:///the%20logic/n.xml#main-pou",
        )],
        &[
            "error[M209]",
            "`the logic/n.xml` cannot be read",
            "relative",
            "old/M/logic",
        ],
    ),
    (
        "missing POU",
        &[("old.aml", "m.xml#Off", "m.xml#Of")],
        &[
            "error[M812]",
            "has no POU, variable or globalId `Of`",
            "did you mean `Off`",
            "old/M/Lit/recovery",
        ],
    ),
    (
        "missing variable",
        &[("old.aml", "m.xml#Start</Value>", "m.xml#Stert</Value>")],
        &["error[M313]", "`Stert`", "did you mean `Start`", "old/M/go"],
    ),
    (
        "logic outside",
        &[(
            "old.aml",
            "file:///the%20logic/m.xml#main-pou",
            "file:///../m.xml#main-pou",
        )],
        &["error[M805]", "leaves the model's folder"],
    ),
    (
        "hosted nowhere",
        &[
            (
                "old.aml",
                "RefPartnerSideA=\"00000000-0000-0000-0000-000000000104\"",
                "RefPartnerSideA=\"00000000-0000-0000-0000-000000000105\"",
            ),
            (
                "old.aml",
                "RefBaseSystemUnitPath=\"{00000000-0000-0000-0000-000000000005}\"",
                "",
            ),
        ],
        &["error[M208]", "MC M is hosted on no controller", "Hosting"],
    ),
    (
        "no source",
        &[(
            "old.aml",
            "00000000-0000-0000-0000-000000000005:go",
            "00000000-0000-0000-0000-000000000005:Hosting",
        )],
        &[
            "error[M302]",
            "input Start of MC M comes from nowhere",
            "FieldPoint",
            "old/M/go",
        ],
    ),
    (
        "condition over no state",
        &[("old.aml", "count &gt; 3</Value>", "Start</Value>")],
        &["error[M507]", "`Start` is not part of the state"],
    ),
    (
        "action without end",
        &[
            (
                "the logic/m.xml",
                "<variable name=\"end\"><type><BOOL /></type></variable>",
                "",
            ),
            ("the logic/m.xml", "end := TRUE;", ""),
        ],
        &["error[M506]", "`Off` has no output `end`", "VAR_OUTPUT"],
    ),
    (
        "body of another language",
        &[(
            "the logic/m.xml",
            "<ST><xhtml:p>Lamp := FALSE; end := TRUE;</xhtml:p></ST>",
            "<XYZ />",
        )],
        &["Off", "XYZ"],
    ),
];

#[test]
fn bad_models_are_refused_with_what_is_wrong_and_what_to_do() {
    let mut failures = String::new();
    for (name, changes, parts) in BAD {
        let dir = tempfile::tempdir().unwrap();
        let model = old_model(dir.path());
        for (file, from, to) in *changes {
            let path = dir.path().join(file);
            let text = std::fs::read_to_string(&path).unwrap();
            assert!(text.contains(from), "{name}: {file} has no {from:?}");
            let text = text.replacen(
                from,
                to,
                if *name == "another kind" {
                    usize::MAX
                } else {
                    1
                },
            );
            std::fs::write(&path, text).unwrap();
        }
        match build(&model) {
            Ok(_) => failures.push_str(&format!("{name}: was built\n")),
            Err(problems) => {
                let text = problems.to_string();
                for part in parts.iter().filter(|p| !text.contains(**p)) {
                    failures.push_str(&format!("{name}: expected `{part}` in:\n{text}\n"));
                }
            }
        }
    }
    assert!(failures.is_empty(), "{failures}");
}

#[test]
fn large_files_and_deep_nesting_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("big.aml");
    std::fs::File::create(&path)
        .unwrap()
        .set_len(300 << 20)
        .unwrap();
    let problems = build(&path).unwrap_err().to_string();
    assert!(
        problems.contains("300 MB, more than the 64 MB"),
        "{problems}"
    );

    let deep = format!(
        "<CAEXFile SchemaVersion=\"2.15\" FileName=\"d\"><InstanceHierarchy Name=\"h\">{}{}</InstanceHierarchy></CAEXFile>",
        "<InternalElement Name=\"e\">".repeat(100_000),
        "</InternalElement>".repeat(100_000)
    );
    let path = dir.path().join("deep.aml");
    std::fs::write(&path, deep).unwrap();
    let problems = build(&path).unwrap_err().to_string();
    assert!(problems.contains("nested more than 64 deep"), "{problems}");
}

#[test]
fn containers_that_are_none_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("cell.amlx");
    let no_root = container::pack(
        &BTreeMap::from([("a.aml".to_owned(), OLD.to_owned())]),
        "b.aml",
    );
    let outside =
        fam_engineering::caex::zip::pack(&BTreeMap::from([("../a.aml".to_owned(), vec![1])]));
    let empty = fam_engineering::caex::zip::pack(&BTreeMap::new());
    for (bytes, part) in [
        (b"no zip".to_vec(), "it has no end record"),
        (no_root, "the container has no such part"),
        (outside, "`../a.aml` leaves"),
        (empty, "which of its parts is the model"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let problems = build(&path).unwrap_err().to_string();
        assert!(
            problems.contains("error[M813]") && problems.contains(part),
            "expected {part} in {problems}"
        );
    }
}
