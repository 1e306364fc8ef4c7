//! The folder of an evaluation.
//!
//! | file | what |
//! |---|---|
//! | `config.json` | the [`Manifest`]: builds, settings, nets and weights of the results |
//! | `episodes.jsonl` | one line per episode, appended when it ends |
//! | `summary.json` | the table in the plan's order, whatever the order of driving |
//! | `episodes/NAME/` | the recording of each failed episode, for `replay` |

use super::kept::{KeptError, Packed};
use super::plan::groups;
use super::record::RECORDINGS;
use super::{Case, EpisodeRecord, Manifest, RecordingFolder};
use crate::folder_lock::{FolderLock, LockError};
use serde::Deserialize;
use std::collections::{HashMap, HashSet};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use wad_sim::telemetry::write_json;

/// Why results cannot be stored or read.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// A file cannot be read or written.
    #[error("cannot {what} {}: {source}", path.display())]
    File {
        /// The action that failed.
        what: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The folder holds results already.
    #[error("{} holds results already: continue them with --resume, or name another folder with --out", path.display())]
    Taken {
        /// The file or folder.
        path: PathBuf,
    },
    /// The folder holds results without a manifest.
    #[error(
        "{} holds results ({found}), but no {CONFIG} that says what they were made by, so new ones cannot be told from \
         them: put that file back, or name another folder with --out", path.display()
    )]
    Unnamed {
        /// The file or folder.
        path: PathBuf,
        /// The file that was found.
        found: &'static str,
    },
    /// A line's recording lies outside the folder.
    #[error(
        "{}, line {line}: {why}; other paths are not followed. Get the file from the person who drove the episodes, or take the \
         line out", path.display()
    )]
    Outside {
        /// The file or folder.
        path: PathBuf,
        /// The line's number, from 1.
        line: usize,
        /// The cause.
        why: String,
    },
    /// A recording cannot be copied.
    #[error(
        "the recording {} cannot be copied: {why}; bring it back as `eval` kept it, or take `recording` out of its line \
         in {EPISODES}", path.display()
    )]
    Recording {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        why: String,
    },
    /// The folder cannot be locked.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// The folder is not an evaluation's.
    #[error("{} is not an evaluation's folder: {why}", path.display())]
    Format {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        why: String,
    },
    /// The folder's results were made with other settings.
    #[error(
        "the results in {} were made otherwise, and must not be mixed with new ones: {}; use another folder, or what \
         they were made with", path.display(), differences.join("; ")
    )]
    Mixed {
        /// The file or folder.
        path: PathBuf,
        /// What differs.
        differences: Vec<String>,
    },
}

/// An evaluation's folder, open for more episodes.
#[derive(Debug)]
pub struct Store {
    path: PathBuf,
    episodes: File,
    /// Length of the whole lines (bytes).
    whole: u64,
    _lock: FolderLock,
}

/// A folder's manifest and episodes, as read.
#[derive(Clone, Debug)]
pub struct Results {
    /// The folder.
    pub path: PathBuf,
    /// The contents of `config.json`.
    pub manifest: Manifest,
    /// The plan's episodes, in the order of their lines.
    pub episodes: Vec<EpisodeRecord>,
    /// Invalid lines, left out: their numbers, and the cause.
    pub broken: Vec<(usize, String)>,
    /// Lines of episodes outside the manifest's plan, left out: their numbers and names.
    pub foreign: Vec<(usize, String)>,
    /// Names of the plan's episodes that have no line.
    pub missing: Vec<String>,
    /// Length of the file up to the end of its last whole line (bytes).
    whole: u64,
}

const CONFIG: &str = "config.json";
const EPISODES: &str = "episodes.jsonl";
const SUMMARY: &str = "summary.json";

