//! The numbered input image that a gateway sends each cycle, with all its records.

use super::record::RecordSummary;
use crate::codec::Wire;
use crate::ids::{BootId, GatewayId, ImageNumber, McId};
use serde::{Deserialize, Serialize};

/// The inputs of one MC: field inputs and the exported variables of other MCs, in the MC's own `%I` layout.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct McInputs {
    /// The MC.
    pub mc: McId,
    /// Its input image.
    #[serde(with = "serde_bytes")]
    pub bytes: Vec<u8>,
    /// Whether all of it was read from the field in this cycle. `false` while a field device does not answer: the bytes are the last ones read.
    pub fresh: bool,
}

/// The outputs of one MC as they stand at its gateway.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct McExports {
    /// The MC.
    pub mc: McId,
    /// Its output image.
    #[serde(with = "serde_bytes")]
    pub outputs: Vec<u8>,
}

/// One cycle's inputs and records.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct InputImage {
    /// The gateway.
    pub gateway: GatewayId,
    /// Its life.
    pub boot: BootId,
    /// Number of the image; grows across restarts.
    pub number: ImageNumber,
    /// When it was sent, on the gateway's clock, in microseconds. For reports; nobody else compares it with a clock.
    pub sent_at_us: u64,
    /// Inputs of every MC of this gateway.
    pub inputs: Vec<McInputs>,
    /// Records of every MC of this gateway: acknowledgements and rejections.
    pub records: Vec<RecordSummary>,
    /// Outputs of the MCs of this gateway whose exported variables MCs of other gateways read.
    pub exports: Vec<McExports>,
}

impl InputImage {
    /// The inputs of one MC.
    #[must_use]
    pub fn inputs_of(&self, mc: &McId) -> Option<&McInputs> {
        self.inputs.iter().find(|i| &i.mc == mc)
    }
    /// The record of one MC.
    #[must_use]
    pub fn record_of(&self, mc: &McId) -> Option<&RecordSummary> {
        self.records.iter().find(|r| &r.mc == mc)
    }
}

impl Wire for InputImage {
    const KIND: u8 = 2;
    const NAME: &'static str = "input image";
}
