//! Station 3: lids from a turret of magazines are checked for material and height and laid onto the set.

use crate::cylinder::{Bistable, IndexDrive};
use crate::feeding::{GAUGE_STROKE, depth_of, depth_us};
use crate::hand::{Hand, Under};
use crate::image::UnitImage;
use crate::lane::{Lane, LaneCommand, LaneStrokes};
use crate::part::{LID_MAGAZINES, LidHeight, Material, PartId, PartKind, Shape};
use crate::records::Records;
use crate::signals::lid as at;
use crate::transport::Transport;

const UNIT: u8 = 3;
const STOP: usize = 2;
const ARM_US: u32 = 350_000;
const TURRET_STEP_US: u32 = 100_000;
const DEPTH_HIGH: u32 = 2200;
const DEPTH_LOW: u32 = 2800;

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct ClosingStation {
    turret: IndexDrive,
    lane: Lane,
    arm: Bistable,
    hand: Hand,
}

impl ClosingStation {
    pub fn new() -> Self {
        let strokes = LaneStrokes {
            pusher_us: 250_000,
            probe_us: 200_000,
            ejector_us: 200_000,
        };
        ClosingStation {
            turret: IndexDrive::new(TURRET_STEP_US, u16::from(LID_MAGAZINES)),
            lane: Lane::new(UNIT, PartKind::Lid, LID_MAGAZINES, strokes),
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
        let (enable, target) = (
            image.coil(at::TURRET_ENABLE),
            image.holding_register(at::TURRET_TARGET),
        );
        self.turret.step(enable, target, UNIT, "turret", records);
        self.arm.step(
            image.coil(at::ARM_TO_PALLET),
            image.coil(at::ARM_TO_NEST),
            UNIT,
            "arm",
            0,
            records,
        );
        let arm = &self.arm.cylinder;
        let stop = transport.stop_state(STOP);
        let over = if arm.is_home() {
            Under::Nest(&mut self.lane.nest)
        } else if arm.is_out() {
            Under::Pallet(transport.lifted(STOP))
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
            Some(Shape::Lid {
                height: LidHeight::High,
                ..
            }) => DEPTH_HIGH,
            Some(_) => DEPTH_LOW,
            None => GAUGE_STROKE,
        };
        let lower = image.coil(at::GAUGE_LOWER);
        let probe_limit_us = depth_us(depth);
        let command = LaneCommand {
            push: image.coil(at::PUSHER_EXTEND),
            probe: lower,
            eject: image.coil(at::EJECTOR_EXTEND),
            selected: self.turret.place(),
            selecting: self.turret.moving,
            probe_limit_us,
        };
        self.lane.step(command, hand, records);

        let lane = &self.lane;
        let sensed = lane.sensed(hand);
        let material = match sensed.map(|part| records.part(part).shape) {
            Some(Shape::Lid { material, .. }) => Some(material),
            _ => None,
        };
        image.sense(at::MAGAZINE_PART, lane.has_part());
        image.sense(
            at::TURRET_IN_POSITION,
            self.turret.is_in_position(enable, target),
        );
        image.sense(at::PUSHER_RETRACTED, lane.pusher.is_home());
        image.sense(at::PUSHER_EXTENDED, lane.pusher.is_out());
        image.sense(at::NEST_PART, sensed.is_some());
        image.sense(at::INDUCTIVE, material == Some(Material::Aluminium));
        image.sense(
            at::BRIGHT,
            material.is_some_and(|material| material != Material::BlackPlastic),
        );
        image.sense(at::GAUGE_UP, lane.probe.is_home());
        image.sense(
            at::GAUGE_CONTACT,
            lower && lane.probe.position_us == probe_limit_us,
        );
        image.sense(at::EJECTOR_RETRACTED, lane.ejector.is_home());
        image.sense(at::EJECTOR_EXTENDED, lane.ejector.is_out());
        image.sense(at::ARM_AT_NEST, arm.is_home());
        image.sense(at::ARM_AT_PALLET, arm.is_out());
        image.sense(at::HAND_UP, self.hand.lift.is_home());
        image.sense(at::HAND_DOWN, self.hand.lift.is_out());
        image.sense(at::VACUUM, self.hand.held.is_some());
        image.measure(at::TURRET_POSITION, self.turret.millisteps());
        image.measure(at::GAUGE_DEPTH, depth_of(lane.probe.position_us));
    }

    pub fn feeding_parts(&self) -> impl Iterator<Item = PartId> + '_ {
        self.lane.parts()
    }

    pub fn held(&self) -> Option<PartId> {
        self.hand.held
    }
}
