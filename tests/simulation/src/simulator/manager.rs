//! The manager's process: its agents, its repository, and a disk that may fail.

use super::canary::Canary;
use super::faults::Fault;
use super::network::Pid;
use super::random::Random;
use super::world::{Event, World};
use crate::invariants::Seen;
use fam_agents::manager::{ManagerAgents, ManagerLocal, boot_after};
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::{AgentId, CellId, Epoch, Message, RepoState, RepoWrite};
use fam_repository::Repository;
use fam_repository::disk::Disk;

/// A manager that could not open its repository is started again after this long, in microseconds.
const START_AGAIN_US: u64 = 50_000;

/// A manager's process and its machine.
pub(super) struct Managing {
    pub agents: Option<ManagerAgents>,
    pub store: Store,
}

impl Managing {
    pub(super) fn new(cell: &CellId) -> Managing {
        Managing {
            agents: None,
            store: Store::new(cell),
        }
    }
}

/// A copy of a repository, put aside.
#[derive(Clone)]
pub(super) struct Copy {
    bytes: Vec<u8>,
    promised: RepoState,
}

/// Where a manager keeps what it knows: the real repository on a simulated disk.
pub(super) struct Store {
    /// What was answered `Ok`: what has to be there after a restart.
    pub promised: RepoState,
    /// Which history it tells: a copy begins another one.
    pub history: u64,
    cell: CellId,
    disk: Disk,
    open: Option<Repository>,
}

