//! Every problem that a model can have, with its whole message: what, where (file, line, element), what was expected, what to do.
//!
//! The cases stand in `cases/`, what is said of them in `said.txt`. `FAM_RENEW=1 cargo test -p fam-engineering --test problems` writes that
//! file anew; `git diff` then shows what people will read differently.

mod base;
mod cases;

use fam_engineering::build::build_for;
use fam_engineering::files::ModelAt;
use fam_engineering::generate::Target;
use fam_engineering::output::write;
use fam_engineering::{DeploymentFile, Problems, build, write_projects};
use fam_soft_plc::diag::{Diagnostic, Severity};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Writes files with changes.
fn changed(name: &str, files: &[(&str, &str)], changes: &[cases::Change]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (file, text) in files {
        let mut text = (*text).to_owned();
        for (_, old, new) in changes.iter().filter(|(f, ..)| f == file) {
            assert!(
                text.contains(old),
                "{name}: {file} does not contain {old:?}"
            );
            text = text.replacen(old, new, 1);
        }
        std::fs::write(dir.path().join(file), text).unwrap();
    }
    for (file, _, text) in changes {
        if !files.iter().any(|(f, _)| f == file) {
            std::fs::write(dir.path().join(file), text).unwrap();
        }
    }
    dir
}

/// All problems of a model; none is no case.
fn of_model(name: &str, dir: &Path, model: &str, target: Target) -> Vec<Diagnostic> {
    let found = match build_for(&dir.join(model), target) {
        Ok(built) => built.warnings,
        Err(Problems { list }) => list,
    };
    assert!(!found.is_empty(), "{name}: there is no problem");
    found
}

/// All cases: name and problems, their places relative to the model.
fn all() -> Vec<(String, Vec<Diagnostic>)> {
    let mut all = Vec::new();
    for (kind, model, files, cases, target) in [
        ("toml", "cell.toml", base::TOML, cases::TOML, Target::Fam),
        ("caex", "cell.aml", base::CAEX, cases::CAEX, Target::Fam),
        (
            "portable",
            "cell.toml",
            base::TOML,
            cases::PORTABLE,
            Target::Portable,
        ),
    ] {
        for (name, changes) in cases.iter().copied().flatten() {
            let name = format!("{kind}: {name}");
            let dir = changed(&name, files, changes);
            let found = of_model(&name, dir.path(), model, target);
            all.push((name, relative(found, dir.path())));
        }
    }
    for (name, old, new) in cases::DEPLOYMENT {
        let name = format!("deployment: {name}");
        let dir = changed(&name, base::TOML, &[]);
        let cell = build(&dir.path().join("cell.toml")).unwrap().model;
        assert!(base::DEPLOYMENT.contains(old), "{name}");
        let text = base::DEPLOYMENT.replacen(old, new, 1);
        let found = DeploymentFile::parse("deployment.toml", text, PathBuf::new())
            .and_then(|file| file.resolve(&cell))
            .expect_err(&name);
        all.push((name, found.list));
    }
    all.extend(files());
    all
}

/// Problems of files as such.
fn files() -> Vec<(String, Vec<Diagnostic>)> {
    let dir = changed("files", base::TOML, &[]);
    let at = |name: &str| dir.path().join(name);
    std::fs::write(at("cell.amlx"), "PK no container").unwrap();
    std::fs::write(at("latin1.aml"), b"<CAEXFile Name=\"\xe4\"/>").unwrap();
    let large = std::fs::File::create(at("large.aml")).unwrap();
    large.set_len(300 << 20).unwrap();
    let mut all: Vec<(String, Vec<Diagnostic>)> =
        ["none.aml", "latin1.aml", "large.aml", "cell.amlx"]
            .iter()
            .map(|name| {
                let found = of_model(name, dir.path(), name, Target::Fam);
                (format!("file: {name}"), relative(found, dir.path()))
            })
            .collect();
    for (name, root) in [
        ("a root beside the model", "other"),
        ("a root that is not there", "none"),
    ] {
        std::fs::create_dir_all(at("other")).unwrap();
        let (file, root) = (at("cell.toml"), at(root));
        let found = build(ModelAt {
            file: &file,
            root: Some(&root),
        })
        .expect_err(name)
        .list;
        all.push((format!("file: {name}"), relative(found, dir.path())));
    }
    let built = build(&at("cell.toml")).unwrap();
    for (name, place) in [
        ("a folder that cannot be made", "cell.toml/out"),
        ("a file that cannot be written", "out"),
    ] {
        std::fs::create_dir_all(at("out/c1.xml")).unwrap();
        let found = write_projects(&built, &at(place)).expect_err(name).list;
        all.push((format!("file: {name}"), relative(found, dir.path())));
    }
    let Err(Problems { list }) = write(&at("cell.toml"), Target::Fam, dir.path()) else {
        panic!("the model was written over");
    };
    let list = list.into_iter().map(|d| Diagnostic {
        file: ".".into(),
        ..d
    });
    all.push(("file: a folder that holds the model".into(), list.collect()));
    std::fs::create_dir_all(at("used")).unwrap();
    std::fs::write(at("used/c9.xml"), "old").unwrap();
    let (_, built) = write(&at("cell.toml"), Target::Fam, &at("used")).unwrap();
    let of_files = built.warnings.into_iter().filter(|w| w.code == "W601");
    all.push((
        "file: a folder with files of before".into(),
        relative(of_files.collect(), dir.path()),
    ));
    all
}

