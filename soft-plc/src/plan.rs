//! Plans the memory of an MC: which POUs the entry reaches, where each variable lies, and its initial bytes.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::check::IMAGE_BYTES_MAX;
use crate::check::tree::{Location, PouId, Root, Stmt, TypedProject, Var, VarId, visit_places};
use crate::diag::{Diagnostic, Problem, finish_all};
use crate::image;
use crate::layout::{
    Area, CompileSpec, FieldNode, Layout, Region, TypeNode, VariableInfo, WORK_REGION,
};
use crate::memory::{Filler, MEMORY_BYTES_MAX, SYSTEM_BYTES, Sizes, is_kept, round_up};
use crate::syntax::ast::PouKind;
use crate::types::{Elem, TypeId, TypeKind};

/// The layout together with what the compiler needs: addresses of variables.
pub(crate) struct Plan {
    pub layout: Layout,
    pub sizes: Sizes,
    /// Address of each variable of a program and each global one; for variables of function blocks the offset in the instance.
    pub addresses: Vec<u32>,
    /// Programs and function blocks that the entry reaches, the entry included.
    pub reachable: Vec<bool>,
    pub entry: PouId,
    /// Constant arrays and structures: address and bytes.
    pub constants: Vec<(u32, Vec<u8>)>,
    /// Where scratch memory begins.
    pub scratch_at: u32,
    /// Address of `%MB0`.
    pub markers_at: u32,
}

struct Builder<'a> {
    project: &'a TypedProject,
    sizes: Sizes,
    nodes: BTreeMap<TypeId, Arc<TypeNode>>,
    placed: BTreeMap<VarId, (Area, u64)>,
    roots: Vec<VariableInfo>,
}

impl Plan {
    pub fn new(project: &TypedProject, spec: &CompileSpec) -> Result<Plan, Vec<Diagnostic>> {
        let mut problems = Vec::new();
        let plan = Self::build(project, spec, &mut problems);
        match plan {
            Some(plan) if problems.is_empty() => Ok(plan),
            _ => Err(finish_all(problems, &project.sources)),
        }
    }

    fn build(
        project: &TypedProject,
        spec: &CompileSpec,
        problems: &mut Vec<Problem>,
    ) -> Option<Plan> {
        let Some(entry) = find_program(project, &spec.entry) else {
            problems.push(no_program(project, &spec.entry));
            return None;
        };
        let regions = resolve_regions(project, spec, problems)?;
        let mut reachable = vec![false; project.pous.len()];
        let mut todo = vec![entry];
        todo.extend(regions.iter().flat_map(|r| r.0.iter().copied()));
        while let Some(pou) = todo.pop() {
            if !std::mem::replace(&mut reachable[pou.0 as usize], true) {
                todo.extend(project.pou(pou).calls.iter().copied());
            }
        }

        let mut builder = Builder {
            project,
            sizes: Sizes::new(project),
            nodes: BTreeMap::new(),
            placed: BTreeMap::new(),
            roots: Vec::new(),
        };
        // Offsets in function block instances are the same everywhere.
        for (ty, _) in project.types.iter() {
            builder.sizes.of(project, ty);
        }
        let mut lens = Vec::new();
        for (index, (programs, globals)) in regions.iter().enumerate() {
            lens.push(builder.region(index, programs, globals));
        }
        let work_programs: Vec<_> = (0..project.pous.len() as u32)
            .map(PouId)
            .filter(|p| project.pou(*p).kind == PouKind::Program && reachable[p.0 as usize])
            .filter(|p| !regions.iter().any(|r| r.0.contains(p)))
            .collect();
        let work_globals: Vec<_> = project
            .globals
            .iter()
            .copied()
            .filter(|g| is_region_variable(project, *g))
            .filter(|g| !regions.iter().any(|r| r.1.contains(g)))
            .collect();
        lens.push(builder.region(regions.len(), &work_programs, &work_globals));
        let region = spec.regions.iter().position(|r| r.markers);
        let region = region.unwrap_or(spec.regions.len());
        let markers = builder.markers(&reachable, region, &mut lens[region]);
        let (inputs_len, outputs_len) = builder.image(&reachable, spec, problems);

        builder.assemble(
            spec,
            entry,
            reachable,
            &lens,
            inputs_len,
            outputs_len,
            (region, markers),
            problems,
        )
    }

