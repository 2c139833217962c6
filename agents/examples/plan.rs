//! Plans a large cell with a planted optimum and prints how long it took and how far it is from the optimum.
#![allow(clippy::disallowed_methods)] // an example measures; the crate itself reads no clock

fn main() {
    let number = |at: usize, default: usize| {
        std::env::args()
            .nth(at)
            .and_then(|a| a.parse().ok())
            .unwrap_or(default)
    };
    let (controllers, mcs) = (number(1, 1_000), number(2, 10_000));
    for seed in 1..=10 {
        let planted = fam_agents::planner::planted(seed, controllers, mcs);
        let start = std::time::Instant::now();
        let found = fam_agents::planner::plan(&planted.problem);
        let took = start.elapsed();
        #[allow(clippy::cast_precision_loss)] // a percentage for people
        let gap = (found.peak_ppm as f64 / planted.optimum_ppm as f64 - 1.0) * 100.0;
        println!(
            "seed {seed}: {took:?}, {gap:.3} % above the optimum, {} left out",
            found.left_out.len()
        );
    }
}
