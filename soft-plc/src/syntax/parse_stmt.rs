//! Statements (IEC 61131-3, clause 7.3.3).

use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{CaseLabel, Expr, ExprKind, ForLoop, Stmt, StmtKind};
use crate::syntax::lexer::{Kw, Tok};
use crate::syntax::parser::{Parsed, Parser, Stop};

/// Keywords at which a list of statements ends.
fn ends_statements(kw: Kw) -> bool {
    matches!(
        kw,
        Kw::EndIf
            | Kw::EndCase
            | Kw::EndFor
            | Kw::EndWhile
            | Kw::EndRepeat
            | Kw::Elsif
            | Kw::Else
            | Kw::Until
            | Kw::EndProgram
            | Kw::EndFunction
            | Kw::EndFunctionBlock
            | Kw::EndVar
            | Kw::EndType
            | Kw::EndStruct
            | Kw::Program
            | Kw::Function
            | Kw::FunctionBlock
            | Kw::Type
            | Kw::Configuration
            | Kw::EndConfiguration
            | Kw::EndResource
            | Kw::EndStep
            | Kw::EndTransition
            | Kw::EndAction
            | Kw::EndMethod
            | Kw::EndInterface
            | Kw::EndNamespace
            | Kw::EndClass
    )
}

pub(super) fn starts_statement(kw: Kw) -> bool {
    matches!(
        kw,
        Kw::If | Kw::Case | Kw::For | Kw::While | Kw::Repeat | Kw::Exit | Kw::Continue | Kw::Return
    )
}

