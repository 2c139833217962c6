//! Types and initial values (IEC 61131-3, clause 6.4).

use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{ExprKind, Ident, Init, Project, TypeDecl, TypeSpec, TypeSpecKind};
use crate::syntax::lexer::{Kw, Tok};
use crate::syntax::parse_decl::{ends_variables, starts_declaration};
use crate::syntax::parser::{Parsed, Parser, Stop};

impl Parser<'_> {
    pub fn type_spec(&mut self) -> Parsed<TypeSpec> {
        self.deeper(Self::type_spec_inner)
    }

    /// `ARRAY[*, *] OF INT`, from the first star on.
    fn open_array(&mut self, start: Span) -> Parsed<TypeSpec> {
        let mut dims = 1;
        self.expect(Tok::Star, "`*`")?;
        while self.eat(Tok::Comma) {
            self.expect(Tok::Star, "`*` for each dimension")?;
            dims += 1;
        }
        self.expect(Tok::RBracket, "`]` or `,` after `*`")?;
        self.expect(Tok::Kw(Kw::Of), "OF and the type of the elements")?;
        let elem = Box::new(self.type_spec()?);
        let span = start.to(elem.span);
        let kind = TypeSpecKind::OpenArray { dims, elem };
        Ok(TypeSpec { kind, span })
    }

    fn type_spec_inner(&mut self) -> Parsed<TypeSpec> {
        let start = self.span();
        let kind = match self.peek() {
            Tok::Kw(Kw::Array) => {
                self.advance();
                self.expect(Tok::LBracket, "`[` and the bounds of the array")?;
                if self.at(Tok::Star) {
                    return self.open_array(start);
                }
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
                // A field may have the name too.
                let is_field = matches!(self.peek_at(1), Tok::Colon | Tok::Comma | Tok::Kw(Kw::At));
                let overlap = !is_field && self.eat_word("OVERLAP");
                let mut fields = Vec::new();
                while !self.eat_kw(Kw::EndStruct) {
                    if self.var_decl(&mut fields).is_err() {
                        self.recover(ends_variables);
                        if !self.at_kw(Kw::EndStruct) && !self.at(Tok::Ident) {
                            return Err(Stop);
                        }
                    }
                }
                TypeSpecKind::Struct { overlap, fields }
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
                        TypeSpecKind::Pointer(Box::new(self.type_spec()?))
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
                        let mut whole = self.qualified("a type")?;
                        whole.name = format!("{}.{}", name.name, whole.name);
                        whole.span = name.span.to(whole.span);
                        TypeSpecKind::Named(whole)
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

    pub(super) fn type_block(&mut self, project: &mut Project) -> Parsed<()> {
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
}
