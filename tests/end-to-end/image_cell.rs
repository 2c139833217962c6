//! A small cell on the `image` driver, with real processes: operators' commands, crashes, traps, clean ends.

mod support;

use support::{ImageCell, until};

/// Up, with reports: it can take MCs.
fn wait_up(cell: &ImageCell, controller: &str) {
    until(&format!("{controller} is up"), || {
        let status = cell.status()?;
        let c = status["controllers"]
            .as_array()?
            .iter()
            .find(|c| c["controller"] == controller)?
            .clone();
        let image_seen = c["report"]["image_age_us"].as_u64()? < 1_000_000;
        (c["up"] == true && image_seen).then_some(())
    });
}

#[test]
fn mcs_are_placed_moved_drained_and_survive_a_crash() {
    let cell = ImageCell::start();
    let mut first = cell.node("controller1");
    for mc in ["Feeder", "Press"] {
        cell.wait_runs_on(mc, "controller1");
    }
    let mut second = cell.node("controller2");
    wait_up(&cell, "controller2");
    cell.operate(&["move", "Feeder", "--to", "controller2"]);
    cell.wait_runs_on("Feeder", "controller2");
    cell.operate(&["pin", "Feeder"]);
    let epoch = |mc: &str| {
        let status = cell.status().unwrap();
        status["mcs"]
            .as_array()
            .unwrap()
            .iter()
            .find(|m| m["mc"] == mc)
            .unwrap()["epoch"]
            .as_u64()
            .unwrap()
    };
    let before = epoch("Feeder");
    second.child.kill().unwrap();
    cell.wait_runs_on("Feeder", "controller1");
    assert!(epoch("Feeder") > before, "a failover has a new epoch");
    cell.operate(&["unpin", "Feeder"]);

    let third = cell.node("controller2");
    wait_up(&cell, "controller2");
    cell.operate(&["drain", "controller1"]);
    for mc in ["Feeder", "Press"] {
        cell.wait_runs_on(mc, "controller2");
    }
    assert!(
        first.terminate().success(),
        "a drained node ends cleanly:\n{}",
        first.text()
    );
    drop(third);
}

/// What the generated Control POU is for: the new owner recovers the interrupted interval first, and goes on from the state
/// that was applied last. A Control that forgets `wasActive` runs the logic at once, or never gets out of the recovery.
#[test]
fn an_interrupted_interval_is_recovered_first_and_the_state_goes_on() {
    let cell = ImageCell::start();
    let mut nodes = ["controller1", "controller2"].map(|name| (name, cell.node(name)));
    wait_up(&cell, "controller1");
    wait_up(&cell, "controller2");
    let owner = until("Feeder runs", || cell.runs_on("Feeder"));
    cell.set(&["RamUp=1", "PusherHome=1", "Weight=4000", "Start=1"]);
    cell.wait_point("Feeder.PusherExtend", "1");
    cell.set(&["Start=0", "PusherOut=1"]);
    cell.wait_point("Feeder.FedParts", "1");
    cell.wait_point("Press.LastWeight", "1");
    // The second part: the pusher is under way when its controller dies.
    cell.set(&["PusherOut=0", "Start=1"]);
    cell.wait_point("Feeder.PusherExtend", "1");
    cell.set(&["PusherHome=0"]);
    let driving = nodes.iter_mut().find(|(name, _)| *name == owner);
    driving.unwrap().1.child.kill().unwrap();
    cell.wait_point("Feeder.PusherExtend", "0");
    assert_ne!(cell.runs_on("Feeder").unwrap(), owner);
    assert_eq!(
        cell.get("Feeder.FedParts").unwrap(),
        "1",
        "nothing is forgotten"
    );
    cell.set(&["PusherHome=1"]);
    cell.wait_point("Feeder.PusherExtend", "1");
    cell.set(&["Start=0", "PusherOut=1"]);
    cell.wait_point("Feeder.FedParts", "2");
}

