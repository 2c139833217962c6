//! The driver's order: outputs one after the other, a write answered before what follows it, deadlines before inputs.

mod common;

use common::*;
use fam_driver::{Link, Shell, run};
use fam_proto::agent::{Input, Output};
use fam_proto::{Agent, Envelope, Event, EventKind, Message, Now, ProcessId, Severity};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use tokio::sync::{mpsc, oneshot};

/// Writes down what comes in; answers a local `n` by a fixed list of outputs, and a write by a message with its result.
#[derive(Default)]
struct Scripted {
    outputs: VecDeque<Output<&'static str, &'static str>>,
    seen: Arc<Mutex<Vec<String>>>,
    deadline: Option<Now>,
}

impl Scripted {
    fn note(&self, text: String) {
        self.seen.lock().unwrap().push(text);
    }
}

impl Agent for Scripted {
    type Input = Input<u64>;
    type Output = Output<&'static str, &'static str>;
    fn handle(&mut self, input: Input<u64>, now: Now) {
        match input {
            Input::Local(1) => {
                let to_self = numbered(&node("c1"), &node("c1"), 10);
                self.outputs.extend([
                    Output::Act("first"),
                    Output::Persist {
                        ticket: 1,
                        write: "epoch",
                    },
                    Output::Send(to_self),
                    Output::Persist {
                        ticket: 2,
                        write: "full disk",
                    },
                    Output::Act("last"),
                    Output::Event(Event::new(Severity::Info, EventKind::PlanDone, "noted")),
                ]);
            }
            Input::Local(2) => self.deadline = Some(now.plus_ms(20)),
            Input::Local(other) => self.note(format!("local {other}")),
            Input::Persisted { ticket, result } => {
                self.note(format!("persisted {ticket} {result:?}"));
                self.outputs.push_back(Output::Act("after persisted"));
            }
            Input::Message(envelope) => self.note(format!("message {:?}", envelope.body)),
            Input::Peer { .. } => {}
            Input::Image(image) => self.note(format!("image {}", image.number)),
        }
    }
    fn handle_timeout(&mut self, now: Now) {
        if self.deadline.is_some_and(|at| at <= now) {
            self.deadline = None;
            self.note("timeout".to_owned());
            self.outputs.push_back(Output::Act("end"));
        }
    }
    fn poll_output(&mut self) -> Option<Self::Output> {
        self.outputs.pop_front()
    }
    fn poll_timeout(&self) -> Option<(Now, &'static str)> {
        self.deadline.map(|at| (at, "the test's end"))
    }
}

struct Notes {
    seen: Arc<Mutex<Vec<String>>>,
    finished: bool,
}

impl Shell<&'static str, &'static str> for Notes {
    fn persist(&mut self, write: &'static str) -> Result<(), String> {
        self.seen.lock().unwrap().push(format!("write {write}"));
        if write == "full disk" {
            return Err("no space left".to_owned());
        }
        Ok(())
    }
    fn act(&mut self, action: &'static str, _now: Now) {
        self.seen.lock().unwrap().push(format!("act {action}"));
        self.finished |= action == "end";
    }
    fn event(&mut self, event: Event) {
        self.seen
            .lock()
            .unwrap()
            .push(format!("event {}", event.text));
    }
    fn outgoing(&mut self, envelope: &mut Envelope) {
        if let Message::OrderReceived(order) = &mut envelope.body {
            order.0 += 1;
        }
        self.seen.lock().unwrap().push("send".to_owned());
    }
    fn finished(&self) -> bool {
        self.finished
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn outputs_leave_in_order_and_a_write_is_answered_before_the_next() {
    let ((manager, mut manager_events), (link, events)) =
        pair(options(ProcessId::Manager, 1), options(node("c1"), 2)).await;
    let seen: Arc<Mutex<Vec<String>>> = Arc::default();
    let agent = Scripted {
        seen: seen.clone(),
        ..Scripted::default()
    };
    let notes = Notes {
        seen: seen.clone(),
        finished: false,
    };
    let (locals, receiver) = mpsc::unbounded_channel();
    locals.send(1).unwrap();
    locals.send(2).unwrap();
    let run = run(
        agent,
        &link,
        events,
        receiver,
        notes,
        std::future::pending(),
    );
    tokio::time::timeout(SOON, run)
        .await
        .unwrap_or_else(|_| panic!("the deadline's action ends it: {:?}", seen.lock()));
    let seen = seen.lock().unwrap().clone();
    assert_eq!(
        seen,
        [
            "act first",
            "write epoch",
            "persisted 1 Ok(())",
            "send",
            "write full disk",
            "persisted 2 Err(\"no space left\")",
            "act last",
            "event noted",
            "act after persisted",
            "act after persisted",
            "message OrderReceived(OrderId(11))",
            "timeout",
            "act end",
        ]
    );
    // The event went to the manager too, signed by the Controller Agent.
    let event = message(&mut manager_events).await;
    assert_eq!(event.from, agent_of("c1"));
    assert!(matches!(event.body, Message::Event(e) if e.text == "noted"));
    manager.close().await;
    link.close().await;
}

fn agent_of(name: &str) -> fam_proto::AgentId {
    agent(&node(name))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn it_ends_on_shutdown_and_gives_the_agent_back() {
    let (link, events) = Link::open(options(node("c1"), 2)).await.unwrap();
    let agent = Scripted::default();
    let seen = agent.seen.clone();
    let notes = Notes {
        seen: seen.clone(),
        finished: false,
    };
    let (end, ended) = oneshot::channel::<()>();
    let (locals, receiver) = mpsc::unbounded_channel();
    locals.send(5).unwrap();
    drop(locals);
    let waiter = tokio::spawn({
        let seen = seen.clone();
        async move {
            while seen.lock().unwrap().is_empty() {
                tokio::task::yield_now().await;
            }
            end.send(()).unwrap();
        }
    });
    let agent = run(agent, &link, events, receiver, notes, async {
        let _ = ended.await;
    })
    .await;
    waiter.await.unwrap();
    assert_eq!(*agent.seen.lock().unwrap(), ["local 5"]);
    link.close().await;
}
