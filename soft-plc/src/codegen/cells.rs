//! Loads and stores of scalars, with the different forms that a value has in memory.

use wasm_encoder::{Instruction as I, ValType};

use super::expr::simple;
use super::fun::{Fun, mem, val};
use super::place::{Addr, Form, Kept};
use crate::check::tree::{Expr, Place, Root, StepKind};
use crate::syntax::ast::BinOp;
use crate::types::Elem;
use crate::value::Value;

impl Fun<'_, '_> {
    /// Reads the value of a scalar place.
    pub fn load(&mut self, place: &Place) {
        let bit = Self::bits_of(place);
        let elem = self.whole_elem(place);
        match self.local_of(place) {
            Some(local) => {
                self.i(I::LocalGet(local));
                if let Some(ahead) = self.ahead_of(place) {
                    self.constant(Value::from_i128(elem, ahead), elem);
                    self.i(simple(BinOp::Add, elem));
                }
            }
            None => match self.known_local(place) {
                Some(local) => self.i(I::LocalGet(local)),
                None => {
                    self.reads = true;
                    let addr = self.address(place);
                    self.load_from(elem, addr);
                    if let Some(local) = self.learn(place) {
                        self.i(I::LocalTee(local));
                    }
                }
            },
        }
        if let Some((low, count)) = bit {
            self.pick_bits(elem, low, count);
        }
    }

    /// The elementary type of the place, or of what its bit is picked from.
    pub fn whole_elem(&self, place: &Place) -> Elem {
        let project = self.m.project;
        let mut ty = match (&place.root, place.steps.last()) {
            (Root::Var(id), _) => project.var(*id).ty,
            (Root::This, _) => place.ty,
            (Root::Direct(_), None) => return self.elem(place.ty),
            (Root::Direct(location), Some(_)) => {
                return match location.size {
                    'B' => Elem::Byte,
                    'W' => Elem::Word,
                    'D' => Elem::Dword,
                    _ => Elem::Lword,
                };
            }
        };
        for step in &place.steps {
            if !matches!(step.kind, StepKind::Bit(_) | StepKind::Part(..)) {
                ty = step.ty;
            }
        }
        self.elem(ty)
    }

    pub fn pick_bits(&mut self, elem: Elem, low: u8, count: u8) {
        if val(elem) == ValType::I64 {
            self.i(I::I64Const(i64::from(low)));
            self.i(I::I64ShrU);
            self.i(I::I32WrapI64);
        } else {
            self.i(I::I32Const(i32::from(low)));
            self.i(I::I32ShrU);
        }
        if count < 32 {
            self.i(I::I32Const((1i32 << count) - 1));
            self.i(I::I32And);
        }
    }

    /// Loads from the base on the stack.
    pub fn load_from(&mut self, elem: Elem, addr: Addr) {
        let o = addr.offset;
        match addr.form {
            Form::View { whole, .. } => self.load_view(elem, whole),
            Form::ImageBit(bit) => {
                self.i(I::I32Load8U(mem(o, 0)));
                if bit != 0 {
                    self.i(I::I32Const(i32::from(bit)));
                    self.i(I::I32ShrU);
                }
                self.i(I::I32Const(1));
                self.i(I::I32And);
            }
            Form::ImageBitAt(number) => {
                self.i(I::I32Load8U(mem(o, 0)));
                self.bit_number(number);
                self.i(I::I32ShrU);
                self.i(I::I32Const(1));
                self.i(I::I32And);
            }
            Form::Packed | Form::Image if elem.bits() <= 8 => self.i(if elem == Elem::Sint {
                I::I32Load8S(mem(o, 0))
            } else {
                I::I32Load8U(mem(o, 0))
            }),
            Form::Image if elem.bits() == 16 => self.i(if elem == Elem::Int {
                I::I32Load16S(mem(o, 0))
            } else {
                I::I32Load16U(mem(o, 0))
            }),
            _ => {
                let align = if addr.form == Form::Image { 0 } else { 2 };
                self.i(match val(elem) {
                    ValType::I64 => I::I64Load(mem(o, align)),
                    ValType::F64 => I::F64Load(mem(o, align)),
                    ValType::F32 => I::F32Load(mem(o, align)),
                    _ => I::I32Load(mem(o, align)),
                });
            }
        }
    }

    fn bit_number(&mut self, number: u32) {
        self.i(I::LocalGet(number));
        self.i(I::I32Const(7));
        self.i(I::I32And);
    }

    /// Stores the value on the stack to the base below it.
    pub fn store_to(&mut self, elem: Elem, addr: Addr) {
        self.canonical(elem);
        self.store_as_it_is(elem, addr);
    }

