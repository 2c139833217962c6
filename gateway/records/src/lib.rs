//! The record file: a mapped file of fixed size that survives a kill of the gateway at any instruction.
//!
//! ```text
//!  page 0          magic, format, cell, gateway, fingerprint of the MCs, checksum; two counters of starts
//!  table           for each MC the room that its states have (8 bytes each, in order of names)
//!  for each MC     ledger slot A | ledger slot B | head slot A | head slot B      (each on pages of its own)
//! ```
//!
//! A write goes into the slot that is not the newest one and carries a sequence number and a checksum; a torn one is not
//! read, and the slot of before holds. Heads are written without a sync: the page cache outlives the process. Ledgers of
//! openings are synced. The file is written in full when it is made, so that a full disk cannot strike later.
//!
//! A file that is foreign, of a newer version, of another cell or of other MCs is refused and left untouched. Each head says of
//! which layout it is; a new version of an MC's logic may bring another one, within the room that the file has for it.

mod slots;

use fam_gateway_core::stored::never;
use fam_gateway_core::{RecordWrite, StoredRecord};
use fam_proto::codec::MESSAGE_BYTES_MAX;
use fam_proto::model::{CellModel, McModel, state_room};
use fam_proto::{CellId, Digest, GatewayId, McId};
use memmap2::MmapMut;
use slots::{HeadSlots, LedgerSlots};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Version of the file that this build writes, and the only one that it reads.
pub const FILE_VERSION: u32 = 2;

const PAGE: usize = 4096;
const MAGIC: [u8; 8] = *b"FAMGWREC";
const NAME_AT: [usize; 2] = [64, 192];
const NAME_BYTES: usize = 128;
const FINGERPRINT_AT: usize = 16;
const CHECKSUM_AT: usize = 32;
/// Digest of the table of rooms.
const TABLE_AT: usize = 48;
const ROOM_BYTES: usize = 8;
/// The checked part of page 0 ends here; the counters of starts lie behind.
const FIXED_END: usize = 320;
const STARTS_AT: [usize; 2] = [512, 520];

/// Why a record file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RecordsError {
    /// The operating system says no.
    #[error("record file {path}: {what} failed: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        what: &'static str,
        /// What the system says.
        source: io::Error,
    },
    /// No room.
    #[error(
        "record file {path}: the disk has no room for its {bytes} bytes; free some, or give another place for it"
    )]
    DiskFull {
        /// The file.
        path: PathBuf,
        /// What is needed.
        bytes: u64,
    },
    /// Another gateway has it.
    #[error(
        "record file {path} is in use by another gateway; end that one first, or give this one a file of its own"
    )]
    InUse {
        /// The file.
        path: PathBuf,
    },
    /// Not a record file, or damaged beyond reading.
    #[error(
        "{path} is not a record file of a gateway (or its first page is damaged); it was left untouched. Give another path, or move it away"
    )]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// Written by another version.
    #[error(
        "record file {path} has format version {found}, this build reads version {FILE_VERSION}; it was left untouched. Run the version of fam that wrote it"
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
    },
    /// Belongs to someone else.
    #[error(
        "record file {path} belongs to gateway {gateway} of cell {cell}; it was left untouched. Give this gateway a file of its own"
    )]
    Other {
        /// The file.
        path: PathBuf,
        /// Its cell.
        cell: String,
        /// Its gateway.
        gateway: String,
    },
    /// A state has no room any more.
    #[error(
        "record file {path} has no room for the state of {mc}, which has grown; it was left untouched. Go back to the version that it was written with, or, with the plant in its initial state, move the file away: all MCs then start from their initial values"
    )]
    Outgrown {
        /// The file.
        path: PathBuf,
        /// The MC.
        mc: McId,
    },
    /// The model has changed.
    #[error(
        "record file {path} was written for other MCs or other outputs than the cell has now; it was left untouched. Go back to the cell that it was written with, or, with the plant in its initial state, move the file away: all MCs then start from their initial values"
    )]
    Layout {
        /// The file.
        path: PathBuf,
    },
}

#[derive(Debug)]
struct McPart {
    ledger: LedgerSlots,
    head: HeadSlots,
}

/// The open record file.
#[derive(Debug)]
pub struct RecordFile {
    path: PathBuf,
    map: MmapMut,
    /// Kept for its lock.
    _file: File,
    parts: BTreeMap<McId, McPart>,
    starts: u32,
}

/// Now, in seconds since 1970.
fn made_s() -> u32 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(1, |since| {
        u32::try_from(since.as_secs()).unwrap_or(1).max(1)
    })
}

