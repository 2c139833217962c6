//! The journal of applied frames around the pure recorder: kept in memory, asked for, streamed, written to a file.
//!
//! Who wants every entry asks under `fam/<cell>/applied/<gateway>` with a position ([`fetch`]); the stream under the same key is for
//! onlookers and may lose batches, which their positions show.

use fam_driver::{Link, LinkError, RequestError, Server, Topic};
use fam_gateway_core::recorder::Journal;
use fam_proto::codec::{self, CodecError};
use fam_proto::{Applied, AppliedBatch, BootId, CellId, GatewayId, keys};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Entries kept in memory: about three minutes of five MCs at 5 ms.
pub const JOURNAL_ENTRIES_MAX: usize = 200_000;
/// Most entries of one batch.
pub const BATCH_ENTRIES_MAX: usize = 4_096;
/// Batches that wait for the file's thread; further ones are left out, which the positions show.
const FILE_BATCHES_WAITING_MAX: usize = 256;
/// Ticks between two looks at whether anybody listens to the stream.
const LOOK_TICKS: u32 = 20;

/// Why a journal could not be read from a file.
#[derive(Debug, thiserror::Error)]
pub enum JournalFileError {
    /// The operating system says no.
    #[error("journal {path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// It does not read.
    #[error("journal {path}, byte {at}: {source}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where.
        at: usize,
        /// Why.
        source: CodecError,
    },
}

#[derive(Debug)]
struct Shared {
    journal: Mutex<Journal>,
    gateway: GatewayId,
    boot: BootId,
    monotonic_offset_us: i64,
}

impl Shared {
    fn batch(&self, position: u64) -> AppliedBatch {
        let journal = self.journal.lock().unwrap_or_else(PoisonError::into_inner);
        let (first, entries) = journal.since(position, BATCH_ENTRIES_MAX);
        AppliedBatch {
            gateway: self.gateway.clone(),
            boot: self.boot,
            monotonic_offset_us: self.monotonic_offset_us,
            first,
            entries,
        }
    }
}

/// The recorder of a gateway process.
#[derive(Debug)]
pub struct Recording {
    shared: Arc<Shared>,
    topic: Topic,
    _server: Server,
    always: bool,
    listened: bool,
    ticks: u32,
    streamed: u64,
    file: Option<JournalFile>,
}

