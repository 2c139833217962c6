//! Expressions.

use wasm_encoder::{BlockType, Ieee32, Ieee64, Instruction as I, ValType};

use super::SiteKind;
use super::dispatch::tag_of;
use super::fun::{Fun, mem, val};
use crate::check::tree::{Enabled, Expr, ExprKind, Limits, PouId, StepKind};
use crate::source::Span;
use crate::syntax::ast::{BinOp, UnOp};
use crate::types::Elem;
use crate::value::Value;

impl Fun<'_, '_> {
    /// Pushes the value of a scalar expression.
    pub fn expr(&mut self, expr: &Expr) {
        match &expr.kind {
            ExprKind::Const(value) => self.constant(*value, self.elem(expr.ty)),
            ExprKind::Load(place) => match self.only_value(expr) {
                Some(value) => {
                    let elem = self.elem(expr.ty);
                    self.constant(Value::from_i128(elem, value), elem);
                }
                None => self.load(place),
            },
            ExprKind::Unary(op, inner) => self.unary(*op, inner),
            ExprKind::Binary(op, elem, left, right) => {
                let wraps = self.range_of(expr).is_none();
                self.binary(*op, *elem, left, right, wraps, expr.span);
            }
            ExprKind::Convert(inner) => {
                self.expr(inner);
                let (from, to) = (self.elem(inner.ty), self.elem(expr.ty));
                let as_it_is = val(from) == val(to) && self.range_of(expr).is_some();
                if !as_it_is {
                    self.convert(from, to, expr.span);
                }
            }
            ExprKind::Check(inner, limits) => {
                self.expr(inner);
                self.check(self.elem(inner.ty), limits, expr);
            }
            ExprKind::Std(fun, args) => self.standard(*fun, args, self.elem(expr.ty), expr.span),
            ExprKind::Call(call) => self.function_call(call),
            ExprKind::Enabled(inner) => {
                let local = self.temp(val(self.elem(expr.ty)));
                self.enabled(inner, |f, value| {
                    f.expr(value);
                    f.i(I::LocalSet(local));
                });
                self.i(I::LocalGet(local));
                self.release(local);
            }
            ExprKind::AddressOf(place) => {
                self.reads = true;
                self.push_full_address(place);
                self.characters(place, expr);
            }
            ExprKind::AddressIf(inner, accepted) => self.address_if(inner, accepted),
            // Strings have their own way (`text`).
            ExprKind::Text(_) => self.i(I::I32Const(0)),
        }
    }

    /// A call with EN: `keep` evaluates the value and puts it where both ways leave it.
    pub fn enabled(&mut self, inner: &Enabled, keep: impl Fn(&mut Self, &Expr)) {
        self.expr(&inner.condition);
        self.open(I::If(BlockType::Empty));
        self.aside(|f| {
            keep(f, &inner.value);
            f.stmts(&inner.on);
        });
        self.i(I::Else);
        self.aside(|f| {
            keep(f, &inner.otherwise);
            f.stmts(&inner.off);
        });
        self.close();
    }

    /// Pushes the address of an instance if it is of one of the function blocks, else 0.
    fn address_if(&mut self, inner: &Expr, accepted: &[PouId]) {
        let local = self.spill(inner);
        self.i(I::LocalGet(local));
        self.open(I::If(BlockType::Result(ValType::I32)));
        self.i(I::LocalGet(local));
        self.i(I::I32Const(0));
        self.i(I::I32Const(0));
        for pou in accepted {
            self.i(I::LocalGet(local));
            self.i(I::I32Load(mem(0, 2)));
            self.i(I::I32Const(tag_of(*pou)));
            self.i(I::I32Eq);
            self.i(I::I32Or);
        }
        self.i(I::Select);
        self.i(I::Else);
        self.i(I::I32Const(0));
        self.close();
        self.release(local);
    }

    /// Pushes the address of an array or structure.
    pub fn aggregate(&mut self, expr: &Expr) {
        match &expr.kind {
            ExprKind::Load(place) => {
                self.reads = true;
                self.push_full_address(place);
            }
            ExprKind::Call(call) => self.aggregate_call(call, expr.ty),
            _ => self.i(I::I32Const(0)),
        }
    }

