//! Shared by the tests: from program text to a running instance.
#![allow(dead_code)]

use fam_soft_plc::{
    CheckOptions, CompileSpec, CompiledMc, Engine, EngineOptions, Instance, Interruption,
    SourceFile, Trap, TypedProject, Value, check, compile, parse_project,
};

/// Scans of the tests stop after this many Wasm instructions.
pub const FUEL: u64 = 50_000_000;

pub fn typed(text: &str) -> TypedProject {
    typed_with(text, CheckOptions::default())
}

pub fn typed_with(text: &str, options: CheckOptions) -> TypedProject {
    let (project, diagnostics) = parse_project(&[SourceFile::new("test.st", text)]);
    assert!(diagnostics.is_empty(), "{}", show(&diagnostics));
    check(&project, options).unwrap_or_else(|d| panic!("{}", show(&d)))
}

pub fn show(diagnostics: &[fam_soft_plc::Diagnostic]) -> String {
    diagnostics.iter().map(ToString::to_string).collect()
}

pub fn spec(entry: &str) -> CompileSpec {
    CompileSpec {
        entry: entry.to_owned(),
        ..CompileSpec::default()
    }
}

pub fn compiled(text: &str, spec: &CompileSpec) -> CompiledMc {
    compile(&typed(text), spec).unwrap_or_else(|d| panic!("{}", show(&d)))
}

pub struct Machine {
    pub engine: Engine,
    pub instance: Instance,
    pub time_ns: i64,
}

/// 10 ms
pub const CYCLE_NS: i64 = 10_000_000;

impl Machine {
    /// Runs PROGRAM P of the text.
    pub fn new(text: &str) -> Self {
        Self::of(&compiled(text, &spec("P")))
    }

    pub fn of(mc: &CompiledMc) -> Self {
        let engine = Engine::new(EngineOptions {
            interruption: Interruption::Fuel(FUEL),
        })
        .expect("engine");
        let module = engine.prepare(mc).unwrap_or_else(|e| panic!("{e}"));
        let instance = Instance::new(&engine, &module).expect("instance");
        Self {
            engine,
            instance,
            time_ns: 0,
        }
    }

    pub fn try_scan(&mut self) -> Result<(), Trap> {
        let result = self.instance.scan(self.time_ns, 2);
        self.time_ns += CYCLE_NS;
        result
    }

    pub fn scan(&mut self) {
        self.try_scan().unwrap_or_else(|t| panic!("{t}"));
    }

    /// The value of a variable of P, or of any path with a dot in front of which P does not stand.
    pub fn get(&self, name: &str) -> Value {
        self.instance
            .read(&format!("P.{name}"))
            .or_else(|| self.instance.read(name))
            .unwrap_or_else(|| panic!("no variable {name}"))
    }

    pub fn set(&mut self, name: &str, value: Value) {
        self.instance
            .write(&format!("P.{name}"), value)
            .or_else(|_| self.instance.write(name, value))
            .unwrap_or_else(|e| panic!("{e}"));
    }

    pub fn text(&self, name: &str) -> String {
        self.get(name).to_string()
    }
}

/// Declares `vars` in PROGRAM P, runs `body` once, and answers the values of `names`.
pub fn run(vars: &str, body: &str, names: &[&str]) -> Vec<String> {
    let text = format!("PROGRAM P\nVAR\n{vars}\nEND_VAR\n{body}\nEND_PROGRAM\n");
    let mut machine = Machine::new(&text);
    machine.scan();
    names.iter().map(|n| machine.text(n)).collect()
}
