//! What goes wrong in a soak, and when: drawn from a seed; several faults may overlap, but one controller is always left.

use crate::bench::relay::{self, Cut};
use crate::observe::{Observer, monotonic_us};
use crate::running::Running;
use anyhow::{Context, Result};
use fam_proto::{CommandKind, ControllerId, McId};
use fam_simulation::simulator::Random;
use nix::sys::signal::Signal;
use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

/// Pause between the beginnings of two faults, in milliseconds.
const PAUSE_MS: (u64, u64) = (1_000, 6_000);
/// So many controllers are always whole and undrained.
const WHOLE_MIN: usize = 1;
/// A fault's consequences may come so long after its end, in microseconds: a node that starts again joins, and work is
/// balanced.
const AFTER_US: u64 = 3_000_000;

/// A node is asked to end no earlier than so long after its start: before that it does not know SIGTERM yet.
const STOPPABLE_AFTER: Duration = Duration::from_secs(2);

/// A process that a fault hits.
pub const MANAGER: &str = "manager";
/// A process that a fault hits.
pub const GATEWAY: &str = "gateway";

/// Kinds of faults, with their shares.
const KINDS: [(Kind, u64); 11] = [
    (Kind::KillNode, 20),
    (Kind::FreezeNode, 16),
    (Kind::CutNode, 14),
    (Kind::StopNode, 6),
    (Kind::KillManager, 7),
    (Kind::FreezeManager, 7),
    (Kind::KillGateway, 6),
    (Kind::FreezeGateway, 6),
    (Kind::Move, 12),
    (Kind::Drain, 6),
    (Kind::KillTwo, 4),
];

/// Kind of a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    KillNode,
    FreezeNode,
    CutNode,
    StopNode,
    KillManager,
    FreezeManager,
    KillGateway,
    FreezeGateway,
    Move,
    Drain,
    /// A node while the manager is down.
    KillTwo,
}

impl Kind {
    /// Its name in the ledger.
    pub fn name(self) -> &'static str {
        match self {
            Kind::KillNode => "kill_node",
            Kind::FreezeNode => "freeze_node",
            Kind::CutNode => "cut_node",
            Kind::StopNode => "stop_node",
            Kind::KillManager => "kill_manager",
            Kind::FreezeManager => "freeze_manager",
            Kind::KillGateway => "kill_gateway",
            Kind::FreezeGateway => "freeze_gateway",
            Kind::Move => "move",
            Kind::Drain => "drain",
            Kind::KillTwo => "kill_node_and_manager",
        }
    }

    /// How long it lasts, in milliseconds.
    fn lasts_ms(self) -> (u64, u64) {
        match self {
            Kind::KillNode | Kind::StopNode | Kind::KillTwo => (100, 4_000),
            Kind::FreezeNode | Kind::CutNode => (20, 2_500),
            Kind::KillManager => (50, 3_000),
            Kind::FreezeManager => (20, 2_000),
            Kind::KillGateway => (20, 1_500),
            Kind::FreezeGateway => (10, 400),
            Kind::Move => (0, 0),
            Kind::Drain => (500, 5_000),
        }
    }
}

/// A fault, past or present.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// What.
    pub kind: Kind,
    /// Which process: a controller, the manager or the gateway.
    pub target: String,
    /// When it began, on the machine's monotonic clock.
    pub from_us: u64,
    /// When it ended; `None` while it lasts.
    pub until_us: Option<u64>,
}

impl Fault {
    /// Whether it can have had a consequence at any time between these two moments.
    pub fn touches(&self, from_us: u64, to_us: u64) -> bool {
        self.from_us <= to_us
            && self
                .until_us
                .is_none_or(|until| until + AFTER_US >= from_us)
    }
}

/// A fault that lasts.
struct Lasting {
    fault: usize,
    until: Instant,
}

/// Begins and ends faults.
pub struct Chaos {
    random: Random,
    controllers: Vec<String>,
    mcs: Vec<McId>,
    cuts: BTreeMap<String, Cut>,
    faults: Vec<Fault>,
    lasting: Vec<Lasting>,
    next: Instant,
    counts: BTreeMap<&'static str, u64>,
    refused_in: Sender<()>,
    refused_out: Receiver<()>,
    refused: u64,
    calm_since_us: Option<u64>,
    started: BTreeMap<String, Instant>,
}

