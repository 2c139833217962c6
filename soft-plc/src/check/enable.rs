//! Calls with EN and ENO (clause 6.6.1.8): they run only if EN is true, and ENO tells whether they did.

use crate::check::Checker;
use crate::check::expr::{constant, error_expr};
use crate::check::tree::{Enabled, Expr, ExprKind, InitValue, PouId, Stmt, StmtKind};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{self, Arg, VarSection};
use crate::syntax::build::At;
use crate::types::TypeId;
use crate::value::Value;

/// A call taken apart.
struct Split {
    /// `None`: it runs in any case.
    enable: Option<ast::Expr>,
    /// Where ENO goes, and whether as `NOT ENO =>`.
    eno: Option<(ast::Expr, bool)>,
    /// Whether the called POU tells ENO itself if it runs.
    declares_eno: bool,
    /// The arguments that the called POU declares.
    rest: Vec<Arg>,
}

impl Split {
    /// What is stored where ENO leads to, if it leads anywhere.
    fn tell(&self, ran: bool) -> Option<ast::Stmt> {
        let (target, negated) = self.eno.clone().filter(|_| !(ran && self.declares_eno))?;
        let at = At(target.span);
        Some(at.assign(target, at.bool(ran != negated)))
    }
}

fn named(arg: &Arg, name: &str) -> bool {
    arg.name
        .as_ref()
        .is_some_and(|n| n.name.eq_ignore_ascii_case(name))
}

