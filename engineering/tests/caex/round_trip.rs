//! Random cells: in each form the same, and what is generated is read back as the same model.

use super::{assert_same, caex, common, converted};
use fam_engineering::build;
use fam_engineering::convert::{Form, write_files};
use fam_engineering::generate::Target;
use fam_engineering::output;
use fam_engineering::plcopen::diagnosis_file;
use fam_reference::random::Random;
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Types of state variables, with an initial value, and a value of a checkpoint state as `cell.toml` has it.
const TYPES: [(&str, &str, &str); 16] = [
    ("BOOL", "TRUE", "false"),
    ("SINT", "-5", "-128"),
    ("UINT", "7", "65535"),
    ("DINT", "-70000", "12"),
    ("LINT", "LINT#-9000000000", "-9000000000"),
    ("WORD", "16#BEEF", "4660"),
    ("LWORD", "16#F0F0_F0F0_F0F0", "1"),
    ("REAL", "1.5", "-0.25"),
    ("LREAL", "-1.0E-300", "1.0e10"),
    ("TIME", "T#1s500ms", "\"T#-3ms\""),
    ("DATE", "D#2024-02-29", "\"D#1999-12-31\""),
    ("STRING[12]", "'a$'b<&>'", ""),
    ("ARRAY[-1..1, 2..3] OF INT", "[3(1), 2]", ""),
    ("Mode", "Mode#Run", "\"Run\""),
    ("INT (-10..10)", "4", "-10"),
    ("TON", "", ""),
];

/// Names as people give them: with what XML and TOML have to write otherwise.
const WORDS: [&str; 5] = [
    "plain",
    "with <angle> & \"quotes\"",
    "Größe 5 µm – 'links'",
    "back\\slash # hash",
    "]]> --> {x}",
];

struct Cell<'r> {
    random: &'r mut Random,
    files: BTreeMap<String, String>,
}

