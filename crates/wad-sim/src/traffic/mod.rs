//! Background traffic on demand: a fixed number of vehicles and pedestrians alive, at seeded random
//! places on seeded random trips.
//!
//! [`TrafficSpec`] says how many; [`Population`] keeps them alive. It never talks to SUMO itself: it
//! appends commands to the batch that the caller sends with the next step anyway, and reads what
//! the last one brought. On a tick where nothing is due it asks SUMO three numbers at most.
//!
//! ```no_run
//! # async fn example(mut client: sumo_traci::TcpClient) -> Result<(), Box<dyn std::error::Error>> {
//! use std::{path::Path, sync::Arc};
//! use sumo_network::network::Network;
//! use sumo_traci::Batch;
//! use wad_sim::traffic::{Counts, Options, Population, StepEvents};
//!
//! let network = Arc::new(Network::load(Path::new("town5.net.xml"))?);
//! let mut population = Population::new(network, Counts::new(70, 100), 1, Options::default());
//! let mut batch = Batch::new();
//! Population::subscribe(&mut batch);
//! Population::define_types(&mut batch);
//! population.populate(&mut batch, &[]);
//! for _ in 0..600 {
//!     batch.step();
//!     let replies = client.send(&batch).await?;
//!     batch.clear();
//!     let events = StepEvents::read(&replies)?;
//!     population.update(&events, &replies, &[], &[], &mut batch);
//! }
//! # Ok(())
//! # }
//! ```

mod draw;
mod events;
mod fleet;
mod pedestrians;
mod places;
mod reserve;
mod roads;
mod schedule;
mod slots;
mod spec;
mod vehicles;
mod walks;

pub use events::StepEvents;
pub use fleet::{FLEET, Model, Normc, Rgb, WALKERS, Walker};
pub use places::Avoid;
pub use spec::{Counts, TrafficSpec, TrafficSpecError};

use pedestrians::Pedestrians;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use sumo_network::geometry::{Point, Pose};
use sumo_network::network::Network;
use sumo_traci::subscription::Subscribed;
use sumo_traci::{Batch, RemoveReason, Replies, Ticket, person, vehicle};
use vehicles::{Scene, Vehicles};

/// The settings of a population.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Areas where no road user is added.
    pub avoid: Avoid,
    /// Length of a vehicle's trip, drawn between these (m), 500 at the least. The longer, the rarer
    /// are vehicles replaced.
    pub trip_length: (f64, f64),
    /// Length of a pedestrian's walk, drawn between these (m).
    pub walk_length: (f64, f64),
    /// A vehicle that has stood still for longer (s), out of the ego's sight, is replaced.
    pub stuck_after: f64,
    /// Removes vehicles and persons of a config's additional files, in the tick after they departed: all
    /// that are neither in the population nor in `keep`.
    pub alone: bool,
    /// Ids of others that stay, e.g. the ego's.
    pub keep: Vec<String>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            avoid: Avoid::default(),
            trip_length: (2000.0, 5000.0),
            walk_length: (300.0, 900.0),
            stuck_after: 180.0,
            alone: false,
            keep: Vec::new(),
        }
    }
}

/// The background vehicles and pedestrians of one SUMO run.
///
/// Ids begin with `wad_v` and `wad_p`, vehicle types and routes with `wad_`. Equal network, counts,
/// seed, options and events give equal commands.
#[derive(Debug)]
pub struct Population {
    wanted: Counts,
    options: Options,
    vehicles: Vehicles,
    pedestrians: Pedestrians,
    /// Vehicles from the config that were taken out; see [`Population::taken_out`].
    others_out: usize,
}

