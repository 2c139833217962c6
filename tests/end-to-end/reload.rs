//! `fam reload` on a running cell: changed logic comes in with its state, everything else runs on untouched.

mod support;

use support::{ImageCell, run, until};

/// A copy of the two-station cell that the test may edit.
fn a_copy() -> (tempfile::TempDir, String) {
    let source = support::project("engineering/tests/cells/two_stations");
    let dir = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(source).unwrap().flatten() {
        std::fs::copy(entry.path(), dir.path().join(entry.file_name())).unwrap();
    }
    let cell = dir.path().join("cell.toml").display().to_string();
    (dir, cell)
}

fn edit(dir: &tempfile::TempDir, file: &str, from: &str, to: &str) {
    let path = dir.path().join(file);
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains(from), "{file} has no `{from}`");
    std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
}

fn mc(cell: &ImageCell, mc: &str) -> serde_json::Value {
    until("the manager answers", || {
        let status = cell.status()?;
        let all = status["mcs"].as_array()?;
        all.iter().find(|m| m["mc"] == mc).cloned()
    })
}

/// A part goes through both stations, and the feeder waits again.
fn feed_one(cell: &ImageCell) {
    cell.set(&["RamUp=1", "PusherHome=1", "Weight=4000", "Start=1"]);
    cell.wait_point("Feeder.PusherExtend", "1");
    cell.set(&["Start=0", "PusherOut=1"]);
    cell.wait_point("Feeder.FedParts", "1");
    cell.wait_point("Press.LastWeight", "1");
    cell.set(&["PusherOut=0"]);
    cell.wait_point("Feeder.PartReady", "0");
}

#[test]
fn changed_logic_takes_over_the_state_while_the_rest_runs_on() {
    let (dir, path) = a_copy();
    let cell = ImageCell::start_with(path.clone());
    let mut nodes = ["controller1", "controller2"].map(|name| (name, cell.node(name)));
    for (name, _) in &nodes {
        until(&format!("{name} is up"), || {
            let status = cell.status()?;
            let all = status["controllers"].as_array()?;
            let this = all.iter().find(|c| c["controller"] == *name)?;
            (this["up"] == true).then_some(())
        });
    }
    for name in ["Feeder", "Press"] {
        until(&format!("{name} runs"), || cell.runs_on(name));
    }
    feed_one(&cell);
    let epochs = || ["Feeder", "Press"].map(|name| mc(&cell, name)["epoch"].as_u64().unwrap());
    let before = epochs();

    // One more variable, another computation.
    edit(
        &dir,
        "feeder.st",
        "    alarm : BOOL;",
        "    alarm : BOOL;\n    bonus : UINT := 1000;",
    );
    edit(
        &dir,
        "feeder.st",
        "FedParts := fed;",
        "FedParts := fed + bonus;",
    );
    let (code, out, err) = cell.try_operate(&["reload", "--dry-run"]);
    assert_eq!(code, 0, "{err}");
    for part in [
        "Feeder: changed (logic; state layout)",
        "starts from its initial value: Feeder.bonus",
        "Press: the same, runs on untouched",
    ] {
        assert!(out.contains(part), "`{part}` is not in: {out}");
    }
    assert_eq!(epochs(), before, "a look changes nothing");
    // Nobody to be asked: nothing happens.
    let (code, _, err) = cell.try_operate(&["reload"]);
    assert_ne!(code, 0);
    assert!(err.contains("--yes"), "{err}");
    assert_eq!(epochs(), before);

    let (code, out, err) = cell.try_operate(&["reload", "--yes"]);
    assert_eq!(code, 0, "{out}{err}");
    assert!(out.contains("the new version is in force: Feeder"), "{out}");
    cell.wait_point("Feeder.FedParts", "1001");
    let after = epochs();
    assert_eq!(
        after,
        [before[0] + 1, before[1]],
        "only the feeder has a new epoch"
    );

    // The other controller holds the new version too, and goes on from its state.
    until("both may run the new version", || {
        let status = cell.status()?;
        let all = status["controllers"].as_array()?;
        let fine = |c: &serde_json::Value| c["ineligible"].as_array().is_some_and(Vec::is_empty);
        all.iter().all(fine).then_some(())
    });
    let owner = cell.runs_on("Feeder").unwrap();
    let other = nodes.iter().find(|(name, _)| *name != owner).unwrap().0;
    let driving = nodes.iter_mut().find(|(name, _)| *name == owner);
    driving.unwrap().1.child.kill().unwrap();
    cell.wait_runs_on("Feeder", other);
    assert_eq!(cell.get("Feeder.FedParts").unwrap(), "1001");
    let args = [
        "watch",
        "Feeder.fed",
        "Feeder.bonus",
        "--csv",
        "--samples",
        "1",
    ];
    let place = ["--cell", path.as_str(), "--gateway", &cell.gateway_endpoint];
    let (code, out, err) = run(&[&args[..], &place[..]].concat());
    assert_eq!(code, 0, "{err}");
    assert!(out.trim_end().ends_with(",1,1000"), "{out}");
    // A second part, by the new logic.
    cell.set(&["PusherHome=1", "Start=1"]);
    cell.wait_point("Feeder.PusherExtend", "1");
    cell.set(&["Start=0", "PusherOut=1"]);
    cell.wait_point("Feeder.FedParts", "1002");

    // The gateway comes back with the new version on record.
    let mut cell = cell;
    cell.gateway.as_mut().unwrap().child.kill().unwrap();
    cell.start_gateway();
    until("the feeder runs again", || {
        (mc(&cell, "Feeder")["record"] == "open").then_some(())
    });
    cell.wait_point("Feeder.FedParts", "1002");
}

#[test]
fn what_cannot_change_while_the_cell_runs_is_refused_and_named() {
    let (dir, path) = a_copy();
    let cell = ImageCell::start_with(path);
    let _node = cell.node("controller1");
    cell.wait_runs_on("Feeder", "controller1");
    let epoch = mc(&cell, "Feeder")["epoch"].clone();
    edit(&dir, "cell.toml", "criticality = 2", "criticality = 3");
    let refused = |words: &[&str]| {
        let (code, out, err) = cell.try_operate(&["reload", "--yes"]);
        assert_ne!(code, 0, "{out}");
        for word in words {
            assert!(err.contains(word), "`{word}` is not in: {err}");
        }
    };
    refused(&[
        "controller1",
        "Feeder has another criticality",
        "started again",
    ]);
    edit(&dir, "cell.toml", "criticality = 3", "criticality = 2");
    edit(
        &dir,
        "feeder.st",
        "FedParts := fed;",
        "FedParts := nothing;",
    );
    refused(&["feeder.st", "nothing"]);
    assert_eq!(mc(&cell, "Feeder")["epoch"], epoch, "the feeder has run on");
    edit(
        &dir,
        "feeder.st",
        "FedParts := nothing;",
        "FedParts := fed;",
    );
    let (small, large) = (
        "    alarm : BOOL;",
        "    alarm : BOOL;\n    log : ARRAY[1..2000] OF LREAL;",
    );
    edit(&dir, "feeder.st", small, large);
    refused(&["the state of Feeder has grown to 16", "room for"]);
    edit(&dir, "feeder.st", large, small);
    let (code, out, err) = cell.try_operate(&["reload", "--yes"]);
    assert_eq!(code, 0, "{err}");
    assert!(out.contains("all MCs run this version already"), "{out}");
}
