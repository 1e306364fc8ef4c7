//! `wad-cosim run`: drive through a town.

mod status;

use super::film::{Film, Wanted};
use super::view::{About, View, ViewArgs};
use super::{Exit, agents, config, print, seconds};
use anyhow::Context;
use clap::ValueHint;
use status::StatusLine;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use wad_cosim::assets::Assets;
use wad_cosim::bridge::BridgeOptions;
use wad_cosim::camera::Preset;
use wad_cosim::drive::{Drive, DriveError, DriveOptions, Status, Summary};
use wad_cosim::driver::{DriverSpec, Pilot};
use wad_cosim::interrupt::Interrupt;
use wad_cosim::latent::Decoder;
use wad_cosim::perception;
use wad_cosim::record::{Codec, RecordError, RecordView};
use wad_cosim::traci::process::SumoInstall;
use wad_cosim::traffic::TrafficSpec;
use wad_cosim::view::Listener;

const EXAMPLES: &str = "\
Examples:
  wad-cosim run town5                                       the town's own traffic, until Ctrl-C or the config's end
  wad-cosim run town5 --traffic dense --ticks 1200          70 vehicles and 150 pedestrians, 200 s
  wad-cosim run town3 --traffic 40,80 --seed 7 --gui        watch it in sumo-gui
  wad-cosim run town5 --view                                watch it in the browser, and drive
  wad-cosim run town5 --agent wad-t                         the trained agent drives
  wad-cosim run town5 --egos 20 --agent wad-t --view        twenty of it; the page follows any of them
  wad-cosim run town5 --perception --record see.mp4         film the camera, detections and reconstruction
  wad-cosim run my.sumocfg --route -E12,E7 --json           own net, from edge -E12 to edge E7, machine-readable
  wad-cosim run my.net.xml --attach 127.0.0.1:8813          join a running SUMO

Results go to runs/DATE-TOWN-SEED (or --out): config.json, telemetry.jsonl, summary.json, sumo/sumo.log.
Exit codes: 0 done; 2 usage or input; 3 SUMO failed; 4 interrupted, results kept; 1 anything else.";

/// Drive an ego vehicle through SUMO traffic, by autopilot, agent or hand.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A .sumocfg, a .net.xml(.gz), a scenario's folder, a bundled town (town3, town5, town7) or a shipped scenario.
    #[arg(value_hint = ValueHint::FilePath)]
    config: String,
    /// The driver: autopilot, wad-t, wad-s, wad-t-reward, wad-s-reward, a file that `train agent` wrote, constant, random,
    /// manual (with --view), or exec:COMMAND (docs/evaluate.md).
    #[arg(long, default_value = "autopilot", value_name = "NAME|FILE|exec:CMD", value_hint = ValueHint::FilePath)]
    agent: DriverSpec,
    /// Number of egos, each with a driver of that kind and a route of its own (with manual: the autopilot drives the others).
    /// Film, --perception and status line show the first one.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=200))]
    egos: u16,
    /// The agent's encoder [default: the one that it was trained with], and the encoder whose
    /// reconstruction --perception shows [default: the bundled one].
    #[arg(long, value_name = "NAME", value_hint = ValueHint::AnyPath)]
    encoder: Option<String>,
    /// Stop after N ticks [default: at the config's end time, or at Ctrl-C].
    #[arg(long, value_name = "N")]
    ticks: Option<u64>,
    /// Stop after this many simulation seconds.
    #[arg(long, value_name = "SECONDS", conflicts_with = "ticks", value_parser = seconds)]
    time: Option<f64>,
    /// Seed of everything random [default: the config's seed, or 0].
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Background traffic: as-is (the config's own), empty, regular, dense, or VEHICLES,PEDESTRIANS
    /// [default: as-is, or the scenario's].
    #[arg(long, value_name = "T")]
    traffic: Option<TrafficSpec>,
    /// First route (of the first ego), from one edge (or lane) to another; later destinations are random.
    #[arg(long, value_name = "FROM,TO", allow_hyphen_values = true)]
    route: Option<String>,
    /// Folder for the results.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: Option<PathBuf>,
    /// Length of a tick in milliseconds [default: the config's step-length, or 167].
    #[arg(long, value_name = "MS")]
    tick_ms: Option<f64>,
    /// Show the run in sumo-gui; its view follows the ego.
    #[arg(long)]
    gui: bool,
    /// Weather of camera and film, by CARLA's name [default: ClearNoon, or the scenario's].
    #[arg(long, value_name = "NAME")]
    weather: Option<Preset>,
    /// Film the run: a .mp4 file, or a folder with a trailing / for numbered PNG pictures. A .mcap file holds
    /// camera, boxes, map, traffic, pose and reward for Foxglove and Rerun.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::AnyPath)]
    record: Option<PathBuf>,
    /// What the film shows: front, chase, bird, or all.
    #[arg(long, value_name = "VIEW", default_value = "chase", requires = "record")]
    record_view: RecordView,
    /// Codec of a .mp4 film: auto (H.264, else MPEG-4), h264, mp4v, or another four-character code.
    #[arg(long, value_name = "CODEC", default_value = "auto", requires = "record")]
    record_codec: Codec,
    /// Run perception on the front camera: print its results, and film its stages (camera, detections,
    /// transformed image, reconstruction) below the view.
    #[arg(long)]
    perception: bool,
    #[arg(long, help = format!("The detector: {}", perception::DETECTORS), default_value = perception::DEFAULT_DETECTOR, value_name = "NAME")]
    detector: String,
    /// Cameras in place of the door mirrors look back before a change of lane; without them nobody sees who is beside the ego.
    #[arg(long)]
    mirrors: bool,
    /// Run no faster than real time.
    #[arg(long)]
    realtime: bool,
    #[command(flatten)]
    view: ViewArgs,
    /// Join a running SUMO (started with --remote-port) instead of starting one.
    #[arg(long, value_name = "HOST:PORT", conflicts_with = "gui")]
    attach: Option<String>,
    /// Fail if SUMO takes longer than this for one tick.
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0, value_parser = seconds)]
    tick_timeout: f64,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    super::runtime()?.block_on(drive(args))
}

