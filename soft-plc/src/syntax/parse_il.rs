//! Instruction lists (IEC 61131-3, clause 7.2), read into the same statements as Structured Text.
//!
//! The current result becomes an expression that grows with each instruction; where it is stored or decides something, it
//! goes through a temporary variable first, so that later changes of its operands do not change it.

use std::collections::BTreeSet;

use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{Arg, BinOp, Expr, ExprKind, Pou, Stmt, StmtKind, UnOp, VarSection};
use crate::syntax::build::{At, block, jump, with_jumps};
use crate::syntax::lexer::{Kw, Tok};
use crate::syntax::parser::{Parsed, Parser, Stop, parse_in};

/// Operators that begin an instruction list, to tell it from Structured Text.
const OPENERS: [&str; 9] = [
    "LD", "LDN", "CAL", "CALC", "CALCN", "JMP", "JMPC", "JMPCN", "RET",
];
/// Inputs of standard function blocks that are operators: `CU counter`.
const FB_INPUTS: [&str; 8] = ["S1", "R1", "CLK", "CU", "CD", "PV", "IN", "PT"];

/// How many operations one expression may hold before it goes to a variable, and how deep parentheses may be nested.
const OPERATIONS_MAX: usize = 50;

struct Instruction {
    op: String,
    span: Span,
    /// `AND(`: the operation waits for its `)`.
    deferred: bool,
    operands: Vec<Arg>,
}

enum Item {
    Label(String, Span),
    Close(Span),
    Run(Instruction),
}

fn binary(op: &str) -> Option<(BinOp, bool)> {
    Some(match op {
        "AND" | "&" => (BinOp::And, false),
        "ANDN" | "&N" => (BinOp::And, true),
        "OR" => (BinOp::Or, false),
        "ORN" => (BinOp::Or, true),
        "XOR" => (BinOp::Xor, false),
        "XORN" => (BinOp::Xor, true),
        "ADD" => (BinOp::Add, false),
        "SUB" => (BinOp::Sub, false),
        "MUL" => (BinOp::Mul, false),
        "DIV" => (BinOp::Div, false),
        "MOD" => (BinOp::Mod, false),
        "GT" => (BinOp::Gt, false),
        "GE" => (BinOp::Ge, false),
        "EQ" => (BinOp::Eq, false),
        "NE" => (BinOp::Ne, false),
        "LE" => (BinOp::Le, false),
        "LT" => (BinOp::Lt, false),
        _ => return None,
    })
}

/// Reads the instruction list `text` that stands at byte `base` of its source, as the body of `pou`.
pub fn parse_il(source: u32, text: &str, base: usize, pou: &mut Pou) -> (Vec<Stmt>, Vec<Problem>) {
    let name = pou.name.name.clone();
    parse_in(source, text, base, &name, |parser| {
        parser.il_statements(pou)
    })
}

