//! Files on their way into a folder: none of them stands there until all are written, so that a failure leaves it as it was.

use std::path::{Path, PathBuf};

use crate::convert::not_written;
use crate::problem::Problems;

pub(crate) struct Staged<'a> {
    target: &'a Path,
    /// Removed with all that is left in it.
    waiting: tempfile::TempDir,
    names: Vec<String>,
}

impl<'a> Staged<'a> {
    /// For the folder `target`, which need not exist. The files wait inside of it, or beside it: on the same disk.
    pub fn new(target: &'a Path) -> Result<Self, Problems> {
        let near = if target.is_dir() {
            target
        } else {
            match target.parent() {
                Some(parent) if !parent.as_os_str().is_empty() => parent,
                _ => Path::new("."),
            }
        };
        let waiting = std::fs::create_dir_all(near)
            .and_then(|()| tempfile::Builder::new().prefix(".fam-").tempdir_in(near))
            .map_err(|e| Problems::one(not_written(target, &e)))?;
        Ok(Self {
            target,
            waiting,
            names: Vec::new(),
        })
    }

    pub fn add(&mut self, name: String, text: &str) -> Result<(), Problems> {
        let path = self.waiting.path().join(&name);
        path.parent()
            .map_or(Ok(()), std::fs::create_dir_all)
            .and_then(|()| std::fs::write(&path, text))
            .map_err(|e| Problems::one(not_written(&self.target.join(&name), &e)))?;
        self.names.push(name);
        Ok(())
    }

    /// Puts all of them where they belong, or none if something is in the way. Returns their paths.
    pub fn deliver(self) -> Result<Vec<PathBuf>, Problems> {
        let paths: Vec<PathBuf> = self.names.iter().map(|n| self.target.join(n)).collect();
        for path in &paths {
            let folder = path.parent().unwrap_or(self.target);
            let in_the_way = if path.is_dir() {
                Err(std::io::ErrorKind::IsADirectory.into())
            } else {
                std::fs::create_dir_all(folder)
            };
            in_the_way.map_err(|e| Problems::one(not_written(path, &e)))?;
        }
        for (name, path) in self.names.iter().zip(&paths) {
            std::fs::rename(self.waiting.path().join(name), path)
                .map_err(|e| Problems::one(not_written(path, &e)))?;
        }
        Ok(paths)
    }
}
