//! Expressions that stand alone, outside of any POU: conditions over the state of a program.

use std::sync::Arc;

use crate::check::stdfun;
use crate::check::tree::{Expr, ExprKind, Limits, Place, TypedProject};
use crate::check::{Checker, Declared, Progress, Scope, key};
use crate::diag::{Diagnostic, finish_all};
use crate::syntax::ast::PouKind;
use crate::syntax::parser::parse_whole_expression;
use crate::types::TypeId;
use crate::value::{self, Fault, Value};

/// Type-checks `text` as an expression in the scope of `pou` (a program or function block; its variables are known by
/// their bare names), or with globals and `program.variable` only when `pou` is `None`.
///
/// `file` names the text in messages. Paths of the variables in the result: `TypedProject::path_of`.
pub fn check_expression(
    project: &TypedProject,
    pou: Option<&str>,
    file: &str,
    text: &str,
) -> Result<Expr, Vec<Diagnostic>> {
    let syntax = &project.syntax;
    let mut sources = (*syntax.sources).clone();
    let source = sources.add(file, text);
    let sources = Arc::new(sources);
    let parsed = parse_whole_expression(source, text, 0).map_err(|p| finish_all(p, &sources))?;

    let mut checker = Checker::new(syntax, project.options);
    checker.sources = sources.clone();
    checker.collect();
    // The declarations have been checked; their results are taken over.
    checker.types = project.types.clone();
    checker.vars.clone_from(&project.vars);
    for (own, known) in checker.pous.iter_mut().zip(&project.pous) {
        own.vars.clone_from(&known.vars);
        own.result = known.result;
    }
    for (id, ty) in project.types.iter() {
        if let (Some(name), Some(Declared::Type(index))) = (
            &ty.name,
            ty.name.as_ref().and_then(|n| checker.names.get(&key(n))),
        ) && syntax.types[*index].name.name == *name
        {
            checker.type_ids[*index] = (Progress::Done, id);
        }
        if let crate::types::TypeKind::Enum { values, .. } = project.types.kind(id)
            && ty.same_as == id
        {
            for (name, value) in values {
                let entry = checker.enum_values.entry(key(name)).or_default();
                entry.push((id, *value));
            }
        }
    }
    let mut globals = project.globals.iter();
    for (b, block) in syntax.globals.iter().enumerate() {
        for d in 0..block.decls.len() {
            checker
                .globals
                .insert((b, d), (Progress::Done, globals.next().copied()));
        }
    }
    let mut scope = Scope::default();
    if let Some(name) = pou {
        let Some(id) = project.find_pou(name) else {
            let problem =
                crate::diag::Problem::general("E501", format!("there is no program `{name}`"));
            return Err(finish_all(vec![problem], &sources));
        };
        scope.space.clone_from(&project.pou(id).name);
        scope.pou = (project.pou(id).kind != PouKind::Function).then_some(id);
        for var in &project.pou(id).vars {
            scope.names.insert(key(&project.var(*var).name), *var);
        }
    }
    checker.current = scope;
    let expr = checker.expr(&parsed, Some(TypeId::BOOL));
    let expr = checker.settle(expr);
    if checker.problems.is_empty() {
        Ok(expr)
    } else {
        Err(finish_all(checker.problems, &sources))
    }
}

/// The value of an expression without calls of user functions; `load` gives the values of variables.
pub fn evaluate(
    project: &TypedProject,
    expr: &Expr,
    load: &dyn Fn(&Place) -> Option<Value>,
) -> Result<Value, Fault> {
    let elem = |e: &Expr| project.types.elem(e.ty).ok_or(Fault::Types);
    match &expr.kind {
        ExprKind::Const(value) => Ok(*value),
        ExprKind::Load(place) => load(place).ok_or(Fault::Types),
        ExprKind::Unary(op, inner) => {
            value::unary(*op, elem(inner)?, evaluate(project, inner, load)?)
        }
        ExprKind::Binary(op, ty, left, right) => {
            let left = evaluate(project, left, load)?;
            value::binary(*op, *ty, left, evaluate(project, right, load)?)
        }
        ExprKind::Convert(inner) => {
            value::convert(elem(inner)?, elem(expr)?, evaluate(project, inner, load)?)
        }
        ExprKind::Check(inner, limits) => {
            let value = evaluate(project, inner, load)?;
            let v = value.as_i128().ok_or(Fault::Types)?;
            let inside = match limits {
                Limits::Range(lo, hi) => (*lo..=*hi).contains(&v),
                Limits::Values(values) => values.iter().any(|n| i128::from(*n) == v),
            };
            if inside { Ok(value) } else { Err(Fault::Range) }
        }
        ExprKind::Std(fun, args) => {
            let args: Result<Vec<Value>, Fault> =
                args.iter().map(|a| evaluate(project, a, load)).collect();
            stdfun::evaluate(*fun, elem(expr)?, &args?)
        }
        ExprKind::Call(_)
        | ExprKind::Enabled(_)
        | ExprKind::Text(_)
        | ExprKind::AddressOf(_)
        | ExprKind::AddressIf(..) => Err(Fault::Types),
    }
}
