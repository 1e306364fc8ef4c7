//! `wad-cosim bench tick`: the time of a tick, by stage.

use super::{Exit, answer, run};
use anyhow::Context;
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressDrawTarget};
use serde_json::{Map, Value, json};
use wad_cosim::agent::policy::find_encoder;
use wad_cosim::bench_tick::{TickBench, TickBenchError, TickBenchOptions, TickReport};
use wad_cosim::bundled;
use wad_cosim::camera::{CameraConfig, Instructions, Outputs, Preset};
use wad_cosim::drive::DriveOptions;
use wad_cosim::latent::Encoder;
use wad_cosim::perception::{self, DEFAULT_DETECTOR, DETECTORS, LeastScore};
use wad_cosim::traffic::TrafficSpec;

const EXAMPLES: &str = "\
Examples:
  wad-cosim bench tick
  wad-cosim bench tick town3 --traffic 100,250 --weather HardRainNoon --json
  wad-cosim bench tick my.sumocfg --traffic as-is --outputs all
  wad-cosim bench tick --detector eyes --cpu-features          (as on processors that have less)";

/// Measure a tick of the whole loop: autopilot, physics, SUMO, decoding, camera, perception.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A .sumocfg, a .net.xml(.gz) or a bundled town.
    #[arg(default_value = "town5")]
    config: String,
    /// Background traffic: as-is, empty, regular, dense, or VEHICLES,PEDESTRIANS.
    #[arg(long, default_value = "70,100", value_name = "T")]
    traffic: TrafficSpec,
    /// The camera's weather.
    #[arg(long, default_value = "ClearNoon", value_name = "NAME")]
    weather: Preset,
    /// The camera's size in pixels; weights see through the default one alone: other sizes take --detector truth or outlines,
    /// and --encoder pooled or none.
    #[arg(long, default_value = "512x512", value_name = "WxH", value_parser = super::snapshot::size)]
    size: (usize, usize),
    /// The camera's outputs.
    #[arg(long, value_enum, default_value_t = Made::Rgb)]
    outputs: Made,
    #[arg(long, help = format!("The detector: {DETECTORS}"), default_value = DEFAULT_DETECTOR, value_name = "NAME")]
    detector: String,
    /// The encoder: a .safetensors file, a folder of `train encoder`, a bundled encoder, or none.
    #[arg(long, default_value = "default", value_name = "NAME")]
    encoder: String,
    /// Do not run perception and encoder.
    #[arg(long, conflicts_with_all = ["detector", "encoder"])]
    no_perception: bool,
    /// Ticks to measure.
    #[arg(long, default_value_t = 600)]
    ticks: u64,
    /// Ticks of warm-up, not measured.
    #[arg(long, default_value_t = 120)]
    warm_up: u64,
    /// Seed of the traffic.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Measure once with each of these instruction sets: plain, avx2, avx512 [default without a list: all that this
    /// processor has]
    #[arg(long, value_name = "SETS", value_delimiter = ',', num_args = 0..=1, require_equals = true,
          default_missing_value = "avx512,avx2,plain", value_parser = Instructions::named)]
    cpu_features: Vec<Instructions>,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Made {
    /// The picture.
    Rgb,
    /// The picture with depth, semantic labels, instances and boxes.
    All,
}

/// Runs the command.
pub async fn run(args: Args) -> anyhow::Result<Exit> {
    if !args.cpu_features.is_empty() {
        return each_set(&args).await;
    }
    let config = bundled::resolve(&args.config).map_err(|e| Exit::Input.because(e))?;
    let scratch = tempfile::tempdir().context("cannot make a temporary folder")?;
    let detector = (!args.no_perception)
        .then(|| perception::detector(&args.detector, LeastScore::Usual))
        .transpose()
        .map_err(|e| Exit::Input.because(e))?;
    let encoder = if detector.is_some() { encoder(&args.encoder)? } else { None };
    let options = TickBenchOptions {
        detector,
        encoder,
        drive: DriveOptions::passing(config, args.seed, args.traffic, scratch.path()),
        camera: CameraConfig::sized(args.size.0, args.size.1),
        weather: args.weather,
        outputs: match args.outputs {
            Made::Rgb => Outputs::RGB,
            Made::All => Outputs::ALL,
        },
        warm_up: args.warm_up,
    };
    let mut interrupt = super::interrupt()?;
    let mut bench = TickBench::start(options).await.map_err(with_exit)?;
    let ticks = args.warm_up + args.ticks.max(1);
    // Hidden if stderr is not a terminal.
    let bar = ProgressBar::with_draw_target(Some(ticks), ProgressDrawTarget::stderr_with_hz(4));
    let mut interrupted = false;
    while bench.ticks_done() < ticks {
        tokio::select! {
            biased;
            () = interrupt.wait() => { interrupted = true; break; }
            ticked = bench.tick() => { ticked.map_err(with_exit)?; }
        }
        if bench.ticks_done() % 60 == 0 {
            bar.set_position(bench.ticks_done());
        }
    }
    bar.finish_and_clear();
    let report = bench.report();
    bench.finish().await.map_err(with_exit)?;
    match &report {
        Some(report) => show(report, args.json)?,
        None => super::note(format_args!("interrupted before the first measured tick")),
    }
    Ok(if interrupted { Exit::Interrupted } else { Exit::Done })
}

