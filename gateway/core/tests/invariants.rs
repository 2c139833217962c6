//! Random histories: opens, frames, delays, losses, traps, stalls, kills. Whatever happens, one owner drives each epoch,
//! epochs never fall, applied scans rise, the chain is unbroken, and what the record says was applied was applied.

mod common;
use common::*;
use fam_gateway_core::{RecordWrite, recorder};
use fam_proto::*;
use proptest::prelude::*;
use std::collections::BTreeMap;

#[derive(Debug, Clone)]
enum Step {
    /// A controller asks for an epoch relative to the record's.
    Open {
        n: u64,
        above: i64,
        force: bool,
        reset: Option<Reset>,
        held: bool,
    },
    /// One of the drivers ever made scans; its frame arrives, is lost, or is kept for later.
    Scan {
        driver: usize,
        fate: Fate,
    },
    /// A driver releases to a controller and epoch.
    Release {
        driver: usize,
        to: u64,
        above: u64,
    },
    /// A frame that was kept arrives.
    Late(usize),
    /// A driver sends a frame in the name of another owner, or one that builds on something else.
    Forge {
        driver: usize,
        owner: bool,
    },
    /// A driver's stop POU has ended.
    Stop(usize),
    Token {
        n: u64,
        alive: bool,
    },
    Pass(u64),
    /// The gateway is killed and started again, perhaps in the middle of the write of a head.
    Kill {
        torn: bool,
    },
    Disk {
        works: bool,
    },
    Field {
        answers: bool,
    },
}

#[derive(Debug, Clone, Copy)]
enum Fate {
    Arrives,
    Lost,
    Kept,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let reset = prop_oneof![
        4 => Just(None),
        1 => prop::sample::select(vec![Some(Reset::Cold), Some(Reset::Warm), Some(Reset::Resume)]),
    ];
    let fate = prop_oneof![6 => Just(Fate::Arrives), 1 => Just(Fate::Lost), 2 => Just(Fate::Kept)];
    let step = prop_oneof![
        4 => (1_u64..3, -1_i64..4, any::<bool>(), reset, any::<bool>()).prop_map(|(n, above, force, reset, held)| Step::Open { n, above, force, reset, held }),
        10 => (0_usize..6, fate).prop_map(|(driver, fate)| Step::Scan { driver, fate }),
        1 => (0_usize..6, 1_u64..3, 0_u64..3).prop_map(|(driver, to, above)| Step::Release { driver, to, above }),
        3 => (0_usize..10).prop_map(Step::Late),
        2 => (0_usize..6, any::<bool>()).prop_map(|(driver, owner)| Step::Forge { driver, owner }),
        1 => (0_usize..6).prop_map(Step::Stop),
        1 => (1_u64..3, any::<bool>()).prop_map(|(n, alive)| Step::Token { n, alive }),
        4 => prop::sample::select(vec![1_000, 5_000, 16_000, 60_000, 1_000_000]).prop_map(Step::Pass),
        1 => any::<bool>().prop_map(|torn| Step::Kill { torn }),
        1 => prop::bool::weighted(0.7).prop_map(|works| Step::Disk { works }),
        1 => prop::bool::weighted(0.7).prop_map(|answers| Step::Field { answers }),
    ];
    prop::collection::vec(step, 1..120)
}

/// What is remembered of the whole history, over all lives of the gateway.
#[derive(Default)]
struct History {
    drivers: Vec<Driver>,
    kept: Vec<Vec<u8>>,
    owners: BTreeMap<Epoch, Owner>,
    epoch: Epoch,
}

