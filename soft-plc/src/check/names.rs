//! What a name stands for that is declared outside of POUs: namespaces, USING, INTERNAL (IEC 61131-3, clause 6.9).
//!
//! A name is looked for in the namespace of the text that uses it, then in those that this text names in USING, then the same
//! one namespace further out, up to the names outside of any. A path `a.b.Name` is looked for in the same way, from `a` on.

use std::collections::BTreeSet;

use crate::check::{Checker, Declared, Dialect, key};
use crate::diag::Problem;
use crate::syntax::ast::{self, Access};
use crate::syntax::parse_expr::dotted;
use crate::types::TypeId;

/// Namespaces and who may see what is in them; all in upper case.
#[derive(Debug, Default)]
pub(super) struct Spaces {
    paths: BTreeSet<String>,
    /// Namespaces that only the one around them sees.
    internal: BTreeSet<String>,
    /// POUs that only their own namespace sees.
    hidden: BTreeSet<String>,
    /// Where USING stands, and what it names.
    usings: Vec<(String, String)>,
}

/// The namespace that something of this name stands in; of a namespace the one around it.
fn around(name: &str) -> &str {
    name.rsplit_once('.').map_or("", |(space, _)| space)
}

/// The path itself and all around it, the empty one last.
fn outwards(path: &str) -> impl Iterator<Item = &str> {
    std::iter::successors(Some(path), |p| (!p.is_empty()).then(|| around(p)))
}

fn join(space: &str, name: &str) -> String {
    match space {
        "" => name.to_owned(),
        _ => format!("{space}.{name}"),
    }
}

