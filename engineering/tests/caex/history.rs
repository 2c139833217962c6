//! `ChangeMode` and the headers of elements: what is deleted is no part of the plant, and nothing goes unsaid.

use super::{OLD, assert_same, old_model};
use fam_engineering::{BuiltCell, Problems, build};

/// Changes, and parts of what is said then.
type Wrong = (
    &'static [(&'static str, &'static str)],
    &'static [&'static str],
);

/// The old model with texts replaced.
fn built(changes: &[(&str, &str)]) -> Result<BuiltCell, Problems> {
    let dir = tempfile::tempdir().unwrap();
    let model = old_model(dir.path());
    let mut text = OLD.to_owned();
    for (old, new) in changes {
        assert!(text.contains(old), "{old}");
        text = text.replacen(old, new, 1);
    }
    std::fs::write(&model, text).unwrap();
    build(&model)
}

fn warnings(cell: &BuiltCell, code: &str) -> Vec<String> {
    let all = cell.warnings.iter().filter(|w| w.code == code);
    all.map(ToString::to_string).collect()
}

#[test]
fn what_is_deleted_is_no_part_of_the_plant() {
    let before = built(&[]).unwrap();
    assert!(warnings(&before, "W812").is_empty() && warnings(&before, "W813").is_empty());
    // Elements of every kind that are there only as deleted ones.
    let cell = built(&[
        (
            "<ExternalReference",
            "<ExternalReference ChangeMode=\"delete\" Path=\"lib/Gone.aml\" Alias=\"Gone\" /><ExternalReference",
        ),
        (
            "<InstanceHierarchy",
            "<InstanceHierarchy Name=\"past\" ChangeMode=\"delete\"><InternalElement><Nonsense /></InternalElement></InstanceHierarchy><InstanceHierarchy",
        ),
        (
            "<InternalElement Name=\"second\"",
            "<InternalElement Name=\"third\" ChangeMode=\"Delete\" ID=\"{00000000-0000-0000-0000-000000000004}\" RefBaseSystemUnitPath=\"Gone@Units/Any\" /><InternalElement Name=\"second\"",
        ),
        (
            "<Attribute Name=\"cpuFactor\"",
            "<Attribute Name=\"cpuFactor\" ChangeMode=\"delete\"><Value>7</Value></Attribute><Attribute Name=\"cpuFactor\"",
        ),
        (
            "<ExternalInterface Name=\"Lamp\" ID",
            "<ExternalInterface Name=\"Horn\" ChangeMode=\"delete\" RefBaseClassPath=\"FAMInterfaceClassLib/FieldPoint\" /><ExternalInterface Name=\"Lamp\" ID",
        ),
        (
            "<RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/Gateway\" />",
            "<RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/Gateway\" /><RoleRequirements ChangeMode=\"delete\" RefBaseRoleClassPath=\"FAMRoleClassLib/Controller\" />",
        ),
        (
            "<InternalLink Name=\"a\"",
            "<InternalLink Name=\"z\" ChangeMode=\"delete\" RefPartnerSideA=\"nobody:a\" RefPartnerSideB=\"nobody:b\" /><InternalLink Name=\"a\"",
        ),
    ])
    .unwrap_or_else(|p| panic!("{p}"));
    assert_same(&before, &cell);
    let said = warnings(&cell, "W812");
    assert_eq!(said.len(), 1, "{said:?}");
    for part in [
        "ChangeMode=\"delete\"",
        "`Gone`, `past`, `old/gate/Horn`, `old/gate/FAMRoleClassLib/Controller`, `old/third` and 2 more",
        "old.aml:4",
        "remove them",
    ] {
        assert!(said[0].contains(part), "{}", said[0]);
    }
}

