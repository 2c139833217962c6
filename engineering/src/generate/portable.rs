//! Serialize and Deserialize variable by variable, in IEC 61131-3 that other compilers take.
//!
//! Each variable takes the bytes that it has in the soft-PLC's memory, lowest byte first, whatever the machine: BOOL 0 or 1,
//! signed integers with their sign extended over the cell, REAL and LREAL by their bits, TIME in nanoseconds, dates in
//! nanoseconds since 1970-01-01, strings with their length before them. Bytes between variables stay 0. So a checkpoint goes from one
//! form to the other.
//!
//! What the standard has no conversion for is written out: an enumeration as a CASE over its values, a string character by
//! character, a date as the time from the first one. Charts, diagrams that remember and edges of inputs have become plain statements
//! before (`fam_soft_plc::plain`), their memory variables. What means nothing elsewhere (addresses) is an error that names it.

use fam_soft_plc::check::tree::{TypedProject, Var, VarId};
use fam_soft_plc::syntax::ast::VarSection;
use fam_soft_plc::types::{Elem, TypeId, TypeKind};
use std::collections::{BTreeMap, BTreeSet};
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
    /// What to do.
    pub hint: &'static str,
}

/// Hints of [`PortableError`], by what stands against a variable.
mod hints {
    pub const MADE: &str =
        "write its POU in plain Structured Text; or generate with `--target fam`";
    pub const ADDRESS: &str = "keep the index of what is meant instead of a reference to it; or generate with `--target fam`";
    pub const MARKER: &str = "declare it without an address; or generate with `--target fam`, whose checkpoints hold all of %M";
    pub const OTHER: &str = "give it an elementary type, or an array or structure of such; or generate with `--target fam`";
}

/// Where the variables lie.
#[derive(Clone, Copy)]
pub struct Memory<'a> {
    /// Offset of a variable in the serialized state, by its path; `None` if it lies elsewhere.
    pub offset: &'a dyn Fn(&str) -> Option<u32>,
    /// The state at its initial values.
    pub initial: &'a [u8],
}

