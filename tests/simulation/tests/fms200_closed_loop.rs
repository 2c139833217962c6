//! The FMS-200 cell's logic against its mechanics: what it assembles, and that interruptions of every kind, at any scan, neither harm
//! the plant nor change the products. That restarting an MC from its initial state does harm shows that zero incidents mean something.

use fam_plant_core::{Part, PlantConfig, Variant};
use fam_proto::diagnosis::IntervalKind;
use fam_simulation::closed_loop::{self, Dice, Rig, Timing, cell};
use std::sync::{Mutex, OnceLock};

/// Products of a run when its interruptions begin: all stations are at work then.
const WARM: usize = 1;
/// Products of each run at its end.
const PRODUCTS: usize = WARM + 3;
/// No run may take longer than this in simulated seconds.
const LIMIT_S: u64 = 120;
const SEEDS: [u64; 3] = [200, 7, 31];

type Contents = Vec<(u16, Variant, Vec<Part>)>;

fn config(seed: u64) -> PlantConfig {
    PlantConfig {
        seed,
        pallets: 5,
        ..PlantConfig::default()
    }
}

/// Cases of a random test: `FAM_CASES` times as many as usual.
fn cases(usual: u64) -> std::ops::Range<u64> {
    let times =
        std::env::var("FAM_CASES").map_or(1, |times| times.parse().expect("FAM_CASES is a number"));
    0..usual * times
}

/// An undisturbed run: the cell when it is warm, and what it makes.
struct Undisturbed {
    warm: Mutex<Rig>,
    contents: Contents,
}

fn undisturbed(seed: u64) -> &'static Undisturbed {
    static RUNS: [OnceLock<Undisturbed>; SEEDS.len()] = [const { OnceLock::new() }; SEEDS.len()];
    let index = SEEDS
        .iter()
        .position(|known| *known == seed)
        .expect("a known seed");
    RUNS[index].get_or_init(|| {
        let mut rig = Rig::new(config(seed), Timing::PROMPT);
        run_to_products(&mut rig, "undisturbed", WARM);
        let warm = Mutex::new(rig.fork(Timing::PROMPT));
        run_to_products(&mut rig, "undisturbed", PRODUCTS);
        Undisturbed {
            warm,
            contents: rig.contents(PRODUCTS),
        }
    })
}

fn warm(seed: u64, timing: Timing) -> Rig {
    let rig = undisturbed(seed).warm.lock();
    rig.expect("no test changes the warm cell").fork(timing)
}

fn run_to_products(rig: &mut Rig, context: &str, products: usize) {
    rig.run_until(context, LIMIT_S, |rig| {
        rig.plant.products().len() >= products
    });
    rig.assert_unharmed(context);
}

/// A cell for a case of a random test, with what to say if it fails.
fn case(number: u64, dice: &mut Dice) -> (Rig, u64, String) {
    let seed = SEEDS[number as usize % SEEDS.len()];
    let timing = Timing::rolled(dice);
    let context = format!("case {number}, seed {seed}, {timing:?}");
    (warm(seed, timing), seed, context)
}

/// The end of a case: unharmed, and the products of the undisturbed run.
fn assert_as_undisturbed(rig: &Rig, seed: u64, context: &str) {
    rig.assert_unharmed(context);
    assert_eq!(
        rig.contents(PRODUCTS),
        undisturbed(seed).contents,
        "{context}"
    );
}

fn assert_in_time(rig: &Rig, context: &str) {
    assert!(
        rig.now_ms() < LIMIT_S * 1000,
        "{context}: {}",
        rig.situation()
    );
}

#[test]
fn ordered_sets_are_assembled_without_an_incident() {
    const SETS: usize = 10;
    let mut rig = Rig::new(config(SEEDS[0]), Timing::PROMPT);
    rig.run_until("ten sets", LIMIT_S, |rig| {
        rig.plant.products().len() >= SETS
    });
    rig.assert_unharmed("undisturbed");
    let orders: Vec<u16> = rig.plant.products().iter().map(|set| set.order).collect();
    assert_eq!(orders, (1..=SETS as u16).collect::<Vec<_>>());
    for product in rig.plant.products() {
        assert_eq!(product.parts.len(), 4);
        assert_eq!(product.variant, rig.plant.ordered(product.order));
    }
    let rejected = rig.plant.ledger().rejected;
    assert!(rejected > 0, "the checks were never needed");
    let (first, last) = (&rig.plant.products()[0], &rig.plant.products()[SETS - 1]);
    let beat_ms = (last.stored_at_us - first.stored_at_us) / 1000 / (SETS as u64 - 1);
    assert!(beat_ms < 6_000, "a set takes {beat_ms} ms");
}

