//! Variables in the process image, each at a place of its own.

use fam_soft_plc::types::Elem;

use super::scope::Scope;
use super::{StructDef, Ty, World};
use crate::shrink::Piece;

/// The structure whose fields can all lie in the process image.
const NAME: &str = "L0";
/// Largest array: of structures, and of elementary types.
const ELEMENTS: i64 = 3;
/// Distance of fields with relative addresses: `ELEMENTS` of 8 bytes fit.
const FIELD_BYTES: u32 = 32;
/// Fields at most.
const FIELDS: i64 = 4;
/// Distance of variables: an array of the structure fits.
const VARIABLE_BYTES: u32 = ELEMENTS as u32 * FIELDS as u32 * FIELD_BYTES;
/// What programs take together of each area.
const IMAGE_BYTES: u32 = 16_384;

impl World {
    /// Declares the structure.
    pub fn image_structure(&mut self) -> Piece {
        let relative = self.random.chance(50);
        let (mut lines, mut fields) = (Vec::new(), Vec::new());
        for number in 0..self.random.within(2, FIELDS) {
            let ty = self.flat_type();
            let name = format!("f{number}");
            let at = if relative {
                self.note("relative address");
                let byte = number as u32 * FIELD_BYTES;
                if is_bits(&ty) {
                    format!(" AT %X{byte}.{}", self.random.within(0, 7))
                } else {
                    format!(" AT %B{byte}")
                }
            } else {
                String::new()
            };
            lines.push(self.declaration(&format!("{name}{at}"), &ty));
            fields.push((name, ty));
        }
        self.structs.push(StructDef {
            name: NAME.to_owned(),
            fields,
        });
        Piece::block(format!("{NAME} : STRUCT"), lines, "END_STRUCT;")
    }

    /// An elementary type, or an array of one.
    fn flat_type(&mut self) -> Ty {
        let elem = match self.random.below(8) {
            0 => Ty::Enum(self.random.below(self.enums.len())),
            1 => Ty::Sub(self.random.below(self.subs.len())),
            2 | 3 => Ty::El(Elem::Bool),
            _ => Ty::El(self.elementary()),
        };
        if self.random.chance(40) {
            self.array(elem)
        } else {
            elem
        }
    }

    fn array(&mut self, elem: Ty) -> Ty {
        let low = self.random.within(-3, 3);
        let high = low + self.random.within(0, ELEMENTS - 1);
        Ty::Array(Box::new(elem), vec![(low, high)])
    }

    /// Declares variables in the process image and makes them known.
    pub fn located(&mut self, scope: &mut Scope) -> Vec<Piece> {
        let mut lines = Vec::new();
        for _ in 0..self.random.within(0, 2) {
            if self.image_bytes + VARIABLE_BYTES > IMAGE_BYTES {
                break;
            }
            let structure = Ty::Struct(self.structs.len() - 1);
            let ty = match self.random.below(5) {
                0 | 1 => self.flat_type(),
                2 | 3 => structure,
                _ => self.array(structure),
            };
            let (byte, area) = (self.image_bytes, *self.random.one(&['Q', 'M']));
            self.image_bytes += VARIABLE_BYTES;
            let at = match self.image_bits(&ty) {
                1 => format!("X{byte}.{}", self.random.within(0, 7)),
                8 => format!("B{byte}"),
                16 => format!("W{}", byte / 2),
                32 => format!("D{}", byte / 4),
                _ => format!("L{}", byte / 8),
            };
            let name = self.fresh("l");
            self.note("located variable");
            lines.push(self.declaration(&format!("{name} AT %{area}{at}"), &ty));
            let known = scope.leaves.len();
            self.enter(scope, &name, &ty, true, false);
            if matches!(ty, Ty::Struct(_) | Ty::Array(..)) {
                let mut parts = scope.leaves.split_off(known);
                parts.retain(|leaf| !matches!(leaf.ty, Ty::Struct(_) | Ty::Array(..)));
                scope.leaves.append(&mut parts);
                scope.located.push((name, ty));
            }
        }
        lines
    }

    /// Bits that the letter of an address stands for.
    fn image_bits(&self, ty: &Ty) -> u32 {
        match ty {
            Ty::El(elem) => elem.bits(),
            Ty::Enum(0) => Elem::Int.bits(),
            Ty::Enum(_) => Elem::Usint.bits(),
            Ty::Sub(number) => self.subs[*number].base.bits(),
            Ty::Array(elem, _) if is_bits(elem) => 1,
            _ => 8,
        }
    }

    /// An assignment of such an array or structure as a whole, or to one.
    pub fn copy_of_image(&mut self, scope: &mut Scope) -> Option<Piece> {
        if scope.located.is_empty() {
            return None;
        }
        let (name, ty) = self.random.one(&scope.located.clone()).clone();
        let twins: Vec<String> = scope
            .located
            .iter()
            .filter(|(other, t)| *t == ty && *other != name)
            .map(|(other, _)| other.clone())
            .collect();
        let (other, write) = if !twins.is_empty() && self.random.chance(50) {
            (self.random.one(&twins).clone(), true)
        } else {
            let (text, leaf) = self.place(scope, 1, |leaf| leaf.ty == ty)?;
            (text, leaf.write)
        };
        self.note("copy to or from the process image");
        Some(Piece::line(if write && self.random.chance(50) {
            format!("{other} := {name};")
        } else {
            format!("{name} := {other};")
        }))
    }
}

fn is_bits(ty: &Ty) -> bool {
    match ty {
        Ty::Array(elem, _) => is_bits(elem),
        _ => *ty == Ty::El(Elem::Bool),
    }
}
