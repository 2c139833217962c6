//! A fourth quality of service beside the three standard ones, without a change to any of them; and the cycle-time monitor.

use crate::bench::{Bench, c, m, model, owner};
use fam_agents::cell_view::CellView;
use fam_agents::monitor::{Placement, Qualities, QualityOfService};
use fam_proto::*;
use std::hash::{Hash, Hasher};

/// Energy: prefers controllers that draw little power, and wants to move when a draw above 100 W can be had lower.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
struct Energy {
    asked: bool,
}

impl QualityOfService for Energy {
    fn name(&self) -> &str {
        "energy"
    }

    /// Asks once, when two controllers are there.
    fn monitor(&mut self, view: &CellView, _now: Now) -> Vec<QosEvent> {
        let up = view.controllers.values().filter(|c| c.is_up()).count();
        if self.asked || up < 2 || view.is_busy(_now) || view.runs_on(&m("m1")).is_none() {
            return Vec::new();
        }
        self.asked = true;
        vec![QosEvent {
            qos: "energy".to_owned(),
            cause: Cause::Custom("power".to_owned()),
            detail: "the night tariff has ended".to_owned(),
        }]
    }

    fn criteria(&self) -> Vec<String> {
        vec!["watts".to_owned()]
    }

    fn weigh(&self, placement: &Placement<'_>) -> Result<(), String> {
        match watts(placement) {
            Some(watts) if watts > 1_000 => Err(format!("draws {watts} W")),
            _ => Ok(()),
        }
    }

    fn cost(&self, placement: &Placement<'_>) -> u64 {
        watts(placement).map_or(0, i64::unsigned_abs)
    }

    fn boxed(&self) -> Box<dyn QualityOfService> {
        Box::new(self.clone())
    }

    fn digest(&self, mut hasher: &mut dyn Hasher) {
        self.hash(&mut hasher);
    }
}

fn watts(placement: &Placement<'_>) -> Option<i64> {
    let bid = placement.bid?;
    let (_, watts) = bid.criteria.iter().find(|(name, _)| name == "watts")?;
    Some(*watts)
}

fn bench(controllers: usize) -> Bench {
    let qualities = Qualities::standard().with(Box::new(Energy::default()));
    Bench::restored(model(controllers, 1), RepoState::default(), qualities, 1)
}

fn draws(watts: i64) -> impl Fn(&mut Bid) {
    move |bid| bid.criteria = vec![("watts".to_owned(), watts)]
}

#[test]
fn a_fourth_quality_of_service_asks_weighs_and_decides() {
    let mut bench = bench(2);
    bench.step(0, "up c1.1; up c2.1");
    assert_eq!(
        bench.step(1, "image m1=open,c1.1,e3"),
        "c1 call m1; c2 call m1"
    );
    bench.bid("c1.1", 200, draws(300));
    bench.bid("c2.1", 0, draws(80));
    let said = bench.step(2, "tick");
    assert_eq!(
        said,
        "c2/m1 activate e4 after c1; c1/m1 release e3 to c2 e4; c1 award; c2 award m1"
    );
    assert!(
        bench.plans[0].why.contains("night tariff"),
        "{}",
        bench.plans[0].why
    );
}

#[test]
fn without_a_gain_the_fourth_quality_of_service_moves_nothing() {
    let mut bench = bench(2);
    bench.step(0, "up c1.1; up c2.1");
    bench.step(1, "image m1=open,c1.1,e3");
    bench.bid("c1.1", 200, draws(80));
    bench.bid("c2.1", 0, draws(300));
    assert_eq!(bench.step(2, "tick"), "c1 award; c2 award");
}

