//! Scenarios: situations drawn in netedit.
//!
//! A scenario is a folder of plain SUMO files and nothing else: a `.sumocfg` that names a net, a route file
//! with the ego (a trip or vehicle of type `ego`), and an additional file with obstacles and events (points
//! and polygons by type). What SUMO has no attribute for is a generic parameter `wad.*`. docs/scenarios.md
//! lists them all.
//!
//! ```text
//! .sumocfg --inspect--> Scenario (route, task, weather, things) + Problems
//! Scenario --Director--> the things and events in SUMO, tick by tick, through the bridge
//! ```

mod actors;
mod director;
mod ego;
mod params;
mod problem;
pub mod template;
mod things;
mod xml;

pub use crate::bridge::EGO_TYPE;
pub use director::Director;
pub use problem::{Problem, ScenarioError};
pub use things::{Closure, Kind, Leader, ObjectShape, POINTS, POLYGONS, Thing, Trigger, VEHICLES};

use crate::sumo_config::{ConfigError, OptionSchema, SumoConfig};
use crate::tasks::{ObstaclePlacement, Placement, Spot, TaskKind, TaskSpec};
use crate::traffic::TrafficSpec;
use std::path::{Path, PathBuf};
use sumo_network::network::{Network, Route};
use sumo_traci::process::SumoInstall;
use wad_camera::Preset;

/// A scenario that can be driven.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// The name: its configuration's file name without the extension.
    pub name: String,
    /// Its `.sumocfg`.
    pub config: PathBuf,
    /// The ego's task.
    pub task: TaskKind,
    /// The ego's start, via points and destination; the obstacle of the obstacle task.
    pub placement: Placement,
    /// The ego's route.
    pub route: Route,
    /// The weather.
    pub weather: Preset,
    /// Background traffic beside the scenario's own vehicles.
    pub traffic: TrafficSpec,
    /// s; None: the task's own limit.
    pub time_limit: Option<f64>,
    /// Obstacles and events.
    pub things: Vec<Thing>,
    /// Lanes that it closes to SUMO's traffic, by id.
    pub closed_lanes: Vec<String>,
}

/// The result of reading a scenario: the scenario, if it can be driven, and its mistakes.
#[derive(Debug)]
pub struct Inspection {
    /// None if the ego or its route is broken.
    pub scenario: Option<Scenario>,
    /// Mistakes in its files, each with a remedy.
    pub problems: Vec<Problem>,
}

impl Inspection {
    /// The scenario, where nothing is wrong with it.
    ///
    /// # Errors
    /// All mistakes found.
    pub fn into_scenario(self) -> Result<Scenario, ScenarioError> {
        match self.scenario {
            Some(scenario) if self.problems.is_empty() => Ok(scenario),
            _ => Err(ScenarioError(self.problems)),
        }
    }
}

/// Looks a scenario over, every mistake at once.
pub fn inspect(config: &Path) -> Inspection {
    let loaded = match open(config) {
        Ok(loaded) => loaded,
        Err(problem) => return Inspection { scenario: None, problems: vec![problem] },
    };
    let problem = match loaded.present_net() {
        Err(error) => about_config(config, &error),
        Ok(net) => match Network::load(&net) {
            Ok(network) => return inspect_on(&loaded, &network),
            Err(error) => {
                Problem::of_file(&net, error.to_string(), "name a net that SUMO can read as net-file")
            }
        },
    };
    // Without a net, only what is wrong with the other files as such.
    let mut problems = vec![problem];
    elements(&loaded, &mut problems);
    Inspection { scenario: None, problems }
}

fn open(config: &Path) -> Result<SumoConfig, Problem> {
    let install = SumoInstall::find()
        .map_err(|error| Problem::of_file(config, error.to_string(), "run wad-cosim doctor"))?;
    let schema = OptionSchema::cached(&install, false).map_err(|error| about_config(config, &error))?;
    SumoConfig::read(config, &schema).map_err(|error| about_config(config, &error))
}

fn about_config(config: &Path, error: &ConfigError) -> Problem {
    Problem::of_file(
        config,
        error.to_string(),
        "repair it, or make a new scenario with wad-cosim scenario new",
    )
}

