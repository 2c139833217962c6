//! Station 2: a bearing, measured by its height profile, and a shaft of the ordered material are put onto the base.

use crate::cylinder::{Bistable, IndexDrive};
use crate::hand::{Hand, Under};
use crate::image::UnitImage;
use crate::lane::{Lane, LaneCommand, LaneStrokes};
use crate::part::{Material, PartId, PartKind, Shape};
use crate::records::Records;
use crate::signals::bearing as at;
use crate::transport::Transport;

const UNIT: u8 = 2;
const STOP: usize = 1;
const HEAD_US: u32 = 300_000;
const SELECTOR_US: u32 = 200_000;
const ARM_STEP_US: u32 = 300_000;
/// Places of the arm, in steps.
const ARM_AT_BEARING: u16 = 0;
const ARM_AT_PALLET: u16 = 1;
const ARM_AT_SHAFT: u16 = 2;

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct FittingStation {
    bearings: Lane,
    selector: Bistable,
    shafts: Lane,
    arm: IndexDrive,
    hand: Hand,
}

impl FittingStation {
    pub fn new() -> Self {
        let bearing = LaneStrokes {
            pusher_us: 250_000,
            probe_us: HEAD_US,
            ejector_us: 200_000,
        };
        // The shaft lane has no probe: its coil does not exist, so that it never moves.
        let shaft = LaneStrokes {
            pusher_us: 250_000,
            probe_us: HEAD_US,
            ejector_us: 200_000,
        };
        FittingStation {
            bearings: Lane::new(UNIT, PartKind::Bearing, 1, bearing),
            selector: Bistable::new(SELECTOR_US),
            shafts: Lane::new(UNIT, PartKind::Shaft, 2, shaft),
            arm: IndexDrive::new(ARM_STEP_US, 3),
            hand: Hand::new(UNIT),
        }
    }

    pub fn step(
        &mut self,
        image: &mut UnitImage,
        transport: &mut Transport,
        records: &mut Records,
    ) {
        let (enable, target) = (
            image.coil(at::ARM_ENABLE),
            image.holding_register(at::ARM_TARGET),
        );
        self.arm.step(enable, target, UNIT, "arm", records);
        self.selector.step(
            image.coil(at::SELECT_NYLON),
            image.coil(at::SELECT_ALUMINIUM),
            UNIT,
            "selector",
            0,
            records,
        );
        let stop = transport.stop_state(STOP);
        let place = self.arm.place();
        let over = match place {
            Some(ARM_AT_BEARING) => Under::Nest(&mut self.bearings.nest),
            Some(ARM_AT_SHAFT) => Under::Nest(&mut self.shafts.nest),
            Some(ARM_AT_PALLET) => Under::Pallet(transport.lifted(STOP)),
            _ => Under::Between,
        };
        self.hand.step(
            image.coil(at::HAND_LOWER),
            image.coil(at::SUCTION),
            over,
            stop,
            records,
        );
        let at_bearing = self.hand.at_nest(place == Some(ARM_AT_BEARING));
        let at_shaft = self.hand.at_nest(place == Some(ARM_AT_SHAFT));

        let command = LaneCommand {
            push: image.coil(at::BEARING_PUSHER_EXTEND),
            probe: image.coil(at::HEAD_TRAVERSE),
            eject: image.coil(at::BEARING_EJECTOR_EXTEND),
            selected: Some(0),
            selecting: false,
            probe_limit_us: HEAD_US,
        };
        self.bearings.step(command, at_bearing, records);
        let selector = &self.selector.cylinder;
        let command = LaneCommand {
            push: image.coil(at::SHAFT_PUSHER_EXTEND),
            probe: false,
            eject: image.coil(at::SHAFT_EJECTOR_EXTEND),
            selected: if selector.is_between() {
                None
            } else {
                Some(u16::from(selector.is_out()))
            },
            selecting: selector.direction != 0,
            probe_limit_us: 0,
        };
        self.shafts.step(command, at_shaft, records);

        let bearing = self.bearings.sensed(at_bearing);
        let shaft = self.shafts.sensed(at_shaft);
        let inductive = shaft.is_some_and(|part| {
            matches!(
                records.part(part).shape,
                Shape::Shaft {
                    material: Material::Aluminium
                }
            )
        });
        image.sense(at::BEARING_MAGAZINE_PART, self.bearings.has_part());
        image.sense(at::BEARING_PUSHER_RETRACTED, self.bearings.pusher.is_home());
        image.sense(at::BEARING_PUSHER_EXTENDED, self.bearings.pusher.is_out());
        image.sense(at::BEARING_NEST_PART, bearing.is_some());
        image.sense(at::HEAD_HOME, self.bearings.probe.is_home());
        image.sense(at::HEAD_END, self.bearings.probe.is_out());
        image.sense(
            at::BEARING_EJECTOR_RETRACTED,
            self.bearings.ejector.is_home(),
        );
        image.sense(at::BEARING_EJECTOR_EXTENDED, self.bearings.ejector.is_out());
        image.sense(at::SELECTOR_AT_ALUMINIUM, selector.is_home());
        image.sense(at::SELECTOR_AT_NYLON, selector.is_out());
        image.sense(at::SHAFT_MAGAZINE_PART, self.shafts.has_part());
        image.sense(at::SHAFT_PUSHER_RETRACTED, self.shafts.pusher.is_home());
        image.sense(at::SHAFT_PUSHER_EXTENDED, self.shafts.pusher.is_out());
        image.sense(at::SHAFT_NEST_PART, shaft.is_some());
        image.sense(at::SHAFT_INDUCTIVE, inductive);
        image.sense(at::SHAFT_EJECTOR_RETRACTED, self.shafts.ejector.is_home());
        image.sense(at::SHAFT_EJECTOR_EXTENDED, self.shafts.ejector.is_out());
        image.sense(at::ARM_IN_POSITION, self.arm.is_in_position(enable, target));
        image.sense(at::HAND_UP, self.hand.lift.is_home());
        image.sense(at::HAND_DOWN, self.hand.lift.is_out());
        image.sense(at::VACUUM, self.hand.held.is_some());

        let place = self.bearings.probe.permille();
        let height = match bearing.map(|part| records.part(part).shape) {
            Some(Shape::Bearing { height }) => profile(height.ring_height(), place as i32),
            _ => 0,
        };
        image.measure(at::PROFILE_HEIGHT, height as i16 as u16);
        image.measure(at::PROFILE_POSITION, place as u16);
        image.measure(at::ARM_POSITION, self.arm.millisteps());
    }

