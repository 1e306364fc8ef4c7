//! Episodes on disk with their transformed images, so that a recorded episode serves every encoder.
//!
//! ```text
//! DIR/SEED.episode   one line of JSON (Header), then per observation: length and bytes of a PNG (0 and none
//!                    where no images were made), the raw vector; per transition: action, 1 or 0 and the
//!                    expert's action, reward
//! ```
//!
//! Numbers are little-endian `f32` and `u32`. About 22 kB per step with images.

use super::TrainError;
use crate::agent::action::{self, ACTION_SIZE, Action};
use crate::agent::networks::Dims;
use crate::agent::replay_buffer::{SEGMENT, Segment};
use crate::dataset::image_codec::{decode_png, encode_png};
use serde::{Deserialize, Serialize};
use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};
use wad_see::eyes::EyesError;
use wad_see::latent::Encoder;
use wad_see::observation::{self, Observation, RAW_SIZE, RawState};
use wad_see::perception::{ImageKind, TRANSFORMED_SIZE, TransformedImage};
use wad_sim::tasks::TaskKind;
use wad_sim::telemetry::write_whole;

/// A file's first line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    pub task: TaskKind,
    pub seed: u64,
    /// The driver: `autopilot`, or the trained agent's name.
    pub driver: String,
    pub camera_hash: String,
    /// What its images are; None: it has none.
    #[serde(default = "transformed")]
    pub image: Option<ImageKind>,
    /// Version of the raw vectors' meaning: [`observation::RAW_MEANING`] at its recording.
    #[serde(default = "observation::first_meaning")]
    pub raw_meaning: u32,
    pub detector: String,
    pub success: bool,
    pub end: String,
    pub transitions: usize,
    pub terminated: bool,
}

/// Files that do not say what their images are have transformed ones.
fn transformed() -> Option<ImageKind> {
    Some(ImageKind::Transformed)
}

/// A growing recording of an episode.
#[derive(Debug, Default)]
pub struct Recording {
    /// What the images are; None: there are none.
    pub image: Option<ImageKind>,
    observations: Vec<(Vec<u8>, [f32; RAW_SIZE])>,
    transitions: Vec<(Action, Option<Action>, f32)>,
}

impl Recording {
    /// An empty one, of images of this kind or without images.
    pub fn of(image: Option<ImageKind>) -> Self {
        Self { image, ..Self::default() }
    }

    /// Adds an observation, with its image if there is one.
    ///
    /// # Errors
    /// The image cannot be compressed.
    pub fn observe(&mut self, image: Option<&TransformedImage>, raw: [f32; RAW_SIZE]) -> Result<(), Error> {
        let side = TRANSFORMED_SIZE as u32;
        let png = image.map(|image| encode_png(image.bytes(), side, side).map_err(Error::other));
        self.observations.push((png.transpose()?.unwrap_or_default(), raw));
        Ok(())
    }

    /// Adds the action after the last observation, the expert's action, and the reward.
    pub fn act(&mut self, action: Action, shown: Option<Action>, reward: f32) {
        self.transitions.push((action, shown, reward));
    }

    /// Transitions so far.
    pub fn count(&self) -> usize {
        self.transitions.len()
    }

    /// Writes the episode into `folder`.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, folder: &Path, header: &Header) -> Result<(), TrainError> {
        let path = folder.join(format!("{:016x}.episode", header.seed));
        let mut data = serde_json::to_vec(header)
            .map_err(|e| TrainError::Write { path: path.clone(), source: e.into() })?;
        data.push(b'\n');
        for (png, raw) in &self.observations {
            data.extend((png.len() as u32).to_le_bytes());
            data.extend(png);
            data.extend(raw.iter().flat_map(|x| x.to_le_bytes()));
        }
        for (action, shown, reward) in &self.transitions {
            let known = f32::from(u8::from(shown.is_some()));
            let shown = shown.unwrap_or_default();
            let numbers = action.iter().chain([&known]).chain(&shown).chain([reward]);
            data.extend(numbers.flat_map(|x| x.to_le_bytes()));
        }
        Ok(write_whole(&path, &data)?)
    }
}

/// All recorded episodes in a folder, by name.
///
/// # Errors
/// The folder cannot be read, or holds none.
pub fn list(folder: &Path) -> Result<Vec<PathBuf>, TrainError> {
    let failed = |source| TrainError::Read { path: folder.to_path_buf(), source };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.extension().is_some_and(|extension| extension == "episode") {
            found.push(path);
        }
    }
    if found.is_empty() {
        return Err(failed(Error::new(
            ErrorKind::NotFound,
            "it holds no recorded episode (expected *.episode)",
        )));
    }
    found.sort();
    Ok(found)
}

