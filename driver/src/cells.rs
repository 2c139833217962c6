//! Which cells answer at an endpoint: a command need not be told the name of the only one.

use crate::link::{LinkError, LinkOptions};
use fam_proto::{CellId, ProcessId, keys};
use std::collections::BTreeSet;
use std::time::{Duration, Instant};
use zenoh::Session;

/// From a question that nobody answered to the next one.
const AGAIN_AFTER: Duration = Duration::from_millis(25);

/// The cells whose processes tell at `endpoint` that they are alive; waits until there is one, or for `within`.
///
/// # Errors
/// [`LinkError`] if the endpoint is malformed.
pub async fn cells_at(endpoint: &str, within: Duration) -> Result<BTreeSet<CellId>, LinkError> {
    let deadline = Instant::now() + within;
    let nameless = CellId::new("any").map_err(|e| LinkError::Zenoh {
        what: "looking for cells".to_owned(),
        reason: e.to_string(),
    })?;
    let options = LinkOptions {
        connect: vec![endpoint.to_owned()],
        ..LinkOptions::new(nameless, ProcessId::Client(u64::from(std::process::id())))
    };
    let config = crate::config::config(&options).map_err(|reason| LinkError::Zenoh {
        what: format!("reading the endpoint {endpoint}"),
        reason,
    })?;
    let failed = |e: &zenoh::Error| LinkError::zenoh("looking for cells", e);
    let session = zenoh::open(config).await.map_err(|e| failed(&e))?;
    let cells = loop {
        let cells = alive_cells(&session).await.map_err(|e| failed(&e))?;
        if !cells.is_empty() || Instant::now() >= deadline {
            break cells;
        }
        tokio::time::sleep(AGAIN_AFTER).await;
    };
    // What is not closed now is with the process.
    let _ = session.close().await;
    Ok(cells)
}

async fn alive_cells(session: &Session) -> zenoh::Result<BTreeSet<CellId>> {
    let replies = session.liveliness().get(keys::ALIVE_ANYWHERE).await?;
    let mut cells = BTreeSet::new();
    while let Ok(reply) = replies.recv_async().await {
        if let Ok(sample) = reply.result() {
            cells.extend(keys::cell_alive(sample.key_expr().as_str()));
        }
    }
    Ok(cells)
}
