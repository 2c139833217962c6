//! The syntax tree: what was written, with spans, before any name is looked up.

use std::fmt;
use std::sync::Arc;

use crate::source::{Sources, Span};
use crate::types::Elem;

#[derive(Clone, Debug)]
pub struct Ident {
    pub name: String,
    pub span: Span,
}

/// All that was read: the sources and everything declared in them.
#[derive(Clone, Debug, Default)]
pub struct Project {
    pub sources: Arc<Sources>,
    pub types: Vec<TypeDecl>,
    pub pous: Vec<Pou>,
    pub globals: Vec<VarBlock>,
    pub configurations: Vec<Configuration>,
    /// POUs of the built-in library (timers, counters, edges); a project's own POU of the same name takes precedence.
    pub library: Arc<Vec<Pou>>,
    pub interfaces: Vec<Interface>,
    /// Namespaces as they are declared. What stands in one has its path before its name: `Space.Inner.Name`.
    pub namespaces: Vec<Namespace>,
    pub usings: Vec<Using>,
}

/// `NAMESPACE INTERNAL a.b`
#[derive(Clone, Debug)]
pub struct Namespace {
    pub path: String,
    pub internal: bool,
}

/// `USING a.b;`
#[derive(Clone, Debug)]
pub struct Using {
    /// The namespace or POU that it stands in; empty for the whole project.
    pub within: String,
    pub path: Ident,
}

/// INTERFACE: methods that function blocks promise to have.
#[derive(Clone, Debug)]
pub struct Interface {
    pub name: Ident,
    pub extends: Vec<Ident>,
    pub methods: Vec<Pou>,
}

#[derive(Clone, Debug)]
pub struct TypeDecl {
    pub name: Ident,
    pub spec: TypeSpec,
    pub init: Option<Init>,
}

#[derive(Clone, Debug)]
pub struct TypeSpec {
    pub kind: TypeSpecKind,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub enum TypeSpecKind {
    Named(Ident),
    Str {
        wide: bool,
        len: Option<Box<Expr>>,
    },
    Array {
        dims: Vec<(Expr, Expr)>,
        elem: Box<TypeSpec>,
    },
    /// `ARRAY[*, *] OF INT`
    OpenArray {
        dims: u32,
        elem: Box<TypeSpec>,
    },
    Subrange {
        base: Ident,
        lo: Box<Expr>,
        hi: Box<Expr>,
    },
    Enum {
        base: Option<Ident>,
        values: Vec<(Ident, Option<Expr>)>,
    },
    Struct {
        /// `STRUCT OVERLAP`: fields may share their place.
        overlap: bool,
        fields: Vec<VarDecl>,
    },
    /// `REF_TO INT`
    Ref(Box<TypeSpec>),
    /// `POINTER TO INT`: in the standard dialect another way to write REF_TO.
    Pointer(Box<TypeSpec>),
    /// The type of the first value that is assigned: wires of diagrams.
    Inferred,
}

/// An initial value.
#[derive(Clone, Debug)]
pub enum Init {
    Expr(Expr),
    /// `[1, 2, 3(0)]`; the count is the repetition.
    Array(Vec<(Option<Expr>, Init)>, Span),
    /// `(a := 1, b := [2, 3])`
    Struct(Vec<(Ident, Init)>, Span),
}

impl Init {
    pub fn span(&self) -> Span {
        match self {
            Init::Expr(e) => e.span,
            Init::Array(_, span) | Init::Struct(_, span) => *span,
        }
    }
}

#[derive(Clone, Debug)]
pub struct VarDecl {
    pub name: Ident,
    /// `AT %IX3.5`
    pub location: Option<Ident>,
    pub spec: TypeSpec,
    pub init: Option<Init>,
    /// `R_EDGE` and `F_EDGE` behind the type of an input.
    pub edge: Option<Edge>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Edge {
    Rising,
    Falling,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum VarSection {
    Local,
    Input,
    Output,
    InOut,
    External,
    Global,
    Temp,
}

impl fmt::Display for VarSection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            VarSection::Local => "VAR",
            VarSection::Input => "VAR_INPUT",
            VarSection::Output => "VAR_OUTPUT",
            VarSection::InOut => "VAR_IN_OUT",
            VarSection::External => "VAR_EXTERNAL",
            VarSection::Global => "VAR_GLOBAL",
            VarSection::Temp => "VAR_TEMP",
        })
    }
}

#[derive(Clone, Debug)]
pub struct VarBlock {
    pub section: VarSection,
    pub constant: bool,
    pub retain: bool,
    /// Who may use the variables of a function block or class from outside; nobody but derived ones if nothing is said.
    pub access: Option<Access>,
    pub decls: Vec<VarDecl>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum PouKind {
    Program,
    Function,
    FunctionBlock,
    Method,
}

impl fmt::Display for PouKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            PouKind::Program => "PROGRAM",
            PouKind::Function => "FUNCTION",
            PouKind::FunctionBlock => "FUNCTION_BLOCK",
            PouKind::Method => "METHOD",
        })
    }
}

#[derive(Clone, Debug)]
pub struct Pou {
    pub kind: PouKind,
    pub name: Ident,
    pub result: Option<TypeSpec>,
    pub vars: Vec<VarBlock>,
    pub body: Vec<Stmt>,
    pub class: Class,
    /// Where the whole declaration stands: there its text in plain statements goes, if it needs one.
    pub place: Span,
}

