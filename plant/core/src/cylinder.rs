//! Pneumatic cylinders and the indexing drives of arm and turret.
//!
//! A place on the stroke is the time that it takes to get there, in microseconds: exact, and independent of units of length.

use crate::incident::IncidentKind;
use crate::plant::TICK_US;
use crate::records::Records;

/// A cylinder on its stroke from home (0) to its end.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Cylinder {
    pub position_us: u32,
    pub travel_us: u32,
    /// Moved in the last tick: -1 towards home, 1 outwards, 0 at rest.
    pub direction: i8,
}

impl Cylinder {
    pub fn new(travel_us: u32) -> Self {
        Cylinder {
            position_us: 0,
            travel_us,
            direction: 0,
        }
    }

    pub fn is_home(&self) -> bool {
        self.position_us == 0
    }

    pub fn is_out(&self) -> bool {
        self.position_us == self.travel_us
    }

    pub fn is_between(&self) -> bool {
        !self.is_home() && !self.is_out()
    }

    pub fn permille(&self) -> u32 {
        self.position_us * 1000 / self.travel_us
    }

    /// Monostable: out while the valve is on, springs home when it is off.
    pub fn step(&mut self, on: bool) {
        self.step_towards(if on { self.travel_us } else { 0 });
    }

    /// Moves one tick towards a place on the stroke.
    pub fn step_towards(&mut self, target_us: u32) {
        let before_us = self.position_us;
        self.position_us = if target_us > before_us {
            (before_us + TICK_US).min(target_us)
        } else {
            before_us.saturating_sub(TICK_US).max(target_us)
        };
        self.direction =
            (self.position_us > before_us) as i8 - (self.position_us < before_us) as i8;
    }
}

/// A cylinder with a valve of two coils that keeps its place when both are off.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Bistable {
    pub cylinder: Cylinder,
    outward: bool,
}

impl Bistable {
    pub fn new(travel_us: u32) -> Self {
        Bistable {
            cylinder: Cylinder::new(travel_us),
            outward: false,
        }
    }

    /// One tick. Both coils on is an incident, and the valve then stays as it is.
    pub fn step(
        &mut self,
        out: bool,
        home: bool,
        unit: u8,
        name: &'static str,
        index: usize,
        records: &mut Records,
    ) {
        records.watch(
            (unit, name, index),
            out && home,
            IncidentKind::DrivenAgainstStop,
            &[],
            || format!("both coils of {name} are on"),
        );
        if out != home {
            self.outward = out;
        }
        self.cylinder.step(self.outward);
    }
}

/// A drive that stands at one of several places a fixed step apart.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct IndexDrive {
    pub position_us: u32,
    step_us: u32,
    places: u16,
    pub moving: bool,
}

impl IndexDrive {
    pub fn new(step_us: u32, places: u16) -> Self {
        IndexDrive {
            position_us: 0,
            step_us,
            places,
            moving: false,
        }
    }

    /// One tick. A target that does not exist is an incident, and the drive stands still.
    pub fn step(
        &mut self,
        enable: bool,
        target: u16,
        unit: u8,
        name: &'static str,
        records: &mut Records,
    ) {
        let exists = target < self.places;
        records.watch(
            (unit, name, 0),
            enable && !exists,
            IncidentKind::DrivenAgainstStop,
            &[],
            || {
                format!(
                    "{name} is sent to place {target}, its last place is {}",
                    self.places - 1
                )
            },
        );
        self.moving = false;
        if enable && exists {
            let target_us = u32::from(target) * self.step_us;
            let before_us = self.position_us;
            self.position_us = if target_us > before_us {
                (before_us + TICK_US).min(target_us)
            } else {
                before_us.saturating_sub(TICK_US).max(target_us)
            };
            self.moving = self.position_us != before_us;
        }
    }

    /// The place where it stands, if it is not between two.
    pub fn place(&self) -> Option<u16> {
        self.position_us
            .is_multiple_of(self.step_us)
            .then(|| (self.position_us / self.step_us) as u16)
    }

    /// Thousandths of a step, for the position register.
    pub fn millisteps(&self) -> u16 {
        (u64::from(self.position_us) * 1000 / u64::from(self.step_us)) as u16
    }

    pub fn is_in_position(&self, enable: bool, target: u16) -> bool {
        enable && self.place() == Some(target)
    }
}
