//! Strings. The value of a string expression is a pair on the stack: address of its characters, and length. Parts of a string
//! are views of it and cost nothing; what is put together goes to scratch memory of its own.

use wasm_encoder::{Instruction as I, ValType};

use super::SiteKind;
use super::fun::{Fun, Slot, mem, val};
use super::helper;
use crate::check::stdfun::StdFun;
use crate::check::tree::{Expr, ExprKind, FunctionCall, Place, Root, StepKind};
use crate::check::visit::{Node, visit_nodes};
use crate::source::Span;
use crate::types::{Elem, STRING_LEN_MAX};

/// Bytes before the characters: the current length.
pub const TEXT_HEADER: u32 = 4;

/// A view in two locals.
#[derive(Clone, Copy)]
struct View {
    ptr: u32,
    len: u32,
}

impl Fun<'_, '_> {
    fn is_wide(&self, expr: &Expr) -> bool {
        self.m.project.types.text(expr.ty).is_some_and(|t| t.0)
    }

    /// Pushes address and length of a string.
    pub fn text(&mut self, expr: &Expr) {
        match &expr.kind {
            ExprKind::Text(units) => {
                let wide = self.is_wide(expr);
                let at = self.m.text_constant(wide, units);
                self.i(I::I32Const(at as i32));
                self.i(I::I32Const(units.len() as i32));
            }
            ExprKind::Load(place) => {
                self.reads = true;
                self.push_full_address(place);
                self.view_of_address();
            }
            ExprKind::Call(call) => self.text_call(call),
            ExprKind::Std(fun, args) => self.text_standard(*fun, args, expr),
            ExprKind::Enabled(inner) => {
                let view = View {
                    ptr: self.temp(ValType::I32),
                    len: self.temp(ValType::I32),
                };
                self.enabled(inner, |f, value| {
                    f.text(value);
                    f.i(I::LocalSet(view.len));
                    f.i(I::LocalSet(view.ptr));
                });
                self.push_view(view);
                self.release(view.len);
                self.release(view.ptr);
            }
            _ => {
                self.i(I::I32Const(0));
                self.i(I::I32Const(0));
            }
        }
    }

    /// From the address of a string variable on the stack to its view.
    fn view_of_address(&mut self) {
        let base = self.temp(ValType::I32);
        self.i(I::LocalTee(base));
        self.i(I::I32Const(TEXT_HEADER as i32));
        self.i(I::I32Add);
        self.i(I::LocalGet(base));
        self.i(I::I32Load(mem(0, 2)));
        self.release(base);
    }

    fn view(&mut self, expr: &Expr) -> View {
        self.text(expr);
        self.keep_view()
    }

    fn keep_view(&mut self) -> View {
        let len = self.temp(ValType::I32);
        self.i(I::LocalSet(len));
        let ptr = self.temp(ValType::I32);
        self.i(I::LocalSet(ptr));
        View { ptr, len }
    }

    /// A view that stays as it is while `later` is evaluated: what a variable holds is copied if a call could change it.
    fn view_before(&mut self, expr: &Expr, later: &[Expr]) -> View {
        let view = self.view(expr);
        if !reads_variable(expr) || !later.iter().any(calls) {
            return view;
        }
        self.join(&[view], self.is_wide(expr), expr);
        self.keep_view()
    }

    /// Views of all, each as it was when it was evaluated; `behind` is evaluated after them.
    fn views(&mut self, args: &[Expr], behind: &[Expr]) -> Vec<View> {
        let mut list = Vec::new();
        for (index, arg) in args.iter().enumerate() {
            let later = [&args[index + 1..], behind].concat();
            list.push(self.view_before(arg, &later));
        }
        list
    }

    /// Pushes a string that stays as it is while `later` is evaluated.
    pub fn text_before(&mut self, expr: &Expr, later: &[&Expr]) {
        if reads_variable(expr) && later.iter().any(|e| calls(e)) {
            let view = self.view(expr);
            self.join(&[view], self.is_wide(expr), expr);
        } else {
            self.text(expr);
        }
    }

    fn push_view(&mut self, view: View) {
        self.i(I::LocalGet(view.ptr));
        self.i(I::LocalGet(view.len));
    }

    fn drop_view(&mut self, view: View) {
        self.release(view.ptr);
        self.release(view.len);
    }

