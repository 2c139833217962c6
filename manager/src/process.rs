//! The process: cell, repository, link and agents put together.

use crate::shell::ManagerShell;
use crate::store::Store;
use anyhow::Context;
use fam_agents::manager::{ManagerAgents, ManagerLocal, boot_after};
use fam_driver::{Link, LinkOptions, boot_id, now, wall_us};
use fam_proto::model::CellModel;
use fam_proto::{BootId, ProcessId, RepoState};
use fam_repository::{Repository, open_file};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;

/// How often the agents are told the wall clock and the count of messages that did not read.
const TELL_EVERY: Duration = Duration::from_secs(1);

/// Where things are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ManagerOptions {
    /// The cell model, `cell.toml`.
    pub cell_file: PathBuf,
    /// The System Repository; made if it is not there.
    pub repository: PathBuf,
    /// Zenoh endpoints to listen at.
    pub listen: Vec<String>,
    /// Zenoh endpoints of others, the gateways above all; tried for ever.
    pub connect: Vec<String>,
}

impl ManagerOptions {
    /// A manager at the usual place.
    #[must_use]
    pub fn new(cell_file: PathBuf, repository: PathBuf) -> ManagerOptions {
        ManagerOptions {
            cell_file,
            repository,
            listen: vec!["tcp/127.0.0.1:7447".to_owned()],
            connect: vec!["tcp/127.0.0.1:7448".to_owned()],
        }
    }
}

/// Runs the manager until `shutdown` completes.
///
/// # Errors
/// A cell with problems, a repository that is refused, a port in use; the text says what to do.
pub async fn run(
    options: ManagerOptions,
    shutdown: impl Future<Output = ()>,
) -> anyhow::Result<()> {
    let model = Arc::new(fam_engineering::build_model(&options.cell_file)?);
    let (repository, restored) = open_file(&options.repository, &model.cell)?;
    let boot = boot_after(boot_id().0, &restored, drawn());
    run_on(model, repository, restored, boot, options, shutdown).await
}

/// As [`run`], over a model and a repository that are already there; the two paths of `options` are not looked at.
///
/// # Errors
/// A port in use.
pub async fn run_on(
    model: Arc<CellModel>,
    repository: Repository,
    restored: RepoState,
    boot: BootId,
    options: ManagerOptions,
    shutdown: impl Future<Output = ()>,
) -> anyhow::Result<()> {
    let link = LinkOptions {
        boot,
        listen: options.listen,
        connect: options.connect,
        images: true,
        peers: true,
        ..LinkOptions::new(model.cell.clone(), ProcessId::Manager)
    };
    let (link, events) = Link::open(link).await?;
    let store = Store::start(repository).context("the repository's writer thread")?;
    let (locals, receiver) = mpsc::unbounded_channel();
    let _ = locals.send(ManagerLocal::Wall { unix_us: wall_us() });
    let teller = tokio::spawn(tell(link.clone(), locals));
    let agents = ManagerAgents::new(model, restored, boot, now());
    let shell = ManagerShell::new(link.clone(), store);
    // The shell goes with it: what is gathered for the repository is written before this returns.
    fam_driver::run(agents, &link, events, receiver, shell, shutdown).await;
    teller.abort();
    link.close().await;
    Ok(())
}

async fn tell(link: Link, locals: mpsc::UnboundedSender<ManagerLocal>) {
    let mut every = tokio::time::interval(TELL_EVERY);
    every.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut bad = 0;
    loop {
        every.tick().await;
        let mut told = locals.send(ManagerLocal::Wall { unix_us: wall_us() });
        if link.bad_messages() != bad {
            bad = link.bad_messages();
            told = locals.send(ManagerLocal::BadMessages(bad));
        }
        if told.is_err() {
            return;
        }
    }
}

/// A number that no other life has drawn, also not one on a copy of this machine.
fn drawn() -> u64 {
    use std::hash::BuildHasher;
    std::collections::hash_map::RandomState::new().hash_one(std::process::id())
}
