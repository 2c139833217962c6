//! Object orientation (IEC 61131-3 third edition, clause 6.6.5 to 6.6.8): inheritance, methods, interfaces; and the edges of
//! inputs, which add variables to function blocks too.

use crate::check::tree::{
    Expr, ExprKind, InitValue, Interface, Place, PouId, Root, Stmt, StmtKind, Var, VarId,
};
use crate::check::{Checker, Declared, key};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{self, Edge, PouKind, VarSection};
use crate::types::{Elem, InterfaceId, TypeId, TypeKind};

/// Name of the hidden first variable of function blocks with relatives.
const TAG: &str = "__TYPE";

impl<'p> Checker<'p> {
    /// Methods become POUs of their own, with the name `Block.Method`.
    pub(super) fn collect_methods(&mut self) {
        let blocks: Vec<PouId> = (0..self.pous.len() as u32).map(PouId).collect();
        for block in blocks {
            let syntax = self.syntaxes[block.0 as usize];
            for method in &syntax.class.methods {
                let id = self.add_method(&syntax.name.name, method);
                self.pous[id.0 as usize].instance_of = Some(block);
                let own = &mut self.pous[block.0 as usize].methods;
                let name = key(&method.name.name);
                let twice = own.iter().any(|(n, _)| *n == name);
                own.push((name, id));
                if twice {
                    self.method_twice(&method.name);
                }
            }
        }
        let project = self.project;
        for interface in &project.interfaces {
            let mut methods = Vec::new();
            for method in &interface.methods {
                let id = self.add_method(&interface.name.name, method);
                if methods.iter().any(|(n, _)| *n == key(&method.name.name)) {
                    self.method_twice(&method.name);
                }
                methods.push((key(&method.name.name), id));
            }
            self.interfaces.push(Interface {
                name: interface.name.name.clone(),
                methods,
            });
        }
    }

    fn method_twice(&mut self, name: &ast::Ident) {
        let message = format!("the method `{}` is declared twice", name.name);
        self.report(Problem::error("E201", name.span, message));
    }

    fn add_method(&mut self, owner: &str, method: &'p ast::Pou) -> PouId {
        let id = PouId(self.pous.len() as u32);
        self.add_pou(method, false);
        self.pous[id.0 as usize].name = format!("{owner}.{}", method.name.name);
        id
    }

    /// Who is derived from whom and implements what.
    pub(super) fn resolve_classes(&mut self) {
        let project = self.project;
        for (index, interface) in project.interfaces.iter().enumerate() {
            // Bases first; a circle ends when nothing new comes.
            let mut todo: Vec<&ast::Ident> = interface.extends.iter().collect();
            let mut seen = vec![index];
            while let Some(base) = todo.pop() {
                match self.lookup_in(&interface.name.name, &base.name) {
                    Some(Declared::Interface(id)) if !seen.contains(&(id.0 as usize)) => {
                        seen.push(id.0 as usize);
                        let more = &project.interfaces[id.0 as usize];
                        todo.extend(&more.extends);
                        for method in &more.methods {
                            let name = key(&method.name.name);
                            let inherited = self.interfaces[id.0 as usize]
                                .methods
                                .iter()
                                .find(|(n, _)| *n == name)
                                .cloned();
                            let own = &mut self.interfaces[index].methods;
                            if !own.iter().any(|(n, _)| *n == name) {
                                own.extend(inherited);
                            }
                        }
                    }
                    Some(Declared::Interface(_)) => {}
                    _ => self.no_interface(base),
                }
            }
        }
        for index in 0..self.pous.len() {
            let class = &self.syntaxes[index].class;
            if let Some(base) = &class.extends {
                let space = self.pous[index].name.clone();
                match self.lookup_in(&space, &base.name) {
                    Some(Declared::Pou(id)) if self.pou(id).kind == PouKind::FunctionBlock => {
                        self.pous[index].extends = Some(id);
                    }
                    _ => {
                        let message = format!("there is no function block `{}`", base.name);
                        self.report(Problem::error("E230", base.span, message));
                    }
                }
            }
            for name in &class.implements {
                let space = self.pous[index].name.clone();
                match self.lookup_in(&space, &name.name) {
                    Some(Declared::Interface(id)) => self.pous[index].implements.push(id),
                    _ => self.no_interface(name),
                }
            }
        }
        self.refuse_circles();
        // What the base implements, the derived one implements too.
        for index in 0..self.pous.len() {
            let mut base = self.pous[index].extends;
            while let Some(id) = base {
                let inherited = self.pou(id).implements.clone();
                for interface in inherited {
                    if !self.pous[index].implements.contains(&interface) {
                        self.pous[index].implements.push(interface);
                    }
                }
                base = self.pou(id).extends;
            }
        }
    }

