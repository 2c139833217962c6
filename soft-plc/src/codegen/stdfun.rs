//! Standard functions; the counterpart of `check::stdfun::evaluate`.

use wasm_encoder::{Ieee32, Ieee64, Instruction as I, ValType};

use super::SiteKind;
use super::expr::simple;
use super::fun::{Fun, mem, val};
use crate::check::stdfun::{Signature, StdFun};
use crate::check::tree::{Expr, ExprKind};
use crate::memory::MC_TIME_AT;
use crate::source::Span;
use crate::syntax::ast::BinOp;
use crate::types::Elem;
use crate::value::Value;

impl Fun<'_, '_> {
    pub fn standard(&mut self, fun: StdFun, args: &[Expr], elem: Elem, span: Span) {
        match fun.signature() {
            Signature::Text => self.text_number(fun, args, elem, span),
            Signature::Swap => self.swap_bytes(&args[0], elem),
            Signature::Num => self.absolute(&args[0], elem),
            Signature::Real | Signature::Real2 => self.real_function(fun, args, elem),
            Signature::Shift => self.shift(fun, &args[0], &args[1], elem),
            Signature::Sel => {
                let selector = self.spill(&args[0]);
                let first = self.spill(&args[1]);
                self.expr(&args[2]);
                self.i(I::LocalGet(first));
                self.i(I::LocalGet(selector));
                self.i(I::Select);
                self.release(first);
                self.release(selector);
            }
            Signature::Mux => self.mux(args, span),
            Signature::Extensible => {
                self.expr(&args[0]);
                for next in &args[1..] {
                    self.pick_from(fun == StdFun::Max, elem, next);
                }
            }
            Signature::Limit => {
                if real_bound(&args[0]).is_some() {
                    self.expr(&args[1]);
                    self.pick_from(true, elem, &args[0]);
                } else {
                    self.expr(&args[0]);
                    self.pick_from(true, elem, &args[1]);
                }
                self.pick_from(false, elem, &args[2]);
            }
            Signature::Trunc => {
                self.expr(&args[0]);
                if self.elem(args[0].ty) == Elem::Real {
                    self.i(I::F64PromoteF32);
                }
                self.i(I::F64Trunc);
                self.whole_to_integer(elem, span);
            }
            Signature::Validity => {
                // x - x is 0 exactly for numbers.
                let real = self.elem(args[0].ty) == Elem::Real;
                let local = self.spill(&args[0]);
                self.i(I::LocalGet(local));
                self.i(I::LocalGet(local));
                if real {
                    self.i(I::F32Sub);
                    self.i(I::F32Const(Ieee32::from(0.0)));
                    self.i(I::F32Eq);
                } else {
                    self.i(I::F64Sub);
                    self.i(I::F64Const(Ieee64::from(0.0)));
                    self.i(I::F64Eq);
                }
                self.release(local);
            }
            Signature::Time => {
                self.i(I::I32Const(0));
                self.i(I::I64Load(mem(MC_TIME_AT, 3)));
            }
        }
    }

    /// Evaluates into a new local; the caller releases it.
    pub fn spill(&mut self, expr: &Expr) -> u32 {
        self.expr(expr);
        let local = self.temp(val(self.elem(expr.ty)));
        self.i(I::LocalSet(local));
        local
    }

    fn absolute(&mut self, arg: &Expr, elem: Elem) {
        match val(elem) {
            ValType::F32 => {
                self.expr(arg);
                self.i(I::F32Abs);
            }
            ValType::F64 => {
                self.expr(arg);
                self.i(I::F64Abs);
            }
            ty if elem.is_signed() => {
                let wide = ty == ValType::I64;
                let local = self.spill(arg);
                self.i(if wide { I::I64Const(0) } else { I::I32Const(0) });
                self.i(I::LocalGet(local));
                self.i(if wide { I::I64Sub } else { I::I32Sub });
                self.i(I::LocalGet(local));
                self.i(I::LocalGet(local));
                self.i(if wide { I::I64Const(0) } else { I::I32Const(0) });
                self.i(if wide { I::I64LtS } else { I::I32LtS });
                self.i(I::Select);
                if !wide {
                    self.normalise(elem);
                }
                self.release(local);
            }
            _ => self.expr(arg),
        }
    }

