//! Statements.

use fam_soft_plc::types::Elem;

use super::scope::Scope;
use super::types::{BITS, INTS};
use super::{Ty, World};
use crate::shrink::Piece;

/// Loops in loops.
const LOOPS_MAX: u32 = 2;

impl World {
    pub fn stmts(&mut self, scope: &mut Scope, count: i64, depth: u32) -> Vec<Piece> {
        let mut list = Vec::new();
        for _ in 0..count {
            self.stmt(scope, depth, &mut list);
        }
        list
    }

    fn stmt(&mut self, scope: &mut Scope, depth: u32, out: &mut Vec<Piece>) {
        let choice = if depth == 0 {
            self.random.below(9)
        } else {
            self.random.below(18)
        };
        match choice {
            0..=4 => self.assignment(scope, out),
            5 => self.invocation(scope, out),
            6 => self.call_statement(scope, out),
            7 => self.small(scope, out),
            8 => self.jump(scope, out),
            9..=11 => {
                self.note("IF");
                let condition = self.elem_expr(scope, Elem::Bool, 2);
                let mut inner = self.few(scope, depth);
                if self.random.chance(40) {
                    let other = self.elem_expr(scope, Elem::Bool, 1);
                    let body = self.few(scope, depth);
                    inner.push(Piece::block(format!("ELSIF {other} THEN"), body, ""));
                }
                if self.random.chance(50) {
                    let body = self.few(scope, depth);
                    inner.push(Piece::block("ELSE", body, ""));
                }
                out.push(Piece::block(
                    format!("IF {condition} THEN"),
                    inner,
                    "END_IF;",
                ));
            }
            12 | 13 => self.case(scope, depth, out),
            14 | 15 if scope.loops < LOOPS_MAX && scope.counters_used < scope.counters.len() => {
                self.for_loop(scope, depth, out);
            }
            _ if scope.loops < LOOPS_MAX && scope.counters_used < scope.counters.len() => {
                self.while_loop(scope, depth, out);
            }
            _ => self.assignment(scope, out),
        }
    }

    fn few(&mut self, scope: &mut Scope, depth: u32) -> Vec<Piece> {
        let count = self.random.within(1, 3);
        self.stmts(scope, count, depth - 1)
    }

    fn assignment(&mut self, scope: &mut Scope, out: &mut Vec<Piece>) {
        if self.random.chance(10)
            && let Some(copy) = self.copy_of_image(scope)
        {
            out.push(copy);
            return;
        }
        let target = self.place(scope, 2, |l| l.write && !matches!(l.ty, Ty::Block(_)));
        let Some((text, leaf)) = target else { return };
        self.note(match leaf.ty {
            Ty::El(_) => "assignment of a number",
            Ty::Str(..) => "assignment of a string",
            Ty::Enum(_) => "assignment of an enumerated value",
            Ty::Sub(_) => "assignment to a subrange",
            Ty::Struct(_) => "assignment of a structure",
            Ty::Array(..) => "assignment of an array",
            _ => "assignment of a reference",
        });
        let mut value = self.expr(scope, &leaf.ty, 3);
        if matches!(leaf.ty, Ty::Str(..)) && self.random.chance(25) {
            self.note("string made longer");
            value = format!("CONCAT({text}, {value}, {text})");
        }
        out.push(Piece::line(format!("{text} := {value};")));
    }