    fn no_interface(&mut self, name: &ast::Ident) {
        let message = format!("there is no interface `{}`", name.name);
        self.report(Problem::error("E231", name.span, message));
    }

    fn refuse_circles(&mut self) {
        for index in 0..self.pous.len() {
            let mut at = self.pous[index].extends;
            let mut steps = 0;
            while let Some(id) = at {
                steps += 1;
                if id.0 as usize == index || steps > self.pous.len() {
                    let span = self.pous[index].name_span;
                    let message = format!("{} is derived from itself", self.pous[index].name);
                    self.report(Problem::error("E230", span, message));
                    self.pous[index].extends = None;
                    break;
                }
                at = self.pou(id).extends;
            }
        }
    }

    /// The hidden first variable of function blocks that have a base, are one, or implement an interface.
    pub(super) fn declare_tag(&mut self, id: PouId, syntax: &ast::Pou) {
        if syntax.kind != PouKind::FunctionBlock || self.pou(id).tag.is_some() {
            return;
        }
        let related = self.pou(id).extends.is_some()
            || !self.pou(id).implements.is_empty()
            || self.pous.iter().any(|p| p.extends == Some(id));
        if !related {
            return;
        }
        let var = VarId(self.vars.len() as u32);
        self.vars.push(Var {
            name: TAG.to_owned(),
            ty: TypeId::of(Elem::Dint),
            section: VarSection::Local,
            constant: false,
            retain: false,
            location: None,
            open_input: false,
            open_output: false,
            init: None,
            owner: Some(id),
            span: syntax.name.span,
        });
        let pou = &mut self.pous[id.0 as usize];
        pou.vars.insert(0, var);
        pou.tag = Some(var);
    }

    /// `CLK : BOOL R_EDGE`: the body sees an edge where callers set a level.
    pub(super) fn declare_edge(&mut self, pou: PouId, raw: VarId, edge: Edge, decl: &ast::VarDecl) {
        let span = decl.name.span;
        let fits =
            self.pou(pou).kind == PouKind::FunctionBlock || self.pou(pou).kind == PouKind::Program;
        if !fits || self.var(raw).ty != TypeId::BOOL || self.var(raw).section != VarSection::Input {
            self.report(Problem::error(
                "E232",
                span,
                "only BOOL inputs of function blocks and programs have edges",
            ));
            return;
        }
        let mark = match edge {
            Edge::Rising => "rise",
            Edge::Falling => "fall",
        };
        let add = |checker: &mut Self, name: String, init: bool| {
            let id = VarId(checker.vars.len() as u32);
            checker.vars.push(Var {
                name,
                ty: TypeId::BOOL,
                section: VarSection::Local,
                constant: false,
                retain: false,
                location: None,
                open_input: false,
                open_output: false,
                init: init.then_some(InitValue::Scalar(crate::value::Value::Bool(true))),
                owner: Some(pou),
                span,
            });
            checker.pous[pou.0 as usize].vars.push(id);
            id
        };
        let seen = add(self, format!("__{mark}_{}", decl.name.name), false);
        add(
            self,
            format!("__last_{}", decl.name.name),
            edge == Edge::Falling,
        );
        self.current.names.insert(key(&decl.name.name), seen);
    }

    /// What keeps the edges of inputs up to date, before the body.
    pub(super) fn edge_calls(&mut self, pou: PouId) -> Vec<Stmt> {
        let vars = self.pou(pou).vars.clone();
        let mut list = Vec::new();
        for (index, seen) in vars.iter().enumerate() {
            let name = self.var(*seen).name.clone();
            let rising = name.starts_with("__rise_");
            let owner = self.open_arrays.blocks.get(&pou).copied().unwrap_or(pou);
            if self.var(*seen).owner != Some(owner) || !(rising || name.starts_with("__fall_")) {
                continue;
            }
            let (raw, last) = (vars[index - 1], vars[index + 1]);
            let span = self.var(raw).span;
            let place = |id: VarId| Place {
                root: Root::Var(id),
                steps: Vec::new(),
                ty: TypeId::BOOL,
                span,
            };
            let load = |id: VarId| Expr {
                kind: ExprKind::Load(Box::new(place(id))),
                ty: TypeId::BOOL,
                span,
            };
            let (on, off) = if rising { (raw, last) } else { (last, raw) };
            let not = self.unary(ast::UnOp::Not, load(off), span);
            let edge = self.binary(ast::BinOp::And, load(on), not, span);
            for (target, value) in [(*seen, edge), (last, load(raw))] {
                list.push(Stmt {
                    kind: StmtKind::Assign(place(target), value),
                    span,
                });
            }
        }
        list
    }

