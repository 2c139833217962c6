//! Runs the programs of a project alone: one instance that holds all of them, scanned in simulated time.
//!
//! An entry program is written for them. Where the project has a configuration, its tasks say which program instances run and
//! how often: the fastest cyclic task runs in every scan, another with an interval k times as long in every k-th. Tasks with
//! SINGLE run at the rising edge of their variable. Without a configuration all programs run in every scan.

use crate::check::{CheckOptions, check};
use crate::codegen::{CompiledMc, compile};
use crate::diag::{Diagnostic, Problem, Severity, finish_all};
use crate::instances::own_programs;
use crate::layout::CompileSpec;
use crate::project::parse_project;
use crate::source::{SourceFile, Span};
use crate::syntax::ast::{
    BinOp, Class, Connection, Expr, ExprKind, Pou, PouKind, ProgramInstance, Project, Stmt, Task,
    VarDecl, VarSection,
};
use crate::syntax::build::{At, block};
use crate::syntax::parser::parse_whole_expression;

#[cfg(feature = "runtime")]
mod values;
#[cfg(feature = "runtime")]
pub use values::{Assertions, Shown, assertions, find, show, variables, write};

/// Name of the entry program.
const ENTRY: &str = "__FAM_RUN";
/// Cycle of a project that names none.
const CYCLE_DEFAULT_NS: i64 = 10_000_000;

#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Only this program, or an instance of this function block.
    pub program: Option<String>,
    pub check: CheckOptions,
}

/// A project that is ready to run.
#[derive(Clone, Debug)]
pub struct Prepared {
    pub mc: CompiledMc,
    pub warnings: Vec<Diagnostic>,
    /// The shortest interval of its tasks.
    pub cycle_ns: i64,
}

/// Parses, checks and compiles the files with an entry for their programs.
pub fn prepare(files: &[SourceFile], options: &Options) -> Result<Prepared, Vec<Diagnostic>> {
    let (mut project, diagnostics) = parse_project(files);
    if diagnostics.iter().any(|d| d.severity == Severity::Error) {
        return Err(diagnostics);
    }
    let cycle_ns = add_entry(&mut project, options.program.as_deref())?;
    let mut typed = check(project, options.check)?;
    let spec = CompileSpec {
        entry: ENTRY.to_owned(),
        ..CompileSpec::default()
    };
    let mc = compile(&typed, &spec)?;
    let mut warnings = diagnostics;
    warnings.append(&mut typed.warnings);
    Ok(Prepared {
        mc,
        warnings,
        cycle_ns,
    })
}

fn same(a: &str, b: &str) -> bool {
    a.eq_ignore_ascii_case(b)
}

/// Adds the entry program; answers the cycle.
fn add_entry(project: &mut Project, only: Option<&str>) -> Result<i64, Vec<Diagnostic>> {
    let mut entry = Entry {
        at: At(Span::default()),
        kept: Vec::new(),
        externals: Vec::new(),
        body: Vec::new(),
        count: 0,
    };
    let mut cycle_ns = CYCLE_DEFAULT_NS;
    if let Some(name) = only {
        let found = project
            .pous
            .iter()
            .chain(project.library.iter())
            .find(|p| same(&p.name.name, name))
            .cloned();
        match found {
            Some(pou) if pou.kind == PouKind::Program => entry.program(&pou.name.name),
            Some(pou) if pou.kind == PouKind::FunctionBlock => entry.instance(&pou),
            Some(pou) if pou.kind == PouKind::Function => entry.function(&pou),
            _ => return Err(no_program(project, Some(name))),
        }
    } else {
        own_programs(project);
        let resources: Vec<(Vec<Task>, Vec<ProgramInstance>)> = project
            .configurations
            .iter()
            .flat_map(|c| &c.resources)
            .map(|r| (r.tasks.clone(), r.instances.clone()))
            .collect();
        if resources.iter().any(|r| !r.1.is_empty()) {
            let fastest = resources
                .iter()
                .flat_map(|r| &r.0)
                .filter(|t| t.single.is_none())
                .filter_map(|t| t.interval_ns.filter(|ns| *ns > 0))
                .min();
            cycle_ns = fastest.unwrap_or(CYCLE_DEFAULT_NS);
            for (tasks, instances) in &resources {
                entry.resource(project, tasks, instances, cycle_ns)?;
            }
        } else {
            let programs: Vec<String> = project
                .pous
                .iter()
                .filter(|p| p.kind == PouKind::Program)
                .map(|p| p.name.name.clone())
                .collect();
            if programs.is_empty() {
                return Err(no_program(project, None));
            }
            for name in &programs {
                entry.program(name);
            }
        }
    }
    let at = entry.at;
    project.pous.push(Pou {
        kind: PouKind::Program,
        name: at.ident(ENTRY),
        result: None,
        vars: vec![
            block(VarSection::Local, entry.kept),
            block(VarSection::External, entry.externals),
        ],
        body: entry.body,
        class: Class::default(),
        place: at.0,
    });
    Ok(cycle_ns)
}

