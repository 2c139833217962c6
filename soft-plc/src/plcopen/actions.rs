//! Actions of a POU outside of a chart, which its body calls by their names.
//!
//! They become methods without parameters. One that uses what exists only while the body runs, VAR_IN_OUT and VAR_TEMP, stands in
//! the place of its calls instead.

use std::collections::BTreeSet;

use roxmltree::Node;

use super::{Reader, element, elements};
use crate::syntax::ast::{Class, Expr, ExprKind, Pou, PouKind, Stmt, StmtKind, VarSection};
use crate::syntax::walk::{each_body, each_expr};

impl Reader<'_> {
    /// Reads `<actions>` as methods.
    pub(super) fn actions(&mut self, pou_node: Node<'_, '_>, pou: &mut Pou) {
        for action in element(pou_node, "actions")
            .iter()
            .flat_map(|actions| elements(*actions, "action"))
        {
            let (Some(name), Some(inner)) = (self.name(action, "name"), element(action, "body"))
            else {
                continue;
            };
            let mut method = Pou {
                kind: PouKind::Method,
                name,
                result: None,
                vars: Vec::new(),
                body: Vec::new(),
                class: Class::default(),
                place: pou.place,
            };
            let mut holder = method.clone();
            method.body = self.statements_of(inner, &mut holder);
            // Variables of a diagram are kept with the POU.
            for block in holder.vars {
                if block.section == VarSection::Temp {
                    method.vars.push(block);
                } else {
                    pou.vars.push(block);
                }
            }
            pou.class.methods.push(method);
        }
    }
}

/// Puts the actions that need it in the place of their calls. `fleeting` are the names of VAR_IN_OUT and VAR_TEMP.
pub(super) fn put_in_place(pou: &mut Pou, fleeting: &BTreeSet<String>) {
    let mut needy = BTreeSet::new();
    loop {
        let more: Vec<String> = pou
            .class
            .methods
            .iter()
            .filter(|action| !needy.contains(&key(&action.name.name)))
            .filter(|action| {
                names(&action.body).any(|n| fleeting.contains(&n) || needy.contains(&n))
            })
            .map(|action| key(&action.name.name))
            .collect();
        if more.is_empty() {
            break;
        }
        needy.extend(more);
    }
    if needy.is_empty() {
        return;
    }
    let (mut inner, outer): (Vec<Pou>, Vec<Pou>) = std::mem::take(&mut pou.class.methods)
        .into_iter()
        .partition(|action| needy.contains(&key(&action.name.name)));
    pou.class.methods = outer;
    for action in &mut inner {
        pou.vars.append(&mut action.vars);
    }
    replace(&mut pou.body, &inner, &mut Vec::new());
}

/// Puts actions in the place of their calls, except inside of themselves.
fn replace(body: &mut [Stmt], actions: &[Pou], around: &mut Vec<String>) {
    for stmt in body {
        if let StmtKind::Call(call) = &stmt.kind
            && let Some(name) = called(call).filter(|name| !around.contains(name))
            && let Some(action) = actions.iter().find(|a| key(&a.name.name) == name)
        {
            let mut statements = action.body.clone();
            around.push(name);
            replace(&mut statements, actions, around);
            around.pop();
            stmt.kind = StmtKind::Block(statements);
            continue;
        }
        each_body(&mut stmt.kind, &mut |body| replace(body, actions, around));
    }
}

/// What a call without arguments calls: `Act()` or `THIS.Act()`.
fn called(call: &Expr) -> Option<String> {
    let ExprKind::Call(callee, args) = &call.kind else {
        return None;
    };
    match &callee.kind {
        _ if !args.is_empty() => None,
        ExprKind::Name(name) => Some(key(name)),
        ExprKind::Field(of, name) => {
            let this = match &of.kind {
                ExprKind::Deref(inner) => &inner.kind,
                kind => kind,
            };
            matches!(this, ExprKind::Name(this) if key(this) == "THIS").then(|| key(&name.name))
        }
        _ => None,
    }
}

fn names(body: &[Stmt]) -> impl Iterator<Item = String> {
    let mut found = BTreeSet::new();
    each_expr(body, &mut |expr| match &expr.kind {
        ExprKind::Name(name) => {
            found.insert(key(name));
        }
        ExprKind::Field(_, name) => {
            found.insert(key(&name.name));
        }
        _ => {}
    });
    found.into_iter()
}

fn key(name: &str) -> String {
    name.to_ascii_uppercase()
}
