//! Problems of a model: collected, so that all of them can be shown at once, each with file, line, what was expected and what to do.
//!
//! They are the compiler's diagnostics, so that an error in `cell.toml` and one in the logic read alike. Codes: M1xx the
//! file itself (M104 its root), M2xx names and references, M3xx inputs and outputs, M4xx timing and size, M5xx critical intervals,
//! M6xx generated projects, M7xx deployments; W8xx warnings.

use fam_soft_plc::diag::{Diagnostic, Severity, shown_line};
use std::fmt;
use std::ops::Range;

/// Everything that is wrong with a model, never empty.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problems {
    /// Errors first, then warnings, each in the order of the text.
    pub list: Vec<Diagnostic>,
}

impl Problems {
    /// Only one problem.
    #[must_use]
    pub fn one(problem: Diagnostic) -> Problems {
        Problems {
            list: vec![problem],
        }
    }

    /// How many of them are errors.
    #[must_use]
    pub fn errors(&self) -> usize {
        self.list
            .iter()
            .filter(|p| p.severity == Severity::Error)
            .count()
    }
}

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for problem in &self.list {
            writeln!(f, "{problem}")?;
        }
        match self.errors() {
            1 => f.write_str("1 error"),
            n => write!(f, "{n} errors"),
        }
    }
}

impl std::error::Error for Problems {}

/// A named element of a model file, so that problems can say in which one they are.
#[derive(Debug, Clone)]
pub struct Place {
    /// From its beginning to its end, in bytes.
    pub at: Range<usize>,
    /// Its name.
    pub name: String,
    /// Number of the element that it stands in, an earlier one.
    pub inside: Option<usize>,
}

/// A model file that problems point into.
#[derive(Debug, Clone, Default)]
pub struct ModelText {
    /// As people know it: a path.
    pub name: String,
    /// Its content.
    pub text: String,
    /// Its named elements in the order of the text; none for TOML, whose lines say enough.
    pub places: Vec<Place>,
}

impl ModelText {
    /// A file without named elements.
    #[must_use]
    pub fn new(name: impl Into<String>, text: impl Into<String>) -> ModelText {
        ModelText {
            name: name.into(),
            text: text.into(),
            places: Vec::new(),
        }
    }

    /// Whether this is an AutomationML file.
    #[must_use]
    pub fn is_caex(&self) -> bool {
        !self.places.is_empty()
    }

    /// Path of the innermost element around a byte: `fms200/Station1/Picking`.
    #[must_use]
    pub fn element_path(&self, byte: usize) -> Option<String> {
        let begun = self.places.partition_point(|p| p.at.start <= byte);
        let mut next = self.places[..begun]
            .iter()
            .rposition(|p| p.at.contains(&byte));
        let mut names = Vec::new();
        while let Some(index) = next {
            names.push(self.places[index].name.as_str());
            next = self.places[index].inside;
        }
        names.reverse();
        (!names.is_empty()).then(|| names.join("/"))
    }

    /// Line and column of a byte, counted from 1; the column counts characters.
    #[must_use]
    pub fn position(&self, byte: usize) -> (u32, u32) {
        let mut at = byte.min(self.text.len());
        while !self.text.is_char_boundary(at) {
            at -= 1;
        }
        let before = &self.text[..at];
        let line = before.matches('\n').count() + 1;
        let start = before.rfind('\n').map_or(0, |i| i + 1);
        let column = before[start..].chars().count() + 1;
        (
            u32::try_from(line).unwrap_or(u32::MAX),
            u32::try_from(column).unwrap_or(u32::MAX),
        )
    }

    fn diagnostic(
        &self,
        severity: Severity,
        code: &str,
        span: Option<Range<usize>>,
        message: String,
    ) -> Diagnostic {
        let mut diagnostic = Diagnostic {
            code: code.to_owned(),
            severity,
            message,
            file: self.name.clone(),
            line: 1,
            column: 1,
            len: 1,
            source_line: String::new(),
            pou: None,
            expected: None,
            hint: None,
        };
        if let Some(span) = span {
            diagnostic.pou = self.element_path(span.start);
            let (line, column) = self.position(span.start);
            let source_line = self
                .text
                .lines()
                .nth(line as usize - 1)
                .unwrap_or("")
                .to_owned();
            let shown = self
                .text
                .get(span)
                .and_then(|s| s.lines().next())
                .map_or(1, |s| s.chars().count());
            diagnostic.line = line;
            diagnostic.column = column;
            diagnostic.len = u32::try_from(shown.max(1)).unwrap_or(1);
            diagnostic.source_line = shown_line(&source_line).to_owned();
        }
        diagnostic
    }

