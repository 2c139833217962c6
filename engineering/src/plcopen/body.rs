//! Cuts the text of a POU's body out of its source, comments included.

use fam_soft_plc::source::Sources;
use fam_soft_plc::syntax::ast::{Ident, Pou, Project};
use std::ops::Range;

/// Text between the last END_VAR of the POU (or its head) and its end.
#[must_use]
pub fn body_text(project: &Project, pou: &Pou) -> String {
    let first = pou.body.first().map(|s| s.span);
    let head = pou.result.as_ref().map_or(pou.name.span, |r| r.span);
    let sources: &Sources = &project.sources;
    if let Some(first) = first
        && first.source != head.source
    {
        // A body that stands alone in an element of an XML file is a source of its own.
        return of_element(&sources.get(first.source).text).to_owned();
    }
    let Some(first) = first else {
        return String::new();
    };
    let text = &sources.get(head.source).text;
    let (mut start, mut end) = (head.end as usize, text.len());
    if text.trim_start().starts_with('<') {
        // In an XML file it is the body alone, or the whole POU in a section of its own.
        match section(text, start) {
            Some(section) => end = section.end,
            None => return of_element(element_text(text, first.start as usize)).to_owned(),
        }
    }
    let text = &text[..end];
    for (at, word) in words(text, start) {
        let upper = word.to_ascii_uppercase();
        if upper == "END_VAR" && at < first.start as usize {
            start = at + word.len();
        }
        if at >= first.start as usize
            && matches!(
                upper.as_str(),
                "END_PROGRAM" | "END_FUNCTION" | "END_FUNCTION_BLOCK"
            )
        {
            end = at;
            break;
        }
    }
    trimmed(text.get(start..end).unwrap_or("")).to_owned()
}

/// The text of a declaration from its opening word to its closing one, around its name.
#[must_use]
pub fn whole_text<'a>(
    project: &'a Project,
    name: &Ident,
    open: &str,
    close: &str,
) -> Option<&'a str> {
    let text = project.sources.get(name.span.source).text.as_str();
    let at = name.span.start as usize;
    // In an XML file it stands in a section of its own.
    let Range { start: from, end } = if text.trim_start().starts_with('<') {
        section(text, at)?
    } else {
        0..text.len()
    };
    let part = text.get(from..end)?;
    let mut start = None;
    for (offset, word) in words(part, 0) {
        if from + offset < at {
            if word.eq_ignore_ascii_case(open) {
                start = Some(offset);
            }
        } else if word.eq_ignore_ascii_case(close) {
            return part.get(start?..offset + word.len());
        }
    }
    None
}

/// What stands in the CDATA section around a byte of an XML file.
fn section(text: &str, at: usize) -> Option<Range<usize>> {
    const OPENING: &str = "<![CDATA[";
    const CLOSING: &str = "]]>";
    let from = text.get(..at)?.rfind(OPENING)? + OPENING.len();
    let before = text.get(from..at)?;
    let to = at + text[at..].find(CLOSING)?;
    (!before.contains(CLOSING)).then_some(from..to)
}

/// The whole `<pou>` element of a POU whose body is a diagram, a chart or a list: what has no ST text is kept as it was drawn.
#[must_use]
pub fn drawn<'a>(project: &'a Project, pou: &Pou) -> Option<&'a str> {
    let text = &project.sources.get(pou.name.span.source).text;
    if !text.trim_start().starts_with('<') {
        return None;
    }
    let name = pou.name.span.start as usize;
    let start = text[..name].rfind("<pou")?;
    let end = name + text[name..].find("</pou>")? + "</pou>".len();
    let element = &text[start..end];
    let body = element.split_once("<body")?.1;
    let language = body.split_once('>')?.1.trim_start();
    let name = language
        .split(['>', ' ', '\t', '\r', '\n'])
        .next()
        .unwrap_or("");
    let name = name
        .trim_start_matches('<')
        .rsplit(':')
        .next()
        .unwrap_or("");
    let is_text =
        name.starts_with('/') || matches!(name, "ST" | "ST/" | "" | "addData" | "documentation");
    let has_more = element.contains("<actions") || element.contains("<transitions");
    (!is_text || has_more).then_some(element)
}

