//! The signals of the cell: names, tables and addresses, as `deploy/fms200/REGISTERS.md` documents them (a test keeps the two
//! equal). The modules of constants are what the mechanics use; [`ALL`] is for people and tools that look signals up by name.

use serde::Serialize;

/// Modbus table of a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub enum Table {
    DiscreteInput,
    Coil,
    InputRegister,
    HoldingRegister,
}

/// IEC type of a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub enum SignalType {
    Bool,
    Int,
    Uint,
}

/// One signal of the cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub struct Signal {
    pub name: &'static str,
    /// Modbus unit (slave id), 1 to 5.
    pub unit: u8,
    pub table: Table,
    pub address: u16,
    pub signal_type: SignalType,
    /// Value to give when no controller drives the output; `None` for inputs.
    pub safe: Option<u16>,
}

/// The signal of that name.
pub fn find(name: &str) -> Option<&'static Signal> {
    ALL.iter().find(|signal| signal.name == name)
}

const fn input(name: &'static str, unit: u8, address: u16) -> Signal {
    Signal {
        name,
        unit,
        table: Table::DiscreteInput,
        address,
        signal_type: SignalType::Bool,
        safe: None,
    }
}

const fn coil(name: &'static str, unit: u8, address: u16, safe: u16) -> Signal {
    Signal {
        name,
        unit,
        table: Table::Coil,
        address,
        signal_type: SignalType::Bool,
        safe: Some(safe),
    }
}

const fn word_in(name: &'static str, unit: u8, address: u16, signal_type: SignalType) -> Signal {
    Signal {
        name,
        unit,
        table: Table::InputRegister,
        address,
        signal_type,
        safe: None,
    }
}

const fn word_out(
    name: &'static str,
    unit: u8,
    address: u16,
    signal_type: SignalType,
    safe: u16,
) -> Signal {
    Signal {
        name,
        unit,
        table: Table::HoldingRegister,
        address,
        signal_type,
        safe: Some(safe),
    }
}

/// Addresses of unit 1, base feeding.
pub mod base {
    pub const MAGAZINE_PART: u16 = 0;
    pub const PUSHER_RETRACTED: u16 = 1;
    pub const PUSHER_EXTENDED: u16 = 2;
    pub const CHECK_PART: u16 = 3;
    pub const GAUGE_UP: u16 = 4;
    pub const GAUGE_CONTACT: u16 = 5;
    pub const EJECTOR_RETRACTED: u16 = 6;
    pub const EJECTOR_EXTENDED: u16 = 7;
    pub const ARM_AT_CHECK: u16 = 8;
    pub const ARM_AT_PALLET: u16 = 9;
    pub const HAND_UP: u16 = 10;
    pub const HAND_DOWN: u16 = 11;
    pub const VACUUM: u16 = 12;
    pub const PUSHER_EXTEND: u16 = 0;
    pub const GAUGE_LOWER: u16 = 1;
    pub const EJECTOR_EXTEND: u16 = 2;
    pub const ARM_TO_PALLET: u16 = 3;
    pub const ARM_TO_CHECK: u16 = 4;
    pub const HAND_LOWER: u16 = 5;
    pub const SUCTION: u16 = 6;
    pub const GAUGE_DEPTH: u16 = 0;
}

/// Addresses of unit 2, bearing and shaft.
pub mod bearing {
    pub const BEARING_MAGAZINE_PART: u16 = 0;
    pub const BEARING_PUSHER_RETRACTED: u16 = 1;
    pub const BEARING_PUSHER_EXTENDED: u16 = 2;
    pub const BEARING_NEST_PART: u16 = 3;
    pub const HEAD_HOME: u16 = 4;
    pub const HEAD_END: u16 = 5;
    pub const BEARING_EJECTOR_RETRACTED: u16 = 6;
    pub const BEARING_EJECTOR_EXTENDED: u16 = 7;
    pub const SELECTOR_AT_ALUMINIUM: u16 = 8;
    pub const SELECTOR_AT_NYLON: u16 = 9;
    pub const SHAFT_MAGAZINE_PART: u16 = 10;
    pub const SHAFT_PUSHER_RETRACTED: u16 = 11;
    pub const SHAFT_PUSHER_EXTENDED: u16 = 12;
    pub const SHAFT_NEST_PART: u16 = 13;
    pub const SHAFT_INDUCTIVE: u16 = 14;
    pub const SHAFT_EJECTOR_RETRACTED: u16 = 15;
    pub const SHAFT_EJECTOR_EXTENDED: u16 = 16;
    pub const ARM_IN_POSITION: u16 = 17;
    pub const HAND_UP: u16 = 18;
    pub const HAND_DOWN: u16 = 19;
    pub const VACUUM: u16 = 20;
    pub const BEARING_PUSHER_EXTEND: u16 = 0;
    pub const HEAD_TRAVERSE: u16 = 1;
    pub const BEARING_EJECTOR_EXTEND: u16 = 2;
    pub const SELECT_NYLON: u16 = 3;
    pub const SELECT_ALUMINIUM: u16 = 4;
    pub const SHAFT_PUSHER_EXTEND: u16 = 5;
    pub const SHAFT_EJECTOR_EXTEND: u16 = 6;
    pub const ARM_ENABLE: u16 = 7;
    pub const HAND_LOWER: u16 = 8;
    pub const SUCTION: u16 = 9;
    pub const PROFILE_HEIGHT: u16 = 0;
    pub const PROFILE_POSITION: u16 = 1;
    pub const ARM_POSITION: u16 = 2;
    pub const ARM_TARGET: u16 = 0;
}

