//! One SUMO with the ego in it, from episode to episode.

use super::episode::{Episode, nowhere};
use super::green::{self, Held};
use super::obstacle;
use super::scratch::Scratch;
use super::{EnvError, EnvOptions, Info, Stages, Step, WorldMode};
use crate::reward::{self, RewardTerms};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use sumo_network::network::{EdgeKind, LaneId, Network, Route};
use sumo_network::seeds;
use wad_see::eyes::Eyes;
use wad_see::latent::Encoder;
use wad_see::observation::Observation;
use wad_see::perception::EgoFacts;
use wad_sim::assets::Assets;
use wad_sim::autopilot::AutopilotParams;
use wad_sim::bridge::{BridgeError, BridgeOptions, Ego};
use wad_sim::destination::Destinations;
use wad_sim::end::{End, judge_limit};
use wad_sim::session::{Act, Seat, Session};
use wad_sim::tasks::{Placement, TaskError, TaskSpec};
use wad_sim::traffic::TrafficSpec;
use wad_vehicle::Control;

/// Failed starts of SUMO for one episode after which `reset` fails.
const ATTEMPTS: usize = 3;
/// In running traffic: places drawn for one start, and the radius cleared round it (m).
const PLACES: usize = 12;
const ROOM: f64 = 30.0;

/// The environment's only ego.
const EGO: usize = 0;

/// A running SUMO with the ego in it.
struct Sumo {
    session: Session,
    /// The settings of its population.
    traffic: TrafficSpec,
    episodes: u64,
    /// The last episode's obstacle is still there.
    obstacle: bool,
    /// Lights held at green by the last task.
    held: Held,
}

pub struct World {
    assets: Arc<Assets>,
    options: EnvOptions,
    eyes: Eyes,
    sumo: Option<Sumo>,
    /// The ego, while no SUMO runs.
    parked: Option<Seat>,
    episode: Option<Episode>,
    /// Draws the further destinations of a route that never ends.
    onward: Option<Destinations>,
    folder: Scratch,
    pub stages: Stages,
}

impl World {
    pub fn new(
        assets: Arc<Assets>,
        options: EnvOptions,
        encoder: Box<dyn Encoder>,
    ) -> Result<Self, EnvError> {
        options.ego.check().map_err(BridgeError::from)?;
        let folder = Scratch::new().map_err(|source| EnvError::Folder { source })?;
        Ok(Self {
            eyes: Eyes::of_agent(&assets, options.observation, &options.detector, options.camera, encoder)?,
            assets,
            options,
            sumo: None,
            parked: None,
            episode: None,
            onward: None,
            folder,
            stages: Stages::default(),
        })
    }

    pub async fn reset(&mut self, task: &TaskSpec, seed: u64) -> Result<Observation, EnvError> {
        let clock = Instant::now();
        self.episode = None;
        let mut attempt = 0;
        let placement = loop {
            attempt += 1;
            match self.begin(task, seed).await {
                Ok(placement) => break placement,
                Err(EnvError::Bridge(error)) if !error.is_input() => {
                    self.park();
                    if attempt == ATTEMPTS {
                        let (task, source) = (task.kind.to_string(), error);
                        return Err(EnvError::Start {
                            attempts: ATTEMPTS,
                            task,
                            seed,
                            source: Box::new(source),
                        });
                    }
                    tracing::warn!("SUMO is started again for `{}`, seed {seed}: {error}", task.kind);
                }
                Err(error) => return Err(error),
            }
        };
        let Some(ego) = self.ego() else { return Err(EnvError::NoEpisode) };
        let tick = self.options.tick_ms / 1000.0;
        let limit = task.tick_limit.unwrap_or_else(|| task.kind.tick_limit(ego.route().length(), tick));
        self.episode = Some(Episode::new(task.clone(), placement, limit));
        self.onward = None;
        if task.endless {
            let rng = seeds::rng(seed, "onward");
            let destinations = Destinations::new(self.assets.network(), rng);
            self.onward = Some(
                destinations
                    .map_err(|error| TaskError::NoPlace { task: task.kind, condition: error.to_string() })?,
            );
        }
        self.eyes.reset(task.weather, seed);
        let observation = self.look()?;
        self.stages.resets += 1;
        self.stages.reset += clock.elapsed().as_secs_f64();
        Ok(observation)
    }

