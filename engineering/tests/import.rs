//! Existing PLC projects in, ordinary projects out, and a small cell to begin with.

mod common;

use common::two_stations;
use fam_engineering::build::build_for;
use fam_engineering::convert::write_files;
use fam_engineering::generate::Target;
use fam_engineering::output::files_of;
use fam_engineering::plcopen::ordinary_project;
use fam_engineering::{build, import, new_cell};
use fam_proto::model::InputSource;
use fam_soft_plc::layout::Area;
use fam_soft_plc::source::SourceFile;
use std::path::Path;

const PROJECT: &str = "
VAR_GLOBAL
    Button AT %IX0.0 : BOOL;
    Level AT %IW1 : INT;
    Pump AT %QX0.0 : BOOL;
    Lamp AT %QX0.1 : BOOL;
    shared : INT;
    unused : LREAL;
END_VAR
VAR_GLOBAL CONSTANT
    LIMIT : INT := 100;
END_VAR
FUNCTION Above : BOOL
VAR_INPUT x : INT; END_VAR
    Above := x > 3;
END_FUNCTION
FUNCTION_BLOCK Filter
VAR_INPUT x : INT; END_VAR
VAR_OUTPUT y : INT; END_VAR
    y := (3 * y + x) / 4;
END_FUNCTION_BLOCK
FUNCTION_BLOCK Other
VAR_OUTPUT z : INT; END_VAR
    z := z + 1;
END_FUNCTION_BLOCK
PROGRAM Pumping
VAR_EXTERNAL Button, Pump : BOOL; Level : INT; shared : INT; END_VAR
VAR_EXTERNAL CONSTANT LIMIT : INT; END_VAR
VAR smooth : Filter; spare : ARRAY[0..1] OF Filter; END_VAR
    smooth(x := Level);
    Pump := Button AND smooth.y < LIMIT;
    shared := smooth.y;
END_PROGRAM
PROGRAM Lighting
VAR_EXTERNAL Lamp : BOOL; shared : INT; END_VAR
VAR count : Other; END_VAR
    count();
    Lamp := Above(shared);
END_PROGRAM
CONFIGURATION plant
    RESOURCE cpu ON PLC
        TASK fast(INTERVAL := T#20ms, PRIORITY := 1);
        TASK slow(INTERVAL := T#100ms, PRIORITY := 2);
        PROGRAM Pump1 WITH fast : Pumping;
        PROGRAM Light1 WITH slow : Lighting;
    END_RESOURCE
END_CONFIGURATION
";

#[test]
fn a_project_becomes_one_mc_for_each_program_instance() {
    let files = import::model(&[SourceFile::new("plant.st", PROJECT)], "plant.aml")
        .unwrap_or_else(|p| panic!("{p}"));
    let names: Vec<&str> = files.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "FAM.aml",
            "TODO.md",
            "logic/Light1.xml",
            "logic/Pump1.xml",
            "plant.aml"
        ]
    );
    // Each gets what it needs and no more.
    let pump = &files["logic/Pump1.xml"];
    for part in [
        "\"Pumping\"",
        "\"Filter\"",
        "\"LIMIT\"",
        "\"Button\"",
        "\"shared\"",
    ] {
        assert!(pump.contains(part), "{part} is missing");
    }
    for part in [
        "\"Lighting\"",
        "\"Other\"",
        "\"Above\"",
        "\"Lamp\"",
        "\"unused\"",
    ] {
        assert!(!pump.contains(part), "{part} is not needed");
    }
    let to_do = &files["TODO.md"];
    for part in [
        "Pump1 exports shared to Light1: what it writes is seen there a cycle later",
        "Pump1: look at the fail-safe value",
        "Light1: give it its critical intervals",
        "write a stop POU",
    ] {
        assert!(to_do.contains(part), "expected `{part}` in:\n{to_do}");
    }
    let dir = tempfile::tempdir().unwrap();
    write_files(&files, dir.path()).unwrap();
    let built = build(&dir.path().join("plant.aml")).unwrap_or_else(|p| panic!("{p}"));
    let cycles: Vec<(&str, u32)> = built
        .model
        .mcs
        .iter()
        .map(|m| (m.mc.as_str(), m.cycle_us))
        .collect();
    assert_eq!(cycles, [("Light1", 100_000), ("Pump1", 20_000)]);
    assert_eq!(built.model.mcs[1].inputs.len(), 2);
    assert_eq!(built.model.controllers.len(), 2);
}

