//! Clocks of the operating system: monotonic time, and the CPU time of one thread.

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

/// Sleeps until this time on CLOCK_MONOTONIC, whatever signals come.
pub(crate) fn sleep_until_ns(at_ns: u64) {
    let until = libc::timespec {
        tv_sec: libc::time_t::try_from(at_ns / 1_000_000_000).unwrap_or(libc::time_t::MAX),
        tv_nsec: libc::c_long::try_from(at_ns % 1_000_000_000).unwrap_or(0),
    };
    // SAFETY: `until` is a valid timespec; the remaining time is not asked for with absolute deadlines.
    while unsafe {
        libc::clock_nanosleep(
            libc::CLOCK_MONOTONIC,
            libc::TIMER_ABSTIME,
            &raw const until,
            std::ptr::null_mut(),
        )
    } == libc::EINTR
    {}
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
        sleep_until_ns(wall + 20_000_000);
        assert!(monotonic_ns() >= wall + 20_000_000);
        let slept = clock.ns() - from;
        assert!(slept < 10_000_000, "{slept} ns");
        let from = thread_ns();
        while thread_ns() < from + 2_000_000 {}
        assert!(clock.ns() >= from + 2_000_000);
    }
}
