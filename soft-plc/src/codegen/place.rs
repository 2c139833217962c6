//! Places: addresses, loads and stores, with the different forms that a value has in memory.

use wasm_encoder::{Instruction as I, ValType};

use super::SiteKind;
use super::fun::{Fun, Slot, mem, val};
use crate::check::tree::{Expr, ExprKind, Place, Root, StepKind};
use crate::types::{Elem, TypeKind};

/// How a value is written in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// An ordinary cell; also arrays and structures.
    Cell,
    /// An element of a packed array: 1 byte.
    Packed,
    /// As wide as the type, in the process image.
    Image,
    /// A bit of a byte in the process image.
    ImageBit(u8),
    /// The same for an element of an array: the lowest three bits of a local say which.
    ImageBitAt(u32),
}

/// An address: what was pushed, plus `offset`.
#[derive(Clone, Copy, Debug)]
pub struct Addr {
    pub offset: u32,
    pub form: Form,
}

/// An address kept for later: in a local, or constant.
#[derive(Clone, Copy, Debug)]
pub struct Kept {
    pub base: Option<u32>,
    pub addr: Addr,
}

impl Fun<'_, '_> {
    /// The local of a scalar that lives in one, whatever bit of it is meant.
    pub fn local_of(&self, place: &Place) -> Option<u32> {
        let Root::Var(id) = place.root else {
            return None;
        };
        if place
            .steps
            .iter()
            .any(|s| matches!(s.kind, StepKind::Deref))
        {
            return None;
        }
        match self.slots.get(&id) {
            Some(Slot::Local(local)) => Some(*local),
            _ => None,
        }
    }

    /// The lowest bit and the number of bits that are meant of a larger value.
    pub fn bits_of(place: &Place) -> Option<(u8, u8)> {
        let mut bits = None;
        for step in place.steps.iter().rev() {
            match step.kind {
                StepKind::Bit(bit) => bits = Some((bit, 1)),
                StepKind::Part(low, count) => {
                    bits = Some(bits.map_or((low, count), |(bit, n)| (bit + low, n)));
                }
                _ => break,
            }
        }
        bits
    }

    /// Pushes the base of the place and answers offset and form. A bit at the end is left to the caller.
    pub fn address(&mut self, place: &Place) -> Addr {
        let (dynamic, addr) = self.address_parts(place);
        if !dynamic {
            self.i(I::I32Const(0));
        }
        addr
    }

    /// Computes the address once, for several uses.
    pub fn keep_address(&mut self, place: &Place) -> Kept {
        let (dynamic, addr) = self.address_parts(place);
        let base = dynamic.then(|| {
            let local = self.temp(ValType::I32);
            self.i(I::LocalSet(local));
            local
        });
        Kept { base, addr }
    }

    pub fn push_kept(&mut self, kept: &Kept) {
        match kept.base {
            Some(local) => self.i(I::LocalGet(local)),
            None => self.i(I::I32Const(0)),
        }
    }

    pub fn release_kept(&mut self, kept: &Kept) {
        if let Some(local) = kept.base {
            self.release(local);
        }
    }

    /// Pushes base plus offset as one number.
    pub fn push_full_address(&mut self, place: &Place) -> Form {
        let (dynamic, addr) = self.address_parts(place);
        self.finish_address(dynamic, addr.offset);
        addr.form
    }

    fn finish_address(&mut self, dynamic: bool, offset: u32) {
        if !dynamic {
            self.i(I::I32Const(offset as i32));
        } else if offset != 0 {
            self.i(I::I32Const(offset as i32));
            self.i(I::I32Add);
        }
    }

