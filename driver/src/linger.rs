//! Keeps the closing of a dead connection from stopping the living ones.
//!
//! Zenoh sets SO_LINGER to 10 s on its TCP sockets. With unsent data Linux then holds up whoever closes the socket, and that is
//! one of the few threads on which Zenoh sends and receives for all its connections: when the lease of a controller whose cable
//! was pulled, or that was frozen, ran out, healthy controllers stood still for seconds. Without it a close returns at once, and
//! the kernel goes on sending what was written.

use std::os::fd::RawFd;

/// Takes the option back from all sockets of this process that have it. Zenoh does not tell its sockets, and no other socket of a
/// FAM process wants it.
pub(crate) fn off() {
    let Ok(open) = std::fs::read_dir("/proc/self/fd") else {
        return;
    };
    for entry in open.flatten() {
        let number = entry.file_name().to_str().and_then(|n| n.parse().ok());
        if let Some(fd) = number
            && lingers(fd)
        {
            set(fd, 0);
        }
    }
}

/// `false` also for what is no socket, or open no more.
fn lingers(fd: RawFd) -> bool {
    let mut linger = libc::linger {
        l_onoff: 0,
        l_linger: 0,
    };
    let mut len = size_of::<libc::linger>() as libc::socklen_t;
    // SAFETY: both may be written; a wrong descriptor is an error, which leaves them as they are.
    unsafe {
        libc::getsockopt(
            fd,
            libc::SOL_SOCKET,
            libc::SO_LINGER,
            (&raw mut linger).cast(),
            &raw mut len,
        )
    };
    linger.l_onoff != 0
}

fn set(fd: RawFd, seconds: libc::c_int) {
    let linger = libc::linger {
        l_onoff: libc::c_int::from(seconds > 0),
        l_linger: seconds,
    };
    let len = size_of::<libc::linger>() as libc::socklen_t;
    // SAFETY: a whole option; a wrong descriptor is an error without an effect.
    unsafe {
        libc::setsockopt(
            fd,
            libc::SOL_SOCKET,
            libc::SO_LINGER,
            (&raw const linger).cast(),
            len,
        )
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::net::{TcpListener, TcpStream};
    use std::os::fd::AsRawFd;
    use std::time::{Duration, Instant};

    #[test]
    fn closing_a_connection_whose_far_end_reads_nothing_takes_no_time() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let mut near = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let far = listener.accept().unwrap();
        set(near.as_raw_fd(), 3);
        near.set_nonblocking(true).unwrap();
        while near.write(&[0; 65_536]).is_ok() {}
        assert!(lingers(near.as_raw_fd()));
        off();
        assert!(!lingers(near.as_raw_fd()));
        let from = Instant::now();
        drop(near);
        assert!(from.elapsed() < Duration::from_secs(1));
        drop(far);
    }
}
