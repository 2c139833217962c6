//! Values of elementary types, and the meaning of operators and conversions on them.
//!
//! This is the reference for what compiled code must compute; constant folding and the evaluation of conditions use it.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::calendar;
use crate::syntax::ast::{BinOp, UnOp};
use crate::types::Elem;

/// A value. Signed integers are `Int`; unsigned integers and bit strings are `Uint`; an enumerated value is its number.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Serialize, Deserialize)]
pub enum Value {
    Bool(bool),
    Int(i64),
    Uint(u64),
    Real(f32),
    Lreal(f64),
    /// Nanoseconds.
    Time(i64),
    /// Nanoseconds since 1970-01-01.
    Date(i64),
    /// Nanoseconds since midnight.
    Tod(i64),
    /// Nanoseconds since 1970-01-01.
    Dt(i64),
    /// CHAR or WCHAR, by its code.
    Char(u16),
    /// The address that a reference holds.
    Ref(u32),
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::Bool(b) => f.write_str(if *b { "TRUE" } else { "FALSE" }),
            Value::Int(v) => write!(f, "{v}"),
            Value::Uint(v) => write!(f, "{v}"),
            Value::Real(v) => write!(f, "{v:?}"),
            Value::Lreal(v) => write!(f, "{v:?}"),
            Value::Time(ns) => f.write_str(&format_time(*ns)),
            Value::Date(ns) => write!(f, "D#{}", calendar::date_text(*ns)),
            Value::Tod(ns) => write!(f, "TOD#{}", calendar::time_of_day_text(*ns)),
            Value::Dt(ns) => write!(f, "DT#{}", calendar::date_time_text(*ns)),
            Value::Char(code) => match char::from_u32(u32::from(*code)) {
                Some(c) if !c.is_control() => write!(f, "'{c}'"),
                _ => write!(f, "'${code:02X}'"),
            },
            Value::Ref(0) => f.write_str("NULL"),
            Value::Ref(address) => write!(f, "REF#{address}"),
        }
    }
}

/// A duration as a TIME literal, `T#1s500ms`.
pub fn format_time(ns: i64) -> String {
    let mut out = String::from(if ns < 0 { "T#-" } else { "T#" });
    let mut rest = ns.unsigned_abs();
    let mut any = false;
    for (unit, size) in [
        ("d", 86_400_000_000_000),
        ("h", 3_600_000_000_000),
        ("m", 60_000_000_000),
        ("s", 1_000_000_000),
        ("ms", 1_000_000),
        ("us", 1_000),
        ("ns", 1),
    ] {
        let count = rest / size;
        rest %= size;
        if count > 0 {
            out.push_str(&format!("{count}{unit}"));
            any = true;
        }
    }
    if !any {
        out.push_str("0s");
    }
    out
}

/// Why a computation has no result. At run time each of these is a trap.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    #[error("division by zero")]
    DivisionByZero,
    #[error("the value does not fit the type that it is converted to")]
    Conversion,
    #[error("the value is outside its range")]
    Range,
    #[error("this operation does not apply to these values")]
    Types,
}

impl Value {
    pub fn zero(elem: Elem) -> Value {
        match elem {
            Elem::Bool => Value::Bool(false),
            Elem::Real => Value::Real(0.0),
            Elem::Lreal => Value::Lreal(0.0),
            Elem::Time => Value::Time(0),
            Elem::Date => Value::Date(0),
            Elem::Tod => Value::Tod(0),
            Elem::Dt => Value::Dt(0),
            Elem::Char | Elem::Wchar => Value::Char(0),
            Elem::Ref => Value::Ref(0),
            e if e.is_signed() => Value::Int(0),
            _ => Value::Uint(0),
        }
    }

