//! Errors of datasets.

use crate::folder_lock::LockError;
use std::path::PathBuf;

/// Why a dataset cannot be read, written or collected.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The folder cannot be locked.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// A file or folder cannot be read or written.
    #[error("could not {what} `{}`: {source}", path.display())]
    Io {
        /// The action that failed.
        what: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The disk is full.
    #[error(
        "the disk is full: could not write `{}`: {source}; finished shards are kept, so free some room and \
         give the same command again to go on",
        path.display()
    )]
    DiskFull {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The folder has no `dataset.json`.
    #[error(
        "`{}` is not a dataset: expected dataset.json in it; make one with `wad-cosim dataset collect --out {}`",
        path.display(), path.display()
    )]
    NotADataset {
        /// The file or folder.
        path: PathBuf,
    },
    /// The dataset is of another version.
    #[error(
        "`{}` was written in format {found}, this program reads format {expected}; collect it again, or use \
         the program that wrote it",
        path.display()
    )]
    Version {
        /// The file or folder.
        path: PathBuf,
        /// The dataset's version.
        found: u64,
        /// This program's version.
        expected: u64,
    },
    /// The dataset is unfinished.
    #[error(
        "`{}` is unfinished: {found} of {wanted} frames are there; run the same `dataset collect` command \
         again to finish it, or use these frames with --partial",
        path.display()
    )]
    HalfWritten {
        /// The file or folder.
        path: PathBuf,
        /// Frames that are there.
        found: usize,
        /// Frames that were to be collected.
        wanted: usize,
    },
    /// There are no usable frames.
    #[error("`{}` holds no frames{hint}", path.display())]
    Empty {
        /// The file or folder.
        path: PathBuf,
        /// The rest of the message: where, or what to do.
        hint: &'static str,
    },
    /// A shard is cut off or damaged.
    #[error("`{}` is torn: {why}", path.display())]
    Torn {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        why: String,
    },
    /// The folder holds another dataset than the one to collect.
    #[error(
        "`{}` holds another dataset: expected {what} {asked}, found {found}; name another folder with \
         --out, or remove it",
        path.display()
    )]
    Differs {
        /// The file or folder.
        path: PathBuf,
        /// The option that differs.
        what: &'static str,
        /// Its value in the folder.
        found: String,
        /// Its value in the call.
        asked: String,
    },
    /// The dataset was collected with another camera.
    #[error(
        "`{}` was collected with camera {found}, this program's camera is {expected}; collect it again",
        path.display()
    )]
    Camera {
        /// The file or folder.
        path: PathBuf,
        /// Hash of the dataset's camera.
        found: String,
        /// Hash of this program's camera.
        expected: String,
    },
    /// Test data must not be trained on.
    #[error(
        "`{}` is test data (town `{town}`): it may only be measured on; train on a dataset of the training \
         town, `wad-cosim dataset collect --town town3`",
        path.display()
    )]
    TestData {
        /// The file or folder.
        path: PathBuf,
        /// The dataset's town.
        town: String,
    },
    /// The folder is not a recorded run.
    #[error(
        "`{}` is not a recorded run: {why}; expected a folder that `wad-cosim run --out` wrote", path.display()
    )]
    NotARun {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        why: String,
    },
    /// A recorded run does not repeat.
    #[error(
        "the run in `{}` does not repeat: {off:.2} m off its record at tick {tick}; it was recorded with another \
         version of this program, of SUMO or of the config, so record it again",
        path.display()
    )]
    Drifted {
        /// The file or folder.
        path: PathBuf,
        /// The tick at which it was noticed.
        tick: u64,
        /// Distance from the record (m).
        off: f64,
    },
    /// The recorded runs are of several towns.
    #[error(
        "the recorded runs are of different towns, {first} and {other}; a dataset has one town, so collect one for each"
    )]
    Towns {
        /// The first run's town.
        first: String,
        /// Another run's town.
        other: String,
    },
    /// A picture cannot be encoded or decoded.
    #[error("image: {0}")]
    Image(String),
    /// No such town.
    #[error(transparent)]
    Bundled(#[from] wad_sim::bundled::ResolveError),
    /// SUMO fails.
    #[error(transparent)]
    Bridge(#[from] wad_sim::bridge::BridgeError),
    /// The drive cannot start or go on.
    #[error(transparent)]
    Drive(#[from] crate::drive::DriveError),
    /// There is no route.
    #[error(transparent)]
    Destination(#[from] wad_sim::destination::DestinationError),
    /// The town cannot be read.
    #[error(transparent)]
    Assets(#[from] wad_sim::assets::AssetsError),
    /// Camera or perception fail.
    #[error(transparent)]
    Eyes(#[from] wad_see::eyes::EyesError),
    /// The operating system refuses something.
    #[error("could not {what}: {source}")]
    System {
        /// The action that failed.
        what: &'static str,
        /// The cause.
        source: std::io::Error,
    },
}

impl From<wad_sim::session::ItineraryError> for DatasetError {
    fn from(error: wad_sim::session::ItineraryError) -> Self {
        match error {
            wad_sim::session::ItineraryError::Bridge(error) => error.into(),
            wad_sim::session::ItineraryError::Destination(error) => error.into(),
        }
    }
}

impl DatasetError {
    /// Whether the user's input is wrong, not this machine or SUMO.
    pub fn is_input(&self) -> bool {
        match self {
            Self::Bridge(error) => error.is_input(),
            Self::Drive(error) => error.is_input(),
            Self::Assets(error) => error.is_input(),
            Self::Io { .. }
            | Self::Lock(LockError::Make { .. })
            | Self::DiskFull { .. }
            | Self::System { .. } => false,
            _ => true,
        }
    }

    /// Whether SUMO failed.
    pub fn is_sumo(&self) -> bool {
        match self {
            Self::Bridge(error) => error.is_sumo(),
            Self::Drive(error) => error.is_sumo(),
            Self::Assets(error) => !error.is_input(),
            _ => false,
        }
    }

    /// An I/O error at `path`; a full disk has its own error.
    pub fn io(what: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| match source.kind() {
            std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => {
                Self::DiskFull { path, source }
            }
            _ => Self::Io { what, path, source },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::DriveError;
    use std::io::ErrorKind;
    use wad_sim::assets::AssetsError;
    use wad_sim::bridge::BridgeError;

    #[test]
    fn an_error_is_the_inputs_or_sumos_or_this_machines() {
        let install = || sumo_traci::process::InstallError::NotFound { looked: Vec::new() };
        let kinds = |error: DatasetError| (error.is_input(), error.is_sumo());
        let torn = DatasetError::Torn { path: PathBuf::new(), why: String::new() };
        assert_eq!(kinds(torn), (true, false));
        let denied = DatasetError::io("read", "shard")(ErrorKind::PermissionDenied.into());
        assert_eq!(kinds(denied), (false, false));
        assert_eq!(kinds(BridgeError::from(install()).into()), (false, true));
        assert_eq!(kinds(AssetsError::from(install()).into()), (false, true));
        assert_eq!(kinds(DriveError::from(AssetsError::from(install())).into()), (false, true));
    }
}
