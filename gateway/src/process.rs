//! The process: core, record file, field, journal and link, put together; and its clean end.

use crate::field::{Field, image::Points, modbus::Client};
use crate::io::IoView;
use crate::pace;
use crate::recording::Recording;
use crate::records::RecordFile;
use anyhow::Context as _;
use fam_driver::{Frames, Link, LinkOptions, Shell, Sinks};
use fam_gateway_core::{Gateway, GatewayAct, GatewayLocal, RecordWrite, Why};
use fam_proto::model::{CellModel, FieldDriver};
use fam_proto::{BootId, GatewayId, McId, Now, ProcessId, decode_frame, keys};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};

/// Where a gateway listens unless told otherwise.
pub const LISTEN: &str = "tcp/127.0.0.1:7448";
/// Where it looks for the manager unless told otherwise.
pub const CONNECT: &str = "tcp/127.0.0.1:7447";
/// Most frames that wait for the core; what comes on top is dropped, and its sender's next full checkpoint makes that good.
const FRAMES_WAITING_MAX: usize = 1_024;
/// How long a clean end may take for the last outputs to reach the field.
const LEAVE_MAX: Duration = Duration::from_secs(1);

/// What a gateway's process needs.
#[derive(Debug, Clone)]
pub struct GatewayOptions {
    /// The cell's `cell.toml`.
    pub cell: PathBuf,
    /// Which gateway of the cell; may be left out if there is only one.
    pub gateway: Option<GatewayId>,
    /// Endpoints to listen at.
    pub listen: Vec<String>,
    /// Endpoints to connect to: the manager.
    pub connect: Vec<String>,
    /// The record file; made if it is not there.
    pub records: PathBuf,
    /// Address of the Modbus device, `host:port`, instead of the one in the cell.
    pub field_address: Option<String>,
    /// Whether the journal of applied frames is streamed also while nobody is known to listen.
    pub stream_applied: bool,
    /// File that gets the journal of applied frames; one that is there is replaced.
    pub journal: Option<PathBuf>,
    /// Takes the fence away, so that a benchmark can show what it is for. Exists in test builds only.
    #[cfg(feature = "fence-off")]
    pub fence_off: bool,
}

impl GatewayOptions {
    /// The defaults for a cell with one gateway.
    #[must_use]
    pub fn new(cell: PathBuf, records: PathBuf) -> GatewayOptions {
        GatewayOptions {
            cell,
            gateway: None,
            listen: vec![LISTEN.to_owned()],
            connect: vec![CONNECT.to_owned()],
            records,
            field_address: None,
            stream_applied: false,
            journal: None,
            #[cfg(feature = "fence-off")]
            fence_off: false,
        }
    }
}

/// Runs a gateway of the cell in `options.cell` until `shutdown` completes: then all outputs are set to their fail-safe values, and it ends.
///
/// # Errors
/// If the cell, the record file, a port or the journal's file cannot be used; the message says what to do.
pub async fn run(
    options: GatewayOptions,
    shutdown: impl Future<Output = ()>,
) -> anyhow::Result<()> {
    let path = options.cell.clone();
    let model = tokio::task::spawn_blocking(move || fam_engineering::build_model(&path)).await??;
    run_model(&model, options, shutdown).await
}

