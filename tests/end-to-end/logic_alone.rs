//! `fam run`, `fam test` and `fam check` of logic, as a control engineer meets them: files in, text and exit code out.

mod support;

use serde_json::{Value, json};
use std::path::PathBuf;
use support::run;

/// A folder with these files; gives their paths.
fn files(named: &[(&str, &str)]) -> (tempfile::TempDir, Vec<String>) {
    let dir = tempfile::tempdir().unwrap();
    let paths = named.iter().map(|(name, text)| {
        let path: PathBuf = dir.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.display().to_string()
    });
    let paths = paths.collect();
    (dir, paths)
}

/// The last line of what was printed, as JSON.
fn last_json(out: &str) -> Value {
    serde_json::from_str(out.lines().last().unwrap_or_default())
        .unwrap_or_else(|e| panic!("{e}: {out}"))
}

const PUMP: &str = "\
TYPE Mode : (Idle, Pumping := 5); END_TYPE
VAR_GLOBAL
    level AT %IW0 : INT;
    pump AT %QX0.0 : BOOL;
END_VAR
PROGRAM Main
VAR_EXTERNAL level : INT; pump : BOOL; END_VAR
VAR
    mode : Mode;
    delay : TON;
    history : ARRAY[1..3] OF INT;
    note : STRING[8] := 'start';
    mean : LREAL;
