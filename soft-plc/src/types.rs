//! Data types (IEC 61131-3, clause 6.4): elementary types, derived types, and the table that holds them.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::check::tree::{InitValue, PouId};
use crate::value::Value;

/// Elementary data types.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum Elem {
    Bool,
    Sint,
    Int,
    Dint,
    Lint,
    Usint,
    Uint,
    Udint,
    Ulint,
    Byte,
    Word,
    Dword,
    Lword,
    Real,
    Lreal,
    /// Signed 64-bit nanoseconds; LTIME is the same type.
    Time,
    /// Midnight of a day, signed 64-bit nanoseconds since 1970-01-01; LDATE is the same type.
    Date,
    /// Nanoseconds since midnight; LTOD is the same type.
    Tod,
    /// Signed 64-bit nanoseconds since 1970-01-01; LDT is the same type.
    Dt,
    /// One byte of a STRING.
    Char,
    /// One 16-bit unit of a WSTRING.
    Wchar,
    /// The address of a variable, 0 for NULL; only as the base of a reference type.
    Ref,
}

impl Elem {
    /// All elementary types that have a name.
    pub const ALL: [Elem; 21] = [
        Elem::Bool,
        Elem::Sint,
        Elem::Int,
        Elem::Dint,
        Elem::Lint,
        Elem::Usint,
        Elem::Uint,
        Elem::Udint,
        Elem::Ulint,
        Elem::Byte,
        Elem::Word,
        Elem::Dword,
        Elem::Lword,
        Elem::Real,
        Elem::Lreal,
        Elem::Time,
        Elem::Date,
        Elem::Tod,
        Elem::Dt,
        Elem::Char,
        Elem::Wchar,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Elem::Bool => "BOOL",
            Elem::Sint => "SINT",
            Elem::Int => "INT",
            Elem::Dint => "DINT",
            Elem::Lint => "LINT",
            Elem::Usint => "USINT",
            Elem::Uint => "UINT",
            Elem::Udint => "UDINT",
            Elem::Ulint => "ULINT",
            Elem::Byte => "BYTE",
            Elem::Word => "WORD",
            Elem::Dword => "DWORD",
            Elem::Lword => "LWORD",
            Elem::Real => "REAL",
            Elem::Lreal => "LREAL",
            Elem::Time => "TIME",
            Elem::Date => "DATE",
            Elem::Tod => "TIME_OF_DAY",
            Elem::Dt => "DATE_AND_TIME",
            Elem::Char => "CHAR",
            Elem::Wchar => "WCHAR",
            Elem::Ref => "REF_TO",
        }
    }

    pub fn from_name(name: &str) -> Option<Elem> {
        Elem::ALL
            .into_iter()
            .find(|e| e.name().eq_ignore_ascii_case(name))
            .or_else(|| {
                Elem::OTHER_NAMES
                    .into_iter()
                    .find(|(n, _)| n.eq_ignore_ascii_case(name))
                    .map(|(_, e)| e)
            })
    }

    const OTHER_NAMES: [(&'static str, Elem); 8] = [
        ("LTIME", Elem::Time),
        ("LDATE", Elem::Date),
        ("TOD", Elem::Tod),
        ("LTOD", Elem::Tod),
        ("LTIME_OF_DAY", Elem::Tod),
        ("DT", Elem::Dt),
        ("LDT", Elem::Dt),
        ("LDATE_AND_TIME", Elem::Dt),
    ];

    /// Counted in signed 64-bit nanoseconds.
    pub fn is_time(self) -> bool {
        matches!(self, Elem::Time | Elem::Date | Elem::Tod | Elem::Dt)
    }

    pub fn is_char(self) -> bool {
        matches!(self, Elem::Char | Elem::Wchar)
    }

    pub fn is_signed(self) -> bool {
        matches!(self, Elem::Sint | Elem::Int | Elem::Dint | Elem::Lint)
    }

    pub fn is_unsigned(self) -> bool {
        matches!(self, Elem::Usint | Elem::Uint | Elem::Udint | Elem::Ulint)
    }

    /// ANY_INT
    pub fn is_int(self) -> bool {
        self.is_signed() || self.is_unsigned()
    }

    /// ANY_BIT: BOOL and the bit strings.
    pub fn is_bit(self) -> bool {
        matches!(
            self,
            Elem::Bool | Elem::Byte | Elem::Word | Elem::Dword | Elem::Lword
        )
    }

    /// ANY_REAL
    pub fn is_real(self) -> bool {
        matches!(self, Elem::Real | Elem::Lreal)
    }

    /// ANY_NUM
    pub fn is_num(self) -> bool {
        self.is_int() || self.is_real()
    }

    pub fn bits(self) -> u32 {
        match self {
            Elem::Bool => 1,
            Elem::Sint | Elem::Usint | Elem::Byte | Elem::Char => 8,
            Elem::Int | Elem::Uint | Elem::Word | Elem::Wchar => 16,
            Elem::Dint | Elem::Udint | Elem::Dword | Elem::Real | Elem::Ref => 32,
            Elem::Lint
            | Elem::Ulint
            | Elem::Lword
            | Elem::Lreal
            | Elem::Time
            | Elem::Date
            | Elem::Tod
            | Elem::Dt => 64,
        }
    }

    /// Bytes in the process image; BOOL takes a bit there and has no width of its own.
    pub fn image_bytes(self) -> u32 {
        self.bits().div_ceil(8)
    }

    /// Bytes of a variable's cell in memory.
    pub fn cell_bytes(self) -> u32 {
        if self.bits() == 64 { 8 } else { 4 }
    }

    /// Whether elements of an array of this type are packed one to a byte.
    pub fn is_packed_in_arrays(self) -> bool {
        self.bits() <= 8
    }

    /// Smallest and largest value of an integer, bit string, BOOL or TIME.
    pub fn limits(self) -> Option<(i128, i128)> {
        if self.is_real() {
            return None;
        }
        let bits = self.bits();
        Some(if self.is_signed() || self.is_time() {
            (-(1i128 << (bits - 1)), (1i128 << (bits - 1)) - 1)
        } else {
            (0, (1i128 << bits) - 1)
        })
    }

    /// Implicit conversions (third edition, figure 11): those that lose nothing.
    pub fn widens_to(self, to: Elem) -> bool {
        use Elem::{
            Bool, Byte, Dint, Dword, Int, Lint, Lreal, Lword, Real, Sint, Udint, Uint, Ulint,
            Usint, Word,
        };
        self == to
            || match self {
                Bool => matches!(to, Byte | Word | Dword | Lword),
                Byte => matches!(to, Word | Dword | Lword),
                Word => matches!(to, Dword | Lword),
                Dword => to == Lword,
                Sint => matches!(to, Int | Dint | Lint | Real | Lreal),
                Int => matches!(to, Dint | Lint | Real | Lreal),
                Dint => matches!(to, Lint | Lreal),
                Usint => matches!(to, Uint | Udint | Ulint | Int | Dint | Lint | Real | Lreal),
                Uint => matches!(to, Udint | Ulint | Dint | Lint | Real | Lreal),
                Udint => matches!(to, Ulint | Lint | Lreal),
                Real => to == Lreal,
                _ => false,
            }
    }

    /// The smallest type that both widen to.
    pub fn common(self, other: Elem) -> Option<Elem> {
        const ORDER: [Elem; 22] = [
            Elem::Bool,
            Elem::Byte,
            Elem::Word,
            Elem::Dword,
            Elem::Lword,
            Elem::Usint,
            Elem::Sint,
            Elem::Uint,
            Elem::Int,
            Elem::Udint,
            Elem::Dint,
            Elem::Ulint,
            Elem::Lint,
            Elem::Real,
            Elem::Lreal,
            Elem::Time,
            Elem::Date,
            Elem::Tod,
            Elem::Dt,
            Elem::Char,
            Elem::Wchar,
            Elem::Ref,
        ];
        ORDER
            .into_iter()
            .find(|to| self.widens_to(*to) && other.widens_to(*to))
    }
}