    /// Pushes the part of the address that is known at run time only; answers whether there is one.
    fn address_parts(&mut self, place: &Place) -> (bool, Addr) {
        let project = self.m.project;
        let mut dynamic = false;
        let mut addr = Addr {
            offset: 0,
            form: Form::Cell,
        };
        let mut ty = place.ty;
        let mut address_is_value = false;
        // A located array whose elements lie closer than in memory, and the bit that it begins with.
        let mut closer = None;
        match place.root {
            Root::This => {
                // A program has one instance, at a fixed place: its actions need no address.
                if project.pou(self.pou).kind == crate::syntax::ast::PouKind::Program {
                    self.i(I::I32Const(0));
                } else {
                    self.i(I::LocalGet(0));
                }
                dynamic = true;
            }
            Root::Direct(location) => {
                let start = if location.memory {
                    self.m.plan.markers_at
                } else if location.output {
                    self.m.plan.layout.outputs.offset
                } else {
                    self.m.plan.layout.inputs.offset
                };
                addr.offset = start + location.byte;
                addr.form = location.bit.map_or(Form::Image, Form::ImageBit);
            }
            Root::Var(id) => {
                let var = project.var(id);
                ty = var.ty;
                match self.slots.get(&id).copied() {
                    Some(Slot::Pointer(local) | Slot::PointerText(local, _)) => {
                        self.i(I::LocalGet(local));
                        dynamic = true;
                    }
                    Some(Slot::Scratch(at)) => addr.offset = at,
                    Some(Slot::Local(local)) => {
                        // A reference in a local: its value is the address.
                        if place
                            .steps
                            .iter()
                            .any(|s| matches!(s.kind, StepKind::Deref))
                        {
                            self.i(I::LocalGet(local));
                            address_is_value = true;
                        }
                    }
                    None => {
                        addr.offset = self.m.plan.addresses[id.0 as usize];
                        let in_instance = var.owner.is_some_and(|o| {
                            project.pou(o).kind == crate::syntax::ast::PouKind::FunctionBlock
                        });
                        if in_instance && !var.constant {
                            self.i(I::LocalGet(0));
                            dynamic = true;
                        }
                        if let Some(location) = var.location {
                            addr.form = location.bit.map_or(Form::Image, Form::ImageBit);
                            if project.types.is_aggregate(var.ty) {
                                addr.form = Form::Cell;
                                let first = location.bit.unwrap_or(0);
                                closer = var.image_elem(&project.types).map(|e| (e, first));
                            }
                        }
                    }
                }
            }
        }
        for step in &place.steps {
            match &step.kind {
                StepKind::Field(index, owner) => {
                    addr.offset += self.m.plan.sizes.field(project, *owner, *index) as u32;
                    addr.form = Form::Cell;
                }
                StepKind::Member(var) => {
                    addr.offset += self.m.plan.sizes.offsets[var.0 as usize] as u32;
                    addr.form = Form::Cell;
                }
                StepKind::Index(indices) => {
                    let TypeKind::Array { dims, elem } = project.types.kind(ty).clone() else {
                        continue;
                    };
                    let closer = closer.take();
                    if let Some((Elem::Bool, first)) = closer {
                        dynamic = self.bit_of_image(indices, &dims, first, &mut addr);
                        ty = step.ty;
                        continue;
                    }
                    let stride = match closer {
                        Some((elem, _)) => elem.image_bytes(),
                        None => self.m.plan.sizes.stride(project, elem) as u32,
                    };
                    let mut weights = vec![stride; dims.len()];
                    for d in (1..dims.len()).rev() {
                        let count = (dims[d].1 - dims[d].0 + 1) as u32;
                        weights[d - 1] = weights[d].saturating_mul(count);
                    }
                    for ((index, bounds), weight) in indices.iter().zip(&dims).zip(&weights) {
                        if let ExprKind::Const(value) = &index.kind {
                            let at = value.as_i128().unwrap_or(0) - i128::from(bounds.0);
                            addr.offset += at as u32 * weight;
                            continue;
                        }
                        self.index(index, *bounds, *weight);
                        if dynamic {
                            self.i(I::I32Add);
                        }
                        dynamic = true;
                    }
                    let packed = project
                        .types
                        .elem(elem)
                        .is_some_and(Elem::is_packed_in_arrays);
                    addr.form = match (closer, packed) {
                        (Some(_), _) => Form::Image,
                        (None, true) => Form::Packed,
                        (None, false) => Form::Cell,
                    };
                }
                StepKind::Bit(_) | StepKind::Part(..) => continue,
                StepKind::Deref => {
                    if !std::mem::take(&mut address_is_value) {
                        if !dynamic {
                            self.i(I::I32Const(0));
                        }
                        self.i(I::I32Load(mem(addr.offset, 2)));
                    }
                    let target = self.temp(ValType::I32);
                    self.i(I::LocalTee(target));
                    self.i(I::I32Eqz);
                    self.trap_if(SiteKind::NullReference, place.span, None);
                    self.i(I::LocalGet(target));
                    self.release(target);
                    dynamic = true;
                    addr = Addr {
                        offset: 0,
                        form: Form::Cell,
                    };
                }
                StepKind::Char(index) => {
                    let wide = step.ty == crate::types::TypeId::of(Elem::Wchar);
                    let width: u32 = if wide { 2 } else { 1 };
                    // The character must be one that the string has now.
                    self.finish_address(dynamic, addr.offset);
                    let base = self.temp(ValType::I32);
                    self.i(I::LocalSet(base));
                    self.expr(index);
                    let number = self.temp(ValType::I64);
                    self.i(I::LocalTee(number));
                    self.i(I::I64Const(1));
                    self.i(I::I64Sub);
                    self.i(I::LocalGet(base));
                    self.i(I::I32Load(mem(0, 2)));
                    self.i(I::I64ExtendI32U);
                    self.i(I::I64GeU);
                    let detail = Some((number, Elem::Lint));
                    self.trap_if(SiteKind::Character, index.span, detail);
                    self.i(I::LocalGet(base));
                    self.i(I::LocalGet(number));
                    self.i(I::I32WrapI64);
                    self.scale(width);
                    self.i(I::I32Add);
                    self.release(number);
                    self.release(base);
                    dynamic = true;
                    addr = Addr {
                        offset: super::text::TEXT_HEADER - width,
                        form: if wide { Form::Image } else { Form::Packed },
                    };
                }
            }
            ty = step.ty;
        }
        (dynamic, addr)
    }

