//! The interpreter: statements, calls, expressions and places of the typed tree.

use std::collections::BTreeMap;

use fam_soft_plc::TrapKind;
use fam_soft_plc::check::stdfun::{Signature, StdFun};
use fam_soft_plc::check::tree::{
    Argument, Branch, Expr, ExprKind, For, FunctionCall, Invocation, Limits, Place, PouId,
    Receiver, Root, StepKind, Stmt, StmtKind, TypedProject, VarId,
};
use fam_soft_plc::source::Span;
use fam_soft_plc::syntax::ast::{BinOp, PouKind, VarSection};
use fam_soft_plc::types::{Elem, TypeId, TypeKind};

use crate::memory::{Data, Memory, Node, NodeId, is_state};
use crate::text::{self, Units};
use crate::value::{self, Scalar};

/// Why a scan did not come to its end.
#[derive(Clone, Debug, PartialEq)]
pub enum Stop {
    Trap {
        kind: TrapKind,
        line: u32,
    },
    /// More statements than `STATEMENTS_MAX`: nothing is said about the program.
    TooLong,
    /// Something that the interpreter does not know.
    Unknown(&'static str),
}

/// Statements in one scan.
const STATEMENTS_MAX: u64 = 40_000;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Flow {
    On,
    Exit,
    Continue,
    Return,
}

type Run<T> = Result<T, Stop>;

/// A variable or a part of it.
#[derive(Clone, Copy, Debug)]
struct Spot {
    node: NodeId,
    part: Part,
}

#[derive(Clone, Copy, Debug)]
enum Part {
    Whole,
    /// Lowest bit, number of bits.
    Bits(u32, u32),
    /// Character, from 0.
    Char(usize),
}

/// A POU that is running.
#[derive(Default)]
struct Frame {
    this: Option<NodeId>,
    own: BTreeMap<VarId, NodeId>,
}

pub struct Machine<'p> {
    project: &'p TypedProject,
    pub memory: Memory<'p>,
    /// Variables of programs, global variables, constants.
    fixed: BTreeMap<VarId, NodeId>,
    time_ns: i64,
    statements: u64,
}

impl<'p> Machine<'p> {
    pub fn new(project: &'p TypedProject) -> Self {
        let mut memory = Memory::new(project);
        let mut fixed = BTreeMap::new();
        for index in 0..project.vars.len() as u32 {
            let id = VarId(index);
            let var = project.var(id);
            let lasting = match var.owner {
                None => true,
                Some(owner) => {
                    var.constant || (project.pou(owner).kind == PouKind::Program && is_state(var))
                }
            };
            if lasting {
                fixed.insert(id, memory.variable(var.ty, var.init.as_ref()));
            }
        }
        Self {
            project,
            memory,
            fixed,
            time_ns: 0,
            statements: 0,
        }
    }

    /// The node of a variable of a program, or of a global one.
    pub fn fixed(&self, var: VarId) -> Option<NodeId> {
        self.fixed.get(&var).copied()
    }

    /// One scan of the program.
    pub fn scan(&mut self, program: PouId, time_ns: i64) -> Run<()> {
        self.time_ns = time_ns;
        self.statements = 0;
        self.run_pou(program, None, BTreeMap::new()).map(|_| ())
    }

    fn trap<T>(&self, kind: TrapKind, span: Span) -> Run<T> {
        let line = self.project.sources.position(span).line;
        Err(Stop::Trap { kind, line })
    }

    fn or_trap<T>(&self, result: Result<T, TrapKind>, span: Span) -> Run<T> {
        result.or_else(|kind| self.trap(kind, span))
    }

    /// Runs the body of a program or function block; variables by reference are given.
    fn run_pou(
        &mut self,
        pou: PouId,
        this: Option<NodeId>,
        own: BTreeMap<VarId, NodeId>,
    ) -> Run<Flow> {
        let mark = self.memory.mark();
        let mut frame = Frame { this, own };
        for id in &self.project.pou(pou).vars {
            let var = self.project.var(*id);
            if var.section == VarSection::Temp {
                let node = self.memory.variable(var.ty, var.init.as_ref());
                frame.own.insert(*id, node);
            }
        }
        let flow = self.stmts(self.project.body(pou), &mut frame);
        self.memory.forget(mark);
        flow
    }

