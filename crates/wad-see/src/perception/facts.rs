//! What the ego knows beside its camera.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::ops::Range;
use std::sync::Arc;
use sumo_network::geometry::{Point, Pose, Projection, wrap_angle};
use sumo_network::network::{Network, Route};
use sumo_network::seeds;
use wad_sim::bridge::Ego;
use wad_sim::criteria::EgoOnRoute;

/// Largest distance of a vehicle in front (m from the front bumper).
pub const SIGHT: f64 = 50.0;
/// How far along the route from the ego's centre on somebody is looked for (m).
pub(super) const REACH: f64 = SIGHT + 15.0;

/// What the ego knows beside its camera's frame: its motion, its waypoints, and the signals' states.
#[derive(Clone, Copy, Debug)]
pub struct EgoFacts<'a> {
    /// The town's road network.
    pub network: &'a Network,
    /// The ego's route.
    pub route: &'a Route,
    /// The ego's motion and place on the route.
    pub on_route: EgoOnRoute,
    /// The ego's length (m).
    pub length: f64,
    /// State strings by traffic light, as [`sumo_network::world::WorldState::traffic_lights`].
    pub signals: &'a [Option<Arc<str>>],
    /// Time since the last tick (s).
    pub tick: f64,
}

impl<'a> EgoFacts<'a> {
    /// The facts of an ego after a tick of `tick` s.
    pub fn of(network: &'a Network, ego: &'a Ego, tick: f64) -> Self {
        Self {
            network,
            route: ego.route(),
            on_route: ego.on_route(),
            length: ego.params().length,
            signals: &ego.world().traffic_lights,
            tick,
        }
    }

    /// Where `place` is on the route from the ego's centre on, as far as it can see. The offset of what is farther is no distance
    /// from the route.
    pub fn ahead(&self, place: Point) -> Projection {
        self.route.project_near(place, self.on_route.s, 0.0, REACH)
    }

    /// The same `distance` m farther along the route, as far from its middle and as askew: for looks from where the ego is
    /// not.
    #[must_use]
    pub fn moved(mut self, distance: f64) -> Self {
        let at = &mut self.on_route;
        let s = (at.s + distance).clamp(0.0, self.route.length());
        let (from, to) = (self.route.at(at.s).pose, self.route.at(s).pose);
        let is = at.state.pose;
        let place = to.to_world(from.to_local(is.xy()));
        let heading = wrap_angle(is.heading + to.heading - from.heading);
        at.state.pose = Pose::new(place.x, place.y, is.position.z + to.position.z - from.position.z, heading);
        at.front_s += s - at.s;
        at.s = s;
        self
    }
}

/// Draws how near the ego is to be put to whoever is next (m): nearer than the autopilot drives, too.
#[derive(Clone, Debug)]
pub struct NearGaps(ChaCha8Rng);

impl NearGaps {
    /// What is drawn from.
    pub const RANGE: Range<f64> = 0.2..5.0;

    /// Equal seeds, equal gaps.
    pub fn new(seed: u64) -> Self {
        Self(seeds::rng(seed, "gaps"))
    }

    /// The next one.
    pub fn draw(&mut self) -> f64 {
        self.0.random_range(Self::RANGE)
    }
}
