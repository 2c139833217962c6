//! The layout of an MC's memory as tools see it: regions, variables by their dotted path, initial bytes.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

use crate::check::tree::TypedProject;
use crate::diag::Diagnostic;
use crate::plan::Plan;
use crate::types::Elem;

/// What is compiled: the program that runs once a scan, and how its memory is grouped.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CompileSpec {
    /// Program run once a scan.
    pub entry: String,
    pub regions: Vec<RegionSpec>,
    /// The images of inputs and outputs have at least this many bytes, whatever is declared.
    pub input_bytes_min: u32,
    pub output_bytes_min: u32,
}

/// A region: programs, then global variables, then `%M` if it has the markers, contiguous and in this order. What is named in no
/// region goes to the last one, `work`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RegionSpec {
    pub name: String,
    pub programs: Vec<String>,
    pub globals: Vec<String>,
    /// Whether the variables at `%M` lie here.
    pub markers: bool,
}

/// Name of the region that holds what no specification names.
pub const WORK_REGION: &str = "work";

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Region {
    pub name: String,
    /// Address in linear memory.
    pub offset: u32,
    pub len: u32,
}

/// Where a variable lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Area {
    /// Number of the region in `Layout::regions`.
    Region(usize),
    Inputs,
    Outputs,
}

/// The shape of a variable.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TypeNode {
    Elem(Elem),
    Enum {
        name: String,
        base: Elem,
        values: Vec<(String, i64)>,
    },
    Subrange {
        base: Elem,
        lo: i64,
        hi: i64,
    },
    /// STRING or WSTRING: its length (4 bytes), then its characters.
    Text {
        wide: bool,
        len: u32,
    },
    Array {
        /// Lower and upper bound of each dimension; the last index varies fastest.
        dims: Vec<(i64, i64)>,
        /// Bytes from one element to the next.
        stride: u32,
        elem: Arc<TypeNode>,
    },
    /// A structure, or an instance of a function block.
    Struct {
        name: String,
        fields: Vec<FieldNode>,
    },
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FieldNode {
    pub name: String,
    pub offset: u32,
    pub len: u32,
    /// In the process image, of a BOOL its bit, of an array of them the bit of its first element.
    pub bit: Option<u8>,
    pub retain: bool,
    pub ty: Arc<TypeNode>,
}

impl TypeNode {
    /// The elementary type of a scalar.
    pub fn elem(&self) -> Option<Elem> {
        match self {
            TypeNode::Elem(e) => Some(*e),
            TypeNode::Enum { base, .. } | TypeNode::Subrange { base, .. } => Some(*base),
            _ => None,
        }
    }

    pub fn is_scalar(&self) -> bool {
        self.elem().is_some()
    }