/// One program twice: VAR_CONFIG gives each instance its own places and values.
const LINES: &str = "
FUNCTION_BLOCK Gain VAR k : INT := 2; x AT %I* : INT; y AT %Q* : INT; END_VAR y := x * k; END_FUNCTION_BLOCK
PROGRAM Line VAR_INPUT way : BOOL; END_VAR VAR first, second : Gain; n : INT := 5; END_VAR first(); second(); n := n + 1; END_PROGRAM
CONFIGURATION C
RESOURCE R ON PLC
    TASK T(INTERVAL := T#10ms, PRIORITY := 1);
    PROGRAM North WITH T : Line;
    PROGRAM South WITH T : Line (way := TRUE);
END_RESOURCE
VAR_CONFIG
    R.North.first.x AT %IW0 : INT; R.North.first.y AT %QW0 : INT;
    R.North.second.x AT %IW1 : INT; R.North.second.y AT %QW1 : INT;
    R.South.first.x AT %IW2 : INT; R.South.first.y AT %QW2 : INT;
    R.South.second.x AT %IW1 : INT; R.South.second.y AT %QW3 : INT;
    R.South.first.k : INT := 100;
    R.South.n : INT := 50;
END_VAR
END_CONFIGURATION
";

/// The first bytes of the outputs of an MC after a scan in which its inputs hold 1, 0, 1, 0, and so on.
fn outputs_after_a_scan(xml: &str, program: &str) -> Vec<u8> {
    use fam_soft_plc::standalone::{Options, prepare};
    use fam_soft_plc::{Engine, EngineOptions, Instance, Interruption};
    let options = Options {
        program: Some(program.to_owned()),
        ..Options::default()
    };
    let prepared = prepare(&[SourceFile::new("logic.xml", xml)], &options)
        .unwrap_or_else(|d| panic!("{d:?}\n{xml}"));
    let options = EngineOptions {
        interruption: Interruption::Fuel(1_000_000),
    };
    let engine = Engine::new(options).unwrap();
    let module = engine.prepare(&prepared.mc).unwrap();
    let mut instance = Instance::new(&engine, &module).unwrap();
    for (index, byte) in instance.inputs_mut().iter_mut().enumerate() {
        *byte = u8::from(index % 2 == 0);
    }
    instance.scan(0, 2).unwrap();
    instance.outputs()[..8].to_vec()
}

#[test]
fn instances_of_one_program_keep_their_places_and_values() {
    let files = import::model(&[SourceFile::new("lines.st", LINES)], "lines.aml")
        .unwrap_or_else(|p| panic!("{p}"));
    let expected = [
        ("North", [2, 0, 2, 0, 0, 0, 0, 0]),
        ("South", [0, 0, 0, 0, 100, 0, 2, 0]),
    ];
    for (mc, outputs) in expected {
        let logic = &files[&format!("logic/{mc}.xml")];
        assert_eq!(outputs_after_a_scan(logic, mc), outputs, "{mc}");
    }
    let to_do = &files["TODO.md"];
    assert!(to_do.contains("connects `way := TRUE`"), "{to_do}");
    let dir = tempfile::tempdir().unwrap();
    write_files(&files, dir.path()).unwrap();
    let built = build(&dir.path().join("lines.aml")).unwrap_or_else(|p| panic!("{p}"));
    // What has one place in the project is one point.
    let model = &files["lines.aml"];
    for point in [
        "North_first__x",
        "South_first__x",
        "second__x",
        "South_second__y",
    ] {
        assert!(
            model.contains(&format!("image:{point}<")),
            "{point} in {model}"
        );
    }
    // Written for a controller, and read back.
    let controller = &built.model.controllers[0].controller;
    let project = fam_engineering::plcopen::project_xml(&built, controller);
    for (mc, outputs) in expected {
        let source = fam_engineering::plcopen::mc_source(&project, mc).unwrap();
        assert_eq!(outputs_after_a_scan(&source.text, mc), outputs, "{mc}");
    }
    // And as one ordinary project, whose images lie one behind the other.
    let text = ordinary_project(&built);
    compiles(&text);
    let back = import::model(&[SourceFile::new("all.xml", text.as_str())], "all.aml")
        .unwrap_or_else(|p| panic!("{p}"));
    assert!(back["logic/South.xml"].contains("value=\"100\""));
}

#[test]
fn projects_that_cannot_be_imported_say_why() {
    for (text, part) in [
        (
            "FUNCTION_BLOCK A\nVAR x : INT; END_VAR\nx := 1;\nEND_FUNCTION_BLOCK",
            "the project has no PROGRAM",
        ),
        ("PROGRAM P\nx := 1;\nEND_PROGRAM", "x"),
        (
            "<project xmlns=\"http://www.plcopen.org/xml/tc6.xsd\"/>",
            "PLCopen XML 1.0",
        ),
        ("<x/>", "no PLCopen project"),
    ] {
        let problems = import::model(&[SourceFile::new("p", text)], "p.aml")
            .unwrap_err()
            .to_string();
        assert!(problems.contains(part), "expected `{part}` in:\n{problems}");
    }
}

/// Global variables of an exported project: name and address.
fn globals(text: &str) -> Vec<(String, String)> {
    let document = roxmltree::Document::parse(text).unwrap();
    let all = document.descendants();
    all.filter(|n| n.has_tag_name("globalVars") || n.tag_name().name() == "globalVars")
        .flat_map(|n| n.children().filter(|c| c.tag_name().name() == "variable"))
        .map(|v| {
            let of = |name| v.attribute(name).unwrap_or_default().to_owned();
            (of("name"), of("address"))
        })
        .collect()
}

/// A project has no errors.
fn compiles(text: &str) {
    let files = [SourceFile::new("all.xml", text)];
    let mut found = fam_soft_plc::diagnose(&files, fam_soft_plc::CheckOptions::default());
    found.retain(|d| d.severity == fam_soft_plc::Severity::Error);
    assert!(found.is_empty(), "{found:?} in\n{text}");
}

#[test]
fn in_one_plc_each_name_and_each_place_means_one_thing() {
    let logic = |inner: &str, constant: u32, vars: &str, body: &str| {
        format!(
            "FUNCTION_BLOCK F\nVAR_INPUT go : BOOL; END_VAR\nVAR_OUTPUT q : BOOL; END_VAR\n q := {inner};\nEND_FUNCTION_BLOCK\n\
             VAR_GLOBAL CONSTANT LIMIT : INT := 7; K : INT := {constant}; END_VAR\n\
             VAR_GLOBAL {vars} END_VAR\n{body}\nEND_PROGRAM\n"
        )
    };
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: String| std::fs::write(dir.path().join(name), text).unwrap();
    write(
        "a.st",
        logic(
            "go",
            1,
            "go AT %IX0.0 : BOOL; (* whoever presses *)\nout AT %QX0.0 : BOOL; done AT %QX0.1 : BOOL; kept : INT;",
            "PROGRAM A\nVAR f : F; END_VAR\n f(go := go);\n out := f.q; done := kept > LIMIT; kept := kept + K;",
        ),
    );
    write(
        "b.st",
        logic(
            "NOT go",
            2,
            "ready AT %IX1.0 : BOOL; go AT %IX0.0 : BOOL; out AT %QW3 : INT; kept : INT;",
            "PROGRAM B\nVAR_EXTERNAL go, ready : BOOL; END_VAR\nVAR f : F; k2 : BOOL; END_VAR\n f(go := go, q => k2);\n\
             IF ready AND k2 OR %IX1.0 THEN kept := kept + K; END_IF; out := MIN(kept, LIMIT);",
        ),
    );
    write(
        "cell.toml",
        "format = 1\n[cell]\nname = \"c\"\ntick_ms = 5\n[[gateway]]\nname = \"g\"\ndriver = \"image\"\n[[controller]]\nname = \"k\"\n\
         [[mc]]\nname = \"B\"\nlogic = [\"b.st\"]\ngateway = \"g\"\nhosts = \"all\"\nworst_case_us = 50\n\
         [mc.inputs]\ngo = \"image:b_go\"\nready = \"mc:A.done\"\n\
         [mc.outputs]\nout = { field = \"image:b_out\", fail_safe = 0 }\n\
         [[mc]]\nname = \"A\"\nlogic = [\"a.st\"]\ngateway = \"g\"\nhosts = \"all\"\nworst_case_us = 50\n\
         [mc.inputs]\ngo = \"image:a_go\"\n\
         [mc.outputs]\nout = { field = \"image:a_out\", fail_safe = false }\ndone = { export = true, fail_safe = false }\n"
            .to_owned(),
    );
    let built = build(&dir.path().join("cell.toml")).unwrap_or_else(|p| panic!("{p}"));
    let text = ordinary_project(&built);
    compiles(&text);
    let expected = [
        ("LIMIT", ""),
        ("K", ""),
        ("go", "%IX0.0"),
        ("out", "%QX0.0"),
        ("done", ""),
        ("kept", ""),
        ("B_K", ""),
        ("B_go", "%IX8.0"),
        ("B_out", "%QW7"),
        ("B_kept", ""),
    ];
    let expected = expected.map(|(name, at)| (name.to_owned(), at.to_owned()));
    assert_eq!(globals(&text), expected, "{text}");
    for part in [
        "f(go := go);",
        "out := f.q; done := kept > LIMIT; kept := kept + K;",
        "f(go := B_go, q => k2);",
        "IF done AND k2 OR %IX9.0 THEN B_kept := B_kept + B_K; END_IF; B_out := MIN(B_kept, LIMIT);",
        "<derived name=\"B_F\"/>",
        "whoever presses",
    ] {
        assert!(text.contains(part), "expected `{part}` in:\n{text}");
    }
}

#[test]
fn what_is_drawn_takes_its_names_and_places_along() {
    let element = |kind: &str, id: u32, from: u32, variable: &str| {
        format!(
            "<{kind} localId=\"{id}\" negated=\"false\"><position x=\"0\" y=\"0\"/><connectionPointIn><connection refLocalId=\"{from}\"/></connectionPointIn>\
             <connectionPointOut/><variable>{variable}</variable></{kind}>"
        )
    };
    let variable = |name: &str, place: &str| {
        format!("<variable name=\"{name}\"{place}><type><BOOL/></type></variable>")
    };
    let ladder = format!(
        "<project xmlns=\"http://www.plcopen.org/xml/tc6_0201\"><fileHeader companyName=\"c\" productName=\"p\" productVersion=\"1\" creationDateTime=\"2020-01-01T00:00:00\"/>\
         <contentHeader name=\"l\"><coordinateInfo><fbd><scaling x=\"1\" y=\"1\"/></fbd><ld><scaling x=\"1\" y=\"1\"/></ld><sfc><scaling x=\"1\" y=\"1\"/></sfc></coordinateInfo></contentHeader>\
         <types><dataTypes/><pous><pou name=\"Ladder\" pouType=\"program\"><interface><externalVars>{}{}</externalVars></interface><body><LD>\
         <leftPowerRail localId=\"1\"><position x=\"0\" y=\"0\"/><connectionPointOut formalParameter=\"\"/></leftPowerRail>{}{}{}</LD></body></pou></pous></types>\
         <instances><configurations><configuration name=\"c\"><resource name=\"r\"/><globalVars>{}{}{}</globalVars></configuration></configurations></instances></project>",
        variable("go", ""),
        variable("out", ""),
        element("contact", 2, 1, "go"),
        element("contact", 3, 2, "%IX0.1"),
        element("coil", 4, 3, "out"),
        variable("go", " address=\"%IX0.0\""),
        variable("spare", " address=\"%IX0.1\""),
        variable("out", " address=\"%QX0.0\""),
    );
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("ladder.xml"), ladder).unwrap();
    let mc = |name: &str| {
        format!(
            "[[mc]]\nname = \"{name}\"\nprogram = \"Ladder\"\nlogic = [\"ladder.xml\"]\ngateway = \"g\"\nhosts = \"all\"\nworst_case_us = 50\n\
             [mc.inputs]\ngo = \"image:{name}_go\"\nspare = \"image:{name}_spare\"\n\
             [mc.outputs]\nout = {{ field = \"image:{name}_out\", fail_safe = false }}\n"
        )
    };
    let cell = format!(
        "format = 1\n[cell]\nname = \"c\"\n[[gateway]]\nname = \"g\"\ndriver = \"image\"\n[[controller]]\nname = \"k\"\n{}{}",
        mc("A"),
        mc("B")
    );
    std::fs::write(dir.path().join("cell.toml"), cell).unwrap();
    let built = build(&dir.path().join("cell.toml")).unwrap_or_else(|p| panic!("{p}"));
    let text = ordinary_project(&built);
    compiles(&text);
    let (first, second) = text.split_once("name=\"B_Ladder\"").unwrap();
    for (part, said) in [
        (
            first,
            ["<variable>go<", "<variable>%IX0.1<", "<variable>out<"],
        ),
        (
            second,
            ["<variable>B_go<", "<variable>%IX8.1<", "<variable>B_out<"],
        ),
    ] {
        for words in said {
            assert!(part.contains(words), "expected `{words}` in:\n{text}");
        }
    }
}

