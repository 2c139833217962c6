//! Names that stand outside POUs: collected first, then declared on demand, so that the order of texts does not matter.

use crate::check::tree::{Location, Pou, PouId, Var, VarId};
use crate::check::{Checker, Declared, Progress, key};
use crate::diag::{Fallible, Problem};
use crate::syntax::ast::{self, PouKind, VarSection};
use crate::types::{Elem, InterfaceId, TypeId, TypeKind};

impl<'p> Checker<'p> {
    pub(super) fn collect(&mut self) {
        let project = self.project;
        self.collect_spaces();
        for (index, decl) in project.types.iter().enumerate() {
            self.claim(&decl.name, Declared::Type(index));
        }
        for pou in &project.pous {
            let id = PouId(self.pous.len() as u32);
            self.claim(&pou.name, Declared::Pou(id));
            self.add_pou(pou, false);
        }
        for (index, interface) in project.interfaces.iter().enumerate() {
            let id = InterfaceId(index as u32);
            self.claim(&interface.name, Declared::Interface(id));
            let ty = self
                .types
                .add(Some(interface.name.name.clone()), TypeKind::Interface(id));
            self.interface_types.push(ty);
        }
        for (b, block) in project.globals.iter().enumerate() {
            for (d, decl) in block.decls.iter().enumerate() {
                self.claim(&decl.name, Declared::Global(b, d));
            }
        }
        for pou in project.library.iter() {
            if !self.names.contains_key(&key(&pou.name.name)) {
                let id = PouId(self.pous.len() as u32);
                self.names.insert(key(&pou.name.name), Declared::Pou(id));
                self.add_pou(pou, true);
            }
        }
        self.collect_methods();
    }

    pub(super) fn add_pou(&mut self, pou: &'p ast::Pou, library: bool) {
        let id = PouId(self.pous.len() as u32);
        self.pous.push(Pou {
            name: pou.name.name.clone(),
            name_span: pou.name.span,
            kind: pou.kind,
            library,
            pattern: false,
            vars: Vec::new(),
            result: None,
            body: Vec::new(),
            calls: std::collections::BTreeSet::new(),
            instance_of: None,
            extends: None,
            implements: Vec::new(),
            methods: Vec::new(),
            is_abstract: pou.class.is_abstract,
            is_final: pou.class.is_final,
            access: pou.class.access,
            tag: None,
        });
        self.syntaxes.push(pou);
        if pou.kind == PouKind::FunctionBlock {
            let ty = self
                .types
                .add(Some(pou.name.name.clone()), TypeKind::FunctionBlock(id));
            self.fb_types.insert(id, ty);
        }
    }

    /// Names that other compilers refuse: several underscores in a row, or one at the end (clause 6.1.2). Those of the compiler's
    /// own variables begin with two.
    pub(super) fn warn_of_underscores(&mut self, name: &ast::Ident) {
        let text = name.name.rsplit('.').next().unwrap_or_default();
        let wrong = text.contains("__") || text.ends_with('_');
        if wrong && !text.starts_with("__") && !self.is_liberal() {
            let message = format!("the standard has no names like `{text}`");
            self.report(
                Problem::warning("W718", name.span, message)
                    .expected("single underscores, and none at the end")
                    .hint("other compilers refuse it"),
            );
        }
    }

    /// A program's `AT %Q*` that VAR_CONFIG does not place.
    fn warn_of_no_place(&mut self, name: &ast::Ident, owner: Option<PouId>) {
        let Some(owner) = owner.map(|p| self.pou(p)) else {
            return;
        };
        let configurations = &self.project.configurations;
        let mut resources = configurations.iter().flat_map(|c| &c.resources);
        // Of a program that runs several times each instance has a program of its own, and this one never runs.
        let runs = configurations.is_empty()
            || resources.any(|r| {
                r.instances
                    .iter()
                    .any(|i| i.program.eq_ignore_ascii_case(&owner.name))
            });
        if owner.kind == PouKind::Program && runs {
            let message = format!("`{}` has no place in the process image", name.name);
            self.report(
                Problem::warning("W720", name.span, message)
                    .expected("a line for it in the VAR_CONFIG of the configuration")
                    .hint("until it has one it lies in memory, and no driver reads or writes it"),
            );
        }
    }

