//! Function block diagrams and ladder diagrams: networks of elements, read into statements.
//!
//! Only connections count, never positions. Elements run in the order of their `executionOrderId` where they have one, else
//! in the order of the file, each after those that it takes values from. A function block that takes part in a loop of
//! connections is read as it was after its last call.

mod blocks;
mod values;

use std::collections::{BTreeMap, BTreeSet};

use roxmltree::Node;

use super::{Reader, element};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{Expr, ExprKind, Pou, Stmt, StmtKind, VarDecl, VarSection};
use crate::syntax::build::{At, block, jump, with_jumps};

/// How long a chain of connections may be.
const DEPTH_MAX: usize = 300;

/// Elements that hold no logic.
const SILENT: [&str; 9] = [
    "comment",
    "vendorElement",
    "addData",
    "documentation",
    "leftPowerRail",
    "rightPowerRail",
    "position",
    "error",
    "networkComment",
];

/// Attributes that modify what goes in or comes out.
#[derive(Clone, Copy)]
struct Side {
    negated: &'static str,
    edge: &'static str,
    storage: &'static str,
}

const PLAIN: Side = Side {
    negated: "negated",
    edge: "edge",
    storage: "storage",
};
/// `<inOutVariable>` has both.
const IN: Side = Side {
    negated: "negatedIn",
    edge: "edgeIn",
    storage: "storageIn",
};
const OUT: Side = Side {
    negated: "negatedOut",
    edge: "edgeOut",
    storage: "storageOut",
};

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    New,
    Running,
    Done,
}

pub struct Network<'r, 's, 'a, 'i> {
    reader: &'r mut Reader<'s>,
    by_id: BTreeMap<String, Node<'a, 'i>>,
    /// Number of connections that begin at an element.
    users: BTreeMap<String, usize>,
    states: BTreeMap<String, State>,
    /// Values of elements that have run.
    wires: BTreeMap<(String, String), Expr>,
    /// Blocks that run only at times, with what says whether they have.
    enabled: BTreeMap<String, Expr>,
    /// Instances that blocks call, with the type that is drawn.
    instances: Vec<(String, String, Span)>,
    kept: Vec<VarDecl>,
    temps: Vec<VarDecl>,
    segments: Vec<Vec<Stmt>>,
    labels: Vec<String>,
    pc: Option<String>,
    /// The name under which a transition's result is assigned, and the wire that it goes to.
    result: Option<(String, String)>,
    depth: usize,
}

fn is_true(node: Node<'_, '_>, attribute: &str) -> bool {
    node.attribute(attribute) == Some("true")
}

impl<'r, 's, 'a, 'i> Network<'r, 's, 'a, 'i> {
    pub fn new(reader: &'r mut Reader<'s>, body: Node<'a, 'i>) -> Self {
        let mut by_id = BTreeMap::new();
        let mut users = BTreeMap::new();
        for node in body.children().filter(Node::is_element) {
            if let Some(id) = node.attribute("localId") {
                by_id.insert(id.to_owned(), node);
            }
        }
        for node in body
            .descendants()
            .filter(|n| n.has_tag_name_local("connection"))
        {
            if let Some(id) = node.attribute("refLocalId") {
                *users.entry(id.to_owned()).or_insert(0) += 1;
            }
        }
        Self {
            reader,
            by_id,
            users,
            states: BTreeMap::new(),
            wires: BTreeMap::new(),
            enabled: BTreeMap::new(),
            instances: Vec::new(),
            kept: Vec::new(),
            temps: Vec::new(),
            segments: vec![Vec::new()],
            labels: Vec::new(),
            pc: None,
            result: None,
            depth: 0,
        }
    }

    /// The whole diagram as statements.
    pub fn body(mut self, body: Node<'a, 'i>, pou: &mut Pou) -> Vec<Stmt> {
        self.all(body);
        self.finish(body, pou)
    }

    /// The diagram of a transition: statements, and the value that goes to the transition's name.
    pub fn condition(
        mut self,
        body: Node<'a, 'i>,
        name: &str,
        pou: &mut Pou,
    ) -> (Vec<Stmt>, Option<Expr>) {
        let wire = self.new_name("cond");
        let at = At(self.reader.tag(body));
        self.temps.push(at.var(&wire, "BOOL"));
        self.result = Some((name.to_owned(), wire.clone()));
        self.all(body);
        let used = self.result.is_none();
        let statements = self.finish(body, pou);
        (statements, used.then(|| at.name(&wire)))
    }

    /// The value that a connection point has, with what has to run for it: for conditions drawn beside a chart.
    pub fn point(mut self, point: Node<'a, 'i>, pou: &mut Pou) -> (Vec<Stmt>, Option<Expr>) {
        let value = self.input(point);
        let statements = self.finish(point, pou);
        (statements, value)
    }