impl RecordFile {
    /// Opens the file for a gateway, or makes it, counts this start, and returns what it holds.
    ///
    /// # Errors
    /// [`RecordsError`]; a file that is refused has not been changed.
    pub fn open(
        path: &Path,
        cell: &CellModel,
        gateway: &GatewayId,
    ) -> Result<(RecordFile, Vec<StoredRecord>), RecordsError> {
        let io = |what| {
            move |source| RecordsError::Io {
                path: path.to_owned(),
                what,
                source,
            }
        };
        let mcs: BTreeMap<&McId, &McModel> = cell
            .mcs
            .iter()
            .filter(|mc| &mc.gateway == gateway)
            .map(|mc| (&mc.mc, mc))
            .collect();
        let wanted: Vec<usize> = mcs
            .values()
            .map(|mc| state_room(mc.diagnosis.checkpoint_len as usize))
            .collect();
        let page = first_page(&cell.cell, gateway, &mcs, &wanted);
        if !path.exists() {
            create(path, &page, lay_out(&mcs, &wanted).1)?;
        }
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .open(path)
            .map_err(io("opening it for reading and writing"))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(std::fs::TryLockError::WouldBlock) => {
                return Err(RecordsError::InUse {
                    path: path.to_owned(),
                });
            }
            Err(std::fs::TryLockError::Error(error)) => return Err(io("locking it")(error)),
        }
        let rooms = check(path, &file, &page, mcs.len())?;
        let (parts, bytes) = lay_out(&mcs, &rooms);
        if file.metadata().map_err(io("reading its length"))?.len() != bytes as u64 {
            return Err(RecordsError::Foreign {
                path: path.to_owned(),
            });
        }
        let outgrown = mcs.values().zip(&rooms);
        if let Some((mc, _)) = outgrown
            .into_iter()
            .find(|(mc, room)| mc.diagnosis.checkpoint_len as usize > **room)
        {
            return Err(RecordsError::Outgrown {
                path: path.to_owned(),
                mc: mc.mc.clone(),
            });
        }
        // SAFETY: the file is locked by this process and has its full length, and its room is reserved on disk. Nobody who honours the
        // lock changes or shortens it; every byte read is checked by a checksum.
        let map = unsafe { MmapMut::map_mut(&file) }.map_err(io("mapping it"))?;
        let mut records = RecordFile {
            path: path.to_owned(),
            map,
            _file: file,
            parts,
            starts: 0,
        };
        records.count_start()?;
        let stored = records.load();
        Ok((records, stored))
    }

    /// Grows with each opening by a gateway; it begins with the time at which the file was made, in seconds since 1970.
    #[must_use]
    pub fn starts(&self) -> u32 {
        self.starts
    }

    /// Where the file is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn count_start(&mut self) -> Result<(), RecordsError> {
        // Each counter stands beside its complement, so that a torn one is known; the older of the two is overwritten.
        let read = |at: usize| {
            let value = u32::from_le_bytes(self.map[at..at + 4].try_into().unwrap_or_default());
            let complement =
                u32::from_le_bytes(self.map[at + 4..at + 8].try_into().unwrap_or_default());
            if value == !complement { value } else { 0 }
        };
        let counts = STARTS_AT.map(read);
        let before = counts[0].max(counts[1]);
        // Image numbers grow with it, and others go by them: a file that is made anew goes on above the one that was lost.
        self.starts = if before == 0 {
            made_s()
        } else {
            before.saturating_add(1)
        };
        let at = STARTS_AT[usize::from(counts[0] > counts[1])];
        self.map[at..at + 4].copy_from_slice(&self.starts.to_le_bytes());
        self.map[at + 4..at + 8].copy_from_slice(&(!self.starts).to_le_bytes());
        self.map
            .flush_range(0, PAGE)
            .map_err(|source| RecordsError::Io {
                path: self.path.clone(),
                what: "writing the count of starts",
                source,
            })
    }

    fn load(&mut self) -> Vec<StoredRecord> {
        let map = &self.map;
        self.parts
            .iter_mut()
            .map(|(mc, part)| {
                let ledger = part.ledger.load(map).unwrap_or_else(never);
                StoredRecord::choose(mc.clone(), ledger, part.head.load(map))
            })
            .collect()
    }

    /// Carries out a write.
    ///
    /// # Errors
    /// What the disk says, for people. An opening that could not be synced is taken back.
    pub fn write(&mut self, write: &RecordWrite) -> Result<(), String> {
        let Some(part) = self.parts.get_mut(write.mc()) else {
            return Err(format!(
                "{} has no place in {}",
                write.mc(),
                self.path.display()
            ));
        };
        match write {
            RecordWrite::Head { head, .. } => part.head.write(&mut self.map, head),
            RecordWrite::Opened { ledger, .. } => {
                let undo = part.ledger.write(&mut self.map, ledger)?;
                sync(&self.map, &self.path, part.ledger.newest_range()).inspect_err(|_| {
                    part.ledger.take_back(&mut self.map, undo);
                })
            }
            RecordWrite::Changed {
                ledger, sync: s, ..
            } => {
                part.ledger.write(&mut self.map, ledger)?;
                if *s {
                    sync(&self.map, &self.path, part.ledger.newest_range())
                } else {
                    Ok(())
                }
            }
        }
    }

    /// Syncs everything, at a clean end.
    ///
    /// # Errors
    /// What the disk says.
    pub fn sync_all(&self) -> Result<(), RecordsError> {
        self.map.flush().map_err(|source| RecordsError::Io {
            path: self.path.clone(),
            what: "syncing it",
            source,
        })
    }
}

