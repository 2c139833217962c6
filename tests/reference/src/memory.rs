//! Variables as a tree of nodes: no bytes, no addresses. A reference is the number of a node.

use std::collections::BTreeMap;

use fam_soft_plc::check::tree::{InitValue, PouId, TypedProject, Var, VarId};
use fam_soft_plc::syntax::ast::VarSection;
use fam_soft_plc::types::{Elem, TypeId, TypeKind};
use fam_soft_plc::value::Value;

use crate::text::Units;
use crate::value::Scalar;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct NodeId(pub usize);

#[derive(Clone, Debug)]
pub enum Node {
    Scalar(Elem, Scalar),
    /// Most characters that it holds, and those that it has.
    Text(usize, Units),
    /// Elements in the order of memory (the last index varies fastest), or fields.
    List(Vec<NodeId>),
    Instance(PouId, Vec<NodeId>),
}

/// A value by itself.
#[derive(Clone, Debug)]
pub enum Data {
    Scalar(Scalar),
    Text(Units),
    List(Vec<Data>),
}

pub struct Memory<'p> {
    project: &'p TypedProject,
    nodes: Vec<Node>,
    /// Place of each variable in the instances of its function block.
    members: BTreeMap<(PouId, VarId), usize>,
}

/// Whether the variable is part of the state of its program or instance.
pub fn is_state(var: &Var) -> bool {
    let section = matches!(
        var.section,
        VarSection::Local | VarSection::Input | VarSection::Output
    );
    section && !var.constant
}

pub fn scalar_of(value: Value) -> Scalar {
    match value {
        Value::Real(v) => Scalar::Real(v),
        Value::Lreal(v) => Scalar::Lreal(v),
        Value::Ref(_) => Scalar::Ref(None),
        other => Scalar::Int(other.as_i128().unwrap_or(0)),
    }
}

impl<'p> Memory<'p> {
    pub fn new(project: &'p TypedProject) -> Self {
        let mut members = BTreeMap::new();
        for index in 0..project.pous.len() as u32 {
            let pou = PouId(index);
            let state = project
                .pou(pou)
                .vars
                .iter()
                .filter(|v| is_state(project.var(**v)));
            for (place, var) in state.enumerate() {
                members.insert((pou, *var), place);
            }
        }
        Self {
            project,
            nodes: Vec::new(),
            members,
        }
    }

    fn add(&mut self, node: Node) -> NodeId {
        self.nodes.push(node);
        NodeId(self.nodes.len() - 1)
    }

    /// For `forget`: variables made from here on live only for a call.
    pub fn mark(&self) -> usize {
        self.nodes.len()
    }

    pub fn forget(&mut self, mark: usize) {
        self.nodes.truncate(mark);
    }

    /// A new variable with its initial value.
    pub fn variable(&mut self, ty: TypeId, init: Option<&InitValue>) -> NodeId {
        let project = self.project;
        let node = match project.types.kind(ty) {
            TypeKind::Array { dims, elem } => {
                let count: i64 = dims.iter().map(|(l, h)| h - l + 1).product();
                let list = (0..count).map(|_| self.variable(*elem, None)).collect();
                self.add(Node::List(list))
            }
            TypeKind::Struct { fields } => {
                let list = fields
                    .iter()
                    .map(|f| self.variable(f.ty, f.init.as_ref()))
                    .collect();
                self.add(Node::List(list))
            }
            TypeKind::FunctionBlock(pou) => {
                let mut list = Vec::new();
                for id in &project.pou(*pou).vars {
                    let var = project.var(*id);
                    if is_state(var) {
                        list.push(self.variable(var.ty, var.init.as_ref()));
                    }
                }
                self.add(Node::Instance(*pou, list))
            }
            TypeKind::Str { len, .. } => self.add(Node::Text(*len as usize, Units::new())),
            kind => {
                let (elem, value) = match kind {
                    // The first value named (third edition, 6.4.4.2.2), the lower limit (6.4.4.3.2).
                    TypeKind::Enum { base, values } => {
                        (*base, values.first().map_or(0, |v| v.1.into()))
                    }
                    TypeKind::Subrange { base, lo, .. } => (*base, *lo),
                    TypeKind::Elem(elem) => (*elem, 0),
                    _ => (Elem::Ref, 0),
                };
                let scalar = match Scalar::zero(elem) {
                    Scalar::Int(_) => Scalar::Int(value),
                    other => other,
                };
                self.add(Node::Scalar(elem, scalar))
            }
        };
        if let Some(init) = project.types.init(ty) {
            self.initialise(node, init);
        }
        if let Some(init) = init {
            self.initialise(node, init);
        }
        node
    }