/// Which MC reads what of which, as far as it is of an elementary type.
fn exchanges(built: &fam_engineering::BuiltCell) -> Vec<(String, String)> {
    let mut list = Vec::new();
    for mc in &built.model.mcs {
        for input in &mc.inputs {
            if let InputSource::Export { mc: from, place } = &input.source {
                let outputs = &built.model.mc(from).unwrap().outputs;
                let output = outputs.iter().find(|o| o.place == *place).unwrap();
                list.push((mc.mc.to_string(), format!("{from}.{}", output.name)));
            }
        }
    }
    list.sort();
    list
}

#[test]
fn models_become_projects_of_one_plc_and_come_back() {
    for model in [
        "engineering/tests/cells/two_stations/cell.toml",
        "engineering/tests/cells/types/cell.toml",
        "deploy/marking-machine/cell.toml",
        "deploy/fms200/fms200.aml",
    ] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(model);
        let built = build(&path).unwrap_or_else(|p| panic!("{model}: {p}"));
        let text = ordinary_project(&built);
        compiles(&text);
        let back = import::model(&[SourceFile::new("all.xml", text.as_str())], "all.aml");
        let dir = tempfile::tempdir().unwrap();
        write_files(&back.unwrap_or_else(|p| panic!("{model}: {p}")), dir.path()).unwrap();
        let back = build(&dir.path().join("all.aml")).unwrap_or_else(|p| panic!("{model}: {p}"));
        assert_eq!(exchanges(&back), exchanges(&built), "{model}");
        let mut places: Vec<_> = globals(&text).into_iter().map(|(_, at)| at).collect();
        places.retain(|at| !at.is_empty());
        let all = places.len();
        places.sort();
        places.dedup();
        assert!(all > 0 && places.len() == all, "{model}: {places:?}");
    }
}

