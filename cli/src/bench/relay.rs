//! A TCP relay on loopback that can be cut: it stops forwarding without closing, as a pulled cable does.

use anyhow::{Context, Result};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Condvar, Mutex};

/// Whether bytes pass; a cut link keeps what it has read until it is mended.
#[derive(Clone, Default)]
pub struct Cut(Arc<(Mutex<bool>, Condvar)>);

impl Cut {
    /// Stops all relays that share this switch, or lets them go on.
    pub fn set(&self, cut: bool) {
        if let Ok(mut state) = self.0.0.lock() {
            *state = cut;
            self.0.1.notify_all();
        }
    }

    fn wait_until_mended(&self) {
        if let Ok(state) = self.0.0.lock() {
            drop(self.0.1.wait_while(state, |cut| *cut));
        }
    }
}

/// Listens on a free port and forwards each connection to `target`. Returns the address to connect to.
///
/// # Errors
/// If no port is free.
pub fn start(target: SocketAddr, cut: &Cut) -> Result<SocketAddr> {
    let listener = TcpListener::bind("127.0.0.1:0").context("no free TCP port for the relay")?;
    let address = listener.local_addr()?;
    let cut = cut.clone();
    std::thread::spawn(move || {
        for near in listener.incoming().flatten() {
            let Ok(far) = TcpStream::connect(target) else {
                continue;
            };
            let _ = (near.set_nodelay(true), far.set_nodelay(true));
            if let (Ok(near2), Ok(far2)) = (near.try_clone(), far.try_clone()) {
                pump(near, far, cut.clone());
                pump(far2, near2, cut.clone());
            }
        }
    });
    Ok(address)
}

fn pump(mut from: TcpStream, mut to: TcpStream, cut: Cut) {
    std::thread::spawn(move || {
        let mut buffer = vec![0; 64 << 10];
        loop {
            let n = from.read(&mut buffer).unwrap_or(0);
            cut.wait_until_mended();
            if n == 0 || to.write_all(&buffer[..n]).is_err() {
                let _ = (
                    from.shutdown(std::net::Shutdown::Both),
                    to.shutdown(std::net::Shutdown::Both),
                );
                return;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_cut_link_is_silent_but_open_and_can_be_mended() {
        let echo = TcpListener::bind("127.0.0.1:0").unwrap();
        let target = echo.local_addr().unwrap();
        std::thread::spawn(move || {
            let (mut s, _) = echo.accept().unwrap();
            let mut b = [0; 1];
            while s.read_exact(&mut b).is_ok() {
                s.write_all(&b).unwrap();
            }
        });
        let cut = Cut::default();
        let mut client = TcpStream::connect(start(target, &cut).unwrap()).unwrap();
        let mut b = [0; 1];
        client.write_all(b"a").unwrap();
        client.read_exact(&mut b).unwrap();
        assert_eq!(&b, b"a");
        cut.set(true);
        client
            .set_read_timeout(Some(Duration::from_millis(50)))
            .unwrap();
        client.write_all(b"b").unwrap();
        assert!(
            client.read_exact(&mut b).is_err(),
            "nothing passes a cut link, and it is not closed"
        );
        cut.set(false);
        client
            .set_read_timeout(Some(Duration::from_secs(5)))
            .unwrap();
        client.read_exact(&mut b).unwrap();
        assert_eq!(&b, b"b");
    }
}