impl Checker<'_> {
    pub(super) fn collect_spaces(&mut self) {
        let project = self.project;
        let spaces = &mut self.spaces;
        for space in &project.namespaces {
            spaces.paths.insert(key(&space.path));
            if space.internal {
                spaces.internal.insert(key(&space.path));
            }
        }
        for pou in &project.pous {
            let name = key(&pou.name.name);
            // Those of a PLCopen file have no NAMESPACE around them.
            let paths = outwards(&name).skip(1).filter(|p| !p.is_empty());
            spaces.paths.extend(paths.map(str::to_owned));
            if pou.class.access == Access::Internal {
                spaces.hidden.insert(name);
            }
        }
        for using in &project.usings {
            let (within, path) = (key(&using.within), key(&using.path.name));
            let found = outwards(&within)
                .map(|space| join(space, &path))
                .find(|p| spaces.paths.contains(p));
            match found {
                Some(path) => spaces.usings.push((within, path)),
                None => {
                    let message = format!("there is no namespace `{}`", using.path.name);
                    let problem = Problem::error("E235", using.path.span, message);
                    self.problems.push(problem);
                }
            }
        }
    }

    /// What a name or path stands for in the text that is being looked at.
    pub(super) fn lookup(&self, name: &str) -> Option<Declared> {
        self.lookup_in(&self.current.space, name)
    }

    pub(super) fn lookup_in(&self, space: &str, name: &str) -> Option<Declared> {
        let name = key(name);
        if self.spaces.paths.is_empty() && !name.contains('.') {
            return self.names.get(&name).copied();
        }
        let space = key(space);
        for at in outwards(&space) {
            let own = join(at, &name);
            if let Some(found) = self.names.get(&own)
                && self.sees(&space, &own)
            {
                return Some(*found);
            }
            let used = self.used(at, &space, &name);
            if !used.is_empty() {
                // Of several none is meant.
                return self
                    .names
                    .get(&used[0])
                    .copied()
                    .filter(|_| used.len() == 1);
            }
        }
        // CODESYS writes the name of a library before what is in it.
        let (prefix, last) = name.rsplit_once('.')?;
        let is_library = self.options.dialect == Dialect::Codesys && !self.is_space(prefix);
        is_library.then(|| self.lookup_in("", last)).flatten()
    }

    /// Full names that the USINGs at one place lead to.
    fn used(&self, at: &str, from: &str, name: &str) -> Vec<String> {
        let here = self.spaces.usings.iter().filter(|(w, _)| w == at);
        let all: BTreeSet<String> = here
            .map(|(_, path)| join(path, name))
            .filter(|full| self.names.contains_key(full) && self.sees(from, full))
            .collect();
        all.into_iter().collect()
    }

    /// Whether a text in `space` may use what has the full name.
    fn sees(&self, space: &str, full: &str) -> bool {
        let inside = |of: &str| of.is_empty() || outwards(space).any(|s| s == of);
        let mut closed = outwards(around(full)).filter(|s| self.spaces.internal.contains(*s));
        closed.all(|s| inside(around(s)))
            && (!self.spaces.hidden.contains(full) || inside(around(full)))
    }

    /// Whether both stand in one namespace, as INTERNAL methods ask for.
    pub(super) fn same_space(&self, one: &str, from: &str) -> bool {
        let (one, from) = (key(one), key(from));
        let of = outwards(&one).find(|s| s.is_empty() || self.spaces.paths.contains(*s));
        let of = of.unwrap_or_default();
        of.is_empty() || outwards(&from).any(|s| s == of)
    }

    fn is_space(&self, path: &str) -> bool {
        let (path, space) = (key(path), key(&self.current.space));
        outwards(&space).any(|s| self.spaces.paths.contains(&join(s, &path)))
    }

    pub(super) fn is_namespace(&mut self, base: &ast::Expr) -> bool {
        if self.spaces.paths.is_empty() {
            return false;
        }
        let mut first = base;
        while let ast::ExprKind::Field(of, _) = &first.kind {
            first = of;
        }
        let ast::ExprKind::Name(name) = &first.kind else {
            return false;
        };
        self.find_var(name).is_none() && dotted(base).is_some_and(|path| self.is_space(&path))
    }

    /// `Space.Inner.name` as a name with its path, if the base is a namespace.
    pub(super) fn with_path(&mut self, base: &ast::Expr, name: &ast::Ident) -> Option<String> {
        if !self.is_namespace(base) {
            return None;
        }
        Some(format!("{}.{}", dotted(base)?, name.name))
    }

    /// Of enumerations that have a value of the same name those whose namespace is at hand.
    pub(super) fn nearest(&self, found: &[(TypeId, i64)]) -> Vec<(TypeId, i64)> {
        if found.len() < 2 || self.spaces.paths.is_empty() {
            return found.to_vec();
        }
        let space = key(&self.current.space);
        for at in outwards(&space) {
            let here = found.iter().copied().filter(|(ty, _)| {
                let name = self.types.get(*ty).name.as_deref().unwrap_or_default();
                let own = key(name);
                let own = around(&own);
                let used = |(within, path): &(String, String)| within == at && path == own;
                own == at || self.spaces.usings.iter().any(used)
            });
            let here: Vec<_> = here.collect();
            if !here.is_empty() {
                return here;
            }
        }
        found.to_vec()
    }

    /// Why a name that exists somewhere is none here: what to write instead.
    pub(super) fn elsewhere(&self, name: &str) -> Option<String> {
        let tail = format!(".{}", key(name));
        let space = key(&self.current.space);
        let ends =
            |full: &&String| full.ends_with(&tail) || (name.contains('.') && full[..] == tail[1..]);
        let all: Vec<&String> = self.names.keys().filter(ends).collect();
        let (seen, hidden): (Vec<&String>, Vec<&String>) =
            all.into_iter().partition(|full| self.sees(&space, full));
        match (seen.as_slice(), hidden.as_slice()) {
            ([], []) => None,
            ([], [hidden, ..]) => Some(format!("{hidden} is INTERNAL to its namespace")),
            (seen, _) => {
                let seen: Vec<&str> = seen.iter().map(|s| s.as_str()).collect();
                Some(format!(
                    "write its namespace before it: {}",
                    seen.join(" or ")
                ))
            }
        }
    }
}