/// What the libraries call an instruction set: oneDNN (in OpenVINO), ATen and MKL (in libtorch).
fn library_names(set: Instructions) -> [(&'static str, &'static str); 3] {
    let [onednn, aten, mkl] = match set {
        Instructions::Plain => ["SSE41", "default", "SSE4_2"],
        Instructions::Avx2 => ["AVX2", "avx2", "AVX2"],
        Instructions::Avx512 => ["ALL", "avx512", "AVX512"],
    };
    [("ONEDNN_MAX_CPU_ISA", onednn), ("ATEN_CPU_CAPABILITY", aten), ("MKL_ENABLE_INSTRUCTIONS", mkl)]
}

/// The same measurement in a process for each instruction set, since libraries choose theirs when they are loaded.
async fn each_set(args: &Args) -> anyhow::Result<Exit> {
    let mut interrupt = super::interrupt()?;
    let program = std::env::current_exe().context("cannot find this program")?;
    let given = std::env::args_os().skip(1);
    let mut given: Vec<_> =
        given.filter(|arg| !arg.to_string_lossy().starts_with("--cpu-features")).collect();
    if !args.json {
        given.push("--json".into());
    }
    let mut rows = Vec::new();
    for &set in &args.cpu_features {
        if set > Instructions::of_processor() {
            super::note(format_args!("{}: this processor does not have it", set.name()));
            continue;
        }
        tracing::info!("{}", set.name());
        let child = tokio::process::Command::new(&program)
            .args(&given)
            .env(Instructions::VARIABLE, set.name())
            .envs(library_names(set))
            .stdin(std::process::Stdio::null())
            .kill_on_drop(true)
            .output();
        let output = tokio::select! {
            biased;
            () = interrupt.wait() => return Ok(Exit::Interrupted),
            output = child => output.context("cannot start this program again")?,
        };
        let report = output.stdout.split(|byte| *byte == b'\n').rfind(|line| !line.is_empty());
        let report = report.and_then(|line| serde_json::from_slice::<Map<String, Value>>(line).ok());
        let Some(mut row) = report.filter(|_| output.status.success()) else {
            let error = anyhow::anyhow!("{}: {}", set.name(), String::from_utf8_lossy(&output.stderr).trim());
            let ended = |exit: Exit| output.status.code() == Some(exit as i32);
            return Err(Exit::blamed(ended(Exit::Input), ended(Exit::Sumo)).because(error));
        };
        row.insert("cpu_features".to_owned(), json!(set.name()));
        rows.push(row);
    }
    answer(&table(&rows), args.json, &json!({ "rows": rows }))?;
    Ok(Exit::Done)
}

/// Stages down, instruction sets across (ms).
fn table(rows: &[Map<String, Value>]) -> String {
    let mut text = format!("{:>9}", "ms");
    for row in rows {
        text += &format!(" {:>9}", row["cpu_features"].as_str().unwrap_or_default());
    }
    let stages = rows.first().and_then(|row| row["stages"].as_object()).into_iter().flat_map(Map::keys);
    let mut line = |name: &str, of: &dyn Fn(&Map<String, Value>) -> Option<f64>| {
        text += &format!("\n{name:>9}");
        for row in rows {
            text += &of(row).map_or_else(|| format!(" {:>9}", "-"), |ms| format!(" {ms:>9.3}"));
        }
    };
    for stage in stages {
        line(stage, &|row| row["stages"].get(stage)?.as_f64());
    }
    line("total", &|row| row["total_ms"].as_f64());
    line("cpu", &|row| row.get("cpu_ms")?.as_f64());
    text + "\n"
}

fn encoder(name: &str) -> anyhow::Result<Option<Box<dyn Encoder>>> {
    if name == "none" {
        return Ok(None);
    }
    find_encoder(name).map(Some).map_err(|e| Exit::Input.because(e))
}

fn with_exit(error: TickBenchError) -> anyhow::Error {
    match error {
        TickBenchError::Drive(error) => run::with_exit(error),
        TickBenchError::Eyes(error) if error.is_input() => Exit::Input.because(error),
        TickBenchError::Eyes(error) => Exit::Other.because(error),
    }
}

fn show(report: &TickReport, json: bool) -> anyhow::Result<()> {
    let mut text = String::new();
    for (name, ms) in report.stages.medians() {
        let p95 = report.stages_p95.get(name).copied().unwrap_or(f64::NAN);
        text += &format!("{name:>9} {ms:>8.3} ms, 95 % below {p95:.3}\n");
    }
    text += &format!("{:>9} {:>8.3} ms, median of {} ticks", "total", report.total_ms, report.ticks);
    if let Some(cpu) = report.cpu_ms {
        text += &format!("; {cpu:.3} ms of processor time on average");
    }
    text.push('\n');
    answer(&text, json, report)
}
