//! A folder of finished files that become visible together.
//!
//! Renaming is the only step that touches the target, and takes milliseconds however long the bake took. The manifest comes last: as
//! long as the old one stands, it names every file that may still have to be removed.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::io::Write;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::error::{Error, Result};
use crate::output::manifest;
use crate::output::names;

/// Files on their way into a directory.
#[derive(Debug)]
pub(super) struct Staging {
    directory: PathBuf,
    /// The scene's part of file names.
    scene: String,
    folder: TempDir,
    files: BTreeSet<String>,
}

impl Staging {
    /// Opens a temporary folder on the file system of `directory`.
    pub(super) fn open(directory: &Path, scene: String) -> Result<Self> {
        let nearest = directory
            .ancestors()
            .find(|folder| folder.symlink_metadata().is_ok())
            .filter(|folder| !folder.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        if !nearest.is_dir() {
            return Err(io_error(nearest, io::ErrorKind::NotADirectory.into()));
        }
        let folder = tempfile::Builder::new()
            .prefix(&format!(".{scene}.lumel."))
            .tempdir_in(nearest)
            .map_err(|source| io_error(nearest, source))?;
        Ok(Self {
            directory: directory.to_owned(),
            scene,
            folder,
            files: BTreeSet::new(),
        })
    }

    /// The scene's part of file names.
    pub(super) fn scene(&self) -> &str {
        &self.scene
    }

    /// Takes `file` into the list and returns it.
    pub(super) fn add(&mut self, file: String) -> String {
        self.files.insert(file.clone());
        file
    }

    /// Where `file` is for now.
    pub(super) fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    /// Names of all files so far, sorted.
    pub(super) fn files(&self) -> Vec<&str> {
        self.files.iter().map(String::as_str).collect()
    }

    /// Writes a file that does not exist yet: `pieces`, one behind the other.
    pub(super) fn write(&self, file: &str, pieces: &[&[u8]]) -> Result<()> {
        let path = self.path(file);
        let mut target = fs::File::create_new(&path).map_err(|source| io_error(&path, source))?;
        for piece in pieces {
            target
                .write_all(piece)
                .map_err(|source| io_error(&path, source))?;
        }
        Ok(())
    }

    /// Moves all files to their places and removes those of the previous bake that this one lacks. Returns the names, sorted.
    pub(super) fn commit(self) -> Result<Vec<String>> {
        let stale = manifest::previous(&self.directory, &self.scene);
        fs::create_dir_all(&self.directory).map_err(|source| io_error(&self.directory, source))?;

        // What cannot be replaced is found out before anything has been.
        for file in &self.files {
            let target = self.directory.join(file);
            if target.is_dir() {
                return Err(io_error(&target, io::ErrorKind::IsADirectory.into()));
            }
        }

        let last = names::manifest(&self.scene);
        for file in self.files.iter().filter(|file| **file != last) {
            self.publish(file)?;
        }
        for file in stale.difference(&self.files) {
            let path = self.directory.join(file);
            fs::remove_file(&path).map_err(|source| io_error(&path, source))?;
        }
        if self.files.contains(&last) {
            self.publish(&last)?;
        }
        Ok(self.files.into_iter().collect())
    }

    fn publish(&self, file: &str) -> Result<()> {
        let target = self.directory.join(file);
        fs::rename(self.path(file), &target).map_err(|source| io_error(&target, source))
    }
}

fn io_error(path: &Path, source: io::Error) -> Error {
    Error::Io {
        path: path.to_owned(),
        source,
    }
}
