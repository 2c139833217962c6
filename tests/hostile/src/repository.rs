//! The System Repository with hostile rows, and as a damaged file.

use crate::cell::{cell, mc_id};
use crate::pieces::Pieces;
use crate::records::folder;
use fam_proto::codec::Wire;
use fam_proto::{Epoch, Event, RepoWrite};
use fam_repository::disk::Disk;
use fam_repository::{Repository, open_file};
use redb::{Database, TableDefinition};
use std::sync::OnceLock;

const EPOCHS: TableDefinition<'_, &str, u64> = TableDefinition::new("epochs");
const EVENTS: TableDefinition<'_, u64, &[u8]> = TableDefinition::new("events");
const STATE: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("state");
const REGISTRATIONS: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("registrations");

fn block(upto: u64) -> RepoWrite {
    RepoWrite::EpochBlock {
        mc: mc_id(),
        upto: Epoch(upto),
    }
}

/// A small repository as bytes.
fn good() -> &'static [u8] {
    static GOOD: OnceLock<Vec<u8>> = OnceLock::new();
    GOOD.get_or_init(|| {
        let disk = Disk::default();
        let handle = disk.clone();
        let (mut repository, _) =
            Repository::over(&cell().cell, move || Ok(handle.backend())).expect("an empty disk");
        repository.store(&[block(64)]).expect("a good disk");
        drop(repository);
        disk.bytes()
    })
}

/// A repository whose rows, or whose pages, are the fuzzer's.
pub fn repository(bytes: &[u8]) {
    match bytes.split_first() {
        Some((how, rest)) if how & 1 == 0 => rows(rest),
        Some((_, rest)) => pages(rest),
        None => {}
    }
}

/// Rows that only a foe or a bug can have written: read, or refused in words.
fn rows(bytes: &[u8]) {
    let disk = Disk::with(good().to_vec());
    let mut pieces = Pieces(bytes);
    {
        let database = Database::builder()
            .create_with_backend(disk.backend())
            .expect("a good repository");
        let write = database.begin_write().expect("begin");
        {
            let mut epochs = write.open_table(EPOCHS).expect("epochs");
            let mut events = write.open_table(EVENTS).expect("events");
            let mut state = write.open_table(STATE).expect("state");
            let mut registrations = write.open_table(REGISTRATIONS).expect("registrations");
            for _ in 0..8 {
                if pieces.is_empty() {
                    break;
                }
                let how = pieces.byte();
                let key = String::from_utf8_lossy(pieces.take(usize::from(how >> 4))).into_owned();
                let kind = if how & 4 == 0 {
                    Event::KIND
                } else {
                    RepoWrite::KIND
                };
                let mut value = Vec::new();
                if how & 8 != 0 {
                    value.extend_from_slice(&[b'F', 1, kind, 0]);
                }
                value.extend_from_slice(pieces.piece());
                let number = value
                    .get(..8)
                    .and_then(|v| v.try_into().ok())
                    .map_or(0, u64::from_le_bytes);
                match how & 3 {
                    0 => drop(epochs.insert(key.as_str(), number).expect("insert")),
                    1 => drop(events.insert(number, value.as_slice()).expect("insert")),
                    2 => drop(
                        state
                            .insert(key.as_str(), value.as_slice())
                            .expect("insert"),
                    ),
                    _ => drop(
                        registrations
                            .insert(key.as_str(), value.as_slice())
                            .expect("insert"),
                    ),
                }
            }
        }
        write.commit().expect("commit");
    }
    let handle = disk.clone();
    if let Ok((mut repository, state)) =
        Repository::over(&cell().cell, move || Ok(handle.backend()))
    {
        crate::agents::start_manager(state);
        let _ = repository.events(0, 10);
        repository.store(&[block(128)]).expect("a good disk");
        // Unless an unreadable row lies in the way, the block is there, and never lower than it was.
        if let Ok(state) = repository.load() {
            assert!(state.epochs[&mc_id()] >= Epoch(128));
        }
    }
}

/// A file with damaged pages: opened, or refused and left as it is.
fn pages(bytes: &[u8]) {
    thread_local! {
        static FOLDER: tempfile::TempDir = folder();
    }
    let mut file = good().to_vec();
    let mut pieces = Pieces(bytes);
    let page = usize::from(pieces.byte()) % (file.len() / 4096);
    pieces.lay_over(&mut file[page * 4096..]);
    FOLDER.with(|folder| {
        let path = folder.path().join("repository");
        std::fs::write(&path, &file).expect("room in memory");
        match open_file(&path, &cell().cell) {
            Ok((repository, _)) => drop(repository),
            Err(_) => {
                let now = std::fs::read(&path).expect("still there");
                assert_eq!(now, file, "a refused file is left as it is");
            }
        }
    });
}
