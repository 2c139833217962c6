//! The relay between all hosts: takes each packet from its sender's cable and puts it on the receiver's, or does not.

use super::{Host, NoHost};
use fam_simulation::simulator::Random;
use std::collections::{BTreeMap, BinaryHeap};
use std::net::Ipv4Addr;
use std::os::fd::{AsRawFd, OwnedFd};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Longest packet.
const PACKET_BYTES_MAX: usize = 65_536;
/// How often a relay thread looks whether its host is gone, in milliseconds.
const LOOK_MS: i32 = 100;
/// A packet that is overtaken comes so much later.
const OVERTAKEN: Duration = Duration::from_millis(8);
/// Packets on their way with a delay; further ones are lost, as in a router's full queue.
const DELAYED_MAX: usize = 200_000;

/// What becomes of packets in one direction between two hosts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Weather {
    pub cut: bool,
    pub delay: Duration,
    pub loss_permille: u64,
    pub twice_permille: u64,
    pub overtaken_permille: u64,
}

impl Weather {
    pub const CUT: Weather = Weather {
        cut: true,
        delay: Duration::ZERO,
        loss_permille: 0,
        twice_permille: 0,
        overtaken_permille: 0,
    };
}

struct Delayed {
    due: Instant,
    number: u64,
    to: Ipv4Addr,
    packet: Vec<u8>,
}

