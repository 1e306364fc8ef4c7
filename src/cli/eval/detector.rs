//! `wad-cosim eval detector`: recall, false alarms and average precision on frames of a town. `eval eyes` also scores
//! what is seen of lane and light.

use crate::cli::progress::Bar;
use crate::cli::{Exit, answer, run};
use anyhow::Context;
use clap::ValueHint;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Instant;
use wad_cosim::bundled;
use wad_cosim::camera::{Camera, CameraConfig, Frame, Outputs, Picture, Preset, Weather};
use wad_cosim::dataset::TRAINING_WEATHERS;
use wad_cosim::drive::DriveOptions;
use wad_cosim::perception::score::{
    self, BELIEVED, BySureness, FALSE_ALARM_GOAL, GROUPS, Precision, Realism, View, precision, realism,
    sureness,
};
use wad_cosim::perception::sight_score::{RoadReport, RoadScore};
use wad_cosim::perception::{
    DETECTORS, Detection, Detector, GroundPlane, Heads, LaneDetector, LeastScore, LightAhead, RoadTruth,
    Seen, detector,
};
use wad_cosim::stats::median;
use wad_cosim::tour::Tour;
use wad_cosim::traffic::TrafficSpec;

const EXAMPLES: &str = "\
Examples:
  wad-cosim eval detector --detector onnx:$(scripts/fetch-detector)
  wad-cosim eval detector --detector centernet --frames 1400
  wad-cosim eval detector --detector truth:faulty
  wad-cosim eval detector --detector onnx --frames 500 --weather ClearNoon --json
  wad-cosim eval detector --detector onnx --frames 28 --pictures boxes/";

/// Examples of `eval eyes`.
pub const EYES_EXAMPLES: &str = "\
Examples:
  wad-cosim eval eyes --detector eyes                                              the bundled one
  wad-cosim eval eyes --detector eyes:runs/eyes/detector.safetensors --frames 3000
  wad-cosim eval eyes --detector centernet                                         lanes by Canny and Hough
  wad-cosim eval eyes --detector eyes --weather HardRainNoon --json";

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
    #[arg(long, value_name = "NAME", help = format!("The detector: {DETECTORS}"))]
    detector: String,
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
    detector: String,
    town: String,
    seed: u64,
    frames: usize,
    interrupted: bool,
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

/// Scores of lane and light: by weather, and of all frames.
struct Roads {
    by_weather: Vec<(Preset, RoadScore)>,
    all: RoadScore,
    heads: Option<Heads>,
}

impl Roads {
    fn new(weathers: &[Preset]) -> Self {
        let by_weather = weathers.iter().map(|&weather| (weather, RoadScore::default())).collect();
        Self { by_weather, all: RoadScore::default(), heads: None }
    }