#[test]
fn every_seed_and_timing_makes_good_sets() {
    let mut dice = Dice::new(1);
    for seed in cases(3) {
        let timing = Timing::rolled(&mut dice);
        let mut rig = Rig::new(config(seed), timing);
        run_to_products(&mut rig, &format!("seed {seed}, {timing:?}"), 2);
    }
}

/// MCs are killed one by one or together at random scans and taken over a few scans later.
#[test]
fn killed_mcs_go_on_from_the_applied_state() {
    for number in cases(10) {
        let mut dice = Dice::new(1_000 + number);
        let (mut rig, seed, context) = case(number, &mut dice);
        let mut down: Vec<(usize, u64)> = Vec::new();
        let mut kills = 0;
        while rig.plant.products().len() < PRODUCTS {
            assert_in_time(&rig, &context);
            if dice.roll(0, 19) == 0 {
                // Sometimes a controller with several MCs.
                let count = if dice.roll(0, 3) == 0 { 3 } else { 1 };
                for _ in 0..count {
                    let mc = dice.roll(0, rig.mcs.len() as u64 - 1) as usize;
                    if rig.runs(mc) {
                        rig.kill(mc);
                        down.push((mc, dice.roll(3, 20)));
                        kills += 1;
                    }
                }
            }
            down.retain_mut(|(mc, ticks)| {
                *ticks -= 1;
                if *ticks == 0 {
                    rig.take_over(*mc);
                }
                *ticks > 0
            });
            rig.tick();
            assert_eq!(
                rig.plant.incidents_total(),
                0,
                "{context}: {}",
                rig.situation()
            );
        }
        assert_as_undisturbed(&rig, seed, &context);
        assert!(kills > 30, "{context}: only {kills} kills");
    }
}

/// The gateway dies: no output changes for a second, then every MC is activated anew as interrupted.
#[test]
fn the_cell_comes_back_after_an_outage_of_the_gateway() {
    for number in cases(6) {
        let mut dice = Dice::new(2_000 + number);
        let (mut rig, seed, context) = case(number, &mut dice);
        while rig.plant.products().len() < PRODUCTS {
            assert_in_time(&rig, &context);
            for _ in 0..dice.roll(100, 400) {
                rig.tick();
            }
            (0..rig.mcs.len()).for_each(|mc| rig.kill(mc));
            for _ in 0..closed_loop::WATCHDOG_TICKS - 2 {
                rig.tick();
            }
            (0..rig.mcs.len()).for_each(|mc| rig.take_over(mc));
        }
        assert_as_undisturbed(&rig, seed, &context);
    }
}

/// An MC, or all of them, are silent for so long that the gateway sets the fail-safe values.
#[test]
fn fail_safe_values_harm_nothing() {
    for number in cases(6) {
        let mut dice = Dice::new(3_000 + number);
        let (mut rig, seed, context) = case(number, &mut dice);
        while rig.plant.products().len() < PRODUCTS {
            assert_in_time(&rig, &context);
            for _ in 0..dice.roll(50, 300) {
                rig.tick();
            }
            let dead: Vec<usize> = if dice.roll(0, 2) == 0 {
                (0..rig.mcs.len()).collect()
            } else {
                vec![dice.roll(0, rig.mcs.len() as u64 - 1) as usize]
            };
            dead.iter().for_each(|mc| rig.kill(*mc));
            // From just after the fail-safe values have been set to long after everything has come to rest.
            for _ in 0..closed_loop::WATCHDOG_TICKS + dice.roll(0, 100) {
                rig.tick();
            }
            dead.iter().for_each(|mc| rig.take_over(*mc));
        }
        assert_as_undisturbed(&rig, seed, &context);
    }
}

/// Every checkpoint interval of every MC: a kill inside it runs its recovery, also one that is killed again; production goes on.
#[test]
fn each_critical_interval_is_recovered() {
    let seed = SEEDS[0];
    for (index, mc) in cell().built.mcs.iter().enumerate() {
        let model = cell().built.model.mc(&mc.mc).expect("a model");
        let intervals = model.diagnosis.intervals.iter();
        let mut rig = warm(seed, Timing::PROMPT);
        for interval in intervals.filter(|interval| interval.kind == IntervalKind::Checkpoint) {
            let context = format!("{} of {}", interval.name, mc.mc);
            // Station 3 only ejects when a lid is wrong, so this may take a few sets.
            rig.run_until(&context, LIMIT_S, |rig| {
                rig.interval(index) == Some(interval.name.as_str())
            });
            rig.kill(index);
            for _ in 0..4 {
                rig.tick();
            }
            rig.take_over(index);
            assert_eq!(
                rig.mcs[index].recoveries.get(&interval.name),
                Some(&1),
                "{context}"
            );
            rig.tick();
            rig.tick();
            rig.kill(index);
            for _ in 0..8 {
                rig.tick();
            }
            rig.take_over(index);
            assert!(
                rig.mcs[index].recoveries.contains_key(closed_loop::GONE_ON),
                "{context}: the recovery was not under way any more"
            );
            let recovered = rig.plant.products().len();
            rig.run_until(&context, LIMIT_S, |rig| {
                rig.interval(index) != Some(interval.name.as_str())
            });
            assert!(
                rig.plant.products().len() <= recovered + 1,
                "{context} took long"
            );
            rig.mcs[index].recoveries.clear();
        }
        let stored = rig.plant.products().len();
        rig.run_until("two more sets", LIMIT_S, |rig| {
            rig.plant.products().len() >= stored + 2
        });
        rig.assert_unharmed(mc.mc.as_str());
    }
}

