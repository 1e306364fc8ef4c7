//! `wad-cosim eval detector`: recall, false alarms and average precision on frames of a town. `eval eyes` also scores
//! what is seen of lane and light.

mod text;

use crate::cli::progress::Bar;
use crate::cli::{Exit, answer, run};
use anyhow::Context;
use clap::ValueHint;
use serde::Serialize;
use std::cell::LazyCell;
use std::path::PathBuf;
use std::time::Instant;
use wad_cosim::bundled;
use wad_cosim::camera::{Camera, CameraConfig, Frame, Outputs, Picture, Preset, Weather};
use wad_cosim::dataset::TRAINING_WEATHERS;
use wad_cosim::drive::DriveOptions;
use wad_cosim::perception::score::{
    self, BELIEVED, BySureness, Precision, Realism, View, precision, realism, sureness,
};
use wad_cosim::perception::sight_score::{RoadReport, RoadScore};
use wad_cosim::perception::{
    DEFAULT_DETECTOR, DETECTORS, Detection, Detector, GroundPlane, Heads, LaneDetector, LeastScore,
    LightAhead, RoadTruth, RoadWanted, Seen, detector,
};
use wad_cosim::stats::median;
use wad_cosim::tour::Tour;
use wad_cosim::traffic::TrafficSpec;

const EXAMPLES: &str = "\
Examples:
  wad-cosim eval detector --detector onnx:$(scripts/fetch-detector)
  wad-cosim eval detector --detector centernet --frames 1400
  wad-cosim eval detector --detector eyes --detector centernet    the same frames, side by side
  wad-cosim eval detector --detector truth:faulty
  wad-cosim eval detector --detector onnx --frames 500 --weather ClearNoon --json
  wad-cosim eval detector --detector onnx --frames 28 --pictures boxes/";

/// Examples of `eval eyes`.
pub const EYES_EXAMPLES: &str = "\
Examples:
  wad-cosim eval eyes --frames 3000                                               the bundled one
  wad-cosim eval eyes --detector eyes:runs/eyes/detector.safetensors --frames 3000
  wad-cosim eval eyes --detector eyes --detector centernet --detector onnx        the same frames, side by
                                                                                  side; lanes by Canny and
                                                                                  Hough but for eyes
  wad-cosim eval eyes --weather HardRainNoon --json";

/// What is scored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scored {
    /// Objects.
    Objects,
    /// Objects, and the ego's lane and light.
    Road,
}

/// Score a detector: recall, false alarms, average precision.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[arg(long, value_name = "NAME", default_value = DEFAULT_DETECTOR,
        help = format!("The detector, or several that see the same frames, each behind a --detector: {DETECTORS}"))]
    detector: Vec<String>,
    /// The town: a .sumocfg, a .net.xml(.gz), a folder with one .sumocfg, or a bundled town.
    #[arg(long, default_value = "town5", value_name = "CONFIG", value_hint = ValueHint::FilePath)]
    town: String,
    /// Number of frames.
    #[arg(long, value_name = "N", default_value_t = 200)]
    frames: usize,
    /// The weathers, frame by frame in turn [default: all 14].
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    weather: Vec<Preset>,
    /// Background traffic: as-is, empty, regular, dense, or VEHICLES,PEDESTRIANS.
    #[arg(long, default_value = "dense", value_name = "T")]
    traffic: TrafficSpec,
    /// Seed of everything random.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    /// Lowest score that counts for average precision; at most 0.3, from which recall counts.
    #[arg(long, value_name = "SCORE", default_value_t = 0.05)]
    min_score: f32,
    /// Write the frames to this folder as PNG: truth in white, hits green, false alarms red.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pictures: Option<PathBuf>,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

/// The last line of `--json`.
#[derive(Serialize)]
struct Report {
    town: String,
    seed: u64,
    frames: usize,
    interrupted: bool,
    detectors: Vec<Scores>,
}

/// What one detector sees of the frames.
#[derive(Serialize)]
struct Scores {
    detector: String,
    /// Wall time of a detection (median, ms).
    detect_ms: f64,
    realism: Realism,
    realism_by_weather: Vec<(Preset, Realism)>,
    /// What is found by height, from some scores on.
    sureness: Vec<BySureness>,
    precision: Vec<Precision>,
    precision_by_weather: Vec<(Preset, Vec<Precision>)>,
    /// In the weathers that detectors are trained in, and in all others.
    precision_training_weathers: Vec<Precision>,
    precision_unseen_weathers: Vec<Precision>,
    /// Lane and light, by weather and of all frames; `eval eyes` only.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    road: Vec<(String, RoadReport)>,
}

