//! The cell that hostile bytes are thrown at: two controllers, one MC, one gateway.

use fam_node_core::McSpec;
use fam_node_core::model_mc::{INPUTS_LEN, ModelMc, OUTPUTS_LEN};
use fam_proto::model::{
    CellModel, ControllerModel, FieldDriver, FieldPoint, GatewayModel, InputPoint, InputSource,
    McModel, OutputPoint, Place, Settings,
};
use fam_proto::{BootId, CellId, ControllerId, GatewayId, McId, NameError, Owner};

/// Bytes of the MC's state beyond its own.
const PADDING: usize = 24;
const TICK_US: u32 = 5_000;

fn sure<T>(name: Result<T, NameError>) -> T {
    match name {
        Ok(name) => name,
        Err(error) => unreachable!("{error}"),
    }
}

/// The MC.
#[must_use]
pub fn mc_id() -> McId {
    sure(McId::new("Station1"))
}

/// Its gateway.
#[must_use]
pub fn gateway_id() -> GatewayId {
    sure(GatewayId::new("gateway1"))
}

/// The `n`-th controller (1 or 2) in its first life.
#[must_use]
pub fn owner(n: u64) -> Owner {
    Owner {
        controller: sure(ControllerId::new(&format!("controller{n}"))),
        boot: BootId(1_700_000_000_000_000 + n),
    }
}

/// What a node knows of the MC.
pub(crate) fn spec() -> McSpec {
    ModelMc::spec(0, mc_id(), gateway_id(), TICK_US, PADDING)
}

/// An instance of it.
pub(crate) fn instance() -> ModelMc {
    ModelMc::new(PADDING)
}

/// The model of the cell.
#[must_use]
pub fn cell() -> CellModel {
    let controllers = [owner(1), owner(2)].map(|owner| ControllerModel {
        controller: owner.controller,
        description: "PLC".to_owned(),
        cpu_factor_permille: 1_000,
        memory_kb: 10_000,
        limit_permille: 700,
        tick_us: TICK_US,
    });
    let mut fail_safe = vec![0; OUTPUTS_LEN];
    fail_safe[0] = 0xFA;
    CellModel {
        cell: sure(CellId::new("cell")),
        mcs: vec![McModel {
            mc: mc_id(),
            gateway: gateway_id(),
            hosts: controllers.iter().map(|c| c.controller.clone()).collect(),
            criticality: 1,
            cycle_us: TICK_US,
            worst_case_us: 100,
            memory_kb: 100,
            watchdog_us: 500_000,
            suspect_us: 60_000,
            hash: 7,
            layout: ModelMc::layout(PADDING),
            diagnosis: ModelMc::diagnosis(PADDING),
            inputs: vec![InputPoint {
                name: "In".to_owned(),
                number: fam_proto::model::Number::Unsigned,
                place: Place::Bytes { byte: 0, width: 2 },
                source: InputSource::Field(FieldPoint::Image("In".to_owned())),
            }],
            inputs_len: INPUTS_LEN as u32,
            outputs: vec![OutputPoint {
                name: "Out".to_owned(),
                number: fam_proto::model::Number::Unsigned,
                place: Place::Bytes { byte: 0, width: 1 },
                field: Some(FieldPoint::Image("Out".to_owned())),
            }],
            fail_safe,
        }],
        gateways: vec![GatewayModel {
            gateway: gateway_id(),
            tick_us: TICK_US,
            driver: FieldDriver::Image,
        }],
        settings: Settings::default(),
        controllers: controllers.to_vec(),
    }
}
