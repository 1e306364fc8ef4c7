//! A trained actor as a file, and as an [`Agent`].
//!
//! The file is a `.safetensors` with the parameters in half precision and, in its header, a
//! [`PolicyCard`]: algorithm, training data and validation results. An actor belongs to
//! one encoder and one camera, whose hashes it carries.

use super::action::to_control;
use super::actor::PlainActor;
use super::params::{Algorithm, Dims, InputScale, Inputs, Misfit};
use super::{Agent, AgentError};
use half::f16;
use half::slice::HalfFloatSliceExt;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use wad_camera::CameraConfig;
use wad_see::latent::{self, Encoder, LatentError, PlainEncoder, PooledEncoder};
use wad_see::observation::{self, Observation, ObservationMode};
use wad_sim::{bundled, telemetry};
use wad_vehicle::Control;

/// The header of an actor's file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PolicyCard {
    /// Algorithm and its constants.
    pub algorithm: Algorithm,
    /// Sizes of the networks' inputs and outputs.
    pub dims: Dims,
    /// The part of the observation that the actor uses.
    pub inputs: Inputs,
    /// Hash of the encoder that the actor was trained with.
    pub encoder_hash: String,
    /// Hash of the camera's configuration ([`wad_camera::CameraConfig::hash`]).
    pub camera_hash: String,
    /// Version of the raw states' meaning: [`observation::RAW_MEANING`] at its training.
    #[serde(default = "observation::first_meaning")]
    pub raw_meaning: u32,
    /// The detector that it was trained with.
    pub detector: String,
    /// Environment steps of its training.
    pub steps: u64,
    /// Updates of the networks.
    pub updates: u64,
    /// The training's seed.
    pub seed: u64,
    /// Demonstrations in its replay buffer (environment steps).
    pub demonstrations: u64,
    /// Results on the validation seeds, and other notes of the trainer.
    pub scores: serde_json::Value,
    /// The whole training configuration.
    pub config: serde_json::Value,
}

/// A trained actor.
#[derive(Clone, Debug, PartialEq)]
pub struct Policy {
    /// The header.
    pub card: PolicyCard,
    /// Scale of the actor's inputs.
    pub scale: InputScale,
    /// The actor's parameters, rounded to half precision.
    pub values: Vec<f32>,
}

/// Why a policy cannot be read, written or used.
#[derive(Debug, thiserror::Error)]
pub enum PolicyError {
    /// A file cannot be read or written.
    #[error("cannot {what} `{}`: {source}", path.display())]
    File {
        /// The action that failed.
        what: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The file does not hold a trained agent.
    #[error("`{}` is not a trained agent: {why}; expected a file that `train agent` wrote", path.display())]
    Format {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        why: String,
    },
    /// The agent was trained with another encoder, camera or meaning of the raw states.
    #[error(
        "the agent `{}` was trained with the {what} {expected}, and this one is {found}; \
         use the agent's {what}, or train the agent again", path.display()
    )]
    Other {
        /// The file or folder.
        path: PathBuf,
        /// What differs.
        what: &'static str,
        /// The hash or meaning that the agent was trained with.
        expected: String,
        /// This program's.
        found: String,
    },
    /// No bundled agent has this name, and no file this path.
    #[error(
        "no agent is called `{0}`: expected autopilot, {names}, or a file that `train agent` wrote",
        names = bundled::agents().join(", ")
    )]
    Unknown(String),
    /// The agent's encoder cannot be opened.
    #[error("the agent's encoder: {0}")]
    Encoder(#[from] LatentError),
}

/// Key of the card in the file's header.
const CARD: &str = "wad_cosim_policy";
/// Key of the checksum of card and tensors in the file's header; files of older versions have none.
const CHECKSUM: &str = "wad_cosim_crc32";

fn checksum<const N: usize>(parts: [&[u8]; N]) -> String {
    let mut crc = crc32fast::Hasher::new();
    parts.into_iter().for_each(|part| crc.update(part));
    format!("{:08x}", crc.finalize())
}

impl Policy {
    /// Rounds `values` as the file will.
    pub fn new(card: PolicyCard, scale: InputScale, values: &[f32]) -> Self {
        let values = values.iter().map(|x| f16::from_f32(*x).to_f32()).collect();
        Self { card, scale, values }
    }

