//! The standard functions (IEC 61131-3, tables 28 to 33) that are not operators in another form: names, parameters, meaning.

use crate::types::Elem;
use crate::value::{Fault, Value, canonical_f32, canonical_f64, integer};

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum StdFun {
    Abs,
    Sqrt,
    Ln,
    Log,
    Exp,
    Sin,
    Cos,
    Tan,
    Asin,
    Acos,
    Atan,
    Atan2,
    /// REAL or LREAL towards zero, to the integer type of the result.
    Trunc,
    Shl,
    Shr,
    Rol,
    Ror,
    Sel,
    Max,
    Min,
    Limit,
    Mux,
    /// Whether a REAL is a number, neither infinite nor NaN.
    IsValid,
    /// MC time.
    McTime,
    // Strings.
    Len,
    Left,
    Right,
    Mid,
    Concat,
    Insert,
    Delete,
    Replace,
    Find,
    /// An elementary value as text.
    ToText,
    /// The elementary value that a text shows; a trap if it shows none.
    FromText,
    /// Comparison of two strings: negative, 0 or positive.
    Compare,
    /// Bytes in the opposite order.
    SwapBytes,
}

/// What the arguments of a function may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signature {
    /// ANY_NUM -> the same
    Num,
    /// ANY_REAL -> the same
    Real,
    /// two ANY_REAL -> the same
    Real2,
    /// ANY_BIT, ANY_INT -> type of the first
    Shift,
    /// BOOL, ANY, ANY -> type of the others
    Sel,
    /// two or more ANY_ELEMENTARY -> the same
    Extensible,
    /// MN, IN, MX -> the same
    Limit,
    /// ANY_INT, ANY... -> type of the others
    Mux,
    /// ANY_REAL -> ANY_INT
    Trunc,
    /// ANY_REAL -> BOOL
    Validity,
    /// nothing -> TIME
    Time,
    /// strings and numbers -> string or number
    Text,
    /// ANY_NUM or ANY_BIT -> the same
    Swap,
}

impl StdFun {
    const NAMES: [(&'static str, StdFun); 36] = [
        ("ABS", StdFun::Abs),
        ("SQRT", StdFun::Sqrt),
        ("LN", StdFun::Ln),
        ("LOG", StdFun::Log),
        ("EXP", StdFun::Exp),
        ("SIN", StdFun::Sin),
        ("COS", StdFun::Cos),
        ("TAN", StdFun::Tan),
        ("ASIN", StdFun::Asin),
        ("ACOS", StdFun::Acos),
        ("ATAN", StdFun::Atan),
        ("ATAN2", StdFun::Atan2),
        ("TRUNC", StdFun::Trunc),
        ("SHL", StdFun::Shl),
        ("SHR", StdFun::Shr),
        ("ROL", StdFun::Rol),
        ("ROR", StdFun::Ror),
        ("SEL", StdFun::Sel),
        ("MAX", StdFun::Max),
        ("MIN", StdFun::Min),
        ("LIMIT", StdFun::Limit),
        ("MUX", StdFun::Mux),
        ("IS_VALID", StdFun::IsValid),
        ("__MC_TIME", StdFun::McTime),
        ("TIME", StdFun::McTime),
        ("LEN", StdFun::Len),
        ("LEFT", StdFun::Left),
        ("RIGHT", StdFun::Right),
        ("MID", StdFun::Mid),
        ("CONCAT", StdFun::Concat),
        ("INSERT", StdFun::Insert),
        ("DELETE", StdFun::Delete),
        ("REPLACE", StdFun::Replace),
        ("FIND", StdFun::Find),
        ("TO_BIG_ENDIAN", StdFun::SwapBytes),
        ("FROM_BIG_ENDIAN", StdFun::SwapBytes),
    ];

    pub fn from_name(name: &str) -> Option<StdFun> {
        StdFun::NAMES
            .iter()
            .find(|(n, _)| n.eq_ignore_ascii_case(name))
            .map(|(_, f)| *f)
    }

    pub fn name(self) -> &'static str {
        StdFun::NAMES
            .iter()
            .find(|(_, f)| *f == self)
            .map_or("", |(n, _)| n)
    }

