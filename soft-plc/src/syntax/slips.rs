//! Slips that are usual, told as what they are: words and signs of other languages, END words written otherwise.

use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::lexer::{Kw, Tok};
use crate::syntax::parser::{Parsed, Parser, Stop};

/// A text with more mistakes than this is told more of them than it has.
const PROBLEMS_LOOKED_AT: usize = 1_000;

const ENDS: [Kw; 16] = [
    Kw::EndIf,
    Kw::EndFor,
    Kw::EndWhile,
    Kw::EndRepeat,
    Kw::EndCase,
    Kw::EndProgram,
    Kw::EndFunction,
    Kw::EndFunctionBlock,
    Kw::EndMethod,
    Kw::EndClass,
    Kw::EndInterface,
    Kw::EndNamespace,
    Kw::EndAction,
    Kw::EndStep,
    Kw::EndTransition,
    Kw::EndVar,
];

impl Parser<'_> {
    /// Whether the token `back` places back is of this kind and ends where the current one begins.
    pub(super) fn touches(&self, back: usize, tok: Tok) -> bool {
        let last = self.last_span();
        self.token_before(back) == Some(tok) && last.end == self.span().start
    }

    /// Whether something unknown stands between the last token and this one: that has been told.
    pub(super) fn follows_unknown(&self) -> bool {
        let (last, next) = (self.last_span(), self.span());
        let between = |p: &Problem| {
            let inside = |at: Span| at.start >= last.end && at.start <= next.start;
            matches!(p.code, "E102" | "E103" | "E104")
                && p.span.is_some_and(|s| s.source == next.source && inside(s))
        };
        // What is not closed has taken what should follow with it.
        if self.token_before(1) == Some(Tok::Broken) {
            return true;
        }
        self.position() > 0 && self.problems.iter().take(PROBLEMS_LOOKED_AT).any(between)
    }

    /// The keyword of a statement's head. If the line ends without it, that is where it is missing.
    pub(super) fn expect_word(&mut self, kw: Kw, wanted: &str) -> Parsed<()> {
        let last = self.last_span();
        if self.at_kw(kw) || self.follows_unknown() || !self.on_new_line() {
            return self.expect(Tok::Kw(kw), wanted).map(|_| ());
        }
        let span = Span {
            start: last.end,
            end: last.end + 1,
            ..last
        };
        let message = format!("{} is missing here", kw.text());
        self.report(Problem::error("E110", span, message).expected(wanted));
        Err(Stop)
    }

    /// What was probably meant by a token that cannot stand where it does.
    pub(super) fn slip(&self) -> Option<&'static str> {
        let next = self.peek_at(1);
        Some(match self.peek() {
            Tok::Eq if self.touches(1, Tok::Eq) => "one `=` compares",
            Tok::Amp if self.touches(1, Tok::Amp) => "AND joins conditions",
            Tok::Assign => "`:=` assigns; `=` compares",
            Tok::Plus | Tok::Minus | Tok::Star | Tok::Slash if next == Tok::Eq => {
                "write the sum out: `a := a + 1`"
            }
            Tok::Plus if next == Tok::Plus => "write the sum out: `a := a + 1`",
            Tok::Minus if next == Tok::Minus => "write the difference out: `a := a - 1`",
            _ => return None,
        })
    }

    /// `ELSEIF` and `ENDIF` are read as what was meant, once they have been told.
    pub(super) fn mend_keyword(&mut self) {
        let follows = matches!(
            self.peek_at(1),
            Tok::Assign | Tok::TryAssign | Tok::LParen | Tok::Dot | Tok::LBracket | Tok::Caret
        );
        if !self.at(Tok::Ident) || follows || self.peek_at(1) == Tok::Colon {
            return;
        }
        let span = self.span();
        let word = self.text_of(span).to_ascii_uppercase();
        let plain = |text: &str| text.replace('_', "");
        let meant = match word.as_str() {
            "ELSEIF" | "ELIF" | "ELSE_IF" | "ELSIFF" => Some(Kw::Elsif),
            _ if word.starts_with("END") => ENDS.into_iter().find(|kw| {
                let (have, want) = (plain(&word), plain(kw.text()));
                have == want || (have.starts_with(&want) && have.len() <= want.len() + 2)
            }),
            _ => None,
        };
        if let Some(kw) = meant {
            let message = format!("`{}` is no word of Structured Text", self.text_of(span));
            self.report(Problem::error("E110", span, message).expected(kw.text()));
            self.replace(Tok::Kw(kw));
        }
    }
}
