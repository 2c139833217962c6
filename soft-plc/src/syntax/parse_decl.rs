//! Declarations: types, variables, POUs, configurations (IEC 61131-3, clauses 6.4 to 6.8).

use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{
    Access, Class, Edge, Ident, Interface, Namespace, Pou, PouKind, Project, Using, VarBlock,
    VarDecl, VarSection,
};
use crate::syntax::lexer::{Kw, Tok};
use crate::syntax::parse_stmt::starts_statement;
use crate::syntax::parser::{Parsed, Parser, Stop};

fn section(kw: Kw) -> Option<VarSection> {
    Some(match kw {
        Kw::Var => VarSection::Local,
        Kw::VarInput => VarSection::Input,
        Kw::VarOutput => VarSection::Output,
        Kw::VarInOut => VarSection::InOut,
        Kw::VarGlobal => VarSection::Global,
        Kw::VarExternal => VarSection::External,
        Kw::VarTemp => VarSection::Temp,
        Kw::VarConfig | Kw::VarAccess => return None,
        _ => return None,
    })
}

pub(super) fn starts_declaration(kw: Kw) -> bool {
    matches!(
        kw,
        Kw::Program
            | Kw::Function
            | Kw::FunctionBlock
            | Kw::Type
            | Kw::VarGlobal
            | Kw::Configuration
    )
}

pub(super) fn ends_variables(kw: Kw) -> bool {
    section(kw).is_some()
        || starts_declaration(kw)
        || matches!(
            kw,
            Kw::EndVar
                | Kw::EndProgram
                | Kw::EndFunction
                | Kw::EndFunctionBlock
                | Kw::EndStruct
                | Kw::EndType
        )
}

/// How many names a path may have, and how many namespaces may stand in each other.
const PATH_PARTS_MAX: usize = 16;

/// How many there were.
struct Declared {
    types: usize,
    pous: usize,
    interfaces: usize,
    globals: usize,
}

impl Declared {
    fn of(project: &Project) -> Self {
        Self {
            types: project.types.len(),
            pous: project.pous.len(),
            interfaces: project.interfaces.len(),
            globals: project.globals.len(),
        }
    }
}

fn join(space: &str, name: &str) -> String {
    match space {
        "" => name.to_owned(),
        _ => format!("{space}.{name}"),
    }
}

/// Whether the path is that of the namespace, or of one in it.
fn is_within(path: &str, space: &str) -> bool {
    let (path, space) = (path.to_ascii_uppercase(), space.to_ascii_uppercase());
    let rest = path.strip_prefix(&space);
    space.is_empty() || rest.is_some_and(|r| r.is_empty() || r.starts_with('.'))
}

