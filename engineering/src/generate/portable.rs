//! Serialize and Deserialize variable by variable, in IEC 61131-3 that other compilers take.
//!
//! Each variable takes the bytes that it has in the soft-PLC's memory, lowest byte first, whatever the machine: BOOL 0 or 1,
//! signed integers with their sign extended over the cell, REAL and LREAL by their bits, TIME in nanoseconds. Bytes between
//! variables stay 0. So a checkpoint goes from one form to the other.

use fam_soft_plc::check::tree::{TypedProject, VarId};
use fam_soft_plc::syntax::ast::VarSection;
use fam_soft_plc::types::{Elem, TypeId, TypeKind};
use std::fmt::Write as _;

/// The statements of both POUs.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Statements {
    /// Global variables that they use: name and type.
    pub globals: Vec<(String, String)>,
    /// Temporary variables that they need.
    pub temps: Vec<(String, &'static str)>,
    /// Body of Serialize.
    pub serialize: String,
    /// Body of Deserialize.
    pub deserialize: String,
}

/// Why a state cannot be written out.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the variable `{path}` cannot be serialized one by one: {why}")]
pub struct PortableError {
    /// The variable.
    pub path: String,
    /// What stands against it.
    pub why: String,
}

/// Offset of an elementary variable in the serialized state, by its path; `None` if it lies elsewhere.
pub type Offset<'a> = &'a dyn Fn(&str) -> Option<u32>;

/// Writes the statements for all variables of `programs` and for `globals`.
///
/// # Errors
/// [`PortableError`] for a variable whose type cannot be named or whose place is not in the state.
pub fn statements(
    project: &TypedProject,
    programs: &[String],
    globals: &[VarId],
    state: &str,
    offset: Offset<'_>,
) -> Result<Statements, PortableError> {
    let mut writer = Writer {
        project,
        state,
        offset,
        out: Statements::default(),
        loops_max: 0,
        uses: [false; 2],
    };
    for global in globals {
        let var = project.var(*global);
        writer
            .out
            .globals
            .push((var.name.clone(), project.type_name(var.ty)));
        writer.walk(&Path::root(&var.name), var.ty)?;
    }
    for program in programs {
        let Some(pou) = project.find_pou(program) else {
            continue;
        };
        let name = project.pou(pou).name.clone();
        for var in project.pou(pou).vars.clone() {
            let var = project.var(var);
            if is_kept(var.section) && !var.constant && var.location.is_none() {
                writer.walk(&Path::root(&format!("{name}.{}", var.name)), var.ty)?;
            }
        }
    }
    let Writer {
        mut out,
        loops_max,
        uses,
        ..
    } = writer;
    for (used, name, ty) in [(uses[0], "fam_d", "DWORD"), (uses[1], "fam_l", "LWORD")] {
        if used {
            out.temps.push((name.to_owned(), ty));
        }
    }
    for depth in 0..loops_max {
        out.temps.push((counter(depth), "DINT"));
    }
    Ok(out)
}

fn is_kept(section: VarSection) -> bool {
    matches!(
        section,
        VarSection::Local | VarSection::Input | VarSection::Output
    )
}

fn counter(depth: usize) -> String {
    format!("fam_i{depth}")
}

/// A path with the places where indices stand.
#[derive(Clone)]
struct Path {
    parts: Vec<Part>,
    loops: Vec<(i64, i64)>,
}

#[derive(Clone)]
enum Part {
    Text(String),
    /// Loops from the first to before the second.
    Index(usize, usize),
}

impl Path {
    fn root(name: &str) -> Path {
        Path {
            parts: vec![Part::Text(name.to_owned())],
            loops: Vec::new(),
        }
    }

    fn field(&self, name: &str) -> Path {
        let mut path = self.clone();
        path.parts.push(Part::Text(format!(".{name}")));
        path
    }

    fn elements(&self, dims: &[(i64, i64)]) -> Path {
        let mut path = self.clone();
        let first = path.loops.len();
        path.loops.extend(dims);
        path.parts.push(Part::Index(first, first + dims.len()));
        path
    }

