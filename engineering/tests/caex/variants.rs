//! One model as different tools write it: in each spelling the same cell.

use super::{LOGIC, OLD, OWN, assert_same, old_model};
use fam_engineering::{BuiltCell, Problems, build};
use std::path::Path;

/// The files of the model, by their path.
type Files = [(&'static str, Vec<u8>); 3];

fn files() -> Files {
    [
        ("old.aml", OLD.as_bytes().to_vec()),
        ("lib/Own.aml", OWN.as_bytes().to_vec()),
        ("the logic/m.xml", LOGIC.as_bytes().to_vec()),
    ]
}

fn built(files: &Files) -> Result<BuiltCell, Problems> {
    let dir = tempfile::tempdir().unwrap();
    let model = old_model(dir.path());
    for (path, bytes) in files {
        std::fs::write(dir.path().join(path), bytes).unwrap();
    }
    build(&model)
}

/// Changes the bytes of every file.
fn each(change: impl Fn(&str) -> Vec<u8>) -> Files {
    files().map(|(path, bytes)| (path, change(std::str::from_utf8(&bytes).unwrap())))
}

/// Replaces texts of one file.
fn replaced(path: &str, changes: &[(&str, &str)]) -> Files {
    files().map(|(file, bytes)| {
        let mut text = String::from_utf8(bytes).unwrap();
        for (from, to) in changes
            .iter()
            .filter(|_| Path::new(file) == Path::new(path))
        {
            assert!(text.contains(from), "{file} has no {from}");
            text = text.replace(from, to);
        }
        (file, text.into_bytes())
    })
}

fn utf16(text: &str, mark: bool, unit: fn(u16) -> [u8; 2]) -> Vec<u8> {
    let text = text.replace("utf-8", "utf-16");
    let mark = mark.then_some('\u{feff}');
    let units: Vec<u16> = mark
        .into_iter()
        .chain(text.chars())
        .collect::<String>()
        .encode_utf16()
        .collect();
    units.into_iter().flat_map(unit).collect()
}

fn same(name: &str, changed: &Files) {
    let original = built(&files()).unwrap_or_else(|p| panic!("{p}"));
    let other = built(changed).unwrap_or_else(|p| panic!("{name}: {p}"));
    assert_same(&original, &other);
}

#[test]
fn every_encoding_and_line_end_is_read() {
    let table: [(&str, Files); 6] = [
        (
            "UTF-16, little end first",
            each(|t| utf16(t, true, u16::to_le_bytes)),
        ),
        (
            "UTF-16, big end first",
            each(|t| utf16(t, true, u16::to_be_bytes)),
        ),
        (
            "UTF-16 without mark",
            each(|t| utf16(t, false, u16::to_le_bytes)),
        ),
        (
            "UTF-8 with mark",
            each(|t| format!("\u{feff}{t}").into_bytes()),
        ),
        (
            "lines of Windows",
            each(|t| t.replace('\n', "\r\n").into_bytes()),
        ),
        (
            "one byte for a character",
            each(|t| t.replace("utf-8", "Windows-1252").into_bytes()),
        ),
    ];
    for (name, files) in table {
        same(name, &files);
    }
    // Umlauts of a one-byte code, and nothing else that is no UTF-8.
    let named = |declared: &str| {
        let text = OLD.replace("utf-8", declared);
        let (head, rest) = text.split_once("<Attribute Name=\"cpuFactor\"").unwrap();
        let mut bytes = format!("{head}<Description>").into_bytes();
        bytes.extend(b"Gr\xf6\xdfe \x80");
        bytes.extend(format!("</Description><Attribute Name=\"cpuFactor\"{rest}").into_bytes());
        let [_, own, logic] = files();
        built(&[("old.aml", bytes), own, logic])
    };
    let cell = named("windows-1252").unwrap_or_else(|p| panic!("{p}"));
    assert_eq!(cell.model.controllers[1].description, "Größe €");
    let problems = named("utf-8").unwrap_err().to_string();
    assert!(
        problems.contains("error[M103]") && problems.contains("no text in UTF-8 or UTF-16"),
        "{problems}"
    );
}

/// Name, file, what stands there and what stands there instead.
type Variant = (
    &'static str,
    &'static str,
    &'static [(&'static str, &'static str)],
);

/// Version 3.0 under a prefix.
fn prefixed() -> Files {
    let [(path, bytes), own, logic] = files();
    let text = String::from_utf8(bytes).unwrap();
    let (declaration, rest) = text.split_once("?>").unwrap();
    let rest = rest
        .replace(
            "SchemaVersion=\"2.15\"",
            "SchemaVersion=\"3.0\" xmlns:caex=\"http://www.dke.de/CAEX\"",
        )
        .replace("</", "</caex:")
        .replace('<', "<caex:")
        .replace("<caex:/caex:", "</caex:");
    [
        (path, format!("{declaration}?>{rest}").into_bytes()),
        own,
        logic,
    ]
}

#[test]
fn every_spelling_means_the_same_cell() {
    same("prefixed namespace", &prefixed());
    const SECOND: &str = "</InstanceHierarchy>\n  <InstanceHierarchy Name=\"more\">\n    <InternalElement Name=\"wires\"";
    let table: [Variant; 9] = [
        (
            "several hierarchies",
            "old.aml",
            &[("<InternalElement Name=\"wires\"", SECOND)],
        ),
        (
            "headers of tools",
            "old.aml",
            &[
                (
                    "<AdditionalInformation AutomationMLVersion=\"2.0\" />",
                    "<Description>d</Description><Version>1</Version><Revision><RevisionDate>2020-01-01</RevisionDate><AuthorName>a</AuthorName></Revision><AdditionalInformation AutomationMLVersion=\"2.0\" /><AdditionalInformation><WriterHeader><WriterName>w</WriterName></WriterHeader></AdditionalInformation><AdditionalInformation><x:any xmlns:x=\"urn:x\"><InternalElement /></x:any></AdditionalInformation>",
                ),
                (
                    "<RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/Gateway\" />",
                    "<Copyright>c</Copyright><AdditionalInformation /><RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/Gateway\"><Description /></RoleRequirements>",
                ),
                (" FileName=\"old.aml\"", ""),
            ],
        ),
        (
            "supported roles",
            "old.aml",
            &[
                (
                    "<RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/MechatronicComponent\" />",
                    "<SupportedRoleClass RefRoleClassPath=\"FAMRoleClassLib/MechatronicComponent\" />",
                ),
                (
                    "<RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/Gateway\" />",
                    "<SupportedRoleClass RefRoleClassPath=\"FAMRoleClassLib/Gateway\"><MappingObject /></SupportedRoleClass>",
                ),
            ],
        ),
        (
            "roles through an alias, and a role of the standard beside them",
            "old.aml",
            &[(
                "<RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/MechatronicComponent\" />",
                "<RoleRequirements RefBaseRoleClassPath=\"AutomationMLBaseRoleClassLib/AutomationMLBaseRole/Resource\" /><RoleRequirements RefBaseRoleClassPath=\"Std@AutomationMLDMIRoleClassLib/DiscManufacturingEquipment\" /><RoleRequirements RefBaseRoleClassPath=\"[FAMRoleClassLib]/[MechatronicComponent]\" />",
            )],
        ),
        (
            "another prefix of the schema's types, and none",
            "old.aml",
            &[("AttributeDataType=\"xs:", "AttributeDataType=\"xsd:")],
        ),
        (
            "values by attribute types",
            "lib/Own.aml",
            &[
                (
                    "<Attribute Name=\"loadLimit\" AttributeDataType=\"xs:double\"><Value>40</Value></Attribute>",
                    "<Attribute Name=\"loadLimit\" RefAttributeType=\"OwnTypes/Limit\" />",
                ),
                (
                    "</CAEXFile>",
                    "<AttributeTypeLib Name=\"OwnTypes\"><AttributeType Name=\"Any\" AttributeDataType=\"xs:double\"><DefaultValue>40</DefaultValue></AttributeType><AttributeType Name=\"Limit\" RefAttributeType=\"OwnTypes/Any\"><RefSemantic CorrespondingAttributePath=\"x\" /></AttributeType></AttributeTypeLib></CAEXFile>",
                ),
            ],
        ),
        (
            "an attribute of a role under another name",
            "lib/Own.aml",
            &[
                ("Name=\"loadLimit\"", "Name=\"Auslastung\""),
                (
                    "<SupportedRoleClass RefRoleClassPath=\"F@FAMRoleClassLib/Controller\" />",
                    "<SupportedRoleClass RefRoleClassPath=\"F@FAMRoleClassLib/Controller\"><MappingObject><AttributeNameMapping SystemUnitAttributeName=\"Auslastung\" RoleAttributeName=\"loadLimit\" /></MappingObject></SupportedRoleClass>",
                ),
            ],
        ),
        (
            "a class of logic whose library is not at hand",
            "old.aml",
            &[(
                "PLCopenXMLInterface/LogicInterface",
                "PLCopenXMLInterface/LogicInterface/VendorsOwn",
            )],
        ),
        (
            "comments, processing instructions and CDATA",
            "old.aml",
            &[
                (
                    "<InstanceHierarchy",
                    "<!-- <InternalElement> --><?tool x?><InstanceHierarchy",
                ),
                ("<Value>0.5</Value>", "<Value><![CDATA[0.5]]></Value>"),
            ],
        ),
    ];
    for (name, path, changes) in table {
        same(name, &replaced(path, changes));
    }
}
