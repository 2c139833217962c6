//! POUs: their variables, the names that they see, and their bodies.

use std::collections::BTreeMap;

use crate::check::tree::{PouId, Var, VarId};
use crate::check::{Checker, Declared, Scope, key};
use crate::diag::Problem;
use crate::syntax::ast::{self, PouKind, VarSection};
use crate::types::{TypeId, TypeKind};

impl<'p> Checker<'p> {
    fn syntax_of(&self, id: PouId) -> &'p ast::Pou {
        self.syntaxes[id.0 as usize]
    }

    /// Looks at the text of `pou` from now on.
    pub(super) fn enter(&mut self, pou: Option<PouId>) {
        self.current = Scope {
            pou,
            names: pou.map_or_else(BTreeMap::new, |p| self.scopes[p.0 as usize].clone()),
            space: pou.map_or_else(String::new, |p| self.pou(p).name.clone()),
            loops: 0,
            defining: false,
            assigned: None,
        };
    }

    pub(super) fn leave(&mut self) {
        self.current = Scope::default();
    }

    pub(super) fn declare_pous(&mut self) {
        self.scopes = vec![BTreeMap::new(); self.pous.len()];
        self.resolve_classes();
        let mut done = vec![false; self.pous.len()];
        for index in 0..self.pous.len() {
            self.declare_with_bases(PouId(index as u32), &mut done);
        }
        self.check_classes();
        self.refuse_endless_instances();
    }

    /// A derived function block begins with the variables of its base, a method sees those of its function block.
    fn declare_with_bases(&mut self, id: PouId, done: &mut [bool]) {
        if std::mem::replace(&mut done[id.0 as usize], true) {
            return;
        }
        let before = self.pou(id).extends.or(self.pou(id).instance_of);
        let mut names = BTreeMap::new();
        if let Some(base) = before {
            self.declare_with_bases(base, done);
            names.clone_from(&self.scopes[base.0 as usize]);
            if self.pou(id).kind == PouKind::Method {
                // Those exist while the body runs only.
                names.retain(|_, var| !self.lives_with_body(*var));
            }
            if self.pou(id).extends.is_some() {
                names.retain(|_, var| self.access.get(var) != Some(&ast::Access::Private));
            }
        }
        self.enter(Some(id));
        if let Some(base) = self.pou(id).extends {
            self.pous[id.0 as usize].vars = self.pou(base).vars.clone();
            self.pous[id.0 as usize].tag = self.pou(base).tag;
            self.current.names = names;
            self.declare_pou(id);
        } else {
            self.declare_pou(id);
            if before.is_some() {
                // Names of the method hide those of its function block.
                for (name, var) in std::mem::take(&mut self.current.names) {
                    names.insert(name, var);
                }
                self.current.names = names;
            }
        }
        self.scopes[id.0 as usize] = std::mem::take(&mut self.current.names);
        self.leave();
    }

    /// Whether a variable of a function block or program is there only while its body runs.
    pub(super) fn lives_with_body(&self, var: VarId) -> bool {
        matches!(self.var(var).section, VarSection::InOut | VarSection::Temp)
    }

    pub(super) fn declare_pou(&mut self, id: PouId) {
        let syntax = self.syntax_of(id);
        self.declare_tag(id, syntax);
        if matches!(syntax.kind, PouKind::Function | PouKind::Method)
            && let Some(spec) = &syntax.result
        {
            let ty = self.resolve_spec(spec, None);
            if matches!(self.types.kind(ty), TypeKind::FunctionBlock(_)) {
                let problem =
                    Problem::error("E219", spec.span, "a function cannot return an instance");
                self.report(problem);
            }
            let var = VarId(self.vars.len() as u32);
            self.vars.push(Var {
                name: last_part(&syntax.name.name).to_owned(),
                ty,
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
            self.pous[id.0 as usize].result = Some(var);
            self.current
                .names
                .insert(key(last_part(&syntax.name.name)), var);
        }
        // Constants first: the bounds of an array may name one that is declared below it. The variables stand in the order of the
        // text, which is that of calls without names, and of memory.
        let before = self.pou(id).vars.len();
        let mut groups = vec![Vec::new(); syntax.vars.len()];
        for constant in [true, false] {
            for (index, block) in syntax.vars.iter().enumerate() {
                if block.constant == constant {
                    self.declare_block(id, syntax, block);
                    groups[index] = self.pous[id.0 as usize].vars.split_off(before);
                }
            }
        }
        self.pous[id.0 as usize].vars.extend(groups.concat());
    }

    fn declare_block(&mut self, id: PouId, syntax: &'p ast::Pou, block: &'p ast::VarBlock) {
        for decl in &block.decls {
            if block.section == VarSection::External {
                self.declare_external(decl);
                continue;
            }
            self.check_section(syntax, block, decl);
            self.before_open_array(id, block.section, decl);
            let var = self.declare_var(block, decl, block.section, Some(id));
            if let Some(access) = block.access {
                self.access.insert(var, access);
            }
            let name = key(&decl.name.name);
            // A private variable of the base is out of sight, and still one of the instance.
            let inherited = self.pou(id).extends.is_some()
                && self
                    .pou(id)
                    .vars
                    .iter()
                    .any(|v| key(&self.var(*v).name) == name);
            if inherited || self.current.names.contains_key(&name) {
                let message = format!("the variable `{}` is declared twice", decl.name.name);
                self.report(Problem::error("E201", decl.name.span, message));
            }
            self.current.names.insert(name, var);
            self.pous[id.0 as usize].vars.push(var);
            self.check_instance_section(syntax, block, decl, var);
            if let Some(edge) = decl.edge {
                self.declare_edge(id, var, edge, decl);
            }
        }
    }

    fn check_section(&mut self, pou: &ast::Pou, block: &ast::VarBlock, decl: &ast::VarDecl) {
        let span = decl.name.span;
        let refused = match (pou.kind, block.section) {
            (_, VarSection::Global) => {
                Some("declare it outside of the POU and name it in VAR_EXTERNAL here")
            }
            (PouKind::Program, VarSection::InOut) => Some("use VAR_EXTERNAL or VAR_INPUT"),
            _ => None,
        };
        if let Some(hint) = refused {
            let message = format!("a {} cannot have {}", pou.kind, block.section);
            self.report(Problem::error("E220", span, message).hint(hint));
        }
        if let Some(at) = &decl.location
            && !(pou.kind == PouKind::Program
                && matches!(
                    block.section,
                    VarSection::Local | VarSection::Input | VarSection::Output
                ))
            && !(at.name.ends_with('*') && pou.kind == PouKind::FunctionBlock)
        {
            let message = format!(
                "a variable in {} of a {} cannot be located",
                block.section, pou.kind
            );
            self.report(
                Problem::error("E206", at.span, message)
                    .hint("locate a variable in VAR of a program or in VAR_GLOBAL"),
            );
        }
        if block.section == VarSection::InOut && decl.init.is_some() {
            self.report(Problem::error(
                "E221",
                span,
                "VAR_IN_OUT has no initial value",
            ));
        }
    }

    /// Instances live where their memory is kept from scan to scan.
    fn check_instance_section(
        &mut self,
        pou: &ast::Pou,
        block: &ast::VarBlock,
        decl: &ast::VarDecl,
        var: VarId,
    ) {
        let kept = block.section == VarSection::InOut
            || (!matches!(pou.kind, PouKind::Function | PouKind::Method)
                && matches!(
                    block.section,
                    VarSection::Local | VarSection::Input | VarSection::Output
                ));
        let ty = self.var(var).ty;
        if !kept && self.holds_instance(ty) {
            let message = format!(
                "a function block instance cannot stand in {} of a {}",
                block.section, pou.kind
            );
            self.report(Problem::error("E222", decl.name.span, message).hint(
                "declare it in VAR of a program or function block, or pass it as VAR_IN_OUT",
            ));
        }
        if block.constant && self.holds_instance(ty) {
            self.report(Problem::error(
                "E222",
                decl.name.span,
                "an instance cannot be CONSTANT",
            ));
        }
    }

    fn holds_instance(&self, ty: TypeId) -> bool {
        match self.types.kind(ty) {
            TypeKind::FunctionBlock(_) => true,
            TypeKind::Array { elem, .. } => self.holds_instance(*elem),
            TypeKind::Struct { fields } => fields.iter().any(|f| self.holds_instance(f.ty)),
            _ => false,
        }
    }

    /// VAR_EXTERNAL makes a global variable visible under its name.
    fn declare_external(&mut self, decl: &'p ast::VarDecl) {
        let name = &decl.name.name;
        let Some(Declared::Global(b, d)) = self.lookup(name) else {
            let message = format!("there is no global variable `{name}`");
            self.report(
                Problem::error("E223", decl.name.span, message)
                    .expected("the name of a variable declared in VAR_GLOBAL"),
            );
            // What uses it has nothing to add.
            let unknown = VarId(self.vars.len() as u32);
            self.vars.push(Var {
                name: name.clone(),
                ty: TypeId::ERROR,
                section: VarSection::External,
                constant: false,
                retain: false,
                location: None,
                open_input: false,
                open_output: false,
                init: None,
                owner: None,
                span: decl.name.span,
            });
            self.current.names.insert(key(name), unknown);
            return;
        };
        let Some(id) = self.declare_global(b, d) else {
            return;
        };
        let ty = self.resolve_spec(&decl.spec, None);
        let global = self.var(id).ty;
        if ty != TypeId::ERROR && global != TypeId::ERROR && !self.types.same(ty, global) {
            let message = format!(
                "`{name}` is {} here and {} in VAR_GLOBAL",
                self.type_name(ty),
                self.type_name(global)
            );
            self.report(
                Problem::error("E224", decl.spec.span, message).expected(self.type_name(global)),
            );
        }
        self.current.names.insert(key(name), id);
    }

    /// A function block that contains an instance of itself would have no end.
    fn refuse_endless_instances(&mut self) {
        // 0 = not seen, 1 = on the path, 2 = done
        let mut state = vec![0u8; self.pous.len()];
        for index in 0..self.pous.len() {
            self.visit_instances(PouId(index as u32), &mut state);
        }
    }

    fn visit_instances(&mut self, pou: PouId, state: &mut Vec<u8>) -> bool {
        match state[pou.0 as usize] {
            1 => return true,
            2 => return false,
            _ => {}
        }
        state[pou.0 as usize] = 1;
        for var in self.pou(pou).vars.clone() {
            if self.var(var).section == VarSection::InOut {
                continue;
            }
            for inner in self.instances_in(self.var(var).ty) {
                if self.visit_instances(inner, state) {
                    let message = format!(
                        "{} contains an instance of {}, which contains {} again",
                        self.pou(pou).name,
                        self.pou(inner).name,
                        self.pou(pou).name
                    );
                    let span = self.var(var).span;
                    self.report(Problem::error("E225", span, message));
                    // Broken here, so that nothing walks in circles afterwards.
                    self.vars[var.0 as usize].ty = TypeId::ERROR;
                }
            }
        }
        state[pou.0 as usize] = 2;
        false
    }

    fn instances_in(&self, ty: TypeId) -> Vec<PouId> {
        match self.types.kind(ty) {
            TypeKind::FunctionBlock(pou) => vec![*pou],
            TypeKind::Array { elem, .. } => self.instances_in(*elem),
            TypeKind::Struct { fields } => fields
                .iter()
                .flat_map(|f| self.instances_in(f.ty))
                .collect(),
            _ => Vec::new(),
        }
    }

    pub(super) fn check_bodies(&mut self) {
        let mut index = 0;
        // Calls with open arrays add functions behind.
        while index < self.pous.len() {
            let id = PouId(index as u32);
            index += 1;
            if self.is_pattern(id) {
                continue;
            }
            self.enter(Some(id));
            let syntax = self.syntax_of(id);
            let mut body = Vec::new();
            if !syntax.body.is_empty() {
                body.extend(self.enable_prologue(id));
            }
            body.extend(self.edge_calls(id));
            body.extend(self.stmts(&syntax.body));
            if body.is_empty()
                && let Some(base) = self.pou(id).extends
            {
                // The statements of the base run in its place.
                self.note_call(base);
            }
            self.pous[id.0 as usize].body = self.with_placed(id, body);
            self.leave();
        }
    }
}

/// The name without the path of its namespace.
fn last_part(name: &str) -> &str {
    name.rsplit('.').next().unwrap_or(name)
}