#[test]
fn what_was_there_is_missed() {
    // A controller is gone; the MC keeps the other one.
    let cell = built(&[
        (
            "<InternalElement Name=\"second\"",
            "<InternalElement Name=\"second\" ChangeMode=\"delete\"",
        ),
        (
            "<InternalLink RefPartner",
            "<InternalLink ChangeMode=\"delete\" RefPartner",
        ),
    ])
    .unwrap_or_else(|p| panic!("{p}"));
    assert_eq!(cell.model.controllers.len(), 1);
    // What leads to a deleted element leads nowhere.
    let table: [Wrong; 4] = [
        (
            &[(
                "<InternalElement Name=\"second\"",
                "<InternalElement Name=\"second\" ChangeMode=\"delete\"",
            )],
            &[
                "error[M808]",
                "00000000-0000-0000-0000-000000000104",
                "warning[W812]",
                "`old/second`",
            ],
        ),
        (
            &[(
                "<Attribute Name=\"refURI\" AttributeDataType=\"xs:anyURI\"><Value>file:///the%20logic/m.xml#main",
                "<Attribute ChangeMode=\"delete\" Name=\"refURI\" AttributeDataType=\"xs:anyURI\"><Value>file:///the%20logic/m.xml#main",
            )],
            &["error[M811]", "refers to no file", "`old/M/logic/refURI`"],
        ),
        (
            &[(
                "<InternalElement Name=\"Lit\"",
                "<InternalElement ChangeMode=\"removed\" Name=\"Lit\"",
            )],
            &[
                "error[M803]",
                "the ChangeMode `removed` is unknown",
                "state, create, change or delete",
                "old/M",
                "old.aml:34",
            ],
        ),
        (
            &[("<CAEXFile ", "<CAEXFile ChangeMode=\"delete\" ")],
            &["error[M802]", "marked as deleted as a whole", "old.aml:2"],
        ),
    ];
    for (changes, parts) in table {
        let problems = built(changes).unwrap_err().to_string();
        for part in parts {
            assert!(problems.contains(part), "{part} in {problems}");
        }
    }
}

#[test]
fn what_was_created_or_changed_counts_as_it_stands() {
    let before = built(&[]).unwrap();
    for mode in ["state", "create", "change", "Create", " change "] {
        let changed = format!("ChangeMode=\"{mode}\" Name");
        let cell = built(&[
            (
                "<InternalElement Name=\"M\"",
                &format!("<InternalElement {changed}=\"M\""),
            ),
            (
                "<Attribute Name=\"condition\"",
                &format!("<Attribute {changed}=\"condition\""),
            ),
            ("<InternalLink Name", &format!("<InternalLink {changed}")),
        ])
        .unwrap_or_else(|p| panic!("{mode}: {p}"));
        assert_same(&before, &cell);
        assert!(warnings(&cell, "W812").is_empty(), "{mode}");
    }
}

#[test]
fn versions_and_revisions_are_not_passed_over_in_silence() {
    let before = built(&[]).unwrap();
    const HEADER: &str = "<Version>1.2</Version><Revision><RevisionDate>2020-01-01</RevisionDate><OldVersion>1</OldVersion><NewVersion>1.2</NewVersion><AuthorName>a</AuthorName><Comment>c</Comment></Revision>";
    let cell = built(&[
        (
            "<Attribute Name=\"cpuFactor\"",
            &format!("<Description>d</Description>{HEADER}<Copyright>me</Copyright><Attribute Name=\"cpuFactor\""),
        ),
        ("<ExternalInterface Name=\"go\" RefBaseClassPath=\"FAMInterfaceClassLib/Input\">", "<ExternalInterface Name=\"go\" RefBaseClassPath=\"FAMInterfaceClassLib/Input\"><AdditionalInformation>any <x /></AdditionalInformation>"),
        // Those of the file itself are of the tool that wrote it.
        ("<ExternalReference", &format!("{HEADER}<ExternalReference")),
    ])
    .unwrap_or_else(|p| panic!("{p}"));
    assert_eq!(cell.model.controllers[1].description, "d");
    assert_eq!(before.model.mcs, cell.model.mcs);
    let said = warnings(&cell, "W813");
    assert_eq!(said.len(), 1, "{said:?}");
    for part in [
        "AdditionalInformation, Copyright, Revision, Version of `old/M/go`, `old/second`",
        "old.aml:19",
        "keep this file",
    ] {
        assert!(said[0].contains(part), "{}", said[0]);
    }
}
