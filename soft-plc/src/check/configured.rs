//! VAR_CONFIG: where the variables stand that were declared with `AT %I*` or `AT %Q*`, and initial values of single instances
//! (IEC 61131-3, clause 6.8.1).
//!
//! One of a program is located as if it had been declared so. One inside a function block instance stays where the instance
//! is: the program gets a located variable of its own beside it, named by its path (`feeder__ready` for `feeder.ready`, a name
//! that no text can have), and copies it in before its statements, or out behind them.

use crate::check::tree::{
    Expr, ExprKind, InitValue, Place, PouId, Root, Step, StepKind, Stmt, StmtKind, Var, VarId,
};
use crate::check::{Checker, key};
use crate::diag::{Fallible, Problem};
use crate::syntax::ast::{self, PouKind, VarSection};
use crate::types::{TypeId, TypeKind};

/// A variable of a function block instance that VAR_CONFIG places.
#[derive(Clone, Debug)]
pub(super) struct Placed {
    program: PouId,
    /// The located variable of the program.
    at: VarId,
    inside: Place,
    output: bool,
}

impl<'p> Checker<'p> {
    /// What VAR_CONFIG says about a variable of a program itself.
    pub(super) fn configured(
        &self,
        name: &str,
        owner: Option<PouId>,
    ) -> Option<&'p ast::Configured> {
        let pou = self.pou(owner?);
        if pou.kind != PouKind::Program {
            return None;
        }
        let all = self
            .project
            .configurations
            .iter()
            .flat_map(|c| c.configured.iter().map(move |v| (c, v)));
        for (configuration, configured) in all {
            let [.., program, variable] = configured.path.as_slice() else {
                continue;
            };
            let is_it = program_of(configuration, &program.name).eq_ignore_ascii_case(&pou.name);
            if is_it && variable.name.eq_ignore_ascii_case(name) {
                return Some(configured);
            }
        }
        None
    }

    /// Every line of VAR_CONFIG means a variable of a program, or of an instance in one.
    pub(super) fn place_configured(&mut self) {
        let project = self.project;
        for configuration in &project.configurations {
            for configured in &configuration.configured {
                let result = self.place_one(configuration, configured);
                self.ok(result);
            }
        }
    }

    fn place_one(
        &mut self,
        configuration: &'p ast::Configuration,
        configured: &'p ast::Configured,
    ) -> Fallible<()> {
        let mut path = configured.path.as_slice();
        if let [first, rest @ ..] = path
            && rest.len() > 1
            && configuration
                .resources
                .iter()
                .any(|r| r.name.eq_ignore_ascii_case(&first.name))
        {
            path = rest;
        }
        let program = path.iter().enumerate().find_map(|(at, part)| {
            let pou = self.find_declared_pou(program_of(configuration, &part.name))?;
            (self.pou(pou).kind == PouKind::Program).then_some((at, pou))
        });
        let Some((program, [instances @ .., variable])) =
            program.map(|(at, pou)| (pou, &path[at + 1..]))
        else {
            return Err(no_variable(path));
        };
        let mut place: Option<Place> = None;
        let mut within = program;
        for part in instances {
            let inner = self.step(within, place.take(), part, path)?;
            let TypeKind::FunctionBlock(block) = *self.types.kind(inner.ty) else {
                let message = format!("`{}` is no function block instance", part.name);
                return Err(Box::new(Problem::error("E228", part.span, message)));
            };
            within = block;
            place = Some(inner);
        }
        let inside = self.step(within, place, variable, path)?;
        let ty = self.resolve_spec(&configured.spec, None);
        if ty != TypeId::ERROR && inside.ty != TypeId::ERROR && !self.types.same(ty, inside.ty) {
            let (is, said) = (self.type_name(inside.ty), self.type_name(ty));
            let message = format!(
                "`{}` is {is}, and VAR_CONFIG calls it {said}",
                variable.name
            );
            return Err(Box::new(Problem::error(
                "E228",
                configured.spec.span,
                message,
            )));
        }
        if instances.is_empty() {
            // Located and given its value when it was declared.
            return Ok(());
        }
        self.begin_inside(configured, &inside);
        let is_open = inside.steps.last().is_some_and(|s| match s.kind {
            StepKind::Member(var) => self.var(var).open_input || self.var(var).open_output,
            _ => false,
        });
        if configured.location.is_none() && configured.init.is_some() && !is_open {
            return Ok(());
        }
        self.place_inside(program, configured, inside)
    }

    /// The initial value of a variable of an instance becomes one of the program's variable that the instance is in.
    fn begin_inside(&mut self, configured: &'p ast::Configured, inside: &Place) {
        let Root::Var(root) = inside.root else { return };
        let Some(init) = &configured.init else { return };
        let Some(mut value) = self.init_value(init, inside.ty) else {
            return;
        };
        for step in inside.steps.iter().rev() {
            if let StepKind::Member(var) = step.kind {
                value = InitValue::Instance(vec![(var, value)]);
            }
        }
        let InitValue::Instance(more) = value else {
            return;
        };
        // What comes later counts.
        match &mut self.vars[root.0 as usize].init {
            Some(InitValue::Instance(items)) => items.extend(more),
            none => *none = Some(InitValue::Instance(more)),
        }
    }

    /// One part further along a path.
    fn step(
        &self,
        within: PouId,
        place: Option<Place>,
        part: &ast::Ident,
        path: &[ast::Ident],
    ) -> Fallible<Place> {
        let found = self.pou(within).vars.iter().copied().find(|v| {
            let var = self.var(*v);
            var.name.eq_ignore_ascii_case(&part.name) && var.section != VarSection::InOut
        });
        let Some(var) = found else {
            return Err(no_variable(path));
        };
        let ty = self.var(var).ty;
        Ok(match place {
            None => Place {
                root: Root::Var(var),
                steps: Vec::new(),
                ty,
                span: part.span,
            },
            Some(mut place) => {
                place.steps.push(Step {
                    kind: StepKind::Member(var),
                    ty,
                });
                place.ty = ty;
                place
            }
        })
    }

    fn place_inside(
        &mut self,
        program: PouId,
        configured: &'p ast::Configured,
        inside: Place,
    ) -> Fallible<()> {
        let Some(StepKind::Member(declared)) = inside.steps.last().map(|s| &s.kind) else {
            return Err(no_variable(&configured.path));
        };
        let declared = self.var(*declared).clone();
        let (last, span) = (&declared.name, inside.span);
        let Some(at) = &configured.location else {
            let problem = Problem::error(
                "E228",
                span,
                format!("VAR_CONFIG does not say where `{last}` stands"),
            );
            return Err(Box::new(
                problem.expected("AT and an address, or an initial value"),
            ));
        };
        if !(declared.open_input || declared.open_output) {
            let problem = Problem::error(
                "E228",
                span,
                format!("`{last}` is not declared with AT %I* or AT %Q*"),
            );
            return Err(Box::new(problem.hint(
                "declare it so in the function block: what has a place is not the caller's to set",
            )));
        }
        let location = self.located(at, inside.ty)?;
        if location.output == declared.open_input {
            let problem = Problem::error(
                "E228",
                at.span,
                format!("`{last}` cannot stand at {}", at.name),
            );
            let wanted = if declared.open_input { "%I" } else { "%Q" };
            return Err(Box::new(
                problem.expected(format!("an address that begins with {wanted}")),
            ));
        }
        let mut names: Vec<&str> = Vec::new();
        if let Root::Var(first) = inside.root {
            names.push(&self.var(first).name);
        }
        for step in &inside.steps {
            if let StepKind::Member(var) = step.kind {
                names.push(&self.var(var).name);
            }
        }
        let name = names.join("__");
        if self.scopes[program.0 as usize].contains_key(&key(&name)) {
            // Of another instance of the program. They get programs of their own before they run (`crate::instances`).
            return Ok(());
        }
        let id = VarId(self.vars.len() as u32);
        let output = location.output;
        self.vars.push(Var {
            name: name.clone(),
            section: VarSection::Local,
            constant: false,
            retain: false,
            location: Some(location),
            open_input: false,
            open_output: false,
            init: None,
            owner: Some(program),
            ..declared
        });
        self.pous[program.0 as usize].vars.push(id);
        self.scopes[program.0 as usize].insert(key(&name), id);
        self.placed.push(Placed {
            program,
            at: id,
            inside,
            output,
        });
        Ok(())
    }

    /// The body of a program between its copies in and out. RETURN leaves the body, not what follows.
    pub(super) fn with_placed(&mut self, program: PouId, body: Vec<Stmt>) -> Vec<Stmt> {
        if self.pou(program).kind != PouKind::Program {
            return body;
        }
        let texts = (
            self.copy_texts(program, false),
            self.copy_texts(program, true),
        );
        let copies = |output: bool| -> Vec<Stmt> {
            let of_program = |p: &&Placed| p.program == program && p.output == output;
            self.placed
                .iter()
                .filter(of_program)
                .map(Placed::copy)
                .collect()
        };
        let (mut list, mut after) = (copies(false), copies(true));
        list.extend(texts.0);
        after.extend(texts.1);
        if after.is_empty() {
            list.extend(body);
        } else {
            let span = self.pou(program).name_span;
            list.push(Stmt {
                kind: StmtKind::Block(body),
                span,
            });
            list.extend(after);
        }
        list
    }
}

