//! Watches a running cell from outside: what is applied behind the fence, the manager's status and events, the plant.
//!
//! Demo and benchmarks judge by this alone. The journal of applied frames comes from the gateway; its times are on the
//! machine's monotonic clock, which this process shares, so that the moment of a signal can be compared with them.

use anyhow::{Result, bail};
use fam_driver::{Client, ClientError, Subscription};
use fam_gateway::recording::fetch;
use fam_proto::codec;
use fam_proto::{
    Applied, AppliedBatch, CellId, CellStatus, CommandKind, Event, GatewayId, McId, Query,
    QueryReply,
};
use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};

/// Pause between two looks at the manager's status and events.
const LOOK: Duration = Duration::from_millis(100);
/// How long one question may take; the manager may be down on purpose.
const ASK_WITHIN: Duration = Duration::from_millis(400);
/// How long a command may take.
const COMMAND_WITHIN: Duration = Duration::from_secs(20);

/// What has been seen so far.
#[derive(Debug, Default)]
pub struct Seen {
    /// Frames applied, in order, with times in microseconds of the machine's monotonic clock.
    pub applied: Vec<Applied>,
    /// Pieces of the journal that were lost on the way, in entries.
    pub holes: u64,
    /// Newest applied frame of each MC.
    pub newest: BTreeMap<McId, Applied>,
    /// Events of the manager, oldest first.
    pub events: Vec<Event>,
    /// Every status, and when it came.
    pub history: Vec<(Instant, CellStatus)>,
    journal: Option<(u64, u64)>,
    /// The journal is missing from here on; what comes meanwhile waits in `pending`.
    missing: Option<u64>,
    pending: Vec<AppliedBatch>,
}

impl Seen {
    /// Controller whose frame of the MC was applied last.
    pub fn driver(&self, mc: &McId) -> Option<&str> {
        self.newest.get(mc).map(|a| a.owner.controller.as_str())
    }

    /// Newest status.
    pub fn status(&self) -> Option<&CellStatus> {
        self.history.last().map(|(_, status)| status)
    }

    /// Workload of each controller that is up, in percent of its limit.
    pub fn workloads(&self) -> Vec<(String, f64)> {
        let Some(status) = self.status() else {
            return Vec::new();
        };
        status
            .controllers
            .iter()
            .filter(|c| c.up)
            .filter_map(|c| {
                Some((
                    c.controller.to_string(),
                    crate::status::percent(c.report.as_ref()?.workload_permille),
                ))
            })
            .collect()
    }

    /// A piece from the stream: what is missing before it is asked for first.
    fn stream(&mut self, batch: AppliedBatch) {
        let expected = match self.journal {
            Some((boot, next)) if boot == batch.boot.0 => next,
            _ => 0,
        };
        if self.missing.is_some() || batch.first > expected {
            self.missing.get_or_insert(expected);
            self.pending.push(batch);
        } else {
            self.take(batch);
        }
    }

    /// A piece that was asked for. More has to be asked for unless it reaches the stream.
    fn fetched(&mut self, batch: AppliedBatch) {
        let end = batch.first + batch.entries.len() as u64;
        let done = batch.entries.is_empty()
            || self
                .pending
                .first()
                .is_none_or(|p| p.boot != batch.boot || p.first <= end);
        self.missing = Some(end);
        self.take(batch);
        if done {
            self.missing = None;
            for batch in std::mem::take(&mut self.pending) {
                self.take(batch);
            }
        }
    }

    fn take(&mut self, batch: AppliedBatch) {
        let place = match self.journal {
            Some((boot, next)) if boot == batch.boot.0 => {
                if batch.first + (batch.entries.len() as u64) <= next {
                    return;
                }
                self.holes += batch.first.saturating_sub(next);
                next
            }
            _ => batch.first,
        };
        let known = usize::try_from(place.saturating_sub(batch.first)).unwrap_or(usize::MAX);
        self.journal = Some((batch.boot.0, batch.first + batch.entries.len() as u64));
        for mut entry in batch.entries.into_iter().skip(known) {
            entry.at_us = entry.at_us.saturating_add_signed(batch.monotonic_offset_us);
            self.newest.insert(entry.mc.clone(), entry.clone());
            self.applied.push(entry);
        }
    }
}

