//! Expressions of a wanted type.

use fam_soft_plc::types::Elem;

use super::scope::Scope;
use super::types::{BITS, COUNTS, INTS, REALS, TIMES};
use super::{Callable, Ty, World};

impl World {
    /// An expression of exactly this type.
    pub fn expr(&mut self, scope: &mut Scope, ty: &Ty, depth: u32) -> String {
        match ty {
            Ty::El(elem) => {
                let narrower: Vec<Elem> = Elem::ALL
                    .into_iter()
                    .filter(|e| e.widens_to(*elem) && e != elem)
                    .collect();
                if !narrower.is_empty() && self.random.chance(12) {
                    self.note("implicit widening");
                    let from = *self.random.one(&narrower);
                    return self.elem_expr(scope, from, depth);
                }
                self.elem_expr(scope, *elem, depth)
            }
            Ty::Str(wide, _) => self.text_expr(scope, *wide, depth),
            _ if depth > 0 && self.random.chance(25) => match self.call_value(scope, ty, depth - 1)
            {
                Some(call) => call,
                None => self.simple(scope, ty, depth),
            },
            _ => self.simple(scope, ty, depth),
        }
    }

    /// A variable or a literal.
    fn simple(&mut self, scope: &mut Scope, ty: &Ty, depth: u32) -> String {
        let wanted = ty.clone();
        let found = self.place(scope, depth.min(1), |l| l.ty == wanted);
        match (ty, found) {
            (Ty::Sub(n), found) => {
                let (base, low, high) = (self.subs[*n].base, self.subs[*n].low, self.subs[*n].high);
                match self.random.below(4) {
                    0 => self.sub_literal(*n),
                    1 if self.risky => self.variable(scope, base, 0),
                    2 => {
                        self.note("subrange");
                        let value = self.variable(scope, base, 0);
                        format!("LIMIT({base}#{low}, {value}, {base}#{high})")
                    }
                    _ => found.map_or_else(|| self.sub_literal(*n), |f| f.0),
                }
            }
            (_, Some((text, _)))
                if self.random.chance(70) || matches!(ty, Ty::Struct(_) | Ty::Array(..)) =>
            {
                text
            }
            (Ty::Enum(n), _) => {
                self.note("enumerated value");
                let value = self.random.below(4);
                format!("{}#{}", self.enums[*n].name, self.enums[*n].values[value])
            }
            (Ty::Ref(to), _) => {
                let to = (**to).clone();
                match self.place(scope, 1, |l| l.ty == to && l.refer && !l.behind) {
                    Some((text, _)) if self.random.chance(90) => {
                        self.note("reference taken");
                        format!("REF({text})")
                    }
                    _ => "NULL".to_owned(),
                }
            }
            (_, Some((text, _))) => text,
            // The caller makes sure that there is one.
            (ty, None) => self.literal(match ty {
                Ty::El(elem) => *elem,
                _ => Elem::Int,
            }),
        }
    }

    /// A variable of an elementary type, or something that is not constant.
    pub fn variable(&mut self, scope: &mut Scope, elem: Elem, depth: u32) -> String {
        match self.place(scope, depth, |l| l.ty == Ty::El(elem)) {
            Some((text, _)) => text,
            None => match elem {
                Elem::Bool => "(TIME() > T#5ms)".to_owned(),
                Elem::Time => "TIME()".to_owned(),
                elem if TIMES.contains(&elem) => format!("LINT_TO_{elem}(TIME_TO_LINT(TIME()))"),
                elem if elem.is_real() => format!("TIME_TO_{elem}(TIME())"),
                elem => format!("LINT_TO_{elem}(TIME_TO_LINT(TIME()) / 1000000)"),
            },
        }
    }

