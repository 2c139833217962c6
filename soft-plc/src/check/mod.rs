//! From the syntax tree to the typed tree: names looked up, types found, constants worked out, rules enforced.

mod address;
mod calls;
mod class;
mod conditions;
mod configured;
mod declare;
mod enable;
mod expr;
mod init;
mod liberties;
pub mod lint;
mod located;
mod located_text;
mod methods;
mod names;
mod open_arrays;
mod operators;
mod place;
mod pointers;
mod pous;
mod recursion;
mod stdcalls;
pub mod stdfun;
mod stmt;
mod tasks;
mod text;
pub mod tree;
mod types;
pub mod visit;

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::diag::{Diagnostic, Fallible, Problem, Severity, finish_all};
use crate::source::{Sources, Span};
use crate::syntax::ast::Project;
use crate::types::{InterfaceId, TypeId, TypeTable};
use tree::{Pou, PouId, TypedProject, Var, VarId};

pub use address::{IMAGE_BYTES_MAX, parse_location};
pub use conditions::{check_expression, evaluate};

/// What is allowed beyond the standard.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CheckOptions {
    /// Any POU may read and write the internal variables of programs and function block instances by their dotted path
    /// (`MC1.timer.ET`): needed by generated POUs that write a state out variable by variable.
    pub allow_internal_access: bool,
    pub dialect: Dialect,
}

/// Whose liberties are taken with the standard.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Dialect {
    #[default]
    Standard,
    /// Numbers become narrower ones without a conversion function; a warning says so.
    Codesys,
}

/// Checks the project. Errors come together, in the order of the text; warnings go with the typed tree.
///
/// The typed tree keeps the project, so that conditions can be checked against it later.
pub fn check(
    project: impl Into<Arc<Project>>,
    options: CheckOptions,
) -> Result<TypedProject, Vec<Diagnostic>> {
    let project = project.into();
    let mut checker = Checker::new(&project, options);
    checker.collect();
    checker.declare_all();
    checker.check_bodies();
    checker.finish(project.clone())
}

impl From<&Project> for Arc<Project> {
    fn from(project: &Project) -> Self {
        Arc::new(project.clone())
    }
}