// The heap gives its greatest first: that is the one due first.
impl Ord for Delayed {
    fn cmp(&self, other: &Delayed) -> std::cmp::Ordering {
        (other.due, other.number).cmp(&(self.due, self.number))
    }
}
impl PartialOrd for Delayed {
    fn partial_cmp(&self, other: &Delayed) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl PartialEq for Delayed {
    fn eq(&self, other: &Delayed) -> bool {
        self.cmp(other).is_eq()
    }
}
impl Eq for Delayed {}

struct Shared {
    cables: Mutex<BTreeMap<Ipv4Addr, Arc<OwnedFd>>>,
    weather: Mutex<BTreeMap<(Ipv4Addr, Ipv4Addr), Weather>>,
    delayed: (Mutex<BinaryHeap<Delayed>>, Condvar),
    relayed: AtomicU64,
    hindered: AtomicU64,
    over: AtomicBool,
}

/// The relay, and the hosts that it connects.
pub struct Fabric {
    shared: Arc<Shared>,
    hosts: Vec<Ipv4Addr>,
}

fn lock<T>(of: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Default for Fabric {
    fn default() -> Fabric {
        let shared = Arc::new(Shared {
            cables: Mutex::default(),
            weather: Mutex::default(),
            delayed: (Mutex::default(), Condvar::new()),
            relayed: AtomicU64::new(0),
            hindered: AtomicU64::new(0),
            over: AtomicBool::new(false),
        });
        let late = shared.clone();
        std::thread::spawn(move || late.deliver_late());
        Fabric {
            shared,
            hosts: Vec::new(),
        }
    }
}

impl Fabric {
    /// Makes a host and connects it.
    pub fn host(&mut self, address: Ipv4Addr) -> Result<Host, NoHost> {
        let host = Host::new(address)?;
        self.connect(&host);
        self.hosts.push(address);
        Ok(host)
    }

    /// Connects a host that is there already.
    pub fn connect(&self, host: &Host) {
        let cable = host.cable().clone();
        lock(&self.shared.cables).insert(host.address, cable.clone());
        let (shared, from) = (self.shared.clone(), host.address);
        std::thread::spawn(move || shared.relay(from, &cable));
    }

    /// What becomes of packets from one host to the other.
    pub fn set(&self, from: &Host, to: &Host, weather: Weather) {
        lock(&self.shared.weather).insert((from.address, to.address), weather);
    }

    /// The same between all hosts, in both directions.
    pub fn set_all(&self, weather: Weather) {
        let mut all = lock(&self.shared.weather);
        for from in &self.hosts {
            for to in &self.hosts {
                all.insert((*from, *to), weather);
            }
        }
    }

    /// Pulls a host's cable, or puts it in again.
    pub fn set_host(&self, host: &Host, weather: Weather) {
        let mut all = lock(&self.shared.weather);
        for other in &self.hosts {
            all.insert((host.address, *other), weather);
            all.insert((*other, host.address), weather);
        }
    }

    /// All cables are whole again.
    pub fn mend(&self) {
        lock(&self.shared.weather).clear();
    }

    /// Packets relayed so far, and packets lost, delayed, doubled or overtaken.
    pub fn packets(&self) -> (u64, u64) {
        let read = |n: &AtomicU64| n.load(Ordering::Relaxed);
        (read(&self.shared.relayed), read(&self.shared.hindered))
    }
}

impl Drop for Fabric {
    fn drop(&mut self) {
        self.shared.over.store(true, Ordering::Relaxed);
        self.shared.delayed.1.notify_all();
    }
}

impl Shared {
    fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }

    /// One thread for each cable.
    fn relay(&self, from: Ipv4Addr, cable: &OwnedFd) {
        let mut random = Random::new(u64::from(u32::from(from)), 3);
        let mut buffer = vec![0_u8; PACKET_BYTES_MAX];
        while !self.is_over() {
            let mut ready = libc::pollfd {
                fd: cable.as_raw_fd(),
                events: libc::POLLIN,
                revents: 0,
            };
            // SAFETY: one descriptor of ours.
            if unsafe { libc::poll(&raw mut ready, 1, LOOK_MS) } <= 0 {
                continue;
            }
            loop {
                // SAFETY: reads into a buffer of that length.
                let n = unsafe {
                    libc::read(cable.as_raw_fd(), buffer.as_mut_ptr().cast(), buffer.len())
                };
                let Ok(n) = usize::try_from(n) else {
                    break;
                };
                if n == 0 {
                    break;
                }
                self.forward(from, &buffer[..n], &mut random);
            }
            if ready.revents & (libc::POLLERR | libc::POLLHUP | libc::POLLNVAL) != 0 {
                return;
            }
        }
    }

    fn forward(&self, from: Ipv4Addr, packet: &[u8], random: &mut Random) {
        // IPv4 alone: the kernel's announcements of version 6 have nobody to go to.
        let Some(to) = packet
            .get(16..20)
            .filter(|_| packet[0] >> 4 == 4)
            .map(|b| Ipv4Addr::new(b[0], b[1], b[2], b[3]))
        else {
            return;
        };
        let weather = lock(&self.weather)
            .get(&(from, to))
            .copied()
            .unwrap_or_default();
        if weather.cut || random.chance(weather.loss_permille) {
            self.hindered.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let mut delay = weather.delay;
        if random.chance(weather.overtaken_permille) {
            delay += OVERTAKEN;
        }
        let copies = 1 + usize::from(random.chance(weather.twice_permille));
        if copies > 1 || !delay.is_zero() {
            self.hindered.fetch_add(1, Ordering::Relaxed);
        }
        for _ in 0..copies {
            if delay.is_zero() {
                self.put(to, packet);
            } else {
                self.put_late(to, packet, delay);
            }
        }
    }

    fn put(&self, to: Ipv4Addr, packet: &[u8]) {
        let Some(cable) = lock(&self.cables).get(&to).cloned() else {
            return;
        };
        self.relayed.fetch_add(1, Ordering::Relaxed);
        // SAFETY: writes from a buffer of that length. A host that is gone takes nothing, which is what a cable does too.
        unsafe { libc::write(cable.as_raw_fd(), packet.as_ptr().cast(), packet.len()) };
    }

    fn put_late(&self, to: Ipv4Addr, packet: &[u8], delay: Duration) {
        let mut waiting = lock(&self.delayed.0);
        if waiting.len() < DELAYED_MAX {
            let number = self.relayed.load(Ordering::Relaxed) + waiting.len() as u64;
            waiting.push(Delayed {
                due: Instant::now() + delay,
                number,
                to,
                packet: packet.to_vec(),
            });
            self.delayed.1.notify_all();
        }
    }

    fn deliver_late(&self) {
        let mut waiting = lock(&self.delayed.0);
        while !self.is_over() {
            let now = Instant::now();
            let wait = match waiting.peek() {
                Some(first) if first.due <= now => {
                    if let Some(first) = waiting.pop() {
                        drop(waiting);
                        self.put(first.to, &first.packet);
                        waiting = lock(&self.delayed.0);
                    }
                    continue;
                }
                Some(first) => first.due - now,
                None => Duration::from_millis(u64::from(LOOK_MS.unsigned_abs())),
            };
            waiting = self
                .delayed
                .1
                .wait_timeout(waiting, wait)
                .unwrap_or_else(PoisonError::into_inner)
                .0;
        }
    }
}
