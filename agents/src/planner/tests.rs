//! The exact search against brute force, the heuristic against bounds and planted optima, and the hard limits of both.

use super::state::State;
use super::*;
use proptest::prelude::*;

/// Every assignment, judged as [`plan`] promises to judge.
fn brute_force(problem: &Problem) -> Vec<Option<u32>> {
    let classes = classes(problem);
    let mut all: Vec<Vec<Option<u32>>> = vec![Vec::new()];
    for mc in &problem.mcs {
        let options: Vec<Option<u32>> = if mc.fixed {
            vec![mc.current]
        } else {
            mc.hosts
                .iter()
                .map(|h| Some(h.controller))
                .chain([None])
                .collect()
        };
        all = all
            .into_iter()
            .flat_map(|a| {
                options.iter().map(move |o| {
                    let mut next = a.clone();
                    next.push(*o);
                    next
                })
            })
            .collect();
    }
    all.retain(|a| violations(problem, a).is_empty());
    let best = all
        .iter()
        .map(|a| worth(problem, &classes, a))
        .min()
        .unwrap();
    let allowed = allowed_peak_ppm(problem, best.peak_ppm);
    all.into_iter()
        .filter(|a| {
            let w = worth(problem, &classes, a);
            w.left_out == best.left_out && w.evicted == best.evicted && w.peak_ppm <= allowed
        })
        .min_by_key(|a| (secondary(problem, a), problem.peak_ppm(a)))
        .unwrap()
}

fn violations(problem: &Problem, assignment: &[Option<u32>]) -> Vec<String> {
    let mut found = Vec::new();
    for (m, place) in assignment.iter().enumerate() {
        let mc = &problem.mcs[m];
        if mc.fixed && *place != mc.current {
            found.push(format!("fixed MC {m} moved"));
        }
        if let (Some(c), false) = (place, mc.fixed)
            && !mc.hosts.iter().any(|h| h.controller == *c)
        {
            found.push(format!("MC {m} on {c}, which does not host it"));
        }
    }
    let state = State::from_assignment(problem, assignment);
    for c in 0..problem.controllers.len() {
        if !state.holds(c) {
            found.push(format!("controller {c} above its memory or cycle"));
        }
    }
    found
}