    /// Pushes how many characters the string variable can hold, whose address has just been pushed.
    pub fn push_capacity(&mut self, place: &Place) {
        if place.steps.is_empty()
            && let Root::Var(id) = place.root
            && let Some(Slot::PointerText(_, capacity)) = self.slots.get(&id).copied()
        {
            self.i(I::LocalGet(capacity));
            return;
        }
        if self.capacity_of_address(place) {
            return;
        }
        let len = self.m.project.types.text(place.ty).map_or(0, |t| t.1);
        self.i(I::I32Const(len as i32));
    }

    /// `place := value`, cut to the length of the place.
    pub fn assign_text(&mut self, place: &Place, value: &Expr) {
        let wide = self.is_wide(value);
        if let Some(more) = self.appended(place, value) {
            return self.append(place, more, wide);
        }
        self.push_full_address(place);
        self.push_capacity(place);
        self.text(value);
        self.i(I::Call(helper::assign(wide)));
    }

    /// What `place := CONCAT(place, ...)` puts behind that which is there.
    fn appended<'e>(&self, place: &Place, value: &'e Expr) -> Option<&'e [Expr]> {
        let ExprKind::Std(StdFun::Concat, args) = &value.kind else {
            return None;
        };
        let (first, more) = args.split_first()?;
        let in_place = matches!(&first.kind, ExprKind::Load(p) if p.is_surely(place));
        // With pointers strings may overlap, and have a 0 behind them.
        (in_place && !self.m.pointers && !more.iter().any(calls)).then_some(more)
    }

    /// Appends to a string, cut to its capacity. Views of the string itself stay as they are: only what is behind it is written.
    fn append(&mut self, place: &Place, more: &[Expr], wide: bool) {
        let (base, len, room) = (
            self.temp(ValType::I32),
            self.temp(ValType::I32),
            self.temp(ValType::I32),
        );
        let pieces = self.views(more, &[]);
        self.reads = true;
        self.push_full_address(place);
        self.i(I::LocalTee(base));
        self.i(I::I32Load(mem(0, 2)));
        self.i(I::LocalSet(len));
        for piece in pieces {
            self.push_capacity(place);
            self.i(I::LocalGet(len));
            self.i(I::I32Sub);
            self.i(I::LocalSet(room));
            self.lesser(piece.len, room);
            self.i(I::LocalGet(base));
            self.i(I::LocalGet(len));
            self.scale_units(wide);
            self.i(I::I32Add);
            self.i(I::I32Const(TEXT_HEADER as i32));
            self.i(I::I32Add);
            self.i(I::LocalGet(piece.ptr));
            self.i(I::LocalGet(room));
            self.scale_units(wide);
            self.i(I::Call(helper::MOVE));
            self.i(I::LocalGet(len));
            self.i(I::LocalGet(room));
            self.i(I::I32Add);
            self.i(I::LocalSet(len));
            self.drop_view(piece);
        }
        self.i(I::LocalGet(base));
        self.i(I::LocalGet(len));
        self.i(I::I32Store(mem(0, 2)));
        for local in [room, len, base] {
            self.release(local);
        }
    }

    /// Sets `limit` to `value` if that is less.
    fn lesser(&mut self, value: u32, limit: u32) {
        for local in [value, limit, value, limit] {
            self.i(I::LocalGet(local));
        }
        self.i(I::I32LtU);
        self.i(I::Select);
        self.i(I::LocalSet(limit));
    }

    /// Stores the string at the address that `source` pushes into the place.
    pub fn copy_text(&mut self, place: &Place, source: impl FnOnce(&mut Self)) {
        let wide = self.m.project.types.text(place.ty).is_some_and(|t| t.0);
        self.push_full_address(place);
        self.push_capacity(place);
        source(self);
        self.view_of_address();
        self.i(I::Call(helper::assign(wide)));
    }

    /// The result of a function, in memory that no later call touches.
    fn text_call(&mut self, call: &FunctionCall) {
        self.function_call(call);
        let Some(result) = self.m.project.pou(call.pou).result else {
            return;
        };
        let size = self.m.size_of(self.m.project.var(result).ty);
        let from = self.m.scratch_of(result);
        let own = self.m.allocate(u64::from(size));
        self.i(I::I32Const(own as i32));
        self.i(I::I32Const(from as i32));
        self.copy(size);
        self.i(I::I32Const((own + TEXT_HEADER) as i32));
        self.i(I::I32Const(0));
        self.i(I::I32Load(mem(own, 2)));
    }

    /// Standard functions with a string as their result.
    fn text_standard(&mut self, fun: StdFun, args: &[Expr], expr: &Expr) {
        let wide = self.is_wide(expr);
        match fun {
            StdFun::Left => {
                let of = self.view_before(&args[0], &args[1..]);
                self.i(I::LocalGet(of.ptr));
                self.clamp(&args[1], 0, of.len);
                self.drop_view(of);
            }
            StdFun::Right => {
                let of = self.view_before(&args[0], &args[1..]);
                self.clamp(&args[1], 0, of.len);
                let count = self.temp(ValType::I32);
                self.i(I::LocalSet(count));
                self.i(I::LocalGet(of.ptr));
                self.i(I::LocalGet(of.len));
                self.i(I::LocalGet(count));
                self.i(I::I32Sub);
                self.scale_units(wide);
                self.i(I::I32Add);
                self.i(I::LocalGet(count));
                self.release(count);
                self.drop_view(of);
            }
            StdFun::Mid => {
                let of = self.view_before(&args[0], &args[1..]);
                let (start, count) = self.part(of, &args[1], &args[2]);
                self.i(I::LocalGet(of.ptr));
                self.i(I::LocalGet(start));
                self.scale_units(wide);
                self.i(I::I32Add);
                self.i(I::LocalGet(count));
                self.release(start);
                self.release(count);
                self.drop_view(of);
            }
            StdFun::Concat => {
                let pieces = self.views(args, &[]);
                self.join(&pieces, wide, expr);
            }
            StdFun::Insert => {
                let of = self.view_before(&args[0], &args[1..]);
                let with = self.view_before(&args[1], &args[2..]);
                self.clamp(&args[2], 0, of.len);
                let start = self.temp(ValType::I32);
                self.i(I::LocalSet(start));
                let (head, tail) = self.split(of, start, start, wide);
                self.release(start);
                self.join(&[head, with, tail], wide, expr);
                self.drop_view(of);
            }
            StdFun::Delete => {
                let of = self.view_before(&args[0], &args[1..]);
                let (head, tail) = self.cut(of, &args[1], &args[2], wide);
                self.join(&[head, tail], wide, expr);
                self.drop_view(of);
            }
            StdFun::Replace => {
                let of = self.view_before(&args[0], &args[1..]);
                let with = self.view_before(&args[1], &args[2..]);
                let (head, tail) = self.cut(of, &args[2], &args[3], wide);
                self.join(&[head, with, tail], wide, expr);
                self.drop_view(of);
            }
            StdFun::Sel => {
                let selector = self.spill(&args[0]);
                let first = self.view_before(&args[1], &args[2..]);
                let second = self.view(&args[2]);
                for (a, b) in [(second.ptr, first.ptr), (second.len, first.len)] {
                    self.i(I::LocalGet(a));
                    self.i(I::LocalGet(b));
                    self.i(I::LocalGet(selector));
                    self.i(I::Select);
                }
                self.drop_view(second);
                self.drop_view(first);
                self.release(selector);
            }
            StdFun::Mux => self.mux_text(args, expr.span),
            StdFun::Max | StdFun::Min => {
                let mut views = self.views(args, &[]).into_iter();
                let Some(mut best) = views.next() else {
                    return;
                };
                for other in views {
                    best = self.better(best, other, fun == StdFun::Max, wide);
                }
                self.push_view(best);
                self.drop_view(best);
            }
            StdFun::Limit => {
                // MIN(MAX(MN, IN), MX)
                let views = self.views(args, &[]);
                let [low, value, high] = views.as_slice() else {
                    return;
                };
                let least = self.better(*low, *value, true, wide);
                let both = self.better(least, *high, false, wide);
                self.push_view(both);
                self.drop_view(both);
            }
            _ => self.value_text(&args[0], wide),
        }
    }

    /// The larger or smaller of two; their locals are given back.
    fn better(&mut self, best: View, other: View, larger: bool, wide: bool) -> View {
        let keep = self.temp(ValType::I32);
        self.push_view(best);
        self.push_view(other);
        self.i(I::Call(helper::compare(wide)));
        self.i(I::I32Const(0));
        self.i(if larger { I::I32GeS } else { I::I32LeS });
        self.i(I::LocalSet(keep));
        for (a, b) in [(best.ptr, other.ptr), (best.len, other.len)] {
            self.i(I::LocalGet(a));
            self.i(I::LocalGet(b));
            self.i(I::LocalGet(keep));
            self.i(I::Select);
        }
        self.release(keep);
        self.drop_view(other);
        self.drop_view(best);
        self.keep_view()
    }

    fn mux_text(&mut self, args: &[Expr], span: Span) {
        let selector = self.spill(&args[0]);
        let count = args.len() as i64 - 1;
        self.i(I::LocalGet(selector));
        self.i(I::I64Const(count));
        self.i(I::I64GeU);
        self.trap_if(
            SiteKind::Selector(count),
            span,
            Some((selector, Elem::Lint)),
        );
        let views = self.views(&args[1..], &[]);
        let part = |v: &View, ptr: bool| if ptr { v.ptr } else { v.len };
        for ptr in [true, false] {
            self.i(I::LocalGet(part(&views[0], ptr)));
            for (number, view) in views.iter().enumerate().skip(1) {
                self.i(I::LocalGet(part(view, ptr)));
                self.i(I::LocalGet(selector));
                self.i(I::I64Const(number as i64));
                self.i(I::I64Ne);
                self.i(I::Select);
            }
        }
        for view in views {
            self.drop_view(view);
        }
        self.release(selector);
    }

    /// Turns the number of characters on the stack into bytes.
    fn scale_units(&mut self, wide: bool) {
        if wide {
            self.i(I::I32Const(1));
            self.i(I::I32Shl);
        }
    }

    /// Pushes `count - less`, brought into 0..limit. Nothing is subtracted before it is, so that nothing wraps.
    fn clamp(&mut self, count: &Expr, less: i32, limit: u32) {
        self.expr(count);
        let value = self.temp(ValType::I64);
        self.i(I::LocalSet(value));
        self.i(I::I32Const(0));
        self.i(I::LocalGet(limit));
        self.i(I::LocalGet(value));
        self.i(I::I32WrapI64);
        if less != 0 {
            self.i(I::I32Const(less));
            self.i(I::I32Sub);
        }
        self.i(I::LocalGet(value));
        self.i(I::LocalGet(limit));
        self.i(I::I64ExtendI32U);
        if less != 0 {
            self.i(I::I64Const(i64::from(less)));
            self.i(I::I64Add);
        }
        self.i(I::I64GtS);
        self.i(I::Select);
        self.i(I::LocalGet(value));
        self.i(I::I64Const(i64::from(less)));
        self.i(I::I64LtS);
        self.i(I::Select);
        self.release(value);
    }

    /// First character (from 0) and number of those that L and P mean.
    fn part(&mut self, of: View, length: &Expr, position: &Expr) -> (u32, u32) {
        self.clamp(position, 1, of.len);
        let start = self.temp(ValType::I32);
        self.i(I::LocalSet(start));
        let rest = self.temp(ValType::I32);
        self.i(I::LocalGet(of.len));
        self.i(I::LocalGet(start));
        self.i(I::I32Sub);
        self.i(I::LocalSet(rest));
        self.clamp(length, 0, rest);
        self.i(I::LocalSet(rest));
        (start, rest)
    }

    /// What stands before and behind the characters that L and P mean.
    fn cut(&mut self, of: View, length: &Expr, position: &Expr, wide: bool) -> (View, View) {
        let (start, count) = self.part(of, length, position);
        self.i(I::LocalGet(start));
        self.i(I::LocalGet(count));
        self.i(I::I32Add);
        self.i(I::LocalSet(count));
        let parts = self.split(of, start, count, wide);
        self.release(start);
        self.release(count);
        parts
    }

    /// The views up to `start` and from `end` on.
    fn split(&mut self, of: View, start: u32, end: u32, wide: bool) -> (View, View) {
        self.i(I::LocalGet(of.ptr));
        self.i(I::LocalGet(start));
        let head = self.keep_view();
        self.i(I::LocalGet(of.ptr));
        self.i(I::LocalGet(end));
        self.scale_units(wide);
        self.i(I::I32Add);
        self.i(I::LocalGet(of.len));
        self.i(I::LocalGet(end));
        self.i(I::I32Sub);
        let tail = self.keep_view();
        (head, tail)
    }

    /// How many characters the string can have. Its type does not tell where a VAR_IN_OUT or a reference is involved: the variable
    /// that it leads to may be longer.
    fn most(&self, expr: &Expr) -> u32 {
        let types = &self.m.project.types;
        let (wide, declared) = types.text(expr.ty).unwrap_or_default();
        let longest = |args: &[Expr]| args.iter().map(|a| self.most(a)).max().unwrap_or(0);
        let led_to = match &expr.kind {
            ExprKind::Load(place) => {
                let passed = place.steps.is_empty()
                    && matches!(place.root, Root::Var(id)
                        if matches!(self.slots.get(&id), Some(Slot::PointerText(..))));
                let referenced = place
                    .steps
                    .iter()
                    .any(|s| matches!(s.kind, StepKind::Deref));
                if passed || referenced {
                    self.m.passed_texts[usize::from(wide)]
                } else {
                    0
                }
            }
            ExprKind::Std(fun, args) => match fun {
                StdFun::Concat => args.iter().map(|a| self.most(a)).sum(),
                StdFun::Insert | StdFun::Replace => self.most(&args[0]) + self.most(&args[1]),
                StdFun::Left | StdFun::Right | StdFun::Mid | StdFun::Delete => self.most(&args[0]),
                StdFun::Sel | StdFun::Mux => longest(&args[1..]),
                StdFun::Max | StdFun::Min | StdFun::Limit => longest(args),
                _ if types.text(args[0].ty).is_some() => self.most(&args[0]),
                _ => 0,
            },
            ExprKind::Enabled(inner) => self.most(&inner.value),
            _ => 0,
        };
        declared.max(led_to.min(STRING_LEN_MAX))
    }

    /// Pushes the pieces one after the other as one string; gives their locals back.
    fn join(&mut self, pieces: &[View], wide: bool, expr: &Expr) {
        let most = self.most(expr);
        let at = self.m.allocate(u64::from(most) * if wide { 2 } else { 1 });
        let total = self.temp(ValType::I32);
        let room = self.temp(ValType::I32);
        self.i(I::I32Const(0));
        self.i(I::LocalSet(total));
        for piece in pieces {
            // No more than fits.
            self.i(I::I32Const(most as i32));
            self.i(I::LocalGet(total));
            self.i(I::I32Sub);
            self.i(I::LocalSet(room));
            self.lesser(piece.len, room);
            self.i(I::I32Const(at as i32));
            self.i(I::LocalGet(total));
            self.scale_units(wide);
            self.i(I::I32Add);
            self.i(I::LocalGet(piece.ptr));
            self.i(I::LocalGet(room));
            self.scale_units(wide);
            self.i(I::Call(helper::MOVE));
            self.i(I::LocalGet(total));
            self.i(I::LocalGet(room));
            self.i(I::I32Add);
            self.i(I::LocalSet(total));
        }
        self.i(I::I32Const(at as i32));
        self.i(I::LocalGet(total));
        self.release(room);
        self.release(total);
        for piece in pieces {
            self.drop_view(*piece);
        }
    }

    /// Standard functions of strings with a number as their result.
    pub fn text_number(&mut self, fun: StdFun, args: &[Expr], elem: Elem, span: Span) {
        let wide = self.is_wide(&args[0]);
        match fun {
            StdFun::Len => {
                let of = self.view(&args[0]);
                self.i(I::LocalGet(of.len));
                self.drop_view(of);
            }
            StdFun::Find | StdFun::Compare => {
                let a = self.view_before(&args[0], &args[1..]);
                let b = self.view(&args[1]);
                self.push_view(a);
                self.push_view(b);
                self.i(I::Call(if fun == StdFun::Find {
                    helper::find(wide)
                } else {
                    helper::compare(wide)
                }));
                self.drop_view(b);
                self.drop_view(a);
            }
            _ => return self.value_of_text(&args[0], elem, wide, span),
        }
        if val(elem) == ValType::I64 {
            self.i(I::I64ExtendI32U);
        }
    }

    /// Pushes the text of an elementary value, or of a string of the other width.
    fn value_text(&mut self, arg: &Expr, wide: bool) {
        let project = self.m.project;
        if let Some((from_wide, _)) = project.types.text(arg.ty) {
            let most = self.most(arg);
            let at = self.m.allocate(u64::from(most) * 2);
            let of = self.view(arg);
            self.i(I::LocalGet(of.ptr));
            // Never more than there is room for, whatever a reference leads to.
            self.i(I::LocalGet(of.len));
            self.i(I::I32Const(most as i32));
            self.i(I::LocalGet(of.len));
            self.i(I::I32Const(most as i32));
            self.i(I::I32LtU);
            self.i(I::Select);
            self.drop_view(of);
            self.i(I::I32Const(at as i32));
            self.i(I::I32Const(i32::from(from_wide)));
            let number = self
                .m
                .import("text_convert", &[ValType::I32; 4], &[ValType::I32]);
            let len = self.temp(ValType::I32);
            self.i(I::Call(number));
            self.i(I::LocalSet(len));
            self.i(I::I32Const(at as i32));
            self.i(I::LocalGet(len));
            self.release(len);
            return;
        }
        let elem = self.elem(arg.ty);
        let at = self.m.allocate(128);
        if elem.is_char() {
            self.i(I::I32Const(at as i32));
            self.expr(arg);
            self.i(if wide {
                I::I32Store16(mem(0, 0))
            } else {
                I::I32Store8(mem(0, 0))
            });
            self.i(I::I32Const(at as i32));
            self.i(I::I32Const(1));
            return;
        }
        self.i(I::I32Const(elem as i32));
        self.expr(arg);
        match val(elem) {
            ValType::F32 => {
                self.i(I::I32ReinterpretF32);
                self.i(I::I64ExtendI32U);
            }
            ValType::F64 => self.i(I::I64ReinterpretF64),
            ValType::I64 => {}
            _ => self.i(I::I64ExtendI32S),
        }
        self.i(I::I32Const(at as i32));
        self.i(I::I32Const(i32::from(wide)));
        let params = [ValType::I32, ValType::I64, ValType::I32, ValType::I32];
        let number = self.m.import("text_of_value", &params, &[ValType::I32]);
        self.i(I::Call(number));
        let len = self.temp(ValType::I32);
        self.i(I::LocalSet(len));
        self.i(I::I32Const(at as i32));
        self.i(I::LocalGet(len));
        self.release(len);
    }

    /// Pushes the value that a text shows.
    fn value_of_text(&mut self, arg: &Expr, elem: Elem, wide: bool, span: Span) {
        self.i(I::I32Const(elem as i32));
        self.text(arg);
        self.i(I::I32Const(i32::from(wide)));
        let params = [ValType::I32; 4];
        let results = [ValType::I64, ValType::I32];
        let number = self.m.import("value_of_text", &params, &results);
        self.i(I::Call(number));
        self.i(I::I32Eqz);
        let bits = self.temp(ValType::I64);
        let failed = self.temp(ValType::I32);
        self.i(I::LocalSet(failed));
        self.i(I::LocalSet(bits));
        self.i(I::LocalGet(failed));
        self.trap_if(SiteKind::Text(elem.name().to_owned()), span, None);
        self.i(I::LocalGet(bits));
        match val(elem) {
            ValType::F32 => {
                self.i(I::I32WrapI64);
                self.i(I::F32ReinterpretI32);
            }
            ValType::F64 => self.i(I::F64ReinterpretI64),
            ValType::I64 => {}
            _ => self.i(I::I32WrapI64),
        }
        self.release(failed);
        self.release(bits);
    }
}

/// Whether the string is, or is a part of, what a variable holds.
fn reads_variable(expr: &Expr) -> bool {
    match &expr.kind {
        ExprKind::Load(_) => true,
        ExprKind::Std(fun, args) => {
            !matches!(
                fun,
                StdFun::Concat | StdFun::Insert | StdFun::Delete | StdFun::Replace | StdFun::ToText
            ) && args.iter().any(reads_variable)
        }
        ExprKind::Enabled(inner) => reads_variable(&inner.value),
        _ => false,
    }
}

/// Whether evaluating it may write variables: it runs a function of the project, or tells an ENO.
pub fn calls(expr: &Expr) -> bool {
    let mut found = false;
    visit_nodes(expr, &mut |node| {
        found |= matches!(node, Node::Call(_) | Node::Stmt(_));
    });
    found
}
