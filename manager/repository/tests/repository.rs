//! What is stored comes back: after a restart, after a crash, after a full disk; and what is no repository is left alone.

use fam_proto::{
    BootId, CellId, ControllerId, Epoch, Event, EventKind, McId, Owner, PlanId, Registration,
    RepoState, RepoWrite, Severity,
};
use fam_repository::disk::Disk;
use fam_repository::{Repository, RepositoryError, open_file};
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

fn cell() -> CellId {
    CellId::new("fms200").unwrap()
}

fn mc(number: u8) -> McId {
    McId::new(&format!("station{number}")).unwrap()
}

fn controller(number: u8) -> ControllerId {
    ControllerId::new(&format!("controller{number}")).unwrap()
}

fn event(seq: u64, text: &str) -> RepoWrite {
    let mut event = Event::new(Severity::Info, EventKind::PlanDone, text);
    event.seq = seq;
    RepoWrite::Event(event)
}

fn block(of: u8, upto: u64) -> RepoWrite {
    RepoWrite::EpochBlock {
        mc: mc(of),
        upto: Epoch(upto),
    }
}

fn registration(of: u8, boot: u64) -> RepoWrite {
    RepoWrite::Registered(Registration {
        owner: Owner {
            controller: controller(of),
            boot: BootId(boot),
        },
        description: "soft-PLC".to_owned(),
        cpu_factor_permille: 1_000,
        memory_kb: 64,
        limit_permille: 800,
        tick_us: 5_000,
        mcs: Vec::new(),
        active: vec![(mc(1), Epoch(4))],
        real_time: Vec::new(),
    })
}

fn open(disk: &Disk) -> Result<(Repository, RepoState), RepositoryError> {
    let disk = disk.clone();
    Repository::over(&cell(), move || Ok(disk.backend()))
}

fn any_write() -> impl Strategy<Value = RepoWrite> {
    let number = 1..5_u8;
    let map = prop::collection::btree_map(
        number.clone().prop_map(mc),
        number.clone().prop_map(controller),
        0..4,
    );
    prop_oneof![
        (number.clone(), 0..500_u64).prop_map(|(of, upto)| block(of, upto)),
        (1..40_u64, "[a-z]{0,30}").prop_map(|(seq, text)| event(seq, &text)),
        (number.clone(), 0..9_u64).prop_map(|(of, boot)| registration(of, boot)),
        (0..9_u64, map.clone()).prop_map(|(generation, assignment)| RepoWrite::Assignment {
            generation: PlanId(generation),
            assignment
        }),
        map.prop_map(RepoWrite::Pins),
        prop::collection::btree_set(number.clone().prop_map(controller), 0..4)
            .prop_map(RepoWrite::Drained),
        prop::collection::btree_set(number.prop_map(mc), 0..4).prop_map(RepoWrite::Stopped),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Batches of writes, a crash at some operation with any part of the unsynced writes on the disk, whole or torn: what was answered `Ok` is there.
    #[test]
    fn what_was_stored_survives_any_crash(
        batches in prop::collection::vec(prop::collection::vec(any_write(), 1..5), 1..12),
        fails_in in 0..120_u64,
        kept in any::<u64>(),
        torn in any::<bool>(),
    ) {
        let disk = Disk::default();
        let (mut repository, found) = open(&disk).unwrap();
        prop_assert_eq!(found, RepoState::default());
        disk.fail_in(Some(fails_in));
        let mut expected = RepoState::default();
        let mut unsure = None;
        for batch in &batches {
            let mut with = expected.clone();
            batch.iter().for_each(|write| with.apply(write));
            match repository.store(batch) {
                Ok(()) => expected = with,
                Err(RepositoryError::Write { .. }) => {
                    unsure = Some(with);
                    break;
                }
                Err(error) => prop_assert!(false, "{}", error),
            }
        }
        disk.fail_in(None);
        let keeps = |n: u64| kept.rotate_left(u32::try_from(n % 64).unwrap_or(0)) & 1 == 1;
        if torn {
            disk.crash_torn(|position, sector| keeps(position as u64 + sector));
        } else {
            disk.crash(|position| keeps(position as u64));
        }
        drop(repository);
        let (_, found) = open(&disk).unwrap();
        prop_assert!(
            found == expected || Some(&found) == unsure.as_ref(),
            "found {:?}\nexpected {:?}\nor {:?}", found, expected, unsure
        );
    }
}

#[test]
fn a_full_disk_is_said_and_left_again() {
    let disk = Disk::default();
    let (mut repository, _) = open(&disk).unwrap();
    repository.store(&[block(1, 64)]).unwrap();
    disk.set_capacity(Some(disk.bytes().len() as u64));
    let many: Vec<_> = (1..400).map(|seq| event(seq, &"x".repeat(500))).collect();
    let error = repository.store(&many).unwrap_err().to_string();
    assert!(
        error.starts_with("the repository could not be written"),
        "{error}"
    );
    assert!(error.contains("no space left on device"), "{error}");
    let error = repository.store(&many).unwrap_err().to_string();
    assert!(error.contains("no space left on device"), "{error}");
    disk.set_capacity(None);
    repository.store(&[block(1, 128)]).unwrap();
    let state = repository.load().unwrap();
    assert_eq!(state.epochs[&mc(1)], Epoch(128));
    assert_eq!(state.last_event_seq, 0);
}

#[test]
fn events_are_read_in_pieces() {
    let (mut repository, _) = open(&Disk::default()).unwrap();
    let writes: Vec<_> = (1..=10).map(|seq| event(seq, "x")).collect();
    repository.store(&writes).unwrap();
    for (after, limit, expected, more) in [
        (0, 3, vec![1, 2, 3], true),
        (3, 7, vec![4, 5, 6, 7, 8, 9, 10], false),
        (10, 5, vec![], false),
        (u64::MAX, 5, vec![], false),
    ] {
        let (events, follows) = repository.events(after, limit).unwrap();
        let seqs: Vec<_> = events.iter().map(|e| e.seq).collect();
        assert_eq!((seqs, follows), (expected, more), "after {after}");
    }
}

/// A file with something of everything in it.
fn written(path: &Path) -> RepoState {
    let (mut repository, mut state) = open_file(path, &cell()).unwrap();
    let writes = [
        block(1, 64),
        registration(1, 7),
        RepoWrite::Assignment {
            generation: PlanId(3),
            assignment: BTreeMap::from([(mc(1), controller(1))]),
        },
        RepoWrite::Pins(BTreeMap::from([(mc(1), controller(1))])),
        RepoWrite::Drained(BTreeSet::from([controller(2)])),
        RepoWrite::Stopped(BTreeSet::from([mc(2)])),
        event(1, "first"),
        event(2, &"second".repeat(300)),
    ];
    repository.store(&writes).unwrap();
    writes.iter().for_each(|write| state.apply(write));
    state
}

#[test]
fn a_file_comes_back_after_a_restart_and_only_one_manager_has_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run/repository.redb");
    let state = written(&path);
    let (_open, found) = open_file(&path, &cell()).unwrap();
    assert_eq!(found, state);
    let error = open_file(&path, &cell()).unwrap_err();
    assert!(matches!(error, RepositoryError::InUse { .. }), "{error}");
    assert!(error.to_string().contains("another manager"), "{error}");
}