/// A detector, and what it has seen.
struct Judged {
    detector: Box<dyn Detector>,
    views: Vec<View>,
    /// Wall time of each detection (ms).
    times: Vec<f64>,
    roads: Option<Roads>,
}

impl Judged {
    fn scores(self, weathers: &[Preset], least: f32) -> Scores {
        let views = &self.views;
        let of = |weather: Preset| views.iter().filter(move |v| v.weather == weather);
        let is_trained = |v: &&View| TRAINING_WEATHERS.contains(&v.weather);
        let (trained, unseen): (Vec<&View>, Vec<&View>) = views.iter().partition(is_trained);
        Scores {
            detector: self.detector.name().to_string(),
            detect_ms: median(self.times),
            realism: realism(views),
            realism_by_weather: weathers.iter().map(|&w| (w, realism(of(w)))).collect(),
            sureness: sureness(views, least),
            precision: precision(&views.iter().collect::<Vec<_>>()),
            precision_by_weather: weathers
                .iter()
                .map(|&w| (w, precision(&of(w).collect::<Vec<_>>())))
                .collect(),
            precision_training_weathers: precision(&trained),
            precision_unseen_weathers: precision(&unseen),
            road: self.roads.map_or_else(Vec::new, |roads| roads.report()),
        }
    }
}

/// What is to be seen of lane and light in a frame, for all detectors alike.
fn wanted(frame: &Frame, tour: &Tour, camera: &CameraConfig, heads: &mut Option<Heads>) -> RoadWanted {
    let facts = tour.facts(0.0);
    let heads = heads.get_or_insert_with(|| Heads::new(facts.network, tour.town().scene()));
    let truth = RoadTruth::find(&facts, tour.world(), heads);
    let signs = &tour.town().scene().signs;
    let truth = truth.with_frame(signs, camera, &facts.on_route.state.pose, frame);
    let objects = frame.objects.iter().map(|one| {
        let hidden = score::truth(one.class, one.visible_pixels, one.visible_box, one.full_box).ignored;
        (one.id, one.visible_box.map(|v| v as f32), hidden)
    });
    let light = LightAhead::find(&facts).map(|light| (light.state, light.distance));
    truth.wanted(objects, light)
}

/// Scores of lane and light: by weather, and of all frames.
struct Roads {
    by_weather: Vec<(Preset, RoadScore)>,
    all: RoadScore,
}

impl Roads {
    fn new(weathers: &[Preset]) -> Self {
        let by_weather = weathers.iter().map(|&weather| (weather, RoadScore::default())).collect();
        Self { by_weather, all: RoadScore::default() }
    }

    /// Scores a view.
    fn add(&mut self, weather: Preset, wanted: &RoadWanted, seen: &Seen) {
        let heads = wanted.heads.iter().filter(|(_, counts)| *counts).count();
        tracing::debug!("{weather}: {heads} heads of {:?}, seen {:?}", wanted.light, seen.light);
        self.all.add(wanted, seen);
        if let Some((_, score)) = self.by_weather.iter_mut().find(|(one, _)| *one == weather) {
            score.add(wanted, seen);
        }
    }

    fn report(&self) -> Vec<(String, RoadReport)> {
        let by_weather = self.by_weather.iter().map(|(weather, score)| (weather.to_string(), score.report()));
        by_weather.chain([("all".to_string(), self.all.report())]).collect()
    }
}

/// Runs the command.
pub fn run(args: Args, what: Scored) -> anyhow::Result<Exit> {
    if !(0.0..=BELIEVED).contains(&args.min_score) {
        return Err(Exit::Input.because(anyhow::anyhow!(
            "--min-score: expected 0 to {BELIEVED}, from which recall counts, found {}; give less",
            args.min_score
        )));
    }
    if args.pictures.is_some() && args.detector.len() > 1 {
        return Err(Exit::Input.because(anyhow::anyhow!(
            "--pictures shows what one detector finds, found {} of them; give one --detector",
            args.detector.len()
        )));
    }
    let config = bundled::resolve(&args.town).map_err(|e| Exit::Input.because(e))?;
    let weathers = if args.weather.is_empty() { Preset::ALL.to_vec() } else { args.weather.clone() };
    let mut judged = Vec::new();
    for name in &args.detector {
        let detector =
            detector(name, LeastScore::Fixed(args.min_score)).map_err(|e| Exit::Input.because(e))?;
        let roads = (what == Scored::Road).then(|| Roads::new(&weathers));
        judged.push(Judged { detector, views: Vec::new(), times: Vec::new(), roads });
    }
    let runtime = crate::cli::runtime()?;
    let interrupted = runtime.block_on(look(&args, config, &weathers, &mut judged))?;
    let report = Report {
        town: args.town.clone(),
        seed: args.seed,
        frames: judged.iter().map(|one| one.views.len()).max().unwrap_or_default(),
        interrupted,
        detectors: judged.into_iter().map(|one| one.scores(&weathers, args.min_score)).collect(),
    };
    answer(&text::of(&report), args.json, &report)?;
    Ok(if interrupted { Exit::Interrupted } else { Exit::Done })
}