    fn real_function(&mut self, fun: StdFun, args: &[Expr], elem: Elem) {
        for arg in args {
            self.expr(arg);
        }
        let single = elem == Elem::Real;
        let name = match (fun, single) {
            (StdFun::Sqrt, true) => return self.i(I::F32Sqrt),
            (StdFun::Sqrt, false) => return self.i(I::F64Sqrt),
            (StdFun::Ln, true) => "logf",
            (StdFun::Ln, false) => "log",
            (StdFun::Log, true) => "log10f",
            (StdFun::Log, false) => "log10",
            (StdFun::Exp, true) => "expf",
            (StdFun::Exp, false) => "exp",
            (StdFun::Sin, true) => "sinf",
            (StdFun::Sin, false) => "sin",
            (StdFun::Cos, true) => "cosf",
            (StdFun::Cos, false) => "cos",
            (StdFun::Tan, true) => "tanf",
            (StdFun::Tan, false) => "tan",
            (StdFun::Asin, true) => "asinf",
            (StdFun::Asin, false) => "asin",
            (StdFun::Acos, true) => "acosf",
            (StdFun::Acos, false) => "acos",
            (StdFun::Atan, true) => "atanf",
            (StdFun::Atan, false) => "atan",
            (_, true) => "atan2f",
            (_, false) => "atan2",
        };
        let ty = val(elem);
        let params = vec![ty; args.len()];
        let number = self.m.real_function(name, &params, ty);
        self.i(I::Call(number));
    }

    /// The larger or smaller of the value on the stack and another.
    fn pick_from(&mut self, larger: bool, elem: Elem, other: &Expr) {
        let Some(bound) = real_bound(other) else {
            self.expr(other);
            return self.pick(larger, elem);
        };
        // With a bound that is neither 0 nor a NaN, a comparison that keeps the value in doubt (NaN) does what the
        // instructions of Wasm do, and has one of the processor's own.
        let (local, limit) = (self.temp(val(elem)), self.temp(val(elem)));
        self.i(I::LocalSet(local));
        self.stored_constant(bound, elem);
        self.i(I::LocalTee(limit));
        self.i(I::LocalGet(local));
        let order = if larger {
            [local, limit]
        } else {
            [limit, local]
        };
        for operand in order {
            self.i(I::LocalGet(operand));
        }
        self.i(simple(BinOp::Lt, elem));
        self.i(I::Select);
        self.release(limit);
        self.release(local);
    }

    /// Pushes a real constant from memory. In code, one that the instruction cannot name itself takes two instructions and fourteen bytes.
    fn stored_constant(&mut self, value: Value, elem: Elem) {
        let mut bytes = [0; 8];
        let bytes = &mut bytes[..elem.bits() as usize / 8];
        value.store(bytes);
        let at = self.m.data_constant(bytes);
        self.i(I::I32Const(0));
        self.i(if elem == Elem::Real {
            I::F32Load(mem(at, 2))
        } else {
            I::F64Load(mem(at, 3))
        });
    }

    /// The larger or smaller of the two values on the stack.
    fn pick(&mut self, larger: bool, elem: Elem) {
        match (val(elem), larger) {
            (ValType::F32, true) => return self.i(I::F32Max),
            (ValType::F32, false) => return self.i(I::F32Min),
            (ValType::F64, true) => return self.i(I::F64Max),
            (ValType::F64, false) => return self.i(I::F64Min),
            _ => {}
        }
        let ty = val(elem);
        let (a, b) = (self.temp(ty), self.temp(ty));
        self.i(I::LocalSet(b));
        self.i(I::LocalTee(a));
        self.i(I::LocalGet(b));
        self.i(I::LocalGet(a));
        self.i(I::LocalGet(b));
        self.i(simple(if larger { BinOp::Ge } else { BinOp::Le }, elem));
        self.i(I::Select);
        self.release(b);
        self.release(a);
    }

