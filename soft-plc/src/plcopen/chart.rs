//! Sequential function charts of PLCopen XML: steps and transitions by their connections.

use std::collections::BTreeSet;

use roxmltree::Node;

use super::network::{LocalName, Network};
use super::{Reader, element, elements};
use crate::diag::Problem;
use crate::syntax::ast::{Expr, Ident, Pou, Stmt};
use crate::syntax::build::At;
use crate::syntax::literal;
use crate::syntax::parser::parse_whole_expression;
use crate::syntax::sfc::{
    Action, Association, MacroStep, Qualifier, Sfc, Step, Target, Transition,
};

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

/// The elements of a chart, or of the chart inside a macro step.
struct Level<'a, 'i> {
    body: Node<'a, 'i>,
    /// The number of the macro step.
    of: Option<usize>,
    nodes: Vec<Node<'a, 'i>>,
}

/// Where the chart inside a macro step begins and ends: steps, or macro steps again.
struct Ends<'a, 'i> {
    of: Node<'a, 'i>,
    first: Node<'a, 'i>,
    last: Node<'a, 'i>,
}

/// How many macro steps may stand in each other.
const MACROS_DEEP_MAX: usize = 32;

/// How many macro steps are around an element, itself included.
fn nesting(node: Node<'_, '_>) -> usize {
    let around = node.ancestors();
    around.filter(|a| a.has_tag_name_local("macroStep")).count()
}

fn is_initial(node: Node<'_, '_>) -> bool {
    node.attribute("initialStep") == Some("true")
}

