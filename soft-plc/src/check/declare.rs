//! Names that stand outside POUs: collected first, then declared on demand, so that the order of texts does not matter.

use crate::check::tree::{Location, Pou, PouId, Var, VarId};
use crate::check::{Checker, Declared, Progress, key};
use crate::diag::{Fallible, Problem};
use crate::source::Span;
use crate::syntax::ast::{self, PouKind, VarSection};
use crate::types::{Elem, InterfaceId, TypeId, TypeKind};

impl<'p> Checker<'p> {
    pub(super) fn collect(&mut self) {
        let project = self.project;
        self.collect_spaces();
        for (index, decl) in project.types.iter().enumerate() {
            self.claim(&decl.name, Declared::Type(index));
        }
        for pou in &project.pous {
            let id = PouId(self.pous.len() as u32);
            self.claim(&pou.name, Declared::Pou(id));
            self.add_pou(pou, false);
        }
        for (index, interface) in project.interfaces.iter().enumerate() {
            let id = InterfaceId(index as u32);
            self.claim(&interface.name, Declared::Interface(id));
            let ty = self
                .types
                .add(Some(interface.name.name.clone()), TypeKind::Interface(id));
            self.interface_types.push(ty);
        }
        for (b, block) in project.globals.iter().enumerate() {
            for (d, decl) in block.decls.iter().enumerate() {
                self.claim(&decl.name, Declared::Global(b, d));
            }
        }
        for pou in &project.library {
            if !self.names.contains_key(&key(&pou.name.name)) {
                let id = PouId(self.pous.len() as u32);
                self.names.insert(key(&pou.name.name), Declared::Pou(id));
                self.add_pou(pou, true);
            }
        }
        self.collect_methods();
    }

    pub(super) fn add_pou(&mut self, pou: &'p ast::Pou, library: bool) {
        let id = PouId(self.pous.len() as u32);
        self.pous.push(Pou {
            name: pou.name.name.clone(),
            name_span: pou.name.span,
            kind: pou.kind,
            library,
            pattern: false,
            vars: Vec::new(),
            result: None,
            body: Vec::new(),
            calls: std::collections::BTreeSet::new(),
            instance_of: None,
            extends: None,
            implements: Vec::new(),
            methods: Vec::new(),
            is_abstract: pou.class.is_abstract,
            is_final: pou.class.is_final,
            access: pou.class.access,
            tag: None,
        });
        self.syntaxes.push(pou);
        if pou.kind == PouKind::FunctionBlock {
            let ty = self
                .types
                .add(Some(pou.name.name.clone()), TypeKind::FunctionBlock(id));
            self.fb_types.insert(id, ty);
        }
    }

    fn claim(&mut self, name: &ast::Ident, declared: Declared) {
        if Elem::from_name(&name.name).is_some() {
            let message = format!("`{}` is the name of an elementary type", name.name);
            self.report(Problem::error("E201", name.span, message));
            return;
        }
        if self.names.contains_key(&key(&name.name)) {
            let problem = Problem::error(
                "E201",
                name.span,
                format!("`{}` is declared twice", name.name),
            )
            .hint("types, POUs and global variables of a namespace share one set of names; case does not count");
            self.report(problem);
            return;
        }
        self.names.insert(key(&name.name), declared);
    }

    pub(super) fn declare_all(&mut self) {
        let project = self.project;
        for index in 0..project.types.len() {
            self.resolve_declared(index, project.types[index].name.span);
        }
        for (b, block) in project.globals.iter().enumerate() {
            for d in 0..block.decls.len() {
                self.declare_global(b, d);
            }
        }
        self.declare_pous();
        self.place_configured();
        self.find_patterns();
        self.settle_inits(0);
    }

    /// The global variable, declared now if it was not yet. `None` if it is wrong, or needs itself.
    pub(super) fn declare_global(&mut self, b: usize, d: usize) -> Option<VarId> {
        if let Some((progress, id)) = self.globals.get(&(b, d)).copied() {
            if progress == Progress::Running {
                let span = self.project.globals[b].decls[d].name.span;
                self.report(Problem::error(
                    "E204",
                    span,
                    "this constant needs its own value",
                ));
            }
            return id;
        }
        let project = self.project;
        let block = &project.globals[b];
        let decl = &block.decls[d];
        self.globals.insert((b, d), (Progress::Running, None));
        let outside = std::mem::take(&mut self.current);
        self.current.space.clone_from(&decl.name.name);
        let id = self.declare_var(block, decl, VarSection::Global, None);
        self.current = outside;
        self.globals.insert((b, d), (Progress::Done, Some(id)));
        Some(id)
    }

