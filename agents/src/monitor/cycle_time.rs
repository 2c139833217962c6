//! Cycle time: no MC's scans take longer than its cycle again and again, and no MC falls behind real time.
//!
//! Raised once for each epoch of an MC; work balance answers what can be answered by moving, the rest is for people.

use super::{IMAGE_STALE_US, Placement, QualityOfService};
use crate::cell_view::CellView;
use fam_proto::{Cause, ControllerId, Epoch, McId, Now, QosEvent, ResourceReport};
use std::collections::BTreeMap;
use std::hash::{Hash, Hasher};

const NAME: &str = "cycle time";
/// So many reports in a row have to show a growing lag, or more overruns.
const GROWING_REPORTS: u32 = 3;

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Watched {
    epoch: Epoch,
    lag_us: u64,
    growing: u32,
    raised: bool,
}

/// The monitor.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct CycleTime {
    watched: BTreeMap<(ControllerId, McId), Watched>,
    /// Reports that were looked at last.
    reports: BTreeMap<ControllerId, ResourceReport>,
    /// For each controller its count of overruns and how many reports in a row have shown more.
    overruns: BTreeMap<ControllerId, (u64, u32)>,
}

impl CycleTime {
    /// A controller whose ticks overrun in several reports in a row has too much to do, whatever its workload says.
    fn overruns(&mut self, controller: &ControllerId, report: &ResourceReport) -> Option<QosEvent> {
        let known = self
            .overruns
            .entry(controller.clone())
            .or_insert((report.overruns, 0));
        let more = report.overruns > known.0;
        *known = (report.overruns, if more { known.1 + 1 } else { 0 });
        (known.1 == GROWING_REPORTS).then(|| QosEvent {
            qos: NAME.to_owned(),
            cause: Cause::Overload(controller.clone()),
            detail: format!(
                "ticks of {controller} overrun: {} since its start, more in each of the last {GROWING_REPORTS} reports",
                report.overruns
            ),
        })
    }
}

impl QualityOfService for CycleTime {
    fn name(&self) -> &str {
        NAME
    }

    fn monitor(&mut self, view: &CellView, _now: Now) -> Vec<QosEvent> {
        let mut events = Vec::new();
        for (controller, there) in &view.controllers {
            let Some(report) = there.report.as_ref().filter(|_| there.is_up()) else {
                continue;
            };
            if self.reports.get(controller) == Some(report) {
                continue;
            }
            self.reports.insert(controller.clone(), report.clone());
            // What was raised is kept: an MC does not go back to where it could not keep its cycle.
            self.watched.retain(|(c, mc), w| {
                c != controller || w.raised || report.mcs.iter().any(|load| &load.mc == mc)
            });
            events.extend(self.overruns(controller, report));
            for load in &report.mcs {
                let Some(record) = view.mcs.get(&load.mc).and_then(|m| m.record.as_ref()) else {
                    continue;
                };
                let key = (controller.clone(), load.mc.clone());
                let watched = self.watched.entry(key).or_insert_with(|| Watched {
                    epoch: record.epoch,
                    lag_us: load.lag_us,
                    growing: 0,
                    raised: false,
                });
                if watched.epoch != record.epoch {
                    *watched = Watched {
                        epoch: record.epoch,
                        lag_us: load.lag_us,
                        growing: 0,
                        raised: false,
                    };
                }
                // A lag that grows by more than a cycle in each of several reports is no single stall. Without input images an MC
                // has to wait: that is the gateway's matter or the link's, and no controller's.
                let cycle_us = u64::from(load.cycle_us);
                let fed = report.image_age_us <= IMAGE_STALE_US;
                let grown = fed && load.lag_us > watched.lag_us + cycle_us;
                watched.growing = if grown { watched.growing + 1 } else { 0 };
                watched.lag_us = load.lag_us;
                let long = load.scan_us_worst > load.cycle_us;
                if watched.raised || !(long || watched.growing >= GROWING_REPORTS) {
                    continue;
                }
                watched.raised = true;
                let mc = &load.mc;
                let detail = if long {
                    format!(
                        "scans of {mc} on {controller} take up to {} us again and again (mean {} us), its cycle is {} us",
                        load.scan_us_worst, load.scan_us_mean, load.cycle_us
                    )
                } else {
                    format!(
                        "{mc} on {controller} falls behind: {} ms by now",
                        load.lag_us / 1_000
                    )
                };
                events.push(QosEvent {
                    qos: NAME.to_owned(),
                    cause: Cause::Overrun(controller.clone(), mc.clone()),
                    detail,
                });
            }
        }
        events
    }

    /// A controller on which this MC did not keep its cycle is the last choice.
    fn cost(&self, placement: &Placement<'_>) -> u64 {
        let key = (placement.controller.clone(), placement.mc.mc.clone());
        u64::from(self.watched.get(&key).is_some_and(|w| w.raised))
    }

    fn boxed(&self) -> Box<dyn QualityOfService> {
        Box::new(self.clone())
    }

    fn digest(&self, mut hasher: &mut dyn Hasher) {
        self.hash(&mut hasher);
    }
}
