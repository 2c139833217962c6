//! Opens a model file of any form: `cell.toml`, AutomationML (`.aml`), or a container of it (`.amlx`).

use super::toml_file::CellFile;
use crate::caex::{FAM_LIBRARY_FILE, cell, container, library};
use crate::files::{FILE_BYTES_MAX, ModelAt, ModelFiles, below, decoded, folder_of};
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
pub fn open<'a>(model: impl Into<ModelAt<'a>>) -> Opened {
    let model = model.into();
    match read_bytes(model.file) {
        Ok(bytes) => open_bytes(model, &bytes),
        Err(problem) => Opened::failed(*problem),
    }
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, Box<Diagnostic>> {
    if path.is_dir() {
        let problem = file_error("M103", path, "this is a directory, no model".to_owned());
        return Err(Box::new(match models_in(path).as_slice() {
            [] => {
                problem.hint("give the path of an AutomationML model (.aml, .amlx) or a cell.toml")
            }
            models => problem.hint(format!("did you mean {}?", models.join(" or "))),
        }));
    }
    let unreadable = |e: std::io::Error| {
        let ending = path.extension().map(|e| e.to_ascii_lowercase());
        let is_logic =
            ending.is_some_and(|e| e == "st" || e == "xml" || e == "exp" || e == "iecst");
        Box::new(if is_logic {
            file_error("M103", path, format!("the file cannot be read: {e}"))
        } else {
            file_error("M103", path, format!("the model cannot be read: {e}"))
                .hint("give the path of an AutomationML model (.aml, .amlx) or a cell.toml")
        })
    };
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

/// Models that lie in a folder, as far as their names say so.
fn models_in(folder: &Path) -> Vec<String> {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut models: Vec<String> = files
        .map(|f| f.path())
        .filter(|p| {
            let ending = p.extension().map(|e| e.to_ascii_lowercase());
            let is_caex = ending.is_some_and(|e| e == "aml" || e == "amlx");
            let is_library = p.file_name().is_some_and(|n| n == FAM_LIBRARY_FILE);
            (is_caex && !is_library || p.ends_with("cell.toml")) && p.is_file()
        })
        .map(|p| format!("`{}`", p.display()))
        .collect();
    models.sort();
    models
}

/// Where a model's references lead, and the model's own path from there.
fn files_of(model: ModelAt<'_>, own: String) -> Result<(ModelFiles, String), Box<Diagnostic>> {
    let Some(root) = model.root else {
        let folder = model.file.parent().unwrap_or(Path::new(""));
        return Ok((ModelFiles::within(folder), own));
    };
    match below(root, model.file) {
        Ok(Some(inside)) => Ok((ModelFiles::within(root), inside)),
        Ok(None) => Err(Box::new(
            file_error(
                "M104",
                model.file,
                format!("the model does not lie in the root `{}`", root.display()),
            )
            .hint("give as `--root` the folder that holds the model and all that it refers to"),
        )),
        Err(e) => Err(Box::new(
            file_error("M104", root, format!("the root cannot be used: {e}"))
                .hint("give as `--root` the folder that holds the model and all that it refers to"),
        )),
    }
}

/// Opens a model whose content is at hand; `model` says its name and where its other files are.
#[must_use]
pub fn open_bytes<'a>(model: impl Into<ModelAt<'a>>, bytes: &[u8]) -> Opened {
    let model = model.into();
    let path = model.file;
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
    let Some(text) = decoded(bytes.to_vec()) else {
        return Opened::failed(
            file_error(
                "M103",
                path,
                "the file is no text in UTF-8 or UTF-16".to_owned(),
            )
            .expected("an AutomationML model (.aml, .amlx) or a cell.toml"),
        );
    };
    if text.trim_start().starts_with('<') {
        let own = path
            .file_name()
            .map_or_else(|| name.clone(), |n| n.to_string_lossy().into_owned());
        return match files_of(model, own) {
            Ok((files, own)) => caex(files, &name, &own, text),
            Err(problem) => Opened::failed(*problem),
        };
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
    let files = match model.root {
        None => ModelFiles::anywhere(folder),
        Some(_) => match files_of(model, String::new()) {
            Ok((files, own)) => files.from(folder_of(&own)),
            Err(problem) => return Opened::failed(*problem),
        },
    };
    let text = ModelText::new(name, text);
    if text.text.trim().is_empty() {
        return Opened::failed(
            text.error("M101", 0..0, "the file is empty")
                .expected("an AutomationML model (.aml, .amlx) or a cell.toml"),
        );
    }
    let (file, problems) = match toml::from_str::<CellFile>(&text.text) {
        Ok(file) => (Some(file), Vec::new()),
        Err(e) => (None, vec![text.unreadable(&e)]),
    };
    Opened {
        file,
        text,
        files,
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