    /// Runs camera and perception after a tick.
    fn look(&mut self) -> Result<Observation, EnvError> {
        let Some(sumo) = &self.sumo else { return Err(EnvError::NoEpisode) };
        let ego = sumo.session.ego(EGO);
        let clock = Instant::now();
        self.eyes.follow(ego.world());
        let followed = clock.elapsed().as_secs_f64();
        self.eyes.look(&EgoFacts::of(self.assets.network(), ego, sumo.session.bridge().tick()))?;
        let times = self.eyes.times();
        self.stages.camera += followed + times.camera;
        self.stages.perception += times.perception();
        self.stages.encoder += times.encode;
        Ok(self.eyes.observation())
    }

    /// Ends SUMO, and keeps the ego for the next one.
    fn park(&mut self) {
        if let Some(sumo) = self.sumo.take() {
            self.parked = sumo.session.into_seats().pop();
        }
    }

    /// Moves the ego to its start, and prepares traffic, lights and obstacle for the task.
    async fn begin(&mut self, task: &TaskSpec, seed: u64) -> Result<Placement, EnvError> {
        let (placement, route) = self.place(task, seed)?;
        let traffic = task.traffic();
        let runs_on = self.options.world == WorldMode::Running
            && self.assets.scenario().is_none()
            && self.sumo.as_ref().is_some_and(|sumo| {
                let own = |t: TrafficSpec| t == TrafficSpec::AsIs;
                sumo.episodes < self.options.episodes_per_sumo && own(sumo.traffic) == own(traffic)
            });
        let placement = if runs_on {
            self.go_on(task, seed, placement, route).await?
        } else {
            self.start(traffic, seed, route).await?;
            placement
        };
        let Some(sumo) = &mut self.sumo else { return Err(EnvError::NoEpisode) };
        sumo.episodes += 1;
        sumo.obstacle = placement.obstacle.is_some();
        let (bridge, seat) = sumo.session.bridge_and_seat(EGO);
        if task.kind.lights_are_green() {
            sumo.held = green::hold(bridge, seat.ego().route()).await?;
        }
        // A scenario's director puts its own.
        if let (Some(wanted), None) = (&placement.obstacle, self.assets.scenario()) {
            obstacle::put(bridge, seat.ego_mut(), wanted)?;
        }
        // One tick at standstill: SUMO gets the new route, and actors in sight get a speed.
        sumo.session.settle().await?;
        Ok(placement)
    }

    fn place(&self, task: &TaskSpec, seed: u64) -> Result<(Placement, Route), EnvError> {
        let placement = match &task.placement {
            Some(placement) => placement.clone(),
            None => self.assets.place(task.kind, seed)?,
        };
        let route = placement.route(self.assets.network())?;
        Ok((placement, route))
    }

    /// A new SUMO with the ego at the route's begin.
    async fn start(&mut self, traffic: TrafficSpec, seed: u64, route: Route) -> Result<(), EnvError> {
        // The old one goes before the new one comes.
        self.park();
        let options = BridgeOptions {
            seed: seeds::derive(seed, "world"),
            tick_ms: Some(self.options.tick_ms),
            traffic,
            sight: self.options.sight,
            tick_timeout: self.options.tick_timeout,
            scenario: self.assets.scenario().is_some(),
            closed_lanes: self.assets.scenario().map_or(Vec::new(), |scenario| scenario.closed_lanes.clone()),
            gui: self.options.gui,
            ..BridgeOptions::new(self.assets.config(), self.sumo_folder())
        };
        let mut seat = match self.parked.take() {
            Some(mut seat) => {
                seat.ego_mut().forget();
                seat
            }
            None => {
                let (ego, criteria) = (self.options.ego.clone(), self.options.criteria);
                Seat::new(&self.assets, "ego", ego, AutopilotParams::default(), criteria, route.clone())
            }
        };
        seat.place(route, 0.0, self.options.start.draw(seed));
        let session = Session::start(&self.assets, &options, vec![seat]).await?;
        self.sumo = Some(Sumo { session, traffic, episodes: 0, obstacle: false, held: Held::default() });
        Ok(())
    }

