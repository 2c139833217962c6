//! `ARRAY[*] OF T`: parameters of functions that take arrays of any bounds (IEC 61131-3, third edition, clause 6.6.1.2.7).
//!
//! A function with such parameters is a pattern. Each call makes, once for each kind of array, a function of its own in which
//! the parameters have the bounds of what is passed: inside it `LOWER_BOUND` and `UPPER_BOUND` are constants, and indices are
//! checked as with any other array.

use std::collections::BTreeMap;

use crate::check::expr::{constant, error_expr};
use crate::check::tree::{Expr, Pou, PouId, VarId};
use crate::check::{Checker, key};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{self, Arg, PouKind, TypeSpecKind, VarSection};
use crate::types::{Elem, TypeId, TypeKind};
use crate::value::Value;

/// Functions with open arrays: the patterns with their parameters, and what was made of them.
#[derive(Debug, Default)]
pub(super) struct OpenArrays {
    patterns: BTreeMap<PouId, Vec<VarId>>,
    made: BTreeMap<(PouId, Vec<TypeId>), PouId>,
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
        let allowed = self.pou(pou).kind == PouKind::Function
            && matches!(section, VarSection::InOut | VarSection::Input);
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
                    "ARRAY[*] can stand only for a parameter of a function",
                )
                .expected("VAR_IN_OUT or VAR_INPUT of a FUNCTION")
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
            if !open.is_empty() {
                self.open_arrays.patterns.insert(id, open);
            }
        }
    }

    /// Whether the body of a POU has no meaning before bounds are known.
    pub(super) fn is_pattern(&self, pou: PouId) -> bool {
        self.open_arrays.patterns.contains_key(&pou)
    }

    /// The function that a call means: for a pattern the one for the arrays that are passed.
    pub(super) fn with_bounds(&mut self, pou: PouId, args: &[Arg], span: Span) -> Option<PouId> {
        let Some(open) = self.open_arrays.patterns.get(&pou).cloned() else {
            return Some(pou);
        };
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
        let known = (pou, given.clone());
        if let Some(made) = self.open_arrays.made.get(&known) {
            return Some(*made);
        }
        let made = self.make(pou, given);
        self.open_arrays.made.insert(known, made);
        Some(made)
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

    /// A function of its own, declared now; its body is checked with all others.
    fn make(&mut self, pattern: PouId, given: Vec<TypeId>) -> PouId {
        let id = PouId(self.pous.len() as u32);
        let unit = Pou {
            vars: Vec::new(),
            result: None,
            body: Vec::new(),
            calls: Default::default(),
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
        self.scopes[id.0 as usize] = std::mem::take(&mut self.current.names);
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
        constant(Value::Int(bound), TypeId::of(Elem::Dint), span)
    }
}
