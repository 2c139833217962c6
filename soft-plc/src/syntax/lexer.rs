//! Splits Structured Text into tokens (IEC 61131-3, clause 6.1 to 6.3). Comments and pragmas are passed over.

use logos::{Lexer, Logos};
use std::ops::Range;

use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::parser::PROBLEMS_MAX;

/// What a token is; its text is found through its span.
#[derive(Logos, Clone, Copy, Debug, PartialEq, Eq)]
#[logos(skip r"[ \t\r\n\f\u{feff}]+")]
pub enum Tok {
    #[regex(r"[A-Za-z_][A-Za-z0-9_]*")]
    Ident,
    Kw(Kw),
    /// `INT#`, `Color#`: the prefix of a typed literal.
    #[regex(r"[A-Za-z_][A-Za-z0-9_]*#")]
    TypePrefix,
    #[regex(r"[0-9][0-9_]*")]
    Int,
    #[regex(r"[0-9][0-9_]*#[0-9A-Fa-f][0-9A-Fa-f_]*")]
    Based,
    #[regex(r"[0-9][0-9_]*\.[0-9][0-9_]*([eE][+-]?[0-9][0-9_]*)?")]
    #[regex(r"[0-9][0-9_]*[eE][+-]?[0-9][0-9_]*")]
    Real,
    #[regex(r"(?i)(T|TIME|LT|LTIME)#[+-]?[0-9][0-9a-z_.]*", priority = 20)]
    Time,
    #[regex(r"(?i)(D|DATE|LD|LDATE)#[0-9]+-[0-9]+-[0-9]+", priority = 25)]
    Date,
    #[regex(
        r"(?i)(TOD|TIME_OF_DAY|LTOD|LTIME_OF_DAY)#[0-9]+:[0-9]+(:[0-9]+(\.[0-9_]+)?)?",
        priority = 25
    )]
    TimeOfDay,
    #[regex(
        r"(?i)(DT|DATE_AND_TIME|LDT|LDATE_AND_TIME)#[0-9]+-[0-9]+-[0-9]+-[0-9]+:[0-9]+(:[0-9]+(\.[0-9_]+)?)?",
        priority = 25
    )]
    DateTime,
    #[regex(r"'([^'$\n]|\$[^\n])*'")]
    Str,
    #[regex("\"([^\"$\n]|\\$[^\n])*\"")]
    WStr,
    #[regex(r"%[A-Za-z][A-Za-z]?([0-9]+(\.[0-9]+)*|\*)")]
    Direct,
    #[token(":=")]
    Assign,
    #[token("=>")]
    Arrow,
    #[token(":")]
    Colon,
    #[token(";")]
    Semi,
    #[token(",")]
    Comma,
    #[token("(")]
    LParen,
    #[token(")")]
    RParen,
    #[token("[")]
    LBracket,
    #[token("]")]
    RBracket,
    #[token("..")]
    DotDot,
    #[token(".")]
    Dot,
    #[token("+")]
    Plus,
    #[token("-")]
    Minus,
    #[token("**")]
    Power,
    #[token("*")]
    Star,
    #[token("/")]
    Slash,
    #[token("&")]
    Amp,
    #[token("<=")]
    Le,
    #[token(">=")]
    Ge,
    #[token("<>")]
    Ne,
    #[token("<")]
    Lt,
    #[token(">")]
    Gt,
    #[token("=")]
    Eq,
    /// `?=`: assigns a reference if it fits.
    #[token("?=")]
    TryAssign,
    #[token("^")]
    Caret,
    #[token("(*", comment_paren)]
    #[token("/*", comment_slash)]
    #[token("//", comment_line)]
    #[token("{", pragma)]
    Comment(bool),
    /// A string that is not closed on its line: told already.
    Broken,
    Eof,
}

macro_rules! keywords {
    ($($variant:ident $text:literal),* $(,)?) => {
        /// Reserved words of Structured Text.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Kw { $($variant),* }

        impl Kw {
            pub fn text(self) -> &'static str {
                match self { $(Kw::$variant => $text),* }
            }

            fn find(text: &str) -> Option<Kw> {
                $(if text.eq_ignore_ascii_case($text) { return Some(Kw::$variant); })*
                // The short-circuit operators of CODESYS: AND and OR of BOOL are evaluated so anyway.
                if text.eq_ignore_ascii_case("AND_THEN") { return Some(Kw::And); }
                if text.eq_ignore_ascii_case("OR_ELSE") { return Some(Kw::Or); }
                None
            }
        }
    };
}

