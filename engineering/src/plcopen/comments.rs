//! Comments of declarations in Structured Text, to go with them into PLCopen XML, where they are documentation.

use fam_soft_plc::source::{Sources, Span};

/// The comment of a declaration: behind it on its line, else the one that ends on the line before it.
#[must_use]
pub fn of(sources: &Sources, name: Span) -> Option<String> {
    let text = &sources.get(name.source).text;
    behind(text, name.end as usize).or_else(|| before(text, name.start as usize))
}

/// The comment at the head of a file, before anything is declared, with an empty line behind it.
#[must_use]
pub fn of_file(text: &str) -> Option<String> {
    let text = text.trim_start();
    let (comment, rest) = comment_at(text)?;
    let gap = &rest[..rest.len() - rest.trim_start().len()];
    (gap.matches('\n').count() > 1).then_some(comment)
}

fn behind(text: &str, from: usize) -> Option<String> {
    let line = text.get(from..)?.lines().next()?;
    // Behind the end of a declaration; the head of a POU has none and stands alone on its line.
    let at = line.find(';').map_or(0, |i| i + 1);
    let rest = line.get(at..)?.trim();
    let (comment, after) = comment_at(rest)?;
    after.trim().is_empty().then_some(comment)
}

fn before(text: &str, at: usize) -> Option<String> {
    let line = text[..at].rfind('\n')?;
    let above = &text[..line];
    let last = above.rfind('\n').map_or(above, |i| &above[i + 1..]);
    if let Some(comment) = last.trim().strip_prefix("//") {
        return Some(comment.trim().to_owned());
    }
    let above = above
        .strip_suffix("*)")
        .or_else(|| above.trim_end_matches(' ').strip_suffix("*)"))?;
    let start = above.rfind("(*")?;
    // A comment behind something else on its line belongs to that.
    let lead = above[..start].rfind('\n').map_or(0, |i| i + 1);
    if !above[lead..start].trim().is_empty() || above[start..].contains("*)") {
        return None;
    }
    Some(joined(&above[start + 2..]))
}

/// A comment at the beginning of a text, and what follows.
fn comment_at(text: &str) -> Option<(String, &str)> {
    if let Some(rest) = text.strip_prefix("//") {
        let end = rest.find('\n').unwrap_or(rest.len());
        return Some((rest[..end].trim().to_owned(), &rest[end..]));
    }
    let rest = text.strip_prefix("(*")?;
    let end = rest.find("*)")?;
    Some((joined(&rest[..end]), &rest[end + 2..]))
}

/// The lines of a comment without their indentation.
fn joined(comment: &str) -> String {
    let lines: Vec<&str> = comment.trim().lines().map(str::trim).collect();
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_belong_to_what_they_stand_at() {
        let text = "(* head\n   of file *)\n\n(* a POU *)\nPROGRAM P\nVAR\n    a : INT; // first\n    b : INT := 3; (* second *)\n    c : INT;\n    (* third *)\n    d : INT;\nEND_VAR\n";
        let mut sources = Sources::default();
        let source = sources.add("a.st", text);
        let at = |needle: &str| {
            let start = text.find(needle).unwrap();
            Span::new(source, start, start + 1)
        };
        assert_eq!(of_file(text).as_deref(), Some("head\nof file"));
        assert_eq!(of(&sources, at("P\nVAR")).as_deref(), Some("a POU"));
        assert_eq!(of(&sources, at("a : INT")).as_deref(), Some("first"));
        assert_eq!(of(&sources, at("b : INT")).as_deref(), Some("second"));
        assert_eq!(of(&sources, at("c : INT")), None);
        assert_eq!(of(&sources, at("d : INT")).as_deref(), Some("third"));
    }
}
