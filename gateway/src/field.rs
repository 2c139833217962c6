//! The field as the gateway's core sees it: read once a tick, set at once.

pub mod image;
pub mod modbus;

use fam_gateway_core::GatewayLocal;
use fam_proto::McId;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::UnboundedSender;

/// A gateway's field.
#[derive(Debug)]
pub enum Field {
    /// One Modbus TCP device.
    Modbus(modbus::Client),
    /// Points in memory.
    Image(Arc<image::Points>),
}

impl Field {
    /// Asks for a read; the answer comes as [`GatewayLocal::Field`].
    pub fn read(&self, locals: &UnboundedSender<GatewayLocal>) {
        match self {
            Field::Modbus(client) => client.read(),
            Field::Image(points) => {
                let _ = locals.send(GatewayLocal::Field(points.inputs()));
            }
        }
    }

    /// Sets an MC's outputs; newer values replace those not yet written.
    pub fn apply(&self, mc: &McId, outputs: &[u8]) {
        match self {
            Field::Modbus(client) => client.apply(mc, outputs),
            Field::Image(points) => points.apply(mc, outputs),
        }
    }

    /// Waits until everything is written, at most `within`; returns whether it is.
    pub async fn flush(&self, within: Duration) -> bool {
        match self {
            Field::Modbus(client) => client.flush(within).await,
            Field::Image(_) => true,
        }
    }
}
