//! An operator's command against a manager that answers late, refuses, or is not there.

mod common;

use common::*;
use fam_driver::{Client, ClientError, Link, LinkOptions};
use fam_proto::{
    AgentId, CommandKind, CommandReply, ControllerId, Envelope, Event, EventKind, Message,
    ProcessId, Query, QueryReply, Severity,
};
use std::time::Duration;

fn drain() -> CommandKind {
    CommandKind::Drain(ControllerId::new("c1").unwrap())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nobody_there_and_nobody_answering_are_told_apart() {
    let at = endpoint();
    let mut client = Client::open(cell(), vec![at.clone()]).await.unwrap();
    let short = Duration::from_millis(300);
    let error = client.ask(Query::Status, short).await.unwrap_err();
    assert_eq!(
        error.to_string(),
        format!(
            "cannot reach the manager at {at} (waited 300 ms): start it with `fam manager` or `fam up`, or give its endpoint with `--manager`"
        )
    );
    let (silent, _events) = Link::open(LinkOptions {
        listen: vec![at.clone()],
        ..options(ProcessId::Manager, 1)
    })
    .await
    .unwrap();
    tokio::time::timeout(SOON, async {
        while !client.link().check_reach().await.is_empty() {
            tokio::task::yield_now().await;
        }
    })
    .await
    .unwrap();
    let error = client.command(drain(), short, |_| {}).await.unwrap_err();
    assert!(
        matches!(&error, ClientError::NoAnswer { endpoints, .. } if *endpoints == at),
        "{error}"
    );
    silent.close().await;
    client.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_command_is_repeated_until_its_end_and_refusals_come_in_words() {
    let at = endpoint();
    let (manager, mut events) = Link::open(LinkOptions {
        listen: vec![at.clone()],
        ..options(ProcessId::Manager, 1)
    })
    .await
    .unwrap();
    let mut client = Client::open(cell(), vec![at]).await.unwrap();
    let answering = tokio::spawn(async move {
        let (mut times, mut ids) = (0, Vec::new());
        loop {
            let asked = message(&mut events).await;
            let answer = match asked.body {
                Message::Command(command) => {
                    times += 1;
                    ids.push(command.id);
                    let (result, done) = match (command.what, times) {
                        (CommandKind::Drain(_), 1) => continue, // the first one is lost
                        (CommandKind::Drain(_), 2) => (Ok("draining".to_owned()), false),
                        (CommandKind::Drain(_), _) => (Ok("drained".to_owned()), true),
                        _ => (Err("station9 is no MC of this cell".to_owned()), true),
                    };
                    Message::CommandReply(CommandReply {
                        id: command.id,
                        result,
                        done,
                    })
                }
                Message::Query(Query::Events { after, .. }) => {
                    let mut event = Event::new(Severity::Info, EventKind::PlanDone, "x");
                    event.seq = after + 1;
                    Message::QueryReply(Box::new(QueryReply::Events {
                        events: vec![event],
                        more: false,
                    }))
                }
                Message::Leaving => return ids,
                other => panic!("{other:?}"),
            };
            manager.send(&Envelope {
                from: AgentId::Manager,
                boot: manager.boot(),
                to: asked.from,
                body: answer,
            });
        }
    });
    let mut progress = Vec::new();
    let done = client
        .command(drain(), SOON, |words| progress.push(words.to_owned()))
        .await;
    assert_eq!(done.unwrap(), "drained");
    assert_eq!(progress, ["draining"]);
    let refused = client
        .command(
            CommandKind::Unpin(fam_proto::McId::new("station9").unwrap()),
            SOON,
            |_| {},
        )
        .await;
    assert_eq!(
        refused.unwrap_err().to_string(),
        "station9 is no MC of this cell"
    );
    for after in [7, 8] {
        let reply = client.ask(Query::Events { after, limit: 5 }, SOON).await;
        let QueryReply::Events { events, .. } = reply.unwrap() else {
            panic!("no events")
        };
        assert_eq!(events[0].seq, after + 1);
    }
    client.link().send(&Envelope {
        from: AgentId::Client(0),
        boot: client.link().boot(),
        to: AgentId::Manager,
        body: Message::Leaving,
    });
    let ids = answering.await.unwrap();
    assert!(ids[..ids.len() - 1].iter().all(|id| *id == 1), "{ids:?}");
    assert_eq!(ids.last(), Some(&2));
    client.close().await;
}