#[test]
fn what_is_no_repository_of_this_cell_is_refused_and_left_untouched() {
    let folder = tempfile::tempdir().unwrap();
    let good_path = folder.path().join("good.redb");
    written(&good_path);
    let good = std::fs::read(&good_path).unwrap();
    let foreign_database = {
        let disk = Disk::default();
        let database = redb::Builder::new()
            .create_with_backend(disk.backend())
            .unwrap();
        let write = database.begin_write().unwrap();
        let other = redb::TableDefinition::<u64, u64>::new("other");
        write.open_table(other).unwrap().insert(1, 1).unwrap();
        write.commit().unwrap();
        drop(database);
        disk.bytes()
    };
    let newer = {
        let disk = Disk::with(good.clone());
        let database = redb::Builder::new()
            .create_with_backend(disk.backend())
            .unwrap();
        let write = database.begin_write().unwrap();
        let meta = redb::TableDefinition::<&str, &str>::new("meta");
        write
            .open_table(meta)
            .unwrap()
            .insert("format", "2")
            .unwrap();
        write.commit().unwrap();
        drop(database);
        disk.bytes()
    };
    let mut flipped = good.clone();
    let at = flipped
        .windows(12)
        .position(|w| w == b"secondsecond")
        .unwrap();
    flipped[at] ^= 0x20;
    let cases: [(&str, Vec<u8>, &str); 7] = [
        ("text", b"key = 1\n".to_vec(), "is not a FAM repository"),
        ("short", good[..5].to_vec(), "is not a FAM repository"),
        (
            "half",
            good[..good.len() / 2].to_vec(),
            "is damaged or cut off",
        ),
        ("head", good[..100].to_vec(), "is damaged or cut off"),
        ("flipped", flipped, "is damaged or cut off"),
        (
            "database",
            foreign_database,
            "the database of another program",
        ),
        (
            "newer",
            newer,
            "newer version of fam (repository format 2, this build reads 1)",
        ),
    ];
    for (name, bytes, expected) in cases {
        let path = folder.path().join(name);
        std::fs::write(&path, &bytes).unwrap();
        let error = open_file(&path, &cell()).unwrap_err().to_string();
        assert!(error.contains(expected), "{name}: {error}");
        assert!(error.contains(path.to_str().unwrap()), "{name}: {error}");
        assert!(error.contains("left untouched"), "{name}: {error}");
        assert_eq!(std::fs::read(&path).unwrap(), bytes, "{name}");
    }
    let other = CellId::new("other").unwrap();
    let error = open_file(&good_path, &other).unwrap_err().to_string();
    assert!(error.contains("cell `fms200`, not of `other`"), "{error}");
    assert_eq!(std::fs::read(&good_path).unwrap(), good);
    let nowhere = folder.path().join("good.redb/inside");
    let error = open_file(&nowhere, &cell()).unwrap_err().to_string();
    assert!(error.contains("cannot be opened"), "{error}");
}