impl Parser<'_> {
    /// Whether the body begins like an instruction list.
    pub fn at_il(&self) -> bool {
        let first = if self.at(Tok::Ident) && self.peek_at(1) == Tok::Colon {
            2
        } else {
            0
        };
        if self.peek_at(first) != Tok::Ident {
            return false;
        }
        let span = self.span_at(first);
        let word = self.text_of(span);
        OPENERS.iter().any(|op| op.eq_ignore_ascii_case(word))
            && !matches!(
                self.peek_at(first + 1),
                Tok::Assign | Tok::Dot | Tok::LBracket | Tok::LParen | Tok::Semi | Tok::Caret
            )
    }

    pub fn il_body(&mut self, pou: &mut Pou) {
        pou.body = self.il_statements(pou);
    }

    pub fn il_statements(&mut self, pou: &mut Pou) -> Vec<Stmt> {
        let items = self.il_items();
        let span = self.span();
        let mut lowering = Lowering::new(pou, span);
        self.lower(&mut lowering, &items);
        if let Err(problem) = lowering.leave(span) {
            self.report(*problem);
        }
        lowering.finish(pou)
    }

    fn lower(&mut self, lowering: &mut Lowering, items: &[Item]) {
        for item in items {
            if let Err(problem) = lowering.item(item, items) {
                self.report(*problem);
            }
        }
        if let Err(problem) = lowering.closed("the list ends") {
            self.report(*problem);
        }
    }

    /// The condition of a transition: what is the current result at its end.
    pub fn il_condition(&mut self, pou: &mut Pou) -> Parsed<(Vec<Stmt>, Expr)> {
        let items = self.il_items();
        let span = self.span();
        let mut lowering = Lowering::new(pou, span);
        self.lower(&mut lowering, &items);
        let Some(result) = lowering.result.take() else {
            return Err(self.unexpected("an instruction such as LD that gives the condition"));
        };
        Ok((lowering.finish(pou), result))
    }

    fn same_line(&self) -> bool {
        let (end, start) = (self.last_span().end, self.span().start);
        let between = Span {
            start: end,
            end: start,
            ..self.span()
        };
        end <= start && !self.at(Tok::Eof) && !self.text_of(between).contains('\n')
    }

    fn il_items(&mut self) -> Vec<Item> {
        let mut items = Vec::new();
        loop {
            match self.peek() {
                Tok::Eof => return items,
                Tok::Kw(kw) if kw.text().starts_with("END_") => return items,
                Tok::Semi => {
                    self.advance();
                }
                Tok::RParen => items.push(Item::Close(self.advance().span)),
                Tok::Ident if self.peek_at(1) == Tok::Colon => {
                    let span = self.advance().span;
                    self.advance();
                    items.push(Item::Label(self.text_of(span).to_ascii_uppercase(), span));
                }
                _ => {
                    let before = self.position();
                    match self.instruction() {
                        Ok(instruction) => items.push(Item::Run(instruction)),
                        Err(Stop) => {
                            // Goes on with the next line.
                            if self.position() == before {
                                self.advance();
                            }
                            while self.same_line() {
                                self.advance();
                            }
                        }
                    }
                }
            }
        }
    }

    fn instruction(&mut self) -> Parsed<Instruction> {
        let span = self.span();
        match self.peek() {
            Tok::Ident | Tok::Amp | Tok::Kw(Kw::And | Kw::Or | Kw::Xor | Kw::Mod | Kw::Not) => {}
            _ => return Err(self.unexpected("an operator such as LD, AND or ST")),
        }
        self.advance();
        let op = self.text_of(span).to_ascii_uppercase();
        let mut instruction = Instruction {
            span,
            deferred: false,
            operands: Vec::new(),
            op,
        };
        let op = instruction.op.as_str();
        if binary(op).is_some() && self.at(Tok::LParen) && self.same_line() {
            self.advance();
            instruction.deferred = true;
            if self.same_line() {
                instruction.operands.push(self.il_operand()?);
            }
            return Ok(instruction);
        }
        if self.at(Tok::LParen) && self.same_line() {
            instruction.operands = self.arguments()?;
            return Ok(instruction);
        }
        if self.same_line() && !self.at(Tok::Semi) {
            instruction.operands.push(self.il_operand()?);
            while self.eat(Tok::Comma) {
                instruction.operands.push(self.il_operand()?);
            }
        }
        Ok(instruction)
    }

    fn il_operand(&mut self) -> Parsed<Arg> {
        let start = self.span();
        let negative = self.eat(Tok::Minus);
        let mut value = self.postfix()?;
        if negative {
            let span = start.to(value.span);
            let kind = match value.kind {
                ExprKind::Int(v) => ExprKind::Int(-v),
                ExprKind::Real(v) => ExprKind::Real(-v),
                _ => ExprKind::Unary(UnOp::Neg, Box::new(value)),
            };
            value = Expr { kind, span };
        }
        Ok(Arg {
            name: None,
            output: false,
            negated: false,
            value: Some(value),
        })
    }
}

