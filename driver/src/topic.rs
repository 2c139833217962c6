//! Plain bytes under keys of their own: streams (the recorder's journal) and questions with answers (field values).

use crate::link::Link;
use std::borrow::Cow;
use std::time::Duration;
use zenoh::Wait;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Queryable;

/// A stream that this process publishes under one key.
#[derive(Debug)]
pub struct Topic {
    publisher: Publisher<'static>,
}

impl Topic {
    /// Publishes; who is too slow misses it.
    pub fn put(&self, bytes: Vec<u8>) {
        let _ = self.publisher.put(bytes).wait();
    }

    /// Whether anybody listens at this moment.
    #[must_use]
    pub fn has_listeners(&self) -> bool {
        self.publisher
            .matching_status()
            .wait()
            .is_ok_and(|s| s.matching())
    }
}

/// Receives a key expression for as long as it is kept.
#[derive(Debug)]
pub struct Subscription {
    _subscriber: Subscriber<()>,
}

/// Answers requests for as long as it is kept.
#[derive(Debug)]
pub struct Server {
    _queryable: Queryable<()>,
}

/// Why a request has no answer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// Nobody answers under this key.
    #[error(
        "nobody answered under `{key}` within {within_ms} ms{}; is that process running, and is its endpoint given?",
        crate::reach::not_connected(unreachable)
    )]
    NoAnswer {
        /// The key asked.
        key: String,
        /// How long was waited.
        within_ms: u64,
        /// Endpoints without connection.
        unreachable: Vec<String>,
    },
    /// The answer is a refusal, in the words of whoever gave it.
    #[error("{0}")]
    Refused(String),
}

impl Link {
    /// A stream under `key`.
    ///
    /// # Errors
    /// If `key` is no valid key expression, or the link is closed.
    pub fn topic(&self, key: &str) -> Result<Topic, crate::LinkError> {
        let publisher = self
            .session()
            .declare_publisher(key.to_owned())
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::Data)
            .wait()
            .map_err(|e| crate::LinkError::zenoh("declaring a stream", &e))?;
        Ok(Topic { publisher })
    }

    /// Calls `each` on Zenoh's thread with key and bytes of everything published under a key that `key` matches.
    ///
    /// # Errors
    /// If `key` is no valid key expression, or the link is closed.
    pub fn subscribe(
        &self,
        key: &str,
        each: impl Fn(&str, Cow<'_, [u8]>) + Send + Sync + 'static,
    ) -> Result<Subscription, crate::LinkError> {
        let subscriber = self
            .session()
            .declare_subscriber(key.to_owned())
            .callback(move |sample| each(sample.key_expr().as_str(), sample.payload().to_bytes()))
            .wait()
            .map_err(|e| crate::LinkError::zenoh("subscribing", &e))?;
        Ok(Subscription {
            _subscriber: subscriber,
        })
    }

    /// Answers requests under `key` with what `answer` makes of their bytes, on Zenoh's thread. `Err` is words for the asker.
    ///
    /// # Errors
    /// If `key` is no valid key expression, or the link is closed.
    pub fn serve(
        &self,
        key: &str,
        answer: impl Fn(&[u8]) -> Result<Vec<u8>, String> + Send + Sync + 'static,
    ) -> Result<Server, crate::LinkError> {
        let queryable = self
            .session()
            .declare_queryable(key.to_owned())
            .complete(true)
            .callback(move |query| {
                let asked = query.payload().map(|p| p.to_bytes()).unwrap_or_default();
                let _ = match answer(&asked) {
                    Ok(bytes) => query.reply(query.key_expr().clone(), bytes).wait(),
                    Err(words) => query.reply_err(words).wait(),
                };
            })
            .wait()
            .map_err(|e| crate::LinkError::zenoh("serving requests", &e))?;
        Ok(Server {
            _queryable: queryable,
        })
    }

    /// Asks under `key` and waits for the first answer, asking again while nobody is known to serve it.
    ///
    /// # Errors
    /// [`RequestError`] if nobody answers in time, or the answer is a refusal.
    pub async fn request(
        &self,
        key: &str,
        bytes: Vec<u8>,
        within: Duration,
    ) -> Result<Vec<u8>, RequestError> {
        const AGAIN: Duration = Duration::from_millis(50);
        let asking = async {
            loop {
                let replies = self
                    .session()
                    .get(key)
                    .payload(bytes.clone())
                    .timeout(within)
                    .await;
                if let Ok(replies) = replies
                    && let Ok(reply) = replies.recv_async().await
                {
                    return match reply.result() {
                        Ok(sample) => Ok(sample.payload().to_bytes().into_owned()),
                        Err(error) => Err(RequestError::Refused(
                            String::from_utf8_lossy(&error.payload().to_bytes()).into_owned(),
                        )),
                    };
                }
                tokio::time::sleep(AGAIN).await;
            }
        };
        match tokio::time::timeout(within, asking).await {
            Ok(answer) => answer,
            Err(_) => Err(RequestError::NoAnswer {
                key: key.to_owned(),
                within_ms: u64::try_from(within.as_millis()).unwrap_or(u64::MAX),
                unreachable: self.check_reach().await,
            }),
        }
    }
}
