//! The soft-PLC: IEC 61131-3 logic in, WebAssembly out, run by Wasmtime.
//!
//! `parse_project` (text to syntax tree) > `check` (typed tree) > `layout_of`, `compile` (memory layout, Wasm) >
//! `Engine::prepare`, `Instance::scan`. No clock, no network, no randomness: MC time and inputs are arguments of a scan.

pub mod calendar;
pub mod check;
pub mod codegen;
pub mod diag;
mod diagnose;
pub mod image;
pub mod instances;
pub mod layout;
pub mod memory;
pub mod plain;
mod plan;
mod plcopen;
pub mod project;
#[cfg(feature = "runtime")]
pub mod runtime;
pub mod source;
pub mod standalone;
pub mod syntax;
pub mod types;
pub mod value;

pub use check::tree::TypedProject;
pub use check::{CheckOptions, Dialect, check, check_expression, evaluate};
pub use codegen::{CompiledMc, compile};
pub use diag::{Diagnostic, Severity};
pub use diagnose::diagnose;
pub use layout::{
    Area, CompileSpec, FieldNode, Layout, Region, RegionSpec, TypeNode, VariableInfo, WORK_REGION,
    layout_of,
};
pub use plcopen::WHOLE_TEXT_NAMESPACE;
pub use project::{parse_expression, parse_project};
#[cfg(feature = "runtime")]
pub use runtime::{
    Engine, EngineOptions, Instance, Interruption, Module, RuntimeError, Trap, TrapKind, WriteError,
};
pub use source::SourceFile;
pub use syntax::ast::Project;
pub use types::Elem;
pub use value::Value;
