//! Each kind of incident is provoked by wrong outputs, and is seen as what it is, once.

mod common;

use common::{Sequencer, assert_conserved, drive_to, is, kinds, plant, put, set, until};
use fam_plant_core::IncidentKind::{self, *};
use fam_plant_core::{Plant, PlantConfig};

fn pulse_until(p: &mut Plant, coil: &str, sensor: &str) {
    set(p, coil, true);
    until(p, sensor, true);
    set(p, coil, false);
}

fn base_at_check(p: &mut Plant) {
    until(p, "S1_MagazinePart", true);
    pulse_until(p, "S1_PusherExtend", "S1_PusherExtended");
    until(p, "S1_PusherRetracted", true);
}

fn base_in_hand(p: &mut Plant) {
    base_at_check(p);
    set(p, "S1_HandLower", true);
    until(p, "S1_HandDown", true);
    set(p, "S1_Suction", true);
    until(p, "S1_Vacuum", true);
    set(p, "S1_HandLower", false);
    until(p, "S1_HandUp", true);
}

fn shaft_in_nest(p: &mut Plant) {
    until(p, "S2_ShaftMagazinePart", true);
    pulse_until(p, "S2_ShaftPusherExtend", "S2_ShaftPusherExtended");
    until(p, "S2_ShaftPusherRetracted", true);
}

fn lid_in_nest(p: &mut Plant) {
    until(p, "S3_MagazinePart", true);
    pulse_until(p, "S3_PusherExtend", "S3_PusherExtended");
    until(p, "S3_PusherRetracted", true);
}

/// Lifts the first pallet that comes to a stop; those before it let one through.
fn pallet_lifted(p: &mut Plant, stop: usize) {
    set(p, "T_BeltRun", true);
    for before in 1..stop {
        until(p, &format!("T_PalletAt{before}"), true);
        set(p, &format!("T_StopperOpen{before}"), true);
        until(p, &format!("T_PalletAt{before}"), false);
        set(p, &format!("T_StopperOpen{before}"), false);
    }
    until(p, &format!("T_PalletAt{stop}"), true);
    pulse_until(
        p,
        &format!("T_LifterRaise{stop}"),
        &format!("T_LifterUp{stop}"),
    );
}

fn hand1_at_pallet(p: &mut Plant) {
    pulse_until(p, "S1_ArmToPallet", "S1_ArmAtPallet");
    set(p, "S1_HandLower", true);
    until(p, "S1_HandDown", true);
}

/// The storage with a set in the gripper, on its way to the rack.
fn set_in_gripper(p: &mut Plant) -> Sequencer {
    let mut sequencer = Sequencer::default();
    sequencer.run_until_storage_step(p, 8);
    sequencer.run(p, 20);
    sequencer
}

