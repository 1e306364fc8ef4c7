//! `wad-cosim bench camera`: the time of a camera frame.

use super::{Exit, print, run};
use anyhow::Context;
use serde::Serialize;
use std::time::Instant;
use wad_cosim::bundled;
use wad_cosim::camera::{Camera, CameraConfig, Outputs, Preset, Stages, Town, Weather};
use wad_cosim::cpu_time;
use wad_cosim::drive::{Drive, DriveOptions};
use wad_cosim::stats::{median, quantile};
use wad_cosim::traffic::TrafficSpec;

const EXAMPLES: &str = "\
Examples:
  wad-cosim bench camera
  wad-cosim bench camera town3 --traffic 100,250 --frames 300 --json
  wad-cosim bench camera --weather ClearNoon,WetSunset --sizes 512x512";

/// Time the rendering of a drive through a town, one frame each tick, on one core. Each row is the same
/// drive again.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A .sumocfg, a .net.xml(.gz) or a bundled town.
    #[arg(default_value = "town5")]
    config: String,
    /// Background traffic.
    #[arg(long, default_value = "70,100", value_name = "T")]
    traffic: TrafficSpec,
    /// Weathers, separated by commas.
    #[arg(long, value_delimiter = ',', default_value = "ClearNoon,HardRainNoon")]
    weather: Vec<Preset>,
    /// Sizes in pixels, separated by commas.
    #[arg(long, value_delimiter = ',', default_value = "512x512,128x128", value_parser = super::snapshot::size)]
    sizes: Vec<(usize, usize)>,
    /// Frames per row, one each tick.
    #[arg(long, default_value_t = 480)]
    frames: usize,
    /// Also measure with the town repeated this many times side by side.
    #[arg(long, default_value_t = 10, value_name = "N")]
    town_times: usize,
    /// Seed of the traffic.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

/// Simulated time before the first frame (s).
const BEFORE: f64 = 20.0;
/// Every so many frames one is rendered once more, to time its stages.
const STAGES_EVERY: usize = 8;

/// One way to render, and the times of its frames.
#[derive(Serialize)]
struct Row {
    weather: Preset,
    width: usize,
    height: usize,
    /// `rgb`, or `all`: with depth, semantic, instance and boxes.
    outputs: &'static str,
    /// How often the town is repeated; 1: once.
    town_times: usize,
    /// Wall time and the thread's processor time; the latter hardly depends on other load.
    median_ms: f64,
    median_cpu_ms: f64,
    p95_ms: f64,
    /// Medians of a frame's stages; each eighth frame is rendered once more for this. Reading the clock makes
    /// them a little slower, warm caches a little faster.
    stages: Stages,
    frames: usize,
}

struct Way {
    camera: Camera,
    weather: Weather,
    outputs: &'static str,
    times: usize,
    wall: Vec<f64>,
    cpu: Vec<f64>,
    stages: Vec<Stages>,
}

/// Runs the command.
pub async fn run(args: Args) -> anyhow::Result<Exit> {
    let config = bundled::resolve(&args.config).map_err(|e| Exit::Input.because(e))?;
    let mut ways = Vec::new();
    for &(width, height) in &args.sizes {
        for &preset in &args.weather {
            for outputs in ["rgb", "all"] {
                ways.push(way((width, height), preset, outputs, 1)?);
            }
        }
    }
    if args.town_times > 1
        && let (Some(&size), Some(&preset)) = (args.sizes.first(), args.weather.first())
    {
        ways.push(way(size, preset, "rgb", args.town_times)?);
    }
    let count = ways.len();
    for (number, way) in ways.iter_mut().enumerate() {
        tracing::info!("row {} of {count}", number + 1);
        drive(way, &args, config.clone()).await?;
    }
    report(&ways, args.json)
}

