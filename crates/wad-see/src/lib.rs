//! What an ego sees: detections, lanes and the light from its camera's frame, then the transformed image, then
//! the latent of 200 numbers.
//!
//! | module | what it is |
//! |---|---|
//! | [`eyes`] | camera, perception, encoder and decoder of one ego, in one call |
//! | [`perception`] | detections, lanes, light, vehicle in front, the transformed image |
//! | [`inference`] | networks in numbers of 8 bits, by OpenVINO |
//! | [`latent`] | the encoder-decoder: the transformed image as 200 numbers |
//! | [`observation`] | an agent's inputs of each tick |
//! | [`surroundings`] | the same from the world itself, without a camera |
//! | [`record`] | a drive as a film |
//! | [`weights`] | files of weights |

pub mod eyes;
pub mod foxglove;
pub mod inference;
pub mod latent;
pub mod observation;
pub mod perception;
pub mod record;
pub mod surroundings;
#[cfg(feature = "learn")]
pub mod torch;
pub mod weights;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
