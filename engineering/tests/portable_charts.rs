//! Charts, diagrams and edges of inputs with `--target portable`: what becomes of them runs as they do, scan by scan and byte by byte, and goes on from a state that
//! Serialize wrote. Each MC runs three times: from the original; from the plain form on FAM's own blocks and time; and from the files as another
//! PLC gets them, the controller's project and `standard.st`, with `<MC>_Cycle` as its task.

mod common;

use common::spec;
use fam_engineering::build::{BuiltMc, build, compile_sources};
use fam_engineering::generate::Target;
use fam_engineering::output;
use fam_engineering::plcopen::mc_source;
use fam_reference::chart::{Sample, samples};
use fam_reference::random::Random;
use fam_soft_plc::{
    Area, CompiledMc, Engine, EngineOptions, Instance, Module, SourceFile, TypeNode, Value,
};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const BUDGET_TICKS: u64 = 1000;

/// Once compiled, any number of instances.
struct Form {
    module: Module,
    checkpoint: usize,
    state: usize,
    /// The count of the MC's time, where nobody else keeps it.
    own_time: Option<String>,
}

impl Form {
    fn new(engine: &Engine, compiled: &CompiledMc, own_time: Option<String>) -> Form {
        Form {
            module: engine.prepare(compiled).unwrap(),
            checkpoint: compiled.layout.region_index("checkpoint").unwrap(),
            state: compiled.layout.region_index("state").unwrap(),
            own_time,
        }
    }

    /// An instance that goes on from a checkpoint, and from the MC time that belongs to it.
    fn instance(&self, engine: &Engine, checkpoint: &[u8], time_ns: i64) -> Instance {
        let mut instance = Instance::new(engine, &self.module).unwrap();
        let region = instance.region_mut(self.checkpoint);
        region.copy_from_slice(checkpoint);
        if let Some(path) = &self.own_time {
            instance.write(path, Value::Time(time_ns)).unwrap();
        }
        instance
    }
}

/// The MC as the files hold it: its part of the project, and the standard blocks.
fn as_files_hold_it(mc: &BuiltMc, project: &str, standard: &str) -> CompiledMc {
    let name = mc.mc.as_str();
    // The tasks of the other MCs run what stands in their parts.
    let mut standard = standard.to_owned();
    let mut from = 0;
    while let Some(at) = standard[from..].find("PROGRAM ").map(|at| from + at) {
        let end = at + standard[at..].find("END_PROGRAM\n").unwrap() + "END_PROGRAM\n".len();
        if standard[at..].starts_with(&format!("PROGRAM {name}_Cycle\n")) {
            from = end;
        } else {
            standard.replace_range(at..end, "");
            from = at;
        }
    }
    let sources = [
        mc_source(project, name).unwrap(),
        SourceFile::new("standard.st", standard),
    ];
    let spec = fam_soft_plc::CompileSpec {
        entry: format!("{name}_Cycle"),
        ..spec(mc)
    };
    compile_sources(&sources, &spec).unwrap_or_else(|problems| {
        let texts: Vec<String> = problems.iter().map(ToString::to_string).collect();
        panic!("{name}: {}", texts.join("\n"))
    })
}

/// Runs all MCs of a model in all forms; how many scans were compared.
fn all_forms_run_equal(model: &Path, scans: usize, seed: u64) -> usize {
    let fam = build(model).unwrap_or_else(|p| panic!("{p}"));
    let (files, portable) =
        output::generate(model, Target::Portable).unwrap_or_else(|p| panic!("{p}"));
    let controller = &fam.model.controllers[0].controller;
    let project = &files[&format!("{controller}.xml")];
    for (name, text) in &files {
        assert!(!text.contains("__"), "{name} has what is no name elsewhere");
        let is_project = name.ends_with(".xml") && !name.contains('/');
        assert!(
            !is_project || !(text.contains("INITIAL_STEP") || text.contains("<SFC")),
            "{name} has a chart"
        );
    }
    let engine = Engine::new(EngineOptions::default()).unwrap();
    let mut compared = 0;
    for (a, b) in fam.mcs.iter().zip(&portable.mcs) {
        same_places(a, b);
        let elsewhere = as_files_hold_it(b, project, &files["standard.st"]);
        let forms = [
            Form::new(&engine, &a.compiled, None),
            Form::new(&engine, &b.compiled, None),
            Form::new(&engine, &elsewhere, Some(format!("{}_mcTime", a.mc))),
        ];
        compared += run(&engine, a, &forms, scans, seed);
    }
    compared
}