    pub fn feeding_parts(&self) -> impl Iterator<Item = PartId> + '_ {
        self.bearings.parts().chain(self.shafts.parts())
    }

    pub fn held(&self) -> Option<PartId> {
        self.hand.held
    }
}

/// Height of a bearing's cross-section at a place from 0 to 1000, in 0.01 mm.
fn profile(ring: i32, place: i32) -> i32 {
    const CHAMFER: i32 = 20;
    const CAGE_BELOW_RING: i32 = 250;
    let cage = ring - CAGE_BELOW_RING;
    // From, to, height; the chamfer of an edge lies on the higher side.
    let lands = [
        (0, 100, 0),
        (100, 250, ring),
        (250, 350, cage),
        (350, 450, ring),
        (450, 550, 0),
        (550, 650, ring),
        (650, 750, cage),
        (750, 900, ring),
        (900, 1001, 0),
    ];
    let Some(index) = lands
        .iter()
        .position(|&(from, to, _)| (from..to).contains(&place))
    else {
        return 0;
    };
    let (from, to, height) = lands[index];
    let before = if index > 0 { lands[index - 1].2 } else { 0 };
    let after = if index + 1 < lands.len() {
        lands[index + 1].2
    } else {
        0
    };
    let mut surface = height;
    if before < height && place - from < CHAMFER {
        surface = surface.min(before + (height - before) * (place - from) / CHAMFER);
    }
    if after < height && to - place < CHAMFER {
        surface = surface.min(after + (height - after) * (to - place) / CHAMFER);
    }
    if height == ring {
        surface += ripple(place);
        if (200..=206).contains(&place) || (600..=606).contains(&place) {
            surface += 180;
        }
    }
    surface
}

/// A triangle from -30 to +30 with period 46.
fn ripple(place: i32) -> i32 {
    const PERIOD: i32 = 46;
    const AMPLITUDE: i32 = 30;
    let phase = place % PERIOD;
    let half = PERIOD / 2;
    let rising = if phase < half { phase } else { PERIOD - phase };
    rising * 2 * AMPLITUDE / half - AMPLITUDE
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::part::BearingHeight;

    /// The filter that the documentation proposes: the median over the lands of the rings.
    fn median(ring: i32) -> i32 {
        let mut samples: Vec<i32> = (0..=1000)
            .step_by(17)
            .filter(|place| {
                [130..=230, 370..=430, 570..=630, 770..=870]
                    .iter()
                    .any(|land| land.contains(place))
            })
            .map(|place| profile(ring, place))
            .collect();
        samples.sort_unstable();
        samples[samples.len() / 2]
    }

    #[test]
    fn the_documented_filter_tells_good_from_wrong_bearings() {
        for (height, good) in [
            (BearingHeight::TooLow, false),
            (BearingHeight::Good, true),
            (BearingHeight::TooHigh, false),
        ] {
            let median = median(height.ring_height());
            assert_eq!(
                (1170..=1230).contains(&median),
                good,
                "{height:?} measured {median}"
            );
        }
    }

    #[test]
    fn the_profile_is_flat_outside_and_over_the_bore() {
        for place in [0, 50, 99, 460, 500, 540, 901, 1000] {
            assert_eq!(profile(1200, place), 0, "at {place}");
        }
        assert_eq!(profile(1200, 300), 950);
    }
}
