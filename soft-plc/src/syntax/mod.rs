//! Structured Text as text: lexer, syntax tree with spans, and parser.

pub mod ast;
pub mod build;
pub mod lexer;
pub mod literal;
mod parse_config;
mod parse_decl;
pub(crate) mod parse_expr;
pub(crate) mod parse_il;
mod parse_sfc;
mod parse_stmt;
mod parse_types;
pub mod parser;
pub mod print;
pub mod sfc;
mod slips;
pub(crate) mod walk;
