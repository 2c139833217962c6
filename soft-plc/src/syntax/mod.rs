//! Structured Text as text: lexer, syntax tree with spans, and parser.

pub mod ast;
pub mod lexer;
pub mod literal;
mod parse_decl;
mod parse_expr;
mod parse_stmt;
pub mod parser;