/// Every variable of the state has its place and its first value in both.
fn same_places(a: &BuiltMc, b: &BuiltMc) {
    let places = |mc: &BuiltMc| -> Vec<(u32, u32)> {
        mc.state_variables
            .iter()
            .map(|v| (v.offset, v.len))
            .collect()
    };
    let (mine, theirs) = (places(a), places(b));
    let at = (0..mine.len().max(theirs.len())).find(|n| mine.get(*n) != theirs.get(*n));
    if let Some(at) = at {
        panic!(
            "MC {}: {:?} in the chart, {:?} in the plain form",
            a.mc,
            a.state_variables.get(at),
            b.state_variables.get(at)
        );
    }
    assert!(a.initial_checkpoint == b.initial_checkpoint, "{}", a.mc);
}

fn run(engine: &Engine, mc: &BuiltMc, forms: &[Form; 3], scans: usize, seed: u64) -> usize {
    let mut random = Random::new(seed);
    let cycle_ns = i64::from(mc.cycle_us) * 1000;
    let mut checkpoint = mc.initial_checkpoint.clone();
    let mut instances: Vec<Instance> = Vec::new();
    let mut compared = 0;
    for scan in 0..scans {
        let time_ns = scan as i64 * cycle_ns;
        // Each goes on from the bytes of another, in an instance that knows nothing.
        if instances.is_empty() || random.chance(10) {
            let actions =
                mc.diagnosis.intervals.len() + usize::from(mc.diagnosis.stop_action.is_some());
            let action = if random.chance(20) {
                random.below(actions + 1)
            } else {
                0
            };
            mc.control.activate(&mut checkpoint, action as u16, false);
            instances = forms
                .iter()
                .map(|f| f.instance(engine, &checkpoint, time_ns))
                .collect();
        }
        let inputs = inputs(mc, &mut instances[0], &mut random);
        let mut ends = Vec::new();
        for instance in &mut instances {
            instance.inputs_mut().copy_from_slice(&inputs);
            let end = instance.scan(time_ns + cycle_ns, BUDGET_TICKS);
            ends.push(end.map_err(|trap| trap.kind));
        }
        assert!(
            ends.iter().all(|e| *e == ends[0]),
            "MC {}, scan {scan}: {ends:?}",
            mc.mc
        );
        if ends[0].is_err() {
            checkpoint.clone_from(&mc.initial_checkpoint);
            instances.clear();
            continue;
        }
        let (first, rest) = instances.split_first().unwrap();
        for (number, (instance, form)) in rest.iter().zip(&forms[1..]).enumerate() {
            for (mine, theirs, what) in [
                (forms[0].state, form.state, "state"),
                (forms[0].checkpoint, form.checkpoint, "checkpoint"),
            ] {
                let (a, b) = (first.region(mine), instance.region(theirs));
                if a != b {
                    let at = a.iter().zip(b).position(|(a, b)| a != b).unwrap_or(0);
                    let mut variables = mc.compiled.layout.variables.iter();
                    let in_array = at.checked_sub(mc.control.state.start as usize);
                    let (region, offset) = match in_array {
                        Some(offset) if what == "checkpoint" => (forms[0].state, offset),
                        _ => (mine, at),
                    };
                    let here = variables
                        .rfind(|v| v.area == Area::Region(region) && v.offset as usize <= offset);
                    panic!(
                        "MC {}, scan {scan}: byte {at} of the {what}, {:?}, is {} in the chart and {} in form {}",
                        mc.mc,
                        here.map(|v| &v.path),
                        a[at],
                        b[at],
                        number + 1
                    );
                }
            }
            assert_eq!(
                first.outputs(),
                instance.outputs(),
                "MC {}, scan {scan}",
                mc.mc
            );
        }
        checkpoint.copy_from_slice(instances[random.below(3)].region(forms[0].checkpoint));
        compared += 1;
    }
    compared
}

