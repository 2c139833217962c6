//! `ARRAY[*] OF T`: parameters that take arrays of any bounds (IEC 61131-3, third edition, clause 6.5.3): inputs, outputs and
//! in-outs of functions and methods, in-outs of function blocks.
//!
//! A POU with such parameters is a pattern. Each call makes, once for each kind of array, a POU of its own in which
//! the parameters have the bounds of what is passed: inside it `LOWER_BOUND` and `UPPER_BOUND` are constants, and indices are
//! checked as with any other array. A method is made together with all those that may run in its place, under a name that
//! tells the bounds. What is made of a function block is a body: the variables are those of the block, so that all
//! calls of an instance work on one state.

use std::collections::BTreeMap;

use crate::check::expr::{constant, error_expr};
use crate::check::tree::{Expr, Pou, PouId, VarId};
use crate::check::{Checker, key};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{self, Arg, PouKind, TypeSpecKind, VarSection};
use crate::types::{InterfaceId, TypeId, TypeKind};
use crate::value::Value;

/// How many POUs are made of patterns.
const MADE_MAX: usize = 2_000;

/// POUs with open arrays: the patterns with their parameters, and what was made of them.
#[derive(Debug, Default)]
pub(super) struct OpenArrays {
    patterns: BTreeMap<PouId, Vec<VarId>>,
    made: BTreeMap<(PouId, Vec<TypeId>), PouId>,
    /// The function block that a body was made of.
    pub(super) blocks: BTreeMap<PouId, PouId>,
    /// Types for the open parameters of the function that is being declared, in their order; placeholders in a pattern.
    given: Vec<TypeId>,
    /// What `ARRAY[*]` means at the declaration that is being read.
    meaning: Option<TypeId>,
}

impl<'p> Checker<'p> {
    /// To be called before a parameter of a POU is declared.
    pub(super) fn before_open_array(
        &mut self,
        pou: PouId,
        section: VarSection,
        decl: &'p ast::VarDecl,
    ) {
        let TypeSpecKind::OpenArray { dims, elem } = &decl.spec.kind else {
            return;
        };
        let allowed = match self.pou(pou).kind {
            PouKind::Function | PouKind::Method => matches!(
                section,
                VarSection::InOut | VarSection::Input | VarSection::Output
            ),
            PouKind::FunctionBlock => section == VarSection::InOut,
            PouKind::Program => false,
        };
        if !allowed {
            return;
        }
        self.open_arrays.meaning = Some(if self.open_arrays.given.is_empty() {
            let elem = self.resolve_spec(elem, None);
            if elem == TypeId::ERROR {
                elem
            } else {
                self.types.array(vec![(0, 0); *dims as usize], elem)
            }
        } else {
            self.open_arrays.given.remove(0)
        });
    }

    /// What `ARRAY[*]` means here.
    pub(super) fn open_array(&mut self, span: Span) -> TypeId {
        self.open_arrays.meaning.take().unwrap_or_else(|| {
            self.report(
                Problem::error(
                    "E229",
                    span,
                    "ARRAY[*] can stand only for a parameter",
                )
                .expected("VAR_INPUT, VAR_OUTPUT or VAR_IN_OUT of a FUNCTION or METHOD, VAR_IN_OUT of a FUNCTION_BLOCK")
                .hint("give the bounds: `ARRAY[0..9] OF INT`"),
            );
            TypeId::ERROR
        })
    }

    /// Notes which functions are patterns, when all are declared.
    pub(super) fn find_patterns(&mut self) {
        for index in 0..self.pous.len() {
            let id = PouId(index as u32);
            let open: Vec<String> = self.syntaxes[index]
                .vars
                .iter()
                .flat_map(|block| &block.decls)
                .filter(|d| matches!(d.spec.kind, TypeSpecKind::OpenArray { .. }))
                .map(|d| key(&d.name.name))
                .collect();
            let of_open = |v: &VarId| open.contains(&key(&self.var(*v).name));
            let open: Vec<VarId> = self.pou(id).vars.iter().copied().filter(of_open).collect();
            if open.is_empty() {
                continue;
            }
            if let Some(relative) = self.relative_of(id) {
                let span = self.var(open[0]).span;
                let (own, other) = (self.pou(id).name.clone(), self.pou(relative).name.clone());
                let message = format!("{own} has ARRAY[*] and cannot be derived: see {other}");
                self.report(
                    Problem::error("E229", span, message)
                        .hint("give the bounds, or take the array in a METHOD"),
                );
            }
            self.pous[index].pattern = true;
            self.open_arrays.patterns.insert(id, open);
        }
    }

    /// Whether the body of a POU has no meaning before bounds are known.
    pub(super) fn is_pattern(&self, pou: PouId) -> bool {
        self.open_arrays.patterns.contains_key(&pou)
    }

    /// A base of a function block, or one derived from it.
    fn relative_of(&self, pou: PouId) -> Option<PouId> {
        if self.pou(pou).kind != PouKind::FunctionBlock {
            return None;
        }
        let all = (0..self.pous.len() as u32).map(PouId);
        let derived = all.into_iter().find(|p| self.pou(*p).extends == Some(pou));
        self.pou(pou).extends.or(derived)
    }

