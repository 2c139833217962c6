//! The process image of an MC: its located variables against the inputs and outputs that the model lists.

use crate::logic::Logic;
use crate::model::{Cell, InputFrom, McSpec, points};
use crate::problem::{Explain, nearest};
use crate::values::value_of;
use fam_proto::McId;
use fam_proto::model::{
    FieldPoint, InputPoint, InputSource, ModbusTable, Number, OutputPoint, Place,
};
use fam_soft_plc::check::tree::{Location, Root, TypedProject, Var, visit_places};
use fam_soft_plc::diag::Diagnostic;
use fam_soft_plc::image::{ImageScalar, scalars};
use fam_soft_plc::types::{Elem, TypeId};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use toml::Spanned;

/// Points that one located array or structure may have.
const POINTS_MAX: usize = 4096;

/// A located variable of an elementary type, or a scalar of an array or structure: `levels[2]`, `drive.speed`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Located {
    /// Name.
    pub name: String,
    /// Whether it is an output.
    pub output: bool,
    /// Its place in the image.
    pub place: Place,
    /// Type.
    pub ty: TypeId,
    /// Elementary type.
    pub elem: Elem,
    /// The address as written.
    pub address: String,
}

/// The process image, as far as it is known without the other MCs.
#[derive(Debug, Clone, Default)]
pub struct Image {
    /// All located variables.
    pub located: Vec<Located>,
    /// Inputs whose source is a field point, and those from other MCs still without their place.
    pub inputs: Vec<(Located, InputFrom, Range<usize>)>,
    /// Outputs.
    pub outputs: Vec<(Located, Option<Spanned<FieldPoint>>, Vec<u8>)>,
}

fn located(scalar: ImageScalar) -> Located {
    let location = scalar.location;
    let place = match location.bit {
        Some(bit) => Place::Bit {
            byte: location.byte,
            bit,
        },
        None => Place::Bytes {
            byte: location.byte,
            #[allow(clippy::cast_possible_truncation)] // 1 to 8
            width: scalar.elem.image_bytes() as u8,
        },
    };
    Located {
        name: scalar.path,
        output: location.output,
        place,
        ty: scalar.ty,
        elem: scalar.elem,
        address: location.to_string(),
    }
}

/// The variable that a located scalar is, or is a part of.
fn variable(path: &str) -> &str {
    path.find(['[', '.']).map_or(path, |at| &path[..at])
}

/// First bit and the one behind the last.
fn bits(place: Place) -> (u64, u64) {
    match place {
        Place::Bit { byte, bit } => {
            let at = u64::from(byte) * 8 + u64::from(bit);
            (at, at + 1)
        }
        Place::Bytes { byte, width } => {
            let at = u64::from(byte) * 8;
            (at, at + u64::from(width) * 8)
        }
    }
}

/// Holds the located variables against the model.
pub fn image(cell: &Cell, mc: &McSpec, logic: &Logic, problems: &mut Vec<Diagnostic>) -> Image {
    let typed = &logic.typed;
    let mut image = Image::default();
    // What lies at %M is the MC's own and part of its state.
    let is_ours = |var: &&Var| var.location.is_some_and(|l| !l.memory);
    for var in typed.vars.iter().filter(is_ours) {
        let scalars = scalars(typed, var);
        if scalars.is_empty() || scalars.len() > POINTS_MAX {
            let message = format!(
                "MC {}: the located variable `{}` is {}",
                mc.mc,
                var.name,
                typed.type_name(var.ty)
            );
            problems.push(
                cell.text
                    .error("M310", mc.at.clone(), message)
                    .expected(format!("at most {POINTS_MAX} elementary values")),
            );
            continue;
        }
        image.located.extend(scalars.into_iter().map(located));
    }
    direct(cell, mc, typed, &image.located, problems);
    overlaps(cell, mc, &image.located, problems);
    unlisted(cell, mc, &image.located, problems);
    inputs(cell, mc, &mut image, problems);
    outputs(cell, mc, logic, &mut image, problems);
    image
}

