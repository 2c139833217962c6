//! Type specifications: from syntax to entries of the type table.

use crate::check::init::Pending;
use crate::check::tree::ExprKind;
use crate::check::{Checker, Declared, Progress, key};
use crate::diag::Problem;
use crate::image;
use crate::source::Span;
use crate::syntax::ast::{self, TypeSpec, TypeSpecKind};
use crate::types::{Elem, Field, STRING_LEN_DEFAULT, STRING_LEN_MAX, TypeId, TypeKind};

/// Largest number of elements of one array.
const ARRAY_ELEMENTS_MAX: i128 = 128 * 1024 * 1024;

/// Largest number of fields of one structure, with those of the structures in it: each is looked at by itself.
const STRUCTURE_PARTS_MAX: u64 = 1 << 20;

impl<'p> Checker<'p> {
    /// The type number `index` of the project.
    pub(super) fn resolve_declared(&mut self, index: usize, used_at: Span) -> TypeId {
        let (progress, id) = self.type_ids[index];
        match progress {
            Progress::Done => return id,
            Progress::Running => {
                let message = format!(
                    "the type `{}` contains itself",
                    self.project.types[index].name.name
                );
                self.report(Problem::error("E209", used_at, message));
                return TypeId::ERROR;
            }
            Progress::Open => {}
        }
        self.type_ids[index].0 = Progress::Running;
        let outside = std::mem::take(&mut self.current);
        let decl = &self.project.types[index];
        self.current.space.clone_from(&decl.name.name);
        let mut id = self.resolve_spec(&decl.spec, Some(&decl.name.name));
        let is_new = self.types.get(id).name.as_deref() == Some(decl.name.name.as_str());
        if !is_new && id != TypeId::ERROR {
            id = self.types.add_alias(decl.name.name.clone(), id);
        }
        if let Some(init) = &decl.init {
            self.pending_inits.push((Pending::Type(id), init));
        }
        self.current = outside;
        self.type_ids[index] = (Progress::Done, id);
        id
    }