/// Whether what follows the label begins with the current result of before.
fn needs_result(items: &[Item], label: usize) -> bool {
    let index_of = |number: usize| {
        let labels = items.iter().enumerate();
        labels
            .filter(|(_, i)| matches!(i, Item::Label(..)))
            .nth(number)
            .map(|(index, _)| index)
    };
    let number_of = |name: &str| {
        let mut labels = items.iter().filter_map(|i| match i {
            Item::Label(label, _) => Some(label),
            _ => None,
        });
        labels.position(|label| label.eq_ignore_ascii_case(name))
    };
    let mut seen = BTreeSet::new();
    let mut at = index_of(label);
    while let Some(index) = at {
        if !seen.insert(index) {
            return false;
        }
        at = match items.get(index) {
            None => return false,
            Some(Item::Close(_)) => return true,
            Some(Item::Label(..)) => Some(index + 1),
            Some(Item::Run(instruction)) => {
                let target = instruction.operands.first().and_then(|a| a.value.as_ref());
                match (instruction.op.as_str(), target.map(|t| &t.kind)) {
                    ("LD" | "LDN" | "RET", _) => return false,
                    ("CAL", _) => Some(index + 1),
                    ("JMP", Some(ExprKind::Name(name))) => number_of(name).and_then(index_of),
                    // A function that names its arguments.
                    (_, _) if instruction.operands.iter().any(|a| a.name.is_some()) => {
                        return false;
                    }
                    _ => return true,
                }
            }
        };
    }
    false
}

struct Lowering {
    segments: Vec<Vec<Stmt>>,
    result: Option<Expr>,
    /// Operations that wait for their `)`.
    waiting: Vec<(BinOp, bool, Option<Expr>, Span)>,
    wires: Vec<String>,
    /// Operations in the current result.
    operations: usize,
    /// Makes names of temporaries unique in the POU.
    tag: usize,
    jumps: bool,
    /// Whether the next instruction is reached from the last one.
    reached: bool,
    /// Labels to which a current result is carried.
    carried: BTreeSet<usize>,
    at: At,
}

impl Lowering {
    fn new(pou: &Pou, span: Span) -> Self {
        Self {
            segments: vec![Vec::new()],
            result: None,
            waiting: Vec::new(),
            wires: Vec::new(),
            operations: 0,
            tag: pou.vars.len(),
            jumps: false,
            reached: true,
            carried: BTreeSet::new(),
            at: At(span),
        }
    }

    fn pc(&self) -> String {
        format!("__pc{}", self.tag)
    }

    fn emit(&mut self, stmt: Stmt) {
        if let Some(last) = self.segments.last_mut() {
            last.push(stmt);
        }
    }

    fn current(&mut self, span: Span) -> Result<Expr, Box<Problem>> {
        self.result.clone().ok_or_else(|| {
            Box::new(
                Problem::error("E710", span, "there is no current result here")
                    .hint("begin with LD; a label has the result of before only if every way to it has one"),
            )
        })
    }

    /// The current result in a variable of its own.
    fn settled(&mut self, span: Span) -> Result<Expr, Box<Problem>> {
        let value = self.current(span)?;
        let is_wire = matches!(&value.kind, ExprKind::Name(n) if n.starts_with("__il"));
        let literal = matches!(
            value.kind,
            ExprKind::Int(_)
                | ExprKind::Real(_)
                | ExprKind::Bool(_)
                | ExprKind::Time(_)
                | ExprKind::Date(..)
                | ExprKind::Str(_)
                | ExprKind::WStr(_)
                | ExprKind::Typed(..)
        );
        if is_wire || literal {
            return Ok(value);
        }
        let name = format!("__il{}_{}", self.tag, self.wires.len());
        let at = At(value.span);
        self.emit(at.assign(at.name(&name), value));
        let wire = at.name(&name);
        self.wires.push(name);
        self.result = Some(wire.clone());
        Ok(wire)
    }

    /// The current result ends here, whether or not anything has used it: it is evaluated all the same.
    fn leave(&mut self, span: Span) -> Result<(), Box<Problem>> {
        if self.result.is_some() {
            self.settled(span)?;
            self.result = None;
        }
        Ok(())
    }

    /// An error if parentheses are open where they cannot be.
    fn closed(&mut self, here: &str) -> Result<(), Box<Problem>> {
        let Some((.., at)) = self.waiting.pop() else {
            return Ok(());
        };
        self.waiting.clear();
        Problem::error("E712", at, format!("`(` is still open where {here}"))
            .expected("a `)` in a line of its own")
            .fail()
    }

