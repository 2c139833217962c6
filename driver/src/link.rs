//! One process's connection to its cell: a Zenoh session as a peer among peers.
//!
//! Nothing here waits for a slow receiver: everything is put with congestion control `Drop`, and what matters is repeated
//! by the agents. What is too long for one message goes in acknowledged pieces (`pieces.rs`). Priorities: images first, then messages, then frames, then streams for onlookers.

use crate::bad::BadMessages;
use crate::frames::{FrameBytes, FrameSender, FrameSink, Frames, Sinks, signature};
use crate::pieces::{PieceReceiver, PieceSender, Taker};
use crate::reach::Reach;
use crate::topic::Subscription;
use fam_proto::codec::{self, Wire};
use fam_proto::{Assembly, BootId, CellId, Envelope, Event, InputImage, McId, ProcessId, keys};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use tokio::sync::mpsc;
use zenoh::Wait;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::{Locality, Sample, SampleKind};

/// Most events that wait for the process's agent; further messages and images are dropped and counted, losses of peers never.
pub const EVENTS_WAITING_MAX: usize = 16_384;
/// Most bytes that wait there, as they came over the wire; beyond, the same.
pub const BYTES_WAITING_MAX: usize = 64 << 20;
/// Even of appearances and losses no more than this wait: a peer that makes up tokens without end fills no memory.
const PEERS_WAITING_MAX: usize = 4 * EVENTS_WAITING_MAX;
/// Most receivers whose keys are kept declared; to others messages go without.
const RECEIVERS_KEPT_MAX: usize = 1_024;

/// How long closing waits for peers.
const CLOSE_WITHIN: std::time::Duration = std::time::Duration::from_secs(1);

/// What a process wants of its link.
#[derive(Debug, Clone)]
pub struct LinkOptions {
    /// The cell.
    pub cell: CellId,
    /// This process.
    pub process: ProcessId,
    /// Its life.
    pub boot: BootId,
    /// Endpoints to listen at: `tcp/127.0.0.1:7447`; port 0 takes any free one.
    pub listen: Vec<String>,
    /// Endpoints to connect to, tried for ever. Other peers are found through them.
    pub connect: Vec<String>,
    /// Whether to receive the input images of all gateways.
    pub images: bool,
    /// Which frames to receive.
    pub frames: Frames,
    /// Whether to be told who is alive.
    pub peers: bool,
}

impl LinkOptions {
    /// Receives messages only, listens at a free port of the loopback, connects nowhere.
    #[must_use]
    pub fn new(cell: CellId, process: ProcessId) -> LinkOptions {
        LinkOptions {
            cell,
            process,
            boot: crate::boot_id(),
            listen: vec!["tcp/127.0.0.1:0".to_owned()],
            connect: Vec::new(),
            images: false,
            frames: Frames::None,
            peers: false,
        }
    }
}

/// Why a link could not be opened.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LinkError {
    /// Somebody else listens there.
    #[error(
        "cannot listen at {endpoint}: the port is in use. Another process (an earlier run of the {process}?) listens there: end it, or give another endpoint"
    )]
    PortInUse {
        /// The endpoint.
        endpoint: String,
        /// Who wanted it.
        process: String,
    },
    /// An endpoint that cannot be listened at for another reason.
    #[error("cannot listen at {endpoint}: {reason}. Expected `tcp/<address of this host>:<port>`")]
    Listen {
        /// The endpoint.
        endpoint: String,
        /// What the operating system says.
        reason: String,
    },
    /// Zenoh refuses for another reason.
    #[error("{what} failed: {reason}")]
    Zenoh {
        /// What was being done.
        what: String,
        /// What Zenoh says.
        reason: String,
    },
}

impl LinkError {
    pub(crate) fn zenoh(what: &str, error: &zenoh::Error) -> LinkError {
        LinkError::Zenoh {
            what: what.to_owned(),
            reason: error.to_string(),
        }
    }
}

/// What comes in.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant)] // moved once into the queue and once out of it; a box would cost more
pub enum LinkEvent {
    /// A message for an agent of this process.
    Message(Envelope),
    /// A process appeared or is gone.
    Peer {
        /// The process.
        process: ProcessId,
        /// Its life.
        boot: BootId,
        /// Whether it is there.
        alive: bool,
    },
    /// An input image.
    Image(Arc<InputImage>),
    /// A frame, unless frames go to a sink.
    Frame {
        /// Whose.
        mc: McId,
        /// As it came.
        bytes: FrameBytes,
    },
}