    /// The POU that a call means: for a pattern the one for the arrays that are passed.
    pub(super) fn with_bounds(&mut self, pou: PouId, args: &[Arg], span: Span) -> Option<PouId> {
        let Some(given) = self.given_bounds(pou, args, span)? else {
            return Some(pou);
        };
        Some(self.made_of(pou, given, ""))
    }

    /// The method that a call means. Those that may run in its place, in other function blocks, are made with it.
    pub(super) fn method_with_bounds(
        &mut self,
        method: PouId,
        interface: Option<InterfaceId>,
        args: &[Arg],
        span: Span,
    ) -> Option<PouId> {
        let Some(given) = self.given_bounds(method, args, span)? else {
            return Some(method);
        };
        let plain = self.pou(method).name.clone();
        let plain = key(plain.rsplit('.').next().unwrap_or_default());
        let bounds: Vec<String> = given.iter().map(|ty| self.bounds_of(*ty)).collect();
        let suffix = format!("[{}]", bounds.join(" "));
        let name = plain.clone() + &key(&suffix);
        for block in (0..self.pous.len() as u32).map(PouId) {
            if self.pou(block).kind != PouKind::FunctionBlock {
                continue;
            }
            let may_run = match (interface, self.pou(method).instance_of) {
                (Some(id), _) => self.implements(block, id),
                (None, Some(owner)) => self.derives_pou(block, owner),
                (None, None) => false,
            };
            let found = self.find_method(block, &plain);
            if let Some(found) = found.filter(|f| may_run && self.is_pattern(*f)) {
                let made = self.made_of(found, given.clone(), &suffix);
                self.give_method(found, &name, made);
            }
        }
        let made = self.made_of(method, given, &suffix);
        self.give_method(method, &name, made);
        for interface in &mut self.interfaces {
            let has = |m: PouId| interface.methods.iter().any(|(_, own)| *own == m);
            if has(method) && !has(made) {
                interface.methods.push((name.clone(), made));
            }
        }
        Some(made)
    }

    /// A method made of `pattern` belongs to the same function block.
    fn give_method(&mut self, pattern: PouId, name: &str, made: PouId) {
        let Some(block) = self.pou(pattern).instance_of else {
            return;
        };
        let methods = &mut self.pous[block.0 as usize].methods;
        if !methods.iter().any(|(n, _)| n == name) {
            methods.push((name.to_owned(), made));
        }
    }

    /// `0:9`, `-1:1,0:4`: part of a name, without dots.
    fn bounds_of(&self, ty: TypeId) -> String {
        let TypeKind::Array { dims, .. } = self.types.kind(ty) else {
            return String::new();
        };
        let dims: Vec<String> = dims.iter().map(|(l, h)| format!("{l}:{h}")).collect();
        dims.join(",")
    }

    /// The types of the arrays that are passed to a pattern, in the order of its open parameters. `Some(None)`: it is none.
    fn given_bounds(
        &mut self,
        pou: PouId,
        args: &[Arg],
        span: Span,
    ) -> Option<Option<Vec<TypeId>>> {
        let Some(open) = self.open_arrays.patterns.get(&pou).cloned() else {
            return Some(None);
        };
        if self.open_arrays.made.len() >= MADE_MAX {
            let message = format!("arrays of more than {MADE_MAX} kinds are passed to ARRAY[*]");
            self.report(
                Problem::error("E229", span, message)
                    .hint("a POU that passes ever larger arrays to itself has no end"),
            );
            return None;
        }
        let pairs = self.match_arguments(pou, args, span)?;
        let mut given = Vec::new();
        for parameter in open {
            let value = pairs
                .iter()
                .find(|(p, _)| *p == parameter)
                .and_then(|(_, a)| a.value.as_ref());
            let Some(value) = value else {
                self.missing(parameter, span);
                return None;
            };
            given.push(self.bounds_of_argument(parameter, value)?);
        }
        Some(Some(given))
    }

    fn made_of(&mut self, pattern: PouId, given: Vec<TypeId>, suffix: &str) -> PouId {
        let known = (pattern, given.clone());
        if let Some(made) = self.open_arrays.made.get(&known) {
            return *made;
        }
        let made = if self.pou(pattern).kind == PouKind::FunctionBlock {
            self.make_body(pattern, given)
        } else {
            self.make(pattern, given)
        };
        self.pous[made.0 as usize].name.push_str(suffix);
        self.open_arrays.made.insert(known, made);
        made
    }

