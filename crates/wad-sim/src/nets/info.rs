//! Facts and problems of a net, as a driver and a camera see it.

use super::enrich::sidewalks;
use crate::destination::EGO_CLASS;
use crate::tasks::{Places, TaskKind};
use serde::Serialize;
use std::collections::BTreeSet;
use sumo_network::network::{EdgeKind, LaneId, Network, Shapes};

/// Facts about a net.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Facts {
    /// Width and height of its bounding box (m).
    pub size_m: (f64, f64),
    /// Height between its lowest and its highest road (m).
    pub climb_m: f64,
    /// Junctions.
    pub junctions: usize,
    /// Edges outside junctions.
    pub roads: usize,
    /// Lanes for cars.
    pub lanes: usize,
    /// Length of these lanes together (km).
    pub lane_km: f64,
    /// The speed limits that occur (km/h).
    pub speed_limits_kmh: Vec<u32>,
    /// Traffic drives on the left.
    pub left_hand: bool,
    /// Traffic lights.
    pub signals: usize,
    /// Roundabouts.
    pub roundabouts: usize,
    /// Lanes for pedestrians alone.
    pub sidewalks: usize,
    /// Pedestrian crossings.
    pub crossings: usize,
    /// Polygons of buildings.
    pub buildings: usize,
    /// The share of the lanes' length in the largest connected part, where every place is reachable from every
    /// other by car.
    pub connected: f64,
    /// For each task, whether the net has a place for it.
    pub tasks: Vec<TaskPlaces>,
    /// What hinders driving here, each with a remedy.
    pub problems: Vec<NetProblem>,
}

/// Whether a task can be placed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TaskPlaces {
    /// The task.
    pub task: TaskKind,
    /// The net has at least one place for it.
    pub placed: bool,
    /// The number of its routes, where they are counted, or the reason why there is none.
    pub note: String,
}

/// A problem for driving, and its remedy.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NetProblem {
    /// The problem.
    pub what: String,
    /// The remedy.
    pub fix: String,
}

/// Less than this share of the lanes hanging together is a problem.
const CONNECTED: f64 = 0.8;

/// Looks a net over. `name` is how commands in the remedies call it.
pub fn facts(network: &Network, shapes: &Shapes, name: &str) -> Facts {
    let lanes: Vec<LaneId> = network.drivable_lanes(EGO_CLASS).to_vec();
    let length = |lanes: &[LaneId]| lanes.iter().map(|l| network.lane(*l).shape.length()).sum::<f64>();
    let whole = length(&lanes);
    let connected = if whole > 0.0 { length(&network.largest_component(EGO_CLASS)) / whole } else { 0.0 };
    let heights = || lanes.iter().flat_map(|l| network.lane(*l).shape.points()).map(|p| p.z);
    let (low, high) = (heights().fold(f64::INFINITY, f64::min), heights().fold(f64::NEG_INFINITY, f64::max));
    let limits: BTreeSet<u32> =
        lanes.iter().map(|l| (network.lane(*l).speed_limit * 3.6).round() as u32).collect();
    let (a, b) = network.bounds;
    let places = Places::default();
    let tasks: Vec<TaskPlaces> = TaskKind::ALL.iter().map(|&task| place(&places, network, task)).collect();
    let mut facts = Facts {
        size_m: (b.x - a.x, b.y - a.y),
        climb_m: if lanes.is_empty() { 0.0 } else { high - low },
        junctions: network.junctions.len(),
        roads: network.edges.iter().filter(|e| e.kind == EdgeKind::Normal).count(),
        lanes: lanes.len(),
        lane_km: whole / 1000.0,
        speed_limits_kmh: limits.into_iter().collect(),
        left_hand: network.left_hand,
        signals: network.traffic_lights.len(),
        roundabouts: network.roundabouts.len(),
        sidewalks: sidewalks(network),
        crossings: network.crossings.len(),
        buildings: shapes.polygons.iter().filter(|p| p.fill && p.kind.starts_with("building")).count(),
        connected,
        tasks,
        problems: Vec::new(),
    };
    facts.problems = problems(network, &facts, name);
    facts
}

fn place(places: &Places, network: &Network, task: TaskKind) -> TaskPlaces {
    // Several seeds: a random route may fall short.
    let drawn = (0..4).map(|seed| places.draw(network, task, seed)).find(Result::is_ok);
    match drawn.unwrap_or_else(|| places.draw(network, task, 0)) {
        Ok(_) => {
            let note = places.count(network, task).map_or(String::new(), |count| format!("{count} ways"));
            TaskPlaces { task, placed: true, note }
        }
        Err(error) => TaskPlaces { task, placed: false, note: error.to_string() },
    }
}

fn problems(network: &Network, facts: &Facts, name: &str) -> Vec<NetProblem> {
    let mut problems = Vec::new();
    let mut add = |what: String, fix: String| problems.push(NetProblem { what, fix });
    let enrich = |option: &str| format!("wad-cosim net enrich {name} {option} --out NEW.net.xml");
    if facts.lanes == 0 {
        add(
            "no lane is open to passenger cars".to_string(),
            "allow class passenger on its roads in netedit, or import it again with them".to_string(),
        );
        return problems;
    }
    let bare = network.links.iter().filter(|link| link.via.is_empty()).count();
    if bare > 0 {
        add(
            format!("{bare} of {} links have no lanes inside the junction", network.links.len()),
            "it was built with no-internal-links: build it again without that option".to_string(),
        );
    }
    if facts.connected < CONNECTED {
        add(
            format!(
                "only {:.0} % of its lanes hang together; random routes begin and end there",
                100.0 * facts.connected
            ),
            "join the parts in netedit, or drive with --route FROM,TO".to_string(),
        );
    }
    if facts.signals == 0 {
        add("it has no signals".to_string(), enrich("--signals"));
    }
    if facts.sidewalks == 0 {
        add(
            "it has no sidewalks: no pedestrians can be put into it".to_string(),
            enrich("--sidewalks --crossings"),
        );
    } else if facts.crossings == 0 {
        add("it has no crossings: pedestrians stay on their side".to_string(), enrich("--crossings"));
    }
    for task in facts.tasks.iter().filter(|task| !task.placed) {
        add(
            task.note.clone(),
            "the suites leave this task out on this net; draw a place for it: wad-cosim scenario new"
                .to_string(),
        );
    }
    problems
}
