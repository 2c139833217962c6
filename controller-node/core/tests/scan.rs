//! The scan core with the model MC: chain, release, recovery, traps, freshness, deposition.

mod common;

use common::*;
use fam_node_core::model_mc::{
    ACTION_SCANS, CARRY, ModelMc, PRESS, STEPS, STOP, TRAP_ALWAYS, TRAP_INPUT,
};
use fam_node_core::{Carry, McRuntime, StagedVersion};
use fam_proto::access::{McAct, McNews, Start, StateSource};
use fam_proto::*;
use std::sync::Arc;

fn started(epoch: u64) -> McNews {
    McNews::Started {
        epoch: Epoch(epoch),
    }
}

fn successor(cell: &Cell<ModelMc>) -> Successor {
    Successor {
        epoch: cell.gateway.lines[0].record.epoch.next(),
        owner: cell.b.owner.clone(),
    }
}

fn release(cell: &mut Cell<ModelMc>, within_us: u64) {
    let act = McAct::Release {
        epoch: cell.gateway.lines[0].record.epoch,
        successor: successor(cell),
        within_us,
    };
    cell.a.act(0, act, cell.now);
}

/// The trace of a run that nothing has disturbed.
fn undisturbed(scans: u64) -> u64 {
    let mut mc = ModelMc::new(0);
    mc.checkpoint_mut()[0] = 1;
    for scan in 1..=scans {
        mc.scan(scan * TICK_US).unwrap();
    }
    ModelMc::trace(mc.checkpoint())
}

#[test]
fn after_an_interruption_the_first_scan_does_not_wait_for_a_tick() {
    let mut cell = model_cell(0);
    cell.activate_a(0, |_| {});
    for _ in 0..5 {
        cell.tick();
    }
    let image = cell.gateway.image();
    cell.b.core.image(image, cell.now);
    cell.activate_b(0, |a| a.at_once = true);
    let (b, now) = (&mut cell.b, cell.now.plus_us(TICK_US / 2));
    b.core.start_at_once(now, &mut b.host);
    b.core.start_at_once(now, &mut b.host);
    assert_eq!(
        b.host.frames.len(),
        1,
        "one scan, however often it is rung for"
    );
    for bytes in cell.b.sent(now) {
        cell.gateway.frame(&bytes);
        receive(&mut cell.a, &bytes);
    }
    cell.tick();
    let applied = &cell.gateway.lines[0].applied;
    let (scans, b) = (applied.len(), &cell.b.owner);
    assert_eq!(scans, 7, "and the next one at the next tick");
    assert!(applied[5..].iter().all(|h| &h.owner == b));

    // Without an interruption the cycle is kept: nothing between ticks.
    cell.activate_a(0, |a| a.at_once = false);
    let a = &mut cell.a;
    a.host.frames.clear();
    a.core.start_at_once(cell.now, &mut a.host);
    assert!(a.host.frames.is_empty());
}

#[test]
fn frames_form_one_chain_over_epochs() {
    let mut cell = model_cell(100);
    cell.activate_a(0, |_| {});
    assert_eq!(cell.a.news(), [started(1)]);
    for _ in 0..10 {
        cell.tick();
    }
    let applied = &cell.gateway.lines[0].applied;
    let scans: Vec<u64> = applied.iter().map(|h| h.scan.0).collect();
    assert_eq!(scans, (1..=10).collect::<Vec<_>>());
    assert!(applied.iter().all(|h| h.base.is_none()));
    assert_eq!(applied[9].mc_time_us, 10 * TICK_US);
    // the first had nothing to be told against, the others were deltas
    assert_eq!((cell.a.full, cell.a.delta), (1, 9));
    let head = cell.head(0).id;
    assert_eq!(cell.b.replicas[0].held(), Some(head));
    assert_eq!(
        cell.b.replicas[0].runtime().unwrap().checkpoint(),
        cell.head(0).state
    );

    // node a is gone: b goes on from the head that it holds itself
    cell.activate_b(0, |a| {
        a.start = Start::From {
            source: StateSource::Held(head),
            retained_only: false,
        };
    });
    for _ in 0..3 {
        cell.tick();
    }
    let applied = &cell.gateway.lines[0].applied;
    assert_eq!(applied[10].base, Some(head));
    assert_eq!(
        applied[10].content,
        Content::Delta(head),
        "the base counts as acknowledged"
    );
    assert_eq!(
        applied[11].base, None,
        "acknowledged in the image of its scan"
    );
    assert_eq!(applied[12].scan, Scan(13));
    assert_eq!(ModelMc::trace(&cell.head(0).state), undisturbed(13));
}

