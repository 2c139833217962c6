//! Reads the files of a project into one syntax tree.

use std::sync::{Arc, LazyLock};

use crate::diag::{Diagnostic, finish_all};
use crate::plcopen;
use crate::source::{SourceFile, Sources};
use crate::syntax::ast::{Expr, Pou, Project};
use crate::syntax::parser::{parse_text, parse_whole_expression};

/// The standard function blocks, in Structured Text.
pub const STANDARD_LIBRARY: &str = include_str!("lib/standard.st");
/// Name of the standard library's text in messages.
pub const STANDARD_LIBRARY_NAME: &str = "standard.st (library)";

/// The standard library, read once: a text that stands before all others, and its POUs.
static LIBRARY: LazyLock<(Sources, Arc<Vec<Pou>>)> = LazyLock::new(|| {
    let mut sources = Sources::default();
    let source = sources.add(STANDARD_LIBRARY_NAME, STANDARD_LIBRARY);
    let mut project = Project::default();
    let problems = parse_text(source, STANDARD_LIBRARY, &mut project);
    assert!(problems.is_empty(), "the standard library: {problems:?}");
    (sources, Arc::new(project.pous))
});

/// Parses all files, Structured Text and PLCopen XML alike, together with the standard library. What could be read is in the
/// project even if there are problems.
pub fn parse_project(files: &[SourceFile]) -> (Project, Vec<Diagnostic>) {
    let (mut sources, library) = LIBRARY.clone();
    let mut project = Project {
        library,
        ..Project::default()
    };
    let mut problems = Vec::new();
    for file in files {
        let source = sources.add(&file.name, &file.text);
        if plcopen::is_xml(&file.text) {
            plcopen::read(&mut sources, source, &mut project, &mut problems);
        } else {
            problems.extend(parse_text(source, &file.text, &mut project));
        }
    }
    let diagnostics = finish_all(problems, &sources);
    project.sources = Arc::new(sources);
    (project, diagnostics)
}

/// Parses `text` as one expression, without looking up any name. `file` names the text in messages.
pub fn parse_expression(file: &str, text: &str) -> Result<Expr, Vec<Diagnostic>> {
    let mut sources = Sources::default();
    let source = sources.add(file, text);
    parse_whole_expression(source, text, 0).map_err(|problems| finish_all(problems, &sources))
}
