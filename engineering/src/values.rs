//! Constant values that a model gives for variables: fail-safe values of outputs, checkpoint states.
//!
//! TOML's own booleans and numbers, or a text with an ST constant (`"T#1s500ms"`, `"16#FF"`, `"Color#Red"`, `"Red"`).

use fam_soft_plc::check::check_expression;
use fam_soft_plc::check::tree::{ExprKind, TypedProject};
use fam_soft_plc::types::{Elem, TypeId, TypeKind};
use fam_soft_plc::value::Value;

/// Why a value does not suit a variable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ValueError {
    /// What is wrong.
    pub message: String,
    /// What was expected.
    pub expected: String,
}

/// The value as one of type `ty`; `program` is the scope of names in an ST constant.
///
/// # Errors
/// [`ValueError`] if it is no value of that type.
pub fn value_of(
    project: &TypedProject,
    program: &str,
    ty: TypeId,
    given: &toml::Value,
) -> Result<Value, ValueError> {
    let Some(elem) = project.types.elem(ty) else {
        return Err(ValueError {
            message: format!(
                "a variable of type {} has no single value",
                project.type_name(ty)
            ),
            expected: "a variable of an elementary type, or one element or field of it".into(),
        });
    };
    let wrong = || ValueError {
        message: format!("{given} is no {}", project.type_name(ty)),
        expected: examples(project, ty, elem),
    };
    let value = match given {
        toml::Value::Boolean(b) => Value::Bool(*b),
        toml::Value::Integer(i) if elem.is_real() => real(elem, *i as f64),
        toml::Value::Integer(i) => Value::Int(*i),
        toml::Value::Float(f) if elem.is_real() && f.is_finite() => real(elem, *f),
        toml::Value::String(text) => constant(project, program, ty, text).ok_or_else(wrong)?,
        _ => return Err(wrong()),
    };
    let number = value.as_i128();
    let in_type = match (project.types.kind(ty), number) {
        (TypeKind::Enum { values, .. }, Some(v)) => values.iter().any(|(_, n)| i128::from(*n) == v),
        (TypeKind::Subrange { lo, hi, .. }, Some(v)) => (*lo..=*hi).contains(&v),
        _ => true,
    };
    if !value.fits(elem) || !in_type {
        return Err(wrong());
    }
    Ok(match number {
        Some(v) => Value::from_i128(elem, v),
        None => value,
    })
}

/// The value as ST text for a variable of type `ty`, a string among them: its characters, or an ST constant in its quotes.
///
/// # Errors
/// [`ValueError`] if it is no value of that type.
pub fn st_value(
    project: &TypedProject,
    program: &str,
    ty: TypeId,
    given: &toml::Value,
) -> Result<String, ValueError> {
    let Some((wide, len)) = project.types.text(ty) else {
        let value = value_of(project, program, ty, given)?;
        return Ok(st_text(project, ty, value));
    };
    let quote = if wide { '"' } else { '\'' };
    let wrong = |why: &str| ValueError {
        message: format!("{given} is no {}: {why}", project.type_name(ty)),
        expected: format!("a text of at most {len} characters"),
    };
    let toml::Value::String(text) = given else {
        return Err(wrong("a string is a text"));
    };
    let is_constant = text.len() >= 2 && text.starts_with(quote) && text.ends_with(quote);
    let units: Vec<u16> = if is_constant {
        match check_expression(project, Some(program), "", text).map(|e| e.kind) {
            Ok(ExprKind::Text(units)) => units.to_vec(),
            _ => return Err(wrong("it is no constant of ST")),
        }
    } else {
        text.encode_utf16().collect()
    };
    if units.len() > len as usize {
        return Err(wrong(&format!("it has {} characters", units.len())));
    }
    if !wide && units.iter().any(|u| *u > 0xff) {
        return Err(wrong("a STRING has the characters of ISO 8859-1"));
    }
    let mut out = String::from(quote);
    for unit in units {
        match u8::try_from(unit).map(char::from) {
            Ok(c) if c == quote || c == '$' => out.extend(['$', c]),
            Ok(c @ ' '..='~') => out.push(c),
            _ if wide => out.push_str(&format!("${unit:04X}")),
            _ => out.push_str(&format!("${unit:02X}")),
        }
    }
    out.push(quote);
    Ok(out)
}

