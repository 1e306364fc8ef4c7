//! TraCI over TCP: SUMO's control protocol, async on tokio.

pub mod batch;
pub mod client;
pub mod codec;
pub mod connection;
pub mod domains;
pub mod error;
mod install;
mod port;
pub mod process;
pub mod replies;
pub mod subscription;
#[cfg(test)]
mod tests;
pub mod types;
pub mod variable;

pub use batch::{Batch, Ticket};
pub use client::{Client, TcpClient, Version};
pub use domains::{
    RemoveReason, Stage, StageKind, edge, gui, junction, lane, person, poi, polygon, route, simulation,
    traffic_light, vehicle, vehicle_type,
};
pub use error::{CommandError, Error};
pub use process::{Input, LaunchError, LaunchOptions, PostMortem, SumoInstall, SumoProcess};
pub use replies::Replies;
pub use subscription::{Filter, ObjectResults, Subscriptions};
pub use types::{Color, GeoPosition, Position2D, Position3D, RoadPosition};
pub use variable::{Domain, Query, Setter, Variable, VariableId};
