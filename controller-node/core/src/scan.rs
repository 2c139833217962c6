//! One tick of the scan thread: the records first, then each active MC that is due, a frame for each scan.
//!
//! In steady state a tick allocates nothing and takes no lock: checkpoints go into buffers made beforehand, frames
//! leave as handles for another thread. What the control plane wants comes as [`ScanCommand`]s before the tick.

pub use crate::active::ScannedFrame;
use crate::active::{ActiveMc, Mode, PendingRelease};
use crate::newest::Newest;
use crate::record::{LastWord, Verdict, judge};
use crate::runtime::McRuntime;
use crate::workload::Workload;
use fam_proto::access::{McAct, McNews};
use fam_proto::{Epoch, GatewayId, InputImage, Now, Owner, Phase};
use std::collections::BTreeMap;
use std::sync::Arc;

/// An image is fresh if it came within this many ticks, by the node's clock.
pub const FRESH_TICKS: u64 = 3;
/// Gateways whose images are kept, at most.
pub const GATEWAYS_MAX: usize = 64;

/// What a tick needs of its thread.
pub trait ScanHost<R> {
    /// CPU time of this thread, in nanoseconds.
    fn cpu_ns(&mut self) -> u64;
    /// A scan begins (`Some(index)`) or has ended: for a watchdog against endless loops.
    fn scanning(&mut self, mc: Option<usize>);
    /// Spends so much CPU time: a slower controller on a fast machine.
    fn spend_ns(&mut self, ns: u64);
    /// A frame to be sent. Must not wait.
    fn frame(&mut self, frame: ScannedFrame);
    /// News for the MC's agent. Must not wait.
    fn news(&mut self, mc: usize, news: McNews);
    /// The MC is passive again. Comes before the news that tells of it.
    fn returned(&mut self, mc: Box<ActiveMc<R>>);
}

/// What reaches the scan thread from the control plane.
pub enum ScanCommand<R> {
    /// Run this from the next tick on, or at once if its activation says so ([`ScanCore::start_at_once`]).
    Activate(Box<ActiveMc<R>>),
    /// An act on an active MC, by its place among the MCs of the node.
    Act {
        /// Which MC.
        mc: usize,
        /// What to do; `ReadState` and `Activate` are the replica's.
        act: McAct,
    },
}

/// The newest image of one gateway.
struct Seen {
    image: Arc<InputImage>,
    at: Now,
    newest: Newest,
}

/// The state of the scan thread.
pub struct ScanCore<R> {
    owner: Owner,
    tick_us: u64,
    cpu_factor_permille: u32,
    slots: Vec<Option<Box<ActiveMc<R>>>>,
    images: BTreeMap<GatewayId, Seen>,
    ticks: u64,
}

/// What becomes of an active MC in a tick.
enum Fate {
    Stays,
    Leaves(McNews),
}

impl<R: McRuntime> ScanCore<R> {
    /// A scan thread for `mcs` MCs. A CPU factor above 1000 is taken as 1000: no machine can be made faster.
    #[must_use]
    pub fn new(owner: Owner, tick_us: u32, cpu_factor_permille: u32, mcs: usize) -> ScanCore<R> {
        ScanCore {
            owner,
            tick_us: u64::from(tick_us.max(1)),
            cpu_factor_permille: cpu_factor_permille.clamp(1, 1_000),
            slots: (0..mcs).map(|_| None).collect(),
            images: BTreeMap::new(),
            ticks: 0,
        }
    }

    /// A gateway's image that came at `at`; one that is not newer than the known, or cannot be, is dropped.
    pub fn image(&mut self, image: Arc<InputImage>, at: Now) {
        let room = self.images.len() < GATEWAYS_MAX;
        match self.images.get_mut(&image.gateway) {
            // Numbers grow over restarts of the gateway, which boot ids need not do: they come from a wall clock.
            Some(seen) => {
                let newer = seen.newest.admit(image.boot, image.number, at);
                if newer {
                    (seen.image, seen.at) = (image, at);
                }
            }
            None if room => {
                let mut newest = Newest::default();
                newest.admit(image.boot, image.number, at);
                let gateway = image.gateway.clone();
                self.images.insert(gateway, Seen { image, at, newest });
            }
            None => {}
        }
    }

    /// Carries out a command; between ticks.
    pub fn command(&mut self, command: ScanCommand<R>, now: Now, host: &mut impl ScanHost<R>) {
        match command {
            ScanCommand::Activate(mut active) => {
                let (index, epoch) = (active.spec.index, active.epoch);
                active.due = self.ticks;
                // There is one instance of each MC, so that its slot is empty; if not, it is the newer epoch that counts.
                if let Some(old) = self.slots[index].replace(active) {
                    host.returned(old);
                }
                host.news(index, McNews::Started { epoch });
            }
            ScanCommand::Act { mc, act } => {
                if let Fate::Leaves(news) = self.act(mc, act, now, host) {
                    self.leave(mc, Some(news), host);
                }
            }
        }
    }

