//! Strings: the standard functions of table 34, and values as text.

use fam_soft_plc::TrapKind;
use fam_soft_plc::check::stdfun::StdFun;
use fam_soft_plc::types::Elem;

use crate::value::{Scalar, limits, wrap};

pub type Units = Vec<u16>;

/// `count` brought into 0..=limit.
fn within(count: i128, limit: usize) -> usize {
    count.clamp(0, limit as i128) as usize
}

/// First character, counted from 0, and the one behind the last, of what L and P mean.
fn part(text: &Units, length: i128, position: i128) -> (usize, usize) {
    let start = within(position - 1, text.len());
    (start, start + within(length, text.len() - start))
}

/// A function of strings with a string as its result; `texts` and `counts` in the order of the arguments.
pub fn edit(fun: StdFun, texts: &[Units], counts: &[i128]) -> Units {
    let first = &texts[0];
    match fun {
        StdFun::Left => first[..within(counts[0], first.len())].to_vec(),
        StdFun::Right => first[first.len() - within(counts[0], first.len())..].to_vec(),
        StdFun::Mid => {
            let (start, end) = part(first, counts[0], counts[1]);
            first[start..end].to_vec()
        }
        StdFun::Concat => texts.concat(),
        StdFun::Insert => {
            let at = within(counts[0], first.len());
            [&first[..at], &texts[1], &first[at..]].concat()
        }
        StdFun::Delete => {
            let (start, end) = part(first, counts[0], counts[1]);
            [&first[..start], &first[end..]].concat()
        }
        _ => {
            let (start, end) = part(first, counts[0], counts[1]);
            [&first[..start], &texts[1], &first[end..]].concat()
        }
    }
}

/// Where `wanted` begins in `text`, counted from 1; 0 if nowhere, or if nothing is wanted.
pub fn find(text: &Units, wanted: &Units) -> i128 {
    if wanted.is_empty() {
        return 0;
    }
    let found = text
        .windows(wanted.len())
        .position(|w| w == wanted.as_slice());
    found.map_or(0, |at| at as i128 + 1)
}

/// By the codes of the characters; a string is less than one that goes on behind it.
pub fn order(a: &Units, b: &Units) -> i128 {
    match a.cmp(b) {
        std::cmp::Ordering::Less => -1,
        std::cmp::Ordering::Equal => 0,
        std::cmp::Ordering::Greater => 1,
    }
}

pub fn units(text: &str) -> Units {
    text.encode_utf16().collect()
}

const UNITS_NS: [(&str, i128); 7] = [
    ("d", 86_400_000_000_000),
    ("h", 3_600_000_000_000),
    ("m", 60_000_000_000),
    ("s", 1_000_000_000),
    ("ms", 1_000_000),
    ("us", 1_000),
    ("ns", 1),
];
const DAY_NS: i128 = 86_400_000_000_000;

fn duration(ns: i128) -> String {
    let mut out = String::new();
    let mut rest = ns.abs();
    for (unit, size) in UNITS_NS {
        if rest >= size {
            out.push_str(&format!("{}{unit}", rest / size));
            rest %= size;
        }
    }
    if out.is_empty() {
        out.push_str("0s");
    }
    format!("T#{}{out}", if ns < 0 { "-" } else { "" })
}

/// Year, month and day, counted up from 1970 year by year.
fn date(ns: i128) -> String {
    let mut days = ns.div_euclid(DAY_NS);
    let leap = |y: i128| y % 4 == 0 && (y % 100 != 0 || y % 400 == 0);
    let mut year = 1970;
    while days < 0 {
        year -= 1;
        days += if leap(year) { 366 } else { 365 };
    }
    while days >= if leap(year) { 366 } else { 365 } {
        days -= if leap(year) { 366 } else { 365 };
        year += 1;
    }
    let february = if leap(year) { 29 } else { 28 };
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    format!("{year:04}-{month:02}-{:02}", days + 1)
}

