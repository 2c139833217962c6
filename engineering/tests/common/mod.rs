//! Cells for tests: the shipped one, and changed copies of it.
#![allow(dead_code)]

use fam_engineering::build::{BuiltMc, compile_sources};
use fam_engineering::generate::Names;
use fam_engineering::plcopen::{mc_source, project_xml};
use fam_engineering::{BuiltCell, Problems, build};
use fam_soft_plc::layout::{CompileSpec, RegionSpec};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

pub fn two_stations() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cells/two_stations/cell.toml")
}

/// A copy of the two stations in which texts are replaced: file, what stands there, what is to stand there.
pub fn changed(changes: &[(&str, &str, &str)]) -> (TempDir, Result<BuiltCell, Problems>) {
    let dir = tempfile::tempdir().unwrap();
    let folder = two_stations().parent().unwrap().to_owned();
    for file in ["cell.toml", "feeder.st", "press.st"] {
        let mut text = std::fs::read_to_string(folder.join(file)).unwrap();
        for (_, old, new) in changes.iter().filter(|(f, ..)| *f == file) {
            assert!(text.contains(old), "{file} does not contain {old:?}");
            text = text.replacen(old, new, 1);
        }
        std::fs::write(dir.path().join(file), text).unwrap();
    }
    let built = build(&dir.path().join("cell.toml"));
    (dir, built)
}

/// A cell of one MC named `M` on one controller with the `image` driver.
pub fn one_mc(logic: &str, extra: &str) -> (TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let cell = format!(
        "format = 1\n[cell]\nname = \"one\"\n[[gateway]]\nname = \"g\"\ndriver = \"image\"\n\
         [[controller]]\nname = \"c\"\n[[mc]]\nname = \"M\"\nlogic = [\"m.st\"]\ngateway = \"g\"\n\
         hosts = \"all\"\nworst_case_us = 10\n{extra}"
    );
    std::fs::write(dir.path().join("cell.toml"), cell).unwrap();
    std::fs::write(dir.path().join("m.st"), logic).unwrap();
    let path = dir.path().join("cell.toml");
    (dir, path)
}

/// One change of the two-station cell, and parts of the message that it must lead to.
pub struct Case {
    pub name: &'static str,
    pub changes: &'static [(&'static str, &'static str, &'static str)],
    pub message: &'static [&'static str],
}

/// Holds every case against what is said; all failures at once.
pub fn hold(cases: &[Case]) {
    let mut failures = String::new();
    for case in cases {
        let (_dir, built) = changed(case.changes);
        let problems = match built {
            Ok(_) => {
                failures.push_str(&format!("{}: was built\n", case.name));
                continue;
            }
            Err(problems) => problems.to_string(),
        };
        for part in case.message {
            if !problems.contains(part) {
                failures.push_str(&format!(
                    "{}: expected `{part}` in:\n{problems}\n\n",
                    case.name
                ));
            }
        }
    }
    assert!(failures.is_empty(), "{failures}");
}

/// The specification that the MC was compiled with, from its layout.
pub fn spec(mc: &BuiltMc) -> CompileSpec {
    let names = Names::of(mc.mc.as_str());
    let layout = &mc.compiled.layout;
    let roots = |region: &str| {
        let index = layout.region_index(region).unwrap();
        let (mut programs, mut globals) = (Vec::<String>::new(), Vec::new());
        for root in &layout.roots {
            if root.area != fam_soft_plc::layout::Area::Region(index) {
                continue;
            }
            match root.path.split_once('.') {
                Some((program, _)) if !programs.iter().any(|p| p == program) => {
                    programs.push(program.to_owned())
                }
                Some(_) => {}
                None => globals.push(root.path.clone()),
            }
        }
        RegionSpec {
            name: region.to_owned(),
            programs,
            globals,
            markers: region == "state",
        }
    };
    CompileSpec {
        entry: names.control,
        regions: vec![roots("checkpoint"), roots("state")],
        ..CompileSpec::default()
    }
}

/// Every MC, taken out of the project of each of its hosts, is the same MC.
pub fn read_back(built: &BuiltCell) {
    for controller in &built.model.controllers {
        let project = project_xml(built, &controller.controller);
        for mc in &built.mcs {
            let hosts = &built.model.mc(&mc.mc).unwrap().hosts;
            if !hosts.contains(&controller.controller) {
                assert!(mc_source(&project, mc.mc.as_str()).is_err());
                continue;
            }
            let source = mc_source(&project, mc.mc.as_str()).unwrap();
            let again = compile_sources(&[source], &spec(mc)).unwrap_or_else(|problems| {
                let texts: Vec<String> = problems.iter().map(ToString::to_string).collect();
                panic!(
                    "{} of {}: {}",
                    mc.mc,
                    controller.controller,
                    texts.join("\n")
                )
            });
            assert_eq!(
                again.layout.hash(),
                mc.compiled.layout.hash(),
                "layout of {}",
                mc.mc
            );
            assert_eq!(
                again.logic_hash, mc.compiled.logic_hash,
                "logic of {}",
                mc.mc
            );
        }
    }
}
