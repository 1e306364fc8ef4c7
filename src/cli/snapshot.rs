//! `wad-cosim snapshot`: saves a picture of a town.

use super::dataset::VariedList;
use super::{Exit, print, run};
use anyhow::Context;
use clap::{ValueEnum, ValueHint};
use std::path::{Path, PathBuf};
use wad_cosim::assets::LOOK;
use wad_cosim::bundled;
use wad_cosim::camera::variety::{self, Varied};
use wad_cosim::camera::{Camera, CameraConfig, MAX_PIXELS, Outputs, Picture, Preset, Town, Weather};
use wad_cosim::drive::{Drive, DriveOptions};
use wad_cosim::eyes::Eyes;
use wad_cosim::geometry::Pose;
use wad_cosim::latent::Decoder;
use wad_cosim::perception::{self, Detector, stages};
use wad_cosim::traffic::TrafficSpec;

const EXAMPLES: &str = "\
Examples:
  wad-cosim snapshot town5 --out front.png
  wad-cosim snapshot town5 --weather HardRainNoon --time 60 --seed 3 --out rain.png
  wad-cosim snapshot town3 --overlay boxes --out boxes.png
  wad-cosim snapshot town5 --stage transformed --out transformed.png
  wad-cosim snapshot town5 --view chase --size 1280x720 --out chase.png
  wad-cosim snapshot town5 --sheet --out weathers.png";

