//! Types, literals and initial values.

use fam_soft_plc::types::Elem;

use super::{EnumDef, StructDef, SubDef, Ty, World};
use crate::shrink::Piece;
use crate::value::limits;

pub const INTS: [Elem; 8] = [
    Elem::Sint,
    Elem::Int,
    Elem::Dint,
    Elem::Lint,
    Elem::Usint,
    Elem::Uint,
    Elem::Udint,
    Elem::Ulint,
];
/// Integers that can be indices, counts and selectors.
pub const COUNTS: [Elem; 7] = [
    Elem::Sint,
    Elem::Int,
    Elem::Dint,
    Elem::Lint,
    Elem::Usint,
    Elem::Uint,
    Elem::Udint,
];
pub const BITS: [Elem; 4] = [Elem::Byte, Elem::Word, Elem::Dword, Elem::Lword];
pub const REALS: [Elem; 2] = [Elem::Real, Elem::Lreal];
pub const TIMES: [Elem; 4] = [Elem::Time, Elem::Date, Elem::Tod, Elem::Dt];

impl World {
    pub fn types(&mut self) -> Vec<Piece> {
        let mut lines = Vec::new();
        for number in 0..2 {
            let name = format!("E{number}");
            let values: Vec<String> = (0..4).map(|v| format!("e{number}v{v}")).collect();
            let (base, list) = match number {
                0 => ("", values.join(", ")),
                _ => (
                    "USINT ",
                    format!(
                        "{} := 3, {}, {} := 200, {}",
                        values[0], values[1], values[2], values[3]
                    ),
                ),
            };
            let init = if self.random.chance(50) {
                format!(" := {}", values[2])
            } else {
                String::new()
            };
            lines.push(Piece::line(format!("{name} : {base}({list}){init};")));
            self.enums.push(EnumDef { name, values });
        }
        for number in 0..3 {
            let base = *self.random.one(&COUNTS);
            let (low, high) = limits(base);
            let low = (i128::from(self.random.within(-20, 10))).clamp(low, high);
            let high = low + i128::from(self.random.within(0, 60));
            let name = format!("S{number}");
            lines.push(Piece::line(format!("{name} : {base} ({low}..{high});")));
            self.subs.push(SubDef {
                name,
                base,
                low,
                high,
            });
        }
        for number in 0..3 {
            let mut fields = Vec::new();
            let mut inner = Vec::new();
            for field in 0..self.random.within(2, 4) {
                let ty = self.data_type(1);
                let name = format!("f{field}");
                inner.push(self.declaration(&name, &ty));
                fields.push((name, ty));
            }
            let name = format!("T{number}");
            lines.push(Piece::block(
                format!("{name} : STRUCT"),
                inner,
                "END_STRUCT;",
            ));
            self.structs.push(StructDef { name, fields });
        }
        lines.push(self.image_structure());
        lines
    }

    pub fn elementary(&mut self) -> Elem {
        match self.random.below(10) {
            0..=3 => *self.random.one(&INTS),
            4 | 5 => Elem::Bool,
            6 => *self.random.one(&BITS),
            7 => *self.random.one(&REALS),
            8 => *self.random.one(&TIMES),
            _ => *self
                .random
                .one(&[Elem::Char, Elem::Wchar, Elem::Time, Elem::Real, Elem::Lreal]),
        }
    }

    /// Any type but references and function blocks.
    pub fn data_type(&mut self, depth: u32) -> Ty {
        match self.random.below(if depth == 0 { 13 } else { 18 }) {
            0..=8 => Ty::El(self.elementary()),
            9 | 10 => {
                let wide = self.random.chance(25);
                Ty::Str(wide, *self.random.one(&[1, 4, 7, 20]))
            }
            11 => Ty::Enum(self.random.below(self.enums.len())),
            12 => {
                let count = self.subs.len();
                if count == 0 {
                    Ty::El(Elem::Int)
                } else {
                    Ty::Sub(self.random.below(count))
                }
            }
            13 | 14 if !self.structs.is_empty() => {
                Ty::Struct(self.random.below(self.structs.len()))
            }
            _ => {
                let elem = self.data_type(depth - 1);
                let mut dims = Vec::new();
                for _ in 0..*self.random.one(&[1, 1, 2]) {
                    let low = self.random.within(-3, 3);
                    dims.push((low, low + self.random.within(0, 3)));
                }
                Ty::Array(Box::new(elem), dims)
            }
        }
    }

    pub fn type_text(&self, ty: &Ty) -> String {
        match ty {
            Ty::El(elem) => elem.to_string(),
            Ty::Str(wide, len) => format!("{}[{len}]", if *wide { "WSTRING" } else { "STRING" }),
            Ty::Enum(n) => self.enums[*n].name.clone(),
            Ty::Sub(n) => self.subs[*n].name.clone(),
            Ty::Struct(n) => self.structs[*n].name.clone(),
            Ty::Block(n) => self.blocks[*n].call.name.clone(),
            Ty::Ref(to) => format!("REF_TO {}", self.type_text(to)),
            Ty::Array(elem, dims) => {
                let dims: Vec<String> = dims.iter().map(|(l, h)| format!("{l}..{h}")).collect();
                format!("ARRAY[{}] OF {}", dims.join(", "), self.type_text(elem))
            }
        }
    }

