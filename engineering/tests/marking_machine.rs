//! The marking machine's cell: its two modifications as differences between versions, and the design rule of generalized actuators.

use fam_engineering::reload::{McChange, compare};
use fam_engineering::{BuiltCell, build};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A copy of the machine in which texts are replaced: file, what stands there, what is to stand there.
fn changed(changes: &[(&str, &str, &str)]) -> (TempDir, BuiltCell) {
    let deploy = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy");
    let dir = tempfile::tempdir().unwrap();
    for folder in ["lib", "marking-machine", "marking-machine/cell"] {
        std::fs::create_dir_all(dir.path().join(folder)).unwrap();
        for entry in std::fs::read_dir(deploy.join(folder)).unwrap() {
            let from: PathBuf = entry.unwrap().path();
            if !from.is_file() {
                continue;
            }
            let name = from.file_name().unwrap().to_str().unwrap();
            let mut text = std::fs::read_to_string(&from).unwrap();
            for (_, old, new) in changes.iter().filter(|(f, ..)| *f == name) {
                assert!(text.contains(old), "{name} does not contain {old:?}");
                text = text.replacen(old, new, 1);
            }
            std::fs::write(dir.path().join(folder).join(name), text).unwrap();
        }
    }
    let built = build(&dir.path().join("marking-machine/cell.toml"))
        .unwrap_or_else(|problems| panic!("{problems}"));
    (dir, built)
}

fn told(built: &BuiltCell) -> Vec<String> {
    let rules = built.warnings.iter();
    rules
        .filter(|w| w.code == "W810" || w.code == "W811")
        .map(ToString::to_string)
        .collect()
}

/// Each modification of the paper changes one component; all others run on untouched.
#[test]
fn each_modification_changes_one_component() {
    let (_dir, as_delivered) = changed(&[]);
    assert_eq!(told(&as_delivered), Vec::<String>::new());
    let table = [
        ("Pack", "\"pack_motion.st\"", "\"pack_motion_delayed.st\""),
        ("Policy", "\"policy.st\"", "\"policy_two_products.st\""),
    ];
    for (name, old, new) in table {
        let (_dir, modified) = changed(&[("cell.toml", old, new)]);
        for (mc, change) in compare(&as_delivered, &modified).mcs {
            if mc.as_str() == name {
                assert!(
                    matches!(change, McChange::Changed { .. }),
                    "{mc}: {change:?}"
                );
            } else {
                assert_eq!(change, McChange::Same, "{mc}");
            }
        }
        assert_eq!(told(&modified), Vec::<String>::new(), "{name}");
    }
}

/// File, text, and what stands there instead.
type Edit = (&'static str, &'static str, &'static str);

#[test]
fn a_drive_belongs_to_exactly_one_generalized_actuator() {
    let port = ", MotorPort => BeltMotorON";
    let table: [(&[Edit], &str); 4] = [
        (
            &[
                ("pack.st", port, ""),
                (
                    "pack.st",
                    "PackDoneOrder := ",
                    "BeltMotorON := orders.begin;\nPackDoneOrder := ",
                ),
            ],
            "warning[W810]: MC Pack: the drive `BeltMotorON` belongs to no generalized actuator",
        ),
        (
            &[
                (
                    "pack.st",
                    "  actuator : PackMotion;",
                    "  actuator, second : PackMotion;",
                ),
                (
                    "pack.st",
                    "PackDoneOrder := ",
                    "second(DoIt := FALSE, MotorPort => BeltMotorON);\nPackDoneOrder := ",
                ),
            ],
            "warning[W811]: MC Pack: the drive `BeltMotorON` belongs to 2 generalized actuators: Pack.actuator and Pack.second",
        ),
        (
            &[(
                "pack.st",
                "PackDoneOrder := ",
                "IF ResetFault THEN BeltMotorON := FALSE; END_IF;\nPackDoneOrder := ",
            )],
            "warning[W811]: MC Pack: the drive `BeltMotorON` belongs to the generalized actuator Pack.actuator, but Pack writes it too",
        ),
        // By an assignment it belongs to its actuator just as well.
        (
            &[
                ("pack.st", port, ""),
                (
                    "pack.st",
                    "PackDoneOrder := ",
                    "BeltMotorON := actuator.MotorPort;\nPackDoneOrder := ",
                ),
            ],
            "",
        ),
    ];
    for (changes, message) in table {
        let (_dir, built) = changed(changes);
        let told = told(&built);
        if message.is_empty() {
            assert_eq!(told, Vec::<String>::new());
        } else {
            assert_eq!(told.len(), 1, "{told:?}");
            assert!(
                told[0].contains(message),
                "expected `{message}` in:\n{}",
                told[0]
            );
        }
    }
}
