//! Agents by the names that the command line gives them.

use wad_cosim::agent::Agent;
use wad_cosim::agent::external::{ExternalAgent, Limits};
use wad_cosim::camera::CameraConfig;
use wad_cosim::eval::{DriverError, DriverSpec, Made};
use wad_cosim::latent::Encoder;

/// Makes trained agents behind the camera `camera`, and external ones that keep to `limits`.
pub fn maker(
    camera: CameraConfig,
    limits: Limits,
) -> impl Fn(&DriverSpec) -> Result<Made, DriverError> + Sync {
    move |spec| match spec {
        DriverSpec::Exec(command) => {
            let encoder = encoder()?;
            let id = format!("exec:{command}, encoder {}", encoder.hash());
            Ok(Made { agent: Box::new(ExternalAgent::new(command, limits)), encoder, id })
        }
        other => open(&other.to_string(), &camera),
    }
}

/// A trained agent, and the encoder that it sees through.
#[cfg(feature = "learn")]
fn open(name: &str, camera: &CameraConfig) -> Result<Made, DriverError> {
    let (agent, encoder) = wad_cosim::agent::policy::open(name, None, camera)?;
    let bytes = match wad_cosim::bundled::agent(name) {
        Some(bytes) if !std::path::Path::new(name).is_file() => bytes.to_vec(),
        _ => std::fs::read(name).unwrap_or_default(),
    };
    let id = format!("weights {:08x}, encoder {}", crc32fast::hash(&bytes), encoder.hash());
    Ok(Made { agent, encoder, id })
}

#[cfg(not(feature = "learn"))]
fn open(name: &str, _: &CameraConfig) -> Result<Made, DriverError> {
    Err(DriverError::Unknown { found: name.to_string() })
}

/// What the latent of an external agent is made with.
#[cfg(feature = "learn")]
fn encoder() -> Result<Box<dyn Encoder>, DriverError> {
    Ok(wad_cosim::agent::policy::find_encoder("default")?)
}

#[cfg(not(feature = "learn"))]
fn encoder() -> Result<Box<dyn Encoder>, DriverError> {
    Ok(Box::new(wad_cosim::latent::PooledEncoder))
}

/// The name of the encoder that belongs to `agent`: the one `asked` for, the agent's own, or the default.
#[cfg(feature = "learn")]
pub fn sees_through(asked: Option<&str>, agent: Option<&str>) -> String {
    let own = || agent.and_then(wad_cosim::agent::policy::encoder_of);
    asked.map(str::to_string).or_else(own).unwrap_or_else(|| "default".to_string())
}

#[cfg(not(feature = "learn"))]
pub fn sees_through(asked: Option<&str>, _: Option<&str>) -> String {
    asked.unwrap_or("default").to_string()
}

/// An agent, and what it sees through.
pub type Seeing = (Box<dyn Agent>, Box<dyn Encoder>);

/// The agent `name` for `run`, behind `encoder` or its own.
///
/// # Errors
/// There is no such agent or encoder, or they do not belong together.
#[cfg(feature = "learn")]
pub fn for_run(name: &str, encoder: Option<&str>, camera: &CameraConfig) -> Result<Seeing, DriverError> {
    match name.strip_prefix("exec:") {
        Some(command) => {
            let encoder = wad_cosim::agent::policy::find_encoder(encoder.unwrap_or("default"))?;
            Ok((Box::new(ExternalAgent::new(command, Limits::default())), encoder))
        }
        None => Ok(wad_cosim::agent::policy::open(name, encoder, camera)?),
    }
}

#[cfg(not(feature = "learn"))]
pub fn for_run(name: &str, _: Option<&str>, _: &CameraConfig) -> Result<Seeing, DriverError> {
    match name.strip_prefix("exec:") {
        Some(command) => Ok((Box::new(ExternalAgent::new(command, Limits::default())), encoder()?)),
        None => Err(DriverError::Unknown { found: name.to_string() }),
    }
}
