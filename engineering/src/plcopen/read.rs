//! Takes one MC out of a Flexible Automation Project: its resource, types and POUs, in the order in which they were written.

use super::MC_DATA;
use fam_soft_plc::source::SourceFile;
use roxmltree::{Document, Node};

/// Why an MC could not be read from a project.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// Not XML.
    #[error("the project is no XML: {0}")]
    Xml(#[from] roxmltree::Error),
    /// The MC has no resource with its list of items.
    #[error(
        "the project has no mechatronic component `{0}`; `fam generate` writes it for the controllers that host it"
    )]
    NoMc(String),
    /// An item of the list is missing.
    #[error(
        "the project lists the {kind} `{name}` for {mc}, but does not contain it; generate the project again"
    )]
    Missing {
        /// `type` or `pou`.
        kind: &'static str,
        /// The item.
        name: String,
        /// The MC.
        mc: String,
    },
}

/// The MC's part as a project of its own.
///
/// # Errors
/// [`ReadError`].
pub fn mc_source(project: &str, mc: &str) -> Result<SourceFile, ReadError> {
    let document = Document::parse(project)?;
    let root = document.root_element();
    let named = |element: &'static str, name: &str| {
        let name = name.to_owned();
        root.descendants().find(move |n| {
            n.has_tag_name((root_namespace(root), element)) && n.attribute("name") == Some(&name)
        })
    };
    let no_mc = || ReadError::NoMc(mc.to_owned());
    let resource = named("resource", mc).ok_or_else(no_mc)?;
    let list = resource
        .descendants()
        .find(|n| n.has_tag_name((MC_DATA, "mc")))
        .ok_or_else(no_mc)?;
    let text = |node: Node<'_, '_>| project[node.range()].to_owned();
    let renames = Renamed::of(list);
    let mut parts = [String::new(), String::new()];
    for item in list.children().filter(Node::is_element) {
        let (kind, element, part) = if item.has_tag_name((MC_DATA, "type")) {
            ("type", "dataType", 0)
        } else {
            ("pou", "pou", 1)
        };
        let name = item.attribute("name").unwrap_or("");
        let node = named(element, name).ok_or_else(|| ReadError::Missing {
            kind,
            name: name.to_owned(),
            mc: mc.to_owned(),
        })?;
        parts[part].push_str(&text(node));
        parts[part].push('\n');
    }
    let header = |element| {
        root.children()
            .find(|n| n.has_tag_name((root_namespace(root), element)))
            .map(text)
            .unwrap_or_default()
    };
    let configuration = resource
        .parent()
        .and_then(|p| p.attribute("name"))
        .unwrap_or("");
    let [types, pous] = parts.map(|part| renames.undo(part));
    // What VAR_CONFIG says about this MC: the paths begin with its resource.
    let path = |n: &Node<'_, '_>| {
        let path = n.attribute("instancePathAndName").unwrap_or("");
        path.split('.').next() == Some(mc)
    };
    let lines: String = root
        .descendants()
        .filter(|n| n.has_tag_name((root_namespace(root), "configVariable")))
        .filter(path)
        .map(|n| renames.undo(text(n)) + "\n")
        .collect();
    let config_vars = if lines.is_empty() {
        lines
    } else {
        format!("<configVars>\n{lines}</configVars>\n")
    };
    Ok(SourceFile::new(
        format!("{mc}.xml"),
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
             <project xmlns=\"{}\" xmlns:xhtml=\"http://www.w3.org/1999/xhtml\">\n{}\n{}\n\
             <types>\n<dataTypes>\n{types}</dataTypes>\n<pous>\n{pous}</pous>\n</types>\n\
             <instances>\n<configurations>\n<configuration name=\"{configuration}\">\n{}\n\
             {config_vars}</configuration>\n</configurations>\n</instances>\n</project>\n",
            root_namespace(root),
            header("fileHeader"),
            header("contentHeader"),
            renames.undo(text(resource)),
        ),
    ))
}

/// Items that another MC's name stands in the way of: their names in the project and in the MC's logic. The first stands nowhere in the logic.
struct Renamed<'a>(Vec<(&'a str, &'a str)>);

impl<'a> Renamed<'a> {
    fn of(list: Node<'a, '_>) -> Self {
        let items = list.children().filter(Node::is_element);
        let names = items.filter_map(|i| Some((i.attribute("name")?, i.attribute("original")?)));
        let mut names: Vec<_> = names.filter(|(new, old)| new.len() > old.len()).collect();
        // One may be the beginning of another.
        names.sort_by_key(|(new, _)| std::cmp::Reverse(new.len()));
        Self(names)
    }

    fn undo(&self, text: String) -> String {
        let replace = |text: String, (new, old): &(&str, &str)| text.replace(new, old);
        self.0.iter().fold(text, replace)
    }
}

fn root_namespace<'a>(root: Node<'a, '_>) -> &'a str {
    root.tag_name().namespace().unwrap_or("")
}