    /// Bits, parts, characters, and what lies behind references.
    fn small(&mut self, scope: &mut Scope, out: &mut Vec<Piece>) {
        match self.random.below(4) {
            0 | 1 => {
                let t = *self
                    .random
                    .one(&[BITS.as_slice(), INTS.as_slice()].concat());
                let Some((text, _)) = self.place(scope, 1, |l| l.write && l.ty == Ty::El(t)) else {
                    return;
                };
                self.note("assignment of a bit or part");
                let bits = t.bits() as usize;
                if t.is_bit() && bits > 8 && self.random.chance(40) {
                    let value = self.elem_expr(scope, Elem::Byte, 2);
                    let part = self.random.below(bits / 8);
                    out.push(Piece::line(format!("{text}.%B{part} := {value};")));
                } else {
                    let value = self.elem_expr(scope, Elem::Bool, 2);
                    let bit = self.random.below(bits);
                    out.push(Piece::line(format!("{text}.{bit} := {value};")));
                }
            }
            2 => {
                let Some((text, leaf)) =
                    self.place(scope, 0, |l| l.write && matches!(l.ty, Ty::Str(..)))
                else {
                    return;
                };
                self.note("assignment of a character");
                let Ty::Str(wide, len) = leaf.ty else { return };
                let at = self.random.within(1, i64::from(len.min(3)));
                let elem = if wide { Elem::Wchar } else { Elem::Char };
                let value = self.elem_expr(scope, elem, 1);
                let line = format!("{text}[{at}] := {value};");
                if self.risky && self.random.chance(30) {
                    out.push(Piece::line(line));
                } else {
                    out.push(Piece::block(
                        format!("IF LEN({text}) >= {at} THEN"),
                        vec![Piece::line(line)],
                        "END_IF;",
                    ));
                }
            }
            _ => {
                let Some((text, leaf)) =
                    self.place(scope, 0, |l| matches!(l.ty, Ty::Ref(_)) && !l.behind)
                else {
                    return;
                };
                let Ty::Ref(to) = leaf.ty else { return };
                if matches!(*to, Ty::Block(_)) {
                    return;
                }
                self.note("through a reference");
                let value = self.expr(scope, &to, 2);
                let line = Piece::line(format!("{text}^ := {value};"));
                out.push(Piece::block(
                    format!("IF {text} <> NULL THEN"),
                    vec![line],
                    "END_IF;",
                ));
            }
        }
    }

    /// EXIT, CONTINUE and RETURN under a condition.
    fn jump(&mut self, scope: &mut Scope, out: &mut Vec<Piece>) {
        let condition = self.elem_expr(scope, Elem::Bool, 2);
        let word = if scope.loops > 0 {
            *self
                .random
                .one(&["EXIT", "CONTINUE", "EXIT", "CONTINUE", "RETURN"])
        } else if self.random.chance(25) {
            "RETURN"
        } else {
            return self.assignment(scope, out);
        };
        self.note("EXIT, CONTINUE, RETURN");
        let line = Piece::line(format!("{word};"));
        out.push(Piece::block(
            format!("IF {condition} THEN"),
            vec![line],
            "END_IF;",
        ));
    }

    fn case(&mut self, scope: &mut Scope, depth: u32, out: &mut Vec<Piece>) {
        self.note("CASE");
        let mut branches = Vec::new();
        let selector;
        if self.random.chance(25) {
            let n = self.random.below(2);
            selector = self.expr(scope, &Ty::Enum(n), 1);
            for value in 0..3 {
                if self.random.chance(70) {
                    let label = format!("{}#{}", self.enums[n].name, self.enums[n].values[value]);
                    let body = self.few(scope, depth);
                    branches.push(Piece::block(format!("{label}:"), body, ""));
                }
            }
        } else {
            let all = [INTS.as_slice(), BITS.as_slice()].concat();
            let t = *self.random.one(&all);
            let value = self.elem_expr(scope, t, 1);
            selector = if t.is_int() && self.random.chance(50) {
                format!("({value} MOD {t}#7)")
            } else {
                value
            };
            let mut label = if t.is_signed() { -2 } else { 0 };
            for _ in 0..self.random.within(1, 6) {
                let text = match self.random.below(3) {
                    0 => format!("{label}..{}", label + 2),
                    1 => format!("{label}, {}", label + 2),
                    _ => label.to_string(),
                };
                label += 3;
                let body = self.few(scope, depth);
                branches.push(Piece::block(format!("{text}:"), body, ""));
            }
        }
        if self.random.chance(60) {
            let body = self.few(scope, depth);
            branches.push(Piece::block("ELSE", body, ""));
        }
        if branches.len() < 2 {
            return;
        }
        out.push(Piece::block(
            format!("CASE {selector} OF"),
            branches,
            "END_CASE;",
        ));
    }

