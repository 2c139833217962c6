//! Drives one agent: what comes in goes to it, what it asks for is carried out strictly in order.
//!
//! `Persist` is executed when its turn comes and answered at once: no later output leaves before the agent has seen the result.

use crate::clock::{instant, now};
use crate::link::{Link, LinkEvent, LinkEvents};
use crate::logging::log_event;
use fam_proto::agent::{Input, Output};
use fam_proto::{Agent, AgentId, Envelope, Event, Message, Now, ProcessId};
use tokio::sync::mpsc::UnboundedReceiver;

/// What a process does for its agent.
pub trait Shell<P, X> {
    /// Makes `write` durable; returns when it is, or says what the disk said.
    ///
    /// # Errors
    /// Words for people; the agent gets them as `Input::Persisted`.
    fn persist(&mut self, write: P) -> Result<(), String>;
    /// Does what the agent asks of its own process. Must not wait.
    fn act(&mut self, action: X, now: Now);
    /// Writes an event of the agent to the log.
    fn log(&mut self, event: &Event) {
        log_event(event);
    }
    /// Called with each event of the agent, after it has been logged and, by processes other than the manager, sent to it.
    fn event(&mut self, event: Event) {
        let _ = event;
    }
    /// Called with each message before it leaves; may fill in what the agent cannot know (the wall clock).
    fn outgoing(&mut self, envelope: &mut Envelope) {
        let _ = envelope;
    }
    /// Whether the process is to end; asked after each input.
    fn finished(&self) -> bool {
        false
    }
}

impl<P, X, S: Shell<P, X>> Shell<P, X> for &mut S {
    fn persist(&mut self, write: P) -> Result<(), String> {
        (**self).persist(write)
    }
    fn act(&mut self, action: X, now: Now) {
        (**self).act(action, now);
    }
    fn log(&mut self, event: &Event) {
        (**self).log(event);
    }
    fn event(&mut self, event: Event) {
        (**self).event(event);
    }
    fn outgoing(&mut self, envelope: &mut Envelope) {
        (**self).outgoing(envelope);
    }
    fn finished(&self) -> bool {
        (**self).finished()
    }
}

/// Runs `agent` until `shutdown` completes, the shell is finished, or the link is closed; returns it.
///
/// Deadlines are looked at before each input, so that a queue of inputs cannot hold a timer back. Frames come to agents
/// only through a sink that makes locals of them ([`crate::Sinks`]).
pub async fn run<A, L, P, X, S>(
    mut agent: A,
    link: &Link,
    mut events: LinkEvents,
    mut locals: UnboundedReceiver<L>,
    mut shell: S,
    shutdown: impl Future<Output = ()>,
) -> A
where
    A: Agent<Input = Input<L>, Output = Output<P, X>>,
    S: Shell<P, X>,
{
    #[allow(clippy::large_enum_variant)] // lives on the stack for a moment
    enum Woken<L> {
        Shutdown,
        Event(Option<LinkEvent>),
        Local(Option<L>),
        Deadline,
    }
    let mut shutdown = std::pin::pin!(shutdown);
    let mut locals_open = true;
    drain(&mut agent, link, &mut shell);
    while !shell.finished() {
        if agent.poll_timeout().is_some_and(|(at, _)| at <= now()) {
            agent.handle_timeout(now());
            drain(&mut agent, link, &mut shell);
            if shell.finished() {
                break;
            }
        }
        let deadline = agent.poll_timeout().map(|(at, _)| instant(at));
        let woken = tokio::select! {
            () = &mut shutdown => Woken::Shutdown,
            event = events.recv() => Woken::Event(event),
            local = locals.recv(), if locals_open => Woken::Local(local),
            () = async { tokio::time::sleep_until(deadline.unwrap_or_else(tokio::time::Instant::now)).await }, if deadline.is_some() => Woken::Deadline,
        };
        let input = match woken {
            Woken::Shutdown | Woken::Event(None) => break,
            Woken::Deadline => continue,
            Woken::Local(None) => {
                locals_open = false;
                continue;
            }
            Woken::Local(Some(local)) => Input::Local(local),
            Woken::Event(Some(LinkEvent::Message(envelope))) => Input::Message(envelope),
            Woken::Event(Some(LinkEvent::Image(image))) => Input::Image(image),
            Woken::Event(Some(LinkEvent::Peer {
                process,
                boot,
                alive,
            })) => Input::Peer {
                process,
                boot,
                alive,
            },
            Woken::Event(Some(LinkEvent::Frame { .. })) => continue,
        };
        agent.handle(input, now());
        drain(&mut agent, link, &mut shell);
    }
    agent
}

fn drain<A, L, P, X, S>(agent: &mut A, link: &Link, shell: &mut S)
where
    A: Agent<Input = Input<L>, Output = Output<P, X>>,
    S: Shell<P, X>,
{
    while let Some(output) = agent.poll_output() {
        match output {
            Output::Persist { ticket, write } => {
                let result = shell.persist(write);
                agent.handle(Input::Persisted { ticket, result }, now());
            }
            Output::Send(mut envelope) => {
                shell.outgoing(&mut envelope);
                link.send(&envelope);
            }
            Output::Act(action) => shell.act(action, now()),
            Output::Event(event) => {
                shell.log(&event);
                if let Some(from) = signer(link.process()) {
                    link.send(&Envelope {
                        from,
                        boot: link.boot(),
                        to: AgentId::Manager,
                        body: Message::Event(event.clone()),
                    });
                }
                shell.event(event);
            }
        }
    }
}

/// Who signs the events of a process; the manager keeps its own.
fn signer(process: &ProcessId) -> Option<AgentId> {
    match process {
        ProcessId::Manager | ProcessId::Client(_) => None,
        ProcessId::Node(controller) => Some(AgentId::Controller(controller.clone())),
        ProcessId::Gateway(gateway) => Some(AgentId::Gateway(gateway.clone())),
    }
}
