//! The record file against its enemies: kills, torn writes, files of others.

use super::*;
use crate::testing;
use fam_gateway_core::StoredHead;
use fam_proto::{
    CheckpointId, Epoch, HeadMeta, ImageNumber, LayoutHash, Ledger, Phase, RecordState, Scan,
    TrapInfo,
};
use std::sync::Arc;

fn head(scan: u64) -> StoredHead {
    let state: Vec<u8> = (0..testing::STATE_LEN)
        .map(|n| (n as u64 ^ scan) as u8)
        .collect();
    StoredHead {
        meta: HeadMeta {
            id: CheckpointId {
                epoch: Epoch(5),
                scan: Scan(scan),
                digest: Digest::of(scan * 5_000, &state),
            },
            layout: LayoutHash(7),
            mc_time_us: scan * 5_000,
            phase: Phase::Running,
            image: ImageNumber(scan),
        },
        outputs: vec![scan as u8, 1].into(),
        state: Arc::new(state),
    }
}

fn ledger(epoch: u64) -> Ledger {
    Ledger {
        epoch: Epoch(epoch),
        owner: Some(testing::owner(1)),
        state: RecordState::Open,
        ..never()
    }
}

fn write_head(file: &mut RecordFile, scan: u64) {
    let write = RecordWrite::Head {
        mc: testing::mc_id(),
        head: head(scan),
    };
    file.write(&write).unwrap();
}

fn write_ledger(file: &mut RecordFile, ledger: Ledger) {
    let write = RecordWrite::Opened {
        mc: testing::mc_id(),
        ledger,
    };
    file.write(&write).unwrap();
}

struct Place {
    _folder: tempfile::TempDir,
    path: PathBuf,
}

fn place() -> Place {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run/gateway1.records");
    Place {
        _folder: folder,
        path,
    }
}

fn open(path: &Path) -> Result<(RecordFile, StoredRecord), RecordsError> {
    let (file, mut stored) = RecordFile::open(path, &testing::cell(), &testing::gateway_id())?;
    assert_eq!(stored.len(), 2);
    Ok((file, stored.remove(0)))
}

#[test]
fn what_is_written_comes_back_and_starts_are_counted() {
    let place = place();
    let (mut file, stored) = open(&place.path).unwrap();
    assert_eq!((stored.ledger, stored.head), (never(), None));
    let mut trap = ledger(5);
    trap.state = RecordState::Faulted(TrapInfo {
        pou: "P".repeat(256),
        file: "ä".repeat(128),
        line: 3,
        message: "m".repeat(256),
    });
    let first = file.starts();
    assert!(first > 1_700_000_000, "{first}");
    for n in 1..=5 {
        assert_eq!(file.starts(), first + n - 1);
        write_ledger(&mut file, ledger(5));
        for scan in 0..u64::from(n) {
            write_head(&mut file, scan);
        }
        write_ledger(&mut file, trap.clone());
        drop(file);
        let (again, stored) = open(&place.path).unwrap();
        assert_eq!(stored.ledger, trap);
        assert_eq!(stored.head, Some(head(u64::from(n) - 1)));
        file = again;
    }
    file.sync_all().unwrap();
}

#[test]
fn a_slot_torn_anywhere_falls_back_to_the_other() {
    let place = place();
    let (mut file, _) = open(&place.path).unwrap();
    write_ledger(&mut file, ledger(4));
    write_ledger(&mut file, ledger(5));
    write_head(&mut file, 7);
    write_head(&mut file, 8);
    let part = &file.parts[&testing::mc_id()];
    let (ledger_at, _) = part.ledger.newest_range();
    let head_at = ledger_at - PAGE + 2 * PAGE + part.head.bytes() / 2;
    drop(file);
    let bytes = std::fs::read(&place.path).unwrap();
    let state_end = 256 + 2 + testing::STATE_LEN;
    for at in [0, 10, 16, 24, 30, 40, 256, 257, 258, state_end - 1] {
        let mut torn = bytes.clone();
        torn[head_at + at] ^= 0x5A;
        std::fs::write(&place.path, torn).unwrap();
        let (_, stored) = open(&place.path).unwrap();
        assert_eq!(stored.head, Some(head(7)), "head torn at {at}");
        assert_eq!(stored.ledger.epoch, Epoch(5));
    }
    for at in [0, 16, 24, 32, 40] {
        let mut torn = bytes.clone();
        torn[ledger_at + at] ^= 0x5A;
        std::fs::write(&place.path, torn).unwrap();
        let (mut file, stored) = open(&place.path).unwrap();
        assert_eq!(stored.ledger.epoch, Epoch(4), "ledger torn at {at}");
        write_ledger(&mut file, ledger(9));
        drop(file);
        assert_eq!(open(&place.path).unwrap().1.ledger.epoch, Epoch(9));
    }
}