    fn finish(mut self, body: Node<'a, 'i>, pou: &mut Pou) -> Vec<Stmt> {
        self.refuse_other_types(pou);
        let at = At(self.reader.tag(body));
        let mut temps = self.temps;
        let statements = match &self.pc {
            Some(pc) => {
                temps.push(at.var(pc, "DINT"));
                with_jumps(at, pc, self.segments)
            }
            None => self.segments.concat(),
        };
        if !self.kept.is_empty() {
            pou.vars.push(block(VarSection::Local, self.kept));
        }
        if !temps.is_empty() {
            pou.vars.push(block(VarSection::Temp, temps));
        }
        statements
    }

    /// Elements that a connection or jump could mean as well as another one.
    fn refuse_doubles(&mut self, nodes: &[Node<'a, 'i>]) {
        let mut seen = BTreeSet::new();
        let silent = |node: &&Node<'_, '_>| SILENT.contains(&node.tag_name().name());
        for node in nodes.iter().filter(|n| !silent(n)) {
            let of = |tag: &str, name: &str| {
                let found = node.has_tag_name_local(tag).then(|| node.attribute(name));
                found.flatten().map(str::to_ascii_uppercase)
            };
            let names = [
                ("E711", "label", of("label", "label")),
                ("E610", "connector", of("connector", "name")),
                (
                    "E610",
                    "localId",
                    node.attribute("localId").map(str::to_owned),
                ),
            ];
            for (code, what, name) in names {
                if let Some(name) = name
                    && !seen.insert((what, name.clone()))
                {
                    let span = self.reader.tag(*node);
                    let message = format!("the {what} `{name}` stands twice");
                    self.reader.report(Problem::error(code, span, message));
                }
            }
        }
    }

    /// Elements that no connection reaches: most likely one was cut off when the diagram was edited.
    fn warn_of_loose_ends(&mut self, nodes: &[Node<'a, 'i>]) {
        for node in nodes {
            let kind = node.tag_name().name();
            let open = !element(*node, "connectionPointIn").is_some_and(|p| {
                element(p, "connection").is_some() || element(p, "expression").is_some()
            });
            let id = node.attribute("localId").unwrap_or_default();
            let unused = self.users.get(id).copied().unwrap_or(0) == 0;
            let what = match kind {
                "contact" if open => "no power comes to this contact: nothing is connected to it",
                "coil" if open => "no power comes to this coil: nothing is connected to it",
                "outVariable" if open => "this variable is not written: nothing is connected to it",
                "contact" if unused => "the power of this contact goes nowhere",
                "inVariable" if unused => "the value of this variable goes nowhere",
                _ => continue,
            };
            let span = self.reader.tag(*node);
            self.reader
                .report(Problem::warning("W719", span, what).hint("connect it, or remove it"));
        }
    }

    fn all(&mut self, body: Node<'a, 'i>) {
        let nodes: Vec<Node<'a, 'i>> = body.children().filter(Node::is_element).collect();
        self.refuse_doubles(&nodes);
        self.warn_of_loose_ends(&nodes);
        self.labels = nodes
            .iter()
            .filter(|n| n.has_tag_name_local("label"))
            .filter_map(|n| n.attribute("label").map(str::to_ascii_uppercase))
            .collect();
        let mut order: Vec<(u64, usize)> = Vec::new();
        for (index, node) in nodes.iter().enumerate() {
            let number = node
                .attribute("executionOrderId")
                .and_then(|n| n.parse().ok())
                .filter(|n| *n > 0 && self.labels.is_empty());
            order.push((number.unwrap_or(u64::MAX), index));
        }
        order.sort_unstable();
        for (_, index) in order {
            let node = nodes[index];
            match node.tag_name().name() {
                "label" => self.segments.push(Vec::new()),
                "block" | "coil" | "outVariable" | "inOutVariable" | "jump" | "return" => {
                    self.run(node);
                }
                "contact" | "inVariable" | "connector" | "continuation" => {}
                name if SILENT.contains(&name) => {}
                // Charts have elements of their own beside those of a network.
                name if super::chart::ELEMENTS.contains(&name) => {}
                name => {
                    let span = self.reader.tag(node);
                    self.reader.report(Problem::error(
                        "E609",
                        span,
                        format!("<{name}> is no element of a diagram that can be run"),
                    ));
                }
            }
        }
    }

    fn new_name(&mut self, what: &str) -> String {
        self.reader.serial += 1;
        format!("__{what}{}", self.reader.serial)
    }

    fn emit(&mut self, stmt: Stmt) {
        if let Some(last) = self.segments.last_mut() {
            last.push(stmt);
        }
    }