    /// Rules between classes, once all are declared.
    pub(super) fn check_classes(&mut self) {
        for index in 0..self.pous.len() {
            let id = PouId(index as u32);
            if self.pou(id).kind != PouKind::FunctionBlock {
                continue;
            }
            if let Some(base) = self.pou(id).extends
                && self.pou(base).is_final
            {
                let span = self.pou(id).name_span;
                let message = format!("{} is FINAL", self.pou(base).name);
                self.report(Problem::error("E230", span, message));
            }
            let methods = self.pou(id).methods.clone();
            for (name, method) in &methods {
                let overridden = self
                    .pou(id)
                    .extends
                    .and_then(|base| self.find_method(base, name));
                let syntax = self.syntaxes[method.0 as usize];
                let span = syntax.name.span;
                if let Some(other) = overridden {
                    if self.pou(other).is_final {
                        let message = format!("{} is FINAL", self.pou(other).name);
                        self.report(Problem::error("E233", span, message));
                    }
                    if !syntax.class.is_override && !self.is_liberal() {
                        let other = self.pou(other).name.clone();
                        let message = format!("`{}` overrides {other}", syntax.name.name);
                        self.report(
                            Problem::warning("W717", span, message)
                                .hint("say so: `METHOD OVERRIDE`, or take another name"),
                        );
                    }
                    self.same_signature(*method, other, span);
                } else if syntax.class.is_override {
                    let message = format!("there is no method `{}` to override", syntax.name.name);
                    self.report(Problem::error("E233", span, message));
                }
                if syntax.class.is_abstract && !self.pou(id).is_abstract {
                    let message = format!(
                        "{} has an ABSTRACT method and must be ABSTRACT itself",
                        self.pou(id).name
                    );
                    self.report(Problem::error("E234", span, message));
                }
            }
            self.check_promises(id);
        }
        self.refuse_abstract_instances();
    }

    /// Every method of the interfaces and every abstract method of the bases is there.
    fn check_promises(&mut self, id: PouId) {
        if self.pou(id).is_abstract {
            return;
        }
        let span = self.pou(id).name_span;
        let mut wanted: Vec<(String, PouId)> = Vec::new();
        for interface in self.pou(id).implements.clone() {
            wanted.extend(self.interfaces[interface.0 as usize].methods.clone());
        }
        let mut base = self.pou(id).extends;
        while let Some(at) = base {
            wanted.extend(
                self.pou(at)
                    .methods
                    .iter()
                    .filter(|(_, m)| self.pou(*m).is_abstract)
                    .cloned(),
            );
            base = self.pou(at).extends;
        }
        for (name, promised) in wanted {
            match self.find_method(id, &name) {
                Some(found) if !self.pou(found).is_abstract => {
                    let at = self.pou(found).name_span;
                    self.same_signature(found, promised, at);
                }
                _ => {
                    let message = format!(
                        "{} lacks the method of {}",
                        self.pou(id).name,
                        self.pou(promised).name
                    );
                    self.report(
                        Problem::error("E234", span, message)
                            .hint("write the method, or declare the function block ABSTRACT"),
                    );
                }
            }
        }
    }

    fn refuse_abstract_instances(&mut self) {
        for index in 0..self.vars.len() {
            let var = &self.vars[index];
            let mut ty = var.ty;
            while let TypeKind::Array { elem, .. } = self.types.kind(ty) {
                ty = *elem;
            }
            if let TypeKind::FunctionBlock(pou) = *self.types.kind(ty)
                && self.pou(pou).is_abstract
                && var.section != VarSection::InOut
            {
                let span = var.span;
                let message = format!("{} is ABSTRACT and has no instances", self.pou(pou).name);
                self.report(Problem::error("E234", span, message));
            }
        }
    }

