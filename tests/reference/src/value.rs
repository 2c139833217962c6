//! Scalars, and operators, conversions and standard functions on them, read off the standard's tables.

use fam_soft_plc::TrapKind;
use fam_soft_plc::check::stdfun::StdFun;
use fam_soft_plc::syntax::ast::{BinOp, UnOp};
use fam_soft_plc::types::Elem;

use crate::memory::NodeId;

/// A value of an elementary type; which one, the context says. BOOL is 0 or 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scalar {
    Int(i128),
    Real(f32),
    Lreal(f64),
    Ref(Option<NodeId>),
}

const DAY_NS: i128 = 86_400_000_000_000;
const MS_NS: i128 = 1_000_000;

/// Bits of an integer type, and whether it has a sign.
fn shape(elem: Elem) -> (u32, bool) {
    match elem {
        Elem::Bool => (1, false),
        Elem::Sint => (8, true),
        Elem::Usint | Elem::Byte | Elem::Char => (8, false),
        Elem::Int => (16, true),
        Elem::Uint | Elem::Word | Elem::Wchar => (16, false),
        Elem::Dint => (32, true),
        Elem::Udint | Elem::Dword | Elem::Ref => (32, false),
        Elem::Lint | Elem::Time | Elem::Date | Elem::Tod | Elem::Dt => (64, true),
        Elem::Ulint | Elem::Lword => (64, false),
        Elem::Real => (32, true),
        Elem::Lreal => (64, true),
    }
}

pub fn limits(elem: Elem) -> (i128, i128) {
    match shape(elem) {
        (bits, true) => (-(1 << (bits - 1)), (1 << (bits - 1)) - 1),
        (bits, false) => (0, (1 << bits) - 1),
    }
}

/// The value with only the bits that the type has.
pub fn wrap(elem: Elem, value: i128) -> i128 {
    let (bits, signed) = shape(elem);
    let low = value & ((1i128 << bits) - 1);
    if signed && low >> (bits - 1) & 1 == 1 {
        low - (1i128 << bits)
    } else {
        low
    }
}

impl Scalar {
    pub fn zero(elem: Elem) -> Scalar {
        match elem {
            Elem::Real => Scalar::Real(0.0),
            Elem::Lreal => Scalar::Lreal(0.0),
            Elem::Ref => Scalar::Ref(None),
            _ => Scalar::Int(0),
        }
    }

    pub fn int(self) -> i128 {
        match self {
            Scalar::Int(v) => v,
            Scalar::Ref(node) => node.map_or(0, |n| n.0 as i128 + 1),
            Scalar::Real(_) | Scalar::Lreal(_) => 0,
        }
    }

    pub fn is_true(self) -> bool {
        self.int() != 0
    }

    fn real(self) -> f64 {
        match self {
            Scalar::Real(v) => v.into(),
            Scalar::Lreal(v) => v,
            other => other.int() as f64,
        }
    }

    /// As it is kept in memory: all NaNs are one.
    pub fn kept(self) -> Scalar {
        match self {
            Scalar::Real(v) if v.is_nan() => Scalar::Real(f32::from_bits(0x7fc0_0000)),
            Scalar::Lreal(v) if v.is_nan() => Scalar::Lreal(f64::from_bits(0x7ff8_0000_0000_0000)),
            other => other,
        }
    }
}

fn truth(condition: bool) -> Scalar {
    Scalar::Int(i128::from(condition))
}

/// A real with an integral value as an integer of the type.
fn whole(to: Elem, value: f64) -> Result<Scalar, TrapKind> {
    let (low, high) = limits(to);
    // Exact: f64 to i128 saturates far outside of all types, NaN is caught before.
    if value.is_nan() || value.is_infinite() || value.abs() > 1e30 {
        return Err(TrapKind::Conversion);
    }
    let number = value as i128;
    if number < low || number > high {
        return Err(TrapKind::Conversion);
    }
    Ok(Scalar::Int(number))
}

pub fn unary(op: UnOp, elem: Elem, value: Scalar) -> Scalar {
    match (op, value) {
        (UnOp::Neg, Scalar::Real(v)) => Scalar::Real(-v),
        (UnOp::Neg, Scalar::Lreal(v)) => Scalar::Lreal(-v),
        (UnOp::Neg, v) => Scalar::Int(wrap(elem, -v.int())),
        (UnOp::Not, v) => Scalar::Int(wrap(elem, !v.int())),
    }
}