/// Likewise for the text of an element, whose first line may begin with the element.
fn of_element(text: &str) -> &str {
    let text = text.trim_end();
    let skipped = text.len() - text.trim_start().len();
    match text[..skipped].rfind('\n') {
        Some(newline) => &text[newline + 1..],
        None => text,
    }
}

/// The text of the `<ST>` element of an XML file around a byte, as it stands there, without markup.
fn element_text(text: &str, inside: usize) -> &str {
    let is_st = |at: &usize| {
        let name = text[at + 1..]
            .split(['>', ' ', '\t', '\r', '\n', '/'])
            .next();
        name.is_some_and(|n| n.rsplit(':').next() == Some("ST"))
    };
    let opened = text[..inside]
        .rmatch_indices('<')
        .map(|(at, _)| at)
        .find(is_st);
    let Some(mut at) = opened else {
        return "";
    };
    loop {
        let rest = &text[at..];
        let blank = rest.len() - rest.trim_start().len();
        let tag = &rest[blank..];
        if let Some(data) = tag.strip_prefix("<![CDATA[") {
            return &data[..data.find("]]>").unwrap_or(data.len())];
        }
        match tag.find('>') {
            Some(end) if tag.starts_with('<') => at += blank + end + 1,
            _ => return &rest[..rest.find('<').unwrap_or(rest.len())],
        }
    }
}

/// Without empty lines before and after, the first line's indentation kept.
fn trimmed(text: &str) -> &str {
    let text = text.trim_end();
    let skipped = text.len() - text.trim_start().len();
    match text[..skipped].rfind('\n') {
        Some(newline) => &text[newline + 1..],
        None => text.trim_start(),
    }
}

/// Words of a text from a byte on, outside comments, pragmas and strings: `(offset, word)`.
pub fn words(text: &str, from: usize) -> impl Iterator<Item = (usize, &str)> {
    tokens(text, from).filter(|(_, token)| !token.starts_with('%'))
}

/// Words and addresses in the process image, such as `%IX0.3`.
pub fn tokens(text: &str, from: usize) -> impl Iterator<Item = (usize, &str)> {
    let bytes = text.as_bytes();
    let mut at = from;
    std::iter::from_fn(move || {
        while at < bytes.len() {
            let rest = &bytes[at..];
            let skip_to = |end: &[u8], from: usize| {
                rest[from..]
                    .windows(end.len())
                    .position(|w| w == end)
                    .map_or(rest.len(), |p| from + p + end.len())
            };
            match rest {
                [b'(', b'*', ..] => at += nested_comment(rest, b'(', b')'),
                [b'/', b'*', ..] => at += nested_comment(rest, b'/', b'/'),
                [b'/', b'/', ..] => at += skip_to(b"\n", 2),
                [b'{', ..] => at += skip_to(b"}", 1),
                [quote @ (b'\'' | b'"'), ..] => at += string_len(rest, *quote),
                [c, ..] if c.is_ascii_alphabetic() || *c == b'_' => {
                    let len = rest
                        .iter()
                        .position(|c| !c.is_ascii_alphanumeric() && *c != b'_')
                        .unwrap_or(rest.len());
                    let found = (at, &text[at..at + len]);
                    at += len;
                    return Some(found);
                }
                [b'%', area, ..] if b"IQMiqm".contains(area) => {
                    let is_part = |c: &u8| c.is_ascii_alphanumeric() || *c == b'.';
                    let end = rest[1..].iter().position(|c| !is_part(c));
                    let len = end.map_or(rest.len(), |end| end + 1);
                    let found = &text[at..at + len];
                    at += len;
                    return Some((at - len, found));
                }
                [c, ..] if c.is_ascii_digit() => {
                    // A number with its base and exponent is no word.
                    at += rest
                        .iter()
                        .position(|c| !c.is_ascii_alphanumeric() && *c != b'_' && *c != b'#')
                        .unwrap_or(rest.len());
                }
                _ => at += 1,
            }
        }
        None
    })
}