fn time_of_day(ns: i128) -> String {
    let ns = ns.rem_euclid(DAY_NS);
    let seconds = ns / 1_000_000_000;
    let mut text = format!(
        "{:02}:{:02}:{:02}",
        seconds / 3600,
        seconds / 60 % 60,
        seconds % 60
    );
    let fraction = ns % 1_000_000_000;
    if fraction > 0 {
        text.push('.');
        text.push_str(format!("{fraction:09}").trim_end_matches('0'));
    }
    text
}

/// `*_TO_STRING`
pub fn of_value(elem: Elem, value: Scalar) -> Units {
    if matches!(elem, Elem::Char | Elem::Wchar) {
        return vec![value.int() as u16];
    }
    units(&match (elem, value) {
        (_, Scalar::Real(v)) => format!("{v:?}"),
        (_, Scalar::Lreal(v)) => format!("{v:?}"),
        (Elem::Bool, v) => if v.is_true() { "TRUE" } else { "FALSE" }.to_owned(),
        (Elem::Time, v) => duration(v.int()),
        (Elem::Date, v) => format!("D#{}", date(v.int())),
        (Elem::Tod, v) => format!("TOD#{}", time_of_day(v.int())),
        (Elem::Dt, v) => format!("DT#{}-{}", date(v.int()), time_of_day(v.int())),
        (_, v) => v.int().to_string(),
    })
}

/// STRING to WSTRING and back; what a STRING cannot hold becomes a question mark.
pub fn widen(text: Units, to_wide: bool) -> Units {
    if to_wide {
        return text;
    }
    text.into_iter()
        .map(|u| if u > 255 { u16::from(b'?') } else { u })
        .collect()
}

/// `STRING_TO_*` of integers, BOOL, reals and durations in the form that `*_TO_STRING` gives, with signs and leading zeros.
pub fn to_value(elem: Elem, text: &Units) -> Result<Scalar, TrapKind> {
    let text = String::from_utf16_lossy(text);
    let text = text.trim();
    let wrong = TrapKind::Conversion;
    match elem {
        Elem::Bool => match text.to_ascii_uppercase().as_str() {
            "TRUE" | "1" => Ok(Scalar::Int(1)),
            "FALSE" | "0" => Ok(Scalar::Int(0)),
            _ => Err(wrong),
        },
        Elem::Real => text.parse().map(Scalar::Real).map_err(|_| wrong),
        Elem::Lreal => text.parse().map(Scalar::Lreal).map_err(|_| wrong),
        Elem::Time => parse_duration(text).ok_or(wrong),
        _ => {
            let number: i128 = text.parse().map_err(|_| wrong)?;
            let (low, high) = limits(elem);
            if (low..=high).contains(&number) {
                Ok(Scalar::Int(wrap(elem, number)))
            } else {
                Err(wrong)
            }
        }
    }
}

fn parse_duration(text: &str) -> Option<Scalar> {
    let upper = text.to_ascii_uppercase();
    let body = upper.strip_prefix("T#")?;
    let (sign, mut rest) = match body.strip_prefix('-') {
        Some(rest) => (-1, rest),
        None => (1, body),
    };
    let mut sum = 0i128;
    while !rest.is_empty() {
        let digits = rest.find(|c: char| !c.is_ascii_digit())?;
        let number: i128 = rest[..digits].parse().ok()?;
        rest = &rest[digits..];
        let letters = rest
            .find(|c: char| c.is_ascii_digit())
            .unwrap_or(rest.len());
        let unit = rest[..letters].to_ascii_lowercase();
        sum += number * UNITS_NS.iter().find(|(u, _)| *u == unit)?.1;
        rest = &rest[letters..];
    }
    let ns = sign * sum;
    let (low, high) = limits(Elem::Time);
    (low..=high).contains(&ns).then_some(Scalar::Int(ns))
}
