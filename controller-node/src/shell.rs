//! Between the driver and the node's agents: what the threads know is told to the agents before it is asked for, and what
//! the agents want goes to the threads.

use crate::replica_thread::ReplicaJob;
use crate::shared::Shared;
use crate::stage::Stager;
use crossbeam_channel::Sender;
use fam_agents::node::{NodeAct, NodeAgents, NodeLocal, NodeOutput, NodePersist};
use fam_driver::Shell;
use fam_proto::access::{McAct, McNews};
use fam_proto::agent::{Agent, Input};
use fam_proto::{CheckpointId, McId, Message, Now};
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// The node's agents, with their view of the threads brought up to date before each message and deadline.
pub(crate) struct Informed {
    pub agents: NodeAgents,
    pub shared: Arc<Shared>,
    /// What the agents have been told that the passive instances hold.
    pub told: Vec<Option<CheckpointId>>,
}

impl Informed {
    fn inform(&mut self, now: Now) {
        let held = self.shared.held();
        for (index, id) in held.into_iter().enumerate() {
            if id != self.told[index]
                && let Some(id) = id
            {
                self.told[index] = Some(id);
                let mc = self.shared.specs[index].mc.clone();
                self.local(NodeLocal::Held { mc, id }, now);
            }
        }
        self.local(NodeLocal::Sample(self.shared.sample()), now);
    }

    fn local(&mut self, local: NodeLocal, now: Now) {
        self.agents.handle(Input::Local(local), now);
    }
}

impl Agent for Informed {
    type Input = Input<NodeLocal>;
    type Output = NodeOutput;

    fn handle(&mut self, input: Input<NodeLocal>, now: Now) {
        match &input {
            Input::Message(envelope) => {
                self.inform(now);
                if let Message::Registered(registered) = &envelope.body
                    && !self.agents.controller().is_registered()
                {
                    tracing::info!("registered with the manager");
                    for (mc, why) in &registered.ineligible {
                        tracing::warn!(mc = %mc, "{mc} may not run here: {why}");
                    }
                }
            }
            Input::Local(NodeLocal::Mc { mc, news }) => say(mc, news),
            _ => {}
        }
        self.agents.handle(input, now);
        let registered = self.agents.controller().is_registered();
        self.shared.registered.store(registered, Ordering::Relaxed);
    }

    fn handle_timeout(&mut self, now: Now) {
        self.inform(now);
        self.agents.handle_timeout(now);
    }

    fn poll_output(&mut self) -> Option<NodeOutput> {
        self.agents.poll_output()
    }

    fn poll_timeout(&self) -> Option<(Now, &'static str)> {
        self.agents.poll_timeout()
    }
}

fn say(mc: &McId, news: &McNews) {
    match news {
        McNews::State { .. } | McNews::Handed(_) => {}
        McNews::Started { epoch } => tracing::info!(mc = %mc, "{mc} runs under epoch {epoch}"),
        McNews::NotStarted { epoch, why } => {
            tracing::warn!(mc = %mc, "{mc} does not run under epoch {epoch}: {why}");
        }
        McNews::Recovered { epoch, scan } => {
            tracing::info!(mc = %mc, "{mc} has recovered in epoch {epoch}, scan {scan}");
        }
        McNews::Released { epoch, scan } => {
            tracing::info!(mc = %mc, "{mc} is released after scan {scan} of epoch {epoch}");
        }
        McNews::ReleaseCancelled { epoch, why } => {
            tracing::info!(mc = %mc, "{mc} goes on under epoch {epoch}: {why}");
        }
        McNews::Stopped { epoch, scan } => {
            tracing::info!(mc = %mc, "{mc} is stopped safely after scan {scan} of epoch {epoch}");
        }
        McNews::Trapped { epoch, trap } => {
            tracing::error!(mc = %mc, "{mc} has trapped in epoch {epoch}: {trap}");
        }
        McNews::Deposed { epoch, why } => {
            tracing::info!(mc = %mc, "{mc} is passive, its epoch {epoch} drives no more: {why}");
        }
    }
}

/// What the agents want of the process.
pub(crate) struct NodeShell<R> {
    pub jobs: Sender<ReplicaJob<R>>,
    pub shared: Arc<Shared>,
    pub finished: bool,
    pub stager: Stager,
    /// MCs that could not be handed over before the end.
    pub left: Vec<McId>,
}

impl<R> Shell<NodePersist, NodeAct> for NodeShell<R> {
    fn persist(&mut self, write: NodePersist) -> Result<(), String> {
        match write {}
    }

    fn act(&mut self, action: NodeAct, _: Now) {
        match action {
            NodeAct::Mc { mc, act } => {
                let Some(index) = self.shared.specs.iter().position(|s| s.mc == mc) else {
                    return;
                };
                if !matches!(act, McAct::ReadState { .. }) {
                    tracing::debug!(mc = %mc, "{mc}: {act:?}");
                }
                if self
                    .jobs
                    .try_send(ReplicaJob::Act { mc: index, act })
                    .is_err()
                {
                    tracing::error!(mc = %mc, "the replica thread does not take what the MC Agent of {mc} asks for");
                }
            }
            NodeAct::Stage { id } => self.stager.stage(id),
            NodeAct::Renewed { mc, version } => self.stager.renewed(&mc, version),
            NodeAct::Leave { left } => {
                self.left = left;
                self.finished = true;
            }
        }
    }

    fn finished(&self) -> bool {
        self.finished
    }
}
