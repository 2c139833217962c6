//! Station 4: a carriage on two axes with fork and gripper lays finished sets into a rack.

use crate::cylinder::Bistable;
use crate::drive::Drive;
use crate::hand::watch_pallet;
use crate::image::UnitImage;
use crate::incident::IncidentKind;
use crate::order::Variant;
use crate::part::{PartId, SET_PIECES};
use crate::plant::TICK_US;
use crate::records::{Product, Records};
use crate::signals::storage as at;
use crate::transport::Transport;

const UNIT: u8 = 4;
const STOP: usize = 3;
const FORK_US: u32 = 250_000;
const GRIPPER_US: u32 = 100_000;
const SLOTS: u8 = 12;
const COLUMNS: u8 = 4;
/// A stored set is taken out of the rack from behind after this time.
const DISPATCH_US: u32 = 15_000_000;
/// One unit of the position registers.
const REGISTER_UM: i32 = 100;
const TRANSFER_UM: (i32, i32) = (50_000, 100_000);
const FIRST_SLOT_UM: (i32, i32) = (200_000, 50_000);
const SLOT_PITCH_UM: (i32, i32) = (80_000, 100_000);
/// Room around a place, within which the fork fits into it.
const ENTRY_X_UM: i32 = 1_000;
const ENTRY_BELOW_UM: i32 = 1_000;
const ENTRY_ABOVE_UM: i32 = 25_000;
/// Up to here above a place a set rests on it.
const REST_UM: i32 = 2_000;
/// From here on a set is clear of its place.
const CLEAR_UM: i32 = 15_000;
const X_STOPS_UM: (i32, i32) = (-20_000, 480_000);
const Z_STOPS_UM: (i32, i32) = (-20_000, 320_000);

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct HeldSet {
    parts: Vec<PartId>,
    pallet: u16,
}

/// A place that the fork can enter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Transfer,
    Slot(u8),
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct StorageStation {
    x: Drive,
    z: Drive,
    fork: Bistable,
    /// Home is open.
    gripper: Bistable,
    held: Option<HeldSet>,
    /// Time since a set was laid into the slot; `None`: free.
    slots_us: [Option<u32>; SLOTS as usize],
}

impl StorageStation {
    pub fn new() -> Self {
        StorageStation {
            x: Drive::new("X", X_STOPS_UM.0, X_STOPS_UM.1),
            z: Drive::new("Z", Z_STOPS_UM.0, Z_STOPS_UM.1),
            fork: Bistable::new(FORK_US),
            gripper: Bistable::new(GRIPPER_US),
            held: None,
            slots_us: [None; SLOTS as usize],
        }
    }

    /// One tick. `orders` is the number of orders that exist.
    pub fn step(
        &mut self,
        image: &mut UnitImage,
        transport: &mut Transport,
        orders: u16,
        records: &mut Records,
    ) {
        let enable = image.coil(at::AXES_ENABLE);
        let x_setpoint_um = setpoint_um(image.holding_register(at::X_SETPOINT));
        let z_setpoint_um = setpoint_um(image.holding_register(at::Z_SETPOINT));
        self.x.step(enable, x_setpoint_um, UNIT, records);
        self.z.step(enable, z_setpoint_um, UNIT, records);
        self.fork.step(
            image.coil(at::FORK_EXTEND),
            image.coil(at::FORK_RETRACT),
            UNIT,
            "fork",
            0,
            records,
        );
        self.gripper.step(
            image.coil(at::GRIP_CLOSE),
            image.coil(at::GRIP_OPEN),
            UNIT,
            "gripper",
            0,
            records,
        );

        let entered = self.place();
        self.watch_fork(entered, transport, records);
        self.grip(
            entered,
            image.holding_register(at::ORDER_NUMBER),
            orders,
            transport,
            records,
        );
        self.dispatch(entered);

        image.sense(at::FORK_RETRACTED, self.fork.cylinder.is_home());
        image.sense(at::FORK_EXTENDED, self.fork.cylinder.is_out());
        image.sense(at::GRIP_OPENED, self.gripper.cylinder.is_home());
        image.sense(at::GRIP_CLOSED, self.gripper.cylinder.is_out());
        image.sense(at::GRIP_PART, self.held.is_some());
        image.sense(
            at::X_IN_POSITION,
            self.x.is_in_position(enable, x_setpoint_um),
        );
        image.sense(
            at::Z_IN_POSITION,
            self.z.is_in_position(enable, z_setpoint_um),
        );
        image.sense(at::DRIVE_FAULT, self.x.tripped || self.z.tripped);
        image.measure(at::X_POSITION, register(self.x.position_um / REGISTER_UM));
        image.measure(at::Z_POSITION, register(self.z.position_um / REGISTER_UM));
        image.measure(at::X_VELOCITY, register(self.x.velocity));
        image.measure(at::Z_VELOCITY, register(self.z.velocity));
        let occupied = self
            .slots_us
            .iter()
            .enumerate()
            .filter(|(_, slot)| slot.is_some());
        image.measure(
            at::SLOT_OCCUPIED,
            occupied.map(|(index, _)| 1_u16 << index).sum(),
        );
    }