    fn initialise(&mut self, at: NodeId, init: &InitValue) {
        match init {
            InitValue::Scalar(value) => self.set(at, scalar_of(*value)),
            InitValue::Text(units) => self.set_text(at, units.to_vec()),
            InitValue::Array(items) => {
                let children = self.children(at).to_vec();
                let mut next = children.into_iter();
                for (count, item) in items {
                    for child in next.by_ref().take(*count as usize) {
                        self.initialise(child, item);
                    }
                }
            }
            InitValue::Struct(items) => {
                for (index, item) in items {
                    let child = self.children(at)[*index];
                    self.initialise(child, item);
                }
            }
            InitValue::Instance(items) => {
                for (var, item) in items {
                    if let Some(child) = self.member(at, *var) {
                        self.initialise(child, item);
                    }
                }
            }
        }
    }

    pub fn node(&self, at: NodeId) -> &Node {
        &self.nodes[at.0]
    }

    pub fn children(&self, at: NodeId) -> &[NodeId] {
        match self.node(at) {
            Node::List(list) | Node::Instance(_, list) => list,
            Node::Scalar(..) | Node::Text(..) => &[],
        }
    }

    pub fn member(&self, instance: NodeId, var: VarId) -> Option<NodeId> {
        let Node::Instance(pou, list) = self.node(instance) else {
            return None;
        };
        self.members.get(&(*pou, var)).map(|at| list[*at])
    }

    pub fn scalar(&self, at: NodeId) -> Scalar {
        match self.node(at) {
            Node::Scalar(_, value) => *value,
            _ => Scalar::Int(0),
        }
    }

    pub fn set(&mut self, at: NodeId, value: Scalar) {
        if let Node::Scalar(_, old) = &mut self.nodes[at.0] {
            *old = value.kept();
        }
    }

    pub fn text(&self, at: NodeId) -> Units {
        match self.node(at) {
            Node::Text(_, units) => units.clone(),
            _ => Units::new(),
        }
    }

    /// Cut to what the variable holds.
    pub fn set_text(&mut self, at: NodeId, mut text: Units) {
        if let Node::Text(most, units) = &mut self.nodes[at.0] {
            text.truncate(*most);
            *units = text;
        }
    }

    /// The character was there when its place was found; what was evaluated since may have made the string shorter.
    pub fn set_unit(&mut self, at: NodeId, index: usize, unit: u16) {
        if let Node::Text(_, units) = &mut self.nodes[at.0]
            && let Some(old) = units.get_mut(index)
        {
            *old = unit;
        }
    }

    pub fn data(&self, at: NodeId) -> Data {
        match self.node(at) {
            Node::Scalar(_, value) => Data::Scalar(*value),
            Node::Text(_, units) => Data::Text(units.clone()),
            Node::List(list) | Node::Instance(_, list) => {
                Data::List(list.iter().map(|n| self.data(*n)).collect())
            }
        }
    }

    pub fn set_data(&mut self, at: NodeId, data: &Data) {
        match data {
            Data::Scalar(value) => self.set(at, *value),
            Data::Text(units) => self.set_text(at, units.clone()),
            Data::List(list) => {
                let children = self.children(at).to_vec();
                for (child, part) in children.into_iter().zip(list) {
                    self.set_data(child, part);
                }
            }
        }
    }
}
