//! The node core with compiled logic of a real cell: handover, recovery, traps, the watchdog of endless loops, the cache.

#[path = "../core/tests/common/mod.rs"]
mod common;
mod faulty;

use common::{Cell, Gateway, Node, TICK_US};
use fam_controller_node::{HostError, host};
use fam_node_core::plc::PlcRuntime;
use fam_proto::access::{Activation, McAct, McNews};
use fam_proto::*;
use fam_soft_plc::{Engine, EngineOptions, Interruption, Value};
use std::path::{Path, PathBuf};

fn engine() -> Engine {
    Engine::new(EngineOptions {
        interruption: Interruption::Epoch,
    })
    .unwrap()
}

fn two_stations() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../engineering/tests/cells/two_stations/cell.toml")
}

/// A cell of two nodes that host the same MCs, and one engine for both.
fn cell(path: &Path, engine: &Engine) -> Cell<PlcRuntime> {
    let built = match fam_engineering::build(path) {
        Ok(built) => built,
        Err(problems) => panic!("{problems}"),
    };
    let node = |name: &str| {
        let controller = ControllerId::new(name).unwrap();
        let hosted = host(&built, &controller, engine, None).unwrap();
        Node::new(
            name,
            hosted.specs.into_iter().zip(hosted.runtimes).collect(),
        )
    };
    let lines = built.model.mcs.iter().map(|mc| {
        let inputs = vec![0; mc.inputs_len as usize];
        (mc.mc.clone(), inputs, mc.fail_safe.clone())
    });
    Cell {
        now: Now(1_000_000),
        gateway: Gateway::new(lines.collect()),
        a: node("controller1"),
        b: node("controller2"),
    }
}

fn running(node: &Node<PlcRuntime>, mc: usize, path: &str) -> Value {
    let active = node.core.active(mc).expect("active");
    active.runtime().instance().read(path).expect("a variable")
}

/// One round of the feeder: what its sensors show at a tick.
fn sensors(tick: u32) -> u8 {
    const START: u8 = 1;
    const OUT: u8 = 2;
    const HOME: u8 = 4;
    const TAKEN: u8 = 8;
    match tick % 24 {
        0..4 => START | HOME,
        4..14 => OUT,
        14..18 => HOME | TAKEN,
        _ => HOME,
    }
}

/// Runs the feeder for some ticks, and gives the head.
fn run(cell: &mut Cell<PlcRuntime>, ticks: std::ops::Range<u32>) -> Checkpoint {
    for tick in ticks {
        cell.gateway.inputs[0][0] = sensors(tick);
        cell.gateway.inputs[0][2] = (tick % 200) as u8;
        cell.tick();
    }
    cell.head(0).clone()
}

#[test]
fn a_handover_at_any_tick_makes_no_difference_to_the_state() {
    let engine = engine();
    let mut undisturbed = cell(&two_stations(), &engine);
    undisturbed.activate_a(0, |_| {});
    let expected = run(&mut undisturbed, 0..60);
    let fed = running(&undisturbed.a, 0, "fed");
    assert_eq!(fed, Value::Uint(3), "three parts are through");

    for ordered_at in [0, 1, 5, 9, 12, 17, 25, 30] {
        let mut cell = cell(&two_stations(), &engine);
        cell.activate_a(0, |_| {});
        let head = run(&mut cell, 0..ordered_at + 1);
        let successor = Successor {
            epoch: head.id.epoch.next(),
            owner: cell.b.owner.clone(),
        };
        let act = McAct::Release {
            epoch: head.id.epoch,
            successor,
            within_us: 5_000_000,
        };
        cell.a.act(0, act, cell.now);
        let mut tick = ordered_at + 1;
        while cell.gateway.lines[0].record.state == RecordState::Open {
            run(&mut cell, tick..tick + 1);
            tick += 1;
        }
        let mask = &cell.a.replicas[0].spec().diagnosis;
        assert!(mask.critical_interval(&cell.head(0).state).is_none());
        cell.activate_b(0, |_| {});
        let head = run(&mut cell, tick..60);
        assert_eq!(head.id.scan, expected.id.scan);
        assert_eq!(head.mc_time_us, expected.mc_time_us);
        assert_eq!(head.state, expected.state, "ordered at tick {ordered_at}");
        assert_eq!(
            cell.gateway.lines[0].outputs,
            undisturbed.gateway.lines[0].outputs
        );
    }
}

