//! The Zenoh configuration of a FAM process: peers over TCP that find each other by gossip, never by multicast.

use crate::link::LinkOptions;
use fam_proto::ProcessId;
use serde_json::json;

/// How long opening waits for connections that are being made, in milliseconds. A peer that has gone a moment ago is still told
/// of by the others, and is waited for as long: a controller that is started again may not lose more than that.
const OPEN_WAIT_MS: u64 = 150;
/// First and longest pause between two attempts to reach an endpoint, in milliseconds.
const RETRY_MS: (u64, u64) = (50, 400);
/// How long a put waits for room in the queue of one peer that does not take its data, and how long at most for a message of
/// several batches, in microseconds: so long is everybody else held up when a peer freezes.
const WAIT_BEFORE_DROP_US: (u64, u64) = (200, 5_000);
/// Batches of 64 kB that wait for one peer in the queues of images, messages and frames; allocated when needed.
/// 16 hold a frame of 800 kB while the peer's link is busy.
const QUEUE_BATCHES: u64 = 16;

pub(crate) fn config(options: &LinkOptions) -> Result<zenoh::Config, String> {
    // An operator's command is nobody's data path: others do not connect to it, and it connects only where it is told.
    let is_client = matches!(options.process, ProcessId::Client(_));
    // Who does not listen does not look for others either: it reaches the cell through its endpoints alone.
    let found: &[&str] = if options.listen.is_empty() {
        &[]
    } else {
        &["peer"]
    };
    let json = json!({
        "mode": "peer",
        "metadata": { "name": options.process.to_string(), "cell": options.cell.as_str() },
        "listen": { "endpoints": { "peer": options.listen }, "timeout_ms": 0, "exit_on_failure": true },
        "connect": {
            "endpoints": { "peer": options.connect },
            "timeout_ms": -1,
            "exit_on_failure": false,
            "retry": { "period_init_ms": RETRY_MS.0, "period_max_ms": RETRY_MS.1, "period_increase_factor": 2 },
        },
        // Without gossip nothing tells that a connection's declarations are complete; a command repeats itself instead.
        "open": { "return_conditions": { "connect_scouted": true, "declares": !is_client } },
        "scouting": {
            "delay": OPEN_WAIT_MS,
            "multicast": { "enabled": false },
            "gossip": { "enabled": !is_client, "autoconnect": { "peer": found } },
        },
        "transport": { "link": { "tx": { "queue": {
            "size": {
                "control": 2, "real_time": QUEUE_BATCHES, "interactive_high": QUEUE_BATCHES, "interactive_low": 2,
                "data_high": QUEUE_BATCHES, "data": 4, "data_low": 2, "background": 2,
            },
            "congestion_control": { "drop": {
                "wait_before_drop": WAIT_BEFORE_DROP_US.0, "max_wait_before_drop_fragments": WAIT_BEFORE_DROP_US.1,
            } },
        } } } },
        // Read by this process alone, to know which endpoints have a connection.
        "adminspace": { "enabled": true, "permissions": { "read": true, "write": false } },
    });
    zenoh::Config::from_json5(&json.to_string()).map_err(|e| e.to_string())
}
