//! Why a plan is as it is, in words and numbers for the event history.

use super::problem::{Asked, Built};
use crate::planner::{LIMIT_PPM, Solution};
use fam_proto::{Move, QosEvent};

/// Bids named one by one; of more only the number is told.
const BIDS_TOLD_MAX: usize = 8;
/// Moves named one by one.
const MOVES_TOLD_MAX: usize = 12;

pub(super) fn why(
    event: &QosEvent,
    asked: &Asked<'_>,
    built: &Built,
    solution: &Solution,
    moves: &[Move],
) -> String {
    let mut parts = vec![event.detail.clone()];
    parts.push(bids(asked));
    if !moves.is_empty() {
        parts.push(moved(moves));
    }
    let left_out = built.left_out(solution);
    for (mc, why) in &left_out {
        parts.push(format!("{mc} finds no place: {why}"));
    }
    let stay = built.problem.peak_ppm(&built.stay());
    let mut peak = format!(
        "highest worst-case load {} of the limit before, {} after",
        percent(stay),
        percent(solution.peak_ppm)
    );
    if moves.is_empty() {
        peak = format!(
            "highest worst-case load {} of the limit, the best plan has {}",
            percent(stay),
            percent(solution.peak_ppm)
        );
    }
    if solution.peak_ppm > LIMIT_PPM {
        peak.push_str(" (above the limit: better that than not running)");
    }
    if !solution.proven {
        peak.push_str(&format!(
            "; no plan can be below {}",
            percent(solution.lower_bound_ppm)
        ));
    }
    parts.push(peak);
    parts.join(". ")
}

fn bids(asked: &Asked<'_>) -> String {
    if asked.bids.is_empty() {
        return "no bids".to_owned();
    }
    if asked.bids.len() > BIDS_TOLD_MAX {
        return format!("{} bids", asked.bids.len());
    }
    let told: Vec<String> = asked
        .bids
        .values()
        .map(|bid| {
            let controller = &bid.owner.controller;
            let mut text = format!(
                "{controller} is at {}.{} %",
                bid.workload_permille / 10,
                bid.workload_permille % 10
            );
            let reported = asked.view.controllers[controller].report.as_ref();
            if let Some(report) = reported
                && report.workload_permille.abs_diff(bid.workload_permille)
                    > asked.view.model.settings.gain_permille
            {
                text.push_str(&format!(
                    " (its last report said {}.{} %)",
                    report.workload_permille / 10,
                    report.workload_permille % 10
                ));
            }
            text
        })
        .collect();
    format!("bids: {}", told.join(", "))
}

fn moved(moves: &[Move]) -> String {
    let mut told: Vec<String> = moves
        .iter()
        .take(MOVES_TOLD_MAX)
        .map(|m| match &m.from {
            Some(from) => format!("{} from {from} to {}", m.mc, m.to),
            None => format!("{} to {}", m.mc, m.to),
        })
        .collect();
    if moves.len() > MOVES_TOLD_MAX {
        told.push(format!("{} more", moves.len() - MOVES_TOLD_MAX));
    }
    told.join(", ")
}

fn percent(ppm: u64) -> String {
    format!("{}.{} %", ppm / 10_000, ppm / 1_000 % 10)
}
