//! What a training keeps, and goes on with.

use super::*;
use crate::train::agent::recording::{Header, Recording};
use crate::train::agent::schedule::Purpose;
use crate::train::agent::tests::config;
use std::path::Path;
use tch::Device;
use wad_see::latent::{Encoder, LatentError, PooledEncoder};
use wad_see::observation::{RAW_MEANING, RAW_SIZE};
use wad_see::perception::{ImageKind, TransformedImage};
use wad_sim::tasks::TaskKind;

fn small() -> TrainConfig {
    TrainConfig { buffer: 2000, ..config() }
}

fn limits(out: &Path) -> Limits {
    Limits { time: None, collectors: 1, device: Device::Cpu, out: out.to_path_buf(), record: None }
}

/// Records an episode of two transitions.
fn record(folder: &Path, seed: u64) {
    let mut recording = Recording::of(Some(ImageKind::Transformed));
    let image = TransformedImage::default();
    recording.observe(Some(&image), [0.0; RAW_SIZE]).unwrap();
    for _ in 0..2 {
        recording.act([0.0; 3], None, 1.0);
        recording.observe(Some(&image), [0.0; RAW_SIZE]).unwrap();
    }
    let header = Header {
        task: TaskKind::Straight,
        seed,
        driver: "autopilot".to_string(),
        camera_hash: small().env.camera.hash(),
        image: recording.image,
        raw_meaning: RAW_MEANING,
        detector: "truth".to_string(),
        success: true,
        end: "arrival".to_string(),
        transitions: recording.count(),
        terminated: false,
    };
    recording.write(folder, &header).unwrap();
}

/// Interrupts when it encodes.
struct Interrupting(Arc<AtomicBool>);

impl Encoder for Interrupting {
    fn hash(&self) -> &str {
        "interrupting"
    }

    fn encode(&mut self, image: &TransformedImage, latent: &mut Vec<f32>) -> Result<(), LatentError> {
        self.0.store(true, Ordering::Relaxed);
        PooledEncoder.encode(image, latent)
    }
}

#[test]
fn an_interrupt_while_recorded_episodes_load_leaves_no_part_of_them_to_go_on_with() {
    let dir = tempfile::tempdir().unwrap();
    let (folder, out) = (dir.path().join("recorded"), dir.path().join("out"));
    std::fs::create_dir(&folder).unwrap();
    (1..=2).for_each(|seed| record(&folder, seed));
    let config = TrainConfig { recorded: vec![folder], demonstrations: 3, ..small() };
    let limits = limits(&out);
    let run = |encoder: Box<dyn Encoder>, interrupt: &AtomicBool| {
        let mut learning = Learning::begin(&config, &limits, false).unwrap();
        learning.recall(interrupt, encoder, &mut |_: Progress<'_>| {}).unwrap();
        let shared = learning.shared();
        learning.finish(&shared, Ok(())).unwrap();
    };
    let interrupt = Arc::new(AtomicBool::new(false));
    run(Box::new(Interrupting(Arc::clone(&interrupt))), &interrupt);
    assert!(Learning::begin(&config, &limits, true).is_err(), "there is nothing to resume");

    // The same command begins again.
    run(Box::new(PooledEncoder), &AtomicBool::new(false));
    assert!(matches!(Learning::begin(&config, &limits, false), Err(TrainError::Taken { .. })));
    let mut resumed = Learning::begin(&config, &limits, true).unwrap();
    assert_eq!((resumed.recorded, resumed.buffer.len()), (4, 6));
    // Recorded steps are none of the demonstrations that are asked for.
    let job = lock(&resumed.shared().schedule).next(&config);
    assert!(matches!(job.purpose, Purpose::Demonstrate { .. }) && !resumed.ready());
}

#[test]
fn cloning_and_the_first_validation_go_on_after_a_resume() {
    let dir = tempfile::tempdir().unwrap();
    let (config, limits) = (TrainConfig { demonstrations: 1000, cloning: 80, ..small() }, limits(dir.path()));
    let mut learning = Learning::begin(&config, &limits, false).unwrap();
    (learning.demonstrated, learning.cloned) = (1000, 48);
    let shared = learning.shared();
    learning.finish(&shared, Ok(())).unwrap();
    let resumed = Learning::begin(&config, &limits, true).unwrap();
    assert_eq!((resumed.cloned, resumed.begins_trained), (48, true));
}

#[test]
fn the_logs_go_back_to_the_checkpoint() {
    let dir = tempfile::tempdir().unwrap();
    let (config, limits) = (small(), limits(dir.path()));
    let log = || std::fs::read_to_string(dir.path().join("train.jsonl")).unwrap();
    let mut learning = Learning::begin(&config, &limits, false).unwrap();
    let shared = learning.shared();
    learning.steps = 50_000;
    learning.log.figures(50_000, &[("charts/SPS", 1.0)]).unwrap();
    learning.save(&shared).unwrap();
    let kept = log();
    learning.log.figures(60_000, &[("charts/SPS", 2.0)]).unwrap();
    assert_ne!(log(), kept);
    let error = learning.diverged("a loss").to_string();
    assert!(error.contains("--init") && error.contains("last.safetensors"), "{error}");
    drop(learning);
    let mut resumed = Learning::begin(&config, &limits, true).unwrap();
    assert_eq!(log(), kept);
    resumed.log.figures(55_000, &[("charts/SPS", 3.0)]).unwrap();
    assert_eq!(log().lines().count(), 2);
}

#[test]
fn the_best_actors_card_is_of_the_actor_that_was_validated() {
    let dir = tempfile::tempdir().unwrap();
    let (config, limits) = (small(), limits(dir.path()));
    let mut learning = Learning::begin(&config, &limits, false).unwrap();
    let shared = learning.shared();
    (learning.steps, learning.demonstrated) = (500, 5);
    learning.start_validation(&shared);
    (learning.steps, learning.demonstrated) = (900, 9);
    learning.finish_validation(&shared, &mut |_: Progress<'_>| {}).unwrap();
    let best = Policy::load(&dir.path().join("best.safetensors")).unwrap();
    assert_eq!((best.card.steps, best.card.demonstrations), (500, 5));
}
