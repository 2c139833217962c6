//! POINTER TO of CODESYS: an address that is reckoned with in bytes, becomes a number and back, and leads to whatever lies there.
//!
//! Most values lie in memory byte by byte as they do in CODESYS, so that any pointer may become any other. Those that do not
//! (16 bits, which take a cell of 4 bytes here; times and dates, which are 64 bits here) are reached as what they are only.

use crate::check::Checker;
use crate::check::expr::{constant, error_expr};
use crate::check::tree::{Expr, ExprKind, Place, Root, Step, StepKind, VarId};
use crate::diag::Problem;
use crate::memory::round_up;
use crate::source::Span;
use crate::syntax::ast::{self, BinOp, PouKind, VarSection};
use crate::types::{Elem, TypeId, TypeKind};
use crate::value::Value;

/// How the bytes of a type lie, compared with CODESYS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shape {
    /// As there.
    Same,
    /// In another order or with other gaps: to be copied and cleared, not to be read byte by byte.
    Spread,
    /// Numbers that are wider here: only pointers to the same ones lead to them.
    Wider(Elem),
    /// 16-bit characters.
    WideText,
    Block,
}

impl Checker<'_> {
    /// `ADR(x)`.
    pub(super) fn pointer_to(&mut self, place: Place, span: Span) -> Expr {
        let direct = !place
            .steps
            .iter()
            .any(|s| matches!(s.kind, StepKind::Deref));
        let mut problem = match place.root {
            Root::Direct(_) => Some("it lies in the process image"),
            Root::Var(id) if direct => {
                let var = self.var(id);
                if var.location.is_some() {
                    Some("it lies in the process image")
                } else if var.constant && !self.types.is_aggregate(var.ty) {
                    Some("it is a constant without a place in memory")
                } else {
                    None
                }
            }
            _ => None,
        };
        let last = place.steps.last().map(|s| &s.kind);
        match last {
            Some(StepKind::Bit(_) | StepKind::Part(..) | StepKind::Char(_)) => {
                problem = Some("it is only a part of a variable");
            }
            Some(StepKind::Index(_) | StepKind::Deref | StepKind::Element(_)) => {}
            _ if self.types.elem(place.ty) == Some(Elem::Sint) => {
                problem = Some("a SINT alone takes 4 bytes here, and CODESYS's pointers see one");
            }
            _ => {}
        }
        if let Some(why) = problem {
            let text = self.sources.slice(place.span).to_owned();
            let message = format!("there is no pointer to `{text}`: {why}");
            let hint = match last {
                Some(StepKind::Char(_)) => "take the address of the string and add to it",
                _ => "point to a variable of its own, or to an element of an array",
            };
            self.report(Problem::error("E319", span, message).hint(hint));
            return error_expr(span);
        }
        let ty = self.types.pointer(place.ty);
        Expr {
            kind: ExprKind::AddressOf(Box::new(place)),
            ty,
            span,
        }
    }

    /// `pt[i]`: the value number i from where the pointer leads, counted from 0.
    pub(super) fn element(
        &mut self,
        place: Place,
        indices: &[ast::Expr],
        span: Span,
    ) -> Option<Place> {
        let [index] = indices else {
            self.report(Problem::error("E314", span, "a pointer has one index"));
            return None;
        };
        let typed = self.expr(index, None);
        if typed.ty == TypeId::ERROR {
            return None;
        }
        let typed = self.settle(typed);
        let typed = self.as_whole_number(typed);
        let usable = self.types.elem(typed.ty).is_some_and(Elem::is_int);
        if !usable || self.types.is_enum(typed.ty) {
            let message = format!("{} cannot be an index", self.type_name(typed.ty));
            self.report(Problem::error("E315", index.span, message).expected("an integer"));
            return None;
        }
        let number = self.convert(typed, Elem::Lint, index.span);
        let mut place = self.deref(place, span)?;
        if self.types.text(place.ty).is_some() {
            let message = "what a pointer to a string counts is not said: strings or characters";
            let hint = "use a POINTER TO BYTE for the characters: `pt := ADR(s); c := pt[i];`";
            self.report(Problem::error("E314", span, message).hint(hint));
            return None;
        }
        let ty = place.ty;
        place.steps.push(Step {
            kind: StepKind::Element(Box::new(number)),
            ty,
        });
        Some(place)
    }

    /// The address as an unsigned number.
    fn address_number(&mut self, expr: Expr) -> Expr {
        let ty = TypeId::of(Elem::Dword);
        match &expr.kind {
            ExprKind::Const(value) => {
                let value = Value::from_i128(Elem::Dword, value.as_i128().unwrap_or(0));
                constant(value, ty, expr.span)
            }
            _ => Expr { ty, ..expr },
        }
    }

    /// A whole number of whatever width as 32 bits; `None` if it is none.
    fn as_bytes(&mut self, expr: Expr) -> Option<Expr> {
        let elem = self.types.elem(expr.ty);
        let literal = expr.ty == TypeId::UNTYPED_INT;
        let whole = elem.is_some_and(|e| e.is_int() || (e.is_bit() && e != Elem::Bool));
        if (!literal && !whole) || self.types.is_enum(expr.ty) {
            return None;
        }
        let span = expr.span;
        if let ExprKind::Const(value) = &expr.kind {
            let low = value.as_i128()? & i128::from(u32::MAX);
            let value = Value::from_i128(Elem::Udint, low);
            return Some(constant(value, TypeId::of(Elem::Udint), span));
        }
        let elem = elem?;
        let seen = Expr {
            ty: TypeId::of(elem),
            ..expr
        };
        let wide = if elem.is_signed() && elem.bits() < 32 {
            self.convert(seen, Elem::Dint, span)
        } else {
            seen
        };
        Some(self.convert(wide, Elem::Udint, span))
    }

    /// Operators with a pointer on one side at least.
    pub(super) fn pointer_operator(
        &mut self,
        op: BinOp,
        left: Expr,
        right: Expr,
        span: Span,
    ) -> Expr {
        let pointer = |c: &Self, e: &Expr| c.types.is_pointer(e.ty);
        let (l, r) = (pointer(self, &left), pointer(self, &right));
        let moved = match op {
            BinOp::Add if l != r => true,
            BinOp::Sub => l && !r,
            _ => false,
        };
        if moved {
            let (base, by) = if l { (&left, &right) } else { (&right, &left) };
            let ty = base.ty;
            if let Some(elem) = self.counts_otherwise(ty) {
                let message = format!(
                    "pointers to {elem} cannot be reckoned with: {elem} takes {} bytes here, and {} in CODESYS",
                    elem.cell_bytes(),
                    elem.image_bytes()
                );
                self.report(Problem::error("E305", span, message).hint(
                    "`pt[i]` is the i-th value from where the pointer leads, whatever its size",
                ));
                return error_expr(span);
            }
            let Some(by) = self.as_bytes(by.clone()) else {
                return self.operator_mismatch(op, &left, &right, span);
            };
            return Expr {
                kind: ExprKind::Binary(op, Elem::Ref, Box::new(base.clone()), Box::new(by)),
                ty,
                span,
            };
        }
        let known =
            |c: &Self, e: &Expr| e.ty == TypeId::NULL || pointer(c, e) || !c.types.is_ref(e.ty);
        if !known(self, &left) || !known(self, &right) || (op == BinOp::Add && l && r) {
            return self.operator_mismatch(op, &left, &right, span);
        }
        let mut number = |e: Expr| {
            if self.types.is_ref(e.ty) {
                self.address_number(e)
            } else {
                e
            }
        };
        let (a, b) = (number(left), number(right));
        self.binary(op, a, b, span)
    }

    /// The numbers that a pointer of this type leads to, if they have another size in CODESYS.
    fn counts_otherwise(&self, pointer: TypeId) -> Option<Elem> {
        match self.shape(self.types.pointee(pointer)?) {
            Shape::Wider(elem) if elem.bits() == 16 => Some(elem),
            _ => None,
        }
    }

    fn shape(&self, ty: TypeId) -> Shape {
        match self.types.kind(ty) {
            TypeKind::Array { elem, .. } => match self.types.kind(*elem) {
                TypeKind::Str { wide: false, .. } => Shape::Spread,
                _ => self.shape(*elem),
            },
            TypeKind::Struct { fields } => {
                let same = fields.iter().all(|f| {
                    let narrow = self.types.elem(f.ty).is_some_and(|e| e.bits() <= 16);
                    !narrow && self.types.text(f.ty).is_none() && self.shape(f.ty) == Shape::Same
                });
                if same { Shape::Same } else { Shape::Spread }
            }
            TypeKind::FunctionBlock(_) => Shape::Block,
            TypeKind::Str { wide: true, .. } => Shape::WideText,
            _ => match self.types.elem(ty) {
                Some(elem) if elem.bits() == 16 || elem.is_time() => Shape::Wider(elem),
                _ => Shape::Same,
            },
        }
    }

    /// What the type consists of, arrays seen through.
    fn item(&self, ty: TypeId) -> TypeId {
        match self.types.kind(ty) {
            TypeKind::Array { elem, .. } => self.item(*elem),
            _ => ty,
        }
    }

    /// Any value as a pointer of this type: another pointer, a number, NULL.
    pub(super) fn as_pointer(&mut self, expr: Expr, ty: TypeId) -> Expr {
        let Some(to) = self.types.pointee(ty) else {
            return error_expr(expr.span);
        };
        let span = expr.span;
        let from = match self.types.kind(expr.ty) {
            _ if expr.ty == TypeId::NULL => return Expr { ty, ..expr },
            TypeKind::Pointer(from) => *from,
            TypeKind::Ref(from) => {
                if self.types.same(*from, to) && self.types.text(to).is_none() {
                    return Expr { ty, ..expr };
                }
                let (have, want) = (self.type_name(expr.ty), self.type_name(ty));
                let message = format!("{have} cannot become {want} here");
                let problem = Problem::error("E302", span, message);
                self.report(problem.hint("ADR(...) gives a pointer"));
                return error_expr(span);
            }
            _ => {
                return match self.as_bytes(expr.clone()) {
                    Some(Expr {
                        kind: ExprKind::Const(value),
                        ..
                    }) => {
                        let at = value.as_i128().unwrap_or(0);
                        constant(Value::Ref(at as u32), ty, span)
                    }
                    Some(number) => Expr { ty, ..number },
                    None => {
                        self.mismatch(&expr, ty);
                        error_expr(span)
                    }
                };
            }
        };
        let (a, b) = (self.item(from), self.item(to));
        if self.types.same(a, b) || self.derives(from, to) {
            return Expr { ty, ..expr };
        }
        match (self.shape(from), self.shape(to)) {
            (Shape::Same, Shape::Same) => {}
            (Shape::Wider(a), Shape::Wider(b)) if alike(a, b) => {}
            (Shape::Same | Shape::Spread, Shape::Same | Shape::Spread) => {
                let odd = if self.shape(from) == Shape::Spread {
                    from
                } else {
                    to
                };
                let message = format!(
                    "the bytes of {} lie otherwise than in CODESYS: values of less than 4 bytes take 4, a string has its length before it",
                    self.type_name(odd)
                );
                self.report(Problem::warning("W713", span, message).hint(
                    "copying and clearing as many bytes as SIZEOF says is right; single bytes are others",
                ));
            }
            (a, b) => {
                let (have, want) = (self.type_name(expr.ty), self.type_name(ty));
                let message = format!("{have} cannot become {want} here");
                let why = [a, b].into_iter().find_map(|s| match s {
                    Shape::Wider(e) => Some(format!(
                        "{e} takes {} bytes here, and other bytes than in CODESYS: use a pointer to {e}, or convert the value",
                        e.cell_bytes()
                    )),
                    Shape::WideText => Some("characters of a WSTRING take two bytes".to_owned()),
                    _ => None,
                });
                let hint = why.unwrap_or_else(|| {
                    "a function block is reached through a pointer to it or to its base".to_owned()
                });
                self.report(Problem::error("E302", span, message).hint(hint));
                return error_expr(span);
            }
        }
        Expr { ty, ..expr }
    }

    /// A pointer where a number is expected.
    pub(super) fn pointer_as_number(&mut self, expr: Expr, ty: TypeId) -> Expr {
        let number = self
            .types
            .elem(ty)
            .is_some_and(|e| e.is_int() || (e.is_bit() && e != Elem::Bool));
        if !number || self.types.is_enum(ty) {
            let (have, want) = (self.type_name(expr.ty), self.type_name(ty));
            let message = format!("{have} cannot become {want} here");
            let problem = Problem::error("E302", expr.span, message);
            self.report(problem.hint("`^` behind the pointer is what it leads to"));
            return error_expr(expr.span);
        }
        let number = self.address_number(expr);
        self.coerce(number, ty)
    }

    /// Bytes in memory of what is laid out otherwise than in CODESYS: SIZEOF and pointers must agree.
    pub(super) fn laid_out(&self, ty: TypeId) -> Option<u64> {
        let item = self.item(ty);
        let aggregate = matches!(self.types.kind(item), TypeKind::Struct { .. })
            || (item != ty && self.types.text(item).is_some());
        if !self.is_liberal() || !aggregate {
            return None;
        }
        self.bytes_in_memory(ty).map(|(size, _)| size)
    }

    /// Size and alignment, as `memory::Sizes` has them in a project with pointers.
    fn bytes_in_memory(&self, ty: TypeId) -> Option<(u64, u64)> {
        Some(match self.types.kind(ty) {
            TypeKind::Array { dims, elem } => {
                let (size, align) = self.bytes_in_memory(*elem)?;
                let packed = self
                    .types
                    .elem(*elem)
                    .is_some_and(Elem::is_packed_in_arrays);
                let stride = if packed { 1 } else { round_up(size, align) };
                let counts = dims.iter().map(|(l, h)| (h - l + 1) as u64);
                let count = counts.fold(1, u64::saturating_mul);
                (round_up(count.saturating_mul(stride), align), align)
            }
            TypeKind::Struct { fields } => {
                let (mut end, mut align) = (0, 4);
                for field in fields {
                    let (size, a) = self.bytes_in_memory(field.ty)?;
                    end = round_up(end, a).saturating_add(size);
                    align = align.max(a);
                }
                (round_up(end, align), align)
            }
            TypeKind::Str { wide, len } => {
                let bytes = (u64::from(*len) + 1) * if *wide { 2 } else { 1 };
                (4 + round_up(bytes, 4), 4)
            }
            _ => {
                let bytes = u64::from(self.types.elem(ty)?.cell_bytes());
                (bytes, bytes)
            }
        })
    }

    /// A pointer to what exists during a call only, stored where it is seen after the call.
    pub(super) fn warn_of_temporary(&mut self, holder: VarId, value: &Expr) {
        if self.lives_in_call(holder) || self.var(holder).section == VarSection::InOut {
            return;
        }
        if let Some((temporary, span)) = self.temporary_in(value) {
            let message = format!(
                "`{}` outlives this call, and `{}`, which it will point to, does not",
                self.var(holder).name,
                self.var(temporary).name
            );
            self.report(Problem::warning("W714", span, message).hint(
                "keep the pointer in a variable of the call, or point to a variable in VAR of a program or function block",
            ));
        }
    }

    /// The variable of a call whose address the value is.
    fn temporary_in(&self, value: &Expr) -> Option<(VarId, Span)> {
        match &value.kind {
            ExprKind::AddressOf(place) => {
                let Root::Var(id) = place.root else {
                    return None;
                };
                let through = place
                    .steps
                    .iter()
                    .any(|s| matches!(s.kind, StepKind::Deref));
                let own = self.var(id).section != VarSection::InOut && self.lives_in_call(id);
                (own && !through).then_some((id, value.span))
            }
            ExprKind::Binary(_, Elem::Ref, left, _) => self.temporary_in(left),
            ExprKind::Convert(inner) => self.temporary_in(inner),
            _ => None,
        }
    }

    fn lives_in_call(&self, id: VarId) -> bool {
        let var = self.var(id);
        var.section == VarSection::Temp
            || var
                .owner
                .is_some_and(|o| matches!(self.pou(o).kind, PouKind::Function | PouKind::Method))
    }
}

/// Whether cells of both hold numbers in the same way.
fn alike(a: Elem, b: Elem) -> bool {
    a == b
        || (a.bits() == 16
            && b.bits() == 16
            && a.is_signed() == b.is_signed()
            && !a.is_char()
            && !b.is_char())
}
