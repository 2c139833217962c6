//! The interpreter: statements, calls, expressions and places of the typed tree.

mod calls;
mod expressions;
mod places;

use std::collections::BTreeMap;

use fam_soft_plc::TrapKind;
use fam_soft_plc::check::tree::{Branch, Expr, For, PouId, Stmt, StmtKind, TypedProject, VarId};
use fam_soft_plc::source::Span;
use fam_soft_plc::syntax::ast::{PouKind, VarSection};
use fam_soft_plc::types::TypeKind;

use crate::memory::{Data, Memory, NodeId, is_state};
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
}