/// As [`run`], for a model that is already there. Runs a gateway until `shutdown` completes: then all outputs are set to their fail-safe values, and it ends.
///
/// # Errors
/// If the cell, the record file, a port or the journal's file cannot be used; the message says what to do.
pub async fn run_model(
    model: &CellModel,
    options: GatewayOptions,
    shutdown: impl Future<Output = ()>,
) -> anyhow::Result<()> {
    let id = choose(model, options.gateway.as_ref())?;
    // The model is checked before anything on disk is touched.
    Gateway::new(model, &id, BootId(0), 0, vec![], Now(0))?;
    let (records, stored) = RecordFile::open(&options.records, model, &id)?;
    fam_driver::boot_after(&options.records.with_extension("boot"));
    let journal = match &options.journal {
        Some(path) => Some(
            std::fs::File::create(path)
                .with_context(|| format!("cannot make the journal {}", path.display()))?,
        ),
        None => None,
    };

    let mcs: Vec<McId> = model
        .mcs
        .iter()
        .filter(|mc| mc.gateway == id)
        .map(|mc| mc.mc.clone())
        .collect();
    let (locals, queue) = unbounded_channel();
    let inlet = Arc::new(Inlet {
        locals: locals.clone(),
        waiting: Mutex::default(),
        link: Mutex::new(None),
    });
    let sink = Arc::clone(&inlet);
    let (link, events) = Link::open_with(
        LinkOptions {
            listen: options.listen.clone(),
            connect: options.connect.clone(),
            frames: Frames::Of(mcs.clone()),
            // Exported variables of other gateways' MCs come with their images.
            images: model.gateways.len() > 1,
            peers: true,
            ..LinkOptions::new(model.cell.clone(), ProcessId::Gateway(id.clone()))
        },
        Sinks {
            frame: Some(Arc::new(move |mc, bytes| sink.frame(&mc, &bytes))),
            image: None,
        },
    )
    .await?;
    inlet.set_link(Some(link.clone()));

    let (field, points, field_text) = start_field(model, &id, &options, &locals);
    let view = Arc::new(IoView::new(model, &id, points));
    for record in &stored {
        if let Some(head) = &record.head {
            view.head(record.mc.clone(), head.clone());
        }
    }
    let io_server = (view.serve(&link, &id)?, view.serve_watched(&link, &id)?);
    let recording = Recording::start(&link, &id, options.stream_applied, journal)?;
    tracing::info!(
        gateway = %id,
        "gateway {id} of cell {} serves {}; field: {field_text}; records: {}",
        model.cell,
        mcs.iter().map(McId::as_str).collect::<Vec<_>>().join(", "),
        records.path().display(),
    );

    let start = fam_driver::now();
    let starts = records.starts();
    let agent = Gateway::new(model, &id, link.boot(), starts, stored, start)?;
    #[cfg(feature = "fence-off")]
    let agent = if options.fence_off {
        tracing::warn!("the fence is off: this build is for tests and drives no plant safely");
        agent.without_fence()
    } else {
        agent
    };
    let tick_us = model
        .gateways
        .iter()
        .find(|gateway| gateway.gateway == id)
        .map_or(5_000, |gateway| u64::from(gateway.tick_us));
    pace::start(&locals, start, tick_us).context("cannot start the thread of the ticks")?;

    let mut shell = GatewayShell {
        link: link.clone(),
        records,
        field,
        view,
        recording,
        locals: locals.clone(),
        bad_told: 0,
        left: false,
    };
    let leaving = async {
        shutdown.await;
        let _ = locals.send(GatewayLocal::Leave);
        tokio::time::sleep(LEAVE_MAX).await;
    };
    let agent = fam_driver::run(agent, &link, events, queue, &mut shell, leaving).await;

    if !shell.field.flush(LEAVE_MAX).await {
        tracing::warn!(
            "the last outputs could not be written to the field: the device does not answer; look after it"
        );
    }
    shell.records.sync_all()?;
    for (mc, counters) in agent.counters() {
        tracing::info!(mc = %mc, applied = counters.applied, repeated = counters.repeated, rejected = counters.rejected_all(), "frames of {mc}");
    }
    inlet.set_link(None);
    drop(io_server);
    drop(shell);
    link.close().await;
    tracing::info!("gateway {id} has ended");
    Ok(())
}

