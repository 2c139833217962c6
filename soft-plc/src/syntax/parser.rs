//! The parser's engine room: token access, expectations, recovery, limits. Declarations, statements and expressions are
//! parsed in their own files.
//!
//! A parse never stops at the first mistake: a broken statement or declaration is reported and passed over.

use crate::diag::{Fallible, Problem};
use crate::source::Span;
use crate::syntax::ast::{Expr, Ident, Init, Project, Stmt};
use crate::syntax::lexer::{Kw, Tok, Token, lex};

/// How deep expressions and statements may be nested; a limit, so that no text can exhaust the stack.
pub const DEPTH_MAX: u32 = 200;
/// How many problems one text may report before the rest is left out.
pub const PROBLEMS_MAX: usize = 200;

/// The problem has been reported already; the caller recovers.
#[derive(Debug)]
pub struct Stop;

pub type Parsed<T> = Result<T, Stop>;

pub struct Parser<'a> {
    tokens: Vec<Token>,
    pos: usize,
    text: &'a str,
    base: usize,
    pub problems: Vec<Problem>,
    depth: u32,
    /// The POU being read, for messages.
    pub pou: Option<String>,
    /// The namespaces around, from the outermost, each with its whole path and where it was opened.
    pub(super) spaces: Vec<(String, Span)>,
}

/// Parses a whole `.st` text into `project`.
pub fn parse_text(source: u32, text: &str, project: &mut Project) -> Vec<Problem> {
    let mut parser = Parser::new(source, text, 0);
    parser.file(project);
    parser.problems
}

/// Parses declarations, POUs among them, that stand at byte `base` of their source, into `project`.
pub fn parse_declarations(
    source: u32,
    text: &str,
    base: usize,
    project: &mut Project,
) -> Vec<Problem> {
    let mut parser = Parser::new(source, text, base);
    parser.file(project);
    parser.problems
}

/// Parses the statements of a POU body that stands at byte `base` of its source.
pub fn parse_body(source: u32, text: &str, base: usize, pou: &str) -> (Vec<Stmt>, Vec<Problem>) {
    let mut parser = Parser::new(source, text, base);
    parser.pou = Some(pou.to_owned());
    let body = parser.statements();
    if !parser.at(Tok::Eof) {
        parser.unexpected("a statement");
    }
    (body, parser.problems)
}

