//! Small synthetic datasets for tests.

use super::folder::shard_path;
use super::{
    CameraCodec, CollectOptions, Frame, FrameRecord, Labels, Manifest, Segment, ShardHeader, ShardWriter,
    State,
};
use std::path::Path;
use sumo_network::geometry::{Pose, Vector};
use wad_camera::{CameraConfig, Preset};
use wad_see::observation::RawState;
use wad_see::perception::{TRANSFORMED_SIZE, TransformedImage};
use wad_sim::traffic::Counts;
use wad_vehicle::{Control, EgoState};

/// A grey road under a light sky, with a blue box (left, top, width, height) and perhaps a red mark.
#[derive(Clone, Copy, Debug)]
pub struct Picture {
    /// With a red mark.
    pub red: bool,
    /// Left, top, width, height (pixels).
    pub object: [usize; 4],
}

impl Picture {
    fn paint(self) -> TransformedImage {
        let mut image = TransformedImage::default();
        let [left, top, width, height] = self.object;
        for (i, pixel) in image.bytes_mut().chunks_exact_mut(3).enumerate() {
            let (x, y) = (i % TRANSFORMED_SIZE, i / TRANSFORMED_SIZE);
            let inside = (left..left + width).contains(&x) && (top..top + height).contains(&y);
            pixel.copy_from_slice(match (self.red && y < 10, inside, y < 64) {
                (true, _, _) => &[255, 0, 0],
                (_, true, _) => &[0, 0, 255],
                (_, _, true) => &[150, 180, 210],
                _ => &[90, 90, 92],
            });
        }
        image
    }
}

/// A frame that shows `picture`.
pub fn frame(picture: Picture, weather: Preset) -> Frame {
    let ego = EgoState {
        pose: Pose::new(1.0, 2.0, 0.0, 0.5),
        roll: 0.0,
        pitch: 0.0,
        velocity: Vector::new(3.0, 0.0),
        speed: 3.0,
        lateral_speed: 0.0,
        yaw_rate: 0.0,
        acceleration: 0.0,
        steer_angle: 0.0,
    };
    let record = FrameRecord {
        time: 1.0,
        weather,
        ego,
        control: Control::default(),
        disturbed: false,
        boxes: Vec::new(),
        light: None,
        raw: RawState::STANDING,
        labels: Labels { lead: Some(12.5), pedestrian: None, red: picture.red },
        lanes: Default::default(),
        road: None,
    };
    Frame { record, transformed: picture.paint(), camera: Vec::new() }
}

/// Writes a whole dataset with so many frames in each shard.
pub fn write(
    folder: &Path,
    town: &str,
    shards: &[usize],
    weather: Preset,
    picture: impl Fn(usize) -> Picture,
) {
    write_frames(folder, town, shards, weather, None, |number| frame(picture(number), weather));
}

/// The same from whole frames, whose camera pictures are encoded as `codec` says.
pub fn write_frames(
    folder: &Path,
    town: &str,
    shards: &[usize],
    weather: Preset,
    codec: Option<CameraCodec>,
    make: impl Fn(usize) -> Frame,
) {
    std::fs::create_dir_all(folder).unwrap();
    let total = shards.iter().sum();
    let mut options = CollectOptions::new(town, total, folder);
    options.camera = codec.is_some();
    let mut manifest = Manifest::new(&options, town);
    let mut number = 0;
    for (index, &frames) in shards.iter().enumerate() {
        let segment = Segment { index, seed: 1, weather, traffic: Counts::default(), frames };
        let camera = CameraConfig::default().hash();
        let header = ShardHeader { version: super::FORMAT_VERSION, segment, camera, camera_codec: codec };
        let mut shard = ShardWriter::create(&shard_path(folder, &segment), &header).unwrap();
        for _ in 0..frames {
            shard.add(&make(number)).unwrap();
            number += 1;
        }
        shard.finish().unwrap();
    }
    (manifest.state, manifest.frames) = (State::Complete, total);
    manifest.save(folder).unwrap();
}
