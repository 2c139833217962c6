//! What people read when something is wrong: each message says what, where, what was expected, what to do.

mod support;

use std::io::Write;
use support::{Fam, ImageCell, fam, free_port, project, run};

fn write(dir: &std::path::Path, name: &str, text: &str) -> String {
    let path = dir.join(name);
    std::fs::write(&path, text).unwrap();
    path.display().to_string()
}

/// Each text stands in the message.
fn says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "expected `{part}` in:\n{message}");
    }
}

/// The two-station cell with some text of a file replaced.
fn changed_cell(dir: &std::path::Path, file: &str, from: &str, to: &str) -> String {
    let source = project("engineering/tests/cells/two_stations");
    for entry in std::fs::read_dir(source).unwrap().flatten() {
        let mut text = std::fs::read_to_string(entry.path()).unwrap();
        if entry.file_name() == file {
            assert!(text.contains(from), "{file} has no `{from}`");
            text = text.replace(from, to);
        }
        std::fs::write(dir.join(entry.file_name()), text).unwrap();
    }
    dir.join("cell.toml").display().to_string()
}

#[test]
fn cells_with_mistakes_are_refused_with_file_line_and_remedy() {
    let cases: [(&str, &str, &str, &[&str]); 4] = [
        (
            "cell.toml",
            "tick_ms = 5",
            "tick_ms = 5\ntick_msec = 5",
            &["cell.toml:7", "tick_msec"],
        ),
        (
            "cell.toml",
            "hosts = \"all\"",
            "hosts = []",
            &["cell.toml", "Feeder", "hosted"],
        ),
        (
            "cell.toml",
            "image:RamDown",
            "image:PusherExtend",
            &["PusherExtend", "Feeder", "Press"],
        ),
        (
            "press.st",
            "RamDown := step = 10;",
            "RamDown := step = ;",
            &["press.st:", "expected"],
        ),
    ];
    for (file, from, to, parts) in cases {
        let dir = tempfile::tempdir().unwrap();
        let cell = changed_cell(dir.path(), file, from, to);
        let (code, out, err) = run(&["check", &cell]);
        assert_eq!(code, 1, "{out}{err}");
        says(&out, parts);
    }
}

#[test]
fn a_deployment_with_an_unknown_field_says_where() {
    let dir = tempfile::tempdir().unwrap();
    let cell = project("engineering/tests/cells/two_stations/cell.toml");
    let deployment = write(
        dir.path(),
        "deployment.toml",
        &format!("cell = {cell:?}\n\n[manager]\nlisen = \"tcp/127.0.0.1:7447\"\n"),
    );
    let (code, _, err) = run(&["up", &deployment]);
    assert_eq!(code, 2);
    says(&err, &["deployment.toml:4", "lisen", "listen"]);
}

#[test]
fn a_cell_whose_port_is_in_use_does_not_come_up() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let dir = tempfile::tempdir().unwrap();
    let cell = project("engineering/tests/cells/two_stations/cell.toml");
    let deployment = write(
        dir.path(),
        "deployment.toml",
        &format!("cell = {cell:?}\n\n[manager]\nlisten = \"tcp/127.0.0.1:{port}\"\n"),
    );
    let (code, _, err) = run(&["up", &deployment]);
    assert_ne!(code, 0);
    says(
        &err,
        &["manager ended by itself", &port.to_string(), "in use"],
    );
}

#[test]
fn a_port_in_use_is_named() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", taken.local_addr().unwrap());
    let dir = tempfile::tempdir().unwrap();
    let cell = project("engineering/tests/cells/two_stations/cell.toml")
        .display()
        .to_string();
    let repository = dir.path().join("r.redb").display().to_string();
    let (code, _, err) = run(&[
        "manager",
        "--cell",
        &cell,
        "--listen",
        &endpoint,
        "--repository",
        &repository,
    ]);
    assert_eq!(code, 2);
    says(&err, &[&endpoint, "in use"]);
    let (code, _, err) = run(&[
        "plant",
        "--modbus",
        &taken.local_addr().unwrap().to_string(),
        "--status",
        "127.0.0.1:0",
    ]);
    assert_eq!(code, 2);
    says(&err, &[&taken.local_addr().unwrap().port().to_string()]);
}

#[test]
fn a_manager_that_cannot_be_reached_is_named() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let (code, _, err) = run(&["status", "--manager", &endpoint]);
    assert_eq!(code, 2);
    says(&err, &[&endpoint, "fam up"]);
}

#[test]
fn a_node_says_whom_it_cannot_reach_and_keeps_trying() {
    let dir = tempfile::tempdir().unwrap();
    let cell = project("engineering/tests/cells/two_stations/cell.toml")
        .display()
        .to_string();
    let (manager, gateway) = (
        format!("tcp/127.0.0.1:{}", free_port()),
        format!("tcp/127.0.0.1:{}", free_port()),
    );
    let cache = dir.path().join("modules").display().to_string();
    let mut node = Fam::start(&[
        "node",
        "controller1",
        "--cell",
        &cell,
        "--connect",
        &manager,
        "--connect",
        &gateway,
        "--cache",
        &cache,
    ]);
    node.wait_for(&[&manager]);
    node.wait_for(&[&gateway]);
    assert!(node.runs());
    assert!(node.terminate().success(), "{}", node.text());
}

