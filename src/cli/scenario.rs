//! `wad-cosim scenario`: situations drawn in netedit: make, edit, check, list, drive.

use super::{Exit, config, print, run};
use anyhow::Context;
use clap::Subcommand;
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};
use wad_cosim::bundled;
use wad_cosim::network::{Network, Shapes};
use wad_cosim::scenario::template::{self, Base, TEMPLATES};
use wad_cosim::scenario::{self, Problem, Scenario};
use wad_cosim::sumo_config::{OptionSchema, SumoConfig};
use wad_cosim::traci::process::SumoInstall;

const EXAMPLES: &str = "\
Examples:
  wad-cosim scenario list                                         templates and shipped scenarios
  wad-cosim scenario new my_jam --template accident --town town5  a folder of SUMO files
  wad-cosim scenario edit my_jam                                  draw in netedit
  wad-cosim scenario check my_jam                                 every mistake, with its fix
  wad-cosim scenario run my_jam --record jam.mp4                  drive it";

/// Make, edit, check, list and drive scenarios: folders of SUMO files for netedit.
#[derive(clap::Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Make a scenario from a template.
    New(New),
    /// Open a scenario's files in netedit.
    Edit(Edit),
    /// Print every mistake in a scenario, with file, element and fix.
    Check(Check),
    /// List templates and shipped scenarios.
    List(List),
    /// Drive a scenario: the same as `run`.
    Run(Box<run::Args>),
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  wad-cosim scenario new my_jam --template accident --town town5")]
struct New {
    /// Its name, or the path of its folder. A plain name goes into scenarios/ if that folder is here.
    name: PathBuf,
    /// The template; see `scenario list`.
    #[arg(long, value_name = "T", default_value = "straight")]
    template: String,
    /// The net: a bundled town, a .sumocfg or a .net.xml(.gz).
    #[arg(long, value_name = "CONFIG", default_value = "town5")]
    town: String,
    /// Seed: another number gives another place in the town.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  wad-cosim scenario edit my_jam\n  wad-cosim scenario edit my_jam -- --window-size 1000,800"
)]
struct Edit {
    /// A scenario's folder or name.
    name: String,
    /// More options for netedit, after `--`.
    #[arg(last = true)]
    more: Vec<String>,
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  wad-cosim scenario check my_jam")]
struct Check {
    /// Scenarios' folders or names [default: all shipped ones].
    names: Vec<String>,
    /// Print one JSON object as the last line of stdout; everything else goes to stderr.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  wad-cosim scenario list --json")]
struct List {
    /// Print one JSON object as the last line of stdout.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    match args.what {
        What::New(args) => new(&args),
        What::Edit(args) => edit(&args),
        What::Check(args) => check(&args),
        What::List(args) => list(&args),
        What::Run(args) => run::run(*args),
    }
}

fn new(args: &New) -> anyhow::Result<Exit> {
    let template = template::find(&args.template).map_err(|e| Exit::Input.because(e))?;
    let plain = args.name.components().count() == 1;
    let folder = if plain && Path::new("scenarios").is_dir() {
        Path::new("scenarios").join(&args.name)
    } else {
        args.name.clone()
    };
    if folder.exists() {
        return Err(Exit::Input.because(template::TemplateError::Taken { path: folder }));
    }
    let config = bundled::resolve(&args.town).map_err(|e| Exit::Input.because(e))?;
    let town = load(&config)?;
    let net = town.net_file().map_err(|e| Exit::Input.because(e))?;
    let network = Network::load(&net).map_err(|e| Exit::Input.because(e))?;
    let mut needed = vec![net];
    needed.extend(town.additional_files().into_iter().filter(|file| has_polygons(file)));
    let names = place_files(&folder, &needed, bundled::is_unpacked(&config));
    let base = Base {
        network: &network,
        net: names[0].1.clone(),
        additional: names[1..].iter().map(|n| n.1.clone()).collect(),
    };
    let made = template::create(&folder, template, &base, args.seed).map_err(|error| match error {
        template::TemplateError::Write { .. } => Exit::Other.because(error),
        error => Exit::Input.because(error),
    })?;
    for (file, name, copy) in &names {
        if *copy {
            let to = folder.join(name);
            std::fs::copy(file, &to).with_context(|| format!("cannot write {}", to.display()))?;
        }
    }
    print(&format!(
        "{}: {}\nedit it:   wad-cosim scenario edit {folder}\ncheck it:  wad-cosim scenario check {folder}\ndrive it:  wad-cosim scenario run {folder}\n",
        made.display(),
        template.about,
        folder = folder.display(),
    ))?;
    Ok(Exit::Done)
}

fn load(config: &Path) -> anyhow::Result<SumoConfig> {
    let install = SumoInstall::find().map_err(|e| Exit::Sumo.because(e))?;
    let schema = OptionSchema::cached(&install, false).map_err(|e| Exit::Sumo.because(e))?;
    SumoConfig::load(config, &schema).map_err(|e| Exit::Input.because(e))
}

/// Buildings and other polygons belong to a net; vehicle types and detectors do not.
fn has_polygons(file: &Path) -> bool {
    file.to_string_lossy().contains(".poly.xml")
}

/// The path of each file in the scenario, and whether to copy it: a bundled town is referred to inside the
/// repository and copied elsewhere, so that the folder can be passed on; an author's own net is referred to.
fn place_files(folder: &Path, files: &[PathBuf], bundled: bool) -> Vec<(PathBuf, String, bool)> {
    let place = |file: &PathBuf| {
        let base = file.file_name().unwrap_or_default().to_string_lossy().to_string();
        if !bundled {
            return (file.clone(), relative(folder, file), false);
        }
        let town = file.parent().and_then(Path::file_name).unwrap_or_default();
        let beside = Path::new("../../sumo_nets").join(town).join(&base);
        if folder
            .parent()
            .is_some_and(|scenarios| scenarios.join("../sumo_nets").join(town).join(&base).is_file())
        {
            (file.clone(), beside.to_string_lossy().to_string(), false)
        } else {
            (file.clone(), base, true)
        }
    };
    files.iter().map(place).collect()
}

/// `file` as seen from `folder`.
fn relative(folder: &Path, file: &Path) -> String {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let (from, to) = (absolute(folder), absolute(file));
    let (from, to): (Vec<_>, Vec<_>) = (from.components().collect(), to.components().collect());
    let same = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    let mut path = PathBuf::new();
    path.extend(std::iter::repeat_n("..", from.len() - same));
    path.extend(&to[same..]);
    path.to_string_lossy().to_string()
}

fn edit(args: &Edit) -> anyhow::Result<Exit> {
    let config = config::resolve(&args.name)?;
    if bundled::is_unpacked(&config) {
        super::note(format_args!(
            "{} is the shipped copy: the next update overwrites your changes; make your own with `scenario new`",
            config.display()
        ));
    }
    let install = SumoInstall::find().map_err(|e| Exit::Sumo.because(e))?;
    let town = Town::remember(&config)?;
    let mut command = install.command("netedit");
    command.arg("--sumocfg-file").arg(&config).args(&args.more);
    let given = |options: &[&str]| {
        args.more.iter().any(|arg| options.iter().any(|o| arg.split('=').next() == Some(o)))
    };
    if !given(&["--window-size"]) {
        command.args(["--window-size", WINDOW]);
    }
    // netedit reads it at its start; it is removed at the end.
    let mut view =
        tempfile::Builder::new().suffix(".xml").tempfile().context("cannot make a temporary file")?;
    if let (Some(scenario), Some(network)) = (scenario::inspect(&config).scenario, &town.network)
        && !given(&["-g", "--gui-settings-file"])
    {
        view.write_all(view_settings(&scenario, network).as_bytes())
            .context("cannot write netedit's view")?;
        command.arg("--gui-settings-file").arg(view.path());
    }
    super::note("netedit: F3 shows the ego (Demand), F2 the obstacles and events (Network)");
    let status = command.status().map_err(|error| {
        Exit::Sumo.because(anyhow::anyhow!(
            "cannot start {}: {error}; run wad-cosim doctor",
            install.program("netedit").display()
        ))
    })?;
    if !status.success() {
        return Err(Exit::Sumo.because(anyhow::anyhow!(
            "netedit ended with {status}; it needs a display (DISPLAY is `{}`)",
            std::env::var("DISPLAY").unwrap_or_default()
        )));
    }
    town.put_back();
    Ok(Exit::Done)
}

/// Width and height (pixels) of netedit's window: its own default shows a town as a stamp.
const WINDOW: &str = "1400,900";

/// netedit's view settings: some 250 m around the ego's start.
fn view_settings(scenario: &Scenario, network: &Network) -> String {
    let at = scenario.route.at(50.0).pose.position;
    // At 100 the whole net is in view.
    let (low, high) = network.bounds;
    let zoom = (100.0 * (high - low).amax() / 250.0).max(100.0);
    format!(
        "<viewsettings><scheme name=\"standard\"/><viewport x=\"{:.1}\" y=\"{:.1}\" zoom=\"{zoom:.0}\"/></viewsettings>\n",
        at.x, at.y
    )
}

/// The files of a scenario's town, which other scenarios share. netedit rewrites them at each save, with
/// other digits. If their meaning is unchanged, their old bytes are restored.
struct Town {
    files: Vec<(PathBuf, Vec<u8>, Shapes)>,
    network: Option<Network>,
}

impl Town {
    fn remember(config: &Path) -> anyhow::Result<Self> {
        let loaded = load(config)?;
        let network = loaded.net_file().ok().and_then(|net| Network::load(&net).ok());
        let folder = config.parent().unwrap_or(Path::new(""));
        let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_path_buf());
        let others = loaded.additional_files().into_iter().filter(|file| file.parent() != Some(&folder));
        let files = others.filter_map(|file| {
            let bytes = std::fs::read(&file).ok()?;
            let shapes = Shapes::load(&file, network.as_ref()?).ok()?;
            Some((file, bytes, shapes))
        });
        Ok(Self { files: files.collect(), network })
    }

