//! What flows along connections: values of variables, contacts and connectors, and how they are changed on the way.

use std::collections::BTreeSet;

use roxmltree::Node;

use super::{DEPTH_MAX, LocalName, Network, OUT, PLAIN, Side, State, is_true};
use crate::diag::Problem;
use crate::plcopen::{Part, element, elements};
use crate::syntax::ast::{Expr, ExprKind};
use crate::syntax::build::At;
use crate::syntax::parser::parse_whole_expression;

impl<'a, 'i> Network<'_, '_, 'a, 'i> {
    /// The value at the element's own `connectionPointIn`.
    pub(super) fn own_input(&mut self, node: Node<'a, 'i>) -> Option<Expr> {
        let point = element(node, "connectionPointIn")?;
        self.input(point)
    }

    /// The value at a connection point: several connections are a wired OR. `None` if nothing is connected.
    pub(super) fn input(&mut self, point: Node<'a, 'i>) -> Option<Expr> {
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

    pub(super) fn connection(&mut self, connection: Node<'a, 'i>) -> Option<Expr> {
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
    pub(super) fn value(&mut self, node: Node<'a, 'i>, id: &str, formal: &str) -> Option<Expr> {
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

    pub(super) fn continuation(&mut self, node: Node<'a, 'i>) -> Option<Expr> {
        let found = self.connector_of(node);
        match found {
            Some(connector) => self.own_input(connector),
            None => {
                let span = self.reader.tag(node);
                let name = node.attribute("name").unwrap_or_default();
                let message = format!("there is no connector `{name}`");
                self.reader.report(Problem::error("E610", span, message));
                None
            }
        }
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

    /// The one output, as element and name, that the element's input comes from, through connectors too.
    pub(super) fn source(&self, node: Node<'a, 'i>) -> Option<(String, String)> {
        let mut at = node;
        for _ in 0..DEPTH_MAX {
            let point = element(at, "connectionPointIn")?;
            let mut connections = elements(point, "connection");
            let only = connections.next()?;
            if connections.next().is_some() {
                return None;
            }
            let id = only.attribute("refLocalId")?;
            let before = self.by_id.get(id).copied()?;
            at = match self.connector_of(before) {
                Some(connector) => connector,
                None if before.has_tag_name_local("connector") => before,
                None => {
                    let formal = only.attribute("formalParameter").unwrap_or_default();
                    return Some((id.to_owned(), formal.to_owned()));
                }
            };
        }
        None
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
                    next.extend(self.connector_of(before));
                }
            }
        }
        false
    }

    pub(super) fn contact(&mut self, node: Node<'a, 'i>, id: &str) -> Option<Expr> {
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
    pub(super) fn modified(&mut self, node: Node<'a, 'i>, value: Expr) -> Expr {
        self.modified_at(node, PLAIN, value)
    }

    pub(super) fn modified_at(&mut self, node: Node<'a, 'i>, side: Side, value: Expr) -> Expr {
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
    pub(super) fn wire(&mut self, at: At, what: &str, kept: bool) -> String {
        let name = self.new_name(what);
        let decl = at.wire(&name);
        if kept {
            self.kept.push(decl);
        } else {
            self.temps.push(decl);
        }
        name
    }

    pub(super) fn parse(&mut self, part: &Part) -> Option<Expr> {
        match parse_whole_expression(part.source, &part.text, part.base) {
            Ok(expr) => Some(expr),
            Err(problems) => {
                problems.into_iter().for_each(|p| self.reader.report(p));
                None
            }
        }
    }

    pub(super) fn expression(&mut self, node: Node<'a, 'i>) -> Option<Expr> {
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
    pub(super) fn variable(&mut self, node: Node<'a, 'i>) -> Option<Expr> {
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
}