pub fn binary(op: BinOp, elem: Elem, left: Scalar, right: Scalar) -> Result<Scalar, TrapKind> {
    use std::cmp::Ordering::{Equal, Greater, Less};
    if op.is_comparison() {
        let order = match (left, right) {
            (Scalar::Real(a), Scalar::Real(b)) => a.partial_cmp(&b),
            (Scalar::Lreal(a), Scalar::Lreal(b)) => a.partial_cmp(&b),
            (a, b) => Some(a.int().cmp(&b.int())),
        };
        return Ok(truth(match op {
            BinOp::Eq => order == Some(Equal),
            BinOp::Ne => order != Some(Equal),
            BinOp::Lt => order == Some(Less),
            BinOp::Le => matches!(order, Some(Less | Equal)),
            BinOp::Gt => order == Some(Greater),
            _ => matches!(order, Some(Greater | Equal)),
        }));
    }
    match (left, right) {
        (Scalar::Real(a), Scalar::Real(b)) => Ok(Scalar::Real(match op {
            BinOp::Add => a + b,
            BinOp::Sub => a - b,
            BinOp::Mul => a * b,
            BinOp::Div => a / b,
            _ => libm::powf(a, b),
        })),
        (Scalar::Lreal(a), Scalar::Lreal(b)) => Ok(Scalar::Lreal(match op {
            BinOp::Add => a + b,
            BinOp::Sub => a - b,
            BinOp::Mul => a * b,
            BinOp::Div => a / b,
            _ => libm::pow(a, b),
        })),
        // TIME times or by a real: rounded like a conversion.
        (Scalar::Int(a), Scalar::Lreal(b)) => {
            let exact = if op == BinOp::Mul {
                a as f64 * b
            } else {
                a as f64 / b
            };
            whole(elem, exact.round_ties_even())
        }
        (a, b) => {
            let (a, b) = (a.int(), b.int());
            let result = match op {
                BinOp::Add => a + b,
                BinOp::Sub => a - b,
                BinOp::Mul => a.wrapping_mul(b),
                BinOp::Div | BinOp::Mod if b == 0 => return Err(TrapKind::DivisionByZero),
                BinOp::Div => a / b,
                BinOp::Mod => a % b,
                BinOp::And => a & b,
                BinOp::Or => a | b,
                _ => a ^ b,
            };
            Ok(Scalar::Int(wrap(elem, result)))
        }
    }
}

fn is_bits(elem: Elem) -> bool {
    matches!(elem, Elem::Byte | Elem::Word | Elem::Dword | Elem::Lword)
}

fn is_real(elem: Elem) -> bool {
    matches!(elem, Elem::Real | Elem::Lreal)
}

/// The bits of a real as a number.
fn bits_of(value: Scalar) -> i128 {
    match value.kept() {
        Scalar::Real(v) => v.to_bits().into(),
        Scalar::Lreal(v) => v.to_bits().into(),
        other => other.int(),
    }
}

fn to_real(elem: Elem, number: i128) -> Scalar {
    // Rounded once, from the exact integer.
    if elem == Elem::Real {
        Scalar::Real(number as f32)
    } else {
        Scalar::Lreal(number as f64)
    }
}

/// Tables 22 to 27, and implicit conversions.
pub fn convert(from: Elem, to: Elem, value: Scalar) -> Result<Scalar, TrapKind> {
    Ok(match (from, to) {
        (from, to) if from == to => value,
        // Transfer of bits.
        (Elem::Real | Elem::Lreal, to) if is_bits(to) => Scalar::Int(wrap(to, bits_of(value))),
        (from, Elem::Real) if is_bits(from) => Scalar::Real(f32::from_bits(value.int() as u32)),
        (from, Elem::Lreal) if is_bits(from) => Scalar::Lreal(f64::from_bits(value.int() as u64)),
        (Elem::Real, Elem::Lreal) => Scalar::Lreal(value.real()),
        (Elem::Lreal, Elem::Real) => Scalar::Real(value.real() as f32),
        (Elem::Real | Elem::Lreal, Elem::Bool) => truth(value.real() != 0.0),
        // Durations count milliseconds, for LINT nanoseconds.
        (Elem::Time, Elem::Lint) | (Elem::Lint, Elem::Time) => value,
        (Elem::Time, to) if is_real(to) => {
            let ms = value.int() as f64 / MS_NS as f64;
            if to == Elem::Real {
                Scalar::Real(ms as f32)
            } else {
                Scalar::Lreal(ms)
            }
        }
        (Elem::Time, to) => Scalar::Int(wrap(to, value.int() / MS_NS)),
        (Elem::Real | Elem::Lreal, Elem::Time) => {
            whole(Elem::Time, (value.real() * MS_NS as f64).round_ties_even())?
        }
        (_, Elem::Time) => Scalar::Int(wrap(Elem::Time, wrap(Elem::Lint, value.int()) * MS_NS)),
        (Elem::Dt, Elem::Date) => {
            Scalar::Int(wrap(Elem::Date, value.int().div_euclid(DAY_NS) * DAY_NS))
        }
        (Elem::Dt, Elem::Tod) => Scalar::Int(value.int().rem_euclid(DAY_NS)),
        (Elem::Real | Elem::Lreal, to) => whole(to, value.real().round_ties_even())?,
        (_, to) if is_real(to) => to_real(to, value.int()),
        (from, Elem::Bool) if is_bits(from) => Scalar::Int(value.int() & 1),
        (_, Elem::Bool) => truth(value.int() != 0),
        (_, to) => Scalar::Int(wrap(to, value.int())),
    })
}

