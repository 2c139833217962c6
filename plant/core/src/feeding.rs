//! Station 1: bases from a gravity feeder are checked for their orientation and laid onto the pallet.

use crate::cylinder::Bistable;
use crate::hand::{Hand, Under};
use crate::image::UnitImage;
use crate::lane::{Lane, LaneCommand, LaneStrokes};
use crate::part::{PartId, PartKind, Shape};
use crate::records::Records;
use crate::signals::base as at;
use crate::transport::Transport;

const UNIT: u8 = 1;
const ARM_US: u32 = 350_000;
const PROBE_US: u32 = 200_000;
/// Full stroke of the measuring cylinder, 0.01 mm.
pub(crate) const GAUGE_STROKE: u32 = 4000;
const DEPTH_UPRIGHT: u32 = 3000;
const DEPTH_UPSIDE_DOWN: u32 = 1800;

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct FeedingStation {
    lane: Lane,
    arm: Bistable,
    hand: Hand,
}

impl FeedingStation {
    pub fn new() -> Self {
        let strokes = LaneStrokes {
            pusher_us: 300_000,
            probe_us: PROBE_US,
            ejector_us: 250_000,
        };
        FeedingStation {
            lane: Lane::new(UNIT, PartKind::Base, 1, strokes),
            arm: Bistable::new(ARM_US),
            hand: Hand::new(UNIT),
        }
    }

    pub fn step(
        &mut self,
        image: &mut UnitImage,
        transport: &mut Transport,
        records: &mut Records,
    ) {
        self.arm.step(
            image.coil(at::ARM_TO_PALLET),
            image.coil(at::ARM_TO_CHECK),
            UNIT,
            "arm",
            0,
            records,
        );
        let arm = &self.arm.cylinder;
        let stop = transport.stop_state(0);
        let over = if arm.is_home() {
            Under::Nest(&mut self.lane.nest)
        } else if arm.is_out() {
            Under::Pallet(transport.lifted(0))
        } else {
            Under::Between
        };
        self.hand.step(
            image.coil(at::HAND_LOWER),
            image.coil(at::SUCTION),
            over,
            stop,
            records,
        );
        let hand = self.hand.at_nest(arm.is_home());

        let depth = match self.lane.sensed(hand).map(|part| records.part(part).shape) {
            Some(Shape::Base { upright: true }) => DEPTH_UPRIGHT,
            Some(_) => DEPTH_UPSIDE_DOWN,
            None => GAUGE_STROKE,
        };
        let lower = image.coil(at::GAUGE_LOWER);
        let probe_limit_us = depth_us(depth);
        let command = LaneCommand {
            push: image.coil(at::PUSHER_EXTEND),
            probe: lower,
            eject: image.coil(at::EJECTOR_EXTEND),
            selected: Some(0),
            selecting: false,
            probe_limit_us,
        };
        self.lane.step(command, hand, records);

        let lane = &self.lane;
        image.sense(at::MAGAZINE_PART, lane.has_part());
        image.sense(at::PUSHER_RETRACTED, lane.pusher.is_home());
        image.sense(at::PUSHER_EXTENDED, lane.pusher.is_out());
        image.sense(at::CHECK_PART, lane.sensed(hand).is_some());
        image.sense(at::GAUGE_UP, lane.probe.is_home());
        image.sense(
            at::GAUGE_CONTACT,
            lower && lane.probe.position_us == probe_limit_us,
        );
        image.sense(at::EJECTOR_RETRACTED, lane.ejector.is_home());
        image.sense(at::EJECTOR_EXTENDED, lane.ejector.is_out());
        image.sense(at::ARM_AT_CHECK, arm.is_home());
        image.sense(at::ARM_AT_PALLET, arm.is_out());
        image.sense(at::HAND_UP, self.hand.lift.is_home());
        image.sense(at::HAND_DOWN, self.hand.lift.is_out());
        image.sense(at::VACUUM, self.hand.held.is_some());
        image.measure(at::GAUGE_DEPTH, depth_of(lane.probe.position_us));
    }

    pub fn feeding_parts(&self) -> impl Iterator<Item = PartId> + '_ {
        self.lane.parts()
    }

    pub fn held(&self) -> Option<PartId> {
        self.hand.held
    }
}

/// Place on the stroke of a gauge for a depth in 0.01 mm.
pub(crate) fn depth_us(depth: u32) -> u32 {
    depth * PROBE_US / GAUGE_STROKE
}

/// Depth in 0.01 mm for a place on the stroke of a gauge.
pub(crate) fn depth_of(position_us: u32) -> u16 {
    (position_us * (GAUGE_STROKE / 100) / (PROBE_US / 100)) as u16
}
