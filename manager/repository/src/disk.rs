//! A disk in memory: it loses what was not synced when it crashes, and fills up. For tests and the simulation.

use redb::StorageBackend;
use std::collections::VecDeque;
use std::io::{Error, ErrorKind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What a disk writes whole or not at all, in bytes.
const SECTOR: u64 = 512;

#[derive(Debug, Default)]
struct State {
    /// What survives a crash.
    durable: Vec<u8>,
    /// What a reader sees.
    current: Vec<u8>,
    /// Writes since the last sync, oldest first.
    pending: VecDeque<Change>,
    /// Bytes that fit; `None`: any number.
    capacity: Option<u64>,
    /// Operations until one fails (and all after it); `None`: none fails.
    fails_in: Option<u64>,
    syncs: u64,
    /// Counts the crashes: backends of an earlier life reach nothing any more.
    life: u64,
}

#[derive(Debug, Clone)]
enum Change {
    Len(u64),
    Bytes(u64, Vec<u8>),
}

fn apply(bytes: &mut Vec<u8>, change: &Change) {
    #[allow(clippy::cast_possible_truncation)] // a disk in memory fits into memory
    match change {
        Change::Len(len) => bytes.resize(*len as usize, 0),
        Change::Bytes(at, data) => {
            let at = *at as usize;
            if bytes.len() < at + data.len() {
                bytes.resize(at + data.len(), 0);
            }
            bytes[at..at + data.len()].copy_from_slice(data);
        }
    }
}

/// The disk; clones are the same disk.
#[derive(Debug, Clone, Default)]
pub struct Disk {
    state: Arc<Mutex<State>>,
}

impl Disk {
    /// A disk with content.
    #[must_use]
    pub fn with(bytes: Vec<u8>) -> Disk {
        let disk = Disk::default();
        let mut state = disk.lock();
        state.current.clone_from(&bytes);
        state.durable = bytes;
        drop(state);
        disk
    }

    /// A storage backend on this disk. One at a time.
    #[must_use]
    pub fn backend(&self) -> DiskBackend {
        DiskBackend {
            life: self.lock().life,
            disk: self.clone(),
        }
    }

    /// Power off: of the writes since the last sync only those are on the disk that `keeps` picks by their position.
    /// Backends made before see nothing but errors from now on.
    pub fn crash(&self, mut keeps: impl FnMut(usize) -> bool) {
        let mut state = self.lock();
        let pending = std::mem::take(&mut state.pending);
        let state = &mut *state;
        for (position, change) in pending.iter().enumerate() {
            if keeps(position) {
                apply(&mut state.durable, change);
            }
        }
        state.current.clone_from(&state.durable);
        state.life += 1;
    }

    /// As [`Disk::crash`], in the middle of writes: of each write since the last sync only those sectors are on the disk that
    /// `keeps` picks by the write's position and the sector's number.
    pub fn crash_torn(&self, mut keeps: impl FnMut(usize, u64) -> bool) {
        let mut state = self.lock();
        let pending = std::mem::take(&mut state.pending);
        let state = &mut *state;
        for (position, change) in pending.iter().enumerate() {
            match change {
                Change::Len(_) => {
                    if keeps(position, 0) {
                        apply(&mut state.durable, change);
                    }
                }
                Change::Bytes(at, data) => {
                    let mut from = 0;
                    while from < data.len() {
                        let here = at + from as u64;
                        let rest = usize::try_from(SECTOR - here % SECTOR).unwrap_or(data.len());
                        let to = data.len().min(from + rest);
                        if keeps(position, here / SECTOR) {
                            let piece = Change::Bytes(here, data[from..to].to_vec());
                            apply(&mut state.durable, &piece);
                        }
                        from = to;
                    }
                }
            }
        }
        state.current.clone_from(&state.durable);
        state.life += 1;
    }

    /// From now on only so many bytes fit; `None`: any number.
    pub fn set_capacity(&self, bytes: Option<u64>) {
        self.lock().capacity = bytes;
    }

    /// After `operations` more writes, changes of length or syncs, each fails; `None`: none fails any more.
    pub fn fail_in(&self, operations: Option<u64>) {
        self.lock().fails_in = operations;
    }

    /// What a reader sees now.
    #[must_use]
    pub fn bytes(&self) -> Vec<u8> {
        self.lock().current.clone()
    }

    /// How often it was synced.
    #[must_use]
    pub fn syncs(&self) -> u64 {
        self.lock().syncs
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A storage backend on a [`Disk`].
#[derive(Debug)]
pub struct DiskBackend {
    disk: Disk,
    life: u64,
}

impl DiskBackend {
    fn state(&self) -> Result<MutexGuard<'_, State>, Error> {
        let state = self.disk.lock();
        if state.life != self.life {
            return Err(Error::other("the power has been off"));
        }
        Ok(state)
    }

    fn change(&self, change: Change) -> Result<(), Error> {
        let mut state = self.state()?;
        state.count_down()?;
        let end = match &change {
            Change::Len(len) => *len,
            Change::Bytes(at, data) => at + data.len() as u64,
        };
        if state.capacity.is_some_and(|room| end > room) {
            return Err(Error::new(
                ErrorKind::StorageFull,
                "no space left on device",
            ));
        }
        apply(&mut state.current, &change);
        state.pending.push_back(change);
        Ok(())
    }
}

impl State {
    fn count_down(&mut self) -> Result<(), Error> {
        match &mut self.fails_in {
            None => Ok(()),
            Some(0) => Err(Error::other("input/output error")),
            Some(left) => {
                *left -= 1;
                Ok(())
            }
        }
    }
}

impl StorageBackend for DiskBackend {
    fn len(&self) -> Result<u64, Error> {
        Ok(self.state()?.current.len() as u64)
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> Result<(), Error> {
        let state = self.state()?;
        let from = usize::try_from(offset).map_err(Error::other)?;
        let bytes = state
            .current
            .get(from..from.saturating_add(out.len()))
            .ok_or(ErrorKind::UnexpectedEof)?;
        out.copy_from_slice(bytes);
        Ok(())
    }

    fn set_len(&self, len: u64) -> Result<(), Error> {
        self.change(Change::Len(len))
    }

    fn sync_data(&self) -> Result<(), Error> {
        let mut state = self.state()?;
        state.count_down()?;
        let state = &mut *state;
        for change in std::mem::take(&mut state.pending) {
            apply(&mut state.durable, &change);
        }
        state.syncs += 1;
        Ok(())
    }

    fn write(&self, offset: u64, data: &[u8]) -> Result<(), Error> {
        self.change(Change::Bytes(offset, data.to_vec()))
    }
}
