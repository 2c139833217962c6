//! Places: their addresses.

use wasm_encoder::{Instruction as I, ValType};

use super::SiteKind;
use super::fun::{Fun, Slot, mem};
use super::hold::whole_var;
use crate::check::tree::{ExprKind, Place, Root, StepKind, VarId};
use crate::image;
use crate::syntax::ast::PouKind;
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
    /// Wherever a pointer leads, at an offset of 0: as many bytes as the type has, or a cell where it is known to be one.
    /// `site` is that of the trap.
    View { site: i32, whole: bool },
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

    /// Whether the variable is one of a function block's instance.
    pub fn is_in_instance(&self, id: VarId) -> bool {
        let project = self.m.project;
        let var = project.var(id);
        !var.constant
            && var
                .owner
                .is_some_and(|o| project.pou(o).kind == PouKind::FunctionBlock)
    }

    /// How much a FOR variable is ahead of its local.
    pub fn ahead_of(&self, place: &Place) -> Option<i128> {
        self.ahead.get(&whole_var(place)?).copied()
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
        let reads = std::mem::take(&mut self.reads);
        let mut dynamic = false;
        let mut addr = Addr {
            offset: 0,
            form: Form::Cell,
        };
        let mut ty = place.ty;
        let mut address_is_value = false;
        // In what lies closer in the process image than in memory: the bits before the part that is meant.
        let mut in_image: Option<u64> = None;
        // Whether a pointer leads to what is named so far, and whether that is certainly a cell.
        let (mut pointed, mut whole) = (false, false);
        match place.root {
            Root::This => {
                // A program has one instance, at a fixed place: its actions need no address.
                match self.instance.base {
                    Some(local) if project.pou(self.pou).kind != PouKind::Program => {
                        self.i(I::LocalGet(local));
                    }
                    _ => self.i(I::I32Const(0)),
                }
                addr.offset = self.instance.offset;
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
                        if self.is_in_instance(id) {
                            addr.offset += self.instance.offset;
                            if let Some(local) = self.instance.base {
                                self.i(I::LocalGet(local));
                                dynamic = true;
                            }
                        }
                        if let Some(location) = var.location {
                            addr.form = location.bit.map_or(Form::Image, Form::ImageBit);
                            if project.types.is_aggregate(var.ty) {
                                addr.form = Form::Cell;
                                in_image = var
                                    .is_closer(&project.types)
                                    .then(|| location.bit.unwrap_or(0).into());
                            }
                        }
                    }
                }
            }
        }
        for step in &place.steps {
            match &step.kind {
                StepKind::Field(index, owner) if in_image.is_some() => {
                    let bit = image::field_bit(&project.types, *owner, *index);
                    in_image = in_image.map(|first| first + bit);
                }
                StepKind::Field(index, owner) => {
                    addr.offset += self.m.plan.sizes.field(project, *owner, *index) as u32;
                    addr.form = Form::Cell;
                    whole = true;
                }
                StepKind::Member(var) => {
                    addr.offset += self.m.plan.sizes.offsets[var.0 as usize] as u32;
                    addr.form = Form::Cell;
                    whole = true;
                }
                StepKind::Index(indices) => {
                    let TypeKind::Array { dims, elem } = project.types.kind(ty).clone() else {
                        continue;
                    };
                    if let (Some(first), Some(Elem::Bool)) = (in_image, project.types.elem(elem)) {
                        in_image = None;
                        addr.offset += (first / 8) as u32;
                        let pushed = self.bit_of_image(indices, &dims, first % 8, &mut addr);
                        if pushed && dynamic {
                            self.i(I::I32Add);
                        }
                        dynamic |= pushed;
                        ty = step.ty;
                        continue;
                    }
                    let stride = match in_image {
                        Some(_) => (image::stride_bits(&project.types, elem) / 8) as u32,
                        None => self.m.plan.sizes.stride(project, elem) as u32,
                    };
                    let mut weights = vec![stride; dims.len()];
                    for d in (1..dims.len()).rev() {
                        let count = (dims[d].1 - dims[d].0 + 1) as u32;
                        weights[d - 1] = weights[d].saturating_mul(count);
                    }
                    for ((index, bounds), weight) in indices.iter().zip(&dims).zip(&weights) {
                        let low = i128::from(bounds.0);
                        let only = match &index.kind {
                            ExprKind::Const(value) => value.as_i128(),
                            _ => self
                                .only_value(index)
                                .filter(|v| (low..=i128::from(bounds.1)).contains(v)),
                        };
                        if let Some(value) = only {
                            addr.offset += (value - low) as u32 * weight;
                            continue;
                        }
                        self.index(index, *bounds, *weight, &mut addr.offset);
                        if dynamic {
                            self.i(I::I32Add);
                        }
                        dynamic = true;
                    }
                    let packed = project
                        .types
                        .elem(elem)
                        .is_some_and(Elem::is_packed_in_arrays);
                    whole = !packed;
                    addr.form = if packed { Form::Packed } else { Form::Cell };
                }
                StepKind::Bit(_) | StepKind::Part(..) => continue,
                StepKind::Deref => {
                    if !std::mem::take(&mut address_is_value) {
                        if pointed {
                            self.finish_address(dynamic, addr.offset);
                            self.reach(4, place.span);
                            addr.offset = 0;
                        } else if !dynamic {
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
                    pointed = project.types.is_pointer(ty);
                    whole = false;
                    if pointed {
                        self.begin_of_text(step.ty);
                    } else {
                        let size = self.m.size_of(step.ty);
                        self.reach_reference(size, place.span);
                    }
                }
                StepKind::Element(index) => {
                    self.finish_address(dynamic, addr.offset);
                    self.expr(index);
                    self.i(I::I32WrapI64);
                    let stride = self.m.plan.sizes.stride(project, step.ty) as u32;
                    self.scale(stride);
                    self.i(I::I32Add);
                    dynamic = true;
                    addr.offset = 0;
                    whole = false;
                }
                StepKind::Char(index) => {
                    let wide = step.ty == crate::types::TypeId::of(Elem::Wchar);
                    let width: u32 = if wide { 2 } else { 1 };
                    // The character must be one that the string has now.
                    self.finish_address(dynamic, addr.offset);
                    if std::mem::take(&mut pointed) {
                        self.check_text(wide, reads, place.span);
                    }
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
        if let Some(first) = in_image {
            addr.offset += (first / 8) as u32;
            addr.form = match project.types.elem(ty) {
                Some(Elem::Bool) => Form::ImageBit((first % 8) as u8),
                _ => Form::Image,
            };
        }
        if pointed {
            self.finish_address(dynamic, addr.offset);
            let form = self.check_address(ty, whole, reads, place.span);
            return (true, Addr { offset: 0, form });
        }
        (dynamic, addr)
    }
}