fn problems(
    controllers: std::ops::Range<usize>,
    mcs: std::ops::Range<usize>,
) -> impl Strategy<Value = Problem> {
    (controllers, mcs, 0..2u64)
        .prop_flat_map(|(controllers, mcs, tolerance)| {
            let count = u32::try_from(controllers).unwrap();
            let capacity = (
                1..5u64,
                5..10u64,
                3..12u64,
                prop_oneof![4 => Just(0), 1 => 0..30u64],
            )
                .prop_map(|(factor, limit, memory_kb, base)| Capacity {
                    capacity_ppm: factor * limit * 50_000,
                    cycle_ppm: factor * 500_000,
                    memory_kb,
                    base_ppm: base * 10_000,
                });
            let demand = (
                1..40u64,
                1..5u64,
                0..4u64,
                0..3u32,
                prop::collection::btree_map(
                    0..count,
                    prop_oneof![3 => Just(0), 1 => 0..3u64],
                    0..=controllers,
                ),
                prop::option::of(0..count),
                prop::bool::weighted(0.15),
            )
                .prop_map(
                    |(need, memory_kb, state_bytes, criticality, hosts, current, fixed)| Demand {
                        need_ppm: need * 10_000,
                        memory_kb,
                        state_bytes,
                        criticality,
                        hosts: hosts
                            .into_iter()
                            .map(|(controller, cost)| Host { controller, cost })
                            .collect(),
                        current,
                        fixed: fixed && current.is_some(),
                    },
                );
            (
                prop::collection::vec(capacity, controllers),
                prop::collection::vec(demand, mcs),
                Just(tolerance * 50_000),
            )
        })
        .prop_map(|(controllers, mcs, tolerance_ppm)| Problem {
            controllers,
            mcs,
            tolerance_ppm,
            node_limit: NODE_LIMIT,
        })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn exact_search_finds_what_brute_force_finds(problem in problems(1..4, 0..6)) {
        let expected = brute_force(&problem);
        let found = plan(&problem);
        let classes = classes(&problem);
        prop_assert!(found.proven);
        prop_assert_eq!(violations(&problem, &found.assignment), Vec::<String>::new());
        let (a, b) = (worth(&problem, &classes, &found.assignment), worth(&problem, &classes, &expected));
        prop_assert_eq!((a.left_out, a.evicted), (b.left_out, b.evicted));
        prop_assert_eq!(secondary(&problem, &found.assignment), secondary(&problem, &expected));
        prop_assert_eq!(a.peak_ppm, b.peak_ppm);
        prop_assert!(found.lower_bound_ppm <= found.peak_ppm);
    }

    #[test]
    fn the_heuristic_keeps_hard_limits_and_its_bound_holds(problem in problems(1..10, 0..40)) {
        let assignment = heuristic::search(&problem);
        prop_assert_eq!(violations(&problem, &assignment), Vec::<String>::new());
        let peak = problem.peak_ppm(&assignment);
        prop_assert!(problem.lower_bound_ppm(&assignment) <= peak);
    }

    #[test]
    fn the_bound_holds_for_the_optimum(problem in problems(1..4, 0..6)) {
        let best = brute_force(&problem);
        prop_assert!(problem.lower_bound_ppm(&best) <= problem.peak_ppm(&best));
    }

    #[test]
    fn a_planted_optimum_is_met_within_one_percent(seed in 0..1_000u64) {
        let planted = planted(seed, 60, 600);
        let found = plan(&planted.problem);
        prop_assert_eq!(violations(&planted.problem, &found.assignment), Vec::<String>::new());
        prop_assert!(found.left_out.is_empty());
        prop_assert_eq!(found.lower_bound_ppm, planted.optimum_ppm);
        prop_assert!(found.peak_ppm <= planted.optimum_ppm * 101 / 100, "{} above {}", found.peak_ppm, planted.optimum_ppm);
    }
}

fn controller(factor_permille: u64, limit_permille: u64) -> Capacity {
    Capacity {
        capacity_ppm: factor_permille * limit_permille,
        cycle_ppm: factor_permille * 1_000,
        memory_kb: 1_000,
        base_ppm: 0,
    }
}

fn mc(need_ppm: u64, hosts: &[u32], current: Option<u32>) -> Demand {
    Demand {
        need_ppm,
        memory_kb: 100,
        state_bytes: 100,
        criticality: 1,
        hosts: hosts
            .iter()
            .map(|c| Host {
                controller: *c,
                cost: 0,
            })
            .collect(),
        current,
        fixed: false,
    }
}

fn problem(controllers: &[Capacity], mcs: &[Demand]) -> Problem {
    Problem {
        controllers: controllers.to_vec(),
        mcs: mcs.to_vec(),
        tolerance_ppm: 0,
        node_limit: NODE_LIMIT,
    }
}

#[test]
fn a_slower_controller_gets_its_fair_share() {
    let mcs: Vec<_> = (0..6).map(|_| mc(100_000, &[0, 1], Some(0))).collect();
    let found = plan(&problem(
        &[controller(1_000, 1_000), controller(500, 1_000)],
        &mcs,
    ));
    let on_slow = found.assignment.iter().filter(|p| **p == Some(1)).count();
    assert_eq!((on_slow, found.moves.len()), (2, 2));
    assert_eq!(found.peak_ppm, 400_000);
    assert!(found.proven);
}