fn nested_comment(rest: &[u8], open: u8, close: u8) -> usize {
    let (mut depth, mut at) = (0usize, 0);
    while at + 1 < rest.len() {
        if rest[at] == open && rest[at + 1] == b'*' {
            depth += 1;
            at += 2;
        } else if rest[at] == b'*' && rest[at + 1] == close {
            depth -= 1;
            at += 2;
            if depth == 0 {
                return at;
            }
        } else {
            at += 1;
        }
    }
    rest.len()
}

fn string_len(rest: &[u8], quote: u8) -> usize {
    let mut at = 1;
    while at < rest.len() {
        match rest[at] {
            b'$' => at += 2,
            c if c == quote => return at + 1,
            _ => at += 1,
        }
    }
    rest.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use fam_soft_plc::project::parse_project;
    use fam_soft_plc::source::SourceFile;

    #[test]
    fn words_leave_out_comments_strings_and_numbers() {
        let text = "a (* b (* c *) d *) e // f\n'g$'h' {i} 16#AB 1e5 j_1 /* k */ T#5s \"l\" m";
        let found: Vec<&str> = words(text, 0).map(|(_, w)| w).collect();
        assert_eq!(found, ["a", "e", "j_1", "T", "m"]);
    }

    #[test]
    fn a_body_in_xml_is_what_stands_in_its_element() {
        for body in [
            "<ST><xhtml:p><![CDATA[\n  (* a < b *)\n  x := 1;\n  y := x < 2; (* > *)\n]]></xhtml:p></ST>",
            "<ST>\n<xhtml:p>  (* a *)\n  x := 1;\n  y := x = 2;</xhtml:p>\n</ST>",
        ] {
            let file = format!(
                "<project xmlns=\"http://www.plcopen.org/xml/tc6_0201\" xmlns:xhtml=\"http://www.w3.org/1999/xhtml\"><types><pous><pou name=\"P\" pouType=\"program\"><interface><localVars><variable name=\"x\"><type><INT/></type></variable><variable name=\"y\"><type><BOOL/></type></variable></localVars></interface><body>{body}</body></pou></pous></types></project>"
            );
            let (project, problems) = parse_project(&[SourceFile::new("a.xml", file)]);
            assert!(problems.is_empty(), "{problems:?}");
            let text = body_text(&project, &project.pous[0]);
            assert!(
                text.starts_with("  (* a") && text.lines().count() == 3,
                "{text}"
            );
            assert!(!text.contains("xhtml") && !text.contains("CDATA"), "{text}");
        }
    }

    #[test]
    fn what_is_drawn_is_kept_as_it_is() {
        let pou = |body: &str| {
            format!("<pou name=\"P\" pouType=\"program\"><interface/><body>{body}</body></pou>")
        };
        let of = |body: &str| {
            let file = format!(
                "<project xmlns=\"http://www.plcopen.org/xml/tc6_0201\" xmlns:xhtml=\"http://www.w3.org/1999/xhtml\"><types><pous>{}</pous></types></project>",
                pou(body)
            );
            let (project, _) = parse_project(&[SourceFile::new("a.xml", file)]);
            drawn(&project, &project.pous[0]).map(str::to_owned)
        };
        assert_eq!(of("<LD></LD>"), Some(pou("<LD></LD>")));
        assert_eq!(of("\n<FBD/>"), Some(pou("\n<FBD/>")));
        assert_eq!(of("<ST><xhtml:p>;</xhtml:p></ST>"), None);
        assert_eq!(of("<ST/>"), None);
        assert_eq!(of(""), None);
    }

    #[test]
    fn a_body_keeps_its_comments() {
        let text = "PROGRAM P\nVAR x : INT; (* END_VAR *) END_VAR\nVAR y : INT; END_VAR\n  (* first *)\n  x := 1;\n  y := 2; // last END_PROGRAM\nEND_PROGRAM\nFUNCTION F : INT\nF := 3;\nEND_FUNCTION\n";
        let (project, problems) = parse_project(&[SourceFile::new("a.st", text)]);
        assert!(problems.is_empty());
        assert_eq!(
            body_text(&project, &project.pous[0]),
            "  (* first *)\n  x := 1;\n  y := 2; // last END_PROGRAM"
        );
        assert_eq!(body_text(&project, &project.pous[1]), "F := 3;");
    }
}