/// Random inputs; of enumerations those values that they have, for others have no place in the plain form.
fn inputs(mc: &BuiltMc, instance: &mut Instance, random: &mut Random) -> Vec<u8> {
    for byte in instance.inputs_mut() {
        *byte = (random.below(256) & random.below(256)) as u8;
    }
    let variables = mc.compiled.layout.variables.iter();
    for variable in variables.filter(|v| v.area == Area::Inputs) {
        if let TypeNode::Enum { base, values, .. } = &*variable.ty {
            let number = i128::from(random.one(values).1);
            let value = Value::from_i128(*base, number);
            instance.write_variable(variable, value).unwrap();
        }
    }
    instance.inputs().to_vec()
}

/// A cell of one MC with these files of logic.
fn cell(logic: &BTreeMap<&str, String>, inputs: &str) -> (TempDir, PathBuf) {
    let (dir, path) = common::one_mc("", inputs);
    let names: Vec<String> = logic.keys().map(|n| format!("{n:?}")).collect();
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("\"m.st\"", &names.join(", "))).unwrap();
    for (name, text) in logic {
        std::fs::write(dir.path().join(name), text).unwrap();
    }
    (dir, path)
}

/// A program that runs all of them on inputs from a counter that belongs to the state.
fn caller(calls: &[(String, bool)], seed: u64) -> String {
    let mut text = format!(
        "PROGRAM M\nVAR random : UDINT := {}; x0, x1, x2, x3 : BOOL;\n",
        seed * 7 + 1
    );
    for (name, is_block) in calls {
        if *is_block {
            text.push_str(&format!("i_{name} : {name};\n"));
        }
    }
    text.push_str("END_VAR\n random := random * 1664525 + 1013904223;\n");
    for x in 0..4 {
        let shifted = 1 << (8 + 5 * x);
        text.push_str(&format!(" x{x} := random / {shifted} MOD 10 < 4;\n"));
    }
    for (name, is_block) in calls {
        let prefix = if *is_block { "i_" } else { "" };
        text.push_str(&format!(
            " {prefix}{name}(x0 := x0, x1 := x1, x2 := x2, x3 := x3);\n"
        ));
    }
    text.push_str("END_PROGRAM\n");
    text
}

/// As text and as drawings, programs and function blocks.
fn files_of(charts: &[Sample], seed: u64) -> BTreeMap<&'static str, String> {
    let (mut text, mut drawn, mut calls) = (String::new(), String::new(), Vec::new());
    for (number, chart) in charts.iter().enumerate() {
        let is_block = number % 2 == 1;
        calls.push((chart.name.clone(), is_block));
        if number % 4 < 2 {
            let one = if is_block {
                chart.text.replace("PROGRAM", "FUNCTION_BLOCK")
            } else {
                chart.text.clone()
            };
            text.push_str(&one);
        } else {
            let kind = if is_block { "functionBlock" } else { "program" };
            drawn.push_str(&chart.drawn.replace("program", kind));
        }
    }
    text.push_str(&caller(&calls, seed));
    let drawn = format!(
        "<project xmlns=\"http://www.plcopen.org/xml/tc6_0201\" xmlns:xhtml=\"http://www.w3.org/1999/xhtml\"><types><dataTypes/><pous>\n{drawn}</pous></types><instances><configurations/></instances></project>"
    );
    BTreeMap::from([("m.st", text), ("drawn.xml", drawn)])
}

#[test]
fn random_charts_run_equal() {
    let from_environment = std::env::var("FAM_RANDOM_CHARTS").ok();
    let seeds = from_environment.and_then(|n| n.parse().ok()).unwrap_or(8);
    for seed in 0..seeds {
        let files = files_of(&samples(seed, 12, ""), seed);
        let (_dir, path) = cell(&files, "");
        let compared = all_forms_run_equal(&path, 120, seed);
        assert_eq!(compared, 120, "seed {seed}");
    }
}

#[test]
fn the_shipped_cells_run_equal() {
    let deploy = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy");
    for model in ["marking-machine/cell.toml", "fms200/cell.toml"] {
        let compared = all_forms_run_equal(&deploy.join(model), 400, 3);
        assert!(compared > 1500, "{model}: {compared}");
    }
}

