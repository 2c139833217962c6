//! From a compiled module to what nodes and gateways know of an MC.

use super::built::{BuiltMc, IntervalText, StateVariable, type_name};
use super::sizes::memory_kb;
use crate::control::ControlLayout;
use crate::generate::{REGION_CHECKPOINT, REGION_STATE, stop_number};
use crate::intervals::Interval;
use crate::io::{self, Image};
use crate::model::McSpec;
use crate::narrow::Narrowed;
use fam_proto::LayoutHash;
use fam_proto::diagnosis::{CriticalInterval, Diagnosis};
use fam_proto::model::McModel;
use fam_soft_plc::CompiledMc;
use fam_soft_plc::layout::{Area, VariableInfo};
use fam_soft_plc::source::SourceFile;
use xxhash_rust::xxh3::Xxh3;

pub(super) fn finish(
    mc: &McSpec,
    intervals: &[Interval],
    compiled: CompiledMc,
    sources: Vec<SourceFile>,
    control_st: String,
    narrowed: &Narrowed,
) -> BuiltMc {
    let layout = &compiled.layout;
    let control = ControlLayout::of(mc.mc.as_str(), layout);
    let checkpoint = layout.region_index(REGION_CHECKPOINT).unwrap_or(0);
    let state = layout.region_index(REGION_STATE).unwrap_or(0);
    let mut initial_checkpoint = layout.initial[checkpoint].clone();
    initial_checkpoint[control.state.start as usize..control.state.end as usize]
        .copy_from_slice(&layout.initial[state]);
    let diagnosis = Diagnosis {
        state_offset: control.state.start,
        checkpoint_len: layout.regions[checkpoint].len,
        intervals: mc
            .intervals
            .iter()
            .zip(intervals)
            .zip(1..)
            .map(|((spec, interval), action)| CriticalInterval {
                name: spec.name.get_ref().clone(),
                rows: interval.rows.clone(),
                kind: spec.kind,
                action,
                pou: spec.recovery.get_ref().clone(),
                repeatable: spec.repeatable,
            })
            .collect(),
        stop_action: mc.stop.as_ref().map(|_| stop_number(mc.intervals.len())),
    };
    let texts = mc
        .intervals
        .iter()
        .zip(intervals)
        .map(|(spec, interval)| IntervalText {
            condition: spec.condition.get_ref().clone(),
            checkpoint_state: interval
                .overlay
                .iter()
                .map(|o| (o.path.clone(), o.value.clone()))
                .collect(),
        })
        .collect();
    let state_variables = layout
        .variables
        .iter()
        .filter(|v| v.area == Area::Region(state) && !narrowed.contains(v.offset))
        // Of which function block an instance is changes with nothing.
        .filter(|v| !v.path.ends_with(crate::reload::TAG_END))
        .map(state_variable)
        .collect();
    BuiltMc {
        mc: mc.mc.clone(),
        program: mc.program.get_ref().clone(),
        cycle_us: mc.cycle_us,
        control,
        initial_checkpoint,
        diagnosis,
        intervals: texts,
        state_variables,
        sources,
        control_st,
        compiled,
    }
}

fn state_variable(variable: &VariableInfo) -> StateVariable {
    StateVariable {
        path: variable.path.clone(),
        type_name: type_name(&variable.ty),
        offset: variable.offset,
        retain: variable.retain,
        len: variable.len,
    }
}

pub(super) fn mc_model(spec: &McSpec, built: &BuiltMc, gateway: fam_proto::GatewayId) -> McModel {
    let layout = &built.compiled.layout;
    McModel {
        mc: spec.mc.clone(),
        gateway,
        hosts: spec.hosts.clone(),
        criticality: spec.criticality,
        cycle_us: spec.cycle_us,
        worst_case_us: spec.worst_case_us,
        memory_kb: memory_kb(layout),
        watchdog_us: spec.watchdog_us,
        suspect_us: spec.suspect_us,
        hash: 0,
        layout: LayoutHash(layout.hash()),
        diagnosis: built.diagnosis.clone(),
        inputs: Vec::new(),
        inputs_len: layout.inputs.len,
        outputs: Vec::new(),
        fail_safe: Vec::new(),
    }
}

pub(super) fn fail_safe(built: &BuiltMc, image: &Image) -> Vec<u8> {
    let mut bytes = vec![0; built.compiled.layout.outputs.len as usize];
    for (l, _, value) in &image.outputs {
        io::put(&mut bytes, l.place, value);
    }
    bytes
}

/// Hash of logic, layout and masks, and of the process image: two nodes with the same hash run the same MC.
pub(super) fn mc_hash(model: &McModel, built: &BuiltMc) -> u64 {
    let mut hasher = Xxh3::new();
    hasher.update(&built.compiled.logic_hash.to_le_bytes());
    hasher.update(&model.layout.0.to_le_bytes());
    hasher.update(crate::plcopen::diagnosis_file::write(built).as_bytes());
    hasher.update(format!("{:?}{:?}{:?}", model.inputs, model.outputs, model.fail_safe).as_bytes());
    hasher.update(&model.cycle_us.to_le_bytes());
    hasher.digest()
}