/// An address used without a declaration (`%QX0.7 := TRUE`) would reach nothing, as the model knows variables only.
fn direct(
    cell: &Cell,
    mc: &McSpec,
    typed: &TypedProject,
    located: &[Located],
    problems: &mut Vec<Diagnostic>,
) {
    let mut found: BTreeMap<Location, String> = BTreeMap::new();
    for pou in typed.pous.iter().filter(|p| !p.library) {
        visit_places(&pou.body, &mut |place| {
            if let Root::Direct(location) = place.root
                && !location.memory
            {
                found.entry(location).or_insert_with(|| pou.name.clone());
            }
        });
    }
    for (location, pou) in found {
        let address = location.to_string();
        if located
            .iter()
            .any(|l| l.address.eq_ignore_ascii_case(&address))
        {
            continue;
        }
        let message = format!(
            "MC {}: {pou} uses {address}, which no located variable declares",
            mc.mc
        );
        problems.push(
            cell.text
                .error("M318", mc.at.clone(), message)
                .hint(format!(
                    "declare it in VAR_GLOBAL: `name AT {address} : ...;`, and list it in the model"
                )),
        );
    }
}

fn overlaps(cell: &Cell, mc: &McSpec, located: &[Located], problems: &mut Vec<Diagnostic>) {
    let mut sorted: Vec<&Located> = located.iter().collect();
    sorted.sort_by_key(|l| (l.output, bits(l.place)));
    for (index, a) in sorted.iter().enumerate() {
        for b in &sorted[index + 1..] {
            if b.output != a.output || bits(b.place).0 >= bits(a.place).1 {
                break;
            }
            let message = format!(
                "MC {}: `{}` (at {}) and `{}` (at {}) lie over each other",
                mc.mc, a.name, a.address, b.name, b.address
            );
            problems.push(
                cell.text
                    .error("M311", mc.at.clone(), message)
                    .expected("addresses that do not overlap: %IW and %QW count in 2 bytes, %ID in 4, %IL in 8")
                    .hint("give one of them another address in the logic"),
            );
        }
    }
}

fn unlisted(cell: &Cell, mc: &McSpec, located: &[Located], problems: &mut Vec<Diagnostic>) {
    let outputs: BTreeSet<String> = mc.outputs.iter().map(|o| key(o.name.get_ref())).collect();
    let inputs: BTreeSet<String> = mc.inputs.iter().map(|i| key(i.name.get_ref())).collect();
    let missing = located.iter().filter(|l| {
        let listed = if l.output { &outputs } else { &inputs };
        !listed.contains(&key(&l.name))
    });
    // Of an array or structure one is told.
    let mut told = BTreeSet::new();
    for l in missing {
        if !told.insert(variable(&l.name)) {
            continue;
        }
        let is_part = variable(&l.name) != l.name;
        let word = if is_part {
            toml::Value::String(l.name.clone()).to_string()
        } else {
            l.name.clone()
        };
        let (kind, table, example) = if l.output {
            (
                "output",
                "mc.outputs",
                format!("{word} = {{ field = \"...\", fail_safe = ... }}"),
            )
        } else {
            ("input", "mc.inputs", format!("{word} = \"...\""))
        };
        let message = format!(
            "MC {}: the {kind} `{}` (at {}) of its logic is not listed",
            mc.mc, l.name, l.address
        );
        problems.push(
            cell.text
                .error("M312", mc.at.clone(), message)
                .hint(format!(
                    "add `{example}` to [{table}]{}",
                    if is_part {
                        ", and the like for each element and field"
                    } else {
                        ""
                    }
                )),
        );
    }
}

