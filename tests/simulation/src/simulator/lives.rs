//! Processes start, die, stand still and go on; who hears of it, and when.

use super::network::Pid;
use super::time::Clock;
use super::world::{Event, Life, TELL_WALL_US, WALL_US, World};
use crate::invariants::Seen;
use fam_agents::manager::ManagerLocal;
use fam_proto::agent::Input;
use fam_proto::{BootId, Now, ProcessId};
use std::collections::BTreeSet;

impl World {
    // ---- processes

    pub(super) fn is_up(&self, pid: Pid) -> bool {
        match pid {
            Pid::Manager => self.managing.agents.is_some(),
            Pid::Rival => self.rival.agents.is_some(),
            Pid::Gateway => self.gateway.is_some(),
            Pid::Node(n) => self.nodes[n].is_some(),
            Pid::Operator => true,
        }
    }

    pub(super) fn boot_of(&self, pid: Pid) -> BootId {
        self.lives.get(&pid).map_or(BootId(0), |l| l.boot)
    }

    pub(super) fn is_this(&self, pid: Pid, boot: BootId) -> bool {
        self.is_up(pid) && self.boot_of(pid) == boot
    }

    /// A process's own time.
    pub(super) fn local(&self, pid: Pid) -> Now {
        self.lives
            .get(&pid)
            .map_or(Now(self.now_us), |l| l.clock.local(self.now_us))
    }

    pub(super) fn global(&self, pid: Pid, at: Now) -> u64 {
        let at_us = self.lives.get(&pid).map_or(at.0, |l| l.clock.global(at));
        at_us.max(self.now_us)
    }

    pub(super) fn process_id(&self, pid: Pid) -> ProcessId {
        match pid {
            Pid::Manager | Pid::Rival => ProcessId::Manager,
            Pid::Gateway => ProcessId::Gateway(self.cell.gateway.clone()),
            Pid::Node(n) => ProcessId::Node(self.cell.controllers[n].clone()),
            Pid::Operator => ProcessId::Client(1),
        }
    }

    pub(super) fn pid_of(&self, process: &ProcessId) -> Option<Pid> {
        match process {
            ProcessId::Manager => Some(Pid::Manager),
            ProcessId::Gateway(_) => Some(Pid::Gateway),
            ProcessId::Node(c) => self.cell.node(c).map(Pid::Node),
            ProcessId::Client(_) => Some(Pid::Operator),
        }
    }

    pub(super) fn start(&mut self, pid: Pid) {
        if self.is_up(pid) {
            return;
        }
        let boot = self.new_boot(pid);
        let starts = self.lives.get(&pid).map_or(0, |life| life.starts) + 1;
        let now_us = self.now_us;
        let dice = self.dice(pid);
        let life = Life {
            boot,
            starts,
            started_us: now_us,
            clock: Clock {
                origin_us: now_us,
                start_us: dice.below(10_000_000),
                fast_ppm: i64::try_from(dice.below(400)).unwrap_or(0) - 200,
            },
            frozen_us: None,
            scheduled_us: None,
            stalled: Vec::new(),
            tokens: BTreeSet::new(),
            doomed: None,
            died_us: 0,
        };
        self.lives.insert(pid, life);
        self.note(|| format!("{pid:<8} starts (boot …{})", boot.0 % 1_000_000_000));
        match pid {
            Pid::Manager | Pid::Rival => self.start_manager(pid),
            Pid::Gateway => self.start_gateway(),
            Pid::Node(n) => self.start_node(n),
            Pid::Operator => {}
        }
        for other in self.pids() {
            if other != pid && self.is_up(other) {
                self.look(pid, other, 300, 5_000);
                self.look(other, pid, 300, 5_000);
            }
        }
    }

    /// What the wall clock of a process's machine shows.
    pub(super) fn wall_us(&self, pid: Pid) -> u64 {
        let step_us = self.wall_steps_us.get(&pid).copied().unwrap_or(0);
        (WALL_US + self.now_us).saturating_add_signed(step_us)
    }

    /// Boot ids come from the wall clock. No two lives begin in the same microsecond.
    fn new_boot(&mut self, pid: Pid) -> BootId {
        let mut boot = BootId(self.wall_us(pid));
        while !self.boots.insert(boot) {
            boot.0 += 1;
        }
        boot
    }

    /// A manager's process tells its agents the wall clock from time to time.
    pub(super) fn tell_wall(&mut self, pid: Pid, boot: BootId) {
        if !self.is_this(pid, boot) {
            return;
        }
        let unix_us = self.wall_us(pid);
        self.queue
            .push(self.now_us + TELL_WALL_US, Event::Wall { pid, boot });
        self.manager_input(pid, Input::Local(ManagerLocal::Wall { unix_us }));
    }