    /// The same for a value whose NaN, if it is one, is the canonical one.
    pub fn store_as_it_is(&mut self, elem: Elem, addr: Addr) {
        let o = addr.offset;
        match addr.form {
            Form::View { site, whole } => self.store_view(elem, site, whole),
            Form::ImageBit(bit) => {
                let value = self.temp(ValType::I32);
                let base = self.temp(ValType::I32);
                self.i(I::LocalSet(value));
                self.i(I::LocalTee(base));
                self.i(I::LocalGet(base));
                self.i(I::I32Load8U(mem(o, 0)));
                self.i(I::I32Const(!(1 << bit)));
                self.i(I::I32And);
                self.i(I::LocalGet(value));
                if bit != 0 {
                    self.i(I::I32Const(i32::from(bit)));
                    self.i(I::I32Shl);
                }
                self.i(I::I32Or);
                self.i(I::I32Store8(mem(o, 0)));
                self.release(base);
                self.release(value);
            }
            Form::ImageBitAt(number) => {
                let value = self.temp(ValType::I32);
                let base = self.temp(ValType::I32);
                self.i(I::LocalSet(value));
                self.i(I::LocalTee(base));
                self.i(I::LocalGet(base));
                self.i(I::I32Load8U(mem(o, 0)));
                self.i(I::I32Const(-2));
                self.bit_number(number);
                self.i(I::I32Rotl);
                self.i(I::I32And);
                self.i(I::LocalGet(value));
                self.bit_number(number);
                self.i(I::I32Shl);
                self.i(I::I32Or);
                self.i(I::I32Store8(mem(o, 0)));
                self.release(base);
                self.release(value);
            }
            Form::Packed | Form::Image if elem.bits() <= 8 => self.i(I::I32Store8(mem(o, 0))),
            Form::Image if elem.bits() == 16 => self.i(I::I32Store16(mem(o, 0))),
            _ => {
                let align = if addr.form == Form::Image { 0 } else { 2 };
                self.i(match val(elem) {
                    ValType::I64 => I::I64Store(mem(o, align)),
                    ValType::F64 => I::F64Store(mem(o, align)),
                    ValType::F32 => I::F32Store(mem(o, align)),
                    _ => I::I32Store(mem(o, align)),
                });
            }
        }
    }

    /// `place := value` for a scalar.
    pub fn store_value(&mut self, place: &Place, value: &Expr) {
        if self.local_of(place).is_none()
            && Self::bits_of(place).is_none()
            && self.is_canonical(value)
        {
            let addr = self.address(place);
            self.expr(value);
            self.store_known(place, self.elem(place.ty), addr, true);
        } else {
            self.store(place, |f| f.expr(value));
        }
    }

    /// `place := value` for a scalar; `value` pushes it.
    pub fn store(&mut self, place: &Place, value: impl FnOnce(&mut Self)) {
        let elem = self.whole_elem(place);
        let local = self.local_of(place);
        let Some((low, count)) = Self::bits_of(place) else {
            match local {
                Some(local) => {
                    value(self);
                    self.i(I::LocalSet(local));
                }
                None => {
                    let addr = self.address(place);
                    value(self);
                    self.store_known(place, elem, addr, false);
                }
            }
            self.forget_dependents(place, local);
            return;
        };
        match local {
            Some(local) => {
                self.merge_bits(elem, (low, count), |f| f.i(I::LocalGet(local)), value);
                self.i(I::LocalSet(local));
            }
            None => {
                let kept = self.keep_address(place);
                self.store_bits(elem, (low, count), &kept, value);
                self.release_kept(&kept);
                self.forget(place);
            }
        }
        self.forget_dependents(place, local);
    }

    /// Stores the value on the stack to the base below it, and keeps it in a local if it may be asked for again.
    fn store_known(&mut self, place: &Place, elem: Elem, addr: Addr, canonical: bool) {
        self.forget(place);
        if !canonical {
            self.canonical(elem);
        }
        if let Some(local) = self.learn(place) {
            self.i(I::LocalTee(local));
        }
        self.store_as_it_is(elem, addr);
    }

    /// A variable in a local is written: cells that it is an index of are others now.
    fn forget_dependents(&mut self, place: &Place, local: Option<u32>) {
        if local.is_some() {
            self.forget(place);
        }
    }

    /// Stores some bits of the cell at a kept address.
    pub fn store_bits(
        &mut self,
        elem: Elem,
        bits: (u8, u8),
        kept: &Kept,
        value: impl FnOnce(&mut Self),
    ) {
        self.push_kept(kept);
        let load = |f: &mut Self| {
            f.push_kept(kept);
            f.load_from(elem, kept.addr);
        };
        self.merge_bits(elem, bits, load, value);
        self.store_to(elem, kept.addr);
    }

    /// Pushes the old value with some bits replaced.
    pub fn merge_bits(
        &mut self,
        elem: Elem,
        (low, count): (u8, u8),
        old: impl FnOnce(&mut Self),
        value: impl FnOnce(&mut Self),
    ) {
        let wide = val(elem) == ValType::I64;
        let mask = ((1u64 << count) - 1) << low;
        let part = self.temp(ValType::I32);
        value(self);
        self.i(I::LocalSet(part));
        old(self);
        if wide {
            self.i(I::I64Const(!mask as i64));
            self.i(I::I64And);
            self.i(I::LocalGet(part));
            self.i(I::I64ExtendI32U);
            self.i(I::I64Const(i64::from(low)));
            self.i(I::I64Shl);
            self.i(I::I64Or);
        } else {
            self.i(I::I32Const(!mask as i32));
            self.i(I::I32And);
            self.i(I::LocalGet(part));
            self.i(I::I32Const(i32::from(low)));
            self.i(I::I32Shl);
            self.i(I::I32Or);
            // Setting the top bit of a SINT or INT makes it negative.
            self.normalise(elem);
        }
        self.release(part);
    }
}