/// The located variable of a name; else says what is wrong with the name.
fn find<'a>(
    cell: &Cell,
    mc: &McSpec,
    located: &'a [Located],
    name: &Spanned<String>,
    output: bool,
    problems: &mut Vec<Diagnostic>,
) -> Option<&'a Located> {
    let text = name.get_ref();
    let (kind, area) = if output {
        ("output", "%Q")
    } else {
        ("input", "%I")
    };
    let message = match located.iter().find(|l| key(&l.name) == key(text)) {
        Some(l) if l.output == output => return Some(l),
        Some(l) => format!("`{text}` is at {}, so that it is no {kind}", l.address),
        None => format!("its logic has no {kind} `{text}`"),
    };
    let known = located
        .iter()
        .filter(|l| l.output == output)
        .map(|l| l.name.as_str());
    let hint = match nearest(text, known) {
        Some(near) => format!("did you mean `{near}`?"),
        None => format!("declare it in VAR_GLOBAL: `{text} AT {area}X0.0 : BOOL;`"),
    };
    problems.push(
        cell.text
            .error("M313", name.span(), format!("MC {}: {message}", mc.mc))
            .hint(hint),
    );
    None
}

/// A bit belongs to a bit table, a number to registers.
fn fits_point(point: &FieldPoint, l: &Located) -> Result<(), String> {
    let FieldPoint::Modbus { table, address, .. } = point else {
        return Ok(());
    };
    let is_bit_table = matches!(table, ModbusTable::DiscreteInput | ModbusTable::Coil);
    let text = points::point_text(point);
    match (is_bit_table, l.place) {
        (true, Place::Bytes { .. }) => Err(format!(
            "`{text}` is one bit, but `{}` is {}",
            l.name, l.elem
        )),
        (false, Place::Bit { .. }) => Err(format!(
            "`{text}` is a register, but `{}` is one bit",
            l.name
        )),
        (false, place) if u32::from(*address) + registers(place) > 0x1_0000 => {
            Err(format!("`{}` does not fit behind `{text}`", l.name))
        }
        _ => Ok(()),
    }
}

pub(crate) fn registers(place: Place) -> u32 {
    match place {
        Place::Bit { .. } => 1,
        Place::Bytes { width, .. } => u32::from(width).div_ceil(2),
    }
}

fn inputs(cell: &Cell, mc: &McSpec, image: &mut Image, problems: &mut Vec<Diagnostic>) {
    for input in &mc.inputs {
        let Some(l) = find(cell, mc, &image.located, &input.name, false, problems) else {
            continue;
        };
        let Some(from) = &input.from else {
            continue;
        };
        if let InputFrom::Field(point) = from
            && let Err(why) = fits_point(point, l)
        {
            let message = format!("input {} of MC {}: {why}", input.name.get_ref(), mc.mc);
            problems.push(cell.text.error("M314", input.at.clone(), message).hint(
                "BOOL variables take points of discrete or coil, others of input or holding",
            ));
        }
        image
            .inputs
            .push((l.clone(), from.clone(), input.at.clone()));
    }
}

fn outputs(
    cell: &Cell,
    mc: &McSpec,
    logic: &Logic,
    image: &mut Image,
    problems: &mut Vec<Diagnostic>,
) {
    for output in &mc.outputs {
        let Some(l) = find(cell, mc, &image.located, &output.name, true, problems) else {
            continue;
        };
        if let Some(point) = &output.field
            && let Err(why) = fits_point(point.get_ref(), l)
        {
            let message = format!("output {} of MC {}: {why}", output.name.get_ref(), mc.mc);
            problems.push(
                cell.text
                    .error("M314", point.span(), message)
                    .hint("BOOL variables take points of coil, others of holding"),
            );
        }
        let mut bytes = vec![0; l.elem.image_bytes() as usize];
        if let Some(given) = &output.fail_safe {
            match value_of(&logic.typed, mc.program.get_ref(), l.ty, given.get_ref()) {
                Ok(value) => value.store(&mut bytes),
                Err(e) => {
                    let message = format!(
                        "fail-safe value of output {} of MC {}: {}",
                        output.name.get_ref(),
                        mc.mc,
                        e.message
                    );
                    problems.push(
                        cell.text
                            .error("M315", given.span(), message)
                            .expected(e.expected),
                    );
                }
            }
        }
        image.outputs.push((l.clone(), output.field.clone(), bytes));
    }
}

