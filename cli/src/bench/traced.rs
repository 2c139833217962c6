//! Two nodes that run one MC with a large state on the production path, with the measuring points of both.

use crate::observe::Observer;
use crate::running::{Running, Setup};
use anyhow::{Context, Result};
use fam_driver::{Client, Subscription};
use fam_proto::{CellId, ControllerId, GatewayId};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// One measuring point, as `fam_controller_node::trace` writes it.
#[derive(Debug, Clone, Deserialize)]
#[serde(tag = "point", rename_all = "lowercase")]
pub enum Point {
    Scanned {
        epoch: u64,
        scan: u64,
        scan_end_ns: u64,
        capture_cpu_ns: u64,
        sender_cpu_ns: u64,
        bytes: usize,
        full: bool,
    },
    Held {
        epoch: u64,
        scan: u64,
        at_ns: u64,
    },
}

/// The running pair.
pub struct Traced {
    pub cell: Running,
    points: Arc<(Mutex<Vec<Point>>, Condvar)>,
    runtime: tokio::runtime::Runtime,
    _subscriptions: Vec<Subscription>,
    client: Client,
    _dir: TempDir,
}

const NAME: &str = "bench";
const GATEWAY: &str = "gateway1";
const WAIT: Duration = Duration::from_secs(60);

impl Traced {
    /// Starts manager, gateway and two nodes with one MC of so many LREAL variables, all changed in each scan.
    pub fn start(variables: usize, cycle_ms: u32) -> Result<Traced> {
        let dir = tempfile::Builder::new().prefix("fam-bench-").tempdir()?;
        write_cell(dir.path(), variables, cycle_ms)?;
        let mut cell = Running::start(Setup {
            cell: dir.path().join("cell.toml"),
            gateway: GATEWAY.to_owned(),
            plant: false,
            seed: 1,
            run_dir: dir.path().to_owned(),
            detour: BTreeMap::new(),
            fence_off: false,
        })?;
        let mut connect = vec![
            cell.manager_endpoint().to_owned(),
            cell.gateway_endpoint().to_owned(),
        ];
        for controller in ["controller1", "controller2"] {
            connect.push(cell.trace_node(controller)?);
        }
        let cell_id = CellId::new(NAME)?;
        let runtime = fam_driver::runtime()?;
        let points: Arc<(Mutex<Vec<Point>>, Condvar)> = Arc::default();
        let (client, subscriptions) = runtime.block_on(async {
            let client = Client::open(cell_id.clone(), connect).await?;
            let mut subscriptions = Vec::new();
            for controller in ["controller1", "controller2"] {
                let sink = points.clone();
                let key =
                    fam_controller_node::trace::key(&cell_id, &ControllerId::new(controller)?);
                subscriptions.push(client.link().subscribe(&key, move |_, bytes| {
                    if let Ok(mut points) = sink.0.lock() {
                        points.extend(
                            bytes
                                .split(|b| *b == b'\n')
                                .filter_map(|line| serde_json::from_slice(line).ok()),
                        );
                        sink.1.notify_all();
                    }
                })?);
            }
            anyhow::Ok((client, subscriptions))
        })?;
        // The first one drives, the second one holds.
        let eye = Observer::start(
            &cell_id,
            &GatewayId::new(GATEWAY)?,
            cell.manager_endpoint(),
            cell.gateway_endpoint(),
        )?;
        cell.start_node("controller1")?;
        eye.wait("controller1 drives the MC", WAIT, |seen| {
            (!seen.newest.is_empty()).then_some(())
        })?;
        cell.start_node("controller2")?;
        drop(eye);
        Ok(Traced {
            cell,
            points,
            runtime,
            _subscriptions: subscriptions,
            client,
            _dir: dir,
        })
    }

    /// Waits until `enough` is content with the points seen so far.
    pub fn wait<T>(&self, what: &str, mut enough: impl FnMut(&[Point]) -> Option<T>) -> Result<T> {
        let deadline = Instant::now() + WAIT;
        let mut points = self
            .points
            .0
            .lock()
            .map_err(|_| anyhow::anyhow!("the points are lost"))?;
        loop {
            if let Some(value) = enough(&points) {
                return Ok(value);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            anyhow::ensure!(
                !left.is_zero(),
                "waited {WAIT:?} in vain: {what}; {} points seen; logs in {}",
                points.len(),
                self.cell.run_dir().display()
            );
            points = self
                .points
                .1
                .wait_timeout(points, left)
                .map_err(|_| anyhow::anyhow!("the points are lost"))?
                .0;
        }
    }

    /// Ends the cell.
    pub fn stop(self) -> Result<()> {
        self.runtime.block_on(self.client.close());
        self.cell.stop()
    }
}

fn write_cell(dir: &Path, variables: usize, cycle_ms: u32) -> Result<()> {
    let cell = format!(
        "format = 1\n[cell]\nname = \"{NAME}\"\ntick_ms = {cycle_ms}\n\
         [[gateway]]\nname = \"{GATEWAY}\"\ndriver = \"image\"\n\
         [[controller]]\nname = \"controller1\"\nlimit_percent = 100\n[[controller]]\nname = \"controller2\"\nlimit_percent = 100\n\
         [[mc]]\nname = \"Large\"\nlogic = [\"large.st\"]\ngateway = \"{GATEWAY}\"\nhosts = \"all\"\ncriticality = 1\ncycle_ms = {cycle_ms}\n\
         worst_case_us = 1000\nwatchdog_ms = 2000\nsuspect_ms = 1000\n[mc.inputs]\n[mc.outputs]\nSum = {{ field = \"image:Sum\", fail_safe = 0.0 }}\n"
    );
    let logic = format!(
        "VAR_GLOBAL\n    Sum AT %QL0 : LREAL;\nEND_VAR\nPROGRAM Large\nVAR_EXTERNAL\n    Sum : LREAL;\nEND_VAR\nVAR\n    x : ARRAY[1..{variables}] OF LREAL;\n    i : DINT;\nEND_VAR\n\
         FOR i := 1 TO {variables} DO\n    x[i] := x[i] + 1.0;\nEND_FOR;\nSum := x[1];\nEND_PROGRAM\n"
    );
    std::fs::write(dir.join("cell.toml"), cell).context("cell.toml of the benchmark")?;
    std::fs::write(dir.join("large.st"), logic).context("large.st of the benchmark")
}
