//! Sequential function charts in their textual form (IEC 61131-3, tables 54 to 56).

use crate::diag::Problem;
use crate::syntax::ast::{Expr, ExprKind, Ident, Pou};
use crate::syntax::lexer::{Kw, Tok};
use crate::syntax::parser::{Parsed, Parser, Stop};
use crate::syntax::sfc::{Action, Association, Qualifier, Sfc, Step, Target, Transition};

impl Parser<'_> {
    /// Whether the body begins like a chart.
    pub fn at_sfc(&self) -> bool {
        let word = self.at_word("INITIAL_STEP") || self.at_word("STEP");
        word && self.peek_at(1) == Tok::Ident && self.peek_at(2) == Tok::Colon
    }

    pub fn sfc_body(&mut self, pou: &mut Pou) {
        let mut sfc = Sfc::default();
        let clean = self.problems.len();
        loop {
            let before = self.position();
            let result = if self.at(Tok::Semi) {
                self.advance();
                Ok(())
            } else if self.at_word("INITIAL_STEP") || self.at_word("STEP") {
                self.step().map(|step| sfc.steps.push(step))
            } else if self.at_word("TRANSITION") {
                self.transition(pou).map(|t| sfc.transitions.push(t))
            } else if self.at_word("ACTION") {
                self.action(pou).map(|action| sfc.actions.push(action))
            } else {
                break;
            };
            if result.is_err() {
                if self.position() == before {
                    self.advance();
                }
                self.recover(|kw| {
                    matches!(
                        kw,
                        Kw::EndStep
                            | Kw::EndTransition
                            | Kw::EndAction
                            | Kw::EndProgram
                            | Kw::EndFunctionBlock
                            | Kw::EndFunction
                    )
                });
                while matches!(
                    self.peek(),
                    Tok::Kw(Kw::EndStep | Kw::EndTransition | Kw::EndAction)
                ) {
                    self.advance();
                }
            }
        }
        if self.problems.len() == clean {
            let mut problems = Vec::new();
            sfc.lower(pou, &mut problems);
            problems.into_iter().for_each(|p| self.report(p));
        }
    }

    fn step(&mut self) -> Parsed<Step> {
        let initial = self.at_word("INITIAL_STEP");
        self.advance();
        let name = self.ident("the name of the step")?;
        self.expect(Tok::Colon, "`:` after the name of the step")?;
        let mut associations = Vec::new();
        while !self.eat_kw(Kw::EndStep) {
            if self.eat(Tok::Semi) {
                continue;
            }
            associations.push(self.association()?);
        }
        Ok(Step {
            name,
            initial,
            associations,
        })
    }

    /// `action(N);`, `action(D, T#1s, indicator);`
    fn association(&mut self) -> Parsed<Association> {
        let name = self.ident("the name of an action, or END_STEP")?;
        let mut expr = Expr {
            kind: ExprKind::Name(name.name.clone()),
            span: name.span,
        };
        while self.eat(Tok::Dot) {
            let field = self.ident("a field")?;
            expr = Expr {
                span: expr.span.to(field.span),
                kind: ExprKind::Field(Box::new(expr), field),
            };
        }
        let mut association = Association {
            qualifier: Qualifier::NonStored,
            time: None,
            span: expr.span,
            action: Target::Named(expr),
        };
        if self.eat(Tok::LParen) {
            let qualifier = self.ident("a qualifier: N, R, S, L, D, P, P0, P1, SD, DS or SL")?;
            let Some(known) = Qualifier::from_name(&qualifier.name) else {
                let message = format!("`{}` is no qualifier of an action", qualifier.name);
                self.report(
                    Problem::error("E708", qualifier.span, message)
                        .expected("N, R, S, L, D, P, P0, P1, SD, DS or SL"),
                );
                return Err(Stop);
            };
            association.qualifier = known;
            let mut first = true;
            while self.eat(Tok::Comma) {
                let value = self.expression()?;
                // Behind the time stand indicator variables, which only a display uses.
                if first && known.needs_time() {
                    association.time = Some(value);
                }
                first = false;
            }
            self.expect(Tok::RParen, "`)` after the qualifier")?;
        }
        self.expect_semi("the action block")?;
        Ok(association)
    }

    fn step_names(&mut self) -> Parsed<Vec<Ident>> {
        if !self.eat(Tok::LParen) {
            return Ok(vec![self.ident("the name of a step")?]);
        }
        let mut names = vec![self.ident("the name of a step")?];
        while self.eat(Tok::Comma) {
            names.push(self.ident("the name of a step")?);
        }
        self.expect(Tok::RParen, "`)` or `,` after the step")?;
        Ok(names)
    }

    /// `TRANSITION name (PRIORITY := 1) FROM a TO (b, c) := condition; END_TRANSITION`
    fn transition(&mut self, pou: &mut Pou) -> Parsed<Transition> {
        let start = self.advance().span;
        if self.at(Tok::Ident) && !self.at_word("FROM") {
            self.advance();
        }
        let mut priority = None;
        if self.eat(Tok::LParen) {
            if !self.eat_word("PRIORITY") {
                return Err(self.unexpected("PRIORITY := number"));
            }
            self.expect(Tok::Assign, "`:=` and a number")?;
            let span = self.expect(Tok::Int, "a number")?;
            priority = self.text_of(span).parse().ok();
            self.expect(Tok::RParen, "`)` after the priority")?;
        }
        if !self.eat_word("FROM") {
            return Err(self.unexpected("FROM and the step before the transition"));
        }
        let from = self.step_names()?;
        self.expect(Tok::Kw(Kw::To), "TO and the step after the transition")?;
        let to = self.step_names()?;
        let (before, condition) = if self.eat(Tok::Assign) {
            let condition = self.expression()?;
            self.expect_semi("the condition")?;
            (Vec::new(), condition)
        } else if self.eat(Tok::Colon) {
            self.il_condition(pou)?
        } else {
            return Err(self.unexpected("`:=` and the condition"));
        };
        let span = start.to(self.last_span());
        self.eat(Tok::Semi);
        self.expect(Tok::Kw(Kw::EndTransition), "END_TRANSITION")?;
        Ok(Transition {
            priority,
            from,
            to,
            before,
            condition,
            span,
        })
    }

    fn action(&mut self, pou: &mut Pou) -> Parsed<Action> {
        self.advance();
        let name = self.ident("the name of the action")?;
        self.eat(Tok::Colon);
        let body = if self.at_il() {
            self.il_statements(pou)
        } else {
            self.statements()
        };
        self.expect(Tok::Kw(Kw::EndAction), "END_ACTION, or a statement")?;
        Ok(Action { name, body })
    }
}
