//! Functions, function blocks and programs.

use fam_soft_plc::types::Elem;

use super::scope::Scope;
use super::stmt::COUNTER_TYPES;
use super::{BlockDef, Callable, Ty, World};
use crate::shrink::Piece;

/// The standard function blocks, with their parameters.
pub fn standard() -> Vec<BlockDef> {
    let bool_ = |n: &str| (n.to_owned(), Ty::El(Elem::Bool));
    let of = |n: &str, e| (n.to_owned(), Ty::El(e));
    let block = |name: &str, inputs: Vec<(String, Ty)>, outputs: Vec<(String, Ty)>| BlockDef {
        call: Callable {
            name: name.to_owned(),
            inputs,
            outputs,
            ..Callable::default()
        },
        methods: Vec::new(),
        base: None,
        standard: true,
    };
    let mut list = Vec::new();
    for name in ["TON", "TOF", "TP"] {
        let inputs = vec![bool_("IN"), of("PT", Elem::Time)];
        list.push(block(name, inputs, vec![bool_("Q"), of("ET", Elem::Time)]));
    }
    for name in ["R_TRIG", "F_TRIG"] {
        list.push(block(name, vec![bool_("CLK")], vec![bool_("Q")]));
    }
    list.push(block(
        "SR",
        vec![bool_("S1"), bool_("R")],
        vec![bool_("Q1")],
    ));
    list.push(block(
        "RS",
        vec![bool_("S"), bool_("R1")],
        vec![bool_("Q1")],
    ));
    let cv = |e| vec![bool_("Q"), of("CV", e)];
    list.push(block(
        "CTU",
        vec![bool_("CU"), bool_("R"), of("PV", Elem::Int)],
        cv(Elem::Int),
    ));
    list.push(block(
        "CTD_DINT",
        vec![bool_("CD"), bool_("LD"), of("PV", Elem::Dint)],
        cv(Elem::Dint),
    ));
    list.push(block(
        "CTUD_ULINT",
        vec![
            bool_("CU"),
            bool_("CD"),
            bool_("R"),
            bool_("LD"),
            of("PV", Elem::Ulint),
        ],
        vec![bool_("QU"), bool_("QD"), of("CV", Elem::Ulint)],
    ));
    list
}

impl World {
    fn parameters(&mut self, prefix: &str, count: i64) -> Vec<(String, Ty)> {
        (0..count)
            .map(|_| {
                let name = self.fresh(prefix);
                let depth = u32::from(self.random.chance(25));
                (name, self.data_type(depth))
            })
            .collect()
    }

    fn section(&mut self, word: &str, list: &[(String, Ty)], init: bool) -> Piece {
        let lines = list
            .iter()
            .map(|(name, ty)| {
                if init {
                    self.declaration(name, ty)
                } else {
                    Piece::line(format!("{name} : {};", self.type_text(ty)))
                }
            })
            .collect();
        Piece::block(word, lines, "END_VAR")
    }

    /// Counters of loops, in a section of their own.
    fn counters(&mut self, scope: &mut Scope, word: &str) -> Piece {
        let mut lines = Vec::new();
        for number in 0..6 {
            let name = self.fresh("k");
            let ty = COUNTER_TYPES[number % COUNTER_TYPES.len()];
            lines.push(Piece::line(format!("{name} : {ty};")));
            scope.counters.push(name);
        }
        Piece::block(word, lines, "END_VAR")
    }

    fn scope(&self) -> Scope {
        let mut scope = Scope {
            functions: self.functions.len(),
            blocks: self.blocks.len(),
            ..Scope::default()
        };
        for (name, ty) in &self.globals {
            self.enter(&mut scope, name, ty, true, true);
        }
        scope
    }

    fn interface(&mut self, result: bool) -> Callable {
        let inputs = self.random.within(0, 3);
        let outputs = *self.random.one(&[0, 0, 1, 2]);
        let in_outs = *self.random.one(&[0, 0, 1, 2]);
        Callable {
            name: String::new(),
            inputs: self.parameters("i", inputs),
            outputs: self.parameters("o", outputs),
            in_outs: self.parameters("r", in_outs),
            result: if result && self.random.chance(85) {
                let depth = u32::from(self.random.chance(30));
                Some(self.data_type(depth))
            } else {
                None
            },
        }
    }

