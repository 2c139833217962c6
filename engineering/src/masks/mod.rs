//! From a critical interval's condition to masks over the serialized state.
//!
//! The condition is checked by the compiler in the scope of the MC's program; here its typed tree becomes a formula over
//! comparisons of state variables, and that its disjunctive normal form. Whatever the masks cannot say exactly as the
//! compiled program would compute it is refused.

pub mod dnf;
pub mod satisfy;

use dnf::{Formula, MASKS_MAX, ROWS_MAX};
use fam_proto::diagnosis::{Mask, MaskOperand, MaskOperator, MaskType, MaskVariable};
use fam_soft_plc::check::tree::{Expr, ExprKind, Place, Root, StepKind, TypedProject};
use fam_soft_plc::source::Span;
use fam_soft_plc::syntax::ast::{BinOp, UnOp};
use fam_soft_plc::types::Elem;
use fam_soft_plc::value::Value;

/// What a critical interval may ask for and set.
pub(crate) const IS_STATE: &str = "name a variable of the MC's program, of one of its function block instances, or a global one; \
     if the MC lists its `state`, it has to be in the list";

/// Why a condition gives no masks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MaskError {
    /// Where in the condition.
    pub span: Span,
    /// What is wrong.
    pub message: String,
    /// What to do.
    pub hint: String,
}

impl MaskError {
    fn new(span: Span, message: impl Into<String>, hint: impl Into<String>) -> MaskError {
        MaskError {
            span,
            message: message.into(),
            hint: hint.into(),
        }
    }
}

/// Says where a variable, given by its dotted path, lies in the serialized state; `None` if it is no state.
pub type Locate<'a> = &'a dyn Fn(&str) -> Option<(u32, Elem)>;

/// The rows of masks of a condition.
///
/// # Errors
/// [`MaskError`] for what masks cannot say.
pub fn masks(
    project: &TypedProject,
    condition: &Expr,
    locate: Locate<'_>,
) -> Result<Vec<Vec<Mask>>, MaskError> {
    let lowering = Lowering { project, locate };
    if project.types.elem(condition.ty) != Some(Elem::Bool) {
        return Err(MaskError::new(
            condition.span,
            "a condition is TRUE or FALSE, this is neither",
            "compare it with something, such as `step = 40`",
        ));
    }
    let formula = lowering.formula(condition)?;
    formula.rows().map_err(|dnf::TooLarge| {
        MaskError::new(
            condition.span,
            format!("the condition is too large: its disjunctive normal form has more than {ROWS_MAX} rows or {MASKS_MAX} comparisons"),
            "let the program compute it into a BOOL variable, and name that",
        )
    })
}

/// Type of a variable's mask.
#[must_use]
pub fn mask_type(elem: Elem) -> MaskType {
    #[allow(clippy::cast_possible_truncation)] // 1 to 8
    let bytes = elem.image_bytes() as u8;
    match elem {
        Elem::Real | Elem::Lreal => MaskType::Real(bytes),
        e if e.is_time() => MaskType::Signed(bytes),
        e if e.is_signed() => MaskType::Signed(bytes),
        _ => MaskType::Unsigned(bytes),
    }
}

struct Lowering<'a> {
    project: &'a TypedProject,
    locate: Locate<'a>,
}

/// One side of a comparison.
#[derive(Clone, Copy)]
enum Side {
    Variable(MaskVariable),
    Constant(Value),
}

