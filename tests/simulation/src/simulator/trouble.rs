//! The schedule is carried out: faults begin and end.

use super::faults::Fault;
use super::logic::Logic;
use super::network::{CALM, Pid};
use super::world::{Event, World};
use crate::invariants::Seen;
use fam_agents::node::NodeLocal;
use fam_node_core::model_mc::{TRAP_ALWAYS, TRAP_INPUT};
use fam_proto::agent::Input;
use fam_proto::{AgentId, BootId, Command, CommandKind, Envelope, Message};

/// How often the operator repeats a command that was not answered, in microseconds.
const ASK_AGAIN_US: u64 = 250_000;

impl World {
    pub(super) fn fault(&mut self, n: usize) {
        let fault = self.schedule[n].1.clone();
        if self.quiet.is_some() || !self.has_effect(&fault) {
            return;
        }
        *self.faults.entry(fault.kind()).or_default() += 1;
        self.count_stages(&fault);
        self.carried.push((self.now_us, fault.clone()));
        self.note(|| format!("FAULT {fault:?}"));
        let end_us = self.now_us + fault.lasts_us();
        self.last_end_us = self.last_end_us.max(end_us);
        let mut ends = true;
        match &fault {
            Fault::Crash {
                pid,
                after_outputs,
                down_us,
            } => {
                match (after_outputs, self.lives.get_mut(pid)) {
                    (Some(left), Some(life)) => life.doomed = Some(*left),
                    _ => self.kill(*pid),
                }
                // A process that has not had enough outputs to die yet is killed at the end.
                ends = down_us.is_some();
            }
            Fault::Freeze { pid, .. } => self.freeze(*pid),
            Fault::Terminate { node, down_us } => {
                self.terminated.insert(*node, *down_us);
                self.node_input(*node, Input::Local(NodeLocal::Terminate));
                ends = false;
            }
            Fault::Cut { pairs, .. } => {
                let lease_us = self.network.lease_us;
                for (from, to) in pairs {
                    self.network.cut(*from, *to, self.now_us);
                    self.look(*to, *from, lease_us + 1, lease_us + 20_000);
                }
            }
            Fault::Storm { weather, .. } => {
                self.storms.push((n, *weather));
                self.network.set_weather(*weather);
            }
            Fault::SlowLink {
                from, to, by_us, ..
            } => self.network.slow_down(*from, *to, *by_us),
            Fault::Command(what) => {
                self.command(what.clone());
                ends = false;
            }
            Fault::Trap { mc, always } => {
                let byte = if *always { TRAP_ALWAYS } else { TRAP_INPUT };
                self.field.traps.insert(*mc, byte);
                ends = false;
            }
            Fault::FieldSilent { .. } => self.field_silent += 1,
            Fault::ManagerDiskFails { .. } => {
                self.manager_disk_fails += 1;
                self.managing.store.fails_in(Some(0));
            }
            Fault::ManagerDiskCrash {
                operations, torn, ..
            } => {
                self.manager_power = Some(*torn);
                self.managing.store.fails_in(Some(*operations));
            }
            Fault::OldCopy { back, .. } => {
                self.kill(Pid::Manager);
                if let Some(copy) = self.copy_back(*back) {
                    self.restore_repository(copy);
                }
            }
            Fault::SecondManager { back, .. } => self.start_rival(*back),
            Fault::GatewayDiskFails { .. } => self.gateway_disk_fails += 1,
            Fault::GatewayTornRecord { .. } => self.gateway_tears = true,
            Fault::GatewayPower { .. } => {
                self.kill(Pid::Gateway);
                self.records.lose_power();
                self.see(&Seen::PowerLost);
            }
            Fault::LostImages { node, permille, .. } => {
                self.lost_images.insert(n, (*node, *permille));
            }
            Fault::StaleImages { node, by_us, .. } => {
                self.stale_images.insert(n, (*node, *by_us));
            }
            Fault::LostFrames { node, permille, .. } => {
                self.lost_frames.insert(n, (*node, *permille));
            }
            Fault::WipedReplica { node, mc } => {
                let runtime = self.cell.mcs[*mc].logic.instance();
                if let Some(node) = &mut self.nodes[*node] {
                    node.wipe(*mc, runtime);
                }
                ends = false;
            }
            Fault::OtherVersion { node, mc, .. } => {
                self.versions.insert(n, (*node, *mc));
                self.start_anew(Pid::Node(*node));
            }
            Fault::LateTicks { node, late_us, .. } => {
                self.late.insert(n, (*node, *late_us));
            }
            Fault::SlowScans { node, by_us, .. } => {
                self.slow.insert(n, (*node, *by_us));
            }
            Fault::ClockDrift { pid, ppm, .. } => self.drift(*pid, *ppm),
            Fault::ClockStep { pid, by_us } => {
                *self.wall_steps_us.entry(*pid).or_default() += by_us;
                ends = false;
            }
        }
        if ends {
            self.queue.push_first(end_us, Event::Ends(n));
        }
    }

