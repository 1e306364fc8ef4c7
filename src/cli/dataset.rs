//! `wad-cosim dataset`: collects training data while the autopilot drives.

use super::progress::Bar;
use super::{Exit, answer, print};
use clap::{Subcommand, ValueHint};
use std::path::PathBuf;
use std::time::Duration;
use wad_cosim::camera::Preset;
use wad_cosim::camera::model::ObjectClass;
use wad_cosim::camera::variety::Varied;
use wad_cosim::dataset::{
    CollectOptions, Collected, Dataset, DatasetError, NoiseParams, Progress, RecordedRun, Role, ShardReader,
    collect,
};
use wad_cosim::perception::ImageKind;
use wad_cosim::perception::coco::{CLASSES, class_name};

/// Clap takes this for one value.
pub type VariedList = Vec<Varied>;

/// Collect training data while the autopilot drives.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Drive under the autopilot with disturbances, and save the camera's frames.
    Collect(CollectArgs),
    /// Print a dataset's contents, and check that it can be read.
    Info(InfoArgs),
}

const EXAMPLES: &str = "\
Examples:
  wad-cosim dataset collect --town town3 --frames 150000 --out data/town3 --jobs 2   (the paper's 100k + 50k)
  wad-cosim dataset collect --town town5 --frames 2000 --out data/town5              (for measuring only)
  wad-cosim dataset collect --frames 20000 --camera --out data/detector              (pictures for a detector)
  wad-cosim dataset collect --frames 20000 --camera --vary all --out data/varied     (other streets in each shard)
  wad-cosim dataset collect --frames 5000 --camera --near --out data/near            (close behind others)
  wad-cosim dataset collect --frames 5000 --camera --near --showing person --out data/people
  wad-cosim dataset collect --from runs/mine --from runs/yours --out data/runs       (frames of recorded runs)

Run the same command again to continue an interrupted collection. Frames of town5 and town7, scenarios in them
too, are test data: `train` refuses them.";

#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct CollectArgs {
    /// A bundled town, a .sumocfg or a .net.xml.
    #[arg(long, default_value = "town3", value_hint = ValueHint::FilePath)]
    town: String,
    /// Instead of new drives: a folder that `run` wrote, driven again in each weather with the
    /// controls of its telemetry. May be given several times.
    #[arg(long, value_name = "RUN", value_hint = ValueHint::DirPath, conflicts_with_all = ["town", "frames", "per_shard", "noise_pause", "showing", "near"])]
    from: Vec<PathBuf>,
    /// Number of frames.
    #[arg(long, value_name = "N", default_value_t = 150_000)]
    frames: usize,
    /// Folder for the dataset.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// SUMOs in parallel; each takes one core.
    #[arg(long, value_name = "N", default_value_t = 1)]
    jobs: usize,
    /// Seed of everything random.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    /// Weathers, in turn [default: ClearNoon, CloudyNoon, SoftRainNoon].
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    weather: Vec<Preset>,
    /// Keep the 512x512 pictures too, for training detectors.
    #[arg(long)]
    camera: bool,
    /// Keep the camera's picture at 128x128 in place of the transformed image, for an encoder that is shown no detections.
    #[arg(long)]
    plain: bool,
    /// Simulation seconds between frames.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.5, value_parser = super::seconds)]
    every: f64,
    /// Keep only frames that show an object of one of these classes, 16 pixels high or more: car, motorcycle,
    /// bicycle, person, bus, truck, "traffic light", bench.
    #[arg(long, value_name = "CLASS", value_delimiter = ',', value_parser = class)]
    showing: Vec<ObjectClass>,
    /// Look from places where the autopilot never stands: 0.2 to 5 m behind whoever is next in the ego's lane. Frames with
    /// nobody there are left out. With `--showing person` (or without person) behind the next person (or vehicle).
    #[arg(long)]
    near: bool,
    /// In pictures and labels, signals show lamps drawn at random, lane by lane; traffic obeys the real ones.
    /// For training eyes: real programs show little yellow, and who stands at a line always sees red.
    #[arg(long)]
    random_signals: bool,
    /// Draw these anew for each shard: houses (façades, colours, kinds of trees), paint (worn or missing), parked (cars
    /// along the streets), trees (none to over the road), sun (from every side), night (every third shard), signs
    /// (many, which say anything), or all.
    #[arg(long, value_name = "WHAT,...", value_parser = Varied::list)]
    vary: Option<VariedList>,
    /// Mean seconds between disturbances of the autopilot's controls; 0: none.
    #[arg(long, value_name = "SECONDS", default_value_t = NoiseParams::default().pause, value_parser = super::seconds)]
    noise_pause: f64,
    /// Frames per shard [default: a twentieth of all, at most 500].
    #[arg(long, value_name = "N")]
    per_shard: Option<usize>,
    /// Stop after this wall time; the frames so far are a complete dataset.
    #[arg(long, value_name = "MINUTES")]
    max_minutes: Option<f64>,
    /// Print the result as one JSON line on stdout.
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args, Debug)]
#[command(after_help = "Example:\n  wad-cosim dataset info data/town3")]
pub struct InfoArgs {
    /// The dataset's folder.
    #[arg(value_hint = ValueHint::DirPath)]
    folder: PathBuf,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    match args.command {
        Command::Collect(args) => run_collect(&args),
        Command::Info(args) => info(&args),
    }
}

