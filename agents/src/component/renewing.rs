//! A new version of an MC's logic: made ready beside the one that runs, run from the state that the old one released, or held
//! because another controller runs it.
//!
//! The old version releases the MC to the new one at a non-critical state, so that nothing has to be diagnosed: a state that was
//! interrupted is the old version's to recover, and is never carried over.

use super::events::ActivateOrder;
use super::{ComponentConfig, McAgent, Next, State};
use fam_proto::access::McAct;
use fam_proto::{McOutcome, Now, Opened, OrderId, Phase};
use std::sync::Arc;

impl McAgent {
    /// A version is ready beside the one that runs.
    pub fn stage(&mut self, config: ComponentConfig) {
        self.staged = Some(Arc::new(config));
    }

    /// Version of the logic that runs here, or would.
    #[must_use]
    pub fn config(&self) -> &ComponentConfig {
        &self.config
    }

    /// An order to run a staged version.
    pub(super) fn renew(&mut self, state: State, order: ActivateOrder, now: Now) -> Next {
        let staged = self.staged.as_ref().map(|s| s.version);
        match state {
            State::Passive if staged == order.renew => self.begin(order, now),
            State::Passive => {
                let why = "this version is not ready here; `fam reload` makes it so".to_owned();
                State::Passive.report(Some(order.id), McOutcome::NotOpened(why))
            }
            // The gateway's record is faster than the scan thread's word.
            State::Releasing { .. } if staged == order.renew => {
                self.renewal = Some(order);
                state.silent()
            }
            other => {
                let why = "it is not passive here".to_owned();
                other.report(Some(order.id), McOutcome::NotOpened(why))
            }
        }
    }

    /// An order to hold a staged version, because another controller runs it.
    pub(super) fn adopt(&mut self, state: State, id: OrderId, version: u64) -> Next {
        let rests = matches!(
            state,
            State::Passive | State::Stopped { .. } | State::Faulted { .. }
        );
        if rests && self.staged.as_ref().is_some_and(|s| s.version == version) {
            self.act(McAct::Adopt { version });
            self.change_version();
        }
        state.report(Some(id), McOutcome::Changed)
    }

    /// The staged version is the one that runs, from now on.
    pub(super) fn change_version(&mut self) {
        if let Some(staged) = self.staged.take() {
            if staged.layout != self.config.layout {
                self.held = None;
            }
            self.config = staged;
        }
    }
}

/// Why a grant is nothing that a new version can start from; `None` if it is.
pub(super) fn objection(grant: &Opened) -> Option<String> {
    let at_rest = grant.base.is_none()
        || (!grant.interrupted && !grant.fail_safe && grant.phase == Some(Phase::Running));
    (!at_rest).then(|| {
        "its state was interrupted meanwhile: the version of before has to bring it to rest first".to_owned()
    })
}
