//! Whatever is lost on the way, a replica holds either exactly what was run or says that it does not.

mod common;

use common::*;
use fam_node_core::McRuntime;
use fam_node_core::model_mc::ModelMc;
use fam_node_core::replica::FrameRefusal;
use fam_proto::*;
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn deltas_and_full_checkpoints_lead_to_the_same_state(
        losses in prop::collection::vec((any::<bool>(), any::<bool>(), any::<bool>()), 20..60),
        padding in 0usize..600,
    ) {
        let mut cell = model_cell(padding);
        cell.activate_a(0, |_| {});
        let mut kept = 0;
        for (to_gateway, to_replica, image) in losses {
            cell.now = cell.now.plus_us(TICK_US);
            let seen = cell.gateway.image();
            // a lost image only delays acknowledgements: one of the last three ticks is still fresh
            if image || cell.now.0.is_multiple_of(2 * TICK_US) {
                cell.a.core.image(seen, cell.now);
            }
            cell.a.tick(cell.now);
            let run = cell.a.core.active(0).unwrap().runtime().checkpoint().to_vec();
            for bytes in cell.a.sent(cell.now) {
                if to_gateway {
                    let applied = cell.gateway.frame(&bytes);
                    prop_assert_eq!(&applied.state, &run);
                }
                if to_replica {
                    match cell.b.replicas[0].frame(&bytes).unwrap().held {
                        Ok(id) => {
                            kept += 1;
                            let instance = cell.b.replicas[0].runtime().unwrap().checkpoint();
                            prop_assert_eq!(instance, &run[..]);
                            prop_assert_eq!(cell.b.replicas[0].held(), Some(id));
                        }
                        Err(FrameRefusal::NoBase(_)) => {}
                        Err(other) => prop_assert!(false, "{other}"),
                    }
                }
            }
        }
        prop_assert!(kept <= 60);
    }

    #[test]
    fn garbage_and_damage_never_reach_the_instance(flip in any::<prop::sample::Index>(), bit in 0u8..8, cut in any::<prop::sample::Index>()) {
        let mut cell = model_cell(40);
        cell.activate_a(0, |_| {});
        cell.tick();
        let held = cell.b.replicas[0].held();
        let state = cell.b.replicas[0].runtime().unwrap().checkpoint().to_vec();
        cell.now = cell.now.plus_us(TICK_US);
        let image = cell.gateway.image();
        cell.a.core.image(image, cell.now);
        cell.a.tick(cell.now);
        let bytes = cell.a.sent(cell.now).remove(0);
        let whole = decode_frame(&bytes).unwrap();
        let mut damaged = bytes.clone();
        let at = flip.index(damaged.len());
        damaged[at] ^= 1 << bit;
        for bad in [&damaged[..], &bytes[..cut.index(bytes.len())]] {
            let seen = cell.b.replicas[0].frame(bad);
            let now_held = cell.b.replicas[0].held();
            if now_held == held {
                prop_assert_eq!(cell.b.replicas[0].runtime().unwrap().checkpoint(), &state[..]);
            } else {
                // damage outside of what the digest guards: the state is the one that was sent
                prop_assert!(seen.unwrap().held.is_ok());
                let run = cell.a.core.active(0).unwrap().runtime().checkpoint();
                prop_assert_eq!(cell.b.replicas[0].runtime().unwrap().checkpoint(), run);
                break;
            }
        }
        prop_assert_eq!(whole.header.scan, Scan(2));
    }
}

