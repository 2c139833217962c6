//! The schedule is carried out: faults begin and end.

use super::faults::Fault;
use super::network::{CALM, Pid};
use super::world::{Event, World};
use fam_agents::node::NodeLocal;
use fam_node_core::model_mc::{TRAP_ALWAYS, TRAP_INPUT};
use fam_proto::agent::Input;
use fam_proto::{AgentId, BootId, Command, CommandKind, Envelope, Message};

/// How often the operator repeats a command that was not answered, in microseconds.
const ASK_AGAIN_US: u64 = 250_000;

impl World {
    pub(super) fn fault(&mut self, n: usize) {
        let (_, fault) = self.schedule[n].clone();
        if !self.has_effect(&fault) {
            return;
        }
        *self.faults.entry(fault.kind()).or_default() += 1;
        self.note(|| format!("FAULT {fault:?}"));
        let now_us = self.now_us;
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
                if let Some(down_us) = down_us {
                    // A process that has not had enough outputs to die yet is killed now.
                    self.queue.push(now_us + down_us, Event::Ends(n));
                }
            }
            Fault::Freeze { pid, us } => {
                self.freeze(*pid);
                self.queue.push(now_us + us, Event::Ends(n));
            }
            Fault::Terminate { node, .. } => {
                self.node_input(*node, Input::Local(NodeLocal::Terminate));
            }
            Fault::Cut { pairs, us } => {
                let lease_us = self.network.lease_us;
                for (from, to) in pairs {
                    self.network.cut(*from, *to, now_us);
                    self.look(*to, *from, lease_us + 1, lease_us + 20_000);
                }
                self.queue.push(now_us + us, Event::Ends(n));
            }
            Fault::Storm { weather, us, .. } => {
                self.storms.push((n, *weather));
                self.network.set_weather(*weather);
                self.queue.push(now_us + us, Event::Ends(n));
            }
            Fault::SlowLink {
                from,
                to,
                by_us,
                us,
            } => {
                self.network.slow_down(*from, *to, *by_us);
                self.queue.push(now_us + us, Event::Ends(n));
            }
            Fault::Command(what) => self.command(what.clone()),
            Fault::Trap { mc, always } => {
                let byte = if *always { TRAP_ALWAYS } else { TRAP_INPUT };
                self.plant.traps.insert(*mc, byte);
            }
            Fault::FieldSilent { us } => {
                self.field_silent += 1;
                self.queue.push(now_us + us, Event::Ends(n));
            }
            Fault::ManagerDiskFails { us } => {
                self.manager_disk_fails += 1;
                self.store.fails(true);
                self.queue.push(now_us + us, Event::Ends(n));
            }
            Fault::GatewayDiskFails { us } => {
                self.gateway_disk_fails += 1;
                self.queue.push(now_us + us, Event::Ends(n));
            }
            Fault::LostImages { node, permille, us } => {
                self.lost_images.insert(n, (*node, *permille));
                self.queue.push(now_us + us, Event::Ends(n));
            }
            Fault::LateTicks { node, late_us, us } => {
                self.late.insert(n, (*node, *late_us));
                self.queue.push(now_us + us, Event::Ends(n));
            }
        }
    }

    fn has_effect(&self, fault: &Fault) -> bool {
        match fault {
            Fault::Crash { pid, .. } => self.is_up(*pid),
            Fault::Freeze { pid, .. } => self.is_up(*pid) && self.lives[pid].frozen_us.is_none(),
            Fault::Terminate { node, .. } => {
                let pid = Pid::Node(*node);
                self.is_up(pid) && self.lives[&pid].frozen_us.is_none()
            }
            _ => true,
        }
    }

    pub(super) fn ends(&mut self, n: usize) {
        let (_, fault) = self.schedule[n].clone();
        self.note(|| format!("ends: {}", fault.kind()));
        match &fault {
            Fault::Crash { pid, .. } => {
                if self.lives.get(pid).is_some_and(|l| l.doomed.is_some()) {
                    self.kill(*pid);
                }
                if !self.is_up(*pid) {
                    self.queue.push(self.now_us + 1, Event::Start(*pid));
                }
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
                self.store.fails(self.manager_disk_fails > 0);
            }
            Fault::GatewayDiskFails { .. } => self.gateway_disk_fails -= 1,
            Fault::LostImages { .. } => {
                self.lost_images.remove(&n);
            }
            Fault::LateTicks { .. } => {
                self.late.remove(&n);
            }
            Fault::Terminate { .. } | Fault::Command(_) | Fault::Trap { .. } => {}
        }
    }

    /// An operator gives a command.
    pub(super) fn command(&mut self, what: CommandKind) {
        if let CommandKind::Reset { mc, .. } = &what
            && let Some(index) = self.cell.index(mc)
        {
            // Whoever resets an MC has seen to the cause.
            self.plant.traps.remove(&index);
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
