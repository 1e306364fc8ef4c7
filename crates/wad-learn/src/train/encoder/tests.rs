use super::*;
use crate::dataset::testing::{Picture, write};
use safetensors::Dtype;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use wad_camera::Preset;

/// A dataset of 24 + 8 frames with a blue box on a grey road, one shard of each.
fn data(folder: &Path, town: &str) {
    let picture = |n: usize| Picture { red: n.is_multiple_of(3), object: [30 + n % 40, 60, 20, 14] };
    write(folder, town, &[24, 8], Preset::ClearNoon, picture);
}

fn options(data: &Path, out: &Path, epochs: u64) -> TrainOptions {
    TrainOptions { batch: 8, epochs, decay: 0.0, ..TrainOptions::new(data, out) }
}

fn go(options: &TrainOptions, resume: bool) -> Result<Trained, TrainError> {
    train(options, Device::Cpu, resume, &AtomicBool::new(false), |_| {})
}

#[test]
fn a_broken_off_training_ends_with_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3");
    // With heads, which are part of a checkpoint too.
    let options =
        |out: &str, epochs| TrainOptions { label_weight: 0.1, ..options(&path("data"), &path(out), epochs) };
    go(&options("whole", 4), false).unwrap();
    go(&options("parts", 2), false).unwrap();
    let resumed = go(&options("parts", 4), true).unwrap();
    assert_eq!((resumed.epochs, resumed.steps), (4, 12));
    let tensors = |name: &str| {
        let weights = Weights::load(&path(name).join("checkpoint.safetensors")).unwrap();
        weights.hash()
    };
    assert_eq!(tensors("whole"), tensors("parts"));
    let lines = std::fs::read_to_string(path("parts").join("metrics.jsonl")).unwrap();
    assert_eq!(lines.lines().count(), 4);
}

#[test]
fn training_learns_and_its_encoder_is_read_back() {
    use wad_see::latent::{Decoder, Encoder, TchEncoder};
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3");
    let options = TrainOptions { learning_rate: 1e-3, ..options(&path("data"), &path("out"), 12) };
    let trained = go(&options, false).unwrap();
    let lines = std::fs::read_to_string(path("out").join("metrics.jsonl")).unwrap();
    let records: Vec<EpochRecord> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(trained.best.loss < 0.5 * records[0].validation.loss, "{lines}");
    let mut encoder = TchEncoder::find(&path("out").to_string_lossy()).unwrap();
    let dataset = Dataset::open(&path("data"), false).unwrap();
    let mut latents = Vec::new();
    let mut reader = dataset.reader(0).unwrap();
    while let Some(frame) = reader.next_frame().unwrap() {
        let mut latent = Vec::new();
        encoder.encode(&frame.transformed, &mut latent).unwrap();
        latents.push(latent);
        let made = encoder.reconstruct(&frame.transformed).unwrap();
        assert!(crate::encoder_score::score::psnr(&made, &frame.transformed) > 8.0);
    }
    // Standardised over the training images.
    let mean = latents.iter().flatten().map(|x| f64::from(*x)).sum::<f64>() / (24.0 * 200.0);
    let square = latents.iter().flatten().map(|x| f64::from(*x).powi(2)).sum::<f64>() / (24.0 * 200.0);
    assert!(mean.abs() < 0.2 && (0.3..2.0).contains(&square), "{mean} {square}");
    // The file's content is its name; a changed file is refused.
    let file = path("out").join("encoder.safetensors");
    let mut bytes = std::fs::read(&file).unwrap();
    let last = bytes.len() - 10;
    bytes[last] ^= 1;
    std::fs::write(&file, bytes).unwrap();
    let error = TchEncoder::load(&file, Device::Cpu).unwrap_err().to_string();
    assert!(error.contains("hash"), "{error}");
}

