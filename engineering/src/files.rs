//! The files of a model: read from its folder or out of its container, with a limit on their size.
//!
//! An AutomationML model may come from anybody, so that what it refers to stays within its folder, or within the one that its
//! user names as root. A `cell.toml` is written by whoever runs it and may name any file, unless a root is named.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Largest file that is read, in bytes.
pub const FILE_BYTES_MAX: u64 = 64 << 20;

/// Why a file could not be had.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FileError {
    /// It lies outside.
    #[error("`{0}` leaves the model's folder")]
    Leaves(String),
    /// Not there, or not readable.
    #[error("`{path}` cannot be read: {why}")]
    Unreadable {
        /// As the model names it.
        path: String,
        /// What the system says.
        why: String,
    },
    /// Too large.
    #[error("`{path}` has {mb} MB, more than the {max_mb} MB that are read")]
    TooLarge {
        /// As the model names it.
        path: String,
        /// Its size.
        mb: u64,
        /// The limit.
        max_mb: u64,
    },
    /// Not a text.
    #[error("`{0}` is no text in UTF-8 or UTF-16")]
    NotText(String),
}

impl FileError {
    /// What to do.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            FileError::Leaves(_) => {
                "copy the file into the model's folder, or name the folder that holds both with `--root DIR`"
            }
            FileError::Unreadable { .. } => {
                "paths are relative to the file that names them, also after `file:///`"
            }
            FileError::TooLarge { .. } => "divide it, or leave out what is no control logic",
            FileError::NotText(_) => "save it as UTF-8",
        }
    }
}

/// A model file, and how far its references may lead.
#[derive(Debug, Clone, Copy)]
pub struct ModelAt<'a> {
    /// The model.
    pub file: &'a Path,
    /// The folder within which everything lies that it refers to: `--root`. Without one an AutomationML model is kept to its own
    /// folder, and a `cell.toml` to none.
    pub root: Option<&'a Path>,
}

impl<'a, P: AsRef<Path> + ?Sized> From<&'a P> for ModelAt<'a> {
    fn from(file: &'a P) -> ModelAt<'a> {
        ModelAt {
            file: file.as_ref(),
            root: None,
        }
    }
}

/// Path of a file below a root, as [`ModelFiles::within`] takes it; `None` if it lies elsewhere.
///
/// # Errors
/// A root or a folder of the file that is not there.
pub fn below(root: &Path, file: &Path) -> std::io::Result<Option<String>> {
    let folder = match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let (root, folder) = (root.canonicalize()?, folder.canonicalize()?);
    let Ok(inside) = folder.strip_prefix(&root) else {
        return Ok(None);
    };
    let mut parts: Vec<String> = inside
        .components()
        .map(|c| c.as_os_str().to_string_lossy().into_owned())
        .collect();
    if let Some(name) = file.file_name() {
        parts.push(name.to_string_lossy().into_owned());
    }
    Ok(Some(parts.join("/")))
}

/// What a file is, by its content.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileKind {
    /// A model: AutomationML or `cell.toml`; also what cannot be read, for its reader says what is wrong with it.
    Model,
    /// Logic in Structured Text.
    StructuredText,
    /// Logic in PLCopen XML.
    PlcopenXml,
}

/// What a file is. A container is a model; so is a folder, a file that is too large, and one without anything in it.
#[must_use]
pub fn kind_of(file: &Path) -> FileKind {
    const HEAD: usize = 4096;
    let ending = file.extension().map(|e| e.to_ascii_lowercase());
    let is_logic = |endings: &[&str]| {
        endings
            .iter()
            .any(|e| ending.as_deref() == Some(e.as_ref()))
    };
    let Ok(bytes) = bounded(file, "") else {
        return FileKind::Model;
    };
    if bytes.starts_with(b"PK\x03\x04") {
        return FileKind::Model;
    }
    // Old logic comes in codes of one byte; its letters mean nothing for what it is.
    let text = decoded(bytes.clone());
    let text = text.unwrap_or_else(|| bytes.into_iter().map(char::from).collect());
    let start = text.trim_start();
    if start.starts_with('<') {
        let head: String = start.chars().take(HEAD).collect();
        return match head.contains("CAEXFile") {
            true => FileKind::Model,
            false => FileKind::PlcopenXml,
        };
    }
    let is_st = is_logic(&["st", "iecst", "exp"]);
    match is_logic(&["toml", "aml", "amlx"]) || !is_st && text.parse::<toml::Table>().is_ok() {
        true => FileKind::Model,
        false => FileKind::StructuredText,
    }
}

/// The text of a file of logic.
///
/// # Errors
/// [`FileError`].
pub fn text_of(file: &Path) -> Result<String, FileError> {
    let name = file.display().to_string();
    decoded(bounded(file, &name)?).ok_or(FileError::NotText(name))
}

/// Where a model's files are.
#[derive(Debug, Clone)]
pub struct ModelFiles {
    place: Place,
    /// Folder below that place which paths are relative to.
    prefix: String,
    /// Files that were made from others, by their name.
    made: BTreeMap<String, String>,
}

