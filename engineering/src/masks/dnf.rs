//! Formulas over masks, and their disjunctive normal form.

use super::satisfy::{Satisfiable, satisfiable};
use fam_proto::diagnosis::{Mask, MaskOperand, MaskOperator, MaskType, MaskVariable};

/// Most rows of one condition.
pub const ROWS_MAX: usize = 256;
/// Most masks in all rows of one condition together.
pub const MASKS_MAX: usize = 2048;

/// A condition over the serialized state.
#[derive(Debug, Clone, PartialEq)]
pub enum Formula {
    /// Holds always or never.
    Constant(bool),
    /// One comparison.
    Mask(Mask),
    /// Negation.
    Not(Box<Formula>),
    /// All hold.
    And(Vec<Formula>),
    /// At least one holds.
    Or(Vec<Formula>),
    /// Exactly one of both holds.
    Exclusive(Box<Formula>, Box<Formula>),
}

type Rows = Vec<Vec<Mask>>;

/// Rows of a formula, and of its negation, as far as they were asked for.
#[derive(Default)]
struct Expanded {
    holds: Option<Rows>,
    fails: Option<Rows>,
}

/// Which of both are asked for.
#[derive(Clone, Copy)]
struct Wanted {
    holds: bool,
    fails: bool,
}

/// The normal form would be larger than [`ROWS_MAX`] rows or [`MASKS_MAX`] masks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooLarge;

impl Formula {
    /// The rows of the disjunctive normal form, without those that can never hold and those that another one covers.
    /// No rows: the condition never holds; an empty row: it always does.
    ///
    /// # Errors
    /// [`TooLarge`] beyond the limits.
    pub fn rows(&self) -> Result<Vec<Vec<Mask>>, TooLarge> {
        let wanted = Wanted {
            holds: true,
            fails: false,
        };
        // A condition of one comparison has been through neither a product nor a union.
        simplified(self.expand(wanted)?.holds.unwrap_or_default())
    }

    /// Each part is expanded once, however deep it lies, and only what is asked for: a negation may be far larger.
    fn expand(&self, wanted: Wanted) -> Result<Expanded, TooLarge> {
        let both = Wanted {
            holds: true,
            fails: true,
        };
        let when =
            |wanted: bool, rows: &dyn Fn() -> Result<Rows, TooLarge>| wanted.then(rows).transpose();
        match self {
            Formula::Constant(value) => {
                let always = |yes: bool| if yes { vec![Vec::new()] } else { Vec::new() };
                Ok(Expanded {
                    holds: wanted.holds.then(|| always(*value)),
                    fails: wanted.fails.then(|| always(!*value)),
                })
            }
            Formula::Mask(mask) => Ok(Expanded {
                holds: wanted.holds.then(|| vec![vec![*mask]]),
                fails: wanted.fails.then(|| negate(mask)),
            }),
            Formula::Not(inner) => {
                let Expanded { holds, fails } = inner.expand(Wanted {
                    holds: wanted.fails,
                    fails: wanted.holds,
                })?;
                Ok(Expanded {
                    holds: fails,
                    fails: holds,
                })
            }
            Formula::And(parts) => {
                let (holds, fails) = expand_all(parts, wanted)?;
                Ok(Expanded {
                    holds: when(wanted.holds, &|| product(&holds))?,
                    fails: when(wanted.fails, &|| union(&fails))?,
                })
            }
            Formula::Or(parts) => {
                let (holds, fails) = expand_all(parts, wanted)?;
                Ok(Expanded {
                    holds: when(wanted.holds, &|| union(&holds))?,
                    fails: when(wanted.fails, &|| product(&fails))?,
                })
            }
            Formula::Exclusive(a, b) => {
                let (a, b) = (a.expand(both)?, b.expand(both)?);
                let (a, not_a) = (a.holds.unwrap_or_default(), a.fails.unwrap_or_default());
                let (b, not_b) = (b.holds.unwrap_or_default(), b.fails.unwrap_or_default());
                let either = |x: &Rows, y: &Rows, u: &Rows, v: &Rows| {
                    union(&[
                        product(&[x.clone(), y.clone()])?,
                        product(&[u.clone(), v.clone()])?,
                    ])
                };
                Ok(Expanded {
                    holds: when(wanted.holds, &|| either(&a, &not_b, &not_a, &b))?,
                    fails: when(wanted.fails, &|| either(&a, &b, &not_a, &not_b))?,
                })
            }
        }
    }
}

fn expand_all(parts: &[Formula], wanted: Wanted) -> Result<(Vec<Rows>, Vec<Rows>), TooLarge> {
    let (mut holds, mut fails) = (Vec::new(), Vec::new());
    for part in parts {
        let expanded = part.expand(wanted)?;
        holds.extend(expanded.holds);
        fails.extend(expanded.fails);
    }
    Ok((holds, fails))
}

fn union(parts: &[Rows]) -> Result<Rows, TooLarge> {
    let mut rows = Vec::new();
    for part in parts {
        rows.extend(part.iter().cloned());
        rows = simplified(rows)?;
    }
    Ok(rows)
}

fn product(parts: &[Rows]) -> Result<Rows, TooLarge> {
    let mut rows = vec![Vec::new()];
    for factor in parts {
        let mut next = Vec::with_capacity(rows.len() * factor.len());
        for row in &rows {
            for more in factor {
                let mut joined: Vec<Mask> = row.clone();
                for mask in more {
                    if !joined.contains(mask) {
                        joined.push(*mask);
                    }
                }
                next.push(joined);
            }
        }
        rows = simplified(next)?;
    }
    Ok(rows)
}

