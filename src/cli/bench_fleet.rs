//! `wad-cosim bench fleet`: many egos in one SUMO.

use super::agents::default_encoder;
use super::{Exit, print};
use clap::ValueHint;
use std::path::{Path, PathBuf};
use std::time::Instant;
use wad_cosim::assets::Assets;
use wad_cosim::bench::{peak_memory_mb, reset_peak_memory};
use wad_cosim::bridge::Fetch;
use wad_cosim::cores::workers;
use wad_cosim::env::{EnvError, EnvOptions, Fleet, ObservationMode, Stages};
use wad_cosim::eval::report::{Chart, Line};
use wad_cosim::latent::{Encoder, PooledEncoder};
use wad_cosim::observation::{LEAD_NEARNESS, LIGHT_NEARNESS, RAW_SIZE};
use wad_cosim::session::Act;
use wad_cosim::tasks::{TaskKind, TaskSpec};
use wad_cosim::traffic::TrafficSpec;
use wad_cosim::vehicle::Control;

const EXAMPLES: &str = "\
Examples:
  wad-cosim bench fleet
  wad-cosim bench fleet --egos 50 --observation camera --seconds 20
  wad-cosim bench fleet --egos 1,8 --fetch around --json
  wad-cosim bench fleet city.net.xml --egos 50 --traffic 100,0 --traffic 1000,0 --plot population.svg

Milliseconds are per tick of the whole fleet. Egos follow their routes by their raw states, and begin anew
elsewhere when their episode ends; `rest` holds those returns, reward and criteria. `vehicles` and
`pedestrians` are those of the background at the end: a net may have no room for all that were asked for.
`memory MB` is the most that this process, without SUMO, held during the row.";

/// Measure many egos in one SUMO: time of a tick by stage, agent-steps per second, memory.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A .sumocfg, a .net.xml(.gz) or a bundled town.
    #[arg(default_value = "town5")]
    config: String,
    /// Numbers of egos, separated by commas.
    #[arg(long, value_delimiter = ',', default_value = "1,4,16,50", value_parser = clap::value_parser!(u32).range(1..=1000))]
    egos: Vec<u32>,
    /// VEHICLES,PEDESTRIANS in the background; may be given several times.
    #[arg(long, value_name = "V,P", default_value = "70,100")]
    traffic: Vec<TrafficSpec>,
    /// What each ego observes.
    #[arg(long, value_enum, default_value_t = Observe::Vector)]
    observation: Observe,
    /// How road users in sight are fetched.
    #[arg(long, value_enum, default_value_t = FetchChoice::Auto)]
    fetch: FetchChoice,
    /// Seconds to measure, for each number of egos.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Draw the tick by stage over the vehicles where --traffic is given several times, else over the egos, as SVG.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    plot: Option<PathBuf>,
    /// Seed of everything random.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
enum Observe {
    /// The surroundings as numbers; no camera.
    Vector,
    /// Camera, perception and encoder.
    Camera,
}

#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
enum FetchChoice {
    /// The cheaper one.
    Auto,
    /// SUMO searches round each ego.
    Around,
    /// All that moves, once.
    Once,
}

#[derive(serde::Serialize)]
struct Row {
    egos: u32,
    vehicles: usize,
    pedestrians: usize,
    observation: &'static str,
    ticks: u64,
    tick_ms: f64,
    agent_steps_per_s: f64,
    sumo_ms: f64,
    physics_ms: f64,
    camera_ms: f64,
    perception_ms: f64,
    encoder_ms: f64,
    rest_ms: f64,
    episodes: u64,
    ego_collisions: usize,
    memory_mb: Option<f64>,
}

/// Ticks before the measurement.
const WARM_UP: u64 = 60;

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<Exit> {
    let assets = Assets::load(&args.config).map_err(|e| Exit::of_assets(&e).because(e))?;
    let say = |line: &str| super::row(line, args.json);
    say(&format!(
        "{:>5} {:>8} {:>11} {:>9} {:>14} {:>9} {:>11} {:>10} {:>13} {:>11} {:>8} {:>9} {:>9}",
        "egos",
        "vehicles",
        "pedestrians",
        "tick ms",
        "agent-steps/s",
        "sumo ms",
        "physics ms",
        "camera ms",
        "perception ms",
        "encoder ms",
        "rest ms",
        "episodes",
        "memory MB"
    ))?;
    let mut rows = Vec::new();
    for (&traffic, &egos) in
        args.traffic.iter().flat_map(|traffic| args.egos.iter().map(move |n| (traffic, n)))
    {
        let row = measure(args, &assets, traffic, egos)?;
        say(&format!(
            "{:>5} {:>8} {:>11} {:>9.3} {:>14.0} {:>9.3} {:>11.3} {:>10.3} {:>13.3} {:>11.3} {:>8.3} {:>9} {:>9.0}",
            row.egos,
            row.vehicles,
            row.pedestrians,
            row.tick_ms,
            row.agent_steps_per_s,
            row.sumo_ms,
            row.physics_ms,
            row.camera_ms,
            row.perception_ms,
            row.encoder_ms,
            row.rest_ms,
            row.episodes,
            row.memory_mb.unwrap_or(0.0)
        ))?;
        rows.push(row);
    }
    if args.json {
        print(&format!("{}\n", serde_json::json!({ "town": args.config, "rows": rows })))?;
    }
    if let Some(path) = &args.plot {
        draw(&rows, args.traffic.len() > 1, path)?;
    }
    Ok(Exit::Done)
}

