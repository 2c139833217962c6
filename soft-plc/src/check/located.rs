//! Located arrays (IEC 61131-3, clause 6.5.5, "array location"): those whose elements lie closer in the process image than in
//! memory are used element by element, and assigned so.

use crate::check::Checker;
use crate::check::expr::constant;
use crate::check::tree::{Expr, ExprKind, Place, Root, Step, StepKind, Stmt, StmtKind};
use crate::diag::Problem;
use crate::types::{Elem, TypeId, TypeKind};
use crate::value::Value;

/// How many elements one assignment copies.
const ELEMENTS_MAX: i64 = 4096;

impl Checker<'_> {
    /// Whether the place is such an array as a whole.
    fn is_image(&self, place: &Place) -> bool {
        match place.root {
            Root::Var(id) if place.steps.is_empty() => {
                self.var(id).image_elem(&self.types).is_some()
            }
            _ => false,
        }
    }

    /// Reports an array of the process image where only one in memory will do.
    pub(super) fn usable_whole(&mut self, place: &Place) -> bool {
        if self.current.all_elements || !self.is_image(place) {
            return true;
        }
        let text = self.project.sources.slice(place.span).to_owned();
        self.report(
            Problem::error(
                "E324",
                place.span,
                format!("`{text}` lies in the process image and cannot be passed as a whole"),
            )
            .expected("one of its elements")
            .hint("assign it to an array of the same type, and pass that"),
        );
        false
    }

    /// `a := b` where one of both is such an array: an assignment for each element. `None` if it is none; `Some(None)`
    /// after a mistake.
    pub(super) fn by_elements(&mut self, to: &Place, from: &Expr) -> Option<Option<StmtKind>> {
        let source = match &from.kind {
            ExprKind::Load(place) => Some(&**place),
            _ => None,
        };
        if !self.is_image(to) && !source.is_some_and(|place| self.is_image(place)) {
            return None;
        }
        let TypeKind::Array { dims, elem } = self.types.kind(to.ty).clone() else {
            return None;
        };
        let counts = dims.iter().map(|(l, h)| h - l + 1);
        let count = counts.fold(1, i64::saturating_mul);
        let Some(source) = source.filter(|_| count <= ELEMENTS_MAX) else {
            let message = "this cannot be copied to or from the process image at once";
            self.report(
                Problem::error("E324", from.span, message)
                    .expected(format!("a variable of at most {ELEMENTS_MAX} elements"))
                    .hint("copy the elements in a FOR loop"),
            );
            return Some(None);
        };
        let assign = |number: i64| {
            let mut rest = number;
            let mut indices = Vec::new();
            for (low, high) in dims.iter().rev() {
                let index = low + rest % (high - low + 1);
                rest /= high - low + 1;
                let ty = TypeId::of(Elem::Lint);
                indices.insert(0, constant(Value::Int(index), ty, to.span));
            }
            let element = |place: &Place| {
                let mut place = place.clone();
                place.steps.push(Step {
                    kind: StepKind::Index(indices.clone()),
                    ty: elem,
                });
                place.ty = elem;
                place
            };
            let value = Expr {
                kind: ExprKind::Load(Box::new(element(source))),
                ty: elem,
                span: from.span,
            };
            Stmt {
                kind: StmtKind::Assign(element(to), value),
                span: to.span,
            }
        };
        Some(Some(StmtKind::Block((0..count).map(assign).collect())))
    }
}
