//! What a running MC is told and what becomes of it: release, stop, trap, deposition.

use super::events::{ActivateOrder, ReleaseOrder};
use super::{Action, McAgent, Next, RELEASE_GRACE_US, State, not_released};
use fam_proto::access::McAct;
use fam_proto::{Epoch, McOutcome, Now, OrderId, TrapInfo};

impl McAgent {
    /// A running MC is not taken apart by a manager that does not know of it; an operator may force it.
    pub(super) fn activate_while_running(
        &mut self,
        state: State,
        order: ActivateOrder,
        now: Now,
    ) -> Next {
        let own = match &state {
            State::Active { epoch }
            | State::Releasing { epoch, .. }
            | State::Recovering { epoch, .. } => *epoch,
            _ => Epoch(0),
        };
        if order.force && order.epoch > own {
            self.act(McAct::Deactivate { epoch: own });
            return self.begin(order, now);
        }
        let why = format!("it runs here under epoch {own}");
        state.report(Some(order.id), McOutcome::NotOpened(why))
    }

    pub(super) fn release(
        &mut self,
        epoch: Epoch,
        recovering: Option<Action>,
        order: ReleaseOrder,
        now: Now,
    ) -> Next {
        if order.epoch != epoch {
            let why = format!(
                "the order is about epoch {}, epoch {epoch} runs",
                order.epoch
            );
            return super::running_on(epoch, recovering)
                .report(Some(order.id), McOutcome::ReleaseCancelled(why));
        }
        self.act(McAct::Release {
            epoch,
            successor: order.successor,
            within_us: order.within_us,
        });
        State::Releasing {
            epoch,
            order: order.id,
            until: now.plus_us(order.within_us).plus_us(RELEASE_GRACE_US),
            recovering,
        }
        .silent()
    }

    pub(super) fn cancel_release(&mut self, state: State, id: OrderId, meant: Epoch) -> Next {
        match state {
            State::Releasing {
                epoch,
                until,
                recovering,
                ..
            } if epoch == meant => {
                self.act(McAct::CancelRelease { epoch });
                State::Releasing {
                    epoch,
                    order: id,
                    until,
                    recovering,
                }
                .silent()
            }
            other => other.report(
                Some(id),
                not_released("the order to cancel is about another epoch"),
            ),
        }
    }

    /// An order to stop, in normal logic or while releasing.
    pub(super) fn stop(
        &mut self,
        epoch: Epoch,
        state: State,
        id: OrderId,
        meant: Epoch,
        now: Now,
    ) -> Next {
        if meant != epoch {
            return state.report(Some(id), McOutcome::Changed);
        }
        if let Some(action) = self.config.diagnosis.stop_action {
            self.act(McAct::RunAction { epoch, action });
            let action = Action {
                stopping: true,
                stop_pou: true,
                trap: None,
                order: Some(id),
            };
            return State::Recovering { epoch, action }.report(None, McOutcome::Changed);
        }
        let reason = TrapInfo {
            pou: format!("{}_Control", self.config.mc),
            file: String::new(),
            line: 0,
            message: "stopped by order; the MC has no stop POU, so its fail-safe values are set"
                .to_owned(),
        };
        self.act(McAct::Deactivate { epoch });
        let state = self.close(epoch, reason.clone(), now);
        state.report(Some(id), McOutcome::Faulted(reason))
    }

    pub(super) fn stop_recovering(
        &mut self,
        epoch: Epoch,
        action: Action,
        id: OrderId,
        meant: Epoch,
        now: Now,
    ) -> Next {
        if meant != epoch {
            return State::Recovering { epoch, action }.report(Some(id), McOutcome::Changed);
        }
        if action.stopping {
            let action = Action {
                order: Some(id),
                ..action
            };
            return State::Recovering { epoch, action }.silent();
        }
        self.stop(epoch, State::Recovering { epoch, action }, id, meant, now)
    }

    /// A trap is answered by the stop POU, from the last good checkpoint; a trap in the stop POU, or an MC without one,
    /// by the fail-safe values.
    pub(super) fn trapped(
        &mut self,
        epoch: Epoch,
        during: &Action,
        trap: TrapInfo,
        now: Now,
    ) -> Next {
        match self.config.diagnosis.stop_action {
            Some(action) if !during.stop_pou => {
                self.act(McAct::RunAction { epoch, action });
                let action = Action {
                    stopping: true,
                    stop_pou: true,
                    trap: Some(trap.clone()),
                    order: during.order,
                };
                State::Recovering { epoch, action }.report(None, McOutcome::Faulted(trap))
            }
            _ => {
                self.act(McAct::Deactivate { epoch });
                // The first trap is the cause that people have to see.
                let cause = during.trap.clone().unwrap_or(trap);
                let state = self.close(epoch, cause.clone(), now);
                state.report(during.order, McOutcome::Faulted(cause))
            }
        }
    }

    pub(super) fn deposed(&mut self, epoch: Epoch, why: String) -> Next {
        self.act(McAct::Deactivate { epoch });
        State::Passive.report(None, McOutcome::Deposed(why))
    }
}
