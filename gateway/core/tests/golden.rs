//! The bytes of what a gateway keeps on disk and streams, fixed: another build has to read them.

mod common;
use common::owner;
use fam_proto::codec::{self, Wire};
use fam_proto::*;

fn id() -> CheckpointId {
    CheckpointId {
        epoch: Epoch(3),
        scan: Scan(300),
        digest: Digest([7; 16]),
    }
}

fn check<T: Wire + PartialEq + std::fmt::Debug>(body: &T, hex: &str) {
    let bytes = codec::encode(body).unwrap();
    let found: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(found, hex, "{}", T::NAME);
    assert_eq!(&codec::decode::<T>(&bytes).unwrap(), body);
}

#[test]
fn bytes_of_ledger_head_and_journal() {
    check(
        &Ledger {
            epoch: Epoch(4),
            owner: Some(owner(1)),
            state: RecordState::Released(Successor {
                epoch: Epoch(5),
                owner: owner(2),
            }),
            base: Some(id()),
            driven: true,
            fail_safe: false,
            last_scan: Scan(301),
            head_lost: false,
        },
        "4601080004010b636f6e74726f6c6c6572316502050b636f6e74726f6c6c657232660103fb2c01070707070707070707070707070707070100fb2d0100",
    );
    check(
        &HeadMeta {
            id: id(),
            layout: LayoutHash(9),
            mc_time_us: 1_500_000,
            phase: Phase::Recovering(2),
            image: ImageNumber((1 << 32) + 5),
        },
        "4601090003fb2c010707070707070707070707070707070709fc60e316000102fd0500000001000000",
    );
    check(
        &AppliedBatch {
            gateway: common::gateway_id(),
            boot: BootId(11),
            monotonic_offset_us: -5,
            first: 17,
            entries: vec![Applied {
                mc: common::mc_id(),
                epoch: Epoch(4),
                owner: owner(1),
                scan: Scan(301),
                digest: Digest([8; 16]),
                base: Some(id()),
                phase: Phase::Running,
                released: true,
                at_us: 70_000,
            }],
        },
        "46010a000867617465776179310b0911010853746174696f6e31040b636f6e74726f6c6c65723165fb2d01080808080808080808080808080808080103fb2c01070707070707070707070707070707070001fc70110100",
    );
}
