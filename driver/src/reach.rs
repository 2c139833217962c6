//! Which of the configured endpoints have a connection: said in the log, and to whoever asks.
//!
//! Zenoh keeps trying by itself; what it has connected stands in its administration space, which only this process reads.

use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// How often the connections are looked at.
const LOOK_EVERY: Duration = Duration::from_millis(500);
/// How long an endpoint may be without connection before the log says so first.
const SAY_AFTER: Duration = Duration::from_secs(1);
/// How often it is said again.
const SAY_AGAIN: Duration = Duration::from_secs(5);
/// How long the answer of this process's own administration space is waited for.
const ANSWER_WITHIN: Duration = Duration::from_secs(2);

#[derive(Debug, Default)]
pub(crate) struct Reach {
    endpoints: Vec<String>,
    unreachable: Mutex<Vec<String>>,
}

impl Reach {
    pub(crate) fn new(endpoints: Vec<String>) -> Reach {
        Reach {
            unreachable: Mutex::new(endpoints.clone()),
            endpoints,
        }
    }

    /// As seen at the last look.
    pub(crate) fn unreachable(&self) -> Vec<String> {
        self.unreachable
            .lock()
            .map(|u| u.clone())
            .unwrap_or_default()
    }

    /// Looks now.
    pub(crate) async fn look(&self, session: &zenoh::Session) -> Vec<String> {
        if self.endpoints.is_empty() {
            return Vec::new();
        }
        let connected = connected(session).await;
        let mut missing = Vec::new();
        for endpoint in &self.endpoints {
            let addresses = resolve(endpoint).await;
            if addresses.iter().all(|a| !connected.contains(a)) {
                missing.push(endpoint.clone());
            }
        }
        if let Ok(mut unreachable) = self.unreachable.lock() {
            unreachable.clone_from(&missing);
        }
        missing
    }

    /// Looks again and again until the session is closed, and logs what changes.
    pub(crate) async fn watch(self: Arc<Self>, session: zenoh::Session, process: String) {
        let mut said: std::collections::BTreeMap<String, Instant> = Default::default();
        let mut since = Instant::now();
        let mut before: BTreeSet<String> = self.endpoints.iter().cloned().collect();
        let mut every = tokio::time::interval(LOOK_EVERY);
        every.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        while !session.is_closed() {
            every.tick().await;
            crate::linger::off();
            let missing: BTreeSet<String> = self.look(&session).await.into_iter().collect();
            for endpoint in before.difference(&missing) {
                tracing::info!("{process} is connected to {endpoint}");
                said.remove(endpoint);
            }
            if missing.is_empty() || missing != before {
                since = Instant::now();
            }
            for endpoint in &missing {
                let again = said
                    .get(endpoint)
                    .is_none_or(|at: &Instant| at.elapsed() >= SAY_AGAIN);
                if since.elapsed() >= SAY_AFTER && again {
                    tracing::warn!(
                        "{process} cannot reach {endpoint} and keeps trying: is the process that listens there started?"
                    );
                    said.insert(endpoint.clone(), Instant::now());
                }
            }
            before = missing;
        }
    }
}

/// Addresses of the far ends of this session's links.
async fn connected(session: &zenoh::Session) -> BTreeSet<SocketAddr> {
    let mut found = BTreeSet::new();
    let key = format!("@/{}/peer", session.zid());
    let Ok(replies) = session.get(key).timeout(ANSWER_WITHIN).await else {
        return found;
    };
    let Ok(reply) = replies.recv_async().await else {
        return found;
    };
    let Ok(sample) = reply.result() else {
        return found;
    };
    let Ok(data) = serde_json::from_slice::<serde_json::Value>(&sample.payload().to_bytes()) else {
        return found;
    };
    let list =
        |value: &serde_json::Value, name: &str| value[name].as_array().cloned().unwrap_or_default();
    for transport in list(&data, "sessions") {
        for link in list(&transport, "links") {
            let far = link["dst"].as_str().and_then(address);
            found.extend(far.and_then(|a| a.parse::<SocketAddr>().ok()));
        }
    }
    found
}

async fn resolve(endpoint: &str) -> Vec<SocketAddr> {
    let Some(address) = address(endpoint) else {
        return Vec::new();
    };
    match tokio::net::lookup_host(address).await {
        Ok(addresses) => addresses.collect(),
        Err(_) => Vec::new(),
    }
}

/// `host:port` of an endpoint `tcp/host:port?metadata#config`.
pub(crate) fn address(endpoint: &str) -> Option<&str> {
    let rest = endpoint.split_once('/')?.1;
    rest.split(['?', '#']).next()
}

/// For error messages: names the endpoints without connection, or nothing.
pub(crate) fn not_connected(unreachable: &[String]) -> String {
    if unreachable.is_empty() {
        String::new()
    } else {
        format!(" (no connection to {})", unreachable.join(", "))
    }
}
