//! A thin layer over the XML writer: elements with attributes, indented, the same bytes for the same calls.

use quick_xml::Writer;
use quick_xml::events::{BytesCData, BytesDecl, BytesEnd, BytesStart, BytesText, Event};

/// An XML document in the making.
pub struct Xml {
    writer: Writer<Vec<u8>>,
    open: Vec<String>,
}

impl Default for Xml {
    fn default() -> Xml {
        Xml::new()
    }
}

impl Xml {
    /// A document with its declaration.
    #[must_use]
    pub fn new() -> Xml {
        let mut xml = Xml {
            writer: Writer::new_with_indent(Vec::new(), b' ', 2),
            open: Vec::new(),
        };
        xml.event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)));
        xml
    }

    /// A part of a document, to be put into one with [`Xml::raw`].
    #[must_use]
    pub fn fragment() -> Xml {
        Xml {
            writer: Writer::new_with_indent(Vec::new(), b' ', 2),
            open: Vec::new(),
        }
    }

    /// Puts in a fragment, indented to its place. Texts within it keep their lines as they are only in CDATA.
    pub fn raw(&mut self, fragment: &str) {
        let indent = "  ".repeat(self.open.len());
        let mut out = String::with_capacity(fragment.len() + 64);
        let mut in_cdata = false;
        for line in fragment.trim_end().lines() {
            out.push('\n');
            if !in_cdata {
                out.push_str(&indent);
            }
            out.push_str(line);
            in_cdata = match (line.rfind("<![CDATA["), line.rfind("]]>")) {
                (Some(start), Some(end)) => start > end,
                (Some(_), None) => true,
                (None, Some(_)) => false,
                (None, None) => in_cdata,
            };
        }
        self.writer.get_mut().extend_from_slice(out.as_bytes());
    }

    fn event(&mut self, event: Event<'_>) {
        self.writer
            .write_event(event)
            .expect("writing to memory does not fail");
    }

    fn start(name: &str, attributes: &[(&str, &str)]) -> BytesStart<'static> {
        let mut start = BytesStart::new(name.to_owned());
        for (key, value) in attributes {
            start.push_attribute((*key, *value));
        }
        start
    }

    /// Opens an element.
    pub fn open(&mut self, name: &str, attributes: &[(&str, &str)]) {
        self.event(Event::Start(Self::start(name, attributes)));
        self.open.push(name.to_owned());
    }

    /// Closes the element opened last.
    pub fn close(&mut self) {
        let name = self.open.pop().expect("an element is open");
        self.event(Event::End(BytesEnd::new(name)));
    }

    /// An element without content.
    pub fn empty(&mut self, name: &str, attributes: &[(&str, &str)]) {
        self.event(Event::Empty(Self::start(name, attributes)));
    }

    /// An element with text.
    pub fn text(&mut self, name: &str, text: &str) {
        self.event(Event::Start(Self::start(name, &[])));
        self.event(Event::Text(BytesText::new(text)));
        self.event(Event::End(BytesEnd::new(name.to_owned())));
    }

    /// An element with a text that people read and that is full of `<` and `&`.
    pub fn cdata(&mut self, name: &str, text: &str) {
        self.cdata_with(name, &[], text);
    }

    /// The same with attributes.
    pub fn cdata_with(&mut self, name: &str, attributes: &[(&str, &str)], text: &str) {
        self.event(Event::Start(Self::start(name, attributes)));
        for part in BytesCData::escaped(text) {
            self.event(Event::CData(part));
        }
        self.event(Event::End(BytesEnd::new(name.to_owned())));
    }

    /// The document.
    #[must_use]
    pub fn finish(self) -> String {
        assert!(self.open.is_empty(), "elements are open: {:?}", self.open);
        let mut text =
            String::from_utf8(self.writer.into_inner()).expect("only texts have been written");
        text.push('\n');
        text
    }
}
