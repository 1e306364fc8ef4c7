//! Where the ego starts and where it drives to, drawn from a seed or named by the user.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use sumo_network::network::{LaneId, LanePosition, Network, Route, RouteError, VehicleClass};

/// The ego's vehicle class.
pub const EGO_CLASS: VehicleClass = VehicleClass::Passenger;

/// Shortest lane to start or stop on (m).
const SHORTEST_LANE: f64 = 20.0;
/// Distance kept from a lane's ends (m).
const MARGIN: f64 = 12.0;
/// Wanted length of a drawn route (m).
pub const ROUTE_LENGTH: std::ops::Range<f64> = 300.0..1500.0;
/// Random places tried before the longest route found is used.
const TRIES: usize = 40;
/// A route that is led on gets longer when less than this is left of it (m), before its end comes into view.
const ONWARD: f64 = 250.0;

/// Why there is no place to drive.
#[derive(Debug, thiserror::Error)]
pub enum DestinationError {
    /// No such edge or lane.
    #[error(
        "no edge or lane `{name}` in the network; give edge or lane ids as in the .net.xml, e.g. --route {example}"
    )]
    Unknown {
        /// The given id.
        name: String,
        /// A route that would do, FROM,TO.
        example: String,
    },
    /// The argument is not two ids.
    #[error("`{given}` is not FROM,TO with two edge or lane ids of the network, e.g. --route {example}")]
    NotAPair {
        /// The argument.
        given: String,
        /// A route that would do, FROM,TO.
        example: String,
    },
    /// The edge or lane is closed to passenger cars.
    #[error("`{name}` has no lane that a passenger car may drive on")]
    NotDrivable {
        /// The given id.
        name: String,
    },
    /// The network has no lane long enough for a passenger car.
    #[error(
        "the network has no lane for a passenger car that is {SHORTEST_LANE} m or longer; the ego has nowhere to drive"
    )]
    NoLane,
    /// No route leads from one to the other.
    #[error(transparent)]
    Route(#[from] RouteError),
}

/// Draws places on the network from a seed.
#[derive(Debug)]
pub struct Destinations {
    rng: ChaCha8Rng,
    lanes: Vec<LaneId>,
}

impl Destinations {
    /// Places in the part of the network where one can drive on for ever, or, where the network
    /// has no such part, anywhere.
    ///
    /// # Errors
    /// No lane is open to passenger cars and long enough.
    pub fn new(network: &Network, rng: ChaCha8Rng) -> Result<Self, DestinationError> {
        let fits = |lane: &LaneId| network.lane(*lane).shape.length() >= SHORTEST_LANE;
        let mut lanes: Vec<LaneId> = network.largest_component(EGO_CLASS).into_iter().filter(fits).collect();
        if lanes.is_empty() {
            lanes = network.drivable_lanes(EGO_CLASS).iter().copied().filter(fits).collect();
        }
        if lanes.is_empty() { Err(DestinationError::NoLane) } else { Ok(Self { rng, lanes }) }
    }

    /// A random place to start or stop.
    pub fn place(&mut self, network: &Network) -> LanePosition {
        let lane = self.lanes[self.rng.random_range(0..self.lanes.len())];
        let length = network.lane(lane).shape.length();
        let margin = MARGIN.min(0.45 * length);
        LanePosition { lane, s: self.rng.random_range(margin..length - margin) }
    }

    /// A route from `from` to a random place.
    ///
    /// # Errors
    /// Nothing can be reached from there.
    pub fn route_from(&mut self, network: &Network, from: LanePosition) -> Result<Route, RouteError> {
        self.draw(network, |network, to| network.route(from, to, EGO_CLASS))
    }

    /// `route` led on to a random place before its end comes into view; None while more than 250 m are left of it from `s`
    /// (m) on, and where the place cannot be reached from its end. Call it in every tick: each draws one place.
    pub fn lead_on(&mut self, network: &Network, route: &Route, s: f64) -> Option<Route> {
        if route.length() - s > ONWARD {
            return None;
        }
        let (place, mut longer) = (self.place(network), route.clone());
        network.extend_route(&mut longer, place).ok().map(|()| longer)
    }

    fn draw(
        &mut self,
        network: &Network,
        make: impl Fn(&Network, LanePosition) -> Result<Route, RouteError>,
    ) -> Result<Route, RouteError> {
        let mut best: Result<Route, RouteError> = make(network, self.place(network));
        for _ in 0..TRIES {
            if best.as_ref().is_ok_and(|route| ROUTE_LENGTH.contains(&route.length())) {
                break;
            }
            let route = make(network, self.place(network));
            let length = |route: &Result<Route, RouteError>| route.as_ref().map_or(0.0, |r| r.length());
            let better = match (length(&best), length(&route)) {
                (best, new) if new > ROUTE_LENGTH.end => best == 0.0,
                (best, new) => new > best || best > ROUTE_LENGTH.end && new > 0.0,
            };
            if better {
                best = route;
            }
        }
        best
    }
}

/// The two ends of `FROM,TO`, each an edge or lane id (which may hold commas and begin with `-`).
///
/// # Errors
/// No split of the text gives two ids that cars may drive on.
pub fn parse_route(network: &Network, text: &str) -> Result<(LanePosition, LanePosition), DestinationError> {
    let example = || {
        let lanes = network.drivable_lanes(EGO_CLASS);
        let edge = |lane: Option<&LaneId>| lane.map_or("FROM", |l| &network.edge(network.lane(*l).edge).id);
        format!("{},{}", edge(lanes.first()), edge(lanes.last()))
    };
    let splits: Vec<(&str, &str)> =
        text.match_indices(',').map(|(i, _)| (text[..i].trim(), text[i + 1..].trim())).collect();
    let Some((from, to)) = splits
        .iter()
        .find(|(from, to)| is_known(network, from) && is_known(network, to))
        .or(splits.first())
        .copied()
    else {
        return Err(DestinationError::NotAPair { given: text.to_string(), example: example() });
    };
    let lane = |name: &str| {
        if !is_known(network, name) {
            return Err(DestinationError::Unknown { name: name.to_string(), example: example() });
        }
        lane_of(network, name).ok_or_else(|| DestinationError::NotDrivable { name: name.to_string() })
    };
    let (from, to) = (lane(from)?, lane(to)?);
    let length = |lane: LaneId| network.lane(lane).shape.length();
    // Room for the whole car behind the starting point; a stop well before the far end.
    let start = 6.0_f64.min(0.5 * length(from));
    let stop = (length(to) - MARGIN).max(0.5 * length(to));
    Ok((LanePosition { lane: from, s: start }, LanePosition { lane: to, s: stop }))
}

fn is_known(network: &Network, name: &str) -> bool {
    network.edge_by_id(name).is_some() || network.lane_by_id(name).is_some()
}

/// The lane of that id, or the outermost lane of the edge that a car may drive on.
fn lane_of(network: &Network, name: &str) -> Option<LaneId> {
    let drivable = |lane: &LaneId| network.lane(*lane).permissions.allows(EGO_CLASS);
    match network.lane_by_id(name) {
        Some(lane) => Some(lane).filter(drivable),
        None => network.edge(network.edge_by_id(name)?).lanes.iter().copied().find(drivable),
    }
}