    fn claim(&mut self, name: &ast::Ident, declared: Declared) {
        self.warn_of_underscores(name);
        if Elem::from_name(&name.name).is_some() {
            let message = format!("`{}` is the name of an elementary type", name.name);
            self.report(Problem::error("E201", name.span, message));
            return;
        }
        if self.names.contains_key(&key(&name.name)) {
            let problem = Problem::error(
                "E201",
                name.span,
                format!("`{}` is declared twice", name.name),
            )
            .hint("types, POUs and global variables, those of all resources too, share one set of names; case does not count");
            self.report(problem);
            return;
        }
        self.names.insert(key(&name.name), declared);
    }

    pub(super) fn declare_all(&mut self) {
        let project = self.project;
        for index in 0..project.types.len() {
            self.resolve_declared(index, project.types[index].name.span);
        }
        for (b, block) in project.globals.iter().enumerate() {
            for d in 0..block.decls.len() {
                self.declare_global(b, d);
            }
        }
        self.declare_pous();
        self.check_tasks();
        self.find_patterns();
        self.settle_inits(0);
        self.begin_texts();
        // Behind the initial values, which it changes for single instances.
        self.place_configured();
    }

    /// The global variable, declared now if it was not yet. `None` if it is wrong, or needs itself.
    pub(super) fn declare_global(&mut self, b: usize, d: usize) -> Option<VarId> {
        if let Some((progress, id)) = self.globals.get(&(b, d)).copied() {
            if progress == Progress::Running {
                let span = self.project.globals[b].decls[d].name.span;
                self.report(Problem::error(
                    "E204",
                    span,
                    "this constant needs its own value",
                ));
            }
            return id;
        }
        let project = self.project;
        let block = &project.globals[b];
        let decl = &block.decls[d];
        self.globals.insert((b, d), (Progress::Running, None));
        let outside = std::mem::take(&mut self.current);
        self.current.space.clone_from(&decl.name.name);
        let id = self.declare_var(block, decl, VarSection::Global, None);
        self.current = outside;
        self.globals.insert((b, d), (Progress::Done, Some(id)));
        Some(id)
    }

    /// Adds a variable. Values of scalar constants are worked out at once, other initial values when all is declared.
    pub(super) fn declare_var(
        &mut self,
        block: &'p ast::VarBlock,
        decl: &'p ast::VarDecl,
        section: VarSection,
        owner: Option<PouId>,
    ) -> VarId {
        let mut ty = self.resolve_spec(&decl.spec, None);
        if ty == TypeId::INFERRED && owner.is_none() {
            ty = TypeId::ERROR;
        }
        if section != VarSection::External {
            self.overlap_is_located(decl, ty);
        }
        let open = decl
            .location
            .as_ref()
            .is_some_and(|at| at.name.ends_with('*'));
        let open_at = |area: &str| {
            let at = decl.location.as_ref().filter(|_| open);
            at.is_some_and(|at| at.name.to_ascii_uppercase().starts_with(area))
        };
        let (open_input, open_output) = (open_at("%I"), open_at("%Q"));
        let configured = self.configured(&decl.name.name, owner);
        let at = configured
            .and_then(|c| c.location.as_ref())
            .or(decl.location.as_ref().filter(|_| !open));
        let is_text = self.types.text(ty).is_some();
        let location = at.filter(|_| !is_text).and_then(|at| {
            let result = self.located(at, ty);
            self.ok(result)
        });
        self.warn_of_underscores(&decl.name);
        if (open_input || open_output) && location.is_none() && configured.is_none() {
            self.warn_of_no_place(&decl.name, owner);
        }
        let id = VarId(self.vars.len() as u32);
        self.vars.push(Var {
            name: decl.name.name.clone(),
            ty,
            section,
            constant: block.constant,
            retain: block.retain,
            location,
            open_input: open_input && location.is_none(),
            open_output: open_output && location.is_none(),
            init: None,
            owner,
            span: decl.name.span,
        });
        if let Some(at) = at.filter(|_| is_text) {
            let result = self.locate_text(id, at);
            self.ok(result);
        }
        if block.constant && decl.init.is_none() && ty != TypeId::ERROR {
            let message = format!("the constant `{}` has no value", decl.name.name);
            self.report(
                Problem::error("E205", decl.name.span, message).expected("`:=` and a value"),
            );
        }
        if block.constant && decl.location.is_some() {
            let message = format!("the constant `{}` cannot be located", decl.name.name);
            self.report(Problem::error("E206", decl.name.span, message));
        }
        let init = configured
            .and_then(|c| c.init.as_ref())
            .or(decl.init.as_ref());
        if let Some(init) = init {
            if block.constant && !self.types.is_aggregate(ty) {
                let value = self.init_value(init, ty);
                self.vars[id.0 as usize].init = value;
            } else {
                self.pending_inits
                    .push((super::init::Pending::Var(id), init));
            }
        }
        id
    }

