//! What the ego knows beside its camera.

use std::sync::Arc;
use sumo_network::network::{Network, Route};
use wad_sim::bridge::Ego;
use wad_sim::criteria::EgoOnRoute;

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
}
