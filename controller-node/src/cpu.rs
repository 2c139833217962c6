//! Clocks of the operating system: monotonic time, the CPU time of one thread, and waiting for a moment or a ring.

use std::sync::atomic::{AtomicU32, Ordering};

/// Nanoseconds on CLOCK_MONOTONIC: the same zero for all processes of this machine.
pub(crate) fn monotonic_ns() -> u64 {
    read(libc::CLOCK_MONOTONIC)
}

/// CPU time of the calling thread, in nanoseconds.
pub(crate) fn thread_ns() -> u64 {
    read(libc::CLOCK_THREAD_CPUTIME_ID)
}

fn read(clock: libc::clockid_t) -> u64 {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: `time` is a timespec that the call may write. An unknown clock leaves it as it is.
    unsafe { libc::clock_gettime(clock, &raw mut time) };
    nanoseconds(time)
}

fn nanoseconds(time: libc::timespec) -> u64 {
    u64::try_from(time.tv_sec).unwrap_or(0) * 1_000_000_000
        + u64::try_from(time.tv_nsec).unwrap_or(0)
}

/// Wakes a thread that waits for a moment; nobody waits to ring it, and nothing is locked.
#[derive(Debug, Default)]
pub(crate) struct Bell(AtomicU32);

impl Bell {
    /// How often it has been rung, modulo 2^32.
    pub(crate) fn rings(&self) -> u32 {
        self.0.load(Ordering::Acquire)
    }

    /// Rings.
    pub(crate) fn ring(&self) {
        self.0.fetch_add(1, Ordering::Release);
        // SAFETY: a futex word that lives as long as this call; waking touches no memory.
        unsafe {
            libc::syscall(
                libc::SYS_futex,
                self.0.as_ptr(),
                libc::FUTEX_WAKE | libc::FUTEX_PRIVATE_FLAG,
                1,
            );
        }
    }

    /// Waits until this time on CLOCK_MONOTONIC, or for a ring after the first `heard` ones.
    pub(crate) fn wait_until_ns(&self, at_ns: u64, heard: u32) {
        let until = timespec(at_ns);
        while self.rings() == heard && monotonic_ns() < at_ns {
            // SAFETY: a futex word and a valid absolute time, which this operation takes on CLOCK_MONOTONIC. Every
            // outcome (woken, time over, a signal, a ring meanwhile) is judged by the condition above.
            unsafe {
                libc::syscall(
                    libc::SYS_futex,
                    self.0.as_ptr(),
                    libc::FUTEX_WAIT_BITSET | libc::FUTEX_PRIVATE_FLAG,
                    heard,
                    &raw const until,
                    std::ptr::null::<u32>(),
                    libc::FUTEX_BITSET_MATCH_ANY,
                );
            }
        }
    }
}

fn timespec(at_ns: u64) -> libc::timespec {
    libc::timespec {
        tv_sec: libc::time_t::try_from(at_ns / 1_000_000_000).unwrap_or(libc::time_t::MAX),
        tv_nsec: libc::c_long::try_from(at_ns % 1_000_000_000).unwrap_or(0),
    }
}

/// The CPU clock of a thread, to be read by other threads.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ThreadClock(libc::clockid_t);

impl ThreadClock {
    /// The calling thread's; `None` if the system does not give it.
    pub(crate) fn of_this_thread() -> Option<ThreadClock> {
        let mut clock: libc::clockid_t = 0;
        // SAFETY: the calling thread exists, and `clock` may be written.
        let error = unsafe { libc::pthread_getcpuclockid(libc::pthread_self(), &raw mut clock) };
        (error == 0).then_some(ThreadClock(clock))
    }

    /// Its CPU time, in nanoseconds; 0 once the thread has ended.
    pub(crate) fn ns(self) -> u64 {
        read(self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_clock_counts_work_and_not_sleep() {
        let clock = ThreadClock::of_this_thread().unwrap();
        let (from, wall) = (clock.ns(), monotonic_ns());
        Bell::default().wait_until_ns(wall + 20_000_000, 0);
        assert!(monotonic_ns() >= wall + 20_000_000);
        let slept = clock.ns() - from;
        assert!(slept < 10_000_000, "{slept} ns");
        let from = thread_ns();
        while thread_ns() < from + 2_000_000 {}
        assert!(clock.ns() >= from + 2_000_000);
    }

    #[test]
    fn a_ring_ends_the_wait_and_none_is_lost() {
        let bell = std::sync::Arc::new(Bell::default());
        let (far, other) = (monotonic_ns() + 60_000_000_000, bell.clone());
        let ringer = std::thread::spawn(move || other.ring());
        bell.wait_until_ns(far, 0);
        ringer.join().unwrap();
        assert_eq!(bell.rings(), 1);
        bell.ring();
        bell.wait_until_ns(far, 1);
        assert!(monotonic_ns() < far);
    }
}
