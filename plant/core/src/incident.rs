//! What real mechanics would punish.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Kind of an incident, by its mechanical cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IncidentKind {
    PartDropped,
    PartLost,
    TwoPartsInOnePlace,
    DrivenAgainstStop,
    FollowingError,
    Collision,
    IncompleteSet,
    WrongSet,
    WrongOrder,
    BadMark,
    MarkedTwice,
    NotMarked,
}

impl IncidentKind {
    pub fn name(self) -> &'static str {
        match self {
            IncidentKind::PartDropped => "part-dropped",
            IncidentKind::PartLost => "part-lost",
            IncidentKind::TwoPartsInOnePlace => "two-parts-in-one-place",
            IncidentKind::DrivenAgainstStop => "driven-against-stop",
            IncidentKind::FollowingError => "following-error",
            IncidentKind::Collision => "collision",
            IncidentKind::IncompleteSet => "incomplete-set",
            IncidentKind::WrongSet => "wrong-set",
            IncidentKind::WrongOrder => "wrong-order",
            IncidentKind::BadMark => "bad-mark",
            IncidentKind::MarkedTwice => "marked-twice",
            IncidentKind::NotMarked => "not-marked",
        }
    }
}

/// One incident, counted once when its cause begins.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Incident {
    /// Simulated time since power-up.
    pub at_us: u64,
    /// Modbus unit: 1 to 4 stations, 5 transport; 6 for the marking machine.
    pub unit: u8,
    pub kind: IncidentKind,
    /// What happened, for people.
    pub cause: String,
}

impl fmt::Display for Incident {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = self.at_us / 1000;
        let place = match self.unit {
            1 => "station 1 (base)",
            2 => "station 2 (bearing and shaft)",
            3 => "station 3 (lid)",
            4 => "station 4 (storage)",
            6 => "marking machine",
            _ => "transport",
        };
        write!(
            f,
            "{}.{:03} s, {place}: {}: {}",
            ms / 1000,
            ms % 1000,
            self.kind.name(),
            self.cause
        )
    }
}