#[test]
fn an_exported_project_is_the_logic_and_comes_back() {
    let text = ordinary_project(&build(&two_stations()).unwrap());
    assert!(
        !text.contains("_Serialize") && !text.contains("_Control"),
        "{text}"
    );
    for part in [
        "<task name=\"Feeder_Task\"",
        "<task name=\"Press_Task\"",
        "interval=\"T#5ms\"",
        "typeName=\"Press\"",
    ] {
        assert!(text.contains(part), "expected `{part}` in:\n{text}");
    }
    // One MC is a project for one PLC.
    let logic = "VAR_GLOBAL\n go AT %IX0.0 : BOOL;\n out AT %QX0.0 : BOOL;\nEND_VAR\nPROGRAM M\nVAR_EXTERNAL go, out : BOOL; END_VAR\n out := go;\nEND_PROGRAM\n";
    let io = "[mc.inputs]\ngo = \"image:go\"\n[mc.outputs]\nout = { field = \"image:out\", fail_safe = false }\n";
    let (_dir, path) = common::one_mc(logic, io);
    let text = ordinary_project(&build(&path).unwrap_or_else(|p| panic!("{p}")));
    let files = import::model(&[SourceFile::new("cell.xml", text)], "cell.aml")
        .unwrap_or_else(|p| panic!("{p}"));
    let dir = tempfile::tempdir().unwrap();
    write_files(&files, dir.path()).unwrap();
    let built = build(&dir.path().join("cell.aml")).unwrap_or_else(|p| panic!("{p}"));
    let mc = &built.model.mcs[0];
    assert_eq!((mc.mc.as_str(), mc.cycle_us), ("M", 5_000));
    assert_eq!((mc.inputs.len(), mc.outputs.len()), (1, 1));
}