/// Reads `text` with `f`, which must come to its end.
pub fn parse_in<T>(
    source: u32,
    text: &str,
    base: usize,
    pou: &str,
    f: impl FnOnce(&mut Parser<'_>) -> T,
) -> (T, Vec<Problem>) {
    let mut parser = Parser::new(source, text, base);
    parser.pou = Some(pou.to_owned());
    let result = f(&mut parser);
    if !parser.at(Tok::Eof) {
        parser.unexpected("the end of the text");
    }
    (result, parser.problems)
}

/// Parses one expression that makes up the whole text.
pub fn parse_whole_expression(source: u32, text: &str, base: usize) -> Result<Expr, Vec<Problem>> {
    let mut parser = Parser::new(source, text, base);
    let result = parser.expression();
    if result.is_ok() && !parser.at(Tok::Eof) {
        parser.unexpected("an operator or the end of the expression");
    }
    match result {
        Ok(expr) if parser.problems.is_empty() => Ok(expr),
        _ => Err(parser.problems),
    }
}

/// Parses one initial value that makes up the whole text.
pub fn parse_whole_init(source: u32, text: &str, base: usize) -> Result<Init, Vec<Problem>> {
    let mut parser = Parser::new(source, text, base);
    let result = parser.init();
    if result.is_ok() && !parser.at(Tok::Eof) {
        parser.unexpected("the end of the initial value");
    }
    match result {
        Ok(init) if parser.problems.is_empty() => Ok(init),
        _ => Err(parser.problems),
    }
}

impl<'a> Parser<'a> {
    pub fn new(source: u32, text: &'a str, base: usize) -> Self {
        let mut problems = Vec::new();
        let tokens = lex(source, text, base, &mut problems);
        Self {
            tokens,
            pos: 0,
            text,
            base,
            problems,
            depth: 0,
            pou: None,
            spaces: Vec::new(),
        }
    }

    pub fn peek(&self) -> Tok {
        self.tokens[self.pos].tok
    }

    pub fn peek_at(&self, ahead: usize) -> Tok {
        self.tokens
            .get(self.pos + ahead)
            .map_or(Tok::Eof, |t| t.tok)
    }

    pub fn span(&self) -> Span {
        self.tokens[self.pos].span
    }

    pub fn span_at(&self, ahead: usize) -> Span {
        self.tokens
            .get(self.pos + ahead)
            .map_or(self.span(), |t| t.span)
    }

    /// The span of the token before the current one.
    pub fn last_span(&self) -> Span {
        self.tokens[self.pos.saturating_sub(1)].span
    }

    pub fn position(&self) -> usize {
        self.pos
    }

    pub fn text_of(&self, span: Span) -> &'a str {
        &self.text[span.start as usize - self.base..span.end as usize - self.base]
    }

    pub fn at(&self, tok: Tok) -> bool {
        self.peek() == tok
    }

    pub(super) fn token_before(&self, back: usize) -> Option<Tok> {
        let at = self.pos.checked_sub(back)?;
        self.tokens.get(at).map(|t| t.tok)
    }

    /// Whether a line ends between the last token and this one.
    pub(super) fn on_new_line(&self) -> bool {
        let (from, to) = (self.last_span().end, self.span().start);
        let text = self.text.get(
            (from as usize).saturating_sub(self.base)..(to as usize).saturating_sub(self.base),
        );
        self.pos > 0 && text.is_some_and(|t| t.contains('\n'))
    }

    /// Reads the current token as another one.
    pub(super) fn replace(&mut self, tok: Tok) {
        self.tokens[self.pos].tok = tok;
    }

    pub fn at_kw(&self, kw: Kw) -> bool {
        self.peek() == Tok::Kw(kw)
    }

    /// Whether the current token is a name with this spelling: words such as TASK that are reserved only in places.
    pub fn at_word(&self, word: &str) -> bool {
        self.at(Tok::Ident) && self.text_of(self.span()).eq_ignore_ascii_case(word)
    }

    pub fn advance(&mut self) -> Token {
        let token = self.tokens[self.pos];
        if token.tok != Tok::Eof {
            self.pos += 1;
        }
        token
    }

    pub fn eat(&mut self, tok: Tok) -> bool {
        let found = self.at(tok);
        if found {
            self.advance();
        }
        found
    }

    pub fn eat_kw(&mut self, kw: Kw) -> bool {
        self.eat(Tok::Kw(kw))
    }

    pub fn eat_word(&mut self, word: &str) -> bool {
        let found = self.at_word(word);
        if found {
            self.advance();
        }
        found
    }

    pub fn report(&mut self, mut problem: Problem) {
        if problem.pou.is_none() {
            problem.pou.clone_from(&self.pou);
        }
        if self.at(Tok::Eof) && self.problems.iter().any(|p| p.code == "E101") {
            // A comment that is never closed has taken the rest of the text with it.
            return;
        }
        if self.problems.len() < PROBLEMS_MAX {
            self.problems.push(problem);
        }
    }

    /// Reports the current token as unexpected.
    pub fn unexpected(&mut self, wanted: &str) -> Stop {
        if self.follows_unknown() {
            return Stop;
        }
        let span = self.span();
        let found = match self.peek() {
            Tok::Ident => format!("`{}`", self.text_of(span)),
            tok => tok.describe(),
        };
        let problem =
            Problem::error("E110", span, format!("{found} cannot stand here")).expected(wanted);
        self.report(match self.slip() {
            Some(hint) => problem.hint(hint),
            None => problem,
        });
        Stop
    }

    pub fn expect(&mut self, tok: Tok, wanted: &str) -> Parsed<Span> {
        if self.at(tok) {
            Ok(self.advance().span)
        } else {
            Err(self.unexpected(wanted))
        }
    }

    /// The semicolon that closes what stands before: reported at the end of that, not at what follows.
    pub fn expect_semi(&mut self, after: &str) -> Parsed<()> {
        if self.eat(Tok::Semi) {
            return Ok(());
        }
        if self.follows_unknown() {
            return Err(Stop);
        }
        if self.at(Tok::RParen) {
            let span = self.span();
            self.report(
                Problem::error("E110", span, "`)` closes nothing that is open here")
                    .hint("remove it, or write the `(` that it belongs to"),
            );
            return Err(Stop);
        }
        let last = self.last_span();
        let follows_number =
            [Tok::Int, Tok::Based, Tok::Real].map(|number| self.touches(1, number));
        if follows_number.contains(&true) && self.at(Tok::Ident) {
            let span = last.to(self.span());
            let message = format!("`{}` is neither a number nor a name", self.text_of(span));
            let hint = if self.token_before(1) == Some(Tok::Based) {
                "digits are 0 and 1 to the base 2, 0 to 7 to the base 8, 0 to 9 and A to F to the base 16"
            } else {
                "a name cannot begin with a digit"
            };
            self.report(Problem::error("E105", span, message).hint(hint));
            return Err(Stop);
        }
        let span = Span {
            start: last.end,
            end: last.end + 1,
            ..last
        };
        let problem = Problem::error("E111", span, format!("the `;` after {after} is missing"));
        self.report(if self.at(Tok::Eq) {
            problem.hint("`:=` gives a value; `=` compares")
        } else {
            problem.expected("`;`")
        });
        Err(Stop)
    }

    pub fn ident(&mut self, wanted: &str) -> Parsed<Ident> {
        if self.at(Tok::Ident) {
            let span = self.advance().span;
            return Ok(Ident {
                name: self.text_of(span).to_owned(),
                span,
            });
        }
        if let Tok::Kw(kw) = self.peek() {
            let span = self.span();
            let message = format!("`{}` is a reserved word and no name", kw.text());
            self.report(Problem::error("E112", span, message).expected(wanted));
            return Err(Stop);
        }
        Err(self.unexpected(wanted))
    }

    /// Takes the value or reports the problem.
    pub fn take<T>(&mut self, result: Fallible<T>) -> Parsed<T> {
        result.map_err(|problem| {
            self.report(*problem);
            Stop
        })
    }

    /// Runs `f` one level deeper, within the limit.
    pub fn deeper<T>(&mut self, f: impl FnOnce(&mut Self) -> Parsed<T>) -> Parsed<T> {
        if self.depth >= DEPTH_MAX {
            let span = self.span();
            self.too_deep(span);
            return Err(Stop);
        }
        self.depth += 1;
        let result = f(self);
        self.depth -= 1;
        result
    }

    pub fn too_deep(&mut self, span: Span) {
        let problem = Problem::error(
            "E113",
            span,
            format!("this is nested deeper than {DEPTH_MAX} levels"),
        )
        .hint("split it into several statements or a function");
        self.report(problem);
    }

    /// Skips to the token after the next `;`, or to a keyword that `stop` accepts.
    pub fn recover(&mut self, stop: impl Fn(Kw) -> bool) {
        loop {
            match self.peek() {
                Tok::Eof => return,
                Tok::Semi => {
                    self.advance();
                    return;
                }
                Tok::Kw(kw) if stop(kw) => return,
                _ => {
                    self.advance();
                }
            }
        }
    }
}