/// Drops rows that can never hold and rows that another one covers; keeps the order.
fn simplified(rows: Vec<Vec<Mask>>) -> Result<Vec<Vec<Mask>>, TooLarge> {
    let mut kept: Vec<Vec<Mask>> = Vec::new();
    for row in rows {
        if satisfiable(&row) == Satisfiable::No || kept.iter().any(|k| covers(k, &row)) {
            continue;
        }
        kept.retain(|k| !covers(&row, k));
        kept.push(row);
        if kept.len() > 2 * ROWS_MAX {
            return Err(TooLarge); // what is still to come hardly covers that many
        }
    }
    let masks: usize = kept.iter().map(Vec::len).sum();
    if kept.len() > ROWS_MAX || masks > MASKS_MAX {
        return Err(TooLarge);
    }
    Ok(kept)
}

/// Whether `wide` holds wherever `narrow` does, as its masks are among those of `narrow`.
fn covers(wide: &[Mask], narrow: &[Mask]) -> bool {
    wide.iter().all(|m| narrow.contains(m))
}

/// Rows that hold where the mask does not. A NaN makes every order comparison false, so that its opposite has to ask for NaN too.
fn negate(mask: &Mask) -> Vec<Vec<Mask>> {
    let (operator, is_order) = match mask.operator {
        MaskOperator::Equal => (MaskOperator::NotEqual, false),
        MaskOperator::NotEqual => (MaskOperator::Equal, false),
        MaskOperator::Less => (MaskOperator::GreaterOrEqual, true),
        MaskOperator::LessOrEqual => (MaskOperator::Greater, true),
        MaskOperator::Greater => (MaskOperator::LessOrEqual, true),
        MaskOperator::GreaterOrEqual => (MaskOperator::Less, true),
    };
    let mut rows = vec![vec![Mask { operator, ..*mask }]];
    if is_order {
        let mut reals = vec![mask.left];
        if let MaskOperand::Variable(right) = mask.right
            && right != mask.left
        {
            reals.push(right);
        }
        for variable in reals {
            if matches!(variable.of, MaskType::Real(_)) {
                rows.push(vec![is_nan(variable)]);
            }
        }
        if matches!(mask.right, MaskOperand::RealBits(bits) if f64::from_bits(bits).is_nan()) {
            rows.push(Vec::new());
        }
    }
    rows
}

/// Only a NaN differs from itself.
fn is_nan(variable: MaskVariable) -> Mask {
    Mask {
        left: variable,
        bits: u64::MAX,
        operator: MaskOperator::NotEqual,
        right: MaskOperand::Variable(variable),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bit(offset: u32) -> Formula {
        Formula::Mask(Mask {
            left: MaskVariable {
                offset,
                of: MaskType::Unsigned(1),
            },
            bits: u64::MAX,
            operator: MaskOperator::NotEqual,
            right: MaskOperand::Integer(0),
        })
    }

    fn exclusive(a: Formula, b: Formula) -> Formula {
        Formula::Exclusive(Box::new(a), Box::new(b))
    }

    fn not(f: Formula) -> Formula {
        Formula::Not(Box::new(f))
    }

    #[test]
    fn rows_are_as_few_as_can_be_seen() {
        let count = |f: &Formula| f.rows().map(|rows| rows.len());
        assert_eq!(
            count(&Formula::Or(vec![
                bit(0),
                Formula::And(vec![bit(0), bit(1)])
            ])),
            Ok(1)
        );
        assert_eq!(count(&Formula::And(vec![bit(0), not(bit(0))])), Ok(0));
        assert_eq!(
            count(&Formula::Or(vec![bit(0), Formula::Constant(true)])),
            Ok(1)
        );
        assert_eq!(count(&exclusive(bit(0), bit(1))), Ok(2));
    }

    #[test]
    fn one_comparison_that_never_holds_has_no_rows() {
        let never = |operator, right| {
            Formula::Mask(Mask {
                left: MaskVariable {
                    offset: 0,
                    of: MaskType::Signed(2),
                },
                bits: u64::MAX,
                operator,
                right,
            })
        };
        let itself = MaskOperand::Variable(MaskVariable {
            offset: 0,
            of: MaskType::Signed(2),
        });
        for formula in [
            never(MaskOperator::Equal, MaskOperand::Integer(100_000)),
            never(MaskOperator::Less, MaskOperand::Integer(-32_768)),
            never(MaskOperator::Less, itself),
            not(never(
                MaskOperator::LessOrEqual,
                MaskOperand::Integer(32_767),
            )),
        ] {
            assert_eq!(formula.rows(), Ok(Vec::new()), "{formula:?}");
        }
    }

    #[test]
    fn a_condition_that_grows_too_large_is_refused() {
        // Pairs of alternatives: 2 ** 9 rows.
        let pairs = (0..9).map(|n| Formula::Or(vec![bit(2 * n), bit(2 * n + 1)]));
        assert_eq!(Formula::And(pairs.collect()).rows(), Err(TooLarge));
        // Few rows with many masks each.
        let long = |k: u32| Formula::And((0..9).map(|n| bit(n * 200 + k)).collect());
        let of = |rows: u32| Formula::Or((0..rows).map(long).collect()).rows();
        assert_eq!(of(200).map(|rows| rows.len()), Ok(200));
        assert_eq!(of(240), Err(TooLarge));
        // An exclusive-or doubles with each part.
        let parity = (1..40).map(bit).fold(bit(0), exclusive);
        assert_eq!(parity.rows(), Err(TooLarge));
        // Depth alone costs nothing.
        let toggled = (0..500).fold(bit(0), |f, _| {
            exclusive(
                Formula::And(vec![f, Formula::Constant(true)]),
                Formula::Constant(true),
            )
        });
        assert_eq!(toggled.rows(), bit(0).rows());
    }
}
