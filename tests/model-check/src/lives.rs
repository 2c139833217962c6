//! Tokens, crashes, and starts.

use crate::properties::Violation;
use crate::state::{Body, Bug, Pid, Process};
use crate::step::{Run, peer};
use fam_gateway_core::MemoryRecords;
use fam_proto::BootId;
use fam_proto::agent::Agent;
use std::sync::Arc;

fn seen(process: &Process, subject: Pid) -> Vec<BootId> {
    let tokens = process.tokens.iter().filter(|(pid, _)| *pid == subject);
    tokens.map(|(_, boot)| *boot).collect()
}

impl Run<'_> {
    pub(crate) fn token(&mut self, observer: Pid, subject: Pid) -> Result<(), Violation> {
        let is = self.world.boot_seen(&self.state, observer, subject);
        let Some(process) = self.state.process(observer) else {
            return Ok(());
        };
        let mut told: Vec<(BootId, bool)> = seen(process, subject)
            .into_iter()
            .filter(|boot| Some(*boot) != is)
            .map(|boot| (boot, false))
            .collect();
        if let Some(boot) = is
            && !seen(process, subject).contains(&boot)
        {
            told.push((boot, true));
        }
        for (boot, alive) in told {
            let id = self.process_id(subject);
            self.change(observer, |process| {
                if alive {
                    process.tokens.insert((subject, boot));
                } else {
                    process.tokens.remove(&(subject, boot));
                }
                let now = process.now;
                let (process_id, boot) = (id, boot);
                match &mut process.body {
                    Body::Manager(agents) => {
                        agents.handle(peer(process_id, boot, alive), now);
                    }
                    Body::Gateway(gateway) => {
                        gateway.handle(peer(process_id, boot, alive), now);
                    }
                    Body::Node(agents, ..) => {
                        agents.handle(peer(process_id, boot, alive), now);
                    }
                }
            });
            self.carry_out(observer)?;
        }
        Ok(())
    }

    pub(crate) fn crash(&mut self, pid: Pid) {
        self.state.processes[pid.at()] = None;
        // An image to the manager is gone with it.
        if pid == Pid::Manager {
            self.state.image = None;
        }
        if pid == Pid::Gateway && self.world.bug == Some(Bug::RecordsForgotten) {
            self.state.records = Arc::new(MemoryRecords::default());
        }
    }

    pub(crate) fn start(&mut self, pid: Pid) -> Result<(), Violation> {
        self.state.boots += 1;
        let boot = BootId(self.state.boots);
        if pid == Pid::Gateway {
            self.state.runs += 1;
        }
        let process = self.world.cell.start(
            pid,
            boot,
            &self.state.repository,
            &self.state.records,
            self.state.runs,
        );
        self.state.processes[pid.at()] = Some(Arc::new(process));
        self.carry_out(pid)
    }
}