    /// The initial bytes of all memory up to the scratch area, as (address, bytes) without runs of zeros.
    pub fn initial_data(&self) -> Vec<(u32, &[u8])> {
        let layout = &self.layout;
        let mut data = vec![(layout.outputs.offset, layout.initial_outputs.as_slice())];
        for (region, bytes) in layout.regions.iter().zip(&layout.initial) {
            data.push((region.offset, bytes.as_slice()));
        }
        for (at, bytes) in &self.constants {
            data.push((*at, bytes.as_slice()));
        }
        data
    }
}

fn find_program(project: &TypedProject, name: &str) -> Option<PouId> {
    project
        .find_pou(name)
        .filter(|p| project.pou(*p).kind == PouKind::Program)
}

fn no_program(project: &TypedProject, name: &str) -> Problem {
    let programs: Vec<&str> = project.programs().collect();
    Problem::general("E501", format!("there is no program `{name}`")).expected(
        if programs.is_empty() {
            "a project that contains a PROGRAM".to_owned()
        } else {
            format!("one of {}", programs.join(", "))
        },
    )
}

fn is_region_variable(project: &TypedProject, id: VarId) -> bool {
    let var = project.var(id);
    !var.constant && var.location.is_none()
}

type Members = (Vec<PouId>, Vec<VarId>);

fn resolve_regions(
    project: &TypedProject,
    spec: &CompileSpec,
    problems: &mut Vec<Problem>,
) -> Option<Vec<Members>> {
    let mut regions: Vec<Members> = Vec::new();
    let before = problems.len();
    for (index, region) in spec.regions.iter().enumerate() {
        let earlier = &spec.regions[..index];
        if region.name == WORK_REGION || earlier.iter().any(|r| r.name == region.name) {
            let message = format!("there are two regions with the name `{}`", region.name);
            problems.push(
                Problem::general("E502", message)
                    .hint("`work` is the region of all that is named nowhere"),
            );
        }
        let mut members: Members = (Vec::new(), Vec::new());
        let twice = |name: &str| {
            Problem::general(
                "E502",
                format!("`{name}` is named in two regions, or twice in one"),
            )
        };
        for name in &region.programs {
            match find_program(project, name) {
                None => problems.push(no_program(project, name)),
                Some(id)
                    if members.0.contains(&id) || regions.iter().any(|r| r.0.contains(&id)) =>
                {
                    problems.push(twice(name));
                }
                Some(id) => members.0.push(id),
            }
        }
        for name in &region.globals {
            match project.find_global(name) {
                None => {
                    let message = format!(
                        "there is no global variable `{name}` for the region `{}`",
                        region.name
                    );
                    problems.push(Problem::general("E503", message));
                }
                Some(id)
                    if members.1.contains(&id) || regions.iter().any(|r| r.1.contains(&id)) =>
                {
                    problems.push(twice(name));
                }
                Some(id) if !is_region_variable(project, id) => {
                    let message = format!(
                        "`{name}` is {} and cannot lie in the region `{}`",
                        if project.var(id).constant {
                            "constant"
                        } else {
                            "part of the process image"
                        },
                        region.name
                    );
                    problems.push(Problem::general("E503", message));
                }
                Some(id) => members.1.push(id),
            }
        }
        regions.push(members);
    }
    (problems.len() == before).then_some(regions)
}

