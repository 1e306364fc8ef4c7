//! `wad-cosim replay`: plays a kept episode as it was recorded, or simulates it again.

use super::progress::Bar;
use super::replay_look::{Looker, Row};
use super::{Exit, agents, print, row};
use clap::{ArgGroup, ValueHint};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use wad_cosim::agent::external::Limits;
use wad_cosim::assets::Assets;
use wad_cosim::eval::kept::Kept;
use wad_cosim::eval::verify::{self, Verdict, VerifyError};
use wad_cosim::record::{Codec, RecordView, Recorder};
use wad_cosim::replay::Recording;

const EXAMPLES: &str = "\
Examples:
  wad-cosim replay runs/nocrash/episodes/NAME                          print what happened
  wad-cosim replay runs/nocrash --view                                 all of them in the browser, with a timeline
  wad-cosim replay runs/nocrash/episodes/NAME --record film.mp4        a film, from behind
  wad-cosim replay runs/nocrash/episodes/NAME --record film.mp4 --record-view all
  wad-cosim replay runs/nocrash/episodes/NAME --detector eyes --last 5
                                                                       what it sees, and what is there
  wad-cosim replay runs/nocrash/episodes/NAME --gui                    simulated again in sumo-gui
  wad-cosim replay runs/nocrash/episodes/NAME --verify                 simulated again, every bit compared";

/// Show a kept episode as a film, in the browser or in sumo-gui, or verify it.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
#[command(group = ArgGroup::new("played").args(["record", "detector"]).multiple(true))]
pub struct Args {
    /// An episode's folder (`eval` keeps one of each failure); with --view also a folder that contains some.
    #[arg(value_name = "EPISODE", value_hint = ValueHint::DirPath)]
    episode: PathBuf,
    /// Film the recorded states: a .mp4 file, or a folder with a trailing / for numbered PNG pictures.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::AnyPath, conflicts_with = "view")]
    record: Option<PathBuf>,
    /// What the film shows: front, chase, bird, or all.
    #[arg(long, value_name = "VIEW", default_value = "chase", requires = "record")]
    record_view: RecordView,
    /// Codec of a .mp4 film: auto (H.264, else MPEG-4), h264, mp4v, or another four-character code.
    #[arg(long, value_name = "CODEC", default_value = "auto", requires = "record")]
    record_codec: Codec,
    #[command(flatten)]
    view: super::view::ViewArgs,
    /// Look at the recorded states through this detector: prints for each tick what it sees and what is there, and a film
    /// of all views (--record-view all) shows it.
    #[arg(long, value_name = "NAME", conflicts_with = "view")]
    detector: Option<String>,
    /// Film or look at only the last N seconds.
    #[arg(long, value_name = "SECONDS", requires = "played", conflicts_with = "view", value_parser = super::seconds)]
    last: Option<f64>,
    /// Simulate the episode again and compare every bit of every tick.
    #[arg(long, conflicts_with = "view")]
    verify: bool,
    /// Simulate the episode again in sumo-gui, in real time.
    #[arg(long, conflicts_with = "view")]
    gui: bool,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long, conflicts_with = "view")]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<Exit> {
    if args.view.view.is_some() {
        return super::replay_view::run(&args.episode, &args.view);
    }
    let (kept, recording) = Kept::open(&args.episode).map_err(|e| Exit::Input.because(e))?;
    let episode = &kept.episode;
    let text = format!(
        "{} in {}, {}, {}, {} traffic: {} after {:.1} s, {:.0} of {:.0} m: {}\n",
        episode.case.agent,
        episode.case.town,
        episode.case.task,
        episode.case.spec.weather.name(),
        episode.case.spec.traffic(),
        episode.ending.end,
        episode.ticks as f64 * episode.tick_s,
        episode.driven_m,
        episode.route_length_m,
        episode.ending.cause,
    );
    super::note(text.trim_end());
    if kept.build != env!("WAD_COSIM_VERSION") {
        super::note(format_args!("recorded by {}, this is {}", kept.build, env!("WAD_COSIM_VERSION")));
    }
    let mut answer = serde_json::json!({ "episode": episode, "ticks": recording.frames().len() - 1 });
    let mut exit = Exit::Done;
    if args.record.is_some() || args.detector.is_some() {
        let (rows, whole) = play(args, &kept, &recording)?;
        if !whole {
            exit = Exit::Interrupted;
        }
        if let Some(path) = &args.record {
            answer["record"] = path.display().to_string().into();
        }
        if args.detector.is_some() {
            answer["looks"] = serde_json::to_value(rows)?;
        }
    }
    if exit == Exit::Done && (args.verify || args.gui) {
        let verdict = again(args, &kept, &recording)?;
        exit = if verdict.same { Exit::Done } else { Exit::Other };
        let all = verdict.ticks == recording.frames().len() as u64;
        match &verdict.first_difference {
            None if all => {
                super::note(format_args!("simulated again: {} states, every bit the same", verdict.ticks))
            }
            None => {
                super::note(format_args!(
                    "interrupted after {} states, every bit the same so far",
                    verdict.ticks
                ));
                exit = Exit::Interrupted;
            }
            Some((tick, what)) => {
                super::note(format_args!("simulated again: it differs from tick {tick} on: {what}"))
            }
        }
        answer["verify"] = serde_json::to_value(&verdict)?;
    }
    if args.json {
        print(&format!("{answer}\n"))?;
    }
    Ok(exit)
}

