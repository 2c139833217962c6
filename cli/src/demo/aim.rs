//! Stops a process while one of its threads is in the middle of its work.
//!
//! A freeze is worth watching only if it hits between the input image and the frame; a thread that drives an MC is there for
//! some percent of its time. So the aim waits until the thread is at work, stops the process, and looks where it has
//! stopped: if the thread was waiting for its next turn after all, the process goes on at once, and the aim is taken again.

use crate::processes::Process;
use anyhow::Result;
use nix::sys::signal::Signal;
use std::fs::read_to_string;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// A thread that still runs so long after it was put on a core is past its waking, and at its work. How long it works, and how
/// long a stop takes to reach it, depend on the machine: the aims go through all of these.
const AT_WORK_AFTER: [Duration; 5] = [
    Duration::from_micros(100),
    Duration::from_micros(60),
    Duration::from_micros(30),
    Duration::from_micros(10),
    Duration::ZERO,
];

/// Stops `process` while its thread of this name is at work, or where it happens to be when `within` has passed.
///
/// # Errors
/// If the process is gone.
pub fn stop_at_work(process: &Process, thread: &str, within: Duration) -> Result<()> {
    let deadline = Instant::now() + within;
    let thread = Thread::of(process.pid(), thread);
    let mut aims = AT_WORK_AFTER.into_iter().cycle();
    loop {
        if let (Some(thread), Some(after)) = (&thread, aims.next()) {
            thread.wait_works(after, deadline);
        }
        process.signal(Signal::SIGSTOP)?;
        let at_work = thread.as_ref().is_none_or(|t| t.stopped_at_work(deadline));
        if at_work || Instant::now() >= deadline {
            return Ok(());
        }
        process.signal(Signal::SIGCONT)?;
    }
}

/// What the system tells of a thread.
struct Thread(PathBuf);

impl Thread {
    fn of(pid: u32, name: &str) -> Option<Thread> {
        let threads = std::fs::read_dir(format!("/proc/{pid}/task")).ok()?;
        let mut threads = threads.flatten().map(|t| Thread(t.path()));
        threads.find(|t| t.told("comm").trim() == name)
    }

    fn told(&self, what: &str) -> String {
        read_to_string(self.0.join(what)).unwrap_or_default()
    }

    /// `R` while it is runnable (perhaps still without a core), `T` while it is stopped.
    fn state(&self) -> Option<char> {
        let stat = self.told("stat");
        stat.rsplit(')').next()?.trim_start().chars().next()
    }

    /// How often it was put on a core; nothing where the system does not count it.
    fn turns(&self) -> Option<String> {
        let schedstat = self.told("schedstat");
        schedstat.split_whitespace().nth(2).map(str::to_owned)
    }

    /// Waits until it has been put on a core and is still there after a while.
    fn wait_works(&self, after: Duration, deadline: Instant) {
        while Instant::now() < deadline {
            let before = self.turns();
            while before.is_some() && self.turns() == before && Instant::now() < deadline {
                std::hint::spin_loop();
            }
            let turn = self.turns();
            let woken = Instant::now();
            while woken.elapsed() < after {
                std::hint::spin_loop();
            }
            if self.state() == Some('R') && self.turns() == turn {
                return;
            }
        }
    }

    /// Whether the stop that is on its way finds it at work, and not in a call that waits. Where the system does not tell,
    /// the aim is believed.
    fn stopped_at_work(&self, deadline: Instant) -> bool {
        while self.state() != Some('T') && Instant::now() < deadline {
            std::hint::spin_loop();
        }
        !waits(&self.told("syscall"))
    }
}

/// Whether a thread in this system call (its number and arguments, as `/proc` tells) waits for something.
fn waits(call: &str) -> bool {
    let mut words = call.split_whitespace();
    let number = words.next().and_then(|n| n.parse::<libc::c_long>().ok());
    let operation = words.nth(1).and_then(|word| {
        let digits = word.trim_start_matches("0x");
        i32::from_str_radix(digits, 16).ok()
    });
    match (number, operation) {
        (Some(libc::SYS_futex), Some(op)) => matches!(
            op & libc::FUTEX_CMD_MASK,
            libc::FUTEX_WAIT | libc::FUTEX_WAIT_BITSET
        ),
        (Some(number), _) => {
            let waiting = [
                libc::SYS_restart_syscall,
                libc::SYS_clock_nanosleep,
                libc::SYS_nanosleep,
            ];
            waiting.contains(&number)
        }
        (None, _) => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_that_waits_is_told_from_one_that_works() {
        let futex = |op: libc::c_int| format!("{} 0x55f2d1323c00 {op:#x} 0x1", libc::SYS_futex);
        assert!(waits(&futex(
            libc::FUTEX_WAIT_BITSET | libc::FUTEX_PRIVATE_FLAG
        )));
        assert!(waits(&futex(libc::FUTEX_WAIT)));
        assert!(!waits(&futex(libc::FUTEX_WAKE | libc::FUTEX_PRIVATE_FLAG)));
        assert!(waits(&format!("{} 0x1 0x0", libc::SYS_clock_nanosleep)));
        assert!(!waits(&format!("{} 0x3 0x7f2d", libc::SYS_clock_gettime)));
        for works in ["-1 0x7f2d505d07b0 0x7f2d51a175d9", "running", ""] {
            assert!(!waits(works), "{works}");
        }
    }
}