impl Results {
    /// Reads a folder.
    ///
    /// # Errors
    /// It is not an evaluation's folder, or cannot be read.
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
        let suite = &manifest.suite;
        let plan = (manifest.selection.cases(suite))
            .map_err(|e| StoreError::Format { path: path.to_path_buf(), why: format!("{CONFIG}: {e}") })?;
        let plan: Vec<Case> = plan.into_iter().map(|(case, _)| case).collect();
        let planned: HashSet<String> = plan.iter().map(Case::name).collect();
        let (mut episodes, mut broken, mut foreign) = (Vec::<EpisodeRecord>::new(), Vec::new(), Vec::new());
        let mut found = HashSet::new();
        let whole = bytes.iter().rposition(|&b| b == b'\n').map_or(0, |end| end as u64 + 1);
        for (text, line) in bytes.split_inclusive(|&b| b == b'\n').zip(1..) {
            // A line without its end may be cut within a number, and look complete.
            if !text.ends_with(b"\n") {
                broken.push((line, "half-written".to_string()));
                continue;
            }
            match serde_json::from_slice::<EpisodeRecord>(text) {
                Ok(episode) => {
                    let name = episode.case.name();
                    if episode.case.suite == suite.name && planned.contains(&name) {
                        found.insert(name);
                        episodes.push(episode);
                    } else {
                        foreign.push((line, name));
                    }
                }
                Err(error) => {
                    if let Some(why) = leads_out(text) {
                        return Err(StoreError::Outside { path: lines, line, why });
                    }
                    broken.push((line, format!("no episode: {error}")));
                }
            }
        }
        let here = groups(plan, manifest.egos, manifest.shard).into_iter().flatten();
        let missing = here.map(|case| case.name()).filter(|name| !found.contains(name)).collect();
        Ok(Self { path: path.to_path_buf(), manifest, episodes, broken, foreign, missing, whole })
    }

    /// One sentence for each line that is left out, and for missing episodes.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = self.unread();
        if let Some(first) = self.missing.first() {
            let (n, more) = (self.missing.len(), if self.missing.len() > 1 { " and others" } else { "" });
            let file = self.path.join(EPISODES);
            remarks.push(format!(
                "{}: {n} of the plan's episodes missing: {first}{more}; `eval --resume` drives them",
                file.display()
            ));
        }
        remarks
    }

    /// One sentence for each line that is left out.
    pub fn unread(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        let file = self.path.join(EPISODES).display().to_string();
        for (line, why) in &self.broken {
            remarks.push(format!(
                "{file}, line {line}: {why}; left out, `eval --resume` drives the episode again"
            ));
        }
        for (line, name) in &self.foreign {
            remarks.push(format!("{file}, line {line}: {name} is not in this evaluation's plan; left out"));
        }
        remarks
    }
}

/// The fault of a line's `recording`, if that makes the line invalid.
fn leads_out(line: &[u8]) -> Option<String> {
    #[derive(Deserialize)]
    struct Line {
        recording: String,
    }
    RecordingFolder::try_from(serde_json::from_slice::<Line>(line).ok()?.recording).err()
}

/// Cases as text, because floating-point numbers have no total order and no hash.
pub(super) fn key(case: &Case) -> String {
    serde_json::to_string(case).unwrap_or_default()
}

fn by_case(episodes: &[EpisodeRecord]) -> HashMap<String, &EpisodeRecord> {
    episodes.iter().map(|episode| (key(&episode.case), episode)).collect()
}

/// The records of `plan` among `episodes`, in the plan's order; None for a missing one.
pub fn in_order<'a>(plan: &[Case], episodes: &'a [EpisodeRecord]) -> Vec<Option<&'a EpisodeRecord>> {
    let index = by_case(episodes);
    plan.iter().map(|case| index.get(&key(case)).copied()).collect()
}

