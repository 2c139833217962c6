//! The marking machine as mechatronic components under the real agents, gateway and nodes, against its mechanics: it goes on marking
//! through crashes and moves, in mid-stroke too, and no pack is lost, marked twice or marked badly.

use fam_gateway_core::recorder::takeovers;
use fam_proto::{CommandKind, ControllerId, McId, Phase};
use fam_simulation::simulator::{Canary, Fault, Options, Outcome, Pid, Profile, run};

/// A pack takes about 4 s; the first waits for the tool to be warm.
const RUN_US: u64 = 30_000_000;
const PACKS_MIN: u64 = 6;
const FIRST_FAULT_US: u64 = 3_000_000;

fn marked(seed: u64, script: Vec<(u64, Fault)>) -> Outcome {
    let options = Options {
        script: Some(script),
        quiet_us: Some(RUN_US),
        log: true,
        ..Options::of(Profile::Marking)
    };
    let outcome = run(seed, &options);
    assert_eq!(outcome.violations, [], "seed {seed}");
    assert!(
        outcome.products >= PACKS_MIN,
        "seed {seed}: {} packs",
        outcome.products
    );
    outcome
}

fn mc(name: &str) -> McId {
    McId::new(name).expect("a name")
}

/// Moves an MC to another controller.
fn moving(name: &str, to: u64) -> Fault {
    Fault::Command(CommandKind::Move {
        mc: mc(name),
        to: ControllerId::new(&format!("controller{}", to % 3 + 1)).expect("a name"),
        force: false,
    })
}

#[test]
fn packs_are_marked_by_components_on_several_controllers() {
    let outcome = marked(1, Vec::new());
    let owners: std::collections::BTreeSet<_> = outcome
        .applied
        .iter()
        .map(|a| a.owner.controller.clone())
        .collect();
    assert!(owners.len() > 1, "{owners:?}");
}

/// Controllers die one after the other, at ever other places of the work.
#[test]
fn marking_goes_on_through_crashes() {
    let (mut failovers, mut strokes) = (0, 0);
    for seed in 0..12 {
        let crash = |n: u64| {
            let fault = Fault::Crash {
                pid: Pid::Node(usize::try_from(n % 3).expect("small")),
                after_outputs: None,
                down_us: Some(400_000),
            };
            (FIRST_FAULT_US + n * 1_310_000 + seed * 109_000, fault)
        };
        let outcome = marked(seed, (0..18).map(crash).collect());
        let takeovers = takeovers(&outcome.applied);
        failovers += takeovers.iter().filter(|t| !t.released).count();
        for takeover in &takeovers {
            assert_eq!(takeover.scans_behind, 0, "seed {seed}: {takeover:?}");
        }
        // A stroke that was interrupted is brought to its end first.
        let mut ram = outcome.applied.iter().filter(|a| a.mc == mc("Ram"));
        strokes += usize::from(ram.any(|a| matches!(a.phase, Phase::Recovering(_))));
    }
    assert!(failovers > 100, "{failovers}");
    assert!(strokes >= 3, "strokes were interrupted in {strokes} runs");
}

/// Every MC is moved again and again, also while the tool comes down: that move waits for the end of the stroke, the others do not.
#[test]
fn marking_goes_on_through_moves_in_mid_stroke() {
    for (seed, name) in ["Ram", "Pack", "Policy", "Heater", "Monitor"]
        .iter()
        .enumerate()
    {
        let script = (0..120)
            .map(|n| (FIRST_FAULT_US + n * 211_000, moving(name, n)))
            .collect();
        let outcome = marked(seed as u64, script);
        let takeovers = takeovers(&outcome.applied);
        let moves: Vec<_> = takeovers
            .iter()
            .filter(|t| t.mc == mc(name) && t.released)
            .collect();
        assert!(moves.len() > 50, "{name}: {} moves", moves.len());
        for moved in moves {
            assert_eq!(moved.scans_behind, 0, "{name}: {moved:?}");
        }
        let recovering = outcome
            .applied
            .iter()
            .filter(|a| matches!(a.phase, Phase::Recovering(_)));
        assert_eq!(recovering.count(), 0, "{name}: no move interrupts a stroke");
    }
}

/// That an MC which forgets its state does harm shows that zero incidents mean something.
#[test]
fn components_that_start_anew_spoil_packs() {
    let harmed = (0..10).any(|seed| {
        let crash = |n: u64| {
            let fault = Fault::Crash {
                pid: Pid::Node(usize::try_from(n % 3).expect("small")),
                after_outputs: None,
                down_us: Some(400_000),
            };
            (FIRST_FAULT_US + n * 1_310_000 + seed * 109_000, fault)
        };
        let options = Options {
            script: Some((0..18).map(crash).collect()),
            quiet_us: Some(RUN_US),
            canary: Some(Canary::StartsCold),
            only: Some("the plant goes on unharmed"),
            ..Options::of(Profile::Marking)
        };
        let outcome = run(seed, &options);
        outcome
            .violations
            .iter()
            .any(|v| v.to_string().contains("the plant reports"))
    });
    assert!(harmed, "packs are good whatever is forgotten");
}
