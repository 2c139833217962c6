//! Located arrays and structures (IEC 61131-3, clause 6.5.5): those whose parts lie closer in the process image than in memory
//! are used part by part, and assigned so. The places of fields in their structures (clause 6.4.4.6).

use crate::check::Checker;
use crate::check::address::parse_relative;
use crate::check::expr::constant;
use crate::check::tree::{Expr, ExprKind, Place, Root, Step, StepKind, Stmt, StmtKind};
use crate::diag::{Fallible, Problem};
use crate::image;
use crate::source::Span;
use crate::syntax::ast;
use crate::types::{Elem, TypeId, TypeKind};
use crate::value::Value;

/// How many elements and fields one assignment copies.
const SCALARS_MAX: u64 = 4096;

impl Checker<'_> {
    /// What of a located variable's type cannot lie in the process image, as the rest of a sentence.
    pub(super) fn no_part_of_the_image(&self, ty: TypeId) -> Option<String> {
        match self.types.kind(ty) {
            TypeKind::Array { elem, .. } if self.types.is_aggregate(*elem) => {
                self.no_part_of_the_image(*elem)
            }
            TypeKind::Struct { fields } => fields.iter().find_map(|field| {
                self.no_part_of_the_image(field.ty).map(|_| {
                    format!(
                        ": its field `{}` is {}",
                        field.name,
                        self.type_name(field.ty)
                    )
                })
            }),
            _ => image::extent(&self.types, ty).is_none().then(String::new),
        }
    }

    /// The place of a field in its structure.
    pub(super) fn relative(&mut self, at: &ast::Ident, ty: TypeId) -> Fallible<u64> {
        let first = parse_relative(&at.name, at.span)?;
        let needs_byte = match self.types.kind(ty) {
            TypeKind::Array { elem, .. } => self.types.elem(*elem) != Some(Elem::Bool),
            _ => self.types.elem(ty) != Some(Elem::Bool),
        };
        if first % 8 != 0 && needs_byte && ty != TypeId::ERROR {
            let message = format!("{} cannot begin at `{}`", self.type_name(ty), at.name);
            return Err(Box::new(
                Problem::error("E207", at.span, message).expected("a place that begins with %B"),
            ));
        }
        Ok(first)
    }

    /// Reports a variable of a structure with OVERLAP that lies in memory, where each field has a place of its own.
    pub(super) fn overlap_is_located(&mut self, decl: &ast::VarDecl, ty: TypeId) {
        if decl.location.is_none() && image::has_overlap(&self.types, ty) {
            let message = format!(
                "`{}` is a structure with OVERLAP and has no address",
                decl.name.name
            );
            self.report(
                Problem::error("E206", decl.name.span, message)
                    .expected("AT and an address in the process image, such as %MB0")
                    .hint("or use the parts of one variable: `w.%B0`, `w.%X3`"),
            );
        }
    }

    /// Whether the place is an array or structure, or a part of one, that lies closer in the process image than in memory.
    fn is_image(&self, place: &Place) -> bool {
        match place.root {
            Root::Var(id) => {
                self.types.is_aggregate(place.ty) && self.var(id).is_closer(&self.types)
            }
            _ => false,
        }
    }

    /// Reports an array or structure of the process image where only one in memory will do.
    pub(super) fn usable_whole(&mut self, place: &Place) -> bool {
        if self.current.assigned == Some(place.span) || !self.is_image(place) {
            return true;
        }
        let text = self.sources.slice(place.span).to_owned();
        self.report(
            Problem::error(
                "E324",
                place.span,
                format!("`{text}` lies in the process image and cannot be passed as a whole"),
            )
            .expected("one of its elements or fields")
            .hint("assign it to a variable of the same type, and pass that"),
        );
        false
    }

    /// `a := b` where one of both is such a variable: an assignment for each scalar. `None` if it is none; `Some(None)`
    /// after a mistake.
    pub(super) fn by_elements(&mut self, to: &Place, from: &Expr) -> Option<Option<StmtKind>> {
        let source = match &from.kind {
            ExprKind::Load(place) => Some(&**place),
            _ => None,
        };
        if !self.is_image(to) && !source.is_some_and(|place| self.is_image(place)) {
            return None;
        }
        let count = self.scalars(to.ty);
        let Some(source) = source.filter(|_| count <= SCALARS_MAX) else {
            let message = "this cannot be copied to or from the process image at once";
            self.report(
                Problem::error("E324", from.span, message)
                    .expected(format!(
                        "a variable of at most {SCALARS_MAX} elements and fields"
                    ))
                    .hint("copy the elements in a FOR loop"),
            );
            return Some(None);
        };
        let mut list = Vec::new();
        self.copy_scalars(to.clone(), source.clone(), from.span, &mut list);
        Some(Some(StmtKind::Block(list)))
    }

    /// How many scalars a value of the type has.
    fn scalars(&self, ty: TypeId) -> u64 {
        match self.types.kind(ty) {
            TypeKind::Array { dims, elem } => {
                let counts = dims.iter().map(|(l, h)| (h - l + 1) as u64);
                counts.fold(self.scalars(*elem), u64::saturating_mul)
            }
            TypeKind::Struct { fields } => fields
                .iter()
                .map(|f| self.scalars(f.ty))
                .fold(0, u64::saturating_add),
            _ => 1,
        }
    }

    fn copy_scalars(&self, to: Place, from: Place, value_span: Span, list: &mut Vec<Stmt>) {
        let mut part = |kind: StepKind, ty: TypeId| {
            let of = |whole: &Place| {
                let mut place = whole.clone();
                place.steps.push(Step {
                    kind: kind.clone(),
                    ty,
                });
                place.ty = ty;
                place
            };
            self.copy_scalars(of(&to), of(&from), value_span, list);
        };
        match self.types.kind(to.ty) {
            TypeKind::Array { dims, elem } => {
                let counts = dims.iter().map(|(l, h)| h - l + 1);
                for number in 0..counts.product::<i64>() {
                    let mut rest = number;
                    let mut indices = Vec::new();
                    for (low, high) in dims.iter().rev() {
                        let index = low + rest % (high - low + 1);
                        rest /= high - low + 1;
                        let ty = TypeId::of(Elem::Lint);
                        indices.insert(0, constant(Value::Int(index), ty, to.span));
                    }
                    part(StepKind::Index(indices), *elem);
                }
            }
            TypeKind::Struct { fields } => {
                for (index, field) in fields.iter().enumerate() {
                    part(StepKind::Field(index, to.ty), field.ty);
                }
            }
            _ => {
                let (ty, span) = (to.ty, to.span);
                let value = Expr {
                    kind: ExprKind::Load(Box::new(from)),
                    ty,
                    span: value_span,
                };
                list.push(Stmt {
                    kind: StmtKind::Assign(to, value),
                    span,
                });
            }
        }
    }
}