#[derive(Debug, Clone)]
enum Place {
    /// A folder; with TRUE nothing outside it is read.
    Folder(PathBuf, bool),
    /// Parts of a container, by their normalised path.
    Parts(Arc<BTreeMap<String, Vec<u8>>>),
}

impl ModelFiles {
    /// Of a folder, and of whatever a path leads to from there.
    #[must_use]
    pub fn anywhere(folder: &Path) -> ModelFiles {
        ModelFiles {
            place: Place::Folder(folder.to_owned(), false),
            prefix: String::new(),
            made: BTreeMap::new(),
        }
    }

    /// Of a folder and the ones below it.
    #[must_use]
    pub fn within(folder: &Path) -> ModelFiles {
        ModelFiles {
            place: Place::Folder(folder.to_owned(), true),
            prefix: String::new(),
            made: BTreeMap::new(),
        }
    }

    /// With paths relative to a folder below that one.
    #[must_use]
    pub fn from(self, prefix: &str) -> ModelFiles {
        ModelFiles {
            prefix: prefix.to_owned(),
            ..self
        }
    }

    /// Of a container.
    #[must_use]
    pub fn parts(parts: BTreeMap<String, Vec<u8>>) -> ModelFiles {
        ModelFiles {
            place: Place::Parts(Arc::new(parts)),
            prefix: String::new(),
            made: BTreeMap::new(),
        }
    }

    /// Adds a file that stands nowhere.
    pub fn make(&mut self, name: &str, text: String) {
        self.made.insert(name.to_owned(), text);
    }

    /// A text, without a byte order mark.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn read(&self, path: &str) -> Result<String, FileError> {
        if let Some(made) = self.made.get(path) {
            return Ok(made.clone());
        }
        decoded(self.bytes(path)?).ok_or_else(|| FileError::NotText(path.to_owned()))
    }

    fn bytes(&self, path: &str) -> Result<Vec<u8>, FileError> {
        match &self.place {
            Place::Parts(parts) => {
                let name = join("", path)?;
                let found = parts.get(&name).ok_or_else(|| FileError::Unreadable {
                    path: path.to_owned(),
                    why: "the container has no such part".to_owned(),
                })?;
                Ok(found.clone())
            }
            Place::Folder(folder, false) => bounded(&folder.join(path), path),
            Place::Folder(folder, true) => {
                let inside = folder.join(join(&self.prefix, path)?);
                let unreadable = |e: std::io::Error| FileError::Unreadable {
                    path: path.to_owned(),
                    why: e.to_string(),
                };
                // A symbolic link may lead out of a folder that the path does not leave.
                let base = if folder.as_os_str().is_empty() {
                    Path::new(".")
                } else {
                    folder
                };
                let real = inside.canonicalize().map_err(unreadable)?;
                if !real.starts_with(base.canonicalize().map_err(unreadable)?) {
                    return Err(FileError::Leaves(path.to_owned()));
                }
                bounded(&real, path)
            }
        }
    }
}

/// The text of a file, without a byte order mark: UTF-8, UTF-16 with a mark or an XML file's `<` at its begin, or the
/// one-byte code that an XML declaration names.
#[must_use]
pub fn decoded(bytes: Vec<u8>) -> Option<String> {
    let utf16 = |bytes: &[u8], unit: fn([u8; 2]) -> u16| {
        let units = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]]));
        let whole = bytes.len().is_multiple_of(2);
        let text: Result<String, _> = char::decode_utf16(units).collect();
        text.ok().filter(|_| whole)
    };
    match bytes.as_slice() {
        [0xff, 0xfe, rest @ ..] => return utf16(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => return utf16(rest, u16::from_be_bytes),
        [b'<', 0, ..] => return utf16(&bytes, u16::from_le_bytes),
        [0, b'<', ..] => return utf16(&bytes, u16::from_be_bytes),
        _ => {}
    }
    match String::from_utf8(bytes) {
        Ok(mut text) => {
            if text.starts_with('\u{feff}') {
                text.drain(..'\u{feff}'.len_utf8());
            }
            Some(text)
        }
        Err(e) => one_byte(e.as_bytes()),
    }
}

/// ISO 8859-1, and what Windows puts into its gap: XML if its declaration says so, and whatever has no control
/// characters.
fn one_byte(bytes: &[u8]) -> Option<String> {
    const DECLARATION_MAX: usize = 200;
    const GAP: &str = "€\u{81}‚ƒ„…†‡ˆ‰Š‹Œ\u{8d}Ž\u{8f}\u{90}‘’“”•–—˜™š›œ\u{9d}žŸ";
    let head = bytes.get(..bytes.len().min(DECLARATION_MAX))?;
    let head = String::from_utf8_lossy(head).to_ascii_lowercase();
    if head.trim_start().starts_with('<') {
        let declaration = head.strip_prefix("<?xml")?.split_once("?>")?.0.to_owned();
        let known = ["iso-8859-1", "latin1", "windows-1252", "us-ascii"];
        known.iter().find(|name| declaration.contains(**name))?;
    } else if bytes
        .iter()
        .any(|b| *b < b' ' && !b"\t\n\x0c\r\x1a".contains(b))
    {
        return None;
    }
    let gap: Vec<char> = GAP.chars().collect();
    let char_of = |byte: &u8| match byte {
        0x80..=0x9f => gap[usize::from(byte - 0x80)],
        byte => char::from(*byte),
    };
    Some(bytes.iter().map(char_of).collect())
}

