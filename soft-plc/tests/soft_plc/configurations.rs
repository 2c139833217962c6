//! Configurations: resources, tasks, instances of programs, access paths, globals of each level, as programs run alone.

use fam_soft_plc::standalone::{self, Options, Shown};
use fam_soft_plc::{
    CheckOptions, Engine, EngineOptions, Instance, SourceFile, check, parse_project,
};

/// What the names show after each of so many scans.
fn run(text: &str, names: &[&str], scans: u32) -> Vec<String> {
    let files = [SourceFile::new("c.st", text)];
    let prepared = standalone::prepare(&files, &Options::default())
        .unwrap_or_else(|d| panic!("{}", crate::common::show(&d)));
    let engine = Engine::new(EngineOptions::default()).expect("engine");
    let module = engine.prepare(&prepared.mc).expect("module");
    let mut instance = Instance::new(&engine, &module).expect("instance");
    let mut seen = Vec::new();
    for scan in 0..i64::from(scans) {
        instance
            .scan(scan * prepared.cycle_ns, 1_000)
            .expect("a scan");
        let shown = names.iter().map(|name| {
            let info = standalone::find(&instance, name).unwrap_or_else(|| panic!("{name}"));
            match standalone::show(&instance, &info) {
                Some(Shown::Scalar(value)) => value.to_string(),
                other => format!("{other:?}"),
            }
        });
        seen.push(shown.collect::<Vec<_>>().join(" "));
    }
    seen
}

const PROGRAMS: &str = "
PROGRAM Count VAR_INPUT step : INT := 1; END_VAR VAR_OUTPUT n : INT; END_VAR n := n + step; END_PROGRAM
";

const SUM: &str = "
PROGRAM Sum VAR_EXTERNAL total : INT; END_VAR VAR_EXTERNAL CONSTANT FACTOR : INT; END_VAR VAR_INPUT x : INT; END_VAR
total := total + FACTOR * x; END_PROGRAM
";

#[test]
fn tasks_run_their_programs_by_interval_and_priority() {
    let text = format!(
        "{PROGRAMS}{SUM}CONFIGURATION Plant
VAR_GLOBAL RETAIN total : INT := 100; END_VAR
VAR_GLOBAL CONSTANT FACTOR : INT := 2; END_VAR
RESOURCE Main ON PLC
    VAR_GLOBAL seen : INT; END_VAR
    TASK fast (INTERVAL := T#10ms, PRIORITY := 1);
    TASK slow (INTERVAL := T#30ms, PRIORITY := 2);
    PROGRAM one WITH fast : Count (n => seen);
    PROGRAM two WITH slow : Count (step := 10);
    PROGRAM all WITH slow : Sum (x := seen);
END_RESOURCE
VAR_ACCESS reach : Main.one.n : INT READ_ONLY; END_VAR
END_CONFIGURATION"
    );
    // The fast one in every scan, the slow ones in every third; `total` gets twice what the fast one has counted.
    assert_eq!(
        run(&text, &["one.n", "two.n", "total"], 7),
        [
            "1 10 102", "2 10 102", "3 10 102", "4 20 110", "5 20 110", "6 20 110", "7 30 124"
        ]
    );
}

#[test]
fn a_single_task_runs_at_the_rising_edge() {
    let text = format!(
        "{PROGRAMS}PROGRAM Clock VAR_EXTERNAL tick : BOOL; END_VAR tick := NOT tick; END_PROGRAM
CONFIGURATION Plant
VAR_GLOBAL tick : BOOL; END_VAR
RESOURCE Main ON PLC
    TASK cyclic (INTERVAL := T#10ms, PRIORITY := 1);
    TASK event (SINGLE := tick, PRIORITY := 2);
    PROGRAM c WITH cyclic : Clock;
    PROGRAM e WITH event : Count;
END_RESOURCE
END_CONFIGURATION"
    );
    assert_eq!(
        run(&text, &["tick", "Count.n"], 4),
        ["TRUE 1", "FALSE 1", "TRUE 2", "FALSE 2"]
    );
}

#[test]
fn resources_have_tasks_and_instances_of_their_own() {
    let text = format!(
        "{PROGRAMS}CONFIGURATION Plant
RESOURCE Left ON PLC
    TASK t (INTERVAL := T#20ms, PRIORITY := 1);
    PROGRAM a WITH t : Count (step := 2);
END_RESOURCE
RESOURCE Right ON PLC
    TASK t (INTERVAL := T#40ms, PRIORITY := 1);
    PROGRAM b WITH t : Count (step := 3);
END_RESOURCE
END_CONFIGURATION"
    );
    assert_eq!(run(&text, &["a.n", "b.n"], 4), ["2 3", "4 3", "6 6", "8 6"]);
}

#[test]
fn tasks_and_instances_that_mean_nothing_are_named() {
    let wrong = [
        (
            "TASK t (INTERVAL := T#5ms); TASK T (INTERVAL := T#20ms); PROGRAM a WITH t : Count;",
            "E236 the task `T`",
        ),
        (
            "TASK t (INTERVAL := T#5ms); PROGRAM a WITH t : Count; PROGRAM A WITH t : Count;",
            "E236 the program instance `A`",
        ),
        (
            "TASK t (INTERVAL := T#5ms); PROGRAM a WITH u : Count;",
            "E237 there is no task `u`",
        ),
        (
            "TASK t (INTERVAL := T#5ms); PROGRAM a WITH t : Nope;",
            "E237 there is no PROGRAM `Nope`",
        ),
        (
            "TASK t (INTERVAL := T#0s); PROGRAM a WITH t : Count;\nTASK v (INTERVAL := T#10ms); PROGRAM b WITH v : Count;",
            "W715 the task `t` has no interval",
        ),
        (
            "TASK t (INTERVAL := T#20ms); PROGRAM a WITH t : Count;\nTASK v (INTERVAL := T#50ms); PROGRAM b WITH v : Count;",
            "W715 the task `v` runs every 60 ms and not every 50 ms",
        ),
        (
            "TASK t (INTERVAL := 10, PRIORITY := 1); PROGRAM a WITH t : Count;",
            "E120 this is no setting",
        ),
    ];
    for (lines, expected) in wrong {
        let text = format!("{PROGRAMS}\nCONFIGURATION Plant\n{lines}\nEND_CONFIGURATION");
        let (project, parsed) = parse_project(&[SourceFile::new("p.st", &text)]);
        let mut said: Vec<String> = parsed
            .iter()
            .map(|d| format!("{} {}", d.code, d.message))
            .collect();
        match check(&project, CheckOptions::default()) {
            Ok(typed) => said.extend(
                typed
                    .warnings
                    .iter()
                    .map(|d| format!("{} {}", d.code, d.message)),
            ),
            Err(problems) => {
                said.extend(problems.iter().map(|d| format!("{} {}", d.code, d.message)))
            }
        }
        let found = said
            .iter()
            .filter(|s| s.starts_with(['E']) || s.starts_with("W715"));
        let found: Vec<&String> = found.collect();
        assert!(
            found.len() == 1 && found[0].starts_with(expected),
            "{lines}: {said:?}"
        );
    }
}
