//! All agents of a controller node as one state machine: the Controller Agent and an MC Agent for each hosted MC.

use crate::component::{ComponentConfig, McAgent};
use crate::controller::ControllerAgent;
use fam_proto::access::{McAct, McNews};
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::model::{ControllerModel, McModel, Settings};
use fam_proto::{
    AgentId, CheckpointId, Envelope, Epoch, InputImage, McId, Message, Now, Owner, ProcessId,
    Staged,
};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// A node keeps nothing on disk.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum NodePersist {}

/// What the node's agents want done.
pub type NodeOutput = Output<NodePersist, NodeAct>;

/// What the agents ask of their process.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum NodeAct {
    /// An MC Agent asks its MC.
    Mc {
        /// The MC.
        mc: McId,
        /// What.
        act: McAct,
    },
    /// Read the cell again and make its changed MCs ready; answered by [`NodeLocal::Staged`].
    Stage {
        /// Number of the request.
        id: u64,
    },
    /// This version of an MC runs here from now on, or would.
    Renewed {
        /// The MC.
        mc: McId,
        /// Its version.
        version: u64,
    },
    /// The process may end; these MCs could not be handed over.
    Leave {
        /// MCs that are still active here.
        left: Vec<McId>,
    },
}

/// What the process tells its agents.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum NodeLocal {
    /// An MC tells its MC Agent.
    Mc {
        /// The MC.
        mc: McId,
        /// What.
        news: McNews,
    },
    /// The passive instance of an MC holds this checkpoint now.
    Held {
        /// The MC.
        mc: McId,
        /// Its newest checkpoint.
        id: CheckpointId,
    },
    /// Newest counters.
    Sample(NodeSample),
    /// Changed MCs are ready beside the ones that run.
    Staged {
        /// Their models.
        models: Vec<Arc<McModel>>,
        /// What the manager is told.
        staged: Box<Staged>,
    },
    /// SIGTERM.
    Terminate,
}

/// Counters of an active MC since its activation.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct McTotals {
    /// The MC.
    pub mc: McId,
    /// Its cycle, in microseconds.
    pub cycle_us: u32,
    /// Scans.
    pub scans: u64,
    /// Their CPU time, in nanoseconds.
    pub cpu_ns: u64,
    /// Worst case: CPU time that scans of the last minute reached more than twice, in microseconds.
    pub worst_us: u32,
    /// How far MC time has fallen behind real time, in microseconds.
    pub lag_us: u64,
}

/// Counters of a node.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct NodeSample {
    /// Active MCs.
    pub mcs: Vec<McTotals>,
    /// CPU of the host, in permille of all its cores.
    pub host_cpu_permille: u32,
    /// CPU of this process, in permille of one core.
    pub process_cpu_permille: u32,
    /// Resident memory of this process, in kB.
    pub process_memory_kb: u64,
    /// Ticks that began later than half a tick after their time, since start.
    pub late_ticks: u64,
    /// Ticks whose work took longer than the tick, since start.
    pub overruns: u64,
    /// Messages that did not read, since start.
    pub bad_messages: u64,
}

/// What a node's agents are made for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeConfig {
    /// The controller in this life.
    pub owner: Owner,
    /// Its model.
    pub model: ControllerModel,
    /// The MCs that it hosts, as built here.
    pub mcs: Vec<Arc<McModel>>,
    /// Settings of the cell.
    pub settings: Settings,
    /// Real-time means in force, in words.
    pub real_time: Vec<String>,
    /// Values of this controller for further bid criteria, by name.
    pub criteria: Vec<(String, i64)>,
}

// All but its life is given by the node's project.
impl std::hash::Hash for NodeConfig {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        self.owner.hash(state);
    }
}

/// The Controller Agent and the MC Agents of a node.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct NodeAgents {
    config: Arc<NodeConfig>,
    controller: ControllerAgent,
    components: BTreeMap<McId, McAgent>,
    staging: Staging,
    out: VecDeque<NodeOutput>,
}

/// A new version of the cell that the manager has asked for.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
struct Staging {
    asked: Option<u64>,
    answer: Option<Staged>,
}

fn component_config(config: &NodeConfig, model: &McModel) -> ComponentConfig {
    ComponentConfig {
        owner: config.owner.clone(),
        mc: model.mc.clone(),
        gateway: model.gateway.clone(),
        version: model.hash,
        layout: model.layout,
        diagnosis: model.diagnosis.clone(),
    }
}

impl NodeAgents {
    /// The agents of a node that has just started: all MCs passive.
    #[must_use]
    pub fn new(config: NodeConfig, now: Now) -> NodeAgents {
        let config = Arc::new(config);
        let components = config.mcs.iter().map(|model| {
            let component = component_config(&config, model);
            (model.mc.clone(), McAgent::new(component))
        });
        NodeAgents {
            components: components.collect(),
            controller: ControllerAgent::new(config.clone(), now),
            config,
            staging: Staging::default(),
            out: VecDeque::new(),
        }
    }

    /// The Controller Agent.
    #[must_use]
    pub fn controller(&self) -> &ControllerAgent {
        &self.controller
    }

    /// The MC Agent of an MC.
    #[must_use]
    pub fn component(&self, mc: &McId) -> Option<&McAgent> {
        self.components.get(mc)
    }

    /// All MC Agents, by MC.
    pub fn components(&self) -> impl Iterator<Item = &McAgent> {
        self.components.values()
    }

