//! Every reason for which a frame is rejected, each provoked alone on a frame that would else be applied.

mod common;
use common::*;
use fam_gateway_core::{GatewayLocal, Rejection};
use fam_proto::agent::Input;
use fam_proto::*;

type Spoil = fn(&mut Bench, &mut Driver) -> Vec<u8>;

fn good(bench: &mut Bench, driver: &mut Driver) -> Vec<u8> {
    driver.frame(bench.newest_image())
}

#[test]
fn each_reason_is_named_counted_and_applies_nothing() {
    let table: &[(Rejection, Spoil)] = &[
        (Rejection::Unreadable, |bench, driver| {
            let bytes = good(bench, driver);
            bytes[..bytes.len() - 1].to_vec()
        }),
        (Rejection::UnknownMc, |bench, driver| {
            driver.header.mc = McId::new("Other").unwrap();
            good(bench, driver)
        }),
        (Rejection::NotOpen, |bench, driver| {
            bench.pass(WATCHDOG_US);
            good(bench, driver)
        }),
        (Rejection::OldEpoch, |bench, driver| {
            bench.pass(4 * TICK_US);
            bench.opened(ask(2, 9));
            good(bench, driver)
        }),
        (Rejection::UnopenedEpoch, |bench, driver| {
            driver.header.epoch = Epoch(6);
            good(bench, driver)
        }),
        (Rejection::OtherOwner, |bench, driver| {
            driver.header.owner = owner(2);
            good(bench, driver)
        }),
        (Rejection::OtherOwner, |bench, driver| {
            driver.header.owner.boot = BootId(1); // another life of the same controller
            good(bench, driver)
        }),
        (Rejection::OldScan, |bench, driver| {
            driver.header.scan = Scan(driver.header.scan.0 - 1);
            good(bench, driver)
        }),
        (Rejection::ScanTooFarAhead, |bench, driver| {
            driver.header.scan = Scan(u64::MAX - 10);
            good(bench, driver)
        }),
        (Rejection::WrongBase, |bench, _| {
            bench.pass(4 * TICK_US);
            let mut next = bench.driver(2, 9);
            next.header.base = None;
            good(bench, &mut next)
        }),
        (Rejection::UnknownImage, |bench, driver| {
            driver.frame(bench.newest_image().next())
        }),
        (Rejection::OldImage, |_, driver| {
            driver.frame(ImageNumber(1))
        }),
        (Rejection::OldImage, |bench, driver| {
            // The field has not answered for the watchdog time: however new the image, its inputs are old.
            bench.field_answers = false;
            for _ in 0..=(WATCHDOG_US / SUSPECT_US) {
                bench.pass(SUSPECT_US);
                let bytes = good(bench, driver);
                bench.frame(bytes.clone());
                if bench.rejected(Rejection::OldImage) > 0 {
                    return bytes;
                }
            }
            panic!("frames on old inputs are still applied");
        }),
        (Rejection::Layout, |bench, driver| {
            driver.header.layout = LayoutHash(8);
            good(bench, driver)
        }),
        (Rejection::OutputsLength, |bench, driver| {
            driver.outputs.push(0);
            driver.header.outputs_len = 3;
            good(bench, driver)
        }),
        (Rejection::StateLength, |bench, driver| {
            driver.state.push(0);
            driver.header.state_len += 1;
            good(bench, driver)
        }),
        (Rejection::BadSuccessor, |bench, driver| {
            driver.header.released_to = Some(Successor {
                epoch: driver.header.epoch,
                owner: owner(2),
            });
            good(bench, driver)
        }),
        (Rejection::BaseNotHeld, |bench, driver| {
            driver.header.content = Content::Delta(CheckpointId::default());
            driver.step(bench.newest_image());
            encode_frame(&driver.header, &driver.outputs, &[]).unwrap()
        }),
        (Rejection::DeltaDamaged, |bench, driver| {
            driver.header.content = Content::Delta(driver.header.checkpoint_id());
            driver.step(bench.newest_image());
            encode_frame(&driver.header, &driver.outputs, &[1, 2, 3]).unwrap()
        }),
        (Rejection::WrongDigest, |bench, driver| {
            driver.step(bench.newest_image());
            driver.state[20] ^= 1;
            driver.encode()
        }),
        (Rejection::NotRecorded, |bench, driver| {
            bench.disk = Disk::Fails;
            good(bench, driver)
        }),
    ];
    for (want, spoil) in table {
        let mut bench = Bench::new();
        let mut driver = bench.driver(1, 5);
        bench.scan(&mut driver);
        bench.pass(TICK_US);
        bench.scan(&mut driver);
        assert_eq!(bench.applied.len(), 2);

        let bytes = spoil(&mut bench, &mut driver);
        let (head, applied, count) = (
            bench.record().head,
            bench.applied.len(),
            bench.rejected(*want),
        );
        bench.frame(bytes);
        assert_eq!(bench.rejected(*want), count + 1, "{want:?}");
        assert_eq!(bench.applied.len(), applied, "{want:?}");
        assert_eq!(bench.record().head, head, "{want:?}");
    }
}

