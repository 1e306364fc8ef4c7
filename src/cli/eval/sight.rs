//! `wad-cosim eval lanes` and `eval lead`: scores perception while the autopilot drives.

use crate::cli::progress::Bar;
use crate::cli::{Exit, print, run};
use anyhow::Context;
use wad_cosim::bundled;
use wad_cosim::camera::{CameraConfig, Frame, Outputs, Preset};
use wad_cosim::drive::{Drive, DriveOptions};
use wad_cosim::eyes::Eyes;
use wad_cosim::perception::sight_score::{self, LaneScore, LaneTruth, LeadReport, LeadScore, MEASURED_AT};
use wad_cosim::perception::{self, DETECTORS, EgoFacts, NearGaps, Perception};
use wad_cosim::traffic::TrafficSpec;
use wad_cosim::world::WorldState;

/// Score lane detection: precision, recall and lateral error, by weather.
#[derive(clap::Args, Debug)]
#[command(after_help = "\
Examples:
  wad-cosim eval lanes
  wad-cosim eval lanes town3 --ticks 2000 --weather ClearNoon,HardRainNoon --json")]
pub struct Lanes {
    /// Weathers, separated by commas.
    #[arg(
        long,
        value_name = "NAMES",
        value_delimiter = ',',
        default_value = "ClearNoon,CloudyNoon,SoftRainNoon,WetCloudySunset,MidRainyNoon,HardRainNoon"
    )]
    weather: Vec<Preset>,
    #[command(flatten)]
    drive: Args,
}

/// Score the estimates of who is in front and who will cross the path: gap and closing speed, by distance.
#[derive(clap::Args, Debug)]
#[command(after_help = "\
Examples:
  wad-cosim eval lead --detector truth:faulty
  wad-cosim eval lead --detector eyes --near          (from 0.2 to 5 m behind whoever is next)")]
pub struct Lead {
    /// The weather.
    #[arg(long, value_name = "NAME", default_value = "ClearNoon")]
    weather: Preset,
    /// Look each time from 0.2 to 5 m behind whoever is next in the ego's path, nearer than the autopilot drives.
    #[arg(long)]
    near: bool,
    #[command(flatten)]
    drive: Args,
}