    fn same_signature(&mut self, one: PouId, other: PouId, span: Span) {
        let shape = |checker: &Self, pou: PouId| -> Vec<(VarSection, String, TypeId)> {
            let unit = checker.pou(pou);
            let result = unit
                .result
                .map(|r| (VarSection::Local, String::new(), checker.var(r).ty));
            unit.vars
                .iter()
                .map(|v| checker.var(*v))
                .filter(|v| {
                    matches!(
                        v.section,
                        VarSection::Input | VarSection::Output | VarSection::InOut
                    )
                })
                .map(|v| (v.section, key(&v.name), v.ty))
                .chain(result)
                .collect()
        };
        let (a, b) = (shape(self, one), shape(self, other));
        let equal = a.len() == b.len()
            && a.iter()
                .zip(&b)
                .all(|(x, y)| x.0 == y.0 && x.1 == y.1 && self.types.same(x.2, y.2));
        if !equal {
            let message = format!(
                "{} has other parameters than {}",
                self.pou(one).name,
                self.pou(other).name
            );
            self.report(Problem::error("E233", span, message));
        }
    }

    /// The method of this name of a function block, its own or that of the nearest base.
    pub(super) fn find_method(&self, block: PouId, name: &str) -> Option<PouId> {
        let mut at = Some(block);
        while let Some(id) = at {
            let own = self.pou(id).methods.iter().find(|(n, _)| n == name);
            if let Some((_, method)) = own {
                return Some(*method);
            }
            at = self.pou(id).extends;
        }
        None
    }

    /// Whether `from` is `to` or derived from it.
    pub(super) fn derives(&self, from: TypeId, to: TypeId) -> bool {
        if self.types.same(from, to) {
            return true;
        }
        let (TypeKind::FunctionBlock(from), TypeKind::FunctionBlock(to)) =
            (self.types.kind(from), self.types.kind(to))
        else {
            return false;
        };
        let mut at = Some(*from);
        while let Some(id) = at {
            if id == *to {
                return true;
            }
            at = self.pou(id).extends;
        }
        false
    }

    pub(super) fn implements(&self, pou: PouId, interface: InterfaceId) -> bool {
        self.pou(pou)
            .implements
            .iter()
            .any(|i| *i == interface || self.interface_extends(*i, interface))
    }

    pub(super) fn interface_extends(&self, from: InterfaceId, to: InterfaceId) -> bool {
        let mut todo = vec![from];
        let mut seen = Vec::new();
        while let Some(at) = todo.pop() {
            if at == to {
                return true;
            }
            if seen.contains(&at) {
                continue;
            }
            seen.push(at);
            let interface = &self.project.interfaces[at.0 as usize];
            for base in &interface.extends {
                let found = self.lookup_in(&interface.name.name, &base.name);
                if let Some(Declared::Interface(id)) = found {
                    todo.push(id);
                }
            }
        }
        false
    }

    /// The function blocks whose instances a reference or interface of this type may lead to.
    pub(super) fn accepted_by(&self, ty: TypeId) -> Vec<PouId> {
        let all = (0..self.pous.len() as u32).map(PouId);
        match self.types.kind(ty) {
            TypeKind::Interface(id) => all.filter(|p| self.implements(*p, *id)).collect(),
            TypeKind::Ref(to) => all
                .filter(|p| {
                    self.pou(*p).tag.is_some()
                        && self
                            .fb_types
                            .get(p)
                            .is_some_and(|own| self.derives(*own, *to))
                })
                .collect(),
            _ => Vec::new(),
        }
    }

    /// The function block whose body or method is looked at.
    pub(super) fn current_block(&self) -> Option<PouId> {
        let pou = self.current.pou?;
        match self.pou(pou).kind {
            PouKind::FunctionBlock => Some(pou),
            PouKind::Method => self.pou(pou).instance_of,
            _ => None,
        }
    }

    /// Whether variables of `owner` are those of the current POU itself, of its instance, or of a base.
    pub(super) fn sees_inside(&self, owner: Option<PouId>) -> bool {
        if owner == self.current.pou {
            return true;
        }
        let Some(owner) = owner else { return false };
        let mut at = self
            .current_block()
            .or(self.current.pou.and_then(|p| self.pou(p).instance_of));
        while let Some(id) = at {
            if id == owner {
                return true;
            }
            at = self.pou(id).extends;
        }
        false
    }
}
