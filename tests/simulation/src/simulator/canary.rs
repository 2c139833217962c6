//! Planted bugs, each of which breaks one promise: they prove that the checkers bite.
//!
//! They lie around the real state machines, in what the simulator hands in and takes out, and nowhere in the product.

/// A planted bug.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Canary {
    /// The gateway finds no records at its restart.
    GatewayForgetsRecords,
    /// The gateway finds at its restart the head before the last one.
    GatewayLosesNewestHead,
    /// The gateway grants every open as if an operator had forced it.
    GatewayForcesOpens,
    /// The gateway lets frames of deposed owners through, and nodes do not heed the record.
    DeposedOwnerDrives,
    /// An order to activate reaches a second controller, too, and the gateway grants it the epoch.
    OrderDoubled,
    /// The gateway does not say that the fail-safe values stand.
    FailSafeForgotten,
    /// The gateway's answer does not carry the reset on.
    ResetForgotten,
    /// The gateway's answers to opens get lost for good after a while.
    AnswersLost,
    /// Blocks of epochs are acknowledged and never written.
    EpochsForgotten,
    /// An epoch begins from the state before the one that it names.
    StaleStart,
    /// An epoch begins with MC time 0.
    McTimeRestarts,
    /// An epoch does not care how old its inputs are.
    OldInputs,
    /// The recovery of a critical interval is left out.
    RecoverySkipped,
    /// The scan thread releases anywhere.
    ReleaseAnywhere,
    /// Each write to the field is made once more by somebody else, a little later.
    TwoWriters,
    /// After a trap normal logic goes on.
    TrapPassedOn,
    /// An epoch begins from initial values, whatever the plant is doing.
    StartsCold,
}

impl Canary {
    /// All of them, each with the invariant that has to find it and the number of seeds within which it has to.
    pub const ALL: [(Canary, &'static str, u64); 18] = [
        (
            Canary::GatewayForgetsRecords,
            "nothing that the plant has seen is lost",
            20,
        ),
        (
            Canary::GatewayLosesNewestHead,
            "nothing that the plant has seen is lost",
            20,
        ),
        (
            Canary::GatewayForcesOpens,
            "a healthy owner keeps its MC",
            20,
        ),
        (Canary::DeposedOwnerDrives, "one driver", 20),
        (Canary::OrderDoubled, "only the named successor goes on", 60),
        (
            Canary::FailSafeForgotten,
            "outputs fail safe, and it latches",
            20,
        ),
        (Canary::ResetForgotten, "stopped stays stopped", 20),
        (
            Canary::AnswersLost,
            "an MC that an able controller hosts is driven",
            20,
        ),
        (
            Canary::EpochsForgotten,
            "the repository keeps what it has promised",
            40,
        ),
        (Canary::EpochsForgotten, "epochs are never reused", 150),
        (Canary::StaleStart, "no invented state", 20),
        (
            Canary::McTimeRestarts,
            "MC time grows by one cycle a scan",
            20,
        ),
        (Canary::OldInputs, "inputs never grow older", 80),
        (
            Canary::RecoverySkipped,
            "critical intervals are answered as declared",
            20,
        ),
        (
            Canary::ReleaseAnywhere,
            "planned moves never start in a critical interval",
            20,
        ),
        (Canary::TwoWriters, "one writer", 5),
        (Canary::TrapPassedOn, "a trap is not passed on", 40),
        (Canary::StartsCold, "the plant goes on unharmed", 20),
    ];
}