/// Drive through a town under the autopilot and save a picture.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A .sumocfg, a .net.xml(.gz), a folder with one .sumocfg, or a bundled town (town3, town5, town7).
    #[arg(value_hint = ValueHint::FilePath)]
    config: String,
    /// One of CARLA's 14 weathers, e.g. ClearNoon, WetCloudySunset, MidRainyNoon.
    #[arg(long, default_value = "ClearNoon")]
    weather: Preset,
    /// Simulation seconds to drive before the picture.
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0, value_parser = super::seconds)]
    time: f64,
    /// Number of pictures, one every --every seconds; the files are numbered.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    count: u32,
    /// Simulation seconds between the pictures.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, value_parser = super::seconds)]
    every: f64,
    /// PNG (or .jpg) file to write.
    #[arg(long, value_name = "FILE", default_value = "snapshot.png", value_hint = ValueHint::FilePath)]
    out: PathBuf,
    /// Background traffic: as-is, empty, regular, dense, or VEHICLES,PEDESTRIANS.
    #[arg(long, default_value = "dense", value_name = "T")]
    traffic: TrafficSpec,
    /// Seed of everything random.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    /// Draw these from --vary-seed, as `dataset collect --vary` does for each shard: houses, paint, parked, trees, sun,
    /// night, signs, or all.
    #[arg(long, value_name = "WHAT,...", value_parser = Varied::list, conflicts_with = "sheet")]
    vary: Option<VariedList>,
    /// The seed of --vary.
    #[arg(long, default_value_t = 0, value_name = "N", requires = "vary")]
    vary_seed: u64,
    /// First route, from one edge (or lane) to another.
    #[arg(long, value_name = "FROM,TO", allow_hyphen_values = true)]
    route: Option<String>,
    /// The encoder for --stage latent and all: a .safetensors file, a folder of `train encoder`, or a bundled
    /// encoder.
    #[arg(long, value_name = "NAME", default_value = "default")]
    encoder: String,
    /// WIDTHxHEIGHT in pixels [default: 512x512; 1280x720 for chase, 720x720 for bird].
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<(usize, usize)>,
    /// The camera's place.
    #[arg(long, value_enum, default_value_t = Place::Front)]
    view: Place,
    /// Ground truth to show in place of the plain picture.
    #[arg(long, value_enum)]
    overlay: Option<Overlay>,
    /// A stage of perception on the front camera's picture, in place of the plain picture.
    #[arg(long, value_enum, conflicts_with_all = ["overlay", "view"])]
    stage: Option<Stage>,
    #[arg(long, help = format!("The detector: {}", perception::DETECTORS), default_value = perception::DEFAULT_DETECTOR, value_name = "NAME", requires = "stage")]
    detector: String,
    /// All 14 weathers in one picture, each of --size.
    #[arg(long, conflicts_with_all = ["weather", "overlay", "stage"])]
    sheet: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Place {
    /// Behind the windscreen, as the ego sees it.
    Front,
    /// Behind and above the ego.
    Chase,
    /// From above.
    Bird,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Overlay {
    /// Depth: bright near, dark far.
    Depth,
    /// Semantic classes in CARLA's colours.
    Semantic,
    /// Instances: a colour for each object.
    Instance,
    /// The picture with the true boxes of visible objects.
    Boxes,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Stage {
    /// Boxes of the detections.
    Detect,
    /// The ego lane's boundaries, and what `eyes` take for road; a red border where the light at the intersection is red.
    Lanes,
    /// All that is seen: boxes with class and certainty (percent), the lane's boundaries, the light ahead, signs, what is road.
    Eyes,
    /// The transformed image, 128x128.
    Transformed,
    /// The transformed image's reconstruction from the latent, 128x128.
    Latent,
    /// Camera, detections, transformed image and reconstruction side by side.
    All,
}

pub fn size(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("expected WIDTHxHEIGHT, e.g. 512x512, found `{text}`");
    let (width, height) = text.split_once('x').ok_or_else(wrong)?;
    Ok((width.trim().parse().map_err(|_| wrong())?, height.trim().parse().map_err(|_| wrong())?))
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    let config = match args.view {
        Place::Front => args.size.map_or(CameraConfig::default(), |(w, h)| CameraConfig::sized(w, h)),
        Place::Chase => args.size.map_or(CameraConfig::chase(1280, 720), |(w, h)| CameraConfig::chase(w, h)),
        Place::Bird => args.size.map_or(CameraConfig::bird(720, 720), |(w, h)| CameraConfig::bird(w, h)),
    };
    let camera = Camera::new(config).map_err(|e| Exit::Input.because(e))?;
    if args.sheet {
        let side = (MAX_PIXELS / (COLUMNS * COLUMNS)).isqrt();
        let (width, height) = (config.width, config.height);
        if width * height > side * side {
            return Err(Exit::Input.because(anyhow::anyhow!(
                "14 pictures of {width}x{height} pixels are too large for one sheet: expected at most \
                 {side}x{side} each"
            )));
        }
    }
    // Checked before anything is simulated.
    check_place(&numbered(&args, 0))?;
    let stage = args.stage.map(|stage| stage_parts(&args, stage)).transpose()?;
    let runtime = crate::cli::runtime()?;
    runtime.block_on(take(args, camera, stage))
}

/// Everything but the camera that a stage's picture needs.
struct StageParts {
    stage: Stage,
    detector: Box<dyn Detector>,
    decoder: Option<Box<dyn Decoder>>,
}

fn stage_parts(args: &Args, stage: Stage) -> anyhow::Result<StageParts> {
    let detector = perception::detector(&args.detector, perception::LeastScore::Usual)
        .map_err(|e| Exit::Input.because(e))?;
    Ok(StageParts { stage, detector, decoder: decoder(args, stage)? })
}

/// `latent` needs an encoder; `all` works without one.
#[cfg(feature = "learn")]
fn decoder(args: &Args, stage: Stage) -> anyhow::Result<Option<Box<dyn Decoder>>> {
    if !matches!(stage, Stage::Latent | Stage::All) {
        return Ok(None);
    }
    match wad_cosim::latent::TchEncoder::find(&args.encoder) {
        Ok(encoder) => Ok(Some(Box::new(encoder))),
        Err(error) if stage == Stage::Latent => Err(Exit::Input.because(error)),
        Err(error) => {
            tracing::warn!("no reconstruction: {error}");
            Ok(None)
        }
    }
}

#[cfg(not(feature = "learn"))]
fn decoder(_: &Args, stage: Stage) -> anyhow::Result<Option<Box<dyn Decoder>>> {
    if stage == Stage::Latent {
        let why = "--stage latent needs libtorch, and this build has none; build with the feature `learn`";
        return Err(Exit::Input.because(anyhow::anyhow!(why)));
    }
    Ok(None)
}

/// The file of picture `number`.
fn numbered(args: &Args, number: u32) -> PathBuf {
    if args.count == 1 {
        return args.out.clone();
    }
    let stem = args.out.file_stem().unwrap_or_default().to_string_lossy();
    let extension = args.out.extension().unwrap_or("png".as_ref()).to_string_lossy();
    args.out.with_file_name(format!("{stem}-{number:03}.{extension}"))
}

fn check_place(path: &Path) -> anyhow::Result<()> {
    Picture::can_save(path)
        .map_err(|e| Exit::Input.because(e))
        .with_context(|| format!("cannot write the picture {}", path.display()))
}

async fn take(args: Args, mut camera: Camera, stage: Option<StageParts>) -> anyhow::Result<Exit> {
    let config = bundled::resolve(&args.config).map_err(|e| Exit::Input.because(e))?;
    let scratch = tempfile::tempdir().context("cannot make a temporary folder")?;
    let options = DriveOptions {
        route: args.route.clone(),
        ..DriveOptions::passing(config, args.seed, args.traffic, scratch.path())
    };
    let mut drive = Drive::start(options).await.map_err(run::with_exit)?;
    let vary = args.vary.as_deref().unwrap_or_default();
    let mut town = drive.assets().town_with(variety::look(vary, LOOK, args.vary_seed));
    let weather = variety::weather(vary, args.weather, args.vary_seed);
    let stage = match stage {
        Some(StageParts { stage, detector, decoder }) => {
            let mut eyes =
                Eyes::new(town.share(), *camera.config(), detector).map_err(|e| Exit::Input.because(e))?;
            if let Some(decoder) = decoder {
                eyes = eyes.with_decoder(decoder);
            }
            drive.watch_with(eyes);
            drive.set_weather(weather.clone());
            Some(stage)
        }
        None => None,
    };
    let begin = drive.bridge().time();
    for number in 0..args.count {
        let until = begin + args.time + f64::from(number) * args.every;
        while drive.bridge().time() < until {
            drive.tick().await.map_err(run::with_exit)?;
            follow(&mut town, &drive, args.view);
            // Perception tracks the vehicle in front and the lanes over several ticks.
            if stage.is_some() && drive.bridge().time() > until - 2.0 {
                drive.look().map_err(run::with_exit)?;
            }
        }
        let picture = match stage {
            Some(stage) => stage_picture(drive.look().map_err(run::with_exit)?, stage)?,
            None => {
                follow(&mut town, &drive, args.view);
                picture(&args, &mut camera, &town, &weather, &drive.ego().state().pose)
            }
        };
        let out = numbered(&args, number);
        picture
            .save(&out)
            .map_err(|e| Exit::Input.because(e))
            .with_context(|| format!("cannot write the picture {}", out.display()))?;
        print(&format!("{} at {:.1} s\n", out.display(), drive.bridge().time()))?;
    }
    drive.finish(false).await.map_err(run::with_exit)?;
    Ok(Exit::Done)
}

/// Moves the road users to their places, and the ego where the camera is not in it.
fn follow(town: &mut Town, drive: &Drive, view: Place) {
    let ego = (view != Place::Front).then(|| drive.ego().as_actor());
    town.follow(drive.ego().world(), ego.as_ref());
}

fn stage_picture(eyes: &Eyes, stage: Stage) -> anyhow::Result<Picture> {
    let (Some(frame), Some(perception)) = (eyes.frame(), eyes.perception()) else {
        anyhow::bail!("the camera gave no picture");
    };
    let percept = perception.percept();
    Ok(match stage {
        Stage::Detect => stages::detections(frame, &percept.detections),
        Stage::Lanes => stages::lanes(frame, percept, perception.ground()),
        Stage::Eyes => stages::seen(frame, percept, perception.ground()),
        Stage::Transformed => stages::transformed(&percept.transformed),
        Stage::Latent => stages::transformed(eyes.reconstruction().unwrap_or(&percept.transformed)),
        Stage::All => {
            eyes.strip(frame.height.max(128)).unwrap_or_else(|| stages::transformed(&percept.transformed))
        }
    })
}

fn picture(args: &Args, camera: &mut Camera, town: &Town, weather: &Weather, pose: &Pose) -> Picture {
    let mut shoot = |weather: &Weather, outputs: Outputs| {
        camera.render(town.scene(), town.actors(), pose, weather, outputs).clone()
    };
    if args.sheet {
        return sheet(|preset| Picture::rgb(&shoot(&Weather::from(preset), Outputs::RGB)));
    }
    let frame = shoot(weather, Outputs::ALL);
    match args.overlay {
        None => Picture::rgb(&frame),
        Some(Overlay::Depth) => Picture::depth(&frame),
        Some(Overlay::Semantic) => Picture::semantic(&frame),
        Some(Overlay::Instance) => Picture::instances(&frame),
        Some(Overlay::Boxes) => Picture::boxes(&frame),
    }
}

/// `ClearNoon` as `Clear Noon`.
fn words(name: &str) -> String {
    let mut text = String::new();
    for letter in name.chars() {
        if letter.is_ascii_uppercase() && !text.is_empty() {
            text.push(' ');
        }
        text.push(letter);
    }
    text
}

/// Pictures in a row of a sheet.
const COLUMNS: usize = 4;

/// Noon in the upper rows, sunset in the lower: four pictures to a row.
fn sheet(mut shoot: impl FnMut(Preset) -> Picture) -> Picture {
    const GAP: usize = 6;
    let mut pages: Option<Picture> = None;
    for (half, presets) in Preset::ALL.chunks(7).enumerate() {
        for (n, &preset) in presets.iter().enumerate() {
            let mut picture = shoot(preset);
            picture.label(&words(preset.name()), 0, 0, (picture.width / 256).max(1));
            let (w, h) = (picture.width + GAP, picture.height + GAP);
            let page = pages.get_or_insert_with(|| Picture::new(COLUMNS * w - GAP, 4 * h - GAP));
            page.paste(&picture, n % COLUMNS * w, (2 * half + n / COLUMNS) * h);
        }
    }
    pages.unwrap_or_else(|| Picture::new(1, 1))
}