async fn drive(args: Args) -> anyhow::Result<Exit> {
    let config = config::resolve(&args.config)?;
    let assets = town(&args, &config)?;
    let args = args.completed(&assets);
    let out = args.out.clone().unwrap_or_else(|| default_folder(&config, args.seed()));
    let listener = args.view.listen()?;
    if args.agent == DriverSpec::Manual && listener.is_none() {
        return Err(Exit::Input.because(anyhow::anyhow!(
            "--agent manual needs the live view to drive in: add --view, or choose another driver"
        )));
    }
    let pilots = pilots(&args, &assets)?;
    let options = args.options(config, &out, assets.scenario().is_some());
    let mut interrupt = super::interrupt()?;
    let started = tokio::select! {
        started = Drive::start_in(&assets, options, pilots, args.weather.unwrap_or_default()) => started,
        () = interrupt.wait() => {
            super::note(format_args!("interrupted before the first tick"));
            return Ok(Exit::Interrupted);
        }
    };
    let mut drive = started.map_err(with_exit)?;
    let limit = tick_limit(&args, &drive)?;
    let film = Film::begin(&mut drive, &args.wanted(), decoder(&args))?;
    let view = listener.map(|listener| open_view(listener, &args, &drive, &out)).transpose()?;
    let line = StatusLine::new(args.quiet_status(), limit);
    let mut watched = Watched { drive, film, view, line };
    let interrupted = match watched.ticks(limit, &args, &mut interrupt).await {
        Stop::Over => false,
        Stop::Interrupted => true,
        Stop::Failed(error) => return Err(watched.abort(error).await),
    };
    let (summary, filmed) = watched.finish(interrupted).await?;
    report(&summary, args.json)?;
    filmed?;
    Ok(if interrupted { Exit::Interrupted } else { Exit::Done })
}

/// Opens the live view of a run with its results in `out`.
fn open_view(listener: Listener, args: &Args, drive: &Drive, out: &Path) -> anyhow::Result<View> {
    let about = About {
        seed: args.seed(),
        agent: &args.agent.to_string(),
        encoder: args.encoder.as_deref(),
        detector: &args.detector,
        mirrors: args.mirrors,
        weather: args.weather.unwrap_or_default(),
        traffic: args.traffic.unwrap_or_default().counts(&drive.bridge().config().town()),
        out,
        recording: args.record.as_deref(),
    };
    View::open(listener, &args.view, drive, &about)
}

/// Why the ticks of a run stopped.
enum Stop {
    /// The limit, or the scenario's end.
    Over,
    Interrupted,
    Failed(anyhow::Error),
}

/// A drive with its film, live view and status line.
struct Watched {
    drive: Drive,
    film: Film,
    view: Option<View>,
    line: StatusLine,
}

