//! A task's place on a net, drawn from a seed.

use super::survey::{self, Passage, Way};
use super::{TaskError, TaskKind};
use crate::destination::{Destinations, EGO_CLASS};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::OnceLock;
use sumo_network::network::{
    EdgeKind, LaneId, LanePosition, Link, LinkDirection, LinkId, Network, RoadOption, Route,
};
use sumo_network::seeds;

/// A place on a lane, by name, so that it can be kept in files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spot {
    /// SUMO's lane id.
    pub lane: String,
    /// Arc length along the lane's shape (m).
    pub s: f64,
}

/// The kind of an obstacle in the ego's lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObstacleKind {
    /// A passenger car.
    Car,
    /// A truck.
    Truck,
    /// A bus.
    Bus,
    /// A motorcycle.
    Motorcycle,
    /// A bicycle.
    Bicycle,
    /// A person.
    Person,
}

impl ObstacleKind {
    /// All of them: the paper's classes that can stand on a road.
    pub const ALL: [Self; 6] =
        [Self::Car, Self::Truck, Self::Bus, Self::Motorcycle, Self::Bicycle, Self::Person];
}

/// An obstacle and its place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObstaclePlacement {
    /// What stands there.
    pub kind: ObstacleKind,
    /// The end of it that the ego comes to.
    pub at: Spot,
}

/// The place of a task: enough to drive it again on the same net.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Placement {
    /// The ego's centre at the start, standing.
    pub from: Spot,
    /// The destination.
    pub to: Spot,
    /// Passed on the way, in this order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub via: Vec<Spot>,
    /// The obstacle of the obstacle task.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub obstacle: Option<ObstaclePlacement>,
}

impl Spot {
    /// A place on a net by name.
    pub fn at(network: &Network, at: LanePosition) -> Self {
        Self::of(network, at.lane, at.s)
    }

    fn of(network: &Network, lane: LaneId, s: f64) -> Self {
        // Whole centimetres: the same in a file as here.
        Self { lane: network.lane(lane).id.clone(), s: (s * 100.0).round() / 100.0 }
    }

    /// The place on this net.
    ///
    /// # Errors
    /// The net has no such lane.
    pub fn on(&self, network: &Network) -> Result<LanePosition, TaskError> {
        let lane = network
            .lane_by_id(&self.lane)
            .ok_or_else(|| TaskError::OtherNet { kind: "lane", id: self.lane.clone() })?;
        Ok(LanePosition { lane, s: self.s })
    }
}

impl Placement {
    /// The ego's route.
    ///
    /// # Errors
    /// The place belongs to another net.
    pub fn route(&self, network: &Network) -> Result<Route, TaskError> {
        let (from, to) = (self.from.on(network)?, self.to.on(network)?);
        let Some((first, others)) = self.via.split_first() else {
            return Ok(network.route(from, to, EGO_CLASS)?);
        };
        let mut route = network.route(from, first.on(network)?, EGO_CLASS)?;
        for spot in others {
            network.extend_route(&mut route, spot.on(network)?)?;
        }
        network.extend_route(&mut route, to)?;
        Ok(route)
    }
}

/// Random draws before placing a task fails.
const DRAWS: usize = 200;
/// Random routes (m).
const ROUTE_LENGTH: std::ops::Range<f64> = 500.0..1600.0;
/// Way before and after a roundabout (m), at least and at most.
const ARM: (f64, f64) = (40.0, 160.0);
/// Way to the obstacle (m), and of lane beyond it.
const TO_OBSTACLE: (f64, f64) = (60.0, 120.0);
const BEYOND_OBSTACLE: f64 = 25.0;

/// The places of a net for each task, found at the first query.
#[derive(Debug, Default)]
pub struct Places {
    straight: OnceLock<Result<Vec<Way>, TaskError>>,
    one_turn: OnceLock<Result<Vec<Way>, TaskError>>,
    cross: OnceLock<Result<Vec<Way>, TaskError>>,
    passages: OnceLock<Result<Vec<Passage>, TaskError>>,
}

impl Places {
    /// A place for `task`, drawn from `seed`.
    ///
    /// # Errors
    /// The net has none; says which condition fails.
    pub fn draw(&self, network: &Network, task: TaskKind, seed: u64) -> Result<Placement, TaskError> {
        let mut rng = seeds::rng(seed, "place");
        match task {
            TaskKind::Straight | TaskKind::OneTurn | TaskKind::Cross => self.on_way(network, task, &mut rng),
            TaskKind::Roundabout => self.roundabout(network, &mut rng),
            TaskKind::Obstacle => obstacle(network, &mut rng),
            TaskKind::Composite | TaskKind::Navigation => random(network, task, rng),
        }
    }

