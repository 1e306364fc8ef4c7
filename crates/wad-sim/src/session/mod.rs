//! One tick of the co-simulation for any number of egos. Nothing else steps the simulation.
//!
//! ```text
//! decide   the expert, if it drives or is asked           Session::plan, Act
//! signal   blinkers and brake lights for the others       Lamps
//! move     each ego's physics, contacts                   Ego::advance
//! step     poses to SUMO, one step, new worlds back       Bridge::step
//! judge    collisions, red lights, lane, arrival          Criteria::check
//! ```
//!
//! `run`, the environment, data collection and the benches add what they need before and after
//! [`Session::step`].

mod itinerary;
mod seat;

pub use itinerary::{Itinerary, ItineraryError};
pub use seat::Seat;

use crate::assets::Assets;
use crate::autopilot::Decision;
use crate::bridge::{Bridge, BridgeError, BridgeOptions, Ego};
use crate::criteria::{EgoOnRoute, Event};
use crate::scenario::Director;
use crate::{cores, cpu_time};
use std::sync::Arc;
use std::time::Instant;
use sumo_network::geometry::Point;
use sumo_network::network::{EdgeKind, LaneId, Network, Route};
use wad_vehicle::{Contact, Control, PartnerKind};

/// An ego begins at least this far from all others (m).
pub const APART: f64 = 25.0;
/// Within this distance of its start no vehicle is left (m).
const ROOM: f64 = 30.0;

/// What an ego does in a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Act {
    /// The expert (autopilot) drives: its control and its lamps.
    Expert,
    /// The expert drives, with this control in place of its own: noise, a slip, a learner. Its lamps.
    Disturbed(Control),
    /// Another driver's control. The lamps follow the route and the brake pedal.
    Control(Control),
    /// It was just placed and does not move: SUMO learns its new place, and it gets a world. Nothing is judged.
    Stay,
}

/// What happened to an ego in a tick.
#[derive(Clone, Debug)]
pub struct Tick {
    /// What was driven.
    pub control: Control,
    /// The expert's decision, if it drove or was asked.
    pub decision: Option<Decision>,
    /// Motion and place on the route at the tick's begin.
    pub before: EgoOnRoute,
    /// The same at the tick's end.
    pub after: EgoOnRoute,
    /// What the ego touched.
    pub contacts: Vec<Contact>,
    /// What happened, as the criteria see it.
    pub events: Vec<Event>,
}

/// Wall time of the ticks so far, by part (s).
#[derive(Clone, Copy, Debug, Default)]
pub struct Timings {
    /// The expert's decisions.
    pub expert: f64,
    /// The egos' physics.
    pub physics: f64,
    /// Poses out, SUMO's step, the new worlds decoded.
    pub bridge: f64,
    /// Of that: from sending the message to having the whole answer.
    pub sumo: f64,
    /// CPU time of `bridge` on our side.
    pub bridge_cpu: f64,
}

/// A co-simulation with its egos.
pub struct Session {
    assets: Arc<Assets>,
    bridge: Bridge,
    seats: Vec<Seat>,
    timings: Timings,
}

impl Session {
    /// Starts SUMO in the town of `assets`, and brings the egos of `seats` into it. Plays the town's
    /// scenario if `options.scenario` is set.
    ///
    /// # Errors
    /// See [`BridgeError`]; nothing is left running.
    pub async fn start(
        assets: &Arc<Assets>,
        options: &BridgeOptions,
        mut seats: Vec<Seat>,
    ) -> Result<Self, BridgeError> {
        if seats.len() >= cores::PARALLEL_FROM {
            cores::free_workers();
        }
        let mut bridge = Bridge::start_on(options, Some(Arc::clone(assets.network()))).await?;
        if let Some(scenario) = assets.scenario().filter(|_| options.scenario) {
            bridge.set_director(Box::new(Director::new(Arc::clone(scenario))));
        }
        bridge.spawn_all(&mut egos(&mut seats)).await?;
        Ok(Self { assets: Arc::clone(assets), bridge, seats, timings: Timings::default() })
    }

    /// The town.
    pub fn assets(&self) -> &Arc<Assets> {
        &self.assets
    }

    /// The co-simulation.
    pub fn bridge(&self) -> &Bridge {
        &self.bridge
    }

    /// The same, mutable, for messages to SUMO between the ticks.
    pub fn bridge_mut(&mut self) -> &mut Bridge {
        &mut self.bridge
    }

    /// The network.
    pub fn network(&self) -> &Arc<Network> {
        self.bridge.network()
    }

    /// The egos, in the order of [`Session::start`].
    pub fn seats(&self) -> &[Seat] {
        &self.seats
    }

    /// Ego number `index`.
    ///
    /// # Panics
    /// `index` is out of range.
    pub fn ego(&self, index: usize) -> &Ego {
        self.seats[index].ego()
    }

    /// The seat of ego number `index`.
    ///
    /// # Panics
    /// `index` is out of range.
    pub fn seat_mut(&mut self, index: usize) -> &mut Seat {
        &mut self.seats[index]
    }

    /// Bridge and seat together, for calls that need both.
    ///
    /// # Panics
    /// `index` is out of range.
    pub fn bridge_and_seat(&mut self, index: usize) -> (&mut Bridge, &mut Seat) {
        (&mut self.bridge, &mut self.seats[index])
    }

    /// Wall time by part.
    pub fn timings(&self) -> Timings {
        self.timings
    }

