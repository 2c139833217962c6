//! Sequential function charts (IEC 61131-3, clause 6.7): the model that textual and graphical charts are read into, and its
//! meaning in terms of ordinary statements.
//!
//! In each scan: the elapsed times of active steps are brought up to date; all transitions are tested on the steps as they
//! are (those of initial steps from the second scan on, as the first one enters them), of several that share a step only the first that is true by priority; the steps before fired transitions are left,
//! then those after them entered; actions run whose control says so. Actions are not run once more after their step was
//! left ("without final scan").

use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{
    BinOp, Expr, ExprKind, Ident, Init, Pou, PouKind, Stmt, StmtKind, VarDecl, VarSection,
};
use crate::syntax::build::{At, block};
use crate::syntax::walk::each_target;

/// Name of the library's type of a step.
pub const STEP_TYPE: &str = "__SFC_STEP";

#[derive(Clone, Debug, Default)]
pub struct Sfc {
    pub steps: Vec<Step>,
    pub transitions: Vec<Transition>,
    pub actions: Vec<Action>,
    pub macros: Vec<MacroStep>,
}

/// A macro step (IEC 60848): steps that have a name together, which is active while one of them is.
#[derive(Clone, Debug)]
pub struct MacroStep {
    pub name: Ident,
    pub inside: Vec<Ident>,
}

#[derive(Clone, Debug)]
pub struct Step {
    pub name: Ident,
    pub initial: bool,
    pub associations: Vec<Association>,
}

