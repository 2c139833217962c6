//! Places: variables and parts of them, with the rules of who may read and write what.

use crate::check::tree::{ExprKind, Place, PouId, Root, Step, StepKind, VarId};
use crate::check::types::closest;
use crate::check::{Checker, Declared, key};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{self, PouKind, VarSection};
use crate::types::{Elem, TypeId, TypeKind};

impl Checker<'_> {
    /// The variable that a name stands for here.
    pub(super) fn find_var(&mut self, name: &str) -> Option<VarId> {
        let name = key(name);
        if let Some(id) = self.current.names.get(&name) {
            return Some(*id);
        }
        match self.lookup(&name) {
            Some(Declared::Global(b, d)) => self.declare_global(b, d),
            _ => None,
        }
    }

    pub(super) fn find_declared_pou(&self, name: &str) -> Option<PouId> {
        match self.lookup(name) {
            Some(Declared::Pou(id)) => Some(id),
            _ => None,
        }
    }

    /// Whether the expression can only be a place, so that a failure to resolve it is an error.
    pub(super) fn place(&mut self, expr: &ast::Expr) -> Option<Place> {
        match &expr.kind {
            ast::ExprKind::Name(name) => {
                if let Some(id) = self.find_var(name) {
                    let ty = self.var(id).ty;
                    if ty == TypeId::INFERRED && !self.current.defining {
                        self.name(name, None, expr.span);
                        return None;
                    }
                    return (ty != TypeId::ERROR).then(|| Place {
                        root: Root::Var(id),
                        steps: Vec::new(),
                        ty,
                        span: expr.span,
                    });
                }
                if name.eq_ignore_ascii_case("THIS") {
                    return self.this(expr.span);
                }
                self.unknown_name(name, expr.span);
                None
            }
            ast::ExprKind::Deref(base) => {
                if let ast::ExprKind::Name(name) = &base.kind
                    && name.eq_ignore_ascii_case("THIS")
                    && self.find_var(name).is_none()
                {
                    return self.this(expr.span);
                }
                let place = self.place(base)?;
                self.deref(place, expr.span)
            }
            ast::ExprKind::Partial(base, size, number) => {
                let place = self.place(base)?;
                self.partial(place, *size, *number, expr.span)
            }
            ast::ExprKind::Direct(text) => {
                if let Some(id) = self.find_var(text) {
                    let ty = self.var(id).ty;
                    return (ty != TypeId::ERROR).then(|| Place {
                        root: Root::Var(id),
                        steps: Vec::new(),
                        ty,
                        span: expr.span,
                    });
                }
                let result = self.address(text, expr.span);
                let location = self.ok(result)?;
                let elem = match location.size {
                    'X' => Elem::Bool,
                    'B' => Elem::Byte,
                    'W' => Elem::Word,
                    'D' => Elem::Dword,
                    _ => Elem::Lword,
                };
                Some(Place {
                    root: Root::Direct(location),
                    steps: Vec::new(),
                    ty: TypeId::of(elem),
                    span: expr.span,
                })
            }
            ast::ExprKind::Field(base, field) => {
                if let Some(path) = self.with_path(base, field) {
                    let name = ast::Expr {
                        kind: ast::ExprKind::Name(path),
                        span: expr.span,
                    };
                    return self.place(&name);
                }
                if let ast::ExprKind::Name(name) = &base.kind
                    && self.find_var(name).is_none()
                    && matches!(key(name).as_str(), "THIS" | "SUPER")
                {
                    return self.own_variable(field, expr.span);
                }
                if let ast::ExprKind::Name(name) = &base.kind
                    && self.find_var(name).is_none()
                    && let Some(pou) = self.find_declared_pou(name)
                    && self.pou(pou).kind == PouKind::Program
                {
                    return self.program_variable(pou, field, expr.span);
                }
                if let ast::ExprKind::Deref(inner) = &base.kind
                    && let ast::ExprKind::Name(name) = &inner.kind
                    && self.find_var(name).is_none()
                    && matches!(key(name).as_str(), "THIS" | "SUPER")
                {
                    return self.own_variable(field, expr.span);
                }
                let place = self.place(base)?;
                self.field(place, field, expr.span)
            }
            ast::ExprKind::Index(base, indices) => {
                let place = self.place(base)?;
                self.index(place, indices, expr.span)
            }
            ast::ExprKind::Bit(base, bit) => {
                let mut place = self.place(base)?;
                let elem = self.types.elem(place.ty).filter(|e| {
                    (e.is_int() || e.is_bit()) && e.bits() >= 8 && !self.types.is_enum(place.ty)
                });
                let Some(elem) = elem else {
                    let message = format!("{} has no bits to pick from", self.type_name(place.ty));
                    self.report(
                        Problem::error("E310", expr.span, message)
                            .expected("a bit string or an integer"),
                    );
                    return None;
                };
                if *bit >= elem.bits() {
                    let message = format!("{elem} has no bit {bit}");
                    self.report(
                        Problem::error("E310", expr.span, message)
                            .expected(format!("a bit from 0 to {}", elem.bits() - 1)),
                    );
                    return None;
                }
                place.steps.push(Step {
                    kind: StepKind::Bit(*bit as u8),
                    ty: TypeId::BOOL,
                });
                place.ty = TypeId::BOOL;
                place.span = expr.span;
                Some(place)
            }
            ast::ExprKind::Call(..) => {
                self.report(
                    Problem::error("E311", expr.span, "the result of a call is no variable")
                        .hint("assign it to a variable first"),
                );
                None
            }
            _ => {
                self.report(
                    Problem::error("E311", expr.span, "this is no variable").expected("a variable"),
                );
                None
            }
        }
    }

    /// `MC1.timer`: a variable of a program, seen from elsewhere.
    fn program_variable(&mut self, pou: PouId, field: &ast::Ident, span: Span) -> Option<Place> {
        let var = self.member(pou, field)?;
        Some(Place {
            root: Root::Var(var),
            steps: Vec::new(),
            ty: self.var(var).ty,
            span,
        })
    }

    /// A variable of a function block or program that may be reached from outside.
    fn member(&mut self, pou: PouId, field: &ast::Ident) -> Option<VarId> {
        let found = self
            .pou(pou)
            .vars
            .iter()
            .copied()
            .find(|v| self.var(*v).name.eq_ignore_ascii_case(&field.name));
        let name = self.pou(pou).name.clone();
        let Some(id) = found else {
            let candidates: Vec<String> = self
                .pou(pou)
                .vars
                .iter()
                .map(|v| self.var(*v).name.clone())
                .collect();
            let mut problem = Problem::error(
                "E312",
                field.span,
                format!("{name} has no variable `{}`", field.name),
            );
            if let Some(close) = closest(&field.name, &candidates) {
                problem = problem.hint(format!("did you mean `{close}`?"));
            }
            self.report(problem);
            return None;
        };
        let own = self.sees_inside(self.var(id).owner);
        let given = match self.access.get(&id) {
            Some(ast::Access::Public) => true,
            Some(ast::Access::Internal) => self.same_space(&name, &self.current.space),
            _ => false,
        };
        match self.var(id).section {
            VarSection::Input | VarSection::Output => {}
            VarSection::Local if given => {}
            VarSection::Local if self.options.allow_internal_access || own => {}
            section => {
                let message = format!("`{}` is internal to {name} ({section})", field.name);
                self.report(
                    Problem::error("E313", field.span, message)
                        .expected("one of its inputs or outputs")
                        .hint("variables of VAR PUBLIC are for all"),
                );
                return None;
            }
        }
        (self.var(id).ty != TypeId::ERROR).then_some(id)
    }

    fn field(&mut self, mut place: Place, field: &ast::Ident, span: Span) -> Option<Place> {
        let (kind, ty) = match self.types.kind(place.ty) {
            TypeKind::Struct { fields } => {
                let found = fields
                    .iter()
                    .position(|f| f.name.eq_ignore_ascii_case(&field.name));
                let Some(index) = found else {
                    let candidates: Vec<String> = fields.iter().map(|f| f.name.clone()).collect();
                    let message =
                        format!("{} has no field `{}`", self.type_name(place.ty), field.name);
                    let mut problem = Problem::error("E312", field.span, message);
                    if let Some(close) = closest(&field.name, &candidates) {
                        problem = problem.hint(format!("did you mean `{close}`?"));
                    }
                    self.report(problem);
                    return None;
                };
                let ty = fields[index].ty;
                (StepKind::Field(index, self.types.get(place.ty).same_as), ty)
            }
            TypeKind::FunctionBlock(pou) => {
                let id = self.member(*pou, field)?;
                (StepKind::Member(id), self.var(id).ty)
            }
            _ => {
                let message = format!(
                    "`{}` is {} and has no fields",
                    self.sources.slice(place.span),
                    self.type_name(place.ty)
                );
                self.report(
                    Problem::error("E312", field.span, message)
                        .expected("a structure or a function block instance"),
                );
                return None;
            }
        };
        if ty == TypeId::ERROR {
            return None;
        }
        place.steps.push(Step { kind, ty });
        place.ty = ty;
        place.span = span;
        Some(place)
    }

    /// `THIS.x`, `THIS^.x`, `SUPER^.x`: a variable of the instance.
    fn own_variable(&mut self, field: &ast::Ident, span: Span) -> Option<Place> {
        let Some(pou) = self.current_block() else {
            self.unknown_name("THIS", span);
            return None;
        };
        let found = self
            .pou(pou)
            .vars
            .iter()
            .copied()
            .find(|v| self.var(*v).name.eq_ignore_ascii_case(&field.name));
        let Some(id) = found else {
            self.member(pou, field)?;
            return None;
        };
        if let Some(section) = self.section_out_of_reach(&field.name) {
            let message = format!(
                "`{}` is {section}, and exists while the body runs",
                field.name
            );
            let problem = Problem::error("E313", field.span, message);
            self.report(problem.hint("pass it to the method as a parameter"));
            return None;
        }
        let ty = self.var(id).ty;
        (ty != TypeId::ERROR).then(|| Place {
            root: Root::Var(id),
            steps: Vec::new(),
            ty,
            span,
        })
    }

    fn this(&mut self, span: Span) -> Option<Place> {
        let Some(pou) = self.current_block() else {
            self.report(Problem::error(
                "E321",
                span,
                "THIS exists in function blocks and their methods only",
            ));
            return None;
        };
        let ty = self.fb_types.get(&pou).copied()?;
        Some(Place {
            root: Root::This,
            steps: Vec::new(),
            ty,
            span,
        })
    }

    pub(super) fn deref(&mut self, mut place: Place, span: Span) -> Option<Place> {
        let Some(to) = self.types.pointee(place.ty) else {
            let message = format!(
                "`{}` is {} and no reference",
                self.sources.slice(place.span),
                self.type_name(place.ty)
            );
            self.report(Problem::error("E322", span, message).expected("a variable of REF_TO"));
            return None;
        };
        if to == TypeId::ERROR {
            return None;
        }
        place.steps.push(Step {
            kind: StepKind::Deref,
            ty: to,
        });
        place.ty = to;
        place.span = span;
        Some(place)
    }

    /// `w.%B1`
    fn partial(&mut self, mut place: Place, size: char, number: u32, span: Span) -> Option<Place> {
        let (bits, elem) = match size {
            'B' => (8, Elem::Byte),
            'W' => (16, Elem::Word),
            'D' => (32, Elem::Dword),
            _ => (64, Elem::Lword),
        };
        let whole = self
            .types
            .elem(place.ty)
            .filter(|e| (e.is_bit() || e.is_int()) && e.bits() > bits)
            .filter(|_| !self.types.is_enum(place.ty));
        let Some(whole) = whole else {
            let message = format!("{} has no part %{size}", self.type_name(place.ty));
            self.report(
                Problem::error("E310", span, message).expected("a wider bit string or integer"),
            );
            return None;
        };
        if number.saturating_mul(bits) >= whole.bits() {
            let message = format!("{whole} has no part %{size}{number}");
            self.report(
                Problem::error("E310", span, message)
                    .expected(format!("a part from 0 to {}", whole.bits() / bits - 1)),
            );
            return None;
        }
        place.steps.push(Step {
            kind: StepKind::Part((number * bits) as u8, bits as u8),
            ty: TypeId::of(elem),
        });
        place.ty = TypeId::of(elem);
        place.span = span;
        Some(place)
    }

    /// `s[2]`: a character of a string.
    fn character(&mut self, mut place: Place, indices: &[ast::Expr], span: Span) -> Option<Place> {
        let (wide, len) = self.types.text(place.ty)?;
        let [index] = indices else {
            self.report(Problem::error("E314", span, "a string has one index"));
            return None;
        };
        let typed = self.expr(index, None);
        if typed.ty == TypeId::ERROR {
            return None;
        }
        let typed = self.settle(typed);
        let typed = self.as_whole_number(typed);
        let usable = self
            .types
            .elem(typed.ty)
            .is_some_and(|e| e.is_int() && e.widens_to(Elem::Lint));
        if !usable || self.types.is_enum(typed.ty) {
            let message = format!("{} cannot be an index", self.type_name(typed.ty));
            self.report(Problem::error("E315", index.span, message).expected("an integer"));
            return None;
        }
        if let ExprKind::Const(value) = &typed.kind
            && let Some(v) = value.as_i128()
            && !(1..=i128::from(len)).contains(&v)
        {
            let message = format!("the index {v} is outside 1..{len}");
            self.report(Problem::error("E316", index.span, message));
            return None;
        }
        let typed = self.coerce(typed, TypeId::of(Elem::Lint));
        let ty = TypeId::of(if wide { Elem::Wchar } else { Elem::Char });
        place.steps.push(Step {
            kind: StepKind::Char(Box::new(typed)),
            ty,
        });
        place.ty = ty;
        place.span = span;
        Some(place)
    }

    fn index(&mut self, mut place: Place, indices: &[ast::Expr], span: Span) -> Option<Place> {
        if self.types.text(place.ty).is_some() {
            return self.character(place, indices, span);
        }
        if self.types.is_pointer(place.ty) {
            return self.element(place, indices, span);
        }
        let TypeKind::Array { dims, elem } = self.types.kind(place.ty).clone() else {
            let message = format!(
                "`{}` is {} and cannot be indexed",
                self.sources.slice(place.span),
                self.type_name(place.ty)
            );
            self.report(Problem::error("E314", span, message).expected("an array"));
            return None;
        };
        if dims.len() != indices.len() {
            let message = format!(
                "this array has {} dimension{}, and {} {} given",
                dims.len(),
                if dims.len() == 1 { "" } else { "s" },
                indices.len(),
                if indices.len() == 1 {
                    "index is"
                } else {
                    "indices are"
                },
            );
            self.report(Problem::error("E314", span, message));
            return None;
        }
        let mut list = Vec::new();
        for (index, (lo, hi)) in indices.iter().zip(&dims) {
            let typed = self.expr(index, None);
            if typed.ty == TypeId::ERROR {
                return None;
            }
            let typed = self.settle(typed);
            let typed = self.as_whole_number(typed);
            let usable = self
                .types
                .elem(typed.ty)
                .is_some_and(|e| e.widens_to(Elem::Lint) && e.is_int());
            if !usable || self.types.is_enum(typed.ty) {
                let message = format!("{} cannot be an index", self.type_name(typed.ty));
                let mut problem = Problem::error("E315", index.span, message)
                    .expected("an integer (SINT to LINT, USINT to UDINT)");
                if self.types.is_enum(typed.ty) {
                    problem = problem.hint("take its number: TO_INT(...)");
                }
                self.report(problem);
                return None;
            }
            if let ExprKind::Const(value) = &typed.kind
                && let Some(v) = value.as_i128()
                && (v < i128::from(*lo) || v > i128::from(*hi))
            {
                let message = format!("the index {v} is outside {lo}..{hi}");
                self.report(Problem::error("E316", index.span, message));
                return None;
            }
            list.push(typed);
        }
        place.steps.push(Step {
            kind: StepKind::Index(list),
            ty: elem,
        });
        place.ty = elem;
        place.span = span;
        Some(place)
    }

    pub(super) fn unknown_name(&mut self, name: &str, span: Span) {
        if let Some(pou) = self.find_declared_pou(name) {
            let kind = self.pou(pou).kind;
            let problem = Problem::error("E301", span, format!("{kind} `{name}` is no variable"));
            let hint = match kind {
                PouKind::FunctionBlock => {
                    "declare an instance of it: `my_instance : ".to_owned() + name + ";`"
                }
                PouKind::Function | PouKind::Method => format!("call it: `{name}(...)`"),
                PouKind::Program => format!("name one of its variables: `{name}.variable`"),
            };
            self.report(problem.hint(hint));
            return;
        }
        if let Some(section) = self.section_out_of_reach(name) {
            let message = format!(
                "`{name}` is {section} of the function block, and exists while its body runs"
            );
            let problem = Problem::error("E301", span, message);
            self.report(problem.hint("pass it to the method as a parameter"));
            return;
        }
        let mut candidates: Vec<String> = Vec::new();
        candidates.extend(
            self.current
                .names
                .values()
                .map(|v| self.var(*v).name.clone()),
        );
        for block in &self.project.globals {
            candidates.extend(block.decls.iter().map(|d| d.name.name.clone()));
        }
        candidates.extend(self.enum_values.keys().cloned());
        let mut problem = Problem::error("E301", span, format!("`{name}` is not declared"));
        if let Some(hint) = self.elsewhere(name) {
            problem = problem.hint(hint);
        } else if let Some(close) = closest(name, &candidates) {
            problem = problem.hint(format!("did you mean `{close}`?"));
        }
        self.report(problem);
    }

    /// The section of a variable that methods of its function block do not reach.
    fn section_out_of_reach(&self, name: &str) -> Option<VarSection> {
        let pou = self
            .current
            .pou
            .filter(|p| self.pou(*p).kind == PouKind::Method)?;
        let block = self.pou(self.pou(pou).instance_of?);
        let mut all = block.vars.iter().copied();
        let found = all.find(|v| self.var(*v).name.eq_ignore_ascii_case(name))?;
        self.lives_with_body(found).then(|| self.var(found).section)
    }

    /// Reports what must not be written. Answers whether writing is allowed.
    pub(super) fn writable(&mut self, place: &Place) -> bool {
        let span = place.span;
        let root = match &place.root {
            Root::Direct(location) => {
                if !location.output {
                    self.report(Problem::error(
                        "E317",
                        span,
                        format!("`{location}` is an input and cannot be written"),
                    ));
                    return false;
                }
                return true;
            }
            Root::This => {
                return true;
            }
            Root::Var(id) => *id,
        };
        if place
            .steps
            .iter()
            .any(|s| matches!(s.kind, StepKind::Deref))
        {
            return true;
        }
        if !self.usable_whole(place) {
            return false;
        }
        let var = self.var(root).clone();
        // A located string is written where it stands: by what reads it from the image.
        if var.open_input && place.span != var.span {
            let message = format!(
                "`{}` is located at an input and cannot be written",
                var.name
            );
            self.report(Problem::error("E317", span, message));
            return false;
        }
        if var.constant {
            self.report(Problem::error(
                "E317",
                span,
                format!("`{}` is CONSTANT and cannot be written", var.name),
            ));
            return false;
        }
        if let Some(location) = &var.location
            && !location.output
        {
            let message = format!(
                "`{}` is located at the input {location} and cannot be written",
                var.name
            );
            self.report(Problem::error("E317", span, message));
            return false;
        }
        if matches!(self.types.kind(place.ty), TypeKind::FunctionBlock(_)) {
            self.report(
                Problem::error("E317", span, "a function block instance cannot be assigned")
                    .hint("call it, or assign its inputs one by one"),
            );
            return false;
        }
        let mut holder = var.owner.map(|o| (o, root));
        let own = self.sees_inside(var.owner);
        for step in &place.steps {
            if let StepKind::Member(member) = step.kind {
                holder = self.var(member).owner.map(|o| (o, member));
            }
        }
        if let Some((pou, member)) = holder {
            let section = self.var(member).section;
            let constant = self.var(member).constant;
            let outside = member != root || !own;
            if constant {
                let message = format!(
                    "`{}` is CONSTANT and cannot be written",
                    self.var(member).name
                );
                self.report(Problem::error("E317", span, message));
                return false;
            }
            let generated = self.var(member).name.starts_with("__");
            if outside
                && section == VarSection::Output
                && !self.options.allow_internal_access
                && !generated
            {
                let message = format!(
                    "`{}` is an output of {} and cannot be written from outside",
                    self.var(member).name,
                    self.pou(pou).name
                );
                self.report(Problem::error("E317", span, message));
                return false;
            }
            if !outside && section == VarSection::Input && !self.pou(pou).library {
                let message = format!("`{}` is an input and is written here", var.name);
                self.report(
                    Problem::warning("W701", span, message)
                        .hint("the standard forbids it: copy the input to a variable of its own"),
                );
            }
        }
        true
    }
}