    fn put_back(&self) {
        let Some(network) = &self.network else { return };
        for (file, bytes, shapes) in &self.files {
            let changed = std::fs::read(file).is_ok_and(|now| now != *bytes);
            let same = || Shapes::load(file, network).is_ok_and(|now| same_shapes(&now, shapes));
            if changed
                && same()
                && let Err(error) = std::fs::write(file, bytes)
            {
                tracing::warn!("{} stays as netedit wrote it: {error}", file.display());
            }
        }
    }
}

/// Whether both are equal except for the order.
fn same_shapes(a: &Shapes, b: &Shapes) -> bool {
    let sorted = |shapes: &Shapes| {
        let mut all: Vec<String> = shapes.polygons.iter().map(|p| format!("{p:?}")).collect();
        all.extend(shapes.points.iter().map(|p| format!("{p:?}")));
        all.sort_unstable();
        all
    };
    sorted(a) == sorted(b)
}

/// "1 thing", "2 things".
fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

#[derive(Serialize)]
struct Checked {
    name: String,
    config: PathBuf,
    ok: bool,
    problems: Vec<Problem>,
}

fn check(args: &Check) -> anyhow::Result<Exit> {
    let names = if args.names.is_empty() { bundled::scenarios() } else { args.names.clone() };
    let mut checked = Vec::with_capacity(names.len());
    for name in &names {
        let config = config::resolve(name)?;
        let found = scenario::inspect(&config);
        let mut text = String::new();
        for problem in &found.problems {
            text += &format!("{problem}\n");
        }
        if let (true, Some(s)) = (found.problems.is_empty(), &found.scenario) {
            text += &format!(
                "{name}: ok: {}, {:.0} m, {}, traffic {}, {}\n",
                s.task,
                s.route.length(),
                s.weather.name(),
                s.traffic,
                counted(s.things.len(), "thing")
            );
        }
        if args.json {
            super::note(text.trim_end())
        } else {
            print(&text)?
        }
        let ok = found.problems.is_empty();
        checked.push(Checked { name: name.clone(), config, ok, problems: found.problems });
    }
    let bad = checked.iter().filter(|c| !c.ok).count();
    if args.json {
        let ok = bad == 0;
        print(&format!("{}\n", serde_json::json!({ "ok": ok, "scenarios": checked })))?;
    }
    Ok(if bad == 0 { Exit::Done } else { Exit::Input })
}