    /// A body of a function block for these arrays; everything else is the block's own.
    fn make_body(&mut self, pattern: PouId, given: Vec<TypeId>) -> PouId {
        let id = PouId(self.pous.len() as u32);
        let mut unit = self.pou(pattern).clone();
        (unit.calls, unit.pattern) = (Default::default(), false);
        // What belongs to the block is this body's own too.
        unit.extends = Some(pattern);
        let mut names = self.scopes[pattern.0 as usize].clone();
        let open = self.open_arrays.patterns.get(&pattern).cloned();
        for (parameter, ty) in open.unwrap_or_default().into_iter().zip(given) {
            let own = VarId(self.vars.len() as u32);
            let mut var = self.var(parameter).clone();
            (var.ty, var.owner) = (ty, Some(id));
            names.insert(key(&var.name), own);
            self.vars.push(var);
            let at = unit.vars.iter_mut().find(|v| **v == parameter);
            at.into_iter().for_each(|v| *v = own);
        }
        self.pous.push(unit);
        self.syntaxes.push(self.syntaxes[pattern.0 as usize]);
        self.scopes.push(names);
        self.open_arrays.blocks.insert(id, pattern);
        if let Some(ty) = self.fb_types.get(&pattern).copied() {
            self.fb_types.insert(id, ty);
        }
        id
    }

    /// The type of what is passed, if it is an array of the right elements and as many dimensions.
    fn bounds_of_argument(&mut self, parameter: VarId, value: &ast::Expr) -> Option<TypeId> {
        let place = self.place(value)?;
        let (want, name) = (self.var(parameter).ty, self.var(parameter).name.clone());
        let TypeKind::Array { dims, elem } = self.types.kind(want).clone() else {
            return None;
        };
        if let TypeKind::Array {
            dims: have_dims,
            elem: have,
        } = self.types.kind(place.ty).clone()
            && have_dims.len() == dims.len()
            && self.types.same(have, elem)
        {
            return Some(place.ty);
        }
        let stars = vec!["*"; dims.len()].join(", ");
        let wanted = format!("ARRAY[{stars}] OF {}", self.type_name(elem));
        let message = format!(
            "`{name}` takes {wanted}, and this is {}",
            self.type_name(place.ty)
        );
        self.report(Problem::error("E412", value.span, message).expected(wanted));
        None
    }

    /// A function or method of its own, declared now; its body is checked with all others.
    fn make(&mut self, pattern: PouId, given: Vec<TypeId>) -> PouId {
        let id = PouId(self.pous.len() as u32);
        let unit = Pou {
            vars: Vec::new(),
            result: None,
            body: Vec::new(),
            calls: Default::default(),
            pattern: false,
            ..self.pou(pattern).clone()
        };
        self.pous.push(unit);
        self.syntaxes.push(self.syntaxes[pattern.0 as usize]);
        self.scopes.push(BTreeMap::new());
        let outside = std::mem::take(&mut self.current);
        self.open_arrays.given = given;
        let settled = self.pending_inits.len();
        self.enter(Some(id));
        self.declare_pou(id);
        let own = std::mem::take(&mut self.current.names);
        // Names of a method hide those of its function block.
        let block = self.pou(id).instance_of;
        let mut names = block.map_or_else(BTreeMap::new, |b| self.scopes[b.0 as usize].clone());
        names.retain(|_, var| !self.lives_with_body(*var));
        names.extend(own);
        self.scopes[id.0 as usize] = names;
        self.settle_inits(settled);
        self.current = outside;
        id
    }

    /// `LOWER_BOUND(a, 1)` and `UPPER_BOUND(ARR := a, DIM := 2)`.
    pub(super) fn bound_call(&mut self, upper: &str, args: &[Arg], span: Span) -> Expr {
        let by_name = |name: &str, at: usize| {
            let named = args.iter().find(|a| {
                a.name
                    .as_ref()
                    .is_some_and(|n| n.name.eq_ignore_ascii_case(name))
            });
            named
                .or_else(|| args.get(at).filter(|a| a.name.is_none()))
                .and_then(|a| a.value.as_ref())
        };
        let (Some(array), Some(dim), 2) = (by_name("ARR", 0), by_name("DIM", 1), args.len()) else {
            self.report(
                Problem::error(
                    "E409",
                    span,
                    format!("{upper} takes an array and a dimension"),
                )
                .expected(format!("{upper}(array, 1)")),
            );
            return error_expr(span);
        };
        let Some(place) = self.place(array) else {
            return error_expr(span);
        };
        let TypeKind::Array { dims, .. } = self.types.kind(place.ty).clone() else {
            let message = format!("{} is no array", self.type_name(place.ty));
            self.report(Problem::error("E418", array.span, message).expected("an array"));
            return error_expr(span);
        };
        let Some(number) = self.const_int(dim) else {
            return error_expr(span);
        };
        let bounds = usize::try_from(number - 1)
            .ok()
            .and_then(|at| dims.get(at).copied());
        let Some((low, high)) = bounds else {
            let message = format!("the array has no dimension {number}");
            let wanted = format!("a number from 1 to {}", dims.len());
            self.report(Problem::error("E418", dim.span, message).expected(wanted));
            return error_expr(span);
        };
        let bound = if upper == "LOWER_BOUND" { low } else { high };
        // ANY_INT: whatever integer its place wants.
        constant(Value::Int(bound), TypeId::UNTYPED_INT, span)
    }
}