#[test]
fn a_deposed_mc_stops_before_its_next_scan_and_its_instance_is_passive_again() {
    let mut cell = model_cell(0);
    cell.activate_a(0, |_| {});
    cell.tick();
    cell.a.news();
    cell.activate_b(0, |_| {});
    cell.tick();
    assert!(cell.a.core.active(0).is_none());
    assert_eq!(
        cell.a.news(),
        [McNews::Deposed {
            epoch: Epoch(1),
            why: "epoch 2 of b (boot 1) is on record".to_owned()
        }]
    );
    for _ in 0..5 {
        cell.tick();
    }
    // it follows the frames of b from its own last checkpoint on
    assert_eq!(cell.a.replicas[0].held(), Some(cell.head(0).id));
    assert_eq!(ModelMc::trace(&cell.head(0).state), undisturbed(7));
}

#[test]
fn a_release_never_falls_into_a_critical_interval_and_loses_nothing() {
    // ordered at every step of the round
    for wait in 0..STEPS {
        let mut cell = model_cell(0);
        cell.activate_a(0, |_| {});
        for _ in 0..=wait {
            cell.tick();
        }
        release(&mut cell, 5_000_000);
        cell.a.news();
        let mut ticks = 0;
        while !matches!(cell.gateway.lines[0].record.state, RecordState::Released(_)) {
            cell.tick();
            ticks += 1;
            assert!(ticks <= 4, "released within a round");
        }
        let step = ModelMc::step(&cell.head(0).state);
        assert!(
            !matches!(step, 3 | 4 | 7 | 9),
            "ordered after step {wait}, released at step {step}"
        );
        let last = cell.head(0).id;
        // no logic runs any more; the record has told it by the next tick
        cell.tick();
        assert_eq!(cell.head(0).id, last);
        assert_eq!(
            cell.a.news(),
            [McNews::Released {
                epoch: Epoch(1),
                scan: last.scan
            }]
        );
        cell.activate_b(0, |_| {});
        cell.tick();
        assert_eq!(
            ModelMc::trace(&cell.head(0).state),
            undisturbed(last.scan.0 + 1)
        );
    }
}

#[test]
fn a_released_frame_is_repeated_without_logic_until_it_is_on_record() {
    let mut cell = model_cell(0);
    cell.activate_a(0, |_| {});
    cell.tick();
    release(&mut cell, 5_000_000);
    // from here the gateway hears nothing; images still come
    let mut frames = Vec::new();
    for _ in 0..6 {
        cell.now = cell.now.plus_us(TICK_US);
        let image = cell.gateway.image();
        cell.a.core.image(image, cell.now);
        cell.a.tick(cell.now);
        frames.extend(cell.a.sent(cell.now));
    }
    assert_eq!(frames.len(), 6);
    for bytes in &frames {
        let header = decode_frame(bytes).unwrap().header;
        assert_eq!(header.scan, Scan(2));
        assert!(header.released_to.is_some());
    }
    assert_eq!(
        decode_frame(&frames[5]).unwrap().header.content,
        Content::Full,
        "a lost delta is made good"
    );
    // cancelled too late: it is irrevocable
    let act = McAct::CancelRelease { epoch: Epoch(1) };
    cell.a.act(0, act, cell.now);
    cell.a.news();
    cell.gateway.frame(&frames[5]);
    cell.tick();
    assert!(matches!(cell.a.news()[..], [McNews::Released { .. }]));
}

#[test]
fn a_release_that_finds_no_moment_is_cancelled_and_the_mc_goes_on() {
    let mut cell = model_cell(0);
    cell.activate_a(0, |_| {});
    for _ in 0..3 {
        cell.tick(); // step 3: in `Carry`
    }
    cell.a.news();
    release(&mut cell, 1_000);
    cell.tick();
    assert_eq!(
        cell.a.news(),
        [McNews::ReleaseCancelled {
            epoch: Epoch(1),
            why: "1 ms have passed in critical interval Carry".to_owned()
        }]
    );
    for _ in 0..5 {
        cell.tick();
    }
    assert_eq!(cell.gateway.lines[0].record.state, RecordState::Open);
    assert_eq!(ModelMc::trace(&cell.head(0).state), undisturbed(9));
    // called off by the manager
    release(&mut cell, 5_000_000);
    let act = McAct::CancelRelease { epoch: Epoch(1) };
    cell.a.act(0, act, cell.now);
    assert!(matches!(
        cell.a.news()[..],
        [McNews::ReleaseCancelled { .. }]
    ));
    cell.tick();
    assert_eq!(cell.gateway.lines[0].record.state, RecordState::Open);
    // an act about another epoch is a late word
    for act in [
        McAct::Deactivate { epoch: Epoch(7) },
        McAct::RunAction {
            epoch: Epoch(7),
            action: STOP,
        },
    ] {
        cell.a.act(0, act, cell.now);
    }
    cell.tick();
    assert_eq!(cell.head(0).phase, Phase::Running);
}