    /// Writes the file, whole or not at all.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), PolicyError> {
        let failed = |source| PolicyError::File { what: "write", path: path.to_path_buf(), source };
        let half: Vec<u8> =
            self.values.iter().flat_map(|x| f16::from_f32(*x).to_bits().to_le_bytes()).collect();
        let floats = |values: &[f32]| values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
        let (offset, factor) = (floats(&self.scale.offset), floats(&self.scale.factor));
        let invalid =
            |error: safetensors::SafeTensorError| failed(std::io::Error::other(format!("{error:?}")));
        let tensors = [
            ("actor", TensorView::new(Dtype::F16, vec![self.values.len()], &half).map_err(invalid)?),
            (
                "input.offset",
                TensorView::new(Dtype::F32, vec![self.scale.offset.len()], &offset).map_err(invalid)?,
            ),
            (
                "input.factor",
                TensorView::new(Dtype::F32, vec![self.scale.factor.len()], &factor).map_err(invalid)?,
            ),
        ];
        let card = serde_json::to_string(&self.card).map_err(|e| failed(e.into()))?;
        let sum = checksum([card.as_bytes(), &half, &offset, &factor]);
        let header = Some(HashMap::from([(CARD.to_string(), card), (CHECKSUM.to_string(), sum)]));
        let bytes = safetensors::serialize(tensors, &header).map_err(invalid)?;
        telemetry::write_whole(path, &bytes).map_err(|e| failed(e.source))
    }

    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read, is not a policy's file, or has parameters of another form.
    pub fn load(path: &Path) -> Result<Self, PolicyError> {
        let bytes = std::fs::read(path).map_err(|source| PolicyError::File {
            what: "read",
            path: path.to_path_buf(),
            source,
        })?;
        Self::parse(&bytes).map_err(|why| PolicyError::Format { path: path.to_path_buf(), why })
    }

    /// The policy called `name`: a file, or a bundled one, e.g. `wad-t`. Also returns the name of its
    /// place, for messages.
    ///
    /// # Errors
    /// There is no such policy, or the file is not one.
    pub fn find(name: &str) -> Result<(Self, PathBuf), PolicyError> {
        let path = Path::new(name);
        if path.is_file() {
            return Ok((Self::load(path)?, path.to_path_buf()));
        }
        let bytes = bundled::agent(name).ok_or_else(|| PolicyError::Unknown(name.to_string()))?;
        let policy =
            Self::parse(bytes).map_err(|why| PolicyError::Format { path: path.to_path_buf(), why })?;
        Ok((policy, path.to_path_buf()))
    }

    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let (_, header) =
            SafeTensors::read_metadata(bytes).map_err(|e| format!("not safetensors ({e:?})"))?;
        let card = header
            .metadata()
            .as_ref()
            .and_then(|metadata| metadata.get(CARD))
            .ok_or_else(|| format!("its header has no `{CARD}`"))?;
        let said = header.metadata().as_ref().and_then(|metadata| metadata.get(CHECKSUM));
        if said.is_none() {
            tracing::warn!("an agent's file holds no checksum: damage to it goes unnoticed");
        }
        let card_text = card.as_bytes();
        let card: PolicyCard = serde_json::from_str(card).map_err(|e| format!("its card: {e}"))?;
        let file = SafeTensors::deserialize(bytes).map_err(|e| format!("not safetensors ({e:?})"))?;
        let tensor = |name: &str, dtype: Dtype| {
            let tensor = file.tensor(name).map_err(|_| format!("it has no tensor `{name}`"))?;
            if tensor.dtype() != dtype {
                return Err(format!("tensor `{name}`: expected {dtype:?}, found {:?}", tensor.dtype()));
            }
            Ok(tensor.data().to_vec())
        };
        if let Some(said) = said {
            let data = |name: &str| file.tensor(name).map(|tensor| tensor.data()).unwrap_or_default();
            let parts = [card_text, data("actor"), data("input.offset"), data("input.factor")];
            if checksum(parts) != *said {
                return Err(
                    "its contents do not have the checksum that it says, so it is damaged".to_string()
                );
            }
        }
        let floats = |name: &str| {
            let data = tensor(name, Dtype::F32)?;
            Ok::<_, String>(
                data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
            )
        };
        let scale = InputScale { offset: floats("input.offset")?, factor: floats("input.factor")? };
        let half: Vec<f16> = tensor("actor", Dtype::F16)?
            .chunks_exact(2)
            .map(|b| f16::from_bits(u16::from_le_bytes([b[0], b[1]])))
            .collect();
        let mut values = vec![0.0; half.len()];
        half.convert_to_f32_slice(&mut values);
        let policy = Self { card, scale, values };
        policy.check_form()?;
        Ok(policy)
    }

    /// Refuses numbers that are not finite, or not as many as the card says.
    ///
    /// # Errors
    /// What was expected, and what was found.
    pub fn check_form(&self) -> Result<(), String> {
        let Self { card, scale, values } = self;
        let n = card.dims.observation() as usize;
        if card.dims.actions > 3 || scale.offset.len() != n || scale.factor.len() != n {
            return Err(format!(
                "expected observations of {n} numbers, found a scale of {} and {}",
                scale.offset.len(),
                scale.factor.len()
            ));
        }
        if values.iter().chain(&scale.offset).chain(&scale.factor).any(|x| !x.is_finite()) {
            return Err("its parameters are not finite numbers".to_string());
        }
        self.actor().map(drop).map_err(|e| e.to_string())
    }

    /// The actor.
    ///
    /// # Errors
    /// The parameters are not of the form that the card says.
    pub fn actor(&self) -> Result<PlainActor, Misfit> {
        PlainActor::new(&self.card.algorithm, self.card.dims, &self.scale, &self.values)
    }

    /// The name of the encoder that it was trained with: the bundled one with those weights, or the name in
    /// its training's configuration.
    pub fn encoder(&self) -> String {
        let called = || self.card.config.get("encoder")?.as_str().map(str::to_string);
        latent::bundled_with(&self.card.encoder_hash).or_else(called).unwrap_or_else(|| "default".into())
    }

    /// Refuses another encoder or camera than the agent was trained with, and raw states of another meaning.
    ///
    /// # Errors
    /// They differ.
    pub fn check(&self, path: &Path, encoder_hash: &str, camera_hash: &str) -> Result<(), PolicyError> {
        let card = &self.card;
        let meaning = |number: u32| number.to_string();
        let pairs = [
            ("encoder", &card.encoder_hash, encoder_hash),
            ("camera", &card.camera_hash, camera_hash),
            ("meaning of the raw states", &meaning(card.raw_meaning), &meaning(observation::RAW_MEANING)),
        ];
        for (what, expected, found) in pairs {
            if expected != found {
                return Err(PolicyError::Other {
                    path: path.to_path_buf(),
                    what,
                    expected: expected.clone(),
                    found: found.to_string(),
                });
            }
        }
        // Older agents take all numbers and multiply those that they leave out by 0.
        let possible = [Dims::DRIVING, card.inputs.dims()];
        if !possible.contains(&card.dims) {
            return Err(PolicyError::Format {
                path: path.to_path_buf(),
                why: format!("expected {:?}, found {:?}", possible[1], card.dims),
            });
        }
        Ok(())
    }
}