fn choose(model: &CellModel, wanted: Option<&GatewayId>) -> anyhow::Result<GatewayId> {
    match (wanted, model.gateways.as_slice()) {
        (Some(id), _) => Ok(id.clone()),
        (None, [only]) => Ok(only.gateway.clone()),
        (None, all) => {
            let names: Vec<_> = all.iter().map(|g| g.gateway.as_str()).collect();
            anyhow::bail!(
                "the cell {} has {} gateways ({}): say which one: fam gateway <name>",
                model.cell,
                all.len(),
                names.join(", ")
            )
        }
    }
}

fn start_field(
    model: &CellModel,
    id: &GatewayId,
    options: &GatewayOptions,
    locals: &UnboundedSender<GatewayLocal>,
) -> (Field, Option<Arc<Points>>, String) {
    let driver = model
        .gateways
        .iter()
        .find(|gateway| &gateway.gateway == id)
        .map(|gateway| &gateway.driver);
    match driver {
        Some(FieldDriver::Modbus { address }) => {
            let address = options.field_address.clone().unwrap_or(address.clone());
            let text = format!("Modbus TCP at {address}");
            let client = Client::start(model, id, address, locals.clone());
            (Field::Modbus(client), None, text)
        }
        Some(FieldDriver::Image) | None => {
            let points = Arc::new(Points::new(model, id));
            let text = "points in memory (`fam io get`, `fam io set`)".to_owned();
            (Field::Image(Arc::clone(&points)), Some(points), text)
        }
    }
}

/// Takes frames from Zenoh's thread to the core's queue, a bounded number at a time.
struct Inlet {
    locals: UnboundedSender<GatewayLocal>,
    /// Frames handed over; the core drops them when it has judged them.
    waiting: Mutex<VecDeque<Weak<[u8]>>>,
    link: Mutex<Option<Link>>,
}

impl Inlet {
    fn set_link(&self, link: Option<Link>) {
        *self.link.lock().unwrap_or_else(PoisonError::into_inner) = link;
    }

    fn frame(&self, mc: &McId, bytes: &fam_driver::FrameBytes) {
        let bytes = bytes.to_arc();
        if let Err(error) = decode_frame(&bytes) {
            let link = self.link.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(link) = &*link {
                link.count_bad(&keys::frame(link.cell(), mc), None, &error);
            }
            return;
        }
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        while waiting
            .front()
            .is_some_and(|frame| frame.strong_count() == 0)
        {
            waiting.pop_front();
        }
        if waiting.len() < FRAMES_WAITING_MAX {
            waiting.push_back(Arc::downgrade(&bytes));
            let _ = self.locals.send(GatewayLocal::Frame(bytes));
        }
    }
}

struct GatewayShell {
    link: Link,
    records: RecordFile,
    field: Field,
    view: Arc<IoView>,
    recording: Recording,
    locals: UnboundedSender<GatewayLocal>,
    /// What the core knows of messages that did not read.
    bad_told: u64,
    left: bool,
}

impl Shell<RecordWrite, GatewayAct> for GatewayShell {
    fn persist(&mut self, write: RecordWrite) -> Result<(), String> {
        self.records.write(&write)?;
        if let RecordWrite::Head { mc, head } = write {
            self.view.head(mc, head);
        }
        Ok(())
    }

    fn act(&mut self, action: GatewayAct, _: Now) {
        match action {
            GatewayAct::ReadField => self.field.read(&self.locals),
            GatewayAct::PublishImage(image) => {
                self.link.publish_image(&image);
                self.view.image(image);
                self.recording.tick();
                let bad = self.link.bad_messages();
                if bad != self.bad_told {
                    self.bad_told = bad;
                    let _ = self.locals.send(GatewayLocal::BadMessages(bad));
                }
            }
            GatewayAct::ApplyOutputs { mc, outputs, why } => {
                self.field.apply(&mc, &outputs);
                self.view.outputs(mc, outputs);
                if let Why::Frame(applied) = why {
                    self.recording.push(applied);
                }
            }
            GatewayAct::Left => self.left = true,
        }
    }

    fn finished(&self) -> bool {
        self.left
    }
}

#[cfg(test)]
mod tests;
