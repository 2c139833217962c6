//! The marking machine of `deploy/marking-machine`, in a closed loop with its plant.

use fam_soft_plc::standalone::{self, Options};
use fam_soft_plc::{Engine, EngineOptions, Instance, Interruption, SourceFile, Value};

use crate::common::{CYCLE_NS, show};

fn text(name: &str) -> String {
    let path = format!("{}/../deploy/{name}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{path}: {e}"))
}

struct Machine {
    instance: Instance,
    scan: i64,
}

impl Machine {
    fn new(pack_motion: &str, policy: &str) -> Self {
        let files: Vec<SourceFile> = [
            "lib/generalized_actuators.st",
            "marking-machine/types.st",
            "marking-machine/signals.st",
            &format!("marking-machine/{pack_motion}"),
            "marking-machine/ram_motion.st",
            "marking-machine/temperature_control.st",
            &format!("marking-machine/{policy}"),
            "marking-machine/monitor.st",
            "marking-machine/alone.st",
            "marking-machine/plant.st",
        ]
        .iter()
        .map(|name| SourceFile::new(*name, text(name)))
        .collect();
        let prepared = standalone::prepare(&files, &Options::default())
            .unwrap_or_else(|d| panic!("{}", show(&d)));
        let engine = Engine::new(EngineOptions {
            interruption: Interruption::None,
        })
        .expect("engine");
        let module = engine.prepare(&prepared.mc).expect("module");
        let instance = Instance::new(&engine, &module).expect("instance");
        Self { instance, scan: 0 }
    }

    fn run(&mut self, scans: i64) {
        for _ in 0..scans {
            let now = self.scan * CYCLE_NS;
            self.instance.scan(now, 2).unwrap_or_else(|t| panic!("{t}"));
            self.scan += 1;
        }
    }

    fn get(&self, path: &str) -> i128 {
        self.instance
            .read(path)
            .and_then(Value::as_i128)
            .unwrap_or_else(|| panic!("{path}"))
    }

    fn start(&mut self, on: bool) {
        self.instance
            .write("StartProcess", Value::Bool(on))
            .expect("StartProcess");
    }
}

#[test]
fn packs_are_marked_warm_and_without_forbidden_sequences() {
    for (pack_motion, early, policy) in [
        ("pack_motion.st", false, "policy.st"),
        ("pack_motion_delayed.st", true, "policy.st"),
        ("pack_motion.st", false, "policy_two_products.st"),
        ("pack_motion_delayed.st", true, "policy_two_products.st"),
    ] {
        let mut m = Machine::new(pack_motion, policy);
        m.instance
            .write("Plant.earlySensor", Value::Bool(early))
            .expect("earlySensor");
        m.run(100);
        assert_eq!(m.get("Marking.marked"), 0, "not started");
        m.start(true);
        m.run(6_000);
        let marked = m.get("Marking.marked");
        assert!(
            marked >= 5,
            "{pack_motion} {policy}: {marked} packs in a minute"
        );
        assert_eq!(m.get("Plant.badMarks"), 0);
        assert!(m.get("Plant.goodMarks") >= marked);
        for path in [
            "PolicyMonitor.watch.ramDownWhileBelt",
            "PolicyMonitor.watch.beltWhileDown",
            "PolicyMonitor.watch.noAnswer",
            "Marking.Pack.FaultType",
            "Marking.Mark.FaultType",
            "Marking.TempCont.FaultType",
        ] {
            assert_eq!(m.get(path), 0, "{pack_motion} {policy}: {path}");
        }
        m.start(false);
        m.run(3_000);
        let at_rest = m.get("Marking.marked");
        m.run(1_000);
        assert_eq!(m.get("Marking.marked"), at_rest, "stopped");
        assert_eq!(m.get("HeatingON"), 0);
    }
}

#[test]
fn the_first_actuator_cannot_do_with_an_early_sensor() {
    let mut m = Machine::new("pack_motion.st", "policy.st");
    m.instance
        .write("Plant.earlySensor", Value::Bool(true))
        .expect("earlySensor");
    m.start(true);
    m.run(2_000);
    assert!(m.get("Plant.badMarks") > 0);
}