    /// The place of a variable in the process image.
    pub(super) fn located(&mut self, at: &ast::Ident, ty: TypeId) -> Fallible<Location> {
        let location = self.address(&at.name, at.span)?;
        if ty == TypeId::ERROR {
            return Ok(location);
        }
        let type_name = self.type_name(ty);
        if self.is_foreign(location) && self.types.is_aggregate(ty) {
            let message = format!("{type_name} cannot be located at `{}`", at.name);
            return Err(Box::new(Problem::error("E207", at.span, message).expected(
                "an address with no more levels than bus, rack and module",
            )));
        }
        if let Some(refused) = self.no_part_of_the_image(ty) {
            let message = format!("{type_name} cannot be located{refused}");
            return Err(Box::new(
                Problem::error("E207", at.span, message)
                    .expected("elementary types, and structures and arrays of them")
                    .hint("locate an ARRAY OF BYTE or CHAR for text"),
            ));
        }
        match self.types.kind(ty) {
            TypeKind::Struct { .. } => {
                if location.bit.is_some() {
                    let message = format!("{type_name} cannot be located at `{}`", at.name);
                    let area = location.area();
                    return Err(Box::new(
                        Problem::error("E207", at.span, message)
                            .expected(format!("an address that begins with %{area}B")),
                    ));
                }
                Ok(location)
            }
            TypeKind::Array { elem, .. } => {
                let area = location.area();
                let wrong = match self.types.elem(*elem) {
                    Some(Elem::Bool) if location.bit.is_none() => {
                        format!("an address that begins with %{area}X: its elements are bits")
                    }
                    Some(elem) if elem != Elem::Bool && location.bit.is_some() => {
                        format!("an address that begins with %{area}{}", size_of(elem))
                    }
                    None if location.bit.is_some() => {
                        format!("an address that begins with %{area}B")
                    }
                    _ => return Ok(location),
                };
                let message = format!("{type_name} cannot be located at `{}`", at.name);
                Err(Box::new(
                    Problem::error("E207", at.span, message).expected(wrong),
                ))
            }
            _ => {
                let Some(elem) = self.types.elem(ty) else {
                    return Ok(location);
                };
                let wanted = match location.size {
                    'X' => 1,
                    'B' => 8,
                    'W' => 16,
                    'D' => 32,
                    _ => 64,
                };
                if elem.bits() != wanted {
                    let (area, size) = (location.area(), size_of(elem));
                    return Err(Box::new(
                        Problem::error(
                            "E207",
                            at.span,
                            format!(
                                "{type_name} has {} and `{}` has {}",
                                bits(elem.bits()),
                                at.name,
                                bits(wanted)
                            ),
                        )
                        .expected(format!("an address that begins with %{area}{size}")),
                    ));
                }
                Ok(location)
            }
        }
    }
}

/// The letter of an address that is as wide as the type.
fn size_of(elem: Elem) -> char {
    match elem.bits() {
        1 => 'X',
        8 => 'B',
        16 => 'W',
        32 => 'D',
        _ => 'L',
    }
}

fn bits(n: u32) -> String {
    if n == 1 {
        "1 bit".into()
    } else {
        format!("{n} bits")
    }
}
