use super::*;
use crate::dataset::testing::{Picture, frame, write_frames};
use crate::dataset::{BoxRecord, CameraCodec};
use wad_camera::Preset;
use wad_camera::model::ObjectClass;
use wad_see::perception::centernet::graph::RANGES;
use wad_see::perception::{DrivableArea, RoadTruth};

/// Frames with one red car each, on grey: the camera's picture, its box, and what is road, but no signs.
fn data(folder: &Path, town: &str, codec: Option<CameraCodec>) {
    let weather = Preset::ClearNoon;
    write_frames(folder, town, &[6, 2], weather, codec, |n| {
        let mut one = frame(Picture { red: false, object: [1, 1, 9, 9] }, weather);
        let (l, t) = (60 + 50 * n, 180 + 12 * n);
        let mut rgb = vec![120; SIDE * SIDE * 3];
        for y in t..t + 48 {
            for x in l..l + 64 {
                rgb[3 * (y * SIDE + x)..][..3].copy_from_slice(&[210, 30, 30]);
            }
        }
        let visible = [l, t, l + 64, t + 48].map(|v| v as u32);
        one.record.boxes = vec![BoxRecord {
            class: ObjectClass::Car,
            id: 1,
            visible,
            full: visible.map(|v| v as f32),
            pixels: 64 * 48,
            depth: 9.0,
        }];
        let area = Some(DrivableArea::new(|row, column| column < 3 * row));
        one.record.road = Some(RoadTruth { area, ..RoadTruth::default() });
        one.camera = codec.map(|codec| codec.encode(&rgb, SIDE, SIDE).unwrap()).unwrap_or_default();
        one
    });
}

fn options(data: &Path, out: &Path, epochs: u64) -> TrainOptions {
    TrainOptions {
        epochs,
        batch: 4,
        epoch_steps: 2,
        window: Some((128, 96)),
        vary: false,
        ..TrainOptions::new(Backbone::Light, data, out)
    }
}

fn go(options: &TrainOptions, resume: bool) -> Result<Trained, TrainError> {
    train(options, Device::Cpu, resume, &AtomicBool::new(false), |_| {})
}

#[test]
fn a_broken_off_training_goes_on_and_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3", Some(CameraCodec::Png));
    let first = options(&path("data"), &path("out"), 1);
    let nothing = go(&first, true).unwrap_err();
    assert!(matches!(nothing, TrainError::NothingToResume { .. }), "{nothing}");
    let trained = go(&first, false).unwrap();
    assert_eq!((trained.epochs, trained.steps), (1, 1));
    assert_eq!((trained.frames, trained.validation_frames), (6, 2));
    assert!(matches!(go(&first, false).unwrap_err(), TrainError::Taken { .. }));
    let more = TrainOptions { epochs: 3, ..first };
    let trained = go(&more, true).unwrap();
    assert_eq!((trained.epochs, trained.steps), (3, 3));
    let lines = std::fs::read_to_string(path("out").join("metrics.jsonl")).unwrap();
    assert_eq!(lines.lines().count(), 3, "{lines}");
    let other = TrainOptions { backbone: Backbone::Resnet50V2, epochs: 4, ..more };
    let error = go(&other, true).unwrap_err().to_string();
    assert!(error.contains("resnet50_v2") && error.contains("light"), "{error}");
    // What was trained is a detector.
    let mut detector =
        CenterNetDetector::load(&trained.detector, Sees::Objects, LeastScore::Fixed(0.0)).unwrap();
    assert!(detector.detect_rgb(&vec![120; SIDE * SIDE * 3], SIDE, SIDE).is_ok());
    assert!(std::fs::metadata(&trained.detector).unwrap().len() < 6_000_000);
}

