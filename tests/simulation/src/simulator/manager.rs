//! The manager's process: its agents, its repository, and a disk that may fail.

use super::canary::Canary;
use super::network::Pid;
use super::random::Random;
use super::world::{Event, World};
use crate::invariants::Seen;
use fam_agents::manager::{ManagerAgents, ManagerLocal};
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::{AgentId, CellId, Epoch, Message, RepoState, RepoWrite};
use fam_repository::Repository;
use fam_repository::disk::Disk;

/// A manager that could not open its repository is started again after this long, in microseconds.
const START_AGAIN_US: u64 = 50_000;

/// Where the manager keeps what it knows: the real repository on a simulated disk.
pub(super) struct Store {
    /// What was answered `Ok`: what has to be there after a restart.
    pub promised: RepoState,
    cell: CellId,
    disk: Disk,
    open: Option<Repository>,
}

impl Store {
    pub(super) fn new(cell: &CellId) -> Store {
        Store {
            promised: RepoState::default(),
            cell: cell.clone(),
            disk: Disk::default(),
            open: None,
        }
    }

    fn load(&mut self) -> Result<RepoState, String> {
        let disk = self.disk.clone();
        let opened = Repository::over(&self.cell, move || Ok(disk.backend()));
        let (repository, state) = opened.map_err(|error| error.to_string())?;
        self.open = Some(repository);
        Ok(state)
    }

    fn write(&mut self, write: &RepoWrite) -> Result<(), String> {
        let repository = self.open.as_mut().ok_or("it is not open")?;
        repository
            .store(std::slice::from_ref(write))
            .map_err(|error| error.to_string())?;
        self.promised.apply(write);
        Ok(())
    }

    /// From now on every write fails, or none.
    pub(super) fn fails(&mut self, fails: bool) {
        self.disk.fail_in(fails.then_some(0));
    }

    /// The power goes off: of what was not synced some is on the disk.
    fn crash(&mut self, random: &mut Random) {
        self.disk.crash(|_| random.chance(500));
        self.open = None;
    }

    /// Epochs that were promised and are not there any more.
    fn lost(&self, restored: &RepoState) -> Vec<String> {
        let there = |mc| restored.epochs.get(mc).copied().unwrap_or_default();
        let lost = self.promised.epochs.iter();
        lost.filter(|(mc, upto)| there(mc) < **upto)
            .map(|(mc, upto)| format!("{mc} up to {upto}, found {}", there(mc)))
            .collect()
    }
}

impl World {
    pub(super) fn start_manager(&mut self) {
        let restored = match self.store.load() {
            Ok(state) => state,
            Err(_) if self.manager_disk_fails > 0 => {
                // It says so and ends; whoever looks after it starts it again.
                let at_us = self.now_us + START_AGAIN_US;
                self.queue.push(at_us, Event::Start(Pid::Manager));
                return;
            }
            Err(error) => {
                self.defect(format!("the manager's repository does not open: {error}"));
                return;
            }
        };
        let lost = self.store.lost(&restored);
        if !lost.is_empty() && !self.has(Canary::EpochsForgotten) {
            self.defect(format!(
                "the repository has lost epochs: {}",
                lost.join("; ")
            ));
        }
        let now = self.local(Pid::Manager);
        let boot = self.boot_of(Pid::Manager);
        let model = self.cell.model.clone();
        self.manager = Some(ManagerAgents::new(model, restored, boot, now));
        self.manager_input(Input::Local(ManagerLocal::Wall { unix_us: boot.0 }));
    }

    pub(super) fn kill_store(&mut self) {
        self.store.crash(&mut self.random);
    }

    pub(super) fn manager_input(&mut self, input: Input<ManagerLocal>) {
        let now = self.local(Pid::Manager);
        if let Some(manager) = &mut self.manager {
            manager.handle(input, now);
        }
        self.carry_out_manager();
    }

    pub(super) fn carry_out_manager(&mut self) {
        while let Some(output) = self.manager.as_mut().and_then(Agent::poll_output) {
            if self.is_doomed(Pid::Manager) {
                self.kill(Pid::Manager);
                return;
            }
            match output {
                Output::Persist { ticket, write } => {
                    let result = self.store_write(&write);
                    let now = self.local(Pid::Manager);
                    if let Some(manager) = &mut self.manager {
                        manager.handle(Input::Persisted { ticket, result }, now);
                    }
                }
                Output::Send(envelope) => {
                    if let (Message::Order(order), AgentId::Component(to, _)) =
                        (&envelope.body, &envelope.to)
                    {
                        let promised = &self.store.promised.epochs;
                        let durable = promised.get(&order.mc).copied().unwrap_or(Epoch(0));
                        let seen = Seen::Ordered {
                            manager: envelope.boot,
                            order,
                            to,
                            durable,
                        };
                        self.invariants.see(&seen, self.now_us);
                    }
                    if self.has(Canary::OrderDoubled) {
                        self.double_order(&envelope);
                    }
                    self.send(Pid::Manager, envelope);
                }
                Output::Act(act) => self.note(|| format!("manager  does {act:?}")),
                Output::Event(event) => {
                    self.deed(super::quiet::deed_of(event.kind));
                    self.note(|| {
                        format!(
                            "manager  EVENT {:?} {:?}: {}",
                            event.severity, event.kind, event.text
                        )
                    });
                }
            }
        }
        self.arm(Pid::Manager);
    }

    fn store_write(&mut self, write: &RepoWrite) -> Result<(), String> {
        if self.has(Canary::EpochsForgotten) && matches!(write, RepoWrite::EpochBlock { .. }) {
            self.store.promised.apply(write);
            return Ok(());
        }
        let result = self.store.write(write);
        if let Err(error) = &result
            && self.manager_disk_fails == 0
        {
            self.defect(format!("the repository fails on a good disk: {error}"));
        }
        result
    }

    /// Planted bug: a second host gets the order, too.
    fn double_order(&mut self, envelope: &fam_proto::Envelope) {
        let (Message::Order(order), AgentId::Component(to, mc)) = (&envelope.body, &envelope.to)
        else {
            return;
        };
        let other = self
            .cell
            .model
            .mc(mc)
            .and_then(|m| m.hosts.iter().find(|h| *h != to).cloned());
        if let (Some(other), fam_proto::OrderKind::Activate { epoch, .. }) = (other, &order.kind) {
            let mut copy = envelope.clone();
            copy.to = AgentId::Component(other, mc.clone());
            copy.body = Message::Order(fam_proto::Order {
                kind: fam_proto::OrderKind::Activate {
                    epoch: *epoch,
                    after: None,
                    force: false,
                    reset: None,
                    within_us: 500_000,
                },
                ..order.clone()
            });
            self.send(Pid::Manager, copy);
        }
    }
}
