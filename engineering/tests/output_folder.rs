//! What `fam generate` leaves in its folder: all of its files, or nothing of it.

mod common;

use std::collections::BTreeMap;
use std::path::Path;

use common::{changed, two_stations};
use fam_engineering::generate::Target;
use fam_engineering::output::write;

/// All files below the folder with their contents, hidden ones too.
fn tree(dir: &Path) -> BTreeMap<String, String> {
    let mut files = BTreeMap::new();
    let mut folders = vec![dir.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path
                    .strip_prefix(dir)
                    .unwrap()
                    .to_string_lossy()
                    .into_owned();
                files.insert(name, std::fs::read_to_string(&path).unwrap());
            }
        }
    }
    files
}

#[test]
fn a_failure_leaves_the_folder_as_it_was() {
    let (broken, built) = changed(&[("press.st", "END_PROGRAM", "nowhere := 1; END_PROGRAM")]);
    assert!(built.is_err());
    let model = broken.path().join("cell.toml");
    let out = tempfile::tempdir().unwrap();
    let fresh = out.path().join("deep/fresh");
    assert!(write(&model, Target::Fam, &fresh).is_err());
    assert!(!fresh.exists());

    let used = out.path().join("used");
    write(&two_stations(), Target::Fam, &used).expect("the cell is sound");
    std::fs::write(used.join("notes.txt"), "mine").unwrap();
    let before = tree(&used);
    assert!(write(&model, Target::Portable, &used).is_err());
    assert_eq!(tree(&used), before);
    assert!(
        tree(out.path())
            .keys()
            .all(|name| name.starts_with("used/"))
    );
}

#[test]
fn the_model_is_never_replaced_by_what_is_generated_from_it() {
    let (cell, built) = changed(&[]);
    built.expect("the cell is sound");
    let before = tree(cell.path());
    for place in [".", "sub/..", "sub/../sub/.."] {
        std::fs::create_dir_all(cell.path().join("sub")).unwrap();
        let Err(problems) = write(
            &cell.path().join("cell.toml"),
            Target::Fam,
            &cell.path().join(place),
        ) else {
            panic!("{place}: it was written over the model");
        };
        assert!(problems.to_string().contains("M602"), "{problems}");
    }
    // The model among generated files is one as well.
    let out = cell.path().join("out");
    write(&cell.path().join("cell.toml"), Target::Fam, &out).expect("a folder of its own");
    assert!(write(&out.join("model/cell.toml"), Target::Fam, &out).is_err());
    std::fs::remove_dir_all(&out).unwrap();
    assert_eq!(tree(cell.path()), before);
}

#[test]
fn what_is_in_the_way_is_named_before_anything_is_written() {
    let out = tempfile::tempdir().unwrap();
    let way = out.path().join("agents.toml");
    std::fs::create_dir(&way).unwrap();
    let Err(problems) = write(&two_stations(), Target::Fam, out.path()) else {
        panic!("a folder is in the way");
    };
    assert!(problems.to_string().contains("agents.toml"), "{problems}");
    assert_eq!(tree(out.path()), BTreeMap::new());
}

#[test]
fn a_second_generation_takes_the_place_of_the_first() {
    let out = tempfile::tempdir().unwrap();
    let (paths, _) = write(&two_stations(), Target::Fam, out.path()).expect("the cell is sound");
    let first = tree(out.path());
    assert_eq!(paths.len(), first.len());
    std::fs::write(out.path().join("agents.toml"), "changed by hand").unwrap();
    write(&two_stations(), Target::Fam, out.path()).expect("the cell is sound");
    assert_eq!(tree(out.path()), first);
}

#[test]
fn files_of_an_earlier_generation_are_named() {
    let out = tempfile::tempdir().unwrap();
    let (_, built) = write(&two_stations(), Target::Portable, out.path()).expect("a sound cell");
    let named = |built: &fam_engineering::BuiltCell| {
        let of_files = built.warnings.iter().find(|w| w.code == "W601");
        of_files.map(|w| w.message.clone())
    };
    assert_eq!(named(&built), None);
    for name in ["Gone.diagnosis.xml", "c9.xml", "notes.txt", "model/gone.st"] {
        std::fs::write(out.path().join(name), "old").unwrap();
    }
    let (_, built) = write(&two_stations(), Target::Fam, out.path()).expect("a sound cell");
    assert_eq!(
        named(&built).as_deref(),
        Some(
            "this model does not make `Gone.diagnosis.xml`, `c9.xml`, `model/gone.st` and `standard.st`"
        )
    );
    assert!(out.path().join("Gone.diagnosis.xml").exists());
}
