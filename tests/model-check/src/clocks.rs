//! Clocks: each process has its own, and it stands still until the process's next deadline comes.
//!
//! Who is up and connected is heard in time: before the manager's deadline comes, the nodes' reports do, and an image that says what
//! it knows. (One that says something new takes its time.) So nothing is missed but by a cut or a crash, and no report and no tick
//! of another process is a step of its own.

use crate::properties::Violation;
use crate::state::{Body, Pid, State};
use crate::step::{Run, World};
use fam_proto::agent::{Agent, Input};
use fam_proto::{AgentId, BootId, Envelope, ImageNumber, InputImage, Message, Now, ResourceReport};
use std::sync::Arc;

/// An order is repeated no longer than a few seconds; this many times is more than that.
const REPEATS_MAX: u32 = 1_000;

impl World<'_> {
    /// The next deadline of each process that has one.
    pub fn deadlines<'s>(
        &self,
        state: &'s State,
    ) -> impl Iterator<Item = (Now, Pid, &'static str)> + 's {
        state.running().filter_map(|(pid, process)| {
            let deadline = match &process.body {
                Body::Manager(agents) => agents.poll_timeout(),
                Body::Gateway(gateway) => gateway.poll_timeout(),
                Body::Node(agents, ..) => agents.poll_timeout(),
            };
            deadline.map(|(at, why)| (at.max(process.now), pid, why))
        })
    }

    /// The number that an image gets when the manager receives it: above those that it knows.
    pub(crate) fn image_number(&self, state: &State) -> ImageNumber {
        let gateways = state.manager().map(|m| &m.view().gateways);
        let known = gateways.and_then(|g| g.get(&self.cell.gateway));
        known.map_or(ImageNumber(1), |known| {
            let doubtful = known.doubtful.map_or(ImageNumber(0), |(_, number)| number);
            known.image.max(doubtful).next()
        })
    }
}

impl Run<'_> {
    /// The next deadline of a process comes. Repetitions of orders do nothing that their first copy, which may come late, does not do:
    /// they are passed over, up to the next deadline of another kind.
    pub(crate) fn time(&mut self, pid: Pid) -> Result<(), Violation> {
        for _ in 0..REPEATS_MAX {
            let due = self
                .world
                .deadlines(&self.state)
                .find(|(_, p, _)| *p == pid);
            let Some((at, _, why)) = due else {
                return Ok(());
            };
            self.change(pid, |process| process.now = at);
            if pid == Pid::Manager {
                self.hear()?;
            }
            self.change(pid, |process| match &mut process.body {
                Body::Manager(agents) => agents.handle_timeout(at),
                Body::Gateway(gateway) => gateway.handle_timeout(at),
                Body::Node(agents, ..) => agents.handle_timeout(at),
            });
            self.carry_out(pid)?;
            let again = pid == Pid::Manager && why == "an order is repeated";
            if !again || self.dies_after.is_some() {
                break;
            }
        }
        Ok(())
    }

    /// The manager hears whom it can hear.
    fn hear(&mut self) -> Result<(), Violation> {
        if let Some(image) = self.known_image() {
            self.manager_hears(Input::Image(image))?;
        }
        for n in [0, 1] {
            let pid = Pid::Node(n);
            let registered = self
                .state
                .node(n)
                .is_some_and(|(agents, _)| agents.controller().is_registered());
            let Some(boot) = self.state.boot(pid).filter(|_| registered) else {
                continue;
            };
            if !self.state.connected(Pid::Manager, pid) {
                continue;
            }
            let report = self.report(n, boot);
            self.manager_hears(Input::Message(report))?;
            self.take_inbox()?;
        }
        Ok(())
    }

    fn manager_hears(
        &mut self,
        input: Input<fam_agents::manager::ManagerLocal>,
    ) -> Result<(), Violation> {
        self.change(Pid::Manager, |process| {
            let now = process.now;
            if let Body::Manager(agents) = &mut process.body {
                agents.handle(input, now);
            }
        });
        self.carry_out(Pid::Manager)
    }

    /// An image of the gateway that says what the manager knows already.
    fn known_image(&self) -> Option<Arc<InputImage>> {
        let view = self.state.manager()?.view();
        let known = view.gateways.get(&self.cell().gateway)?;
        let boot = self.state.boot(Pid::Gateway)?;
        let heard = known.is_up() && known.boot == Some(boot);
        if !heard || !self.state.connected(Pid::Manager, Pid::Gateway) {
            return None;
        }
        let record = view.mcs.get(&self.cell().mc)?.record.clone();
        Some(Arc::new(InputImage {
            gateway: self.cell().gateway.clone(),
            boot,
            number: self.world.image_number(&self.state),
            sent_at_us: 0,
            inputs: Vec::new(),
            records: record.into_iter().collect(),
            exports: Vec::new(),
        }))
    }

    /// The report of a node; its inputs are fresh as long as it hears the gateway.
    fn report(&self, n: usize, boot: BootId) -> Envelope {
        let pid = Pid::Node(n);
        let fresh =
            self.state.process(Pid::Gateway).is_some() && self.state.connected(Pid::Gateway, pid);
        let owner = self.cell().owner(n, boot);
        Envelope {
            from: AgentId::Controller(owner.controller.clone()),
            boot,
            to: AgentId::Manager,
            body: Message::Report(ResourceReport {
                owner,
                workload_permille: 0,
                mcs: Vec::new(),
                host_cpu_permille: 0,
                process_cpu_permille: 0,
                process_memory_kb: 0,
                late_ticks: 0,
                overruns: 0,
                image_age_us: if fresh { 0 } else { u64::MAX },
                bad_messages: 0,
            }),
        }
    }
}