impl Parser<'_> {
    pub fn file(&mut self, project: &mut Project) {
        loop {
            let before = self.position();
            let declared = Declared::of(project);
            let result = match self.peek() {
                Tok::Eof => break,
                Tok::Semi => {
                    self.advance();
                    continue;
                }
                Tok::Kw(Kw::Program) => self.pou(PouKind::Program, project),
                Tok::Kw(Kw::Function) => self.pou(PouKind::Function, project),
                Tok::Kw(Kw::FunctionBlock) => self.pou(PouKind::FunctionBlock, project),
                Tok::Kw(Kw::Type) => self.type_block(project),
                Tok::Kw(Kw::VarGlobal) => self.var_block().map(|block| project.globals.push(block)),
                Tok::Kw(Kw::Configuration) => self.configuration(project),
                Tok::Ident if self.at_word("CLASS") => {
                    self.pou(PouKind::FunctionBlock, project)
                }
                Tok::Ident if self.at_word("INTERFACE") => self.interface(project),
                Tok::Ident if self.at_word("NAMESPACE") => self.namespace(project),
                Tok::Ident if self.at_word("USING") => self.using().map(|list| {
                    let within = self.space();
                    project.usings.extend(list.into_iter().map(|path| Using {
                        within: within.clone(),
                        path,
                    }));
                }),
                Tok::Kw(Kw::EndNamespace) => {
                    let span = self.advance().span;
                    if self.spaces.pop().is_none() {
                        self.report(
                            Problem::error("E119", span, "END_NAMESPACE closes nothing")
                                .hint("remove it, or begin with NAMESPACE and a name"),
                        );
                    }
                    continue;
                }
                _ => Err(self.unexpected(
                    "PROGRAM, FUNCTION, FUNCTION_BLOCK, CLASS, INTERFACE, TYPE, VAR_GLOBAL, NAMESPACE or CONFIGURATION",
                )),
            };
            self.pou = None;
            self.put_in_space(declared, project);
            if result.is_err() {
                if self.position() == before {
                    self.advance();
                }
                while !matches!(self.peek(), Tok::Eof | Tok::Kw(Kw::EndNamespace))
                    && !matches!(self.peek(), Tok::Kw(kw) if starts_declaration(kw))
                {
                    self.advance();
                }
            }
        }
        for (path, span) in std::mem::take(&mut self.spaces) {
            let message = format!("NAMESPACE {path} is not closed");
            self.report(Problem::error("E118", span, message).expected("END_NAMESPACE"));
        }
    }

    /// The path of the namespace that is being read; empty outside of any.
    fn space(&self) -> String {
        self.spaces.last().map_or(String::new(), |s| s.0.clone())
    }

    /// What was declared since gets the path of its namespace before its name.
    fn put_in_space(&mut self, since: Declared, project: &mut Project) {
        let space = self.space();
        let pous = project.pous.iter_mut().skip(since.pous);
        for pou in pous {
            let name = &mut pou.name.name;
            if !space.is_empty() {
                *name = format!("{space}.{name}");
            }
            let own = pou.class.usings.iter().map(|path| Using {
                within: name.clone(),
                path: path.clone(),
            });
            let around = project.usings.len();
            project.usings.extend(own);
            // A text of its own, as the POU is written out, says all of them.
            let outer = project.usings[..around].iter();
            let outer = outer.filter(|u| is_within(&space, &u.within));
            pou.class.usings.extend(outer.map(|u| u.path.clone()));
        }
        if space.is_empty() {
            return;
        }
        let types = project.types.iter_mut().skip(since.types);
        let interfaces = project.interfaces.iter_mut().skip(since.interfaces);
        let globals = project.globals.iter_mut().skip(since.globals);
        let names = types
            .map(|t| &mut t.name)
            .chain(interfaces.map(|i| &mut i.name))
            .chain(globals.flat_map(|g| &mut g.decls).map(|d| &mut d.name));
        for name in names {
            name.name = format!("{space}.{}", name.name);
        }
    }

    /// `NAMESPACE a.b`
    fn namespace(&mut self, project: &mut Project) -> Parsed<()> {
        let opener = self.advance().span;
        let internal = self.at_word("INTERNAL") && self.peek_at(1) == Tok::Ident;
        if internal {
            self.advance();
        }
        let name = self.qualified("the name of the namespace")?;
        if self.spaces.len() >= PATH_PARTS_MAX {
            self.too_deep(name.span);
            return Err(Stop);
        }
        let mut path = self.space();
        let parts: Vec<&str> = name.name.split('.').collect();
        for (number, part) in parts.iter().enumerate() {
            path = join(&path, part);
            project.namespaces.push(Namespace {
                path: path.clone(),
                internal: internal && number + 1 == parts.len(),
            });
        }
        self.spaces.push((path, opener.to(name.span)));
        Ok(())
    }

    fn using(&mut self) -> Parsed<Vec<Ident>> {
        self.advance();
        let list = self.qualified_list("the name of a namespace")?;
        self.expect_semi("USING")?;
        Ok(list)
    }

    /// `a.b.Name`
    pub(super) fn qualified(&mut self, wanted: &str) -> Parsed<Ident> {
        let mut whole = self.ident(wanted)?;
        let mut parts = 1;
        while self.at(Tok::Dot) && self.peek_at(1) == Tok::Ident {
            self.advance();
            parts += 1;
            if parts > PATH_PARTS_MAX {
                self.too_deep(whole.span);
                return Err(Stop);
            }
            let part = self.ident(wanted)?;
            whole.name = join(&whole.name, &part.name);
            whole.span = whole.span.to(part.span);
        }
        Ok(whole)
    }

    fn qualified_list(&mut self, wanted: &str) -> Parsed<Vec<Ident>> {
        let mut list = vec![self.qualified(wanted)?];
        while self.eat(Tok::Comma) {
            list.push(self.qualified(wanted)?);
        }
        Ok(list)
    }

    /// Words such as PUBLIC and ABSTRACT before a name.
    fn modifiers(&mut self, class: &mut Class) {
        // A method may be called like a modifier: the last word before `:` or the end of the line is the name.
        while self.at(Tok::Ident) && matches!(self.peek_at(1), Tok::Ident) {
            let word = self.text_of(self.span()).to_ascii_uppercase();
            match word.as_str() {
                "PUBLIC" => class.access = Access::Public,
                "PRIVATE" => class.access = Access::Private,
                "PROTECTED" => class.access = Access::Protected,
                "INTERNAL" => class.access = Access::Internal,
                "ABSTRACT" => class.is_abstract = true,
                "FINAL" => class.is_final = true,
                "OVERRIDE" => class.is_override = true,
                _ => return,
            }
            self.advance();
        }
    }

    fn interface(&mut self, project: &mut Project) -> Parsed<()> {
        self.advance();
        let name = self.ident("the name of the interface")?;
        let mut interface = Interface {
            name,
            extends: Vec::new(),
            methods: Vec::new(),
        };
        if self.eat_word("EXTENDS") {
            interface.extends = self.qualified_list("the name of an interface")?;
        }
        while !self.eat_kw(Kw::EndInterface) {
            if self.at(Tok::Semi) {
                self.advance();
            } else if self.at_word("METHOD") {
                let mut method = self.method()?;
                method.class.is_abstract = true;
                interface.methods.push(method);
            } else {
                return Err(self.unexpected("METHOD or END_INTERFACE"));
            }
        }
        project.interfaces.push(interface);
        Ok(())
    }

    fn method(&mut self) -> Parsed<Pou> {
        let opener = self.advance().span;
        let mut class = Class::default();
        self.modifiers(&mut class);
        let name = self.ident("the name of the method")?;
        let mut pou = Pou {
            kind: PouKind::Method,
            name,
            result: None,
            vars: Vec::new(),
            body: Vec::new(),
            class,
            place: opener,
        };
        if self.eat(Tok::Colon) {
            pou.result = Some(self.type_spec()?);
        }
        self.variables(&mut pou)?;
        self.body(&mut pou);
        if !self.eat_kw(Kw::EndMethod) {
            self.unclosed(PouKind::Method, &pou.name, opener, Kw::EndMethod);
            return Err(Stop);
        }
        Ok(pou)
    }

    /// The blocks of variables of a POU.
    fn variables(&mut self, pou: &mut Pou) -> Parsed<()> {
        loop {
            match self.peek() {
                Tok::Kw(kw) if section(kw).is_some() => {
                    if let Ok(block) = self.var_block() {
                        pou.vars.push(block);
                    }
                }
                // Access paths are for communication, which FAM does on its own: read and checked for form.
                Tok::Kw(Kw::VarAccess) => {
                    self.var_access()?;
                }
                Tok::Kw(Kw::VarConfig) => {
                    let span = self.span();
                    self.report(
                        Problem::error("E122", span, "VAR_CONFIG stands in a CONFIGURATION only")
                            .hint("move it behind the resources of the configuration"),
                    );
                    return Err(Stop);
                }
                Tok::Semi => {
                    self.advance();
                }
                Tok::Ident if self.at_word("USING") => pou.class.usings.extend(self.using()?),
                _ => return Ok(()),
            }
        }
    }

    fn pou(&mut self, kind: PouKind, project: &mut Project) -> Parsed<()> {
        let opener = self.advance();
        let end = match kind {
            PouKind::Program => Kw::EndProgram,
            PouKind::Function => Kw::EndFunction,
            PouKind::FunctionBlock if opener.tok == Tok::Ident => Kw::EndClass,
            PouKind::FunctionBlock | PouKind::Method => Kw::EndFunctionBlock,
        };
        let opener = opener.span;
        let mut class = Class::default();
        self.modifiers(&mut class);
        // A path before the name stands where a POU is written out on its own.
        let name = self.qualified(&format!("the name of the {kind}"))?;
        self.pou = Some(name.name.clone());
        if self.eat_word("EXTENDS") {
            class.extends = Some(self.qualified("the name of a function block")?);
        }
        if self.eat_word("IMPLEMENTS") {
            class.implements = self.qualified_list("the name of an interface")?;
        }
        let result = if kind == PouKind::Function && self.eat(Tok::Colon) {
            Some(self.type_spec()?)
        } else {
            None
        };
        let mut pou = Pou {
            kind,
            name,
            result,
            vars: Vec::new(),
            body: Vec::new(),
            class,
            place: opener,
        };
        self.variables(&mut pou)?;
        self.methods(&mut pou)?;
        self.body(&mut pou);
        self.methods(&mut pou)?;
        let closed = self.eat_kw(end);
        if !closed {
            self.unclosed(kind, &pou.name, opener, end);
        }
        pou.place = opener.to(self.last_span());
        project.pous.push(pou);
        if closed { Ok(()) } else { Err(Stop) }
    }

    fn methods(&mut self, pou: &mut Pou) -> Parsed<()> {
        loop {
            if self.at(Tok::Semi) {
                self.advance();
            } else if self.at_word("METHOD") && self.peek_at(1) == Tok::Ident {
                if pou.kind == PouKind::Function {
                    return Err(self.unexpected("a statement, or END_FUNCTION"));
                }
                let outer = self.pou.clone();
                let method = self.method()?;
                self.pou = outer;
                pou.class.methods.push(method);
            } else {
                return Ok(());
            }
        }
    }

    fn body(&mut self, pou: &mut Pou) {
        if self.at_sfc() {
            self.sfc_body(pou);
        } else if self.at_il() {
            self.il_body(pou);
        } else {
            pou.body = self.statements();
        }
    }

    fn unclosed(&mut self, kind: PouKind, name: &Ident, opener: Span, end: Kw) {
        let found = self.peek().describe();
        let span = self.span();
        let problem = if matches!(self.peek(), Tok::Eof) {
            Problem::error(
                "E118",
                opener,
                format!("{kind} {} is not closed", name.name),
            )
        } else {
            Problem::error(
                "E119",
                span,
                format!("{found} closes nothing that is open here"),
            )
        };
        self.report(problem.expected(format!("{} of {}", end.text(), name.name)));
    }

    pub fn var_block(&mut self) -> Parsed<VarBlock> {
        let opener = self.advance();
        let Tok::Kw(kw) = opener.tok else {
            return Err(Stop);
        };
        let mut block = VarBlock {
            access: None,
            section: section(kw).unwrap_or(VarSection::Local),
            constant: false,
            retain: false,
            decls: Vec::new(),
        };
        loop {
            if self.eat_kw(Kw::Constant) {
                block.constant = true;
            } else if self.eat_kw(Kw::Retain) {
                block.retain = true;
            } else if self.eat_kw(Kw::NonRetain) || self.eat_word("PERSISTENT") {
                // What is not retained, and what other systems keep apart: nothing to note.
            } else if let Some(access) = self.eat_access() {
                block.access = Some(access);
            } else {
                break;
            }
        }
        loop {
            if self.eat_kw(Kw::EndVar) {
                return Ok(block);
            }
            match self.peek() {
                Tok::Semi => {
                    self.advance();
                    continue;
                }
                Tok::Ident if !self.at_statement() => {}
                Tok::Int if self.peek_at(1) == Tok::Ident => {
                    let whole = self.span().to(self.span_at(1));
                    let message = format!("`{}` is no name", self.text_of(whole));
                    self.report(
                        Problem::error("E105", whole, message)
                            .hint("a name cannot begin with a digit"),
                    );
                    self.recover(ends_variables);
                    continue;
                }
                Tok::Kw(kw)
                    if !ends_variables(kw) && (!starts_statement(kw) || self.names_variable()) => {}
                _ => {
                    let found = match self.peek() {
                        Tok::Ident => "a statement".to_owned(),
                        tok => tok.describe(),
                    };
                    let problem = Problem::error(
                        "E118",
                        opener.span,
                        format!(
                            "this {} is not closed: {found} stands where its END_VAR should",
                            kw.text()
                        ),
                    )
                    .expected("END_VAR, or another variable");
                    self.report(problem);
                    return Ok(block);
                }
            }
            if self.var_decl(&mut block.decls).is_err() {
                self.recover(ends_variables);
            }
        }
    }

    /// Whether what follows assigns or calls, and so is no variable.
    fn at_statement(&self) -> bool {
        matches!(
            self.peek_at(1),
            Tok::Assign | Tok::TryAssign | Tok::LParen | Tok::Dot | Tok::LBracket
        )
    }

    /// Whether the word is meant as a name, reserved as it may be.
    fn names_variable(&self) -> bool {
        matches!(
            self.peek_at(1),
            Tok::Colon | Tok::Comma | Tok::Kw(Kw::At) | Tok::Assign
        )
    }

    /// An access specifier behind VAR, unless it is the name of the first variable.
    fn eat_access(&mut self) -> Option<Access> {
        let is_name = matches!(self.peek_at(1), Tok::Colon | Tok::Comma | Tok::Kw(Kw::At));
        let words = [
            ("PUBLIC", Access::Public),
            ("PRIVATE", Access::Private),
            ("PROTECTED", Access::Protected),
            ("INTERNAL", Access::Internal),
        ];
        if is_name {
            return None;
        }
        let found = words.into_iter().find(|(word, _)| self.eat_word(word));
        found.map(|(_, access)| access)
    }

    /// `a, b AT %IW2 : INT := 5;`
    pub(super) fn var_decl(&mut self, decls: &mut Vec<VarDecl>) -> Parsed<()> {
        let mut names = Vec::new();
        loop {
            // `AT %IW6 : INT;`: the address is its own name.
            let named = if self.at(Tok::Kw(Kw::At)) {
                None
            } else {
                Some(self.ident("the name of a variable, or END_VAR")?)
            };
            let location = if self.eat_kw(Kw::At) {
                let span = self.expect(Tok::Direct, "a direct address such as %IX0.0")?;
                Some(Ident {
                    name: self.text_of(span).to_owned(),
                    span,
                })
            } else {
                None
            };
            if let Some(name) = named.or_else(|| location.clone()) {
                names.push((name, location));
            }
            if !self.eat(Tok::Comma) {
                break;
            }
        }
        self.expect(Tok::Colon, "`:` and the type of the variable")?;
        let spec = self.type_spec()?;
        let edge = if self.eat_word("R_EDGE") {
            Some(Edge::Rising)
        } else if self.eat_word("F_EDGE") {
            Some(Edge::Falling)
        } else {
            None
        };
        let init = if self.eat(Tok::Assign) {
            Some(self.init()?)
        } else {
            None
        };
        self.expect_semi("the declaration")?;
        for (name, location) in names {
            decls.push(VarDecl {
                name,
                location,
                spec: spec.clone(),
                init: init.clone(),
                edge,
            });
        }
        Ok(())
    }
}
