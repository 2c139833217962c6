//! Pointers of CODESYS: what they lead to is looked at before it is used, and read and written in as many bytes as it has.

use std::collections::{BTreeMap, BTreeSet};

use wasm_encoder::{Instruction as I, ValType};

use super::fun::{Fun, Slot, mem, val};
use super::place::{Addr, Form};
use super::pointer_helper::{self, Reach};
use super::text::TEXT_HEADER;
use super::{SiteKind, State};
use crate::check::tree::{Expr, ExprKind, Place, Root, StepKind, TypedProject, VarId};
use crate::check::visit::{Node, visit};
use crate::memory::{is_kept, round_up};
use crate::source::Span;
use crate::syntax::ast::PouKind;
use crate::types::{Elem, TypeId, TypeKind};

/// Scratch memory is given out in pieces of so many bytes.
const PIECE_BYTES: u64 = 8;

/// Variables whose own address is taken.
pub fn addressed(project: &TypedProject, pointers: bool) -> BTreeSet<VarId> {
    let mut found = BTreeSet::new();
    for pou in project.pous.iter().filter(|_| pointers) {
        visit(&pou.body, &mut |node| {
            if let Node::Expr(Expr {
                kind: ExprKind::AddressOf(place),
                ..
            }) = node
                && let Root::Var(id) = place.root
                && !place
                    .steps
                    .iter()
                    .any(|s| matches!(s.kind, StepKind::Deref))
            {
                found.insert(id);
            }
        });
    }
    found
}

/// The longest STRING and WSTRING that there is, in characters: a pointer may lead to it.
pub fn longest_texts(project: &TypedProject) -> [u32; 2] {
    let mut most = [0; 2];
    for (_, ty) in project.types.iter() {
        if let TypeKind::Str { wide, len } = ty.kind {
            let most = &mut most[usize::from(wide)];
            *most = (*most).max(len);
        }
    }
    most
}

impl State<'_> {
    /// Writes the table of strings and constants behind everything else.
    pub fn note_strings(&mut self) {
        if !self.pointers {
            return;
        }
        let project = self.project;
        let mut list: Vec<(u32, u32, u32)> = Vec::new();
        for index in 0..project.vars.len() as u32 {
            let id = VarId(index);
            let var = project.var(id);
            let placed = match var.owner {
                None => true,
                Some(pou) => {
                    project.pou(pou).kind == PouKind::Program
                        && self.plan.reachable[pou.0 as usize]
                        && is_kept(var)
                }
            };
            if placed && !var.constant && var.location.is_none() {
                let at = self.plan.addresses[index as usize];
                self.strings_in(var.ty, at, &mut list);
            }
        }
        for (id, at) in self.scratch.clone() {
            self.strings_in(project.var(id).ty, at, &mut list);
        }
        let texts: BTreeMap<u32, u32> = (0..project.vars.len())
            .filter(|index| project.vars[*index].constant)
            .filter_map(|index| {
                let (wide, len) = project.types.text(project.vars[index].ty)?;
                let kind = pointer_helper::CONSTANT_TEXT | (len * 2 + u32::from(wide));
                Some((self.plan.addresses[index], kind))
            })
            .collect();
        let constants = self.plan.constants.iter().chain(&self.data);
        let constants: Vec<_> = constants
            .map(|(at, bytes)| {
                let end = round_up(u64::from(*at) + bytes.len() as u64, PIECE_BYTES);
                let kind = texts.get(at).copied();
                (*at, end as u32, kind.unwrap_or(pointer_helper::CONSTANT))
            })
            .collect();
        list.extend(constants);
        list.sort_unstable();
        let bytes: Vec<u8> = list
            .iter()
            .flat_map(|(from, to, kind)| [*from, *to, *kind])
            .flat_map(u32::to_le_bytes)
            .collect();
        let table = self.allocate(bytes.len() as u64);
        self.reach = Reach {
            from: self.plan.layout.regions.first().map_or(table, |r| r.offset),
            to: table,
            table,
            entries: list.len() as u32,
        };
        self.data.push((table, bytes));
    }

    /// The strings in a value of the type at the address.
    fn strings_in(&mut self, ty: TypeId, at: u32, list: &mut Vec<(u32, u32, u32)>) {
        let project = self.project;
        match project.types.kind(ty) {
            TypeKind::Str { wide, len } => {
                let end = at.saturating_add(self.size_of(ty));
                list.push((at, end, len * 2 + u32::from(*wide)));
            }
            TypeKind::Array { dims, elem } => {
                let stride = self.plan.sizes.stride(project, *elem) as u32;
                let mut first = Vec::new();
                self.strings_in(*elem, at, &mut first);
                if first.is_empty() {
                    return;
                }
                let count: i64 = dims.iter().map(|(l, h)| h - l + 1).product();
                for number in 0..count as u32 {
                    let by = number.saturating_mul(stride);
                    let moved = first.iter().map(|(from, to, kind)| {
                        (from.saturating_add(by), to.saturating_add(by), *kind)
                    });
                    list.extend(moved);
                }
            }
            TypeKind::Struct { fields } => {
                for (index, field) in fields.iter().enumerate() {
                    let offset = self.plan.sizes.field(project, ty, index) as u32;
                    self.strings_in(field.ty, at.saturating_add(offset), list);
                }
            }
            TypeKind::FunctionBlock(pou) => {
                for id in &project.pou(*pou).vars {
                    let var = project.var(*id);
                    if is_kept(var) {
                        let offset = self.plan.sizes.offsets[id.0 as usize] as u32;
                        self.strings_in(var.ty, at.saturating_add(offset), list);
                    }
                }
            }
            _ => {}
        }
    }
}