type Scenario = (&'static str, u8, IncidentKind, fn(&mut Plant));

const SCENARIOS: &[Scenario] = &[
    ("suction off on the way", 1, PartDropped, |p| {
        base_in_hand(p);
        set(p, "S1_ArmToPallet", true);
        p.step(100_000);
        set(p, "S1_Suction", false);
    }),
    (
        "suction off with the hand up over the nest",
        1,
        PartDropped,
        |p| {
            base_in_hand(p);
            set(p, "S1_Suction", false);
        },
    ),
    ("gripper opened on the way", 4, PartDropped, |p| {
        set_in_gripper(p);
        set(p, "S4_GripOpen", true);
    }),
    ("base let go where no pallet is", 1, PartLost, |p| {
        base_in_hand(p);
        hand1_at_pallet(p);
        set(p, "S1_Suction", false);
    }),
    ("shaft put onto a pallet without a base", 2, PartLost, |p| {
        pallet_lifted(p, 2);
        shaft_in_nest(p);
        set(p, "S2_ArmEnable", true);
        put(p, "S2_ArmTarget", 2);
        p.step(1_000_000);
        set(p, "S2_HandLower", true);
        set(p, "S2_Suction", true);
        until(p, "S2_Vacuum", true);
        set(p, "S2_HandLower", false);
        until(p, "S2_HandUp", true);
        put(p, "S2_ArmTarget", 1);
        p.step(1_000_000);
        set(p, "S2_HandLower", true);
        until(p, "S2_HandDown", true);
        set(p, "S2_Suction", false);
    }),
    ("pushed into an occupied nest", 1, TwoPartsInOnePlace, |p| {
        base_at_check(p);
        base_at_check(p);
    }),
    (
        "lid pushed into an occupied nest",
        3,
        TwoPartsInOnePlace,
        |p| {
            lid_in_nest(p);
            lid_in_nest(p);
        },
    ),
    (
        "held part lowered onto another",
        1,
        TwoPartsInOnePlace,
        |p| {
            base_in_hand(p);
            base_at_check(p);
            set(p, "S1_HandLower", true);
        },
    ),
    (
        "base lowered onto a pallet that has one",
        1,
        TwoPartsInOnePlace,
        |p| {
            pallet_lifted(p, 1);
            for _ in 0..2 {
                base_in_hand(p);
                hand1_at_pallet(p);
                set(p, "S1_Suction", false);
                until(p, "S1_Vacuum", false);
                set(p, "S1_HandLower", false);
                until(p, "S1_HandUp", true);
                pulse_until(p, "S1_ArmToCheck", "S1_ArmAtCheck");
            }
        },
    ),
    (
        "set put into an occupied slot",
        4,
        TwoPartsInOnePlace,
        |p| {
            let mut sequencer = Sequencer::default();
            sequencer.run_until_products(p, 1);
            sequencer.run_until_storage_step(p, 8);
            drive_to(p, 2000, 700);
            set(p, "S4_ForkExtend", true);
        },
    ),
    ("both coils of an arm", 1, DrivenAgainstStop, |p| {
        set(p, "S1_ArmToPallet", true);
        set(p, "S1_ArmToCheck", true);
    }),
    ("both coils of the selector", 2, DrivenAgainstStop, |p| {
        set(p, "S2_SelectNylon", true);
        set(p, "S2_SelectAluminium", true);
    }),
    ("both coils of the gripper", 4, DrivenAgainstStop, |p| {
        set(p, "S4_GripOpen", true);
        set(p, "S4_GripClose", true);
    }),
    ("both coils of a lifter", 5, DrivenAgainstStop, |p| {
        set(p, "T_LifterRaise3", true);
        set(p, "T_LifterLower3", true);
    }),
    (
        "arm sent to a place that it has not",
        2,
        DrivenAgainstStop,
        |p| {
            set(p, "S2_ArmEnable", true);
            put(p, "S2_ArmTarget", 3);
        },
    ),
    (
        "turret sent to a place that it has not",
        3,
        DrivenAgainstStop,
        |p| {
            set(p, "S3_TurretEnable", true);
            put(p, "S3_TurretTarget", 6);
        },
    ),
    ("axis against its end stop", 4, DrivenAgainstStop, |p| {
        set(p, "S4_AxesEnable", true);
        put(p, "S4_XSetpoint", -300_i16 as u16);
    }),
    ("set-point jumps", 4, FollowingError, |p| {
        set(p, "S4_AxesEnable", true);
        put(p, "S4_ZSetpoint", 1000);
    }),
    ("arm moves with the hand down", 1, Collision, |p| {
        set(p, "S1_HandLower", true);
        until(p, "S1_HandDown", true);
        set(p, "S1_ArmToPallet", true);
    }),
    (
        "arm of station 2 moves with the hand down",
        2,
        Collision,
        |p| {
            set(p, "S2_HandLower", true);
            until(p, "S2_HandDown", true);
            set(p, "S2_ArmEnable", true);
            put(p, "S2_ArmTarget", 2);
        },
    ),
    ("pushed under the lowered gauge", 1, Collision, |p| {
        set(p, "S1_GaugeLower", true);
        until(p, "S1_GaugeContact", true);
        base_at_check(p);
    }),
    ("pushed under the measuring head", 2, Collision, |p| {
        set(p, "S2_HeadTraverse", true);
        until(p, "S2_HeadEnd", true);
        until(p, "S2_BearingMagazinePart", true);
        set(p, "S2_BearingPusherExtend", true);
    }),
    ("pushed under the lowered hand", 3, Collision, |p| {
        set(p, "S3_HandLower", true);
        until(p, "S3_HandDown", true);
        lid_in_nest(p);
    }),
    ("ejector against pusher", 1, Collision, |p| {
        set(p, "S1_PusherExtend", true);
        p.step(20_000);
        set(p, "S1_EjectorExtend", true);
    }),
    ("ejector against gauge", 3, Collision, |p| {
        set(p, "S3_GaugeLower", true);
        until(p, "S3_GaugeContact", true);
        set(p, "S3_EjectorExtend", true);
    }),
    ("ejector against hand", 1, Collision, |p| {
        set(p, "S1_HandLower", true);
        until(p, "S1_HandDown", true);
        set(p, "S1_EjectorExtend", true);
    }),
    ("gauge against hand", 3, Collision, |p| {
        set(p, "S3_HandLower", true);
        until(p, "S3_HandDown", true);
        set(p, "S3_GaugeLower", true);
    }),
    ("selector moves with the pusher out", 2, Collision, |p| {
        set(p, "S2_ShaftPusherExtend", true);
        until(p, "S2_ShaftPusherExtended", true);
        set(p, "S2_SelectNylon", true);
    }),
    ("turret moves with the pusher out", 3, Collision, |p| {
        set(p, "S3_PusherExtend", true);
        until(p, "S3_PusherExtended", true);
        put(p, "S3_TurretTarget", 4);
        set(p, "S3_TurretEnable", true);
    }),
    ("pushed between two magazines", 3, Collision, |p| {
        put(p, "S3_TurretTarget", 4);
        set(p, "S3_TurretEnable", true);
        p.step(150_000);
        set(p, "S3_TurretEnable", false);
        p.step(10_000);
        set(p, "S3_PusherExtend", true);
    }),
    ("lifter moves under the hand", 1, Collision, |p| {
        pallet_lifted(p, 1);
        hand1_at_pallet(p);
        set(p, "T_LifterLower1", true);
    }),
    ("hand lowered into an unlifted pallet", 1, Collision, |p| {
        set(p, "T_BeltRun", true);
        until(p, "T_PalletAt1", true);
        hand1_at_pallet(p);
    }),
    ("pallet runs under the lowered hand", 1, Collision, |p| {
        set(p, "T_BeltRun", true);
        until(p, "T_PalletAt1", true);
        set(p, "T_StopperOpen1", true);
        until(p, "T_PalletAt1", false);
        set(p, "T_BeltRun", false);
        hand1_at_pallet(p);
    }),
    ("pallet runs over the raised lifter", 5, Collision, |p| {
        pulse_until(p, "T_LifterRaise1", "T_LifterUp1");
        set(p, "T_BeltRun", true);
    }),
    ("stopper opened under a lifted pallet", 5, Collision, |p| {
        pallet_lifted(p, 1);
        set(p, "T_StopperOpen1", true);
    }),
    ("fork out beside every place", 4, Collision, |p| {
        set(p, "S4_ForkExtend", true);
    }),
    ("axis into the rack at a wrong height", 4, Collision, |p| {
        drive_to(p, 2000, 500 + 350);
        set(p, "S4_ForkExtend", true);
    }),
    ("X moves with the fork out", 4, Collision, |p| {
        drive_to(p, 2000, 500);
        set(p, "S4_ForkExtend", true);
        until(p, "S4_ForkExtended", true);
        put(p, "S4_XSetpoint", 2050);
    }),
    (
        "fork into a set with the gripper closed",
        4,
        Collision,
        |p| {
            Sequencer::default().run_until_storage_step(p, 4);
            set(p, "S4_ForkExtend", false);
            set(p, "S4_GripClose", true);
            p.step(20_000);
            set(p, "S4_ForkExtend", true);
        },
    ),
    (
        "set torn off the pallet without lifting",
        4,
        Collision,
        |p| {
            Sequencer::default().run_until_storage_step(p, 6);
            set(p, "S4_ForkRetract", true);
        },
    ),
    ("lifter moves under the fork", 4, Collision, |p| {
        Sequencer::default().run_until_storage_step(p, 5);
        set(p, "T_LifterLower4", true);
    }),
    ("set stored with parts missing", 4, IncompleteSet, |p| {
        let mut sequencer = Sequencer::default();
        for _ in 0..3_000 {
            sequencer.run(p, 1);
            sequencer.skip_to_storage();
        }
    }),
    ("set stored for another order", 4, WrongSet, |p| {
        let mut sequencer = Sequencer::default();
        sequencer.run_until_storage_step(p, 10);
        let other = (2..100)
            .find(|order| p.ordered(*order) != p.ordered(1))
            .expect("orders differ");
        put(p, "S4_OrderNumber", other);
        sequencer.run_until_products(p, 1);
    }),
    ("set stored for an order that is not", 4, WrongOrder, |p| {
        let mut sequencer = Sequencer::default();
        sequencer.run_until_storage_step(p, 10);
        // Beyond the last order, but of the same variant, so that nothing else is wrong.
        let beyond = (1001..u16::MAX)
            .find(|order| p.ordered(*order) == p.ordered(1))
            .expect("variants repeat");
        put(p, "S4_OrderNumber", beyond);
        sequencer.run_until_products(p, 1);
    }),
    ("order delivered twice", 4, WrongOrder, |p| {
        let mut sequencer = Sequencer::default();
        let again = (2..20)
            .find(|order| p.ordered(*order) == p.ordered(1))
            .expect("variants repeat");
        sequencer.run_until_products(p, usize::from(again) - 1);
        sequencer.run_until_storage_step(p, 10);
        put(p, "S4_OrderNumber", 1);
        sequencer.run_until_products(p, usize::from(again));
    }),
];

#[test]
fn wrong_outputs_are_punished_as_what_they_are() {
    for (name, unit, kind, provoke) in SCENARIOS {
        let mut p = plant(3);
        provoke(&mut p);
        p.step(400_000);
        let first = p
            .incidents()
            .first()
            .map(|incident| (incident.unit, incident.kind));
        assert_eq!(first, Some((*unit, *kind)), "{name}: {:#?}", p.incidents());
        assert_conserved(&p);
    }
}

#[test]
fn every_kind_of_incident_is_provoked() {
    let kinds: std::collections::BTreeSet<_> =
        SCENARIOS.iter().map(|(_, _, kind, _)| *kind).collect();
    let all = [
        PartDropped,
        PartLost,
        TwoPartsInOnePlace,
        DrivenAgainstStop,
        FollowingError,
        Collision,
        IncompleteSet,
        WrongSet,
        WrongOrder,
    ];
    assert_eq!(kinds.into_iter().collect::<Vec<_>>(), all);
}

#[test]
fn an_incident_is_counted_when_it_begins_and_again_only_after_it_has_ended() {
    let mut p = plant(0);
    set(&mut p, "S1_ArmToPallet", true);
    for begin in 1..=2 {
        set(&mut p, "S1_ArmToCheck", true);
        p.step(300_000);
        assert_eq!(kinds(p.incidents()), vec![(1, DrivenAgainstStop); begin]);
        set(&mut p, "S1_ArmToCheck", false);
        p.step(300_000);
    }
}

#[test]
fn an_incident_says_when_where_and_why() {
    let mut p = plant(0);
    base_in_hand(&mut p);
    set(&mut p, "S1_Suction", false);
    p.step(100_000);
    let text = p.incidents()[0].to_string();
    assert!(text.ends_with("s, station 1 (base): part-dropped: base 0.1 fell: the suction let go with the hand not fully down"), "{text}");
    assert_eq!((p.ledger().lost, p.ledger().damaged), (1, 1));
}

#[test]
fn a_tripped_drive_stands_until_it_is_disabled() {
    let mut p = plant(0);
    set(&mut p, "S4_AxesEnable", true);
    put(&mut p, "S4_XSetpoint", 2000);
    p.step(100_000);
    assert!(is(&p, "S4_DriveFault"));
    put(&mut p, "S4_XSetpoint", 100);
    p.step(100_000);
    assert!(is(&p, "S4_DriveFault") && !is(&p, "S4_XInPosition"));
    set(&mut p, "S4_AxesEnable", false);
    p.step(10_000);
    assert!(!is(&p, "S4_DriveFault"));
    drive_to(&mut p, 100, 0);
    assert_eq!(p.incidents_total(), 1);
}

#[test]
fn a_set_that_is_gripped_again_in_the_rack_is_no_product_until_it_lies_there_again() {
    let mut p = plant(3);
    let mut sequencer = Sequencer::default();
    sequencer.run_until_storage_step(&mut p, 11);
    until(&mut p, "S4_GripOpened", true);
    assert_eq!((p.products().len(), p.ledger().stored), (1, 4));
    set(&mut p, "S4_GripOpen", false);
    pulse_until(&mut p, "S4_GripClose", "S4_GripClosed");
    assert!(is(&p, "S4_GripPart"));
    assert_eq!((p.products().len(), p.ledger().stored), (0, 0));
    assert_conserved(&p);
    pulse_until(&mut p, "S4_GripOpen", "S4_GripOpened");
    assert_eq!((p.products().len(), p.incidents_total()), (1, 0));
}

#[test]
fn an_opened_stopper_lets_one_pallet_through() {
    let mut p = plant(0);
    set(&mut p, "T_BeltRun", true);
    until(&mut p, "T_PalletAt1", true);
    set(&mut p, "T_StopperOpen1", true);
    until(&mut p, "T_PalletAt1", false);
    until(&mut p, "T_PalletAt1", true);
    p.step(3_000_000);
    assert!(
        is(&p, "T_PalletAt1"),
        "the second pallet must wait for the next opening"
    );
    set(&mut p, "T_StopperOpen1", false);
    until(&mut p, "T_StopperClosed1", true);
    set(&mut p, "T_StopperOpen1", true);
    until(&mut p, "T_PalletAt1", false);
    assert_eq!(p.incidents(), []);
}

#[test]
fn a_cell_that_cannot_be_is_refused_with_the_reason() {
    let cases = [
        (
            PlantConfig {
                pallets: 0,
                ..PlantConfig::default()
            },
            "the plant has pallets = 0, but the loop takes 1 to 8",
        ),
        (
            PlantConfig {
                pallets: 9,
                ..PlantConfig::default()
            },
            "the plant has pallets = 9, but the loop takes 1 to 8",
        ),
        (
            PlantConfig {
                orders: 0,
                ..PlantConfig::default()
            },
            "the plant has orders = 0: give at least 1, or leave it out for as many as there can be",
        ),
    ];
    for (config, message) in cases {
        assert_eq!(
            Plant::new(config).expect_err("refused").to_string(),
            message
        );
    }
}