#[test]
fn a_frame_that_arrives_again_is_no_rejection_and_keeps_nothing_alive() {
    let mut bench = Bench::new();
    let mut driver = bench.driver(1, 5);
    bench.scan(&mut driver);
    let bytes = driver.encode();
    bench.pass(SUSPECT_US + 1);
    assert!(bench.record().suspect);
    bench.frame(bytes);
    assert!(bench.record().suspect, "a repetition is no sign of life");
    let gate = bench.gateway.gate(&mc_id()).unwrap();
    assert_eq!(gate.counters().repeated, 1);
    assert_eq!(gate.counters().rejected_all(), 0);
    assert_eq!(bench.applied.len(), 1);
}

#[test]
fn lost_frames_break_no_chain_and_deltas_build_on_what_is_held() {
    let mut bench = Bench::new();
    let mut driver = bench.driver(1, 5);
    driver.step(bench.newest_image()); // lost
    bench.scan(&mut driver);
    let acknowledged = (driver.header.checkpoint_id(), driver.state.clone());
    bench.scan(&mut driver);
    driver.step(bench.newest_image()); // lost too
    driver.step(bench.newest_image());
    driver.header.content = Content::Delta(acknowledged.0);
    let mut delta = Vec::new();
    assert!(delta::diff(&acknowledged.1, &driver.state, &mut delta));
    bench.frame(encode_frame(&driver.header, &driver.outputs, &delta).unwrap());
    assert_eq!(bench.applied.len(), 3);
    let head = bench.gateway.gate(&mc_id()).unwrap().head().unwrap();
    assert_eq!(head.state.as_ref(), &driver.state);
    assert!(head.checkpoint().is_intact());
}

#[test]
fn outputs_are_applied_after_their_head_is_recorded() {
    let mut bench = Bench::new();
    let mut driver = bench.driver(1, 5);
    bench.writes.clear();
    let bytes = driver.frame(bench.newest_image());
    bench
        .gateway
        .handle(Input::Local(GatewayLocal::Frame(bytes.into())), bench.now);
    let first = bench.gateway.poll_output();
    assert!(
        matches!(first, Some(agent::Output::Persist { .. })),
        "{first:?}"
    );
    assert_eq!(
        bench.gateway.poll_output(),
        None,
        "nothing before the answer"
    );
}

#[test]
fn rejected_frames_are_reported_by_reason_and_not_each() {
    let mut bench = Bench::new();
    let mut driver = bench.driver(1, 5);
    driver.header.epoch = Epoch(4);
    bench.events.clear();
    for _ in 0..50 {
        bench.pass(TICK_US);
        bench.scan(&mut driver);
    }
    bench.pass(WATCHDOG_US + TICK_US);
    let texts: Vec<_> = bench
        .events
        .iter()
        .filter(|e| e.kind == EventKind::FramesRejected)
        .map(|e| e.text.as_str())
        .collect();
    assert_eq!(
        texts,
        [
            "Station1: 1 frames of controller1 (boot 101) rejected: 1 × epoch of a deposed owner",
            "Station1: 49 frames of controller1 (boot 101) rejected: 49 × epoch of a deposed owner"
        ]
    );
    assert_eq!(bench.record().rejected, 50);
}

#[cfg(feature = "fence-off")]
#[test]
fn without_the_fence_two_controllers_drive_and_the_recorder_shows_it() {
    use fam_gateway_core::recorder;
    let mut bench = Bench::new();
    bench.gateway = bench.gateway.clone().without_fence();
    let mut old = bench.driver(1, 5);
    bench.scan(&mut old);
    bench.token(1, false);
    let mut new = bench.driver(2, 6);
    for _ in 0..10 {
        bench.pass(TICK_US);
        bench.scan(&mut new);
        bench.scan(&mut old);
    }
    assert_eq!(recorder::double_driven_scans(&bench.applied), 10);
}