impl Fun<'_, '_> {
    fn address_site(&mut self, span: Span) -> i32 {
        self.m.site(SiteKind::Address, self.pou, span)
    }

    /// Traps unless so many bytes at the address on the stack lie in variables; the address stays.
    pub fn reach(&mut self, bytes: u32, span: Span) {
        let site = self.address_site(span);
        self.i(I::I32Const(bytes as i32));
        self.i(I::I32Const(site));
        self.i(I::Call(pointer_helper::REACH));
    }

    /// The same for a reference, where pointers could have written it.
    pub fn reach_reference(&mut self, bytes: u32, span: Span) {
        if self.m.pointers {
            self.reach(bytes, span);
        }
    }

    /// From the first character, to which a pointer to a string leads, to the string.
    pub fn begin_of_text(&mut self, ty: TypeId) {
        if self.m.project.types.text(ty).is_some() {
            self.i(I::I32Const(TEXT_HEADER as i32));
            self.i(I::I32Sub);
        }
    }

    /// Traps unless a string begins at the address on the stack; the address stays.
    pub fn check_text(&mut self, wide: bool, reads: bool, span: Span) {
        let site = self.address_site(span);
        let kind = i32::from(wide) | if reads { 0 } else { pointer_helper::WRITTEN };
        self.i(I::I32Const(kind));
        self.i(I::I32Const(site));
        self.i(I::Call(pointer_helper::TEXT));
    }

    /// Looks at the address on the stack, which a pointer leads to; answers how the value there is read and written.
    pub fn check_address(&mut self, ty: TypeId, whole: bool, reads: bool, span: Span) -> Form {
        let project = self.m.project;
        if let Some((wide, _)) = project.types.text(ty) {
            self.check_text(wide, reads, span);
            return Form::Cell;
        }
        let site = self.address_site(span);
        let Some(elem) = project.types.elem(ty) else {
            let size = self.m.size_of(ty);
            self.i(I::I32Const(size as i32));
            self.i(I::I32Const(site));
            self.i(I::Call(if reads {
                pointer_helper::REACH
            } else {
                pointer_helper::AREA
            }));
            return Form::Cell;
        };
        let bytes = if is_byte(elem, whole) {
            1
        } else {
            elem.cell_bytes()
        };
        self.reach(bytes, span);
        Form::View { site, whole }
    }

    /// Loads from the address on the stack.
    pub fn load_view(&mut self, elem: Elem, whole: bool) {
        if is_byte(elem, whole) {
            self.i(if elem == Elem::Sint {
                I::I32Load8S(mem(0, 0))
            } else {
                I::I32Load8U(mem(0, 0))
            });
            if elem == Elem::Bool {
                self.i(I::I32Const(0));
                self.i(I::I32Ne);
            }
            return;
        }
        self.i(match val(elem) {
            ValType::I64 => I::I64Load(mem(0, 0)),
            ValType::F64 => I::F64Load(mem(0, 0)),
            ValType::F32 => I::F32Load(mem(0, 0)),
            _ => I::I32Load(mem(0, 0)),
        });
    }

