//! The repository's writer: what must be durable is waited for, history is gathered and written along.
//!
//! A commit costs a sync of the disk. Events come in bursts, just when a plant waits for orders, so they are answered at
//! once and written within [`GATHER`], or with the next write that is waited for. What was answered so is lost only if
//! this process dies within that time.

use fam_proto::RepoWrite;
use fam_repository::Repository;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How long writes that need no sync are gathered.
const GATHER: Duration = Duration::from_millis(20);
/// How long after a failed write the gathered ones are tried again.
const RETRY: Duration = Duration::from_secs(1);
/// Most writes that are kept for later while the disk fails; the oldest are given up first.
const BACKLOG_MAX: usize = 10_000;

struct Job {
    write: RepoWrite,
    /// Who waits for it; nobody for gathered ones.
    answer: Option<SyncSender<Result<(), String>>>,
}

/// The writing end; dropping it writes what is gathered and ends the writer.
pub(crate) struct Store {
    jobs: Option<mpsc::Sender<Job>>,
    failing: Arc<Mutex<Option<String>>>,
    writer: Option<JoinHandle<()>>,
}

impl Store {
    pub(crate) fn start(repository: Repository) -> std::io::Result<Store> {
        let (jobs, queue) = mpsc::channel();
        let failing: Arc<Mutex<Option<String>>> = Arc::default();
        let said = failing.clone();
        let writer = std::thread::Builder::new()
            .name("repository".to_owned())
            .spawn(move || Writer::new(repository, said).work(&queue))?;
        Ok(Store {
            jobs: Some(jobs),
            failing,
            writer: Some(writer),
        })
    }

    /// Durable when it returns `Ok`, if the write must be; otherwise taken, and `Err` says that the disk fails at the
    /// moment (the write is kept and tried again).
    pub(crate) fn store(&self, write: RepoWrite) -> Result<(), String> {
        let ended = || "the repository's writer has ended".to_owned();
        let jobs = self.jobs.as_ref().ok_or_else(ended)?;
        if !write.must_sync() {
            let job = Job {
                write,
                answer: None,
            };
            jobs.send(job).map_err(|_| ended())?;
            let failing = self.failing.lock().unwrap_or_else(PoisonError::into_inner);
            return failing.clone().map_or(Ok(()), Err);
        }
        let (answer, answered) = mpsc::sync_channel(1);
        let job = Job {
            write,
            answer: Some(answer),
        };
        jobs.send(job).map_err(|_| ended())?;
        answered.recv().unwrap_or_else(|_| Err(ended()))
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        self.jobs = None;
        if let Some(writer) = self.writer.take() {
            let _ = writer.join();
        }
    }
}

struct Writer {
    repository: Repository,
    failing: Arc<Mutex<Option<String>>>,
    gathered: Vec<RepoWrite>,
    /// When the gathered writes are due.
    due: Option<Instant>,
}

impl Writer {
    fn new(repository: Repository, failing: Arc<Mutex<Option<String>>>) -> Writer {
        Writer {
            repository,
            failing,
            gathered: Vec::new(),
            due: None,
        }
    }

    fn work(mut self, queue: &Receiver<Job>) {
        loop {
            let job = match self.due {
                None => queue.recv().map_err(|_| RecvTimeoutError::Disconnected),
                Some(due) => queue.recv_timeout(due.saturating_duration_since(Instant::now())),
            };
            match job {
                Ok(Job {
                    write,
                    answer: None,
                }) => self.gather(write),
                Ok(Job {
                    write,
                    answer: Some(answer),
                }) => {
                    let result = self.write_now(write);
                    let _ = answer.send(result);
                }
                Err(RecvTimeoutError::Timeout) => self.flush(),
                Err(RecvTimeoutError::Disconnected) => {
                    self.flush();
                    return;
                }
            }
        }
    }