impl Cell<'_> {
    fn write(mut self, dir: &Path) -> PathBuf {
        let controllers = self.random.within(1, 4) as usize;
        let mcs = self.random.within(1, 5) as usize;
        let link = *self.random.one(&["", "link_mbit_s = 100.5\n"]);
        let mut text = format!(
            "format = 1\n[cell]\nname = \"c-1\"\ntick_ms = {}\n{link}",
            self.random.one(&["5", "2.5", "10"])
        );
        if self.random.chance(50) {
            text.push_str("[settings]\nreport_ms = 120\nbids_ms = 12.5\ngain_percent = 3\n");
        }
        let gateways = self.random.within(1, 2) as usize;
        for g in 0..gateways {
            let driver = match g {
                0 => "driver = \"image\"",
                _ => "driver = \"modbus\"\naddress = \"10.0.0.7:502\"",
            };
            let _ = writeln!(text, "[[gateway]]\nname = \"g{g}\"\n{driver}");
        }
        for c in 0..controllers {
            let _ = writeln!(text, "[[controller]]\nname = \"c{c}\"");
            if self.random.chance(60) {
                let word = toml::Value::String((*self.random.one(&WORDS)).to_owned());
                let _ = writeln!(text, "description = {word}\ncpu_factor = 0.5");
            }
            if self.random.chance(50) {
                let _ = writeln!(text, "memory_mb = 300.5\nlimit_percent = 33.3");
            }
        }
        // An MC reads only from MCs before it, of its own gateway.
        let mut exports: Vec<(usize, String)> = Vec::new();
        for m in 0..mcs {
            let gateway = self.random.below(gateways);
            text += &self.mc(m, controllers, gateway, &mut exports);
        }
        self.files.insert("cell.toml".to_owned(), text);
        write_files(&self.files, dir).unwrap();
        dir.join("cell.toml")
    }

    fn mc(
        &mut self,
        m: usize,
        controllers: usize,
        gateway: usize,
        exports: &mut Vec<(usize, String)>,
    ) -> String {
        let hosts: Vec<String> = (0..controllers)
            .filter(|_| self.random.chance(60))
            .map(|c| format!("\"c{c}\""))
            .collect();
        let hosts = match hosts.is_empty() {
            true => "\"all\"".to_owned(),
            false => format!("[{}]", hosts.join(", ")),
        };
        // Often several MCs have programs of one name.
        let program = match self.random.below(4) {
            0 => String::new(),
            1 => format!("Main{m}"),
            _ => "Main".to_owned(),
        };
        let mut text = format!(
            "[[mc]]\nname = \"Mc{m}\"\nlogic = [\"common.st\", \"logic/mc {m}.st\"]\ngateway = \"g{gateway}\"\nhosts = {hosts}\nworst_case_us = {}\n",
            self.random.within(1, 90)
        );
        if !program.is_empty() {
            let _ = writeln!(text, "program = \"{program}\"");
        }
        for line in [
            "criticality = 3",
            "cycle_ms = 10",
            "watchdog_ms = 800",
            "suspect_ms = 60.5",
            "stop = \"Halt\"",
        ] {
            if self.random.chance(50) {
                let _ = writeln!(text, "{line}");
            }
        }
        let name = match program.is_empty() {
            true => format!("Mc{m}"),
            false => program,
        };
        let mut variables = Vec::new();
        for v in 0..self.random.within(0, 9) {
            variables.push((format!("v{v}"), *self.random.one(&TYPES)));
        }
        let point = |kind: &str, n: usize| match gateway {
            0 => format!("image:p{m}_{kind}{n}"),
            _ => {
                let table = match kind {
                    "in" => "discrete",
                    _ => "coil",
                };
                format!("modbus:{}/{table}/{}", 1 + m, n)
            }
        };
        let (mut inputs, mut outputs) = (String::new(), String::new());
        let (mut located, mut external, mut body) = (String::new(), String::new(), String::new());
        for n in 0..self.random.within(0, 3) as usize {
            let usable: Vec<&(usize, String)> =
                exports.iter().filter(|(g, _)| *g == gateway).collect();
            let source = match self.random.chance(40) && !usable.is_empty() {
                true => format!("mc:{}", self.random.one(&usable).1),
                false => point("in", n),
            };
            let _ = writeln!(inputs, "In{n} = \"{source}\"");
            let _ = writeln!(located, "In{n} AT %IX0.{n} : BOOL;");
            let _ = writeln!(external, "In{n} : BOOL;");
            let _ = writeln!(body, " IF In{n} THEN step := step + 1; END_IF;");
        }
        for n in 0..self.random.within(0, 3) as usize {
            let exported = self.random.chance(50);
            let field = match !exported || self.random.chance(50) {
                true => format!("field = \"{}\", ", point("out", n)),
                false => String::new(),
            };
            let export = if exported { "export = true, " } else { "" };
            let _ = writeln!(
                outputs,
                "Out{n} = {{ {field}{export}fail_safe = {} }}",
                self.random.chance(50)
            );
            if exported {
                exports.push((gateway, format!("Mc{m}.Out{n}")));
            }
            let _ = writeln!(located, "Out{n} AT %QX0.{n} : BOOL;");
            let _ = writeln!(external, "Out{n} : BOOL;");
            let _ = writeln!(body, " Out{n} := step MOD {} = 0;", n + 2);
        }
        let mut declared =
            String::from("step : INT; busy : BOOL; Own : OwnBlock; look : Look := Look#There;\n");
        for (name, (ty, init, _)) in &variables {
            let init = match init.is_empty() {
                true => String::new(),
                false => format!(" := {init}"),
            };
            let _ = writeln!(declared, "{name} : {ty}{init};");
        }
        if self.random.chance(20) {
            text.push_str("state = [\"step\", \"busy\"");
            for (name, _) in &variables {
                let _ = write!(text, ", \"{name}\"");
            }
            text.push_str("]\n");
        }
        let _ = write!(text, "[mc.inputs]\n{inputs}[mc.outputs]\n{outputs}");
        for i in 0..self.random.within(0, 3) {
            text += &self.interval(i, &variables);
        }
        let logic = format!(
            "VAR_GLOBAL\n{located}END_VAR\nPROGRAM {name}\nVAR_EXTERNAL\n{external}END_VAR\nVAR\n{declared}END_VAR\n{body} Own(n := step); look := Own.look; busy := NOT busy; (* <&> *)\nEND_PROGRAM\n\
             FUNCTION_BLOCK OwnBlock\nVAR_INPUT n : INT; END_VAR\nVAR_OUTPUT look : Look; END_VAR\n look := SEL(n MOD {} = 0, Look#Here, There);\nEND_FUNCTION_BLOCK\n\
             TYPE Look : (Here, There{}); END_TYPE\n",
            m % 2 + 2,
            ["", ", Gone"][m / 2 % 2]
        );
        let logic = logic.replace("VAR_GLOBAL\nEND_VAR\n", "");
        let logic = logic.replace("VAR_EXTERNAL\nEND_VAR\n", "");
        self.files.insert(format!("logic/mc {m}.st"), logic);
        text
    }

    /// Intervals of an MC exclude each other by `step`.
    fn interval(&mut self, i: i64, variables: &[(String, (&str, &str, &str))]) -> String {
        let (low, high) = (100 * i + 10, 100 * i + 20);
        let condition = *self.random.one(&[
            "step >= LOW AND step < HIGH",
            "NOT (step < LOW OR step > HIGH) AND busy",
            "(step = LOW OR step = HIGH) AND NOT busy",
        ]);
        let condition = condition
            .replace("LOW", &low.to_string())
            .replace("HIGH", &high.to_string());
        let is_checkpoint = self.random.chance(60);
        let (kind, pou) = match is_checkpoint {
            true => ("checkpoint", "Back"),
            false => ("unrecoverable", "Halt"),
        };
        let mut text = format!(
            "[[mc.critical_interval]]\nname = \"I{i}\"\ncondition = \"{condition}\"\nkind = \"{kind}\"\nrecovery = \"{pou}\"\nrepeatable = {}\n",
            self.random.chance(50)
        );
        if is_checkpoint && self.random.chance(80) {
            let _ = writeln!(text, "[mc.critical_interval.checkpoint_state]\nstep = {i}");
            for (name, (_, _, value)) in variables {
                if !value.is_empty() && self.random.chance(50) {
                    let _ = writeln!(text, "{name} = {value}");
                }
            }
        }
        text
    }
}

