//! One SUMO with its egos, from episode to episode.

use super::episode::Episode;
use super::green::{self, Programs};
use super::obstacle;
use super::scratch::Scratch;
use super::slot::{Judge, Outcome, Slot, ego_id};
use super::{EnvError, EnvOptions, Stages, WorldMode};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use sumo_network::geometry::{Point, Vector};
use sumo_network::network::{Route, TrafficLightId};
use sumo_network::seeds;
use wad_see::eyes::{Eyes, LookTimes};
use wad_see::latent::Encoder;
use wad_sim::assets::Assets;
use wad_sim::autopilot::{AutopilotParams, Leader, Told, ToldLight};
use wad_sim::bridge::{BridgeError, BridgeOptions, Ego};
use wad_sim::cores;
use wad_sim::destination::Destinations;
use wad_sim::session::{APART, Act, Seat, Session};
use wad_sim::tasks::{Placement, TaskError, TaskSpec};
use wad_sim::traffic::TrafficSpec;

/// Failed starts of SUMO for one episode after which `reset` fails.
const ATTEMPTS: usize = 3;
/// Places drawn for one start.
const PLACES: usize = 12;

/// An ego that leaves goes so far beyond the net (m).
const AWAY: f64 = 500.0;

/// A task and the seed of an episode.
pub type Start<'a> = (&'a TaskSpec, u64);

/// A running SUMO with the egos in it.
struct Sumo {
    session: Session,
    /// The settings of its population.
    traffic: TrafficSpec,
    /// Of the lights that were held in it.
    programs: Programs,
    episodes: u64,
}

/// What ends a step that waits: see [`super::Env::give_up_when`].
pub type GiveUp = Box<dyn FnMut() -> bool + Send>;

/// A step that takes longer is asked whether it is given up, again and again (s).
const LONG: Duration = Duration::from_secs(1);
const GIVEN_UP: &str = "it was given up while SUMO did not answer";

pub struct World {
    assets: Arc<Assets>,
    options: EnvOptions,
    slots: Vec<Slot>,
    sumo: Option<Sumo>,
    /// The egos, while no SUMO runs.
    parked: Vec<Seat>,
    folder: Scratch,
    pub stages: Stages,
    pub give_up: Option<GiveUp>,
}

impl World {
    /// A world with one ego for each of `encoders`.
    pub fn new(
        assets: Arc<Assets>,
        options: EnvOptions,
        encoders: Vec<Box<dyn Encoder>>,
    ) -> Result<Self, EnvError> {
        options.ego.check().map_err(BridgeError::from)?;
        let folder = Scratch::new().map_err(|source| EnvError::Folder { source })?;
        let eyes = encoders.into_iter().map(|encoder| {
            let (mode, detector) = (options.observation, &options.detector);
            let eyes = Eyes::of_agent(&assets, mode, detector, options.camera, encoder)?;
            Ok(Slot::new(eyes.with_mirrors(options.mirrors)?))
        });
        let slots = eyes.collect::<Result<_, EnvError>>()?;
        Ok(Self {
            slots,
            assets,
            options,
            sumo: None,
            parked: Vec::new(),
            folder,
            stages: Stages::default(),
            give_up: None,
        })
    }

