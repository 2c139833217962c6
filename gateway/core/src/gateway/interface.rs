//! What goes into and comes out of a gateway's core, and why one cannot be made.

use crate::stored::RecordWrite;
use fam_proto::agent::{Input, Output};
use fam_proto::{Applied, GatewayId, InputImage, McId, McInputs};
use std::sync::Arc;

/// What comes in from the gateway's own process.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum GatewayLocal {
    /// A frame arrived.
    Frame(Arc<[u8]>),
    /// Answer to [`GatewayAct::ReadField`]: what was read, in each MC's own `%I` layout. MCs without field inputs may be left out.
    Field(Vec<McInputs>),
    /// A field device stopped answering.
    FieldDeviceLost {
        /// Name or address of the device.
        device: String,
        /// What it did, or did not.
        why: String,
    },
    /// A field device answers (again).
    FieldDeviceBack {
        /// Name or address of the device.
        device: String,
    },
    /// Frames and messages that did not read before they came here, since the start of the process.
    BadMessages(u64),
    /// The process's own timer: as `Agent::handle_timeout`.
    Wake,
    /// The gateway is asked to end: whatever is driven is set to its fail-safe values, because nobody will watch it. Answered by
    /// [`GatewayAct::Left`].
    Leave,
}

/// Why outputs are set.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Why {
    /// A frame was applied.
    Frame(Applied),
    /// Fail-safe values.
    FailSafe,
    /// At the gateway's start: the outputs of an MC that has stopped safely stand as it left them.
    Kept,
}

/// What the gateway's process has to do.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum GatewayAct {
    /// Read the field and answer with [`GatewayLocal::Field`].
    ReadField,
    /// Send an image.
    PublishImage(Arc<InputImage>),
    /// Set an MC's outputs at the field; newer ones replace those not yet written.
    ApplyOutputs {
        /// The MC.
        mc: McId,
        /// Its output image.
        outputs: Arc<[u8]>,
        /// Where they come from.
        why: Why,
    },
    /// All outputs are safe and said so in a last image: the process may end.
    Left,
}

/// What comes into a gateway.
pub type GatewayInput = Input<GatewayLocal>;
/// What a gateway wants done.
pub type GatewayOutput = Output<RecordWrite, GatewayAct>;

/// Why a gateway cannot be made from a cell model.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GatewayError {
    /// No such gateway.
    #[error(
        "the cell `{cell}` has no gateway `{gateway}`; it has {known}. Give one of these with --name, or add it to the cell"
    )]
    UnknownGateway {
        /// The cell.
        cell: String,
        /// What was asked for.
        gateway: GatewayId,
        /// What there is.
        known: String,
    },
    /// An exported variable that this gateway cannot copy.
    #[error("{mc}: input `{input}` is an exported variable of {from}, which {why}")]
    Export {
        /// The importing MC.
        mc: McId,
        /// Its variable.
        input: String,
        /// The exporting MC.
        from: McId,
        /// What is wrong.
        why: &'static str,
    },
    /// A place outside the MC's image.
    #[error("{mc}: `{variable}` lies outside the process image; generate the cell again")]
    Place {
        /// The MC.
        mc: McId,
        /// Its variable.
        variable: String,
    },
}