    pub fn elem_expr(&mut self, scope: &mut Scope, t: Elem, depth: u32) -> String {
        if depth == 0 {
            return if self.random.chance(40) {
                self.literal(t)
            } else {
                self.variable(scope, t, 0)
            };
        }
        let d = depth - 1;
        match self.random.below(12) {
            0 => {
                self.note("SEL");
                let g = self.elem_expr(scope, Elem::Bool, d);
                format!(
                    "SEL({g}, {}, {})",
                    self.elem_expr(scope, t, d),
                    self.elem_expr(scope, t, d)
                )
            }
            1 if t != Elem::Bool => {
                self.note("LIMIT, MAX, MIN");
                let (a, b, c) = (
                    self.elem_expr(scope, t, d),
                    self.elem_expr(scope, t, d),
                    self.elem_expr(scope, t, d),
                );
                match self.random.below(3) {
                    0 => format!("LIMIT({a}, {b}, {c})"),
                    1 => format!("MAX({a}, {b}, {c})"),
                    _ => format!("MIN({a}, {b})"),
                }
            }
            2 => {
                self.note("MUX");
                let k = self.variable(scope, Elem::Int, 0);
                let k = if self.risky && self.random.chance(20) {
                    k
                } else {
                    format!("LIMIT(0, {k}, 1)")
                };
                format!(
                    "MUX({k}, {}, {})",
                    self.elem_expr(scope, t, d),
                    self.elem_expr(scope, t, d)
                )
            }
            3 | 4 => match self.call_value(scope, &Ty::El(t), d) {
                Some(call) => call,
                None => self.special(scope, t, d),
            },
            5..=8 => self.special(scope, t, d),
            9 => self.variable(scope, t, depth),
            _ => self.operator(scope, t, d),
        }
    }

    fn operator(&mut self, scope: &mut Scope, t: Elem, d: u32) -> String {
        self.note("operator");
        if t == Elem::Bool || t.is_bit() {
            let (a, b) = (self.elem_expr(scope, t, d), self.elem_expr(scope, t, d));
            return match self.random.below(5) {
                0 => format!("(NOT {a})"),
                n => format!("({a} {} {b})", ["AND", "OR", "XOR", "&"][n - 1]),
            };
        }
        if t.is_char() || matches!(t, Elem::Date | Elem::Tod | Elem::Dt) {
            return self.special(scope, t, d);
        }
        let a = self.elem_expr(scope, t, d);
        if t == Elem::Time {
            let b = self.elem_expr(scope, t, d);
            return format!("({a} {} {b})", self.random.one(&["+", "-"]));
        }
        let choice = self.random.below(if t.is_real() { 5 } else { 6 });
        match choice {
            0..=2 => {
                let b = self.elem_expr(scope, t, d);
                let functional = [
                    format!("ADD({a}, {b})"),
                    format!("SUB({a}, {b})"),
                    format!("MUL({a}, {b})"),
                ];
                if self.random.chance(15) {
                    return functional[choice].clone();
                }
                format!("({a} {} {b})", ["+", "-", "*"][choice])
            }
            3 if t.is_signed() || t.is_real() => format!("(-{})", self.variable(scope, t, d)),
            4 if t.is_real() => {
                self.note("power");
                let b = *self.random.one(&["2.0", "0.5", "-1.0", "3.0"]);
                format!("(ABS({a}) ** {t}#{b})")
            }
            _ => {
                self.note("division");
                let divisor = if t.is_real() || (self.risky && self.random.chance(30)) {
                    self.variable(scope, t, d)
                } else if self.random.chance(50) {
                    format!("{t}#{}", self.random.within(1, 9))
                } else {
                    format!("MAX({t}#1, {})", self.variable(scope, t, d))
                };
                let op = if t.is_real() {
                    "/"
                } else {
                    *self.random.one(&["/", "MOD"])
                };
                format!("({a} {op} {divisor})")
            }
        }
    }

