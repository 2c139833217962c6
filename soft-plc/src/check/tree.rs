//! The typed tree: what the checker hands to the compiler and to tools. Names are resolved, implicit conversions explicit.

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::check::CheckOptions;
use crate::check::stdfun::StdFun;
use crate::diag::Diagnostic;
use crate::image;
use crate::source::{Sources, Span};
use crate::syntax::ast::{Access, BinOp, PouKind, Project, UnOp, VarSection};
use crate::types::{Elem, InterfaceId, TypeId, TypeKind, TypeTable};
use crate::value::Value;

pub use crate::check::visit::{visit_expr, visit_place, visit_places, visit_writes};

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PouId(pub u32);

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct VarId(pub u32);

/// A project that has passed all checks.
#[derive(Clone, Debug)]
pub struct TypedProject {
    pub sources: Arc<Sources>,
    pub types: TypeTable,
    pub vars: Vec<Var>,
    pub pous: Vec<Pou>,
    /// Global variables in the order of their declaration.
    pub globals: Vec<VarId>,
    pub interfaces: Vec<Interface>,
    pub warnings: Vec<Diagnostic>,
    /// What it was made from: conditions are checked against it.
    pub syntax: Arc<Project>,
    pub options: CheckOptions,
}

impl TypedProject {
    pub fn var(&self, id: VarId) -> &Var {
        &self.vars[id.0 as usize]
    }

    pub fn pou(&self, id: PouId) -> &Pou {
        &self.pous[id.0 as usize]
    }

    /// The POU of this name; the path of a namespace may be left out.
    pub fn find_pou(&self, name: &str) -> Option<PouId> {
        let last = |p: &Pou| {
            let last = p.name.rsplit_once('.').map(|(_, last)| last);
            p.kind != PouKind::Method && last.is_some_and(|l| l.eq_ignore_ascii_case(name))
        };
        let exact = |p: &Pou| p.name.eq_ignore_ascii_case(name);
        let found = self.pous.iter().position(exact);
        let found = found.or_else(|| self.pous.iter().position(last));
        found.map(|index| PouId(index as u32))
    }

    /// The method of this name (in upper case) of a function block, its own or that of the nearest base.
    pub fn find_method(&self, block: PouId, name: &str) -> Option<PouId> {
        let mut at = Some(block);
        while let Some(id) = at {
            let unit = self.pou(id);
            if let Some((_, method)) = unit.methods.iter().find(|(n, _)| n == name) {
                return Some(*method);
            }
            at = unit.extends;
        }
        None
    }

    /// Whether `from` is `to` or derived from it.
    pub fn derives(&self, from: PouId, to: PouId) -> bool {
        let mut at = Some(from);
        while let Some(id) = at {
            if id == to {
                return true;
            }
            at = self.pou(id).extends;
        }
        false
    }

    /// The statements of a POU; a derived function block without any has those of its base.
    pub fn body(&self, pou: PouId) -> &[Stmt] {
        let unit = self.pou(pou);
        match unit.extends {
            Some(base) if unit.body.is_empty() => self.body(base),
            _ => &unit.body,
        }
    }

    /// The name of a method without that of its function block, in upper case.
    pub fn method_name(&self, method: PouId) -> String {
        let name = &self.pou(method).name;
        name.rsplit('.').next().unwrap_or(name).to_ascii_uppercase()
    }

    pub fn find_global(&self, name: &str) -> Option<VarId> {
        self.globals
            .iter()
            .copied()
            .find(|id| self.var(*id).name.eq_ignore_ascii_case(name))
    }

    /// Names of all programs, in the order of their declaration.
    pub fn programs(&self) -> impl Iterator<Item = &str> {
        self.pous
            .iter()
            .filter(|p| p.kind == PouKind::Program)
            .map(|p| p.name.as_str())
    }

    /// Whether variables are reached by numbers: POINTER TO of CODESYS.
    pub fn uses_pointers(&self) -> bool {
        self.types
            .iter()
            .any(|(_, ty)| matches!(ty.kind, TypeKind::Pointer(_)))
    }