fn sync(map: &MmapMut, path: &Path, (at, len): (usize, usize)) -> Result<(), String> {
    map.flush_range(at, len)
        .map_err(|error| format!("syncing {}: {error}", path.display()))
}

fn table_bytes(mcs: usize) -> usize {
    (mcs * ROOM_BYTES).div_ceil(PAGE) * PAGE
}

/// Where the parts lie, with so much room for the states, and how long the file is.
fn lay_out(mcs: &BTreeMap<&McId, &McModel>, rooms: &[usize]) -> (BTreeMap<McId, McPart>, usize) {
    let mut at = PAGE + table_bytes(mcs.len());
    let mut parts = BTreeMap::new();
    for ((mc, model), room) in mcs.iter().zip(rooms) {
        let ledger = LedgerSlots::at(at);
        at += ledger.bytes();
        let head = HeadSlots::at(at, model.fail_safe.len(), *room);
        at += head.bytes();
        parts.insert((*mc).clone(), McPart { ledger, head });
    }
    (parts, at)
}

/// The first page as it has to be, but for the counters, and the table behind it.
fn first_page(
    cell: &CellId,
    gateway: &GatewayId,
    mcs: &BTreeMap<&McId, &McModel>,
    rooms: &[usize],
) -> Vec<u8> {
    let mut page = vec![0; PAGE + table_bytes(mcs.len())];
    for (n, room) in rooms.iter().enumerate() {
        let at = PAGE + n * ROOM_BYTES;
        page[at..at + ROOM_BYTES].copy_from_slice(&(*room as u64).to_le_bytes());
    }
    let table = Digest::of(0, &page[PAGE..]).0;
    page[TABLE_AT..TABLE_AT + 16].copy_from_slice(&table);
    page[..8].copy_from_slice(&MAGIC);
    page[8..12].copy_from_slice(&FILE_VERSION.to_le_bytes());
    let mut layout = Vec::new();
    for (mc, model) in mcs {
        layout.extend_from_slice(mc.as_str().as_bytes());
        layout.push(0);
        layout.extend_from_slice(&(model.fail_safe.len() as u64).to_le_bytes());
    }
    page[FINGERPRINT_AT..FINGERPRINT_AT + 16].copy_from_slice(&Digest::of(0, &layout).0);
    for (at, name) in NAME_AT.into_iter().zip([cell.as_str(), gateway.as_str()]) {
        // Names have at most 64 bytes; the rest of the place stays 0.
        page[at..at + name.len()].copy_from_slice(name.as_bytes());
    }
    let checksum = checksum_of(&page);
    page[CHECKSUM_AT..CHECKSUM_AT + 16].copy_from_slice(&checksum);
    page
}

fn checksum_of(page: &[u8]) -> [u8; 16] {
    let mut fixed = page[..FIXED_END].to_vec();
    fixed[CHECKSUM_AT..CHECKSUM_AT + 16].fill(0);
    Digest::of(u64::from(FILE_VERSION), &fixed).0
}

/// Makes the file under another name and renames it when it is whole: a kill leaves no half file.
fn create(path: &Path, page: &[u8], bytes: usize) -> Result<(), RecordsError> {
    let mut temporary = path.as_os_str().to_owned();
    temporary.push(".new");
    let temporary = PathBuf::from(temporary);
    let result = create_at(path, &temporary, page, bytes);
    if result.is_err() {
        let _ = std::fs::remove_file(&temporary);
    }
    result
}

