//! Diagnostics: what is wrong, where, what was expected, and what to do.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::source::{Sources, Span};

/// Longest line that is shown, in bytes: one of a file without line ends would bury what is said about it.
const LINE_BYTES_MAX: usize = 1000;

/// The line that a problem stands in, as it is shown: nothing of one that is too long.
#[must_use]
pub fn shown_line(line: &str) -> &str {
    if line.len() > LINE_BYTES_MAX {
        ""
    } else {
        line
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    Error,
    Warning,
}

/// A finished diagnostic; it needs no sources to be shown.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Diagnostic {
    /// Stable code: E1xx syntax, E2xx declarations, E3xx expressions, E4xx statements, E5xx layout and compilation, E6xx PLCopen XML, W7xx warnings.
    pub code: String,
    pub severity: Severity,
    pub message: String,
    pub file: String,
    /// Lines and columns count from 1.
    pub line: u32,
    pub column: u32,
    /// Length in characters, on the first line.
    pub len: u32,
    pub source_line: String,
    pub pou: Option<String>,
    pub expected: Option<String>,
    pub hint: Option<String>,
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let word = match self.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
        };
        writeln!(f, "{word}[{}]: {}", self.code, self.message)?;
        if !self.file.is_empty() {
            write!(f, "  --> {}:{}:{}", self.file, self.line, self.column)?;
            if let Some(pou) = &self.pou {
                write!(f, " (in {pou})")?;
            }
            writeln!(f)?;
        }
        if !self.source_line.trim().is_empty() {
            let number = self.line.to_string();
            let pad = " ".repeat(number.len());
            writeln!(f, "{pad} |")?;
            writeln!(f, "{number} | {}", self.source_line.replace('\t', " "))?;
            let indent = " ".repeat(self.column.saturating_sub(1) as usize);
            let carets = "^".repeat(self.len.max(1) as usize);
            writeln!(f, "{pad} | {indent}{carets}")?;
        }
        if let Some(expected) = &self.expected {
            writeln!(f, "  = expected: {expected}")?;
        }
        if let Some(hint) = &self.hint {
            writeln!(f, "  = hint: {hint}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Diagnostic {}

/// A result whose error is a problem; boxed, because problems are rare and large.
pub type Fallible<T> = Result<T, Box<Problem>>;

/// A diagnostic in the making: it still points into the sources.
#[derive(Clone, Debug)]
pub struct Problem {
    pub code: &'static str,
    pub severity: Severity,
    pub span: Option<Span>,
    pub message: String,
    pub pou: Option<String>,
    pub expected: Option<String>,
    pub hint: Option<String>,
}

impl Problem {
    pub fn error(code: &'static str, span: Span, message: impl Into<String>) -> Self {
        Self {
            code,
            severity: Severity::Error,
            span: Some(span),
            message: message.into(),
            pou: None,
            expected: None,
            hint: None,
        }
    }

    /// An error that no source text is to blame for, such as a wrong compile specification.
    pub fn general(code: &'static str, message: impl Into<String>) -> Self {
        Self {
            span: None,
            ..Self::error(code, Span::default(), message)
        }
    }

    pub fn warning(code: &'static str, span: Span, message: impl Into<String>) -> Self {
        Self {
            severity: Severity::Warning,
            ..Self::error(code, span, message)
        }
    }

    pub fn fail<T>(self) -> Fallible<T> {
        Err(Box::new(self))
    }

    #[must_use]
    pub fn expected(mut self, text: impl Into<String>) -> Self {
        self.expected = Some(text.into());
        self
    }

    #[must_use]
    pub fn hint(mut self, text: impl Into<String>) -> Self {
        self.hint = Some(text.into());
        self
    }

    #[must_use]
    pub fn in_pou(mut self, pou: &str) -> Self {
        self.pou = Some(pou.to_owned());
        self
    }

    pub fn finish(self, sources: &Sources) -> Diagnostic {
        let mut diagnostic = Diagnostic {
            code: self.code.to_owned(),
            severity: self.severity,
            message: self.message,
            file: String::new(),
            line: 0,
            column: 0,
            len: 0,
            source_line: String::new(),
            pou: self.pou,
            expected: self.expected,
            hint: self.hint,
        };
        if let Some(span) = self.span {
            let source = sources.get(span.source);
            let position = source.position(span.start);
            let line = source.line_text(span.start);
            diagnostic.file.clone_from(&source.name);
            diagnostic.line = position.line;
            diagnostic.column = position.column;
            // A part of an XML file starts in the middle of its line; what stands before it is not known here.
            let shown = line.chars().count() as u32;
            let missing = position.column.saturating_sub(1).saturating_sub(
                source.text[..span.start as usize]
                    .rsplit('\n')
                    .next()
                    .map_or(0, |s| s.chars().count() as u32),
            );
            let line = shown_line(line);
            if !line.is_empty() {
                diagnostic.source_line = format!("{}{line}", " ".repeat(missing as usize));
            }
            let wanted = sources
                .slice(span)
                .lines()
                .next()
                .map_or(1, |l| l.chars().count() as u32);
            let room = (shown + missing + 1)
                .saturating_sub(position.column - 1)
                .max(1);
            diagnostic.len = wanted.clamp(1, room);
        }
        diagnostic
    }
}

/// Finishes all problems, errors first, otherwise in the order of the text.
pub fn finish_all(mut problems: Vec<Problem>, sources: &Sources) -> Vec<Diagnostic> {
    problems.sort_by_key(|p| (p.severity, p.span));
    // A function with open arrays is looked at once for each kind of array that is passed.
    problems.dedup_by(|b, a| (a.code, a.span, &a.message) == (b.code, b.span, &b.message));
    problems.into_iter().map(|p| p.finish(sources)).collect()
}
