//! An operator's command: asks the manager, and repeats until it is answered or the time is over.

use crate::link::{Link, LinkError, LinkEvent, LinkEvents, LinkOptions};
use fam_proto::{
    AgentId, CellId, Command, CommandKind, Envelope, Message, ProcessId, Query, QueryReply,
};
use std::time::Duration;
use tokio::time::Instant;

/// First and longest pause between two repetitions: the first question may leave before it is known who listens.
const REPEAT: (Duration, Duration) = (Duration::from_millis(15), Duration::from_millis(200));

/// Why there is no answer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ClientError {
    /// The link could not be opened.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// Nobody listens at the endpoints.
    #[error(
        "cannot reach the manager at {endpoints} (waited {waited_ms} ms): start it with `fam manager` or `fam up`, or give its endpoint with `--manager`"
    )]
    Unreachable {
        /// The endpoints tried.
        endpoints: String,
        /// How long.
        waited_ms: u64,
    },
    /// Something listens there, but no manager of this cell answers.
    #[error(
        "connected to {endpoints}, but no manager of cell `{cell}` answered within {waited_ms} ms: is it the manager's endpoint, and the right cell?"
    )]
    NoAnswer {
        /// The endpoints.
        endpoints: String,
        /// The cell.
        cell: CellId,
        /// How long.
        waited_ms: u64,
    },
    /// The manager refuses; its words.
    #[error("{0}")]
    Refused(String),
    /// The command was taken, but its end did not come in time.
    #[error(
        "the manager has begun (\"{begun}\"), but it was not done within {waited_ms} ms; it goes on: see `fam events`"
    )]
    Unfinished {
        /// What it answered first.
        begun: String,
        /// How long.
        waited_ms: u64,
    },
}

/// A command's connection to the manager of a cell.
#[derive(Debug)]
pub struct Client {
    link: Link,
    events: LinkEvents,
    number: u64,
    endpoints: String,
    commands: u64,
}

impl Client {
    /// Opens a connection to the manager (and others) of a cell. Does not wait for it: asking does.
    ///
    /// # Errors
    /// [`LinkError`] if an endpoint is malformed.
    pub async fn open(cell: CellId, connect: Vec<String>) -> Result<Client, LinkError> {
        // Two commands of one moment are told apart by their process ids.
        let number = (crate::wall_us() << 12) ^ u64::from(std::process::id());
        let endpoints = connect.join(", ");
        let options = LinkOptions {
            listen: Vec::new(),
            connect,
            ..LinkOptions::new(cell, ProcessId::Client(number))
        };
        let (link, events) = Link::open(options).await?;
        Ok(Client {
            link,
            events,
            number,
            endpoints,
            commands: 0,
        })
    }

    /// The link, for requests and streams of other processes.
    #[must_use]
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// Asks the manager.
    ///
    /// # Errors
    /// [`ClientError`], which says which endpoint could not be reached and what to do.
    pub async fn ask(&mut self, query: Query, within: Duration) -> Result<QueryReply, ClientError> {
        while self.events.try_recv().is_some() {}
        let deadline = Instant::now() + within;
        let body = Message::Query(query.clone());
        let mut pause = REPEAT.0;
        loop {
            self.send(body.clone());
            let again = deadline.min(Instant::now() + pause);
            pause = REPEAT.1.min(pause * 2);
            while let Some(message) = self.next(again).await {
                if let Message::QueryReply(reply) = message
                    && answers(&query, &reply)
                {
                    return Ok(*reply);
                }
            }
            if Instant::now() >= deadline {
                return Err(self.silence(within).await);
            }
        }
    }

    /// Gives a command and waits for its end; `progress` gets what the manager says before.
    ///
    /// # Errors
    /// [`ClientError`]: not reached, refused, or not done in time.
    pub async fn command(
        &mut self,
        what: CommandKind,
        within: Duration,
        mut progress: impl FnMut(&str),
    ) -> Result<String, ClientError> {
        self.commands += 1;
        let id = self.commands;
        let body = Message::Command(Command { id, what });
        let deadline = Instant::now() + within;
        let mut begun: Option<String> = None;
        let mut pause = REPEAT.0;
        loop {
            // Repeated to its end: the final answer may be lost too, and a repeated command does nothing twice.
            self.send(body.clone());
            let again = deadline.min(Instant::now() + pause);
            pause = REPEAT.1.min(pause * 2);
            while let Some(message) = self.next(again).await {
                let Message::CommandReply(reply) = message else {
                    continue;
                };
                if reply.id != id {
                    continue;
                }
                match reply.result {
                    Err(words) => return Err(ClientError::Refused(words)),
                    Ok(words) if reply.done => return Ok(words),
                    Ok(words) => {
                        if begun.as_ref() != Some(&words) {
                            progress(&words);
                        }
                        begun = Some(words);
                    }
                }
            }
            if Instant::now() >= deadline {
                return Err(match begun {
                    Some(begun) => ClientError::Unfinished {
                        begun,
                        waited_ms: ms(within),
                    },
                    None => self.silence(within).await,
                });
            }
        }
    }

    /// Number of the newest command, as further commands refer to it.
    #[must_use]
    pub fn last_command(&self) -> u64 {
        self.commands
    }

    /// Ends the connection.
    pub async fn close(self) {
        self.link.close().await;
    }

    fn send(&self, body: Message) {
        self.link.send(&Envelope {
            from: AgentId::Client(self.number),
            boot: self.link.boot(),
            to: AgentId::Manager,
            body,
        });
    }

    async fn next(&mut self, until: Instant) -> Option<Message> {
        loop {
            match tokio::time::timeout_at(until, self.events.recv()).await {
                Ok(Some(LinkEvent::Message(envelope))) => return Some(envelope.body),
                Ok(Some(_)) => {}
                Ok(None) => {
                    // A closed link stays silent: wait the time out, do not spin.
                    tokio::time::sleep_until(until).await;
                    return None;
                }
                Err(_) => return None,
            }
        }
    }

    async fn silence(&self, within: Duration) -> ClientError {
        let unreachable = self.link.check_reach().await;
        if unreachable.is_empty() && !self.endpoints.is_empty() {
            ClientError::NoAnswer {
                endpoints: self.endpoints.clone(),
                cell: self.link.cell().clone(),
                waited_ms: ms(within),
            }
        } else {
            ClientError::Unreachable {
                endpoints: unreachable.join(", "),
                waited_ms: ms(within),
            }
        }
    }
}

/// Whether a reply belongs to a query, and not to an earlier one that was repeated.
fn answers(query: &Query, reply: &QueryReply) -> bool {
    match (query, reply) {
        (Query::Status, QueryReply::Status(_)) => true,
        (Query::Events { after, .. }, QueryReply::Events { events, .. }) => {
            events.first().is_none_or(|e| e.seq > *after)
        }
        _ => false,
    }
}

fn ms(duration: Duration) -> u64 {
    u64::try_from(duration.as_millis()).unwrap_or(u64::MAX)
}