/// Puts relays before half of the controllers, so that their links can be cut.
pub fn cuttable(cell: &mut Running, controllers: &[String]) -> Result<BTreeMap<String, Cut>> {
    let (mut cuts, mut detour) = (BTreeMap::new(), BTreeMap::new());
    for controller in &controllers[controllers.len() / 2..] {
        let cut = Cut::default();
        let near = |endpoint: &str| -> Result<String> {
            let address: SocketAddr = endpoint
                .trim_start_matches("tcp/")
                .parse()
                .with_context(|| format!("{endpoint} is no TCP endpoint"))?;
            Ok(format!("tcp/{}", relay::start(address, &cut)?))
        };
        detour.insert(
            controller.clone(),
            vec![
                near(cell.manager_endpoint())?,
                near(cell.gateway_endpoint())?,
            ],
        );
        cuts.insert(controller.clone(), cut);
    }
    cell.detour(detour);
    Ok(cuts)
}

impl Chaos {
    pub fn new(
        seed: u64,
        controllers: Vec<String>,
        mcs: Vec<McId>,
        cuts: BTreeMap<String, Cut>,
    ) -> Chaos {
        let (refused_in, refused_out) = channel();
        Chaos {
            random: Random::new(seed, 7),
            controllers,
            mcs,
            cuts,
            faults: Vec::new(),
            lasting: Vec::new(),
            next: Instant::now() + Duration::from_millis(PAUSE_MS.1),
            counts: BTreeMap::new(),
            refused_in,
            refused_out,
            refused: 0,
            calm_since_us: None,
            started: BTreeMap::new(),
        }
    }

    /// All faults so far.
    pub fn faults(&self) -> &[Fault] {
        &self.faults
    }

