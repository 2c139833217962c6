//! Sequential function charts of PLCopen XML: steps and transitions by their connections.

use std::collections::BTreeSet;

use roxmltree::Node;

use super::network::{LocalName, Network};
use super::{Reader, element, elements};
use crate::diag::Problem;
use crate::syntax::ast::{Expr, Ident, Pou, Stmt};
use crate::syntax::literal;
use crate::syntax::parser::parse_whole_expression;
use crate::syntax::sfc::{Action, Association, Qualifier, Sfc, Step, Target, Transition};

/// Elements of a chart.
pub const ELEMENTS: [&str; 9] = [
    "step",
    "transition",
    "jumpStep",
    "macroStep",
    "actionBlock",
    "selectionDivergence",
    "selectionConvergence",
    "simultaneousDivergence",
    "simultaneousConvergence",
];

impl Reader<'_> {
    /// Reads the chart `<SFC>` of a POU, with its actions and named transitions.
    pub fn chart(&mut self, body: Node<'_, '_>, pou_node: Node<'_, '_>, pou: &mut Pou) {
        let before = self.problems.len();
        let mut sfc = Sfc::default();
        if let Some(actions) = element(pou_node, "actions") {
            for action in elements(actions, "action") {
                let Some(name) = self.name(action, "name") else {
                    continue;
                };
                let statements = element(action, "body")
                    .map(|b| self.statements_of(b, pou))
                    .unwrap_or_default();
                sfc.actions.push(Action {
                    name,
                    body: statements,
                });
            }
        }
        let nodes: Vec<Node<'_, '_>> = body.children().filter(Node::is_element).collect();
        for node in &nodes {
            match node.tag_name().name() {
                "step" => {
                    if let Some(name) = self.name(*node, "name") {
                        sfc.steps.push(Step {
                            name,
                            initial: node.attribute("initialStep") == Some("true"),
                            associations: Vec::new(),
                        });
                    }
                }
                "macroStep" => {
                    let span = self.tag(*node);
                    self.report(
                        Problem::error("E602", span, "a macro step is not supported")
                            .hint("draw its steps into the chart itself"),
                    );
                }
                _ => {}
            }
        }
        for node in nodes.iter().filter(|n| n.has_tag_name_local("actionBlock")) {
            self.action_block(*node, &nodes, &mut sfc, pou);
        }
        let transitions: Vec<Node<'_, '_>> = nodes
            .iter()
            .copied()
            .filter(|n| n.has_tag_name_local("transition"))
            .collect();
        for node in &transitions {
            let span = self.tag(*node);
            let (statements, condition) = self.transition_condition(*node, body, pou_node, pou);
            let mut from = Vec::new();
            self.before(*node, &nodes, "step", &mut BTreeSet::new(), &mut |step| {
                from.push(step);
            });
            let from = from
                .into_iter()
                .filter_map(|n| self.name(n, "name"))
                .collect();
            let Some(condition) = condition else {
                self.report(
                    Problem::error("E612", span, "this transition has no condition")
                        .hint("give it a condition; TRUE if it is always to fire"),
                );
                continue;
            };
            sfc.transitions.push(Transition {
                priority: node.attribute("priority").and_then(|p| p.parse().ok()),
                from,
                to: Vec::new(),
                before: statements,
                condition,
                span,
            });
        }
        if self.problems.len() != before {
            return;
        }
        // Each step and jump looks back for the transitions that lead to it.
        for node in &nodes {
            let target = match node.tag_name().name() {
                "step" => self.name(*node, "name"),
                "jumpStep" => self.name(*node, "targetName"),
                _ => continue,
            };
            let Some(target) = target else { continue };
            let mut leading = Vec::new();
            self.before(
                *node,
                &nodes,
                "transition",
                &mut BTreeSet::new(),
                &mut |t| {
                    leading.push(t);
                },
            );
            for transition in leading {
                if let Some(index) = transitions.iter().position(|t| *t == transition) {
                    sfc.transitions[index].to.push(Ident {
                        name: target.name.clone(),
                        span: target.span,
                    });
                }
            }
        }
        let mut problems = Vec::new();
        sfc.lower(pou, &mut problems);
        problems.into_iter().for_each(|p| self.report(p));
    }

    /// Calls `found` with the elements of the kind `stop` that stand before an element, divergences and convergences passed
    /// over.
    fn before<'a, 'i>(
        &mut self,
        node: Node<'a, 'i>,
        nodes: &[Node<'a, 'i>],
        stop: &str,
        seen: &mut BTreeSet<String>,
        found: &mut dyn FnMut(Node<'a, 'i>),
    ) {
        for point in elements(node, "connectionPointIn") {
            for connection in elements(point, "connection") {
                let id = connection.attribute("refLocalId").unwrap_or_default();
                if !seen.insert(id.to_owned()) {
                    continue;
                }
                let Some(source) = nodes.iter().find(|n| n.attribute("localId") == Some(id)) else {
                    let span = self.tag(connection);
                    let message =
                        format!("this connection begins at element {id}, which does not exist");
                    self.report(Problem::error("E610", span, message));
                    continue;
                };
                let name = source.tag_name().name();
                if name == stop {
                    found(*source);
                } else if name.ends_with("Divergence") || name.ends_with("Convergence") {
                    self.before(*source, nodes, stop, seen, found);
                }
            }
        }
    }

    fn action_block<'a, 'i>(
        &mut self,
        node: Node<'a, 'i>,
        nodes: &[Node<'a, 'i>],
        sfc: &mut Sfc,
        pou: &mut Pou,
    ) {
        let mut steps = Vec::new();
        self.before(node, nodes, "step", &mut BTreeSet::new(), &mut |s| {
            steps.push(s)
        });
        let span = self.tag(node);
        let [step] = steps.as_slice() else {
            self.report(Problem::error(
                "E610",
                span,
                "this action block is connected to no step, or to several",
            ));
            return;
        };
        let step = step.attribute("name").unwrap_or_default().to_owned();
        for action in elements(node, "action") {
            let span = self.tag(action);
            let word = action.attribute("qualifier").unwrap_or("N");
            let Some(qualifier) = Qualifier::from_name(word) else {
                let message = format!("`{word}` is no qualifier of an action");
                self.report(
                    Problem::error("E708", span, message)
                        .expected("N, R, S, L, D, P, P0, P1, SD, DS or SL"),
                );
                continue;
            };
            let time = match action.attribute("duration").map(str::trim) {
                Some(text) if !text.is_empty() => self.duration(action, text),
                _ => None,
            };
            let target = if let Some(reference) = element(action, "reference") {
                let Some(part) = self.attribute_part(reference, "name") else {
                    continue;
                };
                match parse_whole_expression(part.source, &part.text, part.base) {
                    Ok(expr) => Target::Named(expr),
                    Err(problems) => {
                        problems.into_iter().for_each(|p| self.report(p));
                        continue;
                    }
                }
            } else if let Some(inline) = element(action, "inline") {
                Target::Inline(self.statements_of(inline, pou))
            } else {
                self.report(Problem::error(
                    "E612",
                    span,
                    "this action has neither a name nor a body",
                ));
                continue;
            };
            let found = sfc
                .steps
                .iter_mut()
                .find(|s| s.name.name.eq_ignore_ascii_case(step.trim()));
            if let Some(step) = found {
                step.associations.push(Association {
                    qualifier,
                    time,
                    action: target,
                    span,
                });
            }
        }
    }

    /// `T#1s`, a variable, or `PT1S`.
    fn duration(&mut self, node: Node<'_, '_>, text: &str) -> Option<Expr> {
        let part = self.attribute_part(node, "duration")?;
        let upper = text.to_ascii_uppercase();
        if let Some(rest) = upper.strip_prefix("PT") {
            let span = self.attribute_span(node, "duration");
            if let Ok(ns) = literal::time(&format!("T#{rest}"), span) {
                return Some(Expr {
                    kind: crate::syntax::ast::ExprKind::Time(ns),
                    span,
                });
            }
        }
        match parse_whole_expression(part.source, &part.text, part.base) {
            Ok(expr) => Some(expr),
            Err(problems) => {
                problems.into_iter().for_each(|p| self.report(p));
                None
            }
        }
    }

    fn transition_condition(
        &mut self,
        node: Node<'_, '_>,
        body: Node<'_, '_>,
        pou_node: Node<'_, '_>,
        pou: &mut Pou,
    ) -> (Vec<Stmt>, Option<Expr>) {
        let none = (Vec::new(), None);
        let Some(condition) = element(node, "condition") else {
            return none;
        };
        if let Some(reference) = element(condition, "reference") {
            let Some(name) = self.name(reference, "name") else {
                return none;
            };
            let named = element(pou_node, "transitions").and_then(|list| {
                elements(list, "transition").find(|t| {
                    t.attribute("name")
                        .is_some_and(|n| n.trim().eq_ignore_ascii_case(&name.name))
                })
            });
            return match named.and_then(|t| element(t, "body")) {
                Some(inner) => self.condition_of(inner, &name.name, pou),
                // A BOOL variable.
                None => (
                    Vec::new(),
                    Some(Expr {
                        kind: crate::syntax::ast::ExprKind::Name(name.name),
                        span: name.span,
                    }),
                ),
            };
        }
        if let Some(inline) = element(condition, "inline") {
            let name = inline.attribute("name").unwrap_or_default().to_owned();
            return self.condition_of(inline, &name, pou);
        }
        let point = element(condition, "connectionPointIn").unwrap_or(condition);
        if element(point, "connection").is_none() {
            return none;
        }
        Network::new(self, body).point(point, pou)
    }

    /// The condition that a body in any language computes for the transition `name`.
    fn condition_of(
        &mut self,
        holder: Node<'_, '_>,
        name: &str,
        pou: &mut Pou,
    ) -> (Vec<Stmt>, Option<Expr>) {
        let Some(language) = self.language_of(holder) else {
            return (Vec::new(), None);
        };
        match language.tag_name().name() {
            "ST" => (Vec::new(), self.st_condition(language, name)),
            "FBD" | "LD" => Network::new(self, language).condition(language, name, pou),
            "IL" => {
                let part = self.text_part(language);
                let pou_name = pou.name.name.clone();
                let (result, problems) = crate::syntax::parser::parse_in(
                    part.source,
                    &part.text,
                    part.base,
                    &pou_name,
                    |p| p.il_condition(pou),
                );
                problems.into_iter().for_each(|p| self.report(p));
                match result {
                    Ok((statements, expr)) => (statements, Some(expr)),
                    Err(_) => (Vec::new(), None),
                }
            }
            other => {
                let span = self.tag(language);
                let message = format!("a condition cannot be written in {other}");
                self.report(Problem::error("E602", span, message));
                (Vec::new(), None)
            }
        }
    }

    /// `x > 5`, `:= x > 5;` or `name := x > 5;`
    fn st_condition(&mut self, language: Node<'_, '_>, name: &str) -> Option<Expr> {
        let part = self.text_part(language);
        let mut text = part.text.as_str();
        let mut base = part.base;
        let trimmed = text.trim_start();
        base += text.len() - trimmed.len();
        text = trimmed;
        let head = text.split(":=").next().unwrap_or("");
        let own = head.trim().is_empty() || head.trim().eq_ignore_ascii_case(name);
        if text.contains(":=") && own {
            base += head.len() + 2;
            text = &text[head.len() + 2..];
        }
        let text = text.trim_end();
        let text = text.strip_suffix(';').unwrap_or(text);
        if text.trim().is_empty() {
            return None;
        }
        match parse_whole_expression(part.source, text, base) {
            Ok(expr) => Some(expr),
            Err(problems) => {
                problems.into_iter().for_each(|p| self.report(p));
                None
            }
        }
    }
}
