//! Opens a model file of any form: `cell.toml`, AutomationML (`.aml`), or a container of it (`.amlx`).

use super::toml_file::CellFile;
use crate::caex::{cell, container, library};
use crate::files::{FILE_BYTES_MAX, ModelFiles};
use crate::problem::{Explain, ModelText, file_error};
use fam_soft_plc::diag::Diagnostic;
use std::io::Read as _;
use std::path::Path;

/// First bytes of a zip file.
const ZIP: &[u8] = b"PK\x03\x04";

/// A model that has been read, and not yet resolved.
#[derive(Debug)]
pub struct Opened {
    /// Its tables; `None` if it cannot be read.
    pub file: Option<CellFile>,
    /// The text that problems point into.
    pub text: ModelText,
    /// Where its logic is.
    pub files: ModelFiles,
    /// What is wrong so far.
    pub problems: Vec<Diagnostic>,
}

impl Opened {
    fn failed(problem: Diagnostic) -> Opened {
        Opened {
            file: None,
            text: ModelText::default(),
            files: ModelFiles::anywhere(Path::new("")),
            problems: vec![problem],
        }
    }
}

/// Opens a model.
#[must_use]
pub fn open(path: &Path) -> Opened {
    let bytes = match read_bytes(path) {
        Ok(bytes) => bytes,
        Err(problem) => return Opened::failed(*problem),
    };
    open_bytes(path, &bytes)
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, Box<Diagnostic>> {
    let unreadable =
        |e: std::io::Error| Box::new(file_error("M103", path, format!("cannot be read: {e}")));
    let file = std::fs::File::open(path).map_err(unreadable)?;
    let mut bytes = Vec::new();
    let mut limited = file.take(FILE_BYTES_MAX + 1);
    limited.read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > FILE_BYTES_MAX {
        let len = std::fs::metadata(path).map_or(bytes.len() as u64, |m| m.len());
        let message = format!(
            "the file has {} MB, more than the {} MB that are read",
            len >> 20,
            FILE_BYTES_MAX >> 20
        );
        return Err(Box::new(
            file_error("M103", path, message)
                .hint("divide the model into libraries and a hierarchy, or leave out what is no control logic"),
        ));
    }
    Ok(bytes)
}

/// Opens a model whose content is at hand; `path` says its name and where its other files are.
#[must_use]
pub fn open_bytes(path: &Path, bytes: &[u8]) -> Opened {
    let name = path.display().to_string();
    let folder = path.parent().unwrap_or(Path::new(""));
    if bytes.starts_with(ZIP)
        || path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("amlx"))
    {
        return match container::open(bytes) {
            Ok((files, root)) => match files.read(&root) {
                Ok(text) => caex(files, &format!("{name}!/{root}"), &root, text),
                Err(e) => Opened::failed(
                    file_error("M813", path, format!("the container's root document: {e}"))
                        .hint(e.hint()),
                ),
            },
            Err(e) => Opened::failed(file_error("M813", path, e.to_string()).expected(
                "an .amlx file: a zip file whose relationship RootDocument names the model",
            )),
        };
    }
    let Ok(text) = std::str::from_utf8(bytes) else {
        return Opened::failed(
            file_error("M103", path, "the file is no text in UTF-8".to_owned())
                .expected("an AutomationML model (.aml, .amlx) or a cell.toml"),
        );
    };
    let text = text.trim_start_matches('\u{feff}').to_owned();
    if text.trim_start().starts_with('<') {
        let own = path
            .file_name()
            .map_or_else(|| name.clone(), |n| n.to_string_lossy().into_owned());
        return caex(ModelFiles::within(folder), &name, &own, text);
    }
    if path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("aml"))
    {
        return Opened::failed(
            ModelText::new(name, text)
                .error("M801", 0..1, "this is no XML")
                .expected("an AutomationML (CAEX) file, which begins with `<`"),
        );
    }
    let text = ModelText::new(name, text);
    let (file, problems) = match toml::from_str::<CellFile>(&text.text) {
        Ok(file) => (Some(file), Vec::new()),
        Err(e) => (None, vec![text.unreadable(&e)]),
    };
    Opened {
        file,
        text,
        files: ModelFiles::anywhere(folder),
        problems,
    }
}

fn caex(mut files: ModelFiles, name: &str, path: &str, text: String) -> Opened {
    let mut problems = Vec::new();
    let Some(caex) = library::load(&files, name, path, text, &mut problems) else {
        return Opened {
            file: None,
            text: ModelText::default(),
            files,
            problems,
        };
    };
    let tables = cell::tables(&caex, &files, &mut problems);
    let file = tables.map(|(file, made)| {
        for (name, text) in made {
            files.make(&name, text);
        }
        file
    });
    Opened {
        file,
        text: caex.into_text(),
        files,
        problems,
    }
}
