//! Ports for processes that are about to start.

use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::ops::Range;

/// Below those that the system gives to outgoing connections (from 32,768 on): a controller that tries to reach a process that does
/// not run yet would otherwise be given that process's port now and then.
const PORTS: Range<u16> = 20_000..32_000;

/// A TCP address on loopback that nobody listens on at this moment; another one in each call, most likely.
///
/// # Errors
/// If none of many is free.
pub fn free_address() -> io::Result<SocketAddr> {
    let mut random = RandomState::new().build_hasher().finish();
    for _ in 0..1_000 {
        let port = PORTS.start + (random % PORTS.len() as u64) as u16;
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        if TcpListener::bind(address).is_ok() {
            return Ok(address);
        }
        random = random
            .rotate_left(17)
            .wrapping_mul(0x9E37_79B9_7F4A_7C15)
            .wrapping_add(1);
    }
    Err(io::Error::new(
        io::ErrorKind::AddrInUse,
        "no free TCP port from 20,000 to 32,000 on loopback",
    ))
}
