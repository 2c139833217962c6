//! What it costs to carry the state in the frame, against outputs alone: the production's own encoder on one side, its decoder,
//! chain and record file on the other, without a network in between.

use super::stats::Stats;
use anyhow::{Context, Result};
use fam_gateway::records::RecordFile;
use fam_gateway_core::chain::Ring;
use fam_gateway_core::{RecordWrite, StoredHead};
use fam_node_core::buffers::Pool;
use fam_node_core::{FrameEncoder, McSpec, ScannedFrame};
use fam_proto::model::CellModel;
use fam_proto::{
    BootId, CheckpointId, ControllerId, Epoch, GatewayId, HeadMeta, ImageNumber, McId, Now, Owner,
    Phase, Scan, decode_frame,
};
use serde_json::{Map, Value, json};
use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;

/// Sizes of the state, in bytes; 0 stands for outputs alone.
const SIZES: [usize; 5] = [0, 1_000, 10_000, 100_000, 1_000_000];
/// Shares of the state that change in each scan, in percent.
const CHANGES: [usize; 3] = [1, 10, 100];
/// Length of the outputs, in bytes.
const OUTPUTS: usize = 64;
/// Scans until an acknowledgement is back at the sender.
const ACKNOWLEDGED_AFTER: usize = 2;
/// Cycle, in microseconds.
const CYCLE_US: u64 = 5_000;
/// Changes lie in variables of so many bytes, spread over the state.
const VARIABLE: usize = 8;

const GATEWAY: &str = "gateway1";
const MC: &str = "Large";

/// What one frame costs.
struct Cost {
    sender_us: f64,
    gateway_us: f64,
    bytes: f64,
    full: bool,
}

pub fn run(scans: usize) -> Result<Map<String, Value>> {
    let dir = tempfile::Builder::new().prefix("fam-bench-").tempdir()?;
    let mut rows = Vec::new();
    let mut alone = None;
    for size in SIZES {
        for change in CHANGES {
            if size == 0 && alone.is_some() {
                continue;
            }
            let costs = measure(dir.path(), size, change, scans)?;
            let of = |pick: fn(&Cost) -> f64| Stats::new(costs.iter().map(pick).collect());
            let (sender, gateway, bytes) =
                (of(|c| c.sender_us), of(|c| c.gateway_us), of(|c| c.bytes));
            let row = json!({
                "state_bytes": size,
                "changed_percent": if size == 0 { 0 } else { change },
                "frame_bytes_p50": bytes.percentile(50.0),
                "sender_us_p50": sender.ms(50.0),
                "sender_us_p99": sender.ms(99.0),
                "gateway_us_p50": gateway.ms(50.0),
                "gateway_us_p99": gateway.ms(99.0),
                "full_frames": costs.iter().filter(|c| c.full).count(),
            });
            if size == 0 {
                alone = Some(row);
            } else {
                rows.push(row);
            }
        }
    }
    let mut figures = Map::new();
    figures.insert("scans".into(), json!(scans));
    figures.insert("outputs_alone".into(), alone.unwrap_or_default());
    figures.insert("rows".into(), Value::Array(rows));
    Ok(figures)
}

fn measure(dir: &Path, size: usize, change: usize, scans: usize) -> Result<Vec<Cost>> {
    let (model, spec) = cell(dir, size)?;
    let size = spec.initial.len();
    let gateway = GatewayId::new(GATEWAY)?;
    let records = dir.join(format!("records-{size}-{change}.bin"));
    let (mut file, _) = RecordFile::open(&records, &model, &gateway)?;
    let mut ring = Ring::default();
    let mut pool = Pool::new(size, OUTPUTS);
    let mut encoder = FrameEncoder::new();
    let mut state = vec![0; size];
    let mut on_the_way: VecDeque<CheckpointId> = VecDeque::new();
    let mut acknowledged = None;
    let mut costs = Vec::new();
    // The first frames fill caches, rings and the file's pages.
    let warm = 20;
    for scan in 1..=(scans + warm) as u64 {
        touch(&mut state, change, scan);
        let outputs = [scan.to_le_bytes()[0]; OUTPUTS];
        let buffer = pool
            .fill(&state, &outputs)
            .context("no buffer is free: more acknowledgements are awaited than buffers exist")?;
        let frame = scanned(&spec, scan, acknowledged, buffer)?;
        let from = cpu_ns();
        let encoded = encoder.encode(&frame, Now(scan * CYCLE_US))?;
        let sent = cpu_ns();
        let view = decode_frame(&encoded.bytes)?;
        let rebuilt = ring
            .rebuild(&view)
            .map_err(|why| anyhow::anyhow!("the frame was rejected: {why:?}"))?;
        let rebuilt = Arc::new(rebuilt);
        let head = StoredHead {
            meta: HeadMeta {
                id: encoded.id,
                layout: view.header.layout,
                mc_time_us: view.header.mc_time_us,
                phase: view.header.phase,
                image: view.header.image,
            },
            outputs: view.outputs.into(),
            state: Arc::clone(&rebuilt),
        };
        let write = RecordWrite::Head {
            mc: spec.mc.clone(),
            head,
        };
        file.write(&write).map_err(anyhow::Error::msg)?;
        ring.keep(encoded.id, rebuilt);
        let applied = cpu_ns();
        on_the_way.push_back(encoded.id);
        if on_the_way.len() > ACKNOWLEDGED_AFTER {
            acknowledged = on_the_way.pop_front();
        }
        if scan > warm as u64 {
            costs.push(Cost {
                sender_us: us(sent - from),
                gateway_us: us(applied - sent),
                bytes: encoded.bytes.len() as f64,
                full: encoded.full,
            });
        }
    }
    drop(file);
    std::fs::remove_file(records)?;
    Ok(costs)
}

