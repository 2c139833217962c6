//! The processes of the cell as subcommands: options in, `run` until SIGTERM or Ctrl-C.

use crate::args::{GatewayArgs, LogArg, MachineArg, ManagerArgs, NodeArgs, PlantArgs};
use anyhow::Result;
use fam_controller_node::{NodeOptions, RealTimeOptions};
use fam_driver::{LogFormat, init_logging};
use fam_gateway::GatewayOptions;
use fam_manager::ManagerOptions;
use fam_plant::{MachineKind, PlantConfig, PlantOptions};

fn logging(log: LogArg) {
    let format = match log {
        LogArg::Plain => LogFormat::Plain,
        LogArg::Json => LogFormat::Json,
    };
    init_logging(format, "info");
}

/// Completes at SIGTERM or Ctrl-C.
async fn ended() {
    match fam_driver::termination().await {
        Ok(signal) => tracing::info!("{signal}: ending"),
        Err(error) => tracing::error!("signals cannot be received ({error}): ending"),
    }
}

/// Gives this thread, and all that it starts from now on, a real-time priority where the machine allows it: a gateway works
/// for microseconds and then waits, and every controller waits for it.
pub fn prefer_this_process(priority: u8) {
    if priority > 0 {
        let param = libc::sched_param {
            sched_priority: i32::from(priority),
        };
        // SAFETY: sets the policy of the calling thread from a valid parameter; refused without the right to it.
        unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const param) };
    }
}

/// `fam manager`
pub async fn manager(a: ManagerArgs) -> Result<()> {
    logging(a.log);
    let options = ManagerOptions {
        cell_file: a.cell,
        repository: a.repository,
        listen: vec![a.listen],
        connect: a.connect,
    };
    fam_manager::run(options, ended()).await
}

/// `fam node`
pub async fn node(a: NodeArgs) -> Result<()> {
    logging(a.log);
    let real_time = RealTimeOptions {
        priority: (a.priority > 0).then_some(a.priority),
        lock_memory: a.lock_memory,
        cpus: a.cpu,
    };
    let options = NodeOptions {
        cell: a.cell,
        controller: a.controller,
        listen: if a.isolated {
            Vec::new()
        } else {
            vec![a.listen]
        },
        connect: a.connect,
        cache: a.cache,
        real_time,
        trace: a.trace,
        criteria: Vec::new(),
    };
    fam_controller_node::run(options, ended()).await
}

/// `fam gateway`
pub async fn gateway(a: GatewayArgs) -> Result<()> {
    logging(a.log);
    let options = GatewayOptions {
        gateway: Some(a.gateway),
        listen: vec![a.listen],
        connect: a.connect,
        field_address: a.field,
        stream_applied: a.recorder,
        journal: a.journal,
        #[cfg(feature = "fence-off")]
        fence_off: a.fence_off,
        ..GatewayOptions::new(a.cell, a.records)
    };
    fam_gateway::run(options, ended()).await
}

/// `fam plant`
pub async fn plant(a: PlantArgs) -> Result<()> {
    logging(a.log);
    let options = PlantOptions {
        modbus: a.modbus,
        status: a.status,
        config: PlantConfig {
            seed: a.seed,
            machine: match a.machine {
                MachineArg::Fms200 => MachineKind::Fms200,
                MachineArg::Marking => MachineKind::Marking,
            },
            ..PlantConfig::default()
        },
        time_scale: 1.0,
    };
    fam_plant::run(options, ended()).await
}