/// Writes the statements for all variables of `programs` and for `globals`.
///
/// # Errors
/// [`PortableError`] for a variable whose type cannot be named or whose place is not in the state.
pub fn statements(
    project: &TypedProject,
    programs: &[String],
    globals: &[VarId],
    state: &str,
    memory: Memory<'_>,
) -> Result<Statements, PortableError> {
    refuse_markers(project, programs)?;
    let mut writer = Writer {
        project,
        state,
        memory,
        out: Statements::default(),
        loops_max: 0,
        uses: BTreeMap::new(),
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
            // A located string is read from its input before the program runs.
            let is_input = var.open_input;
            if is_kept(var.section) && !var.constant && var.location.is_none() && !is_input {
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
    for (name, ty) in uses {
        out.temps.push((name.to_owned(), ty));
    }
    for depth in 0..loops_max {
        out.temps.push((counter(depth), "DINT"));
    }
    Ok(out)
}

/// What lies at %M has its place in the image, bits side by side, and none in the state that is written variable by variable.
fn refuse_markers(project: &TypedProject, programs: &[String]) -> Result<(), PortableError> {
    let is_marker = |var: &&Var| {
        let mut programs = programs.iter().filter_map(|p| project.find_pou(p));
        var.location.is_some_and(|l| l.memory) && var.owner.is_none_or(|o| programs.any(|p| p == o))
    };
    match project.vars.iter().find(is_marker) {
        Some(var) => Err(PortableError {
            path: var.name.clone(),
            why: "it lies at %M".into(),
            hint: hints::MARKER,
        }),
        None => Ok(()),
    }
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

    /// With the lowest indices.
    fn first(&self) -> String {
        self.text(&|k| self.loops[k].0.to_string())
    }

    fn has_hidden(&self) -> bool {
        self.parts.iter().any(|part| match part {
            Part::Text(text) => is_hidden(text.trim_start_matches('.')) || text.contains(".__"),
            Part::Index(..) => false,
        })
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
    memory: Memory<'a>,
    out: Statements,
    loops_max: usize,
    /// Temporaries that are used, with their types.
    uses: BTreeMap<&'static str, &'static str>,
}

const WORD4: (&str, &str) = ("fam_d", "DWORD");
const WORD8: (&str, &str) = ("fam_l", "LWORD");
/// Number of an enumerated value.
const NUMBER: (&str, &str) = ("fam_e", "LINT");
/// Length of a string, and the position in it.
const LENGTH: (&str, &str) = ("fam_len", "DINT");
const POSITION: (&str, &str) = ("fam_c", "DINT");

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
                let unit = self.project.pou(*pou);
                for id in &unit.vars {
                    let var = self.project.var(*id);
                    if !is_kept(var.section) || var.constant {
                        continue;
                    }
                    let path = path.field(&var.name);
                    if unit.tag == Some(*id) {
                        self.tag(&path)?;
                    } else {
                        self.walk(&path, var.ty)?;
                    }
                }
                Ok(())
            }
            TypeKind::Str { wide, len } => self.text(path, *wide, *len),
            _ => self.leaf(path, ty, false),
        }
    }

    fn error(&self, path: &Path, why: &str, hint: &'static str) -> PortableError {
        PortableError {
            path: path.first(),
            why: why.to_owned(),
            hint,
        }
    }

    fn uses(&mut self, (name, ty): (&'static str, &'static str)) {
        self.uses.insert(name, ty);
    }

    /// Offset of the first element, and the expression for that of the one at the loops' counters.
    fn place(&mut self, path: &Path) -> Result<(u32, String), PortableError> {
        if path.has_hidden() {
            return Err(self.error(
                path,
                "the compiler made it, and others keep it elsewhere",
                hints::MADE,
            ));
        }
        self.offset(path)
    }

    fn offset(&mut self, path: &Path) -> Result<(u32, String), PortableError> {
        let low = |k: usize| path.loops[k].0.to_string();
        let find = |this: &Self, text: &str| {
            (this.memory.offset)(text)
                .ok_or_else(|| this.error(path, "it has no place in the state", hints::OTHER))
        };
        let base = find(self, &path.text(&low))?;
        let mut at = base.to_string();
        for (k, (lo, hi)) in path.loops.iter().enumerate() {
            if lo == hi {
                continue;
            }
            let second = path.text(&|j| if j == k { (lo + 1).to_string() } else { low(j) });
            let stride = find(self, &second)? - base;
            let counted = match lo {
                0 => counter(k),
                lo if *lo < 0 => format!("({} + {})", counter(k), -lo),
                lo => format!("({} - {lo})", counter(k)),
            };
            let _ = write!(at, " + {stride} * {counted}");
        }
        self.loops_max = self.loops_max.max(path.loops.len());
        Ok((base, at))
    }

    /// The hidden variable that tells which function block an instance is of: nobody changes it, and others have none.
    fn tag(&mut self, path: &Path) -> Result<(), PortableError> {
        let (base, at) = self.offset(path)?;
        let mut write = String::new();
        let bytes = self.memory.initial.iter().skip(base as usize).take(4);
        for (n, byte) in bytes.enumerate() {
            let _ = writeln!(write, "{}[{}] := {byte};", self.state, plus(&at, n));
        }
        self.put(path, &write, "");
        Ok(())
    }

    fn leaf(&mut self, path: &Path, ty: TypeId, packed: bool) -> Result<(), PortableError> {
        let elem = match self.project.types.elem(ty) {
            Some(Elem::Ref) => {
                return Err(self.error(
                    path,
                    "it holds an address, which means nothing elsewhere",
                    hints::ADDRESS,
                ));
            }
            Some(elem) => elem,
            None => {
                let why = format!(
                    "its type {} has no single value",
                    self.project.type_name(ty)
                );
                return Err(self.error(path, &why, hints::OTHER));
            }
        };
        let (_, at) = self.place(path)?;
        let value = path.text(&counter);
        let bytes = if packed { 1 } else { elem.cell_bytes() };
        let (mut write, mut read) = (String::new(), String::new());
        if let TypeKind::Enum { values, .. } = self.project.types.kind(ty) {
            let owner = self.project.types.get(ty).name.as_ref();
            let named: Vec<(String, i64)> = values
                .iter()
                .map(|(name, number)| {
                    let name = owner.map_or(name.clone(), |owner| format!("{owner}#{name}"));
                    (name, *number)
                })
                .collect();
            self.uses(NUMBER);
            let (put, get) = conversion(Elem::Lint, bytes, NUMBER.0, elem.is_signed());
            cases(&mut write, &value, &named, &|name, number| {
                (name.to_owned(), format!("{} := {number};", NUMBER.0))
            });
            self.bytes(&mut write, &mut read, &at, bytes, &put, (NUMBER.0, &get));
            cases(&mut read, NUMBER.0, &named, &|name, number| {
                (number.to_string(), format!("{value} := {name};"))
            });
        } else {
            let (put, get) = conversion(elem, bytes, &value, elem.is_signed());
            self.bytes(&mut write, &mut read, &at, bytes, &put, (&value, &get));
        }
        self.put(path, &write, &read);
        Ok(())
    }

    /// The statements that bring a BYTE, DWORD or LWORD into the array, and back: there `get` with `{}` for it becomes the value of `target`.
    fn bytes(
        &mut self,
        write: &mut String,
        read: &mut String,
        at: &str,
        bytes: u32,
        put: &str,
        (target, get): (&str, &str),
    ) {
        let place = |byte: u32| format!("{}[{}]", self.state, plus(at, byte as usize));
        if bytes == 1 {
            let _ = writeln!(write, "{} := {put};", place(0));
            let _ = writeln!(read, "{target} := {};", get.replace("{}", &place(0)));
            return;
        }
        let (temp, word) = if bytes == 8 { WORD8 } else { WORD4 };
        let _ = writeln!(write, "{temp} := {put};");
        let mut parts = Vec::new();
        for byte in 0..bytes {
            let shifted = match byte {
                0 => temp.to_owned(),
                n => format!("SHR({temp}, {})", 8 * n),
            };
            let _ = writeln!(write, "{} := {word}_TO_BYTE({shifted});", place(byte));
            let part = format!("BYTE_TO_{word}({})", place(byte));
            parts.push(match byte {
                0 => part,
                n => format!("SHL({part}, {})", 8 * n),
            });
        }
        let _ = writeln!(read, "{temp} := {};", parts.join(" OR "));
        let _ = writeln!(read, "{target} := {};", get.replace("{}", temp));
        self.uses((temp, word));
    }

    /// Length, then characters, then zeros.
    fn text(&mut self, path: &Path, wide: bool, len: u32) -> Result<(), PortableError> {
        let (_, at) = self.place(path)?;
        for temp in [LENGTH, POSITION] {
            self.uses(temp);
        }
        let (value, state) = (path.text(&counter), self.state.to_owned());
        let (length, c) = (LENGTH.0, POSITION.0);
        let (mut write, mut read) = (format!("{length} := LEN({value});\n"), String::new());
        let put = format!("DINT_TO_DWORD({length})");
        let get = format!("MIN(DWORD_TO_DINT({{}}), {len})");
        self.bytes(&mut write, &mut read, &at, 4, &put, (length, &get));
        let (first, second) = if wide {
            self.uses(WORD4);
            (format!("{at} + 2 + 2 * {c}"), format!("{at} + 3 + 2 * {c}"))
        } else {
            (format!("{at} + 3 + {c}"), String::new())
        };
        let temp = WORD4.0;
        let (character, nothing, next, empty) = if wide {
            (
                format!(
                    "{temp} := WORD_TO_DWORD(WCHAR_TO_WORD({value}[{c}])); {state}[{first}] := DWORD_TO_BYTE({temp}); {state}[{second}] := DWORD_TO_BYTE(SHR({temp}, 8));"
                ),
                format!("{state}[{first}] := 0; {state}[{second}] := 0;"),
                format!(
                    "WORD_TO_WCHAR(BYTE_TO_WORD({state}[{first}]) OR SHL(BYTE_TO_WORD({state}[{second}]), 8))"
                ),
                "\"\"",
            )
        } else {
            (
                format!("{state}[{first}] := CHAR_TO_BYTE({value}[{c}]);"),
                format!("{state}[{first}] := 0;"),
                format!("BYTE_TO_CHAR({state}[{first}])"),
                "''",
            )
        };
        let _ = write!(
            write,
            "FOR {c} := 1 TO {len} DO\n    IF {c} <= {length} THEN\n        {character}\n    ELSE\n        {nothing}\n    END_IF;\nEND_FOR;\n"
        );
        let _ = write!(
            read,
            "{value} := {empty};\nFOR {c} := 1 TO {length} DO\n    {value} := CONCAT({value}, {next});\nEND_FOR;\n"
        );
        self.put(path, &write, &read);
        Ok(())
    }

    /// Adds statements of both POUs, inside the loops of a path.
    fn put(&mut self, path: &Path, write: &str, read: &str) {
        let indent = "    ".repeat(path.loops.len());
        for (out, text) in [
            (&mut self.out.serialize, write),
            (&mut self.out.deserialize, read),
        ] {
            if text.is_empty() {
                continue;
            }
            for (k, (lo, hi)) in path.loops.iter().enumerate() {
                let (outer, counter) = ("    ".repeat(k), counter(k));
                let _ = writeln!(out, "{outer}FOR {counter} := {lo} TO {hi} DO");
            }
            for line in text.lines() {
                let _ = writeln!(out, "{indent}{line}");
            }
            for k in (0..path.loops.len()).rev() {
                let _ = writeln!(out, "{}END_FOR;", "    ".repeat(k));
            }
        }
    }
}

