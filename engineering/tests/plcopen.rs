//! Flexible Automation Projects and diagnosis files: valid, the same each time, and the same MC when read back.

mod common;

use common::{changed, read_back, two_stations};
use fam_engineering::plcopen::{diagnosis_file, project_xml};
use fam_engineering::{BuiltCell, build, write_projects};
use std::path::Path;
use std::process::Command;

fn fms200() -> Option<BuiltCell> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/fms200/cell.toml");
    path.exists()
        .then(|| build(&path).unwrap_or_else(|p| panic!("{p}")))
}

#[test]
fn a_project_reads_back_as_the_same_mcs() {
    read_back(&build(&two_stations()).unwrap());
}

#[test]
fn the_projects_of_the_fms200_read_back() {
    if let Some(built) = fms200() {
        read_back(&built);
    }
}

/// Both MCs have a function block and a type of one name, which mean different things.
#[test]
fn names_that_two_mcs_use_differently_are_kept_apart() {
    let (_dir, built) = changed(&[
        (
            "feeder.st",
            "TYPE\n",
            "TYPE\n    Mode : (Slow, Fast);\nEND_TYPE\nFUNCTION_BLOCK Helper\nVAR_INPUT m : Mode; END_VAR\nVAR_OUTPUT n : INT; END_VAR\n    IF m = Mode#Fast THEN n := 2; ELSE n := Mode_TO_INT(m); END_IF;\nEND_FUNCTION_BLOCK\nTYPE\n",
        ),
        (
            "feeder.st",
            "    settle : TON;\n",
            "    settle : TON;\n    help : Helper;\n    mode : Mode;\n",
        ),
        (
            "feeder.st",
            "    arrived := PusherOut;\n",
            "    arrived := PusherOut;\n    help(m := mode);\n",
        ),
        (
            "press.st",
            "VAR_GLOBAL\n",
            "TYPE\n    Mode : (Manual, Automatic, Off);\nEND_TYPE\nFUNCTION_BLOCK Helper\nVAR_INPUT m : Mode; END_VAR\nVAR_OUTPUT n : DINT; END_VAR\n    IF m = Mode#Off THEN n := 4; END_IF;\nEND_FUNCTION_BLOCK\nVAR_GLOBAL\n",
        ),
        (
            "press.st",
            "    force : TON;\n",
            "    force : TON;\n    help : Helper;\n",
        ),
        (
            "press.st",
            "    RamDown := step = 10;\n",
            "    help(m := Mode#Off);\n    RamDown := step = 10;\n",
        ),
    ]);
    let built = built.unwrap_or_else(|p| panic!("{p}"));
    let project = project_xml(&built, &built.model.controllers[0].controller);
    assert!(project.contains("<pou name=\"Helper\""));
    assert!(project.contains("<pou name=\"Press_Helper\""));
    assert!(project.contains("<dataType name=\"Press_Mode\""));
    assert!(project.contains("Press_Mode#Off"));
    read_back(&built);
}

#[test]
fn the_same_cell_gives_the_same_bytes() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let first = write_projects(&build(&two_stations()).unwrap(), one.path()).unwrap();
    let second = write_projects(&build(&two_stations()).unwrap(), two.path()).unwrap();
    let names: Vec<_> = first
        .iter()
        .map(|p| p.file_name().unwrap().to_str().unwrap())
        .collect();
    assert_eq!(
        names,
        [
            "controller1.xml",
            "controller2.xml",
            "Feeder.diagnosis.xml",
            "Press.diagnosis.xml"
        ]
    );
    for (a, b) in first.iter().zip(&second) {
        assert_eq!(
            std::fs::read(a).unwrap(),
            std::fs::read(b).unwrap(),
            "{}",
            a.display()
        );
    }
}

#[test]
fn projects_are_valid_against_the_schema() {
    let Some(reference) = std::env::var_os("FAM_REFERENCE") else {
        eprintln!("passed over: FAM_REFERENCE does not name the folder with the schema");
        return;
    };
    if Command::new("xmllint").arg("--version").output().is_err() {
        eprintln!("passed over: xmllint is not installed");
        return;
    }
    let schema = Path::new(&reference).join("xsd/tc6_xml_v201.xsd");
    for built in [Some(build(&two_stations()).unwrap()), fms200()]
        .into_iter()
        .flatten()
    {
        let dir = tempfile::tempdir().unwrap();
        for file in write_projects(&built, dir.path()).unwrap() {
            if file.to_str().unwrap().ends_with(".diagnosis.xml") {
                continue;
            }
            let out = Command::new("xmllint")
                .args(["--noout", "--nonet", "--schema"])
                .arg(&schema)
                .arg(&file)
                .output()
                .unwrap();
            assert!(
                out.status.success(),
                "{}",
                String::from_utf8_lossy(&out.stderr)
            );
        }
    }
}

