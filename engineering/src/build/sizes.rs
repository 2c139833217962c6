//! What frames and instances take: of messages, of the link, of controllers.

use super::built::BuiltMc;
use crate::model::{Cell, McSpec};
use crate::problem::Explain;
use fam_proto::codec::MESSAGE_BYTES_MAX;
use fam_soft_plc::diag::Diagnostic;
use fam_soft_plc::layout::Layout;

/// Header of a frame or image beside its bytes, in bytes, at most.
const HEADER_BYTES_MAX: usize = 1024;

/// Frames have to fit into messages, and all of them together through the link.
pub(super) fn sizes(cell: &Cell, mcs: &[BuiltMc], problems: &mut Vec<Diagnostic>) {
    let mut link_bytes_s: u64 = 0;
    for (spec, built) in cell.mcs.iter().zip(mcs) {
        let frame = frame_len(built);
        problems.extend(too_large(cell, spec, frame));
        link_bytes_s += frame as u64 * 1_000_000 / u64::from(spec.cycle_us.max(1));
        for controller in cell
            .controllers
            .iter()
            .filter(|c| spec.hosts.contains(&c.controller))
        {
            let kb = memory_kb(&built.compiled.layout);
            if kb > controller.memory_kb {
                let message = format!(
                    "MC {}: an instance needs {kb} kB, controller {} has {} kB",
                    spec.mc, controller.controller, controller.memory_kb
                );
                problems.push(
                    cell.text
                        .error("M409", spec.at.clone(), message)
                        .hint("give the controller more memory_mb, or take it from the MC's hosts"),
                );
            }
        }
    }
    if let Some(limit) = &cell.link_bytes_s
        && link_bytes_s > *limit.get_ref()
    {
        let message = format!(
            "all MCs together may send {:.1} Mbit/s, the link carries {:.1}",
            link_bytes_s as f64 / 125_000.0,
            *limit.get_ref() as f64 / 125_000.0
        );
        problems.push(
            cell.text
                .error("M410", limit.span(), message)
                .hint("make states smaller or cycles longer, or use a faster link"),
        );
    }
}

/// Reports frames of so many bytes that they are no message.
pub(super) fn too_large(cell: &Cell, mc: &McSpec, frame: usize) -> Option<Diagnostic> {
    (frame > MESSAGE_BYTES_MAX).then(|| {
        let message = format!(
            "MC {}: its frames would have {frame} bytes, a message has at most {MESSAGE_BYTES_MAX}",
            mc.mc
        );
        cell.text
            .error("M408", mc.at.clone(), message)
            .hint("make its arrays smaller, keep what is no state in VAR_TEMP, or divide the MC")
    })
}

fn frame_len(built: &BuiltMc) -> usize {
    HEADER_BYTES_MAX + built.initial_checkpoint.len() + built.compiled.layout.outputs.len as usize
}

/// Linear memory comes in pages.
pub(super) fn memory_kb(layout: &Layout) -> u64 {
    const PAGE_KB: u64 = 64;
    let end = layout
        .regions
        .iter()
        .map(|r| u64::from(r.offset) + u64::from(r.len))
        .max()
        .unwrap_or(0);
    (end.div_ceil(PAGE_KB * 1024)).max(1) * PAGE_KB
}