/// A trained agent that drives.
pub struct PolicyAgent {
    name: String,
    actor: PlainActor,
    inputs: Inputs,
}

impl PolicyAgent {
    /// The agent of `policy`, called `name` in tables.
    ///
    /// # Errors
    /// The parameters are not of the form that the card says.
    pub fn new(name: &str, policy: &Policy) -> Result<Self, Misfit> {
        Ok(Self { name: name.to_string(), actor: policy.actor()?, inputs: policy.card.inputs })
    }
}

impl Agent for PolicyAgent {
    fn name(&self) -> &str {
        &self.name
    }

    fn observes(&self) -> ObservationMode {
        self.inputs.observation()
    }

    fn act(&mut self, observation: &Observation) -> Result<Control, AgentError> {
        let failed = |why: String| AgentError::Failed { name: self.name.clone(), why };
        let dims = self.actor.dims();
        let (observation, expected) = (dims.of(observation), dims.observation() as usize);
        if observation.len() != expected {
            return Err(failed(format!(
                "expected an observation of {expected} numbers, found {}",
                observation.len()
            )));
        }
        let action = self.actor.act(&observation);
        if action.iter().any(|x| x.is_nan()) {
            return Err(failed(format!("its network answers {action:?}; the observation is not finite")));
        }
        Ok(to_control(action))
    }
}

/// The encoder called `name`: a file, a folder, a bundled encoder's name, or `pooled` (untrained).
///
/// # Errors
/// There is no such encoder, or it does not fit this program.
pub fn find_encoder(name: &str) -> Result<Box<dyn Encoder>, LatentError> {
    match name {
        "pooled" => Ok(Box::new(PooledEncoder)),
        name => Ok(Box::new(PlainEncoder::find(name)?)),
    }
}

/// The name of the encoder of agent `name`; None if it is not a trained agent of this program.
pub fn encoder_of(name: &str) -> Option<String> {
    Policy::find(name).ok().map(|(policy, _)| policy.encoder())
}

/// A trained agent and its encoder.
pub type Opened = (Box<dyn Agent>, Box<dyn Encoder>);

/// The trained agent called `name` ([`Policy::find`]) and its encoder:
/// `encoder`, or the one that it was trained with.
///
/// # Errors
/// The agent or encoder does not exist, or they do not fit together or this camera.
pub fn open(name: &str, encoder: Option<&str>, camera: &CameraConfig) -> Result<Opened, PolicyError> {
    let (policy, path) = Policy::find(name)?;
    let encoder = match encoder {
        Some(encoder) => find_encoder(encoder)?,
        // The encoder's file may have moved since: the hash decides.
        None => find_encoder(&policy.encoder()).or_else(|_| find_encoder("default"))?,
    };
    policy.check(&path, encoder.hash(), &camera.hash())?;
    let misfit = |e: Misfit| PolicyError::Format { path: path.clone(), why: e.to_string() };
    let agent = PolicyAgent::new(name, &policy).map_err(misfit)?;
    Ok((Box::new(agent), encoder))
}