impl fmt::Display for Elem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Number of a type in its `TypeTable`. The elementary types come first, in the order of `Elem::ALL`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TypeId(pub u32);

impl TypeId {
    pub const BOOL: TypeId = TypeId(Elem::Bool as u32);
    pub const TIME: TypeId = TypeId(Elem::Time as u32);
    /// Type of an integer literal that has not met its context yet.
    pub const UNTYPED_INT: TypeId = TypeId(Elem::ALL.len() as u32);
    pub const UNTYPED_REAL: TypeId = TypeId(Elem::ALL.len() as u32 + 1);
    /// No value: the result of a function without result.
    pub const VOID: TypeId = TypeId(Elem::ALL.len() as u32 + 2);
    /// Something wrong that has been reported; it fits everywhere.
    pub const ERROR: TypeId = TypeId(Elem::ALL.len() as u32 + 3);
    /// The type of NULL, which fits every reference.
    pub const NULL: TypeId = TypeId(Elem::ALL.len() as u32 + 4);
    /// A variable whose type follows from the first value that it gets: a wire of a diagram.
    pub const INFERRED: TypeId = TypeId(Elem::ALL.len() as u32 + 5);

    pub fn of(elem: Elem) -> TypeId {
        TypeId(elem as u32)
    }
}

#[derive(Clone, Debug)]
pub enum TypeKind {
    Elem(Elem),
    UntypedInt,
    UntypedReal,
    Void,
    Error,
    Enum {
        base: Elem,
        values: Vec<(String, i64)>,
    },
    Subrange {
        base: Elem,
        lo: i128,
        hi: i128,
    },
    Array {
        /// Lower and upper bound of each dimension.
        dims: Vec<(i64, i64)>,
        elem: TypeId,
    },
    Struct {
        fields: Vec<Field>,
    },
    FunctionBlock(PouId),
    /// STRING or WSTRING of a declared length, in characters.
    Str {
        wide: bool,
        len: u32,
    },
    /// REF_TO, and POINTER TO of the standard dialect.
    Ref(TypeId),
    /// POINTER TO of CODESYS: a number of bytes that can be reckoned with.
    Pointer(TypeId),
    /// A variable of an interface: the address of an instance that implements it.
    Interface(InterfaceId),
    Inferred,
}