/// Addresses of unit 3, lid.
pub mod lid {
    pub const MAGAZINE_PART: u16 = 0;
    pub const TURRET_IN_POSITION: u16 = 1;
    pub const PUSHER_RETRACTED: u16 = 2;
    pub const PUSHER_EXTENDED: u16 = 3;
    pub const NEST_PART: u16 = 4;
    pub const INDUCTIVE: u16 = 5;
    pub const BRIGHT: u16 = 6;
    pub const GAUGE_UP: u16 = 7;
    pub const GAUGE_CONTACT: u16 = 8;
    pub const EJECTOR_RETRACTED: u16 = 9;
    pub const EJECTOR_EXTENDED: u16 = 10;
    pub const ARM_AT_NEST: u16 = 11;
    pub const ARM_AT_PALLET: u16 = 12;
    pub const HAND_UP: u16 = 13;
    pub const HAND_DOWN: u16 = 14;
    pub const VACUUM: u16 = 15;
    pub const PUSHER_EXTEND: u16 = 0;
    pub const GAUGE_LOWER: u16 = 1;
    pub const EJECTOR_EXTEND: u16 = 2;
    pub const ARM_TO_PALLET: u16 = 3;
    pub const ARM_TO_NEST: u16 = 4;
    pub const HAND_LOWER: u16 = 5;
    pub const SUCTION: u16 = 6;
    pub const TURRET_ENABLE: u16 = 7;
    pub const TURRET_POSITION: u16 = 0;
    pub const GAUGE_DEPTH: u16 = 1;
    pub const TURRET_TARGET: u16 = 0;
}

/// Addresses of unit 4, storage.
pub mod storage {
    pub const FORK_RETRACTED: u16 = 0;
    pub const FORK_EXTENDED: u16 = 1;
    pub const GRIP_OPENED: u16 = 2;
    pub const GRIP_CLOSED: u16 = 3;
    pub const GRIP_PART: u16 = 4;
    pub const X_IN_POSITION: u16 = 5;
    pub const Z_IN_POSITION: u16 = 6;
    pub const DRIVE_FAULT: u16 = 7;
    pub const FORK_EXTEND: u16 = 0;
    pub const FORK_RETRACT: u16 = 1;
    pub const GRIP_CLOSE: u16 = 2;
    pub const GRIP_OPEN: u16 = 3;
    pub const AXES_ENABLE: u16 = 4;
    pub const X_POSITION: u16 = 0;
    pub const Z_POSITION: u16 = 1;
    pub const X_VELOCITY: u16 = 2;
    pub const Z_VELOCITY: u16 = 3;
    pub const SLOT_OCCUPIED: u16 = 4;
    pub const X_SETPOINT: u16 = 0;
    pub const Z_SETPOINT: u16 = 1;
    pub const ORDER_NUMBER: u16 = 2;
}

/// Addresses of unit 5, transport; those of stop 1, from which the other stops are a stride apart.
pub mod transport {
    pub const PALLET_AT: u16 = 0;
    pub const LIFTER_UP: u16 = 1;
    pub const LIFTER_DOWN: u16 = 2;
    pub const STOPPER_CLOSED: u16 = 3;
    pub const PALLET_LOADED: u16 = 4;
    pub const BELT_RUNNING: u16 = 32;
    pub const STOPPER_OPEN: u16 = 0;
    pub const LIFTER_RAISE: u16 = 1;
    pub const LIFTER_LOWER: u16 = 2;
    pub const BELT_RUN: u16 = 16;
    pub const PALLET_CODE: u16 = 0;
    pub const ORDER_NUMBER: u16 = 4;
    pub const ORDER_VARIANT: u16 = 5;
    pub const ORDER_TAKEN: u16 = 0;
    pub const INPUT_STRIDE: u16 = 8;
    pub const COIL_STRIDE: u16 = 4;
    pub const CODE_STRIDE: u16 = 1;
}