    /// Kills a process: all that it held in memory is gone.
    pub(super) fn kill(&mut self, pid: Pid) {
        if !self.is_up(pid) {
            return;
        }
        match pid {
            Pid::Manager | Pid::Rival => {
                self.side(pid).agents = None;
                self.kill_store(pid);
            }
            Pid::Gateway => self.gateway = None,
            Pid::Node(n) => {
                self.nodes[n] = None;
                if let Some(down_us) = self.terminated.remove(&n) {
                    self.queue.push(self.now_us + down_us, Event::Start(pid));
                }
            }
            Pid::Operator => {}
        }
        if let Some(life) = self.lives.get_mut(&pid) {
            life.frozen_us = None;
            life.stalled.clear();
            life.doomed = None;
            life.died_us = self.now_us;
        }
        self.note(|| format!("{pid:<8} dies"));
        for other in self.pids() {
            if other != pid {
                // As measured: most hear of it within 2 ms, a few take longer.
                let slowest_us = if self.dice(other).chance(900) {
                    2_000
                } else {
                    8_000
                };
                self.look(other, pid, 300, slowest_us);
            }
        }
    }

    pub(super) fn freeze(&mut self, pid: Pid) {
        let (now_us, lease_us) = (self.now_us, self.network.lease_us);
        if !self.is_up(pid) {
            return;
        }
        if let Some(life) = self.lives.get_mut(&pid) {
            life.frozen_us.get_or_insert(now_us);
        }
        for other in self.pids() {
            if other != pid {
                self.look(other, pid, lease_us + 1, lease_us + 30_000);
            }
        }
    }

    pub(super) fn resume(&mut self, pid: Pid) {
        let Some(life) = self.lives.get_mut(&pid) else {
            return;
        };
        if life.frozen_us.take().is_none() {
            return;
        }
        let stalled = std::mem::take(&mut life.stalled);
        // Whether threads or messages come first is chance; each of both keeps its order.
        let timers_first = self.dice(pid).chance(500);
        let own = |e: &Event| matches!(e, Event::Timer { .. } | Event::Tick { .. });
        let (timers, rest): (Vec<Event>, Vec<Event>) = stalled.into_iter().partition(own);
        let (first, then) = if timers_first {
            (timers, rest)
        } else {
            (rest, timers)
        };
        // Messages are worked off while threads run again.
        let each_us = self.dice(pid).between(1, 20);
        for (n, event) in first.into_iter().chain(then).enumerate() {
            let at_us = self.now_us + 1 + n as u64 * each_us;
            self.queue.push(at_us, event);
        }
        if pid == Pid::Gateway {
            self.see(&Seen::GatewayUp { restarted: false });
        }
        self.note(|| format!("{pid:<8} goes on"));
        for other in self.pids() {
            if other != pid {
                self.look(other, pid, 500, 30_000);
            }
        }
    }

    // ---- liveliness tokens

    /// Lets an observer look after another process some time from now.
    pub(super) fn look(&mut self, observer: Pid, subject: Pid, from_us: u64, to_us: u64) {
        let at_us = self.now_us + self.dice(observer).between(from_us, to_us);
        self.queue.push(at_us, Event::Tokens { observer, subject });
    }

    pub(super) fn tokens(&mut self, observer: Pid, subject: Pid) {
        if !self.is_up(observer) {
            return;
        }
        let lease_us = self.network.lease_us;
        let silent_us = |since: Option<u64>| since.map(|since| self.now_us - since);
        let cut = silent_us(self.network.cut_since(subject, observer));
        let frozen = silent_us(self.lives.get(&subject).and_then(|l| l.frozen_us));
        let lost = [cut, frozen].into_iter().flatten().any(|us| us >= lease_us);
        if !lost && (cut.is_some() || frozen.is_some()) {
            return; // nothing new is heard, and what was heard still counts
        }
        let truth = (self.is_up(subject) && !lost).then(|| self.boot_of(subject));
        let Some(life) = self.lives.get(&observer) else {
            return;
        };
        let mut changes: Vec<(BootId, bool)> = life
            .tokens
            .iter()
            .filter(|(pid, boot)| *pid == subject && Some(*boot) != truth)
            .map(|(_, boot)| (*boot, false))
            .collect();
        if let Some(boot) = truth
            && !life.tokens.contains(&(subject, boot))
        {
            changes.push((boot, true));
        }
        if self.dice(observer).chance(500) {
            changes.reverse();
        }
        let process = self.process_id(subject);
        for (boot, alive) in changes {
            if let Some(life) = self.lives.get_mut(&observer) {
                if alive {
                    life.tokens.insert((subject, boot));
                } else {
                    life.tokens.remove(&(subject, boot));
                }
            }
            self.note(|| {
                let word = if alive { "sees" } else { "loses" };
                format!(
                    "{observer:<8} {word} the token of {subject} (…{})",
                    boot.0 % 1_000_000_000
                )
            });
            let process = process.clone();
            match observer {
                Pid::Manager | Pid::Rival => self.manager_input(
                    observer,
                    Input::Peer {
                        process,
                        boot,
                        alive,
                    },
                ),
                Pid::Gateway => self.gateway_input(Input::Peer {
                    process,
                    boot,
                    alive,
                }),
                Pid::Node(n) => self.node_input(
                    n,
                    Input::Peer {
                        process,
                        boot,
                        alive,
                    },
                ),
                Pid::Operator => {}
            }
        }
    }
}
