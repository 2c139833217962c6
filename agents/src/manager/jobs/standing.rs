//! How the job of an MC stands: only the gateway's record moves it on; what MC Agents report can only end it earlier.

use super::{Aim, Job, MiddlewareManager, Step};
use crate::cell_view::Need;
use fam_proto::{Epoch, McId, Now, Owner, RecordState, RecordSummary};

/// How a job stands.
pub enum Standing {
    Wait,
    /// The old owner has released it.
    Released,
    Done,
    /// Not wanted any more.
    Dropped(String),
    Failed {
        why: String,
        /// The target is left out for this MC.
        leave_out: bool,
    },
}

impl MiddlewareManager {
    pub(super) fn standing(&self, mc: &McId, now: Now) -> Standing {
        let (Some(job), Some((model, view))) = (self.jobs.get(mc), self.view.mc(mc)) else {
            return Standing::Wait;
        };
        let dropped = |why: &str| Standing::Dropped(why.to_owned());
        if !self
            .view
            .gateways
            .get(&model.gateway)
            .is_some_and(|g| g.is_up())
        {
            return dropped("its gateway cannot be seen");
        }
        let Some(record) = &view.record else {
            return Standing::Wait;
        };
        let Some(target) = job.target() else {
            return stop_standing(job, record, now);
        };
        let lost = !self.view.life_is_up(target);
        match &job.step {
            _ if lost && !is_driven_by(record, target, job) => Standing::Failed {
                why: format!("{} is lost", target.controller),
                leave_out: false,
            },
            Step::Reserving => self.reserving(mc, job, record),
            Step::Activating {
                epoch, deadline, ..
            } => self.activating(mc, job, record, *epoch, *deadline, now),
            Step::Releasing {
                epoch, deadline, ..
            } => self.releasing(mc, job, record, *epoch, *deadline, now),
            Step::Stopping { .. } => Standing::Wait,
        }
    }

    /// Nothing has gone out yet: it may simply be dropped.
    fn reserving(&self, mc: &McId, job: &Job, record: &RecordSummary) -> Standing {
        if record.epoch != job.from_epoch || record.owner != job.from {
            return Standing::Dropped("another epoch was opened meanwhile".to_owned());
        }
        match &job.aim {
            Aim::Activate(_) if self.is_healthy_again(mc, job, record) => {
                Standing::Dropped("its owner is healthy again".to_owned())
            }
            Aim::Handover(_) | Aim::Renew(..)
                if self.view.need(mc).is_some() || record.state != RecordState::Open =>
            {
                Standing::Dropped("its owner no longer drives it".to_owned())
            }
            _ => Standing::Wait,
        }
    }

    fn activating(
        &self,
        mc: &McId,
        job: &Job,
        record: &RecordSummary,
        epoch: Epoch,
        deadline: Now,
        now: Now,
    ) -> Standing {
        let failed = |why: String| Standing::Failed {
            why,
            leave_out: true,
        };
        if record.epoch > epoch || (record.epoch == epoch && record.owner.as_ref() != job.target())
        {
            return Standing::Dropped(format!("epoch {} was opened by another", record.epoch));
        }
        if record.epoch == epoch {
            return match &record.state {
                RecordState::Open if record.driven => Standing::Done,
                RecordState::Open if now >= deadline => {
                    failed("no frame was applied in time".to_owned())
                }
                RecordState::Open => Standing::Wait,
                // It ran, and has already gone on.
                RecordState::Released(_) | RecordState::Stopped | RecordState::Faulted(_) => {
                    Standing::Done
                }
                RecordState::Never | RecordState::Closed | RecordState::FailSafe => {
                    failed(format!("its epoch is {} already", record.state.word()))
                }
            };
        }
        if record.state.needs_reset() && job.reset.is_none() {
            return Standing::Dropped(format!("it is {}", record.state.word()));
        }
        if self.is_healthy_again(mc, job, record) {
            return Standing::Dropped("its owner is healthy again".to_owned());
        }
        if now >= deadline {
            return failed("its epoch was not opened in time".to_owned());
        }
        Standing::Wait
    }

    fn releasing(
        &self,
        mc: &McId,
        job: &Job,
        record: &RecordSummary,
        epoch: Epoch,
        deadline: Now,
        now: Now,
    ) -> Standing {
        if record.epoch > epoch || (record.epoch == epoch && record.owner.as_ref() != job.target())
        {
            return Standing::Dropped(format!("epoch {} was opened by another", record.epoch));
        }
        if record.epoch == epoch {
            return Standing::Released;
        }
        match &record.state {
            RecordState::Released(successor) if successor.epoch == epoch => Standing::Released,
            RecordState::Open if record.epoch == job.from_epoch && self.view.need(mc).is_none() => {
                if now >= deadline {
                    Standing::Failed {
                        why: "it came to no non-critical state in time".to_owned(),
                        leave_out: false,
                    }
                } else {
                    Standing::Wait
                }
            }
            state => Standing::Dropped(match self.view.need(mc) {
                Some(Need::Silent(_)) => "its owner fell silent".to_owned(),
                Some(Need::Lost(controller, _)) => format!("{controller} is lost"),
                _ => format!("its record says: {}", state.word()),
            }),
        }
    }

    /// A false alarm: the owner that was given up drives, and nobody wants to take it by force.
    fn is_healthy_again(&self, mc: &McId, job: &Job, record: &RecordSummary) -> bool {
        record.state == RecordState::Open
            && record.epoch == job.from_epoch
            && !job.force
            && job.reset.is_none()
            && self.view.need(mc).is_none()
    }
}

fn stop_standing(job: &Job, record: &RecordSummary, now: Now) -> Standing {
    if record.epoch != job.from_epoch {
        return Standing::Dropped(format!("epoch {} was opened meanwhile", record.epoch));
    }
    match &record.state {
        RecordState::Open | RecordState::Released(_) => match job.deadline() {
            Some((deadline, _)) if now >= deadline => Standing::Failed {
                why: "its stop POU did not end in time".to_owned(),
                leave_out: false,
            },
            _ => Standing::Wait,
        },
        RecordState::Never
        | RecordState::Closed
        | RecordState::FailSafe
        | RecordState::Stopped
        | RecordState::Faulted(_) => Standing::Done,
    }
}

/// Whether the target has got it already: its loss after that is a new failure.
fn is_driven_by(record: &RecordSummary, target: &Owner, job: &Job) -> bool {
    record.epoch > job.from_epoch && record.owner.as_ref() == Some(target) && record.driven
}