    fn stmts(&mut self, list: &[Stmt], frame: &mut Frame) -> Run<Flow> {
        for stmt in list {
            let flow = self.stmt(stmt, frame)?;
            if flow != Flow::On {
                return Ok(flow);
            }
        }
        Ok(Flow::On)
    }

    fn count(&mut self) -> Run<()> {
        self.statements += 1;
        if self.statements > STATEMENTS_MAX {
            return Err(Stop::TooLong);
        }
        Ok(())
    }

    fn stmt(&mut self, stmt: &Stmt, frame: &mut Frame) -> Run<Flow> {
        self.count()?;
        match &stmt.kind {
            StmtKind::Assign(place, value) => {
                let spot = self.spot(place, frame)?;
                let data = self.data(value, frame)?;
                self.store(spot, &data);
            }
            StmtKind::Call(call) => {
                self.function_call(call, frame)?;
            }
            StmtKind::Invoke(call) => self.invoke(call, frame)?,
            StmtKind::If(branches, otherwise) => {
                for (condition, body) in branches {
                    if self.scalar(condition, frame)?.is_true() {
                        return self.stmts(body, frame);
                    }
                }
                return self.stmts(otherwise, frame);
            }
            StmtKind::Case {
                selector,
                branches,
                otherwise,
            } => {
                return self.case(selector, branches, otherwise, frame);
            }
            StmtKind::For(data) => return self.for_loop(data, frame),
            StmtKind::While(condition, body) => {
                while self.scalar(condition, frame)?.is_true() {
                    self.count()?;
                    match self.stmts(body, frame)? {
                        Flow::Exit => break,
                        Flow::Return => return Ok(Flow::Return),
                        Flow::On | Flow::Continue => {}
                    }
                }
            }
            StmtKind::Repeat(body, until) => loop {
                self.count()?;
                match self.stmts(body, frame)? {
                    Flow::Exit => break,
                    Flow::Return => return Ok(Flow::Return),
                    Flow::On | Flow::Continue => {}
                }
                if self.scalar(until, frame)?.is_true() {
                    break;
                }
            },
            StmtKind::Exit => return Ok(Flow::Exit),
            StmtKind::Continue => return Ok(Flow::Continue),
            StmtKind::Return => return Ok(Flow::Return),
            StmtKind::Block(body) => {
                return Ok(match self.stmts(body, frame)? {
                    Flow::Return => Flow::On,
                    flow => flow,
                });
            }
            StmtKind::CopyRegion { .. } => return Err(Stop::Unknown("regions")),
        }
        Ok(Flow::On)
    }

    fn case(
        &mut self,
        selector: &Expr,
        branches: &[Branch],
        otherwise: &[Stmt],
        frame: &mut Frame,
    ) -> Run<Flow> {
        let elem = self.elem(selector.ty);
        let value = self.scalar(selector, frame)?.int();
        for (ranges, body) in branches {
            let hit = ranges.iter().any(|(low, high)| {
                let label = |v: i64| value::wrap(elem, v.into());
                (label(*low)..=label(*high)).contains(&value)
            });
            if hit {
                return self.stmts(body, frame);
            }
        }
        self.stmts(otherwise, frame)
    }