/// A watcher; ends when dropped.
pub struct Observer {
    runtime: tokio::runtime::Runtime,
    shared: Arc<(Mutex<Seen>, Condvar)>,
    commands: Arc<tokio::sync::Mutex<Client>>,
    _journal: Subscription,
}

impl Observer {
    /// Connects to manager and gateway, and begins to watch.
    ///
    /// # Errors
    /// If an endpoint is malformed.
    pub fn start(
        cell: &CellId,
        gateway: &GatewayId,
        manager_endpoint: &str,
        gateway_endpoint: &str,
    ) -> Result<Observer> {
        let runtime = fam_driver::runtime()?;
        let shared: Arc<(Mutex<Seen>, Condvar)> = Arc::default();
        let connect = vec![manager_endpoint.to_owned(), gateway_endpoint.to_owned()];
        let (watcher, commands) = runtime.block_on(async {
            let watcher = Client::open(cell.clone(), connect.clone()).await?;
            anyhow::Ok((
                watcher,
                Client::open(cell.clone(), vec![manager_endpoint.to_owned()]).await?,
            ))
        })?;
        let sink = shared.clone();
        let journal = runtime.block_on(async {
            watcher
                .link()
                .subscribe(&fam_proto::keys::applied(cell, gateway), move |_, bytes| {
                    if let (Ok(batch), Ok(mut seen)) =
                        (codec::decode::<AppliedBatch>(&bytes), sink.0.lock())
                    {
                        seen.stream(batch);
                        sink.1.notify_all();
                    }
                })
        })?;
        runtime.spawn(look(watcher, gateway.clone(), shared.clone()));
        Ok(Observer {
            runtime,
            shared,
            commands: Arc::new(tokio::sync::Mutex::new(commands)),
            _journal: journal,
        })
    }

    /// What has been seen so far.
    pub fn seen(&self) -> MutexGuard<'_, Seen> {
        match self.shared.0.lock() {
            Ok(seen) => seen,
            Err(poisoned) => poisoned.into_inner(),
        }
    }

    /// Waits until `enough` gives a value.
    ///
    /// # Errors
    /// If it does not in time; the message says what was waited for.
    pub fn wait<T>(
        &self,
        what: &str,
        within: Duration,
        mut enough: impl FnMut(&Seen) -> Option<T>,
    ) -> Result<T> {
        let deadline = Instant::now() + within;
        let mut seen = self.seen();
        loop {
            if let Some(value) = enough(&seen) {
                return Ok(value);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                bail!("waited {within:?} for this in vain: {what}");
            }
            seen = match self.shared.1.wait_timeout(seen, left) {
                Ok((seen, _)) => seen,
                Err(poisoned) => poisoned.into_inner().0,
            };
        }
    }

    /// Gives an operator's command and waits for its end.
    ///
    /// # Errors
    /// If the manager refuses, cannot be reached, or does not finish in time.
    pub fn command(&self, what: CommandKind) -> Result<String> {
        let client = self.commands.clone();
        self.runtime.block_on(async move {
            Ok(client
                .lock()
                .await
                .command(what, COMMAND_WITHIN, |_| {})
                .await?)
        })
    }

    /// Gives an operator's command without waiting for its end; `then` gets it.
    pub fn command_along(
        &self,
        what: CommandKind,
        then: impl FnOnce(Result<String, ClientError>) + Send + 'static,
    ) {
        let client = self.commands.clone();
        self.runtime.spawn(async move {
            let result = client
                .lock()
                .await
                .command(what, COMMAND_WITHIN, |_| {})
                .await;
            then(result);
        });
    }

    /// Runs something asynchronous on the observer's runtime.
    pub fn block_on<F: Future>(&self, future: F) -> F::Output {
        self.runtime.block_on(future)
    }
}