impl Store {
    /// Opens the folder `path` for the results of `manifest`; with `resume` earlier results
    /// stay, and are returned. A half-written line is removed.
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
        let goes_on = resume && path.join(CONFIG).exists();
        if !goes_on {
            free(path)?;
        }
        let lock = FolderLock::take(path)?;
        let lines = path.join(EPISODES);
        let open =
            || OpenOptions::new().append(true).create(true).open(&lines).map_err(file("write", &lines));
        let (mut episodes, mut whole) = (Vec::new(), 0);
        let log = if goes_on {
            let log = open()?;
            let results = Results::open(path)?;
            let differences = results.manifest.differences(manifest, true);
            if !differences.is_empty() {
                return Err(StoreError::Mixed { path: path.to_path_buf(), differences });
            }
            results.unread().iter().for_each(|remark| tracing::warn!("{remark}"));
            log.set_len(results.whole).map_err(file("write", &lines))?;
            (episodes, whole) = (results.episodes, results.whole);
            log
        } else {
            // Another process may have ended since.
            free(path)?;
            write_json(&path.join(CONFIG), manifest).map_err(|e| StoreError::File {
                what: "write",
                path: e.path,
                source: e.source,
            })?;
            open()?
        };
        Ok((Self { path: path.to_path_buf(), episodes: log, whole, _lock: lock }, episodes))
    }

    /// Appends an episode.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn add(&mut self, record: &EpisodeRecord) -> Result<(), StoreError> {
        let failed = |source| StoreError::File { what: "write", path: self.path.join(EPISODES), source };
        let mut line = serde_json::to_vec(record).map_err(|e| failed(e.into()))?;
        line.push(b'\n');
        if let Err(error) = self.episodes.write_all(&line) {
            // The next line must not go on where a full disk cut this one.
            let _ = self.episodes.set_len(self.whole);
            return Err(failed(error));
        }
        self.whole += line.len() as u64;
        Ok(())
    }

    /// Writes the recording of an episode, before its line is appended.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn keep(&self, recording: &RecordingFolder, files: &Packed) -> Result<(), KeptError> {
        files.write(&recording.within(&self.path))
    }

    /// Writes `summary.json`.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(&self, summary: &impl serde::Serialize) -> Result<(), StoreError> {
        write_json(&self.path.join(SUMMARY), summary).map_err(|e| StoreError::File {
            what: "write",
            path: e.path,
            source: e.source,
        })
    }

    /// Makes the folder `path` from `episodes`, each with the folder of its run; their recordings
    /// are copied. Either everything is written or nothing: unusable input is refused before the first
    /// write, and files are renamed to their places when all are written.
    ///
    /// # Errors
    /// The folder holds results, a recording is gone or is more than plain files, or a file cannot be
    /// written.
    pub fn merge(
        path: &Path,
        manifest: &Manifest,
        episodes: &[(&Path, &EpisodeRecord)],
        summary: &impl serde::Serialize,
    ) -> Result<(), StoreError> {
        free(path)?;
        let mut copies = Vec::new();
        for (run, recording) in episodes.iter().filter_map(|(run, e)| Some((run, e.recording.as_ref()?))) {
            copies.push((recording, plain_files(run, recording)?));
        }
        let failed = |what, path: &Path| {
            let path = path.to_path_buf();
            move |source| StoreError::File { what, path, source }
        };
        std::fs::create_dir_all(path).map_err(failed("make", path))?;
        let draft =
            tempfile::Builder::new().prefix(".merge-").tempdir_in(path).map_err(failed("write", path))?;
        let (mut store, _) = Self::open(draft.path(), manifest, false)?;
        for (recording, files) in copies {
            let folder = recording.within(draft.path());
            std::fs::create_dir_all(&folder).map_err(failed("make", &folder))?;
            for file in files {
                let to = folder.join(file.file_name().unwrap_or_default());
                std::fs::copy(&file, to).map_err(failed("copy", &file))?;
            }
        }
        for (_, episode) in episodes {
            store.add(episode)?;
        }
        store.finish(summary)?;
        // The manifest last: without it the folder is not an evaluation's.
        for name in [RECORDINGS, EPISODES, SUMMARY, CONFIG] {
            let (from, to) = (draft.path().join(name), path.join(name));
            if from.exists() {
                std::fs::rename(&from, &to).map_err(failed("write", &to))?;
            }
        }
        Ok(())
    }
}

/// Refuses a folder that holds results.
fn free(path: &Path) -> Result<(), StoreError> {
    if path.join(CONFIG).exists() {
        return Err(StoreError::Taken { path: path.to_path_buf() });
    }
    let lines = std::fs::metadata(path.join(EPISODES)).is_ok_and(|file| file.len() > 0);
    let kept = std::fs::read_dir(path.join(RECORDINGS)).is_ok_and(|mut entries| entries.next().is_some());
    match (lines, kept) {
        (false, false) => Ok(()),
        (lines, _) => {
            let found = if lines { EPISODES } else { RECORDINGS };
            Err(StoreError::Unnamed { path: path.to_path_buf(), found })
        }
    }
}