/// A standard function of numbers, all arguments given. `result` is the type of its result.
pub fn function(fun: StdFun, result: Elem, args: &[Scalar]) -> Result<Scalar, TrapKind> {
    let first = args[0];
    Ok(match fun {
        StdFun::Abs => match first {
            Scalar::Real(v) => Scalar::Real(v.abs()),
            Scalar::Lreal(v) => Scalar::Lreal(v.abs()),
            v => Scalar::Int(wrap(result, v.int().abs())),
        },
        StdFun::Sqrt
        | StdFun::Ln
        | StdFun::Log
        | StdFun::Exp
        | StdFun::Sin
        | StdFun::Cos
        | StdFun::Tan
        | StdFun::Asin
        | StdFun::Acos
        | StdFun::Atan => match first {
            Scalar::Real(v) => Scalar::Real(single(fun, v)),
            other => Scalar::Lreal(double(fun, other.real())),
        },
        StdFun::Atan2 => match (first, args[1]) {
            (Scalar::Real(y), Scalar::Real(x)) => Scalar::Real(libm::atan2f(y, x)),
            (y, x) => Scalar::Lreal(libm::atan2(y.real(), x.real())),
        },
        StdFun::Trunc => whole(result, first.real().trunc())?,
        StdFun::Shl | StdFun::Shr | StdFun::Rol | StdFun::Ror => {
            Scalar::Int(shift(fun, result, first.int(), args[1].int()))
        }
        StdFun::Sel => args[if first.is_true() { 2 } else { 1 }],
        StdFun::Max | StdFun::Min => {
            let mut best = first;
            for other in &args[1..] {
                best = choose(fun == StdFun::Max, best, *other);
            }
            best
        }
        StdFun::Limit => choose(false, choose(true, first, args[1]), args[2]),
        StdFun::IsValid => truth(first.real().is_finite()),
        StdFun::SwapBytes => swap(result, first),
        // The others are functions of strings, or need the machine.
        _ => first,
    })
}

fn swap(elem: Elem, value: Scalar) -> Scalar {
    let bytes = (shape(elem).0 / 8).max(1) as usize;
    let raw = match value {
        Scalar::Real(v) => v.to_bits().into(),
        Scalar::Lreal(v) => v.to_bits(),
        v => v.int() as u64,
    };
    let mut list = raw.to_le_bytes();
    list[..bytes].reverse();
    list[bytes..].fill(0);
    let raw = u64::from_le_bytes(list);
    match elem {
        Elem::Real => Scalar::Real(f32::from_bits(raw as u32)),
        Elem::Lreal => Scalar::Lreal(f64::from_bits(raw)),
        e => Scalar::Int(wrap(e, raw.into())),
    }
}

fn shift(fun: StdFun, elem: Elem, value: i128, places: i128) -> i128 {
    let width = i128::from(shape(elem).0);
    // Bit by bit, as the standard describes it.
    let rotate = matches!(fun, StdFun::Rol | StdFun::Ror);
    let left = matches!(fun, StdFun::Shl | StdFun::Rol);
    let mut out = 0;
    for bit in 0..width {
        let from = if left { bit - places } else { bit + places };
        let from = if rotate { from.rem_euclid(width) } else { from };
        // A negative or too large number of places shifts everything out.
        let inside = (0..width).contains(&from) && (rotate || (0..width).contains(&places));
        if inside && value >> from & 1 == 1 {
            out |= 1 << bit;
        }
    }
    // A signed number, which CODESYS shifts too, keeps its sign.
    if fun == StdFun::Shr && value < 0 {
        let places = if (0..width).contains(&places) {
            places
        } else {
            width
        };
        return value.div_euclid(1 << places);
    }
    out
}

fn choose(larger: bool, a: Scalar, b: Scalar) -> Scalar {
    if !matches!(a, Scalar::Real(_) | Scalar::Lreal(_)) {
        return match (larger, a.int() < b.int()) {
            (true, true) | (false, false) => b,
            _ => a,
        };
    }
    let (x, y) = (a.real(), b.real());
    if x.is_nan() || y.is_nan() {
        return if x.is_nan() { a } else { b };
    }
    // -0 counts as less than +0.
    let below = x < y || (x == y && x.is_sign_negative() && !y.is_sign_negative());
    if below == larger { b } else { a }
}

fn single(fun: StdFun, v: f32) -> f32 {
    match fun {
        StdFun::Sqrt => v.sqrt(),
        StdFun::Ln => libm::logf(v),
        StdFun::Log => libm::log10f(v),
        StdFun::Exp => libm::expf(v),
        StdFun::Sin => libm::sinf(v),
        StdFun::Cos => libm::cosf(v),
        StdFun::Tan => libm::tanf(v),
        StdFun::Asin => libm::asinf(v),
        StdFun::Acos => libm::acosf(v),
        _ => libm::atanf(v),
    }
}

fn double(fun: StdFun, v: f64) -> f64 {
    match fun {
        StdFun::Sqrt => v.sqrt(),
        StdFun::Ln => libm::log(v),
        StdFun::Log => libm::log10(v),
        StdFun::Exp => libm::exp(v),
        StdFun::Sin => libm::sin(v),
        StdFun::Cos => libm::cos(v),
        StdFun::Tan => libm::tan(v),
        StdFun::Asin => libm::asin(v),
        StdFun::Acos => libm::acos(v),
        _ => libm::atan(v),
    }
}