/// An episode as networks of `dims` see it, with latents of `encoder`, in segments for the replay buffer.
///
/// # Errors
/// The file cannot be read, is damaged, is of another camera, or lacks the encoder's images; or the encoder fails.
pub fn load(
    path: &Path,
    camera_hash: &str,
    encoder: &mut dyn Encoder,
    dims: Dims,
) -> Result<(Header, Vec<Segment>), TrainError> {
    let failed = |source| TrainError::Read { path: path.to_path_buf(), source };
    let data = std::fs::read(path).map_err(failed)?;
    let (header, mut rest) = parse(&data).map_err(failed)?;
    if header.camera_hash != camera_hash {
        return Err(failed(invalid(format!(
            "it was recorded with the camera {}, and this one is {camera_hash}",
            header.camera_hash
        ))));
    }
    let wanted = encoder.image_kind();
    if dims.latent > 0 && header.image != Some(wanted) {
        let kind = |image: ImageKind| format!("its images are {}", image.name());
        let found = header.image.map_or("it holds no images".to_string(), kind);
        return Err(failed(invalid(format!(
            "{found}, and the encoder was trained on {} ones; record again with them, or train with --inputs raw",
            wanted.name()
        ))));
    }
    if header.raw_meaning != observation::RAW_MEANING {
        return Err(failed(invalid(format!(
            "its raw states are of meaning {}, expected {}; record again, or train without --recorded",
            header.raw_meaning,
            observation::RAW_MEANING
        ))));
    }
    let mut image = TransformedImage::default();
    let mut observations = Vec::with_capacity(header.transitions + 1);
    let mut observation = Observation { latent: Vec::new(), raw: [0.0; RAW_SIZE] };
    let mut speeds = Vec::with_capacity(header.transitions + 1);
    let side = TRANSFORMED_SIZE as u32;
    for _ in 0..=header.transitions {
        let length = take(&mut rest, 4).map_err(failed)?;
        let length = u32::from_le_bytes([length[0], length[1], length[2], length[3]]);
        let png = take(&mut rest, length as usize).map_err(failed)?;
        if dims.latent > 0 {
            decode_png(png, side, side, image.bytes_mut()).map_err(|e| failed(Error::other(e)))?;
            encoder
                .encode(&image, &mut observation.latent)
                .map_err(|e| TrainError::Env(EyesError::from(e).into()))?;
        }
        observation.raw.copy_from_slice(&floats(&mut rest, RAW_SIZE).map_err(failed)?);
        speeds.push(RawState::speed_of(&observation.raw));
        observations.push(dims.of(&observation));
    }
    let mut segments = Vec::new();
    let mut segment = Segment::default();
    for i in 0..header.transitions {
        let numbers = floats(&mut rest, 2 * ACTION_SIZE + 2).map_err(failed)?;
        let action_at = |at: usize| -> Action { std::array::from_fn(|i| numbers[at + i]) };
        segment.observations.push(observations[i].clone());
        segment.actions.push(action_at(0));
        let asked = numbers[ACTION_SIZE] > 0.5;
        segment.shown.push(asked.then(|| action::shown(action_at(ACTION_SIZE + 1), speeds[i])));
        segment.rewards.push(numbers[2 * ACTION_SIZE + 1]);
        let last = i + 1 == header.transitions;
        if last || segment.len() == SEGMENT {
            segment.observations.push(observations[i + 1].clone());
            segment.terminated = last && header.terminated;
            segment.truncated = last && !header.terminated;
            segments.push(std::mem::take(&mut segment));
        }
    }
    Ok((header, segments))
}

fn parse(data: &[u8]) -> Result<(Header, &[u8]), Error> {
    let end = data.iter().position(|b| *b == b'\n').ok_or_else(|| invalid("it has no header".to_string()))?;
    Ok((serde_json::from_slice(&data[..end])?, &data[end + 1..]))
}

fn take<'a>(rest: &mut &'a [u8], n: usize) -> Result<&'a [u8], Error> {
    let (taken, left) = rest
        .split_at_checked(n)
        .ok_or_else(|| invalid(format!("it is cut short: expected {n} more bytes, found {}", rest.len())))?;
    *rest = left;
    Ok(taken)
}

