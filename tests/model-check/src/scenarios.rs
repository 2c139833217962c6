//! The scenarios: which faults may happen, at any moment and in any order.

use crate::state::{Faults, Kind};

/// So many messages may take their time at once, each for as long as it likes, unless said otherwise.
pub const HELD: usize = 0;

/// So many activations are followed, unless said otherwise.
pub const ACTIVATIONS: u8 = 2;

/// Nothing happens.
pub const NONE: Faults = Faults {
    crashes: 0,
    whom: None,
    restarts: 0,
    cuts: 0,
    between: None,
    repeats: 0,
    moves: 0,
    late: 0,
    held: HELD,
};

/// One crash of a process of this kind at any moment, and its restart at any moment after that.
#[must_use]
pub const fn crash(whom: Kind) -> Faults {
    Faults {
        crashes: 1,
        restarts: 1,
        whom: Some(whom),
        ..NONE
    }
}

/// A connection of this kind is cut at any moment in both directions, and mended at any moment after that.
#[must_use]
pub const fn cut(between: (Kind, Kind)) -> Faults {
    Faults {
        cuts: 1,
        between: Some(between),
        ..NONE
    }
}

/// An operator orders a move.
pub const MOVE: Faults = Faults { moves: 1, ..NONE };

/// All of them, by name.
pub const ALL: [(&str, Faults); 12] = [
    ("none", NONE),
    ("move", MOVE),
    ("crash-controller", crash(Kind::Node)),
    ("crash-manager", crash(Kind::Manager)),
    ("crash-gateway", crash(Kind::Gateway)),
    ("cut-manager-gateway", cut((Kind::Manager, Kind::Gateway))),
    ("cut-manager-controller", cut((Kind::Manager, Kind::Node))),
    ("cut-gateway-controller", cut((Kind::Gateway, Kind::Node))),
    ("move-late", Faults { late: 1, ..MOVE }),
    (
        "move-crash-controller",
        Faults {
            moves: 1,
            ..crash(Kind::Node)
        },
    ),
    (
        "move-crash-manager",
        Faults {
            moves: 1,
            ..crash(Kind::Manager)
        },
    ),
    (
        "move-crash-gateway",
        Faults {
            moves: 1,
            ..crash(Kind::Gateway)
        },
    ),
];