#[test]
fn a_late_replica_gets_a_whole_checkpoint_within_a_second() {
    let mut cell = model_cell(400);
    cell.activate_a(0, |_| {});
    for _ in 0..20 {
        cell.tick();
    }
    let mut late = model_node("c", 400);
    let mut ticks = 0;
    while late.replicas[0].held().is_none() {
        cell.now = cell.now.plus_us(TICK_US);
        let image = cell.gateway.image();
        cell.a.core.image(image, cell.now);
        cell.a.tick(cell.now);
        for bytes in cell.a.sent(cell.now) {
            cell.gateway.frame(&bytes);
            let seen = late.replicas[0].frame(&bytes).unwrap();
            assert!(matches!(seen.held, Ok(_) | Err(FrameRefusal::NoBase(_))));
        }
        ticks += 1;
        assert!(ticks <= 200, "a second has 200 ticks");
    }
    assert!(late.replicas[0].refused() > 0);
    let held = late.replicas[0].runtime().unwrap().checkpoint();
    assert_eq!(ModelMc::count(held), cell.head(0).id.scan.0);
}

#[test]
fn a_frame_of_an_older_epoch_or_scan_is_late() {
    let mut cell = model_cell(0);
    cell.activate_a(0, |_| {});
    cell.now = cell.now.plus_us(TICK_US);
    let image = cell.gateway.image();
    cell.a.core.image(image, cell.now);
    cell.a.tick(cell.now);
    let first = cell.a.sent(cell.now).remove(0);
    cell.gateway.frame(&first);
    cell.b.replicas[0].frame(&first).unwrap().held.unwrap();
    let again = cell.b.replicas[0].frame(&first).unwrap();
    assert_eq!(again.held, Err(FrameRefusal::Late));
    assert_eq!(cell.b.replicas[0].refused(), 0);
    assert_eq!(cell.a.replicas[0].frame(&first), None, "its own");
    let mut other = model_node("c", 8);
    assert_eq!(
        other.replicas[0].frame(&first).unwrap().held,
        Err(FrameRefusal::Layout(
            fam_node_core::model_mc::ModelMc::layout(0)
        ))
    );
}

/// What the encoder sends of a state of 4,000 bytes, scan by scan: `true` is the whole checkpoint.
fn sent(changes: impl Fn(u64) -> usize, scans: u64) -> Vec<bool> {
    let spec = std::sync::Arc::new(ModelMc::spec(
        0,
        mc_id(0),
        gateway_id(),
        TICK_US as u32,
        4_000,
    ));
    let mut pool = fam_node_core::buffers::Pool::new(4_000, 0);
    let mut encoder = fam_node_core::FrameEncoder::new();
    let mut state = vec![0; 4_000];
    let mut acknowledged = None;
    (1..=scans)
        .map(|scan| {
            state[..changes(scan)].fill(scan.to_le_bytes()[0]);
            let frame = fam_node_core::ScannedFrame {
                spec: spec.clone(),
                owner: owner("a"),
                epoch: Epoch(1),
                scan: Scan(scan),
                image: ImageNumber(scan),
                base: None,
                base_bytes: None,
                mc_time_us: scan * TICK_US,
                phase: Phase::Running,
                released_to: None,
                scan_us: 1,
                capture_ns: 0,
                acknowledged,
                buffer: pool.fill(&state, &[]).unwrap(),
            };
            let encoded = encoder.encode(&frame, Now(scan)).unwrap();
            acknowledged = Some(encoded.id);
            encoded.full
        })
        .collect()
}

#[test]
fn deltas_are_sent_while_they_pay_and_tried_again_after_they_did_not() {
    let few = sent(|_| 40, 30);
    assert_eq!(few.iter().filter(|full| **full).count(), 1, "{few:?}");
    assert!(sent(|_| 4_000, 60).iter().all(|full| *full));
    // All of it changes once: the frame after that is not tried, the next one is a delta again.
    let once = sent(|scan| if scan == 10 { 4_000 } else { 40 }, 20);
    let full: Vec<usize> = (0..20).filter(|n| once[*n]).collect();
    assert_eq!(full, [0, 9, 10]);
    // It changes as a whole for long: the delta is back after a pause that is bounded.
    let long = sent(|scan| if scan <= 100 { 4_000 } else { 40 }, 200);
    let last = long.iter().rposition(|full| *full).unwrap();
    let untried_max = fam_node_core::sender::UNTRIED_MAX as usize;
    assert!((100..=101 + untried_max).contains(&last), "{last}");
}
