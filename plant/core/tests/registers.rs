//! `deploy/fms200/REGISTERS.md` and the table of signals say the same, and random writes break nothing.

mod common;

use common::{assert_conserved, plant};
use fam_plant_core::signals::{ALL, SignalType, Table};
use fam_plant_core::{COILS, DISCRETE_INPUTS, HOLDING_REGISTERS, INPUT_REGISTERS};
use proptest::prelude::*;

const DOCUMENT: &str = include_str!("../../../deploy/fms200/REGISTERS.md");

#[test]
fn the_document_lists_exactly_the_signals() {
    let documented: Vec<String> = DOCUMENT
        .lines()
        .filter(|line| line.starts_with("| S") || line.starts_with("| T_"))
        .map(|line| {
            line.split('|')
                .skip(1)
                .take(5)
                .map(str::trim)
                .collect::<Vec<_>>()
                .join(" ")
        })
        .collect();
    let built: Vec<String> = ALL
        .iter()
        .map(|signal| {
            let table = match signal.table {
                Table::DiscreteInput => "DI",
                Table::Coil => "CO",
                Table::InputRegister => "IR",
                Table::HoldingRegister => "HR",
            };
            let signal_type = match signal.signal_type {
                SignalType::Bool => "BOOL",
                SignalType::Int => "INT",
                SignalType::Uint => "UINT",
            };
            let safe = signal.safe.map_or(String::new(), |safe| safe.to_string());
            format!(
                "{} {table} {} {signal_type} {safe}",
                signal.name, signal.address
            )
        })
        .collect();
    let documented: Vec<&str> = documented
        .iter()
        .map(String::as_str)
        .filter(|line| !line.starts_with("signal"))
        .collect();
    assert_eq!(documented, built);
}

#[test]
fn no_two_signals_share_an_address_and_all_lie_in_the_image() {
    let mut seen = std::collections::BTreeSet::new();
    for signal in ALL {
        assert!(
            seen.insert((signal.unit, signal.table, signal.address)),
            "{} shares its address",
            signal.name
        );
        let size = match signal.table {
            Table::DiscreteInput => DISCRETE_INPUTS,
            Table::Coil => COILS,
            Table::InputRegister => INPUT_REGISTERS,
            Table::HoldingRegister => HOLDING_REGISTERS,
        };
        assert!(
            signal.address < size,
            "{} lies beyond the image",
            signal.name
        );
        let prefix = if signal.unit == 5 {
            "T_".to_string()
        } else {
            format!("S{}_", signal.unit)
        };
        assert!(
            signal.name.starts_with(&prefix),
            "{} is in unit {}",
            signal.name,
            signal.unit
        );
    }
}

#[test]
fn what_the_cell_has_not_is_refused_by_name() {
    let mut p = plant(0);
    let cases = [
        (
            p.write_coil(6, 0, true),
            "there is no unit 6: the cell has units 1 (base) to 5 (transport)",
        ),
        (
            p.write_coil(0, 0, true),
            "there is no unit 0: the cell has units 1 (base) to 5 (transport)",
        ),
        (
            p.write_coils(1, 31, &[true, true]),
            "unit 1 has no coil 32: the last one is 31",
        ),
        (
            p.write_holding_registers(4, 9, &[1]),
            "unit 4 has no holding register 9: the last one is 3",
        ),
        (
            p.write_holding_registers(4, u16::MAX, &[1, 2]),
            "unit 4 has no holding register 65535: the last one is 3",
        ),
    ];
    for (result, message) in cases {
        assert_eq!(result.expect_err("refused").to_string(), message);
    }
    assert!(p.write_coils(1, 31, &[true]).is_ok());
}

#[derive(Clone, Debug)]
enum Write {
    Coil(u8, u16, bool),
    Register(u8, u16, u16),
    Wait(u64),
}

fn write() -> impl Strategy<Value = Write> {
    let coil = (1_u8..=5, 0_u16..17, any::<bool>())
        .prop_map(|(unit, address, on)| Write::Coil(unit, address, on));
    let register = (
        1_u8..=5,
        0_u16..4,
        prop_oneof![0_u16..8, (0_u16..4_000), any::<u16>()],
    )
        .prop_map(|(unit, address, value)| Write::Register(unit, address, value));
    let wait = (1_000_u64..600_000).prop_map(Write::Wait);
    prop_oneof![5 => coil, 2 => register, 4 => wait]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_writes_never_lose_count_of_a_part(seed in any::<u64>(), writes in prop::collection::vec(write(), 1..250)) {
        let mut p = plant(seed);
        // Suction and belt on, so that parts and pallets travel.
        for (unit, address) in [(1, 6), (2, 9), (3, 6), (5, 16)] {
            p.write_coil(unit, address, true).expect("coil");
        }
        for write in writes {
            match write {
                Write::Coil(unit, address, on) => p.write_coil(unit, address, on).expect("coil"),
                Write::Register(unit, address, value) => p.write_holding_register(unit, address, value).expect("register"),
                Write::Wait(us) => p.step(us),
            }
            assert_conserved(&p);
        }
    }

    /// Random writes on a cell in full production, where more can go wrong.
    #[test]
    fn random_disturbance_of_production_never_loses_count_of_a_part(
        moment in 2_000_u32..6_000,
        writes in prop::collection::vec(write(), 1..100),
    ) {
        let mut p = plant(9);
        let mut sequencer = common::Sequencer::default();
        sequencer.run(&mut p, moment);
        for write in writes {
            match write {
                Write::Coil(unit, address, on) => p.write_coil(unit, address, on).expect("coil"),
                Write::Register(unit, address, value) => p.write_holding_register(unit, address, value).expect("register"),
                Write::Wait(us) => sequencer.run(&mut p, (us / 20_000) as u32),
            }
            assert_conserved(&p);
        }
    }
}
