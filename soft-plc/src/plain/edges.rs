//! Edges of inputs: what the compiler keeps behind `CLK : BOOL R_EDGE`, as variables and statements of the POU.
//!
//! Callers set the input as before. Behind it stand `fam_rise_CLK`, which the POU's statements read in its place, and `fam_last_CLK`, the
//! input in the call before: in the memory where the compiler puts them.

use std::collections::{BTreeMap, BTreeSet};

use crate::syntax::ast::{Edge, Init, Pou, Project, VarBlock, VarDecl, VarSection};
use crate::syntax::build::{At, block};

/// Stands before the name of an input where its level is meant.
pub const RAW: &str = "__raw_";

/// The variables that stand for inputs with edges, by the input's name in upper case; those of bases included.
pub fn seen(project: &Project, pou: &Pou) -> BTreeMap<String, String> {
    let mut seen = BTreeMap::new();
    let mut visited = BTreeSet::new();
    let mut next = Some(pou);
    while let Some(pou) = next.filter(|p| visited.insert(p.name.name.to_ascii_uppercase())) {
        for decl in pou.vars.iter().flat_map(|b| &b.decls) {
            if let Some(edge) = decl.edge {
                seen.insert(decl.name.name.to_ascii_uppercase(), edge_name(decl, edge));
            }
        }
        let base = pou.class.extends.as_ref();
        next = base.and_then(|base| {
            let mut pous = project.pous.iter();
            pous.find(|p| p.name.name.eq_ignore_ascii_case(&base.name))
        });
    }
    seen
}

fn edge_name(decl: &VarDecl, edge: Edge) -> String {
    match edge {
        Edge::Rising => format!("__rise_{}", decl.name.name),
        Edge::Falling => format!("__fall_{}", decl.name.name),
    }
}

/// Declares the variables behind their inputs, and keeps them up to date before the POU's statements.
pub fn write_out(pou: &mut Pou) {
    let mut statements = Vec::new();
    let mut vars: Vec<VarBlock> = Vec::new();
    for whole in std::mem::take(&mut pou.vars) {
        let mut part = VarBlock {
            decls: Vec::new(),
            ..whole.clone()
        };
        for mut decl in whole.decls {
            let edge = decl.edge.take();
            part.decls.push(decl.clone());
            let Some(edge) = edge else { continue };
            let at = At(decl.name.span);
            let name = &decl.name.name;
            let (seen, last) = (edge_name(&decl, edge), format!("__last_{name}"));
            let mut before = at.var(&last, "BOOL");
            before.init = (edge == Edge::Falling).then(|| Init::Expr(at.bool(true)));
            let raw = || at.name(&format!("{RAW}{name}"));
            let rises = match edge {
                Edge::Rising => at.and(raw(), at.not(at.name(&last))),
                Edge::Falling => at.and(at.name(&last), at.not(raw())),
            };
            statements.push(at.assign(at.name(&seen), rises));
            statements.push(at.assign(at.name(&last), raw()));
            let rest = VarBlock {
                decls: Vec::new(),
                ..part.clone()
            };
            vars.push(std::mem::replace(&mut part, rest));
            let own = vec![at.var(&seen, "BOOL"), before];
            vars.push(block(VarSection::Local, own));
        }
        vars.push(part);
    }
    pou.vars = vars;
    statements.append(&mut pou.body);
    pou.body = statements;
}