    fn for_loop(&mut self, data: &For, frame: &mut Frame) -> Run<Flow> {
        let elem = self.elem(data.var.ty);
        let (_, largest) = value::limits(elem);
        let (smallest, _) = value::limits(elem);
        let spot = self.spot(&data.var, frame)?;
        let from = self.scalar(&data.from, frame)?;
        self.store(spot, &Data::Scalar(from));
        let to = self.scalar(&data.to, frame)?.int();
        let by = self.scalar(&data.by, frame)?.int();
        loop {
            self.count()?;
            let spot = self.spot(&data.var, frame)?;
            let now = self.load(spot).int();
            if (by >= 0 && now > to) || (by < 0 && now < to) {
                return Ok(Flow::On);
            }
            if let TypeKind::Subrange { lo, hi, .. } = self.project.types.kind(data.var.ty)
                && !(*lo..=*hi).contains(&now)
            {
                return self.trap(TrapKind::Range, data.var.span);
            }
            match self.stmts(&data.body, frame)? {
                Flow::Exit => return Ok(Flow::On),
                Flow::Return => return Ok(Flow::Return),
                Flow::On | Flow::Continue => {}
            }
            let spot = self.spot(&data.var, frame)?;
            let next = self.load(spot).int() + by;
            self.store(spot, &Data::Scalar(Scalar::Int(value::wrap(elem, next))));
            if next > largest || next < smallest {
                return Ok(Flow::On);
            }
        }
    }

    // Calls.

    /// The node that a VAR_IN_OUT stands for while the call runs, and where its value goes back to if it was copied.
    fn by_reference(&mut self, place: &Place, frame: &mut Frame) -> Run<(NodeId, Option<Spot>)> {
        let spot = self.spot(place, frame)?;
        // Parts of cells are copied in and out.
        let element = matches!(
            place.steps.last().map(|s| &s.kind),
            Some(StepKind::Index(_))
        );
        let narrow = self
            .project
            .types
            .elem(place.ty)
            .is_some_and(|e| value::limits(e).1 < 256);
        let copied = !matches!(spot.part, Part::Whole) || (element && narrow);
        if !copied {
            return Ok((spot.node, None));
        }
        Ok((self.memory.variable(place.ty, None), Some(spot)))
    }

    /// Just before the call, when all arguments have been evaluated.
    fn copy_in(&mut self, copies: &[(NodeId, Spot)]) {
        for (node, spot) in copies {
            let value = self.load(*spot);
            self.memory.set(*node, value);
        }
    }

    fn bring_back(&mut self, copies: &[(NodeId, Spot)]) {
        for (node, spot) in copies {
            let value = self.memory.scalar(*node);
            self.store(*spot, &Data::Scalar(value));
        }
    }

    /// Stores an output; numbers widen on the way.
    fn store_output(
        &mut self,
        from: TypeId,
        target: &Place,
        value: Data,
        negated: bool,
        spot: Spot,
    ) -> Run<()> {
        let data = match value {
            Data::Scalar(scalar) => {
                let (from, to) = (self.elem(from), self.elem(target.ty));
                let scalar = if negated {
                    Scalar::Int(1 - scalar.int())
                } else {
                    scalar
                };
                Data::Scalar(self.or_trap(value::convert(from, to, scalar), target.span)?)
            }
            other => other,
        };
        self.store(spot, &data);
        Ok(())
    }

    fn invoke(&mut self, call: &Invocation, frame: &mut Frame) -> Run<()> {
        let mark = self.memory.mark();
        let this = match &call.instance {
            Some(place) => Some(self.spot(place, frame)?.node),
            None => None,
        };
        for (parameter, expr) in &call.inputs {
            let data = self.data(expr, frame)?;
            let node = self.parameter(this, *parameter)?;
            self.memory.set_data(node, &data);
        }
        let parameters = self.project.pou(call.pou).vars.iter().copied();
        let in_outs = parameters.filter(|v| self.project.var(*v).section == VarSection::InOut);
        let mut own = BTreeMap::new();
        let mut copies = Vec::new();
        for (parameter, place) in in_outs.zip(&call.in_outs) {
            let (node, back) = self.by_reference(place, frame)?;
            own.insert(parameter, node);
            copies.extend(back.map(|spot| (node, spot)));
        }
        self.copy_in(&copies);
        self.run_pou(call.pou, this, own)?;
        self.bring_back(&copies);
        for (parameter, place, negated) in &call.outputs {
            let spot = self.spot(place, frame)?;
            let node = self.parameter(this, *parameter)?;
            let value = self.memory.data(node);
            self.store_output(
                self.project.var(*parameter).ty,
                place,
                value,
                *negated,
                spot,
            )?;
        }
        self.memory.forget(mark);
        Ok(())
    }

