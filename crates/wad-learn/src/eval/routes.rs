//! Evaluation routes: fixed in a file per town; the autopilot finishes each in the empty town.

use crate::env::{Assets, Env, EnvError, EnvOptions, ObservationMode};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use sumo_network::seeds;
use wad_see::latent::PooledEncoder;
use wad_sim::bundled;
use wad_sim::tasks::{Placement, TaskError, TaskKind, TaskSpec};
use wad_sim::telemetry::write_whole;
use wad_sim::traffic::TrafficSpec;

/// The routes of one town, in sets by kind of task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Routes {
    /// The town (CONFIG).
    pub town: String,
    /// [`Assets::net_hash`] of their net.
    pub net: String,
    /// Places by the kind of task.
    pub sets: BTreeMap<String, Vec<Placement>>,
    /// Sets without a place on the net, and the cause.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub missing: BTreeMap<String, String>,
}

/// Why routes cannot be read, written or made.
#[derive(Debug, thiserror::Error)]
pub enum RouteError {
    /// The town has no file of routes.
    #[error(
        "the suite's routes for `{town}` are missing: make them with `wad-cosim eval routes {town}`, or name \
         their file with `--routes FILE` if it is not beside the net"
    )]
    None {
        /// The town.
        town: String,
    },
    /// The file lacks a set that the suite needs.
    #[error("the suite needs routes `{set}`, and {} has none: {why}{}", path.display(), remedy(set))]
    NoSet {
        /// The set's name.
        set: String,
        /// The file or folder.
        path: PathBuf,
        /// Why there is none.
        why: String,
    },
    /// The file cannot be read or written.
    #[error("cannot {what} the routes {}: {source}", path.display())]
    File {
        /// The action that failed.
        what: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The file does not hold routes.
    #[error(
        "{} is not a file of routes: {why}; remove it, and `wad-cosim eval routes` makes a new one", path.display()
    )]
    Format {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        why: String,
    },
    /// The routes belong to another net.
    #[error(
        "the routes {} belong to another net ({expected}) than {town} ({found}): make them again with \
         `wad-cosim eval routes {town}`", path.display()
    )]
    OtherNet {
        /// The file or folder.
        path: PathBuf,
        /// The town.
        town: String,
        /// Hash of the routes' net.
        expected: String,
        /// Hash of the town's net.
        found: String,
    },
}

/// The remedy for a net without places for a set.
fn remedy(set: &str) -> &'static str {
    match set {
        "cross" => ". `wad-cosim net enrich` adds signals to junctions; make the routes again afterwards",
        _ => ". Drive the suite's other tasks with --task, or choose a net that has such places",
    }
}

const SHIPPED: [(&str, &str); 3] = [
    ("town3", include_str!("routes/town3.json")),
    ("town5", include_str!("routes/town5.json")),
    ("town7", include_str!("routes/town7.json")),
];

impl Routes {
    /// The sets to make: for the five tasks, and for navigation.
    pub const SETS: [TaskKind; 6] = [
        TaskKind::Straight,
        TaskKind::OneTurn,
        TaskKind::Roundabout,
        TaskKind::Obstacle,
        TaskKind::Cross,
        TaskKind::Navigation,
    ];

    /// The routes of the town `config`: from `file` if given, else the bundled ones, else the file
    /// beside the net (`NAME.routes.json`). Also returns their source.
    ///
    /// # Errors
    /// There are no routes, or they belong to another net.
    pub fn find(config: &str, assets: &Assets, file: Option<&Path>) -> Result<(Self, PathBuf), RouteError> {
        let beside = Self::beside(assets);
        let (path, text) = match (file, SHIPPED.iter().find(|(town, _)| *town == config)) {
            (Some(path), _) => (path.to_path_buf(), read(path)?),
            (None, Some((town, text))) => (PathBuf::from(format!("{town} (shipped)")), text.to_string()),
            (None, None) if beside.is_file() => (beside.clone(), read(&beside)?),
            (None, None) => return Err(RouteError::None { town: config.to_string() }),
        };
        let routes: Self = serde_json::from_str(&text)
            .map_err(|e| RouteError::Format { path: path.clone(), why: e.to_string() })?;
        if routes.net != assets.net_hash() {
            return Err(RouteError::OtherNet {
                path,
                town: config.to_string(),
                expected: routes.net,
                found: assets.net_hash().to_string(),
            });
        }
        Ok((routes, path))
    }

    /// The file of a town's own routes: beside its configuration; for a bundled town
    /// in the current folder.
    pub fn beside(assets: &Assets) -> PathBuf {
        let name = format!("{}.routes.json", assets.name());
        let folder = assets.config().parent().unwrap_or(Path::new(""));
        if bundled::is_unpacked(folder) { PathBuf::from(name) } else { folder.join(name) }
    }

