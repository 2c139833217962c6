//! Everything that is generated from three models, to the byte: the FMS-200 cell, the marking machine, and one MC with every type.
//!
//! `FAM_RENEW=1 cargo test -p fam-engineering --test golden` writes `tests/golden` anew; `git diff` then shows what a change does. Projects of
//! controllers beyond the first differ by little and are kept as digests.

mod common;

use common::read_back;
use fam_engineering::generate::Target;
use fam_engineering::plcopen::diagnosis_file;
use fam_engineering::reload::{McChange, compare};
use fam_engineering::{build, output};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use xxhash_rust::xxh3::xxh3_128;

/// Larger files are kept as digests.
const TEXT_BYTES_MAX: usize = 200_000;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_owned()
}

/// The files of a model as they are kept: whole, or a digest in one list.
fn kept(files: &BTreeMap<String, String>) -> BTreeMap<String, String> {
    let mut kept = BTreeMap::new();
    let mut digests = String::new();
    let mut projects = 0;
    for (name, text) in files {
        let is_project =
            name.ends_with(".xml") && !name.contains(".diagnosis.") && !name.contains('/');
        projects += usize::from(is_project);
        let is_whole = (!is_project || projects <= 1)
            && !name.starts_with("model/")
            && text.len() <= TEXT_BYTES_MAX;
        if is_whole {
            kept.insert(name.clone(), text.clone());
        } else {
            digests.push_str(&format!(
                "{:032x} {} {name}\n",
                xxh3_128(text.as_bytes()),
                text.len()
            ));
        }
    }
    kept.insert("digests.txt".to_owned(), digests);
    kept
}

fn golden(name: &str, model: &str, target: Target) -> BTreeMap<String, String> {
    let path = root().join(model);
    let (files, built) = output::generate(&path, target).unwrap_or_else(|p| panic!("{name}: {p}"));
    let folder = root().join("tests/golden").join(name);
    let kept = kept(&files);
    if std::env::var_os("FAM_RENEW").is_some() {
        if folder.exists() {
            std::fs::remove_dir_all(&folder).unwrap();
        }
        std::fs::create_dir_all(&folder).unwrap();
        for (file, text) in &kept {
            std::fs::write(folder.join(file), text).unwrap();
        }
    }
    let mut there: Vec<String> = std::fs::read_dir(&folder)
        .unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    there.sort();
    let names: Vec<&String> = kept.keys().collect();
    assert_eq!(there.iter().collect::<Vec<_>>(), names, "{name}");
    for (file, text) in &kept {
        let was = std::fs::read_to_string(folder.join(file)).unwrap();
        if was != *text {
            let line = was.lines().zip(text.lines()).position(|(a, b)| a != b);
            let line = line.unwrap_or_else(|| was.lines().count().min(text.lines().count()));
            panic!(
                "{name}/{file} is another from line {} on:\n- {}\n+ {}\nif that is meant: FAM_RENEW=1 cargo test -p fam-engineering --test golden",
                line + 1,
                was.lines().nth(line).unwrap_or("(end)"),
                text.lines().nth(line).unwrap_or("(end)")
            );
        }
    }
    // What was generated is the model that it was generated from.
    for mc in &built.mcs {
        let file = &files[&format!("{}.diagnosis.xml", mc.mc)];
        assert_eq!(
            diagnosis_file::read(file).unwrap(),
            mc.diagnosis,
            "{}",
            mc.mc
        );
    }
    if target == Target::Fam {
        read_back(&built);
        let dir = tempfile::tempdir().unwrap();
        for (name, text) in &files {
            let to = dir.path().join(name);
            std::fs::create_dir_all(to.parent().unwrap()).unwrap();
            std::fs::write(to, text).unwrap();
        }
        let again =
            build(&dir.path().join(output::MODEL)).unwrap_or_else(|p| panic!("{name}: {p}"));
        let change = compare(&built, &again);
        assert!(
            change.cell.is_empty() && change.mcs.values().all(|c| *c == McChange::Same),
            "{name}: {change}"
        );
    }
    files
}

/// Holds the XML against the schemas, where they and xmllint are at hand.
fn validate(name: &str, files: &BTreeMap<String, String>) {
    if Command::new("xmllint").arg("--version").output().is_err() {
        eprintln!("passed over: xmllint is not installed");
        return;
    }
    let reference = std::env::var_os("FAM_REFERENCE").map(PathBuf::from);
    if reference.is_none() {
        eprintln!("passed over: FAM_REFERENCE does not name the folder with the schema of PLCopen");
    }
    let dir = tempfile::tempdir().unwrap();
    for (file, text) in files.iter().filter(|(file, _)| file.ends_with(".xml")) {
        let schema = if file.ends_with(".diagnosis.xml") {
            root().join("../deploy/lib/diagnosis.xsd")
        } else {
            match &reference {
                Some(folder) => folder.join("xsd/tc6_xml_v201.xsd"),
                None => continue,
            }
        };
        let path = dir.path().join("file.xml");
        std::fs::write(&path, text).unwrap();
        let out = Command::new("xmllint")
            .args(["--noout", "--nonet", "--schema"])
            .arg(&schema)
            .arg(&path)
            .output()
            .unwrap();
        assert!(
            out.status.success(),
            "{name}/{file}: {}",
            String::from_utf8_lossy(&out.stderr)
        );
    }
}

#[test]
fn the_fms200_cell() {
    let files = golden("fms200", "../deploy/fms200/cell.toml", Target::Fam);
    validate("fms200", &files);
}

#[test]
fn the_marking_machine() {
    let files = golden(
        "marking",
        "../deploy/marking-machine/cell.toml",
        Target::Fam,
    );
    validate("marking", &files);
}

/// The policy's chart as plain statements.
#[test]
fn the_marking_machine_in_portable_form() {
    let files = golden(
        "marking_portable",
        "../deploy/marking-machine/cell.toml",
        Target::Portable,
    );
    validate("marking_portable", &files);
}

#[test]
fn every_type() {
    let files = golden("types", "tests/cells/types/cell.toml", Target::Fam);
    validate("types", &files);
}

#[test]
fn every_type_in_portable_form() {
    let files = golden(
        "types_portable",
        "tests/cells/types/cell.toml",
        Target::Portable,
    );
    validate("types_portable", &files);
}