    fn text(&self, index: &dyn Fn(usize) -> String) -> String {
        let mut text = String::new();
        for part in &self.parts {
            match part {
                Part::Text(t) => text.push_str(t),
                Part::Index(from, to) => {
                    let indices: Vec<String> = (*from..*to).map(index).collect();
                    let _ = write!(text, "[{}]", indices.join(","));
                }
            }
        }
        text
    }
}

struct Writer<'a> {
    project: &'a TypedProject,
    state: &'a str,
    offset: Offset<'a>,
    out: Statements,
    loops_max: usize,
    /// Whether the 4-byte and 8-byte temporaries are used.
    uses: [bool; 2],
}

impl Writer<'_> {
    fn walk(&mut self, path: &Path, ty: TypeId) -> Result<(), PortableError> {
        match self.project.types.kind(ty) {
            TypeKind::Array { dims, elem } => {
                let packed = self
                    .project
                    .types
                    .elem(*elem)
                    .is_some_and(Elem::is_packed_in_arrays);
                let path = path.elements(dims);
                if self.project.types.elem(*elem).is_some() {
                    self.leaf(&path, *elem, packed)
                } else {
                    self.walk(&path, *elem)
                }
            }
            TypeKind::Struct { fields } => fields
                .clone()
                .iter()
                .try_for_each(|f| self.walk(&path.field(&f.name), f.ty)),
            TypeKind::FunctionBlock(pou) => {
                for var in &self.project.pou(*pou).vars {
                    let var = self.project.var(*var);
                    if is_kept(var.section) && !var.constant {
                        self.walk(&path.field(&var.name), var.ty)?;
                    }
                }
                Ok(())
            }
            _ => self.leaf(path, ty, false),
        }
    }

    fn leaf(&mut self, path: &Path, ty: TypeId, packed: bool) -> Result<(), PortableError> {
        let low = |k: usize| path.loops[k].0.to_string();
        let error = |why: String| PortableError {
            path: path.text(&low),
            why,
        };
        let elem = self.project.types.elem(ty).ok_or_else(|| {
            error(format!(
                "its type {} has no single value",
                self.project.type_name(ty)
            ))
        })?;
        let not_state = || error("it has no place in the state".to_owned());
        let base = (self.offset)(&path.text(&low)).ok_or_else(not_state)?;
        let mut at = base.to_string();
        for (k, (lo, hi)) in path.loops.iter().enumerate() {
            if lo == hi {
                continue;
            }
            let second = path.text(&|j| if j == k { (lo + 1).to_string() } else { low(j) });
            let stride = (self.offset)(&second).ok_or_else(not_state)? - base;
            let counted = match lo {
                0 => counter(k),
                lo if *lo < 0 => format!("({} + {})", counter(k), -lo),
                lo => format!("({} - {lo})", counter(k)),
            };
            let _ = write!(at, " + {stride} * {counted}");
        }
        self.loops_max = self.loops_max.max(path.loops.len());
        let value = path.text(&counter);
        let enum_name = match self.project.types.kind(ty) {
            TypeKind::Enum { .. } => {
                Some(self.project.types.get(ty).name.clone().ok_or_else(|| {
                    error("its enumeration has no name; declare it in a TYPE block".to_owned())
                })?)
            }
            _ => None,
        };
        let bytes = if packed { 1 } else { elem.cell_bytes() };
        let (put, get) = conversion(elem, bytes, enum_name.as_deref(), &value);
        let indent = "    ".repeat(path.loops.len());
        let place = |byte: u32| match byte {
            0 => format!("{}[{at}]", self.state),
            n => format!("{}[{at} + {n}]", self.state),
        };
        let (mut write, mut read) = (String::new(), String::new());
        if bytes == 1 {
            let _ = writeln!(write, "{indent}{} := {put};", place(0));
            let _ = writeln!(read, "{indent}{value} := {};", get.replace("{}", &place(0)));
        } else {
            let (temp, word) = if bytes == 8 {
                self.uses[1] = true;
                ("fam_l", "LWORD")
            } else {
                self.uses[0] = true;
                ("fam_d", "DWORD")
            };
            let _ = writeln!(write, "{indent}{temp} := {put};");
            let mut parts = Vec::new();
            for byte in 0..bytes {
                let shifted = match byte {
                    0 => temp.to_owned(),
                    n => format!("SHR({temp}, {})", 8 * n),
                };
                let _ = writeln!(
                    write,
                    "{indent}{} := {word}_TO_BYTE({shifted});",
                    place(byte)
                );
                let part = format!("BYTE_TO_{word}({})", place(byte));
                parts.push(match byte {
                    0 => part,
                    n => format!("SHL({part}, {})", 8 * n),
                });
            }
            let _ = writeln!(read, "{indent}{temp} := {};", parts.join(" OR "));
            let _ = writeln!(read, "{indent}{value} := {};", get.replace("{}", temp));
        }
        let (mut head, mut tail) = (String::new(), String::new());
        for (k, (lo, hi)) in path.loops.iter().enumerate() {
            let _ = writeln!(
                head,
                "{}FOR {} := {lo} TO {hi} DO",
                "    ".repeat(k),
                counter(k)
            );
        }
        for k in (0..path.loops.len()).rev() {
            let _ = writeln!(tail, "{}END_FOR;", "    ".repeat(k));
        }
        for (out, text) in [
            (&mut self.out.serialize, write),
            (&mut self.out.deserialize, read),
        ] {
            out.push_str(&head);
            out.push_str(&text);
            out.push_str(&tail);
        }
        Ok(())
    }
}