    /// One of the sets.
    ///
    /// # Errors
    /// The set is missing; `path` names the file in the error.
    pub fn set(&self, set: &str, path: &Path) -> Result<&[Placement], RouteError> {
        match self.sets.get(set).filter(|routes| !routes.is_empty()) {
            Some(routes) => Ok(routes),
            None => Err(RouteError::NoSet {
                set: set.to_string(),
                path: path.to_path_buf(),
                why: self.missing.get(set).cloned().unwrap_or_else(|| {
                    format!("it has {}", self.sets.keys().cloned().collect::<Vec<_>>().join(", "))
                }),
            }),
        }
    }

    /// Writes the file, one route per line.
    ///
    /// # Errors
    /// It cannot be written; an earlier file stays.
    pub fn save(&self, path: &Path) -> Result<(), RouteError> {
        let failed = |source| RouteError::File { what: "write", path: path.to_path_buf(), source };
        let json = |value: serde_json::Result<String>| value.map_err(|e| failed(e.into()));
        let string = |text: &str| json(serde_json::to_string(text));
        let mut text = format!(
            "{{\n  \"town\": {},\n  \"net\": {},\n  \"sets\": {{",
            string(&self.town)?,
            string(&self.net)?
        );
        for (n, (set, routes)) in self.sets.iter().enumerate() {
            text += if n == 0 { "\n" } else { ",\n" };
            let lines = routes.iter().map(|r| Ok(format!("      {}", json(serde_json::to_string(r))?)));
            let lines: Result<Vec<String>, RouteError> = lines.collect();
            text += &format!("    {}: [\n{}\n    ]", string(set)?, lines?.join(",\n"));
        }
        text += "\n  }";
        if !self.missing.is_empty() {
            text += &format!(",\n  \"missing\": {}", json(serde_json::to_string(&self.missing))?);
        }
        write_whole(path, (text + "\n}\n").as_bytes()).map_err(|error| failed(error.source))
    }
}

fn read(path: &Path) -> Result<String, RouteError> {
    std::fs::read_to_string(path).map_err(|source| RouteError::File {
        what: "read",
        path: path.to_path_buf(),
        source,
    })
}

/// Most places drawn per wanted route.
const DRAWS: u64 = 12;
/// Routes between the same lanes that begin closer together than this count as the same (m).
const APART: f64 = 2.0;

/// The end of a search for a set.
#[derive(Clone, Debug, PartialEq)]
pub enum Search {
    /// The set.
    Found(Vec<Placement>),
    /// There is none on the net, and why.
    None(String),
    /// It was stopped before the set was whole.
    Stopped,
}

/// Finds `count` routes for a kind of task: drawn from `seed`, and kept if the autopilot finishes them
/// in the empty town without breaking a rule. `stopped` is asked before each one, `tried` is called after it.
///
/// # Errors
/// SUMO or the environment fail.
pub fn find(
    assets: &Arc<Assets>,
    kind: TaskKind,
    count: usize,
    seed: u64,
    stopped: impl Fn() -> bool,
    mut tried: impl FnMut(&Placement, bool),
) -> Result<Search, EnvError> {
    let options = EnvOptions { observation: ObservationMode::Blind, ..EnvOptions::evaluation() };
    let mut env = Env::new(Arc::clone(assets), options, Box::new(PooledEncoder))?;
    let mut found: Vec<Placement> = Vec::new();
    for draw in 0..DRAWS * count as u64 {
        if found.len() == count {
            break;
        }
        if stopped() {
            return Ok(Search::Stopped);
        }
        let seed = seeds::derive(seed, &format!("route {kind} {draw}"));
        let placement = match assets.place(kind, seed) {
            Ok(placement) => placement,
            Err(error @ TaskError::NoPlace { .. }) => return Ok(Search::None(error.to_string())),
            Err(error) => return Err(error.into()),
        };
        let same = |other: &Placement| {
            (&other.from.lane, &other.to.lane) == (&placement.from.lane, &placement.to.lane)
                && (other.from.s - placement.from.s).abs() < APART
        };
        if found.iter().any(same) {
            continue;
        }
        let task = TaskSpec {
            traffic: Some(TrafficSpec::Empty),
            placement: Some(placement.clone()),
            ..TaskSpec::new(kind)
        };
        let success = finishes(&mut env, &task, seed)?;
        tried(&placement, success);
        if success {
            found.push(placement);
        }
    }
    Ok(if found.is_empty() {
        Search::None(format!("the autopilot finished none of {} routes for `{kind}`", DRAWS * count as u64))
    } else {
        Search::Found(found)
    })
}

fn finishes(env: &mut Env, task: &TaskSpec, seed: u64) -> Result<bool, EnvError> {
    env.reset(task, seed)?;
    loop {
        let control = env.expert()?;
        if let Some(ending) = env.step(control)?.info.ending {
            return Ok(ending.success);
        }
    }
}
