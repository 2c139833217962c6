//! References of an AutomationML model to files: `refURI` of interfaces, `Path` of external libraries.
//!
//! In the wild they are relative in spite of `file:///`, have percent escapes, backslashes and quotes, and a fragment that names a
//! POU, a variable or a `globalId`.

/// A reference, taken apart.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Uri {
    /// Path with `/` between its parts, as it stands there otherwise; relative to the file that it stands in.
    pub path: String,
    /// What stands behind `#`.
    pub fragment: Option<String>,
}

/// Why a text is no reference.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum UriError {
    /// Nothing there.
    #[error("the reference is empty")]
    Empty,
    /// Another scheme than `file`.
    #[error("`{0}` does not lead to a file")]
    Scheme(String),
    /// `%` without two hexadecimal digits, or bytes that are no text.
    #[error("`{0}` has a wrong percent escape")]
    Escape(String),
    /// Quotes and the like.
    #[error("`{0}` is malformed")]
    Malformed(String),
}

impl UriError {
    /// What was expected.
    pub const EXPECTED: &'static str = "a path relative to the file that it stands in and the name of a POU, such as `logic/station1.xml#Station1`";
}

/// Takes a reference apart.
///
/// # Errors
/// [`UriError`].
pub fn parse(text: &str) -> Result<Uri, UriError> {
    let text = text.trim();
    if text.is_empty() {
        return Err(UriError::Empty);
    }
    if text.contains(['"', '<', '>', '\n']) {
        return Err(UriError::Malformed(text.to_owned()));
    }
    let (path, fragment) = match text.split_once('#') {
        Some((path, fragment)) => (path, Some(fragment)),
        None => (text, None),
    };
    let path = path.replace('\\', "/");
    let path = match scheme(&path) {
        Some("file") => {
            let rest = &path["file:".len()..];
            match rest.strip_prefix("//") {
                // `file:///plc.xml` means the file beside the model, `file://host/x` a machine.
                Some(rest) => match rest.strip_prefix('/') {
                    Some(relative) => relative,
                    None if rest.starts_with("localhost/") => &rest["localhost/".len()..],
                    None if rest.starts_with('.') => rest,
                    None => return Err(UriError::Scheme(text.to_owned())),
                },
                None => rest,
            }
        }
        Some(_) => return Err(UriError::Scheme(text.to_owned())),
        None => &path,
    };
    let decoded = |part: &str| percent_decoded(part).ok_or(UriError::Escape(text.to_owned()));
    let path = decoded(path)?;
    let fragment = fragment.map(decoded).transpose()?;
    if path.is_empty() {
        return Err(UriError::Malformed(text.to_owned()));
    }
    Ok(Uri {
        path,
        fragment: fragment.filter(|f| !f.is_empty()),
    })
}

/// The scheme, if there is one; a single letter is a drive.
fn scheme(text: &str) -> Option<&str> {
    let (scheme, _) = text.split_once(':')?;
    let is_one = scheme.len() > 1
        && scheme.starts_with(|c: char| c.is_ascii_alphabetic())
        && scheme
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.'));
    is_one.then_some(scheme)
}

/// `%20` and the like resolved; `None` for a wrong escape.
#[must_use]
pub fn percent_decoded(text: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        if byte != b'%' {
            bytes.push(byte);
            continue;
        }
        let mut digit = || char::from(rest.next()?).to_digit(16);
        let (high, low) = (digit()?, digit()?);
        bytes.push(u8::try_from(high * 16 + low).ok()?);
    }
    String::from_utf8(bytes).ok()
}

/// A path as it is written into a reference.
#[must_use]
pub fn percent_encoded(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for byte in text.bytes() {
        if byte.is_ascii_alphanumeric() || b"-._~/".contains(&byte) {
            out.push(char::from(byte));
        } else {
            out.push_str(&format!("%{byte:02X}"));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn references_as_they_are_found() {
        let uri = |path: &str, fragment: Option<&str>| {
            Ok(Uri {
                path: path.to_owned(),
                fragment: fragment.map(str::to_owned),
            })
        };
        for (text, expected) in [
            ("file:///plc.xml#UUID_006", uri("plc.xml", Some("UUID_006"))),
            (
                "file:///Source/Candy%20Factory.xml#Var",
                uri("Source/Candy Factory.xml", Some("Var")),
            ),
            ("../PLCOpenXML/x.xml", uri("../PLCOpenXML/x.xml", None)),
            ("logic\\a.xml#Main", uri("logic/a.xml", Some("Main"))),
            ("a.xml#", uri("a.xml", None)),
            // A drive is no scheme; the path leaves the model's folder.
            ("C:\\a.xml#M", uri("C:/a.xml", Some("M"))),
            ("file:./a.xml", uri("./a.xml", None)),
            ("  ", Err(UriError::Empty)),
            (
                "\"\\folder\\x.xml\"#Pou_x",
                Err(UriError::Malformed("\"\\folder\\x.xml\"#Pou_x".into())),
            ),
            (
                "http://a/b.xml",
                Err(UriError::Scheme("http://a/b.xml".into())),
            ),
            (
                "file://host/b.xml",
                Err(UriError::Scheme("file://host/b.xml".into())),
            ),
            ("a%2.xml", Err(UriError::Escape("a%2.xml".into()))),
            ("a%ff.xml", Err(UriError::Escape("a%ff.xml".into()))),
            ("#Pou", Err(UriError::Malformed("#Pou".into()))),
        ] {
            assert_eq!(parse(text), expected, "{text}");
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(path in "[a-zA-Z0-9 äß%#?_./-]{1,20}") {
            let written = format!("{}#Pou", percent_encoded(&path));
            let read = parse(&written).unwrap();
            prop_assert_eq!(read.path, path);
        }

        #[test]
        fn no_text_panics(text in "\\PC{0,40}") {
            let _ = parse(&text);
        }
    }
}