    pub fn held_parts(&self) -> impl Iterator<Item = PartId> + '_ {
        self.held.iter().flat_map(|set| set.parts.iter().copied())
    }

    /// The place before which the carriage stands, and how far above it.
    fn place(&self) -> Option<(Place, i32)> {
        let slots = (0..SLOTS).map(|slot| {
            let (column, row) = (i32::from(slot % COLUMNS), i32::from(slot / COLUMNS));
            let x_um = FIRST_SLOT_UM.0 + SLOT_PITCH_UM.0 * column;
            let z_um = FIRST_SLOT_UM.1 + SLOT_PITCH_UM.1 * row;
            (Place::Slot(slot), (x_um, z_um))
        });
        std::iter::once((Place::Transfer, TRANSFER_UM))
            .chain(slots)
            .find_map(|(place, (x_um, z_um))| {
                let above_um = self.z.position_um - z_um;
                let fits = (self.x.position_um - x_um).abs() <= ENTRY_X_UM
                    && (-ENTRY_BELOW_UM..=ENTRY_ABOVE_UM).contains(&above_um);
                fits.then_some((place, above_um))
            })
    }

    fn is_occupied(&self, place: Place, transport: &mut Transport) -> bool {
        match place {
            Place::Transfer => transport
                .lifted(STOP)
                .is_some_and(|pallet| !pallet.stack.is_empty()),
            Place::Slot(slot) => self.slots_us[usize::from(slot)].is_some(),
        }
    }

    fn watch_fork(
        &self,
        entered: Option<(Place, i32)>,
        transport: &mut Transport,
        records: &mut Records,
    ) {
        let fork = &self.fork.cylinder;
        let out = !fork.is_home();
        let harmed = self
            .held
            .as_ref()
            .and_then(|set| set.parts.first().copied());
        let occupied = entered.is_some_and(|(place, _)| self.is_occupied(place, transport));
        let (x_mm, z_mm) = (self.x.position_um / 1000, self.z.position_um / 1000);

        let mut collision = |name, active, what: &str| {
            records.watch(
                (UNIT, name, 0),
                active,
                IncidentKind::Collision,
                &[harmed],
                || format!("{what} (X {x_mm} mm, Z {z_mm} mm)"),
            );
        };
        collision(
            "fork outside places",
            out && entered.is_none(),
            "the fork is not back, but neither before the pallet nor before a slot",
        );
        collision(
            "fork into set",
            fork.direction > 0
                && occupied
                && self.held.is_none()
                && !self.gripper.cylinder.is_home(),
            "the fork runs into a set with the gripper not open",
        );
        collision(
            "set not clear",
            fork.direction != 0
                && self.held.is_some()
                && entered.is_some_and(|(_, above_um)| above_um < CLEAR_UM),
            "the fork moves with a set that is not lifted clear of its place",
        );
        let two = out && self.held.is_some() && occupied;
        records.watch(
            (UNIT, "set into occupied place", 0),
            two,
            IncidentKind::TwoPartsInOnePlace,
            &[harmed],
            || format!("a set was put into an occupied place (X {x_mm} mm, Z {z_mm} mm)"),
        );
        let reaches_in = out && matches!(entered, Some((Place::Transfer, _)));
        watch_pallet(
            UNIT,
            "the fork is not back from the pallet",
            reaches_in,
            transport.stop_state(STOP),
            harmed,
            records,
        );
    }

    fn grip(
        &mut self,
        entered: Option<(Place, i32)>,
        order: u16,
        orders: u16,
        transport: &mut Transport,
        records: &mut Records,
    ) {
        let resting = match entered {
            Some((place, above_um)) if self.fork.cylinder.is_out() && above_um <= REST_UM => {
                Some(place)
            }
            _ => None,
        };
        let gripper = &self.gripper.cylinder;
        if gripper.is_out() && gripper.direction > 0 && self.held.is_none() {
            self.held = resting.and_then(|place| self.take_from(place, transport, records));
        } else if gripper.direction < 0
            && let Some(set) = self.held.take()
        {
            self.let_go(set, resting, order, orders, transport, records);
        }
    }

    fn take_from(
        &mut self,
        place: Place,
        transport: &mut Transport,
        records: &mut Records,
    ) -> Option<HeldSet> {
        match place {
            Place::Transfer => {
                let pallet = transport.lifted(STOP)?;
                if pallet.stack.is_empty() {
                    return None;
                }
                Some(HeldSet {
                    parts: std::mem::take(&mut pallet.stack),
                    pallet: pallet.code,
                })
            }
            Place::Slot(slot) => {
                self.slots_us[usize::from(slot)].take()?;
                let product = records.take_back(slot)?;
                Some(HeldSet {
                    parts: product.parts.iter().map(|part| part.id).collect(),
                    pallet: product.pallet,
                })
            }
        }
    }

    fn let_go(
        &mut self,
        set: HeldSet,
        resting: Option<Place>,
        order: u16,
        orders: u16,
        transport: &mut Transport,
        records: &mut Records,
    ) {
        let cause = match resting {
            Some(Place::Slot(slot)) if self.slots_us[usize::from(slot)].is_none() => {
                self.slots_us[usize::from(slot)] = Some(0);
                store(&set, slot, order, orders, records);
                return;
            }
            Some(Place::Slot(_)) => (IncidentKind::PartDropped, "the slot is occupied"),
            Some(Place::Transfer) => match transport.lifted(STOP) {
                Some(pallet) if pallet.stack.is_empty() => {
                    records.ledger.placed += set.parts.len() as u64;
                    pallet.stack = set.parts;
                    return;
                }
                Some(_) => (IncidentKind::PartDropped, "the pallet is occupied"),
                None => (
                    IncidentKind::PartLost,
                    "no pallet is lifted under the gripper",
                ),
            },
            None => (
                IncidentKind::PartDropped,
                "the gripper opened with the set not resting on a place",
            ),
        };
        records.note(
            UNIT,
            cause.0,
            format!("a set of {} parts fell: {}", set.parts.len(), cause.1),
        );
        for part in set.parts {
            records.damage(part);
            records.lose(part);
        }
    }

    /// Sets leave the rack from behind, but not while the fork is in their slot.
    fn dispatch(&mut self, entered: Option<(Place, i32)>) {
        let fork_out = !self.fork.cylinder.is_home();
        for (index, slot) in self.slots_us.iter_mut().enumerate() {
            let Some(since_us) = slot else { continue };
            *since_us = since_us.saturating_add(TICK_US);
            let fork_inside = fork_out
                && matches!(entered, Some((Place::Slot(entered), _)) if usize::from(entered) == index);
            if *since_us >= DISPATCH_US && !fork_inside {
                *slot = None;
            }
        }
    }
}

