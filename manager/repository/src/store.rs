//! Tables, and how a write becomes a row.
//!
//! | table | key | value |
//! |---|---|---|
//! | `meta` | `format`, `cell` | number as text, name |
//! | `epochs` | MC | highest reserved epoch |
//! | `events` | position in the history | the event |
//! | `state` | `assignment`, `pins`, `drained`, `stopped` | the newest write of that kind, whole |
//! | `registrations` | controller | its newest registration |
//!
//! Values other than numbers and names are written by `fam_proto::codec`.

use crate::error::RepositoryError;
use fam_proto::codec::{decode, encode};
use fam_proto::{CellId, Epoch, Event, McId, RepoState, RepoWrite};
use redb::{
    Builder, Database, DatabaseError, Durability, ReadableDatabase, ReadableTable,
    ReadableTableMetadata, StorageBackend, TableDefinition, TableError, WriteTransaction,
};

/// Format of the tables that this build writes, and the highest that it reads.
pub const FORMAT: u64 = 1;

/// Events kept on disk; older ones are dropped.
pub const EVENTS_KEPT_MAX: u64 = 100_000;

/// Memory that redb may use to cache pages, in bytes.
const CACHE_BYTES: usize = 8 << 20;

const META: TableDefinition<'_, &str, &str> = TableDefinition::new("meta");
const EPOCHS: TableDefinition<'_, &str, u64> = TableDefinition::new("epochs");
const EVENTS: TableDefinition<'_, u64, &[u8]> = TableDefinition::new("events");
const STATE: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("state");
const REGISTRATIONS: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("registrations");

type Open = Box<dyn FnMut() -> Result<Database, DatabaseError> + Send>;

/// An open repository.
///
/// redb gives a database up after its first failed write. So a failed [`Repository::store`] closes it, and the next one
/// opens it again: a disk that was full and has room again is written again.
pub struct Repository {
    open: Open,
    database: Option<Database>,
}

impl std::fmt::Debug for Repository {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Repository")
            .field("open", &self.database.is_some())
            .finish_non_exhaustive()
    }
}

/// What `meta` says.
pub(crate) enum Meta {
    /// Nothing: a new database.
    New,
    /// Format and cell.
    Of(u64, String),
}

pub(crate) fn builder() -> Builder {
    let mut builder = Builder::new();
    builder.set_cache_size(CACHE_BYTES);
    builder
}

impl Repository {
    /// Opens, or begins, the repository of `cell` on the storage that `backend` makes, anew for each attempt, and loads it.
    ///
    /// # Errors
    /// [`RepositoryError`]: the storage refuses, or holds something else.
    pub fn over<B: StorageBackend>(
        cell: &CellId,
        mut backend: impl FnMut() -> std::io::Result<B> + Send + 'static,
    ) -> Result<(Repository, RepoState), RepositoryError> {
        let open: Open = Box::new(move || builder().create_with_backend(backend()?));
        Repository::with(open, cell)
    }

    pub(crate) fn with(
        mut open: Open,
        cell: &CellId,
    ) -> Result<(Repository, RepoState), RepositoryError> {
        let database = open().map_err(RepositoryError::read)?;
        match meta(&database)? {
            Meta::New => begin(&database, cell)?,
            Meta::Of(format, found) if format > FORMAT || found != cell.as_str() => {
                return Err(RepositoryError::read(format!(
                    "it is of cell `{found}`, format {format}; expected cell `{cell}`, format {FORMAT}"
                )));
            }
            Meta::Of(..) => {}
        }
        let state = load(&database)?;
        let repository = Repository {
            open,
            database: Some(database),
        };
        Ok((repository, state))
    }

    /// Stores all of `writes`, or none. Durable when it returns, also those that need not be.
    ///
    /// # Errors
    /// [`RepositoryError::Write`] with what the disk says; nothing of `writes` may be relied on then.
    pub fn store(&mut self, writes: &[RepoWrite]) -> Result<(), RepositoryError> {
        let database = match self.database.take() {
            Some(database) => database,
            None => (self.open)().map_err(RepositoryError::write)?,
        };
        // On an error the database is dropped here, which closes it.
        store(&database, writes)?;
        self.database = Some(database);
        Ok(())
    }

    /// What is stored, summed up.
    ///
    /// # Errors
    /// [`RepositoryError::Read`].
    pub fn load(&mut self) -> Result<RepoState, RepositoryError> {
        load(self.database()?)
    }

    /// Events after position `after`, oldest first, at most `limit`, and whether more follow.
    ///
    /// # Errors
    /// [`RepositoryError::Read`].
    pub fn events(
        &mut self,
        after: u64,
        limit: usize,
    ) -> Result<(Vec<Event>, bool), RepositoryError> {
        let read = self
            .database()?
            .begin_read()
            .map_err(RepositoryError::read)?;
        let table = read.open_table(EVENTS).map_err(RepositoryError::read)?;
        let mut found = Vec::new();
        let rows = table
            .range(after.saturating_add(1)..)
            .map_err(RepositoryError::read)?;
        for row in rows {
            if found.len() == limit {
                return Ok((found, true));
            }
            let (_, value) = row.map_err(RepositoryError::read)?;
            found.push(decode(value.value()).map_err(RepositoryError::read)?);
        }
        Ok((found, false))
    }

    fn database(&mut self) -> Result<&Database, RepositoryError> {
        if self.database.is_none() {
            self.database = Some((self.open)().map_err(RepositoryError::read)?);
        }
        self.database
            .as_ref()
            .ok_or_else(|| RepositoryError::read("it is closed"))
    }
}