#[test]
fn a_training_does_not_go_on_with_other_options_and_its_own_stay() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for name in ["data", "rare"] {
        data(&path(name), "town3", Some(CameraCodec::Png));
    }
    let first = TrainOptions { more: vec![path("rare")], ..options(&path("data"), &path("out"), 1) };
    go(&first, false).unwrap();
    let more = TrainOptions { epochs: 2, ..first.clone() };
    for (other, what) in [
        (TrainOptions { more: Vec::new(), ..more.clone() }, "more"),
        (TrainOptions { learning_rate: 1e-4, ..more.clone() }, "learning_rate"),
        (TrainOptions { window: None, ..more.clone() }, "window"),
        (TrainOptions { seed: 1, ..more.clone() }, "seed"),
    ] {
        let error = go(&other, true).unwrap_err();
        assert!(error.is_input() && error.to_string().contains(&format!("`{what}` = ")), "{error}");
    }
    let saved = || run::saved::<TrainOptions>(&path("out")).unwrap();
    assert_eq!(saved(), first);
    go(&more, true).unwrap();
    assert_eq!(saved(), more, "the next resume goes on to as many epochs");
}

#[test]
fn a_head_that_learns_alone_goes_on_and_tells_of_the_data_before() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3", Some(CameraCodec::Png));
    let first = TrainOptions {
        sees: Sees::Road,
        init: Some("eyes".to_string()),
        only: Some(Part::Area),
        window: None,
        ..options(&path("data"), &path("out"), 1)
    };
    let made_of = || Weights::load(&run::checkpoint(&path("out"))).unwrap().metadata[MADE_OF].clone();
    go(&first, false).unwrap();
    let before = made_of();
    assert!(before.contains("; the head for area alone: 8 frames"), "{before}");
    let trained = go(&TrainOptions { epochs: 2, ..first.clone() }, true).unwrap();
    assert_eq!((trained.epochs, trained.steps), (2, 2));
    assert_eq!(made_of(), before);
    // No frame says which signs it shows.
    let signs = TrainOptions { only: Some(Part::Signs), out: path("signs"), ..first };
    let error = go(&signs, false).unwrap_err();
    assert!(error.is_input() && error.to_string().contains("--only signs"), "{error}");
}

#[test]
fn one_begins_with_the_weights_it_is_told_to() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3", Some(CameraCodec::Png));
    let first = go(&options(&path("data"), &path("first"), 2), false).unwrap();
    let name = format!("centernet:{}", first.detector.display());
    // Steps too small to be seen in half precision.
    let still = TrainOptions {
        init: Some(name.clone()),
        learning_rate: 1e-12,
        ..options(&path("data"), &path("second"), 1)
    };
    let second = go(&still, false).unwrap();
    let weights = |trained: &Trained| Weights::load(&trained.detector).unwrap();
    let (first, second) = (weights(&first), weights(&second));
    // Batch norm's statistics move with what they see, whatever the rate.
    let trained = |name: &str| name.ends_with("weight") || name.ends_with("bias");
    let mut compared = 0;
    for (name, tensor) in first.tensors.iter().filter(|(name, _)| trained(name)) {
        let shape: Vec<i64> = tensor.shape.iter().map(|&n| n as i64).collect();
        // As numbers: the smallest step turns 0 into -0.
        let [before, after] = [&first, &second].map(|weights| weights.get(name, &shape).unwrap());
        assert!(before.eq_tensor(&after).all().int64_value(&[]) == 1, "{name}");
        compared += 1;
    }
    assert!(compared > 20, "{compared}");
    let other = TrainOptions {
        backbone: Backbone::Resnet50V2,
        init: Some(name),
        ..options(&path("data"), &path("third"), 1)
    };
    let error = go(&other, false).unwrap_err().to_string();
    assert!(error.contains("resnet50_v2") && error.contains("light"), "{error}");
    let nobody = TrainOptions { init: Some("nobody".into()), ..options(&path("data"), &path("fourth"), 1) };
    let error = go(&nobody, false).unwrap_err();
    assert!(error.is_input() && error.to_string().contains("centernet:FILE"), "{error}");
}

#[test]
fn without_an_epoch_weights_get_their_ranges_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3", Some(CameraCodec::Png));
    let of = |init: &str, out: &str| TrainOptions {
        init: Some(init.to_string()),
        ..options(&path("data"), &path(out), 0)
    };
    let trained = go(&of("centernet", "out"), false).unwrap();
    assert_eq!((trained.epochs, trained.steps), (0, 0));
    let learned = |weights: Weights| {
        let (ranges, mut learned): (Vec<_>, Vec<_>) =
            weights.tensors.into_iter().partition(|(name, _)| name == RANGES);
        learned.sort_by(|a, b| a.0.cmp(&b.0));
        let made_of = weights.metadata.get("made_of").cloned();
        (ranges.len(), learned, made_of)
    };
    let (_, before, made_of) = learned(centernet_weights("centernet").unwrap().0);
    let ranges = usize::from(wad_see::inference::available().is_ok());
    assert!(learned(Weights::load(&trained.detector).unwrap()) == (ranges, before, made_of));
    let error = go(&of("eyes", "other"), false).unwrap_err();
    assert!(error.is_input() && error.to_string().contains("nothing is learned"), "{error}");
}