fn with_exit(error: VerifyError) -> anyhow::Error {
    let exit = match &error {
        VerifyError::Env(env) => Exit::of_env(env),
        VerifyError::Lost { .. } => Exit::Sumo,
        VerifyError::Assets(assets) => Exit::of_assets(assets),
        _ => Exit::Input,
    };
    exit.because(error)
}

/// The time before what is shown that a detector looks already (s): it follows road users and lights from tick to tick.
const WARM_UP: f64 = 3.0;

/// The recorded states as a film, and as a detector sees them. False: it was interrupted, and the film ends there.
fn play(args: &Args, kept: &Kept, recording: &Recording) -> anyhow::Result<(Vec<Row>, bool)> {
    let header = recording.header();
    let assets = Assets::load(&header.config).map_err(|e| with_exit(e.into()))?;
    let fps = 1000.0 / header.tick_ms;
    let film = |path: &PathBuf| {
        Recorder::create(path, assets.town(), args.record_view, fps, args.record_codec, 0)
            .map_err(|e| Exit::Input.because(e))
    };
    let mut film = args.record.as_ref().map(film).transpose()?;
    let looker = |name: &String| Looker::new(kept, recording, &assets, name);
    let mut looker = args.detector.as_ref().map(looker).transpose()?;
    let frames = recording.frames();
    let shown = args.last.map_or(frames.len(), |s| ((s.max(0.0) * fps) as usize).min(frames.len()));
    let stop = crate::cli::interrupt()?.flag();
    let bar = Bar::new(shown as u64, "ticks");
    let first = frames.len() - shown;
    let looks_from = first.saturating_sub((WARM_UP * fps) as usize);
    let (mut rows, mut astray) = (Vec::new(), 0);
    if looker.is_some() {
        row(&Row::heads(), args.json)?;
    }
    for (index, frame) in frames.iter().enumerate() {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        // Earlier states are applied too: they move wheels and legs to their positions.
        if let Some(film) = &mut film {
            film.follow(&frame.world, &recording.ego_actor(frame));
        }
        if let Some(looker) = &mut looker {
            looker.follow(frame);
            let look = if index < looks_from { None } else { looker.look(frame)? };
            match look {
                Some(look) if index >= first => {
                    row(&look.to_string(), args.json)?;
                    rows.push(look);
                }
                None if index >= first => astray += 1,
                _ => {}
            }
        }
        if index < first {
            continue;
        }
        if let Some(film) = &mut film {
            film.add(&frame.ego.pose, header.weather, looker.as_ref().map(Looker::eyes))?;
        }
        bar.show((index + 1 - first) as u64, "");
    }
    bar.clear();
    if let Some(film) = film {
        film.finish()?;
    }
    let whole = !stop.load(Ordering::Relaxed);
    if astray > 0 {
        super::note(format_args!(
            "{astray} of {shown} states are not looked at: the ego is on another route than the recording tells (older builds did not write where a drive without an end goes on)"
        ));
    }
    if let Some(path) = &args.record {
        let cut = if whole { "" } else { ": interrupted, it ends there" };
        super::note(format_args!("{}{cut}", path.display()));
    }
    Ok((rows, whole))
}

/// Simulates the episode again.
fn again(args: &Args, kept: &Kept, recording: &Recording) -> anyhow::Result<Verdict> {
    let stop = crate::cli::interrupt()?.flag();
    let bar = Bar::new(recording.frames().len() as u64, "states");
    let make_agent = agents::maker(kept.options.camera, Limits::default());
    let tick = Duration::from_secs_f64(recording.header().tick_ms / 1000.0);
    let mut due = Instant::now();
    let verdict = verify::verify(kept, recording, &make_agent, args.gui, |at| {
        bar.show(at, "");
        if args.gui {
            due = (due + tick).max(Instant::now() - tick);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        !stop.load(Ordering::Relaxed)
    });
    bar.clear();
    verdict.map_err(with_exit)
}