/// Reads format and cell.
pub(crate) fn meta(database: &Database) -> Result<Meta, RepositoryError> {
    let read = database.begin_read().map_err(RepositoryError::read)?;
    let table = match read.open_table(META) {
        Ok(table) => table,
        Err(TableError::TableDoesNotExist(_)) => {
            let others = read.list_tables().map_err(RepositoryError::read)?.count();
            return if others == 0 {
                Ok(Meta::New)
            } else {
                Err(RepositoryError::read(
                    "it is the database of another program",
                ))
            };
        }
        Err(error) => return Err(RepositoryError::read(error)),
    };
    let text = |key: &str| -> Result<String, RepositoryError> {
        let value = table.get(key).map_err(RepositoryError::read)?;
        let value = value
            .ok_or_else(|| RepositoryError::read(format!("its table `meta` lacks `{key}`")))?;
        Ok(value.value().to_owned())
    };
    let format = text("format")?;
    let format = format.parse().map_err(|_| {
        RepositoryError::read(format!("its format is `{format}`, expected a number"))
    })?;
    Ok(Meta::Of(format, text("cell")?))
}

fn begin(database: &Database, cell: &CellId) -> Result<(), RepositoryError> {
    let write = database.begin_write().map_err(RepositoryError::write)?;
    {
        let mut table = write.open_table(META).map_err(RepositoryError::write)?;
        for (key, value) in [
            ("format", FORMAT.to_string().as_str()),
            ("cell", cell.as_str()),
        ] {
            table.insert(key, value).map_err(RepositoryError::write)?;
        }
        write.open_table(EPOCHS).map_err(RepositoryError::write)?;
        write.open_table(EVENTS).map_err(RepositoryError::write)?;
        write.open_table(STATE).map_err(RepositoryError::write)?;
        write
            .open_table(REGISTRATIONS)
            .map_err(RepositoryError::write)?;
    }
    write.commit().map_err(RepositoryError::write)
}

fn store(database: &Database, writes: &[RepoWrite]) -> Result<(), RepositoryError> {
    let mut transaction = database.begin_write().map_err(RepositoryError::write)?;
    transaction
        .set_durability(Durability::Immediate)
        .map_err(RepositoryError::write)?;
    for write in writes {
        put(&transaction, write)?;
    }
    transaction.commit().map_err(RepositoryError::write)
}

fn put(transaction: &WriteTransaction, write: &RepoWrite) -> Result<(), RepositoryError> {
    let in_state = match write {
        RepoWrite::EpochBlock { mc, upto } => {
            let mut table = transaction
                .open_table(EPOCHS)
                .map_err(RepositoryError::write)?;
            let stored = table.get(mc.as_str()).map_err(RepositoryError::write)?;
            let stored = stored.map_or(0, |s| s.value());
            table
                .insert(mc.as_str(), stored.max(upto.0))
                .map_err(RepositoryError::write)?;
            return Ok(());
        }
        RepoWrite::Event(event) => {
            let bytes = encode(event).map_err(RepositoryError::write)?;
            let mut table = transaction
                .open_table(EVENTS)
                .map_err(RepositoryError::write)?;
            table
                .insert(event.seq, bytes.as_slice())
                .map_err(RepositoryError::write)?;
            while table.len().map_err(RepositoryError::write)? > EVENTS_KEPT_MAX {
                table.pop_first().map_err(RepositoryError::write)?;
            }
            return Ok(());
        }
        RepoWrite::Registered(registration) => {
            let bytes = encode(write).map_err(RepositoryError::write)?;
            let mut table = transaction
                .open_table(REGISTRATIONS)
                .map_err(RepositoryError::write)?;
            table
                .insert(registration.owner.controller.as_str(), bytes.as_slice())
                .map_err(RepositoryError::write)?;
            return Ok(());
        }
        RepoWrite::Assignment { .. } => "assignment",
        RepoWrite::Pins(_) => "pins",
        RepoWrite::Drained(_) => "drained",
        RepoWrite::Stopped(_) => "stopped",
    };
    let bytes = encode(write).map_err(RepositoryError::write)?;
    let mut table = transaction
        .open_table(STATE)
        .map_err(RepositoryError::write)?;
    table
        .insert(in_state, bytes.as_slice())
        .map_err(RepositoryError::write)?;
    Ok(())
}

pub(crate) fn load(database: &Database) -> Result<RepoState, RepositoryError> {
    let read = database.begin_read().map_err(RepositoryError::read)?;
    let mut state = RepoState::default();
    let epochs = read.open_table(EPOCHS).map_err(RepositoryError::read)?;
    for row in epochs.iter().map_err(RepositoryError::read)? {
        let (mc, upto) = row.map_err(RepositoryError::read)?;
        state.apply(&RepoWrite::EpochBlock {
            mc: McId::new(mc.value()).map_err(RepositoryError::read)?,
            upto: Epoch(upto.value()),
        });
    }
    for definition in [STATE, REGISTRATIONS] {
        let table = read.open_table(definition).map_err(RepositoryError::read)?;
        for row in table.iter().map_err(RepositoryError::read)? {
            let (_, bytes) = row.map_err(RepositoryError::read)?;
            let write: RepoWrite = decode(bytes.value()).map_err(RepositoryError::read)?;
            state.apply(&write);
        }
    }
    let events = read.open_table(EVENTS).map_err(RepositoryError::read)?;
    let newest = events.iter().map_err(RepositoryError::read)?.rev();
    for row in newest.take(fam_proto::EVENTS_LOADED_MAX) {
        let (_, bytes) = row.map_err(RepositoryError::read)?;
        state
            .events
            .push(decode(bytes.value()).map_err(RepositoryError::read)?);
    }
    state.events.reverse();
    state.last_event_seq = state.events.last().map_or(0, |e| e.seq);
    Ok(state)
}