    /// The type that a specification stands for; a new type gets the name `name`.
    pub(super) fn resolve_spec(&mut self, spec: &'p TypeSpec, name: Option<&str>) -> TypeId {
        let new_name = name.map(str::to_owned);
        match &spec.kind {
            TypeSpecKind::Named(ident) => self.resolve_name(ident),
            TypeSpecKind::Str { wide, len } => {
                let len = match len {
                    None => i128::from(STRING_LEN_DEFAULT),
                    Some(len) => match self.const_int(len) {
                        Some(len) => len,
                        None => return TypeId::ERROR,
                    },
                };
                if !(1..=i128::from(STRING_LEN_MAX)).contains(&len) {
                    let message = format!("a string cannot have {len} characters");
                    self.report(
                        Problem::error("E226", spec.span, message)
                            .expected(format!("a length from 1 to {STRING_LEN_MAX}")),
                    );
                    return TypeId::ERROR;
                }
                self.types.string(*wide, len as u32)
            }
            TypeSpecKind::Ref(to) | TypeSpecKind::Pointer(to) => {
                let target = match self.structure_ahead(to) {
                    Some(target) => target,
                    None => self.resolve_spec(to, None),
                };
                if target == TypeId::ERROR {
                    return TypeId::ERROR;
                }
                if matches!(spec.kind, TypeSpecKind::Pointer(_)) && self.is_liberal() {
                    self.types.pointer(target)
                } else {
                    self.types.reference(target)
                }
            }
            TypeSpecKind::Inferred => TypeId::INFERRED,
            TypeSpecKind::OpenArray { .. } => self.open_array(spec.span),
            TypeSpecKind::Array { dims, elem } => {
                let elem = self.resolve_spec(elem, None);
                let mut bounds = Vec::new();
                let mut count: i128 = 1;
                for (lo, hi) in dims {
                    let (Some(low), Some(high)) = (self.const_int(lo), self.const_int(hi)) else {
                        return TypeId::ERROR;
                    };
                    let limits = i128::from(i32::MIN)..=i128::from(i32::MAX);
                    if low > high || !limits.contains(&low) || !limits.contains(&high) {
                        let span = lo.span.to(hi.span);
                        let message = format!("{low}..{high} is no range of indices");
                        self.report(Problem::error("E210", span, message).expected(
                            "a lower bound that is not above the upper bound, both DINT",
                        ));
                        return TypeId::ERROR;
                    }
                    count *= high - low + 1;
                    if count > ARRAY_ELEMENTS_MAX {
                        let message =
                            format!("this array has more than {ARRAY_ELEMENTS_MAX} elements");
                        self.report(Problem::error("E211", spec.span, message));
                        return TypeId::ERROR;
                    }
                    bounds.push((low as i64, high as i64));
                }
                if elem == TypeId::ERROR {
                    return TypeId::ERROR;
                }
                self.types.array(bounds, elem)
            }
            TypeSpecKind::Subrange { base, lo, hi } => {
                let base_type = self.resolve_name(base);
                let elem = self.types.elem(base_type).filter(|e| e.is_int());
                let (Some(elem), Some(low), Some(high)) =
                    (elem, self.const_int(lo), self.const_int(hi))
                else {
                    if elem.is_none() && base_type != TypeId::ERROR {
                        let message = format!("`{}` cannot have a subrange", base.name);
                        self.report(
                            Problem::error("E212", base.span, message).expected("an integer type"),
                        );
                    }
                    return TypeId::ERROR;
                };
                let (min, max) = elem.limits().unwrap_or((0, 0));
                if low > high || low < min || high > max {
                    let message = format!("{low}..{high} is no subrange of {elem}");
                    self.report(
                        Problem::error("E212", lo.span.to(hi.span), message)
                            .expected(format!("limits within {min}..{max}")),
                    );
                    return TypeId::ERROR;
                }
                let kind = TypeKind::Subrange {
                    base: elem,
                    lo: low,
                    hi: high,
                };
                self.types.add(new_name, kind)
            }
            TypeSpecKind::Enum { base, values } => {
                self.resolve_enum(base.as_ref(), values, new_name)
            }
            TypeSpecKind::Struct { overlap, fields } => {
                let mut list: Vec<Field> = Vec::new();
                let mut inits = Vec::new();
                for decl in fields {
                    if list
                        .iter()
                        .any(|f| f.name.eq_ignore_ascii_case(&decl.name.name))
                    {
                        let message = format!("the field `{}` is declared twice", decl.name.name);
                        self.report(Problem::error("E201", decl.name.span, message));
                        continue;
                    }
                    let ty = self.resolve_spec(&decl.spec, None);
                    let at = decl.location.as_ref().and_then(|at| {
                        let relative = self.relative(at, ty);
                        self.ok(relative)
                    });
                    if let Some(init) = &decl.init {
                        inits.push((list.len(), init));
                    }
                    list.push(Field {
                        name: decl.name.name.clone(),
                        ty,
                        at,
                        init: None,
                    });
                }
                let parts = list.iter().map(|f| self.parts(f.ty)).sum();
                if parts > STRUCTURE_PARTS_MAX {
                    let message = format!(
                        "this structure has {parts} fields, with those of the structures in it"
                    );
                    self.report(
                        Problem::error("E211", spec.span, message)
                            .expected(format!("at most {STRUCTURE_PARTS_MAX}")),
                    );
                    return TypeId::ERROR;
                }
                let kind = TypeKind::Struct { fields: list };
                let ahead = name.and_then(|n| self.ahead.remove(&key(n)));
                let id = match ahead {
                    Some(id) => {
                        self.types.set_kind(id, kind);
                        id
                    }
                    None => self.types.add(new_name, kind),
                };
                self.structure_parts.insert(id, parts);
                for (field, init) in inits {
                    self.pending_inits.push((Pending::Field(id, field), init));
                }
                if let Some((one, other)) = image::overlap(&self.types, id).filter(|_| !overlap) {
                    let message = format!(
                        "`{}` lies over `{}`",
                        fields[other].name.name, fields[one].name.name
                    );
                    self.report(
                        Problem::error("E206", fields[other].name.span, message)
                            .hint("say STRUCT OVERLAP if they are to share their place"),
                    );
                }
                id
            }
        }
    }

    /// How many fields a value of the type has, with those of the structures in it; an array counts as one element.
    fn parts(&self, ty: TypeId) -> u64 {
        match self.types.kind(ty) {
            TypeKind::Array { elem, .. } => self.parts(*elem),
            TypeKind::Struct { .. } => {
                let root = self.types.get(ty).same_as;
                self.structure_parts.get(&root).copied().unwrap_or(1)
            }
            _ => 1,
        }
    }

    /// The structure that a reference leads to, before its fields are known: it may hold references to itself, or to
    /// another one that leads back.
    fn structure_ahead(&mut self, to: &TypeSpec) -> Option<TypeId> {
        let TypeSpecKind::Named(ident) = &to.kind else {
            return None;
        };
        let Some(Declared::Type(index)) = self.lookup(&ident.name) else {
            return None;
        };
        let decl = &self.project.types[index];
        let unknown = self.type_ids[index].0 != Progress::Done;
        if !unknown || !matches!(decl.spec.kind, TypeSpecKind::Struct { .. }) {
            return None;
        }
        let name = key(&decl.name.name);
        if let Some(id) = self.ahead.get(&name) {
            return Some(*id);
        }
        let fields = Vec::new();
        let id = self
            .types
            .add(Some(decl.name.name.clone()), TypeKind::Struct { fields });
        self.ahead.insert(name, id);
        Some(id)
    }

