//! Global variables that one program writes and others read: MCs share no memory, so that the one exports them and the others
//! have them as inputs.

use crate::import::Part;
use fam_soft_plc::check::IMAGE_BYTES_MAX;
use fam_soft_plc::check::tree::{Location, Root, TypedProject, VarId, visit_places};
use fam_soft_plc::image::scalars;
use fam_soft_plc::syntax::ast::{Ident, Project};
use fam_soft_plc::types::Elem;

/// A variable that goes from one MC to others.
pub(crate) struct Exchange {
    pub var: VarId,
    /// The place of the MC that writes it, among the parts.
    pub from: usize,
    /// Those that read it.
    pub to: Vec<usize>,
}

impl Exchange {
    /// All MCs that have it.
    pub fn users(&self) -> impl Iterator<Item = usize> {
        std::iter::once(self.from).chain(self.to.iter().copied())
    }
}

/// What can be exchanged: variables of an elementary type with a single writer. An output that nobody writes stays with the first.
pub(crate) fn exchanges(typed: &TypedProject, parts: &[Part]) -> Vec<Exchange> {
    let mut list = Vec::new();
    for id in &typed.globals {
        let var = typed.var(*id);
        let users: Vec<usize> = (0..parts.len())
            .filter(|p| parts[*p].globals.contains(id))
            .collect();
        let mut writers = users.iter().filter(|p| parts[**p].written.contains(id));
        let is_input = var.location.is_some_and(|l| !l.output);
        if users.len() < 2 || var.constant || is_input || elem(typed, *id).is_none() {
            continue;
        }
        let from = match (writers.next(), writers.next()) {
            (Some(only), None) => *only,
            (None, _) if var.location.is_some() => users[0],
            _ => continue,
        };
        let to = users.into_iter().filter(|u| *u != from).collect();
        list.push(Exchange { var: *id, from, to });
    }
    list
}

/// The elementary type that a process image can hold.
fn elem(typed: &TypedProject, id: VarId) -> Option<Elem> {
    typed
        .types
        .elem(typed.var(id).ty)
        .filter(|elem| *elem != Elem::Ref)
}

/// The project with exchanged variables in the process image of this MC, behind what lies there already.
pub(crate) fn placed(
    project: &Project,
    typed: &TypedProject,
    part: &Part,
    index: usize,
    exchanges: &[&Exchange],
) -> Project {
    let mut project = project.clone();
    let mut free = free(typed, part);
    for exchange in exchanges {
        let var = typed.var(exchange.var);
        let is_output = exchange.from == index;
        if is_output && var.location.is_some_and(|l| !l.memory) {
            continue;
        }
        let Some(elem) = elem(typed, exchange.var) else {
            continue;
        };
        let next = &mut free[usize::from(is_output)];
        let location = behind(next, elem, is_output);
        let mut decls = project.globals.iter_mut().flat_map(|b| &mut b.decls);
        if let Some(decl) = decls.find(|d| d.name.name.eq_ignore_ascii_case(&var.name)) {
            decl.location = Some(Ident {
                name: location.to_string(),
                span: decl.name.span,
            });
            if !is_output {
                decl.init = None;
            }
        }
    }
    project
}

/// The first free bytes of the MC's inputs and outputs. What lies at foreign addresses, at the end of the image, does not count.
fn free(typed: &TypedProject, part: &Part) -> [u32; 2] {
    let mut free = [0; 2];
    let mut takes = |location: Location, bytes: u32| {
        let end = location.byte + bytes;
        if !location.memory && end <= IMAGE_BYTES_MAX / 2 {
            let free = &mut free[usize::from(location.output)];
            *free = (*free).max(end);
        }
    };
    let inner = part.pous.iter().flat_map(|p| typed.pou(*p).vars.iter());
    for id in part.globals.iter().chain(inner) {
        for scalar in scalars(typed, typed.var(*id)) {
            takes(scalar.location, scalar.elem.image_bytes());
        }
    }
    for pou in &part.pous {
        visit_places(&typed.pou(*pou).body, &mut |place| {
            if let Root::Direct(location) = place.root {
                takes(location, 8);
            }
        });
    }
    free
}

/// The next place for a value.
fn behind(free: &mut u32, elem: Elem, output: bool) -> Location {
    let bytes = elem.image_bytes();
    let byte = free.next_multiple_of(bytes);
    *free = byte + bytes;
    let (bit, size) = match (elem, bytes) {
        (Elem::Bool, _) => (Some(0), 'X'),
        (_, 1) => (None, 'B'),
        (_, 2) => (None, 'W'),
        (_, 4) => (None, 'D'),
        _ => (None, 'L'),
    };
    Location {
        output,
        memory: false,
        byte,
        bit,
        size,
    }
}