    /// How many ways (or, for the roundabout, pairs of arms) the net has for a task; None for tasks
    /// whose places are not counted.
    pub fn count(&self, network: &Network, task: TaskKind) -> Option<usize> {
        match task {
            TaskKind::Roundabout => self.passages(network).ok().map(<[Passage]>::len),
            _ => self.ways(network, task)?.ok().map(<[Way]>::len),
        }
    }

    fn ways(&self, network: &Network, task: TaskKind) -> Option<Result<&[Way], TaskError>> {
        let cell = match task {
            TaskKind::Straight => &self.straight,
            TaskKind::OneTurn => &self.one_turn,
            TaskKind::Cross => &self.cross,
            _ => return None,
        };
        let ways = cell.get_or_init(|| survey::ways(network, task));
        Some(ways.as_ref().map(Vec::as_slice).map_err(Clone::clone))
    }

    fn passages(&self, network: &Network) -> Result<&[Passage], TaskError> {
        let passages = self.passages.get_or_init(|| survey::passages(network));
        passages.as_ref().map(Vec::as_slice).map_err(Clone::clone)
    }

    fn on_way(
        &self,
        network: &Network,
        task: TaskKind,
        rng: &mut ChaCha8Rng,
    ) -> Result<Placement, TaskError> {
        let ways = self.ways(network, task).unwrap_or(Ok(&[]))?;
        let length = if task == TaskKind::Cross { survey::CROSS_LENGTH } else { survey::TASK_LENGTH };
        for _ in 0..DRAWS {
            let Some(way) = pick(rng, ways) else { break };
            let (Some((low, high)), Some(&first), Some(&last)) =
                (way.starts(length), way.lanes.first(), way.lanes.last())
            else {
                continue;
            };
            let start = rng.random_range(low..high);
            let placement = Placement {
                from: Spot::of(network, first, start),
                to: Spot::of(network, last, way.end(start, length)),
                via: Vec::new(),
                obstacle: None,
            };
            // The cheapest route there must be this way.
            let route = placement.route(network)?;
            let links: Vec<_> = route.links.iter().map(|link| link.link).collect();
            if links == way.links && (route.length() - length).abs() < 0.1 * length {
                return Ok(placement);
            }
        }
        let condition =
            format!("none of its {} ways is the shortest route from its start to its end", ways.len());
        Err(TaskError::NoPlace { task, condition })
    }

    fn roundabout(&self, network: &Network, rng: &mut ChaCha8Rng) -> Result<Placement, TaskError> {
        let passages = self.passages(network)?;
        for _ in 0..DRAWS {
            let Some(passage) = pick(rng, passages) else { break };
            let (Some(&entry), Some(&exit)) = (pick(rng, &passage.entries), pick(rng, &passage.exits)) else {
                continue;
            };
            let before = rng.random_range(ARM.0..ARM.1);
            let after = rng.random_range(ARM.0..ARM.1);
            let placement = Placement {
                from: before_end(network, entry, before),
                to: beyond_begin(network, exit, after),
                via: Vec::new(),
                obstacle: None,
            };
            let Ok(route) = placement.route(network) else { continue };
            let inside = |edge: &&sumo_network::network::EdgeId| passage.ring.contains(edge);
            if route.edges.iter().filter(inside).count() == passage.ring.len() && !changes_lane(&route) {
                return Ok(placement);
            }
        }
        let condition = format!(
            "none of {DRAWS} routes from a first arm to a third goes round without a lane change ({} pairs of arms)",
            passages.len()
        );
        Err(TaskError::NoPlace { task: TaskKind::Roundabout, condition })
    }
}

fn pick<'a, T>(rng: &mut ChaCha8Rng, from: &'a [T]) -> Option<&'a T> {
    (!from.is_empty()).then(|| &from[rng.random_range(0..from.len())])
}