impl Builder<'_> {
    /// Places programs and globals one after the other; answers the length of the region.
    fn region(&mut self, index: usize, programs: &[PouId], globals: &[VarId]) -> u64 {
        let project = self.project;
        let area = Area::Region(index);
        let mut end: u64 = 0;
        for pou in programs {
            let (size, _) = self.sizes.instance(project, *pou);
            let base = round_up(end, 8);
            for id in &project.pou(*pou).vars {
                if is_kept(project.var(*id)) {
                    let at = base.saturating_add(self.sizes.offsets[id.0 as usize]);
                    self.place(*id, area, at);
                }
            }
            end = base.saturating_add(size);
        }
        for id in globals {
            let (size, align) = self.sizes.of(project, project.var(*id).ty);
            let at = round_up(end, align);
            self.place(*id, area, at);
            end = at.saturating_add(size);
        }
        round_up(end, 8)
    }

    fn place(&mut self, id: VarId, area: Area, at: u64) {
        let var = self.project.var(id);
        self.placed.insert(id, (area, at));
        let path = match var.owner {
            Some(pou) => format!("{}.{}", self.project.pou(pou).name, var.name),
            None => var.name.clone(),
        };
        let (mut len, _) = self.sizes.of(self.project, var.ty);
        if var.location.is_some() {
            len = self.image_bytes(var);
        }
        let ty = if var.is_closer(&self.project.types) {
            self.node_in_image(var.ty)
        } else {
            self.node(var.ty)
        };
        if at.saturating_add(len) > MEMORY_BYTES_MAX {
            return;
        }
        let info = VariableInfo {
            path,
            area,
            offset: at as u32,
            bit: var.location.and_then(|l| l.bit),
            len: len as u32,
            ty,
            retain: var.retain,
        };
        self.roots.push(info);
    }

    fn image_bytes(&mut self, var: &Var) -> u64 {
        let types = &self.project.types;
        if let Some(elem) = types.elem(var.ty) {
            return elem.image_bytes().into();
        }
        if var.is_closer(types) {
            let first = var.location.and_then(|l| l.bit).unwrap_or(0);
            let bits = image::extent(types, var.ty).map_or(0, |(bits, _)| bits);
            return bits.saturating_add(first.into()).div_ceil(8);
        }
        self.sizes.of(self.project, var.ty).0
    }

    /// The shape of what lies closer in the process image than in memory.
    fn node_in_image(&mut self, ty: TypeId) -> Arc<TypeNode> {
        let types = &self.project.types;
        let bytes = |bits: u64| bits.div_ceil(8).min(u64::from(u32::MAX)) as u32;
        Arc::new(match types.kind(ty) {
            TypeKind::Array { dims, elem } => TypeNode::Array {
                dims: dims.clone(),
                stride: bytes(image::stride_bits(types, *elem)),
                elem: self.node_in_image(*elem),
            },
            TypeKind::Struct { fields } => {
                let mut list = Vec::new();
                for (index, field) in fields.iter().enumerate() {
                    let (from, bits, _) = image::field(types, ty, index).unwrap_or_default();
                    let of_bits = match types.kind(field.ty) {
                        TypeKind::Array { elem, .. } => *elem,
                        _ => field.ty,
                    };
                    let bit = (types.elem(of_bits) == Some(Elem::Bool)).then_some((from % 8) as u8);
                    list.push(FieldNode {
                        name: field.name.clone(),
                        offset: (from / 8) as u32,
                        len: bytes(bits + from % 8),
                        bit,
                        retain: false,
                        ty: self.node_in_image(field.ty),
                    });
                }
                TypeNode::Struct {
                    name: self.project.type_name(ty),
                    fields: list,
                }
            }
            _ => return self.node(ty),
        })
    }

    /// Places `%M` variables behind what the region holds, which grows by them; answers where they begin.
    fn markers(&mut self, reachable: &[bool], region: usize, end: &mut u64) -> u64 {
        let project = self.project;
        let start = round_up(*end, 8);
        let mut len = 0;
        for index in 0..project.vars.len() as u32 {
            let id = VarId(index);
            let var = project.var(id);
            let Some(location) = var.location.filter(|l| l.memory) else {
                continue;
            };
            if var.owner.is_some_and(|o| !reachable[o.0 as usize]) {
                continue;
            }
            len = len.max(u64::from(location.byte) + self.image_bytes(var));
            self.place(id, Area::Region(region), start + u64::from(location.byte));
        }
        for (index, pou) in project.pous.iter().enumerate() {
            if reachable[index] {
                for location in direct_locations(&pou.body) {
                    if location.memory {
                        len = len.max(u64::from(location.byte) + 8);
                    }
                }
            }
        }
        if len > 0 {
            *end = round_up(start + len, 8);
        }
        start
    }

    /// Places located variables; answers the lengths of inputs and outputs.
    fn image(
        &mut self,
        reachable: &[bool],
        spec: &CompileSpec,
        problems: &mut Vec<Problem>,
    ) -> (u64, u64) {
        let project = self.project;
        let mut lens = [
            u64::from(spec.input_bytes_min),
            u64::from(spec.output_bytes_min),
        ];
        for index in 0..project.vars.len() as u32 {
            let id = VarId(index);
            let var = project.var(id);
            let Some(location) = var.location.filter(|l| !l.memory) else {
                continue;
            };
            if var.owner.is_some_and(|o| !reachable[o.0 as usize]) {
                continue;
            }
            let area = if location.output {
                Area::Outputs
            } else {
                Area::Inputs
            };
            let end = u64::from(location.byte) + self.image_bytes(var);
            if end > u64::from(IMAGE_BYTES_MAX) {
                let message = format!("`{}` reaches beyond the process image", var.name);
                problems.push(Problem::error("E504", var.span, message));
                continue;
            }
            let len = &mut lens[usize::from(location.output)];
            *len = (*len).max(end);
            self.place(id, area, u64::from(location.byte));
        }
        for (index, pou) in project.pous.iter().enumerate() {
            if reachable[index] {
                for location in direct_locations(&pou.body) {
                    if location.memory {
                        continue;
                    }
                    let width = match location.size {
                        'W' => 2,
                        'D' => 4,
                        'L' => 8,
                        _ => 1,
                    };
                    let len = &mut lens[usize::from(location.output)];
                    *len = (*len).max(u64::from(location.byte) + width);
                }
            }
        }
        (round_up(lens[0], 8), round_up(lens[1], 8))
    }

    fn node(&mut self, ty: TypeId) -> Arc<TypeNode> {
        if let Some(node) = self.nodes.get(&ty) {
            return node.clone();
        }
        let project = self.project;
        let node = match project.types.kind(ty) {
            TypeKind::Enum { base, values } => TypeNode::Enum {
                name: project.type_name(ty),
                base: *base,
                values: values.clone(),
            },
            TypeKind::Subrange { base, lo, hi } => TypeNode::Subrange {
                base: *base,
                lo: *lo as i64,
                hi: *hi as i64,
            },
            TypeKind::Str { wide, len } => TypeNode::Text {
                wide: *wide,
                len: *len,
            },
            TypeKind::Array { dims, elem } => TypeNode::Array {
                dims: dims.clone(),
                stride: self.sizes.stride(project, *elem) as u32,
                elem: self.node(*elem),
            },
            TypeKind::Struct { fields } => {
                let mut list = Vec::new();
                for (index, field) in fields.iter().enumerate() {
                    list.push(FieldNode {
                        name: field.name.clone(),
                        offset: self.sizes.field(project, ty, index) as u32,
                        len: self.sizes.of(project, field.ty).0 as u32,
                        bit: None,
                        retain: false,
                        ty: self.node(field.ty),
                    });
                }
                TypeNode::Struct {
                    name: project.type_name(ty),
                    fields: list,
                }
            }
            TypeKind::FunctionBlock(pou) => {
                let mut list = Vec::new();
                for id in &project.pou(*pou).vars {
                    let var = project.var(*id);
                    if is_kept(var) {
                        list.push(FieldNode {
                            name: var.name.clone(),
                            offset: self.sizes.offsets[id.0 as usize] as u32,
                            len: self.sizes.of(project, var.ty).0 as u32,
                            bit: None,
                            retain: var.retain,
                            ty: self.node(var.ty),
                        });
                    }
                }
                TypeNode::Struct {
                    name: project.pou(*pou).name.clone(),
                    fields: list,
                }
            }
            _ => TypeNode::Elem(project.types.elem(ty).unwrap_or(Elem::Bool)),
        };
        let node = Arc::new(node);
        self.nodes.insert(ty, node.clone());
        node
    }

    #[allow(clippy::too_many_arguments)]
    fn assemble(
        mut self,
        spec: &CompileSpec,
        entry: PouId,
        reachable: Vec<bool>,
        lens: &[u64],
        inputs_len: u64,
        outputs_len: u64,
        (markers_in, markers): (usize, u64),
        problems: &mut Vec<Problem>,
    ) -> Option<Plan> {
        let project = self.project;
        let mut at = u64::from(SYSTEM_BYTES);
        let mut take = |len: u64| {
            let start = at;
            at = round_up(at.saturating_add(len), 8);
            start
        };
        let inputs = (take(inputs_len), inputs_len);
        let outputs = (take(outputs_len), outputs_len);
        let starts: Vec<u64> = lens.iter().map(|len| take(*len)).collect();
        let mut constants = Vec::new();
        for index in 0..project.vars.len() as u32 {
            let id = VarId(index);
            let var = project.var(id);
            if var.constant && project.types.is_aggregate(var.ty) {
                let (size, _) = self.sizes.of(project, var.ty);
                constants.push((id, take(size), size));
            }
        }
        if at > MEMORY_BYTES_MAX {
            let message =
                format!("the variables take {at} bytes, and an MC has at most {MEMORY_BYTES_MAX}");
            problems.push(Problem::general("E505", message).hint("make the arrays smaller"));
            return None;
        }
        let named = |name: &str, (offset, len): (u64, u64)| Region {
            name: name.to_owned(),
            offset: offset as u32,
            len: len as u32,
        };
        let names = spec
            .regions
            .iter()
            .map(|r| r.name.as_str())
            .chain([WORK_REGION]);
        let regions: Vec<Region> = names
            .zip(starts.iter().zip(lens))
            .map(|(name, (start, len))| named(name, (*start, *len)))
            .collect();

        let mut addresses: Vec<u32> = self.sizes.offsets.iter().map(|o| *o as u32).collect();
        let mut initial: Vec<Vec<u8>> = regions.iter().map(|r| vec![0; r.len as usize]).collect();
        let mut initial_outputs = vec![0; outputs_len as usize];
        let mut filler = Filler {
            project,
            sizes: &mut self.sizes,
        };
        for (id, (area, at)) in &self.placed {
            let var = project.var(*id);
            let address = match area {
                Area::Region(index) => u64::from(regions[*index].offset) + at,
                Area::Inputs => inputs.0 + at,
                Area::Outputs => outputs.0 + at,
            };
            addresses[id.0 as usize] = address as u32;
            let at = *at as usize;
            match area {
                Area::Region(index) if var.location.is_some() => {
                    initial_output(&mut filler, var, at, &mut initial[*index]);
                }
                Area::Region(index) => {
                    let (size, _) = filler.sizes.of(project, var.ty);
                    let bytes = &mut initial[*index][at..at + size as usize];
                    filler.variable(bytes, var.ty, var.init.as_ref());
                }
                Area::Outputs => initial_output(&mut filler, var, at, &mut initial_outputs),
                Area::Inputs => {}
            }
        }
        let mut constant_bytes = Vec::new();
        for (id, at, size) in constants {
            let var = project.var(id);
            let mut bytes = vec![0; size as usize];
            filler.variable(&mut bytes, var.ty, var.init.as_ref());
            addresses[id.0 as usize] = at as u32;
            constant_bytes.push((at as u32, bytes));
        }
        let mut variables = Vec::new();
        for root in &self.roots {
            root.expand(false, &mut variables);
        }
        let layout = Layout {
            regions,
            inputs: named("inputs", inputs),
            outputs: named("outputs", outputs),
            variables,
            roots: self.roots,
            initial,
            initial_outputs,
        };
        let markers_at = layout.regions.get(markers_in).map_or(0, |r| r.offset) + markers as u32;
        Some(Plan {
            markers_at,
            layout,
            sizes: self.sizes,
            addresses,
            reachable,
            entry,
            constants: constant_bytes,
            scratch_at: at as u32,
        })
    }
}

