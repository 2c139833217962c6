//! Zenoh key expressions, as text. All begin with `fam/<cell>`.
//!
//! | key | from | to |
//! |---|---|---|
//! | `fam/<cell>/frame/<mc>` | the node that drives the MC | its gateway and every hosting node |
//! | `fam/<cell>/image/<gateway>` | the gateway | all nodes, manager |
//! | `fam/<cell>/to/<process>` | any agent | the agents of that process |
//! | `fam/<cell>/frame/<mc>/pieces`, `fam/<cell>/to/<process>/pieces` | as above, for what is too long for one message | as above, each piece acknowledged |
//! | `fam/<cell>/event` | the manager | whoever follows the events |
//! | `fam/<cell>/applied/<gateway>` | the gateway, on request | benchmarks and the demo |
//! | `fam/<cell>/io/<gateway>` | whoever asks | the gateway, which answers |
//! | `fam/<cell>/watch/<gateway>` | whoever watches variables | the gateway, which answers with the MC as it stands |
//! | `fam/<cell>/alive/<process>/<boot>` | liveliness token of a process | gateways, manager, nodes |

use crate::ids::{BootId, CellId, ControllerId, GatewayId, McId, ProcessId};

/// Key of the frames of one MC.
#[must_use]
pub fn frame(cell: &CellId, mc: &McId) -> String {
    format!("fam/{cell}/frame/{mc}")
}

/// Key of the input images of one gateway.
#[must_use]
pub fn image(cell: &CellId, gateway: &GatewayId) -> String {
    format!("fam/{cell}/image/{gateway}")
}

/// Key under which the agents of a process get their messages.
#[must_use]
pub fn to(cell: &CellId, process: &ProcessId) -> String {
    format!("fam/{cell}/to/{}", segment(process))
}

/// Key of what is too long to go as one message under `key`.
#[must_use]
pub fn pieces(key: &str) -> String {
    format!("{key}/pieces")
}

/// Key of the stream of events.
#[must_use]
pub fn event(cell: &CellId) -> String {
    format!("fam/{cell}/event")
}

/// Key of the journal of applied frames of one gateway.
#[must_use]
pub fn applied(cell: &CellId, gateway: &GatewayId) -> String {
    format!("fam/{cell}/applied/{gateway}")
}

/// Key under which a gateway answers questions about its inputs and outputs.
#[must_use]
pub fn io(cell: &CellId, gateway: &GatewayId) -> String {
    format!("fam/{cell}/io/{gateway}")
}

/// Key under which a gateway shows an MC as it stands: its record, its inputs.
#[must_use]
pub fn watch(cell: &CellId, gateway: &GatewayId) -> String {
    format!("fam/{cell}/watch/{gateway}")
}

/// Key of the liveliness token of one life of a process.
#[must_use]
pub fn alive(cell: &CellId, process: &ProcessId, boot: BootId) -> String {
    format!("fam/{cell}/alive/{}/{boot}", segment(process))
}

/// Expression that matches the liveliness tokens of all processes of a cell.
#[must_use]
pub fn alive_all(cell: &CellId) -> String {
    format!("fam/{cell}/alive/**")
}

/// Expression that matches the liveliness tokens of all processes of all cells.
pub const ALIVE_ANYWHERE: &str = "fam/*/alive/**";

/// The cell of a liveliness token; `None` for any other key.
#[must_use]
pub fn cell_alive(key: &str) -> Option<CellId> {
    let (cell, _) = key.strip_prefix("fam/")?.split_once('/')?;
    let cell = CellId::new(cell).ok()?;
    parse_alive(&cell, key).map(|_| cell)
}

/// Reads process and boot out of the key of a liveliness token of `cell`; `None` for any other key.
#[must_use]
pub fn parse_alive(cell: &CellId, key: &str) -> Option<(ProcessId, BootId)> {
    let rest = key
        .strip_prefix("fam/")?
        .strip_prefix(cell.as_str())?
        .strip_prefix("/alive/")?;
    let (process, boot) = rest.rsplit_once('/')?;
    let process = match process.split_once('/') {
        None if process == "manager" => ProcessId::Manager,
        Some(("node", name)) => ProcessId::Node(ControllerId::new(name).ok()?),
        Some(("gateway", name)) => ProcessId::Gateway(GatewayId::new(name).ok()?),
        Some(("client", number)) => ProcessId::Client(number.parse().ok()?),
        _ => return None,
    };
    Some((process, BootId(boot.parse().ok()?)))
}

fn segment(process: &ProcessId) -> String {
    match process {
        ProcessId::Manager => "manager".to_owned(),
        ProcessId::Node(c) => format!("node/{c}"),
        ProcessId::Gateway(g) => format!("gateway/{g}"),
        ProcessId::Client(n) => format!("client/{n}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_liveliness_key_reads_back() {
        let cell = CellId::new("fms200").unwrap();
        for process in [
            ProcessId::Manager,
            ProcessId::Node(ControllerId::new("controller1").unwrap()),
            ProcessId::Gateway(GatewayId::new("gw").unwrap()),
            ProcessId::Client(7),
        ] {
            let key = alive(&cell, &process, BootId(12));
            assert_eq!(
                parse_alive(&cell, &key),
                Some((process, BootId(12))),
                "{key}"
            );
        }
        assert_eq!(parse_alive(&cell, "fam/other/alive/manager/1"), None);
        assert_eq!(parse_alive(&cell, "fam/fms200/alive/manager/x"), None);
    }
}