    fn parameter(&self, this: Option<NodeId>, var: VarId) -> Run<NodeId> {
        let found = match this {
            Some(instance) => self.memory.member(instance, var),
            None => self.fixed(var),
        };
        found.ok_or(Stop::Unknown("a parameter that is nowhere"))
    }

    fn function_call(&mut self, call: &FunctionCall, frame: &mut Frame) -> Run<Option<Data>> {
        let project = self.project;
        let mark = self.memory.mark();
        let (this, pou) = self.callee(call, frame)?;
        let takes = |id: &VarId| {
            let var = project.var(*id);
            let section = matches!(
                var.section,
                VarSection::Input | VarSection::Output | VarSection::InOut
            );
            section && !var.constant
        };
        // The method that runs may be another than the one that was declared; its parameters are the same.
        let declared: Vec<VarId> = project
            .pou(call.pou)
            .vars
            .iter()
            .copied()
            .filter(takes)
            .collect();
        let parameters: Vec<VarId> = project
            .pou(pou)
            .vars
            .iter()
            .copied()
            .filter(takes)
            .collect();
        let mut inputs = Vec::new();
        let mut own = BTreeMap::new();
        let mut copies = Vec::new();
        for (parameter, argument) in parameters.iter().zip(&call.args) {
            match argument {
                Argument::Input(expr) => inputs.push((*parameter, self.data(expr, frame)?)),
                Argument::InOut(place) => {
                    let (node, back) = self.by_reference(place, frame)?;
                    own.insert(*parameter, node);
                    copies.extend(back.map(|spot| (node, spot)));
                }
                Argument::Output(_) => {}
            }
        }
        self.copy_in(&copies);
        let unit = project.pou(pou);
        for id in unit.vars.iter().chain(unit.result.as_ref()) {
            let var = project.var(*id);
            if var.constant || var.section == VarSection::InOut {
                continue;
            }
            let node = self.memory.variable(var.ty, var.init.as_ref());
            if let Some((_, data)) = inputs.iter().find(|(p, _)| p == id) {
                self.memory.set_data(node, data);
            }
            own.insert(*id, node);
        }
        let mut inner = Frame { this, own };
        self.stmts(project.body(pou), &mut inner)?;
        let result = unit.result.map(|id| self.memory.data(inner.own[&id]));
        self.bring_back(&copies);
        for ((parameter, declared), argument) in parameters.iter().zip(&declared).zip(&call.args) {
            if let Argument::Output(Some(place)) = argument {
                let value = self.memory.data(inner.own[parameter]);
                let spot = self.spot(place, frame)?;
                self.store_output(project.var(*declared).ty, place, value, false, spot)?;
            }
        }
        self.memory.forget(mark);
        Ok(result)
    }

    /// Whose method runs, and which.
    fn callee(&mut self, call: &FunctionCall, frame: &mut Frame) -> Run<(Option<NodeId>, PouId)> {
        let (node, fixed) = match &call.receiver {
            None => return Ok((None, call.pou)),
            Some(Receiver::Fixed(place)) => (self.spot(place, frame)?.node, true),
            Some(Receiver::Derived(place)) => (self.spot(place, frame)?.node, false),
            Some(Receiver::Interface(place, _)) => {
                let spot = self.spot(place, frame)?;
                match self.load(spot) {
                    Scalar::Ref(Some(node)) => (node, false),
                    _ => return self.trap(TrapKind::NullReference, place.span),
                }
            }
        };
        if fixed {
            return Ok((Some(node), call.pou));
        }
        let Node::Instance(block, _) = self.memory.node(node) else {
            return Err(Stop::Unknown("a method of no instance"));
        };
        let name = self.project.method_name(call.pou);
        let found = self.project.find_method(*block, &name);
        found
            .map(|m| (Some(node), m))
            .ok_or(Stop::Unknown("a method that is nowhere"))
    }