impl Placed {
    fn copy(&self) -> Stmt {
        let span = self.inside.span;
        let own = Place {
            root: Root::Var(self.at),
            steps: Vec::new(),
            ty: self.inside.ty,
            span,
        };
        let (to, from) = if self.output {
            (own, self.inside.clone())
        } else {
            (self.inside.clone(), own)
        };
        let value = Expr {
            ty: from.ty,
            kind: ExprKind::Load(Box::new(from)),
            span,
        };
        Stmt {
            kind: StmtKind::Assign(to, value),
            span,
        }
    }
}

fn no_variable(path: &[ast::Ident]) -> Box<Problem> {
    let span = path.last().map_or_else(Default::default, |p| p.span);
    Box::new(
        Problem::error(
            "E228",
            span,
            "this path of VAR_CONFIG names no variable of a program or of an instance in one",
        )
        .expected("resource.program.variable, or resource.program.instance.variable"),
    )
}

/// The program of an instance's name, or the name itself.
fn program_of<'a>(configuration: &'a ast::Configuration, name: &'a str) -> &'a str {
    configuration
        .resources
        .iter()
        .flat_map(|r| &r.instances)
        .find(|i| i.name.eq_ignore_ascii_case(name))
        .map_or(name, |i| i.program.as_str())
}