/// Of variables that share their place, the one that says a value has it: a value of zeros is not written.
fn initial_output(filler: &mut Filler<'_>, var: &Var, at: usize, image: &mut [u8]) {
    let project = filler.project;
    let (size, _) = filler.sizes.of(project, var.ty);
    let mut cells = vec![0; size as usize];
    filler.variable(&mut cells, var.ty, var.init.as_ref());
    let first = at * 8 + usize::from(var.location.and_then(|l| l.bit).unwrap_or(0));
    to_image(project, filler.sizes, var.ty, &cells, first, image);
}

/// Brings a value from the form of memory into that of the image, from bit `first` on.
fn to_image(
    project: &TypedProject,
    sizes: &mut Sizes,
    ty: TypeId,
    cells: &[u8],
    first: usize,
    image: &mut [u8],
) {
    if cells.iter().all(|byte| *byte == 0) {
        return;
    }
    let types = &project.types;
    match types.kind(ty) {
        TypeKind::Array { elem, .. } => {
            let stride = sizes.stride(project, *elem) as usize;
            let bits = image::stride_bits(types, *elem) as usize;
            for (index, value) in cells.chunks_exact(stride).enumerate() {
                to_image(project, sizes, *elem, value, first + index * bits, image);
            }
        }
        TypeKind::Struct { fields } => {
            for (index, field) in fields.iter().enumerate() {
                let from = sizes.field(project, ty, index) as usize;
                let (size, _) = sizes.of(project, field.ty);
                let value = &cells[from..from + size as usize];
                let bit = image::field_bit(types, ty, index) as usize;
                to_image(project, sizes, field.ty, value, first + bit, image);
            }
        }
        _ => match types.elem(ty) {
            Some(Elem::Bool) => {
                if let Some(byte) = image.get_mut(first / 8) {
                    *byte |= (cells[0] & 1) << (first % 8);
                }
            }
            Some(elem) => {
                let width = elem.image_bytes() as usize;
                if let Some(place) = image.get_mut(first / 8..first / 8 + width) {
                    place.copy_from_slice(&cells[..width]);
                }
            }
            None => {}
        },
    }
}

/// Addresses used without a variable, `%QX0.0 := TRUE`.
fn direct_locations(body: &[Stmt]) -> Vec<Location> {
    let mut found = Vec::new();
    visit_places(body, &mut |place| {
        if let Root::Direct(location) = place.root {
            found.push(location);
        }
    });
    found
}