/// The queue of what came in.
#[derive(Debug)]
pub struct LinkEvents {
    receiver: mpsc::UnboundedReceiver<(usize, LinkEvent)>,
    waiting: Arc<Waiting>,
}

/// What waits: events, and the bytes that they came in.
#[derive(Debug, Default)]
struct Waiting {
    events: AtomicUsize,
    bytes: AtomicUsize,
}

impl Waiting {
    fn taken(&self, bytes: usize) {
        self.events.fetch_sub(1, Ordering::Relaxed);
        self.bytes.fetch_sub(bytes, Ordering::Relaxed);
    }
}

impl LinkEvents {
    /// The next event; `None` when the link is closed and all have been taken.
    pub async fn recv(&mut self) -> Option<LinkEvent> {
        let (bytes, event) = self.receiver.recv().await?;
        self.waiting.taken(bytes);
        Some(event)
    }

    /// The next event, if one is there.
    pub fn try_recv(&mut self) -> Option<LinkEvent> {
        let (bytes, event) = self.receiver.try_recv().ok()?;
        self.waiting.taken(bytes);
        Some(event)
    }
}

/// The sending end of the queue, and what is counted beside it.
#[derive(Debug, Clone)]
struct Inbox {
    sender: mpsc::UnboundedSender<(usize, LinkEvent)>,
    waiting: Arc<Waiting>,
    dropped: Arc<AtomicU64>,
    bad: Arc<BadMessages>,
}

impl Inbox {
    /// Queues what came in `bytes` bytes.
    fn push(&self, bytes: usize, event: LinkEvent) {
        let waiting = self.waiting.events.load(Ordering::Relaxed);
        let full = match &event {
            LinkEvent::Peer { .. } => waiting >= PEERS_WAITING_MAX,
            _ => {
                waiting >= EVENTS_WAITING_MAX
                    || self.waiting.bytes.load(Ordering::Relaxed) + bytes > BYTES_WAITING_MAX
            }
        };
        if full {
            self.dropped.fetch_add(1, Ordering::Relaxed);
            return;
        }
        self.waiting.events.fetch_add(1, Ordering::Relaxed);
        self.waiting.bytes.fetch_add(bytes, Ordering::Relaxed);
        let _ = self.sender.send((bytes, event));
    }

    fn decode<T: Wire>(&self, sample: &Sample) -> Option<T> {
        match codec::decode(&sample.payload().to_bytes()) {
            Ok(body) => Some(body),
            Err(error) => {
                let sender = sample.attachment().map(|a| a.to_bytes().into_owned());
                let sender = sender.as_deref().map(String::from_utf8_lossy);
                self.bad
                    .add(sample.key_expr().as_str(), sender.as_deref(), &error);
                None
            }
        }
    }

    /// A frame, to its sink or into the queue.
    fn frame(&self, sink: Option<&FrameSink>, key: &str, bytes: FrameBytes) {
        let Ok(mc) = McId::new(key.rsplit('/').next().unwrap_or_default()) else {
            self.bad.add(key, None, &"the key names no MC");
            return;
        };
        match sink {
            Some(sink) => sink(mc, bytes),
            None => self.push(bytes.len(), LinkEvent::Frame { mc, bytes }),
        }
    }
}

/// One process's connection to its cell. Clones share it; [`Link::close`] ends it for all.
#[derive(Clone)]
pub struct Link {
    inner: Arc<Inner>,
}

struct Inner {
    session: zenoh::Session,
    cell: CellId,
    process: ProcessId,
    boot: BootId,
    signature: String,
    inbox: Inbox,
    reach: Arc<Reach>,
    frames: FrameSender,
    pieces: Arc<PieceSender>,
    publishers: Mutex<BTreeMap<String, Publisher<'static>>>,
    token: Mutex<Option<zenoh::liveliness::LivelinessToken>>,
}

impl std::fmt::Debug for Link {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Link")
            .field("process", &self.inner.process)
            .field("boot", &self.inner.boot)
            .finish_non_exhaustive()
    }
}