    /// Whether the place is reached through a pointer.
    pub fn is_through_pointer(&self, place: &Place) -> bool {
        let mut ty = match place.root {
            Root::Var(id) => self.var(id).ty,
            _ => return false,
        };
        place.steps.iter().any(|step| {
            let before = std::mem::replace(&mut ty, step.ty);
            matches!(step.kind, StepKind::Deref) && self.types.is_pointer(before)
        })
    }

    /// The name of a type as the user would write it.
    pub fn type_name(&self, ty: TypeId) -> String {
        match self.types.kind(ty) {
            TypeKind::FunctionBlock(pou) => self.pou(*pou).name.clone(),
            _ => self.types.name(ty),
        }
    }

    /// The dotted path of a place whose indices are constant: `MC1.station[2].timer.ET`.
    pub fn path_of(&self, place: &Place) -> Option<String> {
        let mut path = match &place.root {
            Root::Var(id) => {
                let var = self.var(*id);
                match var.owner {
                    Some(pou) if self.pou(pou).kind == PouKind::Program => {
                        format!("{}.{}", self.pou(pou).name, var.name)
                    }
                    _ => var.name.clone(),
                }
            }
            Root::Direct(location) => location.to_string(),
            Root::This => return None,
        };
        for step in &place.steps {
            match &step.kind {
                StepKind::Field(index, owner) => {
                    let TypeKind::Struct { fields } = self.types.kind(*owner) else {
                        return None;
                    };
                    path.push('.');
                    path.push_str(&fields[*index].name);
                }
                StepKind::Member(var) => {
                    path.push('.');
                    path.push_str(&self.var(*var).name);
                }
                StepKind::Index(indices) => {
                    let mut texts = Vec::new();
                    for index in indices {
                        match &index.kind {
                            ExprKind::Const(value) => texts.push(value.as_i128()?.to_string()),
                            _ => return None,
                        }
                    }
                    path.push_str(&format!("[{}]", texts.join(",")));
                }
                StepKind::Bit(bit) => path.push_str(&format!(".{bit}")),
                StepKind::Part(..) | StepKind::Deref | StepKind::Element(_) | StepKind::Char(_) => {
                    return None;
                }
            }
        }
        Some(path)
    }
}

/// Where a located variable stands in the process image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Location {
    pub output: bool,
    /// `%M`: neither input nor output; kept from scan to scan as a part of the state. `output` is set too.
    pub memory: bool,
    pub byte: u32,
    /// For BOOL: the bit in the byte.
    pub bit: Option<u8>,
    /// `X`, `B`, `W`, `D` or `L` as written.
    pub size: char,
}

impl Location {
    /// The letter of its area.
    pub fn area(&self) -> char {
        match (self.memory, self.output) {
            (true, _) => 'M',
            (_, true) => 'Q',
            _ => 'I',
        }
    }
}

impl std::fmt::Display for Location {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let area = self.area();
        match (self.bit, self.size) {
            (Some(bit), _) => write!(f, "%{area}X{}.{bit}", self.byte),
            (None, 'W') => write!(f, "%{area}W{}", self.byte / 2),
            (None, 'D') => write!(f, "%{area}D{}", self.byte / 4),
            (None, 'L') => write!(f, "%{area}L{}", self.byte / 8),
            (None, size) => write!(f, "%{area}{size}{}", self.byte),
        }
    }
}

#[derive(Clone, Debug)]
pub struct Var {
    pub name: String,
    pub ty: TypeId,
    pub section: VarSection,
    pub constant: bool,
    pub retain: bool,
    pub location: Option<Location>,
    /// Declared with `AT %I*`: written by nobody in the program.
    pub open_input: bool,
    /// Declared with `AT %Q*`, and placed by nothing that stands with it.
    pub open_output: bool,
    pub init: Option<InitValue>,
    /// The POU that declares it; `None` for a global variable.
    pub owner: Option<PouId>,
    pub span: Span,
}

