//! `wad-cosim net`: inspects, builds, imports and enriches nets.

use super::{Exit, answer};
use clap::{Subcommand, ValueHint};
use std::path::{Path, PathBuf};
use wad_cosim::bundled;
use wad_cosim::nets::{self, Facts, Made, NetError, Wanted};
use wad_cosim::network::{Network, Shapes};
use wad_cosim::sumo_config::{OptionSchema, SumoConfig};
use wad_cosim::traci::process::SumoInstall;

const EXAMPLES: &str = "\
Examples:
  wad-cosim net info town5                               what it has, and what is missing
  wad-cosim net import helsinki.osm --out helsinki       OpenStreetMap with its buildings
  wad-cosim net import Town04.xodr --out town04          OpenDRIVE, e.g. CARLA's towns
  wad-cosim net enrich Town04.net.xml --out new.net.xml  add signals, sidewalks, crossings
  wad-cosim net build my.netccfg --out my                from plain sources
  wad-cosim run helsinki                                 and drive";

/// Inspect, build, import and enrich nets.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Print facts about a net, its problems, and the command that fixes each.
    Info(Info),
    /// Build a net from plain sources (.netccfg, or .nod.xml, .edg.xml, ...).
    Build(Make),
    /// Import OpenDRIVE (.xodr), OpenStreetMap (.osm) or a SUMO net.
    Import(Make),
    /// Add missing signals, sidewalks and crossings to a net; its lanes keep their positions.
    Enrich(Enrich),
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  wad-cosim net info my.net.xml")]
struct Info {
    /// A .net.xml(.gz), a .sumocfg, a scenario or a bundled town.
    config: String,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  wad-cosim net import helsinki.osm --out helsinki\n  wad-cosim net build my.netccfg --out my"
)]
struct Make {
    /// The source file: plain XML, .netccfg, OpenDRIVE, OpenStreetMap or a SUMO net.
    #[arg(value_hint = ValueHint::FilePath)]
    source: PathBuf,
    /// The new folder: NAME.net.xml, NAME.sumocfg and, from OpenStreetMap, NAME.poly.xml.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    out: PathBuf,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  wad-cosim net enrich Town04.net.xml --out new.net.xml\n  wad-cosim net enrich my.net.xml --crossings --out new.net.xml"
)]
struct Enrich {
    /// A .net.xml(.gz), a .sumocfg or a bundled town.
    config: String,
    /// File for the new net.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    out: PathBuf,
    /// Add signals at junctions of four arms, and at wide ones of three.
    #[arg(long)]
    signals: bool,
    /// Add sidewalks to roads of up to 70 km/h.
    #[arg(long)]
    sidewalks: bool,
    /// Add crossings where sidewalks meet a junction.
    #[arg(long)]
    crossings: bool,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    match args.what {
        What::Info(args) => info(&args),
        What::Build(args) => {
            let made = nets::build(&args.source, &args.out).map_err(with_exit)?;
            say_made(&made, args.json)
        }
        What::Import(args) => {
            let made = nets::import(&args.source, &args.out).map_err(with_exit)?;
            say_made(&made, args.json)
        }
        What::Enrich(args) => enrich(&args),
    }
}

fn with_exit(error: NetError) -> anyhow::Error {
    let exit = match &error {
        NetError::Install(_) => Exit::Sumo,
        NetError::Write { .. } => Exit::Other,
        _ => Exit::Input,
    };
    exit.because(error)
}

/// The net of a CONFIG, and the shapes of its additional files.
fn open(config: &str) -> anyhow::Result<(PathBuf, Network, Shapes)> {
    let config = bundled::resolve(config).map_err(|e| Exit::Input.because(e))?;
    let install = SumoInstall::find().map_err(|e| Exit::Sumo.because(e))?;
    let schema = OptionSchema::cached(&install, false).map_err(|e| Exit::Sumo.because(e))?;
    let loaded = SumoConfig::load(&config, &schema).map_err(|e| Exit::Input.because(e))?;
    let net = loaded.net_file().map_err(|e| Exit::Input.because(e))?;
    let network = Network::load(&net).map_err(|e| Exit::Input.because(e))?;
    let mut shapes = Shapes::default();
    for file in loaded.additional_files() {
        match Shapes::load(&file, &network) {
            Ok(found) => shapes.polygons.extend(found.polygons),
            Err(error) => tracing::warn!("no polygons from an additional file: {error}"),
        }
    }
    Ok((net, network, shapes))
}