    fn resolve_enum(
        &mut self,
        base: Option<&'p ast::Ident>,
        values: &'p [(ast::Ident, Option<ast::Expr>)],
        name: Option<String>,
    ) -> TypeId {
        let mut elem = Elem::Int;
        if let Some(base) = base {
            match Elem::from_name(&base.name)
                .filter(|e| e.is_int() || (e.is_bit() && *e != Elem::Bool))
            {
                Some(e) => elem = e,
                None => {
                    let message = format!("`{}` cannot be the base of an enumeration", base.name);
                    self.report(
                        Problem::error("E213", base.span, message).expected("an integer type"),
                    );
                }
            }
        }
        let limits = elem.limits().unwrap_or((0, 0));
        let mut list: Vec<(String, i64)> = Vec::new();
        let mut next: i128 = 0;
        for (ident, value) in values {
            if let Some(value) = value {
                match self.const_int(value) {
                    Some(v) => next = v,
                    None => return TypeId::ERROR,
                }
            }
            if next < limits.0 || next > limits.1.min(i128::from(i64::MAX)) {
                let message = format!("the value {next} of `{}` does not fit {elem}", ident.name);
                self.report(Problem::error("E213", ident.span, message));
                return TypeId::ERROR;
            }
            if list
                .iter()
                .any(|(n, _)| n.eq_ignore_ascii_case(&ident.name))
            {
                let message = format!("the value `{}` is declared twice", ident.name);
                self.report(Problem::error("E201", ident.span, message));
                continue;
            }
            list.push((ident.name.clone(), next as i64));
            next += 1;
        }
        let id = self.types.add(
            name,
            TypeKind::Enum {
                base: elem,
                values: list.clone(),
            },
        );
        for (name, value) in list {
            self.enum_values
                .entry(key(&name))
                .or_default()
                .push((id, value));
        }
        id
    }

    pub(super) fn resolve_name(&mut self, ident: &ast::Ident) -> TypeId {
        if let Some(elem) = Elem::from_name(&ident.name) {
            return TypeId::of(elem);
        }
        match self.lookup(&ident.name) {
            Some(Declared::Interface(id)) => self.interface_types[id.0 as usize],
            Some(Declared::Type(index)) => self.resolve_declared(index, ident.span),
            Some(Declared::Pou(pou)) => match self.fb_types.get(&pou) {
                Some(ty) => *ty,
                None => {
                    let message = format!("{} `{}` is no type", self.pou(pou).kind, ident.name);
                    self.report(
                        Problem::error("E202", ident.span, message)
                            .expected("a data type or a function block"),
                    );
                    TypeId::ERROR
                }
            },
            Some(Declared::Global(..)) => {
                let message = format!("`{}` is a variable and no type", ident.name);
                self.report(Problem::error("E202", ident.span, message));
                TypeId::ERROR
            }
            None => {
                let mut candidates: Vec<String> =
                    Elem::ALL.iter().map(|e| e.name().to_owned()).collect();
                candidates.extend(self.project.types.iter().map(|t| t.name.name.clone()));
                candidates.extend(self.fb_types.keys().map(|p| self.pou(*p).name.clone()));
                let mut problem = Problem::error(
                    "E202",
                    ident.span,
                    format!("the type `{}` is not declared", ident.name),
                );
                if let Some(hint) = self.elsewhere(&ident.name) {
                    problem = problem.hint(hint);
                } else if let Some(close) = closest(&ident.name, &candidates) {
                    problem = problem.hint(format!("did you mean `{close}`?"));
                } else {
                    problem = problem.hint(
                        "declare it; one that the PLC's own tool brings along has to be given with the logic",
                    );
                }
                self.report(problem);
                TypeId::ERROR
            }
        }
    }

    /// The value of a constant integer expression.
    pub(super) fn const_int(&mut self, expr: &ast::Expr) -> Option<i128> {
        let typed = self.expr(expr, None);
        match &typed.kind {
            ExprKind::Const(value) if !self.types.is_enum(typed.ty) => {
                if let Some(v) = value.as_i128() {
                    return Some(v);
                }
            }
            _ if typed.ty == TypeId::ERROR => return None,
            _ => {}
        }
        self.report(
            Problem::error("E214", expr.span, "this is no constant integer")
                .expected("an integer literal, or a variable declared CONSTANT"),
        );
        None
    }
}

/// The candidate that is most like `name`, if one is near enough to be a slip of the finger.
pub(super) fn closest(name: &str, candidates: &[String]) -> Option<String> {
    let name = key(name);
    let limit = (name.chars().count() / 3).clamp(1, 3);
    candidates
        .iter()
        .map(|c| (distance(&name, &key(c)), c))
        .filter(|(d, _)| *d <= limit)
        .min()
        .map(|(_, c)| c.clone())
}

/// Number of letters to insert, remove or change (Levenshtein).
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let cost = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = cost.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}