fn no_program(project: &Project, name: Option<&str>) -> Vec<Diagnostic> {
    let names: Vec<&str> = project
        .pous
        .iter()
        .filter(|p| p.kind != PouKind::Function)
        .map(|p| p.name.name.as_str())
        .collect();
    let message = match name {
        Some(name) => format!("there is no program `{name}`"),
        None => "there is no PROGRAM to run".to_owned(),
    };
    let mut problem = Problem::general("E501", message);
    if names.is_empty() {
        problem = problem.expected("a PROGRAM");
    } else {
        problem = problem.expected(format!("one of {}", names.join(", ")));
    }
    if name.is_none() && !names.is_empty() {
        problem = problem.hint("name a function block with --program to run an instance of it");
    }
    finish_all(vec![problem], &project.sources)
}

struct Entry {
    at: At,
    kept: Vec<VarDecl>,
    externals: Vec<VarDecl>,
    body: Vec<Stmt>,
    count: usize,
}

impl Entry {
    fn counter(&mut self, what: &str) -> String {
        self.count += 1;
        format!("__{what}{}", self.count)
    }

    fn expression(at: At, text: &str) -> Result<Expr, Vec<Diagnostic>> {
        parse_whole_expression(0, text, 0)
            .map(|e| at_once(e, at))
            .map_err(|problems| {
                problems
                    .into_iter()
                    .map(|p| Diagnostic {
                        message: format!("in the configuration, `{text}`: {}", p.message),
                        ..Problem::general("E124", "").finish(&crate::source::Sources::default())
                    })
                    .collect()
            })
    }

    fn call(at: At, name: &str, connections: &[Connection]) -> Result<Stmt, Vec<Diagnostic>> {
        let mut args = Vec::new();
        for connection in connections {
            let value = Self::expression(at, &connection.value)?;
            args.push(if connection.output {
                at.output(&connection.parameter, value)
            } else {
                at.input(&connection.parameter, value)
            });
        }
        Ok(at.invoke(at.name(name), args))
    }

    fn program(&mut self, name: &str) {
        self.body
            .push(self.at.invoke(self.at.name(name), Vec::new()));
    }

    /// An instance of a function block under its own name; what it takes by reference gets a variable.
    fn instance(&mut self, pou: &Pou) {
        let at = self.at;
        let name = &pou.name.name;
        self.kept.push(at.var(name, name));
        let args = self.references(pou);
        self.body.push(at.invoke(at.name(name), args));
    }

    fn references(&mut self, pou: &Pou) -> Vec<crate::syntax::ast::Arg> {
        let at = self.at;
        let mut args = Vec::new();
        for decl in pou
            .vars
            .iter()
            .filter(|b| b.section == VarSection::InOut)
            .flat_map(|b| &b.decls)
        {
            let name = format!("__by_reference_{}", decl.name.name);
            self.kept.push(VarDecl {
                name: at.ident(&name),
                init: None,
                ..decl.clone()
            });
            args.push(at.input(&decl.name.name, at.name(&name)));
        }
        args
    }

