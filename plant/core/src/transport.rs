//! The transport loop: a belt with pallets, and a stopper and a lifter at each station.

use crate::cylinder::{Bistable, Cylinder};
use crate::image::UnitImage;
use crate::incident::IncidentKind;
use crate::part::PartId;
use crate::records::Records;
use crate::signals::transport as at;

/// Stops of the loop, one for each station.
pub(crate) const STOPS: usize = 4;
const UNIT: u8 = 5;
const LOOP_UM: u32 = 2_400_000;
const STOP_DISTANCE_UM: u32 = 600_000;
/// A pallet with its bumpers: the least distance between two fronts.
const PALLET_PITCH_UM: u32 = 200_000;
const PALLET_BODY_UM: u32 = 160_000;
/// 400 mm/s, in one tick of 1 ms.
const BELT_STEP_UM: u32 = 400;
const SENSOR_RANGE_UM: u32 = 1_000;
const LIFTER_US: u32 = 200_000;
const STOPPER_US: u32 = 60_000;
/// Fronts of the pallets at power-up, in belt order from before stop 1 backwards: two between each two stops, clear of the lifters.
const START_UM: [u32; 8] = [
    420_000, 200_000, 2_220_000, 2_000_000, 1_620_000, 1_400_000, 1_020_000, 800_000,
];