/// Changes so many percent of the state, in variables spread evenly over it.
fn touch(state: &mut [u8], percent: usize, scan: u64) {
    let variables = (state.len() / VARIABLE).max(1);
    let changed = (variables * percent).div_ceil(100);
    for n in 0..changed {
        let at = n * variables / changed * VARIABLE;
        if let Some(variable) = state.get_mut(at..at + VARIABLE) {
            variable.copy_from_slice(&(scan + n as u64).to_le_bytes());
        }
    }
}

fn scanned(
    spec: &Arc<McSpec>,
    scan: u64,
    acknowledged: Option<CheckpointId>,
    buffer: Arc<fam_node_core::buffers::Buffer>,
) -> Result<ScannedFrame> {
    Ok(ScannedFrame {
        spec: spec.clone(),
        owner: Owner {
            controller: ControllerId::new("controller1")?,
            boot: BootId(1),
        },
        epoch: Epoch(1),
        scan: Scan(scan),
        image: ImageNumber(scan),
        base: None,
        base_bytes: None,
        mc_time_us: scan * CYCLE_US,
        phase: Phase::Running,
        released_to: None,
        scan_us: 50,
        capture_ns: 0,
        acknowledged,
        buffer,
    })
}

/// A cell with one MC whose checkpoint has this length, as the gateway's record file wants to know it.
fn cell(dir: &Path, size: usize) -> Result<(CellModel, Arc<McSpec>)> {
    let logic = "VAR_GLOBAL\n    Out AT %QX0.0 : BOOL;\nEND_VAR\nPROGRAM Large\nVAR_EXTERNAL\n    Out : BOOL;\nEND_VAR\nOut := NOT Out;\nEND_PROGRAM\n";
    let text = format!(
        "format = 1\n[cell]\nname = \"bench\"\ntick_ms = 5\n[[gateway]]\nname = \"{GATEWAY}\"\ndriver = \"image\"\n\
         [[controller]]\nname = \"controller1\"\nlimit_percent = 100\n\
         [[mc]]\nname = \"{MC}\"\nlogic = [\"large.st\"]\ngateway = \"{GATEWAY}\"\nhosts = \"all\"\ncriticality = 1\ncycle_ms = 5\n\
         worst_case_us = 1000\nwatchdog_ms = 1000\nsuspect_ms = 50\n[mc.inputs]\n[mc.outputs]\nOut = {{ field = \"image:Out\", fail_safe = false }}\n"
    );
    std::fs::write(dir.join("large.st"), logic)?;
    std::fs::write(dir.join("cell.toml"), text)?;
    let mut model = fam_engineering::build_model(&dir.join("cell.toml"))?;
    let mc = model.mcs.first_mut().context("the cell has one MC")?;
    mc.fail_safe = vec![0; OUTPUTS];
    mc.diagnosis.checkpoint_len = u32::try_from(size)?;
    mc.diagnosis.state_offset = 0;
    let spec = McSpec {
        index: 0,
        mc: McId::new(MC)?,
        gateway: GatewayId::new(GATEWAY)?,
        layout: mc.layout,
        cycle_us: mc.cycle_us,
        diagnosis: mc.diagnosis.clone(),
        control: fam_node_core::ControlOffsets {
            is_active: 0,
            was_active: 0,
            recovery_action: 0,
            actions: 0..0,
        },
        initial: vec![0; size],
        retained: Vec::new(),
        inputs_len: 0,
        outputs_len: OUTPUTS,
    };
    Ok((model, Arc::new(spec)))
}

/// CPU time of this thread, in nanoseconds.
fn cpu_ns() -> u64 {
    nix::time::clock_gettime(nix::time::ClockId::CLOCK_THREAD_CPUTIME_ID).map_or(0, |at| {
        u64::try_from(i128::from(at.tv_sec()) * 1_000_000_000 + i128::from(at.tv_nsec()))
            .unwrap_or(0)
    })
}

#[allow(clippy::cast_precision_loss)]
fn us(ns: u64) -> f64 {
    ns as f64 / 1_000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wanted_share_changes() {
        for (percent, want) in [(1, 13), (10, 125), (100, 1_250)] {
            let mut state = vec![0; 10_000];
            touch(&mut state, percent, 1);
            let changed = state.chunks(VARIABLE).filter(|v| v.iter().any(|b| *b != 0));
            assert_eq!(changed.count(), want, "{percent} %");
        }
    }

    #[test]
    fn a_delta_is_far_shorter_than_the_state_and_a_full_change_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let bytes = |change| {
            let costs = measure(dir.path(), 10_000, change, 10).unwrap();
            costs.iter().map(|c| c.bytes).fold(f64::MAX, f64::min)
        };
        assert!(bytes(1) < 2_000.0);
        assert!(bytes(100) > 10_000.0);
    }
}