impl Population {
    /// A population of `counts` for a network; nothing is put into SUMO yet.
    pub fn new(network: Arc<Network>, counts: Counts, seed: u64, options: Options) -> Self {
        // A stream each: the number of pedestrians changes nothing about the vehicles' draws.
        let stream = |number| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(number);
            rng
        };
        Self {
            wanted: counts,
            vehicles: Vehicles::new(Arc::clone(&network), options.clone(), stream(1)),
            pedestrians: Pedestrians::new(network, options.clone(), stream(2)),
            options,
            others_out: 0,
        }
    }

    /// Subscribes to what [`StepEvents::read`] needs; once per run. See [`StepEvents::variables`] for
    /// a caller with a subscription to the simulation of its own.
    pub fn subscribe(batch: &mut Batch) -> Ticket<Subscribed> {
        StepEvents::subscribe(batch)
    }

    /// Defines the fleet's vehicle types in SUMO; once per run, before the first vehicle of them.
    pub fn define_types(batch: &mut Batch) {
        fleet::define(batch);
    }

    /// Adds the whole population to the town, to depart with the next step: the caller sends the batch with
    /// a step. Returns how many found a place: fewer than asked for where the town is full, or has
    /// no sidewalks; a warning says so, and the population is kept at that number.
    pub fn populate(&mut self, batch: &mut Batch, egos: &[Pose]) -> Counts {
        let vehicles = self.vehicles.populate(self.wanted.vehicles, egos, batch);
        if vehicles < self.wanted.vehicles {
            tracing::warn!(
                "the net has room for {vehicles} background vehicles, not for {}: going on with {vehicles}",
                self.wanted.vehicles
            );
        }
        let mut pedestrians = 0;
        if self.wanted.pedestrians > 0 && !self.pedestrians.possible() {
            tracing::warn!(
                "the net has no sidewalks joined by walkingareas: going on without the {} pedestrians asked \
                 for (netconvert --sidewalks.guess --crossings.guess --walkingareas adds some)",
                self.wanted.pedestrians
            );
        } else {
            pedestrians = self.pedestrians.populate(self.wanted.pedestrians, egos, batch);
            if pedestrians < self.wanted.pedestrians {
                tracing::warn!(
                    "the net has room for {pedestrians} pedestrians, not for {}: going on with {pedestrians}",
                    self.wanted.pedestrians
                );
            }
        }
        Counts::new(vehicles, pedestrians)
    }

    /// Reads one step, and appends to the next tick's batch what is needed: replacements, longer trips,
    /// queries. `events` and `replies` belong to the message that carried the step, whose batch this
    /// population appended to; `near` are the positions of road users near the egos (m).
    ///
    /// A vehicle or pedestrian that arrived in the step is back, elsewhere and out of sight, with the
    /// next one.
    pub fn update(
        &mut self,
        events: &StepEvents<'_>,
        replies: &Replies,
        egos: &[Pose],
        near: &[Point],
        batch: &mut Batch,
    ) {
        if self.options.alone {
            self.remove_others(events, batch);
        }
        let scene = Scene { time: events.time, egos, near };
        self.vehicles.update(events, replies, scene, batch);
        self.pedestrians.update(events, replies, scene, batch);
    }

    /// Keeps `counts` alive from now on. Surplus ones are removed with the caller's next message; more
    /// come, out of the ego's sight, with the next updates. A net without sidewalks gets no pedestrians.
    pub fn resize(&mut self, counts: Counts, batch: &mut Batch) {
        self.wanted = counts;
        self.vehicles.resize(counts.vehicles, batch);
        let pedestrians = if self.pedestrians.possible() { counts.pedestrians } else { 0 };
        self.pedestrians.resize(pedestrians, batch);
    }

    /// Never removes the vehicle `id`: an ego, or its obstacle.
    pub fn keep(&mut self, id: &str) {
        if self.options.keep.iter().all(|kept| kept != id) {
            self.options.keep.push(id.to_string());
        }
    }

    /// The wanted size of the population.
    pub fn wanted(&self) -> Counts {
        self.wanted
    }

    /// Removes vehicles with the caller's next message and adds them elsewhere: they are where the ego is
    /// placed.
    pub fn evict<'a>(&mut self, ids: impl IntoIterator<Item = &'a str>, batch: &mut Batch) {
        for id in ids {
            self.vehicles.evict(id, batch);
        }
    }

    /// How many vehicles that were in the network were taken out since the last call: with the caller's next
    /// message they are gone, and SUMO does not say that they arrive.
    pub fn taken_out(&mut self) -> usize {
        self.vehicles.taken_out() + std::mem::take(&mut self.others_out)
    }

    /// How many of the population are in the network, as of the last [`Population::update`].
    pub fn alive(&self) -> Counts {
        Counts::new(self.vehicles.alive(), self.pedestrians.alive())
    }

    /// Whether a vehicle or person is one of the population.
    pub fn owns(&self, id: &str) -> bool {
        self.vehicles.owns(id) || self.pedestrians.owns(id)
    }

    fn remove_others(&mut self, events: &StepEvents<'_>, batch: &mut Batch) {
        let mut others_out = 0;
        let foreign = |id: &&&str| !self.owns(id) && !self.options.keep.iter().any(|k| k == **id);
        for id in events.departed.iter().filter(foreign) {
            tracing::debug!(id, "vehicle from the config is removed");
            vehicle::remove(batch, id, RemoveReason::Vaporized);
            others_out += 1;
        }
        for id in events.departed_persons.iter().filter(foreign) {
            tracing::debug!(id, "person from the config is removed");
            person::remove(batch, id, RemoveReason::Vaporized);
        }
        self.others_out += others_out;
    }
}