/// Number of an interface in its project.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct InterfaceId(pub u32);

/// Length of a STRING that is declared without one.
pub const STRING_LEN_DEFAULT: u32 = 254;
/// The longest string that can be declared.
pub const STRING_LEN_MAX: u32 = 65_535;

#[derive(Clone, Debug)]
pub struct Field {
    pub name: String,
    pub ty: TypeId,
    /// Relative address: its first bit, counted from the start of the structure in the process image.
    pub at: Option<u64>,
    pub init: Option<InitValue>,
}

#[derive(Clone, Debug)]
pub struct Type {
    pub name: Option<String>,
    pub kind: TypeKind,
    /// Initial value that the type's declaration gives.
    pub init: Option<InitValue>,
    /// The type that this one is another name for, or itself.
    pub same_as: TypeId,
    /// For an alias: the type named in its declaration.
    pub alias_of: Option<TypeId>,
}

#[derive(Clone, Debug)]
pub struct TypeTable {
    list: Vec<Type>,
}

impl Default for TypeTable {
    fn default() -> Self {
        let mut table = Self { list: Vec::new() };
        for elem in Elem::ALL {
            table.add(Some(elem.name().to_owned()), TypeKind::Elem(elem));
        }
        table.add(None, TypeKind::UntypedInt);
        table.add(None, TypeKind::UntypedReal);
        table.add(None, TypeKind::Void);
        table.add(None, TypeKind::Error);
        table.add(None, TypeKind::Ref(TypeId::ERROR));
        table.add(None, TypeKind::Inferred);
        table
    }
}

impl TypeTable {
    pub fn add(&mut self, name: Option<String>, kind: TypeKind) -> TypeId {
        let id = TypeId(self.list.len() as u32);
        self.list.push(Type {
            name,
            kind,
            init: None,
            same_as: id,
            alias_of: None,
        });
        id
    }

    /// Another name for `of`; an initial value of its own is set afterwards.
    pub fn add_alias(&mut self, name: String, of: TypeId) -> TypeId {
        let id = self.add(Some(name), TypeKind::Error);
        let same_as = self.get(of).same_as;
        let alias = &mut self.list[id.0 as usize];
        alias.same_as = same_as;
        alias.alias_of = Some(of);
        id
    }