/// The same drive for each way. One camera renders every tick, as in use, so that other pictures are not in
/// the caches.
async fn drive(way: &mut Way, args: &Args, config: std::path::PathBuf) -> anyhow::Result<()> {
    let scratch = tempfile::tempdir().context("cannot make a temporary folder")?;
    let mut drive = Drive::start(DriveOptions::passing(config, args.seed, args.traffic, scratch.path()))
        .await
        .map_err(run::with_exit)?;
    let mut town = drive.assets().town();
    let large = (way.times > 1).then(|| town.scene().repeated(way.times));
    let begin = drive.bridge().time() + BEFORE;
    while way.wall.len() < args.frames.max(1) {
        drive.tick().await.map_err(run::with_exit)?;
        town.follow(drive.ego().world(), None);
        if drive.bridge().time() >= begin {
            time(way, &town, large.as_ref(), &drive);
        }
    }
    drive.finish(false).await.map_err(run::with_exit)?;
    Ok(())
}

fn way(
    (width, height): (usize, usize),
    preset: Preset,
    outputs: &'static str,
    times: usize,
) -> anyhow::Result<Way> {
    let camera = Camera::new(CameraConfig::sized(width, height)).map_err(|e| Exit::Input.because(e))?;
    Ok(Way {
        camera,
        weather: Weather::from(preset),
        outputs,
        times,
        wall: Vec::new(),
        cpu: Vec::new(),
        stages: Vec::new(),
    })
}

fn time(way: &mut Way, town: &Town, large: Option<&wad_cosim::camera::model::Scene>, drive: &Drive) {
    let scene = large.unwrap_or(town.scene());
    let outputs = if way.outputs == "all" { Outputs::ALL } else { Outputs::RGB };
    let pose = drive.ego().state().pose;
    let cpu_seconds = || cpu_time::of_thread().unwrap_or(f64::NAN);
    let (cpu, wall) = (cpu_seconds(), Instant::now());
    way.camera.render(scene, town.actors(), &pose, &way.weather, outputs);
    way.wall.push(wall.elapsed().as_secs_f64() * 1000.0);
    way.cpu.push((cpu_seconds() - cpu) * 1000.0);
    if way.wall.len() % STAGES_EVERY == 1 {
        way.camera.time_stages(true);
        way.camera.render(scene, town.actors(), &pose, &way.weather, outputs);
        way.camera.time_stages(false);
        way.stages.push(way.camera.stages());
    }
}

/// The median of each stage.
fn stages(frames: &[Stages]) -> Stages {
    let of = |stage: fn(&Stages) -> f64| median(frames.iter().map(stage).collect());
    Stages {
        geometry: of(|s| s.geometry),
        raster: of(|s| s.raster),
        shade: of(|s| s.shade),
        effects: of(|s| s.effects),
    }
}

fn report(ways: &[Way], json: bool) -> anyhow::Result<Exit> {
    let say = |line: &str| super::row(line, json);
    say(&format!(
        "{:>16} {:>10} {:>7} {:>10} {:>10} {:>8} {:>8} {:>9} {:>7} {:>7} {:>8}",
        "weather",
        "size",
        "outputs",
        "town times",
        "median ms",
        "cpu ms",
        "p95 ms",
        "geometry",
        "raster",
        "shade",
        "effects"
    ))?;
    let mut rows = Vec::new();
    for way in ways {
        let row = Row {
            weather: way.weather.preset,
            width: way.camera.config().width,
            height: way.camera.config().height,
            outputs: way.outputs,
            town_times: way.times,
            median_ms: median(way.wall.clone()),
            median_cpu_ms: median(way.cpu.clone()),
            p95_ms: quantile(way.wall.clone(), 0.95),
            stages: stages(&way.stages),
            frames: way.wall.len(),
        };
        say(&format!(
            "{:>16} {:>10} {:>7} {:>10} {:>10.3} {:>8.3} {:>8.3} {:>9.3} {:>7.3} {:>7.3} {:>8.3}",
            row.weather.name(),
            format!("{}x{}", row.width, row.height),
            row.outputs,
            row.town_times,
            row.median_ms,
            row.median_cpu_ms,
            row.p95_ms,
            row.stages.geometry,
            row.stages.raster,
            row.stages.shade,
            row.stages.effects
        ))?;
        rows.push(row);
    }
    if json {
        print(&format!("{}\n", serde_json::json!({ "rows": rows })))?;
    }
    Ok(Exit::Done)
}
