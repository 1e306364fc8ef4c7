//! The lock of a results folder: two processes that write into one would delete or repeat each other's work.

use std::fs::{File, OpenOptions, TryLockError};
use std::path::{Path, PathBuf};

/// Why a folder cannot be locked.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// Another process writes into the folder.
    #[error("another process is writing into {}: let it end, or name another folder with --out", path.display())]
    Busy {
        /// The folder.
        path: PathBuf,
    },
    /// The folder or its lock file cannot be made.
    #[error("cannot make {}: {source}", path.display())]
    Make {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
}

/// Held as long as a process writes into a folder. The system releases it when the process ends, however it ends.
#[derive(Debug)]
pub struct FolderLock {
    _file: File,
}

impl FolderLock {
    /// Locks the folder `path`, which is made if it is missing.
    ///
    /// # Errors
    /// Another process holds the lock, or the folder cannot be written.
    pub fn take(path: &Path) -> Result<Self, LockError> {
        let failed = |path: &Path| {
            let path = path.to_path_buf();
            move |source| LockError::Make { path, source }
        };
        std::fs::create_dir_all(path).map_err(failed(path))?;
        // The file stays: one that is removed may be locked by a process that has just opened it.
        let name = path.join(".lock");
        let file = OpenOptions::new().append(true).create(true).open(&name).map_err(failed(&name))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(LockError::Busy { path: path.to_path_buf() }),
            // A file system without locks.
            Err(TryLockError::Error(error)) => tracing::debug!("no lock on {}: {error}", path.display()),
        }
        Ok(Self { _file: file })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_locked_until_its_lock_is_dropped() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("runs/a");
        let lock = FolderLock::take(&folder).unwrap();
        let error = FolderLock::take(&folder).unwrap_err();
        assert!(matches!(error, LockError::Busy { .. }), "{error}");
        assert!(FolderLock::take(&dir.path().join("runs/b")).is_ok());
        drop(lock);
        assert!(FolderLock::take(&folder).is_ok());
    }
}
