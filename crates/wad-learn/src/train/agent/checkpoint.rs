//! Checkpoints: the complete state of a training, for a resume without a difference.
//!
//! ```text
//! OUT/checkpoints/000025000/state.json           counters, random generator, schedule; written last
//!                           learner.safetensors  networks, targets, Adam's moments
//! OUT/checkpoints/replay/chunk-*.bin             shared by checkpoints
//! OUT/config.json                                comes with the first: a folder with it holds a training
//! ```
//!
//! The last two are kept. If the newest is damaged, the one before it is used.

use super::TrainError;
use super::config::TrainConfig;
use super::schedule::ScheduleState;
use crate::agent::batch::InputScale;
use crate::agent::learner::Learner;
use crate::agent::replay_buffer::ReplayBuffer;
use crate::agent::replay_files::{ReplayManifest, remove_unused};
use crate::train::run::CONFIG;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use tch::{Device, Tensor};
use wad_see::observation::{RAW_MEANING, first_meaning};
use wad_sim::telemetry::{write_json, write_whole};

/// A checkpoint's state beside its tensors.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct State {
    /// Environment steps of the agent.
    pub steps: u64,
    pub updates: u64,
    /// Version of the meaning of its raw states: [`RAW_MEANING`] at its writing.
    #[serde(default = "first_meaning")]
    pub raw_meaning: u32,
    /// Steps of each optimiser.
    pub adam_steps: Vec<i64>,
    pub rng: RngState,
    pub schedule: ScheduleState,
    /// None: not measured yet.
    pub scale: Option<InputScale>,
    pub best: Option<Best>,
    pub validated_at: u64,
    /// Steps of the recorded episodes; older versions count them among those that the autopilot drove.
    #[serde(default)]
    pub recorded: u64,
    /// Steps of behaviour cloning so far.
    #[serde(default)]
    pub cloned: u64,
    /// The actor that the training begins with is still to be validated.
    #[serde(default)]
    pub begins_trained: bool,
    /// Lengths of `train.jsonl` and `validation.jsonl` (bytes); None in checkpoints of older versions.
    #[serde(default)]
    pub logged: Option<[u64; 2]>,
    /// Seconds of training so far.
    pub wall_seconds: f64,
    pub replay: ReplayManifest,
    pub learner_bytes: u64,
    pub learner_crc: u32,
}

/// The best actor's validation so far.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Best {
    /// Environment steps at the validation.
    pub steps: u64,
    /// Success rate over all the curriculum's tasks; tasks of later stages count as failed.
    pub success_rate: f64,
    /// Mean return of the validation's episodes.
    pub mean_return: f64,
}

/// A ChaCha generator's whole state.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RngState {
    seed: [u8; 32],
    stream: u64,
    /// As text: JSON's numbers are too small for it.
    word: String,
}

impl RngState {
    /// The state of a generator.
    pub fn of(rng: &ChaCha8Rng) -> Self {
        Self { seed: rng.get_seed(), stream: rng.get_stream(), word: rng.get_word_pos().to_string() }
    }

    /// The generator; None where the state is damaged.
    pub fn generator(&self) -> Option<ChaCha8Rng> {
        let mut rng = ChaCha8Rng::from_seed(self.seed);
        rng.set_stream(self.stream);
        rng.set_word_pos(self.word.parse().ok()?);
        Some(rng)
    }
}

/// The folder of a run's checkpoints.
#[derive(Debug)]
pub struct Checkpoints {
    folder: PathBuf,
    /// The newest complete one, and the one before it.
    kept: Vec<(PathBuf, ReplayManifest)>,
}

/// Checkpoints kept.
const KEEP: usize = 2;

impl Checkpoints {
    /// The checkpoints of the training in `out`.
    pub fn new(out: &Path) -> Self {
        Self { folder: out.join("checkpoints"), kept: Vec::new() }
    }

    fn replay(&self) -> PathBuf {
        self.folder.join("replay")
    }

    /// Writes a checkpoint of the training with `config`, and completes `state`. The oldest checkpoint is removed afterwards.
    ///
    /// # Errors
    /// A file cannot be written; the checkpoints before stay.
    pub fn save(
        &mut self,
        mut state: State,
        learner: &mut Learner,
        buffer: &ReplayBuffer,
        config: &TrainConfig,
    ) -> Result<PathBuf, TrainError> {
        let path = self.folder.join(format!("{:09}", state.steps));
        let failed = |source| TrainError::Write { path: path.clone(), source };
        // A checkpoint of the same step is rewritten completely: without its state it does not count.
        std::fs::create_dir_all(&path).map_err(failed)?;
        let state_file = path.join("state.json");
        if state_file.exists() {
            std::fs::remove_file(&state_file).map_err(failed)?;
            self.kept.retain(|(kept, _)| *kept != path);
        }
        let (updates, adam_steps) = learner.counters();
        (state.updates, state.adam_steps) = (updates, adam_steps);
        state.raw_meaning = RAW_MEANING;
        let bytes = learner_bytes(learner).map_err(|why| failed(std::io::Error::other(why)))?;
        write_whole(&path.join("learner.safetensors"), &bytes)?;
        (state.learner_bytes, state.learner_crc) = (bytes.len() as u64, crc32fast::hash(&bytes));
        let before = self.kept.first().map_or_else(ReplayManifest::default, |(_, manifest)| manifest.clone());
        state.replay = buffer.save(&self.replay(), &before).map_err(failed)?;
        write_json(&self.folder.with_file_name(CONFIG), config)?;
        write_json(&state_file, &state)?;
        self.kept.insert(0, (path.clone(), state.replay));
        for (old, _) in self.kept.split_off(self.kept.len().min(KEEP)) {
            if let Err(error) = std::fs::remove_dir_all(&old) {
                tracing::warn!("an old checkpoint stays in `{}`: {error}", old.display());
            }
        }
        let used: Vec<&ReplayManifest> = self.kept.iter().map(|(_, manifest)| manifest).collect();
        remove_unused(&self.replay(), &used).map_err(failed)?;
        Ok(path)
    }