    /// What only some types have.
    fn special(&mut self, scope: &mut Scope, t: Elem, d: u32) -> String {
        match t {
            Elem::Bool => self.truth(scope, d),
            t if t.is_int() => self.integer(scope, t, d),
            t if t.is_bit() => self.bits(scope, t, d),
            t if t.is_real() => self.real(scope, t, d),
            Elem::Time => match self.random.below(6) {
                0 => {
                    self.note("time arithmetic");
                    let n = *self
                        .random
                        .one(&[Elem::Sint, Elem::Int, Elem::Dint, Elem::Udint]);
                    let n = self.elem_expr(scope, n, d);
                    let a = self.variable(scope, t, d);
                    format!("({a} * {n})")
                }
                1 => {
                    let n = self.random.within(1, 50);
                    format!("({} / {n})", self.elem_expr(scope, t, d))
                }
                2 if self.risky => {
                    let a = self.variable(scope, t, d);
                    format!("({a} * {})", self.variable(scope, Elem::Lreal, d))
                }
                3 => {
                    let other = *self.random.one(&[Elem::Date, Elem::Tod, Elem::Dt]);
                    let (a, b) = (
                        self.elem_expr(scope, other, d),
                        self.variable(scope, other, d),
                    );
                    self.note("date arithmetic");
                    format!("({a} - {b})")
                }
                4 => {
                    let n = *self.random.one(&COUNTS);
                    format!("{n}_TO_TIME({})", self.variable(scope, n, d))
                }
                _ => "TIME()".to_owned(),
            },
            Elem::Date => {
                let value = self.variable(scope, Elem::Dt, d);
                format!("DT_TO_DATE({value})")
            }
            Elem::Tod => {
                let value = self.variable(scope, Elem::Dt, d);
                format!("DT_TO_TOD({value})")
            }
            Elem::Dt => {
                self.note("date arithmetic");
                let time = self.elem_expr(scope, Elem::Time, d);
                let value = self.variable(scope, Elem::Dt, d);
                format!("({value} {} {time})", self.random.one(&["+", "-"]))
            }
            t => {
                self.note("characters");
                let n = if t == Elem::Char {
                    Elem::Byte
                } else {
                    Elem::Word
                };
                format!("{n}_TO_{t}({})", self.variable(scope, n, d))
            }
        }
    }

    fn truth(&mut self, scope: &mut Scope, d: u32) -> String {
        match self.random.below(8) {
            0 => {
                self.note("bit access");
                let s = *self.random.one(&BITS);
                match self.place(scope, d, |l| l.ty == Ty::El(s)) {
                    Some((text, _)) => {
                        let bit = self.random.below(s.bits() as usize);
                        let form = *self.random.one(&[".", ".%X"]);
                        format!("{text}{form}{bit}")
                    }
                    None => self.literal(Elem::Bool),
                }
            }
            1 => {
                self.note("comparison of strings");
                let wide = self.random.chance(25);
                let (a, b) = (
                    self.text_expr(scope, wide, d),
                    self.text_expr(scope, wide, d),
                );
                format!(
                    "({a} {} {b})",
                    self.random.one(&["=", "<>", "<", "<=", ">", ">="])
                )
            }
            2 => {
                self.note("comparison of enumerated values");
                let ty = Ty::Enum(self.random.below(2));
                let (a, b) = (self.simple(scope, &ty, d), self.simple(scope, &ty, 0));
                format!("({a} {} {b})", self.random.one(&["=", "<>"]))
            }
            3 => {
                let s = *self.random.one(&REALS);
                format!("IS_VALID({})", self.variable(scope, s, d))
            }
            4 => {
                let s = *self.random.one(&INTS);
                format!("{s}_TO_BOOL({})", self.elem_expr(scope, s, d))
            }
            5 => match self.place(scope, d, |l| matches!(l.ty, Ty::Ref(_))) {
                Some((text, _)) => {
                    self.note("comparison of references");
                    format!("({text} {} NULL)", self.random.one(&["=", "<>"]))
                }
                None => self.literal(Elem::Bool),
            },
            _ => {
                let all: Vec<Elem> = Elem::ALL.into_iter().collect();
                let s = *self.random.one(&all);
                let (a, b) = (self.elem_expr(scope, s, d), self.elem_expr(scope, s, d));
                if self.random.chance(15) {
                    let c = self.elem_expr(scope, s, d);
                    return format!(
                        "{}({a}, {b}, {c})",
                        self.random.one(&["GT", "GE", "EQ", "LE", "LT"])
                    );
                }
                format!(
                    "({a} {} {b})",
                    self.random.one(&["=", "<>", "<", "<=", ">", ">="])
                )
            }
        }
    }