    /// The declaration of a variable, at times with an initial value.
    pub fn declaration(&mut self, name: &str, ty: &Ty) -> Piece {
        let init = if self.random.chance(50) {
            self.initial(ty)
                .map_or(String::new(), |i| format!(" := {i}"))
        } else {
            String::new()
        };
        Piece::line(format!("{name} : {}{init};", self.type_text(ty)))
    }

    fn initial(&mut self, ty: &Ty) -> Option<String> {
        Some(match ty {
            Ty::El(elem) => self.literal(*elem),
            Ty::Str(wide, _) => self.text_literal(*wide),
            Ty::Enum(n) => {
                let value = self.random.below(4);
                format!("{}#{}", self.enums[*n].name, self.enums[*n].values[value])
            }
            Ty::Sub(n) => self.sub_literal(*n),
            Ty::Array(elem, dims) => {
                self.note("array initialiser");
                let count: i64 = dims.iter().map(|(l, h)| h - l + 1).product();
                let one = self.initial(elem)?;
                if self.random.chance(50) {
                    format!("[{count}({one})]")
                } else {
                    let list: Option<Vec<String>> =
                        (0..count.min(2)).map(|_| self.initial(elem)).collect();
                    format!("[{}]", list?.join(", "))
                }
            }
            Ty::Struct(n) => {
                self.note("structure initialiser");
                let (name, ty) = self.random.one(&self.structs[*n].fields.clone()).clone();
                format!("({name} := {})", self.initial(&ty)?)
            }
            Ty::Ref(_) | Ty::Block(_) => return None,
        })
    }

    pub fn sub_literal(&mut self, number: usize) -> String {
        let sub = &self.subs[number];
        let span = (sub.high - sub.low) as i64;
        (sub.low + i128::from(self.random.within(0, span))).to_string()
    }

    pub fn text_literal(&mut self, wide: bool) -> String {
        let text = *self.random.one(&[
            "",
            "a",
            "ab",
            "Hello",
            "12",
            "-345",
            "x y z",
            "ABCABC",
            "$24$41b",
            "quite a long text",
        ]);
        if wide {
            format!("\"{}\"", text.replace("$24$41", "$$$0041"))
        } else {
            format!("'{text}'")
        }
    }

    /// A literal with the name of its type.
    pub fn literal(&mut self, elem: Elem) -> String {
        match elem {
            Elem::Bool => (*self.random.one(&["TRUE", "FALSE"])).to_owned(),
            Elem::Real | Elem::Lreal => {
                let text = *self.random.one(&[
                    "0.0", "1.0", "-1.5", "2.5", "0.1", "100.25", "1.0E10", "-3.0E-5", "7.0", "0.5",
                ]);
                format!("{elem}#{text}")
            }
            Elem::Time => {
                let text = *self.random.one(&[
                    "T#0s",
                    "T#1ms",
                    "T#-1s500ms",
                    "T#10ms",
                    "T#1d2h3m4s5ms",
                    "T#250ms",
                    "LTIME#1us7ns",
                    "T#2.5s",
                ]);
                text.to_owned()
            }
            Elem::Date => (*self.random.one(&[
                "D#1970-01-01",
                "D#2024-02-29",
                "D#1999-12-31",
                "D#1968-07-04",
                "LDATE#2100-03-01",
            ]))
            .to_owned(),
            Elem::Tod => (*self.random.one(&[
                "TOD#00:00:00",
                "TOD#23:59:59.999",
                "TOD#12:34:56",
                "LTOD#01:02:03.000000004",
            ]))
            .to_owned(),
            Elem::Dt => (*self.random.one(&[
                "DT#1970-01-01-00:00:00",
                "DT#2024-02-29-12:30:15.5",
                "LDT#1969-12-31-23:59:59",
            ]))
            .to_owned(),
            Elem::Char => (*self
                .random
                .one(&["CHAR#'a'", "CHAR#'Z'", "CHAR#'0'", "CHAR#'$FE'"]))
            .to_owned(),
            Elem::Wchar => (*self
                .random
                .one(&["WCHAR#\"a\"", "WCHAR#\"Z\"", "WCHAR#\"$20AC\""]))
            .to_owned(),
            elem => {
                let (low, high) = limits(elem);
                let v = match self.random.below(6) {
                    0 => low,
                    1 => high,
                    _ => i128::from(self.random.within(-20, 120)).clamp(low, high),
                };
                if v >= 0 && self.random.chance(15) {
                    self.note("based literal");
                    match self.random.below(3) {
                        0 => format!("{elem}#16#{v:X}"),
                        1 => format!("{elem}#8#{v:o}"),
                        _ => format!("{elem}#2#{v:b}"),
                    }
                } else {
                    format!("{elem}#{v}")
                }
            }
        }
    }
}
