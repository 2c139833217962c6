//! Reads and writes planned for a small cell, against a device in memory.

use super::*;
use fam_proto::diagnosis::Diagnosis;
use fam_proto::model::{FieldDriver, GatewayModel, InputPoint, McModel, OutputPoint, Settings};
use fam_proto::{CellId, ControllerId, LayoutHash};
use proptest::prelude::*;
use std::collections::BTreeSet;

const UNIT: u8 = 1;

fn name(text: &str) -> McId {
    McId::new(text).unwrap()
}

fn point(table: ModbusTable, address: u16) -> FieldPoint {
    FieldPoint::Modbus {
        unit: UNIT,
        table,
        address,
    }
}

fn mc(mc: &str, inputs: Vec<(Place, FieldPoint)>, outputs: Vec<(Place, FieldPoint)>) -> McModel {
    McModel {
        mc: name(mc),
        gateway: GatewayId::new("g").unwrap(),
        hosts: vec![ControllerId::new("c").unwrap()],
        criticality: 1,
        cycle_us: 5_000,
        worst_case_us: 100,
        memory_kb: 1,
        watchdog_us: 1_000_000,
        suspect_us: 50_000,
        hash: 1,
        layout: LayoutHash(1),
        diagnosis: Diagnosis {
            state_offset: 0,
            checkpoint_len: 8,
            intervals: vec![],
            stop_action: None,
        },
        inputs: inputs
            .into_iter()
            .map(|(place, point)| InputPoint {
                name: "I".to_owned(),
                number: fam_proto::model::Number::Unsigned,
                place,
                source: InputSource::Field(point),
            })
            .collect(),
        inputs_len: 16,
        outputs: outputs
            .into_iter()
            .map(|(place, point)| OutputPoint {
                name: "Q".to_owned(),
                number: fam_proto::model::Number::Unsigned,
                place,
                field: Some(point),
            })
            .collect(),
        fail_safe: vec![0; 16],
    }
}

fn cell(mcs: Vec<McModel>) -> CellModel {
    CellModel {
        cell: CellId::new("cell").unwrap(),
        controllers: vec![],
        mcs,
        gateways: vec![GatewayModel {
            gateway: GatewayId::new("g").unwrap(),
            tick_us: 5_000,
            driver: FieldDriver::Modbus {
                address: "127.0.0.1:1502".to_owned(),
            },
        }],
        settings: Settings::default(),
    }
}

fn gateway() -> GatewayId {
    GatewayId::new("g").unwrap()
}

fn bit(byte: u32, bit: u8) -> Place {
    Place::Bit { byte, bit }
}

fn bytes(byte: u32, width: u8) -> Place {
    Place::Bytes { byte, width }
}

#[test]
fn reads_are_grouped_and_reach_their_images() {
    use ModbusTable::{Coil, DiscreteInput, InputRegister};
    let cell = cell(vec![
        mc(
            "A",
            vec![
                (bit(0, 0), point(DiscreteInput, 0)),
                (bit(0, 1), point(DiscreteInput, 1)),
                (bytes(2, 4), point(InputRegister, 10)),
            ],
            vec![],
        ),
        mc(
            "B",
            vec![
                (bit(3, 7), point(DiscreteInput, 2)),
                (bit(4, 0), point(Coil, 5)),
            ],
            vec![],
        ),
    ]);
    let mut plan = ReadPlan::new(&cell, &gateway());
    let got: Vec<_> = plan
        .ranges()
        .iter()
        .map(|r| (r.table.table, r.address, r.count))
        .collect();
    assert_eq!(
        got,
        [(DiscreteInput, 0, 3), (Coil, 5, 1), (InputRegister, 10, 2)]
    );
    let inputs = plan.take(&[
        Some(vec![0, 1, 1]),
        Some(vec![1]),
        Some(vec![0x1234, 0xABCD]),
    ]);
    assert!(inputs.iter().all(|i| i.fresh));
    assert_eq!(inputs[0].bytes[..6], [0b10, 0, 0x34, 0x12, 0xCD, 0xAB]);
    assert_eq!(inputs[1].bytes[3..5], [0x80, 1]);

    // One request without an answer: its MC keeps all of its last inputs, the other one goes on.
    let inputs = plan.take(&[Some(vec![1, 0, 0]), Some(vec![0]), None]);
    assert!(!inputs[0].fresh && inputs[1].fresh);
    assert_eq!(inputs[0].bytes[..6], [0b10, 0, 0x34, 0x12, 0xCD, 0xAB]);
    assert_eq!(inputs[1].bytes[3..5], [0, 0]);
}