impl Lowering<'_> {
    fn formula(&self, expr: &Expr) -> Result<Formula, MaskError> {
        match &expr.kind {
            ExprKind::Const(value) => Ok(Formula::Constant(value.as_bool().unwrap_or(false))),
            ExprKind::Load(place) => Ok(Formula::Mask(self.boolean(place)?)),
            ExprKind::Unary(UnOp::Not, inner) => Ok(Formula::Not(Box::new(self.formula(inner)?))),
            ExprKind::Binary(op, Elem::Bool, left, right) => {
                let (left, right) = (self.formula(left)?, self.formula(right)?);
                match op {
                    BinOp::And => Ok(Formula::And(vec![left, right])),
                    BinOp::Or => Ok(Formula::Or(vec![left, right])),
                    BinOp::Xor | BinOp::Ne => {
                        Ok(Formula::Exclusive(Box::new(left), Box::new(right)))
                    }
                    BinOp::Eq => Ok(Formula::Not(Box::new(Formula::Exclusive(
                        Box::new(left),
                        Box::new(right),
                    )))),
                    _ => Err(self.unsupported(expr)),
                }
            }
            ExprKind::Binary(op, _, left, right) if op.is_comparison() => {
                self.comparison(*op, left, right)
            }
            _ => Err(self.unsupported(expr)),
        }
    }

    fn unsupported(&self, expr: &Expr) -> MaskError {
        MaskError::new(
            expr.span,
            "masks cannot say this: a condition is made of comparisons of state variables with constants or with each other, AND, OR, XOR and NOT",
            "let the program compute it into a variable, and name that",
        )
    }

    /// A BOOL variable, or a bit of another one.
    fn boolean(&self, place: &Place) -> Result<Mask, MaskError> {
        let (variable, bits) = match place.steps.last().map(|s| &s.kind) {
            Some(StepKind::Bit(bit)) => {
                let mut whole = place.clone();
                whole.steps.pop();
                (self.variable(&whole)?, 1u64 << bit)
            }
            _ => (self.variable(place)?, u64::MAX),
        };
        Ok(Mask {
            left: variable,
            bits,
            operator: MaskOperator::NotEqual,
            right: MaskOperand::Integer(0),
        })
    }

    fn variable(&self, place: &Place) -> Result<MaskVariable, MaskError> {
        let path = self.project.path_of(place).ok_or_else(|| {
            MaskError::new(
                place.span,
                "the index is not constant, so that the place in the state is not known beforehand",
                "use a constant index, or let the program compute the condition into a BOOL variable",
            )
        })?;
        let is_image = match &place.root {
            Root::Direct(_) | Root::This => true,
            Root::Var(id) => self.project.var(*id).location.is_some(),
        };
        if let Some((offset, elem)) = (self.locate)(&path).filter(|_| !is_image) {
            return Ok(MaskVariable {
                offset,
                of: mask_type(elem),
            });
        }
        Err(MaskError::new(
            place.span,
            format!("`{path}` is not part of the state, so that a condition cannot ask for it"),
            if is_image {
                "inputs and outputs are process image: let the program keep what matters in a variable of its own"
            } else {
                IS_STATE
            },
        ))
    }

    /// Looks through conversions that lose nothing.
    fn side(&self, expr: &Expr) -> Result<Side, MaskError> {
        match &expr.kind {
            ExprKind::Const(value) => Ok(Side::Constant(*value)),
            ExprKind::Load(place)
                if !matches!(place.steps.last().map(|s| &s.kind), Some(StepKind::Bit(_))) =>
            {
                Ok(Side::Variable(self.variable(place)?))
            }
            ExprKind::Convert(inner) => {
                let elem = |e: &Expr| self.project.types.elem(e.ty);
                match (elem(inner), elem(expr)) {
                    (Some(from), Some(to)) if from.widens_to(to) && !is_bits(from, to) => {
                        self.side(inner)
                    }
                    (Some(from), Some(to))
                        if from.is_bit() && to.is_bit() && from.bits() <= to.bits() =>
                    {
                        self.side(inner)
                    }
                    _ => Err(self.unsupported(expr)),
                }
            }
            _ => Err(self.unsupported(expr)),
        }
    }

    fn comparison(&self, op: BinOp, left: &Expr, right: &Expr) -> Result<Formula, MaskError> {
        let operator = match op {
            BinOp::Eq => MaskOperator::Equal,
            BinOp::Ne => MaskOperator::NotEqual,
            BinOp::Lt => MaskOperator::Less,
            BinOp::Le => MaskOperator::LessOrEqual,
            BinOp::Gt => MaskOperator::Greater,
            _ => MaskOperator::GreaterOrEqual,
        };
        let mask = |left, operator, right| {
            Formula::Mask(Mask {
                left,
                bits: u64::MAX,
                operator,
                right,
            })
        };
        Ok(match (self.side(left)?, self.side(right)?) {
            (Side::Variable(l), Side::Variable(r)) => mask(l, operator, MaskOperand::Variable(r)),
            (Side::Variable(l), Side::Constant(c)) => mask(l, operator, operand(c)),
            (Side::Constant(c), Side::Variable(r)) => mask(r, mirrored(operator), operand(c)),
            (Side::Constant(a), Side::Constant(b)) => {
                let elem = match (a, b) {
                    (Value::Real(_) | Value::Lreal(_), _)
                    | (_, Value::Real(_) | Value::Lreal(_)) => Elem::Lreal,
                    _ => Elem::Lint,
                };
                let same = |v: Value| {
                    if elem == Elem::Lreal {
                        Value::Lreal(v.as_f64())
                    } else {
                        v
                    }
                };
                let value = fam_soft_plc::value::binary(op, elem, same(a), same(b));
                Formula::Constant(value.ok().and_then(Value::as_bool).unwrap_or(false))
            }
        })
    }
}

/// Between bit strings and reals a conversion transfers bits: no widening.
fn is_bits(from: Elem, to: Elem) -> bool {
    from.is_bit() != to.is_bit()
}

fn operand(value: Value) -> MaskOperand {
    match value.as_i128() {
        Some(integer) => MaskOperand::Integer(integer),
        None => MaskOperand::RealBits(value.as_f64().to_bits()),
    }
}

/// `c < x` is `x > c`.
fn mirrored(operator: MaskOperator) -> MaskOperator {
    match operator {
        MaskOperator::Less => MaskOperator::Greater,
        MaskOperator::LessOrEqual => MaskOperator::GreaterOrEqual,
        MaskOperator::Greater => MaskOperator::Less,
        MaskOperator::GreaterOrEqual => MaskOperator::LessOrEqual,
        same => same,
    }
}
