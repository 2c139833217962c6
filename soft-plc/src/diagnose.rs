//! Everything that can be said about a project at once: what stops it, and what is probably wrong.

use std::collections::BTreeSet;

use crate::check::lint::lint;
use crate::check::{CheckOptions, check};
use crate::diag::{Diagnostic, Severity};
use crate::project::parse_project;
use crate::source::SourceFile;
use crate::standalone::{self, Options};

/// Codes of mistakes that may only follow from others: an unknown name whose declaration could not be read.
const CONSEQUENCES: [&str; 7] = ["E202", "E223", "E230", "E231", "E301", "E312", "E402"];

/// Errors first, then warnings, each in the order of the text.
///
/// After a mistake in the syntax of one POU the others are still checked; what may only follow from it is left out.
pub fn diagnose(files: &[SourceFile], options: CheckOptions) -> Vec<Diagnostic> {
    let (project, mut all) = parse_project(files);
    let broken = all.iter().any(|d| d.severity == Severity::Error);
    let broken_pous: BTreeSet<String> = all.iter().filter_map(|d| d.pou.clone()).collect();
    match check(project, options) {
        Err(found) if broken => all.extend(found.into_iter().filter(|d| {
            !CONSEQUENCES.contains(&d.code.as_str())
                && d.pou.as_ref().is_none_or(|p| !broken_pous.contains(p))
        })),
        Err(found) => all.extend(found),
        Ok(_) if broken => {}
        Ok(typed) => {
            all.extend(lint(&typed));
            let run = Options {
                program: None,
                check: options,
            };
            match standalone::prepare(files, &run) {
                Ok(prepared) => all.extend(prepared.warnings),
                // A library has no program to run.
                Err(found) => {
                    all.extend(found.into_iter().filter(|d| d.code != "E501"));
                    all.extend(typed.warnings);
                }
            }
        }
    }
    let mut seen: Vec<Diagnostic> = Vec::new();
    for diagnostic in all {
        // A program that runs several times is read several times, under other names.
        let is_known = seen.iter().any(|d| {
            let pou = d.pou.clone();
            *d == Diagnostic {
                pou,
                ..diagnostic.clone()
            }
        });
        if !is_known {
            seen.push(diagnostic);
        }
    }
    seen.sort_by(|a, b| {
        (a.severity, &a.file, a.line, a.column).cmp(&(b.severity, &b.file, b.line, b.column))
    });
    seen
}