#[test]
fn unknown_controllers_and_gateways_are_refused() {
    let cell = project("engineering/tests/cells/two_stations/cell.toml")
        .display()
        .to_string();
    let (code, _, err) = run(&["node", "controller9", "--cell", &cell]);
    assert_eq!(code, 2);
    says(&err, &["controller9", "controller1"]);
    let (code, _, err) = run(&["gateway", "nowhere", "--cell", &cell]);
    assert_eq!(code, 2);
    says(&err, &["nowhere", "gateway1"]);
}

#[test]
fn a_second_controller_of_one_name_is_refused_by_name() {
    let cell = ImageCell::start();
    let _first = cell.node("controller1");
    cell.wait_runs_on("Press", "controller1");
    let second = cell.node("controller1");
    second.wait_for(&["controller1", "registered"]);
    assert_eq!(cell.runs_on("Press").as_deref(), Some("controller1"));
}

#[test]
fn an_mc_of_other_logic_may_not_run_and_is_named() {
    let cell = ImageCell::start();
    let dir = tempfile::tempdir().unwrap();
    let other = changed_cell(dir.path(), "press.st", "T#50ms", "T#60ms");
    let _node = cell.node_with("controller1", &other);
    cell.wait_runs_on("Feeder", "controller1");
    let status = cell.status().unwrap();
    let text = status["controllers"].to_string();
    says(&text, &["ineligible", "Press", "hash"]);
    assert_eq!(cell.runs_on("Press"), None);
}

#[test]
fn a_foreign_or_newer_file_is_refused_and_left_untouched() {
    let dir = tempfile::tempdir().unwrap();
    let cell = project("engineering/tests/cells/two_stations/cell.toml")
        .display()
        .to_string();
    for (name, subcommand) in [("repository", "manager"), ("records", "gateway")] {
        let path = write(dir.path(), name, "this is somebody's shopping list");
        let option = format!("--{name}");
        let mut args = vec![subcommand];
        if subcommand == "gateway" {
            args.push("gateway1");
        }
        args.extend([
            "--cell",
            &cell,
            "--listen",
            "tcp/127.0.0.1:0",
            &option,
            &path,
        ]);
        let (code, _, err) = run(&args);
        assert_eq!(code, 2, "{err}");
        says(&err, &[&path]);
        assert_eq!(
            std::fs::read_to_string(&path).unwrap(),
            "this is somebody's shopping list"
        );
    }
}

#[test]
fn io_without_a_gateway_says_so() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let mut child = fam()
        .args(["io", "set", "--endpoint", &endpoint])
        .stdin(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    child
        .stdin
        .take()
        .unwrap()
        .write_all(b"name,value\nStart,1\n")
        .unwrap();
    let out = child.wait_with_output().unwrap();
    assert_eq!(out.status.code(), Some(2));
    says(&String::from_utf8_lossy(&out.stderr), &[&endpoint]);
}

#[test]
fn a_field_device_that_stops_answering_is_named_and_found_again() {
    let dir = tempfile::tempdir().unwrap();
    let (modbus, status) = (
        format!("127.0.0.1:{}", free_port()),
        format!("127.0.0.1:{}", free_port()),
    );
    let start_plant = || Fam::start(&["plant", "--modbus", &modbus, "--status", &status]);
    let mut plant = start_plant();
    plant.wait_for(&[&modbus]);
    let cell = project("deploy/fms200/cell.toml").display().to_string();
    let records = dir.path().join("records.bin").display().to_string();
    let gateway = Fam::start(&[
        "gateway",
        "gateway1",
        "--cell",
        &cell,
        "--listen",
        "tcp/127.0.0.1:0",
        "--connect",
        &format!("tcp/127.0.0.1:{}", free_port()),
        "--records",
        &records,
        "--field",
        &modbus,
    ]);
    gateway.wait_for(&["serves", &modbus]);
    plant.child.kill().unwrap();
    plant.child.wait().unwrap();
    gateway.wait_for(&["field device", "does not answer", "inputs are not fresh"]);
    let plant = start_plant();
    plant.wait_for(&[&modbus]);
    gateway.wait_for(&["field device", " answers"]);
}

#[test]
fn whoever_reads_along_may_stop_reading() {
    let model = project("deploy/fms200/fms200.aml").display().to_string();
    let mut shown = fam();
    shown.args(["show", &model]);
    shown.stdout(std::process::Stdio::piped());
    shown.stderr(std::process::Stdio::piped());
    let mut child = shown.spawn().unwrap();
    drop(child.stdout.take());
    let out = child.wait_with_output().unwrap();
    assert_eq!(String::from_utf8_lossy(&out.stderr), "");
    assert_eq!(out.status.code(), Some(141));
}
