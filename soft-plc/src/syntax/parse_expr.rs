//! Expressions by precedence climbing (IEC 61131-3 third edition, table 71).

use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{Arg, BinOp, Expr, ExprKind, Ident, UnOp};
use crate::syntax::lexer::{Kw, Tok};
use crate::syntax::literal;
use crate::syntax::parser::{DEPTH_MAX, Parsed, Parser, Stop};
use crate::types::Elem;

/// How many operators may follow each other in one expression without parentheses.
const CHAIN_MAX: u32 = DEPTH_MAX * 2;

impl Parser<'_> {
    pub fn expression(&mut self) -> Parsed<Expr> {
        self.deeper(|p| p.binary(0))
    }

    fn binary_operator(&self) -> Option<(BinOp, u8)> {
        Some(match self.peek() {
            Tok::Kw(Kw::Or) => (BinOp::Or, 1),
            Tok::Kw(Kw::Xor) => (BinOp::Xor, 2),
            Tok::Kw(Kw::And) | Tok::Amp => (BinOp::And, 3),
            Tok::Eq => (BinOp::Eq, 4),
            Tok::Ne => (BinOp::Ne, 4),
            Tok::Lt => (BinOp::Lt, 5),
            Tok::Le => (BinOp::Le, 5),
            Tok::Gt => (BinOp::Gt, 5),
            Tok::Ge => (BinOp::Ge, 5),
            Tok::Plus => (BinOp::Add, 6),
            Tok::Minus => (BinOp::Sub, 6),
            Tok::Star => (BinOp::Mul, 7),
            Tok::Slash => (BinOp::Div, 7),
            Tok::Kw(Kw::Mod) => (BinOp::Mod, 7),
            Tok::Power => (BinOp::Pow, 8),
            _ => return None,
        })
    }

    /// Operators of equal precedence apply from left to right, `**` included.
    fn binary(&mut self, min: u8) -> Parsed<Expr> {
        let mut left = self.unary()?;
        let mut count = 0;
        while let Some((op, precedence)) = self.binary_operator() {
            if precedence <= min {
                break;
            }
            count += 1;
            if count > CHAIN_MAX {
                let message = format!("this is a chain of more than {CHAIN_MAX} operators");
                let problem = Problem::error("E113", left.span, message);
                self.report(problem.hint("split it into several statements"));
                return Err(Stop);
            }
            self.advance();
            let right = self.deeper(|p| p.binary(precedence))?;
            left = Expr {
                span: left.span.to(right.span),
                kind: ExprKind::Binary(op, Box::new(left), Box::new(right)),
            };
        }
        Ok(left)
    }

    fn unary(&mut self) -> Parsed<Expr> {
        let start = self.span();
        let op = match self.peek() {
            Tok::Minus => UnOp::Neg,
            Tok::Kw(Kw::Not) => UnOp::Not,
            Tok::Plus => {
                self.advance();
                return self.deeper(Self::unary);
            }
            _ => return self.postfix(),
        };
        self.advance();
        let inner = self.deeper(Self::unary)?;
        let span = start.to(inner.span);
        // A sign before an integer belongs to the literal, so that the smallest value can be written.
        let kind = match (op, inner.kind) {
            (UnOp::Neg, ExprKind::Int(value)) => ExprKind::Int(-value),
            (UnOp::Neg, ExprKind::Real(value)) => ExprKind::Real(-value),
            (op, kind) => ExprKind::Unary(
                op,
                Box::new(Expr {
                    kind,
                    span: inner.span,
                }),
            ),
        };
        Ok(Expr { kind, span })
    }

    /// A primary with fields, indices, bits and calls behind it.
    pub fn postfix(&mut self) -> Parsed<Expr> {
        let mut expr = self.primary()?;
        let mut count = 0;
        loop {
            count += 1;
            if count > DEPTH_MAX {
                self.too_deep(expr.span);
                return Err(Stop);
            }
            let start = expr.span;
            let kind = match self.peek() {
                Tok::Dot => {
                    self.advance();
                    if self.at(Tok::Int) {
                        let span = self.advance().span;
                        let bit = self.text_of(span).parse().unwrap_or(u32::MAX);
                        ExprKind::Bit(Box::new(expr), bit)
                    } else if self.at(Tok::Direct) {
                        self.partial(expr)?
                    } else if self.at(Tok::TypePrefix)
                        && let Some(path) = dotted(&expr)
                    {
                        let start = self.span();
                        let literal = self.typed_literal(start)?;
                        let ExprKind::EnumValue(mut prefix, value) = literal.kind else {
                            return Err(self.unexpected("the name of an enumeration"));
                        };
                        prefix.name = format!("{path}.{}", prefix.name);
                        prefix.span = expr.span.to(prefix.span);
                        ExprKind::EnumValue(prefix, value)
                    } else {
                        let name = self.ident("the name of a field, or a bit number")?;
                        ExprKind::Field(Box::new(expr), name)
                    }
                }
                Tok::LBracket => {
                    self.advance();
                    let mut indices = vec![self.expression()?];
                    while self.eat(Tok::Comma) {
                        indices.push(self.expression()?);
                    }
                    self.expect(Tok::RBracket, "`]` or `,` after the index")?;
                    ExprKind::Index(Box::new(expr), indices)
                }
                Tok::LParen
                    if matches!(
                        expr.kind,
                        ExprKind::Name(_)
                            | ExprKind::Field(..)
                            | ExprKind::Index(..)
                            | ExprKind::Deref(..)
                    ) =>
                {
                    let args = self.arguments()?;
                    ExprKind::Call(Box::new(expr), args)
                }
                Tok::Caret => {
                    self.advance();
                    ExprKind::Deref(Box::new(expr))
                }
                _ => return Ok(expr),
            };
            let span = start.to(self.last_span());
            expr = Expr { kind, span };
        }
    }

    /// `%X3`, `%B1`, `%W0`, `%D1` behind a dot.
    fn partial(&mut self, of: Expr) -> Parsed<ExprKind> {
        let span = self.advance().span;
        let text = self.text_of(span).to_ascii_uppercase();
        let size = text.chars().nth(1).unwrap_or(' ');
        let number = text.get(2..).unwrap_or("").parse::<u32>();
        match (size, number) {
            ('X', Ok(bit)) => Ok(ExprKind::Bit(Box::new(of), bit)),
            ('B' | 'W' | 'D' | 'L', Ok(number)) => {
                Ok(ExprKind::Partial(Box::new(of), size, number))
            }
            _ => {
                self.report(
                    Problem::error("E103", span, format!("`{text}` is no part of a bit string"))
                        .expected("%X3, %B1, %W0 or %D0"),
                );
                Err(Stop)
            }
        }
    }

    pub fn arguments(&mut self) -> Parsed<Vec<Arg>> {
        self.expect(Tok::LParen, "`(`")?;
        let mut args = Vec::new();
        while !self.at(Tok::RParen) {
            args.push(self.argument()?);
            if !self.eat(Tok::Comma) {
                break;
            }
        }
        self.expect(Tok::RParen, "`)` or `,` after the argument")?;
        Ok(args)
    }

    fn argument(&mut self) -> Parsed<Arg> {
        let negated =
            self.at_kw(Kw::Not) && self.peek_at(1) == Tok::Ident && self.peek_at(2) == Tok::Arrow;
        if negated {
            self.advance();
        }
        if self.at(Tok::Ident) && matches!(self.peek_at(1), Tok::Assign | Tok::Arrow) {
            let name = self.ident("a parameter")?;
            let output = self.advance().tok == Tok::Arrow;
            // `q =>` and `in :=` without a value leave the parameter open.
            let value = if matches!(self.peek(), Tok::Comma | Tok::RParen) {
                None
            } else {
                Some(self.expression()?)
            };
            return Ok(Arg {
                name: Some(name),
                output,
                negated,
                value,
            });
        }
        let value = Some(self.expression()?);
        Ok(Arg {
            name: None,
            output: false,
            negated: false,
            value,
        })
    }

    fn primary(&mut self) -> Parsed<Expr> {
        let span = self.span();
        let text = self.text_of(span);
        let kind = match self.peek() {
            Tok::Int => ExprKind::Int(self.take(literal::integer(text, span))?),
            Tok::Based => ExprKind::Int(self.take(literal::based(text, span))?),
            Tok::Real => ExprKind::Real(self.take(literal::real(text, span))?),
            Tok::Time => ExprKind::Time(self.take(literal::time(text, span))?),
            Tok::Date => ExprKind::Date(Elem::Date, self.take(literal::date(text, span))?),
            Tok::TimeOfDay => {
                ExprKind::Date(Elem::Tod, self.take(literal::time_of_day(text, span))?)
            }
            Tok::DateTime => ExprKind::Date(Elem::Dt, self.take(literal::date_time(text, span))?),
            Tok::Str => ExprKind::Str(self.take(literal::string(text, span))?),
            Tok::WStr => ExprKind::WStr(self.take(literal::string(text, span))?),
            Tok::Broken => ExprKind::Str(String::new()),
            Tok::Ident if text.eq_ignore_ascii_case("NULL") => ExprKind::Null,
            Tok::Kw(Kw::True) => ExprKind::Bool(true),
            Tok::Kw(Kw::False) => ExprKind::Bool(false),
            Tok::Direct => ExprKind::Direct(text.to_owned()),
            Tok::Ident => ExprKind::Name(text.to_owned()),
            Tok::TypePrefix => return self.typed_literal(span),
            Tok::LParen => {
                self.advance();
                let inner = self.expression()?;
                let end = self.expect(Tok::RParen, "`)` or an operator")?;
                return Ok(Expr {
                    kind: inner.kind,
                    span: span.to(end),
                });
            }
            // AND(a, b), NOT(a), MOD(a, b) in functional form.
            Tok::Kw(kw @ (Kw::And | Kw::Or | Kw::Xor | Kw::Mod))
                if self.peek_at(1) == Tok::LParen =>
            {
                ExprKind::Name(kw.text().to_owned())
            }
            _ => return Err(self.unexpected("a value: a variable, a literal, a call or `(`")),
        };
        self.advance();
        Ok(Expr { kind, span })
    }

    /// `INT#-5`, `REAL#1.5`, `BOOL#1`, `WORD#16#FF`, `Color#Red`
    fn typed_literal(&mut self, start: Span) -> Parsed<Expr> {
        self.advance();
        let text = self.text_of(start);
        let prefix = &text[..text.len() - 1];
        let prefix_span = Span {
            end: start.end - 1,
            ..start
        };
        if matches!(
            (prefix.to_ascii_uppercase().as_str(), self.peek()),
            ("STRING", Tok::Str) | ("WSTRING", Tok::WStr)
        ) {
            let inner = self.primary()?;
            return Ok(Expr {
                span: start.to(inner.span),
                ..inner
            });
        }
        let Some(elem) = Elem::from_name(prefix) else {
            let value = self.ident("the name of a value of the enumeration")?;
            let span = start.to(value.span);
            let prefix = Ident {
                name: prefix.to_owned(),
                span: prefix_span,
            };
            return Ok(Expr {
                kind: ExprKind::EnumValue(prefix, value),
                span,
            });
        };
        let signed = matches!(self.peek(), Tok::Minus | Tok::Plus);
        let negative = signed && self.advance().tok == Tok::Minus;
        let mut value = self.primary()?;
        match &mut value.kind {
            ExprKind::Int(v) if negative => *v = -*v,
            ExprKind::Real(v) if negative => *v = -*v,
            ExprKind::Int(_) | ExprKind::Real(_) => {}
            ExprKind::Bool(_) if !signed => {}
            ExprKind::Str(_) | ExprKind::WStr(_) if !signed && elem.is_char() => {}
            _ => {
                let problem = Problem::error(
                    "E114",
                    value.span,
                    format!("`{prefix}#` must be followed by a literal"),
                )
                .expected(format!("a literal of type {elem}"));
                self.report(problem);
                return Err(Stop);
            }
        }
        let span = start.to(value.span);
        Ok(Expr {
            kind: ExprKind::Typed(elem, Box::new(value)),
            span,
        })
    }
}

/// `a.b.c` as one text.
pub(crate) fn dotted(expr: &Expr) -> Option<String> {
    match &expr.kind {
        ExprKind::Name(name) => Some(name.clone()),
        ExprKind::Field(base, field) => Some(format!("{}.{}", dotted(base)?, field.name)),
        _ => None,
    }
}
