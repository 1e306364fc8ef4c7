//! One SUMO with the ego in it, from episode to episode.

use super::episode::{Episode, judge_limit};
use super::eyes::Eyes;
use super::green::{self, Held};
use super::obstacle;
use super::{Assets, EnvError, EnvOptions, Info, Stages, Step, WorldMode};
use crate::autopilot::{Autopilot, AutopilotParams, EgoModel};
use crate::bridge::{Bridge, BridgeError, BridgeOptions, Ego, Lamps};
use crate::camera::Frame;
use crate::criteria::{Event, Situation};
use crate::destination::Destinations;
use crate::latent::Encoder;
use crate::network::{EdgeKind, LaneId, Network, RoadOption, Route};
use crate::observation::{Observation, RawState};
use crate::perception::TransformedImage;
use crate::reward::{self, RewardTerms};
use crate::scenario::Director;
use crate::seeds;
use crate::tasks::{Placement, TaskError, TaskSpec};
use crate::traffic::TrafficSpec;
use crate::vehicle::Control;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Times that SUMO is started for one episode before that counts as an error.
const ATTEMPTS: usize = 3;
/// In running traffic: places drawn for one start, and the room that is cleared round it (m).
const PLACES: usize = 12;
const ROOM: f64 = 30.0;

/// A SUMO that runs.
struct Sumo {
    bridge: Bridge,
    /// What its population was made by.
    traffic: TrafficSpec,
    episodes: u64,
    /// Something stands in the way since the last episode.
    obstacle: bool,
    /// Lights that the last task held at green.
    held: Held,
}

pub struct World {
    assets: Arc<Assets>,
    options: EnvOptions,
    eyes: Eyes,
    sumo: Option<Sumo>,
    ego: Option<Ego>,
    autopilot: Autopilot,
    episode: Option<Episode>,
    /// The blinkers and brake lights that the expert asked for, and the control that it decided on.
    lamps: Option<Lamps>,
    decided: Option<Control>,
    /// Draws the further destinations of a route that never ends.
    onward: Option<Destinations>,
    folder: TempDir,
    pub stages: Stages,
}