fn real(elem: Elem, value: f64) -> Value {
    if elem == Elem::Real {
        #[allow(clippy::cast_possible_truncation)] // a REAL is what is asked for
        Value::Real(value as f32)
    } else {
        Value::Lreal(value)
    }
}

/// An ST constant; enumerations only of the very type.
fn constant(project: &TypedProject, program: &str, ty: TypeId, text: &str) -> Option<Value> {
    if let TypeKind::Enum { base, values } = project.types.kind(ty) {
        let name = match text.split_once('#') {
            Some((owner, name)) if owner.trim().eq_ignore_ascii_case(&project.type_name(ty)) => {
                name
            }
            Some(_) => return None,
            None => text,
        };
        let (_, number) = values
            .iter()
            .find(|(n, _)| n.eq_ignore_ascii_case(name.trim()))?;
        return Some(Value::from_i128(*base, i128::from(*number)));
    }
    let expr = check_expression(project, Some(program), "", text).ok()?;
    let value = match (expr.kind, project.types.elem(ty)?) {
        (ExprKind::Const(value), _) => value,
        // A literal of one character has no context here that makes it one.
        (ExprKind::Text(units), Elem::Char | Elem::Wchar) if units.len() == 1 => {
            Value::Char(units[0])
        }
        _ => return None,
    };
    if project.types.is_enum(expr.ty) {
        return None;
    }
    match (project.types.elem(ty)?, value) {
        (elem @ (Elem::Real | Elem::Lreal), v) => {
            let is_number = matches!(
                v,
                Value::Int(_) | Value::Uint(_) | Value::Real(_) | Value::Lreal(_)
            );
            is_number.then(|| real(elem, v.as_f64()))
        }
        (_, v) => Some(v),
    }
}

fn examples(project: &TypedProject, ty: TypeId, elem: Elem) -> String {
    match project.types.kind(ty) {
        TypeKind::Enum { values, .. } => {
            let names: Vec<String> = values.iter().map(|(n, _)| format!("\"{n}\"")).collect();
            return format!("one of {}", names.join(", "));
        }
        TypeKind::Subrange { lo, hi, .. } => return format!("a number from {lo} to {hi}"),
        _ => {}
    }
    match (elem, elem.limits()) {
        (Elem::Bool, _) => "true or false".into(),
        (Elem::Time, _) => "a duration such as \"T#1s500ms\"".into(),
        (Elem::Date, _) => "a date such as \"D#2024-02-29\"".into(),
        (Elem::Tod, _) => "a time of day such as \"TOD#12:30:00\"".into(),
        (Elem::Dt, _) => "a date and time such as \"DT#2024-02-29-12:30:00\"".into(),
        (Elem::Char, _) => "a character such as \"'x'\"".into(),
        (Elem::Wchar, _) => "a character such as \"\\\"x\\\"\"".into(),
        (_, Some((lo, hi))) => format!("a number from {lo} to {hi}"),
        (_, None) => "a number such as 1.5".into(),
    }
}

/// The value as ST text for a variable of type `ty`.
#[must_use]
pub fn st_text(project: &TypedProject, ty: TypeId, value: Value) -> String {
    if let (TypeKind::Enum { values, .. }, Some(v)) = (project.types.kind(ty), value.as_i128())
        && let Some((name, _)) = values.iter().find(|(_, n)| i128::from(*n) == v)
    {
        return match &project.types.get(ty).name {
            Some(owner) => format!("{owner}#{name}"),
            None => name.clone(),
        };
    }
    value.to_string()
}