    // Places.

    fn spot(&mut self, place: &Place, frame: &mut Frame) -> Run<Spot> {
        let (mut node, mut ty) = match &place.root {
            Root::This => (
                frame.this.ok_or(Stop::Unknown("THIS in a program"))?,
                place.ty,
            ),
            Root::Direct(_) => return Err(Stop::Unknown("direct addresses")),
            Root::Var(id) => (self.root(*id, frame)?, self.project.var(*id).ty),
        };
        let mut part = Part::Whole;
        for step in &place.steps {
            match &step.kind {
                StepKind::Field(index, _) => node = self.memory.children(node)[*index],
                StepKind::Member(var) => {
                    let found = self.memory.member(node, *var);
                    node = found.ok_or(Stop::Unknown("a member that is nowhere"))?;
                }
                StepKind::Index(indices) => {
                    let TypeKind::Array { dims, .. } = self.project.types.kind(ty) else {
                        return Err(Stop::Unknown("an index of no array"));
                    };
                    let mut number = 0;
                    for (index, (low, high)) in indices.iter().zip(dims) {
                        let at = self.scalar(index, frame)?.int();
                        if at < i128::from(*low) || at > i128::from(*high) {
                            return self.trap(TrapKind::Index, index.span);
                        }
                        number = number * (high - low + 1) + (at as i64 - low);
                    }
                    node = self.memory.children(node)[number as usize];
                }
                StepKind::Bit(bit) => {
                    let low = match part {
                        Part::Bits(low, _) => low,
                        _ => 0,
                    };
                    part = Part::Bits(low + u32::from(*bit), 1);
                }
                StepKind::Part(low, count) => part = Part::Bits((*low).into(), (*count).into()),
                StepKind::Deref => match self.memory.scalar(node) {
                    Scalar::Ref(Some(target)) => node = target,
                    _ => return self.trap(TrapKind::NullReference, place.span),
                },
                StepKind::Char(index) => {
                    let at = self.scalar(index, frame)?.int();
                    let len = self.memory.text(node).len();
                    if at < 1 || at > len as i128 {
                        return self.trap(TrapKind::Index, index.span);
                    }
                    part = Part::Char(at as usize - 1);
                }
            }
            ty = step.ty;
        }
        Ok(Spot { node, part })
    }

    fn root(&self, id: VarId, frame: &Frame) -> Run<NodeId> {
        let found = frame
            .own
            .get(&id)
            .copied()
            .or_else(|| self.fixed(id))
            .or_else(|| frame.this.and_then(|this| self.memory.member(this, id)));
        found.ok_or(Stop::Unknown("a variable that is nowhere"))
    }

    fn load(&self, spot: Spot) -> Scalar {
        match spot.part {
            Part::Whole => self.memory.scalar(spot.node),
            Part::Bits(low, count) => {
                let whole = self.memory.scalar(spot.node).int();
                Scalar::Int(whole >> low & ((1 << count) - 1))
            }
            Part::Char(at) => Scalar::Int(self.memory.text(spot.node)[at].into()),
        }
    }

    fn store(&mut self, spot: Spot, data: &Data) {
        match (spot.part, data) {
            (Part::Whole, data) => self.memory.set_data(spot.node, data),
            (Part::Bits(low, count), Data::Scalar(value)) => {
                let Node::Scalar(elem, old) = self.memory.node(spot.node).clone() else {
                    return;
                };
                let mask = ((1i128 << count) - 1) << low;
                let new = old.int() & !mask | value.int() << low & mask;
                self.memory
                    .set(spot.node, Scalar::Int(value::wrap(elem, new)));
            }
            (Part::Char(at), Data::Scalar(value)) => {
                self.memory.set_unit(spot.node, at, value.int() as u16);
            }
            _ => {}
        }
    }