/// An action block at a step.
#[derive(Clone, Debug)]
pub struct Association {
    pub qualifier: Qualifier,
    pub time: Option<Expr>,
    pub action: Target,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub enum Target {
    /// An action of the chart, or a BOOL variable.
    Named(Expr),
    /// Statements that stand in the action block itself.
    Inline(Vec<Stmt>),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Qualifier {
    NonStored,
    Reset,
    Set,
    Limited,
    Delayed,
    Pulse,
    PulseRising,
    PulseFalling,
    StoredDelayed,
    DelayedStored,
    StoredLimited,
}

impl Qualifier {
    pub fn from_name(name: &str) -> Option<Qualifier> {
        Some(match name.to_ascii_uppercase().as_str() {
            "" | "N" => Qualifier::NonStored,
            "R" => Qualifier::Reset,
            "S" => Qualifier::Set,
            "L" => Qualifier::Limited,
            "D" => Qualifier::Delayed,
            "P" => Qualifier::Pulse,
            "P1" => Qualifier::PulseRising,
            "P0" => Qualifier::PulseFalling,
            "SD" => Qualifier::StoredDelayed,
            "DS" => Qualifier::DelayedStored,
            "SL" => Qualifier::StoredLimited,
            _ => return None,
        })
    }

    pub fn needs_time(self) -> bool {
        matches!(
            self,
            Qualifier::Limited
                | Qualifier::Delayed
                | Qualifier::StoredDelayed
                | Qualifier::DelayedStored
                | Qualifier::StoredLimited
        )
    }
}

#[derive(Clone, Debug)]
pub struct Transition {
    pub priority: Option<i64>,
    pub from: Vec<Ident>,
    pub to: Vec<Ident>,
    /// What has to run before the condition has its value.
    pub before: Vec<Stmt>,
    pub condition: Expr,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub struct Action {
    pub name: Ident,
    pub body: Vec<Stmt>,
}

fn same(a: &str, b: &str) -> bool {
    a.eq_ignore_ascii_case(b)
}

impl Sfc {
    fn find(&self, name: &Ident) -> Option<usize> {
        self.steps
            .iter()
            .position(|s| same(&s.name.name, &name.name))
    }

    fn validate(&self, pou: &Pou, problems: &mut Vec<Problem>) -> bool {
        let before = problems.len();
        if pou.kind == PouKind::Function || pou.kind == PouKind::Method {
            problems.push(
                Problem::error(
                    "E701",
                    pou.name.span,
                    format!("a {} cannot be a sequential function chart", pou.kind),
                )
                .hint("a chart needs memory from scan to scan: use a FUNCTION_BLOCK"),
            );
        }
        for (index, step) in self.macros.iter().enumerate() {
            let earlier = self.macros[..index].iter();
            let twice = earlier.clone().any(|m| same(&m.name.name, &step.name.name));
            if twice || self.find(&step.name).is_some() {
                let message = format!("the step `{}` is declared twice", step.name.name);
                problems.push(Problem::error("E702", step.name.span, message));
            }
        }
        for (index, step) in self.steps.iter().enumerate() {
            if self.find(&step.name) != Some(index) {
                let message = format!("the step `{}` is declared twice", step.name.name);
                problems.push(Problem::error("E702", step.name.span, message));
            }
            for association in &step.associations {
                if association.qualifier.needs_time() && association.time.is_none() {
                    problems.push(
                        Problem::error("E703", association.span, "this qualifier needs a time")
                            .expected("a duration behind the qualifier: (D, T#1s)"),
                    );
                }
            }
        }
        match self.steps.iter().filter(|s| s.initial).count() {
            0 => problems.push(
                Problem::error(
                    "E704",
                    pou.name.span,
                    format!("the chart of {} has no initial step", pou.name.name),
                )
                .expected("one INITIAL_STEP"),
            ),
            1 => {}
            _ => {
                for step in self.steps.iter().filter(|s| s.initial).skip(1) {
                    problems.push(Problem::error(
                        "E704",
                        step.name.span,
                        "a chart has only one initial step",
                    ));
                }
            }
        }
        for transition in &self.transitions {
            for step in transition.from.iter().chain(&transition.to) {
                if self.find(step).is_none() {
                    let message = format!("there is no step `{}`", step.name);
                    problems.push(Problem::error("E705", step.span, message));
                }
            }
            if transition.from.is_empty() || transition.to.is_empty() {
                problems.push(
                    Problem::error(
                        "E706",
                        transition.span,
                        "this transition leads from no step, or to none",
                    )
                    .hint("connect it to a step before and after it"),
                );
            }
        }
        for (index, action) in self.actions.iter().enumerate() {
            let first = self
                .actions
                .iter()
                .position(|a| same(&a.name.name, &action.name.name));
            if first != Some(index) {
                let message = format!("the action `{}` is declared twice", action.name.name);
                problems.push(Problem::error("E707", action.name.span, message));
            }
        }
        let inline = self.steps.iter().flat_map(|s| &s.associations);
        let inline = inline.filter_map(|a| match &a.action {
            Target::Inline(body) => Some(body),
            Target::Named(_) => None,
        });
        let bodies = self.actions.iter().map(|a| &a.body).chain(inline);
        for body in bodies.chain(self.transitions.iter().map(|t| &t.before)) {
            each_target(body, &mut |to| self.refuse_step_flag(to, problems));
        }
        problems.len() == before
    }

    /// `Step.X` and `Step.T` are the chart's own (clause 6.7.1).
    fn refuse_step_flag(&self, to: &Expr, problems: &mut Vec<Problem>) {
        if let ExprKind::Field(of, flag) = &to.kind
            && let ExprKind::Name(step) = &of.kind
            && (same(&flag.name, "X") || same(&flag.name, "T"))
            && self.steps.iter().any(|s| same(&s.name.name, step))
        {
            let message = format!("`{step}.{}` cannot be written: the chart does", flag.name);
            problems.push(
                Problem::error("E709", to.span, message).hint("lead to the step with a transition"),
            );
        }
    }

    /// Adds the chart's variables to the POU and makes its statements the POU's body.
    pub fn lower(mut self, pou: &mut Pou, problems: &mut Vec<Problem>) {
        if !self.validate(pou, problems) {
            return;
        }
        // The lower number is the higher priority; otherwise the order of the text counts.
        self.transitions
            .sort_by_key(|t| t.priority.unwrap_or(i64::MAX));
        let at = At(pou.name.span);
        let mut kept: Vec<VarDecl> = Vec::new();
        let mut temps: Vec<VarDecl> = Vec::new();
        let initial = |name: &Ident| self.find(name).is_some_and(|s| self.steps[s].initial);
        let steps = self.steps.iter().map(|s| (&s.name, s.initial));
        let macros = self.macros.iter();
        let macros = macros.map(|m| (&m.name, m.inside.iter().any(initial)));
        for (name, active) in steps.chain(macros) {
            let mut decl = At(name.span).var(&name.name, STEP_TYPE);
            if active {
                decl.init = Some(Init::Struct(
                    vec![(at.ident("X"), Init::Expr(at.bool(true)))],
                    name.span,
                ));
            }
            kept.push(decl);
        }
        let mut body = Vec::new();
        let macros = self.macros.iter().map(|m| &m.name.name);
        for name in self.steps.iter().map(|s| &s.name.name).chain(macros) {
            body.push(at.if_then(
                at.and(at.field(name, "X"), at.field(name, "__last")),
                vec![at.assign(at.field(name, "T"), since(at, at.field(name, "__start")))],
            ));
        }
        self.test_transitions(&mut temps, &mut body);
        for step in &self.steps {
            self.after_evolution(step, &mut body);
        }
        for step in &self.macros {
            step.lower(&mut body);
        }
        self.run_actions(&mut kept, &mut temps, &mut body);
        pou.vars.push(block(VarSection::Local, kept));
        pou.vars.push(block(VarSection::Temp, temps));
        pou.body = body;
    }

    fn test_transitions(&self, temps: &mut Vec<VarDecl>, body: &mut Vec<Stmt>) {
        let fired = |number: usize| format!("__fire{number}");
        for (number, transition) in self.transitions.iter().enumerate() {
            let at = At(transition.span);
            temps.push(at.var(&fired(number), "BOOL"));
            // An initial step is entered in the first scan, and left no earlier than in the next (clause 6.7.5): it was active
            // then. At the start of any scan the two are the same of other steps.
            let was_active = |step: &Ident| {
                let initial = self.find(step).is_some_and(|s| self.steps[s].initial);
                at.field(&step.name, if initial { "__last" } else { "X" })
            };
            let steps = transition.from.iter().map(was_active);
            let earlier = self.transitions[..number]
                .iter()
                .enumerate()
                .filter(|(_, other)| {
                    other
                        .from
                        .iter()
                        .any(|a| transition.from.iter().any(|b| same(&a.name, &b.name)))
                })
                .map(|(other, _)| at.not(at.name(&fired(other))));
            let Some(enabled) = at.all(steps.chain(earlier)) else {
                continue;
            };
            let mut inner = transition.before.clone();
            inner.push(at.assign(at.name(&fired(number)), transition.condition.clone()));
            body.push(at.assign(at.name(&fired(number)), at.bool(false)));
            body.push(at.if_then(enabled, inner));
        }
        for (number, transition) in self.transitions.iter().enumerate() {
            let at = At(transition.span);
            let left = transition
                .from
                .iter()
                .map(|s| at.assign(at.field(&s.name, "X"), at.bool(false)))
                .collect();
            body.push(at.if_then(at.name(&fired(number)), left));
        }
        for (number, transition) in self.transitions.iter().enumerate() {
            let at = At(transition.span);
            let mut entered = Vec::new();
            for step in &transition.to {
                entered.push(at.assign(at.field(&step.name, "X"), at.bool(true)));
                entered.push(at.assign(at.field(&step.name, "__start"), at.mc_time()));
                entered.push(at.assign(at.field(&step.name, "T"), at.expr(ExprKind::Time(0))));
            }
            body.push(at.if_then(at.name(&fired(number)), entered));
        }
    }

    /// Edges of the step's activity, for pulses and for the start of its time.
    fn after_evolution(&self, step: &Step, body: &mut Vec<Stmt>) {
        let at = At(step.name.span);
        let name = &step.name.name;
        let pulses = step.associations.iter().any(|a| {
            matches!(
                a.qualifier,
                Qualifier::Pulse | Qualifier::PulseRising | Qualifier::PulseFalling
            )
        });
        let x = || at.field(name, "X");
        let last = || at.field(name, "__last");
        if pulses {
            body.push(at.assign(at.field(name, "__rise"), at.and(x(), at.not(last()))));
            body.push(at.assign(at.field(name, "__fall"), at.and(at.not(x()), last())));
        }
        if step.initial {
            body.push(at.if_then(
                at.and(x(), at.not(last())),
                vec![at.assign(at.field(name, "__start"), at.mc_time())],
            ));
        }
        body.push(at.assign(last(), x()));
    }

    fn run_actions(&self, kept: &mut Vec<VarDecl>, temps: &mut Vec<VarDecl>, body: &mut Vec<Stmt>) {
        // Actions in the order of their declaration, then variables and statements in the order of the steps.
        let mut controls: Vec<Control<'_>> = Vec::new();
        for action in &self.actions {
            controls.push(Control::new(Kind::Body(&action.body), action.name.span));
        }
        for step in &self.steps {
            for association in &step.associations {
                let number = match &association.action {
                    Target::Inline(statements) => {
                        controls.push(Control::new(Kind::Body(statements), association.span));
                        controls.len() - 1
                    }
                    Target::Named(expr) => self.control_of(expr, &mut controls),
                };
                controls[number].users.push((step, association));
            }
        }
        for (number, control) in controls.iter().enumerate() {
            if !control.users.is_empty() {
                control.lower(number, kept, temps, body);
            }
        }
    }

    fn control_of<'a>(&'a self, expr: &'a Expr, controls: &mut Vec<Control<'a>>) -> usize {
        if let ExprKind::Name(name) = &expr.kind
            && let Some(number) = self.actions.iter().position(|a| same(&a.name.name, name))
        {
            return number;
        }
        let text = shape(expr);
        let found = controls.iter().position(
            |c| matches!(c.kind, Kind::Variable(other) if text.is_some() && shape(other) == text),
        );
        found.unwrap_or_else(|| {
            controls.push(Control::new(Kind::Variable(expr), expr.span));
            controls.len() - 1
        })
    }
}

impl MacroStep {
    /// Its activity and the time since it began, from those of its steps.
    fn lower(&self, body: &mut Vec<Stmt>) {
        let at = At(self.name.span);
        let name = &self.name.name;
        let inside = self.inside.iter().map(|s| at.field(&s.name, "X"));
        let active = at.any(inside).unwrap_or(at.bool(false));
        body.push(at.assign(at.field(name, "X"), active));
        let (x, last) = (at.field(name, "X"), at.field(name, "__last"));
        let entered = vec![
            at.assign(at.field(name, "__start"), at.mc_time()),
            at.assign(at.field(name, "T"), at.expr(ExprKind::Time(0))),
        ];
        body.push(at.if_then(at.and(x.clone(), at.not(last.clone())), entered));
        body.push(at.assign(last, x));
    }
}

/// A name or dotted path in upper case, to see that two mean the same variable.
fn shape(expr: &Expr) -> Option<String> {
    match &expr.kind {
        ExprKind::Name(name) | ExprKind::Direct(name) => Some(name.to_ascii_uppercase()),
        ExprKind::Field(of, field) => Some(format!(
            "{}.{}",
            shape(of)?,
            field.name.to_ascii_uppercase()
        )),
        ExprKind::Bit(of, bit) => Some(format!("{}.{bit}", shape(of)?)),
        _ => None,
    }
}

fn since(at: At, start: Expr) -> Expr {
    at.binary(BinOp::Sub, at.mc_time(), start)
}

enum Kind<'a> {
    Body(&'a [Stmt]),
    Variable(&'a Expr),
}

/// What decides whether an action runs: all its associations together (the standard's ACTION_CONTROL).
struct Control<'a> {
    kind: Kind<'a>,
    users: Vec<(&'a Step, &'a Association)>,
    at: At,
}

impl<'a> Control<'a> {
    fn new(kind: Kind<'a>, span: Span) -> Self {
        Self {
            kind,
            users: Vec::new(),
            at: At(span),
        }
    }

    fn of(&self, qualifiers: &[Qualifier]) -> impl Iterator<Item = &(&'a Step, &'a Association)> {
        self.users
            .iter()
            .filter(move |(_, a)| qualifiers.contains(&a.qualifier))
    }

    fn lower(
        &self,
        number: usize,
        kept: &mut Vec<VarDecl>,
        temps: &mut Vec<VarDecl>,
        body: &mut Vec<Stmt>,
    ) {
        use Qualifier as Q;
        let at = self.at;
        let active = |step: &Step| at.field(&step.name.name, "X");
        let elapsed = |step: &Step| at.field(&step.name.name, "T");
        let time = |a: &Association| a.time.clone().unwrap_or(at.expr(ExprKind::Time(0)));
        let mut runs: Vec<Expr> = Vec::new();
        for (step, association) in &self.users {
            let name = &step.name.name;
            match association.qualifier {
                Q::NonStored => runs.push(active(step)),
                Q::Limited => runs.push(at.and(
                    active(step),
                    at.binary(BinOp::Lt, elapsed(step), time(association)),
                )),
                Q::Delayed => runs.push(at.and(
                    active(step),
                    at.binary(BinOp::Ge, elapsed(step), time(association)),
                )),
                Q::Pulse | Q::PulseRising => runs.push(at.field(name, "__rise")),
                Q::PulseFalling => runs.push(at.field(name, "__fall")),
                _ => {}
            }
        }
        let reset = at.any(self.of(&[Q::Reset]).map(|(s, _)| active(s)));
        let set = at.any(self.of(&[Q::Set, Q::DelayedStored]).map(|(s, a)| {
            if a.qualifier == Q::Set {
                active(s)
            } else {
                at.and(active(s), at.binary(BinOp::Ge, elapsed(s), time(a)))
            }
        }));
        let timed: Vec<_> = self.of(&[Q::StoredDelayed, Q::StoredLimited]).collect();
        if let Kind::Variable(target) = self.kind
            && runs.is_empty()
            && timed.is_empty()
        {
            // Only set and reset: the variable itself remembers.
            if let Some(set) = set {
                body.push(at.if_then(set, vec![at.assign(target.clone(), at.bool(true))]));
            }
            if let Some(reset) = reset {
                body.push(at.if_then(reset, vec![at.assign(target.clone(), at.bool(false))]));
            }
            return;
        }
        let mut clear = Vec::new();
        if let Some(set) = set {
            let stored = format!("__stored{number}");
            kept.push(at.var(&stored, "BOOL"));
            body.push(at.if_then(set, vec![at.assign(at.name(&stored), at.bool(true))]));
            clear.push(stored.clone());
            runs.push(at.name(&stored));
        }
        for (index, (step, association)) in timed.iter().enumerate() {
            let on = format!("__on{number}_{index}");
            let since_when = format!("__since{number}_{index}");
            kept.push(at.var(&on, "BOOL"));
            kept.push(at.var(&since_when, "TIME"));
            let entered = at.and(active(step), at.not(at.name(&on)));
            body.push(at.if_then(
                entered,
                vec![
                    at.assign(at.name(&on), at.bool(true)),
                    at.assign(at.name(&since_when), at.mc_time()),
                ],
            ));
            let op = if association.qualifier == Q::StoredDelayed {
                BinOp::Ge
            } else {
                BinOp::Lt
            };
            let passed = since(at, at.name(&since_when));
            runs.push(at.and(at.name(&on), at.binary(op, passed, time(association))));
            clear.push(on);
        }
        let mut condition = at.any(runs).unwrap_or(at.bool(false));
        if let Some(reset) = reset {
            let cleared = clear
                .iter()
                .map(|name| at.assign(at.name(name), at.bool(false)))
                .collect();
            body.push(at.if_then(reset.clone(), cleared));
            condition = at.and(at.not(reset), condition);
        }
        match self.kind {
            Kind::Variable(target) => body.push(at.assign(target.clone(), condition)),
            Kind::Body(statements) => {
                let run = format!("__run{number}");
                temps.push(at.var(&run, "BOOL"));
                body.push(at.assign(at.name(&run), condition));
                let inner = at.stmt(StmtKind::Block(statements.to_vec()));
                body.push(at.if_then(at.name(&run), vec![inner]));
            }
        }
    }
}
