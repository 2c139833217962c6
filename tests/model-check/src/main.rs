//! The full check: `cargo run --release -p fam-model-check [-- SCENARIO [HELD [ACTIVATIONS [STATES]]]]`.
//!
//! Fails on a broken promise. Says of each scenario whether it was explored completely or up to the bound of states.

use fam_model_check::{Bounds, Report, explore, scenarios};

/// States of one scenario at most, unless said otherwise.
const STATES: usize = 20_000_000;

fn main() -> std::process::ExitCode {
    let mut arguments = std::env::args().skip(1);
    let wanted = arguments.next();
    let mut number = || arguments.next().and_then(|text| text.parse().ok());
    let (held, activations, states) = (number(), number(), number());
    let bounds = Bounds {
        activations: activations
            .and_then(|a| u8::try_from(a).ok())
            .unwrap_or(scenarios::ACTIVATIONS),
        states: states.unwrap_or(STATES),
        parts: true,
    };
    let mut good = true;
    for (name, mut faults) in scenarios::ALL {
        faults.held = held.unwrap_or(faults.held);
        if wanted.as_ref().is_some_and(|wanted| wanted != name) {
            continue;
        }
        println!(
            "{name}: at most {} messages late at once, {} activations",
            faults.held, bounds.activations
        );
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
        "  {} states, {} steps, depth {}, {} at the bound, {} waiting at most, {}; driven in {}",
        report.states,
        report.steps,
        report.depth,
        report.at_bound,
        report.waiting,
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