/// Options of both commands.
#[derive(clap::Args, Debug)]
struct Args {
    /// A .sumocfg, a .net.xml(.gz) or a bundled town.
    #[arg(default_value = "town5")]
    config: String,
    /// Ticks to drive; ticks at standstill do not count.
    #[arg(long, value_name = "N", default_value_t = 1200)]
    ticks: u64,
    /// Background traffic: empty, regular, dense, or VEHICLES,PEDESTRIANS.
    #[arg(long, default_value = "regular", value_name = "T")]
    traffic: TrafficSpec,
    #[arg(long, default_value = "truth", value_name = "NAME", help = format!("The detector: {DETECTORS}"))]
    detector: String,
    /// WIDTHxHEIGHT of the camera's picture in pixels.
    #[arg(long, value_name = "WxH", default_value = "512x512", value_parser = crate::cli::snapshot::size)]
    size: (usize, usize),
    /// Seed of everything random.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

/// Drives, and passes each weather's percept to `score` after every tick; `near`: from close behind whoever is next.
async fn drive(
    args: &Args,
    weathers: &[Preset],
    near: bool,
    outputs: Outputs,
    score: &mut dyn FnMut(usize, &Frame, &Perception, &EgoFacts<'_>, &WorldState),
) -> anyhow::Result<()> {
    let config = bundled::resolve(&args.config).map_err(|e| Exit::Input.because(e))?;
    let scratch = tempfile::tempdir().context("cannot make a temporary folder")?;
    let (width, height) = args.size;
    let detectors =
        weathers.iter().map(|_| perception::detector(&args.detector, perception::LeastScore::Usual));
    let detectors: Vec<_> = detectors.collect::<Result<_, _>>().map_err(|e| Exit::Input.because(e))?;
    let mut drive = Drive::start(DriveOptions::passing(config, args.seed, args.traffic, scratch.path()))
        .await
        .map_err(run::with_exit)?;
    let mut eyes = Vec::new();
    for (&weather, detector) in weathers.iter().zip(detectors) {
        let look = Eyes::new(drive.assets().town(), CameraConfig::sized(width, height), detector)
            .map_err(|e| Exit::Input.because(e))?;
        let mut look = look.with_outputs(outputs);
        look.reset(weather, args.seed);
        eyes.push(look);
    }
    let bar = Bar::new(args.ticks, "ticks");
    let mut respawns = 0;
    let mut gaps = NearGaps::new(args.seed);
    for tick in 0..args.ticks {
        drive.tick().await.map_err(run::with_exit)?;
        bar.show(tick + 1, "");
        let now = drive.respawns();
        let world = drive.ego().world();
        let mut facts = EgoFacts::of(drive.bridge().network(), drive.ego(), drive.bridge().tick());
        if near {
            let Some(next) = sight_score::nearest_in_front(&facts, world, |_| true) else { continue };
            facts = facts.moved(next.gap - gaps.draw());
        }
        for (index, (eyes, &weather)) in eyes.iter_mut().zip(weathers).enumerate() {
            if near || now != respawns {
                eyes.reset(weather, args.seed);
            }
            eyes.follow(world);
            eyes.look(&facts)?;
            if let (Some(frame), Some(perception)) = (eyes.frame(), eyes.perception()) {
                score(index, frame, perception, &facts, world);
            }
        }
        respawns = now;
    }
    bar.clear();
    drive.finish(false).await.map_err(run::with_exit)?;
    Ok(())
}

/// Below this speed (m/s) the ego counts as standing: its next frame is like the last.
const STANDS: f64 = 0.3;

/// `eval lanes`.
pub async fn lanes(Lanes { weather, drive: args }: Lanes) -> anyhow::Result<Exit> {
    let mut scores = vec![LaneScore::default(); weather.len()];
    let outputs = Outputs { semantic: true, ..Outputs::RGB };
    drive(&args, &weather, false, outputs, &mut |index, frame, perception, facts, _| {
        if facts.on_route.state.speed > STANDS
            && let Some(truth) = LaneTruth::find(facts, perception.ground(), frame)
        {
            scores[index].add(&perception.percept().lanes, &truth);
        }
    })
    .await?;
    let say = |line: &str| crate::cli::row(line, args.json);
    say(&format!(
        "lane boundaries at {MEASURED_AT} m, {} at {}x{}, seed {}\n{:>16} {:>7} {:>8} {:>10} {:>7} {:>11} {:>9} {:>7} {:>7}",
        args.config,
        args.size.0,
        args.size.1,
        args.seed,
        "weather",
        "frames",
        "painted",
        "precision",
        "recall",
        "with hidden",
        "median m",
        "p90 m",
        "bias m"
    ))?;
    let mut rows = Vec::new();
    for (preset, score) in weather.iter().zip(&scores) {
        let r = score.report();
        say(&format!(
            "{:>16} {:>7} {:>8} {:>10} {:>7} {:>11} {:>9} {:>7} {:>7}",
            preset.name(),
            r.frames,
            r.painted,
            number(r.precision, 3),
            number(r.recall, 3),
            number(r.recall_hidden_too, 3),
            number(r.lateral_error.median, 3),
            number(r.lateral_error.p90, 3),
            number(r.bias, 3)
        ))?;
        rows.push(serde_json::json!({ "weather": preset.name(), "lanes": r }));
    }
    finish(&args, serde_json::json!({ "measured_at_m": MEASURED_AT, "rows": rows }))
}

/// `eval lead`.
pub async fn lead(Lead { weather, near, drive: args }: Lead) -> anyhow::Result<Exit> {
    let (mut lead, mut crossing) = (LeadScore::default(), LeadScore::default());
    let outputs = Outputs { boxes: true, ..Outputs::RGB };
    drive(&args, &[weather], near, outputs, &mut |_, frame, perception, facts, world| {
        if near || facts.on_route.state.speed > STANDS {
            let percept = perception.percept();
            let there = sight_score::in_front(facts, world, frame);
            let (crosses, unseen) = sight_score::who_crosses(facts, world, frame);
            tracing::debug!("in front: {there:?} there, will cross: {crosses:?} there");
            lead.add(there, percept.lead);
            if crosses.is_some() || !unseen {
                crossing.add(crosses, percept.crossing);
            }
        }
    })
    .await?;
    let (lead, crossing) = (lead.report(), crossing.report());
    let head = format!("detector {}, {}, seed {}, {}", args.detector, args.config, args.seed, weather.name());
    say_leads(&args, &format!("vehicle in front, {head}"), &lead, "in the path")?;
    if !near {
        say_leads(&args, "who will cross the path", &crossing, "to cross")?;
    }
    let (weather, detector) = (weather.name(), &args.detector);
    let result =
        serde_json::json!({ "weather": weather, "detector": detector, "lead": lead, "crossing": crossing });
    finish(&args, result)
}

fn say_leads(args: &Args, title: &str, report: &LeadReport, place: &str) -> anyhow::Result<()> {
    let say = |line: &str| crate::cli::row(line, args.json);
    say(&format!(
        "{title}\n{:>9} {:>7} {:>7} {:>10} {:>7} {:>7} {:>13} {:>8}",
        "gap m", "frames", "recall", "gap err m", "p90 m", "bias m", "closing m/s", "p90 m/s"
    ))?;
    for bin in &report.bins {
        say(&format!(
            "{:>9} {:>7} {:>7} {:>10} {:>7} {:>7} {:>13} {:>8}",
            format!("{:.0}-{:.0}", bin.from, bin.to),
            bin.frames,
            number(bin.recall, 3),
            number(bin.gap_error.median, 2),
            number(bin.gap_error.p90, 2),
            number(bin.gap_bias, 2),
            number(bin.closing_error.median, 2),
            number(bin.closing_error.p90, 2)
        ))?;
    }
    say(&format!(
        "nobody {place} in {} frames, somebody reported in {} of them",
        report.free_frames,
        number(report.false_leads.map(|share| 100.0 * share), 1) + " %"
    ))
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_string(), |v| format!("{v:.digits$}"))
}

fn finish(args: &Args, mut result: serde_json::Value) -> anyhow::Result<Exit> {
    if let Some(fields) = result.as_object_mut() {
        fields.insert("config".into(), args.config.clone().into());
        fields.insert("seed".into(), args.seed.into());
        fields.insert("ticks".into(), args.ticks.into());
    }
    if args.json {
        print(&format!("{result}\n"))?;
    }
    Ok(Exit::Done)
}