/// The most pallets that the loop starts with.
pub(crate) const PALLETS_THAT_FIT: u8 = START_UM.len() as u8;

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Pallet {
    pub code: u16,
    /// Place of its front edge on the loop.
    front_um: u32,
    /// Pieces from the base upwards.
    pub stack: Vec<PartId>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Stop {
    stopper: Cylinder,
    /// A pallet has passed since the stopper was opened: it blocks until it has been closed.
    spent: bool,
    lifter: Bistable,
}

/// How the pallet place of a station is, for whoever reaches into it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StopState {
    pub lifter_moves: bool,
    pub lifter_up: bool,
    pub pallet_at_stop: bool,
    /// A pallet over the lifter, but not at the stop.
    pub pallet_passes: bool,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Transport {
    /// In belt order: each one follows the one before it.
    pallets: Vec<Pallet>,
    stops: [Stop; STOPS],
}

impl Transport {
    pub fn new(pallets: u8) -> Self {
        let stop = Stop {
            stopper: Cylinder::new(STOPPER_US),
            spent: false,
            lifter: Bistable::new(LIFTER_US),
        };
        Transport {
            pallets: (1..)
                .zip(START_UM)
                .take(usize::from(pallets))
                .map(|(code, front_um)| Pallet {
                    code,
                    front_um,
                    stack: Vec::new(),
                })
                .collect(),
            stops: std::array::from_fn(|_| stop.clone()),
        }
    }

    pub fn step(&mut self, image: &mut UnitImage, records: &mut Records) {
        let belt = image.coil(at::BELT_RUN);
        for (index, stop) in self.stops.iter_mut().enumerate() {
            let base = index as u16 * at::COIL_STRIDE;
            let open = image.coil(at::STOPPER_OPEN + base);
            stop.stopper.step(open);
            stop.spent &= open;
            let (raise, lower) = (
                image.coil(at::LIFTER_RAISE + base),
                image.coil(at::LIFTER_LOWER + base),
            );
            stop.lifter
                .step(raise, lower, UNIT, "lifter", index + 1, records);
        }
        if belt {
            self.move_pallets();
        }
        self.watch(records);
        self.sense(belt, image);
    }

    pub fn stop_state(&self, stop: usize) -> StopState {
        let lifter = &self.stops[stop].lifter.cylinder;
        StopState {
            lifter_moves: lifter.direction != 0,
            lifter_up: lifter.is_out(),
            pallet_at_stop: self.at_stop(stop).is_some(),
            pallet_passes: self.passing(stop).is_some(),
        }
    }

    /// The pallet that is lifted at a stop.
    pub fn lifted(&mut self, stop: usize) -> Option<&mut Pallet> {
        if !self.stops[stop].lifter.cylinder.is_out() {
            return None;
        }
        self.pallets
            .iter_mut()
            .find(|pallet| pallet.front_um == stop_um(stop))
    }

    pub fn parts(&self) -> impl Iterator<Item = PartId> + '_ {
        self.pallets
            .iter()
            .flat_map(|pallet| pallet.stack.iter().copied())
    }

    fn move_pallets(&mut self) {
        let count = self.pallets.len();
        let fronts: Vec<u32> = self.pallets.iter().map(|pallet| pallet.front_um).collect();
        for (index, pallet) in self.pallets.iter_mut().enumerate() {
            let mut step_um = BELT_STEP_UM;
            if count > 1 {
                let ahead_um = fronts[(index + count - 1) % count];
                let gap_um = ahead(pallet.front_um, ahead_um).saturating_sub(PALLET_PITCH_UM);
                step_um = step_um.min(gap_um);
            }
            for (number, stop) in self.stops.iter_mut().enumerate() {
                let to_stop_um = ahead(pallet.front_um, stop_um(number));
                if to_stop_um >= BELT_STEP_UM || step_um == 0 {
                    continue;
                }
                let blocked = !stop.stopper.is_out() || stop.spent;
                let lifted = to_stop_um == 0 && !stop.lifter.cylinder.is_home();
                if blocked || lifted {
                    step_um = step_um.min(to_stop_um);
                } else if step_um > to_stop_um {
                    stop.spent = true;
                }
            }
            pallet.front_um = (pallet.front_um + step_um) % LOOP_UM;
        }
    }

    fn watch(&self, records: &mut Records) {
        for (index, stop) in self.stops.iter().enumerate() {
            let number = index + 1;
            let lifter_up = !stop.lifter.cylinder.is_home();
            let passing = self.passing(index);
            let harmed = passing.and_then(|pallet| pallet.stack.last().copied());
            records.watch(
                (UNIT, "lifter under moving pallet", number),
                lifter_up && passing.is_some(),
                IncidentKind::Collision,
                &[harmed],
                || format!("lifter {number} is not down while a pallet is over it that is not at the stop"),
            );
            let released = !stop.stopper.is_home() && lifter_up && self.at_stop(index).is_some();
            records.watch(
                (UNIT, "released while lifted", number),
                released,
                IncidentKind::Collision,
                &[],
                || {
                    format!(
                        "stopper {number} opens while lifter {number} is not down under the pallet"
                    )
                },
            );
        }
    }

    fn sense(&self, belt: bool, image: &mut UnitImage) {
        image.sense(at::BELT_RUNNING, belt);
        for (index, stop) in self.stops.iter().enumerate() {
            let base = index as u16 * at::INPUT_STRIDE;
            let near = self.pallets.iter().find(|pallet| {
                let past_um = ahead(stop_um(index), pallet.front_um);
                past_um <= SENSOR_RANGE_UM
            });
            image.sense(at::PALLET_AT + base, near.is_some());
            image.sense(
                at::PALLET_LOADED + base,
                near.is_some_and(|pallet| !pallet.stack.is_empty()),
            );
            image.sense(at::LIFTER_UP + base, stop.lifter.cylinder.is_out());
            image.sense(at::LIFTER_DOWN + base, stop.lifter.cylinder.is_home());
            image.sense(at::STOPPER_CLOSED + base, stop.stopper.is_home());
            image.measure(
                at::PALLET_CODE + index as u16 * at::CODE_STRIDE,
                near.map_or(0, |pallet| pallet.code),
            );
        }
    }

    fn at_stop(&self, stop: usize) -> Option<&Pallet> {
        self.pallets
            .iter()
            .find(|pallet| pallet.front_um == stop_um(stop))
    }

    /// A pallet whose body is over the lifter, but that does not stand at the stop.
    fn passing(&self, stop: usize) -> Option<&Pallet> {
        let stop_um = stop_um(stop);
        self.pallets.iter().find(|pallet| {
            let past_um = ahead(stop_um, pallet.front_um);
            let before_um = ahead(pallet.front_um, stop_um);
            past_um != 0 && past_um.min(before_um) < PALLET_BODY_UM
        })
    }
}

fn stop_um(stop: usize) -> u32 {
    (stop as u32 + 1) * STOP_DISTANCE_UM % LOOP_UM
}

/// Distance from one place on the loop forwards to another.
fn ahead(from_um: u32, to_um: u32) -> u32 {
    (to_um + LOOP_UM - from_um) % LOOP_UM
}
