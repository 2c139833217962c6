//! Messages that do not read: counted, logged with their sender, dropped.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// One line in the log for each key in this time; what came between is counted in the next line.
const LOG_PAUSE: Duration = Duration::from_secs(5);
/// Keys that are told apart; further ones are logged together.
const KEYS_MAX: usize = 64;

#[derive(Debug, Default)]
pub(crate) struct BadMessages {
    count: AtomicU64,
    logged: Mutex<BTreeMap<String, (Instant, u64)>>,
}

impl BadMessages {
    pub(crate) fn count(&self) -> u64 {
        self.count.load(Ordering::Relaxed)
    }

    /// Counts one, and logs it unless this key was logged a moment ago.
    pub(crate) fn add(&self, key: &str, sender: Option<&str>, why: &dyn std::fmt::Display) {
        self.count.fetch_add(1, Ordering::Relaxed);
        let Ok(mut logged) = self.logged.lock() else {
            return;
        };
        let name = if logged.len() < KEYS_MAX || logged.contains_key(key) {
            key
        } else {
            "other keys"
        };
        let now = Instant::now();
        if let Some((at, more)) = logged.get_mut(name)
            && now.duration_since(*at) < LOG_PAUSE
        {
            *more += 1;
            return;
        }
        let more = logged.insert(name.to_owned(), (now, 0)).map_or(0, |l| l.1);
        let sender = sender.unwrap_or("an unknown sender");
        tracing::warn!(
            key,
            more,
            "a message from {sender} does not read and was dropped: {why}"
        );
    }
}