    /// Adds a variable. Values of scalar constants are worked out at once, other initial values when all is declared.
    pub(super) fn declare_var(
        &mut self,
        block: &'p ast::VarBlock,
        decl: &'p ast::VarDecl,
        section: VarSection,
        owner: Option<PouId>,
    ) -> VarId {
        let mut ty = self.resolve_spec(&decl.spec, None);
        if ty == TypeId::INFERRED && owner.is_none() {
            ty = TypeId::ERROR;
        }
        let open = decl
            .location
            .as_ref()
            .is_some_and(|at| at.name.ends_with('*'));
        let open_at = |area: &str| {
            let at = decl.location.as_ref().filter(|_| open);
            at.is_some_and(|at| at.name.to_ascii_uppercase().starts_with(area))
        };
        let (open_input, open_output) = (open_at("%I"), open_at("%Q"));
        let configured = self.configured(&decl.name.name, owner);
        let location = configured
            .and_then(|c| c.location.as_ref())
            .or(decl.location.as_ref().filter(|_| !open))
            .and_then(|at| {
                let result = self.located(at, ty);
                self.ok(result)
            });
        let id = VarId(self.vars.len() as u32);
        self.vars.push(Var {
            name: decl.name.name.clone(),
            ty,
            section,
            constant: block.constant,
            retain: block.retain,
            location,
            open_input: open_input && location.is_none(),
            open_output: open_output && location.is_none(),
            init: None,
            owner,
            span: decl.name.span,
        });
        if block.constant && decl.init.is_none() && ty != TypeId::ERROR {
            let message = format!("the constant `{}` has no value", decl.name.name);
            self.report(
                Problem::error("E205", decl.name.span, message).expected("`:=` and a value"),
            );
        }
        if block.constant && decl.location.is_some() {
            let message = format!("the constant `{}` cannot be located", decl.name.name);
            self.report(Problem::error("E206", decl.name.span, message));
        }
        let init = configured
            .and_then(|c| c.init.as_ref())
            .or(decl.init.as_ref());
        if let Some(init) = init {
            if block.constant && !self.types.is_aggregate(ty) {
                let value = self.init_value(init, ty);
                self.vars[id.0 as usize].init = value;
            } else {
                self.pending_inits
                    .push((super::init::Pending::Var(id), init));
            }
        }
        id
    }

    /// The place of a variable in the process image.
    pub(super) fn located(&mut self, at: &ast::Ident, ty: TypeId) -> Fallible<Location> {
        let location = parse_location(&at.name, at.span)?;
        if ty == TypeId::ERROR {
            return Ok(location);
        }
        let bad = |message: String| Err(Box::new(Problem::error("E207", at.span, message)));
        let type_name = self.type_name(ty);
        match self.types.kind(ty) {
            TypeKind::Array { elem, .. } => {
                let area = location.area();
                let wrong = match self.types.elem(*elem).filter(|e| *e != Elem::Ref) {
                    Some(Elem::Bool) if location.bit.is_none() => {
                        format!("an address that begins with %{area}X: its elements are bits")
                    }
                    Some(elem) if elem != Elem::Bool && location.bit.is_some() => {
                        format!("an address that begins with %{area}{}", size_of(elem))
                    }
                    Some(_) => return Ok(location),
                    None => "an array of an elementary type".to_owned(),
                };
                let message = format!("{type_name} cannot be located at `{}`", at.name);
                Err(Box::new(
                    Problem::error("E207", at.span, message).expected(wrong),
                ))
            }
            _ => {
                let Some(elem) = self.types.elem(ty).filter(|e| *e != Elem::Ref) else {
                    return bad(format!("{type_name} cannot be located"));
                };
                let wanted = match location.size {
                    'X' => 1,
                    'B' => 8,
                    'W' => 16,
                    'D' => 32,
                    _ => 64,
                };
                if elem.bits() != wanted {
                    let (area, size) = (location.area(), size_of(elem));
                    return Err(Box::new(
                        Problem::error(
                            "E207",
                            at.span,
                            format!(
                                "{type_name} has {} and `{}` has {}",
                                bits(elem.bits()),
                                at.name,
                                bits(wanted)
                            ),
                        )
                        .expected(format!("an address that begins with %{area}{size}")),
                    ));
                }
                Ok(location)
            }
        }
    }
}

