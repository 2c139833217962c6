//! What the applied frames of a soak say, taken piece by piece: nothing of it grows with the hours but what went wrong.

use super::chaos::{Fault, GATEWAY, Kind};
use crate::bench::Witness;
use crate::chain::{Chain, starts_beyond_what_was_seen};
use fam_gateway_core::recorder::Takeover;
use fam_proto::{Applied, Event, EventKind, McId};
use std::collections::BTreeMap;
use std::fmt;

/// An MC that is driven by nobody for so long, with manager, gateway and a controller whole all the time, is stuck.
const STUCK_US: u64 = 15_000_000;
/// A machine that stalled within this time before a takeover may have caused it, in microseconds.
const STALL_BEFORE_US: u64 = 300_000;
/// Troubles kept in words.
const TROUBLES_MAX: usize = 200;

/// Counts of one soak.
#[derive(Debug, Default)]
pub struct Ledger {
    /// Frames applied.
    pub scans: u64,
    /// Takeovers after a fault of the old owner, or of the gateway.
    pub failovers: u64,
    /// Takeovers that no fault explains.
    pub false_failovers: u64,
    /// Of the same kind, while the machine itself stalled.
    pub false_while_stalled: u64,
    /// Handovers that the old owner released.
    pub planned_moves: u64,
    /// Frames applied although another controller drove.
    pub double_driven: u64,
    /// Scans that were applied and not built on.
    pub lost: u64,
    /// MCs that went on with a recovery.
    pub recoveries: u64,
    /// MCs that were stopped, faulted or latched fail-safe, by kind of event.
    pub stops: BTreeMap<&'static str, u64>,
    /// Times that an MC was driven by nobody for too long.
    pub stuck: u64,
    /// Longest time between two applied frames of an MC, in microseconds.
    pub longest_gap_us: u64,
    chain: Chain,
    mcs: Vec<McId>,
    silent: BTreeMap<McId, u64>,
    troubles: Vec<String>,
}

impl Ledger {
    /// A ledger for these MCs.
    pub fn new(mcs: Vec<McId>) -> Ledger {
        Ledger {
            mcs,
            ..Ledger::default()
        }
    }

    /// What went wrong, in words.
    pub fn troubles(&self) -> &[String] {
        &self.troubles
    }

    fn trouble(&mut self, text: String) {
        if self.troubles.len() < TROUBLES_MAX {
            self.troubles.push(text);
        }
    }

    /// Takes the next piece of the journal.
    pub fn applied(&mut self, applied: &[Applied], faults: &[Fault], witness: &Witness) {
        if applied.is_empty() {
            return;
        }
        self.scans += applied.len() as u64;
        let shown = self.chain.take(applied);
        if shown.double_driven > 0 {
            self.double_driven += shown.double_driven;
            self.trouble(format!(
                "{} double-driven scan(s) among the {} frames up to {} us",
                shown.double_driven,
                applied.len(),
                applied.last().map_or(0, |a| a.at_us)
            ));
        }
        for takeover in &shown.takeovers {
            self.takeover(takeover, faults, witness);
        }
        self.longest_gap_us = self.longest_gap_us.max(shown.longest_gap_us);
    }

    fn takeover(&mut self, t: &Takeover, faults: &[Fault], witness: &Witness) {
        let restarted = faults.iter().any(|f| {
            f.kind == Kind::KillGateway
                && f.from_us <= t.first_us
                && f.touches(t.last_us, t.first_us)
        });
        let unseen = restarted && starts_beyond_what_was_seen(t);
        if t.scans_behind > 0 && !unseen {
            self.lost += t.scans_behind;
            self.trouble(format!(
                "{}: epoch {} goes on from scan {}, applied last was scan {} of epoch {}",
                t.mc, t.to.0, t.base_scan, t.last_scan, t.from.0
            ));
        }
        if t.released {
            self.planned_moves += 1;
            return;
        }
        let owner = t.from.1.controller.as_str();
        let explained = faults.iter().any(|f| {
            f.touches(t.last_us, t.first_us) && (f.target == owner || f.target == GATEWAY)
        });
        if explained {
            self.failovers += 1;
        } else if witness.stalled_between_us(t.last_us.saturating_sub(STALL_BEFORE_US), t.first_us)
        {
            self.false_while_stalled += 1;
        } else {
            self.false_failovers += 1;
            self.trouble(format!(
                "{} went from {} to {} (epoch {} to {}) at {} us without a fault of {}",
                t.mc, t.from.1, t.to.1, t.from.0, t.to.0, t.first_us, owner
            ));
        }
    }

    /// Takes new events of the manager.
    pub fn events(&mut self, events: &[Event]) {
        for event in events {
            let word = match event.kind {
                EventKind::McRecovering => {
                    self.recoveries += 1;
                    continue;
                }
                EventKind::McStopped => "stopped",
                EventKind::McFaulted => "faulted",
                EventKind::McFailSafe => "fail_safe",
                EventKind::McUnplaced => "unplaced",
                _ => continue,
            };
            *self.stops.entry(word).or_default() += 1;
            if matches!(event.kind, EventKind::McStopped | EventKind::McFaulted) {
                self.trouble(format!("{word}: {}", event.text));
            }
        }
    }