fn run(steps: Vec<Step>) -> Result<(), TestCaseError> {
    let mut bench = Bench::new();
    let mut history = History::default();
    for step in steps {
        let before = bench.record();
        let (applied_before, outputs_before) = (bench.applied.len(), bench.outputs.len());
        let mut killed = false;
        match step {
            Step::Open {
                n,
                above,
                force,
                reset,
                held,
            } => {
                let epoch = before.epoch.0.saturating_add_signed(above);
                let mut open = ask(n, epoch);
                (open.force, open.reset) = (force, reset);
                open.held = before.head.filter(|_| held);
                if let Message::Opened(opened) = bench.open(open.clone()) {
                    let owner = history
                        .owners
                        .entry(opened.epoch)
                        .or_insert_with(|| open.owner.clone());
                    prop_assert_eq!(&*owner, &open.owner, "one owner for an epoch");
                    prop_assert!(
                        opened.base == before.head
                            || (opened.base.is_none() && reset == Some(Reset::Cold))
                            || before.epoch == opened.epoch,
                        "no invented state"
                    );
                    if let (Some(base), Some(checkpoint)) = (opened.base, &opened.checkpoint) {
                        prop_assert_eq!(checkpoint.id, base);
                        prop_assert!(checkpoint.is_intact());
                    }
                    history.drivers.push(Driver::of(n, &opened));
                }
            }
            Step::Scan { driver, fate } => {
                let image = bench.newest_image();
                if let Some(driver) = pick(&mut history.drivers, driver) {
                    let bytes = driver.frame(image);
                    match fate {
                        Fate::Arrives => bench.frame(bytes),
                        Fate::Lost => {}
                        Fate::Kept => history.kept.push(bytes),
                    }
                }
            }
            Step::Release { driver, to, above } => {
                let image = bench.newest_image();
                if let Some(driver) = pick(&mut history.drivers, driver) {
                    driver.header.released_to = Some(Successor {
                        epoch: Epoch(driver.header.epoch.0 + above),
                        owner: owner(to),
                    });
                    let bytes = driver.frame(image);
                    bench.frame(bytes);
                    driver.header.released_to = None;
                }
            }
            Step::Late(n) => {
                if !history.kept.is_empty() {
                    let bytes = history.kept[n % history.kept.len()].clone();
                    bench.frame(bytes);
                }
            }
            Step::Forge { driver, owner: by } => {
                let image = bench.newest_image();
                if let Some(driver) = pick(&mut history.drivers, driver) {
                    let mut forged = driver.clone();
                    if by {
                        let n = driver.header.owner.boot.0 - 100;
                        forged.header.owner = owner(3 - n);
                    } else {
                        forged.header.base = Some(CheckpointId::default());
                    }
                    let bytes = forged.frame(image);
                    bench.frame(bytes);
                }
            }
            Step::Stop(driver) => {
                let image = bench.newest_image();
                if let Some(driver) = pick(&mut history.drivers, driver) {
                    driver.header.phase = Phase::Stopped;
                    let bytes = driver.frame(image);
                    bench.frame(bytes);
                }
            }
            Step::Token { n, alive } => bench.token(n, alive),
            Step::Pass(us) => bench.pass(us),
            Step::Kill { torn } => {
                killed = true;
                if torn && bench.record().driven {
                    // The kill came while the next head was being written: its outputs were never applied.
                    let image = bench.newest_image();
                    let gate = bench.gateway.gate(&mc_id()).unwrap();
                    let (ledger, head) = (gate.ledger().clone(), gate.head().cloned());
                    if let (RecordState::Open, Some(mut head)) = (ledger.state, head) {
                        head.meta.id.scan = head.meta.id.scan.next();
                        head.meta.image = image;
                        bench.records.write(RecordWrite::Head { mc: mc_id(), head });
                        bench.records.tear_head(&mc_id());
                    }
                }
                bench.restart();
            }
            Step::Disk { works } => {
                bench.disk = if works { Disk::Works } else { Disk::NoSync };
            }
            Step::Field { answers } => bench.field_answers = answers,
        }

        let after = bench.record();
        prop_assert!(after.epoch >= history.epoch, "epochs never fall");
        history.epoch = after.epoch;
        prop_assert!(
            after.scan() >= before.scan() || after.head.is_none(),
            "the head never goes back"
        );
        prop_assert_eq!(recorder::double_driven_scans(&bench.applied), 0);
        for entry in &bench.applied[applied_before..] {
            prop_assert_eq!(
                Some(&entry.owner),
                history.owners.get(&entry.epoch),
                "only who opened drives"
            );
        }
        if let Err(broken) = recorder::check_chain(&bench.applied, true) {
            return Err(TestCaseError::fail(broken.to_string()));
        }
        if let (Some(last), Some(head)) = (bench.applied.last(), after.head) {
            prop_assert_eq!(
                last.checkpoint_id(),
                head,
                "the record is what was applied last"
            );
        }
        // What stands at the field is what the record says.
        let gate = bench.gateway.gate(&mc_id()).unwrap();
        let field = bench.outputs.iter().rev().find(|(mc, ..)| mc == &mc_id());
        if let Some((_, outputs, _)) = field {
            prop_assert_eq!(&outputs[..], &gate.outputs()[..]);
        }
        let closed = matches!(after.state, RecordState::FailSafe | RecordState::Faulted(_));
        prop_assert!(!closed || gate.fail_safe_stands());
        if !killed {
            let frames = bench.applied.len() - applied_before;
            prop_assert!(bench.outputs.len() - outputs_before >= frames);
        }
    }
    Ok(())
}

fn pick(drivers: &mut [Driver], n: usize) -> Option<&mut Driver> {
    // The newest ones are met more often.
    let len = drivers.len();
    drivers.get_mut(len.checked_sub(1 + n.min(len.saturating_sub(1)))?)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2_000, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn the_contract_holds_in_any_history(steps in steps()) {
        run(steps)?;
    }
}
