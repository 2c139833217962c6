//! What each FAM process needs around its link: a runtime, and the wish to end.

use std::io;

/// Worker threads of a process's runtime: one for its agents, one for everything else. Zenoh brings its own.
const WORKERS: usize = 2;

/// The tokio runtime of a FAM process.
///
/// # Errors
/// If the operating system gives no threads.
pub fn runtime() -> io::Result<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(WORKERS)
        .thread_name("fam")
        .enable_all()
        .build()
}

/// Completes when the process is asked to end: SIGTERM, or SIGINT (Ctrl-C). Returns the signal's name.
///
/// # Errors
/// If the signals cannot be listened to.
pub async fn termination() -> io::Result<&'static str> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    Ok(tokio::select! {
        _ = terminate.recv() => "SIGTERM",
        _ = interrupt.recv() => "SIGINT",
    })
}