/// The place `way` (m) before a lane's end, on the lanes that lead to it straight on where it is shorter;
/// as far as they go.
fn before_end(network: &Network, mut lane: LaneId, mut way: f64) -> Spot {
    for _ in 0..8 {
        let length = network.lane(lane).shape.length();
        if way <= length - survey::START_MARGIN {
            return Spot::of(network, lane, length - way);
        }
        let Some(link) = straight(network, &network.lane(lane).incoming, |link| link.from) else { break };
        way -= length + network.link_length(link);
        lane = network.link(link).from;
        // Not so near to the junction that it would begin there.
        way = way.max(survey::STOP_MARGIN);
    }
    Spot::of(network, lane, survey::START_MARGIN.min(0.5 * network.lane(lane).shape.length()))
}

/// The place `way` (m) beyond a lane's begin, on the lanes that follow it straight on where it is shorter;
/// as far as they go.
fn beyond_begin(network: &Network, mut lane: LaneId, mut way: f64) -> Spot {
    for _ in 0..8 {
        let length = network.lane(lane).shape.length();
        if way <= length - survey::END_MARGIN {
            return Spot::of(network, lane, way.max(0.0));
        }
        let Some(link) = straight(network, &network.lane(lane).outgoing, |link| link.to) else { break };
        way -= length + network.link_length(link);
        lane = network.link(link).to;
        way = way.max(survey::START_MARGIN);
    }
    let length = network.lane(lane).shape.length();
    Spot::of(network, lane, (length - survey::END_MARGIN).max(0.5 * length))
}

/// The link that goes straight on from or to an open lane.
fn straight(network: &Network, links: &[LinkId], end: impl Fn(&Link) -> LaneId) -> Option<LinkId> {
    links.iter().copied().find(|&id| {
        let link = network.link(id);
        link.direction == LinkDirection::Straight
            && network.lane(end(link)).permissions.allows(EGO_CLASS)
            && network.edge(network.lane(end(link)).edge).kind == EdgeKind::Normal
    })
}

fn changes_lane(route: &Route) -> bool {
    let change = |option| matches!(option, RoadOption::ChangeLaneLeft | RoadOption::ChangeLaneRight);
    route.sections.iter().any(|section| change(section.option))
}

fn obstacle(network: &Network, rng: &mut ChaCha8Rng) -> Result<Placement, TaskError> {
    let least = survey::START_MARGIN + TO_OBSTACLE.0 + BEYOND_OBSTACLE;
    let long: Vec<LaneId> = network
        .drivable_lanes(EGO_CLASS)
        .iter()
        .copied()
        .filter(|&l| network.lane(l).shape.length() > least)
        .filter(|&l| network.edge(network.lane(l).edge).kind == EdgeKind::Normal)
        .collect();
    let Some(&lane) = pick(rng, &long) else {
        let condition = format!("no lane is longer than {least:.0} m");
        return Err(TaskError::NoPlace { task: TaskKind::Obstacle, condition });
    };
    let length = network.lane(lane).shape.length();
    let farthest = TO_OBSTACLE.1.min(length - survey::START_MARGIN - BEYOND_OBSTACLE);
    let gap = rng.random_range(TO_OBSTACLE.0..farthest.max(TO_OBSTACLE.0 + 0.1));
    let start = rng
        .random_range(survey::START_MARGIN..(length - BEYOND_OBSTACLE - gap).max(survey::START_MARGIN + 0.1));
    let kind = ObstacleKind::ALL[rng.random_range(0..ObstacleKind::ALL.len())];
    Ok(Placement {
        from: Spot::of(network, lane, start),
        to: Spot::of(network, lane, length - 1.0),
        via: Vec::new(),
        obstacle: Some(ObstaclePlacement { kind, at: Spot::of(network, lane, start + gap) }),
    })
}

fn random(network: &Network, task: TaskKind, rng: ChaCha8Rng) -> Result<Placement, TaskError> {
    let no = |condition: String| TaskError::NoPlace { task, condition };
    let mut places = Destinations::new(network, rng).map_err(|error| no(error.to_string()))?;
    let mut longest = 0.0_f64;
    for _ in 0..DRAWS {
        let (from, to) = (places.place(network), places.place(network));
        let Ok(route) = network.route(from, to, EGO_CLASS) else { continue };
        longest = longest.max(route.length());
        if ROUTE_LENGTH.contains(&route.length()) {
            return Ok(Placement {
                from: Spot::of(network, from.lane, from.s),
                to: Spot::of(network, to.lane, to.s),
                via: Vec::new(),
                obstacle: None,
            });
        }
    }
    Err(no(format!(
        "it needs a route of {:.0} to {:.0} m, and the longest of {DRAWS} random ones is {longest:.0} m",
        ROUTE_LENGTH.start, ROUTE_LENGTH.end
    )))
}
