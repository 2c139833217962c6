//! A cell made of real processes on loopback, for the demo and the benchmarks: one plant, one gateway, one manager, and
//! controller nodes that come and go. All endpoints are free ports, so that several can run beside each other.

use crate::free_port::free_address;
use crate::processes::Process;
use anyhow::{Context, Result, anyhow};
use nix::sys::signal::Signal;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// How the cell is to be run.
pub struct Setup {
    /// Cell model.
    pub cell: PathBuf,
    /// Gateway of the model that is run.
    pub gateway: String,
    /// Whether the FMS-200 plant is started (else the gateway's driver is `image`).
    pub plant: bool,
    /// Seed of the plant.
    pub seed: u64,
    /// Folder for logs, records and repository.
    pub run_dir: PathBuf,
    /// What the nodes connect to in place of manager and gateway (a relay that can be cut), by controller.
    pub detour: BTreeMap<String, Vec<String>>,
    /// Runs the gateway without its fence; only a build with the feature of this name takes it.
    pub fence_off: bool,
}

/// The running cell.
pub struct Running {
    setup: Setup,
    manager_endpoint: String,
    gateway_endpoint: String,
    modbus: SocketAddr,
    status: SocketAddr,
    plant: Option<Process>,
    gateway: Option<Process>,
    manager: Option<Process>,
    nodes: BTreeMap<String, Process>,
    /// Traced nodes, with the endpoints at which their measuring points are had.
    listen: BTreeMap<String, String>,
    /// Further options of nodes, by controller.
    options: BTreeMap<String, Vec<String>>,
}

impl Running {
    /// Starts plant, gateway and manager; nodes are started one by one.
    ///
    /// # Errors
    /// If a process cannot be started.
    pub fn start(setup: Setup) -> Result<Running> {
        std::fs::create_dir_all(&setup.run_dir).with_context(|| {
            format!("cannot make the run directory {}", setup.run_dir.display())
        })?;
        let mut cell = Running {
            manager_endpoint: format!("tcp/{}", free_address()?),
            gateway_endpoint: format!("tcp/{}", free_address()?),
            modbus: free_address()?,
            status: free_address()?,
            plant: None,
            gateway: None,
            manager: None,
            nodes: BTreeMap::new(),
            listen: BTreeMap::new(),
            options: BTreeMap::new(),
            setup,
        };
        if cell.setup.plant {
            cell.start_plant()?;
        }
        cell.start_gateway()?;
        cell.start_manager()?;
        Ok(cell)
    }

    /// Endpoint of the manager.
    pub fn manager_endpoint(&self) -> &str {
        &self.manager_endpoint
    }

    /// Endpoint of the gateway.
    pub fn gateway_endpoint(&self) -> &str {
        &self.gateway_endpoint
    }

    /// Lets controllers connect to other endpoints than the manager's and the gateway's, from their next start on.
    pub fn detour(&mut self, detour: BTreeMap<String, Vec<String>>) {
        self.setup.detour = detour;
    }

    /// Lets a node publish its measuring points from its next start on, and returns the endpoint to ask for them.
    ///
    /// # Errors
    /// If no port is free.
    pub fn trace_node(&mut self, controller: &str) -> Result<String> {
        let endpoint = format!("tcp/{}", free_address()?);
        self.listen.insert(controller.to_owned(), endpoint.clone());
        Ok(endpoint)
    }

    /// Gives a node further options from its next start on.
    pub fn node_options(&mut self, controller: &str, options: &[&str]) {
        let options = options.iter().map(|&o| o.to_owned()).collect();
        self.options.insert(controller.to_owned(), options);
    }

    /// Status port of the plant.
    pub fn plant_status(&self) -> SocketAddr {
        self.status
    }

    /// Folder of logs, records and repository.
    pub fn run_dir(&self) -> &Path {
        &self.setup.run_dir
    }

    fn spawn(&self, name: &str, args: &[&str]) -> Result<Process> {
        let args: Vec<String> = args.iter().map(|&a| a.to_owned()).collect();
        Process::start(name, &args, &self.setup.run_dir)
    }

    fn cell_arg(&self) -> Result<&str> {
        self.setup.cell.to_str().ok_or_else(|| {
            anyhow!(
                "the path of the cell model is not valid UTF-8: {}",
                self.setup.cell.display()
            )
        })
    }

    fn start_plant(&mut self) -> Result<()> {
        let (modbus, status, seed) = (
            self.modbus.to_string(),
            self.status.to_string(),
            self.setup.seed.to_string(),
        );
        self.plant = Some(self.spawn(
            "plant",
            &[
                "plant", "--modbus", &modbus, "--status", &status, "--seed", &seed,
            ],
        )?);
        Ok(())
    }

    /// Starts the gateway (again).
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start_gateway(&mut self) -> Result<()> {
        let records = self.setup.run_dir.join("records.bin").display().to_string();
        let modbus = self.modbus.to_string();
        let mut args = vec![
            "gateway",
            &self.setup.gateway,
            "--cell",
            self.cell_arg()?,
            "--listen",
            &self.gateway_endpoint,
            "--connect",
            &self.manager_endpoint,
            "--records",
            &records,
            "--recorder",
        ];
        if self.setup.plant {
            args.extend(["--field", &modbus]);
        }
        if self.setup.fence_off {
            args.push("--fence-off");
        }
        self.gateway = Some(self.spawn("gateway", &args)?);
        Ok(())
    }