#[test]
fn the_cell_to_begin_with_is_in_order() {
    let dir = tempfile::tempdir().unwrap();
    write_files(&new_cell::files(), dir.path()).unwrap();
    let built = build(&dir.path().join("cell.toml")).unwrap_or_else(|p| panic!("{p}"));
    assert!(built.warnings.is_empty(), "{:?}", built.warnings);
    assert_eq!((built.mcs.len(), built.model.controllers.len()), (2, 2));
    assert_eq!(built.mcs[0].diagnosis.intervals.len(), 1);
    let deployment =
        fam_engineering::DeploymentFile::read(&dir.path().join("deployment.toml")).unwrap();
    deployment
        .resolve(&built.model)
        .unwrap_or_else(|p| panic!("{p}"));
    assert!(files_of(&built, Target::Fam).contains_key("summary.txt"));
}

#[test]
fn a_narrowed_state_leaves_out_what_is_not_listed_and_says_so() {
    let logic = "VAR_GLOBAL\n go AT %IX0.0 : BOOL;\n out AT %QX0.0 : BOOL;\n total : DINT;\nEND_VAR\nPROGRAM M\nVAR_EXTERNAL go, out : BOOL; total : DINT; END_VAR\nVAR step : INT; scratch : ARRAY[0..9] OF INT := [10(7)]; t : TON; END_VAR\n step := step + 1; scratch[3] := step; total := total + 1; t(IN := go, PT := T#1s); out := go;\nEND_PROGRAM\n";
    let io = "[mc.inputs]\ngo = \"image:go\"\n[mc.outputs]\nout = { field = \"image:out\", fail_safe = false }\n";
    let (_dir, path) = common::one_mc(
        logic,
        &format!("state = [\"step\", \"t\", \"total\"]\n{io}"),
    );
    for target in [Target::Fam, Target::Portable] {
        let built =
            fam_engineering::build::build_for(&path, target).unwrap_or_else(|p| panic!("{p}"));
        let warning = built
            .warnings
            .iter()
            .find(|w| w.code == "W808")
            .unwrap()
            .to_string();
        assert!(
            warning.contains("1 of its variables are no state: M.scratch"),
            "{warning}"
        );
        let mc = &built.mcs[0];
        assert!(mc.state_variables.iter().all(|v| v.path != "M.scratch"));
        assert!(mc.state_variables.iter().any(|v| v.path == "M.t.ET"));
        assert!(mc.control_st.contains(" := 7;"), "{}", mc.control_st);
    }
    for (extra, part) in [
        (
            format!("state = [\"stap\"]\n{io}"),
            "its state lists `stap`, which it does not have",
        ),
        (
            format!(
                "state = [\"step\"]\n{io}[[mc.critical_interval]]\nname = \"A\"\ncondition = \"total > 3\"\nkind = \"unrecoverable\"\nrecovery = \"B\"\n"
            ),
            "`total` is not part of the state",
        ),
    ] {
        let (_dir, path) = common::one_mc(logic, &extra);
        let problems = build(&path).unwrap_err().to_string();
        assert!(problems.contains(part), "expected `{part}` in:\n{problems}");
    }
}

