//! The bytes on wire and disk are fixed: a change of a type or of the codec that changes them fails here.
//!
//! The golden bytes lie in `golden/*.hex`. A change of format makes a new version beside the old one, never a new golden file.

use fam_proto::codec::{CodecError, MESSAGE_BYTES_MAX, Wire, decode, encode};
use fam_proto::*;
use proptest::prelude::*;

fn mc() -> McId {
    McId::new("Station1").unwrap()
}

fn owner() -> Owner {
    Owner {
        controller: ControllerId::new("controller2").unwrap(),
        boot: BootId(1_700_000_000_000_001),
    }
}

fn checkpoint_id() -> CheckpointId {
    CheckpointId {
        epoch: Epoch(3),
        scan: Scan(1_000),
        digest: Digest::of(5_000, b"state"),
    }
}

fn header() -> FrameHeader {
    FrameHeader {
        mc: mc(),
        owner: owner(),
        epoch: Epoch(4),
        scan: Scan(1_001),
        image: ImageNumber(1 << 32),
        base: Some(checkpoint_id()),
        mc_time_us: 10_000,
        layout: LayoutHash(0xfeed),
        digest: Digest::of(10_000, b"next!"),
        phase: Phase::Recovering(2),
        released_to: Some(Successor {
            epoch: Epoch(5),
            owner: owner(),
        }),
        scan_us: 120,
        content: Content::Delta(checkpoint_id()),
        outputs_len: 2,
        state_len: 5,
    }
}

fn record() -> Record {
    Record {
        mc: mc(),
        epoch: Epoch(4),
        owner: Some(owner()),
        state: RecordState::Faulted(TrapInfo {
            pou: "Filter".into(),
            file: "station2.st".into(),
            line: 12,
            message: "division by zero".into(),
        }),
        head: Some(Head {
            checkpoint: Checkpoint {
                id: checkpoint_id(),
                layout: LayoutHash(0xfeed),
                mc_time_us: 5_000,
                phase: Phase::Running,
                image: ImageNumber(7),
                state: b"state".to_vec(),
            },
            outputs: vec![1, 2],
        }),
    }
}

fn image() -> InputImage {
    InputImage {
        gateway: GatewayId::new("gateway1").unwrap(),
        boot: BootId(9),
        number: ImageNumber(77),
        sent_at_us: 123_456,
        inputs: vec![McInputs {
            mc: mc(),
            bytes: vec![0xff, 0],
            fresh: true,
        }],
        records: vec![RecordSummary {
            mc: mc(),
            epoch: Epoch(4),
            owner: Some(owner()),
            state: RecordState::Open,
            head: Some(checkpoint_id()),
            phase: Some(Phase::Running),
            driven: true,
            silent_us: 900,
            suspect: false,
            rejected: 2,
        }],
        exports: vec![McExports {
            mc: McId::new("Transport").unwrap(),
            outputs: vec![1, 2],
        }],
    }
}

fn envelope() -> Envelope {
    Envelope {
        from: AgentId::Manager,
        boot: BootId(5),
        to: AgentId::Component(owner().controller, mc()),
        body: Message::Order(Order {
            id: OrderId(8),
            mc: mc(),
            kind: OrderKind::Activate {
                epoch: Epoch(5),
                after: Some(owner()),
                force: false,
                reset: Some(Reset::Warm),
                within_us: 500_000,
            },
        }),
    }
}

fn event() -> Event {
    Event::new(Severity::Alarm, EventKind::McFaulted, "Station1 stopped")
        .mc(&mc())
        .controller(&owner().controller)
        .epoch(Epoch(4))
        .plan(PlanId(2))
        .scan(Scan(9))
}

fn repository_block() -> RepoWrite {
    RepoWrite::EpochBlock {
        mc: mc(),
        upto: Epoch(128),
    }
}

fn repository_state() -> RepoState {
    let mut state = RepoState::default();
    let controller = owner().controller;
    for write in [
        repository_block(),
        RepoWrite::Event(event()),
        RepoWrite::Assignment {
            generation: PlanId(9),
            assignment: [(mc(), controller.clone())].into(),
        },
        RepoWrite::Pins([(mc(), controller.clone())].into()),
        RepoWrite::Drained([controller.clone()].into()),
        RepoWrite::Stopped([mc()].into()),
        RepoWrite::Registered(Registration {
            owner: owner(),
            description: "PLC 2".into(),
            cpu_factor_permille: 500,
            memory_kb: 65_536,
            limit_permille: 700,
            tick_us: 5_000,
            mcs: vec![Hosted {
                mc: mc(),
                hash: 7,
                layout: LayoutHash(0xfeed),
                memory_kb: 64,
                worst_case_us: 900,
            }],
            active: vec![(mc(), Epoch(4))],
            real_time: vec!["mlock".into()],
        }),
    ] {
        state.apply(&write);
    }
    state
}

