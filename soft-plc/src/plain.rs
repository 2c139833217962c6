//! POUs as plain Structured Text whose memory other compilers keep to themselves: charts, diagrams that remember something from scan
//! to scan, and edges of inputs (R_EDGE, F_EDGE).
//!
//! What the compiler lowers a chart into (`syntax::sfc`) is written out under names that everybody may use: a step is a structure of
//! the type FAM_STEP with its flag, its time, since when it is active, and its edges; what actions remember are variables of
//! the POU; the time comes from the function FAM_TIME. A diagram is written as the statements that it is read into (`plcopen::network`), with its
//! edges, outputs of blocks with EN, and wires as variables. An edge of an input is a variable and two statements (`plain::edges`). Every variable
//! has the type and the place that it has in the original, so that both forms have the same bytes.

mod edges;

use std::collections::{BTreeMap, BTreeSet};

use crate::check::tree::TypedProject;
use crate::plcopen::WHOLE_TEXT_NAMESPACE;
use crate::source::{SourceFile, Span};
use crate::syntax::ast::{
    Expr, Ident, Pou, PouKind, Project, Stmt, StmtKind, TypeSpecKind, VarDecl, VarSection,
};
use crate::syntax::build::{At, block};
use crate::syntax::print::{self, Words};
use crate::syntax::sfc::STEP_TYPE;
use crate::syntax::walk::each_body;

/// Name of the source that holds the type of steps.
const CHARTS: &str = "charts (generated)";
/// The library's function that tells the time.
pub const TIME: &str = "FAM_TIME";
/// A step's fields: as charts have them, and as they are written.
const FIELDS: [(&str, &str); 6] = [
    ("X", "BOOL"),
    ("T", "TIME"),
    ("began", "TIME"),
    ("before", "BOOL"),
    ("rose", "BOOL"),
    ("fell", "BOOL"),
];
const HIDDEN_FIELDS: [(&str, &str); 4] = [
    ("__start", "began"),
    ("__last", "before"),
    ("__rise", "rose"),
    ("__fall", "fell"),
];

/// The sources with every such POU as plain statements, where it stood; `None` if there are none. The type of steps stands in a
/// source of its own, the last one.
pub fn plain(
    project: &Project,
    typed: &TypedProject,
    files: &[SourceFile],
) -> Option<Vec<SourceFile>> {
    let names = Names::of(project);
    // Of each file the places where something goes, and what.
    let mut edits: BTreeMap<usize, BTreeMap<(u32, u32), String>> = BTreeMap::new();
    let is_hidden = |pou: &&Pou| has_hidden_memory(pou) || !edges::seen(project, pou).is_empty();
    let wanted: BTreeSet<_> = project.pous.iter().filter(is_hidden).map(place).collect();
    let mut has_steps = false;
    // Several POUs may stand in one place, an element of an XML file.
    for pou in project.pous.iter().filter(|p| wanted.contains(&place(p))) {
        let place = pou.place;
        has_steps |= is_chart(pou);
        let source = project.sources.get(place.source);
        let mut same = files.iter();
        let file = same.position(|f| f.name == source.name && f.text == source.text)?;
        let places = edits.entry(file).or_default();
        let text = places.entry((place.start, place.end)).or_default();
        text.push_str(&names.text(project, pou, typed));
    }
    if edits.is_empty() {
        return None;
    }
    let mut out = files.to_vec();
    for (file, places) in edits {
        let text = &mut out[file].text;
        let is_xml = crate::plcopen::is_xml(text);
        for ((start, end), new) in places.into_iter().rev() {
            let new = if is_xml { element(&new) } else { new };
            text.replace_range(start as usize..end as usize, &new);
        }
    }
    if !has_steps {
        return Some(out);
    }
    let mut step = format!("TYPE\n    {} : STRUCT\n", names.step);
    for (name, ty) in FIELDS {
        step.push_str(&format!("        {name} : {ty};\n"));
    }
    step.push_str("    END_STRUCT;\nEND_TYPE\n");
    out.push(SourceFile::new(CHARTS, step));
    Some(out)
}

fn place(pou: &Pou) -> (u32, u32, u32) {
    let Span { source, start, end } = pou.place;
    (source, start, end)
}

/// Whether a chart or a diagram keeps something under a name that no text can have.
fn has_hidden_memory(pou: &Pou) -> bool {
    let kept = pou.vars.iter().filter(|b| b.section == VarSection::Local);
    is_chart(pou)
        || pou.kind != PouKind::Function
            && kept
                .flat_map(|b| &b.decls)
                .any(|d| d.name.name.starts_with("__"))
}

fn is_chart(pou: &Pou) -> bool {
    let mut decls = pou.vars.iter().flat_map(|b| &b.decls);
    decls.any(|d| matches!(&d.spec.kind, TypeSpecKind::Named(ty) if ty.name == STEP_TYPE))
}

/// A POU of PLCopen XML as nothing but its text.
fn element(text: &str) -> String {
    let text = text.replace("]]>", "]]]]><![CDATA[>");
    format!(
        "<pou name=\"plain\"><addData><data name=\"{WHOLE_TEXT_NAMESPACE}\" handleUnknown=\"preserve\"><st xmlns=\"{WHOLE_TEXT_NAMESPACE}\"><![CDATA[{text}]]></st></data></addData></pou>"
    )
}

/// The names that hidden ones are written under; nothing else in the project has them.
struct Names {
    step: String,
    prefix: String,
}