#[test]
fn within_the_tolerance_nothing_moves() {
    let mcs = [
        mc(110_000, &[0, 1], Some(0)),
        mc(100_000, &[0, 1], Some(0)),
        mc(100_000, &[0, 1], Some(1)),
        mc(100_000, &[0, 1], Some(1)),
        mc(30_000, &[0, 1], Some(1)),
    ];
    let mut p = problem(&[controller(1_000, 1_000), controller(1_000, 1_000)], &mcs);
    p.tolerance_ppm = 20_000;
    assert_eq!(plan(&p).moves, Vec::<usize>::new());
    p.tolerance_ppm = 0;
    assert_eq!(plan(&p).peak_ppm, 230_000);
}

#[test]
fn short_capacity_takes_the_critical_one_and_leaves_what_runs() {
    let mut mcs = vec![
        mc(600_000, &[0], Some(0)),
        mc(600_000, &[0], None),
        mc(600_000, &[0], None),
    ];
    let p = problem(&[controller(1_000, 500)], &mcs);
    let found = plan(&p);
    assert_eq!(found.assignment, [Some(0), None, None]);
    mcs[2].criticality = 9;
    let found = plan(&problem(&[controller(1_000, 500)], &mcs));
    assert_eq!(found.assignment, [None, None, Some(0)]);
    assert_eq!(found.left_out, [0, 1]);
    assert!(
        found.peak_ppm > LIMIT_PPM,
        "above the limit rather than nowhere"
    );
}

#[test]
fn what_overloads_a_controller_already_may_stay() {
    let mcs = [mc(800_000, &[0], Some(0)), mc(800_000, &[0], Some(0))];
    let found = plan(&problem(&[controller(1_000, 1_000)], &mcs));
    assert_eq!(found.assignment, [Some(0), Some(0)]);
}

#[test]
fn a_quality_of_service_decides_among_equal_peaks() {
    let mut mcs = vec![mc(100_000, &[0, 1], None), mc(100_000, &[0, 1], None)];
    mcs[0].hosts[0].cost = 5;
    let found = plan(&problem(
        &[controller(1_000, 1_000), controller(1_000, 1_000)],
        &mcs,
    ));
    assert_eq!(found.assignment, [Some(1), Some(0)]);
}

#[test]
fn of_two_equal_plans_the_one_that_moves_less_state_wins() {
    // 0 and 1 run side by side; one of them has to make room for the third, which can run nowhere else.
    for heavier in [0, 1] {
        let mut mcs = vec![
            mc(400_000, &[0, 1], Some(0)),
            mc(400_000, &[0, 1], Some(0)),
            mc(400_000, &[0], None),
            mc(400_000, &[1], Some(1)),
        ];
        mcs[heavier].state_bytes = 100_000;
        let found = plan(&problem(
            &[controller(1_000, 1_000), controller(1_000, 1_000)],
            &mcs,
        ));
        assert_eq!(found.moves, [1 - heavier]);
    }
}

#[test]
fn a_plan_from_scratch_has_to_be_better_by_more_than_the_tolerance() {
    let mut p = problem(&[controller(1_000, 1_000)], &[]);
    p.tolerance_ppm = 10_000;
    let kept = worth(&p, &classes(&p), &[]);
    let worth_of = |peak_ppm, evicted| Worth {
        peak_ppm,
        evicted,
        ..kept.clone()
    };
    let kept = worth_of(500_000, 1);
    for (peak_ppm, evicted, is_better) in [
        (489_999, 1, true),
        (490_000, 1, false),
        (400_000, 2, false),
        (900_000, 0, true),
    ] {
        let fresh = worth_of(peak_ppm, evicted);
        assert_eq!(
            super::heuristic::better(&p, &fresh, &kept),
            is_better,
            "{peak_ppm} {evicted}"
        );
    }
}

#[test]
fn an_empty_cell_has_an_empty_plan() {
    let found = plan(&problem(&[], &[]));
    assert_eq!((found.assignment.len(), found.peak_ppm), (0, 0));
    let found = plan(&problem(&[], &[mc(1, &[], None)]));
    assert_eq!(found.left_out, [0]);
}