/// The tick and its stages over the vehicles, or over the egos.
fn draw(rows: &[Row], by_vehicles: bool, path: &Path) -> anyhow::Result<()> {
    let place = |row: &Row| if by_vehicles { row.vehicles as f64 } else { f64::from(row.egos) };
    let line = |name: &str, value: &dyn Fn(&Row) -> f64| Line {
        name: name.to_string(),
        points: rows.iter().map(|row| (place(row), value(row))).collect(),
        band: Vec::new(),
    };
    let looks = |row: &Row| row.camera_ms + row.perception_ms + row.encoder_ms;
    let mut lines = vec![
        line("whole tick", &|row| row.tick_ms),
        line("SUMO", &|row| row.sumo_ms),
        line("physics", &|row| row.physics_ms),
        line("rest", &|row| row.rest_ms),
    ];
    if rows.iter().any(|row| looks(row) > 0.1) {
        lines.push(line("camera, perception, encoder", &looks));
    }
    let egos = rows.first().map_or(0, |row| row.egos);
    let (title, x) = if by_vehicles {
        (format!("A tick of {egos} egos in one SUMO"), "vehicles in the background")
    } else {
        ("A tick of many egos in one SUMO".to_string(), "egos")
    };
    let chart = Chart { title, x: x.to_string(), y: "ms per tick".to_string(), lines };
    super::save(path, &chart.svg())
}

fn measure(
    args: &Args,
    assets: &std::sync::Arc<Assets>,
    traffic: TrafficSpec,
    egos: u32,
) -> anyhow::Result<Row> {
    reset_peak_memory();
    let (observation, detector) = match args.observation {
        Observe::Vector => (ObservationMode::Vector, "outlines"),
        Observe::Camera => (ObservationMode::LatentAndRaw, "truth"),
    };
    let fetch = match args.fetch {
        FetchChoice::Auto => Fetch::Auto,
        FetchChoice::Around => Fetch::Around,
        FetchChoice::Once => Fetch::Once,
    };
    let options = EnvOptions { observation, detector: detector.to_string(), fetch, ..EnvOptions::training() };
    let encoder = || match args.observation {
        Observe::Vector => Ok(Box::new(PooledEncoder) as Box<dyn Encoder>),
        Observe::Camera => default_encoder(None),
    };
    let encoders: Result<Vec<_>, _> = (0..egos).map(|_| encoder()).collect();
    let encoders = encoders.map_err(|e| Exit::Input.because(e))?;
    let failed = |error: EnvError| Exit::of_env(&error).because(error);
    let mut fleet = Fleet::new(std::sync::Arc::clone(assets), options, encoders).map_err(failed)?;
    let task = TaskSpec { traffic: Some(traffic), ..TaskSpec::new(TaskKind::Composite) };
    fleet.reset(&[task], args.seed).map_err(failed)?;
    let mut acts = vec![Act::Stay; fleet.egos()];
    let (mut ticks, mut episodes, mut ego_collisions) = (0, 0, 0);
    let mut background = (0, 0);
    let mut since: Option<(Instant, Stages)> = None;
    loop {
        let size = fleet.observation_size();
        for (act, row) in acts.iter_mut().zip(fleet.observations().chunks_exact(size)) {
            *act = Act::Control(follow(&row[size - RAW_SIZE..]));
        }
        let step = fleet.step(&acts).map_err(failed)?;
        background = step.infos.last().map_or(background, |info| info.traffic);
        if let Some((clock, _)) = &since {
            episodes += step.began.iter().filter(|began| **began).count() as u64;
            ego_collisions += step.ego_collisions();
            if clock.elapsed().as_secs_f64() >= args.seconds {
                break;
            }
        } else if ticks >= WARM_UP {
            since = Some((Instant::now(), fleet.stages()));
            ticks = 0;
        }
        ticks += 1;
    }
    let (clock, before) = since.unwrap_or_else(|| (Instant::now(), Stages::default()));
    let (seconds, after) = (clock.elapsed().as_secs_f64(), fleet.stages());
    let per_tick = |total: f64| 1000.0 * total / ticks.max(1) as f64;
    let [sumo_ms, physics_ms] = [after.sumo - before.sumo, after.physics - before.physics].map(per_tick);
    let looks =
        [after.camera - before.camera, after.perception - before.perception, after.encoder - before.encoder];
    // Summed over the egos, which look on all cores.
    let cores = workers(fleet.egos()) as f64;
    let [camera_ms, perception_ms, encoder_ms] = looks.map(|total| per_tick(total) / cores);
    let tick_ms = per_tick(seconds);
    let row = Row {
        egos,
        vehicles: background.0,
        pedestrians: background.1,
        observation: if args.observation == Observe::Vector { "vector" } else { "camera" },
        ticks,
        tick_ms,
        agent_steps_per_s: 1000.0 * f64::from(egos) / tick_ms,
        sumo_ms,
        physics_ms,
        camera_ms,
        perception_ms,
        encoder_ms,
        rest_ms: tick_ms - sumo_ms - physics_ms - camera_ms - perception_ms - encoder_ms,
        episodes,
        ego_collisions,
        memory_mb: peak_memory_mb(),
    };
    fleet.close();
    Ok(row)
}

/// Drives along the route at 8 m/s, slower in bends; stops behind others and at lights: by the fifteen raw numbers.
fn follow(raw: &[f32]) -> Control {
    let number = |index: usize| f64::from(raw[index]);
    // Nearness 0.5 is 6 m.
    let near = number(LEAD_NEARNESS).max(number(LIGHT_NEARNESS));
    let wanted = (8.0 - 8.0 * number(10).abs()).max(3.0) * (1.0 - ((near - 0.25) / 0.3).clamp(0.0, 1.0));
    let error = wanted - 15.0 * number(0);
    Control {
        throttle: (0.3 * error).clamp(0.0, 1.0),
        brake: (-0.3 * error).clamp(0.0, 1.0),
        steer: (1.3 * number(9)).clamp(-1.0, 1.0),
        reverse: false,
    }
}