    /// How many of each kind.
    pub fn counts(&self) -> BTreeMap<&'static str, u64> {
        self.counts.clone()
    }

    /// Commands that the manager has not carried out, because it was down or the controller was.
    pub fn refused(&mut self) -> u64 {
        self.refused += self.refused_out.try_iter().count() as u64;
        self.refused
    }

    /// Since when manager and gateway have been whole and a controller able to drive; `None` while they are not.
    pub fn calm_since_us(&self) -> Option<u64> {
        self.calm_since_us
    }

    /// Begins a fault if it is time.
    pub fn maybe_begin(&mut self, cell: &mut Running, eye: &Observer) -> Result<()> {
        if Instant::now() < self.next {
            return Ok(());
        }
        let pause = self.random.between(PAUSE_MS.0, PAUSE_MS.1);
        self.next = Instant::now() + Duration::from_millis(pause);
        let all: u64 = KINDS.iter().map(|(_, share)| share).sum();
        let mut drawn = self.random.below(all);
        let Some((kind, _)) = KINDS.into_iter().find(|(_, share)| {
            let hit = drawn < *share;
            drawn = drawn.saturating_sub(*share);
            hit
        }) else {
            return Ok(());
        };
        self.begin(kind, cell, eye)
    }

    fn begin(&mut self, kind: Kind, cell: &mut Running, eye: &Observer) -> Result<()> {
        let Some(target) = self.target(kind) else {
            return Ok(());
        };
        let (from, to) = kind.lasts_ms();
        let lasts = Duration::from_millis(self.random.between(from, to));
        *self.counts.entry(kind.name()).or_default() += 1;
        match kind {
            Kind::KillNode => {
                self.note(kind, &target, lasts);
                cell.kill_node(&target)?;
            }
            Kind::FreezeNode => {
                self.note(kind, &target, lasts);
                cell.signal_node(&target, Signal::SIGSTOP)?;
            }
            Kind::CutNode => {
                self.note(kind, &target, lasts);
                if let Some(cut) = self.cuts.get(&target) {
                    cut.set(true);
                }
            }
            Kind::StopNode => {
                self.note(kind, &target, lasts);
                cell.stop_node(&target)?;
            }
            Kind::KillManager => {
                self.note(kind, &target, lasts);
                cell.kill_manager()?;
            }
            Kind::KillGateway => {
                self.note(kind, &target, lasts);
                cell.kill_gateway()?;
            }
            Kind::FreezeManager | Kind::FreezeGateway => {
                self.note(kind, &target, lasts);
                cell.signal(&target, Signal::SIGSTOP)?;
            }
            Kind::KillTwo => {
                self.note(Kind::KillManager, MANAGER, lasts);
                self.note(Kind::KillNode, &target, lasts * 2);
                cell.kill_manager()?;
                cell.kill_node(&target)?;
            }
            Kind::Move => {
                let mc = self.mcs[self.random.index(self.mcs.len())].clone();
                let to = ControllerId::new(&target)?;
                self.command(
                    eye,
                    CommandKind::Move {
                        mc,
                        to,
                        force: false,
                    },
                );
            }
            Kind::Drain => {
                self.note(kind, &target, lasts);
                self.command(eye, CommandKind::Drain(ControllerId::new(&target)?));
            }
        }
        self.calm();
        Ok(())
    }

    fn target(&mut self, kind: Kind) -> Option<String> {
        let busy: BTreeSet<&str> = self
            .lasting
            .iter()
            .map(|l| self.faults[l.fault].target.as_str())
            .collect();
        match kind {
            Kind::KillManager | Kind::FreezeManager => {
                (!busy.contains(MANAGER)).then(|| MANAGER.to_owned())
            }
            Kind::KillGateway | Kind::FreezeGateway => {
                (!busy.contains(GATEWAY)).then(|| GATEWAY.to_owned())
            }
            _ => {
                let whole: Vec<String> = self
                    .controllers
                    .iter()
                    .filter(|c| !busy.contains(c.as_str()))
                    .cloned()
                    .collect();
                if kind == Kind::KillTwo && busy.contains(MANAGER) {
                    return None;
                }
                if kind != Kind::Move && whole.len() <= WHOLE_MIN {
                    return None;
                }
                let fitting: Vec<String> = whole
                    .into_iter()
                    .filter(|c| kind != Kind::CutNode || self.cuts.contains_key(c))
                    .filter(|c| {
                        let young = |at: &Instant| at.elapsed() < STOPPABLE_AFTER;
                        kind != Kind::StopNode || !self.started.get(c).is_some_and(young)
                    })
                    .collect();
                self.random.pick(&fitting).cloned()
            }
        }
    }

    fn note(&mut self, kind: Kind, target: &str, lasts: Duration) {
        self.faults.push(Fault {
            kind,
            target: target.to_owned(),
            from_us: monotonic_us(),
            until_us: None,
        });
        self.lasting.push(Lasting {
            fault: self.faults.len() - 1,
            until: Instant::now() + lasts,
        });
    }

    /// The plant's account tells whether a command was carried out; here it is only told apart from one that was not.
    fn command(&self, eye: &Observer, what: CommandKind) {
        let refused = self.refused_in.clone();
        eye.command_along(what, move |result| {
            if result.is_err() {
                // The soak may be over.
                let _ = refused.send(());
            }
        });
    }

    /// Ends the faults whose time is over.
    pub fn end_what_is_due(&mut self, cell: &mut Running, eye: &Observer) -> Result<()> {
        let now = Instant::now();
        while let Some(at) = self.lasting.iter().position(|l| l.until <= now) {
            let lasting = self.lasting.swap_remove(at);
            self.end(lasting.fault, cell, eye)?;
        }
        self.calm();
        Ok(())
    }

    /// Ends all faults now.
    pub fn heal(&mut self, cell: &mut Running, eye: &Observer) -> Result<()> {
        for lasting in std::mem::take(&mut self.lasting) {
            self.end(lasting.fault, cell, eye)?;
        }
        self.calm();
        Ok(())
    }

    fn end(&mut self, fault: usize, cell: &mut Running, eye: &Observer) -> Result<()> {
        let (kind, target) = (self.faults[fault].kind, self.faults[fault].target.clone());
        match kind {
            Kind::KillNode | Kind::StopNode | Kind::KillTwo => {
                cell.start_node(&target)?;
                self.started.insert(target, Instant::now());
            }
            Kind::FreezeNode => cell.signal_node(&target, Signal::SIGCONT)?,
            Kind::CutNode => {
                if let Some(cut) = self.cuts.get(&target) {
                    cut.set(false);
                }
            }
            Kind::KillManager => cell.start_manager()?,
            Kind::KillGateway => cell.start_gateway()?,
            Kind::FreezeManager | Kind::FreezeGateway => cell.signal(&target, Signal::SIGCONT)?,
            Kind::Drain => self.command(eye, CommandKind::Undrain(ControllerId::new(&target)?)),
            Kind::Move => {}
        }
        self.faults[fault].until_us = Some(monotonic_us());
        Ok(())
    }

    fn calm(&mut self) {
        let broken = self.lasting.iter().any(|l| {
            let target = self.faults[l.fault].target.as_str();
            target == MANAGER || target == GATEWAY
        });
        self.calm_since_us = match (broken, self.calm_since_us) {
            (true, _) => None,
            (false, None) => Some(monotonic_us()),
            (false, since) => since,
        };
    }
}
