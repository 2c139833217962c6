//! The `image` driver: points in memory, set and read by people and scripts, for a cell without a plant.

use fam_gateway_core::place;
use fam_proto::model::{CellModel, FieldPoint, InputSource, Number, Place};
use fam_proto::{GatewayId, McId, McInputs};
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// A point in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Point {
    /// Its value, zero-extended.
    pub value: u64,
    /// Its width in bits.
    pub bits: u32,
    /// How its bits are read.
    pub number: Number,
    /// Whether an MC sets it: then nobody else does.
    pub driven: bool,
}

#[derive(Debug)]
struct Slot {
    mc: McId,
    place: Place,
    point: String,
}

/// Why a point cannot be set.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SetError {
    /// No such point.
    #[error("there is no point `{point}`; `fam io get` lists all points")]
    Unknown {
        /// The name given.
        point: String,
    },
    /// An output.
    #[error("the point `{point}` is an output of an MC; only inputs can be set")]
    Driven {
        /// The name given.
        point: String,
    },
}

/// All points of a gateway.
#[derive(Debug)]
pub struct Points {
    inputs: Vec<Slot>,
    outputs: Vec<Slot>,
    lengths: BTreeMap<McId, usize>,
    points: Mutex<BTreeMap<String, Point>>,
}

impl Points {
    /// The points that the gateway's MCs name, all 0. A point that one MC sets and another reads connects the two.
    #[must_use]
    pub fn new(cell: &CellModel, gateway: &GatewayId) -> Points {
        let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
        let mut lengths = BTreeMap::new();
        let mut points: BTreeMap<String, Point> = BTreeMap::new();
        let mut add = |name: &str, at: Place, number: Number, driven| {
            let bits = place::width_bits(at);
            let point = points.entry(name.to_owned()).or_insert(Point {
                value: 0,
                bits,
                number,
                driven,
            });
            point.bits = point.bits.max(bits);
            point.driven |= driven;
        };
        for model in cell.mcs.iter().filter(|mc| &mc.gateway == gateway) {
            let slot = |place, point: &str| Slot {
                mc: model.mc.clone(),
                place,
                point: point.to_owned(),
            };
            for input in &model.inputs {
                if let InputSource::Field(FieldPoint::Image(point)) = &input.source {
                    add(point, input.place, input.number, false);
                    inputs.push(slot(input.place, point));
                    lengths.insert(model.mc.clone(), model.inputs_len as usize);
                }
            }
            for output in &model.outputs {
                if let Some(FieldPoint::Image(point)) = &output.field {
                    add(point, output.place, output.number, true);
                    outputs.push(slot(output.place, point));
                }
            }
        }
        Points {
            inputs,
            outputs,
            lengths,
            points: Mutex::new(points),
        }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Point>> {
        self.points.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The inputs of all MCs that read points.
    #[must_use]
    pub fn inputs(&self) -> Vec<McInputs> {
        let mut images: BTreeMap<&McId, Vec<u8>> = self
            .lengths
            .iter()
            .map(|(mc, len)| (mc, vec![0; *len]))
            .collect();
        let points = self.lock();
        for slot in &self.inputs {
            if let (Some(image), Some(point)) = (images.get_mut(&slot.mc), points.get(&slot.point))
            {
                place::set(image, slot.place, point.value);
            }
        }
        images
            .into_iter()
            .map(|(mc, bytes)| McInputs {
                mc: mc.clone(),
                bytes,
                fresh: true,
            })
            .collect()
    }

    /// Sets the points that an MC drives.
    pub fn apply(&self, mc: &McId, outputs: &[u8]) {
        let mut points = self.lock();
        for slot in self.outputs.iter().filter(|slot| &slot.mc == mc) {
            if let (Some(value), Some(point)) =
                (place::get(outputs, slot.place), points.get_mut(&slot.point))
            {
                point.value = value;
            }
        }
    }

    /// All points.
    #[must_use]
    pub fn all(&self) -> BTreeMap<String, Point> {
        self.lock().clone()
    }

    /// Sets points from outside: all of them, or none.
    ///
    /// # Errors
    /// [`SetError`] for the first one that cannot be set.
    pub fn set(&self, values: &[(String, u64)]) -> Result<(), SetError> {
        let mut points = self.lock();
        for (name, _) in values {
            match points.get(name) {
                None => {
                    return Err(SetError::Unknown {
                        point: name.clone(),
                    });
                }
                Some(point) if point.driven => {
                    return Err(SetError::Driven {
                        point: name.clone(),
                    });
                }
                Some(_) => {}
            }
        }
        for (name, value) in values {
            if let Some(point) = points.get_mut(name) {
                point.value = *value;
            }
        }
        Ok(())
    }
}
