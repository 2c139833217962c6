//! `fam convert`: a model from one form into the other, with its logic.
//!
//! AutomationML refers to PLCopen XML, so that Structured Text becomes that on the way there; a `cell.toml` takes either.

use crate::caex::{FAM_LIBRARY, FAM_LIBRARY_FILE, write as caex_write};
use crate::files::{ModelAt, ModelFiles};
use crate::model::open::{Opened, open};
use crate::model::toml_file::CellFile;
use crate::model::toml_text;
use crate::plcopen::logic_file;
use crate::problem::{Explain, Problems, file_error};
use fam_soft_plc::diag::{Diagnostic, Severity};
use fam_soft_plc::project::parse_project;
use fam_soft_plc::source::SourceFile;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use toml::Spanned;

/// A model in another form: the files to write, by their path from the model's new folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Converted {
    /// Path and content.
    pub files: BTreeMap<String, String>,
    /// What was assumed on the way.
    pub warnings: Vec<Diagnostic>,
}

/// Form of a model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Form {
    /// AutomationML, with the path of FAM's library if it is not to be written beside it.
    Caex {
        /// Such as `../lib/FAM.aml`.
        library: Option<String>,
    },
    /// `cell.toml`.
    Toml,
}

/// Reads a model and gives it in another form, under `file_name`.
///
/// # Errors
/// [`Problems`] of reading it, and of its logic where that has to be rewritten.
pub fn convert<'a>(
    from: impl Into<ModelAt<'a>>,
    file_name: &str,
    form: &Form,
) -> Result<Converted, Problems> {
    let Opened {
        file,
        files,
        mut problems,
        ..
    } = open(from);
    let Some(mut file) = file else {
        return Err(Problems { list: problems });
    };
    let mut written = match form {
        Form::Caex { .. } => as_plcopen(&mut file, &files, &mut problems),
        Form::Toml => as_they_are(&mut file, &files, &mut problems),
    };
    if problems.iter().any(|p| p.severity == Severity::Error) {
        return Err(Problems { list: problems });
    }
    let text = match form {
        Form::Caex { library } => {
            if library.is_none() {
                written.insert(FAM_LIBRARY_FILE.to_owned(), FAM_LIBRARY.to_owned());
            }
            model_text(&file, &written, file_name, library.as_deref())
        }
        Form::Toml => toml_text::write(&file),
    };
    written.insert(file_name.to_owned(), text);
    Ok(Converted {
        files: written,
        warnings: problems,
    })
}

/// An AutomationML model of tables whose logic is at hand.
#[must_use]
pub fn model_text(
    file: &CellFile,
    logic: &BTreeMap<String, String>,
    file_name: &str,
    library: Option<&str>,
) -> String {
    let pous: BTreeMap<&str, BTreeSet<String>> = logic
        .iter()
        .map(|(name, text)| {
            let (project, _) = parse_project(&[SourceFile::new(name.as_str(), text.as_str())]);
            let names = project
                .pous
                .iter()
                .map(|p| p.name.name.to_ascii_uppercase());
            (name.as_str(), names.collect())
        })
        .collect();
    let file_of = |files: &[Spanned<String>], pou: &str| {
        let pou = pou.to_ascii_uppercase();
        files
            .iter()
            .map(Spanned::get_ref)
            .find(|f| {
                pous.get(f.as_str())
                    .is_some_and(|names| names.contains(&pou))
            })
            .cloned()
    };
    caex_write::write(
        file,
        &caex_write::Setting {
            file_name,
            library: library.unwrap_or(FAM_LIBRARY_FILE),
            file_of: &file_of,
        },
    )
}