fn list(args: &List) -> anyhow::Result<Exit> {
    let about = |name: &str| {
        let config = bundled::resolve(name).ok().and_then(|config| load(&config).ok());
        config.map(|config| scenario::description(&config)).unwrap_or_default()
    };
    let scenarios: Vec<_> = bundled::scenarios().into_iter().map(|name| (about(&name), name)).collect();
    if args.json {
        let line = |name: &str, about: &str| serde_json::json!({ "name": name, "about": about });
        let templates: Vec<_> = TEMPLATES.iter().map(|t| line(t.name, t.about)).collect();
        let scenarios: Vec<_> = scenarios.iter().map(|(about, name)| line(name, about)).collect();
        print(&format!("{}\n", serde_json::json!({ "templates": templates, "scenarios": scenarios })))?;
        return Ok(Exit::Done);
    }
    let names = TEMPLATES.iter().map(|t| t.name.len()).chain(scenarios.iter().map(|(_, name)| name.len()));
    let width = names.max().unwrap_or_default();
    let mut text = "templates, for `scenario new NAME --template T`:\n".to_string();
    for template in TEMPLATES {
        text += &format!("  {:width$}  {}\n", template.name, template.about);
    }
    text += "scenarios, for `run` and `scenario run`:\n";
    for (about, name) in scenarios {
        text += &format!("  {name:width$}  {about}\n");
    }
    print(&text)?;
    Ok(Exit::Done)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn netedit_opens_where_the_ego_starts() {
        wad_cosim::register_bundled();
        let scenario = Scenario::load(&bundled::resolve("accident_ahead").unwrap()).unwrap();
        let network = Network::load(&load(&scenario.config).unwrap().net_file().unwrap()).unwrap();
        let text = view_settings(&scenario, &network);
        let number = |name: &str| -> f64 {
            let (_, rest) = text.split_once(&format!("{name}=\"")).unwrap();
            rest.split_once('"').unwrap().0.parse().unwrap()
        };
        let ego = scenario.route.at(0.0).pose.position;
        assert!((number(" x") - ego.x).hypot(number(" y") - ego.y) < 60.0, "{text}");
    }
}