/// The same of a configuration whose network has been read already.
pub fn inspect_on(config: &SumoConfig, network: &Network) -> Inspection {
    let mut problems = Vec::new();
    let elements = elements(config, &mut problems);
    let element = ego::find(&elements, config.path(), &mut problems);
    let plan = element.and_then(|e| ego::read(e, &elements, network, &mut problems));
    let things = things::read(&elements, network, plan.as_ref().map(|p| &p.route), &mut problems);
    let scenario = plan.zip(element).map(|(plan, element)| {
        let mut scenario = Scenario {
            name: config.name(),
            config: config.path().to_path_buf(),
            task: plan.kind,
            placement: plan.placement,
            route: plan.route,
            weather: plan.weather,
            traffic: plan.traffic,
            time_limit: plan.time_limit,
            closed_lanes: closed_lanes(&things, network),
            things,
        };
        match scenario.obstacle(network) {
            None if scenario.task == TaskKind::Obstacle => problems.push(element.problem(
                "its task is `obstacle`, but no obstacle stands on its route",
                "put a point of type obstacle.car (or another) onto a lane of the route, or choose another wad.task",
            )),
            found => scenario.placement.obstacle = found,
        }
        scenario
    });
    Inspection { scenario, problems }
}

/// Whether a configuration is a scenario: one of its route files has a trip or vehicle of type `ego`.
pub fn has_ego(config: &SumoConfig) -> bool {
    elements(config, &mut Vec::new()).iter().any(ego::is_ego)
}

/// A scenario's own line about itself, empty if it has none.
pub fn description(config: &SumoConfig) -> String {
    let elements = elements(config, &mut Vec::new());
    let ego = elements.iter().find(|element| ego::is_ego(element));
    let text = ego.and_then(|ego| ego.param(params::DESCRIPTION)).unwrap_or_default();
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn closed_lanes(things: &[Thing], network: &Network) -> Vec<String> {
    let closures = things.iter().flat_map(|thing| match &thing.kind {
        Kind::RoadWorks(closures) => closures.as_slice(),
        Kind::LaneClosed { closure, .. } => std::slice::from_ref(closure),
        _ => &[],
    });
    let closed = closures.filter(|closure| actors::has_other_lane(network, closure.at.lane));
    closed.map(|closure| network.lane(closure.at.lane).id.clone()).collect()
}

fn elements(config: &SumoConfig, problems: &mut Vec<Problem>) -> Vec<xml::Element> {
    let files = config.route_files().into_iter().chain(config.additional_files());
    let mut elements = Vec::new();
    for file in files {
        match xml::read(&file) {
            Ok(found) => elements.extend(found),
            Err(problem) => problems.push(problem),
        }
    }
    elements
}

impl Scenario {
    /// The scenario of a `.sumocfg`.
    ///
    /// # Errors
    /// All its mistakes.
    pub fn load(config: &Path) -> Result<Self, ScenarioError> {
        inspect(config).into_scenario()
    }

    /// Its episode, for ticks of `tick` (s).
    pub fn task_spec(&self, tick: f64) -> TaskSpec {
        TaskSpec {
            kind: self.task,
            traffic: Some(self.traffic),
            weather: self.weather,
            tick_limit: Some(self.tick_limit(tick)),
            placement: Some(self.placement.clone()),
            endless: false,
        }
    }

    /// Ticks of `tick` (s) that it may take.
    pub fn tick_limit(&self, tick: f64) -> u64 {
        match self.time_limit {
            Some(limit) => (limit / tick).ceil() as u64,
            None => self.task.tick_limit(self.route.length(), tick),
        }
    }

    /// The first obstacle on the route.
    fn obstacle(&self, network: &Network) -> Option<ObstaclePlacement> {
        let mut found: Vec<(f64, ObstaclePlacement)> = Vec::new();
        for thing in &self.things {
            let Some(kind) = thing.obstacle_kind() else { continue };
            let on = self.route.centre_line.project(network.lane(thing.lane).shape.at(thing.s).xy());
            if on.distance < 1.5 && on.s > 0.0 {
                let at =
                    Spot::at(network, sumo_network::network::LanePosition { lane: thing.lane, s: thing.s });
                found.push((on.s, ObstaclePlacement { kind, at }));
            }
        }
        found.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, placement)| placement)
    }
}
