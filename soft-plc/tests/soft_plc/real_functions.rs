//! The formulas of the mathematical functions in Wasm against the functions that constants, the reference interpreter and rare
//! arguments use: the same bits, or an MC would compute another value where the compiler knows an argument beforehand.

use crate::common::Machine;

const BATCH: usize = 1_000;
const BATCHES: u64 = 3_000;

type Real = fn(f64) -> f64;
const FUNCTIONS: [(&str, Real); 5] = [
    ("SIN", libm::sin),
    ("COS", libm::cos),
    ("EXP", libm::exp),
    ("LN", libm::log),
    ("ATAN", libm::atan),
];

/// Upper halves at which one of the formulas goes another way.
const EDGES: [u32; 19] = [
    0x0010_0000, // least normal
    0x3e30_0000,
    0x3e40_0000,
    0x3e46_a09e,
    0x3e50_0000,
    0x3fd6_2e42, // ln 2 / 2
    0x3fdc_0000, // 7/16
    0x3fe6_0000, // 11/16
    0x3fe6_a09e, // sqrt(1/2)
    0x3fe9_21fb, // pi/4
    0x3ff0_0000,
    0x3ff0_a2b2, // ln 2 * 3/2
    0x3ff3_0000, // 19/16
    0x4002_d97c, // pi * 3/4
    0x4003_8000, // 39/16
    0x4086_232b, // 708.4
    0x40e9_2000, // 51,456
    0x4410_0000, // 2^66
    0x7ff0_0000, // infinity
];

/// Steele, Lea, Flood: Fast splittable pseudorandom number generators, 2014.
fn next(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// An argument of one of the kinds on which the formulas differ.
fn argument(state: &mut u64) -> f64 {
    let bits = next(state);
    let kind = next(state) % 8;
    let unit = (bits >> 11) as f64 / (1_u64 << 53) as f64;
    let within = |size: f64| (unit * 2.0 - 1.0) * size;
    let sign = bits & (1 << 63);
    match kind {
        0 => f64::from_bits(bits),
        1 => within(1.0),
        2 => within(8.0),
        3 => within(720.0),
        4 => within(110_000.0),
        5 => {
            // Some steps from a multiple of pi/4.
            let multiple = (next(state) % 140_000) as f64 * std::f64::consts::FRAC_PI_4;
            let steps = 1_u64 << (bits % 40);
            f64::from_bits((multiple.to_bits() + steps) | sign)
        }
        6 => {
            // Around an edge, or anywhere in the lower half of it.
            let edge = u64::from(EDGES[(bits % 19) as usize]) << 32;
            let low = (bits >> 8) % 7;
            let some = (bits >> 16) & 0xffff_ffff;
            let lower = if bits & 0x80 == 0 { low } else { some };
            f64::from_bits((edge + lower - 3) | sign)
        }
        _ => f64::from_bits((bits & !(0x7ff << 52)) | ((1023 - 40 + next(state) % 110) << 52)),
    }
}

#[test]
fn formulas_give_the_bits_of_the_library() {
    let mut machine = machine();
    let mut state = 11;
    let mut checked = 0_u64;
    for _ in 0..BATCHES {
        let arguments: Vec<f64> = (0..BATCH).map(|_| argument(&mut state)).collect();
        let bytes: Vec<u8> = arguments.iter().flat_map(|x| x.to_le_bytes()).collect();
        machine.instance.inputs_mut()[..bytes.len()].copy_from_slice(&bytes);
        machine.scan();
        let results = machine.instance.outputs();
        for (place, chunk) in results.as_chunks::<8>().0.iter().enumerate() {
            let (name, function) = FUNCTIONS[place / BATCH];
            let x = arguments[place % BATCH];
            let (ours, theirs) = (f64::from_le_bytes(*chunk), function(x));
            let same = ours.to_bits() == theirs.to_bits() || (ours.is_nan() && theirs.is_nan());
            assert!(same, "{name}({x:e}) = {ours:e}, expected {theirs:e}");
            checked += 1;
        }
    }
    assert_eq!(checked, 5 * BATCHES * BATCH as u64);
}

/// A program that applies all functions to its inputs.
fn machine() -> Machine {
    let last = BATCH - 1;
    let mut vars = format!("x AT %IL0 : ARRAY[0..{last}] OF LREAL;\ni : INT;\n");
    let mut body = String::new();
    for (place, (name, _)) in FUNCTIONS.iter().enumerate() {
        let at = place * BATCH;
        vars += &format!("r{name} AT %QL{at} : ARRAY[0..{last}] OF LREAL;\n");
        body += &format!("r{name}[i] := {name}(x[i]);\n");
    }
    let text = format!(
        "PROGRAM P\nVAR\n{vars}END_VAR\nFOR i := 0 TO {last} DO\n{body}END_FOR;\nEND_PROGRAM\n"
    );
    Machine::new(&text)
}
