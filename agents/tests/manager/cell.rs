//! The cell of the tests, and records in words.

use fam_proto::diagnosis::Diagnosis;
use fam_proto::model::{CellModel, ControllerModel, FieldDriver, GatewayModel, McModel, Settings};
use fam_proto::*;

pub fn c(name: &str) -> ControllerId {
    ControllerId::new(name).unwrap()
}

pub fn m(name: &str) -> McId {
    McId::new(name).unwrap()
}

pub fn gw() -> GatewayId {
    GatewayId::new("gw").unwrap()
}

/// Controllers `c1`, `c2`, ... and MCs `m1`, `m2`, ..., all hosted everywhere; `m1` is the most critical.
pub fn model(controllers: usize, mcs: usize) -> CellModel {
    let names: Vec<ControllerId> = (1..=controllers).map(|n| c(&format!("c{n}"))).collect();
    CellModel {
        cell: CellId::new("test").unwrap(),
        controllers: names
            .iter()
            .map(|name| ControllerModel {
                controller: name.clone(),
                description: String::new(),
                cpu_factor_permille: 1_000,
                memory_kb: 1_000,
                limit_permille: 500,
                tick_us: 5_000,
            })
            .collect(),
        mcs: (1..=mcs)
            .map(|n| McModel {
                mc: m(&format!("m{n}")),
                gateway: gw(),
                hosts: names.clone(),
                criticality: u32::try_from(100 - n).unwrap(),
                cycle_us: 5_000,
                worst_case_us: 500,
                memory_kb: 100,
                watchdog_us: 100_000,
                suspect_us: 25_000,
                hash: 7,
                layout: LayoutHash(7),
                diagnosis: Diagnosis {
                    state_offset: 0,
                    checkpoint_len: 100,
                    intervals: Vec::new(),
                    stop_action: None,
                },
                inputs: Vec::new(),
                inputs_len: 0,
                outputs: Vec::new(),
                fail_safe: Vec::new(),
            })
            .collect(),
        gateways: vec![GatewayModel {
            gateway: gw(),
            tick_us: 5_000,
            driver: FieldDriver::Image,
        }],
        settings: Settings::default(),
    }
}

/// `c1.3`: controller c1 in its life 3.
pub fn split(who: &str) -> (&str, u64) {
    let (name, boot) = who.split_once('.').unwrap();
    (name, boot.parse().unwrap())
}

pub fn owner(name: &str, boot: u64) -> Owner {
    Owner {
        controller: c(name),
        boot: BootId(boot),
    }
}

/// `never`, `open,c1.1,e3`, `opening,c1.1,e3` (no frame yet), `opening,c1.1,e5,e4` (the same, and epoch 4 was the last that drove), `silent,c1.1,e3`, `released,c1.1,e3,c2.1,e4`, `closed,c1.1,e3`,
/// `failsafe,c1.1,e3`, `stopped,c1.1,e3`, `faulted,c1.1,e3`.
pub fn record(mc: &McId, text: &str) -> RecordSummary {
    let parts: Vec<&str> = text.split(',').collect();
    let epoch = |text: &str| Epoch(text.trim_start_matches('e').parse().unwrap());
    let by = |who: &str| {
        let (name, boot) = split(who);
        owner(name, boot)
    };
    let mut record = RecordSummary {
        mc: mc.clone(),
        epoch: parts.get(2).map_or(Epoch(0), |e| epoch(e)),
        owner: parts.get(1).map(|o| by(o)),
        state: RecordState::Open,
        head: parts.get(2).map(|e| CheckpointId {
            epoch: epoch(e),
            scan: Scan(100),
            digest: Digest::default(),
        }),
        phase: None,
        driven: true,
        silent_us: 2_000,
        suspect: false,
        rejected: 0,
    };
    match parts[0] {
        "open" => {}
        "opening" => {
            record.driven = false;
            if let (Some(last), Some(head)) = (parts.get(3), &mut record.head) {
                head.epoch = epoch(last);
            }
        }
        "silent" => {
            record.silent_us = 30_000;
            record.suspect = true;
        }
        other => {
            record.silent_us = 0;
            record.driven = false;
            record.state = match other {
                "never" => RecordState::Never,
                "released" => RecordState::Released(Successor {
                    epoch: epoch(parts[4]),
                    owner: by(parts[3]),
                }),
                "closed" => RecordState::Closed,
                "failsafe" => RecordState::FailSafe,
                "stopped" => RecordState::Stopped,
                "faulted" => RecordState::Faulted(TrapInfo {
                    pou: "M".to_owned(),
                    file: "m.st".to_owned(),
                    line: 7,
                    message: "division by zero".to_owned(),
                }),
                _ => panic!("unknown record {text}"),
            };
        }
    }
    record
}
