//! Whether a row of masks can hold for any state: used to drop rows that cannot, and to find critical intervals that overlap.
//!
//! Comparisons of one variable with constants are decided exactly: if they have a solution at all, then one at, just below or
//! just above a constant, or at an end of the type's range. Comparisons of two variables are left open.

use fam_proto::diagnosis::{Mask, MaskOperand, MaskOperator, MaskType, MaskVariable};

/// Whether a conjunction of masks has a solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Satisfiable {
    /// It has.
    Yes,
    /// It has none.
    No,
    /// That cannot be decided here.
    Unknown,
}

/// Decides for all masks together.
#[must_use]
pub fn satisfiable(masks: &[Mask]) -> Satisfiable {
    let mut result = Satisfiable::Yes;
    let mut done: Vec<MaskVariable> = Vec::new();
    for mask in masks {
        if let MaskOperand::Variable(right) = mask.right {
            let asks_for_nan = right == mask.left && mask.operator == MaskOperator::NotEqual;
            if !asks_for_nan {
                if right == mask.left
                    && matches!(mask.operator, MaskOperator::Less | MaskOperator::Greater)
                {
                    return Satisfiable::No;
                }
                result = Satisfiable::Unknown;
                continue;
            }
        }
        let variable = mask.left;
        if done.contains(&variable) {
            continue;
        }
        if done.iter().any(|d| overlap(*d, variable)) {
            // Two views of the same bytes.
            result = Satisfiable::Unknown;
        }
        done.push(variable);
        let own: Vec<&Mask> = masks
            .iter()
            .filter(|m| m.left == variable && !is_of_two(m))
            .collect();
        let one = if matches!(variable.of, MaskType::Real(_)) {
            real(&own, variable.of)
        } else {
            integer(&own, variable.of)
        };
        match one {
            Satisfiable::No => return Satisfiable::No,
            Satisfiable::Unknown => result = Satisfiable::Unknown,
            Satisfiable::Yes => {}
        }
    }
    result
}

fn is_of_two(mask: &Mask) -> bool {
    matches!(mask.right, MaskOperand::Variable(right) if right != mask.left || mask.operator != MaskOperator::NotEqual)
}

#[allow(clippy::cast_possible_truncation)] // widths are 1, 2, 4 or 8
fn overlap(a: MaskVariable, b: MaskVariable) -> bool {
    a.offset < b.offset + b.of.bytes() as u32 && b.offset < a.offset + a.of.bytes() as u32
}

fn limits(of: MaskType) -> (i128, i128) {
    let bits = 8 * u32::try_from(of.bytes()).unwrap_or(8);
    match of {
        MaskType::Signed(_) => (-(1 << (bits - 1)), (1 << (bits - 1)) - 1),
        _ => (0, (1 << bits) - 1),
    }
}

fn integer(masks: &[&Mask], of: MaskType) -> Satisfiable {
    let (low, high) = limits(of);
    let (mut ones, mut zeros, mut has_bits) = (0u64, 0u64, false);
    let mut candidates = vec![low, high, 0];
    for mask in masks {
        match mask.right {
            // An integer is never NaN.
            MaskOperand::Variable(_) => return Satisfiable::No,
            MaskOperand::Integer(value) if mask.bits == u64::MAX => {
                candidates.extend([value - 1, value, value + 1]);
            }
            MaskOperand::Integer(value) => {
                has_bits = true;
                match (mask.operator, value) {
                    (MaskOperator::Equal, 0) => zeros |= mask.bits,
                    (MaskOperator::NotEqual, 0) if mask.bits.is_power_of_two() => ones |= mask.bits,
                    _ => return Satisfiable::Unknown,
                }
            }
            MaskOperand::RealBits(bits) => {
                let value = f64::from_bits(bits);
                if value.is_finite() && value.abs() < 1e30 {
                    #[allow(clippy::cast_possible_truncation)] // below 2^127 by the test above
                    let near = value as i128;
                    candidates.extend([near - 1, near, near + 1]);
                }
            }
        }
    }
    if ones & zeros != 0 {
        return Satisfiable::No;
    }
    let width = of.bytes();
    let holds = candidates.iter().any(|candidate| {
        let mut raw = *candidate as u64;
        if has_bits {
            raw = (raw & !zeros) | ones;
        }
        (low..=high).contains(candidate) && all_hold(masks, &raw.to_le_bytes()[..width])
    });
    match (holds, has_bits) {
        (true, _) => Satisfiable::Yes,
        (false, false) => Satisfiable::No,
        (false, true) => Satisfiable::Unknown,
    }
}

