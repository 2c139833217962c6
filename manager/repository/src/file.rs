//! A repository in a file. It is examined on a copy in memory first, so that a file that is refused stays as it is.

use crate::disk::Disk;
use crate::error::RepositoryError;
use crate::store::{FORMAT, Meta, Repository, builder, load, meta};
use fam_proto::{CellId, RepoState};
use redb::DatabaseError;
use redb::backends::FileBackend;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// How a redb file begins.
const MAGIC: &[u8] = b"redb\x1A\x0A\xA9\x0D\x0A";

/// Opens the repository of `cell` in a file, or begins one where there is none, and loads it.
///
/// # Errors
/// [`RepositoryError`]; the file is then as it was.
pub fn open_file(path: &Path, cell: &CellId) -> Result<(Repository, RepoState), RepositoryError> {
    let io = |error: std::io::Error| RepositoryError::Io {
        path: path.to_owned(),
        reason: error.to_string(),
    };
    let exists = path.try_exists().map_err(io)?;
    if exists {
        examine(path, cell, &io)?;
    } else if let Some(directory) = path.parent().filter(|d| !d.as_os_str().is_empty()) {
        std::fs::create_dir_all(directory).map_err(io)?;
    }
    let place = path.to_owned();
    let open = move || {
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&place)?;
        builder().create_with_backend(FileBackend::new(file)?)
    };
    // The repository hides the kind of the first failure behind words, so that one is looked at here.
    match open() {
        Ok(database) => drop(database),
        Err(DatabaseError::DatabaseAlreadyOpen) => {
            return Err(RepositoryError::InUse {
                path: path.to_owned(),
            });
        }
        Err(error) => {
            return Err(RepositoryError::Io {
                path: path.to_owned(),
                reason: error.to_string(),
            });
        }
    }
    Repository::with(Box::new(open), cell)
}

/// Reads the whole file and opens the copy, with the checksums of all pages checked.
fn examine(
    path: &Path,
    cell: &CellId,
    io: &dyn Fn(std::io::Error) -> RepositoryError,
) -> Result<(), RepositoryError> {
    let path_of = || path.to_owned();
    let mut file = File::open(path).map_err(io)?;
    match file.try_lock_shared() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => return Err(RepositoryError::InUse { path: path_of() }),
        Err(TryLockError::Error(error)) => return Err(io(error)),
    }
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(io)?;
    if bytes.is_empty() {
        return Ok(());
    }
    if !bytes.starts_with(MAGIC) {
        return Err(RepositoryError::Foreign { path: path_of() });
    }
    let torn = |reason: String| RepositoryError::Torn {
        path: path_of(),
        reason,
    };
    // redb may panic over a file that nobody can have written; that is one more way to find out.
    let found = catch_unwind(AssertUnwindSafe(|| {
        let mut builder = builder();
        builder.set_check_integrity_on_open(true);
        let database = builder
            .create_with_backend(Disk::with(bytes).backend())
            .map_err(|error| torn(error.to_string()))?;
        let found = meta(&database).map_err(|error| torn(error.to_string()))?;
        if matches!(&found, Meta::Of(FORMAT, _)) {
            load(&database).map_err(|error| torn(error.to_string()))?;
        }
        Ok(found)
    }));
    match found.unwrap_or_else(|_| Err(torn("its pages contradict each other".to_owned())))? {
        Meta::Of(format, _) if format > FORMAT => Err(RepositoryError::Newer {
            path: path_of(),
            found: format,
        }),
        Meta::Of(_, found) if found != cell.as_str() => Err(RepositoryError::OtherCell {
            path: path_of(),
            found,
            expected: cell.to_string(),
        }),
        Meta::New | Meta::Of(..) => Ok(()),
    }
}
