//! A town as cameras see it: the scene, the road users' models, and their motion from tick to tick.

use super::actors::{Animation, Cast};
use super::model::{ActorFrame, Instance, Scene};
use super::scene::{self, Look};
use std::sync::Arc;
use sumo_network::network::{Network, Shapes};
use sumo_network::world::{Actor, WorldState};

/// A town with road users. Any number of cameras may share it.
pub struct Town {
    built: Arc<(Scene, Cast)>,
    animation: Animation,
    frame: ActorFrame,
    ego: (Animation, ActorFrame),
}

impl Town {
    /// The town of a network and its polygons; equal `look`, equal town.
    pub fn new(network: &Network, shapes: &Shapes, look: Look) -> Self {
        Self::on(Arc::new(scene::build(network, shapes, look)))
    }

    /// The same town without road users, which then have their own motion. The scene is shared.
    #[must_use]
    pub fn share(&self) -> Self {
        Self::on(Arc::clone(&self.built))
    }

    fn on(built: Arc<(Scene, Cast)>) -> Self {
        Self { built, animation: Animation::default(), frame: ActorFrame::default(), ego: Default::default() }
    }

    /// Moves the road users to their places in `world`. `ego` is the ego as seen from outside.
    pub fn follow(&mut self, world: &WorldState, ego: Option<&Actor>) {
        self.animation.pose(&self.built.1, world, &mut self.frame);
        self.frame.ego = ego.and_then(|ego| {
            let alone = WorldState { vehicles: vec![ego.clone()], time: world.time, ..WorldState::default() };
            let (animation, frame) = &mut self.ego;
            animation.pose(&self.built.1, &alone, frame);
            frame.instances.pop().map(|instance| Instance { object: None, ..instance })
        });
    }

    /// The town without road users.
    pub fn scene(&self) -> &Scene {
        &self.built.0
    }

    /// The road users.
    pub fn actors(&self) -> &ActorFrame {
        &self.frame
    }
}
