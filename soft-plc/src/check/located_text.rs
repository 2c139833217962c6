//! Located strings (IEC 61131-3, clause 6.5.5): in the process image the characters lie one behind the other, a zero behind the last
//! one, room for a zero behind the longest text. A variable in memory keeps the text: each program reads it from the image before
//! its statements, unless it lies at an output, and writes it there behind them, unless it lies at an input.

use std::collections::BTreeMap;

use crate::check::tree::{InitValue, PouId, Stmt, Var, VarId};
use crate::check::{Checker, Progress, key};
use crate::diag::{Fallible, Problem};
use crate::image;
use crate::syntax::ast::{self, BinOp, VarSection};
use crate::syntax::build::At;
use crate::types::{Elem, TypeId};
use crate::value::Value;

/// A located string: the variable that keeps it, and its characters in the image.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocatedText {
    text: VarId,
    image: VarId,
    is_read: bool,
    is_written: bool,
}

impl Checker<'_> {
    /// Gives a string variable its place in the image.
    pub(super) fn locate_text(&mut self, text: VarId, at: &ast::Ident) -> Fallible<()> {
        let var = self.var(text).clone();
        let Some((wide, len)) = self.types.text(var.ty) else {
            return Ok(());
        };
        let location = self.address(&at.name, at.span)?;
        if location.bit.is_some() || self.is_foreign(location) {
            let message = format!(
                "{} cannot be located at `{}`",
                self.type_name(var.ty),
                at.name
            );
            let area = location.area();
            return Err(Box::new(
                Problem::error("E207", at.span, message)
                    .expected(format!("an address that begins with %{area}B")),
            ));
        }
        let unit = TypeId::of(if wide { Elem::Word } else { Elem::Byte });
        let image = VarId(self.vars.len() as u32);
        self.vars.push(Var {
            name: image::characters_of(&var.name),
            ty: self.types.array(vec![(0, i64::from(len))], unit),
            section: if var.owner.is_some() {
                VarSection::Local
            } else {
                VarSection::Global
            },
            location: Some(location),
            init: None,
            ..var.clone()
        });
        match var.owner {
            Some(owner) => self.pous[owner.0 as usize].vars.push(image),
            // Behind those that the text declares.
            None => {
                let place = (self.project.globals.len(), self.texts.len());
                self.globals.insert(place, (Progress::Done, Some(image)));
            }
        }
        let is_input = !location.output && !location.memory;
        self.vars[text.0 as usize].open_input = is_input;
        self.texts.push(LocatedText {
            text,
            image,
            is_read: is_input || location.memory,
            is_written: !is_input,
        });
        Ok(())
    }

    /// The image begins with the characters that the strings begin with.
    pub(super) fn begin_texts(&mut self) {
        for LocatedText { text, image, .. } in self.texts.clone() {
            let var = self.var(text);
            let init = var.init.clone().or(self.types.init(var.ty).cloned());
            let Some(InitValue::Text(units)) = init else {
                continue;
            };
            let units = units.iter().map(|unit| Value::Uint(u64::from(*unit)));
            let units = units.map(|unit| (1, InitValue::Scalar(unit)));
            self.vars[image.0 as usize].init = Some(InitValue::Array(units.collect()));
        }
    }

    /// What a program does for its located strings and the global ones: before its statements, or behind them.
    pub(super) fn copy_texts(&mut self, program: PouId, behind: bool) -> Vec<Stmt> {
        let mut list = Vec::new();
        for located in self.texts.clone() {
            let owner = self.var(located.text).owner;
            let wanted = if behind {
                located.is_written
            } else {
                located.is_read
            };
            if wanted && owner.is_none_or(|o| o == program) {
                list.extend(self.copy_text(located, program, behind));
            }
        }
        list
    }

    fn copy_text(&mut self, located: LocatedText, program: PouId, behind: bool) -> Vec<Stmt> {
        let var = self.var(located.text).clone();
        let Some((wide, len)) = self.types.text(var.ty) else {
            return Vec::new();
        };
        let index = self.index_of_texts(program, &var);
        // The statements see these names and no others, whatever the program calls its variables.
        let names = BTreeMap::from([
            (key("text"), located.text),
            (key("image"), located.image),
            (key("index"), index),
        ]);
        let own = std::mem::replace(&mut self.current.names, names);
        let statements = exchange(At(var.span), wide, len, behind);
        let list = self.stmts(&statements);
        self.current.names = own;
        list
    }

    /// The variable that counts characters in a program's copies.
    fn index_of_texts(&mut self, program: PouId, like: &Var) -> VarId {
        const NAME: &str = "__text";
        let vars = &self.pou(program).vars;
        if let Some(known) = vars.iter().find(|v| self.var(**v).name == NAME) {
            return *known;
        }
        let id = VarId(self.vars.len() as u32);
        self.vars.push(Var {
            name: NAME.into(),
            ty: TypeId::of(Elem::Dint),
            section: VarSection::Temp,
            location: None,
            open_input: false,
            open_output: false,
            constant: false,
            retain: false,
            init: None,
            owner: Some(program),
            span: like.span,
        });
        self.pous[program.0 as usize].vars.push(id);
        id
    }
}

/// The statements that read `text` from `image`, or write it there.
fn exchange(at: At, wide: bool, len: u32, write: bool) -> Vec<ast::Stmt> {
    let (from_unit, to_text, to_unit) = if wide {
        ("WORD_TO_WCHAR", "WCHAR_TO_WSTRING", "WCHAR_TO_WORD")
    } else {
        ("BYTE_TO_CHAR", "CHAR_TO_STRING", "CHAR_TO_BYTE")
    };
    let call = |name: &str, args: Vec<ast::Expr>| {
        let args = args.into_iter().map(|value| ast::Arg {
            name: None,
            output: false,
            negated: false,
            value: Some(value),
        });
        at.call(at.name(name), args.collect())
    };
    let (text, index) = (|| at.name("text"), || at.name("index"));
    let element = |of: &str, index: ast::Expr| {
        at.expr(ast::ExprKind::Index(Box::new(at.name(of)), vec![index]))
    };
    let unit = || element("image", index());
    let each = |last: u32, body: Vec<ast::Stmt>| {
        at.stmt(ast::StmtKind::For(Box::new(ast::ForLoop {
            var: index(),
            from: at.int(0),
            to: at.int(i128::from(last)),
            by: None,
            body,
        })))
    };
    if write {
        let next = at.binary(BinOp::Add, index(), at.int(1));
        let is_in_text = at.binary(BinOp::Lt, index(), call("LEN", vec![text()]));
        let character = call(to_unit, vec![element("text", next)]);
        return vec![each(
            len,
            vec![at.stmt(ast::StmtKind::If(
                vec![(is_in_text, vec![at.assign(unit(), character)])],
                vec![at.assign(unit(), at.int(0))],
            ))],
        )];
    }
    let empty = if wide {
        ast::ExprKind::WStr(String::new())
    } else {
        ast::ExprKind::Str(String::new())
    };
    let is_end = at.binary(BinOp::Eq, unit(), at.int(0));
    let next = call(to_text, vec![call(from_unit, vec![unit()])]);
    let grow = at.assign(text(), call("CONCAT", vec![text(), next]));
    let stop = at.if_then(is_end, vec![at.stmt(ast::StmtKind::Exit)]);
    vec![
        at.assign(text(), at.expr(empty)),
        each(len - 1, vec![stop, grow]),
    ]
}