const COMMON: &str = "TYPE Mode : (Idle, Run := 7, Failed); END_TYPE\n\
    FUNCTION_BLOCK Back\nVAR_OUTPUT end : BOOL; END_VAR\n end := TRUE;\nEND_FUNCTION_BLOCK\n\
    FUNCTION_BLOCK Halt\nVAR_OUTPUT end : BOOL; END_VAR\nVAR t : TON; END_VAR\n t(IN := TRUE, PT := T#20ms); end := t.Q;\nEND_FUNCTION_BLOCK\n";

fn holds(seed: u64) {
    let dir = tempfile::tempdir().unwrap();
    let cell = Cell {
        random: &mut Random::new(seed),
        files: BTreeMap::from([("common.st".to_owned(), COMMON.to_owned())]),
    };
    let path = cell.write(&dir.path().join("cell"));
    let text = || std::fs::read_to_string(&path).unwrap();
    let original = build(&path).unwrap_or_else(|p| panic!("seed {seed}: {p}\n{}", text()));
    // In each form the same.
    let (aml, as_caex) = converted(&path, "cell.aml", &caex(), &dir.path().join("caex"));
    assert_same(&original, &as_caex);
    let (_, as_toml) = converted(&aml, "cell.toml", &Form::Toml, &dir.path().join("toml"));
    assert_same(&original, &as_toml);
    // The projects hold each MC whole, and the generated model is the model.
    common::read_back(&original);
    let (files, built) =
        output::generate(&aml, Target::Fam).unwrap_or_else(|p| panic!("seed {seed}: {p}"));
    for mc in &built.mcs {
        let file = &files[&format!("{}.diagnosis.xml", mc.mc)];
        assert_eq!(diagnosis_file::read(file).unwrap(), mc.diagnosis);
    }
    let generated = dir.path().join("generated");
    write_files(&files, &generated).unwrap();
    let again =
        build(&generated.join(output::MODEL)).unwrap_or_else(|p| panic!("seed {seed}: {p}"));
    assert_same(&original, &again);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(12) })]

    #[test]
    fn random_cells_are_the_same_in_each_form_and_read_back(seed in any::<u32>()) {
        holds(u64::from(seed));
    }
}