#[test]
fn an_interruption_in_the_critical_interval_retracts_the_pusher_first() {
    let engine = engine();
    let mut cell = cell(&two_stations(), &engine);
    cell.activate_a(0, |_| {});
    run(&mut cell, 0..3);
    let diagnosis = cell.a.replicas[0].spec().diagnosis.clone();
    let interval = diagnosis.critical_interval(&cell.head(0).state).unwrap();
    assert_eq!(interval.name, "Pushing");
    assert_eq!(
        cell.gateway.lines[0].outputs[0] & 1,
        1,
        "the pusher extends"
    );
    let recovery = interval.action;
    cell.activate_b(0, |a: &mut Activation| a.recovery = recovery);
    cell.gateway.inputs[0][0] = 0; // between its end positions
    for _ in 0..3 {
        cell.tick();
        assert_eq!(cell.head(0).phase, Phase::Recovering(recovery));
        assert_eq!(
            cell.gateway.lines[0].outputs[0] & 1,
            0,
            "the pusher retracts"
        );
    }
    // a is back: it goes on with the action where it is, timer included
    cell.gateway.inputs[0][0] = 4;
    cell.tick();
    cell.activate_a(0, |a| {
        a.recovery = recovery;
        a.keep_action = true;
    });
    let mut ticks = 0;
    while cell.head(0).phase != Phase::Running {
        cell.tick();
        ticks += 1;
        assert!(ticks < 6);
    }
    assert_eq!(ticks, 4, "20 ms of dwell from the first tick at home");
    assert_eq!(
        running(&cell.a, 0, "Feeder.step"),
        running(&cell.a, 0, "Feeder.next")
    );
    assert!(diagnosis.critical_interval(&cell.head(0).state).is_none());
    assert!(
        cell.a
            .news()
            .iter()
            .any(|n| matches!(n, McNews::Recovered { .. }))
    );
}

#[test]
fn the_stop_pou_ends_in_stopped_and_a_warm_reset_keeps_retained_variables() {
    let engine = engine();
    let mut cell = cell(&two_stations(), &engine);
    cell.activate_a(0, |_| {});
    run(&mut cell, 0..30);
    assert_eq!(running(&cell.a, 0, "fed"), Value::Uint(1));
    let stop = cell.a.replicas[0].spec().diagnosis.stop_action.unwrap();
    let act = McAct::RunAction {
        epoch: Epoch(1),
        action: stop,
    };
    cell.a.act(0, act, cell.now);
    cell.tick();
    assert_eq!(cell.head(0).phase, Phase::Stopped);
    assert_eq!(cell.gateway.lines[0].record.state, RecordState::Stopped);
    cell.tick();
    cell.activate_b(0, |a| {
        if let access::Start::From { retained_only, .. } = &mut a.start {
            *retained_only = true;
        }
    });
    cell.tick();
    assert_eq!(running(&cell.b, 0, "fed"), Value::Uint(1));
    assert_eq!(running(&cell.b, 0, "Feeder.next"), Value::Int(0));
}