    fn mux(&mut self, args: &[Expr], span: Span) {
        let selector = self.spill(&args[0]);
        let count = args.len() as i64 - 1;
        self.i(I::LocalGet(selector));
        self.i(I::I64Const(count));
        self.i(I::I64GeU);
        self.trap_if(
            SiteKind::Selector(count),
            span,
            Some((selector, Elem::Lint)),
        );
        let values: Vec<u32> = args[1..].iter().map(|a| self.spill(a)).collect();
        self.i(I::LocalGet(values[0]));
        for (number, value) in values.iter().enumerate().skip(1) {
            // select(so far, this one, selector <> number)
            self.i(I::LocalGet(*value));
            self.i(I::LocalGet(selector));
            self.i(I::I64Const(number as i64));
            self.i(I::I64Ne);
            self.i(I::Select);
        }
        for value in values {
            self.release(value);
        }
        self.release(selector);
    }

    fn swap_bytes(&mut self, arg: &Expr, elem: Elem) {
        self.expr(arg);
        match val(elem) {
            ValType::F32 => {
                self.i(I::I32ReinterpretF32);
                self.swap_word();
                self.i(I::F32ReinterpretI32);
            }
            ValType::F64 => {
                self.i(I::I64ReinterpretF64);
                self.swap_long();
                self.i(I::F64ReinterpretI64);
            }
            ValType::I64 => self.swap_long(),
            _ if elem.bits() == 32 => self.swap_word(),
            _ if elem.bits() == 16 => {
                self.swap_word();
                self.i(I::I32Const(16));
                self.i(if elem.is_signed() {
                    I::I32ShrS
                } else {
                    I::I32ShrU
                });
            }
            _ => {}
        }
    }

    fn swap_word(&mut self) {
        let v = self.temp(ValType::I32);
        self.i(I::LocalTee(v));
        self.i(I::I32Const(8));
        self.i(I::I32Rotl);
        self.i(I::I32Const(0x00ff_00ff));
        self.i(I::I32And);
        self.i(I::LocalGet(v));
        self.i(I::I32Const(8));
        self.i(I::I32Rotr);
        self.i(I::I32Const(0xff00_ff00_u32 as i32));
        self.i(I::I32And);
        self.i(I::I32Or);
        self.release(v);
    }

    fn swap_long(&mut self) {
        let v = self.temp(ValType::I64);
        self.i(I::LocalTee(v));
        self.i(I::I32WrapI64);
        self.swap_word();
        self.i(I::I64ExtendI32U);
        self.i(I::I64Const(32));
        self.i(I::I64Shl);
        self.i(I::LocalGet(v));
        self.i(I::I64Const(32));
        self.i(I::I64ShrU);
        self.i(I::I32WrapI64);
        self.swap_word();
        self.i(I::I64ExtendI32U);
        self.i(I::I64Or);
        self.release(v);
    }

