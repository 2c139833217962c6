//! What stands in the place of a model, of logic or of a folder to write to and is none: refused with what it is and what to do.

use fam_engineering::caex::{container, zip};
use fam_engineering::convert::write_files;
use fam_engineering::files::{FileKind, kind_of, text_of};
use fam_engineering::{build, new_cell};
use fam_soft_plc::project::parse_project;
use fam_soft_plc::source::SourceFile;
use std::collections::BTreeMap;
use std::path::Path;

fn said(model: &Path) -> String {
    build(model).unwrap_err().to_string()
}

fn holds(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part} in {text}");
    }
}

#[test]
fn what_is_no_model_is_called_what_it_is() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    holds(
        &said(dir.path()),
        &[
            "error[M103]: this is a directory, no model",
            "give the path of an AutomationML model",
        ],
    );
    for name in ["cell.toml", "old.aml", "b.AMLX", "FAM.aml", "readme.md"] {
        std::fs::write(at(name), "").unwrap();
    }
    std::fs::create_dir(at("more.aml")).unwrap();
    let text = said(dir.path());
    holds(
        &text,
        &["did you mean", "b.AMLX` or", "cell.toml` or", "old.aml`?"],
    );
    assert!(
        !text.contains("FAM.aml") && !text.contains("more.aml"),
        "{text}"
    );
    holds(
        &said(&at("cell.toml")),
        &["error[M101]: the file is empty", "cell.toml:1:1"],
    );
    holds(&said(&at("old.aml")), &["error[M801]: this is no XML"]);
    std::fs::write(at("cell.toml"), "[cell]\nname = \"c\"\n").unwrap();
    holds(
        &said(&at("cell.toml")),
        &[
            "error[M101]: missing field `format`",
            "begins with `format = 1`",
        ],
    );
}

#[test]
fn what_a_file_is_shows_in_its_content() {
    let dir = tempfile::tempdir().unwrap();
    let large = vec![b' '; (64 << 20) + 1];
    let table: &[(&str, &[u8], FileKind)] = &[
        ("a.st", b"PROGRAM P\nEND_PROGRAM", FileKind::StructuredText),
        ("b.st", b"", FileKind::StructuredText),
        (
            "c.txt",
            b"(* Gr\xf6\xdfe *) PROGRAM P",
            FileKind::StructuredText,
        ),
        ("d.xml", b"\xef\xbb\xbf <project/>", FileKind::PlcopenXml),
        (
            "e.xml",
            b"<?xml version='1.0'?><c:CAEXFile/>",
            FileKind::Model,
        ),
        ("f.xml", b"<project n='\xe4'/>", FileKind::PlcopenXml),
        ("g.xml", b"\xff\xfe<\0p\0/\0>\0", FileKind::PlcopenXml),
        ("h.toml", b"format = 1\n[cell\n", FileKind::Model),
        ("i", b"format = 1", FileKind::Model),
        ("j.aml", b"no model", FileKind::Model),
        ("k", b"PK\x03\x04...", FileKind::Model),
        ("l.st", &large, FileKind::Model),
    ];
    for (name, bytes, kind) in table {
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(kind_of(&path), *kind, "{name}");
    }
    assert_eq!(kind_of(dir.path()), FileKind::Model);
    assert_eq!(kind_of(&dir.path().join("none")), FileKind::Model);
    holds(
        &said(&dir.path().join("l.st")),
        &["error[M103]", "64 MB that are read"],
    );
    let text = text_of(&dir.path().join("l.st")).unwrap_err().to_string();
    holds(&text, &["l.st` has 64 MB, more than the 64 MB"]);
    assert_eq!(text_of(&dir.path().join("g.xml")).unwrap(), "<p/>");
}

#[test]
fn a_container_names_one_model() {
    let names = |targets: &[&str]| {
        let one = |t: &&str| {
            format!(
                "<Relationship Type=\"http://schemas.automationml.org/container/relationship/RootDocument\" Target=\"{t}\" Id=\"r\"/>"
            )
        };
        let list: String = targets.iter().map(one).collect();
        let rels = format!(
            "<Relationships xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\">{list}</Relationships>"
        );
        let parts = BTreeMap::from([
            ("a.aml".to_owned(), b"<a/>".to_vec()),
            ("_rels/.rels".to_owned(), rels.into_bytes()),
        ]);
        container::open(&zip::pack(&parts))
    };
    assert_eq!(names(&["/a.aml"]).unwrap().1, "a.aml");
    assert_eq!(names(&["/a.aml", "/a.aml"]).unwrap().1, "a.aml");
    let text = names(&["/a.aml", "/b.aml"]).unwrap_err().to_string();
    holds(
        &text,
        &[
            "does not say which of its parts",
            "names both `/a.aml` and `/b.aml`",
        ],
    );
    let text = names(&[]).unwrap_err().to_string();
    holds(&text, &["has no relationship"]);
}

#[test]
fn a_file_in_the_place_of_a_folder_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("cell");
    std::fs::write(&file, "").unwrap();
    for folder in [file.clone(), file.join("deeper")] {
        let text = write_files(&new_cell::files(), &folder)
            .unwrap_err()
            .to_string();
        holds(
            &text,
            &[
                "error[M601]",
                "cell is a file, no folder",
                "give another folder",
            ],
        );
    }
    let taken = dir.path().join("taken");
    std::fs::create_dir_all(taken.join("cell.toml")).unwrap();
    let text = write_files(&new_cell::files(), &taken)
        .unwrap_err()
        .to_string();
    holds(
        &text,
        &[
            "error[M601]",
            "cell.toml",
            "no folder or file of another kind",
        ],
    );
}

/// As many problems as bytes, all in one line: a few of them are told, without that line.
#[test]
fn a_text_that_is_none_is_refused_in_few_words() {
    for text in [
        "\0".repeat(1 << 20),
        "?".repeat(1 << 20),
        "x := 1; ".repeat(1 << 17),
    ] {
        let (_, problems) = parse_project(&[SourceFile::new("a.st", text)]);
        assert!((1..=400).contains(&problems.len()), "{}", problems.len());
        let said: usize = problems.iter().map(|p| p.to_string().len()).sum();
        assert!(said < 100_000, "{said}");
    }
    let dir = tempfile::tempdir().unwrap();
    let long = format!("<CAEXFile><!-- {} --><</CAEXFile>", "x".repeat(1 << 20));
    std::fs::write(dir.path().join("a.aml"), long).unwrap();
    let text = said(&dir.path().join("a.aml"));
    holds(&text, &["error[M801]", "a.aml:1:10485"]);
    assert!(text.len() < 1000, "{}", text.len());
}