    fn enter_parameters(&self, scope: &mut Scope, call: &Callable, lasting: bool) {
        for (name, ty) in &call.inputs {
            self.enter(scope, name, ty, false, false);
        }
        for (name, ty) in &call.outputs {
            self.enter(scope, name, ty, true, lasting);
        }
        for (name, ty) in &call.in_outs {
            self.enter(scope, name, ty, true, false);
        }
    }

    /// Sections of a function or method, and its statements.
    fn callable_body(&mut self, scope: &mut Scope, call: &Callable, statements: i64) -> Vec<Piece> {
        self.enter_parameters(scope, call, false);
        if let Some(result) = &call.result {
            self.enter(scope, &call.name, result, true, false);
        }
        let mut inner = vec![
            self.section("VAR_INPUT", &call.inputs, true),
            self.section("VAR_OUTPUT", &call.outputs, false),
            self.section("VAR_IN_OUT", &call.in_outs, false),
        ];
        let locals = self.parameters("v", 3);
        for (name, ty) in &locals {
            self.enter(scope, name, ty, true, false);
        }
        inner.push(self.section("VAR", &locals, true));
        inner.push(self.counters(scope, "VAR"));
        inner.extend(self.stmts(scope, statements, 2));
        inner
    }

    pub fn function(&mut self, number: usize) -> Piece {
        let mut call = self.interface(true);
        call.name = format!("F{number}");
        let mut scope = self.scope();
        let statements = self.random.within(2, 6);
        let inner = self.callable_body(&mut scope, &call, statements);
        let head = match &call.result {
            Some(ty) => format!("FUNCTION {} : {}", call.name, self.type_text(ty)),
            None => format!("FUNCTION {}", call.name),
        };
        self.functions.push(call);
        Piece::block(head, inner, "END_FUNCTION")
    }

    pub fn function_block(&mut self, number: usize) -> Piece {
        let mut call = self.interface(false);
        call.name = format!("B{number}");
        // At times derived from the one before.
        let base = (0..self.blocks.len())
            .rev()
            .find(|n| !self.blocks[*n].standard)
            .filter(|_| self.random.chance(50));
        let mut scope = self.scope();
        let mut whole = call.clone();
        let mut overridable = Vec::new();
        if let Some(base) = base {
            self.note("derived function block");
            let of = self.blocks[base].clone();
            let mut inherited = of.call.clone();
            self.enter_parameters(&mut scope, &inherited, true);
            inherited.inputs.extend(whole.inputs);
            inherited.outputs.extend(whole.outputs);
            inherited.in_outs.extend(whole.in_outs);
            whole = Callable {
                name: call.name.clone(),
                ..inherited
            };
            overridable = of.methods;
        }
        self.enter_parameters(&mut scope, &call, true);
        let locals = self.locals(&mut scope);
        let mut inner = vec![
            self.section("VAR_INPUT", &call.inputs, true),
            self.section("VAR_OUTPUT", &call.outputs, true),
            self.section("VAR_IN_OUT", &call.in_outs, false),
            self.section("VAR", &locals, true),
        ];
        let mut methods = Vec::new();
        let mut texts = Vec::new();
        for index in 0..self.random.within(0, 2) {
            let mut method = if index == 0 && !overridable.is_empty() && self.random.chance(60) {
                self.note("method overridden");
                overridable[0].clone()
            } else {
                let mut method = self.interface(true);
                method.name = self.fresh("m");
                method
            };
            let overrides = overridable.iter().any(|m| m.name == method.name);
            let mut own = scope.clone();
            own.counters.clear();
            // Variables by reference exist only while the body runs.
            let by_reference: Vec<String> = whole.in_outs.iter().map(|(n, _)| n.clone()).collect();
            own.leaves.retain(
                |l| !matches!(&l.path[0], super::scope::Seg::Text(t) if by_reference.contains(t)),
            );
            let statements = self.random.within(1, 4);
            let body = self.callable_body(&mut own, &method, statements);
            let word = if overrides {
                "METHOD PUBLIC OVERRIDE"
            } else {
                "METHOD PUBLIC"
            };
            let head = match &method.result {
                Some(ty) => format!("{word} {} : {}", method.name, self.type_text(ty)),
                None => format!("{word} {}", method.name),
            };
            texts.push(Piece::block(head, body, "END_METHOD"));
            let prefix = *self.random.one(&["THIS.", ""]);
            scope
                .methods
                .push((format!("{prefix}{}", method.name), method.clone()));
            method.name = method.name.clone();
            methods.push(method);
        }
        if let Some(first) = overridable.first()
            && base.is_some()
        {
            scope
                .methods
                .push((format!("SUPER.{}", first.name), first.clone()));
        }
        inner.push(self.counters(&mut scope, "VAR_TEMP"));
        if self.random.chance(50) {
            self.note("VAR_TEMP");
            let list = self.parameters("u", 3);
            for (name, ty) in &list {
                self.enter(&mut scope, name, ty, true, false);
            }
            inner.push(self.section("VAR_TEMP", &list, true));
        }
        inner.extend(texts);
        if base.is_some() && self.random.chance(60) {
            self.note("SUPER()");
            inner.push(Piece::line("SUPER();"));
        }
        // A derived function block without statements of its own has those of its base.
        if base.is_none() || self.random.chance(75) {
            let statements = self.random.within(2, 7);
            inner.extend(self.stmts(&mut scope, statements, 2));
        }
        let head = match base {
            Some(base) => format!(
                "FUNCTION_BLOCK {} EXTENDS {}",
                call.name, self.blocks[base].call.name
            ),
            None => format!("FUNCTION_BLOCK {}", call.name),
        };
        self.blocks.push(BlockDef {
            call: whole,
            methods,
            base,
            standard: false,
        });
        Piece::block(head, inner, "END_FUNCTION_BLOCK")
    }