impl Var {
    /// Whether it is a located array or structure whose parts lie closer in the image than in memory, bits side by side and two
    /// bytes for 16 bits. Such a variable has no address that a POU could be given; its scalars are reached one by one.
    pub fn is_closer(&self, types: &TypeTable) -> bool {
        self.location.is_some() && image::is_closer(types, self.ty)
    }
}

/// An initial value, as far as it differs from that of the type.
#[derive(Clone, Debug, PartialEq)]
pub enum InitValue {
    Scalar(Value),
    /// Values of the first elements in order; each stands `count` times.
    Array(Vec<(u64, InitValue)>),
    /// Values of fields by their index.
    Struct(Vec<(usize, InitValue)>),
    /// Values of variables of a function block instance.
    Instance(Vec<(VarId, InitValue)>),
    /// Characters of a string.
    Text(Arc<[u16]>),
}

#[derive(Clone, Debug)]
pub struct Pou {
    pub name: String,
    pub name_span: Span,
    pub kind: PouKind,
    /// Part of the built-in library.
    pub library: bool,
    /// It has parameters of `ARRAY[*]` and no body: calls mean what was made of it.
    pub pattern: bool,
    /// All variables in the order of their declaration.
    pub vars: Vec<VarId>,
    /// For a function with a result: the variable that carries the function's name.
    pub result: Option<VarId>,
    pub body: Vec<Stmt>,
    pub calls: BTreeSet<PouId>,
    /// For a method: the function block that it belongs to.
    pub instance_of: Option<PouId>,
    /// The function block that it is derived from.
    pub extends: Option<PouId>,
    /// Interfaces that it implements, those of its base included.
    pub implements: Vec<InterfaceId>,
    /// Its own methods by their name.
    pub methods: Vec<(String, PouId)>,
    pub is_abstract: bool,
    pub is_final: bool,
    pub access: Access,
    /// The hidden first variable that tells which function block an instance is of.
    pub tag: Option<VarId>,
}

/// INTERFACE: its methods, those of its bases included.
#[derive(Clone, Debug)]
pub struct Interface {
    pub name: String,
    pub methods: Vec<(String, PouId)>,
}

