//! Starts and ends a controller node.

use crate::cpu::{Bell, ThreadClock};
use crate::hosted::{self, Hosted};
use crate::mailbox::Mailbox;
use crate::real_time::{self, RealTimeOptions};
use crate::replica_thread::{self, ReplicaThread};
use crate::scan_thread::{self, Begun, Doing, Host, ScanThread};
use crate::sender_thread::{self, Outbox, SenderThread};
use crate::shared::Shared;
use crate::shell::{Informed, NodeShell};
use crate::stage::Stager;
use crate::trace::{self, Trace};
use crate::watchdog::{Watchdog, scan_ns_max};
use anyhow::Context as _;
use crossbeam_channel::bounded;
use fam_agents::node::{NodeAgents, NodeConfig, NodeLocal};
use fam_driver::{Frames, Link, LinkOptions, Sinks};
use fam_engineering::BuiltCell;
use fam_node_core::{Replica, ScanCore};
use fam_proto::{ControllerId, McId, Owner, ProcessId};
use fam_soft_plc::{Engine, EngineOptions, Interruption};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use tokio::sync::mpsc;

/// How a node is started.
#[derive(Debug, Clone)]
pub struct NodeOptions {
    /// The cell model, `cell.toml`.
    pub cell: PathBuf,
    /// Which of its controllers this is.
    pub controller: ControllerId,
    /// Zenoh endpoints to listen at; port 0 takes any free one.
    pub listen: Vec<String>,
    /// Zenoh endpoints of manager and gateways.
    pub connect: Vec<String>,
    /// Where machine code is kept between starts.
    pub cache: Option<PathBuf>,
    /// Real-time means that are wanted.
    pub real_time: RealTimeOptions,
    /// Values of this controller for further bid criteria, by name.
    pub criteria: Vec<(String, i64)>,
    /// Whether measuring points are published ([`trace`]).
    pub trace: bool,
}

impl NodeOptions {
    /// A node of a cell on this machine, with everything else at its default.
    #[must_use]
    pub fn new(cell: PathBuf, controller: ControllerId) -> NodeOptions {
        NodeOptions {
            cell,
            controller,
            listen: vec!["tcp/127.0.0.1:0".to_owned()],
            connect: vec![
                "tcp/127.0.0.1:7447".to_owned(),
                "tcp/127.0.0.1:7448".to_owned(),
            ],
            cache: None,
            real_time: RealTimeOptions::default(),
            criteria: Vec::new(),
            trace: false,
        }
    }
}