    fn shift(&mut self, fun: StdFun, value: &Expr, count: &Expr, elem: Elem) {
        let wide = val(elem) == ValType::I64;
        let width = i64::from(elem.bits());
        let rotate = matches!(fun, StdFun::Rol | StdFun::Ror);
        if fun == StdFun::Shr && elem.is_signed() {
            return self.shift_signed(value, count, elem);
        }
        self.expr(value);
        if rotate && elem.bits() >= 32 {
            self.expr(count);
            if !wide {
                self.i(I::I32WrapI64);
            }
            self.i(match (fun, wide) {
                (StdFun::Rol, true) => I::I64Rotl,
                (StdFun::Rol, false) => I::I32Rotl,
                (_, true) => I::I64Rotr,
                (_, false) => I::I32Rotr,
            });
            return;
        }
        if rotate {
            return self.rotate_narrow(fun, count, elem);
        }
        if let ExprKind::Const(n) = &count.kind
            && let Some(n) = n.as_i128()
            && (0..i128::from(width)).contains(&n)
        {
            self.shift_by(fun, wide, n as i64);
            if !wide && fun == StdFun::Shl {
                self.normalise(elem);
            }
            return;
        }
        // select(shifted, 0, count < width)
        let places = self.spill(count);
        self.i(I::LocalGet(places));
        if !wide {
            self.i(I::I32WrapI64);
        }
        self.i(match (fun, wide) {
            (StdFun::Shl, true) => I::I64Shl,
            (StdFun::Shl, false) => I::I32Shl,
            (_, true) => I::I64ShrU,
            (_, false) => I::I32ShrU,
        });
        if !wide {
            self.normalise(elem);
        }
        self.i(if wide { I::I64Const(0) } else { I::I32Const(0) });
        self.i(I::LocalGet(places));
        self.i(I::I64Const(width));
        self.i(I::I64LtU);
        self.i(I::Select);
        self.release(places);
    }

    /// A signed number to the right, as CODESYS does it: what is shifted in is the sign, also by too many places.
    fn shift_signed(&mut self, value: &Expr, count: &Expr, elem: Elem) {
        let wide = val(elem) == ValType::I64;
        let most = i64::from(elem.bits()) - 1;
        self.expr(value);
        let places = self.spill(count);
        self.i(I::LocalGet(places));
        self.i(I::I64Const(most));
        self.i(I::LocalGet(places));
        self.i(I::I64Const(most));
        self.i(I::I64LtU);
        self.i(I::Select);
        if !wide {
            self.i(I::I32WrapI64);
        }
        self.i(if wide { I::I64ShrS } else { I::I32ShrS });
        self.release(places);
    }

    fn shift_by(&mut self, fun: StdFun, wide: bool, n: i64) {
        self.i(if wide {
            I::I64Const(n)
        } else {
            I::I32Const(n as i32)
        });
        self.i(match (fun, wide) {
            (StdFun::Shl, true) => I::I64Shl,
            (StdFun::Shl, false) => I::I32Shl,
            (_, true) => I::I64ShrU,
            (_, false) => I::I32ShrU,
        });
    }

    /// BYTE and WORD: the value on the stack, rotated within its width.
    fn rotate_narrow(&mut self, fun: StdFun, count: &Expr, elem: Elem) {
        let width = elem.bits() as i32;
        let v = self.temp(ValType::I32);
        self.i(I::LocalSet(v));
        self.expr(count);
        self.i(I::I32WrapI64);
        if fun == StdFun::Ror {
            let n = self.temp(ValType::I32);
            self.i(I::LocalSet(n));
            self.i(I::I32Const(0));
            self.i(I::LocalGet(n));
            self.i(I::I32Sub);
            self.release(n);
        }
        self.i(I::I32Const(width - 1));
        self.i(I::I32And);
        let left = self.temp(ValType::I32);
        self.i(I::LocalSet(left));
        self.i(I::LocalGet(v));
        self.i(I::LocalGet(left));
        self.i(I::I32Shl);
        self.i(I::LocalGet(v));
        self.i(I::I32Const(width));
        self.i(I::LocalGet(left));
        self.i(I::I32Sub);
        self.i(I::I32ShrU);
        self.i(I::I32Or);
        self.normalise(elem);
        self.release(left);
        self.release(v);
    }
}

/// A constant real number that is neither 0 nor a NaN.
fn real_bound(expr: &Expr) -> Option<Value> {
    match &expr.kind {
        ExprKind::Const(value @ (Value::Real(_) | Value::Lreal(_))) => {
            let number = value.as_f64();
            (number != 0.0 && !number.is_nan()).then_some(*value)
        }
        _ => None,
    }
}
