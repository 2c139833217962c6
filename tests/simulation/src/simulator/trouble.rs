//! The schedule is carried out: faults begin and end.

use super::faults::Fault;
use super::network::{CALM, Pid};
use super::world::{Event, World};
use fam_agents::node::NodeLocal;
use fam_node_core::model_mc::{TRAP_ALWAYS, TRAP_INPUT};
use fam_proto::agent::Input;
use fam_proto::{AgentId, BootId, Command, CommandKind, Envelope, Message};

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
                self.queue.push(now_us + us, Event::Ends(n));
            }
            Fault::GatewayDiskFails { us } => {
                self.gateway_disk_fails += 1;
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
            Fault::Freeze { pid, .. } => {
                self.is_up(*pid) && self.lives[pid].frozen_us.is_none()
            }
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
            Fault::FieldSilent { .. } => self.field_silent -= 1,
            Fault::ManagerDiskFails { .. } => self.manager_disk_fails -= 1,
            Fault::GatewayDiskFails { .. } => self.gateway_disk_fails -= 1,
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
        let envelope = Envelope {
            from: AgentId::Client(1),
            boot: BootId(1),
            to: AgentId::Manager,
            body: Message::Command(Command {
                id: self.commands,
                what,
            }),
        };
        self.send(Pid::Operator, envelope);
    }
}