impl Names {
    fn of(project: &Project) -> Names {
        let mut taken: BTreeSet<String> = BTreeSet::new();
        let mut add = |name: &Ident| taken.insert(name.name.to_ascii_uppercase());
        for decl in &project.types {
            add(&decl.name);
        }
        for pou in &project.pous {
            add(&pou.name);
            let methods = pou.class.methods.iter();
            for part in methods.chain([pou]) {
                for decl in part.vars.iter().flat_map(|b| &b.decls) {
                    add(&decl.name);
                }
            }
        }
        for decl in project.globals.iter().flat_map(|b| &b.decls) {
            add(&decl.name);
        }
        let mut step = "FAM_STEP".to_owned();
        while taken.contains(&step) {
            step.push_str("_2");
        }
        let mut prefix = "fam_".to_owned();
        while taken
            .iter()
            .any(|t| t.starts_with(&prefix.to_ascii_uppercase()))
        {
            prefix.push_str("c_");
        }
        Names { step, prefix }
    }

    /// The plain name of anything.
    fn plain(&self, name: &str) -> String {
        if name == STEP_TYPE {
            return self.step.clone();
        }
        if name == "__MC_TIME" {
            return TIME.to_owned();
        }
        if let Some(raw) = name.strip_prefix(edges::RAW) {
            return raw.to_owned();
        }
        let Some(hidden) = name.strip_prefix("__") else {
            return name.to_owned();
        };
        match HIDDEN_FIELDS.iter().find(|(field, _)| *field == name) {
            Some((_, plain)) => (*plain).to_owned(),
            None => format!("{}{hidden}", self.prefix),
        }
    }

    fn text(&self, project: &Project, pou: &Pou, typed: &TypedProject) -> String {
        let wire = |name: &str| {
            let unit = typed.pou(typed.find_pou(&pou.name.name)?);
            let methods = unit.methods.iter().map(|(_, m)| typed.pou(*m));
            let vars = methods.chain([unit]).flat_map(|u| &u.vars);
            let mut vars = vars.map(|v| typed.var(*v));
            let var = vars.find(|v| v.name.eq_ignore_ascii_case(name))?;
            Some(typed.type_name(var.ty))
        };
        let seen = edges::seen(project, pou);
        let words = Words {
            name: &|name| self.plain(name),
            variable: &|name| Some(self.plain(seen.get(&name.to_ascii_uppercase())?)),
            wire: &wire,
        };
        let what = if is_chart(pou) {
            "a sequential function chart"
        } else if has_hidden_memory(pou) {
            "a diagram"
        } else {
            "edges of inputs"
        };
        let mut pou = pou.clone();
        let mut left = Vec::new();
        pou.body = without_blocks(std::mem::take(&mut pou.body), &mut left);
        pou.vars.push(block(VarSection::Temp, left));
        edges::write_out(&mut pou);
        format!(
            "(* {}: {what}, written out in plain statements. *)\n{}",
            pou.name.name,
            print::pou(&pou, &words)
        )
    }
}

/// Actions whose RETURN leaves the action alone become loops that run once, which EXIT leaves. `left` gets the flags that loops
/// inside of them need.
fn without_blocks(list: Vec<Stmt>, left: &mut Vec<VarDecl>) -> Vec<Stmt> {
    let mut out = Vec::new();
    for mut stmt in list {
        if let StmtKind::Block(body) = stmt.kind {
            out.extend(action(At(stmt.span), body, left));
            continue;
        }
        each_body(&mut stmt.kind, &mut |body| {
            *body = without_blocks(std::mem::take(body), left);
        });
        out.push(stmt);
    }
    out
}

fn action(at: At, body: Vec<Stmt>, left: &mut Vec<VarDecl>) -> Vec<Stmt> {
    if !returns(&body) {
        return body;
    }
    let flag = format!("__left{}", left.len());
    let mut is_used = false;
    let body = leaving(body, at.name(&flag), 0, &mut is_used);
    let mut out = Vec::new();
    if is_used {
        left.push(at.var(&flag, "BOOL"));
        out.push(at.assign(at.name(&flag), at.bool(false)));
    }
    out.push(at.stmt(StmtKind::Repeat(body, at.bool(true))));
    out
}

/// RETURN as EXIT; out of `loops` loops inside the action by way of the flag.
fn leaving(list: Vec<Stmt>, flag: Expr, loops: u32, is_used: &mut bool) -> Vec<Stmt> {
    let mut out = Vec::new();
    for mut stmt in list {
        let at = At(stmt.span);
        if matches!(stmt.kind, StmtKind::Return) {
            if loops > 0 {
                *is_used = true;
                out.push(at.assign(flag.clone(), at.bool(true)));
            }
            out.push(at.stmt(StmtKind::Exit));
            continue;
        }
        let is_loop = matches!(
            stmt.kind,
            StmtKind::For(_) | StmtKind::While(..) | StmtKind::Repeat(..)
        );
        let mut is_left = false;
        each_body(&mut stmt.kind, &mut |body| {
            is_left |= is_loop && returns(body);
            let inside = std::mem::take(body);
            *body = leaving(inside, flag.clone(), loops + u32::from(is_loop), is_used);
        });
        out.push(stmt);
        if is_left {
            out.push(at.if_then(flag.clone(), vec![at.stmt(StmtKind::Exit)]));
        }
    }
    out
}

fn returns(list: &[Stmt]) -> bool {
    list.iter().any(|stmt| match &stmt.kind {
        StmtKind::Return => true,
        StmtKind::If(branches, otherwise) => {
            branches.iter().any(|(_, b)| returns(b)) || returns(otherwise)
        }
        StmtKind::Case(_, branches, otherwise) => {
            branches.iter().any(|(_, b)| returns(b))
                || otherwise.as_ref().is_some_and(|o| returns(o))
        }
        StmtKind::For(head) => returns(&head.body),
        StmtKind::While(_, body) | StmtKind::Repeat(body, _) | StmtKind::Block(body) => {
            returns(body)
        }
        _ => false,
    })
}