    fn act(&mut self, index: usize, act: McAct, now: Now, host: &mut impl ScanHost<R>) -> Fate {
        let Some(active) = self.slots.get_mut(index).and_then(Option::as_mut) else {
            return Fate::Stays;
        };
        let own = active.epoch;
        match act {
            McAct::Release {
                epoch,
                successor,
                within_us,
            } if epoch == own && active.mode == Mode::Scans => {
                active.release = Some(PendingRelease {
                    successor,
                    until: now.plus_us(within_us),
                    within_us,
                });
            }
            McAct::CancelRelease { epoch } if epoch == own => {
                if active.release.take().is_some() {
                    let why = "the manager has called it off".to_owned();
                    host.news(index, McNews::ReleaseCancelled { epoch, why });
                }
            }
            McAct::RunAction { epoch, action } if epoch == own && active.mode != Mode::Ended => {
                active.run_action(action);
            }
            McAct::Deactivate { epoch } if epoch == own => {
                return Fate::Leaves(McNews::Deposed {
                    epoch,
                    why: "deactivated".to_owned(),
                });
            }
            McAct::Release { .. }
            | McAct::CancelRelease { .. }
            | McAct::RunAction { .. }
            | McAct::Deactivate { .. }
            | McAct::ReadState { .. }
            | McAct::Adopt { .. }
            | McAct::Activate(_) => {}
        }
        Fate::Stays
    }

    fn leave(&mut self, index: usize, news: Option<McNews>, host: &mut impl ScanHost<R>) {
        if let Some(active) = self.slots[index].take() {
            host.returned(active);
        }
        if let Some(news) = news {
            host.news(index, news);
        }
    }

    /// The first scans of MCs whose predecessor was interrupted: they are late already. To be called after commands that
    /// come between ticks.
    pub fn start_at_once(&mut self, now: Now, host: &mut impl ScanHost<R>) {
        for index in 0..self.slots.len() {
            let starts = |a: &mut Box<ActiveMc<R>>| std::mem::take(&mut a.at_once);
            if self.slots[index].as_mut().is_some_and(starts) {
                self.turn(index, now, host);
            }
        }
    }

    /// One tick.
    pub fn tick(&mut self, now: Now, host: &mut impl ScanHost<R>) {
        self.ticks += 1;
        for index in 0..self.slots.len() {
            self.turn(index, now, host);
        }
    }

    /// What an active MC has to do now, if it is due.
    fn turn(&mut self, index: usize, now: Now, host: &mut impl ScanHost<R>) {
        let Some(active) = self.slots[index].as_mut() else {
            return;
        };
        let seen = self.images.get(&active.spec.gateway);
        let fate = match seen {
            Some(seen) => judged(active, seen, &self.owner),
            None => Fate::Stays,
        };
        if let Fate::Leaves(news) = fate {
            self.leave(index, Some(news), host);
            return;
        }
        overdue_release(active, now, host);
        let cycle_ticks = (u64::from(active.spec.cycle_us) / self.tick_us).max(1);
        if active.due > self.ticks {
            return;
        }
        match active.mode {
            Mode::Trapped => {}
            Mode::Ended => {
                active.due = self.ticks + cycle_ticks;
                if let Some(mut last) = active.last.clone() {
                    last.acknowledged = active.acknowledged;
                    host.frame(last);
                }
            }
            Mode::Scans => {
                let fresh_us = FRESH_TICKS * self.tick_us;
                match seen.and_then(|seen| fresh_inputs(active, seen, now, fresh_us)) {
                    Some((number, bytes)) => {
                        active.due = self.ticks + cycle_ticks;
                        let scan = Scanning {
                            now,
                            cpu_factor_permille: self.cpu_factor_permille,
                        };
                        scan.run(active, number, bytes, host);
                    }
                    None => active.work.starved += 1,
                }
            }
        }
    }

    /// Counts of the active MCs: place, epoch, counts, lag in microseconds.
    pub fn loads(&self, now: Now) -> impl Iterator<Item = (usize, Epoch, Workload, u64)> {
        self.slots.iter().flatten().map(move |active| {
            let lag_us = active.work.lag_us(now, active.spec.cycle_us);
            (active.spec.index, active.epoch, active.work, lag_us)
        })
    }

    /// An active MC, by its place.
    #[must_use]
    pub fn active(&self, mc: usize) -> Option<&ActiveMc<R>> {
        self.slots.get(mc)?.as_deref()
    }
}

