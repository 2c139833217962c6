//! Deployments: what a small file leaves out is filled in; what is wrong is said with its place.

mod common;

use common::two_stations;
use fam_engineering::deployment::{Deployment, LogFormat};
use fam_engineering::{DeploymentFile, Problems, build_model};
use std::path::{Path, PathBuf};

fn resolved(text: &str) -> Result<Deployment, Problems> {
    let folder = two_stations().parent().unwrap().to_owned();
    let file = DeploymentFile::parse("deployment.toml", text.to_owned(), folder)?;
    file.resolve(&build_model(&file.cell()).unwrap())
}

#[test]
fn the_smallest_file_is_the_cell_alone() {
    let folder = two_stations().parent().unwrap().to_owned();
    let deployment = resolved("cell = \"cell.toml\"").unwrap();
    assert_eq!(deployment.cell, folder.join("cell.toml"));
    assert_eq!(deployment.run_dir, folder.join("run"));
    assert_eq!(deployment.manager.listen, "tcp/127.0.0.1:7447");
    assert_eq!(
        deployment.manager.repository,
        folder.join("run/repository.redb")
    );
    let [gateway] = deployment.gateways.as_slice() else {
        panic!("one gateway expected");
    };
    assert_eq!(gateway.listen, "tcp/127.0.0.1:7448");
    assert_eq!(gateway.records, folder.join("run/gateway1.records"));
    assert_eq!(gateway.address, None);
    let names: Vec<&str> = deployment.controllers.iter().map(|c| c.as_str()).collect();
    assert_eq!(names, ["controller1", "controller2"]);
    assert_eq!(deployment.plant, None);
    assert_eq!(deployment.real_time.priority, None);
    assert_eq!(deployment.log.format, LogFormat::Plain);
}

#[test]
fn everything_can_be_said() {
    let folder = two_stations().parent().unwrap().to_owned();
    let deployment = resolved(
        r#"
cell = "cell.toml"
run_dir = "/var/lib/fam"
controllers = ["controller2"]

[manager]
listen = "tcp/127.0.0.1:9000"
repository = "cell.redb"

[[gateway]]
name = "gateway1"
listen = "tcp/field-pc:9001"
records = "/mnt/records"

[plant]
modbus = "127.0.0.1:9002"
seed = 7

[real_time]
priority = 80
lock_memory = true
cpus = [1]

[log]
format = "json"
filter = "fam=debug"
"#,
    )
    .unwrap();
    assert_eq!(deployment.run_dir, Path::new("/var/lib/fam"));
    assert_eq!(deployment.manager.listen, "tcp/127.0.0.1:9000");
    assert_eq!(deployment.manager.repository, folder.join("cell.redb"));
    assert_eq!(deployment.gateways[0].listen, "tcp/field-pc:9001");
    assert_eq!(
        deployment.gateways[0].records,
        PathBuf::from("/mnt/records")
    );
    assert_eq!(deployment.controllers.len(), 1);
    let plant = deployment.plant.unwrap();
    assert_eq!(
        (plant.modbus.as_str(), plant.status.as_str(), plant.seed),
        ("127.0.0.1:9002", "127.0.0.1:1503", 7)
    );
    assert_eq!(deployment.real_time.priority, Some(80));
    assert_eq!(deployment.real_time.cpus, [1]);
    assert_eq!(deployment.log.format, LogFormat::Json);
}

#[test]
fn what_is_wrong_is_said_with_its_place() {
    for (text, parts) in [
        (
            "cell = \"cell.toml\"\nrundir = \"x\"\n",
            vec![
                "error[M101]: unknown field `rundir`",
                "deployment.toml:2:1",
                "expected: one of `cell`, `run_dir`",
            ],
        ),
        (
            "cell = \"cell.toml\"\n[real_time]\nprio = 1\n",
            vec!["unknown field `prio`", "deployment.toml:3:1", "`priority`"],
        ),
        ("run_dir = \"x\"\n", vec!["missing field `cell`"]),
        (
            "cell = \"cell.toml\"\ncontrollers = [\"controler1\"]\n",
            vec![
                "error[M702]: the cell has no controller `controler1`",
                "deployment.toml:2:15",
                "did you mean `controller1`?",
            ],
        ),
        (
            "cell = \"cell.toml\"\ncontrollers = [\"controller1\", \"controller1\"]\n",
            vec!["error[M704]: controller controller1 would be started twice"],
        ),
        (
            "cell = \"cell.toml\"\n[[gateway]]\nname = \"gateway9\"\n",
            vec!["the cell has no gateway `gateway9`"],
        ),
        (
            "cell = \"cell.toml\"\n[[gateway]]\nname = \"gateway1\"\naddress = \"127.0.0.1:502\"\n",
            vec!["error[M703]: gateway gateway1 has the driver `image` and no address"],
        ),
        (
            "cell = \"cell.toml\"\n[manager]\nlisten = \"127.0.0.1:7447\"\n",
            vec![
                "error[M701]: `127.0.0.1:7447` is no endpoint",
                "tcp/<host>:<port>",
            ],
        ),
        (
            "cell = \"cell.toml\"\n[plant]\nmodbus = \"1502\"\n",
            vec!["`1502` is no address"],
        ),
        (
            "cell = \"cell.toml\"\n[log]\nformat = \"xml\"\n",
            vec!["unknown variant `xml`", "`plain` or `json`"],
        ),
    ] {
        let problems = resolved(text).unwrap_err().to_string();
        for part in parts {
            assert!(problems.contains(part), "expected `{part}` in:\n{problems}");
        }
    }
}