impl Checker<'_> {
    /// A call with EN or ENO, alone or as the value of an assignment. `None` if the statement has neither; `Some(None)` after
    /// a mistake. The variable keeps its value if the call does not run.
    pub(super) fn enabled_call(&mut self, stmt: &ast::Stmt) -> Option<Option<StmtKind>> {
        let call = match &stmt.kind {
            ast::StmtKind::Call(call) | ast::StmtKind::Assign(_, call) => call,
            _ => return None,
        };
        let ast::ExprKind::Call(callee, args) = &call.kind else {
            return None;
        };
        let at = At(stmt.span);
        let split = self.split(callee, args, at)?;
        let plain = ast::Expr {
            kind: ast::ExprKind::Call(callee.clone(), split.rest.clone()),
            span: call.span,
        };
        let inner = match &stmt.kind {
            ast::StmtKind::Assign(target, _) => ast::StmtKind::Assign(target.clone(), plain),
            _ => ast::StmtKind::Call(plain),
        };
        let mut on = vec![at.stmt(inner)];
        on.extend(split.tell(true));
        let off = split.tell(false).into_iter().collect();
        let whole = match split.enable {
            Some(enable) => ast::StmtKind::If(vec![(enable, on)], off),
            None => ast::StmtKind::Block(on),
        };
        Some(self.stmt(&at.stmt(whole)))
    }

    /// A call with EN or ENO inside an expression: its value is the initial value of its type if it does not run.
    pub(super) fn enabled_value(
        &mut self,
        callee: &ast::Expr,
        args: &[Arg],
        expected: Option<TypeId>,
        span: Span,
    ) -> Option<Expr> {
        let at = At(span);
        let split = self.split(callee, args, at)?;
        let condition = match &split.enable {
            Some(enable) => self.condition(enable),
            None => constant(Value::Bool(true), TypeId::BOOL, span),
        };
        let value = self.call_expr(callee, &split.rest, expected, span);
        let value = self.settle(value);
        let tell = |checker: &mut Self, ran| -> Vec<Stmt> {
            let stmt = split.tell(ran);
            checker.stmts(stmt.as_slice())
        };
        let (on, off) = (tell(self, true), tell(self, false));
        if condition.ty == TypeId::ERROR || value.ty == TypeId::ERROR {
            return Some(error_expr(span));
        }
        let Some(otherwise) = self.unset(value.ty) else {
            let message = format!(
                "EN in a call inside an expression needs a single value or a string as result, and this is {}",
                self.type_name(value.ty)
            );
            self.report(
                Problem::error("E417", span, message)
                    .hint("make the call a statement of its own: `x := f(EN := c, ...)`"),
            );
            return Some(error_expr(span));
        };
        let ty = value.ty;
        let otherwise = Expr {
            kind: otherwise,
            ty,
            span,
        };
        Some(Expr {
            kind: ExprKind::Enabled(Box::new(Enabled {
                condition,
                value,
                on,
                otherwise,
                off,
            })),
            ty,
            span,
        })
    }

    /// What a variable of the type holds when nothing else is said; `None` for arrays and structures.
    fn unset(&self, ty: TypeId) -> Option<ExprKind> {
        if self.types.text(ty).is_some() {
            return Some(ExprKind::Text(match self.types.init(ty) {
                Some(InitValue::Text(units)) => units.clone(),
                _ => [].into(),
            }));
        }
        self.types.default_value(ty).map(ExprKind::Const)
    }

    /// Takes EN and ENO out of the arguments, if they are there. What the called POU declares of them it gets back: EN is TRUE
    /// when it runs.
    fn split(&mut self, callee: &ast::Expr, args: &[Arg], at: At) -> Option<Split> {
        let special = |arg: &&Arg| named(arg, "EN") || named(arg, "ENO");
        if !args.iter().any(|a| special(&a)) {
            return None;
        }
        let (declares_en, declares_eno) = self.declares_enable(callee);
        // In the dialect a declared EN is an input like any other.
        if declares_en && self.is_liberal() {
            return None;
        }
        let enable = self.only(args, "EN", false).map(|(value, _)| value);
        let eno = self.only(args, "ENO", true);
        // Nothing is left to do here: the POU looks at its own EN, and tells its own ENO.
        let always = match &enable {
            None => true,
            Some(value) => declares_en && matches!(value.kind, ast::ExprKind::Bool(true)),
        };
        if always && (declares_eno || eno.is_none()) {
            return None;
        }
        let mut rest: Vec<Arg> = args.iter().filter(|a| !special(a)).cloned().collect();
        if declares_en && enable.is_some() {
            rest.push(at.input("EN", at.bool(true)));
        }
        if declares_eno {
            rest.extend(args.iter().filter(|a| named(a, "ENO")).cloned());
        }
        Some(Split {
            enable,
            eno,
            declares_eno,
            rest,
        })
    }

    /// The argument of this name, and whether it is negated; reports a second one, and one with the wrong arrow.
    fn only(&mut self, args: &[Arg], name: &str, output: bool) -> Option<(ast::Expr, bool)> {
        let mut found = args.iter().filter(|a| named(a, name));
        let arg = found.next()?;
        if arg.output != output
            && let Some(given) = &arg.name
        {
            let (have, want) = if output { (":=", "=>") } else { ("=>", ":=") };
            let message = format!("`{name}` cannot stand before `{have}`");
            self.report(Problem::error("E408", given.span, message).expected(format!("`{want}`")));
        }
        if let Some(second) = found.next().and_then(|a| a.name.as_ref()) {
            let message = format!("`{name}` is given twice");
            self.report(Problem::error("E408", second.span, message));
        }
        Some((arg.value.clone()?, arg.negated))
    }

    /// Whether the called POU declares EN, and whether ENO.
    fn declares_enable(&mut self, callee: &ast::Expr) -> (bool, bool) {
        let pou = match &callee.kind {
            ast::ExprKind::Name(name) if self.find_var(name).is_none() => {
                self.find_declared_pou(name)
            }
            _ => {
                let before = self.problems.len();
                let place = self.place(callee);
                self.problems.truncate(before);
                match place.map(|p| self.types.kind(p.ty).clone()) {
                    Some(crate::types::TypeKind::FunctionBlock(pou)) => Some(pou),
                    _ => None,
                }
            }
        };
        pou.map_or((false, false), |pou| {
            (
                self.declared_enable(pou, "EN", VarSection::Input),
                self.declared_enable(pou, "ENO", VarSection::Output),
            )
        })
    }

    fn declared_enable(&self, pou: PouId, name: &str, section: VarSection) -> bool {
        self.pou(pou).vars.iter().any(|v| {
            let var = self.var(*v);
            var.section == section && var.name.eq_ignore_ascii_case(name) && var.ty == TypeId::BOOL
        })
    }

    /// What a POU that declares EN or ENO does before its statements: with EN false nothing else, and ENO is TRUE until they
    /// say something else.
    pub(super) fn enable_prologue(&mut self, pou: PouId) -> Vec<Stmt> {
        if self.is_liberal() {
            return Vec::new();
        }
        let en = self.declared_enable(pou, "EN", VarSection::Input);
        let eno = self.declared_enable(pou, "ENO", VarSection::Output);
        let at = At(self.pou(pou).name_span);
        let tell = |ran| eno.then(|| at.assign(at.name("ENO"), at.bool(ran)));
        let mut list = Vec::new();
        if en {
            let mut off: Vec<ast::Stmt> = tell(false).into_iter().collect();
            off.push(at.stmt(ast::StmtKind::Return));
            list.push(at.if_then(at.not(at.name("EN")), off));
        }
        list.extend(tell(true));
        self.stmts(&list)
    }
}
