//! Elementary values as text and back: host functions, because numbers are written and read the same way on every host.

use wasmtime::{Caller, Extern, Linker, Memory};

use crate::codegen::{MATH_MODULE, MEMORY_EXPORT};
use crate::source::Span;
use crate::syntax::literal;
use crate::types::Elem;
use crate::value::Value;

pub fn link(linker: &mut Linker<()>) -> wasmtime::Result<()> {
    linker.func_wrap(
        MATH_MODULE,
        "text_of_value",
        |mut caller: Caller<'_, ()>,
         kind: i32,
         bits: i64,
         at: i32,
         wide: i32|
         -> wasmtime::Result<i32> {
            let elem = element(kind)?;
            let raw = bits.to_le_bytes();
            let value = Value::load(elem, &raw[..elem.image_bytes() as usize]);
            let text = text_of(value);
            write(&mut caller, at, &text, wide != 0)
        },
    )?;
    linker.func_wrap(
        MATH_MODULE,
        "value_of_text",
        |mut caller: Caller<'_, ()>,
         kind: i32,
         ptr: i32,
         len: i32,
         wide: i32|
         -> wasmtime::Result<(i64, i32)> {
            let elem = element(kind)?;
            let units = read(&mut caller, ptr, len, wide != 0)?;
            let text: String = char::decode_utf16(units)
                .map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER))
                .collect();
            Ok(match value_of(elem, text.trim()) {
                Some(value) => {
                    let mut raw = [0u8; 8];
                    // Signed values are extended to the width of their cell.
                    value.store(&mut raw);
                    (i64::from_le_bytes(raw), 1)
                }
                None => (0, 0),
            })
        },
    )?;
    linker.func_wrap(
        MATH_MODULE,
        "text_convert",
        |mut caller: Caller<'_, ()>,
         ptr: i32,
         len: i32,
         at: i32,
         from_wide: i32|
         -> wasmtime::Result<i32> {
            let units = read(&mut caller, ptr, len, from_wide != 0)?;
            let to_wide = from_wide == 0;
            let mut bytes = Vec::with_capacity(units.len() * 2);
            for unit in &units {
                if to_wide {
                    bytes.extend_from_slice(&unit.to_le_bytes());
                } else {
                    bytes.push(u8::try_from(*unit).unwrap_or(b'?'));
                }
            }
            put(&mut caller, at, &bytes)?;
            Ok(units.len() as i32)
        },
    )?;
    Ok(())
}

fn element(kind: i32) -> wasmtime::Result<Elem> {
    Elem::ALL
        .get(kind as usize)
        .copied()
        .ok_or_else(|| wasmtime::Error::msg("a value of no type"))
}

fn memory(caller: &mut Caller<'_, ()>) -> wasmtime::Result<Memory> {
    match caller.get_export(MEMORY_EXPORT) {
        Some(Extern::Memory(memory)) => Ok(memory),
        _ => Err(wasmtime::Error::msg("the module has no memory")),
    }
}

fn read(caller: &mut Caller<'_, ()>, ptr: i32, len: i32, wide: bool) -> wasmtime::Result<Vec<u16>> {
    let memory = memory(caller)?;
    let data = memory.data(&*caller);
    let width = if wide { 2 } else { 1 };
    let bytes = data
        .get(ptr as usize..ptr as usize + len as usize * width)
        .ok_or_else(|| wasmtime::Error::msg("a string beyond the memory"))?;
    Ok(if wide {
        bytes
            .chunks_exact(2)
            .map(|c| u16::from_le_bytes([c[0], c[1]]))
            .collect()
    } else {
        bytes.iter().map(|b| u16::from(*b)).collect()
    })
}

fn put(caller: &mut Caller<'_, ()>, at: i32, bytes: &[u8]) -> wasmtime::Result<()> {
    let memory = memory(caller)?;
    let at = at as usize;
    memory
        .data_mut(&mut *caller)
        .get_mut(at..at + bytes.len())
        .ok_or_else(|| wasmtime::Error::msg("a string beyond the memory"))?
        .copy_from_slice(bytes);
    Ok(())
}

fn write(caller: &mut Caller<'_, ()>, at: i32, text: &str, wide: bool) -> wasmtime::Result<i32> {
    let mut bytes = Vec::new();
    for byte in text.bytes() {
        bytes.push(byte);
        if wide {
            bytes.push(0);
        }
    }
    put(caller, at, &bytes)?;
    Ok(text.len() as i32)
}

/// The text that `*_TO_STRING` gives.
pub fn text_of(value: Value) -> String {
    match value {
        Value::Char(code) => char::from_u32(u32::from(code)).map_or(String::new(), String::from),
        // Never longer than the buffer that the compiled code has for it.
        value => value.to_string().chars().take(60).collect(),
    }
}

/// The value that `STRING_TO_*` reads; `None` if the text shows none of this type.
pub fn value_of(elem: Elem, text: &str) -> Option<Value> {
    let span = Span::default();
    let upper = text.to_ascii_uppercase();
    match elem {
        Elem::Bool => match upper.as_str() {
            "TRUE" | "1" => Some(Value::Bool(true)),
            "FALSE" | "0" => Some(Value::Bool(false)),
            _ => None,
        },
        Elem::Real | Elem::Lreal => {
            let number: f64 = text.parse().ok()?;
            Some(if elem == Elem::Real {
                Value::Real(text.parse().unwrap_or(number as f32))
            } else {
                Value::Lreal(number)
            })
        }
        Elem::Time => prefixed("T#", &upper, |t| literal::time(t, span).ok()).map(Value::Time),
        Elem::Date => prefixed("D#", &upper, |t| literal::date(t, span).ok()).map(Value::Date),
        Elem::Tod => {
            prefixed("TOD#", &upper, |t| literal::time_of_day(t, span).ok()).map(Value::Tod)
        }
        Elem::Dt => prefixed("DT#", &upper, |t| literal::date_time(t, span).ok()).map(Value::Dt),
        Elem::Char | Elem::Wchar => {
            let mut chars = text.chars();
            let code = u16::try_from(u32::from(chars.next()?)).ok()?;
            (chars.next().is_none() && (elem == Elem::Wchar || code < 256))
                .then_some(Value::Char(code))
        }
        Elem::Ref => None,
        _ => {
            let (negative, digits) = match upper.strip_prefix('-') {
                Some(rest) => (true, rest),
                None => (false, upper.strip_prefix('+').unwrap_or(&upper)),
            };
            if digits.is_empty() {
                return None;
            }
            let number = if digits.contains('#') {
                literal::based(digits, span).ok()?
            } else {
                literal::integer(digits, span).ok()?
            };
            let number = if negative { -number } else { number };
            let (lo, hi) = elem.limits()?;
            (lo..=hi)
                .contains(&number)
                .then(|| Value::from_i128(elem, number))
        }
    }
}

fn prefixed<T>(prefix: &str, text: &str, read: impl Fn(&str) -> Option<T>) -> Option<T> {
    if text.contains('#') {
        read(text)
    } else {
        read(&format!("{prefix}{text}"))
    }
}
