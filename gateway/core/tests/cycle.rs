//! Images, silence, watchdog and restart, followed over time.

mod common;
use common::*;
use fam_gateway_core::{Gateway, GatewayLocal};
use fam_proto::agent::{Agent, Input};
use fam_proto::model::InputSource;
use fam_proto::*;

#[test]
fn one_image_a_tick_with_rising_numbers_over_restarts() {
    let mut bench = Bench::new();
    bench.pass(10 * TICK_US);
    assert_eq!(bench.images.len(), 11);
    let last = bench.newest_image();
    bench.restart();
    assert!(bench.newest_image() > last);
    let numbers: Vec<_> = bench.images.iter().map(|i| i.number).collect();
    assert!(numbers.windows(2).all(|pair| pair[0] < pair[1]));
    assert_eq!(
        bench.images[0].inputs_of(&mc_id()).unwrap().bytes[..2],
        [1, 2]
    );
}

#[test]
fn ticks_that_a_stall_swallowed_are_not_made_up_for() {
    let mut bench = Bench::new();
    bench.now = bench.now.plus_us(7 * TICK_US + 100);
    let before = bench.images.len();
    bench.gateway.handle_timeout(bench.now);
    bench.drain();
    bench.gateway.handle_timeout(bench.now);
    bench.drain();
    assert_eq!(bench.images.len(), before + 1);
    let next = bench.gateway.poll_timeout().unwrap().0;
    assert!(next > bench.now && next.since_us(bench.now) < TICK_US);
}

#[test]
fn exported_variables_are_seen_once_applied_and_fail_safe_after() {
    let mut bench = Bench::new();
    let seen = |bench: &mut Bench| {
        bench.pass(TICK_US);
        let image = bench.images.last().unwrap();
        image.inputs_of(&importer_id()).unwrap().bytes[3]
    };
    assert_eq!(seen(&mut bench), 0, "the fail-safe value of the bit");
    let mut driver = bench.driver(1, 5);
    bench.scan(&mut driver);
    assert_eq!(seen(&mut bench), 0b100);
    bench.restart();
    assert_eq!(seen(&mut bench), 0b100, "the record brings it back");
    bench.pass(WATCHDOG_US);
    assert_eq!(seen(&mut bench), 0);
}

#[test]
fn exported_variables_of_another_gateway_come_with_its_images_and_fail_safe_without() {
    let mut bench = Bench::new();
    let other = GatewayId::new("gateway2").unwrap();
    let mut cell = bench.cell.clone();
    cell.gateways.push(fam_proto::model::GatewayModel {
        gateway: other.clone(),
        ..cell.gateways[0].clone()
    });
    cell.mcs[1].gateway = other.clone();
    bench.cell = cell.clone();
    bench.restart();
    let mut reader = Gateway::new(&cell, &other, BootId(9), 1, vec![], bench.now).unwrap();
    // What the reading gateway tells its MC after it has seen these images.
    let seen = |reader: &mut Gateway, images: &[std::sync::Arc<InputImage>], now: Now| {
        for image in images {
            reader.handle(Input::Image(image.clone()), now);
        }
        reader.handle(Input::Local(GatewayLocal::Field(vec![])), now);
        reader.handle_timeout(now);
        reader.handle(Input::Local(GatewayLocal::Field(vec![])), now);
        let mut bits = None;
        while let Some(output) = reader.poll_output() {
            if let agent::Output::Act(fam_gateway_core::GatewayAct::PublishImage(image)) = output {
                bits = Some(image.inputs_of(&importer_id()).unwrap().bytes[3]);
            }
        }
        bits.expect("an image each tick")
    };
    bench.pass(TICK_US);
    let before = bench.images.last().unwrap().clone();
    assert_eq!(before.exports[0].mc, mc_id());
    let mut driver = bench.driver(1, 5);
    bench.scan(&mut driver);
    bench.pass(TICK_US);
    let after = bench.images.last().unwrap().clone();
    let now = bench.now;
    assert_eq!(
        seen(&mut reader, &[], now),
        0,
        "nothing heard yet: fail-safe"
    );
    let now = now.plus_us(TICK_US);
    assert_eq!(
        seen(&mut reader, &[after.clone(), before], now),
        0b100,
        "an older image changes nothing"
    );
    let mut stranger = InputImage::clone(&after);
    stranger.gateway = other;
    stranger.number = ImageNumber(u64::MAX);
    stranger.exports[0].outputs.fill(0);
    let now = now.plus_us(TICK_US);
    assert_eq!(
        seen(&mut reader, &[stranger.into()], now),
        0b100,
        "only its own gateway speaks for an MC"
    );
    assert_eq!(
        seen(&mut reader, &[], now.plus_us(WATCHDOG_US + TICK_US)),
        0,
        "fail-safe once it is silent"
    );
}

#[test]
fn a_silent_field_makes_its_mcs_stale_and_no_others() {
    let mut bench = Bench::new();
    bench.field_answers = false;
    bench.pass(4 * TICK_US);
    let image = bench.images.last().unwrap();
    assert!(!image.inputs_of(&mc_id()).unwrap().fresh);
    assert_eq!(image.inputs_of(&mc_id()).unwrap().bytes[..2], [1, 2]);
    assert!(image.inputs_of(&importer_id()).unwrap().fresh);
    bench.field_answers = true;
    let inputs = vec![McInputs {
        mc: mc_id(),
        bytes: vec![3, 4, 0, 0],
        fresh: true,
    }];
    bench.input(Input::Local(GatewayLocal::Field(inputs)));
    let image = bench.images.last().unwrap();
    assert!(image.inputs_of(&mc_id()).unwrap().fresh);
    assert_eq!(image.inputs_of(&mc_id()).unwrap().bytes[..2], [3, 4]);
}