#[test]
fn a_stopped_mc_stays_stopped_until_its_reset() {
    let cell = ImageCell::start();
    let _node = cell.node("controller1");
    cell.wait_runs_on("Feeder", "controller1");
    cell.set(&["PusherHome=1", "PusherOut=1", "Start=1"]);
    cell.wait_point("Feeder.FedParts", "1");
    cell.set(&["Start=0", "PusherOut=0"]);
    let stop = || {
        cell.operate(&["stop", "Feeder"]);
        until("Feeder is stopped", || {
            let status = cell.status()?;
            let mcs = status["mcs"].as_array()?;
            let feeder = mcs.iter().find(|m| m["mc"] == "Feeder")?;
            (feeder["record"] == "stopped").then_some(())
        });
    };
    stop();
    let (code, _, err) = cell.try_operate(&["move", "Feeder", "--to", "controller1"]);
    assert_ne!(code, 0);
    assert!(err.contains("reset"), "the refusal says what to do: {err}");
    cell.wait_point("Feeder.PartReady", "0");
    // Warm: what is retained (the count) stays, the step (a part on offer) does not.
    cell.operate(&["reset", "Feeder", "--warm"]);
    cell.wait_runs_on("Feeder", "controller1");
    cell.set(&["Start=1"]);
    cell.wait_point("Feeder.PusherExtend", "1");
    assert_eq!(cell.get("Feeder.FedParts").unwrap(), "1");
    stop();
    cell.operate(&["reset", "Feeder", "--cold"]);
    cell.wait_runs_on("Feeder", "controller1");
    cell.wait_point("Feeder.FedParts", "0");
}

#[test]
fn every_process_ends_cleanly_on_sigterm_and_a_node_hands_over_first() {
    let mut cell = ImageCell::start();
    let mut first = cell.node("controller1");
    cell.wait_runs_on("Press", "controller1");
    let mut second = cell.node("controller2");
    until("controller2 is up", || {
        let status = cell.status()?;
        status["controllers"]
            .as_array()?
            .iter()
            .find(|c| c["controller"] == "controller2" && c["up"] == true)
            .map(|_| ())
    });
    assert!(first.terminate().success(), "{}", first.text());
    // Handed over, not failed over: the new owner runs before the old one is gone.
    for mc in ["Feeder", "Press"] {
        cell.wait_runs_on(mc, "controller2");
    }
    let events = cell.operate(&["events", "--json"]);
    assert!(
        events.lines().any(|e| e.contains("mc-released")),
        "{events}"
    );
    assert!(second.terminate().success(), "{}", second.text());
    assert!(cell.manager.take().unwrap().terminate().success());
    assert!(cell.gateway.take().unwrap().terminate().success());
}

#[test]
fn manager_and_gateway_can_be_killed_and_started_again() {
    let mut cell = ImageCell::start();
    let _first = cell.node("controller1");
    cell.wait_runs_on("Press", "controller1");
    let scan = |cell: &ImageCell| {
        let status = cell.status().unwrap();
        status["mcs"]
            .as_array()
            .unwrap()
            .iter()
            .find(|m| m["mc"] == "Press")
            .map(|m| (m["epoch"].as_u64().unwrap(), m["scan"].as_u64().unwrap()))
            .unwrap()
    };
    let (epoch, before) = scan(&cell);
    cell.manager.as_mut().unwrap().child.kill().unwrap();
    cell.start_manager();
    cell.wait_runs_on("Press", "controller1");
    let (same, after) = scan(&cell);
    assert_eq!(same, epoch, "a new manager takes the plant as it finds it");
    assert!(after > before);

    cell.gateway.as_mut().unwrap().child.kill().unwrap();
    cell.start_gateway();
    until("Press runs again, from its record", || {
        let status = cell.status()?;
        let press = status["mcs"]
            .as_array()?
            .iter()
            .find(|m| m["mc"] == "Press")?
            .clone();
        (press["record"] == "open"
            && press["epoch"].as_u64()? > epoch
            && press["scan"].as_u64()? > after)
            .then_some(())
    });
}

#[test]
fn points_are_set_and_read_as_csv() {
    let cell = ImageCell::start();
    let _node = cell.node("controller1");
    cell.wait_runs_on("Feeder", "controller1");
    let (code, out, err) = cell.io(&["get"]);
    assert_eq!(code, 0, "{err}");
    assert!(out.starts_with("name,direction,bits,value"), "{out}");
    let point = out
        .lines()
        .nth(1)
        .unwrap()
        .split(',')
        .next()
        .unwrap()
        .to_owned();
    let (code, _, err) = cell.io(&["set", "NoSuchPoint=1"]);
    assert_ne!(code, 0);
    assert!(err.contains("NoSuchPoint"), "{err}");
    let (code, out, err) = cell.io(&["get", &point]);
    assert_eq!(code, 0, "{err}");
    assert_eq!(out.lines().count(), 2, "{out}");
}

