//! `run`: the autopilot or a trained agent drives one ego from destination to destination.

mod summary;

pub use summary::{CollisionCounts, Summary};

use crate::agent::AgentError;
use crate::driver::{Driver, Pilot, PilotRecord};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;
use summary::Totals;
use sumo_network::network::{LanePosition, Network};
use sumo_network::seeds;
use wad_camera::Preset;
use wad_see::eyes::{Eyes, EyesError, Look};
use wad_see::perception::EgoFacts;
use wad_sim::assets::{Assets, AssetsError};
use wad_sim::autopilot::{AutopilotParams, Decision};
use wad_sim::bridge::{Bridge, BridgeError, BridgeOptions, Ego};
use wad_sim::criteria::{CriteriaParams, Event};
use wad_sim::destination::{self, DestinationError};
use wad_sim::end::{self, End, Ending, Termination};
use wad_sim::scenario::Scenario;
use wad_sim::session::{Act, Itinerary, ItineraryError, Seat, Session};
use wad_sim::telemetry::{
    FolderError, LeaderRecord, LightRecord, RouteRecord, RunFolder, TickRecord, Wish, WriteError,
};
use wad_sim::traffic::{Counts, TrafficSpec};
use wad_vehicle::{Control, EgoParams};

/// A run's options; saved as its `config.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DriveOptions {
    /// SUMO, town, traffic and ticks.
    pub bridge: BridgeOptions,
    /// `FROM,TO` of the first route; None: drawn from the seed.
    pub route: Option<String>,
    /// The ego's physics.
    pub ego: EgoParams,
    /// The autopilot's constants.
    pub autopilot: AutopilotParams,
    /// Thresholds of the events.
    pub criteria: CriteriaParams,
    /// The run's folder.
    pub out: PathBuf,
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
        }
    }

    /// Options of a drive without results: all its files go into the folder `scratch`.
    pub fn passing(config: PathBuf, seed: u64, traffic: TrafficSpec, scratch: &Path) -> Self {
        let bridge = BridgeOptions { seed, traffic, ..BridgeOptions::new(config, scratch.join("sumo")) };
        Self::new(bridge, scratch.join("run"))
    }
}