/// Asks for status and events for ever; survives restarts of the manager.
async fn look(mut client: Client, gateway: GatewayId, shared: Arc<(Mutex<Seen>, Condvar)>) {
    let cell = client.link().cell().clone();
    let mut after = 0;
    loop {
        loop {
            let missing = shared.0.lock().ok().and_then(|seen| seen.missing);
            let Some(position) = missing else { break };
            let Ok(batch) = fetch(client.link(), &cell, &gateway, position, ASK_WITHIN).await
            else {
                break;
            };
            if let Ok(mut seen) = shared.0.lock() {
                seen.fetched(batch);
                shared.1.notify_all();
            }
        }
        if let Ok(QueryReply::Status(status)) = client.ask(Query::Status, ASK_WITHIN).await
            && let Ok(mut seen) = shared.0.lock()
        {
            seen.history.push((Instant::now(), status));
            shared.1.notify_all();
        }
        while let Ok(QueryReply::Events { events, more }) = client
            .ask(Query::Events { after, limit: 500 }, ASK_WITHIN)
            .await
        {
            let Some(last) = events.last().map(|e| e.seq) else {
                break;
            };
            after = last;
            if let Ok(mut seen) = shared.0.lock() {
                seen.events.extend(events);
                shared.1.notify_all();
            }
            if !more {
                break;
            }
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// Microseconds of the machine's monotonic clock, as in [`Seen::applied`].
pub fn monotonic_us() -> u64 {
    // Linux has this clock always; the call cannot fail.
    nix::time::clock_gettime(nix::time::ClockId::CLOCK_MONOTONIC).map_or(0, |at| {
        u64::try_from(i128::from(at.tv_sec()) * 1_000_000 + i128::from(at.tv_nsec()) / 1_000)
            .unwrap_or(0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use fam_proto::{BootId, ControllerId, Digest, Epoch, Owner, Phase, Scan};

    fn entry(scan: u64) -> Applied {
        Applied {
            mc: McId::new("A").unwrap(),
            epoch: Epoch(1),
            owner: Owner {
                controller: ControllerId::new("c").unwrap(),
                boot: BootId(1),
            },
            scan: Scan(scan),
            digest: Digest::default(),
            base: None,
            phase: Phase::Running,
            released: false,
            at_us: scan,
        }
    }

    fn batch(boot: u64, first: u64, scans: std::ops::Range<u64>) -> AppliedBatch {
        AppliedBatch {
            gateway: GatewayId::new("g").unwrap(),
            boot: BootId(boot),
            monotonic_offset_us: 1_000,
            first,
            entries: scans.map(entry).collect(),
        }
    }

    #[test]
    fn the_journal_is_joined_without_doubles_and_missing_pieces_are_fetched() {
        let mut seen = Seen::default();
        for b in [batch(1, 0, 0..3), batch(1, 2, 2..5), batch(1, 2, 2..5)] {
            seen.stream(b);
        }
        assert_eq!((seen.applied.len(), seen.missing), (5, None));
        seen.stream(batch(1, 9, 9..10));
        assert_eq!(
            (seen.applied.len(), seen.missing),
            (5, Some(5)),
            "a hole: what comes waits"
        );
        seen.fetched(batch(1, 5, 5..7));
        assert_eq!(seen.missing, Some(7));
        seen.fetched(batch(1, 7, 7..10));
        seen.stream(batch(2, 4, 14..15));
        seen.fetched(batch(2, 0, 10..15));
        let scans: Vec<u64> = seen.applied.iter().map(|a| a.scan.0).collect();
        assert_eq!(
            (scans, seen.holes, seen.missing),
            ((0..15).collect(), 0, None)
        );
        assert_eq!(seen.newest[&McId::new("A").unwrap()].at_us, 1_014);
    }
}