/// The declared names that stand outside POUs.
#[derive(Clone, Copy, Debug)]
enum Declared {
    /// Index into `Project::types`.
    Type(usize),
    Pou(PouId),
    /// Block and declaration in `Project::globals`.
    Global(usize, usize),
    Interface(InterfaceId),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Progress {
    Open,
    Running,
    Done,
}

struct Checker<'p> {
    project: &'p Project,
    /// The project's texts; a condition's checker knows the condition's, too.
    sources: Arc<Sources>,
    options: CheckOptions,
    types: TypeTable,
    vars: Vec<Var>,
    pous: Vec<Pou>,
    problems: Vec<Problem>,
    names: BTreeMap<String, Declared>,
    type_ids: Vec<(Progress, TypeId)>,
    /// Structures that references lead to and whose fields are not known yet.
    ahead: BTreeMap<String, TypeId>,
    /// Fields of structures, those of the structures in them counted.
    structure_parts: BTreeMap<TypeId, u64>,
    /// Internal variables whose declaration says who may use them.
    access: BTreeMap<VarId, crate::syntax::ast::Access>,
    globals: BTreeMap<(usize, usize), (Progress, Option<VarId>)>,
    /// Enumerated values by their name: the enumerations that have it.
    enum_values: BTreeMap<String, Vec<(TypeId, i64)>>,
    spaces: names::Spaces,
    fb_types: BTreeMap<PouId, TypeId>,
    pending_inits: Vec<(init::Pending, &'p crate::syntax::ast::Init)>,
    /// How many constants need each other right now.
    init_depth: u32,
    interface_types: Vec<TypeId>,
    interfaces: Vec<tree::Interface>,
    /// The syntax of each POU.
    syntaxes: Vec<&'p crate::syntax::ast::Pou>,
    /// Addresses with levels of their own: the bytes where they lie.
    foreign_addresses: BTreeMap<String, u32>,
    /// What VAR_CONFIG places inside instances.
    placed: Vec<configured::Placed>,
    texts: Vec<located_text::LocatedText>,
    open_arrays: open_arrays::OpenArrays,
    /// Names that each POU sees first.
    scopes: Vec<BTreeMap<String, VarId>>,
    current: Scope,
}

/// The POU whose text is being looked at, and the names that it sees first.
#[derive(Clone, Debug, Default)]
struct Scope {
    pou: Option<PouId>,
    names: BTreeMap<String, VarId>,
    /// Where names are looked for first: the namespace of the text, or a name in it.
    space: String,
    /// Number of loops around the current statement.
    loops: u32,
    /// A wire gets its first value: its type is not known yet.
    defining: bool,
    /// One side of an assignment, where a located array or structure may stand for all of its parts.
    assigned: Option<Span>,
}

/// Names are compared without regard to case.
pub(crate) fn key(name: &str) -> String {
    name.to_ascii_uppercase()
}

impl<'p> Checker<'p> {
    fn new(project: &'p Project, options: CheckOptions) -> Self {
        Self {
            project,
            sources: project.sources.clone(),
            options,
            types: TypeTable::default(),
            vars: Vec::new(),
            pous: Vec::new(),
            problems: Vec::new(),
            names: BTreeMap::new(),
            type_ids: vec![(Progress::Open, TypeId::ERROR); project.types.len()],
            ahead: BTreeMap::new(),
            structure_parts: BTreeMap::new(),
            access: BTreeMap::new(),
            globals: BTreeMap::new(),
            enum_values: BTreeMap::new(),
            spaces: names::Spaces::default(),
            fb_types: BTreeMap::new(),
            pending_inits: Vec::new(),
            init_depth: 0,
            interface_types: Vec::new(),
            interfaces: Vec::new(),
            syntaxes: Vec::new(),
            foreign_addresses: BTreeMap::new(),
            placed: Vec::new(),
            texts: Vec::new(),
            open_arrays: open_arrays::OpenArrays::default(),
            scopes: Vec::new(),
            current: Scope::default(),
        }
    }

    fn report(&mut self, mut problem: Problem) {
        if problem.pou.is_none()
            && let Some(pou) = self.current.pou
        {
            problem.pou = Some(self.pous[pou.0 as usize].name.clone());
        }
        self.problems.push(problem);
    }

    /// The value, or `None` after reporting the problem.
    fn ok<T>(&mut self, result: Fallible<T>) -> Option<T> {
        result.map_err(|problem| self.report(*problem)).ok()
    }

    fn var(&self, id: VarId) -> &Var {
        &self.vars[id.0 as usize]
    }

    fn pou(&self, id: PouId) -> &Pou {
        &self.pous[id.0 as usize]
    }

    fn type_name(&self, ty: TypeId) -> String {
        match self.types.kind(ty) {
            crate::types::TypeKind::FunctionBlock(pou) => self.pou(*pou).name.clone(),
            _ => self.types.name(ty),
        }
    }

    fn finish(mut self, syntax: Arc<Project>) -> Result<TypedProject, Vec<Diagnostic>> {
        self.refuse_recursion();
        let has_errors = self.problems.iter().any(|p| p.severity == Severity::Error);
        let diagnostics = finish_all(self.problems, &self.sources);
        if has_errors {
            return Err(diagnostics);
        }
        let globals = self.globals.values().filter_map(|(_, id)| *id).collect();
        Ok(TypedProject {
            sources: self.sources,
            types: self.types,
            vars: self.vars,
            pous: self.pous,
            globals,
            interfaces: self.interfaces,
            warnings: diagnostics,
            syntax,
            options: self.options,
        })
    }
}