impl Watched {
    /// Drives and shows tick by tick.
    async fn ticks(&mut self, limit: Option<u64>, args: &Args, interrupt: &mut Interrupt) -> Stop {
        let (began, tick) = (Instant::now(), self.drive.bridge().tick());
        let mut ticks = 0;
        while limit.is_none_or(|limit| ticks < limit) {
            let ticked = tokio::select! {
                biased;
                () = interrupt.wait() => return Stop::Interrupted,
                ticked = next_tick(&mut self.drive, &mut self.view, &mut self.film) => ticked,
            };
            let shown = ticked.map_err(with_exit).and_then(|status| self.show(&status, args.perception));
            if let Err(error) = shown {
                return Stop::Failed(error);
            }
            ticks += 1;
            if self.drive.ending().is_some() {
                break;
            }
            if args.realtime && self.view.is_none() {
                let due = began + Duration::from_secs_f64(ticks as f64 * tick);
                tokio::select! {
                    () = interrupt.wait() => return Stop::Interrupted,
                    () = tokio::time::sleep_until(due.into()) => {}
                }
            }
        }
        Stop::Over
    }

    /// Shows a tick in film, live view and status line.
    fn show(&mut self, status: &Status, perception: bool) -> anyhow::Result<()> {
        self.film.add(&mut self.drive, status)?;
        if let Some(view) = &mut self.view {
            view.show(&self.drive, status);
        }
        self.line.show(status, self.drive.eyes().percept().filter(|_| perception));
        Ok(())
    }

    /// Ends film, view and SUMO, and writes the summary, also of a run whose film cannot be completed.
    async fn finish(self, interrupted: bool) -> anyhow::Result<(Summary, Result<(), RecordError>)> {
        let Self { drive, mut film, view, line } = self;
        line.clear();
        if let Some(view) = view {
            view.close();
        }
        let filmed = film.end();
        Ok((drive.finish(interrupted).await.map_err(with_exit)?, filmed))
    }

    /// Ends after `error`: the results so far stay readable, with a summary that says how the run ended.
    async fn abort(self, error: anyhow::Error) -> anyhow::Error {
        self.line.clear();
        if let Some(view) = self.view {
            view.close();
        }
        if let Err(second) = self.drive.abort().await {
            super::note(format_args!("wad-cosim: {second}"));
        }
        error
    }
}

/// One tick when it is due: at once, or with a live view at the viewers' pace and with their control.
async fn next_tick(
    drive: &mut Drive,
    view: &mut Option<View>,
    film: &mut Film,
) -> Result<Status, DriveError> {
    let control = match view {
        Some(view) => view.next(drive, film).await?,
        None => None,
    };
    drive.tick_with(control).await
}

/// The town; with its scenario, if CONFIG is one and no --route replaces its route.
fn town(args: &Args, config: &Path) -> anyhow::Result<Arc<Assets>> {
    if args.attach.is_none() {
        // Checked first: a SUMO that is too old should not fail with an unreadable list of options.
        let install = SumoInstall::find().map_err(|e| Exit::Sumo.because(e))?;
        install.check_version().map_err(|e| Exit::Sumo.because(e))?;
    }
    let plays = args.route.is_none() && args.attach.is_none();
    Assets::open(config, plays).map_err(|e| with_exit(e.into()))
}

/// The drivers. The live view shows the same camera frames that they get.
fn pilots(args: &Args, assets: &Assets) -> anyhow::Result<Vec<Pilot>> {
    let mut first =
        agents::pilot(assets, &args.agent, args.encoder.as_deref(), &args.detector, args.mirrors)?;
    if let Some(decoder) = decoder(args).filter(|_| first.driver.looks()) {
        first.eyes = first.eyes.with_decoder(decoder);
    }
    let mut pilots = vec![first];
    for _ in 1..args.egos {
        pilots.push(match &args.agent {
            // A person has one wheel.
            DriverSpec::Manual => Pilot::autopilot(),
            spec => agents::pilot(assets, spec, args.encoder.as_deref(), &args.detector, args.mirrors)?,
        });
    }
    Ok(pilots)
}

/// With --perception: the decoder for the reconstruction, of the agent's encoder.
fn decoder(args: &Args) -> Option<Box<dyn Decoder>> {
    let encoder = || agents::sees_through(args.encoder.as_deref(), Some(&args.agent.to_string()));
    args.perception.then(|| agents::decoder(&encoder())).flatten()
}

impl Args {
    /// With the config's seed, and the scenario's weather and traffic, for those that the command line leaves open.
    fn completed(mut self, assets: &Assets) -> Self {
        self.seed = self.seed.or(assets.seed());
        if let Some(scenario) = assets.scenario() {
            self.weather = self.weather.or(Some(scenario.weather));
            self.traffic = self.traffic.or(Some(scenario.traffic));
        }
        self
    }