#[test]
fn silence_is_reported_once_and_latches_only_at_the_watchdog() {
    let mut bench = Bench::new();
    let mut driver = bench.driver(1, 5);
    bench.scan(&mut driver);
    let suspects = |bench: &Bench| {
        let kind = EventKind::McSuspect;
        bench.events.iter().filter(|e| e.kind == kind).count()
    };
    bench.pass(SUSPECT_US);
    assert_eq!((bench.record().suspect, suspects(&bench)), (false, 0));
    bench.pass(1);
    assert_eq!((bench.record().suspect, suspects(&bench)), (true, 1));
    bench.pass(10 * TICK_US);
    assert_eq!(suspects(&bench), 1);
    bench.scan(&mut driver);
    assert!(!bench.record().suspect, "the owner is back");

    bench.pass(WATCHDOG_US - 1);
    assert_eq!(suspects(&bench), 2);
    assert_eq!(bench.record().state, RecordState::Open);
    bench.pass(1);
    assert_eq!(bench.record().state, RecordState::FailSafe);
    assert_eq!(
        bench.outputs.last(),
        Some(&(mc_id(), vec![0xF0, 0], true)),
        "fail-safe values are set"
    );
    let event = bench.events.last().unwrap();
    assert_eq!(
        (event.kind, event.severity),
        (EventKind::McFailSafe, Severity::Alarm)
    );
    let applied = bench.applied.len();
    bench.scan(&mut driver);
    assert_eq!(bench.applied.len(), applied, "the epoch is closed");
    assert_eq!(bench.record().state, RecordState::FailSafe);
}

#[test]
fn a_queued_frame_does_not_beat_the_watchdog() {
    let mut bench = Bench::new();
    let mut driver = bench.driver(1, 5);
    bench.scan(&mut driver);
    // The gateway's process stalls; when it goes on, the frame lies in its queue and no timer has run.
    let bytes = driver.frame(bench.newest_image());
    bench.now = bench.now.plus_us(WATCHDOG_US);
    bench.frame(bytes);
    assert_eq!(bench.applied.len(), 1);
    assert_eq!(bench.record().state, RecordState::FailSafe);
}

#[test]
fn an_opening_without_frames_ends_in_fail_safe_too() {
    let mut bench = Bench::new();
    bench.driver(1, 5);
    bench.pass(WATCHDOG_US);
    assert_eq!(bench.record().state, RecordState::FailSafe);
}

#[test]
fn the_start_writes_fail_safe_values_only_where_nothing_was_driven() {
    let mut bench = Bench::new();
    assert_eq!(bench.outputs.len(), 2, "{:?}", bench.outputs);
    assert!(bench.outputs.iter().all(|(_, _, fail_safe)| *fail_safe));
    let mut driver = bench.driver(1, 5);
    bench.scan(&mut driver);
    bench.outputs.clear();
    bench.restart();
    let mcs: Vec<_> = bench.outputs.iter().map(|(mc, ..)| mc.clone()).collect();
    assert_eq!(mcs, [importer_id()]);
    assert_eq!(bench.record().state, RecordState::Closed);
    let opened = bench.opened(ask(1, 6));
    assert!(opened.interrupted && !opened.fail_safe);
    assert_eq!(opened.base, Some(driver.header.checkpoint_id()));
}

#[test]
fn a_restart_that_nobody_follows_ends_in_fail_safe() {
    let mut bench = Bench::new();
    let mut driver = bench.driver(1, 5);
    bench.scan(&mut driver);
    bench.restart();
    bench.pass(WATCHDOG_US);
    assert_eq!(bench.record().state, RecordState::FailSafe);
    assert_eq!(
        bench.outputs.last().unwrap(),
        &(mc_id(), vec![0xF0, 0], true)
    );
}

#[test]
fn a_model_that_does_not_fit_is_refused_with_its_names() {
    let start = |cell: &fam_proto::model::CellModel, name: &str| {
        let gateway = GatewayId::new(name).unwrap();
        Gateway::new(cell, &gateway, BootId(1), 1, vec![], Now(0))
            .map(drop)
            .map_err(|e| e.to_string())
            .unwrap_err()
    };
    let mut model = cell();
    let text = start(&model, "gateway9");
    assert!(
        text.contains("`gateway9`") && text.contains("`gateway1`"),
        "{text}"
    );

    model.mcs[1].inputs[0].source = InputSource::Export {
        mc: McId::new("Elsewhere").unwrap(),
        place: fam_proto::model::Place::Bit { byte: 0, bit: 0 },
    };
    let text = start(&model, "gateway1");
    assert!(
        text.contains("`FromStation1`") && text.contains("Elsewhere"),
        "{text}"
    );
}

#[test]
fn a_gateway_that_is_asked_to_end_leaves_nothing_driven() {
    let mut bench = Bench::new();
    let mut driver = bench.driver(1, 5);
    bench.scan(&mut driver);
    let images = bench.images.len();
    bench.input(Input::Local(GatewayLocal::Leave));
    assert!(bench.left);
    assert_eq!(
        bench.outputs.last().unwrap(),
        &(mc_id(), vec![0xF0, 0], true)
    );
    assert_eq!(bench.images.len(), images + 1);
    let record = bench.images[images].record_of(&mc_id()).unwrap();
    assert_eq!(record.state, RecordState::FailSafe);
    bench.restart();
    let opened = bench.opened(ask(1, 6));
    assert!(opened.interrupted && opened.fail_safe);
}
