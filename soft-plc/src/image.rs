//! How structures and arrays lie in the process image: each part as a single variable would, one behind the other.
//!
//! A BOOL takes a bit, everything else begins at a multiple of its own size, a structure at a byte. A field with a relative
//! address (IEC 61131-3, clause 6.4.4.6) lies there instead, counted from the start of its structure.

use crate::check::tree::{Location, TypedProject, Var};
use crate::types::{Elem, TypeId, TypeKind, TypeTable};
use std::collections::{BTreeMap, BTreeSet};

const BYTE: u64 = 8;

/// The name of the array in the image that has the characters of a located string.
pub(crate) fn characters_of(text: &str) -> String {
    format!("__text_{text}")
}

/// A located variable of an elementary type, or a scalar of one that is an array or structure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageScalar {
    /// `level`, `levels[2]`, `drive.speed`.
    pub path: String,
    pub ty: TypeId,
    pub elem: Elem,
    pub location: Location,
}

/// The scalars of a variable at inputs or outputs in the order of their places. Empty if it lies elsewhere.
pub fn scalars(project: &TypedProject, var: &Var) -> Vec<ImageScalar> {
    let mut list = Vec::new();
    if let Some(location) = var.location.filter(|l| !l.memory) {
        let first = u64::from(location.byte) * BYTE + u64::from(location.bit.unwrap_or(0));
        add_scalars(
            project,
            var.ty,
            var.name.clone(),
            first,
            location,
            &mut list,
        );
    }
    list
}

fn add_scalars(
    project: &TypedProject,
    ty: TypeId,
    path: String,
    first: u64,
    of: Location,
    list: &mut Vec<ImageScalar>,
) {
    let types = &project.types;
    match types.kind(ty) {
        TypeKind::Array { dims, elem } => {
            let stride = stride_bits(types, *elem);
            let counts = dims.iter().map(|(l, h)| h - l + 1);
            for number in 0..counts.product::<i64>() {
                let mut rest = number;
                let mut indices = Vec::new();
                for (low, high) in dims.iter().rev() {
                    indices.insert(0, (low + rest % (high - low + 1)).to_string());
                    rest /= high - low + 1;
                }
                let path = format!("{path}[{}]", indices.join(","));
                let first = first + number as u64 * stride;
                add_scalars(project, *elem, path, first, of, list);
            }
        }
        TypeKind::Struct { fields } => {
            for (index, part) in fields.iter().enumerate() {
                let path = format!("{path}.{}", part.name);
                let first = first + field_bit(types, ty, index);
                add_scalars(project, part.ty, path, first, of, list);
            }
        }
        _ => {
            let Some(elem) = types.elem(ty) else {
                return;
            };
            let byte = (first / BYTE) as u32;
            let size = match elem.image_bytes() {
                _ if elem == Elem::Bool => 'X',
                2 if byte.is_multiple_of(2) => 'W',
                4 if byte.is_multiple_of(4) => 'D',
                8 if byte.is_multiple_of(8) => 'L',
                _ => 'B',
            };
            let location = Location {
                byte,
                bit: (elem == Elem::Bool).then_some((first % BYTE) as u8),
                size,
                ..of
            };
            list.push(ImageScalar {
                path,
                ty,
                elem,
                location,
            });
        }
    }
}

/// Bits that a value of the type takes in the image, and of what number of bits its address is a multiple. References cannot lie
/// there, and strings only by their characters (`crate::check::located_text`).
pub(crate) fn extent(types: &TypeTable, ty: TypeId) -> Option<(u64, u64)> {
    Extents::default().of(types, ty)
}

/// Extents that are known already: a structure may stand many times in another one.
#[derive(Default)]
struct Extents(BTreeMap<TypeId, Option<(u64, u64)>>);

impl Extents {
    fn of(&mut self, types: &TypeTable, ty: TypeId) -> Option<(u64, u64)> {
        if let Some(known) = self.0.get(&ty) {
            return *known;
        }
        let result = self.work_out(types, ty);
        self.0.insert(ty, result);
        result
    }