#[test]
fn station_3_has_five_critical_intervals_that_let_it_go_on() {
    let station3 = &cell()
        .built
        .model
        .mcs
        .iter()
        .find(|mc| mc.mc.as_str() == "Station3");
    let diagnosis = &station3.expect("Station3").diagnosis;
    let names: Vec<&str> = diagnosis
        .intervals
        .iter()
        .filter(|interval| interval.kind == IntervalKind::Checkpoint)
        .map(|interval| interval.name.as_str())
        .collect();
    assert_eq!(
        names,
        ["Pushing", "Ejecting", "Picking", "Carrying", "Placing"]
    );
}

/// The sensor of the vacuum fails while the base is carried: the base may lie anywhere. An interruption there is answered with a safe
/// stop: the hand is up, what it holds stays held, nothing moves any more.
#[test]
fn a_lost_base_ends_in_a_safe_stop() {
    let mut rig = Rig::new(config(SEEDS[0]), Timing::PROMPT);
    let station = rig.index("Station1");
    rig.run_until("carrying", LIMIT_S, |rig| {
        rig.interval(station) == Some("Carrying")
    });
    rig.stuck.push(("S1_Vacuum", false));
    rig.run_until("the alarm", 5, |rig| {
        rig.interval(station) == Some("PartLost")
    });
    rig.kill(station);
    for _ in 0..10 {
        rig.tick();
    }
    rig.take_over(station);
    assert_eq!(rig.mcs[station].recoveries.get("PartLost"), Some(&1));
    rig.run_until("the safe stop", 5, |rig| rig.mcs[station].stopped);
    let base = rig.plant.image(1).expect("unit 1");
    use fam_plant_core::signals::base as at;
    assert!(base.discrete_input(at::HAND_UP) && base.discrete_input(at::VACUUM));
    assert!(base.coil(at::SUCTION) && !base.coil(at::HAND_LOWER) && !base.coil(at::PUSHER_EXTEND));
    for _ in 0..400 {
        rig.tick();
    }
    rig.assert_unharmed("after the safe stop");
}

/// Every MC, started from its initial values in the middle of its work instead of its state, harms the plant.
#[test]
fn a_restart_from_the_initial_state_causes_incidents() {
    const TRIES: u64 = 20;
    const WATCHED_S: u64 = 20;
    for (index, mc) in cell().built.mcs.iter().enumerate() {
        let mut dice = Dice::new(4_000 + index as u64);
        let harmed = (0..TRIES).any(|_| {
            let mut rig = warm(SEEDS[0], Timing::PROMPT);
            for _ in 0..dice.roll(1, 1_200) {
                rig.tick();
            }
            rig.start_cold(index);
            let end_ms = rig.now_ms() + WATCHED_S * 1000;
            while rig.plant.incidents_total() == 0 && rig.now_ms() < end_ms {
                rig.tick();
            }
            rig.plant.incidents_total() > 0
        });
        assert!(harmed, "{} was restarted {TRIES} times without harm", mc.mc);
    }
}

/// Each MC can be stopped in any state: its stop POU ends, and nothing is harmed.
#[test]
fn stop_pous_end_and_harm_nothing() {
    for (index, mc) in cell().built.mcs.iter().enumerate() {
        let mut dice = Dice::new(5_000 + index as u64);
        for _ in 0..2 {
            let mut rig = warm(SEEDS[1], Timing::rolled(&mut dice));
            for _ in 0..dice.roll(0, 800) {
                rig.tick();
            }
            rig.stop(index);
            rig.run_until("the stop POU's end", 5, |rig| rig.mcs[index].stopped);
            for _ in 0..300 {
                rig.tick();
            }
            rig.assert_unharmed(&format!("{} stopped", mc.mc));
        }
    }
}
