//! Function block diagrams and ladder diagrams: networks of elements, read into statements.
//!
//! Only connections count, never positions. Elements run in the order of their `executionOrderId` where they have one, else
//! in the order of the file, each after those that it takes values from. A function block that takes part in a loop of
//! connections is read as it was after its last call.

use std::collections::{BTreeMap, BTreeSet};

use roxmltree::Node;

use super::{Part, Reader, element, elements};
use crate::diag::Problem;
use crate::syntax::ast::{Arg, Expr, ExprKind, Pou, Stmt, StmtKind, VarDecl, VarSection};
use crate::syntax::build::{At, block, jump, with_jumps};
use crate::syntax::parser::parse_whole_expression;

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

    fn finish(self, body: Node<'a, 'i>, pou: &mut Pou) -> Vec<Stmt> {
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

    fn all(&mut self, body: Node<'a, 'i>) {
        let nodes: Vec<Node<'a, 'i>> = body.children().filter(Node::is_element).collect();
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

    /// The value at the element's own `connectionPointIn`.
    fn own_input(&mut self, node: Node<'a, 'i>) -> Option<Expr> {
        let point = element(node, "connectionPointIn")?;
        self.input(point)
    }

    /// The value at a connection point: several connections are a wired OR. `None` if nothing is connected.
    fn input(&mut self, point: Node<'a, 'i>) -> Option<Expr> {
        if let Some(text) = element(point, "expression") {
            let part = self.reader.text_part(text);
            return self.parse(&part);
        }
        let at = At(self.reader.tag(point));
        let values: Vec<Expr> = elements(point, "connection")
            .filter_map(|c| self.connection(c))
            .collect();
        at.any(values)
    }

    fn connection(&mut self, connection: Node<'a, 'i>) -> Option<Expr> {
        let id = connection
            .attribute("refLocalId")
            .unwrap_or_default()
            .to_owned();
        let Some(node) = self.by_id.get(&id).copied() else {
            let span = self.reader.tag(connection);
            let message = format!("this connection begins at element {id}, which does not exist");
            self.reader.report(Problem::error("E610", span, message));
            return None;
        };
        let formal = connection.attribute("formalParameter").unwrap_or_default();
        self.value(node, &id, formal)
    }

    /// The value of an element's output.
    fn value(&mut self, node: Node<'a, 'i>, id: &str, formal: &str) -> Option<Expr> {
        let span = self.reader.tag(node);
        let at = At(span);
        if self.depth > DEPTH_MAX {
            self.reader.report(Problem::error(
                "E608",
                span,
                "this chain of connections is too long",
            ));
            return None;
        }
        self.depth += 1;
        let value = match node.tag_name().name() {
            "leftPowerRail" => Some(at.bool(true)),
            "inVariable" => {
                let value = self.expression(node)?;
                Some(self.modified(node, value))
            }
            "inOutVariable" => {
                if !self.later(node) && !self.feeds_itself(node) {
                    self.run(node);
                }
                let value = self.expression(node)?;
                Some(self.modified_at(node, OUT, value))
            }
            "contact" => self.contact(node, id),
            "coil" | "outVariable" => {
                self.run(node);
                self.wires.get(&(id.to_owned(), String::new())).cloned()
            }
            "block" => self.block_value(node, id, formal),
            "connector" => self.own_input(node),
            "continuation" => self.continuation(node),
            name => {
                self.reader.report(Problem::error(
                    "E609",
                    span,
                    format!("<{name}> gives no value to what is connected to it"),
                ));
                None
            }
        };
        self.depth -= 1;
        value
    }

    fn continuation(&mut self, node: Node<'a, 'i>) -> Option<Expr> {
        let name = node.attribute("name").unwrap_or_default().to_owned();
        let found = self.connector_of(node);
        match found {
            Some(connector) => self.own_input(connector),
            None => {
                let span = self.reader.tag(node);
                let message = format!("there is no connector `{name}`");
                self.reader.report(Problem::error("E610", span, message));
                None
            }
        }
    }

    fn contact(&mut self, node: Node<'a, 'i>, id: &str) -> Option<Expr> {
        let key = (id.to_owned(), String::new());
        if let Some(wire) = self.wires.get(&key) {
            return Some(wire.clone());
        }
        match self.states.get(id) {
            Some(State::Running) => {
                let span = self.reader.tag(node);
                self.reader.report(Problem::error(
                    "E611",
                    span,
                    "these contacts feed themselves",
                ));
                return None;
            }
            _ => self.states.insert(id.to_owned(), State::Running),
        };
        let at = At(self.reader.tag(node));
        let variable = self.variable(node)?;
        let value = self.modified(node, variable);
        let before = self.own_input(node);
        let result = match before {
            Some(Expr {
                kind: ExprKind::Bool(true),
                ..
            }) => value,
            Some(before) => at.and(before, value),
            // Connected to nothing: no power comes.
            None => at.bool(false),
        };
        self.states.insert(id.to_owned(), State::Done);
        if self.users.get(id).copied().unwrap_or(0) > 1 {
            let wire = self.wire(at, "w", false);
            self.emit(at.assign(at.name(&wire), result));
            let wire = at.name(&wire);
            self.wires.insert(key, wire.clone());
            return Some(wire);
        }
        Some(result)
    }

    /// Negation and edges of an element or pin.
    fn modified(&mut self, node: Node<'a, 'i>, value: Expr) -> Expr {
        self.modified_at(node, PLAIN, value)
    }

    fn modified_at(&mut self, node: Node<'a, 'i>, side: Side, value: Expr) -> Expr {
        let at = At(value.span);
        let mut value = value;
        if let Some(edge) = node.attribute(side.edge).filter(|e| *e != "none") {
            let ty = if edge == "falling" {
                "F_TRIG"
            } else {
                "R_TRIG"
            };
            let trigger = self.new_name("trig");
            self.kept.push(at.var(&trigger, ty));
            let call = at.invoke(at.name(&trigger), vec![at.input("CLK", value)]);
            self.emit(call);
            value = at.field(&trigger, "Q");
        }
        if is_true(node, side.negated) {
            value = at.not(value);
        }
        value
    }

    /// A variable of this diagram's own; `kept` from scan to scan.
    fn wire(&mut self, at: At, what: &str, kept: bool) -> String {
        let name = self.new_name(what);
        let decl = at.wire(&name);
        if kept {
            self.kept.push(decl);
        } else {
            self.temps.push(decl);
        }
        name
    }

    fn parse(&mut self, part: &Part) -> Option<Expr> {
        match parse_whole_expression(part.source, &part.text, part.base) {
            Ok(expr) => Some(expr),
            Err(problems) => {
                problems.into_iter().for_each(|p| self.reader.report(p));
                None
            }
        }
    }

    fn expression(&mut self, node: Node<'a, 'i>) -> Option<Expr> {
        let Some(text) = element(node, "expression") else {
            let span = self.reader.tag(node);
            self.reader.report(Problem::error(
                "E606",
                span,
                "this element has no <expression>",
            ));
            return None;
        };
        let part = self.reader.text_part(text);
        self.parse(&part)
    }

    /// `<variable>x</variable>` of contacts and coils.
    fn variable(&mut self, node: Node<'a, 'i>) -> Option<Expr> {
        let Some(text) = element(node, "variable") else {
            let span = self.reader.tag(node);
            self.reader.report(Problem::error(
                "E606",
                span,
                "this element has no <variable>",
            ));
            return None;
        };
        let part = self.reader.text_part(text);
        self.parse(&part)
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
        self.store(node, target, value);
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
        self.store_at(node, side, target, value);
    }

    /// Plain, set or reset.
    fn store(&mut self, node: Node<'a, 'i>, target: Expr, value: Expr) {
        self.store_at(node, PLAIN, target, value);
    }

    fn store_at(&mut self, node: Node<'a, 'i>, side: Side, target: Expr, value: Expr) {
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
        self.emit(stmt);
    }

    fn pins(node: Node<'a, 'i>, list: &'static str) -> Vec<Node<'a, 'i>> {
        element(node, list)
            .map(|l| elements(l, "variable").collect())
            .unwrap_or_default()
    }

    fn block(&mut self, node: Node<'a, 'i>, id: &str) {
        let span = self.reader.tag(node);
        let at = At(span);
        let Some(type_name) = node
            .attribute("typeName")
            .map(str::trim)
            .filter(|t| !t.is_empty())
        else {
            self.reader
                .report(Problem::error("E606", span, "<block> has no `typeName`"));
            return;
        };
        let instance = node
            .attribute("instanceName")
            .map(str::trim)
            .filter(|n| !n.is_empty());
        let mut enable = None;
        let mut args: Vec<Arg> = Vec::new();
        let mut gaps = false;
        for list in ["inputVariables", "inOutVariables"] {
            for pin in Self::pins(node, list) {
                let name = pin.attribute("formalParameter").unwrap_or_default().trim();
                let point = element(pin, "connectionPointIn");
                let Some(value) = point.and_then(|p| self.input(p)) else {
                    gaps = true;
                    continue;
                };
                let value = self.modified(pin, value);
                if name.eq_ignore_ascii_case("EN") {
                    enable = Some(value);
                } else {
                    let at = At(self.reader.tag(pin));
                    args.push(at.input(name, value));
                }
            }
        }
        let outputs = Self::pins(node, "outputVariables");
        let mut run = Vec::new();
        let eno = outputs.iter().any(|o| {
            o.attribute("formalParameter")
                .is_some_and(|n| n.eq_ignore_ascii_case("ENO"))
        });
        match instance {
            Some(instance) => {
                let part = self.reader.attribute_part(node, "instanceName");
                let callee = part
                    .and_then(|p| self.parse(&p))
                    .unwrap_or(at.name(instance));
                run.push(at.invoke(callee, args));
            }
            None => {
                // Standard functions take their arguments in order, whatever their pins are called.
                let known = self
                    .reader
                    .functions
                    .contains(&type_name.to_ascii_uppercase());
                if !known && !gaps
                    || args
                        .iter()
                        .any(|a| a.name.as_ref().is_none_or(|n| n.name.is_empty()))
                {
                    args.iter_mut().for_each(|a| a.name = None);
                }
                let mut result = None;
                for output in &outputs {
                    let name = output
                        .attribute("formalParameter")
                        .unwrap_or_default()
                        .trim();
                    if name.eq_ignore_ascii_case("ENO") {
                        continue;
                    }
                    let is_result = result.is_none()
                        && (name.is_empty()
                            || ["OUT", "OUT1", type_name]
                                .iter()
                                .any(|n| n.eq_ignore_ascii_case(name))
                            || !known);
                    let wire = self.wire(at, "w", enable.is_some());
                    self.wires
                        .insert((id.to_owned(), name.to_ascii_uppercase()), at.name(&wire));
                    if is_result {
                        result = Some(wire);
                    } else {
                        args.push(at.output(name, at.name(&wire)));
                    }
                }
                let call = at.call(at.name(type_name), args);
                run.push(match result {
                    Some(wire) => at.assign(at.name(&wire), call),
                    None => at.stmt(StmtKind::Call(call)),
                });
            }
        }
        let mut off = Vec::new();
        if eno {
            let wire = self.new_name("eno");
            self.temps.push(at.var(&wire, "BOOL"));
            run.push(at.assign(at.name(&wire), at.bool(true)));
            off.push(at.assign(at.name(&wire), at.bool(false)));
            self.wires
                .insert((id.to_owned(), "ENO".to_owned()), at.name(&wire));
        }
        match enable {
            Some(Expr {
                kind: ExprKind::Bool(true),
                ..
            })
            | None => {
                run.into_iter().for_each(|s| self.emit(s));
            }
            Some(enable) => self.emit(at.stmt(StmtKind::If(vec![(enable, run)], off))),
        }
        self.states.insert(id.to_owned(), State::Done);
        // Outputs that are written to a variable at the pin itself.
        for output in outputs {
            let text = element(output, "connectionPointOut").and_then(|p| element(p, "expression"));
            if let Some(text) = text {
                let name = output
                    .attribute("formalParameter")
                    .unwrap_or_default()
                    .to_owned();
                let part = self.reader.text_part(text);
                if part.text.trim().is_empty() {
                    continue;
                }
                if let (Some(target), Some(value)) =
                    (self.parse(&part), self.block_value(node, id, &name))
                {
                    self.store(output, target, value);
                }
            }
        }
    }

    fn block_value(&mut self, node: Node<'a, 'i>, id: &str, formal: &str) -> Option<Expr> {
        let span = self.reader.tag(node);
        let at = At(span);
        let outputs = Self::pins(node, "outputVariables");
        let in_outs = Self::pins(node, "inOutVariables");
        let named = |pin: &&Node<'_, '_>| {
            pin.attribute("formalParameter")
                .is_some_and(|n| n.trim().eq_ignore_ascii_case(formal))
        };
        if let Some(pin) = in_outs.iter().find(named).filter(|_| !formal.is_empty()) {
            self.run(node);
            return element(*pin, "connectionPointIn").and_then(|p| self.input(p));
        }
        let pin = if formal.is_empty() {
            outputs.iter().find(|o| {
                !o.attribute("formalParameter")
                    .is_some_and(|n| n.eq_ignore_ascii_case("ENO"))
            })
        } else {
            outputs.iter().find(named)
        };
        let name = pin
            .and_then(|p| p.attribute("formalParameter"))
            .unwrap_or(formal)
            .trim()
            .to_owned();
        if !self.later(node) {
            self.run(node);
        }
        let instance = node
            .attribute("instanceName")
            .map(str::trim)
            .filter(|n| !n.is_empty());
        let key = (id.to_owned(), name.to_ascii_uppercase());
        let value = match (instance, self.wires.get(&key)) {
            (_, Some(wire)) => wire.clone(),
            (Some(instance), None) => {
                let part = self.reader.attribute_part(node, "instanceName");
                let base = part
                    .and_then(|p| self.parse(&p))
                    .unwrap_or(at.name(instance));
                at.expr(ExprKind::Field(Box::new(base), at.ident(&name)))
            }
            (None, None) => {
                self.reader.report(
                    Problem::error(
                        "E611",
                        span,
                        "this loop of connections leads through functions only",
                    )
                    .hint("write the value to a variable and read it from there"),
                );
                return None;
            }
        };
        Some(match pin {
            Some(pin) if is_true(*pin, "negated") => at.not(value),
            _ => value,
        })
    }

    /// Whether a loop of connections leads through the variable: then it is read as it was before it is written, which is what a
    /// feedback variable is for (third edition, clause 8.1.4).
    fn feeds_itself(&self, node: Node<'a, 'i>) -> bool {
        let mut seen = BTreeSet::new();
        let mut next = vec![node];
        while let Some(at) = next.pop() {
            for connection in at
                .descendants()
                .filter(|n| n.has_tag_name_local("connection"))
            {
                let id = connection.attribute("refLocalId").unwrap_or_default();
                let Some(before) = self.by_id.get(id).copied() else {
                    continue;
                };
                if before == node {
                    return true;
                }
                if seen.insert(id) {
                    next.push(before);
                    if let Some(connector) = self.connector_of(before) {
                        next.push(connector);
                    }
                }
            }
        }
        false
    }

    /// Where what comes out of a continuation goes in.
    fn connector_of(&self, node: Node<'a, 'i>) -> Option<Node<'a, 'i>> {
        let name = node.attribute("name")?;
        if !node.has_tag_name_local("continuation") {
            return None;
        }
        self.by_id
            .values()
            .copied()
            .find(|n| n.has_tag_name_local("connector") && n.attribute("name") == Some(name))
    }

    /// Whether the element is to run after one that is running, by their numbers.
    fn later(&self, node: Node<'a, 'i>) -> bool {
        let number = |n: Node<'_, '_>| {
            n.attribute("executionOrderId")
                .and_then(|n| n.parse::<u64>().ok())
                .filter(|n| *n > 0 && self.labels.is_empty())
        };
        let Some(own) = number(node) else {
            return false;
        };
        let running: BTreeSet<u64> = self
            .states
            .iter()
            .filter(|(_, s)| **s == State::Running)
            .filter_map(|(id, _)| self.by_id.get(id).and_then(|n| number(*n)))
            .collect();
        running.first().is_some_and(|first| own > *first)
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