    /// Starts the manager (again).
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start_manager(&mut self) -> Result<()> {
        let repository = self
            .setup
            .run_dir
            .join("repository.redb")
            .display()
            .to_string();
        let args = [
            "manager",
            "--cell",
            self.cell_arg()?,
            "--listen",
            &self.manager_endpoint,
            "--connect",
            &self.gateway_endpoint,
            "--repository",
            &repository,
        ];
        self.manager = Some(self.spawn("manager", &args)?);
        Ok(())
    }

    /// Starts a controller node (again).
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start_node(&mut self, controller: &str) -> Result<()> {
        let cache = self.setup.run_dir.join("modules").display().to_string();
        let connect = self
            .setup
            .detour
            .get(controller)
            .cloned()
            .unwrap_or_else(|| vec![self.manager_endpoint.clone(), self.gateway_endpoint.clone()]);
        let mut args = vec![
            "node",
            controller,
            "--cell",
            self.cell_arg()?,
            "--cache",
            &cache,
        ];
        if self.setup.detour.contains_key(controller) {
            args.push("--isolated");
        }
        let listen = self.listen.get(controller).cloned();
        if let Some(listen) = &listen {
            args.extend(["--trace", "--listen", listen]);
        }
        for endpoint in &connect {
            args.extend(["--connect", endpoint]);
        }
        let options = self.options.get(controller).into_iter().flatten();
        args.extend(options.map(String::as_str));
        let node = self.spawn(controller, &args)?;
        self.nodes.insert(controller.to_owned(), node);
        Ok(())
    }

    /// A running node.
    ///
    /// # Errors
    /// If it was not started.
    pub fn node(&self, controller: &str) -> Result<&Process> {
        self.nodes
            .get(controller)
            .ok_or_else(|| anyhow!("controller node {controller} is not running"))
    }

    /// Sends a signal to a node.
    ///
    /// # Errors
    /// If it is not running.
    pub fn signal_node(&self, controller: &str, signal: Signal) -> Result<()> {
        self.node(controller)?.signal(signal)
    }

    /// SIGKILL to a node.
    ///
    /// # Errors
    /// If it is not running.
    pub fn kill_node(&mut self, controller: &str) -> Result<()> {
        let mut node = self
            .nodes
            .remove(controller)
            .ok_or_else(|| anyhow!("controller node {controller} is not running"))?;
        node.kill()
    }

    /// SIGTERM to a node, and waits for its clean end.
    ///
    /// # Errors
    /// If it is not running or does not end cleanly.
    pub fn stop_node(&mut self, controller: &str) -> Result<()> {
        let node = self
            .nodes
            .remove(controller)
            .ok_or_else(|| anyhow!("controller node {controller} is not running"))?;
        node.terminate()
    }

    /// SIGKILL to the manager.
    ///
    /// # Errors
    /// If it is not running.
    pub fn kill_manager(&mut self) -> Result<()> {
        self.manager
            .take()
            .ok_or_else(|| anyhow!("the manager is not running"))?
            .kill()
    }

    /// SIGKILL to the gateway.
    ///
    /// # Errors
    /// If it is not running.
    pub fn kill_gateway(&mut self) -> Result<()> {
        self.gateway
            .take()
            .ok_or_else(|| anyhow!("the gateway is not running"))?
            .kill()
    }

    /// Sends a signal to any running process: `plant`, `gateway`, `manager`, or a controller.
    ///
    /// # Errors
    /// If it is not running.
    pub fn signal(&self, name: &str, signal: Signal) -> Result<()> {
        self.all()
            .find(|p| p.name() == name)
            .ok_or_else(|| anyhow!("{name} is not running"))?
            .signal(signal)
    }

    /// Names and numbers of the running processes.
    pub fn pids(&self) -> Vec<(String, u32)> {
        self.all().map(|p| (p.name().to_owned(), p.pid())).collect()
    }

    fn all(&self) -> impl Iterator<Item = &Process> {
        self.plant
            .iter()
            .chain(&self.gateway)
            .chain(&self.manager)
            .chain(self.nodes.values())
    }

    /// Names of processes that have ended by themselves, with the end of their logs.
    ///
    /// # Errors
    /// If the system does not tell.
    pub fn casualties(&mut self) -> Result<Vec<String>> {
        let mut dead = Vec::new();
        let all = self
            .plant
            .iter_mut()
            .chain(self.gateway.iter_mut())
            .chain(self.manager.iter_mut())
            .chain(self.nodes.values_mut());
        for process in all {
            if let Some(status) = process.ended()? {
                dead.push(format!(
                    "{} ended by itself with {status}; the end of {}:\n{}",
                    process.name(),
                    process.log().display(),
                    crate::processes::tail(process.log())
                ));
            }
        }
        Ok(dead)
    }

    /// Ends all processes cleanly: nodes first, then manager, gateway, plant.
    ///
    /// # Errors
    /// The first process that does not end cleanly; the others are ended all the same.
    pub fn stop(mut self) -> Result<()> {
        let mut result = Ok(());
        let nodes = std::mem::take(&mut self.nodes).into_values();
        for process in nodes
            .chain(self.manager.take())
            .chain(self.gateway.take())
            .chain(self.plant.take())
        {
            let ended = process.terminate();
            if result.is_ok() {
                result = ended;
            }
        }
        result
    }
}