fn piece() -> PieceHeader {
    PieceHeader {
        from: ProcessId::Node(owner().controller),
        boot: owner().boot,
        message: 300,
        message_bytes: 20_000_000,
        index: 76,
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes
        .chunks(32)
        .map(|line| line.iter().map(|b| format!("{b:02x}")).collect::<String>() + "\n")
        .collect()
}

fn check<T: Wire + PartialEq + std::fmt::Debug>(name: &str, body: &T) {
    let bytes = encode(body).unwrap();
    let path = format!("{}/tests/golden/{name}.hex", env!("CARGO_MANIFEST_DIR"));
    let golden = match std::fs::read_to_string(&path) {
        Ok(golden) => golden,
        // A new kind of body gets its golden bytes once: `FAM_WRITE_GOLDEN=1 cargo test -p fam-proto`.
        Err(_) if std::env::var_os("FAM_WRITE_GOLDEN").is_some() => {
            std::fs::write(&path, hex(&bytes)).unwrap();
            hex(&bytes)
        }
        Err(e) => panic!("{path}: {e}"),
    };
    assert_eq!(
        golden,
        hex(&bytes),
        "{name}: the bytes of format version 1 have changed"
    );
    assert_eq!(&decode::<T>(&bytes).unwrap(), body);
}

#[test]
fn the_bytes_are_the_golden_ones() {
    check("frame_header", &header());
    check("input_image", &image());
    check("record", &record());
    check("event", &event());
    check("envelope", &envelope());
    check("repository_block", &repository_block());
    check("repository_state", &repository_state());
    check("piece_header", &piece());
    check("piece_taken", &PieceTaken { by: piece().from });
}

#[test]
fn a_frame_reads_back_with_its_bytes() {
    let bytes = encode_frame(&header(), &[1, 2], b"delta").unwrap();
    let view = decode_frame(&bytes).unwrap();
    assert_eq!(
        (view.header, view.outputs, view.content),
        (header(), &[1u8, 2][..], &b"delta"[..])
    );
    let full = FrameHeader {
        content: Content::Full,
        ..header()
    };
    assert!(
        decode_frame(&encode_frame(&full, &[1, 2], b"next").unwrap()).is_err(),
        "a full state of another length"
    );
}

#[test]
fn another_version_or_kind_is_named() {
    let mut bytes = encode(&envelope()).unwrap();
    bytes[1] = 2;
    let error = decode::<Envelope>(&bytes).unwrap_err();
    assert_eq!(
        error.to_string(),
        "message: format version 2, this build reads version 1; run the same version of fam everywhere"
    );
    assert!(matches!(
        decode::<InputImage>(&encode(&event()).unwrap()),
        Err(CodecError::Kind { found: 4, .. })
    ));
    assert!(matches!(
        decode::<Envelope>(b"{}"),
        Err(CodecError::Foreign { .. })
    ));
    assert!(matches!(
        decode::<Envelope>(&vec![0; MESSAGE_BYTES_MAX + 1]),
        Err(CodecError::TooLarge { .. })
    ));
}

#[test]
fn names_are_checked_when_they_are_read() {
    for bad in ["", "1st", "a/b", "a b", "ä", &"x".repeat(65)] {
        assert!(McId::new(bad).is_err(), "{bad}");
    }
    let good = encode(&event()).unwrap();
    let at = good.windows(8).position(|w| w == b"Station1").unwrap();
    let mut bad = good;
    bad[at] = b'/';
    assert!(decode::<Event>(&bad).is_err());
}

proptest! {
    #[test]
    fn damaged_bytes_are_an_error_and_never_a_panic(which in 0usize..5, cut in any::<prop::sample::Index>(), flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6)) {
        let mut bytes = match which {
            0 => encode_frame(&header(), &[1, 2], b"delta").unwrap(),
            1 => encode(&image()).unwrap(),
            2 => encode(&record()).unwrap(),
            3 => encode(&event()).unwrap(),
            _ => encode(&envelope()).unwrap(),
        };
        for (at, value) in flips {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        bytes.truncate(cut.index(bytes.len()) + 1);
        let _ = decode_frame(&bytes);
        let _ = decode::<InputImage>(&bytes);
        let _ = decode::<Record>(&bytes);
        let _ = decode::<Event>(&bytes);
        let _ = decode::<Envelope>(&bytes);
    }

    #[test]
    fn a_truncated_message_is_an_error(cut in any::<prop::sample::Index>()) {
        let bytes = encode(&envelope()).unwrap();
        prop_assert!(decode::<Envelope>(&bytes[..cut.index(bytes.len())]).is_err());
    }
}