/// The object-oriented part of a function block or method.
#[derive(Clone, Debug, Default)]
pub struct Class {
    pub extends: Option<Ident>,
    pub implements: Vec<Ident>,
    pub is_abstract: bool,
    pub is_final: bool,
    pub is_override: bool,
    pub access: Access,
    pub methods: Vec<Pou>,
    /// Namespaces whose contents have short names here.
    pub usings: Vec<Ident>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Access {
    #[default]
    Public,
    Internal,
    Protected,
    Private,
}

/// CONFIGURATION with its resources: which programs run in which tasks.
#[derive(Clone, Debug, Default)]
pub struct Configuration {
    pub name: String,
    pub resources: Vec<Resource>,
    /// VAR_CONFIG: places of variables that are declared with `AT %I*`.
    pub configured: Vec<Configured>,
    /// Names of VAR_ACCESS.
    pub accesses: Vec<Ident>,
}

/// `resource.program.variable AT %IX0.0 : BOOL;`
#[derive(Clone, Debug)]
pub struct Configured {
    pub path: Vec<Ident>,
    pub location: Option<Ident>,
    pub spec: TypeSpec,
    pub init: Option<Init>,
}

#[derive(Clone, Debug, Default)]
pub struct Resource {
    pub name: String,
    pub tasks: Vec<Task>,
    pub instances: Vec<ProgramInstance>,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Task {
    pub name: String,
    pub interval_ns: Option<i64>,
    pub single: Option<String>,
    pub priority: i32,
    pub span: Span,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ProgramInstance {
    pub name: String,
    pub program: String,
    pub task: Option<String>,
    /// What is connected to its inputs and outputs.
    pub connections: Vec<Connection>,
    pub span: Span,
}

/// `in := global` or `out => global` of a program instance.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Connection {
    pub parameter: String,
    pub output: bool,
    /// The other side, as text.
    pub value: String,
}

#[derive(Clone, Debug)]
pub struct Stmt {
    pub kind: StmtKind,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub enum StmtKind {
    Assign(Expr, Expr),
    /// `ref ?= instance`: NULL if the instance does not fit.
    TryAssign(Expr, Expr),
    /// A call of a function block, program or function whose result is not used.
    Call(Expr),
    /// Conditions with their statements, in order, then ELSE.
    If(Vec<(Expr, Vec<Stmt>)>, Vec<Stmt>),
    Case(Expr, Vec<(Vec<CaseLabel>, Vec<Stmt>)>, Option<Vec<Stmt>>),
    For(Box<ForLoop>),
    While(Expr, Vec<Stmt>),
    Repeat(Vec<Stmt>, Expr),
    Exit,
    Continue,
    Return,
    /// Statements that RETURN leaves alone: an action of a chart.
    Block(Vec<Stmt>),
    Empty,
}

#[derive(Clone, Debug)]
pub struct ForLoop {
    pub var: Expr,
    pub from: Expr,
    pub to: Expr,
    pub by: Option<Expr>,
    pub body: Vec<Stmt>,
}

#[derive(Clone, Debug)]
pub enum CaseLabel {
    Single(Expr),
    Range(Expr, Expr),
}

#[derive(Clone, Debug)]
pub struct Expr {
    pub kind: ExprKind,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub enum ExprKind {
    /// An integer without type prefix.
    Int(i128),
    Real(f64),
    Bool(bool),
    /// Nanoseconds.
    Time(i64),
    Str(String),
    WStr(String),
    /// A date, a time of day, or both: type and nanoseconds.
    Date(Elem, i64),
    Null,
    /// `r^`: what a reference leads to.
    Deref(Box<Expr>),
    /// `w.%B1`: size (X, B, W, D, L) and number of the part.
    Partial(Box<Expr>, char, u32),
    /// `INT#5`, `REAL#1.0`: the value is still as written.
    Typed(Elem, Box<Expr>),
    /// `Color#Red`
    EnumValue(Ident, Ident),
    Name(String),
    /// `%IX3.5`
    Direct(String),
    Field(Box<Expr>, Ident),
    /// `w.3`: bit 3 of a bit string or integer.
    Bit(Box<Expr>, u32),
    Index(Box<Expr>, Vec<Expr>),
    Call(Box<Expr>, Vec<Arg>),
    Unary(UnOp, Box<Expr>),
    Binary(BinOp, Box<Expr>, Box<Expr>),
}

#[derive(Clone, Debug)]
pub struct Arg {
    /// Name of the parameter in a formal call.
    pub name: Option<Ident>,
    /// `q => x`
    pub output: bool,
    /// `NOT q => x`
    pub negated: bool,
    pub value: Option<Expr>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum UnOp {
    Neg,
    Not,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum BinOp {
    Add,
    Sub,
    Mul,
    Div,
    Mod,
    Pow,
    And,
    Or,
    Xor,
    Eq,
    Ne,
    Lt,
    Le,
    Gt,
    Ge,
}

impl BinOp {
    pub fn is_comparison(self) -> bool {
        matches!(
            self,
            BinOp::Eq | BinOp::Ne | BinOp::Lt | BinOp::Le | BinOp::Gt | BinOp::Ge
        )
    }

    pub fn is_logic(self) -> bool {
        matches!(self, BinOp::And | BinOp::Or | BinOp::Xor)
    }

    pub fn text(self) -> &'static str {
        match self {
            BinOp::Add => "+",
            BinOp::Sub => "-",
            BinOp::Mul => "*",
            BinOp::Div => "/",
            BinOp::Mod => "MOD",
            BinOp::Pow => "**",
            BinOp::And => "AND",
            BinOp::Or => "OR",
            BinOp::Xor => "XOR",
            BinOp::Eq => "=",
            BinOp::Ne => "<>",
            BinOp::Lt => "<",
            BinOp::Le => "<=",
            BinOp::Gt => ">",
            BinOp::Ge => ">=",
        }
    }
}