    /// Looks for MCs that nobody drives although somebody should.
    pub fn silence(&mut self, now_us: u64, calm_since_us: Option<u64>) {
        let Some(calm_since_us) = calm_since_us else {
            return;
        };
        for mc in self.mcs.clone() {
            let last_us = self.chain.head(&mc).map_or(0, |a| a.at_us);
            let since_us = last_us.max(calm_since_us);
            let told_us = self.silent.get(&mc).copied().unwrap_or(0);
            if now_us.saturating_sub(since_us) > STUCK_US && told_us != since_us {
                self.stuck += 1;
                self.silent.insert(mc.clone(), since_us);
                self.trouble(format!(
                    "{mc}: driven by nobody for {} s; last frame at {last_us} us",
                    STUCK_US / 1_000_000
                ));
            }
        }
    }
}

impl fmt::Display for Ledger {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} failovers, {} false ({} more while the machine stalled), {} planned moves; {} scans applied, {} double-driven, {} lost; {} stuck",
            self.failovers,
            self.false_failovers,
            self.false_while_stalled,
            self.planned_moves,
            self.scans,
            self.double_driven,
            self.lost,
            self.stuck
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fam_proto::{BootId, CheckpointId, ControllerId, Digest, Epoch, Owner, Phase, Scan};

    fn mc() -> McId {
        McId::new("Station1").unwrap()
    }

    fn entry(epoch: u64, by: &str, scan: u64, base: Option<(u64, u64)>) -> Applied {
        let digest = |scan: u64| Digest([u8::try_from(scan).unwrap(); 16]);
        Applied {
            mc: mc(),
            epoch: Epoch(epoch),
            owner: Owner {
                controller: ControllerId::new(by).unwrap(),
                boot: BootId(1),
            },
            scan: Scan(scan),
            digest: digest(scan),
            base: base.map(|(epoch, scan)| CheckpointId {
                epoch: Epoch(epoch),
                scan: Scan(scan),
                digest: digest(scan),
            }),
            phase: Phase::Running,
            released: false,
            at_us: scan * 5_000,
        }
    }

    fn fault(kind: Kind, target: &str, from_us: u64) -> Fault {
        Fault {
            kind,
            target: target.to_owned(),
            from_us,
            until_us: None,
        }
    }

    /// Takes the frames one by one, as pieces of their own, and tells failovers, false ones, lost and double-driven scans.
    fn judge(entries: &[Applied], faults: &[Fault]) -> (u64, u64, u64, u64) {
        let witness = Witness::start();
        let mut ledger = Ledger::new(vec![mc()]);
        for entry in entries {
            ledger.applied(std::slice::from_ref(entry), faults, &witness);
        }
        (
            ledger.failovers,
            ledger.false_failovers + ledger.false_while_stalled,
            ledger.lost,
            ledger.double_driven,
        )
    }

    #[test]
    fn takeovers_are_told_apart_also_when_the_journal_comes_in_pieces() {
        let first = [entry(1, "a", 1, None), entry(1, "a", 2, None)];
        let whole = entry(2, "b", 3, Some((1, 2)));
        let behind = entry(2, "b", 2, Some((1, 1)));
        let ahead = entry(2, "b", 5, Some((1, 4)));
        let back = entry(1, "a", 3, None);
        let killed = [fault(Kind::KillNode, "a", 9_000)];
        let restarted = [fault(Kind::KillGateway, GATEWAY, 9_000)];
        let other = [fault(Kind::KillNode, "b", 9_000)];
        for (name, next, faults, want) in [
            ("a kill", vec![whole.clone()], &killed[..], (1, 0, 0, 0)),
            ("no fault", vec![whole.clone()], &[], (0, 1, 0, 0)),
            ("another's fault", vec![whole.clone()], &other, (0, 1, 0, 0)),
            ("a scan lost", vec![behind.clone()], &killed, (1, 0, 1, 0)),
            (
                "a scan lost with the gateway",
                vec![behind],
                &restarted,
                (1, 0, 1, 0),
            ),
            (
                "a tick unseen before the gateway's end",
                vec![ahead.clone()],
                &restarted,
                (1, 0, 0, 0),
            ),
            (
                "a tick that was never applied",
                vec![ahead],
                &killed,
                (1, 0, 1, 0),
            ),
            ("two drivers", vec![whole, back], &killed, (1, 0, 0, 1)),
        ] {
            let all: Vec<Applied> = first.iter().cloned().chain(next).collect();
            assert_eq!(judge(&all, faults), want, "{name}");
        }
    }

    #[test]
    fn an_mc_that_nobody_drives_is_told_once() {
        let mut ledger = Ledger::new(vec![mc()]);
        ledger.silence(STUCK_US + 2, None);
        ledger.silence(STUCK_US + 2, Some(1));
        ledger.silence(STUCK_US + 3, Some(1));
        assert_eq!((ledger.stuck, ledger.troubles().len()), (1, 1));
    }
}
