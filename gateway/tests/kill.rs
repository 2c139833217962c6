//! Kills a process in the middle of its writes to a record file. In a test program of its own, because a child that is being
//! started holds its parent's open files, and their locks, for a moment.

#[path = "../core/tests/common/mod.rs"]
mod common;

use common::{LAYOUT, STATE_LEN, cell, gateway_id, mc_id, owner};
use fam_gateway::records::RecordFile;
use fam_gateway_core::{RecordWrite, StoredHead, StoredRecord};
use fam_proto::*;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;

/// The child says that it is alive after so many writes.
const WRITES_PER_LINE: u64 = 37;

fn head(scan: u64) -> StoredHead {
    let state: Vec<u8> = (0..STATE_LEN).map(|n| (n as u64 ^ scan) as u8).collect();
    StoredHead {
        meta: HeadMeta {
            id: CheckpointId {
                epoch: Epoch(5),
                scan: Scan(scan),
                digest: Digest::of(scan * 5_000, &state),
            },
            layout: LAYOUT,
            mc_time_us: scan * 5_000,
            phase: Phase::Running,
            image: ImageNumber(scan),
        },
        outputs: vec![scan as u8, 1].into(),
        state: Arc::new(state),
    }
}

fn open(path: &Path) -> (RecordFile, StoredRecord) {
    let (file, mut stored) = RecordFile::open(path, &cell(), &gateway_id()).unwrap();
    (file, stored.remove(0))
}

/// Not a test by itself: what the killed process runs.
#[test]
fn child_that_writes_until_it_is_killed() {
    let Ok(path) = std::env::var("FAM_TEST_RECORDS") else {
        return;
    };
    let (mut file, stored) = open(Path::new(&path));
    let mut scan = stored.head.map_or(0, |head| head.meta.id.scan.0);
    let ledger = Ledger {
        epoch: Epoch(5),
        owner: Some(owner(1)),
        state: RecordState::Open,
        ..stored.ledger
    };
    let mc = mc_id();
    file.write(&RecordWrite::Opened {
        mc: mc.clone(),
        ledger,
    })
    .unwrap();
    loop {
        for _ in 0..WRITES_PER_LINE {
            scan += 1;
            let head = head(scan);
            file.write(&RecordWrite::Head {
                mc: mc.clone(),
                head,
            })
            .unwrap();
        }
        println!("written {scan}");
        std::io::stdout().flush().unwrap();
    }
}

#[test]
fn a_kill_in_the_middle_of_a_write_loses_nothing_but_that_write() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gateway1.records");
    let mut last = 0;
    for round in 0..20 {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args([
                "--exact",
                "child_that_writes_until_it_is_killed",
                "--nocapture",
            ])
            .env("FAM_TEST_RECORDS", &path)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut said = 0;
        // Kept open until the child is dead: it dies of the kill and of nothing else.
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        for line in lines.by_ref() {
            if let Some(scan) = line.unwrap().strip_prefix("written ") {
                said = scan.parse().unwrap();
                if said >= last + WRITES_PER_LINE * (1 + round % 4) {
                    break;
                }
            }
        }
        child.kill().unwrap();
        child.wait().unwrap();
        let (_, stored) = open(&path);
        let found = stored.head.expect("a head is there");
        let scan = found.meta.id.scan.0;
        assert!(
            scan >= said,
            "round {round}: {scan} is there, {said} was written"
        );
        assert_eq!(found, head(scan));
        assert_eq!(
            (stored.ledger.epoch, stored.ledger.head_lost),
            (Epoch(5), false)
        );
        last = scan;
    }
}