    /// Stores the value on the stack to the address below it.
    pub fn store_view(&mut self, elem: Elem, site: i32, whole: bool) {
        let put = match val(elem) {
            _ if is_byte(elem, whole) => pointer_helper::PUT8,
            ValType::I64 => pointer_helper::PUT64,
            ValType::F64 => {
                self.i(I::I64ReinterpretF64);
                pointer_helper::PUT64
            }
            ValType::F32 => {
                self.i(I::I32ReinterpretF32);
                pointer_helper::PUT32
            }
            _ => pointer_helper::PUT32,
        };
        self.i(I::I32Const(site));
        self.i(I::Call(put));
    }

    /// Keeps the address on the stack in a local as well, if strings lie there whose lengths a pointer may have spoilt.
    pub fn keep_for_strings(&mut self, ty: TypeId) -> Option<u32> {
        if !self.m.pointers || !self.holds_text(ty) {
            return None;
        }
        let local = self.temp(ValType::I32);
        self.i(I::LocalTee(local));
        Some(local)
    }

    /// After a value was copied as a whole to the address in the local: no string there is longer than it can be.
    pub fn settle(&mut self, address: Option<u32>, size: u32) {
        let Some(local) = address else { return };
        self.i(I::LocalGet(local));
        self.i(I::I32Const(size as i32));
        self.i(I::Call(pointer_helper::SETTLE));
        self.release(local);
    }

    fn holds_text(&self, ty: TypeId) -> bool {
        let project = self.m.project;
        match project.types.kind(ty) {
            TypeKind::Str { .. } => true,
            TypeKind::Array { elem, .. } => self.holds_text(*elem),
            TypeKind::Struct { fields } => fields.iter().any(|f| self.holds_text(f.ty)),
            TypeKind::FunctionBlock(pou) => project
                .pou(*pou)
                .vars
                .iter()
                .any(|v| is_kept(project.var(*v)) && self.holds_text(project.var(*v).ty)),
            _ => false,
        }
    }

    /// A pointer to a string is the address of its first character: adds what stands before it to the address on the stack.
    pub fn characters(&mut self, place: &Place, expr: &Expr) {
        let types = &self.m.project.types;
        let is_reference = matches!(types.kind(expr.ty), TypeKind::Ref(_));
        if self.m.pointers && !is_reference && types.text(place.ty).is_some() {
            self.i(I::I32Const(TEXT_HEADER as i32));
            self.i(I::I32Add);
        }
    }

    /// Pushes how many characters the string can have whose address lies on the stack and stays there, if a pointer leads to it.
    pub fn capacity_of_address(&mut self, place: &Place) -> bool {
        if !self.m.pointers || !self.m.project.is_through_pointer(place) {
            return false;
        }
        let address = self.temp(ValType::I32);
        self.i(I::LocalTee(address));
        self.i(I::LocalGet(address));
        self.i(I::Call(pointer_helper::CAPACITY));
        self.release(address);
        true
    }

    /// Moves a scalar of a call to memory, if its address is taken.
    pub fn place_addressed(&mut self, id: VarId, local: u32) {
        if !self.m.addressed.contains(&id) {
            return;
        }
        let elem = self.elem(self.m.project.var(id).ty);
        let at = self.m.scratch_of(id);
        self.i(I::I32Const(0));
        self.i(I::LocalGet(local));
        self.store_to(elem, cell(at));
        self.slots.insert(id, Slot::Scratch(at));
    }

    /// Pushes the value of such a variable, or nothing if it is no scalar.
    pub fn push_addressed(&mut self, id: VarId) {
        if let Some(elem) = self.m.project.types.elem(self.m.project.var(id).ty)
            && let Some(Slot::Scratch(at)) = self.slots.get(&id).copied()
        {
            self.i(I::I32Const(0));
            self.load_from(elem, cell(at));
        }
    }
}

fn cell(offset: u32) -> Addr {
    Addr {
        offset,
        form: Form::Cell,
    }
}

/// Whether one byte is read and written.
fn is_byte(elem: Elem, whole: bool) -> bool {
    elem.bits() <= 8 && !(whole && elem == Elem::Sint)
}