    fn integer(&mut self, scope: &mut Scope, t: Elem, d: u32) -> String {
        match self.random.below(9) {
            0 => {
                self.note("LEN, FIND");
                let wide = self.random.chance(25);
                let a = self.text_expr(scope, wide, d);
                if t.bits() < 16 {
                    return format!("INT_TO_{t}(LEN({a}))");
                }
                if self.random.chance(50) {
                    return format!("INT_TO_{t}(FIND({a}, {}))", self.text_expr(scope, wide, d));
                }
                format!("INT_TO_{t}(LEN({a}))")
            }
            1 => {
                self.note("real to integer");
                let s = *self.random.one(&REALS);
                let word = *self.random.one(&["TO", "TRUNC"]);
                let value = self.variable(scope, s, d);
                if self.risky && self.random.chance(30) {
                    return format!("{s}_{word}_{t}({value})");
                }
                let low = if t.is_signed() { "-100.0" } else { "0.0" };
                format!(
                    "{s}_{word}_{t}(SEL(IS_VALID({value}), {s}#0.5, LIMIT({s}#{low}, {value}, {s}#100.0)))"
                )
            }
            2 => {
                let s = *self.random.one(&BITS);
                format!("{s}_TO_{t}({})", self.elem_expr(scope, s, d))
            }
            3 => format!("BOOL_TO_{t}({})", self.elem_expr(scope, Elem::Bool, d)),
            4 => format!("TIME_TO_{t}({})", self.elem_expr(scope, Elem::Time, d)),
            5 => {
                self.note("string to number");
                let text = if self.risky && self.random.chance(30) {
                    self.text_expr(scope, false, 0)
                } else {
                    let value = self.variable(scope, t, d);
                    format!("{t}_TO_STRING({value})")
                };
                format!("STRING_TO_{t}({text})")
            }
            6 => {
                let n = self.random.below(2);
                let value = self.simple(scope, &Ty::Enum(n), d);
                format!("{}_TO_{t}({value})", self.enums[n].name)
            }
            7 => format!("ABS({})", self.elem_expr(scope, t, d)),
            _ => {
                let s = *self.random.one(&INTS);
                self.note("conversion of integers");
                let value = self.elem_expr(scope, s, d);
                if self.random.chance(30) {
                    format!("TO_{t}({value})")
                } else {
                    format!("{s}_TO_{t}({value})")
                }
            }
        }
    }

    fn bits(&mut self, scope: &mut Scope, t: Elem, d: u32) -> String {
        match self.random.below(6) {
            0 | 1 => {
                self.note("shift, rotation");
                let n = *self.random.one(&COUNTS);
                let value = self.elem_expr(scope, t, d);
                let places = self.elem_expr(scope, n, 0);
                format!(
                    "{}({value}, {places})",
                    self.random.one(&["SHL", "SHR", "ROL", "ROR"])
                )
            }
            2 => {
                let wider: Vec<Elem> = BITS.into_iter().filter(|e| e.bits() > t.bits()).collect();
                if wider.is_empty() {
                    return self.operator(scope, t, d);
                }
                let s = *self.random.one(&wider);
                match self.place(scope, d, |l| l.ty == Ty::El(s)) {
                    Some((text, _)) => {
                        self.note("partial access");
                        let letter = match t {
                            Elem::Byte => 'B',
                            Elem::Word => 'W',
                            _ => 'D',
                        };
                        let part = self.random.below((s.bits() / t.bits()) as usize);
                        format!("{text}.%{letter}{part}")
                    }
                    None => self.literal(t),
                }
            }
            3 if t == Elem::Dword => {
                format!("REAL_TO_DWORD({})", self.variable(scope, Elem::Real, d))
            }
            3 if t == Elem::Lword => {
                format!("LREAL_TO_LWORD({})", self.variable(scope, Elem::Lreal, d))
            }
            4 => {
                self.note("byte order");
                format!("TO_BIG_ENDIAN({})", self.elem_expr(scope, t, d))
            }
            _ => {
                let s = *self.random.one(&INTS);
                format!("{s}_TO_{t}({})", self.elem_expr(scope, s, d))
            }
        }
    }

    fn real(&mut self, scope: &mut Scope, t: Elem, d: u32) -> String {
        match self.random.below(6) {
            0 | 1 => {
                self.note("real function");
                let name = *self.random.one(&[
                    "SQRT", "SIN", "COS", "TAN", "ATAN", "ASIN", "ACOS", "ABS", "EXP", "LN", "LOG",
                ]);
                format!("{name}({})", self.elem_expr(scope, t, d))
            }
            2 => {
                let (a, b) = (self.elem_expr(scope, t, d), self.elem_expr(scope, t, d));
                format!("ATAN2({a}, {b})")
            }
            3 if t == Elem::Real => {
                format!("DWORD_TO_REAL({})", self.elem_expr(scope, Elem::Dword, d))
            }
            3 => format!("LWORD_TO_LREAL({})", self.elem_expr(scope, Elem::Lword, d)),
            4 => {
                let s = if t == Elem::Real {
                    Elem::Lreal
                } else {
                    Elem::Real
                };
                format!("{s}_TO_{t}({})", self.elem_expr(scope, s, d))
            }
            _ => {
                let s = *self.random.one(&INTS);
                format!("{s}_TO_{t}({})", self.elem_expr(scope, s, d))
            }
        }
    }