/// What random charts do not have: RETURN in actions, also out of loops; diagrams, lists and named transitions; instances, strings
/// and dates; a base with methods; names that the plain form would take.
const BY_HAND: &str = "
TYPE Color : (Red, Green := 4); FAM_STEP : STRUCT fam_a : INT; END_STRUCT; END_TYPE
FUNCTION_BLOCK Base
VAR total : LREAL := 1.0E-7; END_VAR
METHOD PUBLIC Add : BOOL
VAR_INPUT step : LREAL := 0.5; END_VAR
total := total + step; Add := total > -3.0;
END_METHOD
END_FUNCTION_BLOCK
FUNCTION_BLOCK Chart EXTENDS Base
VAR_INPUT x0, x1, x2, x3 : BOOL; END_VAR
VAR_OUTPUT done, lit : BOOL; END_VAR
VAR RETAIN fam_fire0 : FAM_STEP; shade : Color := Color#Green; a : ARRAY[0..3, 1..2] OF INT := [2(1), 3, -4]; END_VAR
VAR CONSTANT limit : INT := 5; END_VAR
VAR t : TON; text : STRING[20] := 'it$'s$L'; wide : WSTRING[8] := \"w$00e9\"; day : DATE := D#2024-02-29; moment : DT := DT#2024-02-29-12:00:01.5; n, k : INT; w : WORD := 16#FF; END_VAR
METHOD Clear : BOOL
n := 0; Clear := TRUE;
END_METHOD
INITIAL_STEP Idle: Early(N); done(R); END_STEP
STEP Work: Loops(N); List(P); color_is(S); done(SL, T#1s); END_STEP
STEP Both: lit(D, T#10ms); END_STEP
TRANSITION FROM Idle TO (Work, Both) := x0 AND NOT (x1 OR t.Q); END_TRANSITION
TRANSITION named (PRIORITY := 1) FROM Idle TO Idle := x3; END_TRANSITION
TRANSITION FROM (Work, Both) TO Idle :
  LD x2
  ORN x0
END_TRANSITION
ACTION Early:
  t(IN := NOT t.Q, PT := T#30ms);
  IF x0 THEN RETURN; END_IF;
  CASE n OF 0, 1..3: n := n + 1; ELSE Clear(); RETURN; END_CASE;
  text := CONCAT(text, 'x'); shade := SEL(x1, Color#Red, Color.Green);
END_ACTION
ACTION Loops:
  k := 0;
  WHILE k < limit DO
    k := k + 1;
    FOR n := 0 TO 3 BY 1 DO
      IF n = 2 AND x2 THEN CONTINUE; END_IF;
      IF x3 AND k = 3 THEN a[n, 1] := a[n, 1] + 1; RETURN; END_IF;
      REPEAT w := ROL(w, 1); IF x1 THEN EXIT; END_IF; UNTIL w.%X0 END_REPEAT;
    END_FOR;
    IF Add(step := INT_TO_LREAL(k) ** 2) THEN w.%B1 := 16#7; END_IF;
  END_WHILE;
  a[3, 2] := -k MOD 3; fam_fire0.fam_a := -(-k); wide := \"$0041\"; day := D#2000-01-01; SUPER^.Add(0.25);
END_ACTION
ACTION List:
  LD x1
  RETC
  LD n
  ADD 7
  ST n
END_ACTION
ACTION color_is:
  IF shade = Color#Red THEN moment := moment + T#1ms; END_IF;
END_ACTION
END_FUNCTION_BLOCK
";

const DRAWN: &str = r#"<project xmlns="http://www.plcopen.org/xml/tc6_0201" xmlns:xhtml="http://www.w3.org/1999/xhtml"><types><dataTypes/><pous>
<pou name="Drawn" pouType="functionBlock"><interface><inputVars><variable name="x0"><type><BOOL/></type></variable><variable name="x1"><type><BOOL/></type></variable><variable name="x2"><type><BOOL/></type></variable><variable name="x3"><type><BOOL/></type></variable></inputVars><localVars><variable name="n"><type><INT/></type><initialValue><simpleValue value="3"/></initialValue></variable><variable name="lamp"><type><BOOL/></type></variable></localVars></interface>
<actions><action name="Work"><body><FBD><inVariable localId="1"><expression>n</expression></inVariable><inVariable localId="2"><expression>INT#2</expression></inVariable><block localId="3" typeName="ADD"><inputVariables><variable formalParameter="IN1"><connectionPointIn><connection refLocalId="1"/></connectionPointIn></variable><variable formalParameter="IN2"><connectionPointIn><connection refLocalId="2"/></connectionPointIn></variable></inputVariables><inOutVariables/><outputVariables><variable formalParameter="OUT"><connectionPointOut/></variable></outputVariables></block><outVariable localId="4"><connectionPointIn><connection refLocalId="3" formalParameter="OUT"/></connectionPointIn><expression>n</expression></outVariable></FBD></body></action>
<action name="Lamp"><body><LD><leftPowerRail localId="1"><connectionPointOut formalParameter=""/></leftPowerRail><contact localId="2" edge="rising"><connectionPointIn><connection refLocalId="1"/></connectionPointIn><connectionPointOut/><variable>x1</variable></contact><coil localId="3"><connectionPointIn><connection refLocalId="2"/></connectionPointIn><connectionPointOut/><variable>lamp</variable></coil></LD></body></action></actions>
<transitions><transition name="other"><body><FBD><inVariable localId="1"><expression>x2</expression></inVariable><outVariable localId="2"><connectionPointIn><connection refLocalId="1"/></connectionPointIn><expression>other</expression></outVariable></FBD></body></transition></transitions>
<body><SFC><step localId="1" name="Start" initialStep="true"><connectionPointIn><connection refLocalId="5"/></connectionPointIn></step>
<transition localId="2"><connectionPointIn><connection refLocalId="1"/></connectionPointIn><condition><reference name="other"/></condition></transition>
<step localId="3" name="Run"><connectionPointIn><connection refLocalId="2"/></connectionPointIn></step>
<actionBlock localId="4"><connectionPointIn><connection refLocalId="3"/></connectionPointIn><action localId="1" qualifier="N"><reference name="Work"/></action><action localId="2" qualifier="N"><reference name="Lamp"/></action><action localId="3" qualifier="SD" duration="PT0.02S"><inline><ST><xhtml:p>IF x3 &amp; n &gt; 9 THEN RETURN; END_IF; n := n + 1;</xhtml:p></ST></inline></action></actionBlock>
<contact localId="9"><connectionPointIn><connection refLocalId="10"/></connectionPointIn><variable>x0</variable></contact><leftPowerRail localId="10"/>
<transition localId="5"><connectionPointIn><connection refLocalId="3"/></connectionPointIn><condition><connectionPointIn><connection refLocalId="9"/></connectionPointIn></condition></transition>
</SFC></body></pou>
</pous></types><instances><configurations/></instances></project>"#;

#[test]
fn charts_by_hand_run_equal() {
    let calls = [("Chart".to_owned(), true), ("Drawn".to_owned(), true)];
    let text = format!("{BY_HAND}{}", caller(&calls, 5));
    let files = BTreeMap::from([("drawn.xml", DRAWN.to_owned()), ("m.st", text)]);
    let (_dir, path) = cell(&files, "");
    let compared = all_forms_run_equal(&path, 1_000, 1);
    assert!(compared > 900, "{compared}");
}

/// Edges of inputs in programs, function blocks, charts, lists, methods and derived blocks; names in any case, and hidden by those of a method.
const EDGES: &str = "
FUNCTION_BLOCK Counts
VAR_INPUT x0 : BOOL R_EDGE; x1 : BOOL F_EDGE; x2, x3 : BOOL; END_VAR
VAR_OUTPUT ups, downs : INT; END_VAR
VAR fam_rise_x0 : INT; seen : ARRAY[0..1] OF INT; END_VAR
METHOD PUBLIC Look : BOOL
VAR_INPUT x1 : BOOL; END_VAR
 Look := x0 AND x1; IF THIS.x0 THEN seen[0] := seen[0] + 1; END_IF;
END_METHOD
 IF X0 THEN ups := ups + 1; END_IF;
 IF x1 THEN downs := downs + 1; RETURN; END_IF;
 IF Look(x1 := x2) THEN seen[1] := seen[1] + 1; END_IF;
 fam_rise_x0 := fam_rise_x0 + 1;
END_FUNCTION_BLOCK
FUNCTION_BLOCK Derived EXTENDS Counts
VAR more : DINT; END_VAR
 IF x0 OR x1 THEN more := more + 1; END_IF;
 SUPER^();
 IF x0 THEN more := more + 100; END_IF;
END_FUNCTION_BLOCK
FUNCTION_BLOCK Silent EXTENDS Counts
VAR nothing : DINT; END_VAR
END_FUNCTION_BLOCK
FUNCTION_BLOCK Steps
VAR_INPUT RETAIN x0 : BOOL R_EDGE; x1, x2 : BOOL; x3 : BOOL F_EDGE := TRUE; END_VAR
VAR n : INT; END_VAR
INITIAL_STEP A: END_STEP
STEP B: Act(P); END_STEP
TRANSITION FROM A TO B := x0; END_TRANSITION
TRANSITION FROM B TO A := x3; END_TRANSITION
ACTION Act: n := n + 1; IF x1 THEN RETURN; END_IF; n := n + 10; END_ACTION
END_FUNCTION_BLOCK
FUNCTION_BLOCK List
VAR_INPUT x0 : BOOL R_EDGE; x1, x2, x3 : BOOL; END_VAR
VAR n : INT; END_VAR
 LD x0
 ANDN x1
 JMPCN over
 LD n
 ADD 1
 ST n
over:
 LD n
 ST n
END_FUNCTION_BLOCK
PROGRAM Bare
VAR_INPUT x0 : BOOL F_EDGE; x1, x2, x3 : BOOL; END_VAR
VAR many : ARRAY[1..3] OF Counts; n : LINT; k : DINT; END_VAR
 FOR k := 1 TO 3 DO many[k](x0 := x1, x1 := NOT x2, x2 := x0, x3 := x3); END_FOR;
 IF x0 THEN n := n + 1; END_IF;
END_PROGRAM
";

#[test]
fn edges_of_inputs_run_equal() {
    let calls = ["Counts", "Derived", "Silent", "Steps", "List"].map(|n| (n.to_owned(), true));
    let calls = [calls.to_vec(), vec![("Bare".to_owned(), false)]].concat();
    let text = format!("{EDGES}{}", caller(&calls, 11));
    let (_dir, path) = cell(&BTreeMap::from([("m.st", text)]), "");
    let compared = all_forms_run_equal(&path, 1_000, 2);
    assert_eq!(compared, 1_000);
    something_happens(
        &path,
        &["i_Counts.ups", "i_Derived.more", "i_Steps.n", "i_List.n"],
    );
}

/// These variables of the program M change, so that what is compared is no standstill; and the project read back is the same logic.
fn something_happens(model: &Path, names: &[&str]) {
    let fam = build(model).unwrap();
    common::read_back(&fam);
    let mc = &fam.mcs[0];
    let engine = Engine::new(EngineOptions::default()).unwrap();
    let form = Form::new(&engine, &mc.compiled, None);
    let mut checkpoint = mc.initial_checkpoint.clone();
    mc.control.activate(&mut checkpoint, 0, false);
    let mut instance = form.instance(&engine, &checkpoint, 0);
    let mut values: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
    for scan in 0..300 {
        instance.scan(scan * 10_000_000, BUDGET_TICKS).unwrap();
        for name in names {
            let value = instance.read(&format!("M.{name}")).unwrap();
            values.entry(name).or_default().insert(value.to_string());
        }
    }
    for (name, values) in values {
        assert!(values.len() > 1, "{name} is always {values:?}");
    }
}

/// Diagrams that remember: contacts and coils with edges, pins with edges, the outputs of functions with EN (of several types), feedback
/// over blocks, jumps; in a program's action as well.
const DIAGRAMS: &str = include_str!("cells/diagrams.xml");

#[test]
fn diagrams_run_equal() {
    let calls = [("Ladder", true), ("Blocks", true), ("Drawing", false)];
    let calls = calls.map(|(name, is_block)| (name.to_owned(), is_block));
    let files = BTreeMap::from([
        ("diagrams.xml", DIAGRAMS.to_owned()),
        ("m.st", caller(&calls, 17)),
    ]);
    let (_dir, path) = cell(&files, "");
    let compared = all_forms_run_equal(&path, 1_000, 4);
    assert_eq!(compared, 1_000);
    something_happens(
        &path,
        &[
            "i_Ladder.n",
            "i_Ladder.lamp",
            "i_Ladder.held",
            "i_Blocks.sum",
            "i_Blocks.shade",
            "i_Blocks.acts",
        ],
    );
}
