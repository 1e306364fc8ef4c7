//! `run`: the autopilot or a trained agent drives one ego from destination to destination.

mod summary;

pub use summary::{CollisionCounts, Summary};

use crate::autopilot::{Autopilot, AutopilotParams, Decision, EgoModel};
use crate::bridge::{Bridge, BridgeError, BridgeOptions, Ego, Lamps};
use crate::criteria::{Criteria, CriteriaParams, Event, Situation};
use crate::destination::{self, DestinationError, Destinations};
use crate::env::episode;
use crate::env::{Ending, Termination};
use crate::learned_driver::{DriverRecord, LearnedDriver, LearnedDriverError};
use crate::network::{LanePosition, Network, Polygon, Route, Shapes};
use crate::scenario::{Director, Scenario};
use crate::telemetry::{
    FolderError, LeaderRecord, LightRecord, RouteRecord, RunFolder, TickRecord, Wish, WriteError,
};
use crate::traffic::{Counts, TrafficSpec};
use crate::vehicle::{self, Control, EgoParams};
use crate::{cpu_time, seeds};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;
use summary::Totals;

/// What a run is made of; saved as its `config.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DriveOptions {
    pub bridge: BridgeOptions,
    /// `FROM,TO` of the first route; None: drawn from the seed.
    pub route: Option<String>,
    pub ego: EgoParams,
    pub autopilot: AutopilotParams,
    pub criteria: CriteriaParams,
    /// The run's folder.
    pub out: PathBuf,
    /// The scenario that the config is, to be played: its route, its events, its end.
    #[serde(skip)]
    pub scenario: Option<Arc<Scenario>>,
}

impl DriveOptions {
    /// The defaults: a route drawn from the seed, into the folder `out`.
    pub fn new(bridge: BridgeOptions, out: PathBuf) -> Self {
        Self {
            bridge,
            route: None,
            ego: Default::default(),
            autopilot: Default::default(),
            criteria: Default::default(),
            out,
            scenario: None,
        }
    }

    /// A drive that is only looked at or measured: everything it writes goes into `scratch`.
    pub fn passing(config: PathBuf, seed: u64, traffic: TrafficSpec, scratch: &Path) -> Self {
        let bridge = BridgeOptions { seed, traffic, ..BridgeOptions::new(config, scratch.join("sumo")) };
        Self::new(bridge, scratch.join("run"))
    }
}

