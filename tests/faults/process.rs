//! A process of `fam` on a host, with what it logs.

use crate::net::Host;
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Lines of a log, oldest first, kept also when its process is gone.
#[derive(Default)]
pub struct Log {
    lines: Mutex<Vec<String>>,
    more: Condvar,
}

impl Log {
    fn push(&self, line: String) {
        let mut lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        lines.push(line);
        self.more.notify_all();
    }

    /// How many lines there are.
    pub fn len(&self) -> usize {
        let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        lines.len()
    }

    /// Waits for a line from number `from` on that contains all of this.
    pub fn wait(&self, from: usize, parts: &[&str], within: Duration) -> Option<String> {
        let deadline = Instant::now() + within;
        let mut lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            let found = lines
                .iter()
                .skip(from)
                .find(|line| parts.iter().all(|part| line.contains(part)));
            if let Some(line) = found {
                return Some(line.clone());
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            lines = self
                .more
                .wait_timeout(lines, left)
                .unwrap_or_else(PoisonError::into_inner)
                .0;
        }
    }

    /// The last lines.
    pub fn tail(&self, most: usize) -> String {
        let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        lines[lines.len().saturating_sub(most)..].join("\n")
    }
}

/// A running process.
pub struct Process {
    child: Child,
}

impl Process {
    /// Starts `fam <args>` on a host. It dies with the test's thread.
    pub fn start(
        host: &Host,
        args: &[String],
        environment: &[(String, String)],
        log: Arc<Log>,
    ) -> Process {
        let mut command = Command::new(env!("CARGO_BIN_EXE_fam"));
        command
            .args(args)
            .envs(environment.iter().cloned())
            .env("NO_COLOR", "1")
            .env_remove("FAM_LOG")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let namespace = host.namespace_fd();
        // SAFETY: setns and prctl are async-signal-safe; nothing is allocated between fork and exec.
        unsafe {
            command.pre_exec(move || {
                libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL);
                if libc::setns(namespace, libc::CLONE_NEWNET) == 0 {
                    Ok(())
                } else {
                    Err(std::io::Error::last_os_error())
                }
            });
        }
        let mut child = command.spawn().expect("fam starts");
        let lines = BufReader::new(child.stderr.take().expect("stderr is piped")).lines();
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                log.push(line);
            }
        });
        Process { child }
    }

    pub fn signal(&self, signal: i32) {
        // SAFETY: a signal to our own child, which has not been waited for.
        unsafe { libc::kill(self.child.id().cast_signed(), signal) };
    }

    /// SIGKILL, and its end.
    pub fn kill(mut self) {
        self.signal(libc::SIGKILL);
        self.child.wait().expect("a killed process ends");
    }

    /// Exit status, if it has ended.
    pub fn ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().expect("the child is ours")
    }

    /// Waits for its end.
    pub fn wait(&mut self, within: Duration) -> Option<ExitStatus> {
        let deadline = Instant::now() + within;
        while Instant::now() < deadline {
            if let Some(status) = self.ended() {
                return Some(status);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        None
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
