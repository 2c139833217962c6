//! Calls of functions, function block instances and programs: arguments matched with parameters.

use crate::check::expr::error_expr;
use crate::check::tree::{
    Argument, Expr, ExprKind, FunctionCall, Invocation, Place, PouId, StmtKind, VarId,
};
use crate::check::types::closest;
use crate::check::{Checker, Declared, key};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{self, Arg, PouKind, VarSection};
use crate::types::{Elem, TypeId, TypeKind};

impl Checker<'_> {
    /// A call inside an expression: of a function.
    pub(super) fn call_expr(
        &mut self,
        callee: &ast::Expr,
        args: &[Arg],
        expected: Option<TypeId>,
        span: Span,
    ) -> Expr {
        if let Some(expr) = self.enabled_value(callee, args, expected, span) {
            return expr;
        }
        if let Some(call) = self.method_call(callee, args, span) {
            return self.method_value(call, span);
        }
        let plain = self.without_namespace(callee);
        let callee = plain.as_ref().unwrap_or(callee);
        let ast::ExprKind::Name(name) = &callee.kind else {
            return self.refuse_invocation(span);
        };
        if let Some(Declared::Pou(pou)) = self.lookup(name) {
            if self.pou(pou).kind != PouKind::Function {
                return self.refuse_invocation(span);
            }
            let Some(call) = self.function_call(pou, args, span) else {
                return error_expr(span);
            };
            let ty = match self.pou(pou).result {
                Some(result) => self.var(result).ty,
                None => TypeId::VOID,
            };
            if ty == TypeId::VOID {
                let message = format!("the function `{name}` has no result");
                self.report(Problem::error("E401", span, message).hint("call it as a statement"));
                return error_expr(span);
            }
            return Expr {
                kind: ExprKind::Call(Box::new(call)),
                ty,
                span,
            };
        }
        if self.find_var(name).is_some()
            && !matches!(key(name).as_str(), "AND" | "OR" | "XOR" | "MOD" | "NOT")
        {
            if crate::check::stdfun::StdFun::from_name(&key(name)).is_some() {
                return self.refuse_hidden(name, callee.span);
            }
            return self.refuse_invocation(span);
        }
        if let Some(expr) = self.standard_call(name, args, expected, span) {
            return expr;
        }
        let mut candidates: Vec<String> = self
            .pous
            .iter()
            .filter(|p| p.kind == PouKind::Function)
            .map(|p| p.name.clone())
            .collect();
        candidates.extend(
            [
                "ABS", "SQRT", "LIMIT", "MAX", "MIN", "SEL", "MUX", "TRUNC", "EXPT", "SHL", "SHR",
                "ROL", "ROR",
            ]
            .map(String::from),
        );
        let mut problem = Problem::error(
            "E402",
            callee.span,
            format!("the function `{name}` is not declared"),
        );
        if let Some(hint) = self.elsewhere(name) {
            problem = problem.hint(hint);
        } else if let Some(close) = closest(name, &candidates) {
            problem = problem.hint(format!("did you mean `{close}`?"));
        }
        self.report(problem);
        error_expr(span)
    }

    /// `Space.function` as one name.
    fn without_namespace(&mut self, callee: &ast::Expr) -> Option<ast::Expr> {
        let ast::ExprKind::Field(base, name) = &callee.kind else {
            return None;
        };
        self.with_path(base, name).map(|path| ast::Expr {
            kind: ast::ExprKind::Name(path),
            span: callee.span,
        })
    }

    /// A variable called like a function: case does not count.
    fn refuse_hidden(&mut self, name: &str, callee: Span) -> Expr {
        let message = format!("`{name}` is a variable here, and hides the function of this name");
        self.report(Problem::error("E403", callee, message).hint("give the variable another name"));
        error_expr(callee)
    }

    fn refuse_invocation(&mut self, span: Span) -> Expr {
        self.report(
            Problem::error("E403", span, "only a function can be called inside an expression")
                .hint("call the instance in a statement of its own, then read its outputs: `fb(in := x); y := fb.q;`"),
        );
        error_expr(span)
    }

    /// A call as a statement.
    pub(super) fn call_stmt(&mut self, call: &ast::Expr) -> Option<StmtKind> {
        let ast::ExprKind::Call(callee, args) = &call.kind else {
            return None;
        };
        if let Some(method) = self.method_call(callee, args, call.span) {
            return method.map(StmtKind::Call);
        }
        let plain = self.without_namespace(callee);
        let callee = plain.as_ref().unwrap_or(callee);
        let super_word = match &callee.kind {
            ast::ExprKind::Name(name) => Some(name),
            ast::ExprKind::Deref(inner) => match &inner.kind {
                ast::ExprKind::Name(name) => Some(name),
                _ => None,
            },
            _ => None,
        };
        if let Some(word) = super_word
            && word.eq_ignore_ascii_case("SUPER")
            && self.find_var(word).is_none()
        {
            return self.super_body(call.span);
        }
        if let ast::ExprKind::Name(name) = &callee.kind
            && self.find_var(name).is_none()
        {
            let upper = key(name);
            if upper == "__REGION_TO_BYTES" || upper == "__BYTES_TO_REGION" {
                return self.region_copy(args, upper == "__REGION_TO_BYTES", call.span);
            }
            if let Some(Declared::Pou(pou)) = self.lookup(name) {
                match self.pou(pou).kind {
                    PouKind::Function => {
                        let call = self.function_call(pou, args, call.span)?;
                        return Some(StmtKind::Call(call));
                    }
                    PouKind::Program => {
                        if let Some(current) = self.current.pou
                            && self.pou(current).kind == PouKind::Function
                        {
                            let message = "a function cannot call a program";
                            self.report(Problem::error("E404", call.span, message));
                            return None;
                        }
                        return self
                            .invocation(pou, None, args, call.span)
                            .map(StmtKind::Invoke);
                    }
                    PouKind::FunctionBlock | PouKind::Method => {
                        self.unknown_name(name, callee.span);
                        return None;
                    }
                }
            }
            let result = self.call_expr(callee, args, None, call.span);
            if result.ty != TypeId::ERROR {
                let message = format!("the result of `{name}` is not used");
                self.report(
                    Problem::warning("W705", call.span, message).hint("assign it to a variable"),
                );
            }
            return None;
        }
        let place = self.place(callee)?;
        let TypeKind::FunctionBlock(pou) = *self.types.kind(place.ty) else {
            let message = format!("{} cannot be called", self.type_name(place.ty));
            self.report(
                Problem::error("E406", callee.span, message)
                    .expected("a function block instance, a function or a program"),
            );
            return None;
        };
        self.invocation(pou, Some(place), args, call.span)
            .map(StmtKind::Invoke)
    }

    fn region_copy(&mut self, args: &[Arg], to_bytes: bool, span: Span) -> Option<StmtKind> {
        let (region, array) = match args {
            [a, b] => (a.value.as_ref()?, b.value.as_ref()?),
            _ => {
                self.report(
                    Problem::error("E407", span, "a block copy needs a region and an array")
                        .expected("two arguments: 'region', array"),
                );
                return None;
            }
        };
        let ast::ExprKind::Str(name) = &region.kind else {
            self.report(
                Problem::error("E407", region.span, "this is no name of a region")
                    .expected("a string, such as 'state'"),
            );
            return None;
        };
        let array = self.place(array)?;
        let is_bytes = matches!(self.types.kind(array.ty), TypeKind::Array { dims, elem }
            if dims.len() == 1 && self.types.elem(*elem).is_some_and(|e| e.bits() == 8));
        if !is_bytes {
            let message = format!("{} is no array of bytes", self.type_name(array.ty));
            self.report(
                Problem::error("E407", array.span, message).expected("an ARRAY[0..n] OF BYTE"),
            );
            return None;
        }
        if to_bytes && !self.writable(&array) {
            return None;
        }
        Some(StmtKind::CopyRegion {
            region: name.clone(),
            array,
            to_bytes,
        })
    }

    pub(super) fn note_call(&mut self, callee: PouId) {
        if let Some(caller) = self.current.pou {
            self.pous[caller.0 as usize].calls.insert(callee);
        }
    }

    /// Parameters of a POU in the order of their declaration.
    fn parameters(&self, pou: PouId) -> Vec<VarId> {
        let takes = |s| {
            matches!(
                s,
                VarSection::Input | VarSection::Output | VarSection::InOut
            )
        };
        self.pou(pou)
            .vars
            .iter()
            .copied()
            .filter(|v| takes(self.var(*v).section) && !self.var(*v).constant)
            .collect()
    }

    /// Pairs each argument with its parameter. Reports unknown, doubled and surplus ones.
    pub(super) fn match_arguments<'a>(
        &mut self,
        pou: PouId,
        args: &'a [Arg],
        span: Span,
    ) -> Option<Vec<(VarId, &'a Arg)>> {
        let parameters = self.parameters(pou);
        let name = self.pou(pou).name.clone();
        let formal = args.iter().filter(|a| a.name.is_some()).count();
        if formal != 0 && formal != args.len() {
            self.report(mixed_arguments(span));
            return None;
        }
        let mut pairs: Vec<(VarId, &Arg)> = Vec::new();
        let mut failed = false;
        for (index, arg) in args.iter().enumerate() {
            let (parameter, at) = match &arg.name {
                Some(given) => {
                    let found = parameters
                        .iter()
                        .copied()
                        .find(|p| self.var(*p).name.eq_ignore_ascii_case(&given.name));
                    (found, given.span)
                }
                None => (
                    parameters.get(index).copied(),
                    arg.value.as_ref().map_or(span, |v| v.span),
                ),
            };
            let Some(parameter) = parameter else {
                self.no_parameter(&name, &parameters, arg, at);
                failed = true;
                continue;
            };
            if pairs.iter().any(|(p, _)| *p == parameter) {
                let message = format!("`{}` is given twice", self.var(parameter).name);
                self.report(Problem::error("E408", at, message));
                failed = true;
            }
            let is_output = self.var(parameter).section == VarSection::Output;
            if arg.name.is_some() && arg.output != is_output {
                let (have, want) = if is_output {
                    (":=", "=>")
                } else {
                    ("=>", ":=")
                };
                let message = format!(
                    "`{}` is in {} of {name} and cannot stand before `{have}`",
                    self.var(parameter).name,
                    self.var(parameter).section
                );
                self.report(Problem::error("E408", at, message).expected(format!("`{want}`")));
                failed = true;
            }
            pairs.push((parameter, arg));
        }
        (!failed).then_some(pairs)
    }

    /// Whether what goes to this place may go there negated; reports it if not.
    fn may_be_negated(&mut self, place: &Place, span: Span) -> bool {
        let is_bool = self.types.elem(place.ty) == Some(Elem::Bool);
        if !is_bool {
            let message = "NOT applies to a BOOL output only";
            self.report(Problem::error("E408", span, message));
        }
        is_bool
    }

    fn no_parameter(&mut self, pou: &str, parameters: &[VarId], arg: &Arg, at: Span) {
        let names: Vec<String> = parameters
            .iter()
            .map(|p| self.var(*p).name.clone())
            .collect();
        let problem = match &arg.name {
            Some(given) => {
                let problem = Problem::error(
                    "E409",
                    at,
                    format!("{pou} has no parameter `{}`", given.name),
                );
                match closest(&given.name, &names) {
                    Some(close) => problem.hint(format!("did you mean `{close}`?")),
                    None => problem,
                }
            }
            None => Problem::error(
                "E409",
                at,
                format!("{pou} takes {} arguments at most", names.len()),
            ),
        };
        let problem = if names.is_empty() {
            problem
        } else {
            problem.expected(format!("one of {}", names.join(", ")))
        };
        self.report(problem);
    }

    pub(super) fn function_call(
        &mut self,
        pou: PouId,
        args: &[Arg],
        span: Span,
    ) -> Option<FunctionCall> {
        let pou = self.with_bounds(pou, args, span)?;
        self.note_call(pou);
        let pairs = self.match_arguments(pou, args, span)?;
        let mut list = Vec::new();
        let mut failed = false;
        for parameter in self.parameters(pou) {
            let given = pairs
                .iter()
                .find(|(p, _)| *p == parameter)
                .and_then(|(_, a)| a.value.as_ref().map(|v| (v, a.negated)));
            let section = self.var(parameter).section;
            let argument = match (section, given) {
                (VarSection::Input, Some((value, _))) => {
                    let typed = self.argument(parameter, value);
                    failed |= typed.ty == TypeId::ERROR;
                    Argument::Input(typed)
                }
                (VarSection::Input, None) => match self.default_argument(parameter, span) {
                    Some(expr) => Argument::Input(expr),
                    None => {
                        failed = true;
                        continue;
                    }
                },
                (VarSection::Output, Some((value, negated))) => {
                    match self.output_target(parameter, value) {
                        Some(place) => {
                            failed |= negated && !self.may_be_negated(&place, value.span);
                            Argument::Output {
                                target: Some(place),
                                negated,
                            }
                        }
                        None => {
                            failed = true;
                            continue;
                        }
                    }
                }
                (VarSection::Output, None) => Argument::Output {
                    target: None,
                    negated: false,
                },
                (_, Some((value, _))) => match self.in_out(parameter, value) {
                    Some(place) => Argument::InOut(place),
                    None => {
                        failed = true;
                        continue;
                    }
                },
                (_, None) => {
                    self.missing(parameter, span);
                    failed = true;
                    continue;
                }
            };
            list.push(argument);
        }
        (!failed).then_some(FunctionCall {
            pou,
            receiver: None,
            args: list,
            span,
        })
    }

    pub(super) fn missing(&mut self, parameter: VarId, span: Span) {
        let var = self.var(parameter);
        let message = format!(
            "the argument for `{}` ({}) is missing",
            var.name, var.section
        );
        self.report(Problem::error("E411", span, message));
    }

    /// An input that is left out has its initial value.
    fn default_argument(&mut self, parameter: VarId, span: Span) -> Option<Expr> {
        let ty = self.var(parameter).ty;
        if let Some((wide, _)) = self.types.text(ty) {
            let units = match self
                .var(parameter)
                .init
                .clone()
                .or(self.types.init(ty).cloned())
            {
                Some(crate::check::tree::InitValue::Text(units)) => units,
                _ => std::sync::Arc::from([]),
            };
            let ty = self.types.string(wide, units.len().max(1) as u32);
            return Some(Expr {
                kind: ExprKind::Text(units),
                ty,
                span,
            });
        }
        if self.types.is_aggregate(ty) {
            self.missing(parameter, span);
            return None;
        }
        let value = match &self.var(parameter).init {
            Some(crate::check::tree::InitValue::Scalar(value)) => *value,
            _ => self.types.default_value(ty)?,
        };
        Some(crate::check::expr::constant(value, ty, span))
    }

    fn argument(&mut self, parameter: VarId, value: &ast::Expr) -> Expr {
        let ty = self.var(parameter).ty;
        let typed = self.expr(value, Some(ty));
        self.coerce(typed, ty)
    }

    /// A variable that is passed by reference must have exactly the parameter's type.
    fn in_out(&mut self, parameter: VarId, value: &ast::Expr) -> Option<Place> {
        let place = self.place(value)?;
        let (ty, name) = (self.var(parameter).ty, self.var(parameter).name.clone());
        if ty == TypeId::ERROR {
            return None;
        }
        let is_instance = matches!(self.types.kind(place.ty), TypeKind::FunctionBlock(_));
        if !is_instance && !self.writable(&place) {
            return None;
        }
        let strings = match (self.types.text(place.ty), self.types.text(ty)) {
            (Some(have), Some(want)) => have.0 == want.0,
            _ => false,
        };
        let derived = is_instance && self.derives(place.ty, ty);
        if !self.types.same(place.ty, ty) && !strings && !derived {
            let message = format!(
                "`{name}` (VAR_IN_OUT) takes a variable of type {}, and this is {}",
                self.type_name(ty),
                self.type_name(place.ty)
            );
            self.report(
                Problem::error("E412", value.span, message)
                    .expected(format!("a variable of type {}", self.type_name(ty))),
            );
            return None;
        }
        Some(place)
    }

    fn output_target(&mut self, parameter: VarId, value: &ast::Expr) -> Option<Place> {
        self.current.defining = true;
        let place = self.place(value);
        self.current.defining = false;
        let mut place = place?;
        if place.ty == TypeId::INFERRED
            && let crate::check::tree::Root::Var(id) = place.root
        {
            place.ty = self.var(parameter).ty;
            self.vars[id.0 as usize].ty = place.ty;
        }
        if !self.writable(&place) {
            return None;
        }
        let ty = self.var(parameter).ty;
        if ty == TypeId::ERROR {
            return None;
        }
        let widens = match (self.types.elem(ty), self.types.elem(place.ty)) {
            (Some(from), Some(to)) => {
                from.widens_to(to)
                    && (self.types.is_enum(ty) == self.types.is_enum(place.ty))
                    && !matches!(self.types.kind(place.ty), TypeKind::Subrange { .. })
            }
            _ => false,
        };
        if let (Some(have), Some(want)) = (self.types.text(ty), self.types.text(place.ty))
            && have.0 == want.0
        {
            return Some(place);
        }
        let enums = self.types.is_enum(ty) || self.types.is_enum(place.ty);
        if !self.types.same(ty, place.ty) && (enums || !widens) {
            let message = format!(
                "`{}` is {} and cannot go to {}",
                self.var(parameter).name,
                self.type_name(ty),
                self.type_name(place.ty)
            );
            self.report(Problem::error("E412", value.span, message));
            return None;
        }
        Some(place)
    }

    fn invocation(
        &mut self,
        pou: PouId,
        instance: Option<Place>,
        args: &[Arg],
        span: Span,
    ) -> Option<Invocation> {
        let pou = self.with_bounds(pou, args, span)?;
        self.note_call(pou);
        let pairs = self.match_arguments(pou, args, span)?;
        let mut call = Invocation {
            pou,
            instance,
            inputs: Vec::new(),
            in_outs: Vec::new(),
            outputs: Vec::new(),
            span,
        };
        let mut failed = false;
        let mut by_reference = Vec::new();
        for (parameter, arg) in &pairs {
            let Some(value) = &arg.value else { continue };
            match self.var(*parameter).section {
                VarSection::Input => {
                    let typed = self.argument(*parameter, value);
                    failed |= typed.ty == TypeId::ERROR;
                    self.warn_of_temporary(*parameter, &typed);
                    call.inputs.push((*parameter, typed));
                }
                VarSection::Output => match self.output_target(*parameter, value) {
                    Some(place) => {
                        failed |= arg.negated && !self.may_be_negated(&place, value.span);
                        call.outputs.push((*parameter, place, arg.negated));
                    }
                    None => failed = true,
                },
                _ => match self.in_out(*parameter, value) {
                    Some(place) => by_reference.push((*parameter, place)),
                    None => failed = true,
                },
            }
        }
        for parameter in self.parameters(pou) {
            if self.var(parameter).section != VarSection::InOut {
                continue;
            }
            match by_reference.iter().position(|(p, _)| *p == parameter) {
                Some(index) => call.in_outs.push(by_reference.swap_remove(index).1),
                None if failed => {}
                None => {
                    self.missing(parameter, span);
                    failed = true;
                }
            }
        }
        (!failed).then_some(call)
    }
}

pub(super) fn mixed_arguments(span: Span) -> Problem {
    Problem::error("E408", span, "named and unnamed arguments cannot be mixed")
        .hint("name all arguments: `in := x`")
}
