//! What an ego sees: its camera's frame becomes detections, lanes and the light, then the transformed image, then
//! 200 numbers.
//!
//! | module | what it is |
//! |---|---|
//! | [`eyes`] | camera, perception, encoder and decoder of one ego: the only place where an ego looks |
//! | [`perception`] | detections, lanes, light, vehicle in front, the transformed image |
//! | [`latent`] | the encoder-decoder: the transformed image as 200 numbers |
//! | [`observation`] | an agent's inputs of each tick |
//! | [`record`] | a drive as a film |
//! | `weights` | files of weights |

pub mod eyes;
pub mod latent;
pub mod observation;
pub mod perception;
pub mod record;
#[cfg(feature = "learn")]
pub mod torch;
#[cfg(feature = "learn")]
pub mod weights;