/// Whether the compiler has made a name: such names are no names of the standard.
fn is_hidden(name: &str) -> bool {
    name.starts_with("__")
}

fn plus(at: &str, n: usize) -> String {
    if n == 0 {
        at.to_owned()
    } else {
        format!("{at} + {n}")
    }
}

/// A CASE over the values of an enumeration.
fn cases(
    text: &mut String,
    selector: &str,
    values: &[(String, i64)],
    branch: &dyn Fn(&str, i64) -> (String, String),
) {
    let _ = writeln!(text, "CASE {selector} OF");
    let mut seen = BTreeSet::new();
    for (name, number) in values {
        // Two names of one number are one value.
        if seen.insert(number) {
            let (label, statement) = branch(name, *number);
            let _ = writeln!(text, "    {label}: {statement}");
        }
    }
    text.push_str("END_CASE;\n");
}

/// The value as BYTE, DWORD or LWORD, and the way back, where `{}` stands for that. `signed` says how a LINT in fewer bytes is read.
fn conversion(elem: Elem, bytes: u32, value: &str, signed: bool) -> (String, String) {
    let name = elem.name();
    let time = |put: &str, back: &str| {
        (
            format!("LINT_TO_LWORD(LTIME_TO_LINT({value}{put}))"),
            back.replace("@", "LINT_TO_LTIME(LWORD_TO_LINT({}))"),
        )
    };
    let both = |put: &str, get: &str| (format!("{put}({value})"), format!("{get}({{}})"));
    match (elem, bytes) {
        (Elem::Bool, 1) => (format!("BOOL_TO_BYTE({value})"), "{} <> 0".to_owned()),
        (Elem::Bool, _) => (format!("BOOL_TO_DWORD({value})"), "{} <> 0".to_owned()),
        (Elem::Byte, 1) | (Elem::Dword, 4) | (Elem::Lword, 8) => {
            (value.to_owned(), "{}".to_owned())
        }
        (Elem::Char, 4) => (
            format!("BYTE_TO_DWORD(CHAR_TO_BYTE({value}))"),
            "BYTE_TO_CHAR(DWORD_TO_BYTE({}))".to_owned(),
        ),
        (Elem::Wchar, _) => (
            format!("WORD_TO_DWORD(WCHAR_TO_WORD({value}))"),
            "WORD_TO_WCHAR(DWORD_TO_WORD({}))".to_owned(),
        ),
        (Elem::Lint, 4 | 1) => {
            let (word, whole) = match (bytes, signed) {
                (4, true) => ("DWORD", "DINT"),
                (4, false) => ("DWORD", "UDINT"),
                (_, true) => ("BYTE", "SINT"),
                (_, false) => ("BYTE", "USINT"),
            };
            (
                format!("LINT_TO_{word}({value})"),
                format!("{whole}_TO_LINT({word}_TO_{whole}({{}}))"),
            )
        }
        (Elem::Sint | Elem::Usint | Elem::Char, 1) => {
            both(&format!("{name}_TO_BYTE"), &format!("BYTE_TO_{name}"))
        }
        // Through the widest integer of the same sign, so that the sign fills the cell.
        (Elem::Sint | Elem::Int, _) => (
            format!("DINT_TO_DWORD({name}_TO_DINT({value}))"),
            format!("DINT_TO_{name}(DWORD_TO_DINT({{}}))"),
        ),
        (Elem::Usint | Elem::Uint, _) => (
            format!("UDINT_TO_DWORD({name}_TO_UDINT({value}))"),
            format!("UDINT_TO_{name}(DWORD_TO_UDINT({{}}))"),
        ),
        (Elem::Time, _) => time("", "LTIME_TO_TIME(@)"),
        (Elem::Date, _) => time(
            " - LDATE#1970-01-01",
            "LDT_TO_DATE(LDT#1970-01-01-00:00:00 + @)",
        ),
        (Elem::Tod, _) => time(" - LTOD#00:00:00", "LTOD_TO_TOD(LTOD#00:00:00 + @)"),
        (Elem::Dt, _) => time(
            " - LDT#1970-01-01-00:00:00",
            "LDT_TO_DT(LDT#1970-01-01-00:00:00 + @)",
        ),
        (_, 8) => both(&format!("{name}_TO_LWORD"), &format!("LWORD_TO_{name}")),
        _ => both(&format!("{name}_TO_DWORD"), &format!("DWORD_TO_{name}")),
    }
}