/// Why a run could not start or go on.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// SUMO or the bridge fail.
    #[error(transparent)]
    Bridge(#[from] BridgeError),
    /// There is no route.
    #[error(transparent)]
    Destination(#[from] DestinationError),
    /// The run folder cannot be made.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// Telemetry or summary cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The town cannot be read.
    #[error(transparent)]
    Assets(#[from] AssetsError),
    /// The agent fails.
    #[error(transparent)]
    Agent(#[from] AgentError),
    /// Camera or perception fail.
    #[error(transparent)]
    Eyes(#[from] EyesError),
}

impl From<ItineraryError> for DriveError {
    fn from(error: ItineraryError) -> Self {
        match error {
            ItineraryError::Bridge(error) => error.into(),
            ItineraryError::Destination(error) => error.into(),
        }
    }
}

/// The contents of `config.json`.
#[derive(Serialize)]
struct RunConfig<'a> {
    #[serde(flatten)]
    options: &'a DriveOptions,
    /// The driver; None for the autopilot.
    #[serde(skip_serializing_if = "Option::is_none")]
    driver: Option<&'a PilotRecord>,
}

/// The facts of the status line.
#[derive(Clone, Debug)]
pub struct Status {
    /// The tick's telemetry.
    pub record: TickRecord,
    /// Ticks per second of wall time, lately.
    pub ticks_per_second: f64,
}

/// A running drive: a session of one ego that goes from destination to destination.
pub struct Drive {
    session: Session,
    pilot: Pilot,
    /// Camera and perception for the live view, if the driver has none.
    spare: Eyes,
    /// Whether the eyes have processed the current tick.
    looked: bool,
    itinerary: Itinerary,
    folder: RunFolder,
    options: DriveOptions,
    scenario: Option<Arc<Scenario>>,
    weather: Preset,
    totals: Totals,
    /// Wall time of the drivers, including camera and perception (s).
    piloting: f64,
    began: Instant,
    /// Requests since the last tick.
    wishes: Vec<Wish>,
    /// The viewer or agent that replaced the run's own driver.
    guest: Option<String>,
    /// The scenario's time limit (ticks), and how it ended.
    limit: Option<u64>,
    ending: Option<Ending>,
}

/// Wall time of the ticks so far, by part (s).
#[derive(Clone, Copy, Debug, Default)]
pub struct Timings {
    /// Bridge: sending poses, SUMO's step, decoding the new world.
    pub bridge: f64,
    /// SUMO's part of it: from sending the message to the complete answer.
    pub sumo: f64,
    /// Our CPU time in it.
    pub bridge_cpu: f64,
    /// The ego's physics.
    pub physics: f64,
    /// The driver, including camera, perception and encoder.
    pub agent: f64,
}

impl Drive {
    /// Reads the town, starts SUMO, draws or reads the first route, and puts the ego on it. The autopilot
    /// drives.
    ///
    /// # Errors
    /// Bad input, SUMO fails, or the run folder cannot be written. Nothing is left running.
    pub async fn start(options: DriveOptions) -> Result<Self, DriveError> {
        let plays = options.bridge.scenario;
        let assets = Assets::open(&options.bridge.config, plays)?;
        Self::start_in(&assets, options, Pilot::autopilot(), Preset::default()).await
    }

    /// The same in a loaded town, driven by `pilot` in `weather`. The autopilot
    /// then only reports what held the ego. The town's scenario is played, if it has one.
    ///
    /// # Errors
    /// As [`Drive::start`].
    pub async fn start_in(
        assets: &Arc<Assets>,
        mut options: DriveOptions,
        mut pilot: Pilot,
        weather: Preset,
    ) -> Result<Self, DriveError> {
        options.ego.check().map_err(BridgeError::from)?;
        pilot.reset(weather, options.bridge.seed);
        let record = (!pilot.driver.is_autopilot()).then_some(&pilot.record);
        let folder = RunFolder::create(&options.out, &RunConfig { options: &options, driver: record })?;
        let scenario = assets.scenario().cloned();
        if let Some(scenario) = &scenario {
            options.bridge.scenario = true;
            options.bridge.closed_lanes.clone_from(&scenario.closed_lanes);
        }
        let network = assets.network();
        network.require_drivable(destination::EGO_CLASS).map_err(BridgeError::from)?;
        let mut itinerary = Itinerary::new(network, seeds::rng(options.bridge.seed, "route"))?;
        let route = match (&options.route, &scenario) {
            (None, Some(scenario)) => scenario.route.clone(),
            (Some(text), _) => {
                let (from, to) = destination::parse_route(network, text)?;
                network.route(from, to, destination::EGO_CLASS).map_err(DestinationError::from)?
            }
            (None, None) => itinerary.first_route(network)?,
        };
        let (ego, autopilot, criteria) = (options.ego.clone(), options.autopilot, options.criteria);
        let seat = Seat::new(assets, "ego", ego, autopilot, criteria, route);
        let session = Session::start(assets, &options.bridge, vec![seat]).await?;
        let limit = scenario.as_ref().map(|scenario| scenario.tick_limit(session.bridge().tick()));
        Ok(Self {
            session,
            pilot,
            spare: Eyes::blind(),
            looked: false,
            itinerary,
            folder,
            options,
            scenario,
            weather,
            totals: Totals::default(),
            piloting: 0.0,
            began: Instant::now(),
            wishes: Vec::new(),
            guest: None,
            limit,
            ending: None,
        })
    }

    /// The co-simulation.
    pub fn bridge(&self) -> &Bridge {
        self.session.bridge()
    }

    /// The same, for requests to SUMO beside the drive.
    pub fn bridge_mut(&mut self) -> &mut Bridge {
        self.session.bridge_mut()
    }

    /// The town.
    pub fn assets(&self) -> &Arc<Assets> {
        self.session.assets()
    }

    /// The ego.
    pub fn ego(&self) -> &Ego {
        self.session.ego(EGO)
    }

    /// Times that the ego was moved to another place.
    pub fn respawns(&self) -> u64 {
        self.totals.respawns
    }

    /// How the scenario ended; None without a scenario or before its end.
    pub fn ending(&self) -> Option<&Ending> {
        self.ending.as_ref()
    }

    /// Wall time by part.
    pub fn timings(&self) -> Timings {
        let times = self.session.timings();
        Timings {
            bridge: times.bridge,
            sumo: times.sumo,
            bridge_cpu: times.bridge_cpu,
            physics: times.physics,
            agent: times.expert + self.piloting,
        }
    }

    /// Saves SUMO's state, persons and random generators included.
    ///
    /// # Errors
    /// SUMO fails or cannot write the file.
    pub async fn save_state(&mut self, file: &Path) -> Result<(), DriveError> {
        Ok(self.bridge_mut().save_state(file).await?)
    }

    /// The driver's eyes after this tick; if it has none, the eyes of [`Drive::watch_with`]. Renders once a
    /// tick, however often it is called.
    ///
    /// # Errors
    /// A stage of perception fails.
    pub fn look(&mut self) -> Result<&Eyes, DriveError> {
        let (ego, bridge) = (self.session.ego(EGO), self.session.bridge());
        let eyes = if self.pilot.driver.looks() { &mut self.pilot.eyes } else { &mut self.spare };
        if !self.looked {
            eyes.follow(ego.world());
            eyes.look(&EgoFacts::of(bridge.network(), ego, bridge.tick()))?;
            self.looked = true;
        }
        Ok(eyes)
    }

    /// The eyes as of their last frame.
    pub fn eyes(&self) -> &Eyes {
        if self.pilot.driver.looks() { &self.pilot.eyes } else { &self.spare }
    }

    /// The driver's last frame and percept; None if it is blind.
    pub fn last_look(&self) -> Option<Look> {
        if self.pilot.driver.looks() { self.pilot.eyes.last_look() } else { None }
    }

    /// Sets camera and perception for the live view while a blind driver drives (autopilot, manual, constant,
    /// random).
    pub fn watch_with(&mut self, mut eyes: Eyes) {
        eyes.reset(self.weather, self.options.bridge.seed);
        self.spare = eyes;
    }

    /// One tick: decide, move, step, judge, record.
    ///
    /// # Errors
    /// SUMO fails, or telemetry cannot be written.
    pub async fn tick(&mut self) -> Result<Status, DriveError> {
        self.tick_with(None).await
    }

    /// The same with a given control in place of the driver's: a viewer's, or a recorded one.
    ///
    /// # Errors
    /// As [`Drive::tick`].
    pub async fn tick_with(&mut self, given: Option<Control>) -> Result<Status, DriveError> {
        let tick = self.session.bridge().tick();
        // Every tick records what held the ego, for any driver.
        let decision = self.session.plan(EGO);
        let act = match given {
            // A control read back from text may differ in its last digit from the one that was driven.
            Some(given) if is_close(&given, &decision.control) => Act::Expert,
            Some(given) => Act::Control(given),
            None => {
                let clock = Instant::now();
                if self.pilot.driver.looks() {
                    self.look()?;
                }
                let act = self.pilot.driver.act(&self.pilot.eyes)?;
                self.piloting += clock.elapsed().as_secs_f64();
                act
            }
        };
        let done = self.session.step_one(act).await?;
        self.looked = false;
        self.totals.add(
            &decision,
            &done.before.state,
            &done.after.state,
            tick,
            self.session.bridge().counts(),
        );
        self.totals.judge(&done.events);
        self.totals.outside_ticks += u64::from(self.session.seats()[EGO].criteria().is_outside_lane());
        let network = self.session.network().clone();
        let record = self.record(&network, &decision, done.control, done.events);
        self.folder.record(&record)?;
        match self.scenario.clone() {
            Some(scenario) => self.judge(&scenario, &network, &record.events),
            None => self.go_on(&record.events).await?,
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
            Some((end, cause)) => Some(end::ending(scenario.task, end, cause)),
            None if self.limit.is_some_and(|limit| ticks >= limit) => {
                Some(end::judge_limit(scenario.task, &scenario.placement, ticks, network, self.ego()))
            }
            None => None,
        };
    }

    fn record(
        &mut self,
        network: &Network,
        decision: &Decision,
        control: Control,
        events: Vec<Event>,
    ) -> TickRecord {
        let ego = self.session.ego(EGO);
        let on_route = ego.on_route();
        let at = ego.route().at(on_route.s);
        let (vehicles, pedestrians) = self.session.bridge().counts();
        let autopilot_drives = self.pilot.driver.is_autopilot() && self.guest.is_none();
        TickRecord {
            tick: self.totals.ticks,
            time: self.session.bridge().time(),
            control,
            ego: on_route.state,
            route: RouteRecord {
                lane: network.lane(at.lane).id.clone(),
                s: on_route.s,
                d: on_route.d,
                length: ego.route().length(),
                option: at.option,
            },
            limit: at.speed_limit,
            light: decision.light.map(|(state, distance)| LightRecord { state, distance }),
            leader: decision.leader.map(|leader| LeaderRecord { gap: leader.gap_m, speed: leader.speed_mps }),
            reason: autopilot_drives.then_some(decision.reason),
            events,
            vehicles,
            pedestrians,
            wishes: std::mem::take(&mut self.wishes),
            driver: self.guest.clone(),
        }
    }

    /// Draws a new destination on arrival, and a new start if the ego is blocked or no way leads on.
    async fn go_on(&mut self, events: &[Event]) -> Result<(), DriveError> {
        let arrived = events.contains(&Event::Arrival);
        let goes_on = if arrived {
            self.itinerary.go_on(&mut self.session, EGO)
        } else {
            !events.contains(&Event::VehicleBlocked)
        };
        if goes_on { Ok(()) } else { self.start_elsewhere().await }
    }

    async fn start_elsewhere(&mut self) -> Result<(), DriveError> {
        self.itinerary.start_elsewhere(&mut self.session, EGO).await?;
        self.pilot.reset(self.weather, self.options.bridge.seed);
        self.spare.reset(self.weather, self.options.bridge.seed);
        self.looked = false;
        self.totals.respawns += 1;
        Ok(())
    }

    /// Grants a viewer's request before the next tick, which records it. False if it is impossible; nothing
    /// changes then.
    ///
    /// # Errors
    /// SUMO fails, or the net has nowhere to start.
    pub async fn grant(&mut self, wish: Wish) -> Result<bool, DriveError> {
        let granted = match wish {
            Wish::Respawn => {
                self.start_elsewhere().await?;
                true
            }
            Wish::NewRoute => self.leave_for(None),
            Wish::FindBack => {
                let to = self.ego().route().to;
                self.leave_for(Some(to))
            }
            Wish::Traffic { vehicles, pedestrians } => {
                self.bridge_mut().set_traffic(Counts::new(vehicles, pedestrians)).await?;
                true
            }
        };
        if granted {
            self.wishes.push(wish);
        }
        Ok(granted)
    }

    /// Routes the ego from its position to `to` or to a random place; false if no way leads there.
    fn leave_for(&mut self, to: Option<LanePosition>) -> bool {
        self.looked = false;
        self.itinerary.leave_for(&mut self.session, EGO, to)
    }

    /// Puts another driver at the wheel from the next tick on, and returns the one before. `guest` is what
    /// its name in telemetry, None for the run's own driver. It starts without memory, in the current
    /// weather.
    pub fn hand_over(&mut self, mut pilot: Pilot, guest: Option<String>) -> Pilot {
        self.guest = guest;
        pilot.reset(self.weather, self.options.bridge.seed);
        self.looked = false;
        std::mem::replace(&mut self.pilot, pilot)
    }

    /// The current driver.
    pub fn driver(&self) -> &Driver {
        &self.pilot.driver
    }

    /// Changes the camera's weather from the next tick on.
    pub fn set_weather(&mut self, weather: Preset) {
        self.weather = weather;
        self.pilot.eyes.set_weather(weather);
        self.spare.set_weather(weather);
        self.looked = false;
    }

    /// The camera's weather.
    pub fn weather(&self) -> Preset {
        self.weather
    }

    /// The summary so far. A run that is not over has survived until now.
    pub fn summary(&self, interrupted: bool) -> Summary {
        self.summary_of(End::Survived, interrupted)
    }

    /// `end` is that of a run without a scenario that ended one.
    fn summary_of(&self, end: End, interrupted: bool) -> Summary {
        let t = &self.totals;
        let per_tick = |sum: f64| if t.ticks == 0 { 0.0 } else { sum / t.ticks as f64 };
        let tick = self.session.bridge().tick();
        let wall_seconds = self.began.elapsed().as_secs_f64();
        Summary {
            town: self.session.bridge().config().name(),
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
            end: self.ending.as_ref().map_or(end, |ending| ending.end),
            success: self.ending.as_ref().map(|ending| ending.success),
            cause: self.ending.as_ref().map(|ending| ending.cause.clone()),
            interrupted,
            out: self.folder.path().to_path_buf(),
        }
    }

    /// After an error: writes a summary with the end `error`, and ends SUMO.
    ///
    /// # Errors
    /// The summary cannot be written.
    pub async fn abort(mut self) -> Result<(), DriveError> {
        let summary = self.summary_of(End::Error, false);
        Ok(self.folder.finish(&summary)?)
    }

    /// Ends SUMO and writes the summary.
    ///
    /// # Errors
    /// The summary cannot be written.
    pub async fn finish(mut self, interrupted: bool) -> Result<Summary, DriveError> {
        let summary = self.summary(interrupted);
        self.folder.finish(&summary)?;
        if let Err(error) = self.session.close().await {
            tracing::warn!("SUMO did not close properly: {error}");
        }
        Ok(summary)
    }
}

/// The run's only ego.
const EGO: usize = 0;

/// Equal but for the last digits that text loses.
fn is_close(a: &Control, b: &Control) -> bool {
    [(a.throttle, b.throttle), (a.steer, b.steer), (a.brake, b.brake)]
        .iter()
        .all(|(a, b)| (a - b).abs() < 1e-9)
}
