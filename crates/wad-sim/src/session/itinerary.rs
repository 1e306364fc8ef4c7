//! Random destinations, one after the other, for an ego without a fixed route.

use super::Session;
use crate::bridge::BridgeError;
use crate::destination::{self, DestinationError, Destinations, ROUTE_LENGTH};
use nalgebra::Point2;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::FRAC_PI_2;
use sumo_network::geometry;
use sumo_network::network::{LanePosition, NearLane, Network, Route};

/// Shortest route to a next destination (m).
const SHORTEST: f64 = 60.0;
/// Farthest lane from the ego on which a new route may begin (m).
const FIND_WITHIN: f64 = 30.0;
/// Random draws for a long enough route, and for a free place.
const DRAWS: usize = 20;

/// Draws destinations and the routes to them.
pub struct Itinerary {
    destinations: Destinations,
}

/// Why there is no next destination.
#[derive(Debug, thiserror::Error)]
pub enum ItineraryError {
    /// SUMO failed.
    #[error(transparent)]
    Bridge(#[from] BridgeError),
    /// The network has no such place, or none to drive to.
    #[error(transparent)]
    Destination(#[from] DestinationError),
}

impl Itinerary {
    /// Draws destinations on the roads of `network` with `rng`.
    ///
    /// # Errors
    /// No lane is open to the ego.
    pub fn new(network: &Network, rng: ChaCha8Rng) -> Result<Self, DestinationError> {
        Ok(Self { destinations: Destinations::new(network, rng)? })
    }

    /// A random route from a random place: the first of some length, else the longest found.
    ///
    /// # Errors
    /// No place leads to another.
    pub fn first_route(&mut self, network: &Network) -> Result<Route, DestinationError> {
        let mut best: Result<Route, DestinationError> = Err(DestinationError::NoLane);
        for _ in 0..DRAWS {
            let from: LanePosition = self.destinations.place(network);
            match (self.destinations.route_from(network, from), &best) {
                (Ok(route), _) if route.length() >= 4.0 * SHORTEST => return Ok(route),
                (Ok(route), Ok(longest)) if route.length() <= longest.length() => {}
                (Ok(route), _) => best = Ok(route),
                (Err(error), Err(_)) => best = Err(error.into()),
                (Err(_), Ok(_)) => {}
            }
        }
        best
    }

    /// The same, with a begin at least `apart` (m) from each of `others`; None if none was found.
    ///
    /// # Errors
    /// No place leads to another.
    pub fn route_apart(
        &mut self,
        network: &Network,
        others: &[Point2<f64>],
        apart: f64,
    ) -> Result<Option<Route>, DestinationError> {
        for _ in 0..DRAWS {
            let route = self.first_route(network)?;
            let start = route.at(0.0).pose.xy();
            if others.iter().all(|other| nalgebra::distance(&start, other) >= apart) {
                return Ok(Some(route));
            }
        }
        Ok(None)
    }

    /// Leads the route of ego `index` on to the destination after the next, before its end comes into view: how one must
    /// drive and what one must obey there depends on the way behind it. Call it in every tick: each draws one place, until
    /// one is as far away as a destination should be.
    pub fn plan_ahead(&mut self, session: &mut Session, index: usize) {
        let network = session.network().clone();
        let seat = session.seat_mut(index);
        let (route, s) = (seat.ego().route(), seat.ego().on_route().s);
        if seat.criteria().destination().is_some() {
            return;
        }
        if let Some(longer) = self.destinations.lead_on(&network, route, s)
            && ROUTE_LENGTH.contains(&(longer.length() - route.length()))
        {
            seat.lead_on(longer);
        }
    }

    /// Gives ego `index`, which has arrived, a route to another destination: the one that [`Itinerary::plan_ahead`] led it
    /// to, else a new one. False if no route leads on.
    pub fn go_on(&mut self, session: &mut Session, index: usize) -> bool {
        let network = session.network().clone();
        let ego = session.ego(index);
        if session.seats()[index].criteria().destination().is_some() {
            let (route, s) = network.drop_passed(ego.route(), ego.on_route().s);
            session.seat_mut(index).set_route(route, s);
            return true;
        }
        // The new route begins a car's length behind the ego, on the lane that it is on.
        let lane = ego.lane();
        let here = network.lane(lane).shape.project(ego.state().pose.xy()).s;
        let from = LanePosition { lane, s: (here - ego.params().length).max(0.0) };
        match self.destinations.route_from(&network, from) {
            Ok(route) if route.length() >= SHORTEST => {
                session.seat_mut(index).set_route(route, here - from.s);
                return true;
            }
            Ok(route) => {
                tracing::info!("the next route has only {:.0} m: starting elsewhere", route.length())
            }
            Err(error) => {
                tracing::info!("no route leads on from the destination: starting elsewhere: {error}")
            }
        }
        false
    }

    /// Places ego `index` elsewhere, at a free place if one is found.
    ///
    /// # Errors
    /// SUMO fails, or no place leads to another.
    pub async fn start_elsewhere(
        &mut self,
        session: &mut Session,
        index: usize,
    ) -> Result<(), ItineraryError> {
        let network = session.network().clone();
        let mut route = self.first_route(&network)?;
        for _ in 0..DRAWS {
            if session.make_room(index, route.at(0.0).pose.xy()).await? {
                break;
            }
            route = self.first_route(&network)?;
        }
        session.place(index, route, 0.0);
        Ok(())
    }

    /// Gives ego `index` a route from its place to `to`, or to a random place. False if no route leads there.
    pub fn leave_for(&mut self, session: &mut Session, index: usize, to: Option<LanePosition>) -> bool {
        let network = session.network().clone();
        let ego = session.ego(index);
        let (pose, length) = (ego.state().pose, ego.params().length);
        let drivable = network.drivable_lanes(destination::EGO_CLASS);
        let along = |near: &NearLane| {
            let heading = network.lane(near.lane).shape.at(near.s).heading;
            geometry::wrap_angle(heading - pose.heading).abs() < FRAC_PI_2
        };
        let near = network.lanes_near(pose.xy(), None, FIND_WITHIN);
        for near in near.iter().filter(|near| drivable.binary_search(&near.lane).is_ok() && along(near)) {
            let from = LanePosition { lane: near.lane, s: (near.s - length).max(0.0) };
            let route = match to {
                Some(to) => network.route(from, to, destination::EGO_CLASS),
                None => self.destinations.route_from(&network, from),
            };
            if let Some(route) = route.ok().filter(|route| route.length() >= 0.5 * SHORTEST) {
                session.seat_mut(index).set_route(route, near.s - from.s);
                return true;
            }
        }
        false
    }
}
