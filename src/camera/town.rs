//! A town as cameras see it: the scene, the road users' models, and their motion from tick to tick.

use super::actors::{Animation, Cast};
use super::model::{ActorFrame, Instance, Scene};
use super::scene;
use crate::network::{Network, Shapes};
use crate::world::{Actor, WorldState};

/// What cameras look at. Any number of cameras may share it.
pub struct Town {
    scene: Scene,
    cast: Cast,
    animation: Animation,
    frame: ActorFrame,
    ego: (Animation, ActorFrame),
}

impl Town {
    /// The town of a network and its polygons; equal `seed`, equal town.
    pub fn new(network: &Network, shapes: &Shapes, seed: u64) -> Self {
        let (scene, cast) = scene::build(network, shapes, seed);
        Self {
            scene,
            cast,
            animation: Animation::default(),
            frame: ActorFrame::default(),
            ego: Default::default(),
        }
    }

    /// Moves the road users to where a tick has them. `ego` is how the ego looks from outside.
    pub fn follow(&mut self, world: &WorldState, ego: Option<&Actor>) {
        self.animation.pose(&self.cast, world, &mut self.frame);
        self.frame.ego = ego.and_then(|ego| {
            let alone = WorldState { vehicles: vec![ego.clone()], time: world.time, ..WorldState::default() };
            let (animation, frame) = &mut self.ego;
            animation.pose(&self.cast, &alone, frame);
            frame.instances.pop().map(|instance| Instance { object: None, ..instance })
        });
    }

    /// The town without road users.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The road users.
    pub fn actors(&self) -> &ActorFrame {
        &self.frame
    }
}