/// A ladder that closes a valve, and a chart that counts its rounds, in one project.
const DIAGRAMS: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<project xmlns="http://www.plcopen.org/xml/tc6_0201" xmlns:xhtml="http://www.w3.org/1999/xhtml">
<fileHeader companyName="c" productName="p" productVersion="1" creationDateTime="2020-01-01T00:00:00"/>
<contentHeader name="n"><coordinateInfo><fbd><scaling x="1" y="1"/></fbd><ld><scaling x="1" y="1"/></ld><sfc><scaling x="1" y="1"/></sfc></coordinateInfo></contentHeader>
<types><dataTypes/><pous>
<pou name="Ladder" pouType="program"><interface><externalVars><variable name="Full"><type><BOOL/></type></variable><variable name="Valve"><type><BOOL/></type></variable></externalVars></interface>
<body><LD><leftPowerRail localId="1"><position x="0" y="0"/><connectionPointOut formalParameter=""/></leftPowerRail>
<contact localId="2" negated="true"><position x="1" y="0"/><connectionPointIn><connection refLocalId="1"/></connectionPointIn><connectionPointOut/><variable>Full</variable></contact>
<coil localId="3"><position x="2" y="0"/><connectionPointIn><connection refLocalId="2"/></connectionPointIn><connectionPointOut/><variable>Valve</variable></coil></LD></body></pou>
<pou name="Rounds" pouType="program"><interface><localVars><variable name="n"><type><INT/></type></variable></localVars><externalVars><variable name="Go"><type><BOOL/></type></variable><variable name="Lamp"><type><BOOL/></type></variable></externalVars></interface>
<body><SFC><step localId="1" name="Waits" initialStep="true"><position x="0" y="0"/><connectionPointIn><connection refLocalId="4"/></connectionPointIn><connectionPointOut formalParameter="sfc"/></step>
<transition localId="2"><position x="0" y="0"/><connectionPointIn><connection refLocalId="1"/></connectionPointIn><condition><inline name=""><ST><xhtml:p>Go</xhtml:p></ST></inline></condition></transition>
<step localId="3" name="Goes"><position x="0" y="0"/><connectionPointIn><connection refLocalId="2"/></connectionPointIn><connectionPointOut formalParameter="sfc"/><connectionPointOutAction formalParameter=""/></step>
<actionBlock localId="5"><position x="0" y="0"/><connectionPointIn><connection refLocalId="3"/></connectionPointIn><action qualifier="N"><relPosition x="0" y="0"/><inline><ST><xhtml:p>Lamp := TRUE; n := n + 1;</xhtml:p></ST></inline></action></actionBlock>
<transition localId="4"><position x="0" y="0"/><connectionPointIn><connection refLocalId="3"/></connectionPointIn><condition><inline name=""><ST><xhtml:p>NOT Go</xhtml:p></ST></inline></condition></transition></SFC></body></pou>
</pous></types>
<instances><configurations><configuration name="c"><resource name="r"><task name="t" interval="PT0.02S" priority="1"><pouInstance name="Ladder1" typeName="Ladder"/><pouInstance name="Rounds1" typeName="Rounds"/></task>
<globalVars><variable name="Full" address="%IX0.0"><type><BOOL/></type></variable><variable name="Go" address="%IX0.1"><type><BOOL/></type></variable><variable name="Valve" address="%QX0.0"><type><BOOL/></type></variable><variable name="Lamp" address="%QX0.1"><type><BOOL/></type></variable></globalVars></resource></configuration></configurations></instances>
</project>"#;

