//! The diagnosis file of an MC (XML): where its state's variables lie, and what an interruption is answered with.
//!
//! After the flexible-automation paper (section IV): variables with name, type and offset; for each critical interval its masks
//! (a disjunctive normal form: the interval holds if all masks of one row hold), kind, recovery action and checkpoint state.

use super::xml::Xml;
use crate::build::BuiltMc;
use fam_proto::diagnosis::{
    CriticalInterval, Diagnosis, IntervalKind, Mask, MaskOperand, MaskOperator, MaskType,
    MaskVariable,
};
use roxmltree::{Document, Node};
use std::str::FromStr;

/// Namespace of the file.
pub const NAMESPACE: &str = "urn:fam:diagnosis:1";

const OPERATORS: [(MaskOperator, &str); 6] = [
    (MaskOperator::Equal, "eq"),
    (MaskOperator::NotEqual, "ne"),
    (MaskOperator::Less, "lt"),
    (MaskOperator::LessOrEqual, "le"),
    (MaskOperator::Greater, "gt"),
    (MaskOperator::GreaterOrEqual, "ge"),
];

/// Writes the file.
#[must_use]
pub fn write(mc: &BuiltMc) -> String {
    let diagnosis = &mc.diagnosis;
    let mut xml = Xml::new();
    let stop = diagnosis.stop_action.map(|n| n.to_string());
    let numbers = [
        diagnosis.state_offset.to_string(),
        (diagnosis.checkpoint_len - diagnosis.state_offset).to_string(),
        diagnosis.checkpoint_len.to_string(),
    ];
    let mut attributes = vec![
        ("xmlns", NAMESPACE),
        ("mc", mc.mc.as_str()),
        ("stateOffset", &numbers[0]),
        ("stateLength", &numbers[1]),
        ("checkpointLength", &numbers[2]),
    ];
    if let Some(stop) = &stop {
        attributes.push(("stopAction", stop));
    }
    xml.open("diagnosis", &attributes);
    xml.open("state", &[]);
    for variable in &mc.state_variables {
        let offset = variable.offset.to_string();
        xml.empty(
            "variable",
            &[
                ("name", &variable.path),
                ("type", &variable.type_name),
                ("offset", &offset),
            ],
        );
    }
    xml.close();
    for (interval, text) in diagnosis.intervals.iter().zip(&mc.intervals) {
        let action = interval.action.to_string();
        xml.open(
            "criticalInterval",
            &[
                ("name", &interval.name),
                ("kind", kind_text(interval.kind)),
                ("action", &action),
                ("pou", &interval.pou),
                (
                    "repeatable",
                    if interval.repeatable { "true" } else { "false" },
                ),
            ],
        );
        xml.text("condition", &text.condition);
        for row in &interval.rows {
            xml.open("row", &[]);
            for mask in row {
                write_mask(&mut xml, mask);
            }
            xml.close();
        }
        if !text.checkpoint_state.is_empty() {
            xml.open("checkpointState", &[]);
            for (variable, value) in &text.checkpoint_state {
                xml.empty("set", &[("variable", variable), ("value", value)]);
            }
            xml.close();
        }
        xml.close();
    }
    xml.close();
    xml.finish()
}

fn kind_text(kind: IntervalKind) -> &'static str {
    match kind {
        IntervalKind::Checkpoint => "checkpoint",
        IntervalKind::Unrecoverable => "unrecoverable",
    }
}

fn type_text(of: MaskType) -> String {
    match of {
        MaskType::Unsigned(n) => format!("u{}", u32::from(n) * 8),
        MaskType::Signed(n) => format!("i{}", u32::from(n) * 8),
        MaskType::Real(n) => format!("f{}", u32::from(n) * 8),
    }
}

fn write_mask(xml: &mut Xml, mask: &Mask) {
    let (offset, of) = (mask.left.offset.to_string(), type_text(mask.left.of));
    let operator = OPERATORS
        .iter()
        .find(|(o, _)| *o == mask.operator)
        .map_or("eq", |(_, t)| t);
    let bits = format!("{:x}", mask.bits);
    let mut attributes = vec![("offset", offset.as_str()), ("type", &of)];
    if mask.bits != u64::MAX {
        attributes.push(("bits", &bits));
    }
    attributes.push(("operator", operator));
    let (right, right_of);
    match mask.right {
        MaskOperand::Integer(value) => {
            right = value.to_string();
            attributes.push(("value", &right));
        }
        MaskOperand::RealBits(value) => {
            right = format!("{value:016x}");
            let shown = format!("{:?}", f64::from_bits(value));
            attributes.push(("realBits", &right));
            attributes.push(("shown", &shown));
            return xml.empty("mask", &attributes);
        }
        MaskOperand::Variable(variable) => {
            right = variable.offset.to_string();
            right_of = type_text(variable.of);
            attributes.push(("otherOffset", &right));
            attributes.push(("otherType", &right_of));
        }
    }
    xml.empty("mask", &attributes);
}

