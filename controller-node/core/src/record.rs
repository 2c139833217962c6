//! How the scan thread reads the gateway's record of an MC that it runs.

use fam_proto::{CheckpointId, Epoch, Owner, RecordState, RecordSummary, Successor};

/// What the MC has said last, if it was a last word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LastWord<'a> {
    /// It still runs.
    None,
    /// Released to this successor.
    Released(&'a Successor),
    /// Stopped safely.
    Stopped,
}

/// What the record means.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// It drives; the head of this epoch, if there is one, is acknowledged.
    Drives(Option<CheckpointId>),
    /// A word about an epoch before ours.
    Late,
    /// Our last word is on record.
    Acknowledged,
    /// It drives no more; why.
    Deposed(String),
}

/// Reads the record for an MC that runs under `epoch`.
pub(crate) fn judge(
    record: &RecordSummary,
    me: &Owner,
    epoch: Epoch,
    last_word: LastWord<'_>,
) -> Verdict {
    let other = || {
        let owner = record.owner.as_ref();
        owner.map_or_else(|| "nobody".to_owned(), ToString::to_string)
    };
    if record.epoch < epoch {
        return Verdict::Late;
    }
    if record.epoch > epoch {
        // The gateway opens a successor's epoch only from the released record.
        return match last_word {
            LastWord::Released(to)
                if to.epoch == record.epoch && Some(&to.owner) == record.owner.as_ref() =>
            {
                Verdict::Acknowledged
            }
            _ => Verdict::Deposed(format!(
                "epoch {} of {} is on record",
                record.epoch,
                other()
            )),
        };
    }
    if record.owner.as_ref() != Some(me) {
        return Verdict::Deposed(format!("epoch {epoch} is on record for {}", other()));
    }
    match (&record.state, last_word) {
        (RecordState::Open, _) => Verdict::Drives(record.head.filter(|head| head.epoch == epoch)),
        (RecordState::Never, _) => Verdict::Late,
        (RecordState::Released(to), LastWord::Released(ours)) if to == ours => {
            Verdict::Acknowledged
        }
        (RecordState::Stopped, LastWord::Stopped) => Verdict::Acknowledged,
        (state, _) => Verdict::Deposed(format!("epoch {epoch} is {} on record", state.word())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fam_proto::{BootId, ControllerId, Digest, McId, Scan, TrapInfo};

    fn owner(name: &str, boot: u64) -> Owner {
        Owner {
            controller: ControllerId::new(name).unwrap(),
            boot: BootId(boot),
        }
    }

    #[test]
    fn the_table_of_records() {
        let me = owner("a", 2);
        let to = Successor {
            epoch: Epoch(6),
            owner: owner("b", 1),
        };
        let head = |epoch| CheckpointId {
            epoch: Epoch(epoch),
            scan: Scan(3),
            digest: Digest::default(),
        };
        let trap = TrapInfo {
            pou: String::new(),
            file: String::new(),
            line: 0,
            message: String::new(),
        };
        use LastWord as L;
        use RecordState as S;
        let deposed = "deposed";
        let table: &[(u64, Owner, S, L<'_>, &str)] = &[
            (4, me.clone(), S::Open, L::None, "late"),
            (4, to.owner.clone(), S::FailSafe, L::None, "late"),
            (5, me.clone(), S::Open, L::None, "drives"),
            (5, me.clone(), S::Open, L::Released(&to), "drives"),
            (5, owner("a", 1), S::Open, L::None, deposed),
            (5, to.owner.clone(), S::Open, L::None, deposed),
            (
                5,
                me.clone(),
                S::Released(to.clone()),
                L::Released(&to),
                "acknowledged",
            ),
            (5, me.clone(), S::Released(to.clone()), L::None, deposed),
            (5, me.clone(), S::Closed, L::None, deposed),
            (5, me.clone(), S::Closed, L::Released(&to), deposed),
            (5, me.clone(), S::FailSafe, L::Stopped, deposed),
            (5, me.clone(), S::Stopped, L::Stopped, "acknowledged"),
            (5, me.clone(), S::Stopped, L::None, deposed),
            (5, me.clone(), S::Faulted(trap), L::None, deposed),
            (
                6,
                to.owner.clone(),
                S::Open,
                L::Released(&to),
                "acknowledged",
            ),
            (6, owner("c", 1), S::Open, L::Released(&to), deposed),
            (7, to.owner.clone(), S::Open, L::Released(&to), deposed),
            (6, to.owner.clone(), S::Open, L::None, deposed),
        ];
        for (epoch, owner, state, last, expected) in table {
            let record = RecordSummary {
                mc: McId::new("M").unwrap(),
                epoch: Epoch(*epoch),
                owner: Some(owner.clone()),
                state: state.clone(),
                head: Some(head(*epoch)),
                phase: None,
                driven: true,
                silent_us: 0,
                suspect: false,
                rejected: 0,
            };
            let got = match judge(&record, &me, Epoch(5), *last) {
                Verdict::Drives(acknowledged) => {
                    assert_eq!(acknowledged, Some(head(5)));
                    "drives"
                }
                Verdict::Late => "late",
                Verdict::Acknowledged => "acknowledged",
                Verdict::Deposed(_) => deposed,
            };
            assert_eq!(got, *expected, "{record:?} after {last:?}");
        }
    }
}