/// Runs a node until `shutdown` completes and its MCs are handed over.
///
/// # Errors
/// If the cell does not build, has no such controller, or the link cannot be opened; the message says what to do.
pub async fn run(
    options: NodeOptions,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> anyhow::Result<()> {
    let engine = Engine::new(EngineOptions {
        interruption: Interruption::Epoch,
    })?;
    let (built, hosted) = load(&options, &engine).await?;
    let model = built.model.clone();
    let name = options.controller.to_string();
    if hosted.specs.is_empty() {
        tracing::warn!("no MC of cell {} is hosted on {name}", model.cell);
    }
    let boot = match &options.cache {
        Some(cache) => fam_driver::boot_after(&cache.join(format!("{name}.boot"))),
        None => fam_driver::boot_id(),
    };
    let owner = Owner {
        controller: options.controller.clone(),
        boot,
    };
    let locked = real_time::lock_memory(&options.real_time);

    let gateways = hosted.models.iter().map(|m| m.gateway.clone());
    let mailbox = Arc::new(Mailbox::new(gateways));
    let shared = Arc::new(Shared::new(hosted.specs.clone()));
    let trace = Arc::new(Trace::new(options.trace));
    let doing = Arc::new(Doing::default());

    let (frames_in, frames_out) = bounded(replica_thread::FRAMES_WAITING_MAX);
    let sinks = {
        let (mailbox, shared) = (mailbox.clone(), shared.clone());
        Sinks {
            image: Some(Arc::new(move |image| mailbox.put(image, fam_driver::now()))),
            frame: Some(Arc::new(move |mc, bytes| {
                if frames_in.try_send((mc, bytes)).is_err() {
                    let missed = &shared.counters.frames_missed;
                    missed.fetch_add(1, Ordering::Relaxed);
                }
            })),
        }
    };
    let mcs: Vec<McId> = hosted.specs.iter().map(|s| s.mc.clone()).collect();
    let link_options = LinkOptions {
        cell: model.cell.clone(),
        process: ProcessId::Node(options.controller.clone()),
        boot: owner.boot,
        listen: options.listen.clone(),
        connect: options.connect.clone(),
        images: true,
        frames: Frames::Of(mcs),
        peers: true,
    };
    let (link, events) = Link::open_with(link_options, sinks)
        .await
        .with_context(|| format!("controller {name} cannot join cell {}", model.cell))?;

    let (news, locals) = mpsc::unbounded_channel();
    let (jobs_in, jobs_out) = bounded(replica_thread::JOBS_WAITING_MAX);
    let (commands_in, commands_out) = bounded(replica_thread::JOBS_WAITING_MAX);
    let (scanned_in, scanned_out) = bounded(sender_thread::FRAMES_WAITING_MAX);
    let (jitter_full_in, jitter_full_out) = bounded(2);
    let (jitter_empty_in, jitter_empty_out) = bounded(2);
    for empty in [scan_thread::jitter(), scan_thread::jitter()]
        .into_iter()
        .flatten()
    {
        let _ = jitter_empty_in.send(empty);
    }
    let replicas = hosted
        .specs
        .iter()
        .zip(hosted.runtimes)
        .map(|(spec, runtime)| Replica::new(spec.clone(), owner.clone(), runtime));

    let (bell, frames_bell) = (Arc::new(Bell::default()), Arc::new(Bell::default()));
    let mut threads = Vec::new();
    let replica_thread = ReplicaThread {
        replicas: replicas.collect(),
        jobs: jobs_out,
        frames: frames_out,
        commands: commands_in,
        bell: bell.clone(),
        news: news.clone(),
        shared: shared.clone(),
        link: link.clone(),
        trace: trace.clone(),
    };
    threads.push(spawn("fam-replica", move || replica_thread.run())?);
    {
        let sender_thread = SenderThread {
            jobs: scanned_out,
            bell: frames_bell.clone(),
            sender: link.sender(),
            shared: shared.clone(),
            trace: trace.clone(),
        };
        threads.push(spawn("fam-sender", move || sender_thread.run())?);
    }
    let scan_thread = ScanThread {
        core: ScanCore::new(
            owner.clone(),
            hosted.controller.tick_us,
            hosted.controller.cpu_factor_permille,
            hosted.specs.len(),
        ),
        tick_us: hosted.controller.tick_us,
        mailbox: mailbox.clone(),
        shared: shared.clone(),
        commands: commands_out,
        bell,
        host: Host {
            shared: shared.clone(),
            doing: doing.clone(),
            frames: Outbox::new(
                scanned_in,
                frames_bell.clone(),
                hosted.controller.tick_us,
                trace.is_on(),
            ),
            replicas: jobs_in.clone(),
            news: news.clone(),
            took_ns: vec![0; hosted.specs.len()],
            scan: None,
        },
        jitter_out: jitter_full_in,
        jitter_back: jitter_empty_out,
    };
    let (begun_in, begun_out) = bounded::<Begun>(1);
    let scan_options = options.real_time.clone();
    threads.push(spawn("fam-scan", move || {
        scan_thread.run(&scan_options, &begun_in);
    })?);
    let begun = tokio::task::spawn_blocking(move || begun_out.recv())
        .await?
        .context("the scan thread did not begin")?;
    let clock: Option<ThreadClock> = begun.clock;
    if clock.is_none() {
        tracing::warn!("{name}: endless loops cannot be ended: no CPU clock of the scan thread");
    }
    let trace_topic = if trace.is_on() {
        Some(link.topic(&trace::key(&model.cell, &options.controller))?)
    } else {
        None
    };
    let watchdog = Watchdog {
        doing,
        frames_bell,
        clock,
        scan_ns_max: hosted
            .models
            .iter()
            .map(|m| scan_ns_max(m.cycle_us, m.suspect_us))
            .collect(),
        interrupt: {
            let engine = engine.clone();
            move || engine.interrupt_tick()
        },
        shared: shared.clone(),
        mailbox,
        link: link.clone(),
        trace,
        trace_topic,
        jitter_in: jitter_full_out,
        jitter_back: jitter_empty_in,
        connect: options.connect.clone(),
        name: format!("controller {name}"),
    };
    threads.push(spawn("fam-watchdog", move || watchdog.run())?);

    let real_time: Vec<String> = begun.real_time.into_iter().chain(locked).collect();
    tracing::info!(
        "controller {name} hosts {} MCs{}",
        hosted.specs.len(),
        if real_time.is_empty() {
            String::new()
        } else {
            format!(", with {}", real_time.join(", "))
        }
    );
    let config = NodeConfig {
        owner,
        model: hosted.controller,
        mcs: hosted.models,
        settings: model.settings.clone(),
        real_time,
        criteria: options.criteria.clone(),
    };
    let agents = Informed {
        told: vec![None; shared.specs.len()],
        agents: NodeAgents::new(config, fam_driver::now()),
        shared: shared.clone(),
    };
    let stager = Stager {
        options: options.clone(),
        engine,
        specs: shared.specs.clone(),
        running: Arc::new(Mutex::new(built)),
        staged: Arc::default(),
        jobs: jobs_in.clone(),
        news: news.clone(),
    };
    let ender = tokio::spawn(async move {
        shutdown.await;
        let _ = news.send(NodeLocal::Terminate);
        // The queue stays open until the agents have handed over.
        std::future::pending::<()>().await;
    });
    let mut shell = NodeShell {
        jobs: jobs_in,
        shared: shared.clone(),
        finished: false,
        stager,
        left: Vec::new(),
    };
    fam_driver::run(
        agents,
        &link,
        events,
        locals,
        &mut shell,
        std::future::pending(),
    )
    .await;
    ender.abort();
    end(&shared, threads, link).await;
    if shell.left.is_empty() {
        tracing::info!("controller {name} has ended");
    }
    Ok(())
}

/// Builds the cell and what is hosted here, off the runtime's threads.
async fn load(options: &NodeOptions, engine: &Engine) -> anyhow::Result<(BuiltCell, Hosted)> {
    let (cell, controller) = (options.cell.clone(), options.controller.clone());
    let (cache, engine) = (options.cache.clone(), engine.clone());
    tokio::task::spawn_blocking(move || {
        // Compiling takes seconds of CPU time, which no running MC may miss.
        real_time::normal_priority();
        let built =
            fam_engineering::build(&cell).map_err(|problems| anyhow::anyhow!("{problems}"))?;
        for warning in &built.warnings {
            tracing::debug!("{warning}");
        }
        let hosted = hosted::host(&built, &controller, &engine, cache.as_deref())?;
        Ok((built, hosted))
    })
    .await?
}

fn spawn(name: &str, body: impl FnOnce() + Send + 'static) -> anyhow::Result<JoinHandle<()>> {
    std::thread::Builder::new()
        .name(name.to_owned())
        .spawn(body)
        .with_context(|| format!("the thread {name} cannot be started"))
}

/// Ends the threads, then the link: frames that wait still leave.
async fn end(shared: &Shared, threads: Vec<JoinHandle<()>>, link: Link) {
    shared.stop.store(true, Ordering::Relaxed);
    let ended = tokio::task::spawn_blocking(move || {
        for thread in threads {
            let name = thread.thread().name().unwrap_or("thread").to_owned();
            if thread.join().is_err() {
                tracing::error!("{name} has panicked");
            }
        }
    });
    let _ = ended.await;
    link.close().await;
}