/// Reads a file that is not larger than [`FILE_BYTES_MAX`].
fn bounded(file: &Path, path: &str) -> Result<Vec<u8>, FileError> {
    let unreadable = |e: std::io::Error| FileError::Unreadable {
        path: path.to_owned(),
        why: e.to_string(),
    };
    let opened = std::fs::File::open(file).map_err(unreadable)?;
    let len = opened.metadata().map_err(unreadable)?.len();
    let too_large = |len: u64| FileError::TooLarge {
        path: path.to_owned(),
        mb: len >> 20,
        max_mb: FILE_BYTES_MAX >> 20,
    };
    if len > FILE_BYTES_MAX {
        return Err(too_large(len));
    }
    let mut bytes = Vec::new();
    // A device or a growing file says less than it has.
    let read = opened
        .take(FILE_BYTES_MAX + 1)
        .read_to_end(&mut bytes)
        .map_err(unreadable)?;
    if read as u64 > FILE_BYTES_MAX {
        return Err(too_large(read as u64));
    }
    Ok(bytes)
}

/// A path that stands in a file of the folder `from` as one relative to the model's folder: `/` between parts, no `.` and no `..`.
///
/// # Errors
/// [`FileError::Leaves`].
pub fn join(from: &str, path: &str) -> Result<String, FileError> {
    let leaves = || FileError::Leaves(path.to_owned());
    let drive = path.as_bytes().get(1) == Some(&b':');
    if path.starts_with('/') || drive || path.contains('\0') {
        return Err(leaves());
    }
    let mut parts: Vec<&str> = from.split('/').filter(|p| !p.is_empty()).collect();
    for part in path.split('/') {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop().ok_or_else(leaves)?;
            }
            name => parts.push(name),
        }
    }
    Ok(parts.join("/"))
}

/// The folder of a path.
#[must_use]
pub fn folder_of(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logic_is_read_in_the_codes_that_tools_write() {
        let text = "(* Größe in € *)\n";
        let utf16 = |mark: u16, unit: fn(u16) -> [u8; 2]| -> Vec<u8> {
            let units = std::iter::once(mark).chain(text.encode_utf16());
            units.flat_map(unit).collect()
        };
        let windows = b"(* Gr\xf6\xdfe in \x80 *)\n".to_vec();
        let marked = format!("\u{feff}{text}").into_bytes();
        for bytes in [
            text.as_bytes().to_vec(),
            marked,
            utf16(0xfeff, u16::to_le_bytes),
            utf16(0xfeff, u16::to_be_bytes),
            windows,
        ] {
            assert_eq!(decoded(bytes.clone()).as_deref(), Some(text), "{bytes:x?}");
        }
        for no_text in [
            b"\x7fELF\x00\xff".to_vec(),
            b"<x>\xff</x>".to_vec(),
            vec![0xff, 0xfe, 0x41],
        ] {
            assert_eq!(decoded(no_text.clone()), None, "{no_text:x?}");
        }
    }

    #[test]
    fn paths_are_normalised_and_kept_inside() {
        assert_eq!(join("", "logic/./a.xml").unwrap(), "logic/a.xml");
        assert_eq!(join("lib", "../logic//a.xml").unwrap(), "logic/a.xml");
        for path in ["../a.xml", "a/../../b.xml", "/etc/passwd", "C:/a.xml"] {
            assert_eq!(join("", path), Err(FileError::Leaves(path.to_owned())));
        }
    }

    #[test]
    fn a_link_out_of_the_folder_is_not_followed() {
        let outside = tempfile::tempdir().unwrap();
        std::fs::write(outside.path().join("secret"), "x").unwrap();
        let folder = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink(outside.path(), folder.path().join("link")).unwrap();
        let files = ModelFiles::within(folder.path());
        assert_eq!(
            files.read("link/secret"),
            Err(FileError::Leaves("link/secret".to_owned()))
        );
        assert_eq!(
            ModelFiles::anywhere(folder.path()).read("link/secret"),
            Ok("x".to_owned())
        );
    }

    #[test]
    fn a_file_that_is_too_large_is_refused_before_it_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = std::fs::File::create(folder.path().join("big.xml")).unwrap();
        file.set_len(300 << 20).unwrap();
        let error = ModelFiles::within(folder.path())
            .read("big.xml")
            .unwrap_err();
        assert_eq!(
            error.to_string(),
            "`big.xml` has 300 MB, more than the 64 MB that are read"
        );
    }
}