    pub fn constant(&mut self, value: Value, elem: Elem) {
        self.i(match val(elem) {
            ValType::F32 => match value {
                Value::Real(v) => I::F32Const(Ieee32::from(v)),
                other => I::F32Const(Ieee32::from(other.as_f64() as f32)),
            },
            ValType::F64 => I::F64Const(Ieee64::from(value.as_f64())),
            ValType::I64 => I::I64Const(value.as_i128().unwrap_or(0) as i64),
            _ => I::I32Const(value.as_i128().unwrap_or(0) as i32),
        });
    }

    /// Brings the i32 on the stack back into the range of a narrow type.
    pub fn normalise(&mut self, elem: Elem) {
        match elem {
            Elem::Sint => self.i(I::I32Extend8S),
            Elem::Int => self.i(I::I32Extend16S),
            Elem::Usint | Elem::Byte | Elem::Char => {
                self.i(I::I32Const(0xff));
                self.i(I::I32And);
            }
            Elem::Uint | Elem::Word | Elem::Wchar => {
                self.i(I::I32Const(0xffff));
                self.i(I::I32And);
            }
            Elem::Bool => {
                self.i(I::I32Const(1));
                self.i(I::I32And);
            }
            _ => {}
        }
    }

    fn unary(&mut self, op: UnOp, inner: &Expr) {
        let elem = self.elem(inner.ty);
        match (op, val(elem)) {
            (UnOp::Neg, ValType::F32) => {
                self.expr(inner);
                self.i(I::F32Neg);
            }
            (UnOp::Neg, ValType::F64) => {
                self.expr(inner);
                self.i(I::F64Neg);
            }
            (UnOp::Neg, ValType::I64) => {
                self.i(I::I64Const(0));
                self.expr(inner);
                self.i(I::I64Sub);
            }
            (UnOp::Neg, _) => {
                self.i(I::I32Const(0));
                self.expr(inner);
                self.i(I::I32Sub);
                self.normalise(elem);
            }
            (UnOp::Not, ValType::I64) => {
                self.expr(inner);
                self.i(I::I64Const(-1));
                self.i(I::I64Xor);
            }
            (UnOp::Not, _) => {
                self.expr(inner);
                if elem == Elem::Bool {
                    self.i(I::I32Eqz);
                } else {
                    self.i(I::I32Const(-1));
                    self.i(I::I32Xor);
                    self.normalise(elem);
                }
            }
        }
    }

    /// `wraps`: the result may leave its type.
    fn binary(
        &mut self,
        op: BinOp,
        elem: Elem,
        left: &Expr,
        right: &Expr,
        wraps: bool,
        span: Span,
    ) {
        if elem == Elem::Bool && matches!(op, BinOp::And | BinOp::Or) && !cheap(right, 4) {
            // The right side is evaluated only if it decides (clause 7.3.2): it may guard an index or a division.
            self.expr(left);
            self.open(I::If(BlockType::Result(ValType::I32)));
            if op == BinOp::And {
                self.aside(|f| f.expr(right));
            } else {
                self.i(I::I32Const(1));
            }
            self.i(I::Else);
            if op == BinOp::And {
                self.i(I::I32Const(0));
            } else {
                self.aside(|f| f.expr(right));
            }
            self.close();
            return;
        }
        if elem == Elem::Time && self.elem(right.ty) == Elem::Lreal {
            self.expr(left);
            self.i(I::F64ConvertI64S);
            self.expr(right);
            self.i(if op == BinOp::Mul {
                I::F64Mul
            } else {
                I::F64Div
            });
            self.convert(Elem::Lreal, Elem::Lint, span);
            return;
        }
        self.expr(left);
        self.expr(right);
        match op {
            BinOp::Div | BinOp::Mod if !elem.is_real() => {
                let known = match &right.kind {
                    ExprKind::Const(v) => v.as_i128(),
                    _ => None,
                };
                self.divide(op, elem, known, span);
            }
            BinOp::Pow => {
                let (name, ty) = if elem == Elem::Real {
                    ("powf", ValType::F32)
                } else {
                    ("pow", ValType::F64)
                };
                let number = self.m.import(name, &[ty, ty], &[ty]);
                self.i(I::Call(number));
            }
            _ => {
                self.i(simple(op, elem));
                if wraps && matches!(op, BinOp::Add | BinOp::Sub | BinOp::Mul) {
                    self.normalise_arithmetic(elem);
                }
            }
        }
    }

