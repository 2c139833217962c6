//! Values of literals: integers with base, durations, strings with escapes (IEC 61131-3, clause 6.3).

use crate::calendar::{DAY_NS, SECOND_NS, days_in_month, days_of};
use crate::diag::{Fallible, Problem};
use crate::source::Span;

/// `1_000`
pub fn integer(text: &str, span: Span) -> Fallible<i128> {
    radix(text, 10, span)
}

/// `16#FF`, `2#1010_0101`
pub fn based(text: &str, span: Span) -> Fallible<i128> {
    let (base, digits) = text.split_once('#').unwrap_or(("10", text));
    match base {
        "2" => radix(digits, 2, span),
        "8" => radix(digits, 8, span),
        "10" => radix(digits, 10, span),
        "16" => radix(digits, 16, span),
        _ => Problem::error("E105", span, format!("`{base}` is no base of a number"))
            .expected("2#, 8#, 10# or 16#")
            .fail(),
    }
}

fn radix(digits: &str, base: u32, span: Span) -> Fallible<i128> {
    if digits.ends_with('_') || digits.contains("__") {
        return Problem::error("E105", span, "an underscore must stand between two digits").fail();
    }
    let digits = digits.replace('_', "");
    if let Some(bad) = digits.chars().find(|c| !c.is_digit(base)) {
        let message = format!("`{bad}` is no digit of a number with base {base}");
        return Problem::error("E105", span, message).fail();
    }
    match i128::from_str_radix(&digits, base) {
        Ok(value) if value <= i128::from(u64::MAX) => Ok(value),
        _ => Problem::error("E106", span, "this number is too large for any type")
            .expected("at most 18446744073709551615 (ULINT)")
            .fail(),
    }
}

pub fn real(text: &str, span: Span) -> Fallible<f64> {
    match text.replace('_', "").parse() {
        Ok(value) => Ok(value),
        Err(_) => Problem::error("E105", span, format!("`{text}` is no number")).fail(),
    }
}

const UNITS: [(&str, i128); 7] = [
    ("d", 86_400_000_000_000),
    ("h", 3_600_000_000_000),
    ("ms", 1_000_000),
    ("us", 1_000),
    ("ns", 1),
    ("m", 60_000_000_000),
    ("s", 1_000_000_000),
];

/// `T#1d2h3m4.5s`, `TIME#-5ms`: nanoseconds. The largest unit may exceed its usual range, only the last may have a fraction.
pub fn time(text: &str, span: Span) -> Fallible<i64> {
    let bad = |what: String| {
        Problem::error("E107", span, what)
            .expected("a duration such as T#500ms, T#1m30s or T#-2.5s")
    };
    let body = text.split_once('#').map_or(text, |(_, b)| b);
    let body = body.to_ascii_lowercase().replace('_', "");
    let (negative, mut rest) = match body.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, body.strip_prefix('+').unwrap_or(&body)),
    };
    let mut total: i128 = 0;
    let mut last_unit = i128::MAX;
    let mut fraction_seen = false;
    while !rest.is_empty() {
        let split = rest
            .find(|c: char| !c.is_ascii_digit() && c != '.')
            .ok_or_else(|| bad(format!("the unit is missing after `{rest}`")))?;
        let (number, tail) = rest.split_at(split);
        let (name, unit) = UNITS
            .iter()
            .find(|(n, _)| tail.starts_with(n))
            .ok_or_else(|| bad(format!("`{tail}` does not start with a unit of time")))?;
        if fraction_seen {
            return bad("only the last part may have a fraction".into()).fail();
        }
        if *unit >= last_unit {
            return bad(format!(
                "`{number}{name}` stands after a unit that is not larger"
            ))
            .fail();
        }
        last_unit = *unit;
        let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
        fraction_seen = number.contains('.');
        let whole: i128 = whole
            .parse()
            .ok()
            .filter(|w| *w < 1 << 80)
            .ok_or_else(|| bad(format!("`{number}` is no number")))?;
        total += whole * unit;
        let mut scale = *unit;
        for digit in fraction.chars() {
            let digit = digit
                .to_digit(10)
                .ok_or_else(|| bad(format!("`{number}` is no number")))?;
            scale /= 10;
            total += i128::from(digit) * scale;
        }
        rest = &tail[name.len()..];
    }
    let total = if negative { -total } else { total };
    i64::try_from(total).or_else(|_| bad("this duration is too long".into()).fail())
}