    /// An error at a place of this file.
    #[must_use]
    pub fn error(&self, code: &str, span: Range<usize>, message: impl Into<String>) -> Diagnostic {
        self.diagnostic(Severity::Error, code, Some(span), message.into())
    }

    /// A warning at a place of this file.
    #[must_use]
    pub fn warning(
        &self,
        code: &str,
        span: Range<usize>,
        message: impl Into<String>,
    ) -> Diagnostic {
        self.diagnostic(Severity::Warning, code, Some(span), message.into())
    }

    /// What the TOML reader found wrong.
    #[must_use]
    pub fn unreadable(&self, error: &toml::de::Error) -> Diagnostic {
        // serde says `unknown field `x`, expected one of ...` in one sentence; the second half has its own line here.
        let text = error.message().trim().to_owned();
        let (message, expected) = match text.split_once(", expected ") {
            Some((message, expected)) => (message.to_owned(), Some(in_words(expected))),
            None => (text, None),
        };
        let mut diagnostic = self.diagnostic(Severity::Error, "M101", error.span(), message);
        diagnostic.expected = expected;
        if diagnostic.message == "missing field `format`" {
            diagnostic.expected = Some("a cell.toml, which begins with `format = 1`".to_owned());
        }
        diagnostic
    }
}

/// What the reader expects, for somebody who does not write Rust.
fn in_words(expected: &str) -> String {
    let words = match expected {
        "f64" => "a number",
        "u32" => "a whole number from 0 to 4294967295",
        "u64" => "a whole number, 0 or more",
        "a boolean" => "true or false",
        "a string" => "text in quotes",
        "a sequence" => "a list in [ ], or a table headed [[ ]] for each entry",
        "a map" => "a table",
        of_a_type if of_a_type.starts_with("struct ") => "a table",
        other => other,
    };
    words.to_owned()
}

/// Fluent additions to a diagnostic.
pub trait Explain {
    /// What was expected instead.
    #[must_use]
    fn expected(self, text: impl Into<String>) -> Self;
    /// What to do.
    #[must_use]
    fn hint(self, text: impl Into<String>) -> Self;
}

impl Explain for Diagnostic {
    fn expected(mut self, text: impl Into<String>) -> Self {
        self.expected = Some(text.into());
        self
    }
    fn hint(mut self, text: impl Into<String>) -> Self {
        self.hint = Some(text.into());
        self
    }
}

/// An error about a file as a whole: it cannot be read or written.
#[must_use]
pub fn file_error(code: &str, file: &std::path::Path, message: String) -> Diagnostic {
    Diagnostic {
        code: code.to_owned(),
        severity: Severity::Error,
        message,
        file: file.display().to_string(),
        line: 1,
        column: 1,
        len: 1,
        source_line: String::new(),
        pou: None,
        expected: None,
        hint: None,
    }
}

/// The one of `known` that a person most likely meant by `name`, if any is near.
#[must_use]
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let name = name.to_ascii_lowercase();
    let limit = (name.len() / 3).max(1);
    known
        .into_iter()
        .map(|k| (distance(&name, &k.to_ascii_lowercase()), k))
        .filter(|(d, _)| *d <= limit)
        .min()
        .map(|(_, k)| k)
}

/// Levenshtein distance.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let next = if ca == *cb {
                diagonal
            } else {
                diagonal.min(row[j]).min(row[j + 1]) + 1
            };
            diagonal = row[j + 1];
            row[j + 1] = next;
        }
    }
    row[b.len()]
}

/// Names for a hint: the nearest one, or all of them if they are few.
#[must_use]
pub fn suggestion<'a>(name: &str, known: impl IntoIterator<Item = &'a str> + Clone) -> String {
    const LISTED_MAX: usize = 12;
    if let Some(near) = nearest(name, known.clone()) {
        return format!("did you mean `{near}`?");
    }
    let all: Vec<&str> = known.into_iter().collect();
    if all.is_empty() {
        "there are none".to_owned()
    } else if all.len() <= LISTED_MAX {
        format!("there are: {}", all.join(", "))
    } else {
        format!("there are {} of them, such as {}", all.len(), all[0])
    }
}
