//! Source texts and positions in them: which file, which line, which column.

use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// One file of a project: Structured Text or PLCopen XML, recognised by its content.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SourceFile {
    pub name: String,
    pub text: String,
}

impl SourceFile {
    pub fn new(name: impl Into<String>, text: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            text: text.into(),
        }
    }
}

/// Bytes `start..end` of source number `source`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Span {
    pub source: u32,
    pub start: u32,
    pub end: u32,
}

impl Span {
    pub fn new(source: u32, start: usize, end: usize) -> Self {
        Self {
            source,
            start: start as u32,
            end: end as u32,
        }
    }

    /// From the start of `self` to the end of `other`.
    #[must_use]
    pub fn to(self, other: Span) -> Span {
        Span {
            source: self.source,
            start: self.start,
            end: other.end.max(self.end),
        }
    }
}

/// A text that spans point into. Usually a whole file; for a text inside an XML file whose entities had to be decoded,
/// the decoded text together with the line and column at which it stands.
#[derive(Clone, Debug)]
pub struct Source {
    pub name: String,
    pub text: String,
    first_line: u32,
    first_column: u32,
    line_starts: Vec<u32>,
}

/// Line and column, both counted from 1; the column counts characters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Position {
    pub line: u32,
    pub column: u32,
}

impl Source {
    fn new(name: String, text: String, first_line: u32, first_column: u32) -> Self {
        let mut line_starts = vec![0];
        line_starts.extend(
            text.bytes()
                .enumerate()
                .filter(|(_, b)| *b == b'\n')
                .map(|(i, _)| i as u32 + 1),
        );
        Self {
            name,
            text,
            first_line,
            first_column,
            line_starts,
        }
    }

    fn line_index(&self, offset: u32) -> usize {
        self.line_starts.partition_point(|s| *s <= offset).max(1) - 1
    }

    pub fn position(&self, offset: u32) -> Position {
        let offset = offset.min(self.text.len() as u32);
        let index = self.line_index(offset);
        let start = self.line_starts[index] as usize;
        let mut end = offset as usize;
        while !self.text.is_char_boundary(end) {
            end -= 1;
        }
        let chars = self.text[start..end].chars().count() as u32;
        let shift = if index == 0 { self.first_column - 1 } else { 0 };
        Position {
            line: self.first_line + index as u32,
            column: chars + 1 + shift,
        }
    }

    /// The text of the line that holds `offset`, without its line end.
    pub fn line_text(&self, offset: u32) -> &str {
        let index = self.line_index(offset.min(self.text.len() as u32));
        let start = self.line_starts[index] as usize;
        let end = self
            .line_starts
            .get(index + 1)
            .map_or(self.text.len(), |e| *e as usize);
        self.text[start..end].trim_end_matches(['\n', '\r'])
    }
}

/// All texts of a project; copies share them.
#[derive(Clone, Debug, Default)]
pub struct Sources {
    list: Vec<Arc<Source>>,
}

impl Sources {
    pub fn add(&mut self, name: &str, text: &str) -> u32 {
        self.add_part(name, text, 1, 1)
    }

    /// A text that stands at the given line and column of the file `name`.
    pub fn add_part(&mut self, name: &str, text: &str, line: u32, column: u32) -> u32 {
        let source = Source::new(name.to_owned(), text.to_owned(), line, column);
        self.list.push(Arc::new(source));
        self.list.len() as u32 - 1
    }

    pub fn get(&self, source: u32) -> &Source {
        &self.list[source as usize]
    }

    pub fn position(&self, span: Span) -> Position {
        self.get(span.source).position(span.start)
    }

    pub fn slice(&self, span: Span) -> &str {
        self.get(span.source)
            .text
            .get(span.start as usize..span.end as usize)
            .unwrap_or("")
    }
}