fn floats(rest: &mut &[u8], n: usize) -> Result<Vec<f32>, Error> {
    let bytes = take(rest, 4 * n)?;
    Ok(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}

fn invalid(why: String) -> Error {
    Error::new(ErrorKind::InvalidData, why)
}

#[cfg(test)]
mod tests {
    use super::*;
    use wad_see::latent::PooledEncoder;

    fn header(n: usize, terminated: bool) -> Header {
        Header {
            task: TaskKind::Cross,
            seed: 77,
            driver: "autopilot".to_string(),
            camera_hash: "camera".to_string(),
            image: Some(ImageKind::Transformed),
            raw_meaning: observation::RAW_MEANING,
            detector: "truth".to_string(),
            success: !terminated,
            end: "arrival".to_string(),
            transitions: n,
            terminated,
        }
    }

    fn recording(n: usize) -> Recording {
        let mut recording = Recording::default();
        let mut image = TransformedImage::default();
        for i in 0..=n {
            image.bytes_mut().fill((i % 250) as u8);
            recording.observe(Some(&image), [i as f32; RAW_SIZE]).unwrap();
            if i < n {
                let shown = (i % 3 == 0).then_some([-0.5, 0.25, i as f32]);
                recording.act([0.5, i as f32, 0.0], shown, i as f32);
            }
        }
        recording
    }

    #[test]
    fn an_episode_comes_back_as_any_encoder_sees_it() {
        let folder = tempfile::tempdir().unwrap();
        recording(150).write(folder.path(), &header(150, true)).unwrap();
        let files = list(folder.path()).unwrap();
        let (found, segments) = load(&files[0], "camera", &mut PooledEncoder, Dims::DRIVING).unwrap();
        assert_eq!(found, header(150, true));
        assert_eq!(segments.iter().map(Segment::len).collect::<Vec<_>>(), [64, 64, 22]);
        assert_eq!(segments.iter().map(|s| s.terminated).collect::<Vec<_>>(), [false, false, true]);
        let second = &segments[1];
        assert_eq!((second.actions[0], second.rewards[0]), ([0.5, 64.0, 0.0], 64.0));
        assert_eq!((second.shown[0], second.shown[2]), (None, Some([-0.5, 0.25, 66.0])));
        assert_eq!(segments[0].observations[64], second.observations[0], "segments join");
        let (mut image, mut latent) = (TransformedImage::default(), Vec::new());
        image.bytes_mut().fill(64);
        PooledEncoder.encode(&image, &mut latent).unwrap();
        assert_eq!(second.observations[0], [latent.as_slice(), &[64.0; RAW_SIZE]].concat());
    }

    #[test]
    fn images_of_another_kind_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let plain = Header { image: Some(ImageKind::Plain), ..header(5, false) };
        recording(5).write(folder.path(), &plain).unwrap();
        let file = list(folder.path()).unwrap().remove(0);
        let error = load(&file, "camera", &mut PooledEncoder, Dims::DRIVING).unwrap_err().to_string();
        assert!(error.contains("plain") && error.contains("transformed"), "{error}");
    }

    #[test]
    fn an_episode_without_images_serves_raw_inputs_alone() {
        let folder = tempfile::tempdir().unwrap();
        let mut blind = Recording::of(None);
        blind.observe(None, [1.0; RAW_SIZE]).unwrap();
        blind.act([0.5, 0.0, 0.0], None, 1.0);
        blind.observe(None, [2.0; RAW_SIZE]).unwrap();
        blind.write(folder.path(), &Header { image: blind.image, ..header(1, false) }).unwrap();
        let file = list(folder.path()).unwrap().remove(0);
        let error = load(&file, "camera", &mut PooledEncoder, Dims::DRIVING).unwrap_err().to_string();
        assert!(error.contains("holds no images") && error.contains("--inputs raw"), "{error}");
        let raw = Dims { latent: 0, ..Dims::DRIVING };
        let (_, segments) = load(&file, "camera", &mut PooledEncoder, raw).unwrap();
        assert_eq!(segments[0].observations, [[1.0; RAW_SIZE], [2.0; RAW_SIZE]]);
    }

    #[test]
    fn damage_and_another_camera_are_said() {
        let folder = tempfile::tempdir().unwrap();
        assert!(list(folder.path()).unwrap_err().to_string().contains("no recorded episode"));
        recording(5).write(folder.path(), &header(5, false)).unwrap();
        let file = list(folder.path()).unwrap().remove(0);
        let error = load(&file, "other", &mut PooledEncoder, Dims::DRIVING).unwrap_err().to_string();
        assert!(error.contains("this one is other"), "{error}");
        recording(5).write(folder.path(), &Header { raw_meaning: 2, ..header(5, false) }).unwrap();
        let error = load(&file, "camera", &mut PooledEncoder, Dims::DRIVING).unwrap_err().to_string();
        assert!(error.contains("of meaning 2, expected 3"), "{error}");
        recording(5).write(folder.path(), &header(5, false)).unwrap();
        let data = std::fs::read(&file).unwrap();
        std::fs::write(&file, &data[..data.len() - 7]).unwrap();
        let error = load(&file, "camera", &mut PooledEncoder, Dims::DRIVING).unwrap_err().to_string();
        assert!(error.contains("cut short"), "{error}");
    }
}
