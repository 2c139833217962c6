//! What stopped a scan, in terms of the program.

use std::fmt;

use serde::{Deserialize, Serialize};
use wasmtime::WasmBacktrace;

use crate::codegen::{BEHIND_STRING, CompiledMc, IS_CONSTANT, NO_STRING, SiteKind};
use crate::memory::{CALLER_SITE_AT, TRAP_DETAIL_AT, TRAP_SITE_AT};
use crate::project::STANDARD_LIBRARY_NAME;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum TrapKind {
    DivisionByZero,
    Index,
    Range,
    Conversion,
    NullReference,
    /// A pointer leads to nothing that it could.
    Address,
    EndlessLoop,
    StackOverflow,
    /// Something that compiled code never does; a fault of the compiler or the host.
    Internal,
}

const TOO_LONG: &str = "the scan took too long and was stopped (endless loop?)";

/// A scan that was stopped: why, and at which line.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, Serialize, Deserialize)]
pub struct Trap {
    pub kind: TrapKind,
    pub pou: String,
    pub file: String,
    pub line: u32,
    pub message: String,
}

impl fmt::Display for Trap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)?;
        if !self.pou.is_empty() {
            write!(f, " in {} ({}, line {})", self.pou, self.file, self.line)?;
        }
        Ok(())
    }
}

pub(super) fn explain(mc: &CompiledMc, error: &wasmtime::Error, memory: &[u8]) -> Trap {
    let number = |at: u32, len: usize| {
        let mut raw = [0u8; 8];
        raw[..len].copy_from_slice(&memory[at as usize..at as usize + len]);
        i64::from_le_bytes(raw)
    };
    let cause = error.downcast_ref::<wasmtime::Trap>().copied();
    let site = number(TRAP_SITE_AT, 4) as usize;
    if cause == Some(wasmtime::Trap::UnreachableCodeReached)
        && let Some(site) = site.checked_sub(1).and_then(|s| mc.sites.get(s))
    {
        let (kind, message) = describe(&site.kind, number(TRAP_DETAIL_AT, 8));
        let caller = (number(CALLER_SITE_AT, 4) as usize).checked_sub(1);
        let caller = caller.filter(|_| site.file == STANDARD_LIBRARY_NAME);
        if let Some(called) = caller.and_then(|s| mc.sites.get(s)) {
            return Trap {
                kind,
                pou: called.pou.clone(),
                file: called.file.clone(),
                line: called.line,
                message: format!("{message} (in the standard function called here)"),
            };
        }
        return Trap {
            kind,
            pou: site.pou.clone(),
            file: site.file.clone(),
            line: site.line,
            message,
        };
    }
    let (kind, message) = match cause {
        Some(wasmtime::Trap::OutOfFuel) => (TrapKind::EndlessLoop, TOO_LONG.to_owned()),
        Some(wasmtime::Trap::StackOverflow) => (
            TrapKind::StackOverflow,
            "the calls are nested too deeply".to_owned(),
        ),
        _ => (TrapKind::Internal, format!("the scan failed: {error:#}")),
    };
    let (pou, file, line) = locate(mc, error, kind).unwrap_or_default();
    Trap {
        kind,
        pou,
        file,
        line,
        message,
    }
}

fn describe(kind: &SiteKind, detail: i64) -> (TrapKind, String) {
    match kind {
        SiteKind::DivisionByZero => (TrapKind::DivisionByZero, "division by zero".to_owned()),
        SiteKind::Index(lo, hi) => (
            TrapKind::Index,
            format!("the index {detail} is outside {lo}..{hi}"),
        ),
        SiteKind::Range(lo, hi) => (
            TrapKind::Range,
            format!("the value {detail} is outside {lo}..{hi}"),
        ),
        SiteKind::Enumeration(name) => (
            TrapKind::Conversion,
            format!("the enumeration {name} has no value {detail}"),
        ),
        SiteKind::Selector(count) => (
            TrapKind::Index,
            format!("MUX has {count} inputs and none with number {detail}"),
        ),
        SiteKind::EndlessLoop => (TrapKind::EndlessLoop, TOO_LONG.to_owned()),
        SiteKind::Character => (
            TrapKind::Index,
            format!("the string has no character {detail}"),
        ),
        SiteKind::NullReference => (TrapKind::NullReference, "the reference is NULL".to_owned()),
        SiteKind::Address => {
            let why = match detail {
                IS_CONSTANT => "the pointer leads to a constant, which cannot be written",
                NO_STRING => "the pointer leads to no place where a STRING begins",
                BEHIND_STRING => {
                    "the pointer leads behind the last character that the STRING can have"
                }
                _ => "the pointer leads out of the variables",
            };
            (TrapKind::Address, why.to_owned())
        }
        // Traps have sites of their own.
        SiteKind::Caller => (TrapKind::Internal, "a call failed".to_owned()),
        SiteKind::Text(to) => (
            TrapKind::Conversion,
            format!("the text shows no value of {to}"),
        ),
        SiteKind::Conversion(to) => (
            TrapKind::Conversion,
            format!("the real number does not fit {to}"),
        ),
    }
}

/// POU, file and line. For an endless loop: the innermost loop that is running, wherever below it the time ran out.
fn locate(
    mc: &CompiledMc,
    error: &wasmtime::Error,
    kind: TrapKind,
) -> Option<(String, String, u32)> {
    let trace = error.downcast_ref::<WasmBacktrace>()?;
    let mut frames = Vec::new();
    for frame in trace.frames() {
        // Helpers and dispatchers have no lines.
        let Some(map) = frame
            .func_index()
            .checked_sub(mc.code_map.first_function)
            .and_then(|index| mc.code_map.functions.get(index as usize))
        else {
            continue;
        };
        frames.push((map, frame.func_offset()? as u32));
    }
    if kind == TrapKind::EndlessLoop {
        for (map, at) in &frames {
            let inside = map
                .loops
                .iter()
                .find(|(from, to, _)| (*from..*to).contains(at));
            if let Some((_, _, line)) = inside {
                return Some((map.pou.clone(), map.file.clone(), *line));
            }
        }
    }
    let (map, at) = frames.first()?;
    let next = map.lines.partition_point(|(offset, _)| offset <= at);
    let line = map
        .lines
        .get(next.saturating_sub(1))
        .map_or(0, |(_, line)| *line);
    Some((map.pou.clone(), map.file.clone(), line))
}