    fn normalise_arithmetic(&mut self, elem: Elem) {
        if val(elem) == ValType::I32 {
            self.normalise(elem);
        }
    }

    /// Integer division or MOD of the two values on the stack. `known` is the divisor if it is constant (and then not 0).
    fn divide(&mut self, op: BinOp, elem: Elem, known: Option<i128>, span: Span) {
        let ty = val(elem);
        let wide = ty == ValType::I64;
        let signed = elem.is_signed() || elem.is_time();
        let plain = match (op, wide, signed) {
            (BinOp::Div, false, true) => I::I32DivS,
            (BinOp::Div, false, false) => I::I32DivU,
            (BinOp::Div, true, true) => I::I64DivS,
            (BinOp::Div, true, false) => I::I64DivU,
            (_, false, true) => I::I32RemS,
            (_, false, false) => I::I32RemU,
            (_, true, true) => I::I64RemS,
            (_, true, false) => I::I64RemU,
        };
        // The smallest value divided by -1 wraps; Wasm's instruction would trap.
        let may_wrap = op == BinOp::Div && signed && known.is_none_or(|k| k == -1);
        if known.is_some() && !may_wrap {
            self.i(plain);
            return;
        }
        let right = self.temp(ty);
        let left = self.temp(ty);
        self.i(I::LocalSet(right));
        self.i(I::LocalSet(left));
        if known.is_none() {
            self.i(I::LocalGet(right));
            self.i(if wide { I::I64Eqz } else { I::I32Eqz });
            self.trap_if(SiteKind::DivisionByZero, span, None);
        }
        if may_wrap && elem.bits() >= 32 {
            self.i(I::LocalGet(right));
            if wide {
                self.i(I::I64Const(-1));
                self.i(I::I64Eq);
            } else {
                self.i(I::I32Const(-1));
                self.i(I::I32Eq);
            }
            self.open(I::If(BlockType::Result(ty)));
            self.i(if wide { I::I64Const(0) } else { I::I32Const(0) });
            self.i(I::LocalGet(left));
            self.i(if wide { I::I64Sub } else { I::I32Sub });
            self.i(I::Else);
            self.i(I::LocalGet(left));
            self.i(I::LocalGet(right));
            self.i(plain);
            self.close();
        } else {
            self.i(I::LocalGet(left));
            self.i(I::LocalGet(right));
            self.i(plain);
            self.normalise_arithmetic(elem);
        }
        self.release(left);
        self.release(right);
    }

    /// Traps unless the value on the stack, of type `elem`, lies within the limits.
    pub fn check(&mut self, elem: Elem, limits: &Limits, expr: &Expr) {
        let ty = val(elem);
        let local = self.temp(ty);
        self.i(I::LocalSet(local));
        let (lo, hi) = match limits {
            Limits::Range(lo, hi) => (*lo, *hi),
            Limits::Values(values) => {
                let lo = i128::from(values.iter().copied().min().unwrap_or(0));
                let hi = i128::from(values.iter().copied().max().unwrap_or(0));
                (lo, hi)
            }
        };
        let kind = match limits {
            Limits::Range(..) => SiteKind::Range(lo as i64, hi as i64),
            Limits::Values(_) => SiteKind::Enumeration(self.m.project.type_name(expr.ty)),
        };
        let (min, max) = elem.limits().unwrap_or((lo, hi));
        // Limits that the type itself keeps need no test.
        let mut tests = 0;
        for (op, bound, needed) in [
            (BinOp::Lt, lo.max(min), lo > min),
            (BinOp::Gt, hi.min(max), hi < max),
        ] {
            if needed {
                self.i(I::LocalGet(local));
                self.constant(Value::from_i128(elem, bound), elem);
                self.i(simple(op, elem));
                tests += 1;
                if tests == 2 {
                    self.i(I::I32Or);
                }
            }
        }
        if let Limits::Values(values) = limits
            && values.len() as i128 != hi - lo + 1
        {
            // The values have gaps: it must be one of them.
            for (number, value) in values.iter().enumerate() {
                self.i(I::LocalGet(local));
                self.constant(Value::from_i128(elem, i128::from(*value)), elem);
                self.i(simple(BinOp::Ne, elem));
                if number > 0 {
                    self.i(I::I32And);
                }
            }
            if tests > 0 {
                self.i(I::I32Or);
            }
            tests += 1;
        }
        if tests > 0 {
            self.trap_if(kind, expr.span, Some((local, elem)));
        }
        self.i(I::LocalGet(local));
        self.release(local);
    }
}

