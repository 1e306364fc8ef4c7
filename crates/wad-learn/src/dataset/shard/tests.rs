use super::*;
use crate::dataset::testing::{self, Picture};
use wad_camera::Preset;
use wad_sim::traffic::Counts;

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
    let picture = Picture { red: n == 0, object: [20 + usize::from(n), 40, 9, 7] };
    Frame { camera: vec![n; 5], ..testing::frame(picture, Preset::SoftRainNoon) }
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
fn pictures_are_found_again_and_a_change_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shard.wads");
    write(&path);
    let mut reader = ShardReader::open(&path).unwrap();
    let places: Vec<_> = std::iter::from_fn(|| reader.next_place().unwrap()).collect();
    assert_eq!(places.len(), 2);
    for (n, (record, place)) in places.iter().enumerate() {
        assert_eq!((record, place.codec()), (&frame(n as u8).record, CameraCodec::Png));
        assert_eq!(place.read().unwrap(), vec![n as u8; 5]);
    }
    let mut bytes = std::fs::read(&path).unwrap();
    // The last frame's picture ends where the trailer begins.
    let last = bytes.len() - 9;
    bytes[last] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    assert_eq!(places[0].1.read().unwrap(), vec![0; 5]);
    assert!(matches!(places[1].1.read(), Err(DatasetError::Torn { .. })));
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
    let error = ShardReader::open(&path).unwrap().verify().unwrap_err().to_string();
    assert!(error.contains("frame 1 is damaged"), "{error}");
}

#[test]
fn a_trailer_that_claims_fewer_frames_is_damage() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shard.wads");
    write(&path);
    ShardReader::open(&path).unwrap().verify().unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let count = bytes.len() - 4;
    bytes[count..].copy_from_slice(&1_u32.to_le_bytes());
    std::fs::write(&path, bytes).unwrap();
    let error = ShardReader::open(&path).unwrap().verify().unwrap_err().to_string();
    assert!(error.contains("claim 1 frames, and it has more"), "{error}");
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

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_told_and_leaves_nothing_half_done() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shard.wads");
    // What is written beside its place first goes to a device that is always full.
    std::os::unix::fs::symlink("/dev/full", path.with_extension("part")).unwrap();
    let mut writer = ShardWriter::create(&path, &header()).unwrap();
    let mut filled = Ok(());
    for n in 0..200 {
        filled = filled.and_then(|()| writer.add(&frame(n)));
    }
    let error = filled.and_then(|()| writer.finish().map(|_| ())).unwrap_err();
    assert!(matches!(error, DatasetError::DiskFull { .. }), "{error}");
    assert!(error.to_string().contains("free some room"), "{error}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn an_unfinished_shard_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = ShardWriter::create(&folder.path().join("shard.wads"), &header()).unwrap();
    writer.add(&frame(0)).unwrap();
    drop(writer);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_trailer_that_claims_more_frames_than_there_is_room_for_is_damage() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shard.wads");
    write(&path);
    let mut bytes = std::fs::read(&path).unwrap();
    let count = bytes.len() - 4;
    bytes[count..].copy_from_slice(&0xffff_fff0_u32.to_le_bytes());
    std::fs::write(&path, bytes).unwrap();
    let error = ShardReader::open(&path).err().unwrap().to_string();
    assert!(error.contains("4294967280 frames"), "{error}");
}