    /// The integer `value`, wrapped to the width of `elem`.
    pub fn from_i128(elem: Elem, value: i128) -> Value {
        match elem {
            Elem::Bool => Value::Bool(value & 1 == 1),
            Elem::Sint => Value::Int(i64::from(value as i8)),
            Elem::Int => Value::Int(i64::from(value as i16)),
            Elem::Dint => Value::Int(i64::from(value as i32)),
            Elem::Lint => Value::Int(value as i64),
            Elem::Time => Value::Time(value as i64),
            Elem::Date => Value::Date(value as i64),
            Elem::Tod => Value::Tod(value as i64),
            Elem::Dt => Value::Dt(value as i64),
            Elem::Char => Value::Char(u16::from(value as u8)),
            Elem::Wchar => Value::Char(value as u16),
            Elem::Ref => Value::Ref(value as u32),
            Elem::Usint | Elem::Byte => Value::Uint(u64::from(value as u8)),
            Elem::Uint | Elem::Word => Value::Uint(u64::from(value as u16)),
            Elem::Udint | Elem::Dword => Value::Uint(u64::from(value as u32)),
            Elem::Ulint | Elem::Lword => Value::Uint(value as u64),
            Elem::Real => Value::Real(value as f32),
            Elem::Lreal => Value::Lreal(value as f64),
        }
    }

    /// The value as an integer; `None` for reals.
    pub fn as_i128(self) -> Option<i128> {
        match self {
            Value::Bool(b) => Some(i128::from(b)),
            Value::Int(v) | Value::Time(v) | Value::Date(v) | Value::Tod(v) | Value::Dt(v) => {
                Some(i128::from(v))
            }
            Value::Char(v) => Some(i128::from(v)),
            Value::Ref(v) => Some(i128::from(v)),
            Value::Uint(v) => Some(i128::from(v)),
            Value::Real(_) | Value::Lreal(_) => None,
        }
    }

    pub fn as_bool(self) -> Option<bool> {
        match self {
            Value::Bool(b) => Some(b),
            _ => None,
        }
    }

    pub fn as_f64(self) -> f64 {
        match self {
            Value::Real(v) => f64::from(v),
            Value::Lreal(v) => v,
            Value::Bool(b) => f64::from(u8::from(b)),
            Value::Int(v) | Value::Time(v) | Value::Date(v) | Value::Tod(v) | Value::Dt(v) => {
                v as f64
            }
            Value::Char(v) => f64::from(v),
            Value::Ref(v) => f64::from(v),
            Value::Uint(v) => v as f64,
        }
    }

    /// Whether the value is one of type `elem` (an integer that fits, a real of that width).
    pub fn fits(self, elem: Elem) -> bool {
        match (self, elem) {
            (Value::Bool(_), e) => e == Elem::Bool,
            (Value::Time(_), e) => e == Elem::Time,
            (Value::Date(_), e) => e == Elem::Date,
            (Value::Tod(_), e) => e == Elem::Tod,
            (Value::Dt(_), e) => e == Elem::Dt,
            (Value::Char(code), e) => e == Elem::Wchar || (e == Elem::Char && code < 256),
            (Value::Ref(_), e) => e == Elem::Ref,
            (Value::Real(_), e) => e == Elem::Real,
            (Value::Lreal(_), e) => e == Elem::Lreal,
            (Value::Int(_) | Value::Uint(_), e) => {
                (e.is_int() || e.is_bit())
                    && e != Elem::Bool
                    && match (e.limits(), self.as_i128()) {
                        (Some((lo, hi)), Some(v)) => (lo..=hi).contains(&v),
                        _ => false,
                    }
            }
        }
    }

    /// The bytes of the value in `bytes.len()` bytes, little-endian.
    pub fn store(self, bytes: &mut [u8]) {
        let raw: u64 = match self {
            Value::Bool(b) => u64::from(b),
            Value::Int(v) | Value::Time(v) | Value::Date(v) | Value::Tod(v) | Value::Dt(v) => {
                v as u64
            }
            Value::Char(v) => u64::from(v),
            Value::Ref(v) => u64::from(v),
            Value::Uint(v) => v,
            Value::Real(v) => u64::from(v.to_bits()),
            Value::Lreal(v) => v.to_bits(),
        };
        let len = bytes.len();
        bytes.copy_from_slice(&raw.to_le_bytes()[..len]);
    }