    pub fn text_expr(&mut self, scope: &mut Scope, wide: bool, depth: u32) -> String {
        let fits = move |l: &super::scope::Leaf| matches!(l.ty, Ty::Str(w, _) if w == wide);
        if depth == 0 || self.random.chance(20) {
            return match self.place(scope, 0, fits) {
                Some((text, _)) if self.random.chance(60) => text,
                _ => self.text_literal(wide),
            };
        }
        let d = depth - 1;
        let name = if wide { "WSTRING" } else { "STRING" };
        let a = self.text_expr(scope, wide, d);
        self.note("string function");
        match self.random.below(13) {
            0 => format!("LEFT({a}, {})", self.count(scope)),
            1 => format!("RIGHT({a}, {})", self.count(scope)),
            2 => format!("MID({a}, {}, {})", self.count(scope), self.count(scope)),
            3 => format!("CONCAT({a}, {})", self.text_expr(scope, wide, d)),
            4 => format!(
                "INSERT({a}, {}, {})",
                self.text_expr(scope, wide, d),
                self.count(scope)
            ),
            5 => format!("DELETE({a}, {}, {})", self.count(scope), self.count(scope)),
            6 => {
                let b = self.text_expr(scope, wide, d);
                format!(
                    "REPLACE(IN1 := {a}, IN2 := {b}, L := {}, P := {})",
                    self.count(scope),
                    self.count(scope)
                )
            }
            7 => {
                let t = self.elementary();
                if t.is_char() && (t == Elem::Wchar) != wide {
                    return a;
                }
                self.note("value as text");
                format!("{t}_TO_{name}({})", self.elem_expr(scope, t, d))
            }
            8 => {
                let g = self.elem_expr(scope, Elem::Bool, d);
                format!("SEL({g}, {a}, {})", self.text_expr(scope, wide, d))
            }
            9 => {
                let k = self.variable(scope, Elem::Int, 0);
                let (b, c) = (
                    self.text_expr(scope, wide, d),
                    self.text_expr(scope, wide, d),
                );
                format!("MUX(LIMIT(0, {k}, 2), {a}, {b}, {c})")
            }
            10 => {
                let b = self.text_expr(scope, wide, d);
                format!("{}({a}, {b})", self.random.one(&["MAX", "MIN"]))
            }
            11 => {
                let other = if wide { "STRING" } else { "WSTRING" };
                format!("{other}_TO_{name}({})", self.text_expr(scope, !wide, d))
            }
            _ => {
                let any = self.call_value(scope, &Ty::Str(wide, 7), d);
                any.unwrap_or(a)
            }
        }
    }

    /// A number of characters or a position.
    fn count(&mut self, scope: &mut Scope) -> String {
        if self.random.chance(60) {
            return self.random.within(-1, 6).to_string();
        }
        let elem = *self.random.one(&COUNTS);
        self.variable(scope, elem, 0)
    }

    /// A call of a function or method with a result of this type.
    pub fn call_value(&mut self, scope: &mut Scope, ty: &Ty, depth: u32) -> Option<String> {
        if scope.calls >= 2 {
            return None;
        }
        let fits = |c: &Callable| match (&c.result, ty) {
            (Some(Ty::Str(a, _)), Ty::Str(b, _)) => a == b,
            (Some(result), ty) => result == ty,
            _ => false,
        };
        let mut list: Vec<(String, Callable)> = self.functions[..scope.functions]
            .iter()
            .map(|f| (f.name.clone(), f.clone()))
            .collect();
        list.extend(self.method_calls(scope));
        list.retain(|(_, c)| fits(c));
        if list.is_empty() {
            return None;
        }
        let (name, callable) = self.random.one(&list).clone();
        self.note(if name.contains('.') {
            "method call in an expression"
        } else {
            "function call in an expression"
        });
        let call = self.call_text(scope, &name, &callable, depth)?;
        Some(self.enabled(scope, call, &name, 15))
    }