    /// The array type with these bounds: one for each structure, so that equal arrays have equal types.
    pub fn array(&mut self, dims: Vec<(i64, i64)>, elem: TypeId) -> TypeId {
        let found = self.list.iter().position(|t| {
            t.name.is_none()
                && matches!(&t.kind, TypeKind::Array { dims: d, elem: e } if *d == dims && *e == elem)
        });
        match found {
            Some(index) => TypeId(index as u32),
            None => self.add(None, TypeKind::Array { dims, elem }),
        }
    }

    /// STRING or WSTRING of this length: one for each.
    pub fn string(&mut self, wide: bool, len: u32) -> TypeId {
        let found = self.list.iter().position(|t| {
            t.name.is_none()
                && matches!(t.kind, TypeKind::Str { wide: w, len: l } if w == wide && l == len)
        });
        match found {
            Some(index) => TypeId(index as u32),
            None => self.add(None, TypeKind::Str { wide, len }),
        }
    }

    /// The type of references to `to`: one for each.
    pub fn reference(&mut self, to: TypeId) -> TypeId {
        let found = self.list.iter().position(|t| {
            t.name.is_none() && matches!(t.kind, TypeKind::Ref(target) if target == to)
        });
        match found {
            Some(index) => TypeId(index as u32),
            None => self.add(None, TypeKind::Ref(to)),
        }
    }

    /// The type of pointers to `to`: one for each.
    pub fn pointer(&mut self, to: TypeId) -> TypeId {
        let found = self.list.iter().position(|t| {
            t.name.is_none() && matches!(t.kind, TypeKind::Pointer(target) if target == to)
        });
        match found {
            Some(index) => TypeId(index as u32),
            None => self.add(None, TypeKind::Pointer(to)),
        }
    }

    pub fn is_pointer(&self, id: TypeId) -> bool {
        matches!(self.kind(id), TypeKind::Pointer(_))
    }

    /// Whether strings of the type are wide, and their longest length.
    pub fn text(&self, id: TypeId) -> Option<(bool, u32)> {
        match self.kind(id) {
            TypeKind::Str { wide, len } => Some((*wide, *len)),
            _ => None,
        }
    }

    /// What a reference of this type leads to.
    pub fn pointee(&self, id: TypeId) -> Option<TypeId> {
        match self.kind(id) {
            TypeKind::Ref(to) | TypeKind::Pointer(to) => Some(*to),
            _ => None,
        }
    }

    pub fn is_ref(&self, id: TypeId) -> bool {
        matches!(
            self.kind(id),
            TypeKind::Ref(_) | TypeKind::Pointer(_) | TypeKind::Interface(_)
        )
    }

    pub fn set_init(&mut self, id: TypeId, init: InitValue) {
        self.list[id.0 as usize].init = Some(init);
    }

    pub fn set_kind(&mut self, id: TypeId, kind: TypeKind) {
        self.list[id.0 as usize].kind = kind;
    }

    pub fn get(&self, id: TypeId) -> &Type {
        &self.list[id.0 as usize]
    }

    pub fn kind(&self, id: TypeId) -> &TypeKind {
        &self.get(self.get(id).same_as).kind
    }

    /// The initial value that the declaration of the type, or of the type that it is an alias of, gives.
    pub fn init(&self, id: TypeId) -> Option<&InitValue> {
        let ty = self.get(id);
        ty.init
            .as_ref()
            .or_else(|| ty.alias_of.and_then(|of| self.init(of)))
    }

    pub fn set_field_init(&mut self, id: TypeId, field: usize, init: InitValue) {
        let root = self.get(id).same_as;
        if let TypeKind::Struct { fields } = &mut self.list[root.0 as usize].kind {
            fields[field].init = Some(init);
        }
    }

    /// The elementary type that values of this type are computed in: itself, or the base of an enumeration or subrange.
    pub fn elem(&self, id: TypeId) -> Option<Elem> {
        match self.kind(id) {
            TypeKind::Elem(e) => Some(*e),
            TypeKind::Enum { base, .. } | TypeKind::Subrange { base, .. } => Some(*base),
            TypeKind::Ref(_) | TypeKind::Pointer(_) | TypeKind::Interface(_) => Some(Elem::Ref),
            _ => None,
        }
    }

