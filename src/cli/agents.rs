//! Agents by their names on the command line.

use super::Exit;
use wad_cosim::agent::external::Limits;
use wad_cosim::assets::Assets;
use wad_cosim::camera::CameraConfig;
use wad_cosim::driver::{DriverError, DriverSpec, Made, Pilot};
use wad_cosim::latent::Decoder;
use wad_cosim::latent::Encoder;

/// Makes trained agents for the camera `camera`, and external agents with the time limits `limits`.
pub fn maker(
    camera: CameraConfig,
    limits: Limits,
) -> impl Fn(&DriverSpec) -> Result<Made, DriverError> + Sync {
    move |spec| Made::open(spec, None, &camera, limits)
}

/// The driver of a run in the town of `assets`, with camera, perception and, if asked for, mirrors if it looks.
pub fn pilot(
    assets: &Assets,
    spec: &DriverSpec,
    encoder: Option<&str>,
    detector: &str,
    mirrors: bool,
) -> anyhow::Result<Pilot> {
    if let Some(pilot) = Pilot::blind(spec) {
        return Ok(pilot);
    }
    let camera = CameraConfig::default();
    let made = Made::open(spec, encoder, &camera, Limits::default()).map_err(|e| Exit::Input.because(e))?;
    let pilot = Pilot::of_agent(assets, made.agent, made.encoder, detector, camera);
    pilot.and_then(|pilot| pilot.with_mirrors(mirrors)).map_err(|e| Exit::Input.because(e))
}

/// Whether the trained agent `name` learned from demonstrations; None if its file is missing or is not the
/// one with the identity `id`.
pub fn is_demonstrated(name: &str, id: &str) -> Option<bool> {
    if id.split(", ").next() != Some(Made::weights(name).as_str()) {
        return None;
    }
    let (policy, _) = wad_cosim::agent::policy::Policy::find(name).ok()?;
    Some(policy.card.demonstrations > 0)
}

/// The encoder called `name`, by default the bundled one.
pub fn default_encoder(name: Option<&str>) -> Result<Box<dyn Encoder>, DriverError> {
    Ok(wad_cosim::agent::policy::find_encoder(name.unwrap_or("default"))?)
}

/// The name of `agent`'s encoder: `asked`, else the agent's own, else the default.
pub fn sees_through(asked: Option<&str>, agent: Option<&str>) -> String {
    let own = || agent.and_then(wad_cosim::agent::policy::encoder_of);
    asked.map(str::to_string).or_else(own).unwrap_or_else(|| "default".to_string())
}

/// The decoder for latents of the encoder called `encoder`; None where this build or this
/// machine has none.
#[cfg(feature = "learn")]
pub fn decoder(encoder: &str) -> Option<Box<dyn Decoder>> {
    match wad_cosim::latent::TchEncoder::find(encoder) {
        Ok(encoder) => Some(Box::new(encoder)),
        Err(error) => {
            tracing::warn!("no reconstruction: {error}");
            None
        }
    }
}

#[cfg(not(feature = "learn"))]
pub fn decoder(_: &str) -> Option<Box<dyn Decoder>> {
    None
}
