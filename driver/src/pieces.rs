//! Messages too long for one message: cut and sent by a thread of their own, put together by whoever receives them.
//!
//! Each piece is a query, and its answer the acknowledgement. The sender waits for that of the one receiver that counts (the
//! gateway for a frame); all others get the same pieces, and one that is too slow or frozen misses them, as it misses a frame.

use crate::bad::BadMessages;
use fam_proto::codec::{self, UNCUT_BYTES_MAX};
use fam_proto::{
    Assembly, BootId, PIECE_BYTES, PieceHeader, PieceTaken, ProcessId, decode_piece, encode_piece,
    keys,
};
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, mpsc};
use std::time::Duration;
use zenoh::Wait;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Query, QueryTarget};
use zenoh::sample::Locality;

/// How long the acknowledgement of a piece is waited for; then the piece is sent again.
const TAKEN_WITHIN: Duration = Duration::from_millis(50);
/// How often a piece is sent; then the message is given up, and whoever needs it asks or repeats.
const ATTEMPTS: u32 = 3;
/// Messages that wait to be sent, at most; the oldest is given up.
const WAITING_MAX: usize = 4;

/// Whose acknowledgement counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Taker {
    /// The gateway's: what it has not, nobody has seen applied.
    Gateway,
    /// That of the one process that the message is for.
    Anybody,
}

struct Job {
    key: String,
    taker: Taker,
    bytes: Vec<u8>,
}

#[derive(Default)]
struct Waiting {
    jobs: VecDeque<Job>,
    /// Set when the thread runs.
    started: bool,
    closed: bool,
}

struct Shared {
    session: zenoh::Session,
    from: ProcessId,
    boot: BootId,
    waiting: Mutex<Waiting>,
    news: Condvar,
}

/// Sends what is too long for one message. The thread starts with the first such message, and ends with this.
pub(crate) struct PieceSender {
    shared: Arc<Shared>,
}

impl PieceSender {
    pub(crate) fn new(session: zenoh::Session, from: ProcessId, boot: BootId) -> PieceSender {
        PieceSender {
            shared: Arc::new(Shared {
                session,
                from,
                boot,
                waiting: Mutex::default(),
                news: Condvar::new(),
            }),
        }
    }

    /// Whether a message has to go this way.
    pub(crate) fn has_to(bytes: &[u8]) -> bool {
        bytes.len() > UNCUT_BYTES_MAX
    }

    /// Takes a message that would go under `key`. Of frames of one MC only the newest waits: it makes those before it good.
    pub(crate) fn send(&self, key: &str, taker: Taker, bytes: Vec<u8>) -> bool {
        let Ok(mut waiting) = self.shared.waiting.lock() else {
            return false;
        };
        if !waiting.started {
            let shared = Arc::clone(&self.shared);
            let thread = std::thread::Builder::new().name("fam-pieces".to_owned());
            if let Err(error) = thread.spawn(move || shared.run()) {
                tracing::error!("no thread for messages in pieces: {error}");
                return false;
            }
            waiting.started = true;
        }
        if taker == Taker::Gateway {
            waiting.jobs.retain(|job| job.key != key);
        }
        if waiting.jobs.len() == WAITING_MAX {
            waiting.jobs.pop_front();
        }
        waiting.jobs.push_back(Job {
            key: key.to_owned(),
            taker,
            bytes,
        });
        self.shared.news.notify_one();
        true
    }
}

impl Drop for PieceSender {
    fn drop(&mut self) {
        if let Ok(mut waiting) = self.shared.waiting.lock() {
            waiting.closed = true;
            waiting.jobs.clear();
        }
        self.shared.news.notify_one();
    }
}

impl Shared {
    fn run(&self) {
        let mut message = 0;
        while let Some(job) = self.next() {
            message += 1;
            if !self.send(message, &job) {
                tracing::debug!(
                    "{} bytes under {} were not acknowledged",
                    job.bytes.len(),
                    job.key
                );
            }
        }
    }