#[test]
fn a_dataset_of_one_shard_is_validated_on_itself() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let picture = |_: usize| Picture { red: false, object: [30, 60, 20, 14] };
    write(&path("data"), "town3", &[16], Preset::ClearNoon, picture);
    let trained = go(&options(&path("data"), &path("out"), 2), false).unwrap();
    assert_eq!((trained.images, trained.validation_images, trained.steps), (16, 16, 4));
    assert!(trained.best.loss > 0.0, "{:?}", trained.best);
}

#[test]
fn an_infinite_loss_stops_and_keeps_the_last_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3");
    go(&options(&path("data"), &path("out"), 1), false).unwrap();
    let checkpoint = path("out").join("checkpoint.safetensors");
    let before = std::fs::read(&checkpoint).unwrap();
    let wild = TrainOptions { learning_rate: 1e30, ..options(&path("data"), &path("out"), 9) };
    run::write_json(&path("out").join(run::CONFIG), &wild).unwrap();
    let error = go(&wild, true).unwrap_err();
    assert!(matches!(error, TrainError::NotFinite { .. }), "{error}");
    assert_eq!(std::fs::read(&checkpoint).unwrap(), before);
}

#[test]
fn weights_of_another_camera_or_network_are_named() {
    use wad_see::latent::TchEncoder;
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3");
    go(&options(&path("data"), &path("out"), 1), false).unwrap();
    let file = path("out").join("encoder.safetensors");
    let refused = |change: &dyn Fn(&mut Weights)| {
        let mut weights = Weights::load(&file).unwrap();
        change(&mut weights);
        let hash = weights.hash();
        weights.metadata.insert(keys::HASH.to_string(), hash);
        weights.save(&path("changed.safetensors")).unwrap();
        TchEncoder::find(&path("changed.safetensors").to_string_lossy()).unwrap_err().to_string()
    };
    let error = refused(&|weights| {
        weights.metadata.insert(keys::CAMERA.to_string(), "90 degrees, 64x64".to_string());
    });
    assert!(error.contains("90 degrees, 64x64") && error.contains("expected camera"), "{error}");
    let error = refused(&|weights| weights.tensors.retain(|(name, _)| name != "encoder.conv3.weight"));
    assert!(error.contains("encoder.conv3.weight") && error.contains("[128, 64, 3, 3]"), "{error}");
    let error = refused(&|weights| {
        for (name, tensor) in &mut weights.tensors {
            if name == "encoder.conv1.weight" {
                *tensor = Stored::of(&tensor.tensor().unwrap().narrow(0, 0, 16)).unwrap();
            }
        }
    });
    assert!(error.contains("[16, 3, 3, 3]") && error.contains("[32, 3, 3, 3]"), "{error}");
    std::fs::write(path("text.safetensors"), "no weights").unwrap();
    let error = TchEncoder::find(&path("text.safetensors").to_string_lossy()).unwrap_err().to_string();
    assert!(error.contains("not a weights file"), "{error}");
    let error = TchEncoder::find("nobody").unwrap_err().to_string();
    assert!(error.contains("`nobody`") && error.contains("train encoder"), "{error}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_keeps_the_last_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3");
    go(&options(&path("data"), &path("out"), 1), false).unwrap();
    let checkpoint = path("out").join("checkpoint.safetensors");
    let before = std::fs::read(&checkpoint).unwrap();
    std::os::unix::fs::symlink("/dev/full", checkpoint.with_extension("safetensors.tmp")).unwrap();
    let error = go(&options(&path("data"), &path("out"), 2), true).unwrap_err().to_string();
    assert!(error.contains("checkpoint.safetensors") && error.contains("No space left"), "{error}");
    assert_eq!(std::fs::read(&checkpoint).unwrap(), before);
}

