//! Random life: whatever comes, no epoch is given twice or before it is durable (the bench checks each order), and once the
//! faults end, every MC that may run does run.

use crate::bench::{Bench, c, m, model, owner};
use fam_proto::*;
use proptest::prelude::*;

const CONTROLLERS: u64 = 3;
const MCS: u64 = 3;

fn bench() -> Bench {
    let mut bench = Bench::new(model(3, 3));
    bench.input("image");
    bench
}

/// One step of a random life.
fn live(bench: &mut Bench, (what, a, b): (u8, u64, u64)) {
    let controller = format!("c{}", a % CONTROLLERS + 1);
    let life = format!("{controller}.{}", b % 3 + 1);
    let mc = format!("m{}", b % MCS + 1);
    match what {
        0 => bench.input(&format!("token {life}")),
        1 => bench.input(&format!("gone {life}")),
        2..=4 => bench.input(&format!("up {life}")),
        5 => bench.input(&format!("killed {life}")),
        6 => bench.input(&format!("frozen {life}")),
        7 => bench.input(&format!("works {life} {}", a * 37 % 1_300)),
        8 => bench.input(&format!("leaving {life}")),
        9..=13 => bids(bench, b % 2 == 0),
        14..=19 => obey(bench, &mc, a % 2 == 0),
        20 => state(bench, &mc, a),
        21 => bench.input(if a % 4 == 0 { "disk full" } else { "disk ok" }),
        22 => bench.input("gateway restarts"),
        23 => bench.input(if a % 3 == 0 {
            "gateway lost"
        } else {
            "gateway back"
        }),
        24 => bench.input(&format!("move {mc} {controller}")),
        25 => bench.input(&format!("force {mc} {controller}")),
        26 => bench.input(&format!("drain {controller}")),
        27 => bench.input(&format!("undrain {controller}")),
        28 => bench.input(&format!("pin {mc} {controller}")),
        29 => bench.input(&format!("unpin {mc}")),
        30 => bench.input(&format!("stop {mc}")),
        31 => bench.input(&format!("reset {mc}")),
        32 => bench.input(if a % 2 == 0 { "mute" } else { "unmute" }),
        33 => bench.restart(),
        34 => answer(bench, &controller, &mc, a % 2 == 0),
        _ => {
            let to = bench.now.plus_us((a * 997 + b * 31) % 400_000);
            bench.advance(to);
        }
    }
}

fn lives(bench: &Bench) -> Vec<(ControllerId, u64, u32)> {
    let alive = bench.alive.iter();
    alive
        .map(|(name, (boot, load))| (name.clone(), *boot, *load))
        .collect()
}

/// Those that report answer the call that is open.
fn bids(bench: &mut Bench, all: bool) {
    if bench.call.is_none() {
        return;
    }
    for (name, boot, load) in lives(bench).into_iter().skip(usize::from(!all)) {
        bench.bid(&format!("{name}.{boot}"), load, |_| {});
    }
    bench.call = None;
}

/// The newest order to activate an MC is carried out, as a gateway would let it.
fn obey(bench: &mut Bench, mc: &str, driven: bool) {
    let mc = m(mc);
    let newest = bench
        .orders
        .iter()
        .filter(|((_, of), _)| *of == mc)
        .flat_map(|((controller, _), orders)| orders.iter().map(move |o| (controller, o)))
        .filter_map(|(controller, order)| match &order.kind {
            OrderKind::Activate { epoch, reset, .. } => Some((*epoch, controller.clone(), *reset)),
            _ => None,
        })
        .max();
    let Some((epoch, controller, reset)) = newest else {
        return;
    };
    let record = bench.records.get_mut(&mc).unwrap();
    let life = bench.alive.get(&controller).map(|(boot, _)| *boot);
    let (Some(life), true) = (life, epoch > record.epoch) else {
        return;
    };
    if record.state.needs_reset() && reset.is_none() {
        return;
    }
    record.epoch = epoch;
    record.owner = Some(owner(controller.as_str(), life));
    record.state = RecordState::Open;
    record.driven = driven;
    record.suspect = false;
    record.silent_us = 1_000;
    bench.send_image();
}

/// Something befalls an MC.
fn state(bench: &mut Bench, mc: &str, what: u64) {
    let record = bench.records.get_mut(&m(mc)).unwrap();
    if record.state != RecordState::Open {
        return;
    }
    match what % 5 {
        0 => {
            record.suspect = true;
            record.silent_us = 30_000;
        }
        1 => {
            record.suspect = false;
            record.silent_us = 1_000;
            record.driven = true;
        }
        2 => record.state = RecordState::FailSafe,
        3 => record.state = RecordState::Stopped,
        _ => record.state = RecordState::Closed,
    }
    bench.send_image();
}

/// An MCA declines its newest order.
fn answer(bench: &mut Bench, controller: &str, mc: &str, opening: bool) {
    let life = bench.alive.get(&c(controller)).map_or(1, |(boot, _)| *boot);
    let Some(orders) = bench.orders.get(&(c(controller), m(mc))) else {
        return;
    };
    let has = |which: fn(&OrderKind) -> bool| orders.iter().any(|o| which(&o.kind));
    if opening && has(|k| matches!(k, OrderKind::Activate { .. })) {
        bench.input(&format!("notopened {controller}.{life} {mc}"));
    } else if has(|k| matches!(k, OrderKind::Release { .. })) {
        bench.input(&format!("notreleased {controller}.{life} {mc}"));
    }
}

/// The faults end: everybody is up in a new life, nothing is drained or stopped, and all orders are carried out.
fn calm(bench: &mut Bench) {
    bench.input("disk ok");
    bench.input("unmute");
    bench.input("gateway back");
    for n in 1..=CONTROLLERS {
        for boot in 1..=3 {
            bench.input(&format!("killed c{n}.{boot}"));
        }
        bench.input(&format!("undrain c{n}"));
        bench.input(&format!("up c{n}.9"));
        bench.input(&format!("works c{n}.9 100"));
    }
    for record in bench.records.values_mut() {
        if record.state == RecordState::Open {
            // Those of old lives fall silent.
            record.suspect = true;
            record.silent_us = 30_000;
        }
    }
    for round in 0..1_500 {
        bids(bench, true);
        for n in 1..=MCS {
            obey(bench, &format!("m{n}"), true);
            let stopped = bench.records[&m(&format!("m{n}"))].state.needs_reset();
            let flagged = bench.agents.view().mcs[&m(&format!("m{n}"))].stopped;
            if (stopped || flagged) && round % 200 == 50 {
                bench.input(&format!("reset m{n}"));
            }
        }
        let to = bench.now.plus_us(10_000);
        bench.advance(to);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, max_shrink_iters: 2_000, ..ProptestConfig::default() })]

    #[test]
    fn whatever_comes_epochs_are_given_once_and_in_the_end_everything_runs(
        steps in prop::collection::vec((0..45u8, 0..1_000u64, 0..1_000u64), 1..120)
    ) {
        let mut bench = bench();
        for step in steps {
            live(&mut bench, step);
        }
        calm(&mut bench);
        for (mc, record) in &bench.records {
            let runs = bench.agents.view().runs_on(mc);
            prop_assert!(
                runs.is_some() && record.driven,
                "{mc} does not run: {record:?}, {:?}, last {:?}",
                bench.agents.view().mcs[mc],
                bench.events.iter().rev().take(4).map(|e| &e.text).collect::<Vec<_>>()
            );
        }
    }
}
