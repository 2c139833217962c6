//! Profiles: which cells are simulated, and how much goes wrong in them.

use super::cell::{Cell, Size};
use super::delivered::{fms200, marking};
use super::field::Field;
use super::generate::Trouble;
use super::random::Random;
use fam_plant_core::{MachineKind, PlantConfig};
use serde::{Deserialize, Serialize};

/// A profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Profile {
    /// 2 to 5 controllers, 1 to 8 MCs with the model logic.
    Default,
    /// As the default, with several times as many faults.
    Harsh,
    /// Up to 50 controllers and 200 MCs.
    Large,
    /// Compiled logic in real soft-PLC instances, with sensors that come and go.
    Plc,
    /// The FMS-200 cell with its delivered logic and the real plant step: an incident is a violation.
    Fms200,
    /// The marking machine with its delivered logic and plant, likewise.
    Marking,
}

impl Profile {
    /// All of them.
    pub const ALL: [Profile; 6] = [
        Profile::Default,
        Profile::Harsh,
        Profile::Large,
        Profile::Plc,
        Profile::Fms200,
        Profile::Marking,
    ];

    /// Its name, as on a command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Profile::Default => "default",
            Profile::Harsh => "harsh",
            Profile::Large => "large",
            Profile::Plc => "plc",
            Profile::Fms200 => "fms200",
            Profile::Marking => "marking",
        }
    }

    /// The cell that a seed chooses.
    pub(super) fn cell(self, random: &mut Random) -> Cell {
        let size = |controllers, mcs, hosts_max, plc| Size {
            controllers,
            mcs,
            hosts_max,
            plc,
        };
        let size = match self {
            Profile::Default => size((2, 5), (1, 8), 5, false),
            Profile::Harsh => size((2, 6), (3, 8), 6, false),
            Profile::Large => size((6, 50), (9, 200), 4, false),
            Profile::Plc => size((2, 4), (1, 5), 4, true),
            Profile::Fms200 => return fms200(),
            Profile::Marking => return marking(),
        };
        Cell::choose(&size, random)
    }

    pub(super) fn trouble(self) -> Trouble {
        let trouble = Trouble {
            from_us: 300_000,
            to_us: 7_500_000,
            faults: (6, 14),
            aimed_permille: 500,
            gentle: false,
        };
        match self {
            Profile::Default | Profile::Plc => trouble,
            Profile::Harsh => Trouble {
                from_us: 200_000,
                to_us: 8_500_000,
                faults: (15, 50),
                ..trouble
            },
            Profile::Large => Trouble {
                faults: (10, 40),
                ..trouble
            },
            Profile::Fms200 | Profile::Marking => Trouble {
                from_us: 1_000_000,
                to_us: 20_000_000,
                faults: (6, 30),
                gentle: true,
                ..trouble
            },
        }
    }

    pub(super) fn field(self, seed: u64) -> Field {
        match self {
            Profile::Fms200 => Field::of(PlantConfig {
                seed,
                pallets: 5,
                ..PlantConfig::default()
            }),
            Profile::Marking => Field::of(PlantConfig {
                seed,
                machine: MachineKind::Marking,
                ..PlantConfig::default()
            }),
            _ => Field::invented(),
        }
    }

    /// Sensors come and go without reason: a recovery may wait for one for ever, and so may the end of a critical interval.
    pub(super) fn sensors_lie(self) -> bool {
        self == Profile::Plc
    }

    /// After the last fault every MC has to be driven within this time, in microseconds.
    pub(super) fn bound_us(self) -> u64 {
        match self {
            Profile::Default | Profile::Harsh | Profile::Plc => 8_000_000,
            Profile::Large | Profile::Fms200 | Profile::Marking => 12_000_000,
        }
    }
}

impl std::str::FromStr for Profile {
    type Err = String;

    fn from_str(name: &str) -> Result<Profile, String> {
        let found = Profile::ALL.into_iter().find(|p| p.name() == name);
        found.ok_or_else(|| {
            let names = Profile::ALL.map(Profile::name).join(", ");
            format!("there is no profile `{name}`: expected one of {names}")
        })
    }
}