    fn seed(&self) -> u64 {
        self.seed.unwrap_or(0)
    }

    /// The drive's options, with results in `out`.
    fn options(&self, config: PathBuf, out: &Path, scenario: bool) -> DriveOptions {
        DriveOptions {
            bridge: BridgeOptions {
                seed: self.seed(),
                tick_ms: self.tick_ms,
                traffic: self.traffic.unwrap_or_default(),
                scenario,
                gui: self.gui,
                attach: self.attach.clone(),
                tick_timeout: self.tick_timeout,
                ..BridgeOptions::new(config, out.join("sumo"))
            },
            route: self.route.clone(),
            egos: usize::from(self.egos),
            out: out.to_path_buf(),
            ego: Default::default(),
            autopilot: Default::default(),
            criteria: Default::default(),
        }
    }

    /// The options of film and perception.
    fn wanted(&self) -> Wanted<'_> {
        Wanted {
            path: self.record.as_deref(),
            view: self.record_view,
            codec: self.record_codec,
            perception: self.perception,
            detector: &self.detector,
        }
    }

    fn quiet_status(&self) -> bool {
        !std::io::stderr().is_terminal()
    }
}

/// `runs/20261121-093000-town5-0` under the current folder.
fn default_folder(config: &Path, seed: u64) -> PathBuf {
    let name = config.file_name().map(|f| f.to_string_lossy().to_string()).unwrap_or_default();
    let town = name.split('.').next().unwrap_or("net").to_string();
    let base = PathBuf::from("runs").join(format!("{}-{town}-{seed}", wad_cosim::clock::timestamp()));
    let mut folder = base.clone();
    let mut copy = 1;
    while folder.exists() {
        copy += 1;
        folder =
            base.with_file_name(format!("{}-{copy}", base.file_name().unwrap_or_default().to_string_lossy()));
    }
    folder
}

/// Number of ticks to drive: from the options, else to the config's end, else unlimited.
fn tick_limit(args: &Args, drive: &Drive) -> anyhow::Result<Option<u64>> {
    if args.ticks.is_some() {
        return Ok(args.ticks);
    }
    let bridge = drive.bridge();
    let seconds = match args.time {
        Some(seconds) => Some(seconds),
        None => {
            let end = bridge.config().time("end").map_err(|e| Exit::Input.because(e))?;
            end.map(|end| end - bridge.time()).filter(|left| *left > 0.0)
        }
    };
    Ok(seconds.map(|seconds| (seconds / bridge.tick()).round().max(0.0) as u64))
}

pub fn with_exit(error: DriveError) -> anyhow::Error {
    Exit::of_drive(&error).because(error)
}

fn report(summary: &Summary, json: bool) -> anyhow::Result<()> {
    let s = summary;
    let text = format!(
        "{}: {} ticks ({:.1} s) in {:.1} s, {:.0} ticks/s\n\
         distance {:.0} m, mean speed {:.1} m/s ({:.1} m/s when free), destinations {}\n\
         collisions: {} vehicle, {} pedestrian, {} static (caused: {}, {}, {}); red lights run {}; \
         outside lane {} ticks; blocked {}\n\
         traffic: {:.1} vehicles, {:.1} pedestrians on average\n\
         {}{}results in {}\n",
        s.town,
        s.ticks,
        s.sim_seconds,
        s.wall_seconds,
        s.ticks_per_second,
        s.distance_m,
        s.mean_speed_mps,
        s.mean_free_speed_mps,
        s.destinations_reached,
        s.collisions.vehicle,
        s.collisions.pedestrian,
        s.collisions.fixed,
        s.collisions_caused.vehicle,
        s.collisions_caused.pedestrian,
        s.collisions_caused.fixed,
        s.red_lights_run,
        s.outside_lane_ticks,
        s.vehicle_blocked,
        s.vehicles_mean,
        s.pedestrians_mean,
        if s.egos.is_empty() {
            String::new()
        } else {
            format!(
                "all of that for {} egos together; {} of the collisions were with each other\n",
                s.egos.len(),
                s.collisions_among_egos
            )
        },
        s.success.map_or(String::new(), |success| format!(
            "scenario: {}, ended by {}: {}\n",
            if success { "success" } else { "failure" },
            s.end,
            s.cause.as_deref().unwrap_or_default(),
        )),
        s.out.display(),
    );
    if json {
        super::note(text.trim_end());
        print(&format!("{}\n", serde_json::to_string(summary).context("cannot write the summary as JSON")?))
    } else {
        print(&text)
    }
}