    fn for_loop(&mut self, scope: &mut Scope, depth: u32, out: &mut Vec<Piece>) {
        self.note("FOR");
        // Counters are SINT, INT, USINT, UDINT in turn.
        let number = scope.counters_used;
        let name = scope.counters[number].clone();
        let t = COUNTER_TYPES[number % COUNTER_TYPES.len()];
        let (low, high) = crate::value::limits(t);
        if t.is_signed() && self.random.chance(30) && self.array_loop(scope, depth, &name, t, out) {
            return;
        }
        let (head, _) = match self.random.below(6) {
            0 => {
                self.note("FOR at the limit of its type");
                (format!("{} TO {high} BY 2", high - 5), ())
            }
            1 => (
                format!(
                    "{} TO {low} BY {}",
                    low + 4,
                    if t.is_signed() { "-1" } else { "1" }
                ),
                (),
            ),
            2 => {
                let from = self.elem_expr(scope, t, 1);
                let by = if self.random.chance(50) {
                    let step = self.elem_expr(scope, t, 1);
                    format!(" BY LIMIT({t}#1, {step}, {t}#5)")
                } else {
                    String::new()
                };
                (
                    format!(
                        "LIMIT({t}#0, {from}, {t}#10) TO LIMIT({t}#2, {}, {t}#12){by}",
                        self.variable(scope, t, 0)
                    ),
                    (),
                )
            }
            3 if t.is_signed() => (
                format!(
                    "{} TO {} BY -2",
                    self.random.within(0, 8),
                    self.random.within(-5, 3)
                ),
                (),
            ),
            4 => {
                self.note("FOR of many steps");
                let from = self.random.within(0, 9);
                let by = self.random.within(1, 3);
                (
                    format!("{from} TO {} BY {by}", from + self.random.within(7, 30)),
                    (),
                )
            }
            _ => (
                format!(
                    "{} TO {}",
                    self.random.within(0, 2),
                    self.random.within(0, 6)
                ),
                (),
            ),
        };
        self.counting(scope, (&name, t), head, out, |g, scope| {
            let mut body = g.few(scope, depth);
            // An element for each round.
            if t == Elem::Sint || t == Elem::Int {
                let arrays = |l: &super::scope::Leaf| {
                    l.write
                        && matches!(&l.ty, Ty::Array(_, dims) if dims.len() == 1 && dims[0].0 <= 0 && dims[0].1 >= 0)
                };
                if let Some((text, leaf)) = g.place(scope, 0, arrays)
                    && let Ty::Array(elem, dims) = leaf.ty
                    && !matches!(*elem, Ty::Array(..) | Ty::Struct(_))
                {
                    g.note("array in a loop");
                    let value = g.expr(scope, &elem, 2);
                    body.push(Piece::line(format!(
                        "{text}[LIMIT({t}#{}, {name}, {t}#{})] := {value};",
                        dims[0].0, dims[0].1
                    )));
                }
            }
            if g.random.chance(15) {
                body.push(g.long_case(scope, &name, t));
            }
            body
        });
    }

    /// A CASE with a branch for each of many values.
    fn long_case(&mut self, scope: &mut Scope, counter: &str, t: Elem) -> Piece {
        self.note("long CASE at the end of a loop");
        let values = self.random.within(7, 12);
        let branches = (0..values).map(|value| {
            let body = self.stmts(scope, 1, 0);
            Piece::block(format!("{value}:"), body, "")
        });
        let mut branches: Vec<Piece> = branches.collect();
        if self.random.chance(50) {
            let body = self.stmts(scope, 1, 0);
            branches.push(Piece::block("ELSE", body, ""));
        }
        let selector = format!("{counter} MOD {t}#{}", values + 1);
        Piece::block(format!("CASE {selector} OF"), branches, "END_CASE;")
    }

    /// A FOR loop over a counter that its body can read.
    fn counting(
        &mut self,
        scope: &mut Scope,
        (name, t): (&str, Elem),
        head: String,
        out: &mut Vec<Piece>,
        body: impl FnOnce(&mut Self, &mut Scope) -> Vec<Piece>,
    ) {
        scope.counters_used += 1;
        scope.loops += 1;
        let known = scope.leaves.len();
        self.enter(scope, name, &Ty::El(t), false, false);
        let body = body(self, scope);
        scope.leaves.truncate(known);
        scope.loops -= 1;
        scope.counters_used -= 1;
        out.push(Piece::block(
            format!("FOR {name} := {head} DO"),
            body,
            "END_FOR;",
        ));
    }

