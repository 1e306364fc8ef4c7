//! The camera: SUMO's town and traffic as pictures with ground truth.
//!
//! ```text
//! Network --scene--> Scene    (built once)     \
//! WorldState --actors--> ActorFrame (per tick)  > Camera::render --> Frame: rgb, depth, tags, ids, boxes
//! Weather (one of CARLA's 14)                  /
//! ```
//!
//! `camera.render(&scene, &actors, pose, &weather, Outputs::ALL) -> &Frame`, where `pose` is the ego's
//! (centre of the footprint, world frame) and the mount says where on it the camera sits.

pub mod actors;
pub mod grid;
pub mod model;
pub mod scene;