    /// Variables that last: of all types, references and instances too.
    fn locals(&mut self, scope: &mut Scope) -> Vec<(String, Ty)> {
        let mut list = Vec::new();
        for _ in 0..7 {
            let name = self.fresh("v");
            let ty = self.data_type(2);
            list.push((name, ty));
        }
        for elem in [Elem::Int, Elem::Bool] {
            let name = self.fresh("v");
            list.push((name, Ty::El(elem)));
        }
        for _ in 0..2 {
            let name = self.fresh("b");
            let count = scope.blocks;
            let number = self.random.below(count);
            let ty = Ty::Block(number);
            let ty = if self.random.chance(25) {
                self.note("array of instances");
                Ty::Array(Box::new(ty), vec![(1, 2)])
            } else {
                ty
            };
            list.push((name, ty));
        }
        let name = self.fresh("p");
        let to = self.random.one(&list[..7]).1.clone();
        list.push((name, Ty::Ref(Box::new(to))));
        for (name, ty) in &list {
            self.enter(scope, name, ty, true, true);
        }
        list
    }

    pub fn program(&mut self, name: &str) -> Piece {
        let mut scope = self.scope();
        let mut inputs = Vec::new();
        for _ in 0..4 {
            let name = self.fresh("x");
            let ty = match self.random.below(5) {
                0 => Ty::Str(self.random.chance(25), 12),
                _ => Ty::El(self.elementary()),
            };
            inputs.push((name, ty));
        }
        for (name, ty) in &inputs {
            self.enter(&mut scope, name, ty, false, true);
        }
        let locals = self.locals(&mut scope);
        let mut inner = vec![
            self.section("VAR_INPUT", &inputs, false),
            self.section("VAR", &locals, true),
        ];
        let located = self.located(&mut scope);
        inner.push(Piece::block("VAR", located, "END_VAR"));
        let word = if self.random.chance(50) {
            "VAR"
        } else {
            "VAR_TEMP"
        };
        inner.push(self.counters(&mut scope, word));
        let statements = self.random.within(4, 12);
        inner.extend(self.stmts(&mut scope, statements, 3));
        Piece::block(format!("PROGRAM {name}"), inner, "END_PROGRAM")
    }
}