fn is_place(node: &Node<'_, '_>) -> bool {
    node.has_tag_name_local("step") || node.has_tag_name_local("macroStep")
}

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
        let mut levels = Vec::new();
        let mut macros = Vec::new();
        self.level(body, None, &mut levels, &mut macros);
        let has_initial = levels[0]
            .nodes
            .iter()
            .any(|n| n.has_tag_name_local("step") && is_initial(*n));
        for (number, level) in levels.iter().enumerate() {
            for node in level.nodes.iter().filter(|n| n.has_tag_name_local("step")) {
                if node.attribute("negated") == Some("true") {
                    let span = self.tag(*node);
                    self.report(Problem::error("E602", span, "a step cannot be negated"));
                }
                if let Some(name) = self.name(*node, "name") {
                    sfc.steps.push(Step {
                        name,
                        // In a macro step it tells the first step, unless the chart begins there.
                        initial: is_initial(*node) && (number == 0 || !has_initial),
                        associations: Vec::new(),
                    });
                }
            }
        }
        for level in &levels {
            let blocks = level
                .nodes
                .iter()
                .filter(|n| n.has_tag_name_local("actionBlock"));
            for node in blocks {
                self.action_block(*node, &level.nodes, &mut sfc, pou);
            }
        }
        let ends = self.ends_of_macros(&levels, &macros);
        let mut transitions = Vec::new();
        for level in &levels {
            let drawn = level
                .nodes
                .iter()
                .filter(|n| n.has_tag_name_local("transition"));
            for node in drawn {
                let span = self.tag(*node);
                let (statements, condition) =
                    self.transition_condition(*node, level.body, pou_node, pou);
                let from = self
                    .places_before(*node, &level.nodes)
                    .into_iter()
                    .filter_map(|n| self.step_of(n, &ends, |e| e.last))
                    .collect();
                let Some(condition) = condition else {
                    self.report(
                        Problem::error("E612", span, "this transition has no condition")
                            .hint("give it a condition; TRUE if it is always to fire"),
                    );
                    continue;
                };
                transitions.push(*node);
                sfc.transitions.push(Transition {
                    priority: node.attribute("priority").and_then(|p| p.parse().ok()),
                    from,
                    to: Vec::new(),
                    before: statements,
                    condition,
                    span,
                });
            }
        }
        for (of, node) in macros.iter().enumerate() {
            let Some(name) = node.attribute("name").filter(|n| !n.trim().is_empty()) else {
                continue;
            };
            let span = self.attribute_span(*node, "name");
            let mut inside = Vec::new();
            self.steps_inside(of, &levels, &macros, &mut inside);
            sfc.macros.push(MacroStep {
                name: Ident {
                    name: name.trim().to_owned(),
                    span,
                },
                inside,
            });
        }
        if self.problems.len() != before {
            return;
        }
        // Each step and jump looks back for the transitions that lead to it.
        for level in &levels {
            for node in &level.nodes {
                let targets: Vec<Ident> = match node.tag_name().name() {
                    "step" | "macroStep" => self
                        .step_of(*node, &ends, |e| e.first)
                        .into_iter()
                        .collect(),
                    "jumpStep" => self.targets(*node, &levels, &ends),
                    _ => continue,
                };
                let mut leading = Vec::new();
                self.before(
                    *node,
                    &level.nodes,
                    &["transition", "step", "macroStep"],
                    &mut BTreeSet::new(),
                    &mut |t| {
                        leading.push(t);
                    },
                );
                for transition in leading {
                    if is_place(&transition) {
                        let span = self.tag(*node);
                        let from = transition.attribute("name").unwrap_or_default();
                        let message =
                            format!("no transition stands between step `{from}` and this one");
                        self.report(Problem::error("E706", span, message));
                        continue;
                    }
                    if let Some(index) = transitions.iter().position(|t| *t == transition) {
                        sfc.transitions[index].to.extend(targets.iter().cloned());
                    }
                }
            }
        }
        let mut problems = Vec::new();
        sfc.lower(pou, &mut problems);
        problems.into_iter().for_each(|p| self.report(p));
    }

    /// The elements of a chart, then those of the macro steps in it, each a level of its own: numbers of elements count
    /// within one.
    fn level<'a, 'i>(
        &mut self,
        body: Node<'a, 'i>,
        of: Option<usize>,
        levels: &mut Vec<Level<'a, 'i>>,
        macros: &mut Vec<Node<'a, 'i>>,
    ) {
        let nodes: Vec<Node<'a, 'i>> = body.children().filter(Node::is_element).collect();
        levels.push(Level {
            body,
            of,
            nodes: nodes.clone(),
        });
        for node in nodes.iter().filter(|n| n.has_tag_name_local("macroStep")) {
            let chart = element(*node, "body").and_then(|b| self.language_of(b));
            match chart.filter(|c| c.has_tag_name_local("SFC")) {
                Some(chart) if nesting(*node) > MACROS_DEEP_MAX => {
                    let span = self.tag(chart);
                    let message = format!("macro steps stand in each other {MACROS_DEEP_MAX} deep");
                    self.report(Problem::error("E113", span, message));
                }
                Some(chart) => {
                    macros.push(*node);
                    let of = Some(macros.len() - 1);
                    self.level(chart, of, levels, macros);
                }
                None => {
                    let span = self.tag(*node);
                    self.report(
                        Problem::error("E602", span, "this macro step has no chart")
                            .expected("<body><SFC>, with the steps that it stands for"),
                    );
                }
            }
        }
    }

    /// For each macro step its first and its last step (IEC 60848: E and S): the one that nothing leads to, or that is
    /// marked as initial, and the one that no transition leaves.
    fn ends_of_macros<'a, 'i>(
        &mut self,
        levels: &[Level<'a, 'i>],
        macros: &[Node<'a, 'i>],
    ) -> Vec<Ends<'a, 'i>> {
        let mut ends = Vec::new();
        for level in levels {
            let Some(of) = level.of else { continue };
            let places: Vec<Node<'a, 'i>> = level.nodes.iter().copied().filter(is_place).collect();
            let left: Vec<Node<'a, 'i>> = level
                .nodes
                .iter()
                .filter(|n| n.has_tag_name_local("transition"))
                .flat_map(|t| self.places_before(*t, &level.nodes))
                .collect();
            let begins = |n: &&Node<'a, 'i>| {
                elements(**n, "connectionPointIn").all(|p| element(p, "connection").is_none())
            };
            let mut first: Vec<_> = places.iter().filter(|n| is_initial(**n)).collect();
            if first.is_empty() {
                first = places.iter().filter(begins).collect();
            }
            let last: Vec<_> = places.iter().filter(|n| !left.contains(n)).collect();
            let span = self.tag(macros[of]);
            match (first.as_slice(), last.as_slice()) {
                ([first], [last]) => ends.push(Ends {
                    of: macros[of],
                    first: **first,
                    last: **last,
                }),
                ([_], _) => self.report(
                    Problem::error(
                        "E706",
                        span,
                        format!("this macro step has {} last steps", last.len()),
                    )
                    .expected("one step that no transition leaves"),
                ),
                _ => self.report(
                    Problem::error(
                        "E706",
                        span,
                        format!("this macro step has {} first steps", first.len()),
                    )
                    .expected("one step that nothing leads to, or one marked as initialStep"),
                ),
            }
        }
        ends
    }

    /// The name of a step; of a macro step that of its first or last one.
    fn step_of<'a, 'i>(
        &mut self,
        mut node: Node<'a, 'i>,
        ends: &[Ends<'a, 'i>],
        end: impl Fn(&Ends<'a, 'i>) -> Node<'a, 'i>,
    ) -> Option<Ident> {
        while node.has_tag_name_local("macroStep") {
            node = end(ends.iter().find(|e| e.of == node)?);
        }
        self.name(node, "name")
    }

    fn steps_inside<'a, 'i>(
        &mut self,
        of: usize,
        levels: &[Level<'a, 'i>],
        macros: &[Node<'a, 'i>],
        inside: &mut Vec<Ident>,
    ) {
        for level in levels.iter().filter(|l| l.of == Some(of)) {
            for node in &level.nodes {
                if node.has_tag_name_local("step") {
                    inside.extend(self.name(*node, "name"));
                } else if let Some(inner) = macros.iter().position(|m| m == node) {
                    self.steps_inside(inner, levels, macros, inside);
                }
            }
        }
    }

    /// Where a jump leads: a step, a macro step, or the steps behind a simultaneous divergence.
    fn targets<'a, 'i>(
        &mut self,
        jump: Node<'a, 'i>,
        levels: &[Level<'a, 'i>],
        ends: &[Ends<'a, 'i>],
    ) -> Vec<Ident> {
        let Some(target) = self.name(jump, "targetName") else {
            return Vec::new();
        };
        let is_target = |node: &Node<'a, 'i>| {
            let name = node.attribute("name").unwrap_or_default();
            name.trim().eq_ignore_ascii_case(&target.name)
        };
        for level in levels {
            for node in level.nodes.iter().filter(|n| is_target(n)) {
                let found: Vec<Node<'a, 'i>> = match node.tag_name().name() {
                    "macroStep" => vec![*node],
                    "simultaneousDivergence" => {
                        let places: Vec<_> = level.nodes.iter().copied().filter(is_place).collect();
                        let behind = |n: &Node<'a, 'i>| self.is_behind(*n, *node, &level.nodes);
                        places.into_iter().filter(behind).collect()
                    }
                    _ => continue,
                };
                let steps = found
                    .into_iter()
                    .filter_map(|n| self.step_of(n, ends, |e| e.first));
                return steps.collect();
            }
        }
        vec![target]
    }

    /// Whether the element stands behind the divergence, with no transition between.
    fn is_behind<'a, 'i>(
        &self,
        node: Node<'a, 'i>,
        divergence: Node<'a, 'i>,
        nodes: &[Node<'a, 'i>],
    ) -> bool {
        let mut todo = vec![node];
        let mut seen = BTreeSet::new();
        while let Some(node) = todo.pop() {
            for point in elements(node, "connectionPointIn") {
                for connection in elements(point, "connection") {
                    let id = connection.attribute("refLocalId").unwrap_or_default();
                    let Some(source) = nodes.iter().find(|n| n.attribute("localId") == Some(id))
                    else {
                        continue;
                    };
                    if *source == divergence {
                        return true;
                    }
                    let name = source.tag_name().name();
                    let passes = name.ends_with("Divergence") || name.ends_with("Convergence");
                    if passes && seen.insert(id.to_owned()) {
                        todo.push(*source);
                    }
                }
            }
        }
        false
    }

    /// The steps and macro steps before a transition.
    fn places_before<'a, 'i>(
        &mut self,
        node: Node<'a, 'i>,
        nodes: &[Node<'a, 'i>],
    ) -> Vec<Node<'a, 'i>> {
        let mut found = Vec::new();
        let stop = ["step", "macroStep"];
        self.before(node, nodes, &stop, &mut BTreeSet::new(), &mut |place| {
            found.push(place);
        });
        found
    }

    /// Calls `found` with the elements of the kinds `stop` that stand before an element, divergences and convergences passed
    /// over.
    fn before<'a, 'i>(
        &mut self,
        node: Node<'a, 'i>,
        nodes: &[Node<'a, 'i>],
        stop: &[&str],
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
                if stop.contains(&name) {
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
        self.before(node, nodes, &["step"], &mut BTreeSet::new(), &mut |s| {
            steps.push(s)
        });
        let span = self.tag(node);
        if node.attribute("negated") == Some("true") {
            self.report(Problem::error(
                "E602",
                span,
                "an action block cannot be negated",
            ));
        }
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
        let Some(condition) = element(node, "condition") else {
            return (Vec::new(), None);
        };
        let (before, value) = self.plain_condition(condition, body, pou_node, pou);
        let negated = condition.attribute("negated") == Some("true");
        let value = value.map(|v| if negated { At(v.span).not(v) } else { v });
        (before, value)
    }

    fn plain_condition(
        &mut self,
        condition: Node<'_, '_>,
        body: Node<'_, '_>,
        pou_node: Node<'_, '_>,
        pou: &mut Pou,
    ) -> (Vec<Stmt>, Option<Expr>) {
        let none = (Vec::new(), None);
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