#[cfg(all(test, feature = "learn"))]
mod tests {
    use super::super::learner::Learner;
    use super::super::td3::Td3Params;
    use super::*;

    #[test]
    fn shipped_agents_find_the_encoder_that_they_were_trained_with() {
        let camera = CameraConfig::default();
        for name in bundled::agents() {
            let name = name.as_str();
            let (policy, _) = Policy::find(name).unwrap();
            let (_, encoder) = open(name, None, &camera).unwrap();
            assert_eq!(encoder.hash(), policy.card.encoder_hash);
            assert_eq!(find_encoder(&encoder_of(name).unwrap()).unwrap().hash(), encoder.hash());
            let error = open(name, Some("pooled"), &camera).err().unwrap().to_string();
            assert!(error.contains(encoder.hash()) && error.contains("pooled"), "{error}");
        }
        assert_eq!((encoder_of("autopilot"), latent::bundled_with("nobody's")), (None, None));
    }

    fn policy() -> Policy {
        let algorithm = Algorithm::Td3(Td3Params::default());
        let learner = Learner::new(&algorithm, Dims::DRIVING, 5, tch::Device::Cpu);
        let card = PolicyCard {
            algorithm,
            dims: Dims::DRIVING,
            inputs: Inputs::Both,
            encoder_hash: "e1".into(),
            camera_hash: "c1".into(),
            raw_meaning: observation::RAW_MEANING,
            detector: "truth".into(),
            steps: 10,
            updates: 9,
            seed: 5,
            demonstrations: 0,
            scores: serde_json::json!({ "success_rate": 1.0 }),
            config: serde_json::json!({}),
        };
        Policy::new(card, InputScale::identity(Dims::DRIVING), &learner.actor_values())
    }

    #[test]
    fn comes_back_from_its_file_and_acts_the_same() {
        let (policy, folder) = (policy(), tempfile::tempdir().unwrap());
        let path = folder.path().join("agent.safetensors");
        policy.save(&path).unwrap();
        assert!(path.metadata().unwrap().len() < 160_000, "half precision");
        let back = Policy::load(&path).unwrap();
        assert_eq!(back, policy);
        let observation = Observation { latent: vec![0.3; 200], raw: [0.1; 15] };
        let mut agents = [&policy, &back].map(|p| PolicyAgent::new("wad-t", p).unwrap());
        let [one, two] = agents.each_mut().map(|agent| agent.act(&observation).unwrap());
        assert_eq!(one, two);
        assert!(one.throttle > 0.2 && one.brake == 0.0, "a new agent creeps forward: {one:?}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_keeps_the_earlier_file_and_no_half_one() {
        let (policy, folder) = (policy(), tempfile::tempdir().unwrap());
        let path = folder.path().join("best.safetensors");
        std::fs::write(&path, "before").unwrap();
        std::os::unix::fs::symlink("/dev/full", folder.path().join("best.safetensors.tmp")).unwrap();
        let error = policy.save(&path).unwrap_err().to_string();
        assert!(error.contains("best.safetensors") && error.contains("No space left"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), b"before");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn other_encoders_other_forms_and_cut_files_are_refused() {
        let (policy, folder) = (policy(), tempfile::tempdir().unwrap());
        let path = folder.path().join("agent.safetensors");
        policy.check(&path, "e1", "c1").unwrap();
        let error = policy.check(&path, "e2", "c1").unwrap_err().to_string();
        assert!(error.contains("encoder e1") && error.contains("e2"), "{error}");
        assert!(policy.check(&path, "e1", "c2").unwrap_err().to_string().contains("camera c1"));

        let mut other = policy.clone();
        other.card.raw_meaning = 1;
        let error = other.check(&path, "e1", "c1").unwrap_err().to_string();
        assert!(error.contains("meaning of the raw states 1"), "{error}");

        let mut other = policy.clone();
        other.values.pop();
        other.save(&path).unwrap();
        let error = Policy::load(&path).unwrap_err().to_string();
        assert!(error.contains("expected 68953 numbers, found 68952"), "{error}");

        policy.save(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for keep in [0, 5, 200, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..keep]).unwrap();
            let error = Policy::load(&path).unwrap_err().to_string();
            assert!(error.contains("is not a trained agent"), "{error}");
        }
        for at in [bytes.len() - 1, bytes.len() / 2] {
            let mut flipped = bytes.clone();
            flipped[at] ^= 1;
            std::fs::write(&path, &flipped).unwrap();
            let error = Policy::load(&path).unwrap_err().to_string();
            assert!(error.contains("it is damaged"), "{error}");
        }
        assert!(Policy::load(&folder.path().join("none")).is_err());
    }
}