    pub(super) fn has_effect(&self, fault: &Fault) -> bool {
        let runs = |pid: Pid| self.is_up(pid) && self.lives[&pid].frozen_us.is_none();
        match fault {
            Fault::Crash { pid, .. } => self.is_up(*pid),
            Fault::Freeze { pid, .. } => runs(*pid),
            Fault::Terminate { node, .. } => runs(Pid::Node(*node)),
            Fault::ManagerDiskCrash { .. } => {
                self.is_up(Pid::Manager)
                    && self.manager_power.is_none()
                    && self.manager_disk_fails == 0
            }
            Fault::OldCopy { .. } => self.is_up(Pid::Manager) && !self.copies.is_empty(),
            Fault::SecondManager { back, .. } => {
                self.rival.agents.is_none() && (back.is_none() || !self.copies.is_empty())
            }
            Fault::GatewayTornRecord { .. } => self.is_up(Pid::Gateway) && !self.gateway_tears,
            Fault::GatewayPower { .. } => self.is_up(Pid::Gateway),
            Fault::WipedReplica { node, mc } => {
                self.nodes[*node].as_ref().is_some_and(|n| n.holds(*mc))
            }
            Fault::OtherVersion { node, mc, .. } => {
                self.is_up(Pid::Node(*node)) && self.cell.mcs[*mc].hosts.contains(node)
            }
            Fault::ClockDrift { pid, .. } => self.is_up(*pid),
            Fault::Trap { mc, .. } => {
                matches!(self.cell.mcs[*mc].logic, Logic::Model { .. })
            }
            _ => true,
        }
    }

    /// Kills a process and starts it at once.
    fn start_anew(&mut self, pid: Pid) {
        self.kill(pid);
        self.queue.push(self.now_us + 5_000, Event::Start(pid));
    }

    fn drift(&mut self, pid: Pid, ppm: i64) {
        let now_us = self.now_us;
        if let Some(life) = self.lives.get_mut(&pid) {
            life.clock.drift(now_us, ppm);
        }
        // Its deadlines are due at other times now.
        self.arm(pid);
    }