#[test]
fn bfloat16_learns_as_well() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3", Some(CameraCodec::Png));
    let options = TrainOptions {
        bfloat16: true,
        batch: 2,
        learning_rate: 1e-2,
        ..options(&path("data"), &path("out"), 20)
    };
    go(&options, false).unwrap();
    let lines = std::fs::read_to_string(path("out").join("metrics.jsonl")).unwrap();
    let records: Vec<EpochRecord> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(records.len(), 20);
    let (first, last) = (records[0].loss, records[19].loss);
    assert!(last < 0.7 * first, "the loss went from {first} to {last}");
}

#[test]
fn an_interrupt_and_a_loss_that_is_no_number_end_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3", Some(CameraCodec::Png));
    let stopped = options(&path("data"), &path("stopped"), 2);
    let trained = train(&stopped, Device::Cpu, false, &AtomicBool::new(true), |_| {}).unwrap();
    assert!(trained.interrupted && trained.epochs == 0);
    let wild = TrainOptions { learning_rate: 1e30, ..options(&path("data"), &path("wild"), 40) };
    let error = go(&wild, false).unwrap_err();
    assert!(matches!(error, TrainError::NotFinite { .. }), "{error}");
    assert!(error.to_string().contains("checkpoint.safetensors"), "{error}");
}

#[test]
fn frames_of_the_new_town_or_without_pictures_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("town5"), "town5", Some(CameraCodec::Png));
    let error = go(&options(&path("town5"), &path("out"), 1), false).unwrap_err().to_string();
    assert!(error.contains("town5"), "{error}");
    data(&path("blind"), "town3", None);
    let error = go(&options(&path("blind"), &path("out"), 1), false).unwrap_err().to_string();
    assert!(error.contains("--camera"), "{error}");
}

#[test]
fn where_one_head_learns_alone_all_else_stays_bit_for_bit() {
    use wad_camera::CameraConfig;
    use wad_camera::model::Sign;
    use wad_see::perception::centernet::road_targets::RoadTargets;
    use wad_see::perception::{GroundPlane, RoadWanted, SignTruth};
    wad_see::torch::one_thread();
    let bounds = [340.0, 220.0, 356.0, 236.0];
    let sign = SignTruth { sign: Sign::Limit(30), bounds, distance: 11.0, is_plain: true };
    let area = Some(DrivableArea::new(|row, column| column < 3 * row));
    let wanted = RoadWanted { signs: Some(vec![sign]), area, ..RoadWanted::default() };
    for (part, least) in [(Part::Signs, 10), (Part::Area, 5)] {
        let mut network = CenterNet::new(Backbone::Light, Sees::Road, Device::Cpu).unwrap();
        let before = network.weights(&[]).unwrap();
        network.learn_only(part);
        let mut adam = AdamW::new(&network.store, 1e-3).unwrap();
        let mut targets = RoadTargets::default();
        targets.add(Some(&wanted), &GroundPlane::new(&CameraConfig::default()));
        let picture = Tensor::rand([1, 3, 320, 512], (Kind::Float, Device::Cpu));
        let answer = network.forward(&picture, true).unwrap();
        let loss = part_loss(part, answer.road.as_ref().unwrap(), &targets, Device::Cpu).unwrap();
        assert!(adam.step(&loss, 0.1, LONGEST).unwrap());
        let after = network.weights(&[]).unwrap();
        let mut changed = 0;
        for ((name, was), (_, is)) in before.tensors.iter().zip(&after.tensors) {
            let is_changed = was.data != is.data;
            changed += usize::from(is_changed);
            assert!(!is_changed || part.has(name), "{name} changed");
        }
        assert!(changed > least, "{part:?}: {changed} parameters learned");
    }
}