    /// A loop over all elements of an array, whose index is the counter plus a number, upwards or downwards. Answers whether there is an array.
    fn array_loop(
        &mut self,
        scope: &mut Scope,
        depth: u32,
        name: &str,
        t: Elem,
        out: &mut Vec<Piece>,
    ) -> bool {
        let arrays = |l: &super::scope::Leaf| {
            l.write && matches!(&l.ty, Ty::Array(_, dims) if dims.len() == 1)
        };
        let Some((text, leaf)) = self.place(scope, 0, arrays) else {
            return false;
        };
        let Ty::Array(elem, dims) = leaf.ty else {
            return false;
        };
        if !matches!(*elem, Ty::El(_)) {
            return false;
        }
        self.note("FOR over an array");
        let ahead = self.random.within(-3, 3);
        let (low, high) = (dims[0].0 - ahead, dims[0].1 - ahead);
        let head = match self.random.below(3) {
            0 => format!("{high} TO {low} BY -1"),
            1 => format!("{low} TO {high} BY 2"),
            _ => format!("{low} TO {high}"),
        };
        let index = match ahead {
            0 => name.to_owned(),
            n if n > 0 => format!("{name} + {n}"),
            n => format!("{name} - {}", -n),
        };
        self.counting(scope, (name, t), head, out, |g, scope| {
            g.enter(scope, &format!("{text}[{index}]"), &elem, true, false);
            let mut body = g.few(scope, depth);
            let value = g.expr(scope, &elem, 2);
            body.push(Piece::line(format!("{text}[{index}] := {value};")));
            body
        });
        true
    }

    fn while_loop(&mut self, scope: &mut Scope, depth: u32, out: &mut Vec<Piece>) {
        let number = scope.counters_used;
        let name = scope.counters[number].clone();
        let most = self.random.within(1, 5);
        scope.counters_used += 1;
        scope.loops += 1;
        let mut body = vec![Piece::line(format!("{name} := {name} + 1;"))];
        body.extend(self.few(scope, depth));
        let condition = self.elem_expr(scope, Elem::Bool, 1);
        scope.loops -= 1;
        scope.counters_used -= 1;
        out.push(Piece::line(format!("{name} := 0;")));
        if self.random.chance(50) {
            self.note("WHILE");
            out.push(Piece::block(
                format!("WHILE {name} < {most} AND ({condition} OR {name} < 1) DO"),
                body,
                "END_WHILE;",
            ));
        } else {
            self.note("REPEAT");
            out.push(Piece::block(
                "REPEAT",
                body,
                format!("UNTIL {name} >= {most} OR {condition} END_REPEAT;"),
            ));
        }
    }

    /// A function block instance is called.
    fn invocation(&mut self, scope: &mut Scope, out: &mut Vec<Piece>) {
        let Some((text, leaf)) = self.place(scope, 1, |l| matches!(l.ty, Ty::Block(_))) else {
            return self.assignment(scope, out);
        };
        let Ty::Block(n) = leaf.ty else { return };
        let mut callable = self.blocks[n].call.clone();
        self.note(if self.blocks[n].standard {
            "standard function block"
        } else {
            "function block"
        });
        // Inputs that are left out keep their values.
        let keep = self.random.within(0, callable.inputs.len() as i64) as usize;
        if self.random.chance(30) {
            callable.inputs.truncate(keep);
        }
        if let Some(call) = self.call_text(scope, &text, &callable, 2) {
            let call = self.enabled(scope, call, &text, 20);
            out.push(Piece::line(format!("{call};")));
        }
    }

    /// A function or method is called for its effects.
    fn call_statement(&mut self, scope: &mut Scope, out: &mut Vec<Piece>) {
        let mut list: Vec<_> = self.functions[..scope.functions]
            .iter()
            .map(|f| (f.name.clone(), f.clone()))
            .collect();
        list.extend(self.method_calls(scope));
        if list.is_empty() {
            return self.assignment(scope, out);
        }
        let (name, callable) = self.random.one(&list).clone();
        if let Some(call) = self.call_text(scope, &name, &callable, 2) {
            self.note("call as a statement");
            let call = self.enabled(scope, call, &name, 20);
            out.push(Piece::line(format!("{call};")));
        }
    }
}

pub const COUNTER_TYPES: [Elem; 4] = [Elem::Int, Elem::Sint, Elem::Usint, Elem::Udint];