impl Link {
    /// Opens the link. Endpoints that cannot be reached are tried in the background for ever; a port that cannot be
    /// listened at is an error.
    ///
    /// # Errors
    /// [`LinkError`], which says what to do.
    pub async fn open(options: LinkOptions) -> Result<(Link, LinkEvents), LinkError> {
        Link::open_with(options, Sinks::default()).await
    }

    /// As [`Link::open`], with sinks that take data at once on Zenoh's thread.
    ///
    /// # Errors
    /// [`LinkError`], which says what to do.
    pub async fn open_with(
        options: LinkOptions,
        sinks: Sinks,
    ) -> Result<(Link, LinkEvents), LinkError> {
        let config = crate::config::config(&options).map_err(|reason| LinkError::Zenoh {
            what: format!(
                "reading the endpoints {} {} of the {}",
                options.listen.join(" "),
                options.connect.join(" "),
                options.process
            ),
            reason,
        })?;
        let session = match zenoh::open(config).await {
            Ok(session) => session,
            Err(error) => return Err(explain_open(&options, &error).await),
        };
        let (sender, receiver) = mpsc::unbounded_channel();
        let inbox = Inbox {
            sender,
            waiting: Arc::default(),
            dropped: Arc::default(),
            bad: Arc::default(),
        };
        let events = LinkEvents {
            receiver,
            waiting: inbox.waiting.clone(),
        };
        let reach = Arc::new(Reach::new(options.connect.clone()));
        let pieces = PieceSender::new(session.clone(), options.process.clone(), options.boot);
        let pieces = Arc::new(pieces);
        let link = Link {
            inner: Arc::new(Inner {
                frames: FrameSender::new(
                    session.clone(),
                    options.cell.clone(),
                    Arc::clone(&pieces),
                ),
                pieces,
                signature: signature(&options.process, options.boot),
                session,
                cell: options.cell.clone(),
                process: options.process.clone(),
                boot: options.boot,
                inbox,
                reach,
                publishers: Mutex::default(),
                token: Mutex::new(None),
            }),
        };
        link.declare(&options, sinks)
            .map_err(|e| LinkError::zenoh("declaring what this process receives", &e))?;
        if !options.connect.is_empty() {
            let watch = link.inner.reach.clone();
            let session = link.inner.session.clone();
            tokio::spawn(watch.watch(session, options.process.to_string()));
        }
        Ok((link, events))
    }

    /// Subscriptions first, the token last: who sees the token can send to this process.
    fn declare(&self, options: &LinkOptions, sinks: Sinks) -> zenoh::Result<()> {
        let session = &self.inner.session;
        let cell = &options.cell;

        let held = Arc::default();
        let to = keys::to(cell, &options.process);
        let inbox = self.inner.inbox.clone();
        self.pieces(&held).receive(
            &to,
            Locality::Remote,
            move |key, bytes| match codec::decode(&bytes) {
                Ok(envelope) => inbox.push(bytes.len(), LinkEvent::Message(envelope)),
                Err(error) => inbox.bad.add(key, None, &error),
            },
        )?;
        let inbox = self.inner.inbox.clone();
        session
            .declare_subscriber(to)
            .callback(move |sample| {
                if let Some(envelope) = inbox.decode(&sample) {
                    inbox.push(sample.payload().len(), LinkEvent::Message(envelope));
                }
            })
            .background()
            .wait()?;

        if options.images {
            let inbox = self.inner.inbox.clone();
            session
                .declare_subscriber(format!("fam/{cell}/image/*"))
                .callback(move |sample| {
                    let Some(image) = inbox.decode::<InputImage>(&sample) else {
                        return;
                    };
                    let image = Arc::new(image);
                    if let Some(sink) = &sinks.image {
                        sink(&image);
                    }
                    inbox.push(sample.payload().len(), LinkEvent::Image(image));
                })
                .background()
                .wait()?;
        }

        let frame_keys = match &options.frames {
            Frames::None => Vec::new(),
            Frames::All => vec![format!("fam/{cell}/frame/*")],
            Frames::Of(mcs) => mcs.iter().map(|mc| keys::frame(cell, mc)).collect(),
        };
        for key in frame_keys {
            let inbox = self.inner.inbox.clone();
            let sink = sinks.frame.clone();
            self.pieces(&held)
                .receive(&key, Locality::Remote, move |key, bytes| {
                    inbox.frame(sink.as_ref(), key, FrameBytes(bytes.into()));
                })?;
            let inbox = self.inner.inbox.clone();
            let sink = sinks.frame.clone();
            session
                .declare_subscriber(key)
                .allowed_origin(Locality::Remote)
                .callback(move |sample| {
                    let bytes = FrameBytes(sample.payload().clone());
                    inbox.frame(sink.as_ref(), sample.key_expr().as_str(), bytes);
                })
                .background()
                .wait()?;
        }

        if options.peers {
            let inbox = self.inner.inbox.clone();
            let (cell, own) = (cell.clone(), (options.process.clone(), options.boot));
            session
                .liveliness()
                .declare_subscriber(keys::alive_all(&cell))
                .history(true)
                .callback(move |sample| {
                    let key = sample.key_expr().as_str();
                    match keys::parse_alive(&cell, key) {
                        None => inbox.bad.add(key, None, &"the key names no process"),
                        Some(seen) if seen == own => {}
                        Some((process, boot)) => {
                            let alive = sample.kind() == SampleKind::Put;
                            inbox.push(
                                0,
                                LinkEvent::Peer {
                                    process,
                                    boot,
                                    alive,
                                },
                            );
                        }
                    }
                })
                .background()
                .wait()?;
        }

        if !matches!(options.process, ProcessId::Client(_)) {
            let token = session
                .liveliness()
                .declare_token(keys::alive(cell, &options.process, options.boot))
                .wait()?;
            if let Ok(mut place) = self.inner.token.lock() {
                *place = Some(token);
            }
        }
        Ok(())
    }