#[test]
fn long_ranges_are_split_and_wide_values_survive_it() {
    let inputs = (0..130)
        .map(|n| (bytes(0, 2), point(ModbusTable::HoldingRegister, n)))
        .chain([(bytes(8, 8), point(ModbusTable::HoldingRegister, 123))])
        .collect();
    let mut plan = ReadPlan::new(&cell(vec![mc("A", inputs, vec![])]), &gateway());
    let counts: Vec<_> = plan.ranges().iter().map(|r| r.count).collect();
    assert_eq!(counts, [125, 5]);
    let answers: Vec<_> = plan
        .ranges()
        .iter()
        .map(|r| Some((r.address..r.address + r.count).collect::<Vec<_>>()))
        .collect();
    let inputs = plan.take(&answers);
    assert!(inputs[0].fresh);
    assert_eq!(inputs[0].bytes[8..], [123, 0, 124, 0, 125, 0, 126, 0]);
}

#[test]
fn only_changes_are_written_and_all_of_it_after_a_reconnect() {
    use ModbusTable::{Coil, HoldingRegister};
    let outputs = vec![
        (bit(0, 0), point(Coil, 0)),
        (bit(0, 1), point(Coil, 1)),
        (bit(0, 2), point(Coil, 2)),
        (bit(0, 3), point(Coil, 9)),
        (bytes(2, 4), point(HoldingRegister, 0)),
    ];
    let mut plan = WritePlan::new(&cell(vec![mc("A", vec![], outputs)]), &gateway());
    assert_eq!(plan.next(), None, "nothing is wanted yet");
    let drain = |plan: &mut WritePlan| {
        let mut writes = Vec::new();
        while let Some(write) = plan.next() {
            plan.written(&write);
            writes.push((write.table.table, write.address, write.values));
        }
        writes
    };
    let mut image = [0_u8; 16];
    image[0] = 0b1001;
    image[2..6].copy_from_slice(&0x0001_0002_u32.to_le_bytes());
    plan.set(&name("A"), &image);
    let all = [
        (Coil, 0, vec![1, 0, 0]),
        (Coil, 9, vec![1]),
        (HoldingRegister, 0, vec![2, 1]),
    ];
    assert_eq!(drain(&mut plan), all);
    plan.set(&name("A"), &image);
    assert_eq!(drain(&mut plan), [], "nothing has changed");
    image[0] = 0b1100;
    plan.set(&name("A"), &image);
    assert_eq!(drain(&mut plan), [(Coil, 0, vec![0, 0, 1])]);
    plan.forget();
    assert!(plan.is_due());
    assert_eq!(drain(&mut plan).len(), 3);
    plan.set(&name("other"), &image);
    assert_eq!(drain(&mut plan), []);
}

proptest! {
    /// Whatever is set, and wherever writes fail, the device ends with exactly what is wanted, and nothing else is touched.
    #[test]
    fn the_device_ends_with_what_is_wanted(addresses in prop::collection::btree_set(0_u16..40, 1..16), steps in prop::collection::vec((any::<u16>(), any::<bool>()), 1..20)) {
        let outputs: Vec<_> = addresses.iter().enumerate().map(|(n, address)| (bit(n as u32 / 8, n as u8 % 8), point(ModbusTable::Coil, *address))).collect();
        let mut plan = WritePlan::new(&cell(vec![mc("A", vec![], outputs)]), &gateway());
        let mut device: BTreeMap<u16, u16> = BTreeMap::new();
        let mut wanted = 0_u16;
        for (value, fails) in steps {
            wanted = value;
            plan.set(&name("A"), &value.to_le_bytes());
            if fails {
                plan.forget();
                continue;
            }
            while let Some(write) = plan.next() {
                device.extend((write.address..).zip(write.values.iter().copied()));
                plan.written(&write);
            }
        }
        while let Some(write) = plan.next() {
            device.extend((write.address..).zip(write.values.iter().copied()));
            plan.written(&write);
        }
        let touched: BTreeSet<u16> = device.keys().copied().collect();
        prop_assert_eq!(&touched, &addresses);
        for (n, address) in addresses.iter().enumerate() {
            prop_assert_eq!(device[address], wanted >> n & 1, "address {}", address);
        }
    }
}
