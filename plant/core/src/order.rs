//! Orders: the variant that each product must be.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::part::{LidHeight, Material, Part, Shape, draw, lid_material};

const ORDER_STREAM: u64 = 0x0f_0f;

/// What an order asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Variant {
    pub lid_material: Material,
    pub lid_height: LidHeight,
    pub shaft_material: Material,
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let height = match self.lid_height {
            LidHeight::Low => "low",
            LidHeight::High => "high",
        };
        write!(
            f,
            "{height} lid of {}, shaft of {}",
            self.lid_material.name(),
            self.shaft_material.name()
        )
    }
}

impl Variant {
    /// Variant of the `number`-th order.
    pub fn ordered(seed: u64, number: u16) -> Self {
        let draw = draw(seed, ORDER_STREAM, u64::from(number));
        Variant {
            lid_material: lid_material((draw % 3) as u8),
            lid_height: if draw >> 16 & 1 == 1 {
                LidHeight::High
            } else {
                LidHeight::Low
            },
            shaft_material: if draw >> 32 & 1 == 1 {
                Material::Nylon
            } else {
                Material::Aluminium
            },
        }
    }

    /// The word that the transport unit shows: lid material + 4 x lid height + 8 x shaft material.
    pub fn code(self) -> u16 {
        let lid = match self.lid_material {
            Material::WhitePlastic => 1,
            Material::BlackPlastic => 2,
            Material::Aluminium | Material::Nylon => 0,
        };
        let high = u16::from(self.lid_height == LidHeight::High);
        let nylon = u16::from(self.shaft_material == Material::Nylon);
        lid + 4 * high + 8 * nylon
    }

    /// Whether a set of these parts is what was ordered: right shaft and lid, good base and bearing, nothing damaged.
    pub fn is_met_by(self, parts: &[Part]) -> bool {
        parts.iter().all(|part| {
            !part.damaged
                && match part.shape {
                    Shape::Shaft { material } => material == self.shaft_material,
                    Shape::Lid { material, height } => {
                        material == self.lid_material && height == self.lid_height
                    }
                    Shape::Base { .. } | Shape::Bearing { .. } => part.is_as_its_magazine_says(),
                }
        })
    }
}
