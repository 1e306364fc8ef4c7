//! Pictures of how failures ended.

use super::{Entry, Section};
use crate::agent::external::base64;
use crate::env::Assets;
use crate::eval::RecordingFolder;
use std::collections::BTreeMap;
use std::path::PathBuf;
use wad_camera::{Camera, CameraConfig, CameraError, Outputs, Picture, Town, Weather};
use wad_sim::replay::Recording;

/// The last picture of a failure.
pub struct Thumbnail {
    /// Agent, town, task, weather and episode.
    pub title: String,
    /// How and why it ended.
    pub cause: String,
    /// The episode's folder.
    pub folder: PathBuf,
    /// A `data:` address.
    pub image: String,
}

/// Size of a thumbnail (pixels).
const SIZE: (usize, usize) = (384, 216);
/// Ticks applied before the last, so that wheels and legs have their positions.
const BEFORE: usize = 8;

/// At most `most` of a section's kept failures, taken evenly from all of them: the `chase` camera's picture
/// of their last state.
///
/// # Errors
/// The camera cannot be made. A recording that cannot be read is left out, with a warning.
pub fn thumbnails(section: &Section, most: usize) -> Result<Vec<Thumbnail>, CameraError> {
    let kept: Vec<(&Entry, &RecordingFolder)> = section
        .episodes
        .iter()
        .filter(|e| !e.record.ending.success)
        .filter_map(|e| Some((e, e.record.recording.as_ref()?)))
        .collect();
    let step = kept.len().div_ceil(most.max(1)).max(1);
    let mut towns: BTreeMap<String, Option<Town>> = BTreeMap::new();
    let mut camera = Camera::new(CameraConfig::chase(SIZE.0, SIZE.1))?;
    let mut all = Vec::new();
    for (entry, recording) in kept.into_iter().step_by(step).take(most) {
        let folder = recording.within(&entry.run);
        let episode = &entry.record;
        let states = match Recording::open(&folder) {
            Ok(states) => states,
            Err(error) => {
                tracing::warn!("no picture: {error}");
                continue;
            }
        };
        let town = towns.entry(episode.case.town.clone()).or_insert_with_key(|town| {
            Assets::load(town)
                .map(|assets| assets.town())
                .map_err(|e| tracing::warn!("no pictures of {town}: {e}"))
                .ok()
        });
        let (Some(town), Some(last)) = (town, states.frames().last()) else { continue };
        let mut town = town.share();
        let frames = states.frames();
        for frame in &frames[frames.len().saturating_sub(BEFORE)..] {
            town.follow(&frame.world, Some(&states.ego_actor(frame)));
        }
        let weather = Weather::from(states.header().weather);
        let frame = camera.render(town.scene(), town.actors(), &last.ego.pose, &weather, Outputs::RGB);
        let Some(image) = data_address(&Picture::rgb(frame)) else { continue };
        let case = &episode.case;
        all.push(Thumbnail {
            title: format!(
                "{}, {}, {}, {}, episode {}",
                entry.driver,
                case.town,
                case.task,
                case.spec.weather.name(),
                case.episode
            ),
            cause: format!("{}: {}", episode.ending.end.name().replace('_', " "), episode.ending.cause),
            folder,
            image,
        });
    }
    Ok(all)
}

/// A JPEG file as a data address.
fn data_address(picture: &Picture) -> Option<String> {
    Some(format!("data:image/jpeg;base64,{}", base64(&picture.jpeg().ok()?)))
}