    fn sumo_folder(&self) -> PathBuf {
        self.folder.path().join("sumo")
    }

    /// Moves the ego to the route's begin, or, if a road user stands there that cannot be removed, to
    /// another place for the same task.
    async fn go_on(
        &mut self,
        task: &TaskSpec,
        seed: u64,
        mut placement: Placement,
        mut route: Route,
    ) -> Result<Placement, EnvError> {
        let network = Arc::clone(self.assets.network());
        for again in 1..=PLACES {
            let Some(sumo) = &mut self.sumo else { return Err(EnvError::NoEpisode) };
            let (bridge, seat) = sumo.session.bridge_and_seat(EGO);
            if let Some(counts) = task.traffic().counts(self.assets.town_name()) {
                bridge.resize_traffic(counts);
            }
            if std::mem::take(&mut sumo.obstacle) {
                obstacle::take_away(bridge, seat.ego_mut());
            }
            green::release(bridge, &mut sumo.held);
            let start = route.at(0.0).pose.xy();
            let roads = |lane: &LaneId| {
                matches!(network.edge(network.lane(*lane).edge).kind, EdgeKind::Normal | EdgeKind::Internal)
            };
            let lanes: Vec<LaneId> =
                network.lanes_near(start, None, ROOM).iter().map(|near| near.lane).filter(roads).collect();
            if bridge.clear(start, ROOM, &lanes).await? {
                seat.place(route, 0.0, self.options.start.draw(seed));
                sumo.session.settle().await?;
                return Ok(placement);
            }
            if task.placement.is_some() {
                break;
            }
            (placement, route) = self.place(task, seeds::derive(seed, &format!("place {again}")))?;
        }
        Err(EnvError::Crowded {
            task: task.kind.to_string(),
            town: self.assets.name().to_string(),
            tries: PLACES,
        })
    }

    /// The ego is driven with `control`; where the expert was asked it shows the expert's lamps.
    pub async fn step(&mut self, control: Control) -> Result<Step, EnvError> {
        let planned = self.sumo.as_ref().is_some_and(|sumo| sumo.session.seats()[EGO].is_planned());
        self.act(if planned { Act::Disturbed(control) } else { Act::Control(control) }).await
    }

    pub async fn act(&mut self, act: Act) -> Result<Step, EnvError> {
        let running = self.episode.as_ref().is_some_and(|episode| !episode.over);
        let (true, Some(sumo)) = (running, &mut self.sumo) else { return Err(EnvError::NoEpisode) };
        if act == Act::Expert {
            sumo.session.plan(EGO);
        }
        if let Some(onward) = &mut self.onward {
            go_onward(self.assets.network(), sumo.session.seat_mut(EGO).ego_mut(), onward);
        }
        let before = sumo.session.timings();
        let stepped = sumo.session.step_one(act).await;
        let after = sumo.session.timings();
        self.stages.physics += after.physics - before.physics;
        self.stages.sumo += after.bridge - before.bridge;
        self.stages.steps += 1;
        let (time, traffic) = (sumo.session.bridge().time(), sumo.session.bridge().counts());
        if let Some(episode) = &mut self.episode {
            episode.tick += 1;
        }
        let tick = match stepped {
            Ok(tick) => tick,
            Err(error) => return Ok(self.lost(&error)),
        };
        let observation = self.look()?;
        let (Some(episode), Some(sumo)) = (&mut self.episode, &self.sumo) else {
            return Err(EnvError::NoEpisode);
        };
        let ego = sumo.session.ego(EGO);
        let ending = match self.options.termination.decide(&tick.events) {
            Some((end, cause)) => Some(episode.ending(end, cause)),
            None if episode.tick >= episode.limit => {
                let (kind, network) = (episode.task.kind, self.assets.network());
                Some(judge_limit(kind, &episode.placement, episode.tick, network, ego))
            }
            None => None,
        };
        let reward = &self.options.reward;
        let facts = episode.facts(reward, ego, &self.eyes, &tick.control, &tick.events, ending.as_ref());
        let terms = reward::compute(reward, &facts);
        let terminated = ending.as_ref().is_some_and(|ending| ending.end.is_terminal());
        let truncated = ending.is_some() && !terminated;
        episode.over = ending.is_some();
        Ok(Step {
            observation,
            control: tick.control,
            reward: terms.total(),
            terminated,
            truncated,
            info: Info {
                tick: episode.tick,
                time,
                reward: terms,
                events: tick.events,
                ending,
                raw: *self.eyes.raw(),
                ego: tick.after.state,
                driven: tick.after.s,
                route_length: ego.route().length(),
                traffic,
            },
        })
    }