#[test]
fn an_interrupted_critical_interval_is_recovered_and_an_interrupted_recovery_goes_on() {
    let mut cell = model_cell(0);
    cell.activate_a(0, |_| {});
    for _ in 0..3 {
        cell.tick();
    }
    let count = ModelMc::count(&cell.head(0).state);
    cell.activate_b(0, |a| a.recovery = CARRY);
    cell.b.news();
    cell.tick();
    cell.tick();
    assert_eq!(cell.head(0).phase, Phase::Recovering(CARRY));
    assert_eq!(ModelMc::count(&cell.head(0).state), count);
    // b fails in the middle of it; a goes on with the action's own state
    cell.activate_a(0, |a| {
        a.recovery = CARRY;
        a.keep_action = true;
    });
    cell.a.news();
    for _ in 2..ACTION_SCANS {
        assert_eq!(cell.head(0).phase, Phase::Recovering(CARRY));
        cell.tick();
    }
    assert_eq!(cell.head(0).phase, Phase::Running);
    assert_eq!(ModelMc::step(&cell.head(0).state), 1);
    assert_eq!(ModelMc::count(&cell.head(0).state), count + 1);
    assert_eq!(
        cell.a.news(),
        [McNews::Recovered {
            epoch: Epoch(3),
            scan: Scan(3 + ACTION_SCANS as u64)
        }]
    );
    // the same action begins anew the next time
    cell.activate_b(0, |a| a.recovery = CARRY);
    cell.tick();
    assert_eq!(cell.head(0).phase, Phase::Recovering(CARRY));
}

#[test]
fn a_safe_stop_ends_in_a_stopped_record() {
    let mut cell = model_cell(0);
    cell.activate_a(0, |_| {});
    cell.tick();
    cell.activate_b(0, |a| a.recovery = PRESS);
    cell.b.news();
    for _ in 1..ACTION_SCANS {
        cell.tick();
        assert_eq!(cell.head(0).phase, Phase::Stopping(PRESS));
    }
    cell.tick();
    assert_eq!(cell.head(0).phase, Phase::Stopped);
    cell.tick();
    assert_eq!(
        cell.b.news(),
        [McNews::Stopped {
            epoch: Epoch(2),
            scan: Scan(1 + ACTION_SCANS as u64)
        }]
    );
    assert!(cell.b.core.active(0).is_none());
}

#[test]
fn a_trap_stays_in_its_mc_and_the_stop_pou_starts_from_the_last_good_checkpoint() {
    let mut cell = model_cell(0);
    cell.activate_a(0, |_| {});
    cell.activate_a(1, |_| {});
    for _ in 0..4 {
        cell.tick();
    }
    cell.a.news();
    let good = cell.head(0).clone();
    cell.gateway.inputs[0][0] = TRAP_INPUT;
    cell.tick();
    cell.tick();
    let news = cell.a.news();
    let [McNews::Trapped { epoch, trap }] = &news[..] else {
        panic!("{news:?}");
    };
    assert_eq!(*epoch, Epoch(1));
    assert_eq!(trap.message, "division by zero");
    assert_eq!(cell.head(0).id, good.id, "nothing half done has gone out");
    assert_eq!(cell.head(1).id.scan, Scan(6), "the other MC runs on");
    let act = McAct::RunAction {
        epoch: Epoch(1),
        action: STOP,
    };
    cell.a.act(0, act, cell.now);
    cell.tick();
    assert_eq!(cell.head(0).phase, Phase::Stopping(STOP));
    assert_eq!(
        ModelMc::trace(&cell.head(0).state),
        ModelMc::trace(&good.state)
    );
    assert_eq!(
        ModelMc::count(&cell.head(0).state),
        ModelMc::count(&good.state)
    );
    for _ in 0..ACTION_SCANS {
        cell.tick();
    }
    assert_eq!(cell.gateway.lines[0].record.state, RecordState::Stopped);
    assert!(matches!(cell.a.news()[..], [McNews::Stopped { .. }]));
    assert_eq!(cell.head(1).id.scan, Scan(11));
}