#[test]
fn faults_are_found_while_an_actuator_is_idle() {
    let mut m = Machine::new("pack_motion.st", "policy.st");
    m.run(10);
    // A ram that is up and down at once.
    m.instance
        .write("Plant.ramAt", Value::Real(80.0))
        .expect("write");
    m.run(1);
    assert_eq!(m.get("Marking.Mark.FaultType"), 0, "only down");
    m.instance
        .write("TemperatureSensor", Value::Real(999.0))
        .expect("write");
    m.instance
        .write("Plant.temperature", Value::Real(999.0))
        .expect("write");
    m.run(2);
    assert_eq!(m.get("Marking.TempCont.State"), 3, "Fault");
    assert_eq!(m.get("Marking.TempCont.FaultType"), 2, "SensorFault");
}

/// Commands as a policy must not give them, each for a while; then what the monitor has counted.
fn watched(commands: &[(&str, i64)]) -> [i128; 3] {
    let program = "PROGRAM M VAR Belt, RamDown, RamUp, AtPack : BOOL; watch : PolicyWatch; END_VAR\n\
         watch(Belt := Belt, RamDown := RamDown, RamUp := RamUp, AtPack := AtPack); END_PROGRAM";
    let files = [
        SourceFile::new("monitor.st", text("marking-machine/monitor.st")),
        SourceFile::new("m.st", program),
    ];
    let prepared =
        standalone::prepare(&files, &Options::default()).unwrap_or_else(|d| panic!("{}", show(&d)));
    let engine = Engine::new(EngineOptions::default()).expect("engine");
    let module = engine.prepare(&prepared.mc).expect("module");
    let mut m = Machine {
        instance: Instance::new(&engine, &module).expect("instance"),
        scan: 0,
    };
    for (on, scans) in commands {
        for name in ["Belt", "RamDown", "RamUp", "AtPack"] {
            let on = on.split(' ').any(|n| n == name);
            m.instance
                .write(&format!("M.{name}"), Value::Bool(on))
                .expect(name);
        }
        m.run(*scans);
    }
    ["ramDownWhileBelt", "beltWhileDown", "noAnswer"].map(|n| m.get(&format!("M.watch.{n}")))
}

/// Signals that are on, and for how many scans.
type Stretch = (&'static str, i64);

#[test]
fn the_monitor_reports_forbidden_sequences_and_missing_responses() {
    let table: [(&[Stretch], [i128; 3]); 6] = [
        // As it should be: in, down, up and out at once.
        (
            &[
                ("Belt", 200),
                ("RamDown", 40),
                ("AtPack", 20),
                ("Belt RamUp AtPack", 5),
                ("Belt RamUp", 30),
            ],
            [0, 0, 0],
        ),
        // The tool comes down before the pack stands; twice.
        (
            &[
                ("Belt", 50),
                ("Belt RamDown", 10),
                ("Belt", 10),
                ("Belt RamDown", 10),
            ],
            [2, 0, 0],
        ),
        // The pack is drawn away before the tool is lifted.
        (&[("AtPack", 20), ("Belt AtPack", 10)], [0, 1, 0]),
        // A drive that reaches nothing, by one scan more than is allowed, and not.
        (&[("Belt", 802)], [0, 0, 1]),
        (&[("Belt", 799)], [0, 0, 0]),
        (&[("RamDown", 402), ("", 1), ("RamUp", 402)], [0, 0, 2]),
    ];
    for (commands, expected) in table {
        assert_eq!(watched(commands), expected, "{commands:?}");
    }
}

#[test]
fn each_modification_changes_one_text_and_nothing_else() {
    // The policy names no sensor and no drive, the actuators name no product.
    for name in [
        "marking-machine/policy.st",
        "marking-machine/policy_two_products.st",
    ] {
        let text = text(name);
        let chart = &text[text.find("FUNCTION_BLOCK MarkingPolicy").expect("chart")..];
        for word in ["Sensor", "Motor", "Port", "DelayTime"] {
            assert!(!chart.contains(word), "{name} names {word}");
        }
    }
    for name in [
        "pack_motion",
        "pack_motion_delayed",
        "ram_motion",
        "temperature_control",
    ] {
        let text = text(&format!("marking-machine/{name}.st"));
        assert!(!text.contains("80.0"), "{name} knows a product");
    }
    let lines = |a: &str, b: &str| -> usize {
        let (a, b) = (text(a), text(b));
        let kept: Vec<&str> = a.lines().collect();
        b.lines().filter(|l| !kept.contains(l)).count()
    };
    // The delay: a parameter, a timer, its call, and where it is asked; the policy: its title and the choice.
    assert!(
        lines(
            "marking-machine/pack_motion.st",
            "marking-machine/pack_motion_delayed.st"
        ) <= 8
    );
    assert_eq!(
        lines(
            "marking-machine/policy.st",
            "marking-machine/policy_two_products.st"
        ),
        2
    );
}
