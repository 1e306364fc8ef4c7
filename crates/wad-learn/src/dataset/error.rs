//! What can be wrong with a dataset.

use std::path::PathBuf;

/// Why a dataset cannot be read, written or collected.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    #[error("could not {what} `{}`: {source}", path.display())]
    Io { what: &'static str, path: PathBuf, source: std::io::Error },
    #[error(
        "the disk is full: could not write `{}`: {source}; finished shards are kept, so free some room and \
         give the same command again to go on",
        path.display()
    )]
    DiskFull { path: PathBuf, source: std::io::Error },
    #[error(
        "`{}` is not a dataset: expected dataset.json in it; make one with `wad-cosim dataset collect --out {}`",
        path.display(), path.display()
    )]
    NotADataset { path: PathBuf },
    #[error(
        "`{}` was written in format {found}, this program reads format {expected}; collect it again, or use \
         the program that wrote it",
        path.display()
    )]
    Version { path: PathBuf, found: u64, expected: u64 },
    #[error(
        "`{}` is unfinished: {found} of {wanted} frames are there; run the same `dataset collect` command \
         again to finish it, or use these frames with --partial",
        path.display()
    )]
    HalfWritten { path: PathBuf, found: usize, wanted: usize },
    #[error("`{}` holds no frames{hint}", path.display())]
    Empty { path: PathBuf, hint: &'static str },
    #[error("`{}` is torn: {why}", path.display())]
    Torn { path: PathBuf, why: String },
    #[error(
        "`{}` holds another dataset: expected {what} {asked}, found {found}; name another folder with \
         --out, or remove it",
        path.display()
    )]
    Differs { path: PathBuf, what: &'static str, found: String, asked: String },
    #[error(
        "`{}` was collected with camera {found}, this program's camera is {expected}; collect it again",
        path.display()
    )]
    Camera { path: PathBuf, found: String, expected: String },
    #[error(
        "`{}` is test data (town `{town}`): it may only be measured on; train on a dataset of the training \
         town, `wad-cosim dataset collect --town town3`",
        path.display()
    )]
    TestData { path: PathBuf, town: String },
    #[error(
        "`{}` is not a recorded run: {why}; expected a folder that `wad-cosim run --out` wrote", path.display()
    )]
    NotARun { path: PathBuf, why: String },
    #[error(
        "the run in `{}` does not repeat: {off:.2} m off its record at tick {tick}; it was recorded with another \
         version of this program, of SUMO or of the config, so record it again",
        path.display()
    )]
    Drifted { path: PathBuf, tick: u64, off: f64 },
    #[error(
        "the recorded runs are of different towns, {first} and {other}; a dataset is of one, so collect one from each"
    )]
    Towns { first: String, other: String },
    #[error("image: {0}")]
    Image(String),
    #[error(transparent)]
    Bundled(#[from] wad_sim::bundled::ResolveError),
    #[error(transparent)]
    Bridge(#[from] wad_sim::bridge::BridgeError),
    #[error(transparent)]
    Drive(#[from] crate::drive::DriveError),
    #[error(transparent)]
    Destination(#[from] wad_sim::destination::DestinationError),
    #[error(transparent)]
    Assets(#[from] wad_sim::assets::AssetsError),
    #[error(transparent)]
    Eyes(#[from] wad_see::eyes::EyesError),
    #[error("could not {what}: {source}")]
    System { what: &'static str, source: std::io::Error },
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
    /// An I/O error at `path`; a full disk is told apart.
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