/// The letter of an address that is as wide as the type.
fn size_of(elem: Elem) -> char {
    match elem.bits() {
        1 => 'X',
        8 => 'B',
        16 => 'W',
        32 => 'D',
        _ => 'L',
    }
}

fn bits(n: u32) -> String {
    if n == 1 {
        "1 bit".into()
    } else {
        format!("{n} bits")
    }
}

/// Size of the process image, in bytes, that addresses may reach.
pub const IMAGE_BYTES_MAX: u32 = 64 * 1024;

/// The levels above the bytes of a module, from the lowest: how many there are, and how many bytes each takes.
const LEVELS: [(&str, u32, u32); 3] = [
    ("modules in a rack", 16, 256),
    ("racks on a bus", 4, 16 * 256),
    ("buses", 4, 4 * 16 * 256),
];

/// `%IX3.5`, `%QB7`, `%IW2` (bytes 4 and 5), `%ID1` (bytes 4 to 7), `%QL1` (bytes 8 to 15).
///
/// More numbers are a hierarchical address (clause 6.5.5.2), bus.rack.module before what has just been shown, the levels on
/// the left left out as one likes: `%IW2.7` is word 7 of module 2, which has bytes 512 to 767 of the image.
pub fn parse_location(text: &str, span: Span) -> Fallible<Location> {
    let bad = |message: String| {
        Err(Box::new(Problem::error("E208", span, message).expected(
            "%IX3.5, %IB3, %IW2, %ID1 or %IL0, or the same with Q or M",
        )))
    };
    let upper = text.to_ascii_uppercase();
    let mut chars = upper.chars();
    chars.next();
    let area = chars.next();
    let memory = area == Some('M');
    let output = match area {
        Some('I') => false,
        Some('Q' | 'M') => true,
        _ => return bad(format!("`{text}` is no address of an input or output")),
    };
    let rest = chars.as_str();
    if rest.starts_with('*') {
        return bad(format!("`{text}`: an address must be complete"));
    }
    let (size, numbers) = match rest.chars().next() {
        Some(c @ ('X' | 'B' | 'W' | 'D' | 'L')) => (c, &rest[1..]),
        Some(c) if c.is_ascii_digit() => ('X', rest),
        _ => return bad(format!("`{text}`: the size must be X, B, W, D or L")),
    };
    let parts: Vec<u32> = numbers
        .split('.')
        .map(|n| n.parse().unwrap_or(u32::MAX))
        .collect();
    let (unit, bit, above) = match (size, parts.as_slice()) {
        ('X', [.., bit]) if parts.len() > 1 && *bit >= 8 => {
            return bad(format!("`{text}`: a byte has bits 0 to 7"));
        }
        ('X', [above @ .., byte, bit]) => (*byte, Some(*bit as u8), above),
        // `%IX7` without a bit: the bits are counted through.
        ('X', [number]) => (*number / 8, Some((*number % 8) as u8), &[][..]),
        (_, [above @ .., unit]) => (*unit, None, above),
        _ => return bad(format!("`{text}` has no number")),
    };
    let width = match size {
        'W' => 2,
        'D' => 4,
        'L' => 8,
        _ => 1,
    };
    if above.len() > LEVELS.len() {
        return bad(format!(
            "`{text}` has too many levels: there are bus, rack, module and what the module has"
        ));
    }
    if !above.is_empty() && u64::from(unit) * u64::from(width) + u64::from(width) > 256 {
        return bad(format!("`{text}`: a module has 256 bytes"));
    }
    let mut start = 0;
    for (number, (level, count, bytes)) in above.iter().rev().zip(LEVELS) {
        if *number >= count {
            return bad(format!(
                "`{text}`: there are {count} {level}, counted from 0"
            ));
        }
        start += number * bytes;
    }
    match unit.checked_mul(width) {
        Some(byte) if byte + width <= IMAGE_BYTES_MAX => Ok(Location {
            output,
            memory,
            byte: start + byte,
            bit,
            size,
        }),
        _ => bad(format!(
            "`{text}` lies outside the process image of {IMAGE_BYTES_MAX} bytes"
        )),
    }
}
