//! Values of expressions, and standard functions.

use fam_soft_plc::TrapKind;
use fam_soft_plc::check::stdfun::{Signature, StdFun};
use fam_soft_plc::check::tree::{Enabled, Expr, ExprKind, FunctionCall, Limits};
use fam_soft_plc::syntax::ast::BinOp;
use fam_soft_plc::types::{Elem, TypeKind};

use super::{Frame, Machine, Part, Run, Stop};
use crate::memory::{Data, Node};
use crate::text::{self, Units};
use crate::value::{self, Scalar};

impl Machine<'_> {
    pub(super) fn data(&mut self, expr: &Expr, frame: &mut Frame) -> Run<Data> {
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

    pub(super) fn result(&mut self, call: &FunctionCall, frame: &mut Frame) -> Run<Data> {
        let result = self.function_call(call, frame)?;
        result.ok_or(Stop::Unknown("a function without result"))
    }

    pub(super) fn scalar(&mut self, expr: &Expr, frame: &mut Frame) -> Run<Scalar> {
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
            ExprKind::Enabled(inner) => self.enabled(inner, frame, Self::scalar),
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

    /// A call with EN: it runs or its value is the initial one, and ENO is told which.
    fn enabled<R>(
        &mut self,
        call: &Enabled,
        frame: &mut Frame,
        evaluate: fn(&mut Self, &Expr, &mut Frame) -> Run<R>,
    ) -> Run<R> {
        let (value, tell) = if self.scalar(&call.condition, frame)?.is_true() {
            (&call.value, &call.on)
        } else {
            (&call.otherwise, &call.off)
        };
        let result = evaluate(self, value, frame)?;
        self.stmts(tell, frame)?;
        Ok(result)
    }

    pub(super) fn standard(
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
    pub(super) fn selector(&mut self, args: &[Expr], expr: &Expr, frame: &mut Frame) -> Run<usize> {
        let k = self.scalar(&args[0], frame)?.int();
        if k < 0 || k >= args.len() as i128 - 1 {
            return self.trap(TrapKind::Index, expr.span);
        }
        Ok(k as usize)
    }

    pub(super) fn text(&mut self, expr: &Expr, frame: &mut Frame) -> Run<Units> {
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
            ExprKind::Enabled(inner) => self.enabled(inner, frame, Self::text),
            _ => Err(Stop::Unknown("a string of another kind")),
        }
    }

    pub(super) fn text_function(
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
