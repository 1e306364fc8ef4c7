//! The folder of an evaluation.
//!
//! | file | what |
//! |---|---|
//! | `config.json` | the [`Manifest`]: what the results were made by |
//! | `episodes.jsonl` | one line per episode, appended when it ends |
//! | `summary.json` | the table, in the plan's order: the same whoever drove which episode when |
//! | `episodes/NAME/` | what is needed to see an episode again, of failures |

use super::{Case, EpisodeRecord, Manifest};
use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use wad_sim::telemetry::write_json;

/// Why results cannot be kept or read.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    #[error("cannot {what} {}: {source}", path.display())]
    File { what: &'static str, path: PathBuf, source: std::io::Error },
    #[error("{} holds results already: --resume goes on with them, or name another folder with --out", path.display())]
    Taken { path: PathBuf },
    #[error("another evaluation is writing into {}", path.display())]
    Busy { path: PathBuf },
    #[error("{} is no folder of an evaluation: {why}", path.display())]
    Format { path: PathBuf, why: String },
    #[error(
        "the results in {} were made otherwise, and must not be mixed with new ones: {}; use another folder, or what \
         they were made with", path.display(), differences.join("; ")
    )]
    Mixed { path: PathBuf, differences: Vec<String> },
}

/// An evaluation's folder, open for more episodes.
#[derive(Debug)]
pub struct Store {
    path: PathBuf,
    episodes: File,
}

/// A folder's manifest and episodes, as read.
#[derive(Clone, Debug)]
pub struct Results {
    pub path: PathBuf,
    pub manifest: Manifest,
    /// In the order of their lines.
    pub episodes: Vec<EpisodeRecord>,
    /// Lines that are no episodes: half-written ones.
    pub broken: usize,
    /// Length of the file up to the end of its last whole line (bytes).
    whole: u64,
}

const CONFIG: &str = "config.json";
const EPISODES: &str = "episodes.jsonl";

impl Results {
    /// Reads a folder.
    ///
    /// # Errors
    /// It is no folder of an evaluation, or cannot be read.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let file = |what, path: PathBuf| move |source| StoreError::File { what, path, source };
        let config = path.join(CONFIG);
        let text = std::fs::read_to_string(&config).map_err(file("read", config.clone()))?;
        let manifest: Manifest = serde_json::from_str(&text)
            .map_err(|e| StoreError::Format { path: path.to_path_buf(), why: format!("{CONFIG}: {e}") })?;
        let lines = path.join(EPISODES);
        let bytes = match std::fs::read(&lines) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Vec::new(),
            Err(source) => return Err(StoreError::File { what: "read", path: lines, source }),
        };
        let (mut episodes, mut broken) = (Vec::new(), 0);
        let whole = bytes.iter().rposition(|&b| b == b'\n').map_or(0, |end| end as u64 + 1);
        for line in bytes.split_inclusive(|&b| b == b'\n') {
            // A line without its end may be cut within a number, and look whole.
            match serde_json::from_slice(line).ok().filter(|_| line.ends_with(b"\n")) {
                Some(episode) => episodes.push(episode),
                None => broken += 1,
            }
        }
        Ok(Self { path: path.to_path_buf(), manifest, episodes, broken, whole })
    }
}

/// Cases as text: they hold numbers that have no order and no hash of their own.
fn key(case: &Case) -> String {
    serde_json::to_string(case).unwrap_or_default()
}

fn by_case(episodes: &[EpisodeRecord]) -> HashMap<String, &EpisodeRecord> {
    episodes.iter().map(|episode| (key(&episode.case), episode)).collect()
}

/// The records of `plan` among `episodes`, in the plan's order; None where one is not there.
pub fn in_order<'a>(plan: &[Case], episodes: &'a [EpisodeRecord]) -> Vec<Option<&'a EpisodeRecord>> {
    let index = by_case(episodes);
    plan.iter().map(|case| index.get(&key(case)).copied()).collect()
}

impl Store {
    /// Opens the folder `path` for the results of `manifest`; with `resume` those that are there already
    /// stay, and are returned. A half-written line is taken out.
    ///
    /// # Errors
    /// The folder holds other results, or cannot be written.
    pub fn open(
        path: &Path,
        manifest: &Manifest,
        resume: bool,
    ) -> Result<(Self, Vec<EpisodeRecord>), StoreError> {
        let file = |what, path: &Path| {
            let path = path.to_path_buf();
            move |source| StoreError::File { what, path, source }
        };
        std::fs::create_dir_all(path).map_err(file("make", path))?;
        let lines = path.join(EPISODES);
        let open =
            || OpenOptions::new().append(true).create(true).open(&lines).map_err(file("write", &lines));
        let mut episodes = Vec::new();
        let log = if path.join(CONFIG).exists() {
            if !resume {
                return Err(StoreError::Taken { path: path.to_path_buf() });
            }
            let log = open()?;
            lock(&log, path)?;
            let results = Results::open(path)?;
            let differences = results.manifest.differences(manifest, true);
            if !differences.is_empty() {
                return Err(StoreError::Mixed { path: path.to_path_buf(), differences });
            }
            if results.broken > 0 {
                tracing::warn!(
                    "{}: {} half-written line(s); those episodes are driven again",
                    lines.display(),
                    results.broken
                );
                log.set_len(results.whole).map_err(file("write", &lines))?;
            }
            episodes = results.episodes;
            log
        } else {
            write_json(&path.join(CONFIG), manifest).map_err(|e| StoreError::File {
                what: "write",
                path: e.path,
                source: e.source,
            })?;
            let log = open()?;
            lock(&log, path)?;
            log
        };
        Ok((Self { path: path.to_path_buf(), episodes: log }, episodes))
    }

    /// Appends an episode.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn add(&mut self, record: &EpisodeRecord) -> Result<(), StoreError> {
        let failed = |source| StoreError::File { what: "write", path: self.path.join(EPISODES), source };
        let mut line = serde_json::to_vec(record).map_err(|e| failed(e.into()))?;
        line.push(b'\n');
        self.episodes.write_all(&line).map_err(failed)
    }

    /// Writes `summary.json`.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(&self, summary: &impl serde::Serialize) -> Result<(), StoreError> {
        write_json(&self.path.join("summary.json"), summary).map_err(|e| StoreError::File {
            what: "write",
            path: e.path,
            source: e.source,
        })
    }

    /// Where the recording of an episode goes.
    pub fn episode_folder(path: &Path, case: &Case) -> PathBuf {
        path.join("episodes").join(case.name())
    }
}

/// Two evaluations into one folder would drive every episode twice.
fn lock(log: &File, path: &Path) -> Result<(), StoreError> {
    match log.try_lock() {
        Ok(()) => Ok(()),
        Err(std::fs::TryLockError::WouldBlock) => Err(StoreError::Busy { path: path.to_path_buf() }),
        // A file system without locks.
        Err(std::fs::TryLockError::Error(error)) => {
            tracing::debug!("no lock on {}: {error}", path.display());
            Ok(())
        }
    }
}