/// Calls `change` with each logic file of the model once, and puts the new names into the tables.
fn each_file(
    file: &mut CellFile,
    files: &ModelFiles,
    problems: &mut Vec<Diagnostic>,
    mut change: impl FnMut(&str, String, &mut Vec<Diagnostic>) -> (String, String),
) -> BTreeMap<String, String> {
    let mut written = BTreeMap::new();
    let mut names: BTreeMap<String, String> = BTreeMap::new();
    let mut failed: BTreeSet<String> = BTreeSet::new();
    for mc in &mut file.mc {
        let mut table = mc.get_ref().logic.get_ref().clone();
        for reference in &mut table {
            let old = reference.get_ref().clone();
            if !names.contains_key(&old) && !failed.contains(&old) {
                match files.read(&old) {
                    Ok(text) => {
                        let (new, text) = change(&old, text, problems);
                        names.insert(old.clone(), new.clone());
                        written.insert(new, text);
                    }
                    Err(e) => {
                        failed.insert(old.clone());
                        problems.push(
                            file_error("M209", Path::new(&old), e.to_string()).hint(e.hint()),
                        );
                    }
                }
            }
            if let Some(new) = names.get(&old) {
                *reference = Spanned::new(reference.span(), new.clone());
            }
        }
        let mc = mc.get_mut();
        mc.logic = Spanned::new(mc.logic.span(), table);
    }
    written
}

fn as_they_are(
    file: &mut CellFile,
    files: &ModelFiles,
    problems: &mut Vec<Diagnostic>,
) -> BTreeMap<String, String> {
    let mut taken = BTreeSet::new();
    each_file(file, files, problems, |old, text, _| {
        (free_name(&inside(old), &mut taken), text)
    })
}

fn as_plcopen(
    file: &mut CellFile,
    files: &ModelFiles,
    problems: &mut Vec<Diagnostic>,
) -> BTreeMap<String, String> {
    let mut taken = BTreeSet::new();
    each_file(file, files, problems, |old, text, problems| {
        let name = inside(old);
        if text.trim_start().starts_with('<') {
            let name = match name.strip_suffix(".xml") {
                Some(_) => name,
                None => format!("{name}.xml"),
            };
            return (free_name(&name, &mut taken), text);
        }
        let sources = [SourceFile::new(old, text)];
        let (project, found) = parse_project(&sources);
        problems.extend(found);
        let stem = name.strip_suffix(".st").unwrap_or(&name).to_owned();
        let title = stem.rsplit('/').next().unwrap_or(&stem);
        let xml = logic_file::write(title, &project, &sources, None);
        (free_name(&format!("{stem}.xml"), &mut taken), xml)
    })
}

/// A path below the model: one from elsewhere keeps its last part, made ones lose what no file name has.
fn inside(path: &str) -> String {
    let path = path.replace(" (", "_").replace([')', ' '], "");
    match crate::files::join("", &path) {
        Ok(path) => path,
        Err(_) => path
            .rsplit(['/', '\\'])
            .next()
            .unwrap_or("logic")
            .to_owned(),
    }
}

fn free_name(name: &str, taken: &mut BTreeSet<String>) -> String {
    let mut free = name.to_owned();
    let mut number = 2;
    while !taken.insert(free.clone()) {
        let (stem, ending) = name.rsplit_once('.').unwrap_or((name, "xml"));
        free = format!("{stem}_{number}.{ending}");
        number += 1;
    }
    free
}

/// A file or folder that cannot be written.
pub(crate) fn not_written(path: &Path, e: &std::io::Error) -> Diagnostic {
    let in_the_way = path.ancestors().skip(1).find(|p| p.is_file());
    match in_the_way {
        Some(file) => {
            let message = format!("it cannot be written: {} is a file, no folder", file.display());
            file_error("M601", path, message).hint("give another folder")
        }
        None => file_error("M601", path, format!("it cannot be written: {e}"))
            .hint("give a folder that can be written, and that has no folder or file of another kind by this name"),
    }
}

/// Writes files below a folder, which is made if needed.
///
/// # Errors
/// [`Problems`] if one cannot be written.
pub fn write_files(files: &BTreeMap<String, String>, dir: &Path) -> Result<Vec<PathBuf>, Problems> {
    let mut list = Vec::new();
    for (name, text) in files {
        let path = dir.join(name);
        let failed = |e: std::io::Error| Problems::one(not_written(&path, &e));
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(failed)?;
        }
        std::fs::write(&path, text).map_err(failed)?;
        list.push(path);
    }
    Ok(list)
}