fn info(args: &Info) -> anyhow::Result<Exit> {
    let (net, network, shapes) = open(&args.config)?;
    let facts = nets::facts(&network, &shapes, &args.config);
    let text = describe(&net, &facts);
    answer(&text, args.json, &facts)?;
    Ok(Exit::Done)
}

fn describe(net: &Path, f: &Facts) -> String {
    let limits: Vec<String> = f.speed_limits_kmh.iter().map(u32::to_string).collect();
    let mut text = format!(
        "{}\n  {:.0} x {:.0} m, climbs {:.0} m, traffic keeps {}\n  {} roads, {} junctions, {} lanes for cars ({:.1} km; {:.0} % hang together), limits {} km/h\n  \
         {} signals, {} roundabouts, {} sidewalks, {} crossings, {} buildings\n",
        net.display(),
        f.size_m.0,
        f.size_m.1,
        f.climb_m,
        if f.left_hand { "left" } else { "right" },
        f.roads,
        f.junctions,
        f.lanes,
        f.lane_km,
        100.0 * f.connected,
        limits.join(", "),
        f.signals,
        f.roundabouts,
        f.sidewalks,
        f.crossings,
        f.buildings,
    );
    let placed: Vec<String> = f
        .tasks
        .iter()
        .filter(|t| t.placed)
        .map(|t| if t.note.is_empty() { t.task.to_string() } else { format!("{} ({})", t.task, t.note) })
        .collect();
    text += &format!("  tasks: {}\n", if placed.is_empty() { "none".to_string() } else { placed.join(", ") });
    for problem in &f.problems {
        text += &format!("  problem: {}\n      fix: {}\n", problem.what, problem.fix);
    }
    text
}

fn say_made(made: &Made, json: bool) -> anyhow::Result<Exit> {
    for warning in made.warnings.iter().take(8) {
        tracing::info!("{warning}");
    }
    let text = format!(
        "{}\nlook:   wad-cosim net info {}\ndrive:  wad-cosim run {}\n",
        made.net.display(),
        made.config.display(),
        made.config.display()
    );
    let warnings = made.warnings.len();
    let made = serde_json::json!({
        "config": made.config, "net": made.net, "polygons": made.polygons, "warnings": warnings,
    });
    answer(&text, json, &made)?;
    Ok(Exit::Done)
}

fn enrich(args: &Enrich) -> anyhow::Result<Exit> {
    let (net, network, _) = open(&args.config)?;
    if args.out.exists() {
        return Err(with_exit(NetError::Taken { path: args.out.clone() }));
    }
    let asked = args.signals || args.sidewalks || args.crossings;
    let wanted = if asked {
        Wanted { signals: args.signals, sidewalks: args.sidewalks, crossings: args.crossings }
    } else {
        Wanted::missing(&network)
    };
    if wanted == Wanted::default() {
        return Err(with_exit(NetError::Nothing { path: net }));
    }
    let done = nets::enrich(&net, &args.out, wanted).map_err(with_exit)?;
    let dropped = if done.dropped_signals.is_empty() {
        String::new()
    } else {
        format!(
            "netconvert dropped {} signals: {}; look at them in netedit\n",
            done.dropped_signals.len(),
            done.dropped_signals.join(", ")
        )
    };
    let text = format!(
        "{}: signals {} -> {}, sidewalks {} -> {}, crossings {} -> {}\n\
         lanes: {} compared, none off its line (worst {:.3} m); {} put back; {} end up to {:.1} m earlier to make room\n{dropped}",
        args.out.display(),
        done.signals.0,
        done.signals.1,
        done.sidewalks.0,
        done.sidewalks.1,
        done.crossings.0,
        done.crossings.1,
        done.moved.compared,
        done.moved.worst,
        done.put_back,
        done.moved.cut,
        done.moved.most_cut,
    );
    answer(&text, args.json, &done)?;
    Ok(Exit::Done)
}