#[test]
fn a_trap_in_the_first_scan_and_in_the_stop_pou_are_reported() {
    let mut cell = model_cell(0);
    cell.gateway.inputs[0][0] = TRAP_ALWAYS;
    cell.activate_a(0, |_| {});
    cell.tick();
    let act = McAct::RunAction {
        epoch: Epoch(1),
        action: STOP,
    };
    cell.a.act(0, act, cell.now);
    cell.tick();
    let traps: Vec<String> = cell
        .a
        .news()
        .into_iter()
        .filter_map(|n| match n {
            McNews::Trapped { trap, .. } => Some(trap.message),
            _ => None,
        })
        .collect();
    assert_eq!(traps, ["division by zero", "index out of range"]);
    let act = McAct::Deactivate { epoch: Epoch(1) };
    cell.a.act(0, act, cell.now);
    assert!(cell.a.core.active(0).is_none());
    // the instance is as new
    cell.gateway.inputs[0][0] = 0;
    cell.activate_a(0, |_| {});
    cell.tick();
    assert_eq!(ModelMc::trace(&cell.head(0).state), undisturbed(1));
}

#[test]
fn without_a_fresh_image_nothing_runs_and_mc_time_stands() {
    let mut cell = model_cell(0);
    cell.activate_a(0, |_| {});
    cell.tick();
    // images stay away: the last one is good for three ticks
    for _ in 0..10 {
        cell.now = cell.now.plus_us(TICK_US);
        cell.a.tick(cell.now);
        for bytes in cell.a.sent(cell.now) {
            cell.gateway.frame(&bytes);
            cell.b.replicas[0].frame(&bytes).unwrap().held.unwrap();
        }
    }
    assert_eq!(cell.head(0).id.scan, Scan(4));
    assert_eq!(cell.head(0).mc_time_us, 4 * TICK_US);
    let (_, _, work, lag_us) = cell.a.core.loads(cell.now).next().unwrap();
    assert_eq!((work.starved, lag_us), (7, 6 * TICK_US));
    // the field does not answer: images come, but are not fresh
    cell.gateway.fresh = false;
    cell.tick();
    assert_eq!(cell.head(0).id.scan, Scan(4));
    cell.gateway.fresh = true;
    cell.tick();
    assert_eq!(cell.head(0).mc_time_us, 5 * TICK_US);
    // an image older than the checkpoint's is no image: a node that has seen no other waits for a newer one
    let newest = cell.gateway.number;
    cell.b.core = fam_node_core::ScanCore::new(cell.b.owner.clone(), TICK_US as u32, 1_000, 2);
    cell.activate_b(0, |_| {});
    for (number, frames) in [(newest - 2, 0), (newest - 1, 1)] {
        cell.gateway.number = number; // the image is numbered one higher
        let image = cell.gateway.image();
        cell.b.core.image(image, cell.now);
        cell.b.tick(cell.now);
        assert_eq!(cell.b.sent(cell.now).len(), frames);
    }
}

#[test]
fn an_activation_waits_for_the_instance_to_come_back() {
    let mut cell = model_cell(0);
    cell.activate_a(0, |_| {});
    cell.tick();
    let again = cell.gateway.open(0, &cell.a.owner.clone());
    let epoch = again.epoch;
    cell.a.news();
    // the agent has deactivated epoch 1 and opened epoch 2, but the scan thread has not had its tick yet
    cell.a.act(0, McAct::Activate(Box::new(again)), cell.now);
    assert_eq!(cell.a.news(), []);
    cell.tick();
    let news = cell.a.news();
    assert!(
        matches!(news[..], [McNews::Started { epoch: e }, McNews::Deposed { .. }] | [McNews::Deposed { .. }, McNews::Started { epoch: e }] if e == epoch),
        "{news:?}"
    );
    cell.tick();
    assert_eq!(ModelMc::trace(&cell.head(0).state), undisturbed(2));
}