/// Shows the frames to all; whether the user interrupted.
async fn look(
    args: &Args,
    config: PathBuf,
    weathers: &[Preset],
    judged: &mut [Judged],
) -> anyhow::Result<bool> {
    let scratch = tempfile::tempdir().context("cannot make a temporary folder")?;
    let mut interrupt = crate::cli::interrupt()?;
    let options = DriveOptions::passing(config, args.seed, args.traffic, scratch.path());
    let mut tour = Tour::start(options, args.seed).await.map_err(run::with_exit)?;
    let mut camera = Camera::new(CameraConfig::default()).map_err(|e| Exit::Input.because(e))?;
    let with_road = judged.iter().any(|one| one.roads.is_some());
    let outputs = Outputs { boxes: true, depth: with_road, semantic: with_road, ..Outputs::RGB };
    let bar = Bar::new(args.frames as u64, "frames");
    let (mut found, mut heads, mut interrupted) = (Vec::new(), None, false);
    for (n, &preset) in weathers.iter().cycle().take(args.frames).enumerate() {
        let pose = tokio::select! {
            biased;
            () = interrupt.wait() => { interrupted = true; break; }
            pose = tour.next() => pose.map_err(run::with_exit)?,
        };
        let camera_config = *camera.config();
        let frame =
            camera.render(tour.town().scene(), tour.town().actors(), &pose, &Weather::from(preset), outputs);
        let wanted = with_road.then(|| wanted(frame, &tour, &camera_config, &mut heads));
        // A detector that sees objects only has the lanes of Canny and Hough, and no light.
        let by_paint = LazyCell::new(|| {
            let ground = GroundPlane::new(&camera_config);
            Seen { lanes: LaneDetector::default().find(frame, &ground, &tour.facts(0.0)), ..Seen::default() }
        });
        for one in judged.iter_mut() {
            let clock = Instant::now();
            one.detector.detect(frame, &camera_config, &mut found)?;
            one.times.push(clock.elapsed().as_secs_f64() * 1000.0);
            let view = View::new(preset, frame, &found);
            if let (Some(roads), Some(wanted)) = (&mut one.roads, &wanted) {
                roads.add(preset, wanted, one.detector.seen().unwrap_or_else(|| &by_paint));
            }
            if let Some(folder) = &args.pictures {
                let path = folder.join(format!("{n:04}-{preset}.png"));
                picture(frame, &view, &found)
                    .save(&path)
                    .map_err(|e| Exit::Input.because(e))
                    .with_context(|| format!("cannot write the picture {}", path.display()))?;
            }
            one.views.push(view);
        }
        bar.show(n as u64 + 1, "");
    }
    bar.clear();
    tour.finish().await.map_err(run::with_exit)?;
    Ok(interrupted)
}

/// The frame with boxes: counted truths white, others grey, counted detections green or red.
fn picture(frame: &Frame, view: &View, found: &[Detection]) -> Picture {
    use wad_cosim::perception::metrics::{Fate, fates};
    let mut picture = Picture::rgb(frame);
    let scored = view.by_group();
    for truth in &scored.truths {
        let colour = if truth.ignored { [120; 3] } else { [255; 3] };
        picture.frame(truth.bounds, colour);
    }
    let believed: Vec<&Detection> = found.iter().filter(|d| d.score >= BELIEVED).collect();
    for (detection, fate) in believed.into_iter().zip(fates(&scored, 0.5, |_| true)) {
        let colour = match fate {
            Fate::Hit(_) => [40, 230, 60],
            Fate::Ignored => [60, 140, 255],
            Fate::False => [255, 50, 40],
        };
        picture.frame(detection.bounds, colour);
    }
    picture
}