#[test]
fn ladders_and_charts_go_from_import_to_projects_as_they_were_drawn() {
    let sources = [SourceFile::new("plant.xml", DIAGRAMS)];
    let files = import::model(&sources, "plant.aml").unwrap_or_else(|p| panic!("{p}"));
    let dir = tempfile::tempdir().unwrap();
    write_files(&files, dir.path()).unwrap_or_else(|p| panic!("{p}"));
    let (generated, built) =
        fam_engineering::output::generate(&dir.path().join("plant.aml"), Target::Fam)
            .unwrap_or_else(|p| panic!("{p}"));
    let project = &generated["controller1.xml"];
    for part in [
        "<LD>",
        "<contact ",
        "<SFC>",
        "name=\"Goes\"",
        "<actionBlock ",
    ] {
        assert!(project.contains(part), "{part}");
    }
    common::read_back(&built);
    // The chart's steps are state, and travel with it.
    let rounds = built
        .mcs
        .iter()
        .find(|m| m.mc.as_str() == "Rounds1")
        .unwrap();
    assert!(
        rounds
            .state_variables
            .iter()
            .any(|v| v.path.eq_ignore_ascii_case("Rounds.Goes.X"))
    );
}

/// Markers are part of the state: what lies at %M survives its controller like every other variable.
#[test]
fn what_lies_in_marker_memory_is_part_of_the_state() {
    let text = "
VAR_GLOBAL shared AT %MW20 : INT; END_VAR
PROGRAM P
VAR_EXTERNAL shared : INT; END_VAR
VAR
    go AT %IX0.0 : BOOL; level AT %MW2 : INT; ready AT %MX0.3 : BOOL;
    recipe AT %MB30 : STRING[6]; name AT %IB8 : STRING[3]; n : INT;
END_VAR
level := level + 1; shared := level; ready := go; n := shared + BYTE_TO_INT(%MB60); recipe := name;
END_PROGRAM
CONFIGURATION C RESOURCE R ON PLC
    TASK t(INTERVAL := T#10ms, PRIORITY := 1);
    PROGRAM One WITH t : P;
END_RESOURCE END_CONFIGURATION";
    let files = import::model(&[SourceFile::new("plant.st", text)], "plant.aml")
        .unwrap_or_else(|p| panic!("{p}"));
    let dir = tempfile::tempdir().unwrap();
    write_files(&files, dir.path()).unwrap();
    let model = dir.path().join("plant.aml");
    let built = build(&model).unwrap_or_else(|p| panic!("{p}"));
    let layout = &built.mcs[0].compiled.layout;
    let state = layout.region_index("state").map(Area::Region);
    for variable in ["P.level", "P.ready", "P.recipe", "P.n", "shared"] {
        let found = layout.find(variable).map(|v| v.area);
        assert_eq!(found, state, "{variable}");
    }
    // The image of inputs is read anew wherever the MC runs.
    let points: Vec<&String> = built.model.mcs[0].inputs.iter().map(|i| &i.name).collect();
    assert_eq!(points.len(), 5, "{points:?}");
    let refused = build_for(&model, Target::Portable)
        .map(|_| ())
        .unwrap_err()
        .to_string();
    assert!(refused.contains("it lies at %M"), "{refused}");
}
