//! The variables of a program that runs alone, as people see and write them.

use std::sync::Arc;

use super::{ENTRY, same};
use crate::image;
use crate::layout::{TypeNode, VariableInfo};
use crate::runtime::Instance;
use crate::source::Span;
use crate::value::Value;

/// A value of any shape, as it is shown.
#[derive(Clone, Debug, PartialEq)]
pub enum Shown {
    Scalar(Value),
    /// An enumerated value by its name.
    Name(String),
    Text(String),
    Array(Vec<Shown>),
    Struct(Vec<(String, Shown)>),
}

/// All variables of the programs and all global ones with their paths; structures and instances are taken apart, arrays
/// stand whole. Variables that FAM made itself are left out.
pub fn variables(instance: &Instance) -> Vec<(String, Shown)> {
    let mut out = Vec::new();
    for root in &instance.layout().roots {
        let path = shown_path(&root.path);
        collect(instance, root, path, &mut out);
    }
    out
}

/// The path without the entry's name.
fn shown_path(path: &str) -> String {
    path.strip_prefix(ENTRY)
        .and_then(|p| p.strip_prefix('.'))
        .unwrap_or(path)
        .to_owned()
}

fn is_hidden(path: &str) -> bool {
    path.rsplit('.').next().is_some_and(|n| n.starts_with("__"))
}

fn collect(instance: &Instance, info: &VariableInfo, path: String, out: &mut Vec<(String, Shown)>) {
    if is_hidden(&path) {
        return;
    }
    if let TypeNode::Struct { fields, .. } = &*info.ty {
        for field in fields {
            if let Some(inner) = info.field(&field.name) {
                collect(instance, &inner, format!("{path}.{}", field.name), out);
            }
        }
        return;
    }
    if let Some(shown) = show(instance, info) {
        out.push((path, shown));
    }
}

/// The value of a variable.
pub fn show(instance: &Instance, info: &VariableInfo) -> Option<Shown> {
    match &*info.ty {
        TypeNode::Struct { fields, .. } => {
            let mut list = Vec::new();
            for field in fields.iter().filter(|f| !f.name.starts_with("__")) {
                let inner = info.field(&field.name)?;
                list.push((field.name.clone(), show(instance, &inner)?));
            }
            Some(Shown::Struct(list))
        }
        TypeNode::Array { dims, .. } => {
            let mut indices = Vec::new();
            array(instance, info, dims, &mut indices)
        }
        TypeNode::Text { .. } => Some(Shown::Text(instance.read_text(info)?)),
        TypeNode::Enum { values, .. } => {
            let value = instance.read_variable(info)?;
            let number = value.as_i128()?;
            let name = values.iter().find(|(_, v)| i128::from(*v) == number);
            Some(name.map_or(Shown::Scalar(value), |(n, _)| Shown::Name(n.clone())))
        }
        _ => Some(Shown::Scalar(instance.read_variable(info)?)),
    }
}

fn array(
    instance: &Instance,
    info: &VariableInfo,
    dims: &[(i64, i64)],
    indices: &mut Vec<i64>,
) -> Option<Shown> {
    let Some((lo, hi)) = dims.get(indices.len()).copied() else {
        return show(instance, &info.element(indices)?);
    };
    let mut list = Vec::new();
    for index in lo..=hi {
        indices.push(index);
        list.push(array(instance, info, dims, indices)?);
        indices.pop();
    }
    Some(Shown::Array(list))
}

/// What one ASSERT block of a test program has counted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assertions {
    /// Path of the block.
    pub path: String,
    pub passed: i64,
    pub failed: i64,
    pub first_failure: String,
}

/// The counts of all ASSERT blocks, those inside other blocks included.
pub fn assertions(instance: &Instance) -> Vec<Assertions> {
    let mut out = Vec::new();
    let mut todo: Vec<VariableInfo> = instance.layout().roots.clone();
    while let Some(info) = todo.pop() {
        let TypeNode::Struct { name, fields } = &*info.ty else {
            if let TypeNode::Array { dims, elem, .. } = &*info.ty
                && matches!(**elem, TypeNode::Struct { .. })
                && let [(lo, hi)] = dims[..]
            {
                todo.extend((lo..=hi).filter_map(|i| info.element(&[i])));
            }
            continue;
        };
        if !same(name, "ASSERT") {
            todo.extend(fields.iter().filter_map(|f| info.field(&f.name)));
            continue;
        }
        let count = |field: &str| {
            info.field(field)
                .and_then(|f| instance.read_variable(&f))
                .and_then(Value::as_i128)
                .unwrap_or(0) as i64
        };
        let first = info
            .field("first_failure")
            .and_then(|f| instance.read_text(&f));
        out.push(Assertions {
            path: shown_path(&info.path),
            passed: count("passed"),
            failed: count("failed"),
            first_failure: first.unwrap_or_default(),
        });
    }
    out.sort_by(|a, b| a.path.cmp(&b.path));
    out
}