/// Whether the expression neither traps nor calls and costs little, so that evaluating it always is cheaper than a branch.
fn cheap(expr: &Expr, budget: u32) -> bool {
    if budget == 0 {
        return false;
    }
    match &expr.kind {
        ExprKind::Const(_) => true,
        ExprKind::Load(place) => place.steps.iter().all(|step| match &step.kind {
            StepKind::Index(indices) => {
                indices.iter().all(|i| matches!(i.kind, ExprKind::Const(_)))
            }
            StepKind::Deref | StepKind::Element(_) | StepKind::Char(_) => false,
            _ => true,
        }),
        ExprKind::Unary(_, inner) => cheap(inner, budget - 1),
        ExprKind::Binary(op, elem, left, right) => {
            !matches!(op, BinOp::Div | BinOp::Mod | BinOp::Pow)
                && *elem != Elem::Time
                && cheap(left, budget - 1)
                && cheap(right, budget - 1)
        }
        _ => false,
    }
}

/// The instruction for operators that need no more than one.
pub fn simple(op: BinOp, elem: Elem) -> I<'static> {
    let signed = elem.is_signed() || elem.is_time();
    match val(elem) {
        ValType::F32 => match op {
            BinOp::Add => I::F32Add,
            BinOp::Sub => I::F32Sub,
            BinOp::Mul => I::F32Mul,
            BinOp::Div => I::F32Div,
            BinOp::Eq => I::F32Eq,
            BinOp::Ne => I::F32Ne,
            BinOp::Lt => I::F32Lt,
            BinOp::Le => I::F32Le,
            BinOp::Gt => I::F32Gt,
            _ => I::F32Ge,
        },
        ValType::F64 => match op {
            BinOp::Add => I::F64Add,
            BinOp::Sub => I::F64Sub,
            BinOp::Mul => I::F64Mul,
            BinOp::Div => I::F64Div,
            BinOp::Eq => I::F64Eq,
            BinOp::Ne => I::F64Ne,
            BinOp::Lt => I::F64Lt,
            BinOp::Le => I::F64Le,
            BinOp::Gt => I::F64Gt,
            _ => I::F64Ge,
        },
        ValType::I64 => match (op, signed) {
            (BinOp::Add, _) => I::I64Add,
            (BinOp::Sub, _) => I::I64Sub,
            (BinOp::Mul, _) => I::I64Mul,
            (BinOp::And, _) => I::I64And,
            (BinOp::Or, _) => I::I64Or,
            (BinOp::Xor, _) => I::I64Xor,
            (BinOp::Eq, _) => I::I64Eq,
            (BinOp::Ne, _) => I::I64Ne,
            (BinOp::Lt, true) => I::I64LtS,
            (BinOp::Lt, false) => I::I64LtU,
            (BinOp::Le, true) => I::I64LeS,
            (BinOp::Le, false) => I::I64LeU,
            (BinOp::Gt, true) => I::I64GtS,
            (BinOp::Gt, false) => I::I64GtU,
            (_, true) => I::I64GeS,
            (_, false) => I::I64GeU,
        },
        _ => match (op, signed) {
            (BinOp::Add, _) => I::I32Add,
            (BinOp::Sub, _) => I::I32Sub,
            (BinOp::Mul, _) => I::I32Mul,
            (BinOp::And, _) => I::I32And,
            (BinOp::Or, _) => I::I32Or,
            (BinOp::Xor, _) => I::I32Xor,
            (BinOp::Eq, _) => I::I32Eq,
            (BinOp::Ne, _) => I::I32Ne,
            (BinOp::Lt, true) => I::I32LtS,
            (BinOp::Lt, false) => I::I32LtU,
            (BinOp::Le, true) => I::I32LeS,
            (BinOp::Le, false) => I::I32LeU,
            (BinOp::Gt, true) => I::I32GtS,
            (BinOp::Gt, false) => I::I32GtU,
            (_, true) => I::I32GeS,
            (_, false) => I::I32GeU,
        },
    }
}