#[test]
fn an_opening_that_is_taken_back_leaves_the_ledger_of_before() {
    let place = place();
    let (mut file, _) = open(&place.path).unwrap();
    write_ledger(&mut file, ledger(5));
    write_head(&mut file, 1);
    let part = file.parts.get_mut(&testing::mc_id()).unwrap();
    let undo = part.ledger.write(&mut file.map, &ledger(6)).unwrap();
    part.ledger.take_back(&mut file.map, undo);
    drop(file);
    let (_, stored) = open(&place.path).unwrap();
    assert_eq!(stored.ledger.epoch, Epoch(5));
    assert_eq!(stored.head, Some(head(1)));
}

#[test]
fn files_of_others_are_refused_by_name_and_left_untouched() {
    let place = place();
    drop(open(&place.path).unwrap());
    let good = std::fs::read(&place.path).unwrap();
    let with = |at: usize, bytes: &[u8]| {
        let mut page = good.clone();
        page[at..at + bytes.len()].copy_from_slice(bytes);
        page
    };
    let other_cell = {
        let mut model = testing::cell();
        model.cell = CellId::new("elsewhere").unwrap();
        model
    };
    let other_outputs = {
        let mut model = testing::cell();
        model.mcs[1].fail_safe.push(0);
        model
    };
    let outgrown = {
        let mut model = testing::cell();
        model.mcs[1].diagnosis.checkpoint_len += 100_000;
        model
    };
    let cell = testing::cell();
    for (name, content, model, words) in [
        ("text", b"hello".to_vec(), &cell, "is not a record file"),
        (
            "long text",
            vec![b'x'; good.len()],
            &cell,
            "is not a record file",
        ),
        (
            "newer version",
            with(8, &3_u32.to_le_bytes()),
            &cell,
            "has format version 3, this build reads version 2",
        ),
        (
            "damaged",
            with(FINGERPRINT_AT, &[1, 2, 3]),
            &cell,
            "is not a record file",
        ),
        (
            "truncated",
            good[..good.len() - PAGE].to_vec(),
            &cell,
            "is not a record file",
        ),
        (
            "other cell",
            good.clone(),
            &other_cell,
            "belongs to gateway gateway1 of cell test",
        ),
        (
            "other outputs",
            good.clone(),
            &other_outputs,
            "other MCs or other outputs",
        ),
        (
            "outgrown",
            good.clone(),
            &outgrown,
            "has no room for the state of",
        ),
        (
            "damaged table",
            with(PAGE, &[9, 9, 9]),
            &cell,
            "is not a record file",
        ),
    ] {
        std::fs::write(&place.path, &content).unwrap();
        let error = RecordFile::open(&place.path, model, &testing::gateway_id()).unwrap_err();
        let text = error.to_string();
        assert!(text.contains(words), "{name}: {text}");
        assert!(
            text.contains("gateway1.records"),
            "{name} names the file: {text}"
        );
        assert_eq!(
            std::fs::read(&place.path).unwrap(),
            content,
            "{name} was changed"
        );
    }
}

#[test]
fn two_gateways_do_not_share_a_file() {
    let place = place();
    let first = open(&place.path).unwrap();
    let text = open(&place.path).unwrap_err().to_string();
    assert!(text.contains("in use by another gateway"), "{text}");
    drop(first);
    open(&place.path).unwrap();
}
