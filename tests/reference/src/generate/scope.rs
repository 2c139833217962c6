//! What a POU can read and write, and how random parts of it are named.

use super::{Ty, World};

/// A part of a path: text, or an index within these bounds.
#[derive(Clone, Debug)]
pub enum Seg {
    Text(String),
    Index(Vec<(i64, i64)>),
}

/// A variable or a part of one.
#[derive(Clone, Debug)]
pub struct Leaf {
    pub path: Vec<Seg>,
    pub ty: Ty,
    pub write: bool,
    /// Whether it has a lasting cell that a reference can lead to.
    pub refer: bool,
    /// Whether it lies behind a reference.
    pub behind: bool,
}

#[derive(Clone, Debug, Default)]
pub struct Scope {
    pub leaves: Vec<Leaf>,
    /// Integer variables that loops count with; nothing else writes them.
    pub counters: Vec<String>,
    pub counters_used: usize,
    pub loops: u32,
    /// Arrays and structures in the process image, which are used whole in assignments only.
    pub located: Vec<(String, super::Ty)>,
    /// Methods of the instance itself, with the words before them.
    pub methods: Vec<(String, super::Callable)>,
    /// How many functions and function blocks may be used (those made before this POU).
    pub functions: usize,
    pub blocks: usize,
    /// How deep expressions are nested in calls: calls stop early.
    pub calls: u32,
}

impl World {
    /// Makes a variable and its parts known.
    pub fn enter(&self, scope: &mut Scope, name: &str, ty: &Ty, write: bool, refer: bool) {
        let path = vec![Seg::Text(name.to_owned())];
        self.add(
            scope,
            Leaf {
                path,
                ty: ty.clone(),
                write,
                refer,
                behind: false,
            },
            3,
        );
    }

    fn add(&self, scope: &mut Scope, leaf: Leaf, depth: u32) {
        scope.leaves.push(leaf.clone());
        if depth == 0 {
            return;
        }
        let part = |seg: Seg, ty: &Ty, write: bool, refer: bool| {
            let mut path = leaf.path.clone();
            path.push(seg);
            Leaf {
                path,
                ty: ty.clone(),
                write,
                refer,
                behind: leaf.behind,
            }
        };
        match &leaf.ty {
            Ty::Array(elem, dims) => {
                let packed = matches!(**elem, Ty::El(e) if e.bits() <= 8)
                    || matches!(**elem, Ty::Enum(1) | Ty::Sub(_));
                let next = part(
                    Seg::Index(dims.clone()),
                    elem,
                    leaf.write,
                    leaf.refer && !packed,
                );
                self.add(scope, next, depth - 1);
            }
            Ty::Struct(n) => {
                for (name, ty) in &self.structs[*n].fields {
                    let next = part(Seg::Text(format!(".{name}")), ty, leaf.write, leaf.refer);
                    self.add(scope, next, depth - 1);
                }
            }
            Ty::Block(n) => {
                let call = &self.blocks[*n].call;
                for (name, ty) in &call.inputs {
                    let next = part(Seg::Text(format!(".{name}")), ty, true, leaf.refer);
                    self.add(scope, next, depth - 1);
                }
                for (name, ty) in &call.outputs {
                    let next = part(Seg::Text(format!(".{name}")), ty, false, leaf.refer);
                    self.add(scope, next, depth - 1);
                }
            }
            Ty::Ref(to) => {
                let mut next = part(Seg::Text("^".to_owned()), to, true, true);
                next.behind = true;
                self.add(scope, next, 1);
            }
            _ => {}
        }
    }

    /// A random place for which `fits` holds.
    pub fn place(
        &mut self,
        scope: &mut Scope,
        depth: u32,
        fits: impl Fn(&Leaf) -> bool,
    ) -> Option<(String, Leaf)> {
        let risky = self.risky;
        let found: Vec<usize> = scope
            .leaves
            .iter()
            .enumerate()
            .filter(|(_, l)| (!l.behind || risky) && fits(l))
            .map(|(i, _)| i)
            .collect();
        if found.is_empty() {
            return None;
        }
        let leaf = scope.leaves[*self.random.one(&found)].clone();
        if leaf.behind {
            self.note("through a reference");
        }
        let text = self.path_text(scope, &leaf.path, depth);
        Some((text, leaf))
    }

    pub fn path_text(&mut self, scope: &mut Scope, path: &[Seg], depth: u32) -> String {
        let mut text = String::new();
        for seg in path {
            match seg {
                Seg::Text(part) => text.push_str(part),
                Seg::Index(dims) => {
                    let list: Vec<String> =
                        dims.iter().map(|d| self.index(scope, *d, depth)).collect();
                    text.push_str(&format!("[{}]", list.join(", ")));
                }
            }
        }
        text
    }

    fn index(&mut self, scope: &mut Scope, (low, high): (i64, i64), depth: u32) -> String {
        if depth == 0 || self.random.chance(60) {
            return self.random.within(low, high).to_string();
        }
        let counts = &super::types::COUNTS;
        let elem = *self.random.one(counts);
        if self.risky && self.random.chance(15) {
            self.note("unguarded index");
            return self.variable(scope, elem, 0);
        }
        self.note("computed index");
        let of = |v: i64| {
            let (least, most) = crate::value::limits(elem);
            (least..=most).contains(&i128::from(v))
        };
        if !of(low) || !of(high) {
            return self.random.within(low, high).to_string();
        }
        let value = self.elem_expr(scope, elem, depth - 1);
        format!("LIMIT({elem}#{low}, {value}, {elem}#{high})")
    }
}