#[test]
fn a_start_that_does_not_fit_is_refused_with_the_reason() {
    let mut cell = model_cell(0);
    cell.activate_a(0, |a| a.outputs = vec![0; 3]);
    cell.activate_a(0, |a| {
        a.start = Start::From {
            source: StateSource::Held(CheckpointId::default()),
            retained_only: false,
        };
    });
    let reasons: Vec<String> = cell
        .a
        .news()
        .into_iter()
        .map(|n| match n {
            McNews::NotStarted { why, .. } => why,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(
        reasons,
        [
            "the gateway's output image has 3 bytes, Model0 here has 9; generate all projects from one model",
            "the checkpoint of scan 0 is held no more",
        ]
    );
}

#[test]
fn a_warm_start_keeps_retained_variables_only() {
    let mut cell = model_cell(8);
    cell.activate_a(0, |_| {});
    for _ in 0..6 {
        cell.tick();
    }
    let before = cell.head(0).clone();
    cell.activate_b(0, |a| {
        if let Start::From { retained_only, .. } = &mut a.start {
            *retained_only = true;
        }
    });
    cell.tick();
    let after = cell.head(0);
    assert_eq!(ModelMc::count(&after.state), 7);
    assert_eq!(ModelMc::step(&after.state), 1);
    assert_eq!(after.mc_time_us, before.mc_time_us + TICK_US);
    assert_eq!(cell.gateway.lines[0].applied[6].base, Some(before.id));
    assert_eq!(cell.gateway.lines[0].applied[6].content, Content::Full);
}

#[test]
fn a_slower_controller_spends_and_counts_its_time() {
    let mut cell = model_cell(0);
    cell.a.core = fam_node_core::ScanCore::new(cell.a.owner.clone(), TICK_US as u32, 500, 2);
    cell.activate_a(0, |_| {});
    cell.tick();
    // the host's clock goes on by 100 us with each look
    assert_eq!(cell.a.host.spent_ns, 100_000);
    assert_eq!(cell.gateway.lines[0].applied[0].scan_us, 200);
}

/// A version with more state takes the place of the one that runs, on the controller that runs it and on the one that does not.
#[test]
fn a_new_version_goes_on_from_the_state_that_the_old_one_released() {
    let mut cell = model_cell(0);
    cell.activate_a(0, |_| {});
    for _ in 0..20 {
        cell.tick();
    }
    let more = 64;
    let staged = |version| {
        let old = ModelMc::spec(0, mc_id(0), gateway_id(), TICK_US as u32, 0);
        let new = ModelMc::spec(0, mc_id(0), gateway_id(), TICK_US as u32, more);
        Box::new(StagedVersion {
            version,
            carry: Carry {
                from: old.layout,
                from_len: old.initial.len(),
                copies: vec![(0..old.initial.len(), 0)],
                zeros: Vec::new(),
                bits: Vec::new(),
            },
            spec: Arc::new(new),
            runtime: ModelMc::new(more),
        })
    };
    cell.a.replicas[0].stage(staged(7));
    cell.b.replicas[0].stage(staged(7));
    assert!(cell.b.replicas[0].awaits(ModelMc::layout(more)));
    let own = cell.a.owner.clone();
    let act = McAct::Release {
        epoch: cell.gateway.lines[0].record.epoch,
        successor: Successor {
            epoch: cell.gateway.lines[0].record.epoch.next(),
            owner: own,
        },
        within_us: 1_000_000,
    };
    cell.a.act(0, act, cell.now);
    while !cell
        .a
        .news()
        .iter()
        .any(|n| matches!(n, McNews::Released { .. }))
    {
        cell.tick();
    }
    let released = cell.head(0).clone();
    // What is not staged does not run, and neither does a state of another length.
    cell.activate_a(0, |a| a.renew = Some(8));
    assert!(matches!(cell.a.news()[..], [McNews::NotStarted { .. }]));
    cell.activate_a(0, |a| {
        a.renew = Some(7);
        if let Start::From {
            source: StateSource::Given(given),
            ..
        } = &mut a.start
        {
            Arc::make_mut(given).state.pop();
        }
    });
    assert!(matches!(cell.a.news()[..], [McNews::NotStarted { .. }]));
    cell.activate_a(0, |a| a.renew = Some(7));
    for _ in 0..10 {
        cell.tick();
    }
    let head = cell.head(0).clone();
    assert_eq!(head.layout, ModelMc::layout(more));
    assert_eq!(head.state.len(), released.state.len() + more);
    assert_eq!(
        head.id.scan.0,
        released.id.scan.0 + 10,
        "no scan is missing"
    );
    assert_eq!(ModelMc::trace(&head.state), undisturbed(head.id.scan.0));
    // The other one holds it from the word to do so on, and can go on with it.
    let missed = cell.b.replicas[0].refused();
    assert!(missed > 0, "frames of the new version came before the word");
    cell.b.act(0, McAct::Adopt { version: 7 }, cell.now);
    for _ in 0..300 {
        cell.tick();
    }
    assert_eq!(
        cell.b.replicas[0].held().unwrap().scan,
        cell.head(0).id.scan
    );
    cell.activate_b(0, |_| {});
    for _ in 0..5 {
        cell.tick();
    }
    let last = cell.head(0).clone();
    assert_eq!(
        cell.gateway.lines[0].applied.last().unwrap().owner,
        cell.b.owner
    );
    assert_eq!(ModelMc::trace(&last.state), undisturbed(last.id.scan.0));
}