    /// Reads a value of type `elem` from its bytes, as many as the cell or image has.
    pub fn load(elem: Elem, bytes: &[u8]) -> Value {
        let mut raw = [0u8; 8];
        raw[..bytes.len()].copy_from_slice(bytes);
        let raw = u64::from_le_bytes(raw);
        match elem {
            Elem::Bool => Value::Bool(raw & 1 == 1),
            Elem::Real => Value::Real(f32::from_bits(raw as u32)),
            Elem::Lreal => Value::Lreal(f64::from_bits(raw)),
            e => Value::from_i128(e, i128::from(raw)),
        }
    }
}

/// `left op right`, both of type `elem`; for TIME, `*` and `/` take a LINT or LREAL on the right.
pub fn binary(op: BinOp, elem: Elem, left: Value, right: Value) -> Result<Value, Fault> {
    use BinOp::{Add, And, Div, Eq, Gt, Le, Lt, Mod, Mul, Ne, Or, Pow, Sub, Xor};
    if op.is_comparison() {
        let order = left.partial_cmp(&right);
        let order_or = |f: fn(std::cmp::Ordering) -> bool| Value::Bool(order.is_some_and(f));
        return Ok(match op {
            Eq => Value::Bool(order == Some(std::cmp::Ordering::Equal)),
            Ne => Value::Bool(order != Some(std::cmp::Ordering::Equal)),
            Lt => order_or(std::cmp::Ordering::is_lt),
            Le => order_or(std::cmp::Ordering::is_le),
            Gt => order_or(std::cmp::Ordering::is_gt),
            _ => order_or(std::cmp::Ordering::is_ge),
        });
    }
    match (left, right) {
        (Value::Real(a), Value::Real(b)) => Ok(Value::Real(canonical_f32(match op {
            Add => a + b,
            Sub => a - b,
            Mul => a * b,
            Div => a / b,
            Pow => libm::powf(a, b),
            _ => return Err(Fault::Types),
        }))),
        (Value::Lreal(a), Value::Lreal(b)) => Ok(Value::Lreal(canonical_f64(match op {
            Add => a + b,
            Sub => a - b,
            Mul => a * b,
            Div => a / b,
            Pow => libm::pow(a, b),
            _ => return Err(Fault::Types),
        }))),
        (Value::Time(a), Value::Lreal(b)) => {
            let product = match op {
                Mul => a as f64 * b,
                Div => a as f64 / b,
                _ => return Err(Fault::Types),
            };
            convert(Elem::Lreal, Elem::Lint, Value::Lreal(product))
                .map(|v| Value::Time(v.as_i128().unwrap_or(0) as i64))
        }
        _ => {
            let (Some(a), Some(b)) = (left.as_i128(), right.as_i128()) else {
                return Err(Fault::Types);
            };
            let result = match op {
                Add => a + b,
                Sub => a - b,
                // Only the low 64 bits count, and the product of two 64-bit values may leave 128 bits.
                Mul => a.wrapping_mul(b),
                Div | Mod if b == 0 => return Err(Fault::DivisionByZero),
                Div => a / b,
                Mod => a % b,
                And => a & b,
                Or => a | b,
                Xor => a ^ b,
                _ => return Err(Fault::Types),
            };
            Ok(Value::from_i128(elem, result))
        }
    }
}

pub fn unary(op: UnOp, elem: Elem, value: Value) -> Result<Value, Fault> {
    match (op, value) {
        (UnOp::Neg, Value::Real(v)) => Ok(Value::Real(-v)),
        (UnOp::Neg, Value::Lreal(v)) => Ok(Value::Lreal(-v)),
        (UnOp::Neg, v) => match v.as_i128() {
            Some(v) => Ok(Value::from_i128(elem, -v)),
            None => Err(Fault::Types),
        },
        (UnOp::Not, Value::Bool(b)) => Ok(Value::Bool(!b)),
        (UnOp::Not, Value::Uint(v)) => Ok(Value::from_i128(elem, !i128::from(v))),
        (UnOp::Not, _) => Err(Fault::Types),
    }
}