/// The plant clock is the same register in every unit.
pub const CLOCK: u16 = 7;

/// Every signal, by unit, then in the order of the documentation.
pub const ALL: &[Signal] = &[
    input("S1_MagazinePart", 1, 0),
    input("S1_PusherRetracted", 1, 1),
    input("S1_PusherExtended", 1, 2),
    input("S1_CheckPart", 1, 3),
    input("S1_GaugeUp", 1, 4),
    input("S1_GaugeContact", 1, 5),
    input("S1_EjectorRetracted", 1, 6),
    input("S1_EjectorExtended", 1, 7),
    input("S1_ArmAtCheck", 1, 8),
    input("S1_ArmAtPallet", 1, 9),
    input("S1_HandUp", 1, 10),
    input("S1_HandDown", 1, 11),
    input("S1_Vacuum", 1, 12),
    coil("S1_PusherExtend", 1, 0, 0),
    coil("S1_GaugeLower", 1, 1, 0),
    coil("S1_EjectorExtend", 1, 2, 0),
    coil("S1_ArmToPallet", 1, 3, 0),
    coil("S1_ArmToCheck", 1, 4, 0),
    coil("S1_HandLower", 1, 5, 0),
    coil("S1_Suction", 1, 6, 1),
    word_in("S1_GaugeDepth", 1, 0, SignalType::Uint),
    word_in("S1_Clock", 1, 7, SignalType::Uint),
    input("S2_BearingMagazinePart", 2, 0),
    input("S2_BearingPusherRetracted", 2, 1),
    input("S2_BearingPusherExtended", 2, 2),
    input("S2_BearingNestPart", 2, 3),
    input("S2_HeadHome", 2, 4),
    input("S2_HeadEnd", 2, 5),
    input("S2_BearingEjectorRetracted", 2, 6),
    input("S2_BearingEjectorExtended", 2, 7),
    input("S2_SelectorAtAluminium", 2, 8),
    input("S2_SelectorAtNylon", 2, 9),
    input("S2_ShaftMagazinePart", 2, 10),
    input("S2_ShaftPusherRetracted", 2, 11),
    input("S2_ShaftPusherExtended", 2, 12),
    input("S2_ShaftNestPart", 2, 13),
    input("S2_ShaftInductive", 2, 14),
    input("S2_ShaftEjectorRetracted", 2, 15),
    input("S2_ShaftEjectorExtended", 2, 16),
    input("S2_ArmInPosition", 2, 17),
    input("S2_HandUp", 2, 18),
    input("S2_HandDown", 2, 19),
    input("S2_Vacuum", 2, 20),
    coil("S2_BearingPusherExtend", 2, 0, 0),
    coil("S2_HeadTraverse", 2, 1, 0),
    coil("S2_BearingEjectorExtend", 2, 2, 0),
    coil("S2_SelectNylon", 2, 3, 0),
    coil("S2_SelectAluminium", 2, 4, 0),
    coil("S2_ShaftPusherExtend", 2, 5, 0),
    coil("S2_ShaftEjectorExtend", 2, 6, 0),
    coil("S2_ArmEnable", 2, 7, 0),
    coil("S2_HandLower", 2, 8, 0),
    coil("S2_Suction", 2, 9, 1),
    word_in("S2_ProfileHeight", 2, 0, SignalType::Int),
    word_in("S2_ProfilePosition", 2, 1, SignalType::Uint),
    word_in("S2_ArmPosition", 2, 2, SignalType::Uint),
    word_in("S2_Clock", 2, 7, SignalType::Uint),
    word_out("S2_ArmTarget", 2, 0, SignalType::Uint, 0),
    input("S3_MagazinePart", 3, 0),
    input("S3_TurretInPosition", 3, 1),
    input("S3_PusherRetracted", 3, 2),
    input("S3_PusherExtended", 3, 3),
    input("S3_NestPart", 3, 4),
    input("S3_Inductive", 3, 5),
    input("S3_Bright", 3, 6),
    input("S3_GaugeUp", 3, 7),
    input("S3_GaugeContact", 3, 8),
    input("S3_EjectorRetracted", 3, 9),
    input("S3_EjectorExtended", 3, 10),
    input("S3_ArmAtNest", 3, 11),
    input("S3_ArmAtPallet", 3, 12),
    input("S3_HandUp", 3, 13),
    input("S3_HandDown", 3, 14),
    input("S3_Vacuum", 3, 15),
    coil("S3_PusherExtend", 3, 0, 0),
    coil("S3_GaugeLower", 3, 1, 0),
    coil("S3_EjectorExtend", 3, 2, 0),
    coil("S3_ArmToPallet", 3, 3, 0),
    coil("S3_ArmToNest", 3, 4, 0),
    coil("S3_HandLower", 3, 5, 0),
    coil("S3_Suction", 3, 6, 1),
    coil("S3_TurretEnable", 3, 7, 0),
    word_in("S3_TurretPosition", 3, 0, SignalType::Uint),
    word_in("S3_GaugeDepth", 3, 1, SignalType::Uint),
    word_in("S3_Clock", 3, 7, SignalType::Uint),
    word_out("S3_TurretTarget", 3, 0, SignalType::Uint, 0),
    input("S4_ForkRetracted", 4, 0),
    input("S4_ForkExtended", 4, 1),
    input("S4_GripOpened", 4, 2),
    input("S4_GripClosed", 4, 3),
    input("S4_GripPart", 4, 4),
    input("S4_XInPosition", 4, 5),
    input("S4_ZInPosition", 4, 6),
    input("S4_DriveFault", 4, 7),
    coil("S4_ForkExtend", 4, 0, 0),
    coil("S4_ForkRetract", 4, 1, 0),
    coil("S4_GripClose", 4, 2, 0),
    coil("S4_GripOpen", 4, 3, 0),
    coil("S4_AxesEnable", 4, 4, 0),
    word_in("S4_XPosition", 4, 0, SignalType::Int),
    word_in("S4_ZPosition", 4, 1, SignalType::Int),
    word_in("S4_XVelocity", 4, 2, SignalType::Int),
    word_in("S4_ZVelocity", 4, 3, SignalType::Int),
    word_in("S4_SlotOccupied", 4, 4, SignalType::Uint),
    word_in("S4_Clock", 4, 7, SignalType::Uint),
    word_out("S4_XSetpoint", 4, 0, SignalType::Int, 0),
    word_out("S4_ZSetpoint", 4, 1, SignalType::Int, 0),
    word_out("S4_OrderNumber", 4, 2, SignalType::Uint, 0),
    input("T_PalletAt1", 5, 0),
    input("T_LifterUp1", 5, 1),
    input("T_LifterDown1", 5, 2),
    input("T_StopperClosed1", 5, 3),
    input("T_PalletLoaded1", 5, 4),
    input("T_PalletAt2", 5, 8),
    input("T_LifterUp2", 5, 9),
    input("T_LifterDown2", 5, 10),
    input("T_StopperClosed2", 5, 11),
    input("T_PalletLoaded2", 5, 12),
    input("T_PalletAt3", 5, 16),
    input("T_LifterUp3", 5, 17),
    input("T_LifterDown3", 5, 18),
    input("T_StopperClosed3", 5, 19),
    input("T_PalletLoaded3", 5, 20),
    input("T_PalletAt4", 5, 24),
    input("T_LifterUp4", 5, 25),
    input("T_LifterDown4", 5, 26),
    input("T_StopperClosed4", 5, 27),
    input("T_PalletLoaded4", 5, 28),
    input("T_BeltRunning", 5, 32),
    coil("T_StopperOpen1", 5, 0, 0),
    coil("T_LifterRaise1", 5, 1, 0),
    coil("T_LifterLower1", 5, 2, 0),
    coil("T_StopperOpen2", 5, 4, 0),
    coil("T_LifterRaise2", 5, 5, 0),
    coil("T_LifterLower2", 5, 6, 0),
    coil("T_StopperOpen3", 5, 8, 0),
    coil("T_LifterRaise3", 5, 9, 0),
    coil("T_LifterLower3", 5, 10, 0),
    coil("T_StopperOpen4", 5, 12, 0),
    coil("T_LifterRaise4", 5, 13, 0),
    coil("T_LifterLower4", 5, 14, 0),
    coil("T_BeltRun", 5, 16, 0),
    word_in("T_PalletCode1", 5, 0, SignalType::Uint),
    word_in("T_PalletCode2", 5, 1, SignalType::Uint),
    word_in("T_PalletCode3", 5, 2, SignalType::Uint),
    word_in("T_PalletCode4", 5, 3, SignalType::Uint),
    word_in("T_OrderNumber", 5, 4, SignalType::Uint),
    word_in("T_OrderVariant", 5, 5, SignalType::Uint),
    word_in("T_Clock", 5, 7, SignalType::Uint),
    word_out("T_OrderTaken", 5, 0, SignalType::Uint, 0),
];