#[test]
fn a_trap_names_pou_and_line_and_stays_in_its_mc() {
    let engine = engine();
    let folder = faulty::cell();
    let mut cell = cell(&folder.path().join("cell.toml"), &engine);
    cell.gateway.inputs[0][0] = 5;
    cell.activate_a(0, |_| {});
    cell.activate_a(1, |_| {});
    for _ in 0..5 {
        cell.tick();
    }
    assert_eq!(running(&cell.a, 0, "quotient"), Value::Int(20));
    let good = cell.head(0).clone();
    cell.a.news();
    // a scan that goes on until somebody ends it
    for (input, line, words) in [
        (0u8, 12, "division by zero"),
        (faulty::LOOPS_FOR_EVER, 9, "endless loop"),
    ] {
        cell.gateway.inputs[0][0] = input;
        let done = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                // the engine's watchdog; another scan never sees two ticks
                while input == faulty::LOOPS_FOR_EVER
                    && !done.load(std::sync::atomic::Ordering::Relaxed)
                {
                    std::thread::yield_now();
                    engine.interrupt_tick();
                }
            });
            cell.tick();
            done.store(true, std::sync::atomic::Ordering::Relaxed);
        });
        let news = cell.a.news();
        let trap = news.iter().find_map(|n| match n {
            McNews::Trapped { trap, .. } if trap.pou == "Divider" => Some(trap),
            _ => None,
        });
        let trap = trap.unwrap_or_else(|| panic!("{news:?}"));
        assert!(trap.message.contains(words), "{trap}");
        assert!(trap.file.ends_with("divider.st"), "{trap}");
        assert!(trap.line.abs_diff(line) <= 1, "{trap}");
        assert_eq!(cell.head(0).id, good.id);
        // ordered to go on from the last good checkpoint, for the next round
        let act = McAct::Deactivate {
            epoch: cell.gateway.lines[0].record.epoch,
        };
        cell.a.act(0, act, cell.now);
        cell.activate_a(0, |_| {});
        cell.a.news();
    }
    cell.gateway.inputs[0][0] = 5;
    cell.tick();
    assert_eq!(running(&cell.a, 0, "Divider.scans"), Value::Int(6));
    // a trap is answered by the stop POU
    cell.gateway.inputs[0][0] = 0;
    cell.tick();
    let epoch = cell.gateway.lines[0].record.epoch;
    let action = cell.a.replicas[0].spec().diagnosis.stop_action.unwrap();
    cell.a.act(0, McAct::RunAction { epoch, action }, cell.now);
    cell.tick();
    assert_eq!(cell.gateway.lines[0].record.state, RecordState::Stopped);
    assert_eq!(cell.gateway.lines[0].outputs[..2], [0xff, 0xff]);
}

#[test]
fn checkpoints_of_both_nodes_are_the_same_bytes() {
    let engine = engine();
    let mut cell = cell(&two_stations(), &engine);
    cell.activate_a(0, |_| {});
    cell.activate_b(1, |_| {});
    run(&mut cell, 0..20);
    let instance = |node: &Node<PlcRuntime>, mc: usize| {
        use fam_node_core::McRuntime;
        node.replicas[mc].runtime().unwrap().checkpoint().to_vec()
    };
    assert_eq!(instance(&cell.b, 0), cell.head(0).state);
    assert_eq!(instance(&cell.a, 1), cell.head(1).state);
    assert!(cell.a.delta > 15, "{} full", cell.a.full);
    let _ = TICK_US;
}

#[test]
fn machine_code_is_kept_and_damage_is_compiled_anew() {
    let engine = engine();
    let built = fam_engineering::build(&two_stations()).unwrap();
    let controller = ControllerId::new("controller1").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let cache = folder.path().join("cache");
    let files = || {
        let mut files: Vec<_> = std::fs::read_dir(&cache)
            .unwrap()
            .map(|f| f.unwrap().path())
            .collect();
        files.sort();
        files
    };
    for _ in 0..2 {
        let hosted = host(&built, &controller, &engine, Some(&cache)).unwrap();
        assert_eq!(hosted.runtimes.len(), 2);
        assert_eq!(files().len(), 2);
    }
    let damaged = &files()[0];
    let mut bytes = std::fs::read(damaged).unwrap();
    let at = bytes.len() / 2;
    bytes[at] ^= 1;
    std::fs::write(damaged, &bytes).unwrap();
    host(&built, &controller, &engine, Some(&cache)).unwrap();
    assert_ne!(std::fs::read(damaged).unwrap(), bytes, "made anew");
}

#[test]
fn a_controller_that_the_cell_does_not_have_is_named_with_those_that_it_has() {
    let built = fam_engineering::build(&two_stations()).unwrap();
    let controller = ControllerId::new("controller9").unwrap();
    let error = host(&built, &controller, &engine(), None).err().unwrap();
    assert!(matches!(error, HostError::UnknownController { .. }));
    assert_eq!(
        error.to_string(),
        "the cell two_stations has no controller `controller9`: it has controller1, controller2"
    );
}