    pub(super) fn ends(&mut self, n: usize) {
        let fault = self.schedule[n].1.clone();
        self.note(|| format!("ends: {}", fault.kind()));
        match &fault {
            Fault::Crash { pid, .. } => {
                if self.lives.get(pid).is_some_and(|l| l.doomed.is_some()) {
                    self.kill(*pid);
                }
                self.start_if_down(*pid);
            }
            Fault::Freeze { pid, .. } => self.resume(*pid),
            Fault::Cut { pairs, .. } => {
                for (from, to) in pairs {
                    if self.network.heal(*from, *to) {
                        self.look(*to, *from, 1_000, 50_000);
                    }
                }
            }
            Fault::Storm { .. } => {
                self.storms.retain(|(storm, _)| *storm != n);
                let weather = self.storms.last().map_or(CALM, |(_, weather)| *weather);
                self.network.set_weather(weather);
            }
            Fault::SlowLink { from, to, .. } => self.network.slow_down(*from, *to, 0),
            Fault::FieldSilent { .. } => self.field_silent -= 1,
            Fault::ManagerDiskFails { .. } => {
                self.manager_disk_fails -= 1;
                let fails = (self.manager_disk_fails > 0).then_some(0);
                self.managing.store.fails_in(fails);
            }
            Fault::ManagerDiskCrash { .. } => {
                if self.manager_power.is_some() {
                    self.kill(Pid::Manager);
                    self.manager_power = None;
                    let fails = (self.manager_disk_fails > 0).then_some(0);
                    self.managing.store.fails_in(fails);
                }
                self.start_if_down(Pid::Manager);
            }
            Fault::OldCopy { .. } => self.start_if_down(Pid::Manager),
            Fault::SecondManager { .. } => self.kill(Pid::Rival),
            Fault::GatewayDiskFails { .. } => self.gateway_disk_fails -= 1,
            Fault::GatewayTornRecord { .. } => {
                if std::mem::take(&mut self.gateway_tears) {
                    self.kill(Pid::Gateway);
                }
                self.start_if_down(Pid::Gateway);
            }
            Fault::GatewayPower { .. } => self.start_if_down(Pid::Gateway),
            Fault::LostImages { .. } => {
                self.lost_images.remove(&n);
            }
            Fault::StaleImages { .. } => {
                self.stale_images.remove(&n);
            }
            Fault::LostFrames { .. } => {
                self.lost_frames.remove(&n);
            }
            Fault::OtherVersion { node, .. } => {
                self.versions.remove(&n);
                self.start_anew(Pid::Node(*node));
            }
            Fault::LateTicks { .. } => {
                self.late.remove(&n);
            }
            Fault::SlowScans { .. } => {
                self.slow.remove(&n);
            }
            Fault::ClockDrift { pid, .. } => self.drift(*pid, 0),
            Fault::Terminate { .. }
            | Fault::Command(_)
            | Fault::Trap { .. }
            | Fault::WipedReplica { .. }
            | Fault::ClockStep { .. } => {}
        }
    }

    fn start_if_down(&mut self, pid: Pid) {
        if !self.is_up(pid) {
            self.queue.push(self.now_us + 1, Event::Start(pid));
        }
    }

    /// An operator gives a command.
    pub(super) fn command(&mut self, what: CommandKind) {
        if let CommandKind::Reset { mc, .. } = &what
            && let Some(index) = self.cell.index(mc)
        {
            // Whoever resets an MC has seen to the cause.
            self.field.traps.remove(&index);
        }
        self.commands += 1;
        let id = self.commands;
        self.open_commands.insert(id, Command { id, what });
        self.ask(id);
        self.queue
            .push(self.now_us + ASK_AGAIN_US, Event::Ask { id });
    }

    /// A command is repeated with the same number until it is answered.
    pub(super) fn ask_again(&mut self, id: u64) {
        if self.open_commands.contains_key(&id) {
            self.ask(id);
            self.queue
                .push(self.now_us + ASK_AGAIN_US, Event::Ask { id });
        }
    }

    fn ask(&mut self, id: u64) {
        let Some(command) = self.open_commands.get(&id) else {
            return;
        };
        let envelope = Envelope {
            from: AgentId::Client(1),
            boot: BootId(1),
            to: AgentId::Manager,
            body: Message::Command(command.clone()),
        };
        self.send(Pid::Operator, envelope);
    }

    /// The operator hears something.
    pub(super) fn answered(&mut self, envelope: &Envelope) {
        if let Message::CommandReply(reply) = &envelope.body {
            self.open_commands.remove(&reply.id);
        }
    }
}
