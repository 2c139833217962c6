//! Blocks: calls of functions and function blocks with their pins, and the values of their outputs.

use std::collections::BTreeSet;

use roxmltree::Node;

use super::{Network, PLAIN, State, is_true};
use crate::diag::Problem;
use crate::plcopen::{element, elements};
use crate::syntax::ast::{Arg, Expr, ExprKind, Pou, StmtKind, TypeSpecKind};
use crate::syntax::build::At;

impl<'a, 'i> Network<'_, '_, 'a, 'i> {
    pub(super) fn pins(node: Node<'a, 'i>, list: &'static str) -> Vec<Node<'a, 'i>> {
        element(node, list)
            .map(|l| elements(l, "variable").collect())
            .unwrap_or_default()
    }

    pub(super) fn block(&mut self, node: Node<'a, 'i>, id: &str) {
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
                self.instances
                    .push((instance.to_owned(), type_name.to_owned(), span));
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
                let mut kept_argument = None;
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
                    let key = (id.to_owned(), name.to_ascii_uppercase());
                    if is_result
                        && !known
                        && type_name.eq_ignore_ascii_case("TRUNC")
                        && args.len() == 1
                    {
                        // Its result has the type of what it goes to, so that it is taken there.
                        let unnamed = Arg {
                            name: None,
                            output: false,
                            negated: false,
                            value: Some(at.name(&wire)),
                        };
                        let value = at.call(at.name(type_name), vec![unnamed]);
                        self.wires.insert(key, value);
                        kept_argument = args[0].value.clone();
                        result = Some(wire);
                        continue;
                    }
                    self.wires.insert(key, at.name(&wire));
                    if is_result {
                        result = Some(wire);
                    } else {
                        args.push(at.output(name, at.name(&wire)));
                    }
                }
                let call = kept_argument.unwrap_or_else(|| at.call(at.name(type_name), args));
                run.push(match result {
                    Some(wire) => at.assign(at.name(&wire), call),
                    None => at.stmt(StmtKind::Call(call)),
                });
            }
        }
        let enable = enable.filter(|e| !matches!(e.kind, ExprKind::Bool(true)));
        let mut off = Vec::new();
        if eno || enable.is_some() {
            let wire = self.new_name("eno");
            self.temps.push(at.var(&wire, "BOOL"));
            run.push(at.assign(at.name(&wire), at.bool(true)));
            off.push(at.assign(at.name(&wire), at.bool(false)));
            self.wires
                .insert((id.to_owned(), "ENO".to_owned()), at.name(&wire));
            if enable.is_some() {
                self.enabled.insert(id.to_owned(), at.name(&wire));
            }
        }
        match enable {
            None => run.into_iter().for_each(|s| self.emit(s)),
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
                    let ran = self.ran(id, &name);
                    self.store_at(output, PLAIN, target, value, ran);
                }
            }
        }
    }

    /// What says whether the block has run from which a value comes, if it may not have: then a variable at its output keeps its value.
    /// ENO has one in any case.
    pub(super) fn ran(&self, id: &str, formal: &str) -> Option<Expr> {
        let ran = self.enabled.get(id).cloned();
        ran.filter(|_| !formal.eq_ignore_ascii_case("ENO"))
    }

    /// Blocks are drawn as what their instances are.
    pub(super) fn refuse_other_types(&mut self, pou: &Pou) {
        let same = |a: &str, b: &str| {
            let last = |name: &'_ str| name.rsplit('.').next().unwrap_or_default().to_owned();
            last(a).eq_ignore_ascii_case(&last(b))
        };
        for (instance, drawn, span) in std::mem::take(&mut self.instances) {
            let mut decls = pou.vars.iter().flat_map(|b| &b.decls);
            let decl = decls.find(|d| d.name.name.eq_ignore_ascii_case(&instance));
            if let Some(TypeSpecKind::Named(declared)) = decl.map(|d| &d.spec.kind)
                && !same(&declared.name, &drawn)
            {
                let declared = &declared.name;
                let message =
                    format!("`{instance}` is drawn as {drawn}, and declared as {declared}");
                self.reader.report(
                    Problem::error("E613", span, message).expected(format!("a block {declared}")),
                );
            }
        }
    }

    pub(super) fn block_value(
        &mut self,
        node: Node<'a, 'i>,
        id: &str,
        formal: &str,
    ) -> Option<Expr> {
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
            (None, None) if pin.is_none() && !outputs.is_empty() => {
                let name = node.attribute("typeName").unwrap_or_default();
                let has: Vec<&str> = outputs
                    .iter()
                    .filter_map(|o| o.attribute("formalParameter"))
                    .collect();
                let message = format!("this {name} has no output `{formal}`");
                self.reader.report(
                    Problem::error("E610", span, message)
                        .expected(format!("one of {}", has.join(", "))),
                );
                return None;
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

    /// Whether the element is to run after one that is running, by their numbers.
    pub(super) fn later(&self, node: Node<'a, 'i>) -> bool {
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
