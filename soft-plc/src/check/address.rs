//! Addresses in the process image (IEC 61131-3, clause 6.5.5.2).

use crate::check::tree::Location;
use crate::check::{Checker, key};
use crate::diag::{Fallible, Problem};
use crate::source::Span;

/// Size of the process image, in bytes, that addresses may reach.
pub const IMAGE_BYTES_MAX: u32 = 64 * 1024;

/// The levels above the bytes of a module, from the lowest: how many there are, and how many bytes each takes.
const LEVELS: [(u32, u32); 3] = [
    (16, MODULE_BYTES),
    (4, 16 * MODULE_BYTES),
    (4, 4 * 16 * MODULE_BYTES),
];
const MODULE_BYTES: u32 = 256;
/// What a foreign address has at the end of the image.
const FOREIGN_BYTES: u32 = 8;

/// An address taken apart.
enum Address {
    At(Location),
    /// Hierarchical in the way of another PLC: more levels, or larger numbers, than bus, rack and module have. The byte
    /// of the location is not known.
    Foreign(Location),
}

/// `%IX3.5`, `%QB7`, `%IW2` (bytes 4 and 5), `%ID1` (bytes 4 to 7), `%QL1` (bytes 8 to 15).
///
/// More numbers are a hierarchical address, bus.rack.module before what has just been shown, the levels on the left left out
/// as one likes: `%IW2.7` is word 7 of module 2, which has bytes 512 to 767 of the image.
pub fn parse_location(text: &str, span: Span) -> Fallible<Location> {
    match parse(text, span)? {
        Address::At(location) => Ok(location),
        Address::Foreign(_) => {
            let message =
                format!("`{text}` has other levels than bus, rack, module and what the module has");
            Err(Box::new(Problem::error("E208", span, message)))
        }
    }
}

impl Checker<'_> {
    /// The place of an address. Those of other PLCs stand at the end of the image, in the order in which they are met.
    pub(super) fn address(&mut self, text: &str, span: Span) -> Fallible<Location> {
        let location = match parse(text, span)? {
            Address::At(location) => return Ok(location),
            Address::Foreign(location) => location,
        };
        let name = key(text);
        if let Some(byte) = self.foreign_addresses.get(&name) {
            return Ok(Location {
                byte: *byte,
                ..location
            });
        }
        let number = self.foreign_addresses.len() as u32 + 1;
        let Some(byte) = (number * FOREIGN_BYTES < IMAGE_BYTES_MAX / 2)
            .then(|| IMAGE_BYTES_MAX - number * FOREIGN_BYTES)
        else {
            let message = format!(
                "`{text}`: the image has no place for more addresses with levels of their own"
            );
            return Err(Box::new(Problem::error("E208", span, message)));
        };
        self.foreign_addresses.insert(name, byte);
        let location = Location { byte, ..location };
        self.report(
            Problem::warning(
                "W712",
                span,
                format!("`{text}` has other levels than bus, rack, module and what the module has"),
            )
            .hint(format!("it lies at {location} in the process image")),
        );
        Ok(location)
    }

    /// Whether it is such an address, which has room for one value only.
    pub(super) fn is_foreign(&self, location: Location) -> bool {
        self.foreign_addresses
            .values()
            .any(|byte| *byte == location.byte)
    }
}

/// The relative address of a field, `%B2`, `%X3.0` or `%W1`: its first bit (clause 6.4.4.6).
pub(super) fn parse_relative(text: &str, span: Span) -> Fallible<u64> {
    let bad = |message: String| {
        Err(Box::new(Problem::error("E208", span, message).expected(
            "the place in the structure: %X3.5, %B3, %W2, %D1 or %L0",
        )))
    };
    let rest = &text.to_ascii_uppercase()[1..];
    let (unit, bits) = match rest.chars().next() {
        Some('X') => ("X", 1),
        Some('B') => ("B", 8),
        Some('W') => ("W", 16),
        Some('D') => ("D", 32),
        Some('L') => ("L", 64),
        _ => return bad(format!("`{text}` is no relative address")),
    };
    let numbers: Option<Vec<u64>> = rest[unit.len()..]
        .split('.')
        .map(|n| n.parse::<u32>().ok().map(u64::from))
        .collect();
    let first = match (unit, numbers.as_deref()) {
        ("X", Some([byte, bit])) if *bit < 8 => byte * 8 + bit,
        (_, Some([number])) => number * bits,
        _ => return bad(format!("`{text}` is no relative address")),
    };
    if first >= u64::from(IMAGE_BYTES_MAX) * 8 {
        return bad(format!(
            "`{text}` lies outside the process image of {IMAGE_BYTES_MAX} bytes"
        ));
    }
    Ok(first)
}

fn parse(text: &str, span: Span) -> Fallible<Address> {
    let bad = |message: String| {
        Err(Box::new(Problem::error("E208", span, message).expected(
            "%IX3.5, %IB3, %IW2, %ID1 or %IL0, or the same with Q or M",
        )))
    };
    let upper = text.to_ascii_uppercase();
    let mut chars = upper.chars();
    chars.next();
    let area = chars.next();
    let memory = area == Some('M');
    let output = match area {
        Some('I') => false,
        Some('Q' | 'M') => true,
        _ => return bad(format!("`{text}` is no address of an input or output")),
    };
    let rest = chars.as_str();
    if rest.starts_with('*') {
        return bad(format!("`{text}`: an address must be complete"));
    }
    let (size, numbers) = match rest.chars().next() {
        Some(c @ ('X' | 'B' | 'W' | 'D' | 'L')) => (c, &rest[1..]),
        Some(c) if c.is_ascii_digit() => ('X', rest),
        _ => return bad(format!("`{text}`: the size must be X, B, W, D or L")),
    };
    let mut parts = Vec::new();
    for number in numbers.split('.') {
        match number.parse::<u32>() {
            Ok(number) => parts.push(number),
            Err(_) => return bad(format!("`{text}`: `{number}` is no number of an address")),
        }
    }
    let (unit, bit, above) = match (size, parts.as_slice()) {
        // `%IX7` without a bit: the bits are counted through.
        ('X', [number]) => (*number / 8, Some(*number % 8), &[][..]),
        ('X', [above @ .., byte, bit]) => (*byte, Some(*bit), above),
        (_, [above @ .., unit]) => (*unit, None, above),
        _ => return bad(format!("`{text}` has no number")),
    };
    let width = match size {
        'W' => 2,
        'D' => 4,
        'L' => 8,
        _ => 1,
    };
    let end = u64::from(unit) * width + width;
    let here = |byte, bit: Option<u32>| Location {
        output,
        memory,
        byte,
        bit: bit.map(|bit| bit as u8),
        size,
    };
    let fits = above.len() <= LEVELS.len()
        && end <= u64::from(MODULE_BYTES)
        && above
            .iter()
            .rev()
            .zip(LEVELS)
            .all(|(number, (count, _))| *number < count);
    if !above.is_empty() && !fits {
        return Ok(Address::Foreign(here(0, bit.map(|_| 0))));
    }
    if bit.is_some_and(|bit| bit >= 8) {
        return bad(format!("`{text}`: a byte has bits 0 to 7"));
    }
    if end > u64::from(IMAGE_BYTES_MAX) {
        return bad(format!(
            "`{text}` lies outside the process image of {IMAGE_BYTES_MAX} bytes"
        ));
    }
    let start: u32 = above
        .iter()
        .rev()
        .zip(LEVELS)
        .map(|(number, (_, bytes))| number * bytes)
        .sum();
    Ok(Address::At(here(start + end as u32 - width as u32, bit)))
}