/// Explicit conversion `FROM_TO_TO` (third edition, tables 22 to 27). Which pairs exist is decided by the checker.
pub fn convert(from: Elem, to: Elem, value: Value) -> Result<Value, Fault> {
    let raw = |bytes: u32| {
        let mut buffer = [0u8; 8];
        value.store(&mut buffer[..bytes as usize]);
        buffer
    };
    if from == to {
        return Ok(value);
    }
    if from.is_real() && to.is_bit() && to != Elem::Bool {
        return Ok(Value::load(to, &raw(from.cell_bytes())));
    }
    if to.is_real() && from.is_bit() && from != Elem::Bool {
        return Ok(Value::load(to, &raw(8)[..to.cell_bytes() as usize]));
    }
    if let Some(result) = convert_date(from, to, value) {
        return Ok(result);
    }
    // Durations become numbers of milliseconds, except LINT, which takes the nanoseconds.
    if from == Elem::Time && to != Elem::Lint {
        let ns = value.as_i128().unwrap_or(0);
        return if to.is_real() {
            convert(Elem::Lreal, to, Value::Lreal(ns as f64 / MS_NS as f64))
        } else {
            Ok(Value::from_i128(to, ns / MS_NS))
        };
    }
    if to == Elem::Time && from != Elem::Lint {
        return match value.as_i128() {
            Some(ms) => Ok(Value::Time((ms as i64).wrapping_mul(MS_NS as i64))),
            None => integer(Elem::Time, libm::rint(value.as_f64() * MS_NS as f64)),
        };
    }
    match (value, to) {
        (Value::Real(v), Elem::Lreal) => Ok(Value::Lreal(f64::from(v))),
        (Value::Lreal(v), Elem::Real) => Ok(Value::Real(v as f32)),
        (Value::Real(_) | Value::Lreal(_), Elem::Bool) => Ok(Value::Bool(value.as_f64() != 0.0)),
        (Value::Real(_) | Value::Lreal(_), _) => integer(to, libm::rint(value.as_f64())),
        (_, Elem::Real | Elem::Lreal) => Ok(Value::from_i128(to, value.as_i128().unwrap_or(0))),
        (Value::Uint(v), Elem::Bool) if from.is_bit() => Ok(Value::Bool(v & 1 == 1)),
        (_, Elem::Bool) => Ok(Value::Bool(value.as_i128() != Some(0))),
        _ => Ok(Value::from_i128(to, value.as_i128().unwrap_or(0))),
    }
}

const MS_NS: i128 = 1_000_000;

/// Date or time of day out of a date and time.
fn convert_date(from: Elem, to: Elem, value: Value) -> Option<Value> {
    let ns = value.as_i128()? as i64;
    match (from, to) {
        (Elem::Dt, Elem::Date) => Some(Value::Date(
            // At the very first moment the day begins before what can be counted.
            ns.wrapping_sub(ns.rem_euclid(calendar::DAY_NS)),
        )),
        (Elem::Dt, Elem::Tod) => Some(Value::Tod(ns.rem_euclid(calendar::DAY_NS))),
        _ => None,
    }
}

/// A whole number as an integer of type `to`.
pub fn integer(to: Elem, whole: f64) -> Result<Value, Fault> {
    let (lo, hi) = to.limits().ok_or(Fault::Types)?;
    // The limits of 64-bit types are not exact as f64; 2^63 and 2^64 are.
    if whole >= lo as f64 && whole < (hi + 1) as f64 {
        Ok(Value::from_i128(to, whole as i128))
    } else {
        Err(Fault::Conversion)
    }
}

/// Every host gives the same bits for "not a number".
pub fn canonical_f32(v: f32) -> f32 {
    if v.is_nan() {
        f32::from_bits(0x7fc0_0000)
    } else {
        v
    }
}

pub fn canonical_f64(v: f64) -> f64 {
    if v.is_nan() {
        f64::from_bits(0x7ff8_0000_0000_0000)
    } else {
        v
    }
}