impl World {
    pub fn new(
        assets: Arc<Assets>,
        options: EnvOptions,
        encoder: Box<dyn Encoder>,
    ) -> Result<Self, EnvError> {
        options.ego.check().map_err(BridgeError::from)?;
        let folder = tempfile::Builder::new()
            .prefix("wad-env-")
            .tempdir()
            .map_err(|source| EnvError::Folder { source })?;
        Ok(Self {
            eyes: Eyes::new(&assets, &options, encoder)?,
            autopilot: Autopilot::new(AutopilotParams::default(), EgoModel::from(&options.ego)),
            assets,
            options,
            sumo: None,
            ego: None,
            episode: None,
            lamps: None,
            decided: None,
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
                    self.sumo = None;
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
        let Some(ego) = &self.ego else { return Err(EnvError::NoEpisode) };
        let tick = self.options.tick_ms / 1000.0;
        let limit = task.tick_limit.unwrap_or_else(|| task.kind.tick_limit(ego.route().length(), tick));
        self.episode = Some(Episode::new(task.clone(), placement, limit, self.options.criteria));
        self.autopilot = Autopilot::new(AutopilotParams::default(), EgoModel::from(&self.options.ego));
        (self.lamps, self.decided) = (None, None);
        self.onward = None;
        if task.endless {
            let rng = seeds::rng(seed, "onward");
            let destinations = Destinations::new(self.assets.network(), rng);
            self.onward = Some(
                destinations
                    .map_err(|error| TaskError::NoPlace { task: task.kind, condition: error.to_string() })?,
            );
        }
        self.eyes.reset(task.weather, seeds::derive(seed, "detector"));
        let observation = self.eyes.look(self.assets.network(), ego, tick, &mut self.stages)?;
        self.stages.resets += 1;
        self.stages.reset += clock.elapsed().as_secs_f64();
        Ok(observation)
    }

    /// Puts the ego to its start, in a world as the task wants it.
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
        let (Some(sumo), Some(ego)) = (&mut self.sumo, &mut self.ego) else {
            return Err(EnvError::NoEpisode);
        };
        sumo.episodes += 1;
        sumo.obstacle = placement.obstacle.is_some();
        if task.kind.lights_are_green() {
            sumo.held = green::hold(&mut sumo.bridge, ego.route()).await?;
        }
        // A scenario's director puts its own.
        if let (Some(wanted), None) = (&placement.obstacle, self.assets.scenario()) {
            obstacle::put(&mut sumo.bridge, ego, wanted)?;
        }
        // Standing: SUMO learns the new route, and those in sight have a speed.
        sumo.bridge.step(&mut [ego]).await?;
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
        self.sumo = None;
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
        let mut bridge = Bridge::start_on(&options, Some(Arc::clone(self.assets.network()))).await?;
        if let Some(scenario) = self.assets.scenario() {
            bridge.set_director(Box::new(Director::new(Arc::clone(scenario))));
        }
        let ego = match &mut self.ego {
            Some(ego) => {
                ego.forget();
                ego
            }
            none => {
                let ego = none.insert(Ego::new("ego", self.options.ego.clone(), route.clone(), 0.0));
                ego.vehicle_mut().set_statics(self.assets.statics().to_vec());
                ego
            }
        };
        let (left, turn) = self.options.start.draw(seed);
        ego.respawn_beside(route, 0.0, left, turn);
        bridge.spawn(ego).await?;
        self.sumo = Some(Sumo { bridge, traffic, episodes: 0, obstacle: false, held: Held::default() });
        Ok(())
    }

    fn sumo_folder(&self) -> PathBuf {
        self.folder.path().join("sumo")
    }

    /// The ego put down at the route's begin, or, where somebody stands there who cannot be taken away,
    /// at another place for the same task.
    async fn go_on(
        &mut self,
        task: &TaskSpec,
        seed: u64,
        mut placement: Placement,
        mut route: Route,
    ) -> Result<Placement, EnvError> {
        let network = Arc::clone(self.assets.network());
        for again in 1..=PLACES {
            let (Some(sumo), Some(ego)) = (&mut self.sumo, &mut self.ego) else {
                return Err(EnvError::NoEpisode);
            };
            if let Some(counts) = task.traffic().counts(self.assets.town_name()) {
                sumo.bridge.resize_traffic(counts);
            }
            if std::mem::take(&mut sumo.obstacle) {
                obstacle::take_away(&mut sumo.bridge, ego);
            }
            green::release(&mut sumo.bridge, &mut sumo.held);
            let start = route.at(0.0).pose.xy();
            let roads = |lane: &LaneId| {
                matches!(network.edge(network.lane(*lane).edge).kind, EdgeKind::Normal | EdgeKind::Internal)
            };
            let lanes: Vec<LaneId> =
                network.lanes_near(start, None, ROOM).iter().map(|near| near.lane).filter(roads).collect();
            if sumo.bridge.clear(start, ROOM, &lanes).await? {
                let (left, turn) = self.options.start.draw(seed);
                ego.respawn_beside(route, 0.0, left, turn);
                sumo.bridge.step(&mut [ego]).await?;
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

    pub async fn step(&mut self, control: Control) -> Result<Step, EnvError> {
        let control = control.clamped();
        let (Some(episode), Some(sumo), Some(ego)) = (&mut self.episode, &mut self.sumo, &mut self.ego)
        else {
            return Err(EnvError::NoEpisode);
        };
        if episode.over {
            return Err(EnvError::NoEpisode);
        }
        let network = self.assets.network();
        let tick = sumo.bridge.tick();
        let before = ego.on_route();
        ego.set_lamps(self.lamps.take().unwrap_or_else(|| lamps(ego, &control)));
        if self.decided.take().is_some_and(|decided| decided.clamped() != control) {
            self.autopilot.overruled();
        }
        if let Some(onward) = &mut self.onward {
            go_onward(network, ego, onward);
        }
        let clock = Instant::now();
        let contacts = ego.advance(control, tick);
        let moved = clock.elapsed().as_secs_f64();
        let stepped = sumo.bridge.step(&mut [ego]).await;
        self.stages.physics += moved;
        self.stages.sumo += clock.elapsed().as_secs_f64() - moved;
        self.stages.steps += 1;
        episode.tick += 1;
        if let Err(error) = stepped {
            return Ok(self.lost(&error));
        }
        let after = ego.on_route();
        let params = ego.params();
        let events = episode.criteria.check(&Situation {
            network,
            route: ego.route(),
            world: ego.previous_world(),
            before,
            after,
            contacts: &contacts,
            static_label: &|key| ego.static_label(key),
            length: params.length,
            width: params.width,
            wheelbase: params.wheelbase,
            track: params.track,
            tick,
        });
        let observation = self.eyes.look(network, ego, tick, &mut self.stages)?;
        let decided = self.options.termination.decide(&events);
        let ending = match decided {
            Some((end, cause)) => Some(episode.ending(end, cause)),
            None if episode.tick >= episode.limit => {
                Some(judge_limit(episode.task.kind, &episode.placement, episode.tick, network, ego))
            }
            None => None,
        };
        let facts = episode.facts(&self.options.reward, ego, &self.eyes, &control, &events, ending.as_ref());
        let terms = reward::compute(&self.options.reward, &facts);
        let terminated = ending.as_ref().is_some_and(|ending| ending.end.is_terminal());
        let truncated = ending.is_some() && !terminated;
        episode.over = ending.is_some();
        Ok(Step {
            observation,
            reward: terms.total(),
            terminated,
            truncated,
            info: Info {
                tick: episode.tick,
                time: sumo.bridge.time(),
                reward: terms,
                events,
                ending,
                raw: *self.eyes.raw(),
                ego: after.state,
                driven: after.s,
                route_length: ego.route().length(),
                traffic: sumo.bridge.counts(),
            },
        })
    }

    /// SUMO died: the episode is lost, the next reset builds a new one.
    fn lost(&mut self, error: &BridgeError) -> Step {
        tracing::warn!("an episode is lost, its SUMO is replaced: {error}");
        let time = self.sumo.take().map_or(0.0, |sumo| sumo.bridge.time());
        let ego = self.ego.as_ref();
        let events: Vec<Event> = Vec::new();
        let (tick, ending) = self.episode.as_mut().map_or((0, None), |episode| {
            episode.over = true;
            (episode.tick, Some(episode.ending(super::End::Error, error.to_string())))
        });
        Step {
            observation: self.eyes.observation(),
            reward: 0.0,
            terminated: false,
            truncated: true,
            info: Info {
                tick,
                time,
                reward: RewardTerms::default(),
                events,
                ending,
                raw: *self.eyes.raw(),
                ego: ego.map_or_else(super::episode::nowhere, Ego::state),
                driven: ego.map_or(0.0, |ego| ego.on_route().s),
                route_length: ego.map_or(0.0, |ego| ego.route().length()),
                traffic: (0, 0),
            },
        }
    }

    pub fn expert(&mut self) -> Result<Control, EnvError> {
        let running = self.episode.as_ref().is_some_and(|episode| !episode.over);
        let (true, Some(ego)) = (running, &self.ego) else { return Err(EnvError::NoEpisode) };
        let at = ego.on_route();
        let tick = self.options.tick_ms / 1000.0;
        let decision =
            self.autopilot.control(self.assets.network(), ego.route(), at.s, &at.state, ego.world(), tick);
        self.lamps = Some(Lamps {
            blinker_left: decision.blinker_left,
            blinker_right: decision.blinker_right,
            brake: decision.brake_light,
        });
        self.decided = Some(decision.control);
        Ok(decision.control)
    }

    pub async fn close(&mut self) {
        if let Some(sumo) = self.sumo.take()
            && let Err(error) = sumo.bridge.close().await
        {
            tracing::debug!("SUMO did not close properly: {error}");
        }
    }

    pub fn placement(&self) -> Option<&Placement> {
        self.episode.as_ref().map(|episode| &episode.placement)
    }

    pub fn ego(&self) -> Option<&Ego> {
        self.ego.as_ref()
    }

    /// SUMO's process, for tests that kill it.
    pub fn sumo_pid(&self) -> Option<u32> {
        self.sumo.as_ref().and_then(|sumo| sumo.bridge.sumo_pid())
    }

    pub fn raw(&self) -> &RawState {
        self.eyes.raw()
    }

    pub fn frame(&self) -> Option<&Frame> {
        self.eyes.frame()
    }

    pub fn image(&self) -> Option<&TransformedImage> {
        self.eyes.image()
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
/// Places drawn for that at a time.
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

/// What an ego shows that nobody told what to show: brake lights, and blinkers before a turn or a lane
/// change.
fn lamps(ego: &Ego, control: &Control) -> Lamps {
    let at = ego.on_route();
    let ahead = (at.front_s + 2.0 + 2.0 * at.state.speed.max(0.0)).min(ego.route().length());
    let option = ego.route().at(ahead).option;
    Lamps {
        blinker_left: matches!(option, RoadOption::Left | RoadOption::ChangeLaneLeft),
        blinker_right: matches!(option, RoadOption::Right | RoadOption::ChangeLaneRight),
        brake: control.brake > 0.05,
    }
}