    fn message(&mut self, envelope: Envelope, now: Now) {
        if envelope.from.process() == ProcessId::Manager {
            if self.controller.is_over(envelope.boot) {
                return; // a late word of a manager that is no more
            }
            self.controller.manager_speaks(envelope.boot, now);
        }
        match &envelope.to {
            AgentId::Controller(to) if *to == self.config.owner.controller => {
                if let Message::CallForProposals(call) = &envelope.body {
                    for mc in &call.mcs {
                        if let Some(component) = self.components.get_mut(mc) {
                            component.call(call.negotiation);
                        }
                    }
                }
                match envelope.body {
                    Message::Stage(id) => self.stage(id),
                    _ => self.controller.message(envelope, now),
                }
            }
            AgentId::Component(to, mc) if *to == self.config.owner.controller => {
                let Some(component) = self.components.get_mut(mc) else {
                    return; // not hosted here: the manager knows from the registration
                };
                match (&envelope.from, envelope.body) {
                    (AgentId::Manager, Message::Order(order)) if order.mc == *component.mc() => {
                        component.order(envelope.boot, order, now);
                    }
                    (AgentId::Gateway(from), body) if from == component.gateway() => {
                        component.gateway_message(body, now);
                    }
                    _ => {}
                }
            }
            _ => {}
        }
    }

    fn image(&mut self, image: &InputImage, now: Now) {
        self.controller.image(image, now);
        for component in self.components.values_mut() {
            if *component.gateway() == image.gateway {
                component.image(image, now);
            }
        }
    }

    fn local(&mut self, local: NodeLocal, now: Now) {
        match local {
            NodeLocal::Mc { mc, news } => {
                if let Some(component) = self.components.get_mut(&mc) {
                    component.news(news, now);
                }
            }
            NodeLocal::Held { mc, id } => {
                if let Some(component) = self.components.get_mut(&mc) {
                    component.held(id);
                }
            }
            NodeLocal::Sample(sample) => self.controller.sample(sample, now),
            NodeLocal::Staged { models, staged } => self.staged(&models, *staged),
            NodeLocal::Terminate => self.controller.leave(now),
        }
    }

    /// The manager wants a new version of the cell read; it asks until it is answered.
    fn stage(&mut self, id: u64) {
        if self.staging.asked != Some(id) {
            self.staging = Staging {
                asked: Some(id),
                answer: None,
            };
            self.out.push_back(NodeOutput::Act(NodeAct::Stage { id }));
        } else if let Some(answer) = self.staging.answer.clone() {
            self.controller.send_staged(answer);
        }
    }

    fn staged(&mut self, models: &[Arc<McModel>], staged: Staged) {
        if self.staging.asked != Some(staged.id) {
            return; // overtaken by another request
        }
        for model in models {
            if let Some(component) = self.components.get_mut(&model.mc) {
                component.stage(component_config(&self.config, model));
            }
        }
        self.staging.answer = Some(staged.clone());
        self.controller.send_staged(staged);
    }

    /// What the manager and the process have to know of versions that have changed.
    fn tell_versions(&mut self, now: Now) {
        for component in self.components.values() {
            let config = component.config();
            let (version, layout) = (config.version, config.layout);
            if self.controller.renewed(&config.mc, version, layout, now) {
                let mc = config.mc.clone();
                self.out
                    .push_back(NodeOutput::Act(NodeAct::Renewed { mc, version }));
            }
        }
    }

    fn tell_facts(&mut self) {
        let active: Vec<(McId, Epoch)> = self
            .components
            .values()
            .filter_map(|c| Some((c.mc().clone(), c.active_epoch()?)))
            .collect();
        let opening = self
            .components
            .values()
            .any(|c| c.is_busy() && c.active_epoch().is_none());
        self.controller.facts(active, opening);
    }

    /// Moves what the agents have to say into one ordered queue.
    fn collect(&mut self) {
        for component in self.components.values_mut() {
            while let Some(output) = component.poll_output() {
                self.out.push_back(output);
            }
        }
        while let Some(output) = self.controller.poll_output() {
            self.out.push_back(output);
        }
    }
}

impl Agent for NodeAgents {
    type Input = Input<NodeLocal>;
    type Output = NodeOutput;

    fn handle(&mut self, input: Input<NodeLocal>, now: Now) {
        let image = matches!(input, Input::Image(_));
        if !image {
            self.tell_facts();
        }
        match input {
            Input::Message(envelope) => self.message(envelope, now),
            Input::Peer {
                process: ProcessId::Manager,
                boot,
                alive,
            } => self.controller.manager_token(boot, alive, now),
            Input::Peer { .. } | Input::Persisted { .. } => {}
            Input::Image(image) => self.image(&image, now),
            Input::Local(local) => self.local(local, now),
        }
        self.tell_versions(now);
        self.collect();
    }

    fn handle_timeout(&mut self, now: Now) {
        for component in self.components.values_mut() {
            component.handle_timeout(now);
        }
        self.tell_facts();
        self.controller.handle_timeout(now);
        self.collect();
    }

    fn poll_output(&mut self) -> Option<NodeOutput> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<(Now, &'static str)> {
        self.components
            .values()
            .filter_map(McAgent::poll_timeout)
            .chain(self.controller.poll_timeout())
            .min_by_key(|(at, _)| *at)
    }
}