    fn describe(&self, out: &mut String) {
        match self {
            TypeNode::Elem(e) => out.push_str(e.name()),
            TypeNode::Enum { base, values, .. } => {
                out.push_str(&format!("{base}{values:?}"));
            }
            TypeNode::Subrange { base, lo, hi } => out.push_str(&format!("{base}({lo}..{hi})")),
            TypeNode::Text { wide, len } => {
                out.push_str(&format!(
                    "{}[{len}]",
                    if *wide { "WSTRING" } else { "STRING" }
                ));
            }
            TypeNode::Array { dims, stride, elem } => {
                out.push_str(&format!("{dims:?}/{stride} "));
                elem.describe(out);
            }
            TypeNode::Struct { fields, .. } => {
                out.push('{');
                for field in fields {
                    out.push_str(&format!(
                        "{}@{} ",
                        field.name.to_ascii_uppercase(),
                        field.offset
                    ));
                    if let Some(bit) = field.bit {
                        out.push_str(&format!(".{bit} "));
                    }
                    field.ty.describe(out);
                    out.push(';');
                }
                out.push('}');
            }
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VariableInfo {
    /// `MC1.timer.ET`, `MC1.a[3].x`, or the bare name of a global variable.
    pub path: String,
    pub area: Area,
    /// Bytes from the start of the area.
    pub offset: u32,
    /// For a BOOL in the inputs or outputs: its bit; for an array of them the bit of its first element.
    pub bit: Option<u8>,
    /// Bytes that it takes there.
    pub len: u32,
    pub ty: Arc<TypeNode>,
    pub retain: bool,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Layout {
    /// As specified; the last one is `work`.
    pub regions: Vec<Region>,
    pub inputs: Region,
    pub outputs: Region,
    /// All variables with structures and instances taken apart; arrays stand whole (see `leaves`).
    pub variables: Vec<VariableInfo>,
    /// The same before they are taken apart: the variables of programs and the global variables.
    pub roots: Vec<VariableInfo>,
    /// Initial bytes of each region.
    pub initial: Vec<Vec<u8>>,
    /// Initial bytes of the outputs.
    pub initial_outputs: Vec<u8>,
}

impl Layout {
    pub fn region(&self, name: &str) -> Option<&Region> {
        self.regions.iter().find(|r| r.name == name)
    }

    pub fn region_index(&self, name: &str) -> Option<usize> {
        self.regions.iter().position(|r| r.name == name)
    }

    /// The variable of this path, without regard to case; indices must be numbers: `MC1.a[3].x`, `m[1,2]`.
    pub fn find(&self, path: &str) -> Option<VariableInfo> {
        let names = path.len() - path.find('[').map_or(0, |at| path.len() - at);
        let mut best: Option<&VariableInfo> = None;
        for root in &self.roots {
            let len = root.path.len();
            let fits = len <= names
                && path.is_char_boundary(len)
                && path[..len].eq_ignore_ascii_case(&root.path)
                && matches!(path.as_bytes().get(len), None | Some(b'.' | b'['));
            if fits && best.is_none_or(|b| b.path.len() < len) {
                best = Some(root);
            }
        }
        let root = best?;
        let mut info = root.clone();
        let mut rest = &path[root.path.len()..];
        while !rest.is_empty() {
            if let Some(tail) = rest.strip_prefix('.') {
                let end = tail.find(['.', '[']).unwrap_or(tail.len());
                info = info.field(&tail[..end])?;
                rest = &tail[end..];
            } else {
                let (inside, tail) = rest.strip_prefix('[')?.split_once(']')?;
                let indices: Option<Vec<i64>> =
                    inside.split(',').map(|i| i.trim().parse().ok()).collect();
                info = info.element(&indices?)?;
                rest = tail;
            }
        }
        Some(info)
    }

    /// The scalars that a variable is made of: itself, or its fields and elements in the order of memory.
    pub fn leaves(&self, variable: &VariableInfo) -> Vec<VariableInfo> {
        let mut out = Vec::new();
        variable.expand(true, &mut out);
        out
    }

    /// Changes when any variable, offset or type changes.
    pub fn hash(&self) -> u64 {
        let mut hasher = Xxh3::new();
        let mut text = String::new();
        for region in self.regions.iter().chain([&self.inputs, &self.outputs]) {
            text.push_str(&format!("{}:{};", region.name, region.len));
        }
        for root in &self.roots {
            let path = root.path.to_ascii_uppercase();
            text.push_str(&format!(
                "{path}|{:?}|{}|{:?}|{}|",
                root.area, root.offset, root.bit, root.retain
            ));
            root.ty.describe(&mut text);
            text.push('\n');
            hasher.update(text.as_bytes());
            text.clear();
        }
        hasher.update(text.as_bytes());
        hasher.digest()
    }

    /// The area's place in linear memory.
    pub fn area(&self, area: Area) -> &Region {
        match area {
            Area::Region(index) => &self.regions[index],
            Area::Inputs => &self.inputs,
            Area::Outputs => &self.outputs,
        }
    }
}

impl VariableInfo {
    /// A field of a structure or instance, without regard to case.
    pub fn field(&self, name: &str) -> Option<VariableInfo> {
        let TypeNode::Struct { fields, .. } = &*self.ty else {
            return None;
        };
        let field = fields.iter().find(|f| f.name.eq_ignore_ascii_case(name))?;
        Some(self.part(field))
    }

    fn part(&self, field: &FieldNode) -> VariableInfo {
        VariableInfo {
            path: format!("{}.{}", self.path, field.name),
            offset: self.offset + field.offset,
            bit: field.bit,
            len: field.len,
            ty: field.ty.clone(),
            retain: self.retain || field.retain,
            ..*self
        }
    }

    /// An element of an array.
    pub fn element(&self, indices: &[i64]) -> Option<VariableInfo> {
        let TypeNode::Array { dims, stride, elem } = &*self.ty else {
            return None;
        };
        if dims.len() != indices.len() {
            return None;
        }
        let mut number: i64 = 0;
        for (index, (lo, hi)) in indices.iter().zip(dims) {
            if index < lo || index > hi {
                return None;
            }
            number = number * (hi - lo + 1) + (index - lo);
        }
        let texts: Vec<String> = indices.iter().map(i64::to_string).collect();
        let path = format!("{}[{}]", self.path, texts.join(","));
        if let Some(first) = self.bit {
            // Bits of the process image, side by side.
            let at = i64::from(first) + number;
            return Some(VariableInfo {
                path,
                offset: self.offset + (at / 8) as u32,
                bit: Some((at % 8) as u8),
                len: 1,
                ty: elem.clone(),
                ..*self
            });
        }
        Some(VariableInfo {
            path,
            offset: self.offset + number as u32 * stride,
            len: *stride,
            ty: elem.clone(),
            ..*self
        })
    }

    pub(crate) fn expand(&self, arrays: bool, out: &mut Vec<VariableInfo>) {
        match &*self.ty {
            TypeNode::Struct { fields, .. } => {
                for field in fields {
                    self.part(field).expand(arrays, out);
                }
            }
            TypeNode::Array { dims, .. } if arrays => {
                let mut indices: Vec<i64> = dims.iter().map(|d| d.0).collect();
                loop {
                    if let Some(element) = self.element(&indices) {
                        element.expand(arrays, out);
                    }
                    let mut at = dims.len();
                    loop {
                        if at == 0 {
                            return;
                        }
                        at -= 1;
                        if indices[at] < dims[at].1 {
                            indices[at] += 1;
                            break;
                        }
                        indices[at] = dims[at].0;
                    }
                }
            }
            _ => out.push(self.clone()),
        }
    }
}

/// Works out the layout without generating code.
pub fn layout_of(project: &TypedProject, spec: &CompileSpec) -> Result<Layout, Vec<Diagnostic>> {
    Plan::new(project, spec).map(|plan| plan.layout)
}