keywords! {
    Program "PROGRAM", EndProgram "END_PROGRAM", Function "FUNCTION", EndFunction "END_FUNCTION",
    FunctionBlock "FUNCTION_BLOCK", EndFunctionBlock "END_FUNCTION_BLOCK", Type "TYPE", EndType "END_TYPE",
    Struct "STRUCT", EndStruct "END_STRUCT", Array "ARRAY", Of "OF",
    Var "VAR", VarInput "VAR_INPUT", VarOutput "VAR_OUTPUT", VarInOut "VAR_IN_OUT", VarGlobal "VAR_GLOBAL",
    VarExternal "VAR_EXTERNAL", VarTemp "VAR_TEMP", VarConfig "VAR_CONFIG", VarAccess "VAR_ACCESS", EndVar "END_VAR",
    Constant "CONSTANT", Retain "RETAIN", NonRetain "NON_RETAIN", At "AT",
    If "IF", Then "THEN", Elsif "ELSIF", Else "ELSE", EndIf "END_IF", Case "CASE", EndCase "END_CASE",
    For "FOR", To "TO", By "BY", Do "DO", EndFor "END_FOR", While "WHILE", EndWhile "END_WHILE",
    Repeat "REPEAT", Until "UNTIL", EndRepeat "END_REPEAT", Exit "EXIT", Continue "CONTINUE", Return "RETURN",
    And "AND", Or "OR", Xor "XOR", Not "NOT", Mod "MOD", True "TRUE", False "FALSE",
    Configuration "CONFIGURATION", EndConfiguration "END_CONFIGURATION", Resource "RESOURCE", EndResource "END_RESOURCE",
    EndStep "END_STEP", EndTransition "END_TRANSITION", EndAction "END_ACTION",
    EndMethod "END_METHOD", EndInterface "END_INTERFACE", EndNamespace "END_NAMESPACE", EndClass "END_CLASS",
}

#[derive(Clone, Copy, Debug)]
pub struct Token {
    pub tok: Tok,
    pub span: Span,
}

/// The tokens of `text`, which stands at byte `base` of source `source`, closed by `Tok::Eof`.
pub fn lex(source: u32, text: &str, base: usize, problems: &mut Vec<Problem>) -> Vec<Token> {
    let mut tokens = Vec::with_capacity(text.len() / 4);
    let mut lexer = Tok::lexer(text);
    while let Some(result) = lexer.next() {
        let range = lexer.span();
        let span = Span::new(source, base + range.start, base + range.end);
        match result {
            Ok(Tok::Comment(true)) if lexer.slice().starts_with("{{") => {
                let opener = Span::new(source, base + range.start, base + range.start + 2);
                problems.push(
                    Problem::error("E104", opener, "code of another language cannot be run")
                        .hint("write what stands between `{{` and `}}` in Structured Text"),
                );
            }
            Ok(Tok::Comment(true)) => {}
            Ok(Tok::Comment(false)) => {
                let opener = Span::new(source, base + range.start, base + range.start + 1);
                problems.push(
                    Problem::error("E101", opener, "this comment or pragma is never closed")
                        .hint("close it with `*)`, `*/` or `}`, like it was opened"),
                );
            }
            Ok(Tok::Ident) => {
                let tok = Kw::find(lexer.slice()).map_or(Tok::Ident, Tok::Kw);
                tokens.push(Token { tok, span });
            }
            Ok(tok) => tokens.push(Token { tok, span }),
            Err(()) if lexer.slice().starts_with(char::is_alphabetic) => {
                word(&mut lexer, source, base, &mut tokens, problems);
            }
            Err(()) => {
                let slice = lexer.slice();
                // A file that is no text at all has as many problems as bytes.
                if problems.len() < PROBLEMS_MAX {
                    problems.push(unknown(slice, span));
                }
                if slice.starts_with(['\'', '"']) {
                    broken(slice, span, &mut tokens);
                }
            }
        }
    }
    let span = Span::new(source, base + text.len(), base + text.len());
    tokens.push(Token {
        tok: Tok::Eof,
        span,
    });
    tokens
}

/// A name with letters that names do not have, `größe`: told once, and read as the name that it is meant to be.
fn word(
    lexer: &mut Lexer<'_, Tok>,
    source: u32,
    base: usize,
    tokens: &mut Vec<Token>,
    problems: &mut Vec<Problem>,
) {
    let rest = lexer.remainder();
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    lexer.bump(rest.find(|c| !is_part(c)).unwrap_or(rest.len()));
    let Range { mut start, end } = lexer.span();
    let begun = tokens.last().filter(|t| {
        let is_word = matches!(t.tok, Tok::Ident | Tok::Kw(_));
        is_word && t.span.source == source && t.span.end as usize == base + start
    });
    if let Some(begun) = begun {
        start = begun.span.start as usize - base;
        tokens.pop();
    }
    let span = Span::new(source, base + start, base + end);
    let message = format!("`{}` is no name", &lexer.source()[start..end]);
    let told = problems.iter().any(|p| p.message == message);
    if !told && problems.len() < PROBLEMS_MAX {
        problems.push(
            Problem::error("E104", span, message)
                .expected("letters from A to Z, digits and `_` (IEC 61131-3, clause 6.1.2)"),
        );
    }
    let tok = Tok::Ident;
    tokens.push(Token { tok, span });
}

/// What stands in the place of a string that is not closed, so that the statement around it can be read: a value, and the
/// semicolon at the end of the line.
fn broken(slice: &str, span: Span, tokens: &mut Vec<Token>) {
    let tok = Tok::Broken;
    tokens.push(Token { tok, span });
    if slice.trim_end().ends_with(';') {
        let end = span.start + slice.trim_end().len() as u32;
        let span = Span {
            start: end - 1,
            end,
            ..span
        };
        tokens.push(Token {
            tok: Tok::Semi,
            span,
        });
    }
}

