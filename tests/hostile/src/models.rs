//! Files of a model: AutomationML, containers, PLCopen projects, diagnosis files. They may come from anybody.
//!
//! What comes of any bytes is a model or problems, each with words for people; never a panic, a hang or much memory.

use fam_engineering::caex::container;
use fam_engineering::import;
use fam_engineering::model::open::{Opened, open_bytes};
use fam_engineering::model::resolve::resolve;
use fam_engineering::plcopen::{diagnosis_file, mc_source};
use fam_soft_plc::source::SourceFile;
use std::collections::BTreeMap;
use std::path::Path;

/// Where no file lies that a model could refer to.
const NOWHERE: &str = "/nowhere";

/// An AutomationML model, or whatever else stands in a file of that name.
pub fn caex(bytes: &[u8]) {
    read(open_bytes(&Path::new(NOWHERE).join("cell.aml"), bytes));
}

/// A container: the bytes of one, or (first byte odd) one made of a model and a project, which are apart by a zero byte.
pub fn amlx(bytes: &[u8]) {
    let path = Path::new(NOWHERE).join("cell.amlx");
    let Some((how, rest)) = bytes.split_first() else {
        return;
    };
    if how & 1 == 0 {
        return read(open_bytes(&path, rest));
    }
    let mut texts = rest.split(|b| *b == 0).map(String::from_utf8_lossy);
    let mut files = BTreeMap::new();
    for name in ["cell.aml", "logic/part.xml"] {
        let text = texts.next().unwrap_or_default();
        files.insert(name.to_owned(), text.into_owned());
    }
    let packed = container::pack(&files, "cell.aml");
    assert!(
        container::open(&packed).is_ok(),
        "a container that was just made"
    );
    read(open_bytes(&path, &packed));
}

/// A PLCopen project: a proposal is made of it, and an MC taken out of it.
pub fn plcopen(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else {
        return;
    };
    if let Ok(source) = mc_source(text, "Loader") {
        assert!(source.text.contains("<project"));
    }
    match import::model(&[SourceFile::new("part.xml", text)], "cell.aml") {
        Ok(files) => assert!(files.contains_key("cell.aml")),
        Err(problems) => assert!(!problems.to_string().is_empty()),
    }
}

/// A diagnosis file, and the decision that it makes over its own bytes.
pub fn diagnosis_file(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else {
        return;
    };
    match diagnosis_file::read(text) {
        Ok(diagnosis) => crate::diagnosis::decide(&diagnosis, bytes),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

fn read(opened: Opened) {
    let mut problems = opened.problems;
    if let Some(file) = opened.file {
        let (_, found) = resolve(file, opened.text, problems);
        problems = found;
    }
    for problem in problems {
        assert!(!problem.to_string().is_empty());
    }
}
