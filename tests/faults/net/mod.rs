//! Hosts: network namespaces without a name, each with one cable (a TUN device) whose other end is held by [`fabric`].

pub mod fabric;

use std::fs::File;
use std::io;
use std::net::Ipv4Addr;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::sync::Arc;

const TUN: &str = "/dev/net/tun";
/// Major and minor number of that device.
const TUN_NUMBER: (u32, u32) = (10, 200);
const CABLE: &str = "cable";
const NETMASK: Ipv4Addr = Ipv4Addr::new(255, 255, 0, 0);

/// A network namespace with one cable.
#[derive(Debug, Clone)]
pub struct Host {
    pub address: Ipv4Addr,
    namespace: Arc<File>,
    cable: Arc<OwnedFd>,
}

/// Why there are no hosts here.
#[derive(Debug)]
pub enum NoHost {
    /// This machine does not let us make namespaces: nothing can be tested here.
    NotAllowed(io::Error),
    /// Namespaces work, but something else does not.
    Broken(&'static str, io::Error),
}

impl Host {
    /// Makes one. The namespace ends with the last process in it and the last copy of this.
    pub fn new(address: Ipv4Addr) -> Result<Host, NoHost> {
        // The namespace is a thread's; this one ends, the test's own thread stays where it is.
        std::thread::spawn(move || make(address))
            .join()
            .expect("a host is made or refused")
    }

    /// Moves the calling thread, and all that it starts from now on, into the host.
    pub fn enter(&self) -> io::Result<()> {
        // SAFETY: the descriptor is a network namespace's.
        checked(unsafe { libc::setns(self.namespace.as_raw_fd(), libc::CLONE_NEWNET) }).map(drop)
    }

    /// Does something in the host: a socket made there stays there.
    pub fn within<T: Send + 'static>(&self, what: impl FnOnce() -> T + Send + 'static) -> T {
        let host = self.clone();
        std::thread::spawn(move || {
            host.enter().expect("a host can be entered");
            what()
        })
        .join()
        .expect("what is done in a host does not panic")
    }

    /// For a child between fork and exec.
    pub fn namespace_fd(&self) -> i32 {
        self.namespace.as_raw_fd()
    }

    pub fn cable(&self) -> &Arc<OwnedFd> {
        &self.cable
    }
}

fn make(address: Ipv4Addr) -> Result<Host, NoHost> {
    // SAFETY: takes this thread alone into a new namespace.
    checked(unsafe { libc::unshare(libc::CLONE_NEWNET) }).map_err(NoHost::NotAllowed)?;
    let broken = |what| move |error| NoHost::Broken(what, error);
    let namespace =
        File::open("/proc/thread-self/ns/net").map_err(broken("opening the namespace"))?;
    let cable = cable().map_err(broken("making a TUN device"))?;
    up("lo", None).map_err(broken("bringing the loopback up"))?;
    up(CABLE, Some(address)).map_err(broken("giving the cable its address"))?;
    Ok(Host {
        address,
        namespace: Arc::new(namespace),
        cable: Arc::new(cable),
    })
}

fn checked(result: i32) -> io::Result<i32> {
    if result < 0 {
        Err(io::Error::last_os_error())
    } else {
        Ok(result)
    }
}

/// A TUN device of this thread's namespace: what is written to it arrives there, what is sent there can be read.
fn cable() -> io::Result<OwnedFd> {
    let open = |path: &str| {
        let file = File::options().read(true).write(true).open(path)?;
        Ok::<OwnedFd, io::Error>(file.into())
    };
    let tun = match open(TUN) {
        Ok(tun) => tun,
        // Containers often have the driver, but no device file.
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let dir = tempfile::tempdir()?;
            let path = dir.path().join("tun");
            let name = std::ffi::CString::new(path.display().to_string())?;
            let device = libc::makedev(TUN_NUMBER.0, TUN_NUMBER.1);
            // SAFETY: the name ends with 0.
            checked(unsafe { libc::mknod(name.as_ptr(), libc::S_IFCHR | 0o600, device) })?;
            open(&path.display().to_string())?
        }
        Err(error) => return Err(error),
    };
    let mut request = named(CABLE);
    // The two flags fit: TUN (1) without packet information (4096).
    request.ifr_ifru.ifru_flags = (libc::IFF_TUN | libc::IFF_NO_PI) as i16;
    // SAFETY: the request is a whole ifreq.
    checked(unsafe { libc::ioctl(tun.as_raw_fd(), libc::TUNSETIFF as _, &raw mut request) })?;
    // SAFETY: a descriptor of ours; the relay must not wait in a read.
    checked(unsafe { libc::fcntl(tun.as_raw_fd(), libc::F_SETFL, libc::O_NONBLOCK) })?;
    Ok(tun)
}

fn named(interface: &str) -> libc::ifreq {
    // SAFETY: an ifreq of zeros is valid.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    for (to, from) in request.ifr_name.iter_mut().zip(interface.bytes()) {
        *to = from.cast_signed();
    }
    request
}

fn up(interface: &str, address: Option<Ipv4Addr>) -> io::Result<()> {
    // SAFETY: makes a socket, which is owned from here on.
    let socket =
        unsafe { OwnedFd::from_raw_fd(checked(libc::socket(libc::AF_INET, libc::SOCK_DGRAM, 0))?) };
    let set = |what: libc::c_ulong, request: &mut libc::ifreq| {
        // SAFETY: the request is a whole ifreq.
        checked(unsafe { libc::ioctl(socket.as_raw_fd(), what as _, request) })
    };
    if let Some(address) = address {
        for (what, value) in [
            (libc::SIOCSIFADDR, address),
            (libc::SIOCSIFNETMASK, NETMASK),
        ] {
            let mut request = named(interface);
            // SAFETY: an IPv4 address is a socket address of this family, and fits.
            unsafe {
                let at = (&raw mut request.ifr_ifru.ifru_addr).cast::<libc::sockaddr_in>();
                (*at).sin_family = libc::AF_INET as u16;
                (*at).sin_addr.s_addr = u32::from(value).to_be();
            }
            set(what, &mut request)?;
        }
    }
    let mut request = named(interface);
    request.ifr_ifru.ifru_flags = (libc::IFF_UP | libc::IFF_RUNNING) as i16;
    set(libc::SIOCSIFFLAGS, &mut request).map(drop)
}