    /// At times with EN and ENO.
    pub fn enabled(
        &mut self,
        scope: &mut Scope,
        call: String,
        name: &str,
        percent: usize,
    ) -> String {
        let formal = call.contains(" := ") || call.contains("=>") || call.ends_with("()");
        if !formal || !self.random.chance(percent) {
            return call;
        }
        let target = self.place(scope, 0, |l| l.write && l.ty == Ty::El(Elem::Bool));
        let Some((eno, _)) = target else {
            return call;
        };
        self.note("EN, ENO");
        let enable = self.elem_expr(scope, Elem::Bool, 1);
        let args = &call[name.len() + 1..call.len() - 1];
        let comma = if args.is_empty() { "" } else { ", " };
        format!("{name}(EN := {enable}{comma}{args}, ENO => {eno})")
    }

    /// Methods that can be called, with what stands before their name.
    pub fn method_calls(&mut self, scope: &mut Scope) -> Vec<(String, Callable)> {
        let mut list = scope.methods.clone();
        let instances: Vec<super::scope::Leaf> = scope
            .leaves
            .iter()
            .filter(|l| matches!(l.ty, Ty::Block(_)) && !l.behind)
            .cloned()
            .collect();
        for leaf in instances {
            let Ty::Block(n) = leaf.ty else { continue };
            let mut at = Some(n);
            let mut seen: Vec<String> = Vec::new();
            while let Some(block) = at {
                for method in self.blocks[block].methods.clone() {
                    if !seen.contains(&method.name) {
                        let text = self.path_text(scope, &leaf.path, 0);
                        list.push((format!("{text}.{}", method.name), method.clone()));
                        seen.push(method.name);
                    }
                }
                at = self.blocks[block].base;
            }
        }
        list
    }

    /// The call with all its arguments; `None` if some variable by reference cannot be had.
    pub fn call_text(
        &mut self,
        scope: &mut Scope,
        name: &str,
        callable: &Callable,
        depth: u32,
    ) -> Option<String> {
        scope.calls += 1;
        let mut args = Vec::new();
        let mut formal =
            self.random.chance(60) || !callable.outputs.is_empty() || !callable.in_outs.is_empty();
        let mut failed = false;
        for (parameter, ty) in &callable.inputs {
            if formal && self.random.chance(15) && !matches!(ty, Ty::Struct(_) | Ty::Array(..)) {
                self.note("argument left out");
                continue;
            }
            if matches!(ty, Ty::Struct(_) | Ty::Array(..)) {
                formal = true;
                let wanted = ty.clone();
                match self.place(scope, 1, |l| l.ty == wanted) {
                    Some((text, _)) => args.push(format!("{parameter} := {text}")),
                    None => failed = true,
                }
                continue;
            }
            let value = self.expr(scope, ty, depth);
            args.push(format!("{parameter} := {value}"));
        }
        for (parameter, ty) in &callable.in_outs {
            let wanted = ty.clone();
            let fits = |l: &super::scope::Leaf| {
                l.write
                    && match (&l.ty, &wanted) {
                        (Ty::Str(a, _), Ty::Str(b, _)) => a == b,
                        (a, b) => a == b,
                    }
            };
            match self.place(scope, 1, fits) {
                Some((text, _)) => {
                    self.note("variable by reference");
                    args.push(format!("{parameter} := {text}"));
                }
                None => failed = true,
            }
        }
        for (parameter, ty) in &callable.outputs {
            if self.random.chance(30) {
                continue;
            }
            let wanted = ty.clone();
            if let Some((text, _)) = self.place(scope, 1, |l| l.write && l.ty == wanted) {
                let negated = *ty == Ty::El(Elem::Bool) && self.random.chance(40);
                self.note(if negated {
                    "negated output argument"
                } else {
                    "output argument"
                });
                let not = if negated { "NOT " } else { "" };
                args.push(format!("{not}{parameter} => {text}"));
            }
        }
        scope.calls -= 1;
        if failed {
            return None;
        }
        if !formal {
            for arg in &mut args {
                if let Some((_, value)) = arg.split_once(" := ") {
                    *arg = value.to_owned();
                }
            }
        }
        Some(format!("{name}({})", args.join(", ")))
    }
}
