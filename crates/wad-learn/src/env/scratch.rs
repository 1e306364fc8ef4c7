//! The environments' temporary folders, and the end of those that nobody uses any more.

use crate::folder_lock::FolderLock;
use std::io;
use std::path::Path;
use std::sync::Once;
use std::time::{Duration, SystemTime};
use tempfile::TempDir;

const PREFIX: &str = "wad-env-";
/// A younger folder may belong to a process that has not locked it yet.
const AGE: Duration = Duration::from_secs(60);

/// A temporary folder that is removed when dropped; after a SIGKILL, by the next process that makes one.
#[derive(Debug)]
pub struct Scratch {
    folder: TempDir,
    /// Says that the folder is in use.
    _lock: FolderLock,
}

impl Scratch {
    /// Makes one among the system's temporary files.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn new() -> io::Result<Self> {
        static SWEPT: Once = Once::new();
        SWEPT.call_once(|| sweep(&std::env::temp_dir(), AGE));
        let folder = tempfile::Builder::new().prefix(PREFIX).tempdir()?;
        let lock = FolderLock::take(folder.path()).map_err(io::Error::other)?;
        Ok(Self { folder, _lock: lock })
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// Removes folders among the `temporary` ones that are older than `age` and whose owner is dead.
fn sweep(temporary: &Path, age: Duration) {
    for entry in std::fs::read_dir(temporary).into_iter().flatten().flatten() {
        let ours = entry.file_name().to_string_lossy().starts_with(PREFIX);
        let made = entry.metadata().and_then(|found| found.modified()).unwrap_or_else(|_| SystemTime::now());
        if !ours || !made.elapsed().is_ok_and(|since| since >= age) {
            continue;
        }
        // Others' folders cannot be locked, and those in use are.
        if entry.path().join(".lock").is_file()
            && let Ok(_lock) = FolderLock::take(&entry.path())
            && let Err(error) = std::fs::remove_dir_all(entry.path())
        {
            tracing::debug!("{} stays: {error}", entry.path().display());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_of_the_dead_are_swept_and_those_in_use_stay() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = |name: &str| temporary.path().join(name);
        let used = FolderLock::take(&folder("wad-env-used")).unwrap();
        drop(FolderLock::take(&folder("wad-env-dead")).unwrap());
        drop(FolderLock::take(&folder("other")).unwrap());
        std::fs::create_dir(folder("wad-env-unlocked")).unwrap();
        sweep(temporary.path(), AGE);
        assert!(folder("wad-env-dead").exists(), "too young to be swept");
        sweep(temporary.path(), Duration::ZERO);
        let left =
            ["wad-env-used", "wad-env-dead", "other", "wad-env-unlocked"].map(|name| folder(name).exists());
        assert_eq!(left, [true, false, true, true]);
        drop(used);
    }
}