/// Reads the record of an active MC.
fn judged<R: McRuntime>(active: &mut ActiveMc<R>, seen: &Seen, owner: &Owner) -> Fate {
    let Some(record) = seen.image.record_of(&active.spec.mc) else {
        return Fate::Stays;
    };
    let epoch = active.epoch;
    let last_word = active.last_word();
    match judge(record, owner, epoch, last_word) {
        Verdict::Late => Fate::Stays,
        Verdict::Drives(acknowledged) => {
            if acknowledged.is_some() {
                active.acknowledged = acknowledged;
                active.base_bytes = None;
            }
            Fate::Stays
        }
        Verdict::Acknowledged => {
            let scan = active.last.as_ref().map_or(active.next_scan, |l| l.scan);
            Fate::Leaves(match last_word {
                LastWord::Stopped => McNews::Stopped { epoch, scan },
                LastWord::Released(_) | LastWord::None => McNews::Released { epoch, scan },
            })
        }
        Verdict::Deposed(why) => Fate::Leaves(McNews::Deposed { epoch, why }),
    }
}

fn overdue_release<R: McRuntime>(active: &mut ActiveMc<R>, now: Now, host: &mut impl ScanHost<R>) {
    let overdue = active.release.as_ref().is_some_and(|r| r.until <= now);
    if !overdue {
        return;
    }
    if let Some(release) = active.release.take() {
        let held = match (active.phase, active.critical_interval()) {
            (Phase::Running, Some(name)) => format!("in critical interval {name}"),
            (Phase::Running, None) => "without a fresh input image".to_owned(),
            _ => "in a recovery action".to_owned(),
        };
        let why = format!("{} ms have passed {held}", release.within_us / 1_000);
        host.news(
            active.spec.index,
            McNews::ReleaseCancelled {
                epoch: active.epoch,
                why,
            },
        );
    }
}

/// The inputs to scan on, if they are fresh: come lately, read from the field, and no older than the checkpoint's.
fn fresh_inputs<'a, R: McRuntime>(
    active: &ActiveMc<R>,
    seen: &'a Seen,
    now: Now,
    fresh_us: u64,
) -> Option<(fam_proto::ImageNumber, &'a [u8])> {
    if now.since_us(seen.at) > fresh_us || seen.image.number < active.image {
        return None;
    }
    let inputs = seen.image.inputs_of(&active.spec.mc)?;
    let fits = inputs.bytes.len() == active.spec.inputs_len;
    (inputs.fresh && fits).then_some((seen.image.number, inputs.bytes.as_slice()))
}

/// One scan of one MC.
struct Scanning {
    now: Now,
    cpu_factor_permille: u32,
}

impl Scanning {
    fn run<R: McRuntime>(
        &self,
        active: &mut ActiveMc<R>,
        image: fam_proto::ImageNumber,
        inputs: &[u8],
        host: &mut impl ScanHost<R>,
    ) {
        let (index, epoch) = (active.spec.index, active.epoch);
        let before = active.phase;
        let from_ns = host.cpu_ns();
        host.scanning(Some(index));
        let result = active.scan(image, inputs);
        host.scanning(None);
        let ended_ns = host.cpu_ns();
        let cpu_ns = self.slowed(ended_ns.saturating_sub(from_ns), host);
        if let Err(trap) = result {
            active.mode = Mode::Trapped;
            host.news(index, McNews::Trapped { epoch, trap });
            return;
        }
        let ran_ns = if cpu_ns == ended_ns.saturating_sub(from_ns) {
            ended_ns
        } else {
            host.cpu_ns()
        };
        let buffer = active.capture();
        let capture_ns = host.cpu_ns().saturating_sub(ran_ns);
        active.work.scanned(self.now, cpu_ns);
        if active.phase == Phase::Running && matches!(before, Phase::Recovering(_)) {
            let scan = active.next_scan;
            host.news(index, McNews::Recovered { epoch, scan });
        }
        match buffer {
            None => active.work.unsent += 1,
            Some(buffer) => {
                // Tested on the very checkpoint that is marked.
                let releasable = active.release.is_some()
                    && active.phase == Phase::Running
                    && active.critical_interval().is_none();
                let released_to = if releasable {
                    active.release.take().map(|r| r.successor)
                } else {
                    None
                };
                let ended = released_to.is_some() || active.phase == Phase::Stopped;
                let scan_us = u32::try_from(cpu_ns / 1_000).unwrap_or(u32::MAX);
                let frame = active.frame(buffer, released_to, scan_us, capture_ns);
                if ended {
                    active.mode = Mode::Ended;
                    active.last = Some(frame.clone());
                }
                host.frame(frame);
            }
        }
        active.next_scan = active.next_scan.next();
    }

    /// Makes a CPU factor below 1 real, and gives the CPU time that the scan has taken on such a controller.
    fn slowed<R>(&self, cpu_ns: u64, host: &mut impl ScanHost<R>) -> u64 {
        let factor = u64::from(self.cpu_factor_permille);
        let more_ns = cpu_ns * (1_000 - factor) / factor;
        if more_ns > 0 {
            host.spend_ns(more_ns);
        }
        cpu_ns + more_ns
    }
}