    fn gather(&mut self, write: RepoWrite) {
        if self.gathered.len() == BACKLOG_MAX {
            self.gathered.remove(0);
        }
        self.gathered.push(write);
        self.due.get_or_insert_with(|| Instant::now() + GATHER);
    }

    /// With what is gathered; alone if the disk has no room for both.
    fn write_now(&mut self, write: RepoWrite) -> Result<(), String> {
        self.gathered.push(write.clone());
        let with_all = self.repository.store(&self.gathered);
        let failed = match with_all {
            Ok(()) => {
                self.gathered.clear();
                self.due = None;
                self.say(None);
                return Ok(());
            }
            Err(error) => error,
        };
        self.gathered.pop();
        if self.gathered.is_empty() {
            self.say(Some(failed.to_string()));
            return Err(failed.to_string());
        }
        self.due = Some(Instant::now() + RETRY);
        let alone = self.repository.store(&[write]).map_err(|e| e.to_string());
        self.say(Some(failed.to_string()));
        alone
    }

    fn flush(&mut self) {
        self.due = None;
        if self.gathered.is_empty() {
            return;
        }
        match self.repository.store(&self.gathered) {
            Ok(()) => {
                self.gathered.clear();
                self.say(None);
            }
            Err(error) => {
                self.due = Some(Instant::now() + RETRY);
                self.say(Some(error.to_string()));
            }
        }
    }

    fn say(&self, failing: Option<String>) {
        let mut said = self.failing.lock().unwrap_or_else(PoisonError::into_inner);
        match (&failing, &*said) {
            (Some(why), None) => tracing::error!("{why}"),
            (None, Some(_)) => tracing::info!("the repository is written again"),
            _ => {}
        }
        *said = failing;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fam_proto::{CellId, Epoch, Event, EventKind, McId, Severity};
    use fam_repository::disk::Disk;

    fn repository(disk: &Disk) -> (Repository, fam_proto::RepoState) {
        let disk = disk.clone();
        let cell = CellId::new("cell").unwrap();
        Repository::over(&cell, move || Ok(disk.backend())).unwrap()
    }

    fn event(seq: u64) -> RepoWrite {
        let mut event = Event::new(Severity::Info, EventKind::PlanDone, "x".repeat(400));
        event.seq = seq;
        RepoWrite::Event(event)
    }

    fn block(upto: u64) -> RepoWrite {
        RepoWrite::EpochBlock {
            mc: McId::new("station1").unwrap(),
            upto: Epoch(upto),
        }
    }

    #[test]
    fn events_cost_no_sync_of_their_own_and_the_end_loses_none() {
        let disk = Disk::default();
        let (repository_, _) = repository(&disk);
        let store = Store::start(repository_).unwrap();
        let before = disk.syncs();
        for seq in 1..=200 {
            store.store(event(seq)).unwrap();
        }
        store.store(block(64)).unwrap();
        let syncs = disk.syncs() - before;
        assert!(syncs < 50, "{syncs} syncs");
        store.store(event(201)).unwrap();
        drop(store);
        let (_, state) = repository(&disk);
        assert_eq!((state.last_event_seq, state.events.len()), (201, 201));
        assert_eq!(state.epochs[&McId::new("station1").unwrap()], Epoch(64));
    }

    #[test]
    fn a_full_disk_refuses_what_must_be_durable_and_keeps_the_rest_for_later() {
        let disk = Disk::default();
        let (repository_, _) = repository(&disk);
        let store = Store::start(repository_).unwrap();
        disk.set_capacity(Some(0));
        let why = store.store(block(64)).unwrap_err();
        assert!(why.contains("no space left"), "{why}");
        assert!(store.store(event(1)).unwrap_err().contains("no space left"));
        disk.set_capacity(None);
        store.store(block(128)).unwrap();
        store.store(event(2)).unwrap();
        drop(store);
        let (_, state) = repository(&disk);
        assert_eq!(state.epochs[&McId::new("station1").unwrap()], Epoch(128));
        assert_eq!(state.events.len(), 2);
    }
}