    /// An element of a located array of BOOL, bits side by side from `first` on. Answers whether something was pushed.
    fn bit_of_image(
        &mut self,
        indices: &[Expr],
        dims: &[(i64, i64)],
        first: u8,
        addr: &mut Addr,
    ) -> bool {
        let mut known = u32::from(first);
        let mut pushed = false;
        let mut weight = 1u32;
        for (index, bounds) in indices.iter().zip(dims).rev() {
            if let ExprKind::Const(value) = &index.kind {
                let at = value.as_i128().unwrap_or(0) - i128::from(bounds.0);
                known = known.wrapping_add((at as u32).wrapping_mul(weight));
            } else {
                self.index(index, *bounds, weight);
                if pushed {
                    self.i(I::I32Add);
                }
                pushed = true;
            }
            weight = weight.saturating_mul((bounds.1 - bounds.0 + 1) as u32);
        }
        if !pushed {
            addr.offset += known / 8;
            addr.form = Form::ImageBit((known % 8) as u8);
            return false;
        }
        let number = self.new_local(ValType::I32);
        self.i(I::I32Const(known as i32));
        self.i(I::I32Add);
        self.i(I::LocalTee(number));
        self.i(I::I32Const(3));
        self.i(I::I32ShrU);
        addr.form = Form::ImageBitAt(number);
        true
    }

    /// Pushes `(index - low) * weight` after checking the bounds.
    fn index(&mut self, index: &Expr, bounds: (i64, i64), weight: u32) {
        let elem = self.elem(index.ty);
        let count = bounds.1 - bounds.0 + 1;
        self.expr(index);
        let certain = self
            .range_of(index)
            .is_some_and(|(low, high)| low >= i128::from(bounds.0) && high <= i128::from(bounds.1));
        if certain {
            if val(elem) == ValType::I64 {
                self.i(I::I32WrapI64);
            }
            self.subtract(bounds.0);
            self.scale(weight);
            return;
        }
        let kind = SiteKind::Index(bounds.0, bounds.1);
        // UDINT and LINT are checked in 64 bits, so that no wrapped value looks valid.
        let wide = matches!(elem, Elem::Udint | Elem::Lint);
        if elem == Elem::Udint {
            self.i(I::I64ExtendI32U);
        }
        let ty = if wide { ValType::I64 } else { ValType::I32 };
        let local = self.temp(ty);
        if wide {
            self.i(I::LocalTee(local));
            self.i(I::I64Const(bounds.0));
            self.i(I::I64Sub);
            self.i(I::I64Const(count));
            self.i(I::I64GeU);
            self.trap_if(kind, index.span, Some((local, Elem::Lint)));
            self.i(I::LocalGet(local));
            self.i(I::I32WrapI64);
            self.subtract(bounds.0);
        } else {
            self.i(I::LocalTee(local));
            self.subtract(bounds.0);
            self.i(I::I32Const(count as i32));
            self.i(I::I32GeU);
            self.trap_if(kind, index.span, Some((local, Elem::Dint)));
            self.i(I::LocalGet(local));
            self.subtract(bounds.0);
        }
        self.release(local);
        self.scale(weight);
    }

    fn subtract(&mut self, low: i64) {
        if low != 0 {
            self.i(I::I32Const(low as i32));
            self.i(I::I32Sub);
        }
    }

    fn scale(&mut self, weight: u32) {
        if weight.is_power_of_two() {
            if weight > 1 {
                self.i(I::I32Const(weight.trailing_zeros() as i32));
                self.i(I::I32Shl);
            }
        } else {
            self.i(I::I32Const(weight as i32));
            self.i(I::I32Mul);
        }
    }

    /// Reads the value of a scalar place.
    pub fn load(&mut self, place: &Place) {
        let bit = Self::bits_of(place);
        let elem = self.whole_elem(place);
        match self.local_of(place) {
            Some(local) => self.i(I::LocalGet(local)),
            None => match self.known_local(place) {
                Some(local) => self.i(I::LocalGet(local)),
                None => {
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