    fn pieces(&self, held: &Arc<Mutex<Assembly>>) -> PieceReceiver {
        PieceReceiver {
            session: self.inner.session.clone(),
            by: self.inner.process.clone(),
            held: Arc::clone(held),
            bad: Arc::clone(&self.inner.inbox.bad),
        }
    }

    /// The cell.
    #[must_use]
    pub fn cell(&self) -> &CellId {
        &self.inner.cell
    }
    /// This process.
    #[must_use]
    pub fn process(&self) -> &ProcessId {
        &self.inner.process
    }
    /// Its life.
    #[must_use]
    pub fn boot(&self) -> BootId {
        self.inner.boot
    }
    pub(crate) fn session(&self) -> &zenoh::Session {
        &self.inner.session
    }
    /// Puts frames; for the sender thread.
    #[must_use]
    pub fn sender(&self) -> FrameSender {
        self.inner.frames.clone()
    }
    /// Messages that did not read, since the start.
    #[must_use]
    pub fn bad_messages(&self) -> u64 {
        self.inner.inbox.bad.count()
    }
    /// Counts a message that did not read, for those who read bytes themselves (frames); logged with its key and sender.
    pub fn count_bad(&self, key: &str, sender: Option<&str>, why: &dyn std::fmt::Display) {
        self.inner.inbox.bad.add(key, sender, why);
    }
    /// Messages and images dropped because the agent did not take them, since the start.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.inner.inbox.dropped.load(Ordering::Relaxed)
    }
    /// Configured endpoints without a connection, as seen at the last look (twice a second).
    #[must_use]
    pub fn unreachable(&self) -> Vec<String> {
        self.inner.reach.unreachable()
    }
    /// Looks at the connections now: configured endpoints without one.
    pub async fn check_reach(&self) -> Vec<String> {
        self.inner.reach.look(&self.inner.session).await
    }

    /// Sends a message; one for an agent of this process is looped back.
    pub fn send(&self, envelope: &Envelope) {
        let to = envelope.to.process();
        if to == self.inner.process {
            self.inner
                .inbox
                .push(0, LinkEvent::Message(envelope.clone()));
            return;
        }
        match codec::encode(envelope) {
            Ok(bytes) if PieceSender::has_to(&bytes) => {
                let key = keys::to(&self.inner.cell, &to);
                self.inner.pieces.send(&key, Taker::Anybody, bytes);
            }
            Ok(bytes) => {
                let keep = !matches!(to, ProcessId::Client(_));
                self.put(
                    keys::to(&self.inner.cell, &to),
                    bytes,
                    Priority::InteractiveHigh,
                    keep,
                );
            }
            Err(error) => tracing::error!("a message to {} was not sent: {error}", envelope.to),
        }
    }

    /// Publishes an input image of this gateway.
    pub fn publish_image(&self, image: &InputImage) {
        match codec::encode(image) {
            Ok(bytes) => self.put(
                keys::image(&self.inner.cell, &image.gateway),
                bytes,
                Priority::RealTime,
                true,
            ),
            Err(error) => tracing::error!("an input image was not sent: {error}"),
        }
    }

    /// Publishes an event of the history for whoever follows it.
    pub fn publish_event(&self, event: &Event) {
        match codec::encode(event) {
            Ok(bytes) => self.put(keys::event(&self.inner.cell), bytes, Priority::Data, true),
            Err(error) => tracing::error!("an event was not sent: {error}"),
        }
    }

    /// Calls `each` on Zenoh's thread with each event that the manager publishes, for as long as the subscription is kept.
    ///
    /// # Errors
    /// If the link is closed.
    pub fn follow_events(
        &self,
        each: impl Fn(Event) + Send + Sync + 'static,
    ) -> Result<Subscription, LinkError> {
        let bad = self.inner.inbox.bad.clone();
        self.subscribe(
            &keys::event(&self.inner.cell),
            move |key, bytes| match codec::decode(&bytes) {
                Ok(event) => each(event),
                Err(error) => bad.add(key, None, &error),
            },
        )
    }

    /// Puts bytes as they are under any key, as the messages of this process: for tests of receivers.
    pub fn put_raw(&self, key: &str, bytes: Vec<u8>) {
        self.put(key.to_owned(), bytes, Priority::InteractiveHigh, false);
    }

    fn put(&self, key: String, bytes: Vec<u8>, priority: Priority, keep: bool) {
        let inner = &self.inner;
        // Whoever asks under made-up names gets answers, and no place in memory.
        let room = || {
            let publishers = inner.publishers.lock();
            publishers.is_ok_and(|p| p.len() < RECEIVERS_KEPT_MAX || p.contains_key(&key))
        };
        if !keep || !room() {
            let _ = inner
                .session
                .put(key, bytes)
                .congestion_control(CongestionControl::Drop)
                .priority(priority)
                .express(true)
                .attachment(inner.signature.as_str())
                .wait();
            return;
        }
        let Ok(mut publishers) = inner.publishers.lock() else {
            return;
        };
        if !publishers.contains_key(&key) {
            let publisher = inner
                .session
                .declare_publisher(key.clone())
                .congestion_control(CongestionControl::Drop)
                .priority(priority)
                .express(true)
                .wait();
            match publisher {
                Ok(publisher) => publishers.insert(key.clone(), publisher),
                Err(error) => {
                    tracing::error!("nothing can be sent under {key}: {error}");
                    return;
                }
            };
        }
        let _ = publishers[&key]
            .put(bytes)
            .attachment(inner.signature.as_str())
            .wait();
    }

    /// Takes back the token, so that everybody knows at once that this process is gone, and ends the session; a peer that
    /// takes nothing any more is not waited for longer than a second.
    pub async fn close(self) {
        let token = self.inner.token.lock().ok().and_then(|mut t| t.take());
        if let Some(token) = token {
            let _ = token.undeclare().await;
        }
        let session = self.inner.session.clone();
        let _ = tokio::time::timeout(CLOSE_WITHIN, async { session.close().await }).await;
    }
}

/// Finds out which endpoint was at fault: Zenoh's error is a text.
async fn explain_open(options: &LinkOptions, error: &zenoh::Error) -> LinkError {
    for endpoint in &options.listen {
        let bound = match crate::reach::address(endpoint) {
            Some(address) => tokio::net::TcpListener::bind(address).await.map(drop),
            None => Err(std::io::Error::other("no protocol is named")),
        };
        match bound {
            Err(e) if e.kind() == std::io::ErrorKind::AddrInUse => {
                return LinkError::PortInUse {
                    endpoint: endpoint.clone(),
                    process: options.process.to_string(),
                };
            }
            Err(e) => {
                return LinkError::Listen {
                    endpoint: endpoint.clone(),
                    reason: e.to_string(),
                };
            }
            Ok(()) => {}
        }
    }
    LinkError::zenoh(
        &format!("opening the link of the {}", options.process),
        error,
    )
}
