//! A feeding lane: gravity magazines, a pusher, the nest where a part is checked, a probe over the nest, an ejector.

use crate::cylinder::Cylinder;
use crate::incident::IncidentKind;
use crate::part::{PartId, PartKind};
use crate::plant::TICK_US;
use crate::records::Records;

/// Time for the next part to fall to the bottom of a magazine.
const DROP_US: u32 = 200_000;

/// One magazine of a lane.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Magazine {
    bottom: Option<PartId>,
    /// Parts that have come out of it.
    fed: u32,
    falling_us: u32,
}

/// Outputs that move a lane in one tick.
#[derive(Clone, Copy)]
pub(crate) struct LaneCommand {
    pub push: bool,
    pub probe: bool,
    pub eject: bool,
    /// Magazine that stands before the pusher; `None` between two.
    pub selected: Option<u16>,
    /// The selector or turret moves.
    pub selecting: bool,
    /// The stroke on which the part in the nest stops the probe.
    pub probe_limit_us: u32,
}

/// What the hand does over the nest of a lane.
#[derive(Clone, Copy)]
pub(crate) struct HandAtNest {
    /// The hand is over this nest and not up.
    pub low: bool,
    /// The part that it holds down in this nest.
    pub holds: Option<PartId>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Lane {
    unit: u8,
    kind: PartKind,
    magazines: Vec<Magazine>,
    selected: Option<u16>,
    pub pusher: Cylinder,
    /// The part before the pusher on its way to the nest, and how far it has come.
    front: Option<(PartId, u32)>,
    pub probe: Cylinder,
    pub ejector: Cylinder,
    pub nest: Option<PartId>,
}

/// Strokes of a lane.
pub(crate) struct LaneStrokes {
    pub pusher_us: u32,
    pub probe_us: u32,
    pub ejector_us: u32,
}

impl Lane {
    pub fn new(unit: u8, kind: PartKind, magazines: u8, strokes: LaneStrokes) -> Self {
        let empty = Magazine {
            bottom: None,
            fed: 0,
            falling_us: 0,
        };
        Lane {
            unit,
            kind,
            magazines: vec![empty; usize::from(magazines)],
            selected: Some(0),
            pusher: Cylinder::new(strokes.pusher_us),
            front: None,
            probe: Cylinder::new(strokes.probe_us),
            ejector: Cylinder::new(strokes.ejector_us),
            nest: None,
        }
    }

    pub fn step(&mut self, command: LaneCommand, hand: HandAtNest, records: &mut Records) {
        self.selected = command.selected;
        self.pusher.step(command.push);
        self.probe.step_towards(if command.probe {
            command.probe_limit_us
        } else {
            0
        });
        self.ejector.step(command.eject);
        self.feed(records);
        let carrying = self.carry();
        self.watch_collisions(command.selecting, carrying, hand, records);
        self.arrive(hand, records);
        if self.ejector.is_out()
            && let Some(part) = self.nest.take()
        {
            records.reject(part);
        }
    }

    /// A part lies at the bottom of the magazine before the pusher.
    pub fn has_part(&self) -> bool {
        self.before_pusher()
            .is_some_and(|magazine| magazine.bottom.is_some())
    }

    /// The part that sensors at the nest see: lying there, or held down there by the hand.
    pub fn sensed(&self, hand: HandAtNest) -> Option<PartId> {
        self.nest.or(hand.holds)
    }

    pub fn parts(&self) -> impl Iterator<Item = PartId> + '_ {
        let bottoms = self.magazines.iter().filter_map(|magazine| magazine.bottom);
        bottoms
            .chain(self.front.map(|(part, _)| part))
            .chain(self.nest)
    }

    fn before_pusher(&self) -> Option<&Magazine> {
        self.magazines.get(usize::from(self.selected?))
    }

    /// Parts fall to free bottoms; behind the pusher's head, and behind a part left half-way, nothing falls.
    fn feed(&mut self, records: &mut Records) {
        let blocked = if self.pusher.is_home() && self.front.is_none() {
            None
        } else {
            self.selected
        };
        for (index, magazine) in self.magazines.iter_mut().enumerate() {
            if magazine.bottom.is_some() || blocked == Some(index as u16) {
                magazine.falling_us = 0;
                continue;
            }
            magazine.falling_us += TICK_US;
            if magazine.falling_us >= DROP_US {
                magazine.falling_us = 0;
                magazine.fed += 1;
                magazine.bottom = Some(records.feed(self.kind, index as u8, magazine.fed));
            }
        }
    }

    /// The pusher takes the part before it along. Returns whether it has moved a part in this tick.
    fn carry(&mut self) -> bool {
        if self.pusher.direction <= 0 {
            return false;
        }
        if self.front.is_none()
            && let Some(index) = self.selected
            && let Some(magazine) = self.magazines.get_mut(usize::from(index))
        {
            self.front = magazine.bottom.take().map(|part| (part, 0));
        }
        match &mut self.front {
            Some((_, progress_us)) if self.pusher.position_us > *progress_us => {
                *progress_us = self.pusher.position_us;
                true
            }
            _ => false,
        }
    }

    fn arrive(&mut self, hand: HandAtNest, records: &mut Records) {
        let Some((part, progress_us)) = self.front else {
            return;
        };
        if progress_us < self.pusher.travel_us {
            return;
        }
        self.front = None;
        match self.nest.or(hand.holds) {
            None => self.nest = Some(part),
            Some(there) => {
                records.damage(part);
                records.damage(there);
                let cause = format!("{part} was pushed into the nest where {there} lies");
                records.note(self.unit, IncidentKind::TwoPartsInOnePlace, cause);
                records.lose(part);
            }
        }
    }

    fn watch_collisions(
        &self,
        selecting: bool,
        carrying: bool,
        hand: HandAtNest,
        records: &mut Records,
    ) {
        let level = self.kind.level();
        let kind = self.kind.name();
        let front = self.front.map(|(part, _)| part);
        let at_nest = self.nest.or(hand.holds);
        let probe_low = !self.probe.is_home();
        let ejector_out = !self.ejector.is_home();
        let pusher_out = !self.pusher.is_home();
        let mut collision = |name, active, harmed: &[Option<PartId>], what: &str| {
            records.watch(
                (self.unit, name, level),
                active,
                IncidentKind::Collision,
                harmed,
                || format!("{kind} lane: {what}"),
            );
        };
        collision(
            "pusher against probe",
            carrying && probe_low,
            &[front, at_nest],
            "the pusher carries a part in while the measuring cylinder or head is not at home",
        );
        collision(
            "pusher against hand",
            carrying && hand.low,
            &[front, at_nest],
            "the pusher carries a part in while the hand is not up over the nest",
        );
        collision(
            "ejector against pusher",
            ejector_out && pusher_out,
            &[at_nest],
            "the ejector is out while the pusher is not at home",
        );
        collision(
            "ejector against probe",
            ejector_out && probe_low,
            &[at_nest],
            "the ejector is out while the measuring cylinder or head is not at home",
        );
        collision(
            "ejector against hand",
            ejector_out && hand.low,
            &[at_nest],
            "the ejector is out while the hand is not up over the nest",
        );
        collision(
            "probe against hand",
            probe_low && hand.low,
            &[at_nest],
            "the hand is not up over the nest while the measuring cylinder or head is not at home",
        );
        collision(
            "magazine moves",
            selecting && pusher_out,
            &[front],
            "the magazines move while the pusher is not at home",
        );
        collision(
            "magazine between",
            self.selected.is_none() && pusher_out,
            &[],
            "the pusher moves out between two magazines",
        );
    }
}