    /// SUMO died: the episode is lost, the next reset starts a new SUMO.
    fn lost(&mut self, error: &BridgeError) -> Step {
        tracing::warn!("an episode is lost, its SUMO is replaced: {error}");
        let time = self.sumo.as_ref().map_or(0.0, |sumo| sumo.session.bridge().time());
        self.park();
        let (tick, ending) = self.episode.as_mut().map_or((0, None), |episode| {
            episode.over = true;
            (episode.tick, Some(episode.ending(End::Error, error.to_string())))
        });
        let ego = self.ego();
        Step {
            observation: self.eyes.observation(),
            control: Control::default(),
            reward: 0.0,
            terminated: false,
            truncated: true,
            info: Info {
                tick,
                time,
                reward: RewardTerms::default(),
                events: Vec::new(),
                ending,
                raw: *self.eyes.raw(),
                ego: ego.map_or_else(nowhere, Ego::state),
                driven: ego.map_or(0.0, |ego| ego.on_route().s),
                route_length: ego.map_or(0.0, |ego| ego.route().length()),
                traffic: (0, 0),
            },
        }
    }

    pub fn expert(&mut self) -> Result<Control, EnvError> {
        let running = self.episode.as_ref().is_some_and(|episode| !episode.over);
        let (true, Some(sumo)) = (running, &mut self.sumo) else { return Err(EnvError::NoEpisode) };
        Ok(sumo.session.plan(EGO).control)
    }

    pub async fn close(&mut self) {
        if let Some(sumo) = self.sumo.take()
            && let Err(error) = sumo.session.close().await
        {
            tracing::debug!("SUMO did not close properly: {error}");
        }
    }

    pub fn placement(&self) -> Option<&Placement> {
        self.episode.as_ref().map(|episode| &episode.placement)
    }

    pub fn ego(&self) -> Option<&Ego> {
        let seat = self.sumo.as_ref().and_then(|sumo| sumo.session.seats().get(EGO)).or(self.parked.as_ref());
        seat.map(Seat::ego)
    }

    /// SUMO's process, for tests that kill it.
    pub fn sumo_pid(&self) -> Option<u32> {
        self.sumo.as_ref().and_then(|sumo| sumo.session.bridge().sumo_pid())
    }

    pub fn eyes(&self) -> &Eyes {
        &self.eyes
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

/// A route that never ends is lengthened when less than this is left of it (m).
const ONWARD: f64 = 250.0;
/// Places drawn per attempt.
const ONWARD_DRAWS: usize = 20;

/// Lengthens the route before its end comes into view. Where no place can be reached from its end it
/// ends there.
fn go_onward(network: &Network, ego: &mut Ego, places: &mut Destinations) {
    let s = ego.on_route().s;
    if ego.route().length() - s > ONWARD {
        return;
    }
    let mut route = ego.route().clone();
    for _ in 0..ONWARD_DRAWS {
        let place = places.place(network);
        if network.extend_route(&mut route, place).is_ok() && route.length() - s > 2.0 * ONWARD {
            ego.set_route(route, s);
            return;
        }
    }
}
