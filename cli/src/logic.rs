//! `fam check` of logic: Structured Text and PLCopen XML.

use crate::args::CheckArgs;
use crate::run::sources;
use anyhow::Result;
use fam_engineering::files::{FileKind, kind_of};
use fam_soft_plc::{CheckOptions, Diagnostic, Severity, SourceFile, diagnose};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Checks files of any kind. Texts are checked together, each XML project alone.
pub fn check(args: &CheckArgs) -> Result<bool> {
    let mut texts: Vec<PathBuf> = Vec::new();
    let mut projects: Vec<Vec<PathBuf>> = Vec::new();
    let mut fine = true;
    for path in &args.files {
        match kind_of(path) {
            FileKind::Model => fine &= crate::engineering::check(path, args.root.as_deref())?,
            FileKind::StructuredText => texts.push(path.clone()),
            FileKind::PlcopenXml => projects.push(vec![path.clone()]),
        }
    }
    if !texts.is_empty() {
        projects.insert(0, texts);
    }
    if projects.is_empty() {
        return Ok(fine);
    }
    let options = CheckOptions {
        dialect: args.dialect.into(),
        ..CheckOptions::default()
    };
    let mut all: Vec<Diagnostic> = Vec::new();
    for project in &projects {
        let files: Vec<SourceFile> = sources(project)?;
        all.extend(diagnose(&files, options));
    }
    let errors = all.iter().filter(|d| d.severity == Severity::Error).count();
    let warnings = all.len() - errors;
    if args.sarif {
        println!("{}", sarif(&all));
    } else if args.json {
        println!(
            "{}",
            json!({ "errors": errors, "warnings": warnings, "diagnostics": all })
        );
    } else {
        for diagnostic in &all {
            println!("{diagnostic}");
        }
        let count = |n: usize, word: &str| match n {
            0 => format!("no {word}s"),
            1 => format!("1 {word}"),
            n => format!("{n} {word}s"),
        };
        println!("{}, {}", count(errors, "error"), count(warnings, "warning"));
    }
    Ok(fine && errors == 0)
}

/// The diagnostics in the Static Analysis Results Interchange Format 2.1.0.
fn sarif(all: &[Diagnostic]) -> Value {
    let mut codes: Vec<&str> = all.iter().map(|d| d.code.as_str()).collect();
    codes.sort_unstable();
    codes.dedup();
    let rules: Vec<Value> = codes
        .iter()
        .map(|code| json!({ "id": code, "helpUri": format!("docs/diagnostics.md#{}", code.to_ascii_lowercase()) }))
        .collect();
    let results: Vec<Value> = all
        .iter()
        .map(|d| {
            let mut text = d.message.clone();
            if let Some(expected) = &d.expected {
                text.push_str(&format!("; expected: {expected}"));
            }
            if let Some(hint) = &d.hint {
                text.push_str(&format!("; hint: {hint}"));
            }
            let level = match d.severity {
                Severity::Error => "error",
                Severity::Warning => "warning",
            };
            let mut result = json!({
                "ruleId": d.code,
                "level": level,
                "message": { "text": text },
            });
            if !d.file.is_empty() {
                result["locations"] = json!([{
                    "physicalLocation": {
                        "artifactLocation": { "uri": d.file },
                        "region": {
                            "startLine": d.line,
                            "startColumn": d.column,
                            "endColumn": d.column + d.len,
                        }
                    },
                    "logicalLocations": d.pou.iter().map(|p| json!({ "name": p })).collect::<Vec<_>>(),
                }]);
            }
            result
        })
        .collect();
    json!({
        "$schema": "https://json.schemastore.org/sarif-2.1.0.json",
        "version": "2.1.0",
        "runs": [{
            "tool": { "driver": {
                "name": "fam check",
                "version": env!("CARGO_PKG_VERSION"),
                "rules": rules,
            } },
            "results": results,
        }]
    })
}