END_VAR
    history[3] := history[2];
    history[2] := history[1];
    history[1] := level;
    mean := INT_TO_LREAL(history[1] + history[2] + history[3]) / 3.0;
    delay(IN := level > 10, PT := T#30ms);
    IF delay.Q THEN
        mode := Pumping;
        note := 'it pumps now';
    END_IF;
    pump := mode = Pumping;
END_PROGRAM
";

#[test]
fn rows_of_inputs_count_scans_as_the_trace_does() {
    let text = "PROGRAM Main VAR x, y : INT; END_VAR y := x; END_PROGRAM";
    for (table, expected) in [
        ("scan,x\n2,5\n", "1,0 2,5 3,5"),
        ("scan,x\n3,6\n1,5\n", "1,5 2,5 3,6"),
        ("scan,x\n0,4\n2,5\n", "1,4 2,4 3,5"),
    ] {
        let (dir, paths) = files(&[("p.st", text), ("inputs.csv", table)]);
        let trace = dir.path().join("trace.csv").display().to_string();
        let (code, _, err) = run(&[
            "run", &paths[0], "--scans", "3", "--inputs", &paths[1], "--trace", &trace, "--watch",
            "y",
        ]);
        assert_eq!(code, 0, "{err}");
        let rows = std::fs::read_to_string(&trace).unwrap();
        let seen: Vec<String> = rows
            .lines()
            .skip(1)
            .map(|row| {
                let cells: Vec<&str> = row.split(',').collect();
                format!("{},{}", cells[0], cells[2])
            })
            .collect();
        assert_eq!(seen.join(" "), expected, "{table}");
    }
    for (table, said) in [
        (
            "scan,x\n1,5,6\n",
            "line 2: 3 fields, and the first line names 2",
        ),
        ("scan,x,X\n1,5,6\n", "two columns are `Main.x`"),
    ] {
        let (_dir, paths) = files(&[("p.st", text), ("inputs.csv", table)]);
        let (code, _, err) = run(&["run", &paths[0], "--inputs", &paths[1]]);
        assert_ne!(code, 0, "{table}");
        assert!(err.contains(said), "{err}");
    }
}

#[test]
fn a_program_runs_in_simulated_time_with_inputs_and_trace() {
    let inputs = "time_ms,level\n0,5\n20,12\n";
    let (dir, paths) = files(&[("pump.st", PUMP), ("inputs.csv", inputs)]);
    let trace = dir.path().join("trace.csv").display().to_string();
    let (code, out, err) = run(&[
        "run",
        &paths[0],
        "--scans",
        "7",
        "--cycle-ms",
        "10",
        "--inputs",
        &paths[1],
        "--trace",
        &trace,
        "--watch",
        "Main.mode,pump",
        "--json",
    ]);
    assert_eq!(code, 0, "{err}");
    let end = last_json(&out);
    assert_eq!(end["scans"], 7);
    let variables = &end["variables"];
    for (name, value) in [
        ("Main.history", json!([12, 12, 12])),
        ("Main.mode", json!("Pumping")),
        ("Main.note", json!("it pumps")),
        ("Main.mean", json!(12.0)),
        ("Main.delay.Q", json!(true)),
        ("level", json!(12)),
        ("pump", json!(true)),
    ] {
        assert_eq!(variables[name], value, "{name} in {end}");
    }
    // 20 ms: the level rises; 30 ms later the delay is over, in the sixth scan.
    let trace = std::fs::read_to_string(&trace).unwrap();
    let rows: Vec<&str> = trace.lines().collect();
    assert_eq!(rows.len(), 8, "{trace}");
    let pumping: Vec<bool> = rows[1..].iter().map(|r| r.contains("Pumping")).collect();
    assert_eq!(
        pumping,
        [false, false, false, false, false, true, true],
        "{trace}"
    );
}

#[test]
fn a_trap_names_pou_and_line_and_ends_with_exit_code_3() {
    let text = "PROGRAM Main\nVAR n : INT := 2; q : INT; END_VAR\n    n := n - 1;\n    q := 10 / n;\nEND_PROGRAM\n";
    let (_dir, paths) = files(&[("divide.st", text)]);
    let (code, out, err) = run(&["run", &paths[0], "--scans", "5", "--json"]);
    assert_eq!(code, 3, "{out}{err}");
    for part in ["division by zero", "Main", "divide.st", "4"] {
        assert!(err.contains(part), "`{part}` is not in: {err}");
    }
    assert_eq!(
        last_json(&out)["scans"],
        1,
        "the scan that trapped does not count: {out}"
    );
}

#[test]
fn every_mistake_is_shown_at_its_line_for_people_and_for_tools() {
    let text = "PROGRAM Main\nVAR a : INT; b : BOOL; END_VAR\n    a := b;\n    c := 1;\n    IF a THEN\n    END_IF;\nEND_PROGRAM\n";
    let (_dir, paths) = files(&[("wrong.st", text)]);
    let (code, out, err) = run(&["check", &paths[0]]);
    assert_eq!(code, 1);
    let said = format!("{out}{err}");
    for part in ["wrong.st:3:", "wrong.st:4:", "wrong.st:5:", "a := b;"] {
        assert!(said.contains(part), "`{part}` is not in: {said}");
    }
    let (code, out, _) = run(&["check", &paths[0], "--json"]);
    assert_eq!(code, 1);
    let json: Value = serde_json::from_str(&out).unwrap();
    let lines = json.to_string();
    assert!(
        lines.contains("\"line\":3") && lines.contains("\"line\":5"),
        "{json}"
    );
    let (code, out, _) = run(&["check", &paths[0], "--sarif"]);
    assert_eq!(code, 1);
    let sarif: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(sarif["version"], "2.1.0");
    let results = sarif["runs"][0]["results"].as_array().unwrap();
    assert!(results.len() >= 3, "{sarif}");
    let starts = results
        .iter()
        .map(|r| &r["locations"][0]["physicalLocation"]["region"]["startLine"]);
    assert!(starts.clone().any(|l| l == 4), "{sarif}");
    assert!(results.iter().all(|r| r["ruleId"].is_string()), "{sarif}");

    let (_dir, paths) = files(&[("right.st", PUMP)]);
    let (code, out, err) = run(&["check", &paths[0]]);
    assert_eq!(code, 0, "{out}{err}");
}

#[test]
fn test_programs_are_run_and_counted() {
    let good = "PROGRAM TestSum\nVAR check : ASSERT; END_VAR\n    check(condition := 1 + 1 = 2, message := 'sum');\nEND_PROGRAM\n";
    let bad = "PROGRAM TestOrder\nVAR check : ASSERT; END_VAR\n    check(condition := 2 < 1, message := 'two is less');\nEND_PROGRAM\n";
    let (dir, _) = files(&[("good.st", good)]);
    let folder = dir.path().display().to_string();
    let (code, out, err) = run(&["test", &folder]);
    assert_eq!(code, 0, "{out}{err}");
    assert!(out.ends_with("1 passed, 0 failed\n"), "{out}");
    std::fs::write(dir.path().join("bad.st"), bad).unwrap();
    let (code, out, _) = run(&["test", &folder]);
    assert_eq!(code, 1);
    assert!(
        out.contains("FAILED  TestOrder") && out.contains("two is less"),
        "{out}"
    );
    assert!(out.ends_with("1 passed, 1 failed\n"), "{out}");
}