    /// The variable in which the current result reaches a label.
    fn label_wire(&self, label: usize) -> String {
        format!("__il{}_at{label}", self.tag)
    }

    fn carry(&mut self, label: usize, value: Expr, span: Span) -> Stmt {
        let (wire, at) = (self.label_wire(label), At(span));
        if self.carried.insert(label) {
            self.wires.push(wire.clone());
        }
        at.assign(at.name(&wire), value)
    }

    /// At a label: the current result is that of the way by which it was reached, if each way has one.
    fn arrive(&mut self, label: usize, needed: bool, span: Span) {
        let before = self.result.take().filter(|_| needed);
        let known = match before {
            Some(value) if self.reached => {
                let stmt = self.carry(label, value, span);
                self.emit(stmt);
                true
            }
            _ => needed && !self.reached && self.carried.contains(&label),
        };
        self.segments.push(Vec::new());
        self.operations = 0;
        self.reached = true;
        if known {
            self.result = Some(At(span).name(&self.label_wire(label)));
        }
    }

    fn item(&mut self, item: &Item, all: &[Item]) -> Result<(), Box<Problem>> {
        match item {
            Item::Label(name, span) => {
                self.closed(&format!("the label `{name}` stands"))?;
                let same = all
                    .iter()
                    .filter(|i| matches!(i, Item::Label(other, _) if other == name))
                    .count();
                let number = self.segments.len() - 1;
                let needed = needs_result(all, number);
                if !needed {
                    self.leave(*span)?;
                }
                self.arrive(number, needed, *span);
                if same > 1 {
                    return Problem::error(
                        "E711",
                        *span,
                        format!("the label `{name}` stands twice"),
                    )
                    .fail();
                }
                Ok(())
            }
            Item::Close(span) => {
                let Some((op, negated, left, at)) = self.waiting.pop() else {
                    return Problem::error("E712", *span, "`)` closes nothing that is open").fail();
                };
                let mut right = self.current(*span)?;
                let at = At(at);
                if negated {
                    right = at.not(right);
                }
                let Some(left) = left else {
                    return Problem::error("E710", *span, "there is no current result before `(`")
                        .fail();
                };
                self.result = Some(at.binary(op, left, right));
                Ok(())
            }
            Item::Run(instruction) => self.run(instruction, all),
        }
    }

