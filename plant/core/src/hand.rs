//! The suction hand of stations 1 to 3: a lift with a suction cup at the end of an arm.

use crate::cylinder::Cylinder;
use crate::incident::IncidentKind;
use crate::lane::HandAtNest;
use crate::part::PartId;
use crate::plant::TICK_US;
use crate::records::Records;
use crate::transport::{Pallet, StopState};

const LIFT_US: u32 = 150_000;
const GRIP_US: u32 = 60_000;
const RELEASE_US: u32 = 40_000;

/// What is under the arm.
pub(crate) enum Under<'a> {
    Nest(&'a mut Option<PartId>),
    /// The place over the stop; a pallet only if one is lifted there.
    Pallet(Option<&'a mut Pallet>),
    Between,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Hand {
    unit: u8,
    pub lift: Cylinder,
    pub held: Option<PartId>,
    /// How long suction has been on over a part, or off under a held one.
    changing_us: u32,
}

impl Hand {
    pub fn new(unit: u8) -> Self {
        Hand {
            unit,
            lift: Cylinder::new(LIFT_US),
            held: None,
            changing_us: 0,
        }
    }

    /// One tick. `over` tells what is under the arm, `stop` how the pallet place of this station is.
    pub fn step(
        &mut self,
        lower: bool,
        suction: bool,
        mut over: Under<'_>,
        stop: StopState,
        records: &mut Records,
    ) {
        self.lift.step(lower);
        let unit = self.unit;
        let low = !self.lift.is_home();
        let between = matches!(over, Under::Between);
        records.watch(
            (unit, "arm with low hand", 0),
            low && between,
            IncidentKind::Collision,
            &[self.held],
            || "the arm is away from its ends while the hand is not up".to_string(),
        );
        let in_pallet = low && matches!(over, Under::Pallet(_));
        watch_pallet(
            unit,
            "the hand is not up over the pallet",
            in_pallet,
            stop,
            self.held,
            records,
        );
        self.watch_occupied(&over, records);
        self.grip(suction, &mut over, records);
    }

    pub fn at_nest(&self, over_nest: bool) -> HandAtNest {
        HandAtNest {
            low: over_nest && !self.lift.is_home(),
            holds: if over_nest && self.lift.is_out() {
                self.held
            } else {
                None
            },
        }
    }

    fn watch_occupied(&self, over: &Under<'_>, records: &mut Records) {
        let there = match (over, self.held) {
            (Under::Nest(nest), Some(_)) => **nest,
            (Under::Pallet(Some(pallet)), Some(part)) => {
                pallet.stack.get(part.kind.level()).copied()
            }
            _ => None,
        };
        let active = there.is_some() && self.lift.is_out();
        let (unit, held) = (self.unit, self.held);
        records.watch(
            (unit, "lowered onto a part", 0),
            active,
            IncidentKind::TwoPartsInOnePlace,
            &[held, there],
            || match (held, there) {
                (Some(held), Some(there)) => {
                    format!("{held} was lowered onto the place where {there} lies")
                }
                _ => "a part was lowered onto an occupied place".to_string(),
            },
        );
    }

    fn grip(&mut self, suction: bool, over: &mut Under<'_>, records: &mut Records) {
        let part_under = match over {
            Under::Nest(nest) => nest.is_some(),
            Under::Pallet(Some(pallet)) => !pallet.stack.is_empty(),
            Under::Pallet(None) | Under::Between => false,
        };
        let takes = self.held.is_none() && suction && self.lift.is_out() && part_under;
        let lets_go = self.held.is_some() && !suction;
        if !takes && !lets_go {
            self.changing_us = 0;
            return;
        }
        self.changing_us += TICK_US;
        if takes && self.changing_us >= GRIP_US {
            self.changing_us = 0;
            self.held = match over {
                Under::Nest(nest) => nest.take(),
                Under::Pallet(Some(pallet)) => pallet.stack.pop(),
                Under::Pallet(None) | Under::Between => None,
            };
        } else if lets_go && self.changing_us >= RELEASE_US {
            self.changing_us = 0;
            if let Some(part) = self.held.take() {
                self.let_go(part, over, records);
            }
        }
    }

    fn let_go(&self, part: PartId, over: &mut Under<'_>, records: &mut Records) {
        let (kind, cause) = match over {
            _ if !self.lift.is_out() => (
                IncidentKind::PartDropped,
                "the suction let go with the hand not fully down",
            ),
            Under::Between => (IncidentKind::PartDropped, "the suction let go on the way"),
            Under::Nest(nest) if nest.is_none() => {
                **nest = Some(part);
                return;
            }
            Under::Nest(_) => (IncidentKind::PartDropped, "the nest is occupied"),
            Under::Pallet(None) => (IncidentKind::PartLost, "no pallet is lifted under the hand"),
            Under::Pallet(Some(pallet)) => {
                let level = part.kind.level();
                if pallet.stack.len() == level {
                    pallet.stack.push(part);
                    records.ledger.placed += 1;
                    return;
                }
                if pallet.stack.len() > level {
                    (
                        IncidentKind::PartDropped,
                        "its place on the pallet is occupied",
                    )
                } else {
                    (IncidentKind::PartLost, "it has nothing to stand on")
                }
            }
        };
        records.damage(part);
        records.note(self.unit, kind, format!("{part} fell: {cause}"));
        records.lose(part);
    }
}

/// Collisions of a hand or fork that reaches into the pallet place of its station.
pub(crate) fn watch_pallet(
    unit: u8,
    who: &str,
    reaches_in: bool,
    stop: StopState,
    held: Option<PartId>,
    records: &mut Records,
) {
    let mut collision = |name, active, what: &str| {
        records.watch(
            (unit, name, 0),
            active,
            IncidentKind::Collision,
            &[held],
            || format!("{who} while {what}"),
        );
    };
    collision(
        "reach against lifter",
        reaches_in && stop.lifter_moves,
        "the lifter moves",
    );
    collision(
        "reach against moving pallet",
        reaches_in && stop.pallet_passes,
        "a pallet is on its way through",
    );
    collision(
        "reach into loose pallet",
        reaches_in && stop.pallet_at_stop && !stop.lifter_up && !stop.lifter_moves,
        "the pallet stands there unlifted",
    );
}