    pub fn signature(self) -> Signature {
        match self {
            StdFun::Abs => Signature::Num,
            StdFun::Sqrt
            | StdFun::Ln
            | StdFun::Log
            | StdFun::Exp
            | StdFun::Sin
            | StdFun::Cos
            | StdFun::Tan
            | StdFun::Asin
            | StdFun::Acos
            | StdFun::Atan => Signature::Real,
            StdFun::Atan2 => Signature::Real2,
            StdFun::Trunc => Signature::Trunc,
            StdFun::Shl | StdFun::Shr | StdFun::Rol | StdFun::Ror => Signature::Shift,
            StdFun::Sel => Signature::Sel,
            StdFun::Max | StdFun::Min => Signature::Extensible,
            StdFun::Limit => Signature::Limit,
            StdFun::Mux => Signature::Mux,
            StdFun::IsValid => Signature::Validity,
            StdFun::McTime => Signature::Time,
            StdFun::SwapBytes => Signature::Swap,
            _ => Signature::Text,
        }
    }

    /// Names of the parameters in formal calls; `None` where they are numbered (IN1, IN2, ... or IN0, IN1, ...).
    pub fn parameters(self) -> &'static [&'static str] {
        match self.signature() {
            Signature::Text => match self {
                StdFun::Left | StdFun::Right => &["IN", "L"],
                StdFun::Mid | StdFun::Delete => &["IN", "L", "P"],
                StdFun::Insert => &["IN1", "IN2", "P"],
                StdFun::Replace => &["IN1", "IN2", "L", "P"],
                StdFun::Concat | StdFun::Find | StdFun::Compare => &["IN1", "IN2"],
                _ => &["IN"],
            },
            Signature::Num
            | Signature::Real
            | Signature::Trunc
            | Signature::Validity
            | Signature::Swap => &["IN"],
            Signature::Real2 => &["Y", "X"],
            Signature::Shift => &["IN", "N"],
            Signature::Sel => &["G", "IN0", "IN1"],
            Signature::Extensible => &["IN1", "IN2"],
            Signature::Limit => &["MN", "IN", "MX"],
            Signature::Mux => &["K", "IN0"],
            Signature::Time => &[],
        }
    }
}

/// The function on values, for constants and conditions. `result` is the elementary type of the result; shifts and TRUNC need it.
pub fn evaluate(fun: StdFun, result: Elem, args: &[Value]) -> Result<Value, Fault> {
    let first = *args.first().ok_or(Fault::Types)?;
    match fun.signature() {
        Signature::Num => match first {
            Value::Real(v) => Ok(Value::Real(v.abs())),
            Value::Lreal(v) => Ok(Value::Lreal(v.abs())),
            v => Ok(Value::from_i128(
                result,
                v.as_i128().ok_or(Fault::Types)?.abs(),
            )),
        },
        Signature::Real => match first {
            Value::Real(v) => Ok(Value::Real(real_f32(fun, v))),
            Value::Lreal(v) => Ok(Value::Lreal(real_f64(fun, v))),
            _ => Err(Fault::Types),
        },
        Signature::Real2 => match (first, args.get(1)) {
            (Value::Real(y), Some(Value::Real(x))) => {
                Ok(Value::Real(canonical_f32(libm::atan2f(y, *x))))
            }
            (Value::Lreal(y), Some(Value::Lreal(x))) => {
                Ok(Value::Lreal(canonical_f64(libm::atan2(y, *x))))
            }
            _ => Err(Fault::Types),
        },
        Signature::Shift => {
            let (Some(bits), Some(n)) = (first.as_i128(), args.get(1).and_then(|v| v.as_i128()))
            else {
                return Err(Fault::Types);
            };
            Ok(Value::from_i128(result, shift(fun, result.bits(), bits, n)))
        }
        Signature::Sel => {
            let chosen = usize::from(first.as_bool().ok_or(Fault::Types)?);
            args.get(1 + chosen).copied().ok_or(Fault::Types)
        }
        Signature::Mux => {
            let k = first.as_i128().ok_or(Fault::Types)?;
            let index = usize::try_from(k).map_err(|_| Fault::Range)?;
            args.get(1 + index).copied().ok_or(Fault::Range)
        }
        Signature::Extensible => {
            let mut best = first;
            for value in &args[1..] {
                best = pick(fun == StdFun::Max, best, *value);
            }
            Ok(best)
        }
        Signature::Limit => match args {
            [low, value, high] => Ok(pick(false, pick(true, *low, *value), *high)),
            _ => Err(Fault::Types),
        },
        Signature::Trunc => integer(result, libm::trunc(first.as_f64())),
        Signature::Validity => Ok(Value::Bool(first.as_f64().is_finite())),
        Signature::Swap => {
            let bytes = (result.bits() / 8) as usize;
            let mut raw = [0u8; 8];
            first.store(&mut raw[..bytes]);
            raw[..bytes].reverse();
            Ok(Value::load(result, &raw[..bytes]))
        }
        Signature::Time | Signature::Text => Err(Fault::Types),
    }
}

