//! Calls whose method is known only when they run: a small function looks at the instance and calls the right one.

use wasm_encoder::{BlockType, Function, Instruction as I, MemArg, ValType};

use super::helper;
use super::{Behind, SiteKind, State, linked};
use crate::check::tree::{PouId, Receiver, VarId};
use crate::source::Span;
use crate::types::InterfaceId;

/// A function that chooses between methods of one signature.
pub struct Dispatcher {
    /// The method as it was called, and through which interface.
    method: PouId,
    interface: Option<InterfaceId>,
    pub params: Vec<ValType>,
    pub results: Vec<ValType>,
    targets: Vec<Target>,
    /// The site that is named if the instance is of none of the kinds.
    site: i32,
}

struct Target {
    /// What the hidden first variable of the instance holds.
    tag: i32,
    function: u32,
    /// Results and outputs in memory: from, to, bytes.
    copies: Vec<(u32, u32, u32)>,
}

/// What the first variable of an instance of `pou` holds, if the function block has relatives.
pub fn tag_of(pou: PouId) -> i32 {
    pou.0 as i32 + 1
}

impl State<'_> {
    /// Number of the function for a call through `receiver`.
    pub fn method_number(
        &mut self,
        method: PouId,
        receiver: &Receiver,
        caller: PouId,
        span: Span,
    ) -> u32 {
        let interface = match receiver {
            Receiver::Fixed(_) => return self.numbers[&method],
            Receiver::Derived(_) => None,
            Receiver::Interface(_, id) => Some(*id),
        };
        let project = self.project;
        let base = project.pou(method).instance_of;
        let name = project.method_name(method);
        let mut targets: Vec<(PouId, PouId)> = Vec::new();
        for index in 0..project.pous.len() as u32 {
            let block = PouId(index);
            let fits = match interface {
                Some(id) => project.pou(block).implements.iter().any(|i| {
                    *i == id
                        || project.interfaces[i.0 as usize]
                            .methods
                            .iter()
                            .any(|(_, m)| *m == method)
                }),
                None => base.is_some_and(|b| project.derives(block, b)),
            };
            if fits
                && let Some(target) = project.find_method(block, &name)
                && self.numbers.contains_key(&target)
            {
                targets.push((block, target));
            }
        }
        let only = targets.first().map(|t| t.1);
        if interface.is_none() && targets.iter().all(|t| Some(t.1) == only) {
            return only.map_or_else(|| self.numbers[&method], |m| self.numbers[&m]);
        }
        let known = self.find_behind(
            |b| matches!(b, Behind::Dispatcher(d) if d.method == method && d.interface == interface),
        );
        if let Some(number) = known {
            return number;
        }
        let shape = self.shape(method);
        let site = self.site(SiteKind::NullReference, caller, span);
        let targets = targets
            .into_iter()
            .map(|(block, target)| Target {
                tag: tag_of(block),
                function: self.numbers[&target],
                copies: self.copies(target, method),
            })
            .collect();
        self.push_behind(Behind::Dispatcher(Dispatcher {
            method,
            interface,
            params: shape.params,
            results: shape.results,
            targets,
            site,
        }))
    }

    /// Results that lie in memory go from the method that ran to where the caller looks for them.
    fn copies(&mut self, from: PouId, to: PouId) -> Vec<(u32, u32, u32)> {
        if from == to {
            return Vec::new();
        }
        let in_memory = |state: &Self, pou: PouId| -> Vec<VarId> {
            let unit = state.project.pou(pou);
            let outputs = unit.vars.iter().copied().filter(|v| {
                state.project.var(*v).section == crate::syntax::ast::VarSection::Output
            });
            unit.result
                .into_iter()
                .chain(outputs)
                .filter(|v| {
                    let ty = state.project.var(*v).ty;
                    state.project.types.is_aggregate(ty)
                })
                .collect()
        };
        let (sources, targets) = (in_memory(self, from), in_memory(self, to));
        sources
            .into_iter()
            .zip(targets)
            .map(|(source, target)| {
                let size = self.size_of(self.project.var(source).ty);
                (self.scratch_of(source), self.scratch_of(target), size)
            })
            .collect()
    }
}

impl Dispatcher {
    pub fn encode(&self, import_count: u32) -> Function {
        let mut f = Function::new([]);
        let call = |n: u32| linked(&I::Call(n), import_count);
        for target in &self.targets {
            f.instruction(&I::LocalGet(0));
            f.instruction(&I::I32Load(MemArg {
                offset: 0,
                align: 2,
                memory_index: 0,
            }));
            f.instruction(&I::I32Const(target.tag));
            f.instruction(&I::I32Eq);
            f.instruction(&I::If(BlockType::Empty));
            for number in 0..self.params.len() as u32 {
                f.instruction(&I::LocalGet(number));
            }
            f.instruction(&call(target.function));
            for (from, to, bytes) in &target.copies {
                f.instruction(&I::I32Const(*to as i32));
                f.instruction(&I::I32Const(*from as i32));
                f.instruction(&I::I32Const(*bytes as i32));
                f.instruction(&I::MemoryCopy {
                    src_mem: 0,
                    dst_mem: 0,
                });
            }
            f.instruction(&I::Return);
            f.instruction(&I::End);
        }
        f.instruction(&I::I32Const(self.site));
        f.instruction(&I::I64Const(0));
        f.instruction(&call(helper::TRAP));
        f.instruction(&I::Unreachable);
        f.instruction(&I::End);
        f
    }
}
