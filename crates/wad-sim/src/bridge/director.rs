//! A director: commands to SUMO beside the egos', in the same message.

use super::Ego;
use sumo_network::network::Network;
use sumo_traci::Batch;

/// What a director knows before each step.
pub struct Scene<'a> {
    /// The town's road network.
    pub network: &'a Network,
    /// Since the bridge began (s).
    pub time: f64,
    /// Length of a tick (s).
    pub tick: f64,
    /// The first ego, with the world as it saw it after the last step.
    pub ego: &'a Ego,
}

/// Plays a scenario's events: appends commands to the message that carries the next step.
pub trait Director: Send {
    /// Called once, with the message that adds the egos. SUMO must refuse none of its commands.
    fn begin(&mut self, scene: &Scene<'_>, batch: &mut Batch);
    /// Called before every step, the first one too.
    fn direct(&mut self, scene: &Scene<'_>, batch: &mut Batch);
}
