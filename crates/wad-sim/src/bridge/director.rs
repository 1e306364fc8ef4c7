//! A director: commands to SUMO beside the egos', in the same message.

use super::Ego;
use sumo_network::network::Network;
use sumo_traci::Batch;

/// What a director knows when its turn comes.
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

/// Plays what a scenario has written: it appends commands to the message that carries the next step.
pub trait Director: Send {
    /// Once, with the message that brings the egos in. SUMO must refuse none of its commands.
    fn begin(&mut self, scene: &Scene<'_>, batch: &mut Batch);
    /// Before every step, that first one too.
    fn direct(&mut self, scene: &Scene<'_>, batch: &mut Batch);
}