    /// Begins an episode of each ego.
    pub async fn reset(&mut self, starts: &[Start<'_>]) -> Result<(), EnvError> {
        let clock = Instant::now();
        self.slots.iter_mut().for_each(Slot::forget);
        let mut attempt = 0;
        let placements = loop {
            attempt += 1;
            match self.begin(starts).await {
                Ok(placements) => break placements,
                Err(EnvError::Bridge(error)) if !error.is_input() => {
                    self.park();
                    let (task, seed) = starts
                        .first()
                        .map_or_else(Default::default, |(task, seed)| (task.kind.to_string(), *seed));
                    if attempt == ATTEMPTS {
                        let source = Box::new(error);
                        return Err(EnvError::Start { attempts: ATTEMPTS, task, seed, source });
                    }
                    tracing::warn!("SUMO is started again for `{task}`, seed {seed}: {error}");
                }
                Err(error) => return Err(error),
            }
        };
        for (index, ((task, seed), placement)) in starts.iter().zip(placements).enumerate() {
            self.started(index, task, *seed, placement)?;
        }
        self.look()?;
        self.stages.resets += starts.len() as u64;
        self.stages.reset += clock.elapsed().as_secs_f64();
        Ok(())
    }

    /// The ego stands at its start: its episode begins.
    fn started(
        &mut self,
        index: usize,
        task: &TaskSpec,
        seed: u64,
        placement: Placement,
    ) -> Result<(), EnvError> {
        let Some(sumo) = &self.sumo else { return Err(EnvError::NoEpisode) };
        let tick = self.options.tick_ms / 1000.0;
        let length = sumo.session.ego(index).route().length();
        let limit = task.tick_limit.unwrap_or_else(|| task.kind.tick_limit(length, tick));
        let onward = if task.endless {
            let rng = seeds::rng(seed, "onward");
            let destinations = Destinations::new(self.assets.network(), rng);
            Some(
                destinations
                    .map_err(|error| TaskError::NoPlace { task: task.kind, condition: error.to_string() })?,
            )
        } else {
            None
        };
        self.slots[index].begin(Episode::new(task.clone(), placement, limit), onward, seed);
        Ok(())
    }

    /// Runs the egos' cameras and perception after a tick.
    fn look(&mut self) -> Result<(), EnvError> {
        let Some(sumo) = &self.sumo else { return Err(EnvError::NoEpisode) };
        let (network, tick) = (self.assets.network(), sumo.session.bridge().tick());
        let each_one = sumo.session.seats().iter().map(|_| ()).collect();
        let looked = each(&mut self.slots, sumo.session.seats(), each_one, |slot, seat, ()| {
            slot.look(network, seat.ego(), tick)
        });
        looked.into_iter().try_for_each(|times| {
            self.stages.looked(&times?);
            Ok(())
        })
    }

    /// Ends SUMO, and keeps the egos for the next one.
    fn park(&mut self) {
        if let Some(sumo) = self.sumo.take() {
            self.parked = sumo.session.into_seats();
        }
        // What an episode left behind went with its SUMO: the next one's lights are held anew.
        self.slots.iter_mut().for_each(Slot::moved_out);
    }

    /// Moves the egos to their starts, and prepares traffic, lights and obstacles for the tasks.
    async fn begin(&mut self, starts: &[Start<'_>]) -> Result<Vec<Placement>, EnvError> {
        let traffic = self.largest_traffic(starts.iter().map(|(task, _)| *task));
        let runs_on = self.options.world == WorldMode::Running
            && self.assets.scenario().is_none()
            && self.sumo.as_ref().is_some_and(|sumo| {
                let own = |t: TrafficSpec| t == TrafficSpec::AsIs;
                sumo.episodes < self.options.episodes_per_sumo && own(sumo.traffic) == own(traffic)
            });
        let going_on = if runs_on { self.run_on(traffic, starts).await? } else { None };
        let placements = match going_on {
            Some(placements) => placements,
            None => self.start(traffic, starts).await?,
        };
        for (index, ((task, _), placement)) in starts.iter().zip(&placements).enumerate() {
            self.prepare(index, task, placement).await?;
        }
        let Some(sumo) = &mut self.sumo else { return Err(EnvError::NoEpisode) };
        // One tick at standstill: SUMO gets the new route, and actors in sight get a speed.
        sumo.session.settle().await?;
        Ok(placements)
    }

    /// Moves the egos to their starts in the SUMO that runs; None where traffic leaves one of them no free place.
    async fn run_on(
        &mut self,
        traffic: TrafficSpec,
        starts: &[Start<'_>],
    ) -> Result<Option<Vec<Placement>>, EnvError> {
        for index in 0..starts.len() {
            self.leave(index, traffic).await?;
        }
        let mut placements = Vec::with_capacity(starts.len());
        for (index, (task, seed)) in starts.iter().enumerate() {
            let Some(placement) = self.go_on(index, task, *seed).await? else { return Ok(None) };
            placements.push(placement);
        }
        let Some(sumo) = &mut self.sumo else { return Err(EnvError::NoEpisode) };
        sumo.session.settle().await?;
        Ok(Some(placements))
    }

    /// Lights and obstacle of an ego's task, with the next step.
    async fn prepare(
        &mut self,
        index: usize,
        task: &TaskSpec,
        placement: &Placement,
    ) -> Result<(), EnvError> {
        let Some(sumo) = &mut self.sumo else { return Err(EnvError::NoEpisode) };
        sumo.episodes += 1;
        let others: Vec<TrafficLightId> = self.slots.iter().flat_map(|slot| slot.held.lights()).collect();
        let slot = &mut self.slots[index];
        slot.obstacle = placement.obstacle.is_some();
        let (bridge, seat) = sumo.session.bridge_and_seat(index);
        if task.kind.lights_are_green() {
            slot.held = green::hold(bridge, seat.ego().route(), &others, &mut sumo.programs).await?;
        }
        // A scenario's director puts its own.
        if let (Some(wanted), None) = (&placement.obstacle, self.assets.scenario()) {
            obstacle::put(bridge, seat.ego_mut(), wanted)?;
        }
        Ok(())
    }

    /// The largest traffic of `tasks`; the config's own counts as the smallest.
    fn largest_traffic<'a>(&self, tasks: impl Iterator<Item = &'a TaskSpec>) -> TrafficSpec {
        let town = self.assets.town_name();
        let size = |traffic: &TrafficSpec| traffic.counts(town).map(|c| c.vehicles + c.pedestrians);
        tasks.map(TaskSpec::traffic).max_by_key(size).unwrap_or(TrafficSpec::Empty)
    }

    /// The largest traffic of ego `index`'s `task` and those that the others drive.
    fn shared_traffic(&self, index: usize, task: &TaskSpec) -> TrafficSpec {
        let others =
            self.slots.iter().enumerate().filter(|(other, slot)| *other != index && slot.is_running());
        self.largest_traffic(others.filter_map(|(_, slot)| slot.task()).chain([task]))
    }

    /// Takes away what an ego's last episode left, and brings the traffic to its next size, with the next step.
    async fn leave(&mut self, index: usize, traffic: TrafficSpec) -> Result<(), EnvError> {
        let Some(sumo) = &mut self.sumo else { return Err(EnvError::NoEpisode) };
        let (bridge, seat) = sumo.session.bridge_and_seat(index);
        if let Some(counts) = traffic.counts(self.assets.town_name()) {
            bridge.set_traffic(counts).await?;
            sumo.traffic = traffic;
        }
        let slot = &mut self.slots[index];
        if std::mem::take(&mut slot.obstacle) {
            obstacle::take_away(bridge, seat.ego_mut());
        }
        green::release(bridge, &mut slot.held);
        Ok(())
    }

    fn place(&self, task: &TaskSpec, seed: u64) -> Result<(Placement, Route), EnvError> {
        let placement = match &task.placement {
            Some(placement) => placement.clone(),
            None => self.assets.place(task.kind, seed)?,
        };
        let route = placement.route(self.assets.network())?;
        Ok((placement, route))
    }

    /// Draws number `again` of a place for an episode, the first being its own.
    fn draw(&self, task: &TaskSpec, seed: u64, again: usize) -> Result<(Placement, Route), EnvError> {
        if again == 0 {
            self.place(task, seed)
        } else {
            self.place(task, seeds::derive(seed, &format!("place {again}")))
        }
    }

    /// How many draws a task is worth: its own placement is the only one.
    fn draws(task: &TaskSpec) -> usize {
        if task.placement.is_some() { 1 } else { PLACES }
    }

    /// A new SUMO with each ego at its route's begin.
    async fn start(
        &mut self,
        traffic: TrafficSpec,
        starts: &[Start<'_>],
    ) -> Result<Vec<Placement>, EnvError> {
        let mut places: Vec<(Placement, Route)> = Vec::with_capacity(starts.len());
        for (task, seed) in starts {
            let free =
                (0..Self::draws(task) * starts.len()).find_map(|again| match self.draw(task, *seed, again) {
                    Ok(place) if places.iter().all(|(_, other)| is_apart(&place.1, begin_of(other))) => {
                        Some(Ok(place))
                    }
                    Ok(_) => None,
                    Err(error) => Some(Err(error)),
                });
            places.push(free.unwrap_or_else(|| {
                Err(EnvError::Full {
                    egos: starts.len(),
                    fit: places.len(),
                    town: self.assets.name().to_string(),
                })
            })?);
        }
        // The old one goes before the new one comes.
        self.park();
        let seed = starts.first().map_or(0, |(_, seed)| *seed);
        let options = BridgeOptions {
            seed: seeds::derive(seed, "world"),
            tick_ms: Some(self.options.tick_ms),
            traffic,
            sight: self.options.sight,
            fetch: self.options.fetch,
            tick_timeout: self.options.tick_timeout,
            scenario: self.assets.scenario().is_some(),
            closed_lanes: self.assets.scenario().map_or(Vec::new(), |scenario| scenario.closed_lanes.clone()),
            gui: self.options.gui,
            ..BridgeOptions::new(self.assets.config(), self.sumo_folder())
        };
        let mut parked = std::mem::take(&mut self.parked).into_iter();
        let mut seats = Vec::with_capacity(starts.len());
        for (index, ((_, seed), (_, route))) in starts.iter().zip(&places).enumerate() {
            let mut seat = match parked.next() {
                Some(mut seat) => {
                    seat.ego_mut().forget();
                    seat
                }
                None => {
                    let (ego, criteria) = (self.options.ego.clone(), self.options.criteria);
                    let id = ego_id(index);
                    Seat::new(&self.assets, &id, ego, AutopilotParams::default(), criteria, route.clone())
                }
            };
            seat.place(route.clone(), 0.0, self.options.start.draw(*seed));
            seats.push(seat);
        }
        let session = Session::start(&self.assets, &options, seats).await?;
        self.sumo = Some(Sumo { session, traffic, programs: Programs::new(), episodes: 0 });
        Ok(places.into_iter().map(|(placement, _)| placement).collect())
    }

    fn sumo_folder(&self) -> PathBuf {
        self.folder.path().join("sumo")
    }

    /// Moves the ego to the begin of a route for the task where no other ego stands, and no road user that
    /// cannot be removed; None where no such place was drawn. The next step brings it there.
    async fn go_on(
        &mut self,
        index: usize,
        task: &TaskSpec,
        seed: u64,
    ) -> Result<Option<Placement>, EnvError> {
        for again in 0..Self::draws(task) {
            let (placement, route) = self.draw(task, seed, again)?;
            let Some(sumo) = &mut self.sumo else { return Err(EnvError::NoEpisode) };
            if sumo.session.make_room(index, begin_of(&route)).await? {
                sumo.session.seat_mut(index).place(route, 0.0, self.options.start.draw(seed));
                return Ok(Some(placement));
            }
        }
        Ok(None)
    }

    /// One tick in which each ego does its act; the outcome of each. Where SUMO dies, every episode that ran ends
    /// with an error.
    pub async fn step(&mut self, acts: &[Act]) -> Result<Vec<Outcome>, EnvError> {
        let Some(sumo) = &mut self.sumo else { return Err(EnvError::NoEpisode) };
        for (index, (slot, act)) in self.slots.iter_mut().zip(acts).enumerate() {
            if *act == Act::Expert {
                sumo.session.plan(index);
            }
            slot.go_onward(self.assets.network(), sumo.session.seat_mut(index).ego_mut());
        }
        let before = sumo.session.timings();
        let stepped = patient(sumo.session.step(acts), &mut self.give_up).await;
        let after = sumo.session.timings();
        self.stages.physics += after.physics - before.physics;
        self.stages.sumo += after.bridge - before.bridge;
        self.stages.steps += acts.iter().filter(|act| **act != Act::Stay).count() as u64;
        let (time, traffic) = (sumo.session.bridge().time(), sumo.session.bridge().counts());
        let ticks = match stepped {
            Some(Ok(ticks)) => ticks,
            Some(Err(error)) => return Ok(self.lost(&error.to_string())),
            None => return Ok(self.lost(GIVEN_UP)),
        };
        let network = self.assets.network();
        let judge = Judge { options: &self.options, network, time, traffic };
        let duration = sumo.session.bridge().tick();
        let ticks = acts.iter().zip(ticks).collect();
        let outcomes = each(&mut self.slots, sumo.session.seats(), ticks, |slot, seat, (act, tick)| {
            if *act != Act::Stay {
                slot.count();
            }
            // Off the road there is nothing to see.
            let away = seat.ego().is_away();
            let times = if away { LookTimes::default() } else { slot.look(network, seat.ego(), duration)? };
            Ok((times, slot.outcome(&judge, seat.ego(), tick)))
        });
        let outcomes: Result<Vec<(LookTimes, Outcome)>, EnvError> = outcomes.into_iter().collect();
        Ok(outcomes?
            .into_iter()
            .map(|(times, outcome)| {
                self.stages.looked(&times);
                outcome
            })
            .collect())
    }

    /// SUMO died: the episodes are lost, the next reset starts a new SUMO.
    fn lost(&mut self, why: &str) -> Vec<Outcome> {
        tracing::warn!("an episode is lost, its SUMO is replaced: {why}");
        let time = self.sumo.as_ref().map_or(0.0, |sumo| sumo.session.bridge().time());
        self.park();
        let egos = self.parked.iter().map(|seat| Some(seat.ego())).chain(std::iter::repeat(None));
        self.slots.iter_mut().zip(egos).map(|(slot, ego)| slot.lost(ego, time, why)).collect()
    }

    /// The expert's control for ego `index`.
    pub fn expert(&mut self, index: usize) -> Result<wad_vehicle::Control, EnvError> {
        let running = self.slots[index].is_running();
        let (true, Some(sumo)) = (running, &mut self.sumo) else { return Err(EnvError::NoEpisode) };
        let raw = self.slots[index].eyes().raw();
        let lead = raw.lead.filter(|_| self.options.told_lead);
        sumo.session.bridge_and_seat(index).1.tell(Told {
            light: (self.options.told_expert)
                .then_some(ToldLight { stop: raw.stop_light, limit: raw.speed_limit }),
            lead: lead.map(|lead| Leader { gap_m: lead.gap, speed_mps: lead.speed(raw.speed) }),
        });
        Ok(sumo.session.plan(index).control)
    }

    /// Whether the expert of ego `index` has been asked since the last tick.
    pub fn is_planned(&self, index: usize) -> bool {
        self.sumo.as_ref().is_some_and(|sumo| sumo.session.seats()[index].is_planned())
    }

    /// Whether an episode of ego `index` runs.
    pub fn is_running(&self, index: usize) -> bool {
        self.sumo.is_some() && self.slots[index].is_running()
    }

    /// Whether SUMO runs.
    pub fn has_sumo(&self) -> bool {
        self.sumo.is_some()
    }

    /// What follows for ego `index`, whose episode has ended: with a `start` its next one begins in running traffic.
    /// Without one, and where no place is free now, it leaves the road. The next step, in which it stays, brings
    /// it there. Gives the outcomes of that step where SUMO dies before it.
    pub async fn go_next(
        &mut self,
        index: usize,
        start: Option<Start<'_>>,
    ) -> Result<Option<Vec<Outcome>>, EnvError> {
        let mut give_up = self.give_up.take();
        let gone = patient(self.begin_again(index, start), &mut give_up).await;
        self.give_up = give_up;
        match gone {
            Some(Err(EnvError::Bridge(error))) if !error.is_input() => {
                Ok(Some(self.lost(&error.to_string())))
            }
            Some(gone) => gone.map(|()| None),
            None => Ok(Some(self.lost(GIVEN_UP))),
        }
    }

    async fn begin_again(&mut self, index: usize, start: Option<Start<'_>>) -> Result<(), EnvError> {
        if let Some(task) = start.map(|(task, _)| task).or(self.slots[index].task()) {
            let traffic = self.shared_traffic(index, task);
            self.leave(index, traffic).await?;
        }
        if let Some((task, seed)) = start
            && let Some(placement) = self.go_on(index, task, seed).await?
        {
            self.prepare(index, task, &placement).await?;
            self.started(index, task, seed, placement)?;
            self.stages.resets += 1;
            return Ok(());
        }
        let (corner, _) = self.assets.network().bounds;
        let Some(sumo) = &mut self.sumo else { return Err(EnvError::NoEpisode) };
        // Each at a place of its own, out of sight of the net and of each other.
        let place = corner - Vector::new(AWAY, AWAY * (1 + index) as f64);
        sumo.session.seat_mut(index).ego_mut().leave(place);
        Ok(())
    }

    /// Ends the episode of ego `index` without an outcome: its driver has failed.
    pub fn give_up(&mut self, index: usize) {
        self.slots[index].give_up();
    }

    /// Whether ego `index` is off the road.
    pub fn is_away(&self, index: usize) -> bool {
        self.ego(index).is_some_and(Ego::is_away)
    }

    pub async fn close(&mut self) {
        if let Some(sumo) = self.sumo.take()
            && let Err(error) = sumo.session.close().await
        {
            tracing::debug!("SUMO did not close properly: {error}");
        }
    }

    pub fn slots(&self) -> &[Slot] {
        &self.slots
    }

    pub fn ego(&self, index: usize) -> Option<&Ego> {
        let seats = self.sumo.as_ref().map_or(self.parked.as_slice(), |sumo| sumo.session.seats());
        seats.get(index).map(Seat::ego)
    }

    /// SUMO's process, for tests that kill it.
    pub fn sumo_pid(&self) -> Option<u32> {
        self.sumo.as_ref().and_then(|sumo| sumo.session.bridge().sumo_pid())
    }

    pub fn tick(&self) -> Duration {
        Duration::from_secs_f64(self.options.tick_ms / 1000.0)
    }

    pub fn assets(&self) -> &Arc<Assets> {
        &self.assets
    }

    pub fn options(&self) -> &EnvOptions {
        &self.options
    }
}

/// What `step` gives, or None where it takes long and is given up.
async fn patient<T>(step: impl Future<Output = T>, give_up: &mut Option<GiveUp>) -> Option<T> {
    let Some(give_up) = give_up else { return Some(step.await) };
    let mut step = std::pin::pin!(step);
    loop {
        match tokio::time::timeout(LONG, &mut step).await {
            Ok(done) => return Some(done),
            Err(_) if give_up() => return None,
            Err(_) => {}
        }
    }
}

/// `what` for each ego with its own one of `given`, on all cores where there are many.
fn each<G: Send, T: Send>(
    slots: &mut [Slot],
    seats: &[Seat],
    given: Vec<G>,
    what: impl Fn(&mut Slot, &Seat, G) -> T + Sync + Send,
) -> Vec<T> {
    let all = slots.iter_mut().zip(seats).zip(given).collect();
    cores::each(all, |((slot, seat), given)| what(slot, seat, given))
}

fn begin_of(route: &Route) -> Point {
    route.at(0.0).pose.xy()
}

fn is_apart(route: &Route, other: Point) -> bool {
    (begin_of(route) - other).norm() >= APART
}