    fn run(&mut self, instruction: &Instruction, all: &[Item]) -> Result<(), Box<Problem>> {
        let span = instruction.span;
        self.operations += 1 + instruction.operands.len();
        if self.operations > OPERATIONS_MAX {
            self.operations = 0;
            if self.result.is_some() {
                self.settled(span)?;
            }
        }
        let at = At(span);
        let op = instruction.op.as_str();
        let operand = || -> Result<Expr, Box<Problem>> {
            instruction
                .operands
                .first()
                .and_then(|a| a.value.clone())
                .ok_or_else(|| {
                    Box::new(Problem::error(
                        "E713",
                        span,
                        format!("{op} needs an operand"),
                    ))
                })
        };
        if let Some((op, negated)) = binary(op) {
            if instruction.deferred {
                if self.waiting.len() >= OPERATIONS_MAX {
                    return Problem::error("E113", span, "these parentheses are nested too deeply")
                        .fail();
                }
                let left = Some(self.settled(span)?);
                self.waiting.push((op, negated, left, span));
                self.result = instruction.operands.first().and_then(|a| a.value.clone());
                return Ok(());
            }
            let mut value = operand()?;
            let span = span.to(value.span);
            if negated {
                value = at.not(value);
            }
            let mut result = At(span).binary(op, self.current(span)?, value);
            for more in instruction.operands.iter().skip(1) {
                if let Some(value) = &more.value {
                    result = At(span).binary(op, result, value.clone());
                }
            }
            self.result = Some(result);
            return Ok(());
        }
        match op {
            "LD" | "LDN" => {
                let value = operand()?;
                self.leave(span)?;
                self.result = Some(if op == "LD" { value } else { at.not(value) });
            }
            "NOT" => self.result = Some(at.not(self.current(span)?)),
            "ST" | "STN" => {
                let target = operand()?;
                let mut value = self.settled(span)?;
                if op == "STN" {
                    value = at.not(value);
                }
                self.emit(At(span.to(target.span)).assign(target, value));
            }
            "S" | "R"
                if !matches!(
                    operand(),
                    Ok(Expr {
                        kind: ExprKind::Call(..),
                        ..
                    })
                ) =>
            {
                let target = operand()?;
                let condition = self.settled(span)?;
                self.emit(at.if_then(condition, vec![at.assign(target, at.bool(op == "S"))]));
            }
            "JMP" | "JMPC" | "JMPCN" => {
                self.closed("the jump stands")?;
                let target = operand()?;
                let ExprKind::Name(name) = &target.kind else {
                    return Problem::error("E711", target.span, "a jump leads to a label").fail();
                };
                let number = all
                    .iter()
                    .filter_map(|i| match i {
                        Item::Label(label, _) => Some(label),
                        _ => None,
                    })
                    .position(|label| label.eq_ignore_ascii_case(name));
                let Some(number) = number else {
                    let message = format!("there is no label `{name}`");
                    return Problem::error("E711", target.span, message).fail();
                };
                self.jumps = true;
                let mut steps = jump(at, &self.pc(), number + 1);
                if needs_result(all, number) {
                    let value = self.settled(span)?;
                    steps.insert(0, self.carry(number, value, span));
                }
                self.conditional(op, "JMP", span, steps)?;
                self.reached = op != "JMP";
            }
            "RET" | "RETC" | "RETCN" => {
                self.closed("the list returns")?;
                let steps = vec![at.stmt(StmtKind::Return)];
                self.conditional(op, "RET", span, steps)?;
                self.reached = op != "RET";
            }
            "CAL" | "CALC" | "CALCN" => {
                let target = operand()?;
                let call = match target.kind {
                    ExprKind::Call(..) => target,
                    _ => At(target.span).call(target, Vec::new()),
                };
                let call = At(call.span).stmt(StmtKind::Call(call));
                self.conditional(op, "CAL", span, vec![call])?;
            }
            _ if FB_INPUTS.contains(&op) && instruction.operands.len() == 1 => {
                let instance = operand()?;
                let value = self.settled(span)?;
                let call = at.invoke(instance, vec![at.input(op, value)]);
                self.emit(call);
            }
            _ => {
                let formal = instruction.operands.iter().any(|a| a.name.is_some());
                let mut args = instruction.operands.clone();
                if formal {
                    self.leave(span)?;
                } else {
                    let first = Arg {
                        name: None,
                        output: false,
                        negated: false,
                        value: Some(self.current(span)?),
                    };
                    args.insert(0, first);
                }
                self.result = Some(at.call(at.name(&instruction.op), args));
            }
        }
        Ok(())
    }

    /// `JMPC`, `JMPCN` and their like: the steps run if the current result says so.
    fn conditional(
        &mut self,
        op: &str,
        plain: &str,
        span: Span,
        steps: Vec<Stmt>,
    ) -> Result<(), Box<Problem>> {
        if op == plain {
            if self.result.is_some() {
                self.settled(span)?;
            }
            steps.into_iter().for_each(|s| self.emit(s));
            return Ok(());
        }
        let at = At(span);
        let mut condition = self.settled(span)?;
        if op.ends_with("CN") {
            condition = at.not(condition);
        }
        self.emit(at.if_then(condition, steps));
        Ok(())
    }

    fn finish(mut self, pou: &mut Pou) -> Vec<Stmt> {
        let at = self.at;
        let mut decls: Vec<_> = self.wires.iter().map(|w| at.wire(w)).collect();
        let body = if self.jumps {
            decls.push(at.var(&self.pc(), "DINT"));
            let pc = self.pc();
            with_jumps(at, &pc, std::mem::take(&mut self.segments))
        } else {
            self.segments.concat()
        };
        if !decls.is_empty() {
            pou.vars.push(block(VarSection::Temp, decls));
        }
        body
    }
}