    /// What the expert of ego `index` decides for the next tick. It decides once a tick, however
    /// often it is asked.
    ///
    /// # Panics
    /// `index` is out of range.
    pub fn plan(&mut self, index: usize) -> Decision {
        let clock = Instant::now();
        let tick = self.bridge.tick();
        let decision = self.seats[index].plan(self.bridge.network(), tick);
        self.timings.expert += clock.elapsed().as_secs_f64();
        decision
    }

    /// One tick: `acts` has what each ego does, in the order of [`Session::seats`].
    ///
    /// # Errors
    /// SUMO died, hung, sent garbage or lost an ego.
    ///
    /// # Panics
    /// There is not one act for each ego.
    pub async fn step(&mut self, acts: &[Act]) -> Result<Vec<Tick>, BridgeError> {
        assert_eq!(acts.len(), self.seats.len(), "one act for each ego");
        for (index, act) in acts.iter().enumerate() {
            if matches!(act, Act::Expert | Act::Disturbed(_)) {
                self.plan(index);
            }
        }
        let tick = self.bridge.tick();
        let clock = Instant::now();
        // Each ego has a physics world of its own: the order does not matter.
        let seats = self.seats.iter_mut().zip(acts).collect();
        let mut ticks: Vec<Tick> =
            cores::each(seats, |(seat, act): (&mut Seat, &Act)| seat.drive(*act, tick));
        tell_both(&self.seats, &mut ticks);
        self.timings.physics += clock.elapsed().as_secs_f64();
        self.settle().await?;
        let network = self.bridge.network();
        for ((seat, act), tick_of) in self.seats.iter_mut().zip(acts).zip(&mut ticks) {
            if *act != Act::Stay {
                seat.judge(network, tick, tick_of);
            }
        }
        Ok(ticks)
    }

    /// One tick of a session with one ego.
    ///
    /// # Errors
    /// As [`Session::step`].
    ///
    /// # Panics
    /// There are more egos.
    pub async fn step_one(&mut self, act: Act) -> Result<Tick, BridgeError> {
        Ok(self.step(&[act]).await?.remove(0))
    }

    /// One step of SUMO in which no ego moves: SUMO learns the egos' new places, and each ego gets a world.
    ///
    /// # Errors
    /// As [`Session::step`].
    pub async fn settle(&mut self) -> Result<(), BridgeError> {
        let clock = Instant::now();
        let cpu = cpu_time::of_thread();
        let stepped = self.bridge.step(&mut egos(&mut self.seats)).await;
        let cpu = cpu_time::of_thread().zip(cpu).map_or(0.0, |(after, before)| after - before);
        self.timings.bridge_cpu += cpu;
        self.timings.bridge += clock.elapsed().as_secs_f64();
        self.timings.sumo = self.bridge.sumo_seconds();
        stepped
    }

    /// Places ego `index` on `route` at `s` (m), standing, and clears its memory. SUMO sees it there from the
    /// next step on.
    ///
    /// # Panics
    /// `index` is out of range.
    pub fn place(&mut self, index: usize, route: Route, s: f64) {
        self.seats[index].place(route, s, (0.0, 0.0));
    }

    /// Makes room for ego `index` at `start`: background vehicles there come back elsewhere. False if another ego is near, or
    /// a vehicle that cannot be removed.
    ///
    /// # Errors
    /// SUMO fails.
    pub async fn make_room(&mut self, index: usize, start: Point) -> Result<bool, BridgeError> {
        let others = self.seats.iter().enumerate().filter(|(other, _)| *other != index);
        if others.into_iter().any(|(_, other)| (start - other.ego().state().pose.xy()).norm() < APART) {
            return Ok(false);
        }
        let network = self.network();
        let is_road = |lane: &LaneId| {
            matches!(network.edge(network.lane(*lane).edge).kind, EdgeKind::Normal | EdgeKind::Internal)
        };
        let lanes: Vec<LaneId> =
            network.lanes_near(start, None, ROOM).iter().map(|near| near.lane).filter(is_road).collect();
        self.bridge.clear(start, ROOM, &lanes).await
    }

    /// Drops SUMO at once, and returns the seats for another session.
    pub fn into_seats(self) -> Vec<Seat> {
        self.seats
    }

    /// Ends SUMO in an orderly way.
    ///
    /// # Errors
    /// SUMO did not close the connection properly. It has ended even so.
    pub async fn close(self) -> Result<(), BridgeError> {
        self.bridge.close().await
    }
}

/// An ego that another one touches is told too: in its own physics the other may just have missed it.
fn tell_both(seats: &[Seat], ticks: &mut [Tick]) {
    if seats.len() < 2 {
        return;
    }
    for index in 0..seats.len() {
        let me = seats[index].ego();
        for contact in ticks[index].contacts.clone() {
            if contact.kind != PartnerKind::Vehicle {
                continue;
            }
            let known = me.world().vehicles.iter().find(|actor| actor.key == contact.key);
            let Some(actor) = known else { continue };
            let Some(other) = seats.iter().position(|seat| *seat.ego().id == *actor.id) else { continue };
            let partner = seats[other].ego();
            let known = partner.world().vehicles.iter().find(|actor| *actor.id == *me.id);
            let Some(mine) = known else { continue };
            let told = &mut ticks[other].contacts;
            if told.iter().all(|known| (known.kind, known.key) != (PartnerKind::Vehicle, mine.key)) {
                let place = me.state().pose.to_world(contact.point);
                let point = partner.state().pose.to_local(place);
                told.push(Contact { key: mine.key, point, ..contact });
            }
        }
    }
}

fn egos(seats: &mut [Seat]) -> Vec<&mut Ego> {
    seats.iter_mut().map(Seat::ego_mut).collect()
}