/// What is written instead of a sign that other languages have.
fn instead(sign: char) -> Option<&'static str> {
    Some(match sign {
        '!' => "`<>` is not equal, NOT negates",
        '|' => "OR joins conditions and bit strings",
        '#' => "a number to a base looks like 16#FF, a value with its type like INT#5",
        '~' => "NOT negates bit strings",
        '‘' | '’' | '“' | '”' | '`' | '´' => {
            "a string stands between straight quotes: 'text'"
        }
        '–' | '—' | '−' => "a minus is `-`",
        _ => return None,
    })
}

fn unknown(slice: &str, span: Span) -> Problem {
    match slice.chars().next() {
        Some('\'' | '"') => Problem::error("E102", span, "this string is not closed on its line")
            .hint("write `$N` for a line feed inside a string"),
        Some('%') if slice == "%" => Problem::error("E103", span, "`%` is no direct address")
            .expected("an address such as %IX3.5, %QW2 or %ID4")
            .hint("MOD gives the rest of a division"),
        Some('%') => Problem::error("E103", span, format!("`{slice}` is no direct address"))
            .expected("an address such as %IX3.5, %QW2 or %ID4"),
        sign => {
            let message = format!("`{slice}` does not belong to Structured Text");
            let problem = Problem::error("E104", span, message);
            match sign.and_then(instead) {
                Some(hint) => problem.hint(hint),
                None => problem,
            }
        }
    }
}

fn comment_paren(lexer: &mut Lexer<'_, Tok>) -> bool {
    nested(lexer, b"(*", b"*)")
}

fn comment_slash(lexer: &mut Lexer<'_, Tok>) -> bool {
    nested(lexer, b"/*", b"*/")
}

/// Comments nest, as the third edition says. Answers whether the comment is closed.
fn nested(lexer: &mut Lexer<'_, Tok>, open: &[u8; 2], close: &[u8; 2]) -> bool {
    let rest = lexer.remainder().as_bytes();
    let mut depth = 1;
    let mut at = 0;
    while at < rest.len() {
        if rest[at..].starts_with(close) {
            depth -= 1;
            at += 2;
            if depth == 0 {
                lexer.bump(at);
                return true;
            }
        } else if rest[at..].starts_with(open) {
            depth += 1;
            at += 2;
        } else {
            at += 1;
        }
    }
    lexer.bump(at);
    false
}

fn comment_line(lexer: &mut Lexer<'_, Tok>) -> bool {
    let rest = lexer.remainder();
    lexer.bump(rest.find('\n').unwrap_or(rest.len()));
    true
}

fn pragma(lexer: &mut Lexer<'_, Tok>) -> bool {
    let rest = lexer.remainder();
    let end = if rest.starts_with('{') {
        behind_foreign(rest)
    } else {
        rest.find('}').map(|at| at + 1)
    };
    lexer.bump(end.unwrap_or(rest.len()));
    end.is_some()
}

/// Where code of another language ends, seen from behind its first brace: where its braces are closed, or else at `}}`.
fn behind_foreign(rest: &str) -> Option<usize> {
    let mut open = 1;
    for (at, byte) in rest.bytes().enumerate() {
        match byte {
            b'{' => open += 1,
            b'}' => open -= 1,
            _ => {}
        }
        if open == 0 {
            return Some(at + 1);
        }
    }
    rest.find("}}").map(|at| at + 2)
}

impl Tok {
    /// How the token is named in a message.
    pub fn describe(self) -> String {
        let text = match self {
            Tok::Ident => return "a name".into(),
            Tok::Kw(kw) => kw.text(),
            Tok::TypePrefix => return "a type prefix".into(),
            Tok::Int | Tok::Based | Tok::Real => return "a number".into(),
            Tok::Time => return "a duration".into(),
            Tok::Date | Tok::DateTime => return "a date".into(),
            Tok::TimeOfDay => return "a time of day".into(),
            Tok::TryAssign => "?=",
            Tok::Str | Tok::WStr | Tok::Broken => return "a string".into(),
            Tok::Direct => return "a direct address".into(),
            Tok::Eof => return "the end of the text".into(),
            Tok::Comment(_) => return "a comment".into(),
            Tok::Assign => ":=",
            Tok::Arrow => "=>",
            Tok::Colon => ":",
            Tok::Semi => ";",
            Tok::Comma => ",",
            Tok::LParen => "(",
            Tok::RParen => ")",
            Tok::LBracket => "[",
            Tok::RBracket => "]",
            Tok::DotDot => "..",
            Tok::Dot => ".",
            Tok::Plus => "+",
            Tok::Minus => "-",
            Tok::Power => "**",
            Tok::Star => "*",
            Tok::Slash => "/",
            Tok::Amp => "&",
            Tok::Le => "<=",
            Tok::Ge => ">=",
            Tok::Ne => "<>",
            Tok::Lt => "<",
            Tok::Gt => ">",
            Tok::Eq => "=",
            Tok::Caret => "^",
        };
        format!("`{text}`")
    }
}