#[test]
fn variables_of_a_running_mc_are_watched() {
    let cell = ImageCell::start();
    let _node = cell.node("controller1");
    cell.set(&["PusherHome=1", "Weight=250"]);
    cell.wait_runs_on("Feeder", "controller1");
    let watch = |variables: &[&str], more: &[&str]| {
        let mut args = vec!["watch"];
        args.extend(variables);
        args.extend(["--cell", &cell.cell, "--gateway", &cell.gateway_endpoint]);
        args.extend(more);
        support::run(&args)
    };
    let all = [
        "Feeder.step",
        "Feeder.weights",
        "Feeder.settle.PT",
        "feeder.Weight",
        "Press.RamDown",
    ];
    let row = |out: &str| out.lines().nth(1).unwrap_or_default().to_owned();
    until("the inputs have come to the MC", || {
        let (code, out, err) = watch(&all, &["--csv", "--samples", "1"]);
        assert_eq!(code, 0, "{err}");
        let titles = "Feeder.scan,Feeder.step,Feeder.weights,Feeder.settle.PT,Feeder.Weight,Press.scan,Press.RamDown";
        assert_eq!(out.lines().next().unwrap(), format!("time_ms,{titles}"));
        row(&out).ends_with("FALSE").then_some(())?;
        row(&out)
            .contains(",Waiting,\"[0, 0, 0, 0]\",T#20ms,250,")
            .then_some(())
    });
    // A part is fed: step and weights follow.
    cell.set(&["Start=1"]);
    cell.wait_point("Feeder.PusherExtend", "1");
    cell.set(&["PusherOut=1", "PusherHome=0"]);
    until("the part is weighed", || {
        let (_, out, _) = watch(
            &["Feeder.weights[0]", "Feeder.fed"],
            &["--csv", "--samples", "1"],
        );
        row(&out).ends_with(",250,1").then_some(())
    });
    let (_, out, _) = watch(&["Feeder.step"], &["--samples", "2", "--every-ms", "5"]);
    assert_eq!(
        out.matches("on controller1, open, epoch").count(),
        2,
        "{out}"
    );
    for (variable, parts) in [
        ("Feeder", vec!["expected <MC>.<variable>"]),
        ("Nobody.step", vec!["no MC `Nobody`", "Feeder, Press"]),
        ("Feeder.stp", vec!["has no variable `stp`", "step"]),
    ] {
        let (code, _, err) = watch(&[variable], &["--samples", "1"]);
        assert_ne!(code, 0);
        assert!(parts.iter().all(|p| err.contains(p)), "{err}");
    }
}

/// A gateway for each station; what the stations tell each other crosses from one gateway to the other.
#[test]
fn two_gateways_share_a_cell_and_exported_variables_cross_between_them() {
    let source = support::project("engineering/tests/cells/two_stations");
    let dir = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(source).unwrap().flatten() {
        std::fs::copy(entry.path(), dir.path().join(entry.file_name())).unwrap();
    }
    let path = dir.path().join("cell.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    let (head, press) = text.split_once("name = \"Press\"").unwrap();
    let second = "[[gateway]]\nname = \"gateway2\"\ndriver = \"image\"\n\n[[controller]]";
    let text = format!(
        "{}name = \"Press\"{}",
        head.replacen("[[controller]]", second, 1),
        press.replace("gateway = \"gateway1\"", "gateway = \"gateway2\"")
    );
    std::fs::write(&path, text).unwrap();
    let mut cell = ImageCell::start_with(path.display().to_string());
    let other = cell.start_second_gateway("gateway2");
    let _node = cell.node("controller1");
    for mc in ["Feeder", "Press"] {
        cell.wait_runs_on(mc, "controller1");
    }
    cell.set(&["PusherHome=1", "Weight=4000", "Start=1", "PusherOut=1"]);
    let at_other = |args: &[&str]| {
        let mut all = vec!["io"];
        all.extend(args);
        all.extend(["--name", "two_stations", "--gateway", "gateway2"]);
        all.extend(["--endpoint", other.as_str()]);
        let (code, out, err) = support::run(&all);
        assert_eq!(code, 0, "{err}");
        out
    };
    at_other(&["set", "RamUp=1"]);
    until(
        "the press has the weight of a part that the feeder offered",
        || {
            // 1 kg with the first part, more with each one that follows while nobody looks.
            let weight = |row: &str| row.split(',').nth(3)?.parse::<f64>().ok();
            at_other(&["get", "Press.LastWeight"])
                .lines()
                .any(|row| weight(row) >= Some(1.0))
                .then_some(())
        },
    );
    // The press's word reaches the feeder: it goes on to the next part.
    until("the next part is fed", || {
        let fed: u32 = cell.get("Feeder.FedParts")?.parse().ok()?;
        (fed >= 2).then_some(())
    });
}