fn relative(found: Vec<Diagnostic>, dir: &Path) -> Vec<Diagnostic> {
    let dir = format!("{}/", dir.display());
    let short = |text: String| text.replace(&dir, "");
    found
        .into_iter()
        .map(|d| Diagnostic {
            file: short(d.file),
            message: short(d.message),
            ..d
        })
        .collect()
}

/// Codes of the model that the sources name, without those of their tests.
fn codes_of_the_sources() -> BTreeSet<String> {
    let mut codes = BTreeSet::new();
    let mut todo = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("src")];
    while let Some(path) = todo.pop() {
        if path.is_dir() {
            let inner = std::fs::read_dir(&path).unwrap();
            todo.extend(inner.map(|entry| entry.unwrap().path()));
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
        let text = text.split("#[cfg(test)]").next().unwrap_or("");
        for word in text.split('"') {
            let is_code = word.len() == 4
                && word.starts_with(['M', 'W'])
                && word[1..].chars().all(|c| c.is_ascii_digit());
            if is_code {
                codes.insert(word.to_owned());
            }
        }
    }
    codes
}

#[test]
fn each_problem_is_told_in_these_words() {
    let mut said = String::new();
    for (name, found) in all() {
        let _ = writeln!(said, "## {name}\n");
        for problem in found {
            let _ = writeln!(said, "{problem}");
        }
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/problems/said.txt");
    if std::env::var_os("FAM_RENEW").is_some() {
        std::fs::write(&path, &said).unwrap();
    }
    let kept = std::fs::read_to_string(&path).unwrap();
    let sections = |text: &str| -> Vec<String> { text.split("## ").map(str::to_owned).collect() };
    let (said, kept) = (sections(&said), sections(&kept));
    let changed: Vec<String> = said
        .iter()
        .filter(|s| !kept.contains(s))
        .map(|s| format!("not in said.txt: ## {s}"))
        .chain(
            kept.iter()
                .filter(|k| !said.contains(k))
                .map(|k| format!("no longer said: ## {k}")),
        )
        .collect();
    assert!(changed.is_empty(), "{}", changed.join("\n"));
}

#[test]
fn each_code_of_the_sources_is_among_them() {
    let said: BTreeSet<String> = all()
        .into_iter()
        .flat_map(|(_, found)| found)
        .map(|d| d.code)
        .collect();
    let codes = codes_of_the_sources();
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/diagnostics.md");
    let page = std::fs::read_to_string(page).unwrap();
    for code in &codes {
        assert!(
            page.contains(&format!(
                "<a id=\"{}\"></a>{code}",
                code.to_ascii_lowercase()
            )),
            "docs/diagnostics.md does not list {code}"
        );
    }
    let missing: Vec<String> = codes.difference(&said).cloned().collect();
    assert!(
        missing.is_empty(),
        "no case leads to {}",
        missing.join(", ")
    );
}

#[test]
fn each_problem_says_where_and_what_to_do() {
    let mut poor = Vec::new();
    for (name, found) in all() {
        for problem in found {
            let is_of_the_model = problem.code.starts_with('M');
            let in_element = !problem.file.ends_with(".aml")
                || problem.pou.is_some()
                // Of the file as a whole, which has no elements.
                || ["M103", "M801", "M802", "M804", "M805", "M807", "W809"].contains(&problem.code.as_str());
            let helps = problem.expected.is_some() || problem.hint.is_some();
            let has_place = !problem.file.is_empty() && problem.line > 0;
            if is_of_the_model && !(in_element && helps && has_place) {
                poor.push(format!("{name}: {problem}"));
            }
            assert!(
                problem.severity == Severity::Error || !problem.code.starts_with('M'),
                "{problem}"
            );
        }
    }
    assert!(poor.is_empty(), "{}", poor.join("\n"));
}