/// Why a diagnosis file could not be read.
#[derive(Debug, thiserror::Error)]
pub enum DiagnosisFileError {
    /// Not XML.
    #[error("the diagnosis file is no XML: {0}")]
    Xml(#[from] roxmltree::Error),
    /// XML of another kind, or of another version.
    #[error(
        "this is no diagnosis file of this version (its root is `{found}`, expected `diagnosis` in {NAMESPACE})"
    )]
    Foreign {
        /// The root element.
        found: String,
    },
    /// An attribute is missing or wrong.
    #[error(
        "diagnosis file, line {line}: the element `{element}` needs an attribute `{attribute}` with {expected}"
    )]
    Attribute {
        /// Line.
        line: u32,
        /// Element.
        element: String,
        /// Attribute.
        attribute: &'static str,
        /// What was expected.
        expected: &'static str,
    },
}

/// Reads what an MC Agent needs. The inverse of [`write()`].
///
/// # Errors
/// [`DiagnosisFileError`] with the place of what is wrong.
pub fn read(text: &str) -> Result<Diagnosis, DiagnosisFileError> {
    let document = Document::parse(text)?;
    let root = document.root_element();
    if !root.has_tag_name((NAMESPACE, "diagnosis")) {
        return Err(DiagnosisFileError::Foreign {
            found: root.tag_name().name().to_owned(),
        });
    }
    let stop_action = match root.attribute("stopAction") {
        Some(_) => Some(number(root, "stopAction")?),
        None => None,
    };
    let mut intervals = Vec::new();
    for node in elements(root, "criticalInterval") {
        let mut rows = Vec::new();
        for row in elements(node, "row") {
            let masks: Result<Vec<Mask>, _> = elements(row, "mask").map(read_mask).collect();
            rows.push(masks?);
        }
        let kind = match node.attribute("kind") {
            Some("checkpoint") => IntervalKind::Checkpoint,
            Some("unrecoverable") => IntervalKind::Unrecoverable,
            _ => return Err(wrong(node, "kind", "checkpoint or unrecoverable")),
        };
        let repeatable = match node.attribute("repeatable") {
            Some("true") => true,
            Some("false") => false,
            _ => return Err(wrong(node, "repeatable", "true or false")),
        };
        intervals.push(CriticalInterval {
            name: node
                .attribute("name")
                .ok_or_else(|| wrong(node, "name", "a name"))?
                .to_owned(),
            rows,
            kind,
            action: number(node, "action")?,
            pou: node
                .attribute("pou")
                .ok_or_else(|| wrong(node, "pou", "a POU"))?
                .to_owned(),
            repeatable,
        });
    }
    Ok(Diagnosis {
        state_offset: number(root, "stateOffset")?,
        checkpoint_len: number(root, "checkpointLength")?,
        intervals,
        stop_action,
    })
}

fn elements<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children()
        .filter(move |n| n.has_tag_name((NAMESPACE, name)))
}

fn wrong(
    node: Node<'_, '_>,
    attribute: &'static str,
    expected: &'static str,
) -> DiagnosisFileError {
    DiagnosisFileError::Attribute {
        line: node.document().text_pos_at(node.range().start).row,
        element: node.tag_name().name().to_owned(),
        attribute,
        expected,
    }
}

fn number<T: FromStr>(
    node: Node<'_, '_>,
    attribute: &'static str,
) -> Result<T, DiagnosisFileError> {
    node.attribute(attribute)
        .and_then(|t| t.parse().ok())
        .ok_or_else(|| wrong(node, attribute, "a whole number"))
}

fn mask_type(node: Node<'_, '_>, attribute: &'static str) -> Result<MaskType, DiagnosisFileError> {
    let error = || wrong(node, attribute, "u8, u16, u32, u64, i8 to i64, f32 or f64");
    let text = node.attribute(attribute).ok_or_else(error)?;
    let bytes = match text.get(1..) {
        Some("8") => 1,
        Some("16") => 2,
        Some("32") => 4,
        Some("64") => 8,
        _ => return Err(error()),
    };
    match (text.as_bytes()[0], bytes) {
        (b'u', n) => Ok(MaskType::Unsigned(n)),
        (b'i', n) => Ok(MaskType::Signed(n)),
        (b'f', n @ (4 | 8)) => Ok(MaskType::Real(n)),
        _ => Err(error()),
    }
}

fn read_mask(node: Node<'_, '_>) -> Result<Mask, DiagnosisFileError> {
    let operator = node
        .attribute("operator")
        .and_then(|t| OPERATORS.iter().find(|(_, text)| *text == t))
        .map(|(o, _)| *o)
        .ok_or_else(|| wrong(node, "operator", "eq, ne, lt, le, gt or ge"))?;
    let hex = |attribute, expected| match node.attribute(attribute) {
        Some(text) => u64::from_str_radix(text, 16)
            .map(Some)
            .map_err(|_| wrong(node, attribute, expected)),
        None => Ok(None),
    };
    let right = if node.has_attribute("otherOffset") {
        MaskOperand::Variable(MaskVariable {
            offset: number(node, "otherOffset")?,
            of: mask_type(node, "otherType")?,
        })
    } else if let Some(bits) = hex("realBits", "16 hexadecimal digits")? {
        MaskOperand::RealBits(bits)
    } else {
        MaskOperand::Integer(number(node, "value")?)
    };
    Ok(Mask {
        left: MaskVariable {
            offset: number(node, "offset")?,
            of: mask_type(node, "type")?,
        },
        bits: hex("bits", "hexadecimal digits")?.unwrap_or(u64::MAX),
        operator,
        right,
    })
}