    pub fn is_enum(&self, id: TypeId) -> bool {
        matches!(self.kind(id), TypeKind::Enum { .. })
    }

    pub fn is_aggregate(&self, id: TypeId) -> bool {
        matches!(
            self.kind(id),
            TypeKind::Array { .. }
                | TypeKind::Struct { .. }
                | TypeKind::FunctionBlock(_)
                | TypeKind::Str { .. }
        )
    }

    /// Whether both are the same type, aliases seen through.
    pub fn same(&self, a: TypeId, b: TypeId) -> bool {
        let (a, b) = (self.get(a).same_as, self.get(b).same_as);
        a == b
            || match (self.kind(a), self.kind(b)) {
                (
                    TypeKind::Array { dims: da, elem: ea },
                    TypeKind::Array { dims: db, elem: eb },
                ) => da == db && self.same(*ea, *eb),
                (TypeKind::Str { wide: wa, len: la }, TypeKind::Str { wide: wb, len: lb }) => {
                    wa == wb && la == lb
                }
                (TypeKind::Ref(a), TypeKind::Ref(b))
                | (TypeKind::Pointer(a), TypeKind::Pointer(b)) => self.same(*a, *b),
                _ => false,
            }
    }

    /// The name of the type as the user would write it.
    pub fn name(&self, id: TypeId) -> String {
        let ty = self.get(id);
        if let Some(name) = &ty.name {
            return name.clone();
        }
        match self.kind(id) {
            TypeKind::Elem(e) => e.name().into(),
            TypeKind::UntypedInt => "an integer literal".into(),
            TypeKind::UntypedReal => "a real literal".into(),
            TypeKind::Void => "no value".into(),
            TypeKind::Error => "an unknown type".into(),
            TypeKind::Enum { values, .. } => {
                let names: Vec<&str> = values.iter().map(|v| v.0.as_str()).collect();
                format!("({})", names.join(", "))
            }
            TypeKind::Subrange { base, lo, hi } => format!("{base}({lo}..{hi})"),
            TypeKind::Array { dims, elem } => {
                let dims: Vec<String> = dims.iter().map(|(l, h)| format!("{l}..{h}")).collect();
                format!("ARRAY[{}] OF {}", dims.join(", "), self.name(*elem))
            }
            TypeKind::Struct { .. } => "STRUCT".into(),
            TypeKind::FunctionBlock(_) => "a function block".into(),
            TypeKind::Str { wide, len } => {
                format!("{}[{len}]", if *wide { "WSTRING" } else { "STRING" })
            }
            TypeKind::Ref(to) if *to == TypeId::ERROR => "NULL".into(),
            TypeKind::Ref(to) => format!("REF_TO {}", self.name(*to)),
            TypeKind::Pointer(to) => format!("POINTER TO {}", self.name(*to)),
            TypeKind::Interface(_) => "an interface".into(),
            TypeKind::Inferred => "a type still unknown".into(),
        }
    }

    pub fn iter(&self) -> impl Iterator<Item = (TypeId, &Type)> {
        self.list
            .iter()
            .enumerate()
            .map(|(i, t)| (TypeId(i as u32), t))
    }

    /// The value that a variable of this elementary, enumerated or subrange type has when nothing else is said.
    pub fn default_value(&self, id: TypeId) -> Option<Value> {
        if let Some(InitValue::Scalar(value)) = self.init(id) {
            return Some(*value);
        }
        Some(match self.kind(id) {
            TypeKind::Elem(e) => Value::zero(*e),
            TypeKind::Enum { base, values } => {
                Value::from_i128(*base, i128::from(values.first().map_or(0, |v| v.1)))
            }
            // The lower limit (clause 6.4.4.4), not 0.
            TypeKind::Subrange { base, lo, .. } => Value::from_i128(*base, *lo),
            TypeKind::Ref(_) | TypeKind::Pointer(_) | TypeKind::Interface(_) => {
                Value::zero(Elem::Ref)
            }
            _ => return None,
        })
    }
}
