//! `fam up`: all processes of a deployment, looked after until Ctrl-C.

use crate::args::{DEFAULT_MANAGER, UpArgs};
use crate::supervised::{Start, Supervised};
use anyhow::{Context, Result};
use fam_engineering::deployment::{Deployment, DeploymentFile, LogFormat};
use std::time::Duration;

/// Starts everything and looks after it.
///
/// # Errors
/// If the deployment is wrong, or a process cannot be started or ends at once.
pub async fn run(args: &UpArgs) -> Result<()> {
    let file = DeploymentFile::read(&args.deployment)?;
    let model = fam_engineering::build(&file.cell())?.model;
    let deployment = file.resolve(&model)?;
    std::fs::create_dir_all(&deployment.run_dir).with_context(|| {
        format!(
            "cannot make the run directory {}",
            deployment.run_dir.display()
        )
    })?;
    let mut processes = Supervised::start(starts(&deployment), &deployment.run_dir)?;
    let endpoint = &deployment.manager.listen;
    let other = if endpoint == DEFAULT_MANAGER {
        String::new()
    } else {
        format!(" --manager {endpoint}")
    };
    println!(
        "cell {} is up, logs in {}. `fam status{other}` shows it; Ctrl-C ends it.",
        model.cell,
        deployment.run_dir.display(),
    );
    let running = processes.running();
    let numbers: Vec<String> = running
        .iter()
        .map(|(name, pid)| format!("{name} {pid}"))
        .collect();
    println!("processes: {}", numbers.join(", "));
    let mut look = tokio::time::interval(Duration::from_millis(250));
    let end = fam_driver::termination();
    tokio::pin!(end);
    let result = loop {
        tokio::select! {
            signal = &mut end => {
                println!("{}: ending the cell", signal?);
                break Ok(());
            }
            _ = look.tick() => match processes.look() {
                Ok(said) => said.iter().for_each(|line| println!("{line}")),
                Err(error) => break Err(error),
            },
        }
    };
    // Nodes were started last and are ended first, so that they can hand over what they drive.
    let ended = tokio::task::block_in_place(|| processes.end());
    result.and(ended)
}

/// The plant first, then what everything else connects to, and the nodes at last.
fn starts(d: &Deployment) -> Vec<Start> {
    let cell = d.cell.display().to_string();
    let log = match d.log.format {
        LogFormat::Plain => "plain",
        LogFormat::Json => "json",
    };
    let endpoints: Vec<&str> = std::iter::once(d.manager.listen.as_str())
        .chain(d.gateways.iter().map(|g| g.listen.as_str()))
        .collect();
    let mut starts = Vec::new();
    let mut add = |name: &str, args: Vec<String>| {
        starts.push(Start {
            name: name.to_owned(),
            args,
        });
    };
    let words = |words: &[&str]| -> Vec<String> { words.iter().map(|&w| w.to_owned()).collect() };
    let connect = |args: &mut Vec<String>, own: &str| {
        for endpoint in endpoints.iter().filter(|e| **e != own) {
            args.extend(["--connect".to_owned(), (*endpoint).to_owned()]);
        }
    };
    if let Some(plant) = &d.plant {
        add(
            "plant",
            words(&[
                "plant",
                "--modbus",
                &plant.modbus,
                "--status",
                &plant.status,
                "--seed",
                &plant.seed.to_string(),
                "--machine",
                plant.machine.name(),
                "--log",
                log,
            ]),
        );
    }
    for gateway in &d.gateways {
        let records = gateway.records.display().to_string();
        let mut args = words(&[
            "gateway",
            gateway.gateway.as_str(),
            "--cell",
            &cell,
            "--listen",
            &gateway.listen,
            "--records",
            &records,
            "--log",
            log,
        ]);
        if let Some(address) = &gateway.address {
            args.extend(words(&["--field", address]));
        }
        connect(&mut args, &gateway.listen);
        add(gateway.gateway.as_str(), args);
    }
    let repository = d.manager.repository.display().to_string();
    let mut args = words(&[
        "manager",
        "--cell",
        &cell,
        "--listen",
        &d.manager.listen,
        "--repository",
        &repository,
        "--log",
        log,
    ]);
    connect(&mut args, &d.manager.listen);
    add("manager", args);
    let cache = d.run_dir.join("modules").display().to_string();
    for controller in &d.controllers {
        let mut args = words(&[
            "node",
            controller.as_str(),
            "--cell",
            &cell,
            "--cache",
            &cache,
            "--log",
            log,
        ]);
        connect(&mut args, "");
        if let Some(priority) = d.real_time.priority {
            args.extend(words(&["--priority", &priority.to_string()]));
        }
        if d.real_time.lock_memory {
            args.push("--lock-memory".to_owned());
        }
        for cpu in &d.real_time.cpus {
            args.extend(words(&["--cpu", &cpu.to_string()]));
        }
        add(controller.as_str(), args);
    }
    starts
}
