//! An MC whose checkpoint is longer than one message, with real processes: it fails over, moves, and comes back from the
//! gateway's record as any other.

mod support;

use support::{Fam, ImageCell, until};

fn scans(cell: &ImageCell) -> Option<u32> {
    cell.get("Archive.Scans")?.parse().ok()
}

fn wait_scans(cell: &ImageCell, least: u32) -> u32 {
    until(&format!("Archive has made {least} scans"), || {
        scans(cell).filter(|scans| *scans >= least)
    })
}

/// Until a controller could take it over: what it holds is near the head.
fn wait_holds(cell: &ImageCell, controller: &str) {
    until(&format!("{controller} holds a checkpoint"), || {
        let status = cell.status()?;
        let all = status["controllers"].as_array()?;
        let this = all.iter().find(|c| c["controller"] == controller)?.clone();
        (this["up"] == true && this["report"]["image_age_us"].as_u64()? < 1_000_000).then_some(())
    });
}

fn kill(mut node: Fam) {
    node.child.kill().unwrap();
    let _ = node.child.wait();
}

#[test]
fn a_state_longer_than_a_message_survives_crashes_moves_and_the_gateways_restart() {
    let path = support::project("tests/end-to-end/cells/large_state/cell.toml");
    let mut cell = ImageCell::start_with(path.display().to_string());
    let first = cell.node("controller1");
    cell.wait_runs_on("Archive", "controller1");
    let before = wait_scans(&cell, 3);

    // A second controller comes late, while everything changes in every scan: each frame goes in pieces.
    cell.set(&["Rewrite=1"]);
    let second = cell.node("controller2");
    wait_holds(&cell, "controller2");
    let before = wait_scans(&cell, before + 4);
    kill(first);
    cell.wait_runs_on("Archive", "controller2");
    let before = wait_scans(&cell, before + 3);

    // One that has nothing gets the state with the answer to its open, or with the frames before it.
    let first = cell.node("controller1");
    wait_holds(&cell, "controller1");
    cell.set(&["Rewrite=0"]);
    cell.operate(&["move", "Archive", "--to", "controller1"]);
    cell.wait_runs_on("Archive", "controller1");
    let before = wait_scans(&cell, before + 3);

    // Both controllers end, and one without memory takes the MC from the gateway's record.
    drop(second);
    kill(first);
    let stood = wait_scans(&cell, before);
    let last = cell.node("controller2");
    let before = wait_scans(&cell, stood + 2);

    // And the gateway itself.
    let mut gateway = cell.gateway.take().unwrap();
    gateway.child.kill().unwrap();
    gateway.child.wait().unwrap();
    cell.start_gateway();
    wait_scans(&cell, before + 2);
    assert_eq!(cell.get("Archive.Broken").as_deref(), Some("0"));
    let status = cell.status().unwrap();
    assert_eq!(status["mcs"][0]["record"], "open", "{status}");
    drop(last);
}