#[test]
fn its_criterion_rules_out_and_its_objective_decides_a_failover() {
    for (second, third, expected) in [
        (500, 90, "c3/m1 activate"),
        (90, 500, "c2/m1 activate"),
        (2_000, 900, "c3/m1 activate"),
    ] {
        let mut copy = bench(3);
        copy.step(0, "up c1.1");
        copy.step(1, "image m1=open,c1.1,e3");
        copy.step(400, "killed c1.1");
        copy.step(500, "up c2.1; up c3.1");
        // The call went to c2 alone; c3 is asked with the next one.
        copy.step(599, "tick");
        let said = copy.step(600, "tick");
        assert!(said.contains("c3 call m1"), "{said}");
        copy.bid("c2.1", 0, draws(second));
        copy.bid("c3.1", 0, draws(third));
        let said = copy.step(601, "tick");
        assert!(said.starts_with(expected), "{second} W, {third} W: {said}");
    }
}

#[test]
fn the_set_compares_and_hashes_by_what_its_members_know() {
    let a = Qualities::standard().with(Box::new(Energy { asked: false }));
    let b = Qualities::standard().with(Box::new(Energy { asked: true }));
    assert_eq!(a, a.clone());
    assert_ne!(a, b);
    assert_ne!(a, Qualities::standard());
}

/// A report of c1, on which m1 runs.
fn report(
    scan_us_worst: u32,
    lag_us: u64,
    image_age_us: u64,
) -> fam_proto::agent::Input<fam_agents::manager::ManagerLocal> {
    fam_proto::agent::Input::Message(Envelope {
        from: AgentId::Controller(c("c1")),
        boot: BootId(1),
        to: AgentId::Manager,
        body: Message::Report(ResourceReport {
            owner: owner("c1", 1),
            workload_permille: 240,
            mcs: vec![McLoad {
                mc: m("m1"),
                scan_us_mean: 400,
                scan_us_worst,
                cycle_us: 5_000,
                scans: 20,
                lag_us,
            }],
            host_cpu_permille: 0,
            process_cpu_permille: 0,
            process_memory_kb: 0,
            late_ticks: 0,
            overruns: 0,
            image_age_us,
            bad_messages: 0,
        }),
    })
}

#[test]
fn a_lag_that_grows_is_told_unless_there_is_nothing_to_scan() {
    for (what, lags_ms, image_age_us, expected) in [
        ("growing", [0, 20, 40, 60], 3_000, 1),
        ("a single stall", [0, 60, 60, 60], 3_000, 0),
        ("by less than a cycle", [0, 4, 8, 12], 3_000, 0),
        ("the gateway is down", [0, 20, 40, 60], 120_000, 0),
    ] {
        let mut bench = Bench::new(model(2, 1));
        bench.step(0, "up c1.1; up c2.1");
        bench.step(1, "image m1=open,c1.1,e3");
        bench.step(600, "works c1.1 240; works c2.1 0");
        for (n, lag_ms) in lags_ms.into_iter().enumerate() {
            bench.handle(report(600, lag_ms * 1_000 + n as u64, image_age_us));
            bench.step(601 + n as u64, "tick");
        }
        let told = bench.texts(EventKind::QosEvent);
        assert_eq!(told.len(), expected, "{what}: {told:?}");
    }
}

#[test]
fn scans_that_take_longer_than_the_cycle_are_told_once_and_moved_away_from() {
    let mut bench = Bench::new(model(2, 1));
    bench.step(0, "up c1.1; up c2.1");
    bench.step(1, "image m1=open,c1.1,e3");
    bench.step(600, "works c1.1 240; works c2.1 0");
    bench.handle(report(600, 0, 0));
    assert_eq!(bench.step(601, "tick"), "");
    bench.handle(report(6_000, 0, 0));
    assert_eq!(bench.step(602, "tick"), "c1 call m1; c2 call m1");
    bench.handle(report(6_001, 0, 0));
    let said = bench.step(603, "bid c1.1 240; bid c2.1 0");
    assert_eq!(
        said,
        "c2/m1 activate e4 after c1; c1/m1 release e3 to c2 e4; c1 award; c2 award m1"
    );
    let told = bench.texts(EventKind::QosEvent);
    assert!(
        told[0].contains("take up to 6000 us") && told[0].contains("its cycle is 5000 us"),
        "{told:?}"
    );
}