/// The variable that a name means: a full path, or the end of one if only one variable has it; `%IX0.0` for a bit of the
/// process image.
pub fn find(instance: &Instance, name: &str) -> Option<VariableInfo> {
    let layout = instance.layout();
    if name.starts_with('%') {
        return direct(instance, name);
    }
    if let Some(found) = layout.find(name) {
        return Some(found);
    }
    if let Some(found) = layout.find(&format!("{ENTRY}.{name}")) {
        return Some(found);
    }
    let mut candidates = layout.roots.iter().filter_map(|root| {
        let (owner, _) = root.path.split_once('.')?;
        layout.find(&format!("{owner}.{name}"))
    });
    let first = candidates.next()?;
    candidates
        .all(|other| other.path == first.path)
        .then_some(first)
}

fn direct(instance: &Instance, name: &str) -> Option<VariableInfo> {
    use crate::layout::Area;
    use crate::types::Elem;
    let location = crate::check::parse_location(name, Span::default()).ok()?;
    if location.memory {
        return None;
    }
    let area = if location.output {
        Area::Outputs
    } else {
        Area::Inputs
    };
    let elem = match location.size {
        'X' => Elem::Bool,
        'B' => Elem::Byte,
        'W' => Elem::Word,
        'D' => Elem::Dword,
        _ => Elem::Lword,
    };
    let len = elem.image_bytes();
    (location.byte + len <= instance.layout().area(area).len).then(|| VariableInfo {
        path: name.to_owned(),
        area,
        offset: location.byte,
        bit: location.bit,
        len,
        ty: Arc::new(TypeNode::Elem(elem)),
        retain: false,
    })
}

/// Writes what a text shows: a literal of the variable's type, or the name of an enumerated value. The error says what was
/// expected.
pub fn write(instance: &mut Instance, info: &VariableInfo, text: &str) -> Result<(), String> {
    let text = text.trim();
    if let TypeNode::Text { .. } = &*info.ty {
        let inner = text.trim_matches(['\'', '"']);
        instance.write_text(info, inner);
        write_to_image(instance, info, inner);
        return Ok(());
    }
    let Some(elem) = info.ty.elem() else {
        return Err(format!(
            "`{}` is an array or structure; write its parts",
            info.path
        ));
    };
    let named = match &*info.ty {
        TypeNode::Enum { base, values, .. } => {
            let name = text.rsplit(['#', '.']).next().unwrap_or(text);
            values
                .iter()
                .find(|(n, _)| same(n, name))
                .map(|(_, v)| Value::from_i128(*base, i128::from(*v)))
        }
        _ => None,
    };
    let Some(value) = named.or_else(|| crate::runtime::value_of(elem, text)) else {
        return Err(format!("`{text}` is no value of `{}` ({elem})", info.path));
    };
    instance
        .write_variable(info, value)
        .map_err(|e| e.to_string())
}

/// The characters of a located string in the image, which the program reads next.
fn write_to_image(instance: &mut Instance, info: &VariableInfo, text: &str) {
    let (owner, name) = info.path.rsplit_once('.').unwrap_or(("", &info.path));
    let dot = if owner.is_empty() { "" } else { "." };
    let image = format!("{owner}{dot}{}", image::characters_of(name));
    let Some(image) = instance.layout().find(&image) else {
        return;
    };
    let mut units = text.encode_utf16();
    for index in 0.. {
        let Some(unit) = image.element(&[index]) else {
            break;
        };
        let value = Value::Uint(u64::from(units.next().unwrap_or(0)));
        // What a STRING cannot hold is a question mark in the image too.
        if instance.write_variable(&unit, value).is_err() {
            let _ = instance.write_variable(&unit, Value::Uint(u64::from(b'?')));
        }
    }
}
