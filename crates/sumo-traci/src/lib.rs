//! TraCI over TCP: SUMO's control protocol, async on tokio.
//!
//! SUMO runs in lock-step with its client: it waits for a message, carries out its commands, and answers
//! each. A round trip costs far more than a command, so commands go into a [`Batch`]. Each command
//! put in returns a [`Ticket`], which gives its typed result from the [`Replies`].
//! A command that SUMO refuses is an error at its ticket alone; an error of [`Client::send`] is the end
//! of the connection.
//!
//! ```no_run
//! use sumo_traci::{Batch, LaunchOptions, SumoProcess, person, simulation, vehicle};
//!
//! # async fn example() -> Result<(), Box<dyn std::error::Error>> {
//! let mut options = LaunchOptions::config("town.sumocfg").option("collision.action", "warn");
//! options.seed = Some(1);
//! // SUMO dies with `sumo`, and with this process.
//! let (mut sumo, mut client) = SumoProcess::launch(&options).await?;
//!
//! // Subscriptions: values that come with every step.
//! let mut batch = Batch::new();
//! batch.subscribe_context(
//!     vehicle::Vehicle, "ego", person::Person, 100.0,
//!     &[person::POSITION.id(), person::ANGLE.id()],
//! );
//! batch.step();
//! client.send(&batch).await?.check()?;
//!
//! for _ in 0..100 {
//!     batch.clear(); // keeps its memory
//!     let to = vehicle::MoveToXy { x: 10.0, y: 20.0, angle_deg: 90.0, ..Default::default() };
//!     vehicle::move_to_xy(&mut batch, "ego", &to);
//!     let time = batch.get(simulation::TIME, ""); // before the step
//!     batch.step(); // always the last command
//!     let replies = match client.send(&batch).await {
//!         Ok(replies) => replies,
//!         // Says how SUMO died, and quotes its log.
//!         Err(error) => return Err(sumo.explain(error).await.into()),
//!     };
//!     replies.check()?;
//!     println!("{} s", replies.get(time)?);
//!     for person in replies.subscriptions().context(vehicle::Vehicle, "ego", person::Person) {
//!         println!("{} is at {:?}", person.id(), person.value(person::POSITION)?);
//!     }
//! }
//! client.close().await?;
//! # Ok(())
//! # }
//! ```
//!
//! Layers, each usable alone: [`codec`] (bytes and values), [`connection`] (whole messages over any
//! stream), [`client`] (batches), [`process`] (SUMO as a child). The variables of each domain are
//! constants in its module: [`vehicle::SPEED`], [`lane::SHAPE`]; getters with parameters are functions
//! that return a [`Query`] for [`Batch::get_with`]; commands with several values are functions on a
//! batch. A variable that is missing here is one line: `Variable::<Vehicle, f64>::new(0x40, "speed")`.
//!
//! Units are SUMO's: m, s, m/s, degrees clockwise from north, positions of front bumpers.

pub mod batch;
pub mod cache;
pub mod client;
pub mod codec;
pub mod connection;
pub mod domains;
pub mod error;
mod install;
pub mod keeper;
mod port;
mod post_mortem;
pub mod process;
pub mod replies;
pub mod subscription;
#[cfg(test)]
mod tests;
pub mod types;
pub mod value;
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
pub use value::Value;
pub use variable::{Domain, Query, Setter, Variable, VariableId};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
