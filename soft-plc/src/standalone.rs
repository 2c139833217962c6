//! Runs the programs of a project alone: one instance that holds all of them, scanned in simulated time.
//!
//! An entry program is written for them. Where the project has a configuration, its tasks say which program instances run and
//! how often: the fastest cyclic task runs in every scan, another with an interval k times as long in every k-th. Tasks with
//! SINGLE run at the rising edge of their variable. Without a configuration all programs run in every scan.

use std::sync::Arc;

use crate::check::{CheckOptions, check};
use crate::codegen::{CompiledMc, compile};
use crate::diag::{Diagnostic, Problem, Severity, finish_all};
use crate::layout::{CompileSpec, TypeNode, VariableInfo};
use crate::project::parse_project;
use crate::runtime::Instance;
use crate::source::{SourceFile, Span};
use crate::syntax::ast::{
    BinOp, Class, Connection, Expr, ExprKind, Pou, PouKind, ProgramInstance, Project, Stmt, Task,
    VarDecl, VarSection,
};
use crate::syntax::build::{At, block};
use crate::syntax::parser::parse_whole_expression;
use crate::value::Value;

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
    let mut typed = check(&project, options.check)?;
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
            .chain(&project.library)
            .find(|p| same(&p.name.name, name))
            .cloned();
        match found {
            Some(pou) if pou.kind == PouKind::Program => entry.program(&pou.name.name, &[])?,
            Some(pou) if pou.kind == PouKind::FunctionBlock => entry.instance(&pou),
            Some(pou) if pou.kind == PouKind::Function => entry.function(&pou),
            _ => return Err(no_program(project, Some(name))),
        }
    } else {
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
            let mut used: Vec<String> = Vec::new();
            for (tasks, instances) in &resources {
                entry.resource(project, tasks, instances, cycle_ns, &mut used)?;
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
                entry.program(name, &[])?;
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

    fn expression(&self, text: &str) -> Result<Expr, Vec<Diagnostic>> {
        parse_whole_expression(0, text, 0)
            .map(|e| at_once(e, self.at))
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

    fn call(&self, name: &str, connections: &[Connection]) -> Result<Stmt, Vec<Diagnostic>> {
        let mut args = Vec::new();
        for connection in connections {
            let value = self.expression(&connection.value)?;
            args.push(if connection.output {
                self.at.output(&connection.parameter, value)
            } else {
                self.at.input(&connection.parameter, value)
            });
        }
        Ok(self.at.invoke(self.at.name(name), args))
    }

    fn program(&mut self, name: &str, connections: &[Connection]) -> Result<(), Vec<Diagnostic>> {
        let call = self.call(name, connections)?;
        self.body.push(call);
        Ok(())
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
        project: &mut Project,
        tasks: &[Task],
        instances: &[ProgramInstance],
        cycle_ns: i64,
        used: &mut Vec<String>,
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
                    let name = place_instance(project, instance, used)?;
                    calls.push(self.call(&name, &instance.connections)?);
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
                let trigger = self.expression(single)?;
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

/// The name under which an instance runs: that of its program, or for a further instance of it a copy under its own name.
fn place_instance(
    project: &mut Project,
    instance: &ProgramInstance,
    used: &mut Vec<String>,
) -> Result<String, Vec<Diagnostic>> {
    let found = project
        .pous
        .iter()
        .find(|p| p.kind == PouKind::Program && same(&p.name.name, &instance.program))
        .cloned();
    let Some(mut pou) = found else {
        return Err(no_program(project, Some(&instance.program)));
    };
    let name = pou.name.name.clone();
    if !used.iter().any(|u| same(u, &name)) {
        used.push(name.clone());
        return Ok(name);
    }
    let mut own = instance.name.clone();
    while project.pous.iter().any(|p| same(&p.name.name, &own)) {
        own.push('_');
    }
    pou.name.name.clone_from(&own);
    used.push(own.clone());
    project.pous.push(pou);
    Ok(own)
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

/// A value of any shape, as it is shown.
#[derive(Clone, Debug, PartialEq)]
pub enum Shown {
    Scalar(Value),
    /// An enumerated value by its name.
    Name(String),
    Text(String),
    Array(Vec<Shown>),
    Struct(Vec<(String, Shown)>),
}

/// All variables of the programs and all global ones with their paths; structures and instances are taken apart, arrays
/// stand whole. Variables that FAM made itself are left out.
pub fn variables(instance: &Instance) -> Vec<(String, Shown)> {
    let mut out = Vec::new();
    for root in &instance.layout().roots {
        let path = shown_path(&root.path);
        collect(instance, root, path, &mut out);
    }
    out
}

/// The path without the entry's name.
fn shown_path(path: &str) -> String {
    path.strip_prefix(ENTRY)
        .and_then(|p| p.strip_prefix('.'))
        .unwrap_or(path)
        .to_owned()
}

fn is_hidden(path: &str) -> bool {
    path.rsplit('.').next().is_some_and(|n| n.starts_with("__"))
}

fn collect(instance: &Instance, info: &VariableInfo, path: String, out: &mut Vec<(String, Shown)>) {
    if is_hidden(&path) {
        return;
    }
    if let TypeNode::Struct { fields, .. } = &*info.ty {
        for field in fields {
            if let Some(inner) = info.field(&field.name) {
                collect(instance, &inner, format!("{path}.{}", field.name), out);
            }
        }
        return;
    }
    if let Some(shown) = show(instance, info) {
        out.push((path, shown));
    }
}

/// The value of a variable.
pub fn show(instance: &Instance, info: &VariableInfo) -> Option<Shown> {
    match &*info.ty {
        TypeNode::Struct { fields, .. } => {
            let mut list = Vec::new();
            for field in fields.iter().filter(|f| !f.name.starts_with("__")) {
                let inner = info.field(&field.name)?;
                list.push((field.name.clone(), show(instance, &inner)?));
            }
            Some(Shown::Struct(list))
        }
        TypeNode::Array { dims, .. } => {
            let mut indices = Vec::new();
            array(instance, info, dims, &mut indices)
        }
        TypeNode::Text { .. } => Some(Shown::Text(instance.read_text(info)?)),
        TypeNode::Enum { values, .. } => {
            let value = instance.read_variable(info)?;
            let number = value.as_i128()?;
            let name = values.iter().find(|(_, v)| i128::from(*v) == number);
            Some(name.map_or(Shown::Scalar(value), |(n, _)| Shown::Name(n.clone())))
        }
        _ => Some(Shown::Scalar(instance.read_variable(info)?)),
    }
}

fn array(
    instance: &Instance,
    info: &VariableInfo,
    dims: &[(i64, i64)],
    indices: &mut Vec<i64>,
) -> Option<Shown> {
    let Some((lo, hi)) = dims.get(indices.len()).copied() else {
        return show(instance, &info.element(indices)?);
    };
    let mut list = Vec::new();
    for index in lo..=hi {
        indices.push(index);
        list.push(array(instance, info, dims, indices)?);
        indices.pop();
    }
    Some(Shown::Array(list))
}

/// What one ASSERT block of a test program has counted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assertions {
    /// Path of the block.
    pub path: String,
    pub passed: i64,
    pub failed: i64,
    pub first_failure: String,
}

/// The counts of all ASSERT blocks, those inside other blocks included.
pub fn assertions(instance: &Instance) -> Vec<Assertions> {
    let mut out = Vec::new();
    let mut todo: Vec<VariableInfo> = instance.layout().roots.clone();
    while let Some(info) = todo.pop() {
        let TypeNode::Struct { name, fields } = &*info.ty else {
            if let TypeNode::Array { dims, elem, .. } = &*info.ty
                && matches!(**elem, TypeNode::Struct { .. })
                && let [(lo, hi)] = dims[..]
            {
                todo.extend((lo..=hi).filter_map(|i| info.element(&[i])));
            }
            continue;
        };
        if !same(name, "ASSERT") {
            todo.extend(fields.iter().filter_map(|f| info.field(&f.name)));
            continue;
        }
        let count = |field: &str| {
            info.field(field)
                .and_then(|f| instance.read_variable(&f))
                .and_then(Value::as_i128)
                .unwrap_or(0) as i64
        };
        let first = info
            .field("first_failure")
            .and_then(|f| instance.read_text(&f));
        out.push(Assertions {
            path: shown_path(&info.path),
            passed: count("passed"),
            failed: count("failed"),
            first_failure: first.unwrap_or_default(),
        });
    }
    out.sort_by(|a, b| a.path.cmp(&b.path));
    out
}

/// The variable that a name means: a full path, or the end of one if only one variable has it; `%IX0.0` for a bit of the
/// process image.
pub fn find(instance: &Instance, name: &str) -> Option<VariableInfo> {
    let layout = instance.layout();
    if name.starts_with('%') {
        return direct(instance, name);
    }
    if let Some(found) = layout.find(name) {
        return Some(found);
    }
    if let Some(found) = layout.find(&format!("{ENTRY}.{name}")) {
        return Some(found);
    }
    let mut candidates = layout.roots.iter().filter_map(|root| {
        let (owner, _) = root.path.split_once('.')?;
        layout.find(&format!("{owner}.{name}"))
    });
    let first = candidates.next()?;
    candidates
        .all(|other| other.path == first.path)
        .then_some(first)
}

fn direct(instance: &Instance, name: &str) -> Option<VariableInfo> {
    use crate::layout::Area;
    use crate::types::Elem;
    let location = crate::check::parse_location(name, Span::default()).ok()?;
    if location.memory {
        return None;
    }
    let area = if location.output {
        Area::Outputs
    } else {
        Area::Inputs
    };
    let elem = match location.size {
        'X' => Elem::Bool,
        'B' => Elem::Byte,
        'W' => Elem::Word,
        'D' => Elem::Dword,
        _ => Elem::Lword,
    };
    let len = elem.image_bytes();
    (location.byte + len <= instance.layout().area(area).len).then(|| VariableInfo {
        path: name.to_owned(),
        area,
        offset: location.byte,
        bit: location.bit,
        len,
        ty: Arc::new(TypeNode::Elem(elem)),
        retain: false,
    })
}

/// Writes what a text shows: a literal of the variable's type, or the name of an enumerated value. The error says what was
/// expected.
pub fn write(instance: &mut Instance, info: &VariableInfo, text: &str) -> Result<(), String> {
    let text = text.trim();
    if let TypeNode::Text { .. } = &*info.ty {
        let inner = text.trim_matches(['\'', '"']);
        instance.write_text(info, inner);
        return Ok(());
    }
    let Some(elem) = info.ty.elem() else {
        return Err(format!(
            "`{}` is an array or structure; write its parts",
            info.path
        ));
    };
    let named = match &*info.ty {
        TypeNode::Enum { base, values, .. } => {
            let name = text.rsplit(['#', '.']).next().unwrap_or(text);
            values
                .iter()
                .find(|(n, _)| same(n, name))
                .map(|(_, v)| Value::from_i128(*base, i128::from(*v)))
        }
        _ => None,
    };
    let Some(value) = named.or_else(|| crate::runtime::value_of(elem, text)) else {
        return Err(format!("`{text}` is no value of `{}` ({elem})", info.path));
    };
    instance
        .write_variable(info, value)
        .map_err(|e| e.to_string())
}