impl Store {
    fn new(cell: &CellId) -> Store {
        Store {
            promised: RepoState::default(),
            history: 0,
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

    /// From now on every write fails after so many operations; `None`: none fails.
    pub(super) fn fails_in(&mut self, operations: Option<u64>) {
        self.disk.fail_in(operations);
    }

    /// The power goes off: of what was not synced some is on the disk, torn to sectors if it is to be.
    fn crash(&mut self, torn: bool, random: &mut Random) {
        if torn {
            self.disk.crash_torn(|_, _| random.chance(500));
        } else {
            self.disk.crash(|_| random.chance(500));
        }
        self.open = None;
    }

    fn copy(&self) -> Copy {
        Copy {
            bytes: self.disk.bytes(),
            promised: self.promised.clone(),
        }
    }

    /// Goes on from a copy.
    fn restore(&mut self, copy: Copy, history: u64) {
        self.disk = Disk::with(copy.bytes);
        self.promised = copy.promised;
        self.history = history;
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
    pub(super) fn side(&mut self, pid: Pid) -> &mut Managing {
        match pid {
            Pid::Rival => &mut self.rival,
            _ => &mut self.managing,
        }
    }

    pub(super) fn start_manager(&mut self, pid: Pid) {
        let restored = match self.side(pid).store.load() {
            Ok(state) => state,
            Err(_) if pid == Pid::Manager && self.manager_disk_fails > 0 => {
                // It says so and ends; whoever looks after it starts it again.
                let at_us = self.now_us + START_AGAIN_US;
                self.queue.push(at_us, Event::Start(pid));
                return;
            }
            Err(error) => {
                self.defect(format!("the manager's repository does not open: {error}"));
                return;
            }
        };
        let lost = self.side(pid).store.lost(&restored);
        self.see(&Seen::Restored { lost: &lost });
        // No two lives begin at one moment: as good as drawn, and no schedule changes.
        let boot = boot_after(self.boot_of(pid).0, &restored, self.now_us);
        if let Some(life) = self.lives.get_mut(&pid) {
            life.boot = boot;
        }
        let now = self.local(pid);
        let model = self.cell.model.clone();
        self.side(pid).agents = Some(ManagerAgents::new(model, restored, boot, now));
        self.tell_wall(pid, boot);
    }

    pub(super) fn kill_store(&mut self, pid: Pid) {
        let torn = match pid {
            Pid::Manager => self.manager_power.take().unwrap_or(false),
            _ => false,
        };
        let mut random = self.dice(pid).clone();
        self.side(pid).store.crash(torn, &mut random);
        self.dice.insert(pid, random);
        if pid == Pid::Manager {
            self.managing
                .store
                .fails_in((self.manager_disk_fails > 0).then_some(0));
        }
    }

    /// Somebody puts a copy of the repository aside.
    pub(super) fn copy_repository(&mut self) {
        let wanted = self
            .schedule
            .iter()
            .any(|(_, fault)| matches!(fault, Fault::OldCopy { .. } | Fault::SecondManager { .. }));
        if wanted {
            self.copies.push(self.managing.store.copy());
        }
    }

    /// The copy that was made so many copies ago.
    pub(super) fn copy_back(&self, back: usize) -> Option<Copy> {
        let at = self
            .copies
            .len()
            .checked_sub(back.min(self.copies.len()) + 1);
        self.copies.get(at.unwrap_or(0)).cloned()
    }

    /// The manager's repository is replaced by a copy; the manager is down.
    pub(super) fn restore_repository(&mut self, copy: Copy) {
        let history = self.managing.store.history.max(self.rival.store.history) + 1;
        self.managing.store.restore(copy, history);
        let fails = (self.manager_disk_fails > 0).then_some(0);
        self.managing.store.fails_in(fails);
    }

    /// A second manager starts on a copy.
    pub(super) fn start_rival(&mut self, back: Option<usize>) {
        let copy = back.and_then(|back| self.copy_back(back));
        let copy = copy.unwrap_or_else(|| self.managing.store.copy());
        let history = self.managing.store.history.max(self.rival.store.history) + 1;
        self.rival.store.restore(copy, history);
        self.start(Pid::Rival);
    }

    pub(super) fn manager_input(&mut self, pid: Pid, input: Input<ManagerLocal>) {
        let now = self.local(pid);
        if let Some(manager) = &mut self.side(pid).agents {
            manager.handle(input, now);
        }
        self.carry_out_manager(pid);
    }

    pub(super) fn carry_out_manager(&mut self, pid: Pid) {
        while let Some(output) = self.side(pid).agents.as_mut().and_then(Agent::poll_output) {
            if self.is_doomed(pid) {
                self.kill(pid);
                return;
            }
            match output {
                Output::Persist { ticket, write } => {
                    let result = self.store_write(pid, &write);
                    if result.is_err() && pid == Pid::Manager && self.manager_power.is_some() {
                        self.kill(pid);
                        return;
                    }
                    let now = self.local(pid);
                    if let Some(manager) = &mut self.side(pid).agents {
                        manager.handle(Input::Persisted { ticket, result }, now);
                    }
                }
                Output::Send(envelope) => {
                    if let (Message::Order(order), AgentId::Component(to, _)) =
                        (&envelope.body, &envelope.to)
                    {
                        let store = &self.side(pid).store;
                        let promised = &store.promised.epochs;
                        let durable = promised.get(&order.mc).copied().unwrap_or(Epoch(0));
                        let seen = Seen::Ordered {
                            manager: envelope.boot,
                            history: store.history,
                            order,
                            to,
                            durable,
                        };
                        self.invariants.see(&seen, self.now_us);
                    }
                    if self.has(Canary::OrderDoubled) {
                        self.double_order(&envelope);
                    }
                    self.send(pid, envelope);
                }
                Output::Act(act) => self.note(|| format!("{pid:<8} does {act:?}")),
                Output::Event(event) => {
                    self.deed(super::quiet::deed_of(event.kind));
                    self.note(|| {
                        format!(
                            "{pid:<8} EVENT {:?} {:?}: {}",
                            event.severity, event.kind, event.text
                        )
                    });
                }
            }
        }
        self.arm(pid);
    }

    fn store_write(&mut self, pid: Pid, write: &RepoWrite) -> Result<(), String> {
        let forgets = self.has(Canary::EpochsForgotten);
        let store = &mut self.side(pid).store;
        if forgets && matches!(write, RepoWrite::EpochBlock { .. }) {
            store.promised.apply(write);
            return Ok(());
        }
        let result = store.write(write);
        if let Err(error) = &result
            && self.manager_disk_fails == 0
            && self.manager_power.is_none()
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