#[test]
fn diagnosis_files_say_what_the_model_says() {
    for built in [Some(build(&two_stations()).unwrap()), fms200()]
        .into_iter()
        .flatten()
    {
        for mc in &built.mcs {
            let text = diagnosis_file::write(mc);
            let read = diagnosis_file::read(&text).unwrap();
            assert_eq!(read, mc.diagnosis, "{}", mc.mc);
        }
    }
    let built = build(&two_stations()).unwrap();
    let text = diagnosis_file::write(&built.mcs[0]);
    for part in [
        "<variable name=\"Feeder.settle.ET\" type=\"TIME\"",
        "<variable name=\"Feeder.weights\" type=\"ARRAY[0..3] OF INT\"",
        "<criticalInterval name=\"Pushing\" kind=\"checkpoint\" action=\"1\" pou=\"Feeder_Retract\" repeatable=\"true\">",
        "<condition>step = Feeding AND NOT (arrived OR alarm)</condition>",
        "<set variable=\"Feeder.step\" value=\"FeederStep#Waiting\"/>",
    ] {
        assert!(text.contains(part), "expected `{part}` in:\n{text}");
    }
}

#[test]
fn damaged_diagnosis_files_are_refused() {
    let text = diagnosis_file::write(&build(&two_stations()).unwrap().mcs[0]);
    for (from, to, message) in [
        ("</diagnosis>", "", "is no XML"),
        (
            "urn:fam:diagnosis:1",
            "urn:fam:diagnosis:2",
            "no diagnosis file of this version",
        ),
        (
            "kind=\"checkpoint\"",
            "kind=\"soft\"",
            "`criticalInterval` needs an attribute `kind` with checkpoint or unrecoverable",
        ),
        (
            "operator=\"",
            "operator=\"x",
            "`mask` needs an attribute `operator`",
        ),
        (
            "stateOffset=\"",
            "stateOffset=\"-",
            "`diagnosis` needs an attribute `stateOffset` with a whole number",
        ),
    ] {
        let damaged = text.replacen(from, to, 1);
        assert_ne!(damaged, text);
        let error = diagnosis_file::read(&damaged).unwrap_err().to_string();
        assert!(
            error.contains(message),
            "expected `{message}`, got: {error}"
        );
    }
}

#[test]
fn diagnosis_files_are_valid_against_their_schema() {
    if Command::new("xmllint").arg("--version").output().is_err() {
        eprintln!("passed over: xmllint is not installed");
        return;
    }
    let schema = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/lib/diagnosis.xsd");
    for built in [Some(build(&two_stations()).unwrap()), fms200()]
        .into_iter()
        .flatten()
    {
        let dir = tempfile::tempdir().unwrap();
        let files = write_projects(&built, dir.path()).unwrap();
        let diagnoses = files
            .iter()
            .filter(|f| f.to_str().unwrap().ends_with(".diagnosis.xml"));
        let out = Command::new("xmllint")
            .args(["--noout", "--nonet", "--schema"])
            .arg(&schema)
            .args(diagnoses)
            .output()
            .unwrap();
        assert!(
            out.status.success(),
            "{}",
            String::from_utf8_lossy(&out.stderr)
        );
    }
}

/// Programs, blocks and types of one name that mean different things; and a variable that has the name which one of them would get.
#[test]
fn two_mcs_with_the_same_names_are_read_back() {
    let logic = |ty: &str, by: u32| {
        format!(
            "TYPE Mode : (Off, On{by}); END_TYPE\nFUNCTION_BLOCK Count\nVAR_OUTPUT n : {ty}; END_VAR\n n := n + {by};\nEND_FUNCTION_BLOCK\n\
             PROGRAM Main\nVAR B_Main : Mode; Count : Count; mode : Mode; b_count2 : {ty}; END_VAR\n Count(); B_Main := mode; b_count2 := Count.n; (* B_Mode *)\nEND_PROGRAM\n"
        )
    };
    let (dir, path) = common::one_mc(&logic("INT", 1), "program = \"Main\"\n");
    let text = std::fs::read_to_string(&path).unwrap();
    let second = "[[mc]]\nname = \"B\"\nlogic = [\"b.st\"]\ngateway = \"g\"\nhosts = \"all\"\nworst_case_us = 10\nprogram = \"Main\"\n";
    std::fs::write(&path, format!("{text}{second}")).unwrap();
    std::fs::write(dir.path().join("b.st"), logic("DINT", 2)).unwrap();
    let built = build(&path).unwrap_or_else(|p| panic!("{p}"));
    common::read_back(&built);
}