fn create_at(path: &Path, temporary: &Path, page: &[u8], bytes: usize) -> Result<(), RecordsError> {
    let io = |what| {
        move |source: io::Error| {
            let full = matches!(
                source.kind(),
                io::ErrorKind::StorageFull
                    | io::ErrorKind::QuotaExceeded
                    | io::ErrorKind::FileTooLarge
            );
            if full {
                RecordsError::DiskFull {
                    path: path.to_owned(),
                    bytes: bytes as u64,
                }
            } else {
                RecordsError::Io {
                    path: path.to_owned(),
                    what,
                    source,
                }
            }
        }
    };
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(folder).map_err(io("making its folder"))?;
    let mut file = OpenOptions::new()
        .write(true)
        .create(true)
        .truncate(true)
        .open(temporary)
        .map_err(io("making it"))?;
    fill(&mut file, page, bytes).map_err(io("writing it for the first time"))?;
    std::fs::rename(temporary, path).map_err(io("putting it in its place"))?;
    File::open(folder)
        .and_then(|folder| folder.sync_all())
        .map_err(io("syncing its folder"))
}

/// Writes the whole file once, so that all its blocks are there: a mapped page without a block kills the process when the disk
/// is full, and a block that was only reserved makes its first sync slow.
fn fill(file: &mut File, page: &[u8], bytes: usize) -> io::Result<()> {
    file.write_all(page)?;
    let zeros = vec![0; 64 * PAGE];
    let mut left = bytes - page.len();
    while left > 0 {
        let piece = left.min(zeros.len());
        file.write_all(&zeros[..piece])?;
        left -= piece;
    }
    file.sync_all()
}

/// Whether it is the file that is wanted; gives the rooms that it has for the MCs' states.
fn check(path: &Path, file: &File, want: &[u8], mcs: usize) -> Result<Vec<usize>, RecordsError> {
    use std::os::unix::fs::FileExt;
    let path_buf = || path.to_owned();
    let io = |source| RecordsError::Io {
        path: path.to_owned(),
        what: "reading its first page",
        source,
    };
    let len = file.metadata().map_err(io)?.len();
    let mut page = vec![0; PAGE];
    if len < PAGE as u64 {
        return Err(RecordsError::Foreign { path: path_buf() });
    }
    file.read_exact_at(&mut page, 0).map_err(io)?;
    if page[..8] != MAGIC {
        return Err(RecordsError::Foreign { path: path_buf() });
    }
    let version = u32::from_le_bytes(page[8..12].try_into().unwrap_or_default());
    if version != FILE_VERSION {
        return Err(RecordsError::Version {
            path: path_buf(),
            found: version,
        });
    }
    if page[CHECKSUM_AT..CHECKSUM_AT + 16] != checksum_of(&page) {
        return Err(RecordsError::Foreign { path: path_buf() });
    }
    let name = |page: &[u8], at: usize| {
        let text = &page[at..at + NAME_BYTES];
        String::from_utf8_lossy(text)
            .trim_end_matches('\0')
            .to_owned()
    };
    if NAME_AT.iter().any(|at| name(&page, *at) != name(want, *at)) {
        return Err(RecordsError::Other {
            path: path_buf(),
            cell: name(&page, NAME_AT[0]),
            gateway: name(&page, NAME_AT[1]),
        });
    }
    let fingerprint = FINGERPRINT_AT..FINGERPRINT_AT + 16;
    if page[fingerprint.clone()] != want[fingerprint] {
        return Err(RecordsError::Layout { path: path_buf() });
    }
    let mut table = vec![0; table_bytes(mcs)];
    let read = file.read_exact_at(&mut table, PAGE as u64);
    if read.is_err() || page[TABLE_AT..TABLE_AT + 16] != Digest::of(0, &table).0 {
        return Err(RecordsError::Foreign { path: path_buf() });
    }
    let rooms = table.chunks_exact(ROOM_BYTES).take(mcs).map(|bytes| {
        bytes
            .try_into()
            .ok()
            .and_then(|bytes| usize::try_from(u64::from_le_bytes(bytes)).ok())
            .filter(|room| *room <= MESSAGE_BYTES_MAX * 2)
    });
    rooms
        .collect::<Option<Vec<usize>>>()
        .ok_or_else(|| RecordsError::Foreign { path: path_buf() })
}

#[cfg(test)]
#[path = "../../core/tests/common/mod.rs"]
mod testing;
#[cfg(test)]
mod tests;