/// Why a run could not start or go on.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    #[error(transparent)]
    Bridge(#[from] BridgeError),
    #[error(transparent)]
    Destination(#[from] DestinationError),
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error(transparent)]
    Write(#[from] WriteError),
    #[error(transparent)]
    Driver(#[from] LearnedDriverError),
}

/// What `config.json` holds.
#[derive(Serialize)]
struct RunConfig<'a> {
    #[serde(flatten)]
    options: &'a DriveOptions,
    /// Who drives, where it is not the autopilot.
    #[serde(skip_serializing_if = "Option::is_none")]
    driver: Option<&'a DriverRecord>,
}

/// What the status line shows.
#[derive(Clone, Debug)]
pub struct Status {
    pub record: TickRecord,
    pub ticks_per_second: f64,
}

/// A drive under way.
pub struct Drive {
    bridge: Bridge,
    ego: Ego,
    autopilot: Autopilot,
    driver: Option<LearnedDriver>,
    criteria: Criteria,
    destinations: Destinations,
    folder: RunFolder,
    options: DriveOptions,
    totals: Totals,
    timings: Timings,
    began: Instant,
    /// Asked for since the last tick.
    wishes: Vec<Wish>,
    /// Who took the wheel from the run's own driver.
    guest: Option<String>,
    /// Ticks that the scenario may take, and how it ended.
    limit: Option<u64>,
    ending: Option<Ending>,
}

/// Where the wall time of the ticks so far went (s).
#[derive(Clone, Copy, Debug, Default)]
pub struct Timings {
    /// Pose in, SUMO's step, the new world decoded.
    pub bridge: f64,
    /// Of that: from sending the message to having the whole answer.
    pub sumo: f64,
    /// CPU time of that on our side.
    pub bridge_cpu: f64,
    pub physics: f64,
    pub agent: f64,
}

impl Drive {
    /// Starts SUMO, draws or reads the first route, and puts the ego on it.
    ///
    /// # Errors
    /// Bad input, SUMO fails, or the run folder cannot be written. Nothing is left running.
    pub async fn start(options: DriveOptions) -> Result<Self, DriveError> {
        Self::start_with(options, None).await
    }

    /// The same with a trained agent at the wheel. The autopilot then only says what held the ego.
    ///
    /// # Errors
    /// As [`Drive::start`].
    pub async fn start_with(
        options: DriveOptions,
        driver: Option<LearnedDriver>,
    ) -> Result<Self, DriveError> {
        options.ego.check().map_err(BridgeError::from)?;
        let config = RunConfig { options: &options, driver: driver.as_ref().map(LearnedDriver::record) };
        let folder = RunFolder::create(&options.out, &config)?;
        let mut options = options;
        if let Some(scenario) = &options.scenario {
            options.bridge.scenario = true;
            options.bridge.closed_lanes.clone_from(&scenario.closed_lanes);
        }
        let mut bridge = Bridge::start(&options.bridge).await?;
        let network = bridge.network().clone();
        let rng = seeds::rng(options.bridge.seed, "route");
        let mut destinations = Destinations::new(&network, rng)?;
        if let Some(scenario) = &options.scenario {
            bridge.set_director(Box::new(Director::new(Arc::clone(scenario))));
        }
        let route = match (&options.route, &options.scenario) {
            (None, Some(scenario)) => scenario.route.clone(),
            (Some(text), _) => {
                let (from, to) = destination::parse_route(&network, text)?;
                network.route(from, to, destination::EGO_CLASS).map_err(DestinationError::from)?
            }
            (None, None) => first_route(&network, &mut destinations)?,
        };
        let mut ego = Ego::new("ego", options.ego.clone(), route, 0.0);
        ego.vehicle_mut().set_statics(vehicle::statics_from_network(&network, &polygons(&bridge, &network)));
        bridge.spawn(&mut ego).await?;
        let autopilot = Autopilot::new(options.autopilot, EgoModel::from(&options.ego));
        let limit = options.scenario.as_ref().map(|scenario| scenario.tick_limit(bridge.tick()));
        Ok(Self {
            limit,
            ending: None,
            bridge,
            ego,
            autopilot,
            driver,
            criteria: Criteria::new(options.criteria),
            destinations,
            folder,
            options,
            totals: Totals::default(),
            timings: Timings::default(),
            began: Instant::now(),
            wishes: Vec::new(),
            guest: None,
        })
    }

    /// The co-simulation.
    pub fn bridge(&self) -> &Bridge {
        &self.bridge
    }

    /// The same, for what is to be asked of SUMO beside the drive.
    pub fn bridge_mut(&mut self) -> &mut Bridge {
        &mut self.bridge
    }

    /// The ego.
    pub fn ego(&self) -> &Ego {
        &self.ego
    }

    /// How the scenario ended, where it is one and has.
    pub fn ending(&self) -> Option<&Ending> {
        self.ending.as_ref()
    }

    /// Where the wall time went.
    pub fn timings(&self) -> Timings {
        self.timings
    }

    /// Saves SUMO's state, persons and random generators included.
    ///
    /// # Errors
    /// SUMO fails or cannot write the file.
    pub async fn save_state(&mut self, file: &Path) -> Result<(), DriveError> {
        Ok(self.bridge.save_state(file).await?)
    }

    /// One tick: decide, move, step, judge, record.
    ///
    /// # Errors
    /// SUMO fails, or telemetry cannot be written.
    pub async fn tick(&mut self) -> Result<Status, DriveError> {
        self.tick_with(None).await
    }

    /// The same with a control that is given, in place of whoever drives: a recorded run driven again.
    ///
    /// # Errors
    /// As [`Drive::tick`].
    pub async fn tick_with(&mut self, given: Option<Control>) -> Result<Status, DriveError> {
        let tick = self.bridge.tick();
        let network = self.bridge.network().clone();
        let before = self.ego.on_route();
        let clock = Instant::now();
        let mut decision = self.autopilot.control(
            &network,
            self.ego.route(),
            before.s,
            &before.state,
            self.ego.world(),
            tick,
        );
        let decided = decision.control;
        if let Some(driver) = self.driver.as_mut().filter(|_| given.is_none()) {
            decision.control = driver.control(&network, &self.ego, tick)?;
            decision.brake_light = decision.control.brake > 0.05;
        }
        // A control read back from text may differ in its last digit from the one that was driven.
        if let Some(given) = given.filter(|given| !is_close(given, &decision.control)) {
            decision.control = given;
            decision.brake_light = given.brake > 0.05;
        }
        if decision.control != decided {
            self.autopilot.overruled();
        }
        self.ego.set_lamps(Lamps {
            blinker_left: decision.blinker_left,
            blinker_right: decision.blinker_right,
            brake: decision.brake_light,
        });
        let decided = clock.elapsed();
        let contacts = self.ego.advance(decision.control, tick);
        let moved = clock.elapsed();
        let cpu = cpu_time::of_thread();
        self.bridge.step(&mut [&mut self.ego]).await?;
        let cpu = cpu_time::of_thread().zip(cpu).map_or(0.0, |(after, before)| after - before);
        self.timings.bridge_cpu += cpu;
        self.timings.sumo = self.bridge.sumo_seconds();
        self.timings.agent += decided.as_secs_f64();
        self.timings.physics += (moved - decided).as_secs_f64();
        self.timings.bridge += (clock.elapsed() - moved).as_secs_f64();
        let after = self.ego.on_route();
        let params = self.ego.params();
        let events = self.criteria.check(&Situation {
            network: &network,
            route: self.ego.route(),
            world: self.ego.previous_world(),
            before,
            after,
            contacts: &contacts,
            static_label: &|key| self.ego.static_label(key),
            length: params.length,
            width: params.width,
            wheelbase: params.wheelbase,
            track: params.track,
            tick,
        });
        self.totals.add(&decision, &before.state, &after.state, tick, self.bridge.counts());
        self.totals.judge(&events);
        self.totals.outside_ticks += u64::from(self.criteria.is_outside_lane());
        let record = self.record(&network, &decision, events);
        self.folder.record(&record)?;
        match self.options.scenario.clone() {
            Some(scenario) => self.judge(&scenario, &network, &record.events),
            None => self.go_on(&network, &record.events).await?,
        }
        let elapsed = self.began.elapsed().as_secs_f64().max(1e-9);
        Ok(Status { record, ticks_per_second: self.totals.ticks as f64 / elapsed })
    }

    /// Whether the scenario has ended with this tick.
    fn judge(&mut self, scenario: &Scenario, network: &Network, events: &[Event]) {
        if self.ending.is_some() {
            return;
        }
        let ticks = self.totals.ticks;
        self.ending = match Termination::default().decide(events) {
            Some((end, cause)) => Some(episode::ending(scenario.task, end, cause)),
            None if self.limit.is_some_and(|limit| ticks >= limit) => {
                let (kind, placement) = (scenario.task, &scenario.placement);
                Some(episode::judge_limit(kind, placement, ticks, network, &self.ego))
            }
            None => None,
        };
    }

    fn record(&mut self, network: &Network, decision: &Decision, events: Vec<Event>) -> TickRecord {
        let on_route = self.ego.on_route();
        let at = self.ego.route().at(on_route.s);
        let (vehicles, pedestrians) = self.bridge.counts();
        TickRecord {
            tick: self.totals.ticks,
            time: self.bridge.time(),
            control: decision.control,
            ego: on_route.state,
            route: RouteRecord {
                lane: network.lane(at.lane).id.clone(),
                s: on_route.s,
                d: on_route.d,
                length: self.ego.route().length(),
                option: at.option,
            },
            limit: at.speed_limit,
            light: decision.light.map(|(state, distance)| LightRecord { state, distance }),
            leader: decision.leader.map(|leader| LeaderRecord { gap: leader.gap_m, speed: leader.speed_mps }),
            reason: (self.driver.is_none() && self.guest.is_none()).then_some(decision.reason),
            events,
            vehicles,
            pedestrians,
            wishes: std::mem::take(&mut self.wishes),
            driver: self.guest.clone(),
        }
    }

    /// A new destination on arrival; a new start where the ego is blocked or has nowhere to go.
    async fn go_on(&mut self, network: &Network, events: &[Event]) -> Result<(), DriveError> {
        let blocked = events.contains(&Event::VehicleBlocked);
        if events.contains(&Event::Arrival) {
            // The new route begins a car's length behind the ego, on the lane that it is on.
            let lane = self.ego.lane();
            let here = network.lane(lane).shape.project(self.ego.state().pose.xy()).s;
            let from = LanePosition { lane, s: (here - self.ego.params().length).max(0.0) };
            match self.destinations.route_from(network, from) {
                Ok(route) if route.length() >= SHORTEST_ROUTE => {
                    self.ego.set_route(route, here - from.s);
                    self.criteria.route_changed();
                    return Ok(());
                }
                Ok(route) => tracing::info!("only {:.0} m of way on, starting elsewhere", route.length()),
                Err(error) => tracing::info!("no way on from the destination, starting elsewhere: {error}"),
            }
        } else if !blocked {
            return Ok(());
        }
        self.start_elsewhere(network).await
    }

    async fn start_elsewhere(&mut self, network: &Network) -> Result<(), DriveError> {
        let mut route = first_route(network, &mut self.destinations)?;
        for _ in 0..20 {
            if self.bridge.is_free(&[route.at(0.0).lane]).await? {
                break;
            }
            route = first_route(network, &mut self.destinations)?;
        }
        self.ego.respawn(route, 0.0);
        if let Some(driver) = &mut self.driver {
            driver.reset();
        }
        self.criteria.route_changed();
        self.totals.respawns += 1;
        Ok(())
    }

    /// Does what a person asks for before the next tick, which records it. False where it cannot be done;
    /// everything stays as it is then.
    ///
    /// # Errors
    /// SUMO fails, or the net has nowhere to start.
    pub async fn grant(&mut self, wish: Wish) -> Result<bool, DriveError> {
        let network = self.bridge.network().clone();
        let granted = match wish {
            Wish::Respawn => {
                self.start_elsewhere(&network).await?;
                true
            }
            Wish::NewRoute => self.leave_for(&network, None),
            Wish::FindBack => {
                let to = self.ego.route().to;
                self.leave_for(&network, Some(to))
            }
            Wish::Traffic { vehicles, pedestrians } => {
                self.bridge.set_traffic(Counts::new(vehicles, pedestrians)).await?;
                true
            }
        };
        if granted {
            self.wishes.push(wish);
        }
        Ok(granted)
    }

    /// Sets out from where the ego is, to `to` or to a place that is drawn; false where no way leads there.
    fn leave_for(&mut self, network: &Network, to: Option<LanePosition>) -> bool {
        let pose = self.ego.state().pose;
        let drivable = network.drivable_lanes(destination::EGO_CLASS);
        let along = |near: &crate::network::NearLane| {
            let heading = network.lane(near.lane).shape.at(near.s).heading;
            crate::geometry::wrap_angle(heading - pose.heading).abs() < std::f64::consts::FRAC_PI_2
        };
        let near = network.lanes_near(pose.xy(), None, FIND_WITHIN);
        let fits = near.iter().filter(|near| drivable.binary_search(&near.lane).is_ok() && along(near));
        for near in fits {
            let from = LanePosition { lane: near.lane, s: (near.s - self.ego.params().length).max(0.0) };
            let route = match to {
                Some(to) => network.route(from, to, destination::EGO_CLASS),
                None => self.destinations.route_from(network, from),
            };
            if let Some(route) = route.ok().filter(|route| route.length() >= 0.5 * SHORTEST_ROUTE) {
                self.ego.set_route(route, near.s - from.s);
                self.criteria.route_changed();
                return true;
            }
        }
        false
    }

    /// Puts somebody else at the wheel from the next tick on: a trained agent, or, with None, the autopilot.
    /// `guest` is what telemetry calls him, None where he is the run's own driver.
    /// Returns the agent that drove before.
    pub fn hand_over(
        &mut self,
        driver: Option<LearnedDriver>,
        guest: Option<String>,
    ) -> Option<LearnedDriver> {
        self.guest = guest;
        std::mem::replace(&mut self.driver, driver)
    }

    /// The weather that a trained agent sees from the next tick on.
    pub fn set_weather(&mut self, weather: crate::camera::Preset) {
        if let Some(driver) = &mut self.driver {
            driver.set_weather(weather);
        }
    }

    /// The summary so far.
    pub fn summary(&self, end: &str, interrupted: bool) -> Summary {
        let t = &self.totals;
        let per_tick = |sum: f64| if t.ticks == 0 { 0.0 } else { sum / t.ticks as f64 };
        let tick = self.bridge.tick();
        let wall_seconds = self.began.elapsed().as_secs_f64();
        Summary {
            town: self.bridge.config().name(),
            seed: self.options.bridge.seed,
            ticks: t.ticks,
            tick_ms: tick * 1000.0,
            sim_seconds: t.ticks as f64 * tick,
            wall_seconds,
            ticks_per_second: t.ticks as f64 / wall_seconds.max(1e-9),
            distance_m: t.distance,
            mean_speed_mps: per_tick(t.distance / tick),
            mean_free_speed_mps: if t.free.0 == 0 { 0.0 } else { t.free.1 / t.free.0 as f64 },
            held_ticks: t.ticks - t.free.0,
            top_speed_mps: t.top_speed,
            destinations_reached: t.destinations,
            collisions: t.collisions,
            collisions_caused: t.caused,
            red_lights_run: t.red_lights,
            outside_lane_ticks: t.outside_ticks,
            sidewalk_events: t.sidewalk,
            vehicle_blocked: t.blocked,
            respawns: t.respawns,
            vehicles_mean: per_tick(t.vehicles as f64),
            pedestrians_mean: per_tick(t.pedestrians as f64),
            end: self.ending.as_ref().map_or(end, |ending| ending.end.name()).to_string(),
            success: self.ending.as_ref().map(|ending| ending.success),
            cause: self.ending.as_ref().map(|ending| ending.cause.clone()),
            interrupted,
            out: self.folder.path().to_path_buf(),
        }
    }

    /// After an error: keeps what was written, with a summary that says `error`, and lets SUMO go.
    ///
    /// # Errors
    /// The summary cannot be written.
    pub async fn abort(mut self) -> Result<(), DriveError> {
        let summary = self.summary("error", false);
        Ok(self.folder.finish(&summary)?)
    }

    /// Ends SUMO and writes the summary.
    ///
    /// # Errors
    /// The summary cannot be written.
    pub async fn finish(mut self, end: &str, interrupted: bool) -> Result<Summary, DriveError> {
        let summary = self.summary(end, interrupted);
        self.folder.finish(&summary)?;
        if let Err(error) = self.bridge.close().await {
            tracing::warn!("SUMO did not close properly: {error}");
        }
        Ok(summary)
    }
}

/// The polygons of the config's additional files.
pub(crate) fn polygons(bridge: &Bridge, network: &Network) -> Vec<Polygon> {
    let mut polygons = Vec::new();
    for file in bridge.config().additional_files() {
        match Shapes::load(&file, network) {
            Ok(shapes) => polygons.extend(shapes.polygons),
            Err(error) => tracing::warn!("no buildings from an additional file: {error}"),
        }
    }
    polygons
}

/// How far from a lane the ego may be to set out on it (m).
const FIND_WITHIN: f64 = 30.0;

/// A shorter way to the next destination is not worth going (m).
const SHORTEST_ROUTE: f64 = 60.0;

/// A random route from a random place: the first of some length, else the longest found.
pub(crate) fn first_route(
    network: &Network,
    destinations: &mut Destinations,
) -> Result<Route, DestinationError> {
    let mut best: Result<Route, DestinationError> = Err(DestinationError::NoLane);
    for _ in 0..20 {
        let from: LanePosition = destinations.place(network);
        match (destinations.route_from(network, from), &best) {
            (Ok(route), _) if route.length() >= 4.0 * SHORTEST_ROUTE => return Ok(route),
            (Ok(route), Ok(longest)) if route.length() <= longest.length() => {}
            (Ok(route), _) => best = Ok(route),
            (Err(error), Err(_)) => best = Err(error.into()),
            (Err(_), Ok(_)) => {}
        }
    }
    best
}

/// Equal but for the last digits that text loses.
fn is_close(a: &Control, b: &Control) -> bool {
    [(a.throttle, b.throttle), (a.steer, b.steer), (a.brake, b.brake)]
        .iter()
        .all(|(a, b)| (a - b).abs() < 1e-9)
}
