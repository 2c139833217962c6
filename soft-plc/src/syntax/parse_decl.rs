//! Declarations: types, variables, POUs, configurations (IEC 61131-3, clauses 6.4 to 6.8).

use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{
    Access, Class, Configuration, Configured, Connection, Edge, ExprKind, Ident, Init, Interface,
    Pou, PouKind, ProgramInstance, Project, Resource, Task, TypeDecl, TypeSpec, TypeSpecKind,
    VarBlock, VarDecl, VarSection,
};
use crate::syntax::lexer::{Kw, Tok};
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

fn starts_declaration(kw: Kw) -> bool {
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

fn ends_variables(kw: Kw) -> bool {
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

impl Parser<'_> {
    pub fn file(&mut self, project: &mut Project, library: bool) {
        loop {
            let before = self.position();
            let result = match self.peek() {
                Tok::Eof => return,
                Tok::Semi => {
                    self.advance();
                    continue;
                }
                Tok::Kw(Kw::Program) => self.pou(PouKind::Program, project, library),
                Tok::Kw(Kw::Function) => self.pou(PouKind::Function, project, library),
                Tok::Kw(Kw::FunctionBlock) => self.pou(PouKind::FunctionBlock, project, library),
                Tok::Kw(Kw::Type) => self.type_block(project),
                Tok::Kw(Kw::VarGlobal) => self.var_block().map(|block| project.globals.push(block)),
                Tok::Kw(Kw::Configuration) => self.configuration(project),
                Tok::Ident if self.at_word("CLASS") => {
                    self.pou(PouKind::FunctionBlock, project, library)
                }
                Tok::Ident if self.at_word("INTERFACE") => self.interface(project),
                Tok::Ident if self.at_word("NAMESPACE") => self.namespace(project),
                Tok::Ident if self.at_word("USING") => self.using(),
                Tok::Kw(Kw::EndNamespace) => {
                    self.advance();
                    continue;
                }
                _ => Err(self.unexpected(
                    "PROGRAM, FUNCTION, FUNCTION_BLOCK, CLASS, INTERFACE, TYPE, VAR_GLOBAL, NAMESPACE or CONFIGURATION",
                )),
            };
            self.pou = None;
            if result.is_err() {
                if self.position() == before {
                    self.advance();
                }
                while !matches!(self.peek(), Tok::Eof)
                    && !matches!(self.peek(), Tok::Kw(kw) if starts_declaration(kw))
                {
                    self.advance();
                }
            }
        }
    }

    /// `NAMESPACE a.b`: its contents are declared like all others; the name may stand before theirs.
    fn namespace(&mut self, project: &mut Project) -> Parsed<()> {
        self.advance();
        if self.at_word("INTERNAL") {
            self.advance();
        }
        loop {
            let name = self.ident("the name of the namespace")?;
            project.namespaces.push(name.name.to_ascii_uppercase());
            if !self.eat(Tok::Dot) {
                return Ok(());
            }
        }
    }

    fn using(&mut self) -> Parsed<()> {
        self.advance();
        loop {
            self.ident("the name of a namespace")?;
            if !self.eat(Tok::Dot) && !self.eat(Tok::Comma) {
                break;
            }
        }
        self.expect_semi("USING")
    }

    /// `a.b.Name`: the last part; namespaces do not keep names apart.
    fn qualified(&mut self, wanted: &str) -> Parsed<Ident> {
        let mut name = self.ident(wanted)?;
        while self.at(Tok::Dot) && self.peek_at(1) == Tok::Ident {
            self.advance();
            name = self.ident(wanted)?;
        }
        Ok(name)
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
                Tok::Ident if self.at_word("USING") => self.using()?,
                _ => return Ok(()),
            }
        }
    }

    fn pou(&mut self, kind: PouKind, project: &mut Project, library: bool) -> Parsed<()> {
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
        let name = self.ident(&format!("the name of the {kind}"))?;
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
        };
        self.variables(&mut pou)?;
        self.methods(&mut pou)?;
        self.body(&mut pou);
        self.methods(&mut pou)?;
        let closed = self.eat_kw(end);
        if !closed {
            self.unclosed(kind, &pou.name, opener, end);
        }
        if library {
            project.library.push(pou);
        } else {
            project.pous.push(pou);
        }
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
            } else if !self.eat_access() {
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
                Tok::Ident => {}
                Tok::Kw(kw) if !ends_variables(kw) => {}
                _ => {
                    let found = self.peek().describe();
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

    /// An access specifier behind VAR, unless it is the name of the first variable.
    fn eat_access(&mut self) -> bool {
        let is_name = matches!(self.peek_at(1), Tok::Colon | Tok::Comma | Tok::Kw(Kw::At));
        !is_name
            && ["PUBLIC", "PRIVATE", "PROTECTED", "INTERNAL"]
                .iter()
                .any(|word| self.eat_word(word))
    }

    /// `a, b AT %IW2 : INT := 5;`
    fn var_decl(&mut self, decls: &mut Vec<VarDecl>) -> Parsed<()> {
        let mut names = Vec::new();
        loop {
            let name = self.ident("the name of a variable, or END_VAR")?;
            let location = if self.eat_kw(Kw::At) {
                let span = self.expect(Tok::Direct, "a direct address such as %IX0.0")?;
                Some(Ident {
                    name: self.text_of(span).to_owned(),
                    span,
                })
            } else {
                None
            };
            names.push((name, location));
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

    /// An initial value: an expression, `[...]` for arrays, `(name := ...)` for structures and instances.
    pub fn init(&mut self) -> Parsed<Init> {
        self.deeper(Self::init_inner)
    }

    fn init_inner(&mut self) -> Parsed<Init> {
        let start = self.span();
        if self.eat(Tok::LBracket) {
            let mut items = Vec::new();
            while !self.at(Tok::RBracket) {
                let repeated = self.at(Tok::Int) && self.peek_at(1) == Tok::LParen;
                if repeated {
                    let count_span = self.span();
                    let count = self.expression_of_int(count_span)?;
                    self.advance();
                    if self.at(Tok::RParen) {
                        return Err(self.unexpected("the value that is repeated"));
                    }
                    let mut values = vec![self.init()?];
                    while self.eat(Tok::Comma) {
                        values.push(self.init()?);
                    }
                    let end = self.expect(Tok::RParen, "`)` after the repeated value")?;
                    let value = if values.len() == 1 {
                        values.remove(0)
                    } else {
                        // `2(1, 3)` repeats the sequence; written as a nested list without brackets of its own.
                        let items = values.into_iter().map(|v| (None, v)).collect();
                        Init::Array(items, count_span.to(end))
                    };
                    items.push((Some(count), value));
                } else {
                    items.push((None, self.init()?));
                }
                if !self.eat(Tok::Comma) {
                    break;
                }
            }
            let end = self.expect(Tok::RBracket, "`]` or `,` after the value")?;
            return Ok(Init::Array(items, start.to(end)));
        }
        if self.at(Tok::LParen) && self.peek_at(1) == Tok::Ident && self.peek_at(2) == Tok::Assign {
            self.advance();
            let mut items = Vec::new();
            loop {
                let name = self.ident("the name of a field")?;
                self.expect(Tok::Assign, "`:=` and the value of the field")?;
                items.push((name, self.init()?));
                if !self.eat(Tok::Comma) {
                    break;
                }
            }
            let end = self.expect(Tok::RParen, "`)` or `,` after the value")?;
            return Ok(Init::Struct(items, start.to(end)));
        }
        Ok(Init::Expr(self.expression()?))
    }

    fn expression_of_int(&mut self, span: Span) -> Parsed<crate::syntax::ast::Expr> {
        let value = self.take(crate::syntax::literal::integer(self.text_of(span), span))?;
        self.advance();
        Ok(crate::syntax::ast::Expr {
            kind: ExprKind::Int(value),
            span,
        })
    }

    pub fn type_spec(&mut self) -> Parsed<TypeSpec> {
        self.deeper(Self::type_spec_inner)
    }

    fn type_spec_inner(&mut self) -> Parsed<TypeSpec> {
        let start = self.span();
        let kind = match self.peek() {
            Tok::Kw(Kw::Array) => {
                self.advance();
                self.expect(Tok::LBracket, "`[` and the bounds of the array")?;
                let mut dims = Vec::new();
                loop {
                    let lo = self.expression()?;
                    self.expect(Tok::DotDot, "`..` between the bounds")?;
                    dims.push((lo, self.expression()?));
                    if !self.eat(Tok::Comma) {
                        break;
                    }
                }
                self.expect(Tok::RBracket, "`]` or `,` after the bounds")?;
                self.expect(Tok::Kw(Kw::Of), "OF and the type of the elements")?;
                let elem = Box::new(self.type_spec()?);
                TypeSpecKind::Array { dims, elem }
            }
            Tok::Kw(Kw::Struct) => {
                self.advance();
                let mut fields = Vec::new();
                while !self.eat_kw(Kw::EndStruct) {
                    if self.var_decl(&mut fields).is_err() {
                        self.recover(ends_variables);
                        if !self.at_kw(Kw::EndStruct) && !self.at(Tok::Ident) {
                            return Err(Stop);
                        }
                    }
                }
                TypeSpecKind::Struct { fields }
            }
            Tok::LParen => self.enumeration(None)?,
            Tok::Ident => {
                let name = self.ident("a type")?;
                let upper = name.name.to_ascii_uppercase();
                match upper.as_str() {
                    "STRING" | "WSTRING" => {
                        let closer = match self.peek() {
                            Tok::LBracket => Some(Tok::RBracket),
                            // CODESYS writes STRING(80).
                            Tok::LParen => Some(Tok::RParen),
                            _ => None,
                        };
                        let len = if let Some(closer) = closer {
                            self.advance();
                            let len = self.expression()?;
                            self.expect(closer, "the end of the length")?;
                            Some(Box::new(len))
                        } else {
                            None
                        };
                        TypeSpecKind::Str {
                            wide: upper == "WSTRING",
                            len,
                        }
                    }
                    "REF_TO" => TypeSpecKind::Ref(Box::new(self.type_spec()?)),
                    "POINTER" => {
                        self.expect(Tok::Kw(Kw::To), "TO and the type that is pointed to")?;
                        TypeSpecKind::Ref(Box::new(self.type_spec()?))
                    }
                    "REFERENCE" => {
                        let problem = Problem::error(
                            "E109",
                            name.span,
                            "REFERENCE TO (a reference that dereferences itself) is not supported",
                        )
                        .hint("use REF_TO and `^`, or pass the variable as VAR_IN_OUT");
                        self.report(problem);
                        return Err(Stop);
                    }
                    _ if self.at(Tok::Dot) && self.peek_at(1) == Tok::Ident => {
                        self.advance();
                        TypeSpecKind::Named(self.qualified("a type")?)
                    }
                    _ if self.at(Tok::LParen) => self.subrange_or_enum(name)?,
                    _ => TypeSpecKind::Named(name),
                }
            }
            _ => return Err(self.unexpected("a type")),
        };
        let span = start.to(self.last_span());
        Ok(TypeSpec { kind, span })
    }

    /// `INT (0..100)` or `INT (Off := 0, On := 1)`
    fn subrange_or_enum(&mut self, base: Ident) -> Parsed<TypeSpecKind> {
        if self.peek_at(1) == Tok::Ident
            && matches!(self.peek_at(2), Tok::Comma | Tok::Assign | Tok::RParen)
        {
            return self.enumeration(Some(base));
        }
        self.advance();
        let lo = Box::new(self.expression()?);
        self.expect(Tok::DotDot, "`..` between the limits of the subrange")?;
        let hi = Box::new(self.expression()?);
        self.expect(Tok::RParen, "`)` after the limits")?;
        Ok(TypeSpecKind::Subrange { base, lo, hi })
    }

    fn enumeration(&mut self, base: Option<Ident>) -> Parsed<TypeSpecKind> {
        self.advance();
        let mut values = Vec::new();
        loop {
            let name = self.ident("the name of a value")?;
            let value = if self.eat(Tok::Assign) {
                Some(self.expression()?)
            } else {
                None
            };
            values.push((name, value));
            if !self.eat(Tok::Comma) {
                break;
            }
        }
        self.expect(Tok::RParen, "`)` or `,` after the value")?;
        // CODESYS writes the base type behind the list.
        let base = match base {
            None if self.at(Tok::Ident) => Some(self.ident("a type")?),
            base => base,
        };
        Ok(TypeSpecKind::Enum { base, values })
    }

    fn type_block(&mut self, project: &mut Project) -> Parsed<()> {
        let opener = self.advance().span;
        loop {
            if self.eat_kw(Kw::EndType) {
                return Ok(());
            }
            match self.peek() {
                Tok::Semi => {
                    self.advance();
                    continue;
                }
                Tok::Eof => {
                    self.report(
                        Problem::error("E118", opener, "this TYPE is not closed")
                            .expected("END_TYPE, or another type"),
                    );
                    return Err(Stop);
                }
                Tok::Kw(kw) if starts_declaration(kw) => {
                    self.report(
                        Problem::error("E118", opener, "this TYPE is not closed")
                            .expected("END_TYPE, or another type"),
                    );
                    return Ok(());
                }
                _ => {}
            }
            if self.type_decl(project).is_err() {
                self.recover(|kw| kw == Kw::EndType || starts_declaration(kw));
            }
        }
    }

    fn type_decl(&mut self, project: &mut Project) -> Parsed<()> {
        let name = self.ident("the name of a type, or END_TYPE")?;
        self.expect(Tok::Colon, "`:` and the definition of the type")?;
        let spec = self.type_spec()?;
        let init = if self.eat(Tok::Assign) {
            Some(self.init()?)
        } else {
            None
        };
        if matches!(spec.kind, TypeSpecKind::Struct { .. }) {
            self.eat(Tok::Semi);
        } else {
            self.expect_semi("the definition of the type")?;
        }
        project.types.push(TypeDecl { name, spec, init });
        Ok(())
    }

    fn configuration(&mut self, project: &mut Project) -> Parsed<()> {
        self.advance();
        let name = self.ident("the name of the configuration")?;
        let mut configuration = Configuration {
            name: name.name,
            ..Configuration::default()
        };
        let mut single = Resource::default();
        while !self.eat_kw(Kw::EndConfiguration) {
            if self.eat_kw(Kw::Resource) {
                let mut resource = Resource {
                    name: self.ident("the name of the resource")?.name,
                    ..Resource::default()
                };
                if self.eat_word("ON") {
                    self.qualified("the type of the resource")?;
                }
                while !self.eat_kw(Kw::EndResource) {
                    self.resource_item(&mut resource, project)?;
                }
                configuration.resources.push(resource);
            } else if self.at_kw(Kw::VarConfig) {
                self.var_config(&mut configuration.configured)?;
            } else if self.at_kw(Kw::VarAccess) {
                let names = self.var_access()?;
                configuration.accesses.extend(names);
            } else {
                self.resource_item(&mut single, project)?;
            }
        }
        if !single.tasks.is_empty() || !single.instances.is_empty() {
            configuration.resources.push(single);
        }
        project.configurations.push(configuration);
        Ok(())
    }

    fn resource_item(&mut self, resource: &mut Resource, project: &mut Project) -> Parsed<()> {
        match self.peek() {
            Tok::Kw(Kw::VarGlobal) => {
                let block = self.var_block()?;
                project.globals.push(block);
            }
            Tok::Kw(Kw::Program) => {
                self.advance();
                if !self.eat_kw(Kw::Retain) {
                    self.eat_kw(Kw::NonRetain);
                }
                let name = self.ident("the name of the program instance")?.name;
                let task = if self.eat_word("WITH") {
                    Some(self.ident("the name of a task")?.name)
                } else {
                    None
                };
                self.expect(Tok::Colon, "`:` and the program")?;
                let program = self.qualified("the name of a program")?.name;
                let mut connections = Vec::new();
                if self.at(Tok::LParen) {
                    for arg in self.arguments()? {
                        let (Some(parameter), Some(value)) = (arg.name, arg.value) else {
                            return Err(self.unexpected("named connections: in := x, out => y"));
                        };
                        connections.push(Connection {
                            parameter: parameter.name,
                            output: arg.output,
                            value: self.text_of(value.span).to_owned(),
                        });
                    }
                }
                self.expect_semi("the program instance")?;
                resource.instances.push(ProgramInstance {
                    name,
                    program,
                    task,
                    connections,
                });
            }
            Tok::Semi => {
                self.advance();
            }
            _ if self.at_word("TASK") => {
                self.advance();
                let task = self.task()?;
                resource.tasks.push(task);
            }
            _ => {
                return Err(
                    self.unexpected("TASK, PROGRAM, VAR_GLOBAL, or the end of the resource")
                );
            }
        }
        Ok(())
    }

    /// VAR_CONFIG: where variables that were declared `AT %I*` stand, and their initial values.
    fn var_config(&mut self, list: &mut Vec<Configured>) -> Parsed<()> {
        self.advance();
        while !self.eat_kw(Kw::EndVar) {
            let mut path = vec![self.ident("the path of a variable, or END_VAR")?];
            while self.eat(Tok::Dot) {
                path.push(self.ident("the next part of the path")?);
            }
            let location = if self.eat_kw(Kw::At) {
                let span = self.expect(Tok::Direct, "a direct address such as %IX0.0")?;
                Some(Ident {
                    name: self.text_of(span).to_owned(),
                    span,
                })
            } else {
                None
            };
            self.expect(Tok::Colon, "`:` and the type of the variable")?;
            self.type_spec()?;
            let init = if self.eat(Tok::Assign) {
                Some(self.init()?)
            } else {
                None
            };
            self.expect_semi("the configured variable")?;
            list.push(Configured {
                path,
                location,
                init,
            });
        }
        Ok(())
    }

    /// VAR_ACCESS: names under which others may reach variables.
    fn var_access(&mut self) -> Parsed<Vec<Ident>> {
        self.advance();
        let mut names = Vec::new();
        while !self.eat_kw(Kw::EndVar) {
            names.push(self.ident("the name of an access path, or END_VAR")?);
            self.expect(Tok::Colon, "`:` and the path of the variable")?;
            self.postfix()?;
            self.expect(Tok::Colon, "`:` and the type of the variable")?;
            self.type_spec()?;
            if !self.eat_word("READ_WRITE") {
                self.eat_word("READ_ONLY");
            }
            self.expect_semi("the access path")?;
        }
        Ok(names)
    }

    fn task(&mut self) -> Parsed<Task> {
        let mut task = Task {
            name: self.ident("the name of the task")?.name,
            ..Task::default()
        };
        self.expect(Tok::LParen, "`(` and the settings of the task")?;
        loop {
            let setting = self.ident("INTERVAL, PRIORITY or SINGLE")?;
            self.expect(Tok::Assign, "`:=`")?;
            let value = self.expression()?;
            match (setting.name.to_ascii_uppercase().as_str(), &value.kind) {
                ("INTERVAL", ExprKind::Time(ns)) => task.interval_ns = Some(*ns),
                ("PRIORITY", ExprKind::Int(v)) if (0..=65_535).contains(v) => {
                    task.priority = *v as i32;
                }
                ("SINGLE", ExprKind::Name(_) | ExprKind::Field(..) | ExprKind::Direct(_)) => {
                    task.single = Some(self.text_of(value.span).to_owned());
                }
                _ => {
                    self.report(
                        Problem::error(
                            "E120",
                            setting.span.to(value.span),
                            "this is no setting of a task",
                        )
                        .expected(
                            "INTERVAL := a duration, PRIORITY := 0..65535, or SINGLE := a variable",
                        ),
                    );
                    return Err(Stop);
                }
            }
            if !self.eat(Tok::Comma) {
                break;
            }
        }
        self.expect(Tok::RParen, "`)` after the settings of the task")?;
        self.expect_semi("the task")?;
        Ok(task)
    }
}