fn real(masks: &[&Mask], of: MaskType) -> Satisfiable {
    let mut candidates = vec![f64::NAN, f64::NEG_INFINITY, f64::INFINITY, 0.0];
    for mask in masks {
        let value = match mask.right {
            MaskOperand::RealBits(bits) => f64::from_bits(bits),
            #[allow(clippy::cast_precision_loss)] // as the masks themselves compare
            MaskOperand::Integer(value) => value as f64,
            MaskOperand::Variable(_) => continue,
        };
        if of.bytes() == 4 {
            #[allow(clippy::cast_possible_truncation)]
            // the nearest REAL and its neighbours are wanted
            let near = value as f32;
            candidates.extend([near.next_down(), near, near.next_up()].map(f64::from));
        } else {
            candidates.extend([value.next_down(), value, value.next_up()]);
        }
    }
    let holds = candidates.into_iter().any(|c| {
        #[allow(clippy::cast_possible_truncation)] // candidates of a REAL are REALs
        if of.bytes() == 4 {
            all_hold(masks, &(c as f32).to_le_bytes())
        } else {
            all_hold(masks, &c.to_le_bytes())
        }
    });
    if holds {
        Satisfiable::Yes
    } else {
        Satisfiable::No
    }
}

/// Evaluates masks of one variable, whose bytes are given.
fn all_hold(masks: &[&Mask], bytes: &[u8]) -> bool {
    masks.iter().all(|mask| {
        let at_start = |v: MaskVariable| MaskVariable { offset: 0, ..v };
        let right = match mask.right {
            MaskOperand::Variable(v) => MaskOperand::Variable(at_start(v)),
            other => other,
        };
        Mask {
            left: at_start(mask.left),
            right,
            ..**mask
        }
        .holds(bytes)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const OPERATORS: [MaskOperator; 6] = [
        MaskOperator::Equal,
        MaskOperator::NotEqual,
        MaskOperator::Less,
        MaskOperator::LessOrEqual,
        MaskOperator::Greater,
        MaskOperator::GreaterOrEqual,
    ];

    fn variable(offset: u32, of: MaskType) -> MaskVariable {
        MaskVariable { offset, of }
    }

    /// Comparisons of one byte with constants and bits, near enough to each other to collide.
    fn mask(of: MaskType) -> impl Strategy<Value = Mask> {
        let whole = (prop::sample::select(&OPERATORS[..]), -4i128..260).prop_map(
            move |(operator, value)| Mask {
                left: variable(0, of),
                bits: u64::MAX,
                operator,
                right: MaskOperand::Integer(value),
            },
        );
        let bit = (0u32..8, any::<bool>()).prop_map(move |(bit, set)| Mask {
            left: variable(0, of),
            bits: 1 << bit,
            operator: if set {
                MaskOperator::NotEqual
            } else {
                MaskOperator::Equal
            },
            right: MaskOperand::Integer(0),
        });
        prop_oneof![4 => whole, 1 => bit]
    }

    fn truth(masks: &[Mask]) -> bool {
        (0..=255u8).any(|byte| masks.iter().all(|m| m.holds(&[byte])))
    }

    proptest! {
        #[test]
        fn one_byte_is_decided_as_by_trying_all_values(
            signed in any::<bool>(),
            masks in any::<bool>().prop_flat_map(|_| prop::collection::vec(mask(MaskType::Unsigned(1)), 1..6)),
        ) {
            let of = if signed { MaskType::Signed(1) } else { MaskType::Unsigned(1) };
            let masks: Vec<Mask> = masks.into_iter().map(|m| Mask { left: variable(0, of), ..m }).collect();
            let has_bits = masks.iter().any(|m| m.bits != u64::MAX);
            match satisfiable(&masks) {
                Satisfiable::Yes => prop_assert!(truth(&masks)),
                Satisfiable::No => prop_assert!(!truth(&masks)),
                Satisfiable::Unknown => prop_assert!(has_bits),
            }
        }
    }

    #[test]
    fn a_variable_against_itself_and_two_views_of_one_place() {
        let compare = |left: MaskVariable, operator, right: MaskOperand| Mask {
            left,
            bits: u64::MAX,
            operator,
            right,
        };
        let x = variable(0, MaskType::Signed(4));
        for (operator, expected) in [
            (MaskOperator::Less, Satisfiable::No),
            (MaskOperator::Greater, Satisfiable::No),
            (MaskOperator::NotEqual, Satisfiable::No),
            (MaskOperator::LessOrEqual, Satisfiable::Unknown),
        ] {
            let itself = compare(x, operator, MaskOperand::Variable(x));
            assert_eq!(satisfiable(&[itself]), expected, "{operator:?}");
        }
        let equal = |v, n| compare(v, MaskOperator::Equal, MaskOperand::Integer(n));
        for (offset, expected) in [(3, Satisfiable::Unknown), (4, Satisfiable::Yes)] {
            let other = variable(offset, MaskType::Unsigned(1));
            assert_eq!(satisfiable(&[equal(x, 0), equal(other, 7)]), expected);
        }
    }

    #[test]
    fn reals_have_values_between_neighbours_only_if_there_are_any() {
        let compare = |of, operator, value: f64| Mask {
            left: variable(0, of),
            bits: u64::MAX,
            operator,
            right: MaskOperand::RealBits(value.to_bits()),
        };
        let (real, lreal) = (MaskType::Real(4), MaskType::Real(8));
        let tenth = f64::from(0.1f32);
        for (masks, expected) in [
            (
                vec![
                    compare(lreal, MaskOperator::Greater, 1.0),
                    compare(lreal, MaskOperator::Less, 2.0),
                ],
                Satisfiable::Yes,
            ),
            (
                vec![
                    compare(lreal, MaskOperator::Greater, 2.0),
                    compare(lreal, MaskOperator::Less, 1.0),
                ],
                Satisfiable::No,
            ),
            (
                vec![
                    compare(lreal, MaskOperator::Greater, 1.0),
                    compare(lreal, MaskOperator::Less, 1.0f64.next_up()),
                ],
                Satisfiable::No,
            ),
            (
                vec![compare(real, MaskOperator::Equal, 0.1)],
                Satisfiable::No,
            ),
            (
                vec![compare(real, MaskOperator::Equal, tenth)],
                Satisfiable::Yes,
            ),
            (
                vec![
                    compare(real, MaskOperator::NotEqual, tenth),
                    compare(real, MaskOperator::GreaterOrEqual, tenth),
                    compare(real, MaskOperator::LessOrEqual, tenth),
                ],
                Satisfiable::No,
            ),
            (
                vec![compare(lreal, MaskOperator::Less, f64::NEG_INFINITY)],
                Satisfiable::No,
            ),
        ] {
            assert_eq!(satisfiable(&masks), expected, "{masks:?}");
        }
    }

    #[test]
    fn a_nan_is_a_solution_where_it_is_asked_for() {
        let x = variable(0, MaskType::Real(8));
        let is_nan = Mask {
            left: x,
            bits: u64::MAX,
            operator: MaskOperator::NotEqual,
            right: MaskOperand::Variable(x),
        };
        let above = Mask {
            operator: MaskOperator::Greater,
            right: MaskOperand::RealBits(0f64.to_bits()),
            ..is_nan
        };
        assert_eq!(satisfiable(&[is_nan]), Satisfiable::Yes);
        assert_eq!(satisfiable(&[is_nan, above]), Satisfiable::No);
        let i = variable(8, MaskType::Signed(4));
        let never = Mask {
            left: i,
            right: MaskOperand::Variable(i),
            ..is_nan
        };
        assert_eq!(satisfiable(&[never]), Satisfiable::No);
        let two = Mask {
            left: i,
            right: MaskOperand::Variable(x),
            ..above
        };
        assert_eq!(satisfiable(&[two, is_nan]), Satisfiable::Unknown);
    }
}
