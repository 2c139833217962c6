//! Why a repository could not be opened, read or written.

use std::path::PathBuf;

/// What went wrong with the repository.
#[derive(Debug, thiserror::Error)]
pub enum RepositoryError {
    /// Not a repository at all.
    #[error(
        "{} is not a FAM repository (it does not begin like one); it was left untouched. Give another path, or move the file away to start with an empty repository", path.display()
    )]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// A repository that cannot be trusted any more.
    #[error(
        "{} is damaged or cut off: {reason}; it was left untouched. Put a copy of it back, or move it away to start with an empty repository: epochs then go on above those of the gateways", path.display()
    )]
    Torn {
        /// The file.
        path: PathBuf,
        /// What was found.
        reason: String,
    },
    /// Written by a later FAM.
    #[error(
        "{} was written by a newer version of fam (repository format {found}, this build reads {}); it was left untouched. Start the newer fam, or give another path", path.display(), crate::FORMAT
    )]
    Newer {
        /// The file.
        path: PathBuf,
        /// Its format.
        found: u64,
    },
    /// Of another cell.
    #[error(
        "{} is the repository of cell `{found}`, not of `{expected}`; it was left untouched. Give each cell a repository of its own", path.display()
    )]
    OtherCell {
        /// The file.
        path: PathBuf,
        /// Whose it is.
        found: String,
        /// Whose was expected.
        expected: String,
    },
    /// Open elsewhere.
    #[error(
        "{} is in use: another manager of this cell is running; end it first, or give another path", path.display()
    )]
    InUse {
        /// The file.
        path: PathBuf,
    },
    /// The operating system refuses.
    #[error(
        "the repository {} cannot be opened: {reason}. Expected a file, or a new name in a directory that this user may write", path.display()
    )]
    Io {
        /// The file.
        path: PathBuf,
        /// What it says.
        reason: String,
    },
    /// A write did not become durable.
    #[error("the repository could not be written: {reason}")]
    Write {
        /// What the disk says.
        reason: String,
    },
    /// What is stored does not read.
    #[error("the repository does not read: {reason}")]
    Read {
        /// What was found.
        reason: String,
    },
}

impl RepositoryError {
    pub(crate) fn write(error: impl std::fmt::Display) -> RepositoryError {
        RepositoryError::Write {
            reason: error.to_string(),
        }
    }
    pub(crate) fn read(error: impl std::fmt::Display) -> RepositoryError {
        RepositoryError::Read {
            reason: error.to_string(),
        }
    }
}