/// Puts a value, given by its bytes, into an image.
pub fn put(image: &mut [u8], place: Place, bytes: &[u8]) {
    match place {
        Place::Bit { byte, bit } => {
            if let Some(target) = image.get_mut(byte as usize) {
                *target &= !(1 << bit);
                if bytes.first().is_some_and(|b| b & 1 == 1) {
                    *target |= 1 << bit;
                }
            }
        }
        Place::Bytes { byte, width } => {
            let from = byte as usize;
            if let (Some(target), Some(bytes)) = (
                image.get_mut(from..from + usize::from(width)),
                bytes.get(..usize::from(width)),
            ) {
                target.copy_from_slice(bytes);
            }
        }
    }
}

/// Input and output points of the model: sources from other MCs get their places.
pub fn connect(
    cell: &Cell,
    index: usize,
    images: &[Option<Image>],
    problems: &mut Vec<Diagnostic>,
) -> (Vec<InputPoint>, Vec<OutputPoint>) {
    let mc = &cell.mcs[index];
    let Some(image) = &images[index] else {
        return (Vec::new(), Vec::new());
    };
    let mut inputs = Vec::new();
    for (l, from, at) in &image.inputs {
        let source = match from {
            InputFrom::Field(point) => Some(InputSource::Field(point.clone())),
            InputFrom::Export { mc: from, variable } => {
                export(cell, mc, l, from, variable, at, images, problems)
            }
        };
        if let Some(source) = source {
            inputs.push(InputPoint {
                name: l.name.clone(),
                place: l.place,
                number: number(l.elem),
                source,
            });
        }
    }
    inputs.sort_by_key(|p| bits(p.place));
    let mut outputs: Vec<OutputPoint> = image
        .outputs
        .iter()
        .map(|(l, field, _)| OutputPoint {
            name: l.name.clone(),
            place: l.place,
            number: number(l.elem),
            field: field.as_ref().map(|f| f.get_ref().clone()),
        })
        .collect();
    outputs.sort_by_key(|p| bits(p.place));
    (inputs, outputs)
}

fn number(elem: Elem) -> Number {
    match elem {
        Elem::Real | Elem::Lreal => Number::Real,
        Elem::Sint | Elem::Int | Elem::Dint | Elem::Lint => Number::Signed,
        _ => Number::Unsigned,
    }
}

#[allow(clippy::too_many_arguments)]
fn export(
    cell: &Cell,
    mc: &McSpec,
    l: &Located,
    from: &McId,
    variable: &str,
    at: &Range<usize>,
    images: &[Option<Image>],
    problems: &mut Vec<Diagnostic>,
) -> Option<InputSource> {
    let exporter = cell.mcs.iter().position(|m| &m.mc == from)?;
    let image = images[exporter].as_ref()?;
    let (source, ..) = image
        .outputs
        .iter()
        .find(|(o, ..)| key(&o.name) == key(variable))?;
    if source.elem != l.elem {
        let message = format!(
            "input {} of MC {} is {}, but `{variable}` of MC {from} is {}",
            l.name, mc.mc, l.elem, source.elem
        );
        problems.push(
            cell.text
                .error("M316", at.clone(), message)
                .hint("give both the same type"),
        );
    }
    Some(InputSource::Export {
        mc: from.clone(),
        place: source.place,
    })
}

/// How names are compared: without regard to case, and to blanks between indices.
pub(crate) fn key(name: &str) -> String {
    name.replace(' ', "").to_ascii_uppercase()
}