/// The value as BYTE, DWORD or LWORD, and the way back, where `{}` stands for that.
fn conversion(elem: Elem, bytes: u32, enum_name: Option<&str>, value: &str) -> (String, String) {
    let name = elem.name();
    let number = match enum_name {
        Some(e) => format!("{e}_TO_{name}({value})"),
        None => value.to_owned(),
    };
    let back = |text: String| match enum_name {
        Some(e) => format!("{name}_TO_{e}({text})"),
        None => text,
    };
    let (put, get) = match (elem, bytes) {
        (Elem::Bool, 1) => (format!("BOOL_TO_BYTE({number})"), "{} <> 0".to_owned()),
        (Elem::Bool, _) => (format!("BOOL_TO_DWORD({number})"), "fam_d <> 0".to_owned()),
        (Elem::Byte, 1) | (Elem::Dword, 4) | (Elem::Lword, 8) => (number, "{}".to_owned()),
        (Elem::Sint | Elem::Usint, 1) => (
            format!("{name}_TO_BYTE({number})"),
            format!("BYTE_TO_{name}({{}})"),
        ),
        (Elem::Byte | Elem::Word, _) => (
            format!("{name}_TO_DWORD({number})"),
            format!("DWORD_TO_{name}({{}})"),
        ),
        // Through the widest integer of the same sign, so that the sign fills the cell.
        (Elem::Sint | Elem::Int, _) => (
            format!("DINT_TO_DWORD({name}_TO_DINT({number}))"),
            format!("DINT_TO_{name}(DWORD_TO_DINT({{}}))"),
        ),
        (Elem::Usint | Elem::Uint, _) => (
            format!("UDINT_TO_DWORD({name}_TO_UDINT({number}))"),
            format!("UDINT_TO_{name}(DWORD_TO_UDINT({{}}))"),
        ),
        (Elem::Time, _) => (
            format!("LINT_TO_LWORD(TIME_TO_LINT({number}))"),
            "LINT_TO_TIME(LWORD_TO_LINT({}))".to_owned(),
        ),
        (_, 8) => (
            format!("{name}_TO_LWORD({number})"),
            format!("LWORD_TO_{name}({{}})"),
        ),
        _ => (
            format!("{name}_TO_DWORD({number})"),
            format!("DWORD_TO_{name}({{}})"),
        ),
    };
    (put, back(get))
}