/// The thread that writes the journal's file.
#[derive(Debug)]
struct JournalFile {
    /// `None` only while it is being ended.
    batches: Option<crossbeam_channel::Sender<Vec<u8>>>,
    /// Position up to which entries have been handed to it.
    written: u64,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Drop for JournalFile {
    fn drop(&mut self) {
        self.batches = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Microseconds of the machine's monotonic clock, which all processes of one machine share.
#[must_use]
pub fn monotonic_us() -> u64 {
    nix::time::clock_gettime(nix::time::ClockId::CLOCK_MONOTONIC).map_or(0, |time| {
        time.tv_sec() as u64 * 1_000_000 + time.tv_nsec() as u64 / 1_000
    })
}

impl Recording {
    /// Starts recording; `always` streams also while nobody is known to listen, `file` gets every batch.
    ///
    /// # Errors
    /// If the link is closed.
    pub fn start(
        link: &Link,
        gateway: &GatewayId,
        always: bool,
        file: Option<std::fs::File>,
    ) -> Result<Recording, LinkError> {
        let key = keys::applied(link.cell(), gateway);
        let shared = Arc::new(Shared {
            journal: Mutex::new(Journal::new(JOURNAL_ENTRIES_MAX)),
            gateway: gateway.clone(),
            boot: link.boot(),
            monotonic_offset_us: monotonic_us() as i64 - fam_driver::now().0 as i64,
        });
        let asked = Arc::clone(&shared);
        let server = link.serve(&key, move |bytes| {
            let position = <[u8; 8]>::try_from(bytes)
                .map(u64::from_le_bytes)
                .map_err(|_| "expected a position in the journal: 8 bytes".to_owned())?;
            codec::encode(&asked.batch(position)).map_err(|error| error.to_string())
        })?;
        let file = file.map(|file| {
            let (sender, batches) = crossbeam_channel::bounded::<Vec<u8>>(FILE_BATCHES_WAITING_MAX);
            let thread = std::thread::spawn(move || {
                if let Err(error) = write_batches(file, &batches) {
                    tracing::error!(
                        "the journal of applied frames is no longer written to its file: {error}"
                    );
                }
            });
            JournalFile {
                batches: Some(sender),
                written: 0,
                thread: Some(thread),
            }
        });
        Ok(Recording {
            topic: link.topic(&key)?,
            _server: server,
            shared,
            always,
            listened: false,
            ticks: 0,
            streamed: 0,
            file,
        })
    }

    /// Takes an applied frame.
    pub fn push(&self, applied: Applied) {
        let mut journal = self
            .shared
            .journal
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        journal.push(applied);
    }

    /// Once a tick: streams and writes what is new.
    pub fn tick(&mut self) {
        let end = self
            .shared
            .journal
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .end();
        if self.ticks == 0 {
            self.listened = self.always || self.topic.has_listeners();
        }
        self.ticks = (self.ticks + 1) % LOOK_TICKS;
        if !self.listened {
            self.streamed = end;
        } else if self.streamed < end
            && let Some((bytes, next)) = self.encode(self.streamed)
        {
            self.topic.put(bytes);
            self.streamed = next;
        }
        let next = match &self.file {
            Some(file) if file.written < end => self.encode(file.written),
            _ => None,
        };
        if let (Some((bytes, next)), Some(file)) = (next, &mut self.file) {
            // A disk that is too slow leaves a hole; it never holds the field up.
            if let Some(batches) = &file.batches {
                let _ = batches.try_send(bytes);
            }
            file.written = next;
        }
    }

    fn encode(&self, position: u64) -> Option<(Vec<u8>, u64)> {
        let batch = self.shared.batch(position);
        let next = batch.first + batch.entries.len() as u64;
        Some((codec::encode(&batch).ok()?, next))
    }
}

fn write_batches(
    file: std::fs::File,
    batches: &crossbeam_channel::Receiver<Vec<u8>>,
) -> io::Result<()> {
    let mut file = io::BufWriter::new(file);
    while let Ok(bytes) = batches.recv() {
        file.write_all(&(bytes.len() as u32).to_le_bytes())?;
        file.write_all(&bytes)?;
        if batches.is_empty() {
            file.flush()?;
        }
    }
    file.flush()
}

/// Reads a journal file. A last batch that was cut off by a kill is left out.
///
/// # Errors
/// [`JournalFileError`].
pub fn read_file(path: &Path) -> Result<Vec<AppliedBatch>, JournalFileError> {
    let io = |source| JournalFileError::Io {
        path: path.to_owned(),
        source,
    };
    let mut bytes = Vec::new();
    std::fs::File::open(path)
        .and_then(|mut file| file.read_to_end(&mut bytes))
        .map_err(io)?;
    let mut batches = Vec::new();
    let mut at = 0;
    while let Some(len) = bytes.get(at..at + 4) {
        let len = u32::from_le_bytes(len.try_into().unwrap_or_default()) as usize;
        let Some(batch) = bytes.get(at + 4..at + 4 + len) else {
            break;
        };
        batches.push(
            codec::decode(batch).map_err(|source| JournalFileError::Damaged {
                path: path.to_owned(),
                at,
                source,
            })?,
        );
        at += 4 + len;
    }
    Ok(batches)
}

/// Why a journal could not be fetched.
#[derive(Debug, thiserror::Error)]
pub enum FetchError {
    /// No answer.
    #[error(transparent)]
    Request(#[from] RequestError),
    /// An answer that does not read.
    #[error(transparent)]
    Codec(#[from] CodecError),
}

/// Asks a gateway for the entries of its journal from a position on; [`BATCH_ENTRIES_MAX`] at most. The journal's oldest entries go:
/// `first` of the answer is above `position` if some asked for are gone. A position beyond the end gives an empty batch whose `first` is the end.
///
/// # Errors
/// [`FetchError`].
pub async fn fetch(
    link: &Link,
    cell: &CellId,
    gateway: &GatewayId,
    position: u64,
    within: Duration,
) -> Result<AppliedBatch, FetchError> {
    let key = keys::applied(cell, gateway);
    let bytes = link
        .request(&key, position.to_le_bytes().to_vec(), within)
        .await?;
    Ok(codec::decode(&bytes)?)
}