#[derive(Clone, Debug)]
pub struct Stmt {
    pub kind: StmtKind,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub enum StmtKind {
    Assign(Place, Expr),
    /// A function called for its effects.
    Call(FunctionCall),
    Invoke(Invocation),
    If(Vec<(Expr, Vec<Stmt>)>, Vec<Stmt>),
    Case {
        selector: Expr,
        branches: Vec<Branch>,
        otherwise: Vec<Stmt>,
    },
    For(Box<For>),
    While(Expr, Vec<Stmt>),
    Repeat(Vec<Stmt>, Expr),
    Exit,
    Continue,
    Return,
    /// Statements that RETURN leaves alone.
    Block(Vec<Stmt>),
    /// `__REGION_TO_BYTES` (`to_bytes`) and `__BYTES_TO_REGION`: a block copy between a region of memory and an array of bytes.
    CopyRegion {
        region: String,
        array: Place,
        to_bytes: bool,
    },
}

/// Ranges of values of a CASE, and what runs for them.
pub type Branch = (Vec<(i64, i64)>, Vec<Stmt>);

#[derive(Clone, Debug)]
pub struct For {
    pub var: Place,
    pub from: Expr,
    pub to: Expr,
    pub by: Expr,
    pub body: Vec<Stmt>,
}

/// A call of a function block instance, or of a program (`instance` is `None`).
#[derive(Clone, Debug)]
pub struct Invocation {
    pub pou: PouId,
    pub instance: Option<Place>,
    pub inputs: Vec<(VarId, Expr)>,
    /// One for each VAR_IN_OUT, in the order of their declaration.
    pub in_outs: Vec<Place>,
    /// Parameter, variable that receives it, and whether it is negated on the way.
    pub outputs: Vec<(VarId, Place, bool)>,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub struct FunctionCall {
    pub pou: PouId,
    /// One for each VAR_INPUT, VAR_OUTPUT and VAR_IN_OUT, in the order of their declaration.
    pub args: Vec<Argument>,
    /// For a method: whose it is.
    pub receiver: Option<Receiver>,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub enum Receiver {
    /// An instance; the method that runs is that of its declared type.
    Fixed(Place),
    /// An instance of this function block or of one derived from it.
    Derived(Place),
    /// A variable of an interface.
    Interface(Place, InterfaceId),
}

#[derive(Clone, Debug)]
pub enum Argument {
    Input(Expr),
    /// `=> target` or `NOT output => target`; without a target nobody asks for it.
    Output {
        target: Option<Place>,
        negated: bool,
    },
    InOut(Place),
}

/// Something with an address: a variable, or a part of one.
#[derive(Clone, Debug)]
pub struct Place {
    pub root: Root,
    pub steps: Vec<Step>,
    pub ty: TypeId,
    pub span: Span,
}

impl Place {
    /// Whether both are the same variable, wherever indices and references lead.
    pub fn is_surely(&self, other: &Self) -> bool {
        let same_root = match (&self.root, &other.root) {
            (Root::Var(a), Root::Var(b)) => a == b,
            (Root::This, Root::This) => true,
            _ => false,
        };
        let same_step = |(a, b): (&Step, &Step)| match (&a.kind, &b.kind) {
            (StepKind::Field(a, _), StepKind::Field(b, _)) => a == b,
            (StepKind::Member(a), StepKind::Member(b)) => a == b,
            _ => false,
        };
        same_root
            && self.steps.len() == other.steps.len()
            && self.steps.iter().zip(&other.steps).all(same_step)
    }
}

#[derive(Clone, Debug)]
pub enum Root {
    /// A variable of the POU itself, of a program, or a global one; its declaration says which.
    Var(VarId),
    /// `%IX0.0` without a variable.
    Direct(Location),
    /// The instance whose body or method runs.
    This,
}

#[derive(Clone, Debug)]
pub struct Step {
    pub kind: StepKind,
    /// Type of what the step leads to.
    pub ty: TypeId,
}

#[derive(Clone, Debug)]
pub enum StepKind {
    /// Field number of the structure type.
    Field(usize, TypeId),
    /// Variable of a function block instance.
    Member(VarId),
    Index(Vec<Expr>),
    Bit(u8),
    /// Bits of a larger value: the lowest one, and how many.
    Part(u8, u8),
    /// What a reference leads to.
    Deref,
    /// The so-many-th value behind the one that a pointer leads to (`pt[i]`), counted from 0.
    Element(Box<Expr>),
    /// A character of a string, counted from 1.
    Char(Box<Expr>),
}

#[derive(Clone, Debug)]
pub struct Expr {
    pub kind: ExprKind,
    pub ty: TypeId,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub enum ExprKind {
    Const(Value),
    /// Characters of a string.
    Text(Arc<[u16]>),
    /// The address of a variable, for a reference.
    AddressOf(Box<Place>),
    /// The address of an instance if it is of the function block (or one derived from it) or has the interface, else NULL.
    AddressIf(Box<Expr>, Vec<PouId>),
    Load(Box<Place>),
    /// The operand has the type of the result.
    Unary(UnOp, Box<Expr>),
    /// Both operands have one type, given here; for TIME, `*` and `/` have a LINT or LREAL on the right.
    Binary(BinOp, Elem, Box<Expr>, Box<Expr>),
    /// From the elementary type of the operand to that of the result; as explicit conversions do.
    Convert(Box<Expr>),
    /// The value must lie within these limits, else the program traps.
    Check(Box<Expr>, Limits),
    Std(StdFun, Vec<Expr>),
    Call(Box<FunctionCall>),
    Enabled(Box<Enabled>),
}

/// A call with EN inside an expression, and what tells its ENO.
#[derive(Clone, Debug)]
pub struct Enabled {
    pub condition: Expr,
    pub value: Expr,
    /// Runs after the call.
    pub on: Vec<Stmt>,
    /// The value if the call does not run.
    pub otherwise: Expr,
    pub off: Vec<Stmt>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Limits {
    Range(i128, i128),
    /// The values of an enumeration.
    Values(Vec<i64>),
}
