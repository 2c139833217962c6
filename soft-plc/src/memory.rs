//! How variables lie in linear memory. Part of the product's contract: checkpoints are these bytes.
//!
//! - A scalar takes a cell of 4 bytes; LINT, ULINT, LWORD, LREAL and TIME take 8 bytes at an 8-byte boundary. Integers in a
//!   cell are sign-extended or zero-extended to it; BOOL is 0 or 1; TIME is signed 64-bit nanoseconds. Little-endian.
//!   A NaN in memory is the canonical one (16#7FC0_0000, 16#7FF8_0000_0000_0000), so that equal states have equal bytes.
//! - Elements of an array are cells too, except BOOL, BYTE, SINT and USINT, which take 1 byte each; the array ends at a
//!   4-byte boundary. The last index varies fastest.
//! - A STRING is its current length (4 bytes), then as many bytes as its declared length, those beyond the current length 0;
//!   a WSTRING likewise, with 2 bytes for each character. It ends at a 4-byte boundary. In projects with pointers of CODESYS there is
//!   room for one character more, which is always 0.
//! - DATE, TIME_OF_DAY and DATE_AND_TIME take 8 bytes like TIME; a reference is the address of what it refers to, or 0.
//! - `%M` variables lie behind the first region, byte by byte as they are addressed.
//! - Structures and function block instances are contiguous, in the order of declaration, aligned as their widest cell.
//!   VAR_IN_OUT, VAR_TEMP and constants take no place in an instance.
//! - Linear memory: the system area (`MC_TIME_AT`, `TRAP_SITE_AT`, `TRAP_DETAIL_AT`, `STOP_AT`, `SCAN_NUMBER_AT`), inputs, outputs, the named regions in
//!   the order of the specification, region `work`, constants, scratch. Each starts at a multiple of 8.
//! - Inputs and outputs are images of the process: BOOLs are bits, `%IW n` are bytes 2n and 2n+1, and so on.

use crate::check::tree::{InitValue, PouId, TypedProject, Var, VarId};
use crate::syntax::ast::VarSection;
use crate::types::{TypeId, TypeKind};

/// MC time, i64 nanoseconds, written by the host before each scan.
pub const MC_TIME_AT: u32 = 0;
/// Number of the site that trapped, u32; 0 is none.
pub const TRAP_SITE_AT: u32 = 8;
/// Number of the site that last called a function of the library that can trap, u32.
pub const CALLER_SITE_AT: u32 = 12;
/// The value that caused the trap (an index, a value out of range), i64.
pub const TRAP_DETAIL_AT: u32 = 16;
/// Number of the scan that the watchdog wants to end, u32: loops look at it.
pub const STOP_AT: u32 = 24;
/// Written by loops that look at `STOP_AT`, so that no compiler takes what it read before for what stands there now.
pub const STOP_FENCE_AT: u32 = 28;
/// Number of the scan that runs, u32, written by the host before each scan; never 0.
pub const SCAN_NUMBER_AT: u32 = 32;
/// Length of the system area.
pub const SYSTEM_BYTES: u32 = 64;
/// Largest linear memory of one MC.
pub const MEMORY_BYTES_MAX: u64 = 512 * 1024 * 1024;

pub(crate) fn round_up(value: u64, align: u64) -> u64 {
    value.saturating_add(align - 1) / align * align
}

/// Sizes of types and offsets of variables in function block instances.
pub(crate) struct Sizes {
    types: Vec<Option<(u64, u64)>>,
    /// Strings end with a 0 of their own, as pointers expect it.
    ended: bool,
    /// Offset of each variable that lies in an instance, by variable number.
    pub offsets: Vec<u64>,
}

/// Whether the variable takes memory in the instance of its POU.
pub(crate) fn is_kept(var: &Var) -> bool {
    !var.constant
        && var.location.is_none()
        && matches!(
            var.section,
            VarSection::Local | VarSection::Input | VarSection::Output
        )
}

impl Sizes {
    pub fn new(project: &TypedProject) -> Self {
        let count = project.types.iter().count();
        Self {
            types: vec![None; count],
            ended: project.uses_pointers(),
            offsets: vec![0; project.vars.len()],
        }
    }

    /// Size and alignment in bytes.
    pub fn of(&mut self, project: &TypedProject, ty: TypeId) -> (u64, u64) {
        if let Some(known) = self.types[ty.0 as usize] {
            return known;
        }
        let result = match project.types.kind(ty) {
            TypeKind::Array { dims, elem } => {
                let stride = self.stride(project, *elem);
                let (_, align) = self.of(project, *elem);
                let count: u64 = dims
                    .iter()
                    .map(|(l, h)| (h - l + 1) as u64)
                    .fold(1, u64::saturating_mul);
                let align = align.max(4);
                (round_up(count.saturating_mul(stride), align), align)
            }
            TypeKind::Struct { fields } => {
                let (mut end, mut align) = (0, 4);
                for field in fields {
                    let (size, a) = self.of(project, field.ty);
                    end = round_up(end, a).saturating_add(size);
                    align = align.max(a);
                }
                (round_up(end, align), align)
            }
            TypeKind::FunctionBlock(pou) => self.instance(project, *pou),
            TypeKind::Str { wide, len } => {
                let units = u64::from(*len) + u64::from(self.ended);
                let bytes = units * if *wide { 2 } else { 1 };
                (4 + round_up(bytes, 4), 4)
            }
            _ => match project.types.elem(ty) {
                Some(elem) => {
                    let bytes = u64::from(elem.cell_bytes());
                    (bytes, bytes)
                }
                None => (0, 4),
            },
        };
        self.types[ty.0 as usize] = Some(result);
        result
    }