    fn next(&self) -> Option<Job> {
        let mut waiting = self.waiting.lock().ok()?;
        loop {
            if waiting.closed {
                return None;
            }
            if let Some(job) = waiting.jobs.pop_front() {
                return Some(job);
            }
            waiting = self.news.wait(waiting).ok()?;
        }
    }

    /// Sends all pieces in turn; `false` if one was not taken.
    fn send(&self, message: u64, job: &Job) -> bool {
        let key = keys::pieces(&job.key);
        let Ok(message_bytes) = u32::try_from(job.bytes.len()) else {
            return false;
        };
        (0..)
            .zip(job.bytes.chunks(PIECE_BYTES))
            .all(|(index, piece)| {
                let header = PieceHeader {
                    from: self.from.clone(),
                    boot: self.boot,
                    message,
                    message_bytes,
                    index,
                };
                let Ok(bytes) = encode_piece(&header, piece) else {
                    return false;
                };
                (0..ATTEMPTS).any(|_| self.is_taken(&key, job.taker, bytes.clone()))
            })
    }

    fn is_taken(&self, key: &str, taker: Taker, bytes: Vec<u8>) -> bool {
        let (answers, answer) = mpsc::channel();
        let asked = self
            .session
            .get(key)
            .payload(bytes)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::Data)
            .allowed_destination(Locality::Remote)
            .timeout(TAKEN_WITHIN)
            .callback(move |reply| {
                let Ok(sample) = reply.result() else { return };
                let taken = codec::decode::<PieceTaken>(&sample.payload().to_bytes());
                let counts = |by: &ProcessId| match taker {
                    Taker::Gateway => matches!(by, ProcessId::Gateway(_)),
                    Taker::Anybody => true,
                };
                if taken.is_ok_and(|taken| counts(&taken.by)) {
                    let _ = answers.send(());
                }
            })
            .wait();
        // Ends early when all have answered, and nobody who counts.
        asked.is_ok() && answer.recv_timeout(TAKEN_WITHIN).is_ok()
    }
}

/// Takes pieces under one key expression, and acknowledges them.
pub(crate) struct PieceReceiver {
    pub(crate) session: zenoh::Session,
    pub(crate) by: ProcessId,
    /// What is held of messages that are not complete, over all key expressions of this process.
    pub(crate) held: Arc<Mutex<Assembly>>,
    pub(crate) bad: Arc<BadMessages>,
}

impl PieceReceiver {
    /// Calls `each` on Zenoh's thread with the key and the bytes of each message that has come whole, for as long as the
    /// session lives.
    pub(crate) fn receive(
        self,
        key: &str,
        origin: Locality,
        each: impl Fn(&str, Vec<u8>) + Send + Sync + 'static,
    ) -> zenoh::Result<()> {
        let session = self.session.clone();
        session
            .declare_queryable(keys::pieces(key))
            .allowed_origin(origin)
            .callback(move |query| {
                if let Err(why) = self.take(&query, &each) {
                    self.bad.add(query.key_expr().as_str(), None, &why);
                    let _ = query.reply_err(why).wait();
                }
            })
            .background()
            .wait()
    }

    fn take(&self, query: &Query, each: &impl Fn(&str, Vec<u8>)) -> Result<(), String> {
        let bytes = query.payload().map(|p| p.to_bytes()).unwrap_or_default();
        let (header, piece) = decode_piece(&bytes).map_err(|e| e.to_string())?;
        let key = query.key_expr().as_str();
        let of = key.strip_suffix("/pieces").unwrap_or(key);
        let whole = match self.held.lock() {
            Ok(mut held) => held.take(of, &header, piece).map_err(|e| e.to_string())?,
            Err(_) => return Err("this process is ending".to_owned()),
        };
        // First what it is for, then the word of it.
        if let Some(whole) = whole {
            each(of, whole);
        }
        let taken = PieceTaken {
            by: self.by.clone(),
        };
        let answer = codec::encode(&taken).map_err(|e| e.to_string())?;
        let _ = query.reply(query.key_expr().clone(), answer).wait();
        Ok(())
    }
}