    fn function(&mut self, pou: &Pou) {
        let at = self.at;
        let mut args = self.references(pou);
        for decl in pou
            .vars
            .iter()
            .filter(|b| b.section == VarSection::Input && !b.constant)
            .flat_map(|b| &b.decls)
        {
            let name = format!("__input_{}", decl.name.name);
            self.kept.push(VarDecl {
                name: at.ident(&name),
                ..decl.clone()
            });
            args.push(at.input(&decl.name.name, at.name(&name)));
        }
        let call = at.call(at.name(&pou.name.name), args);
        if pou.result.is_some() {
            let result = format!("{}_result", pou.name.name);
            self.kept.push(at.wire(&result));
            self.body.push(at.assign(at.name(&result), call));
        } else {
            self.body
                .push(at.stmt(crate::syntax::ast::StmtKind::Call(call)));
        }
    }

    fn resource(
        &mut self,
        project: &Project,
        tasks: &[Task],
        instances: &[ProgramInstance],
        cycle_ns: i64,
    ) -> Result<(), Vec<Diagnostic>> {
        let at = self.at;
        let mut order: Vec<Option<&Task>> = tasks.iter().map(Some).collect();
        // The lower number is the higher priority.
        order.sort_by_key(|t| t.map_or(i32::MAX, |t| t.priority));
        order.push(None);
        for task in order {
            let mut calls = Vec::new();
            for instance in instances {
                let own = match (&instance.task, task) {
                    (Some(name), Some(task)) => same(name, &task.name),
                    (None, None) => true,
                    (Some(name), None) => !tasks.iter().any(|t| same(name, &t.name)),
                    (None, Some(_)) => false,
                };
                if own {
                    let is_it = |p: &&Pou| {
                        p.kind == PouKind::Program && same(&p.name.name, &instance.program)
                    };
                    let Some(program) = project.pous.iter().find(is_it) else {
                        return Err(no_program(project, Some(&instance.program)));
                    };
                    let at = At(instance.span);
                    calls.push(Self::call(at, &program.name.name, &instance.connections)?);
                }
            }
            if calls.is_empty() {
                continue;
            }
            let Some(task) = task else {
                self.body.extend(calls);
                continue;
            };
            if let Some(single) = &task.single {
                let trigger = Self::expression(At(task.span), single)?;
                let last = self.counter("last");
                self.kept.push(at.var(&last, "BOOL"));
                let edge = at.and(trigger.clone(), at.not(at.name(&last)));
                self.body.push(at.if_then(edge, calls));
                self.body.push(at.assign(at.name(&last), trigger));
                continue;
            }
            let every = task
                .interval_ns
                .map_or(1, |ns| (ns + cycle_ns / 2) / cycle_ns.max(1));
            if every <= 1 {
                self.body.extend(calls);
                continue;
            }
            let counter = self.counter("every");
            self.kept.push(at.var(&counter, "LINT"));
            let due = at.binary(BinOp::Eq, at.name(&counter), at.int(0));
            self.body.push(at.if_then(due, calls));
            let next = at.binary(BinOp::Add, at.name(&counter), at.int(1));
            let next = at.binary(BinOp::Mod, next, at.int(i128::from(every)));
            self.body.push(at.assign(at.name(&counter), next));
        }
        Ok(())
    }
}

/// The expression with all spans at one place: its own text is not among the sources.
fn at_once(expr: Expr, at: At) -> Expr {
    let kind = match expr.kind {
        ExprKind::Field(of, name) => {
            ExprKind::Field(Box::new(at_once(*of, at)), at.ident(&name.name))
        }
        ExprKind::Index(of, list) => ExprKind::Index(
            Box::new(at_once(*of, at)),
            list.into_iter().map(|e| at_once(e, at)).collect(),
        ),
        ExprKind::Unary(op, inner) => ExprKind::Unary(op, Box::new(at_once(*inner, at))),
        ExprKind::Binary(op, a, b) => {
            ExprKind::Binary(op, Box::new(at_once(*a, at)), Box::new(at_once(*b, at)))
        }
        ExprKind::Bit(of, bit) => ExprKind::Bit(Box::new(at_once(*of, at)), bit),
        kind => kind,
    };
    at.expr(kind)
}
