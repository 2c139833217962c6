//! Real-time means: priority, locked memory, CPU affinity. Each is used where the machine allows it, and said in words.

use nix::sched::{CpuSet, sched_setaffinity};
use nix::sys::mman::{MlockAllFlags, mlockall};
use nix::unistd::Pid;

/// What is wanted; nothing of it needs to be allowed.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RealTimeOptions {
    /// SCHED_FIFO priority of the scan thread, 1 to 99.
    pub priority: Option<u8>,
    /// Whether memory is locked against paging.
    pub lock_memory: bool,
    /// CPUs that the scan thread may run on; empty for all.
    pub cpus: Vec<usize>,
}

/// Locks the memory of the process. In words what is in force.
pub(crate) fn lock_memory(options: &RealTimeOptions) -> Option<String> {
    if !options.lock_memory {
        return None;
    }
    match mlockall(MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE) {
        Ok(()) => Some("mlock".to_owned()),
        Err(error) => {
            tracing::warn!("memory is not locked: {error} (RLIMIT_MEMLOCK, or CAP_IPC_LOCK)");
            None
        }
    }
}

/// Gives the calling thread its priority and CPUs. In words what is in force.
pub(crate) fn apply_to_this_thread(options: &RealTimeOptions) -> Vec<String> {
    let mut in_force = Vec::new();
    if !options.cpus.is_empty() {
        match pin(&options.cpus) {
            Ok(()) => {
                let cpus: Vec<String> = options.cpus.iter().map(usize::to_string).collect();
                in_force.push(format!("CPU {}", cpus.join(",")));
            }
            Err(error) => tracing::warn!(
                "the scan thread is not bound to CPUs {:?}: {error}",
                options.cpus
            ),
        }
    }
    if let Some(priority) = options.priority {
        match fifo(priority) {
            Ok(()) => in_force.push(format!("SCHED_FIFO {priority}")),
            Err(error) => tracing::warn!(
                "the scan thread has normal priority: SCHED_FIFO {priority}: {error} (RLIMIT_RTPRIO, or CAP_SYS_NICE)"
            ),
        }
    }
    in_force
}

fn pin(cpus: &[usize]) -> nix::Result<()> {
    let mut set = CpuSet::new();
    for cpu in cpus {
        set.set(*cpu)?;
    }
    sched_setaffinity(Pid::from_raw(0), &set)
}

fn fifo(priority: u8) -> std::io::Result<()> {
    let parameters = libc::sched_param {
        sched_priority: i32::from(priority),
    };
    // SAFETY: pid 0 is the calling thread, and the parameters are valid for the call.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) };
    if result == 0 {
        Ok(())
    } else {
        Err(std::io::Error::last_os_error())
    }
}

/// Takes a real-time priority that it may have inherited from the calling thread, and so from those that it starts.
pub(crate) fn normal_priority() {
    let parameters = libc::sched_param { sched_priority: 0 };
    // SAFETY: pid 0 is the calling thread, and the parameters are valid for the call. Everybody may have less priority.
    unsafe { libc::sched_setscheduler(0, libc::SCHED_OTHER, &raw const parameters) };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_wanted_or_not_allowed_is_not_claimed() {
        assert!(apply_to_this_thread(&RealTimeOptions::default()).is_empty());
        let options = RealTimeOptions {
            cpus: vec![0],
            ..RealTimeOptions::default()
        };
        std::thread::spawn(move || {
            assert_eq!(apply_to_this_thread(&options), ["CPU 0"]);
            let beyond = RealTimeOptions {
                cpus: vec![100_000],
                ..RealTimeOptions::default()
            };
            assert!(apply_to_this_thread(&beyond).is_empty());
        })
        .join()
        .unwrap();
    }
}
