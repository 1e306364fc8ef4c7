//! `wad-cosim bench view`: how much viewers slow down the simulation.

use super::film::Film;
use super::run::with_exit;
use super::view::{About, View, ViewArgs};
use super::{Exit, print};
use anyhow::Context;
use serde::Serialize;
use std::time::Instant;
use wad_cosim::bundled;
use wad_cosim::camera::Preset;
use wad_cosim::drive::{Drive, DriveOptions};
use wad_cosim::perception::{DEFAULT_DETECTOR, DETECTORS};
use wad_cosim::stats::{median, quantile};
use wad_cosim::traffic::TrafficSpec;
use wad_cosim::view::{Crowd, Listener, ViewAddress};

/// Measure ticks with no viewer, one viewer and many, in turns, so that other load affects all alike.
#[derive(clap::Args, Debug)]
#[command(after_help = "Example:\n  wad-cosim bench view --viewers 5 --json")]
pub struct Args {
    /// A .sumocfg, a .net.xml(.gz) or a bundled town.
    #[arg(default_value = "town5")]
    config: String,
    /// Background traffic: as-is, empty, regular, dense, or VEHICLES,PEDESTRIANS.
    #[arg(long, default_value = "70,100", value_name = "T")]
    traffic: TrafficSpec,
    /// Number of viewers in the largest case.
    #[arg(long, default_value_t = 20)]
    viewers: usize,
    /// Length of a tick in milliseconds; ticks run in real time.
    #[arg(long, default_value_t = 50.0, value_name = "MS")]
    tick_ms: f64,
    /// Measured ticks per turn.
    #[arg(long, default_value_t = 40)]
    ticks: usize,
    /// How often each case is measured, after one turn to warm up.
    #[arg(long, default_value_t = 5, value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..))]
    repeat: usize,
    #[arg(long, help = format!("The detector: {DETECTORS}"), default_value = DEFAULT_DETECTOR, value_name = "NAME")]
    detector: String,
    /// Seed of the traffic.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

/// The figures for one number of viewers.
#[derive(Debug, Default, Serialize)]
struct Row {
    viewers: usize,
    ticks: usize,
    /// From a tick's begin to its hand-over (ms): median and 95th percentile.
    tick_ms: f64,
    tick_p95_ms: f64,
    /// Of that: handing over.
    show_ms: f64,
    /// More than a tick without viewers (ms, and as a share).
    cost_ms: f64,
    share: f64,
    /// Share of the ticks that a viewer got as frames.
    frames_share: f64,
    /// From the end of a tick to its message at a viewer (ms).
    late_ms: f64,
    megabytes_per_second: f64,
}

#[derive(Default)]
struct Times {
    ticks: Vec<f64>,
    shows: Vec<f64>,
    late: Vec<f64>,
    frames: u64,
    bytes: u64,
    seconds: f64,
}

/// Ticks of warm-up after each change.
const SETTLE: usize = 10;

/// Runs the command.
pub async fn run(args: Args) -> anyhow::Result<Exit> {
    let config = bundled::resolve(&args.config).map_err(|e| Exit::Input.because(e))?;
    let scratch = tempfile::tempdir().context("cannot make a temporary folder")?;
    let any: ViewAddress = "127.0.0.1:0".parse().map_err(anyhow::Error::msg)?;
    let listener = Listener::bind(any, None)?;
    let address = listener.address();
    let mut options = DriveOptions::passing(config, args.seed, args.traffic, scratch.path());
    options.bridge.tick_ms = Some(args.tick_ms);
    let mut drive = Drive::start(options).await.map_err(with_exit)?;
    let about = About {
        seed: args.seed,
        agent: "autopilot",
        encoder: None,
        detector: &args.detector,
        mirrors: false,
        weather: Preset::ClearNoon,
        traffic: None,
        out: scratch.path(),
        recording: None,
    };
    let mut view = View::open(listener, &ViewArgs::at_real_time(), &drive, &about)?;
    let crowds = [0, 1, args.viewers];
    let mut times: [Times; 3] = Default::default();
    let mut interrupt = super::interrupt()?;
    let (mut film, mut interrupted) = (Film::default(), false);
    'turns: for turn in 0..=args.repeat {
        for (viewers, times) in crowds.iter().zip(&mut times) {
            let crowd = Crowd::watch(address, *viewers, view.cores())?;
            let began = Instant::now();
            for tick in 0..SETTLE + args.ticks {
                let control = tokio::select! {
                    () = interrupt.wait() => { interrupted = true; break 'turns; }
                    next = view.next(&mut drive, &mut film) => next.map_err(with_exit)?,
                };
                let clock = Instant::now();
                let status = drive.tick_with(control).await.map_err(with_exit)?;
                let driven = clock.elapsed();
                view.show(&drive, &status);
                let all = clock.elapsed();
                // The first turn warms up.
                if tick >= SETTLE && turn > 0 {
                    times.ticks.push(1000.0 * all.as_secs_f64());
                    times.shows.push(1000.0 * (all - driven).as_secs_f64());
                }
            }
            let seconds = began.elapsed().as_secs_f64();
            let got = crowd.leave();
            if turn > 0 {
                times.seconds += seconds;
                times.frames += got.frames;
                times.bytes += got.bytes;
                times.late.extend(got.late_ms);
            }
        }
        super::note(format_args!("turn {turn} of {} (turn 0 warms up)", args.repeat));
    }
    view.close();
    drive.finish(false).await.map_err(with_exit)?;
    let rows = rows(&crowds, &times, args.ticks);
    for row in &rows {
        let line = format!(
            "{:2} viewers: tick {:.2} ms (95 %: {:.2}), {:+.2} ms = {:+.1} %, handing over {:.3} ms; message after {:.0} ms, {:.0} % of the frames, {:.1} MB/s",
            row.viewers,
            row.tick_ms,
            row.tick_p95_ms,
            row.cost_ms,
            100.0 * row.share,
            row.show_ms,
            row.late_ms,
            100.0 * row.frames_share,
            row.megabytes_per_second
        );
        super::row(&line, args.json)?;
    }
    if args.json {
        print(&format!(
            "{}\n",
            serde_json::json!({ "config": args.config, "tick_ms": args.tick_ms, "rows": rows })
        ))?;
    }
    Ok(if interrupted { Exit::Interrupted } else { Exit::Done })
}

/// The figures for each number of viewers, `turn` ticks per turn.
fn rows(crowds: &[usize], times: &[Times], turn: usize) -> Vec<Row> {
    let alone = times.first().map_or(f64::NAN, |times| median(times.ticks.clone()));
    let per_turn = (SETTLE + turn) as f64 / turn as f64;
    let measured = crowds.iter().zip(times).filter(|(_, t)| !t.ticks.is_empty());
    let row = |(&viewers, t): (&usize, &Times)| {
        let tick_ms = median(t.ticks.clone());
        let wanted = viewers as f64 * t.ticks.len() as f64 * per_turn;
        Row {
            viewers,
            ticks: t.ticks.len(),
            tick_ms,
            tick_p95_ms: quantile(t.ticks.clone(), 0.95),
            show_ms: median(t.shows.clone()),
            cost_ms: tick_ms - alone,
            share: (tick_ms - alone) / alone,
            frames_share: if viewers == 0 { 0.0 } else { t.frames as f64 / wanted },
            late_ms: if t.late.is_empty() { 0.0 } else { median(t.late.clone()) },
            megabytes_per_second: t.bytes as f64 / 1e6 / t.seconds.max(1e-9),
        }
    };
    measured.map(row).collect()
}