    /// Distance from one element of an array to the next.
    pub fn stride(&mut self, project: &TypedProject, elem: TypeId) -> u64 {
        match project.types.elem(elem) {
            Some(e) if e.is_packed_in_arrays() => 1,
            _ => {
                let (size, align) = self.of(project, elem);
                round_up(size, align)
            }
        }
    }

    /// Lays out the variables of a POU one after the other; offsets count from the start of the instance.
    pub fn instance(&mut self, project: &TypedProject, pou: PouId) -> (u64, u64) {
        let (mut end, mut align) = (0, 4);
        for id in &project.pou(pou).vars {
            let var = project.var(*id);
            if !is_kept(var) {
                continue;
            }
            let (size, a) = self.of(project, var.ty);
            let at = round_up(end, a);
            self.offsets[id.0 as usize] = at;
            end = at.saturating_add(size);
            align = align.max(a);
        }
        (round_up(end, align), align)
    }

    /// Offset of a field in its structure.
    pub fn field(&mut self, project: &TypedProject, ty: TypeId, index: usize) -> u64 {
        let TypeKind::Struct { fields } = project.types.kind(ty) else {
            return 0;
        };
        let mut end = 0;
        for (i, field) in fields.iter().enumerate() {
            let (size, align) = self.of(project, field.ty);
            let at = round_up(end, align);
            if i == index {
                return at;
            }
            end = at.saturating_add(size);
        }
        0
    }
}

/// Writes initial values into memory.
pub(crate) struct Filler<'a> {
    pub project: &'a TypedProject,
    pub sizes: &'a mut Sizes,
}

impl Filler<'_> {
    /// The initial value of a variable: that of its type, then its own over it.
    pub fn variable(&mut self, bytes: &mut [u8], ty: TypeId, init: Option<&InitValue>) {
        self.default(bytes, ty);
        if let Some(init) = init {
            self.overlay(bytes, ty, init);
        }
    }

    fn default(&mut self, bytes: &mut [u8], ty: TypeId) {
        let project = self.project;
        match project.types.kind(ty) {
            TypeKind::Array { dims, elem } => {
                let count: usize = dims.iter().map(|(l, h)| (h - l + 1) as usize).product();
                let stride = self.sizes.stride(project, *elem) as usize;
                if count > 0 {
                    self.default(&mut bytes[..stride], *elem);
                    if bytes[..stride].iter().any(|b| *b != 0) {
                        for i in 1..count {
                            bytes.copy_within(0..stride, i * stride);
                        }
                    }
                }
            }
            TypeKind::Struct { fields } => {
                let mut end = 0;
                for field in fields {
                    let (size, align) = self.sizes.of(project, field.ty);
                    let at = round_up(end, align);
                    end = at + size;
                    let part = &mut bytes[at as usize..end as usize];
                    self.variable(part, field.ty, field.init.as_ref());
                }
            }
            TypeKind::FunctionBlock(pou) => {
                for id in &project.pou(*pou).vars {
                    let var = project.var(*id);
                    if is_kept(var) {
                        let at = self.sizes.offsets[id.0 as usize] as usize;
                        let (size, _) = self.sizes.of(project, var.ty);
                        let part = &mut bytes[at..at + size as usize];
                        self.variable(part, var.ty, var.init.as_ref());
                    }
                }
                if let Some(tag) = project.pou(*pou).tag {
                    let at = self.sizes.offsets[tag.0 as usize] as usize;
                    let value = crate::codegen::tag_of(*pou);
                    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
                }
            }
            TypeKind::Str { .. } => {}
            _ => {
                if let Some(value) = project.types.default_value(ty) {
                    value.store(bytes);
                }
                return;
            }
        }
        if let Some(init) = project.types.init(ty) {
            self.overlay(bytes, ty, init);
        }
    }

    fn overlay(&mut self, bytes: &mut [u8], ty: TypeId, init: &InitValue) {
        let project = self.project;
        match (init, project.types.kind(ty)) {
            (InitValue::Scalar(value), _) => value.store(bytes),
            (InitValue::Text(units), TypeKind::Str { wide, len }) => {
                bytes.fill(0);
                let count = units.len().min(*len as usize);
                bytes[..4].copy_from_slice(&(count as u32).to_le_bytes());
                for (index, unit) in units[..count].iter().enumerate() {
                    if *wide {
                        let at = 4 + index * 2;
                        bytes[at..at + 2].copy_from_slice(&unit.to_le_bytes());
                    } else {
                        bytes[4 + index] = *unit as u8;
                    }
                }
            }
            (InitValue::Array(items), TypeKind::Array { elem, .. }) => {
                let stride = self.sizes.stride(project, *elem) as usize;
                let mut at = 0;
                for (count, item) in items {
                    for _ in 0..*count {
                        if let Some(part) = bytes.get_mut(at..at + stride) {
                            self.overlay(part, *elem, item);
                        }
                        at += stride;
                    }
                }
            }
            (InitValue::Struct(items), TypeKind::Struct { fields }) => {
                for (index, item) in items {
                    let at = self.sizes.field(project, ty, *index) as usize;
                    let (size, _) = self.sizes.of(project, fields[*index].ty);
                    let part = &mut bytes[at..at + size as usize];
                    self.overlay(part, fields[*index].ty, item);
                }
            }
            (InitValue::Instance(items), TypeKind::FunctionBlock(_)) => {
                for (id, item) in items {
                    let var: &Var = project.var(*id);
                    let at = self.offset(*id);
                    let (size, _) = self.sizes.of(project, var.ty);
                    let part = &mut bytes[at..at + size as usize];
                    self.overlay(part, var.ty, item);
                }
            }
            _ => {}
        }
    }

    fn offset(&self, id: VarId) -> usize {
        self.sizes.offsets[id.0 as usize] as usize
    }
}