    /// Restores the newest complete checkpoint into `learner` and `buffer`; warns about damaged ones.
    ///
    /// # Errors
    /// None is complete, or the folder cannot be read.
    pub fn restore(
        &mut self,
        learner: &mut Learner,
        mut new_buffer: impl FnMut() -> Result<ReplayBuffer, TrainError>,
    ) -> Result<(State, ReplayBuffer), TrainError> {
        let mut damaged = Vec::new();
        let found = self.list()?;
        for (i, path) in found.iter().enumerate() {
            match self.load(path, learner, new_buffer()?) {
                Ok((state, buffer)) => {
                    self.kept = vec![(path.clone(), state.replay.clone())];
                    for other in &found[i + 1..] {
                        if let Ok(state) = read_state(other) {
                            self.kept.push((other.clone(), state.replay));
                        }
                    }
                    for (path, _) in &damaged {
                        // Else it would be taken for the newest again.
                        let _: std::io::Result<()> = std::fs::remove_dir_all(path);
                    }
                    return Ok((state, buffer));
                }
                Err(why) => {
                    tracing::warn!(
                        "the checkpoint `{}` is damaged ({why}); the one before it is used",
                        path.display()
                    );
                    damaged.push((path.clone(), why));
                }
            }
        }
        Err(TrainError::NoCheckpoint {
            folder: self.folder.clone(),
            why: match damaged.first() {
                None => "there is none".to_string(),
                Some((path, why)) => format!("none is complete; `{}`: {why}", path.display()),
            },
        })
    }

    /// All checkpoints, newest first.
    fn list(&self) -> Result<Vec<PathBuf>, TrainError> {
        let failed = |source| TrainError::Read { path: self.folder.clone(), source };
        let mut found = Vec::new();
        let entries = match std::fs::read_dir(&self.folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(found),
            Err(error) => return Err(failed(error)),
        };
        for entry in entries {
            let path = entry.map_err(failed)?.path();
            if path.file_name().is_some_and(|n| n.to_string_lossy().bytes().all(|b| b.is_ascii_digit())) {
                found.push(path);
            }
        }
        found.sort();
        found.reverse();
        Ok(found)
    }

    fn load(
        &self,
        path: &Path,
        learner: &mut Learner,
        mut buffer: ReplayBuffer,
    ) -> Result<(State, ReplayBuffer), String> {
        let state = read_state(path)?;
        if state.raw_meaning != RAW_MEANING {
            return Err(format!(
                "the raw states in its replay buffer are of meaning {}, expected {RAW_MEANING}; \
                 start a new training",
                state.raw_meaning
            ));
        }
        let bytes =
            std::fs::read(path.join("learner.safetensors")).map_err(|e| format!("its networks: {e}"))?;
        if bytes.len() as u64 != state.learner_bytes || crc32fast::hash(&bytes) != state.learner_crc {
            return Err(format!(
                "its networks: expected {} bytes with checksum {:08x}, found {} with {:08x}",
                state.learner_bytes,
                state.learner_crc,
                bytes.len(),
                crc32fast::hash(&bytes)
            ));
        }
        if state.rng.generator().is_none() {
            return Err("its random generator cannot be read".to_string());
        }
        buffer.restore(&self.replay(), &state.replay).map_err(|e| format!("its replay buffer: {e}"))?;
        let file = safetensors::SafeTensors::deserialize(&bytes).map_err(|e| format!("{e:?}"))?;
        let mut tensors = BTreeMap::new();
        for (name, view) in file.tensors() {
            tensors.insert(name, Tensor::try_from(view).map_err(|e| e.to_string())?);
        }
        learner.restore(&tensors, state.updates, &state.adam_steps).map_err(|e| e.to_string())?;
        Ok((state, buffer))
    }
}

fn read_state(path: &Path) -> Result<State, String> {
    let text = std::fs::read(path.join("state.json")).map_err(|e| format!("its state: {e}"))?;
    serde_json::from_slice(&text).map_err(|e| format!("its state: {e}"))
}

fn learner_bytes(learner: &mut Learner) -> Result<Vec<u8>, String> {
    use safetensors::tensor::{Dtype, TensorView};
    let mut data = Vec::new();
    for (name, tensor) in learner.tensors() {
        let tensor = tensor.to_device(Device::Cpu).contiguous();
        let n = tensor.numel();
        let mut bytes = vec![0; 4 * n];
        tensor.f_copy_data_u8(&mut bytes, n).map_err(|e| e.to_string())?;
        data.push((name, n, bytes));
    }
    let mut views = Vec::new();
    for (name, n, bytes) in &data {
        let view = TensorView::new(Dtype::F32, vec![*n], bytes).map_err(|e| format!("{e:?}"))?;
        views.push((*name, view));
    }
    safetensors::serialize(views, &None).map_err(|e| format!("{e:?}"))
}