impl Parser<'_> {
    /// Statements up to a keyword that ends the list, or to the next label of a CASE when `in_case`.
    pub fn statements(&mut self) -> Vec<Stmt> {
        self.statement_list(false)
    }

    fn statement_list(&mut self, in_case: bool) -> Vec<Stmt> {
        let mut list = Vec::new();
        loop {
            self.mend_keyword();
            match self.peek() {
                Tok::Eof => return list,
                Tok::Kw(kw) if ends_statements(kw) => return list,
                Tok::Semi => {
                    self.advance();
                    continue;
                }
                _ => {}
            }
            if in_case && self.at_case_label() {
                return list;
            }
            if self.at_word("METHOD") && self.peek_at(1) == Tok::Ident {
                return list;
            }
            let before = self.position();
            match self.deeper(Self::statement) {
                Ok(stmt) => list.push(stmt),
                Err(Stop) => {
                    if self.position() == before {
                        self.advance();
                    }
                    self.recover(|kw| ends_statements(kw) || starts_statement(kw));
                }
            }
        }
    }

    fn at_case_label(&self) -> bool {
        match self.peek() {
            Tok::Int | Tok::Based | Tok::TypePrefix | Tok::Minus | Tok::Plus => true,
            Tok::Kw(Kw::True | Kw::False) => true,
            Tok::Ident => {
                matches!(
                    self.peek_at(1),
                    Tok::Colon | Tok::Comma | Tok::DotDot | Tok::Plus | Tok::Minus | Tok::Star
                ) || self.at_qualified_label()
            }
            Tok::Str | Tok::WStr => true,
            _ => false,
        }
    }

    /// `Color.Red:` or `Color.Red,`, as CODESYS writes labels; `Space.Color#Red:`.
    fn at_qualified_label(&self) -> bool {
        let mut at = 1;
        while self.peek_at(at) == Tok::Dot && self.peek_at(at + 1) == Tok::Ident {
            at += 2;
        }
        let labelled = matches!(self.peek_at(at), Tok::Colon | Tok::Comma | Tok::DotDot);
        (at > 1 && labelled)
            || (self.peek_at(at) == Tok::Dot && self.peek_at(at + 1) == Tok::TypePrefix)
    }

    fn statement(&mut self) -> Parsed<Stmt> {
        let start = self.span();
        let kind = match self.peek() {
            Tok::Kw(Kw::If) => self.if_statement(start)?,
            Tok::Kw(Kw::Case) => self.case_statement(start)?,
            Tok::Kw(Kw::For) => self.for_statement(start)?,
            Tok::Kw(Kw::While) => {
                self.advance();
                let condition =
                    self.header(Kw::Do, "DO after the condition of WHILE, or an operator");
                let body = self.statements();
                self.close(Kw::EndWhile, "WHILE", start)?;
                StmtKind::While(condition, body)
            }
            Tok::Kw(Kw::Repeat) => {
                self.advance();
                let body = self.statements();
                self.close(Kw::Until, "REPEAT", start)?;
                let condition = self.expression()?;
                self.eat(Tok::Semi);
                self.close(Kw::EndRepeat, "REPEAT", start)?;
                StmtKind::Repeat(body, condition)
            }
            Tok::Kw(kw @ (Kw::Exit | Kw::Continue | Kw::Return)) => {
                self.advance();
                self.expect_semi(kw.text())?;
                let kind = match kw {
                    Kw::Exit => StmtKind::Exit,
                    Kw::Continue => StmtKind::Continue,
                    _ => StmtKind::Return,
                };
                return Ok(Stmt { kind, span: start });
            }
            Tok::Kw(kw) if kw.text().starts_with("VAR") => {
                let problem = Problem::error(
                    "E115",
                    start,
                    format!("{} cannot stand after the first statement", kw.text()),
                )
                .hint("declare all variables before the statements");
                self.report(problem);
                return Err(Stop);
            }
            _ => return self.simple_statement(start),
        };
        let span = start.to(self.last_span());
        self.eat(Tok::Semi);
        Ok(Stmt { kind, span })
    }

    /// An assignment or a call.
    fn simple_statement(&mut self, start: Span) -> Parsed<Stmt> {
        let target = match self.peek() {
            Tok::Ident | Tok::Direct => self.postfix()?,
            _ => return Err(self.unexpected("a statement")),
        };
        let kind = match self.peek() {
            Tok::Assign => {
                self.advance();
                let value = self.expression()?;
                if self.at(Tok::Assign) {
                    let span = self.span();
                    self.report(
                        Problem::error(
                            "E116",
                            span,
                            "only one assignment can stand in a statement",
                        )
                        .hint("write one statement for each variable"),
                    );
                    return Err(Stop);
                }
                StmtKind::Assign(target, value)
            }
            Tok::Eq => {
                let span = self.span();
                self.report(
                    Problem::error("E117", span, "`=` compares and does not assign")
                        .expected("`:=`"),
                );
                return Err(Stop);
            }
            Tok::TryAssign => {
                self.advance();
                let value = self.expression()?;
                StmtKind::TryAssign(target, value)
            }
            _ if matches!(target.kind, ExprKind::Call(..)) => StmtKind::Call(target),
            _ => {
                return Err(
                    self.unexpected("`:=` to assign a value, or `(` to call a function block")
                );
            }
        };
        let span = start.to(self.last_span());
        let what = match kind {
            StmtKind::Assign(..) => "the assignment",
            _ => "the call",
        };
        self.expect_semi(what)?;
        Ok(Stmt { kind, span })
    }

    /// The expression between a statement's keyword and `kw`. After a mistake reading goes on behind `kw`, so that the
    /// statement's own end is still found.
    fn header(&mut self, kw: Kw, wanted: &str) -> Expr {
        let start = self.span();
        let expr = self.expression();
        if expr.is_err() || self.expect_word(kw, wanted).is_err() {
            self.recover(|found| found == kw || ends_statements(found) || starts_statement(found));
            self.eat_kw(kw);
        }
        expr.unwrap_or(Expr {
            kind: ExprKind::Bool(true),
            span: start,
        })
    }

    /// The keyword that closes a statement opened at `opener`.
    fn close(&mut self, kw: Kw, what: &str, opener: Span) -> Parsed<()> {
        self.close_with(kw, what, opener, None)
    }

    fn close_with(&mut self, kw: Kw, what: &str, opener: Span, hint: Option<&str>) -> Parsed<()> {
        if self.eat_kw(kw) {
            return Ok(());
        }
        let found = self.peek().describe();
        let opener = Span {
            end: opener.start + what.len() as u32,
            ..opener
        };
        let problem = Problem::error(
            "E118",
            opener,
            format!(
                "this {what} is not closed: {found} stands where its {} should",
                kw.text()
            ),
        )
        .expected(kw.text());
        self.report(match hint {
            Some(hint) => problem.hint(hint),
            None => problem,
        });
        Err(Stop)
    }

    fn if_statement(&mut self, start: Span) -> Parsed<StmtKind> {
        self.advance();
        let mut branches = Vec::new();
        let mut otherwise = Vec::new();
        loop {
            let condition = self.header(Kw::Then, "THEN after the condition of IF, or an operator");
            branches.push((condition, self.statements()));
            if self.eat_kw(Kw::Elsif) {
                continue;
            }
            let mut hint = None;
            if self.eat_kw(Kw::Else) {
                hint = self.at_kw(Kw::If).then_some(
                    "ELSE IF begins an IF of its own, with an END_IF of its own: write ELSIF",
                );
                otherwise = self.statements();
            }
            self.close_with(Kw::EndIf, "IF", start, hint)?;
            return Ok(StmtKind::If(branches, otherwise));
        }
    }

    fn case_statement(&mut self, start: Span) -> Parsed<StmtKind> {
        self.advance();
        let selector = self.header(Kw::Of, "OF after the selector of CASE, or an operator");
        let mut branches = Vec::new();
        let mut otherwise = None;
        loop {
            if self.eat_kw(Kw::Else) {
                self.eat(Tok::Colon);
                otherwise = Some(self.statements());
                break;
            }
            if matches!(self.peek(), Tok::Kw(_) | Tok::Eof)
                && !matches!(self.peek(), Tok::Kw(Kw::True | Kw::False))
            {
                break;
            }
            let before = self.position();
            match self.case_labels() {
                Ok(labels) => branches.push((labels, self.statement_list(true))),
                Err(Stop) => {
                    if self.position() == before {
                        self.advance();
                    }
                    self.recover(ends_statements);
                }
            }
        }
        self.close(Kw::EndCase, "CASE", start)?;
        Ok(StmtKind::Case(selector, branches, otherwise))
    }

    fn case_labels(&mut self) -> Parsed<Vec<CaseLabel>> {
        let mut labels = vec![self.case_label()?];
        while self.eat(Tok::Comma) {
            labels.push(self.case_label()?);
        }
        self.expect(Tok::Colon, "`:` or `,` after the label of CASE")?;
        Ok(labels)
    }

    fn case_label(&mut self) -> Parsed<CaseLabel> {
        let from: Expr = self.expression()?;
        if self.eat(Tok::DotDot) {
            return Ok(CaseLabel::Range(from, self.expression()?));
        }
        Ok(CaseLabel::Single(from))
    }

    fn for_statement(&mut self, start: Span) -> Parsed<StmtKind> {
        self.advance();
        let Ok((var, from, to, by)) = self.for_header() else {
            // Reads the body all the same, so that END_FOR finds its FOR.
            self.recover(|kw| kw == Kw::Do || ends_statements(kw) || starts_statement(kw));
            self.eat_kw(Kw::Do);
            self.statements();
            self.close(Kw::EndFor, "FOR", start)?;
            return Ok(StmtKind::Empty);
        };
        let body = self.statements();
        self.close(Kw::EndFor, "FOR", start)?;
        Ok(StmtKind::For(Box::new(ForLoop {
            var,
            from,
            to,
            by,
            body,
        })))
    }

    fn for_header(&mut self) -> Parsed<(Expr, Expr, Expr, Option<Expr>)> {
        let var = self.postfix()?;
        self.expect(Tok::Assign, "`:=` and the first value of the FOR variable")?;
        let from = self.expression()?;
        self.expect(Tok::Kw(Kw::To), "TO and the last value")?;
        let to = self.expression()?;
        let by = if self.eat_kw(Kw::By) {
            Some(self.expression()?)
        } else {
            None
        };
        self.expect_word(Kw::Do, "DO, or BY and the step")?;
        Ok((var, from, to, by))
    }
}