    fn work_out(&mut self, types: &TypeTable, ty: TypeId) -> Option<(u64, u64)> {
        match types.kind(ty) {
            TypeKind::Array { dims, elem } => {
                let counts = dims.iter().map(|(l, h)| (h - l + 1) as u64);
                let count = counts.fold(1, u64::saturating_mul);
                let (bits, align) = self.of(types, *elem)?;
                Some((count.saturating_mul(bits), align))
            }
            TypeKind::Struct { .. } => {
                let (mut end, mut align) = (0, BYTE);
                for (from, bits, a) in self.fields(types, ty)? {
                    end = end.max(from.saturating_add(bits));
                    align = align.max(a);
                }
                Some((end.checked_next_multiple_of(align)?, align))
            }
            _ => {
                let elem = types.elem(ty).filter(|e| *e != Elem::Ref)?;
                let bits = u64::from(elem.bits());
                Some((bits, bits))
            }
        }
    }

    /// Of each field its first bit, bits that it takes, and what its address is a multiple of.
    fn fields(&mut self, types: &TypeTable, ty: TypeId) -> Option<Vec<(u64, u64, u64)>> {
        let TypeKind::Struct { fields } = types.kind(ty) else {
            return None;
        };
        let mut end = 0u64;
        let mut places = Vec::new();
        for field in fields {
            let (bits, align) = self.of(types, field.ty)?;
            let (from, align) = match field.at {
                Some(at) => (at, 1),
                None => (end.checked_next_multiple_of(align)?, align),
            };
            places.push((from, bits, align));
            end = from.saturating_add(bits);
        }
        Some(places)
    }
}

/// First bit of a field, bits that it takes, and what its address is a multiple of.
pub(crate) fn field(types: &TypeTable, ty: TypeId, index: usize) -> Option<(u64, u64, u64)> {
    let places = Extents::default().fields(types, ty)?;
    places.get(index).copied()
}

/// First bit of a field whose structure is known to fit in the image.
pub(crate) fn field_bit(types: &TypeTable, ty: TypeId, index: usize) -> u64 {
    field(types, ty, index).map_or(0, |(from, ..)| from)
}

/// Bits from one element of an array to the next.
pub(crate) fn stride_bits(types: &TypeTable, elem: TypeId) -> u64 {
    extent(types, elem).map_or(0, |(bits, _)| bits)
}

/// Two fields of the structure that share bits, if there are any.
pub(crate) fn overlap(types: &TypeTable, ty: TypeId) -> Option<(usize, usize)> {
    let places = Extents::default().fields(types, ty)?;
    (1..places.len()).find_map(|later| {
        let (from, bits, _) = places[later];
        let shared = |(f, b, _): &(u64, u64, u64)| {
            *f < from.saturating_add(bits) && from < f.saturating_add(*b)
        };
        let earlier = places[..later].iter().position(shared)?;
        Some((earlier, later))
    })
}

/// Whether a structure whose fields share bits is part of the type.
pub(crate) fn has_overlap(types: &TypeTable, ty: TypeId) -> bool {
    let mut seen = BTreeSet::new();
    let mut next = vec![ty];
    while let Some(ty) = next.pop() {
        match types.kind(ty) {
            _ if !seen.insert(ty) => {}
            TypeKind::Array { elem, .. } => next.push(*elem),
            TypeKind::Struct { .. } if overlap(types, ty).is_some() => return true,
            TypeKind::Struct { fields } => next.extend(fields.iter().map(|f| f.ty)),
            _ => {}
        }
    }
    false
}

/// Whether a variable of the type lies closer in the image than in memory. Such a one has no address that a POU could be given;
/// its scalars are reached one by one.
pub(crate) fn is_closer(types: &TypeTable, ty: TypeId) -> bool {
    match types.kind(ty) {
        TypeKind::Array { elem, .. } => match types.elem(*elem) {
            Some(elem) => elem == Elem::Bool || elem.bits() == 16,
            None => true,
        },
        TypeKind::Struct { .. } => true,
        _ => false,
    }
}
