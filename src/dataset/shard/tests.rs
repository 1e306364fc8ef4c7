use super::*;
use crate::camera::Preset;
use crate::dataset::Labels;
use crate::observation::RawState;
use crate::traffic::Counts;
use crate::vehicle::{Control, EgoState};

fn header() -> ShardHeader {
    ShardHeader {
        version: crate::dataset::FORMAT_VERSION,
        segment: Segment {
            index: 3,
            seed: 9,
            weather: Preset::SoftRainNoon,
            traffic: Counts::new(10, 20),
            frames: 2,
        },
        camera: "c".to_string(),
        camera_codec: Some(CameraCodec::Png),
    }
}

fn frame(n: u8) -> Frame {
    let mut transformed = TransformedImage::default();
    for (i, byte) in transformed.bytes_mut().iter_mut().enumerate() {
        *byte = (i % 251) as u8 ^ n;
    }
    let ego = EgoState {
        pose: crate::geometry::Pose::new(1.0, 2.0, 0.0, 0.5),
        roll: 0.0,
        pitch: 0.0,
        velocity: crate::geometry::Vector::new(3.0, 0.0),
        speed: 3.0,
        lateral_speed: 0.0,
        yaw_rate: 0.0,
        acceleration: 0.0,
        steer_angle: 0.0,
    };
    let record = FrameRecord {
        time: f64::from(n),
        weather: Preset::SoftRainNoon,
        ego,
        control: Control::default(),
        disturbed: n == 1,
        boxes: Vec::new(),
        light: None,
        raw: RawState::STANDING,
        labels: Labels { lead: Some(12.5), pedestrian: None, red: true },
        lanes: Default::default(),
    };
    Frame { record, transformed, camera: vec![n; 5] }
}

fn write(path: &Path) {
    let mut writer = ShardWriter::create(path, &header()).unwrap();
    writer.add(&frame(0)).unwrap();
    writer.add(&frame(1)).unwrap();
    assert_eq!(writer.finish().unwrap(), 2);
}

#[test]
fn what_is_written_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shard-00003.wads");
    write(&path);
    let mut reader = ShardReader::open(&path).unwrap();
    assert_eq!((reader.header(), reader.frames()), (&header(), 2));
    assert_eq!(reader.next_frame().unwrap(), Some(frame(0)));
    let mut bytes = vec![0; TransformedImage::BYTES];
    assert!(reader.next_image(&mut bytes).unwrap());
    assert_eq!(bytes, frame(1).transformed.bytes());
    assert_eq!(reader.next_frame().unwrap(), None);
}

#[test]
fn every_cut_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shard.wads");
    write(&path);
    let whole = std::fs::read(&path).unwrap();
    for length in [0, 5, 12, 40, whole.len() / 2, whole.len() - 1] {
        std::fs::write(&path, &whole[..length]).unwrap();
        let error = ShardReader::open(&path).err().unwrap();
        assert!(matches!(error, DatasetError::Torn { .. }), "{length}: {error}");
    }
}

#[test]
fn a_flipped_bit_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shard.wads");
    write(&path);
    let mut bytes = std::fs::read(&path).unwrap();
    let at = bytes.len() - 100;
    bytes[at] ^= 4;
    std::fs::write(&path, &bytes).unwrap();
    let mut reader = ShardReader::open(&path).unwrap();
    assert!(reader.next_frame().unwrap().is_some());
    let error = reader.next_frame().unwrap_err().to_string();
    assert!(error.contains("frame 1 is damaged"), "{error}");
}

#[test]
fn another_version_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shard.wads");
    let writer = ShardWriter::create(&path, &ShardHeader { version: 77, ..header() }).unwrap();
    writer.finish().unwrap();
    let error = ShardReader::open(&path).err().unwrap().to_string();
    assert!(error.contains("77"), "{error}");
}

#[test]
fn an_unfinished_shard_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = ShardWriter::create(&folder.path().join("shard.wads"), &header()).unwrap();
    writer.add(&frame(0)).unwrap();
    drop(writer);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