/// The exit code of a dataset's error.
pub fn with_exit(error: DatasetError) -> anyhow::Error {
    Exit::of_dataset(&error).because(error)
}

/// A class by its COCO name.
fn class(text: &str) -> Result<ObjectClass, String> {
    let names = || CLASSES.map(class_name).join(", ");
    CLASSES
        .into_iter()
        .find(|c| class_name(*c) == text)
        .ok_or_else(|| format!("expected one of {}, found `{text}`", names()))
}

/// `--max-minutes` as a time.
pub fn minutes(minutes: Option<f64>) -> anyhow::Result<Option<Duration>> {
    minutes
        .map(|m| Duration::try_from_secs_f64(60.0 * m))
        .transpose()
        .map_err(|_| Exit::Input.because(anyhow::anyhow!("--max-minutes: expected 0 or more")))
}

fn run_collect(args: &CollectArgs) -> anyhow::Result<Exit> {
    let wrong = |text: &str| Err(Exit::Input.because(anyhow::anyhow!("{text}")));
    if args.frames == 0 {
        return wrong("--frames must be 1 or more");
    }
    if !(args.every > 0.0 && args.noise_pause >= 0.0) {
        return wrong("--every must be more than 0 seconds, --noise-pause 0 or more");
    }
    let mut options = CollectOptions::new(&args.town, args.frames, &args.out);
    options.seed = args.seed;
    options.camera = args.camera;
    options.image = if args.plain { ImageKind::Plain } else { ImageKind::Transformed };
    options.every = args.every;
    options.noise.pause = args.noise_pause;
    options.showing.clone_from(&args.showing);
    options.near = args.near;
    options.random_signals = args.random_signals;
    options.vary = args.vary.clone().unwrap_or_default();
    options.jobs = args.jobs.max(1);
    options.per_segment = args.per_shard.unwrap_or(options.per_segment).max(1);
    options.time_limit = minutes(args.max_minutes)?;
    if !args.weather.is_empty() {
        options.weathers.clone_from(&args.weather);
    }
    let runs = args.from.iter().map(|folder| RecordedRun::open(folder)).collect::<Result<_, _>>();
    options.runs = runs.map_err(with_exit)?;
    let interrupt = crate::cli::interrupt()?.flag();
    let bar = Bar::new(args.frames as u64, "frames");
    let result = collect(&options, &interrupt, |Progress { frames, wanted }| {
        bar.set_total(wanted as u64);
        bar.show(frames as u64, "");
    });
    bar.clear();
    let collected = result.map_err(with_exit)?;
    report(&collected, args.json)?;
    Ok(if collected.interrupted { Exit::Interrupted } else { Exit::Done })
}

fn report(c: &Collected, json: bool) -> anyhow::Result<()> {
    let text = format!(
        "{}: {} frames in {} shards, {:.1} MB ({} frames in {:.0} s, {:.1} frames/s)\n{}",
        c.out.display(),
        c.frames,
        c.shards,
        c.bytes as f64 / 1e6,
        c.frames - c.frames_before.min(c.frames),
        c.wall_seconds,
        c.frames_per_second,
        match (c.interrupted, c.complete) {
            (true, _) => "interrupted; the same command continues from here\n",
            (_, false) => "stopped by --max-minutes; the same command continues from here\n",
            _ => "",
        }
    );
    answer(&text, json, c)
}

fn info(args: &InfoArgs) -> anyhow::Result<Exit> {
    let dataset = Dataset::open(&args.folder, true).map_err(with_exit)?;
    let m = &dataset.manifest;
    let (mut red, mut lead, mut pedestrian, mut disturbed, mut boxes, mut frames) = (0, 0, 0, 0, 0, 0);
    for shard in 0..dataset.shards.len() {
        for frame in dataset.read(shard, ShardReader::next_frame).map_err(with_exit)? {
            let r = &frame.record;
            frames += 1;
            red += usize::from(r.labels.red);
            lead += usize::from(r.labels.lead.is_some_and(|gap| gap < 20.0));
            pedestrian += usize::from(r.labels.pedestrian.is_some_and(|gap| gap < 15.0));
            disturbed += usize::from(r.disturbed);
            boxes += r.boxes.len();
        }
    }
    let share = |n: usize| 100.0 * n as f64 / frames.max(1) as f64;
    let role = match m.role {
        Role::Training => "training data",
        Role::Test => "test data",
    };
    print(&format!(
        "{}: {role}, {frames} of {} frames in {} shards ({} torn), {:?}\n\
         town {}, seed {}, weathers {}, camera pictures {}\n\
         boxes {:.1} a frame; red light {:.1} %, lead within 20 m {:.1} %, pedestrian within 15 m {:.1} %, \
         disturbed {:.1} %\n",
        args.folder.display(),
        m.frames_wanted,
        dataset.shards.len(),
        dataset.torn.len(),
        m.state,
        m.town,
        m.seed,
        m.weathers.iter().map(|w| w.name()).collect::<Vec<_>>().join(", "),
        if m.keeps_camera { "kept" } else { "not kept" },
        boxes as f64 / frames.max(1) as f64,
        share(red),
        share(lead),
        share(pedestrian),
        share(disturbed),
    ))?;
    Ok(Exit::Done)
}
