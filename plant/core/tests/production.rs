//! The cell, driven correctly, makes what was ordered, with no incident; and driven from a wrong state it does not.

mod common;

use common::{Sequencer, assert_conserved, fail_safe, plant};
use fam_plant_core::{Product, Variant};

fn contents(products: &[Product]) -> Vec<(u16, Variant, Vec<fam_plant_core::Part>)> {
    products.iter().map(Product::contents).collect()
}

#[test]
fn correct_sequences_make_the_orders_in_time_without_incident() {
    for seed in 0..4 {
        let mut plant = plant(seed);
        let mut sequencer = Sequencer::default();
        sequencer.run_until_products(&mut plant, 3);
        let warm_us = plant.now_us();
        sequencer.run_until_products(&mut plant, 23);
        assert_eq!(plant.incidents(), []);
        let products = plant.products();
        assert_eq!(
            products
                .iter()
                .map(|product| product.order)
                .collect::<Vec<_>>(),
            (1..=23).collect::<Vec<_>>()
        );
        assert!(
            products
                .iter()
                .all(|product| product.good && product.parts.len() == 4)
        );
        let cycle_ms = (plant.now_us() - warm_us) / 20_000;
        assert!(
            (2_000..=4_500).contains(&cycle_ms),
            "seed {seed}: a set every {cycle_ms} ms"
        );
        let ledger = plant.ledger();
        assert_eq!(
            (ledger.lost, ledger.damaged, ledger.rejected_good),
            (0, 0, 0)
        );
        assert_eq!(ledger.stored, 4 * 23);
        assert!(
            ledger.rejected > 5,
            "the magazines must hold wrong parts, or the checks are not tested"
        );
        assert_conserved(&plant);
    }
}

#[test]
fn products_are_the_same_whatever_the_timing() {
    let mut steady = plant(7);
    Sequencer::default().run_until_products(&mut steady, 15);
    let mut disturbed = plant(7);
    let mut sequencer = Sequencer::default();
    // Each controller in turn holds its outputs for 0.4 s, again and again.
    for turn in 0_u32.. {
        if disturbed.products().len() >= 15 {
            break;
        }
        sequencer.held_station = Some((turn % 5 + 1) as u8);
        sequencer.run(&mut disturbed, 80);
        sequencer.held_station = None;
        sequencer.run(&mut disturbed, 83);
    }
    assert_eq!(disturbed.incidents(), []);
    assert_eq!(
        contents(steady.products()),
        contents(&disturbed.products()[..15])
    );
    assert!(disturbed.now_us() > steady.now_us());
    let mut other = plant(8);
    Sequencer::default().run_until_products(&mut other, 15);
    assert_ne!(contents(steady.products()), contents(other.products()));
}

/// Inputs are a scan old and outputs take some scans through a gateway: the sequences of the documentation bear that.
#[test]
fn latency_between_controller_and_plant_does_no_harm() {
    let mut direct = plant(2);
    Sequencer::default().run_until_products(&mut direct, 12);
    for latency_scans in [1, 2, 5] {
        let mut delayed = plant(2);
        let mut sequencer = Sequencer::default();
        sequencer.latency_scans = latency_scans;
        sequencer.run_until_products(&mut delayed, 12);
        assert_eq!(delayed.incidents(), [], "{latency_scans} scans of latency");
        assert_eq!(contents(direct.products()), contents(delayed.products()));
    }
}

#[test]
fn the_same_writes_give_the_same_cell_bit_for_bit() {
    let run = || {
        let mut plant = plant(3);
        Sequencer::default().run(&mut plant, 3_000);
        plant
    };
    assert_eq!(run(), run());
}

#[test]
fn time_may_come_in_any_portions() {
    let mut whole = plant(1);
    whole.step(1_000_000);
    let mut portions = plant(1);
    for _ in 0..4_000 {
        portions.step(250);
    }
    assert_eq!(whole, portions);
}

/// The point of a checkpoint: a controller that starts from its initial state in the middle of production does harm.
#[test]
fn restarting_a_station_from_its_initial_state_causes_incidents() {
    for station in 1..=5 {
        let mut harmed = 0;
        let mut tried = 0;
        let mut plant = plant(11);
        let mut sequencer = Sequencer::default();
        sequencer.run_until_products(&mut plant, 2);
        for _ in 0..20 {
            sequencer.run(&mut plant, 37);
            let (mut copy, mut restarted) = (plant.clone(), sequencer.clone());
            restarted.restart(&mut copy, station);
            restarted.run(&mut copy, 2_000);
            tried += 1;
            harmed += u32::from(copy.incidents_total() > 0);
            assert_conserved(&copy);
        }
        println!("station {station}: {harmed} of {tried} restarts do harm");
        assert!(
            harmed > 0,
            "station {station}: none of {tried} restarts from the initial state did harm"
        );
    }
}

/// Outputs that are held and fail-safe values let a station stand: nothing falls, nothing collides, at whatever moment.
#[test]
fn silence_and_fail_safe_values_cause_no_incident_at_any_moment() {
    let mut plant = plant(5);
    let mut sequencer = Sequencer::default();
    sequencer.run_until_products(&mut plant, 2);
    for moment in 0..160 {
        sequencer.run(&mut plant, 11);
        for unit in 1..=5 {
            let mut copy = plant.clone();
            fail_safe(&mut copy, unit);
            copy.step(3_000_000);
            assert_eq!(copy.incidents(), [], "unit {unit}, moment {moment}");
        }
        let mut all = plant.clone();
        all.step(2_000_000);
        assert_eq!(all.incidents(), [], "outputs held, moment {moment}");
        for unit in 1..=5 {
            fail_safe(&mut all, unit);
        }
        all.step(3_000_000);
        assert_eq!(all.incidents(), [], "all units, moment {moment}");
        assert_conserved(&all);
    }
}