/// The larger or smaller of two. Of reals as Wasm's `max` and `min` define it: NaN if one is, and -0 is below +0.
fn pick(larger: bool, a: Value, b: Value) -> Value {
    let real = matches!(a, Value::Real(_) | Value::Lreal(_));
    let (x, y) = (a.as_f64(), b.as_f64());
    if real && (x.is_nan() || y.is_nan()) {
        return match a {
            Value::Real(_) => Value::Real(canonical_f32(f32::NAN)),
            _ => Value::Lreal(canonical_f64(f64::NAN)),
        };
    }
    let take_b = if real && x == y {
        x.is_sign_negative() == larger
    } else if larger {
        b > a
    } else {
        b < a
    };
    if take_b { b } else { a }
}

/// A negative or too large number of places shifts everything out; rotations count modulo the width.
fn shift(fun: StdFun, width: u32, value: i128, n: i128) -> i128 {
    let width = i128::from(width);
    match fun {
        StdFun::Shl if (0..width).contains(&n) => value << n,
        StdFun::Shr if (0..width).contains(&n) => value >> n,
        // Of a signed number, which CODESYS shifts too, its sign is left.
        StdFun::Shr if value < 0 => -1,
        StdFun::Shl | StdFun::Shr => 0,
        _ => {
            let left = if fun == StdFun::Rol { n } else { -n }.rem_euclid(width);
            (value << left) | (value >> (width - left))
        }
    }
}

pub fn real_f32(fun: StdFun, v: f32) -> f32 {
    canonical_f32(match fun {
        StdFun::Sqrt => libm::sqrtf(v),
        StdFun::Ln => libm::logf(v),
        StdFun::Log => libm::log10f(v),
        StdFun::Exp => libm::expf(v),
        StdFun::Sin => libm::sinf(v),
        StdFun::Cos => libm::cosf(v),
        StdFun::Tan => libm::tanf(v),
        StdFun::Asin => libm::asinf(v),
        StdFun::Acos => libm::acosf(v),
        _ => libm::atanf(v),
    })
}

pub fn real_f64(fun: StdFun, v: f64) -> f64 {
    canonical_f64(match fun {
        StdFun::Sqrt => libm::sqrt(v),
        StdFun::Ln => libm::log(v),
        StdFun::Log => libm::log10(v),
        StdFun::Exp => libm::exp(v),
        StdFun::Sin => libm::sin(v),
        StdFun::Cos => libm::cos(v),
        StdFun::Tan => libm::tan(v),
        StdFun::Asin => libm::asin(v),
        StdFun::Acos => libm::acos(v),
        _ => libm::atan(v),
    })
}