/// The files of a recording's folder below `run`; links that lead elsewhere, and folders in it, are refused.
fn plain_files(run: &Path, recording: &RecordingFolder) -> Result<Vec<PathBuf>, StoreError> {
    let folder = &recording.within(run);
    let refused = |why: String| StoreError::Recording { path: folder.clone(), why };
    let real = |path: &Path| path.canonicalize().map_err(|e| refused(e.to_string()));
    if !real(folder)?.starts_with(real(run)?) {
        return Err(refused(format!("it is a link that leads out of {}", run.display())));
    }
    let entries = std::fs::read_dir(folder).map_err(|e| refused(e.to_string()))?;
    let mut files = Vec::new();
    for entry in entries {
        let entry = entry.map_err(|e| refused(e.to_string()))?;
        if !entry.file_type().is_ok_and(|kind| kind.is_file()) {
            return Err(refused(format!("expected files, found {}", entry.file_name().display())));
        }
        files.push(entry.path());
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::EnvOptions;
    use crate::eval::{DriverSpec, Selection, Suite};
    use std::collections::BTreeMap;
    use wad_camera::Preset;

    fn manifest() -> Manifest {
        Manifest {
            build: "1".into(),
            sumo: "1.28.0".into(),
            suite: Suite::find("composite").unwrap(),
            selection: Selection {
                agents: vec![DriverSpec::Random],
                conditions: vec!["development".into()],
                episodes: Some(3),
                ..Selection::default()
            },
            options: EnvOptions::evaluation(),
            egos: 1,
            agents: Default::default(),
            nets: Default::default(),
            towns: BTreeMap::new(),
            detector: None,
            shard: None,
        }
    }

    fn cases(manifest: &Manifest) -> Vec<Case> {
        manifest.selection.cases(&manifest.suite).unwrap().into_iter().map(|(case, _)| case).collect()
    }

    #[test]
    fn results_without_a_manifest_are_not_adopted() {
        let folder = tempfile::tempdir().unwrap();
        let (path, manifest) = (folder.path(), manifest());
        let (mut store, _) = Store::open(path, &manifest, false).unwrap();
        store.add(&EpisodeRecord::of_a_tick(cases(&manifest)[0].clone())).unwrap();
        drop(store);
        std::fs::remove_file(path.join(CONFIG)).unwrap();
        for resume in [false, true] {
            let error = Store::open(path, &manifest, resume).unwrap_err().to_string();
            assert!(error.contains(EPISODES) && error.contains(CONFIG) && error.contains("--out"), "{error}");
        }
        assert!(!path.join(CONFIG).exists(), "nothing is written");
        std::fs::remove_file(path.join(EPISODES)).unwrap();
        std::fs::create_dir_all(path.join("episodes/kept")).unwrap();
        assert!(matches!(Store::open(path, &manifest, false), Err(StoreError::Unnamed { .. })));
    }

    #[test]
    fn lines_that_are_broken_or_foreign_and_what_is_missing_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let (path, manifest) = (folder.path(), manifest());
        let all = cases(&manifest);
        let (mut store, _) = Store::open(path, &manifest, false).unwrap();
        store.add(&EpisodeRecord::of_a_tick(all[0].clone())).unwrap();
        store.add(&EpisodeRecord::of_a_tick(Case { seed: 7, ..all[1].clone() })).unwrap();
        drop(store);
        let lines = path.join(EPISODES);
        let mut text = std::fs::read_to_string(&lines).unwrap();
        text += "no episode\n{\"suite\": ";
        std::fs::write(&lines, text).unwrap();
        let results = Results::open(path).unwrap();
        assert_eq!(results.episodes.len(), 1);
        assert_eq!(results.foreign.iter().map(|(line, _)| *line).collect::<Vec<_>>(), [2]);
        assert_eq!(results.broken.iter().map(|(line, _)| *line).collect::<Vec<_>>(), [3, 4]);
        assert_eq!(results.missing, [all[1].name(), all[2].name()]);
        let text = results.remarks().join("\n");
        for part in [
            "line 2",
            "s7_001",
            "line 3: no episode",
            "line 4: half-written",
            "2 of the plan's",
            &all[1].name(),
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        // The half-written line goes, the others stay, and the episodes are driven again.
        let (_, left) = Store::open(path, &manifest, true).unwrap();
        assert_eq!(left.len(), 1);
        assert!(std::fs::read_to_string(&lines).unwrap().ends_with("no episode\n"));
    }

    /// Five groups of two: the second of three shards drives the second and the fifth.
    #[test]
    fn a_shard_of_groups_misses_no_episode_of_another_shard() {
        let folder = tempfile::tempdir().unwrap();
        let mut manifest = Manifest { egos: 2, shard: Some("2/3".parse().unwrap()), ..manifest() };
        manifest.selection.weathers = vec![Preset::WetNoon];
        manifest.selection.episodes = Some(10);
        let all = cases(&manifest);
        assert_eq!(all.len(), 10);
        Store::open(folder.path(), &manifest, false).unwrap();
        let missing = Results::open(folder.path()).unwrap().missing;
        assert_eq!(missing, [2, 3, 8, 9].map(|episode: usize| all[episode].name()));
    }

    #[test]
    fn a_recording_outside_its_folder_is_refused_by_every_reader() {
        let folder = tempfile::tempdir().unwrap();
        let (path, manifest) = (folder.path(), manifest());
        let (store, _) = Store::open(path, &manifest, false).unwrap();
        drop(store);
        for out in ["/etc", "../../b"] {
            let mut line =
                serde_json::to_value(EpisodeRecord::of_a_tick(cases(&manifest)[0].clone())).unwrap();
            line["recording"] = out.into();
            std::fs::write(path.join(EPISODES), format!("{line}\n")).unwrap();
            let error = Results::open(path).unwrap_err().to_string();
            for part in ["line 1", "episodes/NAME", out, EPISODES] {
                assert!(error.contains(part), "{error}");
            }
            assert!(Store::open(path, &manifest, true).is_err());
        }
    }

    #[test]
    fn a_merge_is_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let (run, out, manifest) = (folder.path().join("run"), folder.path().join("out"), manifest());
        let case = cases(&manifest)[0].clone();
        let recording = RecordingFolder::of(&case);
        let episode = EpisodeRecord { recording: Some(recording.clone()), ..EpisodeRecord::of_a_tick(case) };
        let merge = || Store::merge(&out, &manifest, &[(&run, &episode)], &"summary");
        assert!(merge().unwrap_err().to_string().contains("cannot be copied"), "the recording is gone");
        assert!(!out.exists(), "nothing is written");
        let kept = recording.within(&run);
        std::fs::create_dir_all(&kept).unwrap();
        std::fs::write(kept.join("episode.json"), "{}").unwrap();
        std::os::unix::fs::symlink("/", kept.join("link")).unwrap();
        assert!(merge().unwrap_err().to_string().contains("expected files, found link"));
        assert!(!out.exists(), "nothing is written");
        std::fs::remove_file(kept.join("link")).unwrap();
        // Nor is the folder itself a link to somebody's files.
        let elsewhere = folder.path().join("elsewhere");
        std::fs::rename(&kept, &elsewhere).unwrap();
        std::os::unix::fs::symlink(&elsewhere, &kept).unwrap();
        assert!(merge().unwrap_err().to_string().contains("a link that leads out of"));
        assert!(!out.exists(), "nothing is written");
        std::fs::remove_file(&kept).unwrap();
        std::fs::rename(&elsewhere, &kept).unwrap();
        merge().unwrap();
        let merged = Results::open(&out).unwrap();
        assert_eq!(merged.episodes, std::slice::from_ref(&episode));
        assert!(recording.within(&out).join("episode.json").exists());
        assert_eq!(std::fs::read_dir(&out).unwrap().count(), 4, "no draft is left");
        assert!(matches!(merge(), Err(StoreError::Taken { .. })));
    }
}