    /// Runs an element once.
    fn run(&mut self, node: Node<'a, 'i>) {
        let id = node.attribute("localId").unwrap_or_default().to_owned();
        match self.states.get(&id).copied().unwrap_or(State::New) {
            State::New => {}
            State::Running | State::Done => return,
        }
        if self.depth > DEPTH_MAX {
            let span = self.reader.tag(node);
            self.reader.report(Problem::error(
                "E608",
                span,
                "this chain of connections is too long",
            ));
            return;
        }
        self.depth += 1;
        self.states.insert(id.clone(), State::Running);
        match node.tag_name().name() {
            "block" => self.block(node, &id),
            "coil" => self.coil(node, &id),
            "outVariable" => self.out_variable(node),
            "inOutVariable"
                if element(node, "connectionPointIn")
                    .is_some_and(|p| element(p, "connection").is_some()) =>
            {
                self.out_variable(node);
            }
            "jump" => self.jump(node),
            "return" => {
                let at = At(self.reader.tag(node));
                let condition = self.own_input(node).unwrap_or(at.bool(true));
                self.emit(at.if_then(condition, vec![at.stmt(StmtKind::Return)]));
            }
            _ => {}
        }
        self.states.insert(id, State::Done);
        self.depth -= 1;
    }

    fn jump(&mut self, node: Node<'a, 'i>) {
        let span = self.reader.tag(node);
        let at = At(span);
        let label = node
            .attribute("label")
            .unwrap_or_default()
            .to_ascii_uppercase();
        let Some(number) = self.labels.iter().position(|l| *l == label) else {
            let message = format!("there is no label `{label}`");
            self.reader.report(Problem::error("E711", span, message));
            return;
        };
        let condition = self.own_input(node).unwrap_or(at.bool(true));
        let pc = match &self.pc {
            Some(pc) => pc.clone(),
            None => {
                let pc = self.new_name("pc");
                self.pc = Some(pc.clone());
                pc
            }
        };
        self.emit(at.if_then(condition, jump(at, &pc, number + 1)));
    }

    fn coil(&mut self, node: Node<'a, 'i>, id: &str) {
        let at = At(self.reader.tag(node));
        let (Some(target), value) = (self.variable(node), self.own_input(node)) else {
            return;
        };
        let mut value = value.unwrap_or(at.bool(false));
        if self.users.get(id).copied().unwrap_or(0) > 0 {
            let wire = self.wire(at, "w", false);
            self.emit(at.assign(at.name(&wire), value));
            value = at.name(&wire);
            self.wires
                .insert((id.to_owned(), String::new()), value.clone());
        }
        let value = self.modified(node, value);
        self.store_at(node, PLAIN, target, value, None);
    }

    fn out_variable(&mut self, node: Node<'a, 'i>) {
        let Some(target) = self.expression(node) else {
            return;
        };
        let Some(value) = self.own_input(node) else {
            // A variable that nothing is connected to is left alone.
            return;
        };
        let side = if node.has_tag_name_local("inOutVariable") {
            IN
        } else {
            PLAIN
        };
        let value = self.modified_at(node, side, value);
        let id = node.attribute("localId").unwrap_or_default();
        if self.users.get(id).copied().unwrap_or(0) > 0 {
            self.wires
                .insert((id.to_owned(), String::new()), target.clone());
        }
        let ran = self
            .source(node)
            .and_then(|(id, formal)| self.ran(&id, &formal));
        self.store_at(node, side, target, value, ran);
    }

    /// Plain, set or reset; at times only `if_ran`.
    fn store_at(
        &mut self,
        node: Node<'a, 'i>,
        side: Side,
        target: Expr,
        value: Expr,
        if_ran: Option<Expr>,
    ) {
        let at = At(self.reader.tag(node));
        let mut target = target;
        if let (Some((name, wire)), ExprKind::Name(own)) = (&self.result, &target.kind)
            && own.eq_ignore_ascii_case(name)
        {
            target = at.name(wire);
            self.result = None;
        }
        let stmt = match node.attribute(side.storage) {
            Some("set") => at.if_then(value, vec![at.assign(target, at.bool(true))]),
            Some("reset") => at.if_then(value, vec![at.assign(target, at.bool(false))]),
            _ => at.assign(target, value),
        };
        self.emit(match if_ran {
            Some(ran) => at.if_then(ran, vec![stmt]),
            None => stmt,
        });
    }
}

/// Names of elements without regard to their namespace.
pub trait LocalName {
    fn has_tag_name_local(&self, name: &str) -> bool;
}

impl LocalName for Node<'_, '_> {
    fn has_tag_name_local(&self, name: &str) -> bool {
        self.is_element() && self.tag_name().name() == name
    }
}
