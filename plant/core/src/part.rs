//! Parts: what they are, and the seeded magazines that they come from.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The four pieces of a set, in the order in which they are put together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PartKind {
    Base,
    Bearing,
    Shaft,
    Lid,
}

impl PartKind {
    /// Place of the piece in the stack on the pallet, 0 at the bottom.
    pub fn level(self) -> usize {
        match self {
            PartKind::Base => 0,
            PartKind::Bearing => 1,
            PartKind::Shaft => 2,
            PartKind::Lid => 3,
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            PartKind::Base => "base",
            PartKind::Bearing => "bearing",
            PartKind::Shaft => "shaft",
            PartKind::Lid => "lid",
        }
    }
}

/// Number of pieces in a complete set.
pub const SET_PIECES: usize = 4;

/// Which part it is: the `number`-th (from 1) out of that magazine of that kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct PartId {
    pub kind: PartKind,
    pub magazine: u8,
    pub number: u32,
}

impl fmt::Display for PartId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}.{}", self.kind.name(), self.magazine, self.number)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Material {
    Aluminium,
    WhitePlastic,
    BlackPlastic,
    Nylon,
}

impl Material {
    pub fn name(self) -> &'static str {
        match self {
            Material::Aluminium => "aluminium",
            Material::WhitePlastic => "white plastic",
            Material::BlackPlastic => "black plastic",
            Material::Nylon => "nylon",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BearingHeight {
    TooLow,
    Good,
    TooHigh,
}

impl BearingHeight {
    /// Height of the rings in 0.01 mm.
    pub fn ring_height(self) -> i32 {
        match self {
            BearingHeight::TooLow => 1080,
            BearingHeight::Good => 1200,
            BearingHeight::TooHigh => 1320,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LidHeight {
    Low,
    High,
}

/// What a part is like.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shape {
    Base {
        upright: bool,
    },
    Bearing {
        height: BearingHeight,
    },
    Shaft {
        material: Material,
    },
    Lid {
        material: Material,
        height: LidHeight,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Part {
    pub id: PartId,
    pub shape: Shape,
    /// Harmed by an incident.
    pub damaged: bool,
}

/// Number of lid magazines on the turret.
pub const LID_MAGAZINES: u8 = 6;

const BASE_UPSIDE_DOWN_ONE_IN: u64 = 6;
const BEARING_WRONG_ONE_IN: u64 = 7;
const SHAFT_WRONG_ONE_IN: u64 = 10;
const LID_WRONG_ONE_IN: u64 = 8;

impl Part {
    /// The part that comes as the `number`-th out of a magazine.
    pub fn made(seed: u64, id: PartId) -> Self {
        let draw = draw(
            seed,
            id.kind.level() as u64 * 16 + u64::from(id.magazine),
            u64::from(id.number),
        );
        let other = draw >> 32 & 1 == 1;
        let shape = match id.kind {
            PartKind::Base => Shape::Base {
                upright: !one_in(draw, BASE_UPSIDE_DOWN_ONE_IN),
            },
            PartKind::Bearing => Shape::Bearing {
                height: match (one_in(draw, BEARING_WRONG_ONE_IN), other) {
                    (false, _) => BearingHeight::Good,
                    (true, false) => BearingHeight::TooLow,
                    (true, true) => BearingHeight::TooHigh,
                },
            },
            PartKind::Shaft => {
                let nylon = (id.magazine == 1) != one_in(draw, SHAFT_WRONG_ONE_IN);
                Shape::Shaft {
                    material: if nylon {
                        Material::Nylon
                    } else {
                        Material::Aluminium
                    },
                }
            }
            PartKind::Lid => {
                let mut material = id.magazine / 2;
                let mut high = id.magazine % 2 == 1;
                if one_in(draw, LID_WRONG_ONE_IN) {
                    // Both checks of the station must be needed, so the fault is in the height or in the material.
                    if other {
                        high = !high;
                    } else {
                        material = (material + 1) % 3;
                    }
                }
                Shape::Lid {
                    material: lid_material(material),
                    height: if high {
                        LidHeight::High
                    } else {
                        LidHeight::Low
                    },
                }
            }
        };
        Part {
            id,
            shape,
            damaged: false,
        }
    }

    /// A part that may become part of a product: upright, of the right height, of its magazine's kind.
    pub fn is_as_its_magazine_says(&self) -> bool {
        match self.shape {
            Shape::Base { upright } => upright,
            Shape::Bearing { height } => height == BearingHeight::Good,
            Shape::Shaft { material } => (material == Material::Nylon) == (self.id.magazine == 1),
            Shape::Lid { material, height } => {
                material == lid_material(self.id.magazine / 2)
                    && (height == LidHeight::High) == (self.id.magazine % 2 == 1)
            }
        }
    }
}

/// Material of a lid by the number that orders and magazines use.
pub(crate) fn lid_material(number: u8) -> Material {
    match number {
        0 => Material::Aluminium,
        1 => Material::WhitePlastic,
        _ => Material::BlackPlastic,
    }
}

/// A fixed pseudo-random draw (SplitMix64 finaliser) for the `number`-th item of a stream.
pub(crate) fn draw(seed: u64, stream: u64, number: u64) -> u64 {
    let mut z = seed
        ^ stream.wrapping_mul(0xd1b5_4a32_d192_ed03)
        ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    for factor in [0xbf58_476d_1ce4_e5b9, 0x94d0_49bb_1331_11eb] {
        z = (z ^ (z >> 30)).wrapping_mul(factor);
        z ^= z >> 27;
    }
    z ^ (z >> 31)
}

fn one_in(draw: u64, n: u64) -> bool {
    (draw & 0xffff_ffff).is_multiple_of(n)
}