/// `D#2024-02-29`: nanoseconds since 1970-01-01.
pub fn date(text: &str, span: Span) -> Fallible<i64> {
    let body = text.split_once('#').map_or(text, |(_, b)| b);
    day(body, span)
}

/// `TOD#12:34:56.789`: nanoseconds since midnight.
pub fn time_of_day(text: &str, span: Span) -> Fallible<i64> {
    let body = text.split_once('#').map_or(text, |(_, b)| b);
    clock(body, span)
}

/// `DT#2024-02-29-12:34:56.789`: nanoseconds since 1970-01-01.
pub fn date_time(text: &str, span: Span) -> Fallible<i64> {
    let body = text.split_once('#').map_or(text, |(_, b)| b);
    let Some((date, time)) = body.rsplit_once('-') else {
        return bad_date(span).fail();
    };
    let total = i128::from(day(date, span)?) + i128::from(clock(time, span)?);
    i64::try_from(total).or_else(|_| bad_date(span).fail())
}

fn bad_date(span: Span) -> Problem {
    Problem::error("E121", span, "there is no such date or time of day")
        .expected("D#2024-02-29, TOD#12:34:56.789 or DT#2024-02-29-12:34:56, from 1678 to 2261")
}

fn day(text: &str, span: Span) -> Fallible<i64> {
    let parts: Vec<i64> = text.split('-').filter_map(|p| p.parse().ok()).collect();
    let [year, month, day] = parts[..] else {
        return bad_date(span).fail();
    };
    let known = (1678..=2261).contains(&year)
        && (1..=12).contains(&month)
        && (1..=days_in_month(year, month)).contains(&day);
    if !known {
        return bad_date(span).fail();
    }
    Ok(days_of(year, month, day) * DAY_NS)
}

fn clock(text: &str, span: Span) -> Fallible<i64> {
    let mut parts = text.split(':');
    let whole = |text: Option<&str>, limit: i64| {
        text.and_then(|t| t.parse::<i64>().ok())
            .filter(|v| *v < limit)
    };
    let hours = whole(parts.next(), 24);
    let minutes = whole(parts.next(), 60);
    let (seconds, fraction) = match parts.next() {
        Some(text) => text.split_once('.').unwrap_or((text, "")),
        None => ("0", ""),
    };
    let seconds = whole(Some(seconds), 60);
    let (Some(hours), Some(minutes), Some(seconds)) = (hours, minutes, seconds) else {
        return bad_date(span).fail();
    };
    let mut ns = ((hours * 60 + minutes) * 60 + seconds) * SECOND_NS;
    let mut scale = SECOND_NS;
    for digit in fraction.chars().filter_map(|c| c.to_digit(10)) {
        scale /= 10;
        ns += i64::from(digit) * scale;
    }
    Ok(ns)
}

/// The text between the quotes, with `$` escapes replaced.
pub fn string(text: &str, span: Span) -> Fallible<String> {
    let inner = &text[1..text.len() - 1];
    let digits = if text.starts_with('"') { 4 } else { 2 };
    let mut out = String::new();
    let mut chars = inner.chars();
    while let Some(c) = chars.next() {
        if c != '$' {
            out.push(c);
            continue;
        }
        let rest = chars.as_str();
        match rest.chars().next() {
            Some(c @ ('$' | '\'' | '"')) => out.push(c),
            Some('L' | 'l' | 'N' | 'n') => out.push('\n'),
            Some('P' | 'p') => out.push('\u{c}'),
            Some('R' | 'r') => out.push('\r'),
            Some('T' | 't') => out.push('\t'),
            _ => {
                let code = rest
                    .get(..digits)
                    .and_then(|hex| u32::from_str_radix(hex, 16).ok())
                    .and_then(char::from_u32);
                let Some(code) = code else {
                    return Problem::error("E108", span, "`$` is followed by no known escape")
                        .expected(format!("$$, $', $L, $N, $P, $R, $T or {digits} hex digits"))
                        .fail();
                };
                out.push(code);
                chars = rest[digits..].chars();
                continue;
            }
        }
        chars.next();
    }
    Ok(out)
}
