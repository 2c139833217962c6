//! The record file of a gateway, damaged in any way.

use crate::cell::{cell, gateway_id, mc_id, owner};
use crate::pieces::Pieces;
use crate::wire::good_frame;
use fam_gateway_core::{RecordWrite, StoredHead};
use fam_gateway_records::RecordFile;
use fam_proto::{Digest, Epoch, HeadMeta, Ledger, RecordState, Scan};
use std::path::Path;
use std::sync::{Arc, OnceLock};

const PAGE: usize = 4096;
/// Behind the checksum: what it covers.
const SEALED_FROM: usize = 16;

/// The bytes of a good file: an epoch with two heads.
fn good() -> &'static [u8] {
    static GOOD: OnceLock<Vec<u8>> = OnceLock::new();
    GOOD.get_or_init(|| {
        let folder = folder();
        let path = folder.path().join("good");
        let (mut file, stored) =
            RecordFile::open(&path, &cell(), &gateway_id()).expect("a new file");
        assert!(stored.iter().all(|s| s.head.is_none()));
        let ledger = Ledger {
            epoch: Epoch(1),
            owner: Some(owner(1)),
            state: RecordState::Open,
            base: None,
            driven: true,
            fail_safe: false,
            last_scan: Scan(0),
            head_lost: false,
        };
        let mc = mc_id();
        let mut writes = vec![RecordWrite::Opened {
            mc: mc.clone(),
            ledger,
        }];
        for scan in [1, 2] {
            let (header, outputs, state) = good_frame(1, scan);
            let head = StoredHead {
                meta: HeadMeta {
                    id: header.checkpoint_id(),
                    layout: header.layout,
                    mc_time_us: header.mc_time_us,
                    phase: header.phase,
                    image: header.image,
                },
                outputs: outputs.into(),
                state: Arc::new(state),
            };
            writes.push(RecordWrite::Head {
                mc: mc.clone(),
                head,
            });
        }
        for write in &writes {
            file.write(write).expect("room for it");
        }
        file.sync_all().expect("a disk");
        drop(file);
        std::fs::read(&path).expect("the file just written")
    })
}

/// Memory rather than a disk where there is some.
pub(crate) fn folder() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    let folder = if memory.is_dir() {
        tempfile::tempdir_in(memory)
    } else {
        tempfile::tempdir()
    };
    folder.expect("a temporary folder")
}

/// Makes the checksum of a slot fit what stands in it.
fn seal(slot: &mut [u8], checked: usize) {
    let mut sequence = [0; 8];
    sequence.copy_from_slice(&slot[SEALED_FROM..SEALED_FROM + 8]);
    let checked = checked.clamp(SEALED_FROM, slot.len());
    let digest = Digest::of(u64::from_le_bytes(sequence), &slot[SEALED_FROM..checked]);
    slot[..SEALED_FROM].copy_from_slice(&digest.0);
}

/// Opens a damaged file: it is refused, or whatever it gives is whole.
pub fn records(bytes: &[u8]) {
    thread_local! {
        static FOLDER: tempfile::TempDir = folder();
    }
    let mut pieces = Pieces(bytes);
    let how = pieces.byte();
    let checked = usize::from(pieces.word());
    let mut file = good().to_vec();
    let page = usize::from(how >> 4) % (file.len() / PAGE);
    pieces.lay_over(&mut file[page * PAGE..]);
    if how & 1 != 0 {
        // Damage whose checksum is right: what only a foe, or a bug, can have written.
        let len = |at: usize| {
            let word: [u8; 4] = file[page * PAGE + at..][..4].try_into().unwrap_or_default();
            u32::from_le_bytes(word) as usize
        };
        let end = match how & 6 {
            0 => 32 + len(24),
            2 => 256 + len(28),
            _ => checked,
        };
        seal(&mut file[page * PAGE..(page + 1) * PAGE], end);
    }
    if how & 8 != 0 {
        file.truncate(checked);
    }
    FOLDER.with(|folder| {
        let path = folder.path().join("records");
        std::fs::write(&path, &file).expect("room in memory");
        if let Ok((mut open, stored)) = RecordFile::open(&path, &cell(), &gateway_id()) {
            for record in &stored {
                if let Some(head) = &record.head {
                    let digest = Digest::of(head.meta.mc_time_us, &head.state);
                    assert_eq!(digest, head.meta.id.digest, "a head that is not whole");
                }
            }
            // A gateway starts from it, with nothing open, and can go on writing.
            let boot = owner(1).boot;
            let run = open.starts();
            let gateway = fam_gateway_core::Gateway::new(
                &cell(),
                &gateway_id(),
                boot,
                run,
                stored,
                fam_proto::Now(0),
            )
            .expect("the cell fits");
            if let Some(gate) = gateway.gate(&mc_id()) {
                assert_ne!(gate.ledger().state, RecordState::Open);
                let note = RecordWrite::Changed {
                    mc: mc_id(),
                    ledger: gate.ledger().clone(),
                    sync: false,
                };
                open.write(&note).expect("a ledger that was read fits");
            }
        } else {
            let now = std::fs::read(&path).expect("still there");
            assert_eq!(now, file, "a refused file is left as it is");
        }
    });
}