#[test]
fn test_data_other_seeds_and_taken_folders_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("town5"), "town5");
    let error = go(&options(&path("town5"), &path("out"), 1), false).unwrap_err().to_string();
    assert!(error.contains("test data") && error.contains("town5"), "{error}");
    data(&path("data"), "town3");
    let error = go(&options(&path("data"), &path("out"), 1), true).unwrap_err();
    assert!(matches!(error, TrainError::NothingToResume { .. }), "{error}");
    go(&options(&path("data"), &path("out"), 1), false).unwrap();
    let error = go(&options(&path("data"), &path("out"), 1), false).unwrap_err();
    assert!(matches!(error, TrainError::Taken { .. }), "{error}");
    let other = TrainOptions { seed: 5, ..options(&path("data"), &path("out"), 2) };
    let error = go(&other, true).unwrap_err().to_string();
    assert!(error.contains("`seed` = 0") && error.contains("found 5"), "{error}");
}

#[test]
fn a_training_does_not_go_on_with_other_options_and_its_own_stay() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3");
    go(&options(&path("data"), &path("out"), 1), false).unwrap();
    let saved = || run::saved::<TrainOptions>(&path("out")).unwrap();
    let first = saved();
    let more = options(&path("data"), &path("out"), 2);
    for (other, what) in [
        (TrainOptions { data: path("other"), ..more.clone() }, "data"),
        (TrainOptions { learning_rate: 1e-3, ..more.clone() }, "learning_rate"),
        (TrainOptions { dropout: 0.0, ..more.clone() }, "dropout"),
        (TrainOptions { bfloat16: true, ..more.clone() }, "bfloat16"),
    ] {
        let error = go(&other, true).unwrap_err();
        assert!(error.is_input() && error.to_string().contains(&format!("`{what}` = ")), "{error}");
    }
    assert_eq!(saved(), first);
    go(&more, true).unwrap();
    assert_eq!(saved(), more, "the next resume goes on to as many epochs");
}

#[test]
fn a_time_limit_counts_the_time_before_a_resume() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3");
    let first = go(&options(&path("data"), &path("out"), 2), false).unwrap();
    let time_limit = Some(0.9 * first.wall_seconds);
    let more = TrainOptions { time_limit, ..options(&path("data"), &path("out"), 4) };
    assert_eq!(go(&more, true).unwrap().epochs, 2);
}

#[test]
fn bfloat16_learns_as_well_and_the_labels_are_learnt() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3");
    let options = TrainOptions {
        learning_rate: 1e-3,
        label_weight: 0.1,
        bfloat16: true,
        ..options(&path("data"), &path("out"), 12)
    };
    let trained = go(&options, false).unwrap();
    let lines = std::fs::read_to_string(path("out").join("metrics.jsonl")).unwrap();
    let records: Vec<EpochRecord> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let first = records[0].validation;
    assert!(trained.best.loss < 0.5 * first.loss, "{lines}");
    assert!(trained.best.labels < 0.5 * first.labels, "{lines}");
    // The file is in half precision whatever computed it, and the heads stay behind.
    let weights = Weights::load(&path("out").join("encoder.safetensors")).unwrap();
    let types: Vec<Dtype> = weights.tensors.iter().map(|(_, tensor)| tensor.dtype).collect();
    assert!(types.iter().all(|dtype| *dtype == Dtype::F16), "{types:?}");
    assert!(weights.tensors.iter().all(|(name, _)| !name.contains("labels")));
    wad_see::latent::TchEncoder::find(&path("out").to_string_lossy()).unwrap();
}

#[test]
fn a_variational_one_trains_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3");
    let options = TrainOptions { beta: 1.0, ..options(&path("data"), &path("out"), 2) };
    let trained = go(&options, false).unwrap();
    assert!(trained.best.divergence > 0.0);
    wad_see::latent::TchEncoder::find(&path("out").to_string_lossy()).unwrap();
}

#[test]
fn memory_below_one_shard_is_refused_with_what_it_needs() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    data(&path("data"), "town3");
    let with = |resident_gb, out: &str| {
        go(&TrainOptions { resident_gb, ..options(&path("data"), &path(out), 1) }, false)
    };
    let error = with(0.001, "small").unwrap_err();
    let text = error.to_string();
    assert!(error.is_input() && text.contains("expected 0.002 or more, for the largest shard"), "{text}");
    assert_eq!(with(0.002, "enough").unwrap().steps, 3);
}