    /// Scores a view. A detector that sees objects only has the lanes of Canny and Hough, and no light.
    fn add(
        &mut self,
        weather: Preset,
        frame: &Frame,
        tour: &Tour,
        detector: &dyn Detector,
        camera: &CameraConfig,
    ) {
        let facts = tour.facts(0.0);
        let heads = self.heads.get_or_insert_with(|| Heads::new(facts.network, tour.town().scene()));
        let truth = RoadTruth::find(&facts, tour.world(), heads);
        let signs = &tour.town().scene().signs;
        let truth = truth.with_frame(signs, camera, &facts.on_route.state.pose, frame);
        let objects = frame.objects.iter().map(|one| {
            let hidden = score::truth(one.class, one.visible_pixels, one.visible_box, one.full_box).ignored;
            (one.id, one.visible_box.map(|v| v as f32), hidden)
        });
        let light = LightAhead::find(&facts).map(|light| (light.state, light.distance));
        let wanted = truth.wanted(objects, light);
        let seen = detector.seen().copied().unwrap_or_else(|| {
            let lanes = LaneDetector::default().find(frame, &GroundPlane::new(camera), &facts);
            Seen { lanes, ..Seen::default() }
        });
        let heads = wanted.heads.iter().filter(|(_, counts)| *counts).count();
        tracing::debug!("{weather}: {heads} heads of {:?}, seen {:?}", wanted.light, seen.light);
        self.all.add(&wanted, &seen);
        if let Some((_, score)) = self.by_weather.iter_mut().find(|(one, _)| *one == weather) {
            score.add(&wanted, &seen);
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
    let config = bundled::resolve(&args.town).map_err(|e| Exit::Input.because(e))?;
    let mut detector =
        detector(&args.detector, LeastScore::Fixed(args.min_score)).map_err(|e| Exit::Input.because(e))?;
    let weathers = if args.weather.is_empty() { Preset::ALL.to_vec() } else { args.weather.clone() };
    let runtime = crate::cli::runtime()?;
    let mut times = Vec::new();
    let mut roads = (what == Scored::Road).then(|| Roads::new(&weathers));
    let (views, interrupted) =
        runtime.block_on(look(&args, config, &weathers, detector.as_mut(), &mut times, &mut roads))?;
    let of = |weather: Preset| views.iter().filter(move |v| v.weather == weather);
    let is_trained = |v: &&View| TRAINING_WEATHERS.contains(&v.weather);
    let (trained, unseen): (Vec<&View>, Vec<&View>) = views.iter().partition(is_trained);
    let report = Report {
        detector: detector.name().to_string(),
        town: args.town.clone(),
        seed: args.seed,
        frames: views.len(),
        interrupted,
        detect_ms: median(times),
        realism: realism(&views),
        realism_by_weather: weathers.iter().map(|&w| (w, realism(of(w)))).collect(),
        sureness: sureness(&views, args.min_score),
        precision: precision(&views.iter().collect::<Vec<_>>()),
        precision_by_weather: weathers.iter().map(|&w| (w, precision(&of(w).collect::<Vec<_>>()))).collect(),
        precision_training_weathers: precision(&trained),
        precision_unseen_weathers: precision(&unseen),
        road: roads.map_or_else(Vec::new, |roads| roads.report()),
    };
    let text = text(&report);
    answer(&text, args.json, &report)?;
    Ok(if interrupted { Exit::Interrupted } else { Exit::Done })
}

/// The frames, and whether the user interrupted.
async fn look(
    args: &Args,
    config: PathBuf,
    weathers: &[Preset],
    detector: &mut dyn Detector,
    times: &mut Vec<f64>,
    roads: &mut Option<Roads>,
) -> anyhow::Result<(Vec<View>, bool)> {
    let scratch = tempfile::tempdir().context("cannot make a temporary folder")?;
    let mut interrupt = crate::cli::interrupt()?;
    let options = DriveOptions::passing(config, args.seed, args.traffic, scratch.path());
    let mut tour = Tour::start(options, args.seed).await.map_err(run::with_exit)?;
    let mut camera = Camera::new(CameraConfig::default()).map_err(|e| Exit::Input.because(e))?;
    let outputs = Outputs { boxes: true, depth: roads.is_some(), semantic: roads.is_some(), ..Outputs::RGB };
    let bar = Bar::new(args.frames as u64, "frames");
    let (mut views, mut found, mut interrupted) = (Vec::new(), Vec::new(), false);
    for (n, &preset) in weathers.iter().cycle().take(args.frames).enumerate() {
        let pose = tokio::select! {
            biased;
            () = interrupt.wait() => { interrupted = true; break; }
            pose = tour.next() => pose.map_err(run::with_exit)?,
        };
        let camera_config = *camera.config();
        let frame =
            camera.render(tour.town().scene(), tour.town().actors(), &pose, &Weather::from(preset), outputs);
        let clock = Instant::now();
        detector.detect(frame, &camera_config, &mut found)?;
        times.push(clock.elapsed().as_secs_f64() * 1000.0);
        let view = View::new(preset, frame, &found);
        if let Some(roads) = roads {
            roads.add(preset, frame, &tour, detector, &camera_config);
        }
        if let Some(folder) = &args.pictures {
            let path = folder.join(format!("{n:04}-{preset}.png"));
            picture(frame, &view, &found)
                .save(&path)
                .map_err(|e| Exit::Input.because(e))
                .with_context(|| format!("cannot write the picture {}", path.display()))?;
        }
        views.push(view);
        bar.show(n as u64 + 1, "");
    }
    bar.clear();
    tour.finish().await.map_err(run::with_exit)?;
    Ok((views, interrupted))
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

/// The rows of lane and light.
fn road_text(rows: &[(String, RoadReport)]) -> String {
    let mut out = String::from(
        "\nThe ego's lane, 0.5 m at 10 m, and its light within 40 m; the stop line's distance within 20 m\n\
         | weather | boundaries found | median m | lanes seen in junctions | lights right | missed | red called green | seen where none is | stop line, median m | signs found | signs read within 12 m | signs seen where none is | road, IoU |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    let share = |v: Option<f64>, of: usize| v.map_or("-".to_string(), |v| format!("{v:.3} of {of}"));
    let metres = |v: Option<f64>| v.map_or("-".to_string(), |v| format!("{v:.2}"));
    for (weather, r) in rows {
        let _ = writeln!(
            out,
            "| {weather} | {} | {} | {} | {} | {} | {} of {} | {} | {} | {} | {} | {} | {} |",
            share(r.boundaries_found, r.boundaries),
            metres(r.lateral_error.median),
            share(r.phantom_lanes, r.junctions),
            share(r.lights_right, r.lights),
            share(r.lights_missed, r.lights),
            r.red_as_green,
            r.reds,
            share(r.phantom_lights, r.without_light),
            metres(r.line_error.median),
            share(r.signs_found, r.signs),
            share(r.signs_right, r.near_signs),
            share(r.phantom_signs, r.frames),
            r.area_iou.map_or("-".to_string(), |v| format!("{v:.3}")),
        );
    }
    out
}

/// The rows of what is found by height.
fn sureness_text(rows: &[BySureness]) -> String {
    let mut out = String::from(
        "Found (a box of its group overlaps by 0.4), and how many a frame are where nothing is, from a score on; agents \
         drive by 0.4 up to a height of 12 px, falling to 0.3 at 32 (of `onnx` by 0.3), and by what of it does not stand \
         on free road, which is not left out here\n",
    );
    let by_height = || "from 0.4 to 0.3 by height".to_string();
    let least = |least: Option<f32>| least.map_or_else(by_height, |s| format!("from {s:.1}"));
    let first = rows.first().map_or(&[][..], |row| &row.from);
    let columns: Vec<String> = first.iter().map(|one| least(one.least)).collect();
    let _ =
        writeln!(out, "| | truths | {} |\n|---|---{}|", columns.join(" | "), "|---".repeat(columns.len()));
    for row in rows {
        let cells = row.from.iter().map(|one| {
            let recall = one.recall.map_or("-".to_string(), |recall| format!("{:.1} %", 100.0 * recall));
            format!("{recall}; {:.2}", one.false_alarms_per_frame)
        });
        let cells: Vec<String> = cells.collect();
        let height = row.high.map_or_else(|| "px or more".to_string(), |high| format!("to {high} px"));
        let _ =
            writeln!(out, "| {}, {} {height} | {} | {} |", row.group, row.low, row.truths, cells.join(" | "));
    }
    out + "\n"
}

fn text(report: &Report) -> String {
    let mut out = format!(
        "{} on {} frames of {}, {:.1} ms a frame\n\nRecall at a score of {BELIEVED} (hits / truths), and false alarms per frame\n",
        report.detector, report.frames, report.town, report.detect_ms
    );
    let header: Vec<String> =
        GROUPS.iter().map(|g| format!("{} >= {} px", g.name, g.height)).chain(["false".into()]).collect();
    let _ = writeln!(out, "| weather | {} |\n|---{}|", header.join(" | "), "|---".repeat(header.len()));
    let all = ("all".to_string(), &report.realism);
    for (name, score) in report.realism_by_weather.iter().map(|(w, s)| (w.to_string(), s)).chain([all]) {
        let cells = GROUPS.iter().map(|g| {
            score.groups.get(g.name).map_or_else(String::new, |s| match s.recall {
                Some(recall) => format!("{recall:.2} ({}/{})", s.hits, s.truths),
                None => "-".to_string(),
            })
        });
        let cells: Vec<String> = cells.chain([format!("{:.2}", score.false_alarms_per_frame)]).collect();
        let _ = writeln!(out, "| {name} | {} |", cells.join(" | "));
    }
    let goals = GROUPS.iter().map(|g| g.goal.map_or("-".to_string(), |goal| format!("{goal:.2}")));
    let goals: Vec<String> = goals.chain([format!("< {FALSE_ALARM_GOAL:.0}")]).collect();
    let _ = writeln!(out, "| goal | {} |\n", goals.join(" | "));

    out += "By class, counted as found if detected as any class of its group:";
    for (n, (class, score)) in report.realism.classes.iter().enumerate() {
        let recall = score.hits as f64 / score.truths.max(1) as f64;
        let comma = if n == 0 { "" } else { "," };
        let _ = write!(out, "{comma} {class} {recall:.2} ({}/{})", score.hits, score.truths);
    }
    out += "\n\n";

    let cell = |v: Option<f64>| v.map_or("-".to_string(), |v| format!("{v:.3}"));
    out += &sureness_text(&report.sureness);
    out += "Average precision of boxes 24 px high or more, and of 12 to 24 px\n";
    out += "| class | truths | AP@0.5 | training weathers | unseen weathers | AP@[.5:.95] | truths 12-24 | AP@0.5 12-24 |\n";
    out += "|---|---|---|---|---|---|---|---|\n";
    let counted = |rows: &[Precision], n: usize| match rows.get(n) {
        Some(row) if row.truths > 0 => format!("{} of {}", cell(row.ap50), row.truths),
        _ => "-".to_string(),
    };
    for (n, row) in report.precision.iter().enumerate() {
        let _ = writeln!(
            out,
            "| {} | {} | {} | {} | {} | {} | {} | {} |",
            row.class,
            row.truths,
            cell(row.ap50),
            counted(&report.precision_training_weathers, n),
            counted(&report.precision_unseen_weathers, n),
            cell(row.ap),
            row.truths_small,
            cell(row.ap50_small)
        );
    }
    out += "\nmAP by weather\n| weather | mAP@0.5 | mAP@[.5:.95] | mAP@0.5 12-24 |\n|---|---|---|---|\n";
    let by_weather = report.precision_by_weather.iter().map(|(w, rows)| (w.to_string(), rows));
    let groups = [
        ("training weathers".to_string(), &report.precision_training_weathers),
        ("unseen weathers".to_string(), &report.precision_unseen_weathers),
    ];
    for (weather, rows) in by_weather.chain(groups) {
        if let Some(all) = rows.last() {
            let cells = [all.ap50, all.ap, all.ap50_small].map(cell);
            let _ = writeln!(out, "| {weather} | {} |", cells.join(" | "));
        }
    }
    if !report.road.is_empty() {
        out += &road_text(&report.road);
    }
    out
}
