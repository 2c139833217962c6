//! The full check: `cargo run --release -p fam-model-check [-- SCENARIO [ACTIVATIONS [STATES]]]`.
//!
//! Fails on a broken promise. Says of each scenario whether it was explored completely or up to the bound of states.

use fam_model_check::{Bounds, Faults, Report, explore};

const NONE: Faults = Faults {
    crashes: 0,
    restarts: 0,
    cuts: 0,
    repeats: 0,
    moves: 0,
    late: 0,
};

/// Name, faults, activations at most.
const SCENARIOS: [(&str, Faults, u8); 6] = [
    ("none", NONE, 2),
    (
        "crash",
        Faults {
            crashes: 1,
            restarts: 1,
            ..NONE
        },
        2,
    ),
    ("cut", Faults { cuts: 1, ..NONE }, 2),
    (
        "move",
        Faults {
            moves: 1,
            late: 1,
            ..NONE
        },
        2,
    ),
    (
        "crash-cut",
        Faults {
            crashes: 1,
            restarts: 1,
            cuts: 1,
            ..NONE
        },
        2,
    ),
    (
        "all",
        Faults {
            crashes: 1,
            restarts: 1,
            cuts: 1,
            repeats: 1,
            moves: 1,
            late: 1,
        },
        2,
    ),
];

/// States of one scenario at most, unless said otherwise: about 5 GB.
const STATES: usize = 400_000;

fn main() -> std::process::ExitCode {
    let mut arguments = std::env::args().skip(1);
    let scenario = arguments.next();
    let number = |text: Option<String>| text.and_then(|t| t.parse::<usize>().ok());
    let activations = number(arguments.next());
    let states = number(arguments.next()).unwrap_or(STATES);
    let mut good = true;
    for (name, faults, usual) in SCENARIOS {
        if scenario.as_ref().is_some_and(|wanted| wanted != name) {
            continue;
        }
        let activations = activations
            .and_then(|a| u8::try_from(a).ok())
            .unwrap_or(usual);
        let bounds = Bounds {
            activations,
            states,
        };
        println!("{name}: {faults:?}, at most {activations} activations");
        let report = explore(faults, bounds, None);
        tell(&report);
        good &= report.violation.is_none();
    }
    if good {
        std::process::ExitCode::SUCCESS
    } else {
        std::process::ExitCode::FAILURE
    }
}

fn tell(report: &Report) {
    println!(
        "  {} states, {} steps, depth {}, {} at the bound, {}; driven in {}",
        report.states,
        report.steps,
        report.depth,
        report.at_bound,
        if report.complete {
            "complete"
        } else {
            "NOT complete"
        },
        report.driven
    );
    println!("  different states of each part: {:?}", report.parts);
    for (how, count) in &report.grants {
        println!("  grants {how}: {count}");
    }
    if let Some((violation, way)) = &report.violation {
        println!("  VIOLATION {violation}");
        for (n, step) in way.iter().enumerate() {
            println!("  {:>3} {step}", n + 1);
        }
    }
}