    // Expressions.

    fn elem(&self, ty: TypeId) -> Elem {
        self.project.types.elem(ty).unwrap_or(Elem::Bool)
    }

    fn is_text(&self, ty: TypeId) -> bool {
        matches!(self.project.types.kind(ty), TypeKind::Str { .. })
    }

    fn data(&mut self, expr: &Expr, frame: &mut Frame) -> Run<Data> {
        if self.is_text(expr.ty) {
            return self.text(expr, frame).map(Data::Text);
        }
        match &expr.kind {
            ExprKind::Load(place) => {
                let spot = self.spot(place, frame)?;
                Ok(match spot.part {
                    Part::Whole => self.memory.data(spot.node),
                    _ => Data::Scalar(self.load(spot)),
                })
            }
            ExprKind::Call(call) => self.result(call, frame),
            _ => self.scalar(expr, frame).map(Data::Scalar),
        }
    }

    fn result(&mut self, call: &FunctionCall, frame: &mut Frame) -> Run<Data> {
        let result = self.function_call(call, frame)?;
        result.ok_or(Stop::Unknown("a function without result"))
    }

    fn scalar(&mut self, expr: &Expr, frame: &mut Frame) -> Run<Scalar> {
        match &expr.kind {
            ExprKind::Const(value) => Ok(crate::memory::scalar_of(*value)),
            ExprKind::Load(place) => {
                let spot = self.spot(place, frame)?;
                Ok(self.load(spot))
            }
            ExprKind::Unary(op, inner) => {
                let elem = self.elem(inner.ty);
                let value = self.scalar(inner, frame)?;
                Ok(value::unary(*op, elem, value))
            }
            ExprKind::Binary(op, elem, left, right) => {
                let l = self.scalar(left, frame)?;
                // The right side of AND and OR runs only if it decides.
                if *elem == Elem::Bool
                    && ((*op == BinOp::And && !l.is_true()) || (*op == BinOp::Or && l.is_true()))
                {
                    return Ok(l);
                }
                let r = self.scalar(right, frame)?;
                self.or_trap(value::binary(*op, *elem, l, r), expr.span)
            }
            ExprKind::Convert(inner) => {
                let value = self.scalar(inner, frame)?;
                let (from, to) = (self.elem(inner.ty), self.elem(expr.ty));
                self.or_trap(value::convert(from, to, value), expr.span)
            }
            ExprKind::Check(inner, limits) => {
                let value = self.scalar(inner, frame)?;
                let (inside, kind) = match limits {
                    Limits::Range(lo, hi) => ((*lo..=*hi).contains(&value.int()), TrapKind::Range),
                    Limits::Values(list) => (
                        list.iter().any(|v| i128::from(*v) == value.int()),
                        TrapKind::Conversion,
                    ),
                };
                if inside {
                    return Ok(value);
                }
                self.trap(kind, expr.span)
            }
            ExprKind::Std(fun, args) => self.standard(*fun, args, expr, frame),
            ExprKind::Call(call) => match self.result(call, frame)? {
                Data::Scalar(value) => Ok(value),
                _ => Err(Stop::Unknown("a result of another kind")),
            },
            ExprKind::AddressOf(place) => Ok(Scalar::Ref(Some(self.spot(place, frame)?.node))),
            ExprKind::AddressIf(inner, accepted) => {
                let value = self.scalar(inner, frame)?;
                let fits = match value {
                    Scalar::Ref(Some(node)) => match self.memory.node(node) {
                        Node::Instance(pou, _) => accepted.contains(pou),
                        _ => false,
                    },
                    _ => false,
                };
                Ok(if fits { value } else { Scalar::Ref(None) })
            }
            ExprKind::Text(_) => Err(Stop::Unknown("a string as a number")),
        }
    }