/// Enters a set that was laid into the rack as a product, and checks it against its order.
fn store(set: &HeldSet, slot: u8, order: u16, orders: u16, records: &mut Records) {
    let variant = Variant::ordered(records.seed, order);
    let parts: Vec<_> = set.parts.iter().map(|part| records.part(*part)).collect();
    let mut good = true;
    let mut wrong = |kind, cause: String| {
        good = false;
        records.note(UNIT, kind, cause);
    };
    if parts.len() < SET_PIECES {
        wrong(
            IncidentKind::IncompleteSet,
            format!(
                "the set stored for order {order} has {} of {SET_PIECES} parts",
                parts.len()
            ),
        );
    }
    if !variant.is_met_by(&parts) {
        wrong(
            IncidentKind::WrongSet,
            format!(
                "the set stored for order {order} is not what was ordered ({variant}): {parts:?}"
            ),
        );
    }
    let exists = (1..=orders).contains(&order);
    if !exists {
        wrong(
            IncidentKind::WrongOrder,
            format!("a set was stored for order {order}, orders are 1 to {orders}"),
        );
    } else if records
        .products
        .iter()
        .any(|product| product.order == order)
    {
        good = false;
        records.note(
            UNIT,
            IncidentKind::WrongOrder,
            format!("a set was stored for order {order}, which was delivered before"),
        );
    }
    let stored_at_us = records.now_us;
    let pallet = set.pallet;
    records.store(&set.parts, |parts| Product {
        order,
        variant,
        parts,
        pallet,
        slot,
        stored_at_us,
        good,
    });
}

fn setpoint_um(word: u16) -> i32 {
    i32::from(word as i16) * REGISTER_UM
}

fn register(value: i32) -> u16 {
    value.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16 as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_documented_place_is_found_from_its_registers() {
        let mut station = StorageStation::new();
        let mut seen = 0;
        for slot in 0..i32::from(SLOTS) {
            station.x.position_um = (2000 + 800 * (slot % 4)) * REGISTER_UM;
            station.z.position_um = (500 + 1000 * (slot / 4)) * REGISTER_UM;
            assert_eq!(station.place(), Some((Place::Slot(slot as u8), 0)));
            seen += 1;
        }
        station.x.position_um = 500 * REGISTER_UM;
        station.z.position_um = 1000 * REGISTER_UM;
        assert_eq!(station.place(), Some((Place::Transfer, 0)));
        station.x.position_um += ENTRY_X_UM + 1;
        assert_eq!(station.place(), None);
        assert_eq!(seen, 12);
    }
}
