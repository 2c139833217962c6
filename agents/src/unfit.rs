//! Why a controller cannot be given an MC. Read after the controller's name: "controller2 cannot take Press: it is drained".

use crate::cell_view::Loss;
use fam_proto::{ControllerId, McId};

/// The reason.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unfit {
    /// The MC is unknown.
    #[error("knows no MC {0}: the cell model has none of that name")]
    UnknownMc(McId),
    /// The controller is unknown.
    #[error("is not in the cell model")]
    UnknownController,
    /// The model hosts the MC elsewhere.
    #[error("does not host it")]
    NoHost,
    /// No node of that name has come.
    #[error("has not registered")]
    NotRegistered,
    /// It is gone.
    #[error("is lost ({0})")]
    Lost(Loss),
    /// It ends.
    #[error("is leaving")]
    Leaving,
    /// An operator has taken it out.
    #[error("is drained")]
    Drained,
    /// Its project holds another version, or none that fits.
    #[error("{0}")]
    Ineligible(String),
    /// Its project does not hold the MC.
    #[error("has no project that contains it")]
    NoProject,
    /// It owns the MC, and nothing is heard of it.
    #[error("has fallen silent with it")]
    Silent,
    /// It failed to open the MC not long ago.
    #[error("is left out for now ({0})")]
    LeftOut(String),
    /// An operator has named another one.
    #[error("is not {0}, where the operator wants it")]
    Unwished(ControllerId),
    /// It is pinned elsewhere.
    #[error("is not {0}, to which it is pinned")]
    Pinned(ControllerId),
    /// It makes no bid.
    #[error("did not answer the call in time")]
    NoBid,
    /// It says itself that it cannot.
    #[error("{0}")]
    Unable(String),
    /// A quality of service forbids it.
    #[error("{0}")]
    Quality(String),
}