    fn standard(
        &mut self,
        fun: StdFun,
        args: &[Expr],
        expr: &Expr,
        frame: &mut Frame,
    ) -> Run<Scalar> {
        match fun {
            StdFun::McTime => return Ok(Scalar::Int(self.time_ns.into())),
            StdFun::Len => return Ok(Scalar::Int(self.text(&args[0], frame)?.len() as i128)),
            StdFun::Find | StdFun::Compare => {
                let a = self.text(&args[0], frame)?;
                let b = self.text(&args[1], frame)?;
                return Ok(Scalar::Int(if fun == StdFun::Find {
                    text::find(&a, &b)
                } else {
                    text::order(&a, &b)
                }));
            }
            StdFun::FromText => {
                let units = self.text(&args[0], frame)?;
                return self.or_trap(text::to_value(self.elem(expr.ty), &units), expr.span);
            }
            StdFun::Mux => {
                let k = self.selector(args, expr, frame)?;
                let mut values = Vec::new();
                for arg in &args[1..] {
                    values.push(self.scalar(arg, frame)?);
                }
                return Ok(values[k]);
            }
            _ => {}
        }
        let mut values = Vec::new();
        for arg in args {
            values.push(self.scalar(arg, frame)?);
        }
        self.or_trap(value::function(fun, self.elem(expr.ty), &values), expr.span)
    }

    /// The selector of MUX, which must name one of its inputs.
    fn selector(&mut self, args: &[Expr], expr: &Expr, frame: &mut Frame) -> Run<usize> {
        let k = self.scalar(&args[0], frame)?.int();
        if k < 0 || k >= args.len() as i128 - 1 {
            return self.trap(TrapKind::Index, expr.span);
        }
        Ok(k as usize)
    }

    fn text(&mut self, expr: &Expr, frame: &mut Frame) -> Run<Units> {
        match &expr.kind {
            ExprKind::Text(units) => Ok(units.to_vec()),
            ExprKind::Load(place) => {
                let spot = self.spot(place, frame)?;
                Ok(self.memory.text(spot.node))
            }
            ExprKind::Call(call) => match self.result(call, frame)? {
                Data::Text(units) => Ok(units),
                _ => Err(Stop::Unknown("a result of another kind")),
            },
            ExprKind::Std(fun, args) => self.text_function(*fun, args, expr, frame),
            _ => Err(Stop::Unknown("a string of another kind")),
        }
    }

    fn text_function(
        &mut self,
        fun: StdFun,
        args: &[Expr],
        expr: &Expr,
        frame: &mut Frame,
    ) -> Run<Units> {
        if fun == StdFun::ToText {
            let from = &args[0];
            if self.is_text(from.ty) {
                let wide = matches!(
                    self.project.types.kind(expr.ty),
                    TypeKind::Str { wide: true, .. }
                );
                return Ok(text::widen(self.text(from, frame)?, wide));
            }
            let value = self.scalar(from, frame)?;
            return Ok(text::of_value(self.elem(from.ty), value));
        }
        if fun == StdFun::Mux {
            let k = self.selector(args, expr, frame)?;
            let mut texts = Vec::new();
            for arg in &args[1..] {
                texts.push(self.text(arg, frame)?);
            }
            return Ok(texts.swap_remove(k));
        }
        let mut texts = Vec::new();
        let mut counts = Vec::new();
        for arg in args {
            if self.is_text(arg.ty) {
                texts.push(self.text(arg, frame)?);
            } else {
                counts.push(self.scalar(arg, frame)?.int());
            }
        }
        Ok(match fun {
            StdFun::Sel => texts.swap_remove(usize::from(counts[0] != 0)),
            StdFun::Max => texts.into_iter().max().unwrap_or_default(),
            StdFun::Min => texts.into_iter().min().unwrap_or_default(),
            // MIN(MAX(IN, MN), MX)
            StdFun::Limit => texts[1].clone().max(texts[0].clone()).min(texts[2].clone()),
            _ if fun.signature() == Signature::Text => text::edit(fun, &texts, &counts),
            _ => return Err(Stop::Unknown("a function of strings")),
        })
    }
}
