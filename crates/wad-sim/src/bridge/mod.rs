//! The co-simulation: one SUMO, one network, any number of egos in it.
//!
//! One tick is one message: population changes, the egos' poses, the step; the reply brings
//! everything within sight of each ego.
//!
//! ```text
//! ego.advance(control)        physics of one tick, contacts
//! bridge.step(&mut [&mut ego]) poses in, one SUMO step, a new WorldState for each ego
//! ```

mod background;
mod director;
mod ego;
mod error;
mod observe;
mod signals;

pub use director::{Director, Scene};
pub use ego::{Ego, Lamps};
pub use error::BridgeError;
pub use observe::Fetch;

use crate::cores::SharedCore;
use crate::destination::EGO_CLASS;
use crate::sumo_config::{ConfigError, OptionSchema, Overrides, SumoConfig};
use crate::traffic::{Population, StepEvents, TrafficSpec};
use background::population_of;
use observe::ActorCatalog;
use serde::{Deserialize, Serialize};
use signals::SignalWatch;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use sumo_network::geometry::{Point, Pose};
use sumo_network::network::Network;
use sumo_network::seeds;
use sumo_traci::process::{LaunchOptions, SumoInstall, SumoProcess};
use sumo_traci::{Batch, Replies, TcpClient, gui, simulation, vehicle};

/// How to start a co-simulation.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct BridgeOptions {
    /// A `.sumocfg` or `.net.xml(.gz)`.
    pub config: PathBuf,
    /// The run's seed; SUMO's and the traffic's derive from it.
    pub seed: u64,
    /// Tick length (ms); None: the config's step-length, else 167.
    pub tick_ms: Option<f64>,
    /// Background population.
    pub traffic: TrafficSpec,
    /// How far an ego sees (m).
    pub sight: f64,
    /// How the road users in sight are fetched.
    #[serde(default)]
    pub fetch: Fetch,
    /// sumo-gui instead of sumo, the ego followed.
    pub gui: bool,
    /// `host:port` of a running SUMO to use instead of an own one.
    pub attach: Option<String>,
    /// Longest time a tick may take before SUMO counts as hung (s).
    pub tick_timeout: f64,
    /// Folder for SUMO's files: effective config, log, redirected outputs.
    pub output_dir: PathBuf,
    /// The config is a scenario: its own road users stay beside the background population, except its ego.
    #[serde(default)]
    pub scenario: bool,
    /// Lanes that the scenario closes: the background population keeps off them from the start.
    #[serde(default)]
    pub closed_lanes: Vec<String>,
}

impl BridgeOptions {
    /// The defaults of `wad-cosim run` for a config, SUMO's files going to `output_dir`.
    pub fn new(config: impl Into<PathBuf>, output_dir: impl Into<PathBuf>) -> Self {
        Self {
            config: config.into(),
            seed: 0,
            tick_ms: None,
            traffic: TrafficSpec::AsIs,
            sight: 100.0,
            fetch: Fetch::Auto,
            gui: false,
            attach: None,
            tick_timeout: 60.0,
            output_dir: output_dir.into(),
            scenario: false,
            closed_lanes: Vec::new(),
        }
    }
}

/// The paper's six ticks a second, in SUMO's whole milliseconds.
pub const DEFAULT_TICK_MS: f64 = 167.0;
/// Lengths that a tick may have (ms).
pub const TICK_MS: RangeInclusive<f64> = 1.0..=1000.0;

/// The vehicle type of a scenario's ego: the real ego replaces that vehicle.
pub const EGO_TYPE: &str = "ego";

/// A running co-simulation.
pub struct Bridge {
    client: TcpClient,
    /// None where attached to a SUMO that is not ours.
    process: Option<SumoProcess>,
    core: Option<SharedCore>,
    network: Arc<Network>,
    config: SumoConfig,
    catalog: ActorCatalog,
    signals: SignalWatch,
    population: Option<Population>,
    /// Where background traffic drives: the network less the lanes that are closed.
    traffic_roads: Arc<Network>,
    traffic_seed: u64,
    /// The config's own traffic is removed.
    traffic_alone: bool,
    /// Ids of the egos.
    egos: Vec<String>,
    /// Vehicles of the caller by id, and whether they are in the network.
    guests: BTreeMap<String, bool>,
    /// Vehicles that the next step removes: SUMO does not report their arrival.
    taken_out: usize,
    director: Option<Box<dyn Director>>,
    batch: Batch,
    sight: f64,
    fetch: Fetch,
    gui: bool,
    subscribed: bool,
    /// SUMO's clock when the bridge began (ms), tick length (ms), ticks since.
    begin_ms: f64,
    tick_ms: f64,
    ticks: u64,
    /// Background vehicles and pedestrians in the network after the last step.
    counts: (usize, usize),
    /// Vehicles in the network after the last step, egos included.
    in_network: usize,
    /// Time spent waiting for SUMO's answers to steps (s), and their size (bytes).
    sumo_seconds: f64,
    answer_bytes: u64,
}

impl Bridge {
    /// Reads config and network, starts SUMO (or attaches to one) and shakes hands with it.
    ///
    /// # Errors
    /// See [`BridgeError`]; nothing is left running.
    pub async fn start(options: &BridgeOptions) -> Result<Self, BridgeError> {
        Self::start_on(options, None).await
    }

    /// The same with the config's network where it has been read already, to be shared.
    ///
    /// # Errors
    /// As [`Bridge::start`].
    pub async fn start_on(
        options: &BridgeOptions,
        network: Option<Arc<Network>>,
    ) -> Result<Self, BridgeError> {
        let install = SumoInstall::find()?;
        if options.attach.is_none() {
            install.check_version()?;
        }
        let schema = OptionSchema::cached(&install, options.gui)?;
        let config = SumoConfig::load(&options.config, &schema)?;
        for option in &config.ignored {
            tracing::info!("{}: {option} is not an option of this SUMO, left out", config.path().display());
        }
        let network = match network {
            Some(network) => network,
            None => Arc::new(Network::load(&config.net_file()?)?),
        };
        network.require_drivable(EGO_CLASS)?;
        // Longer than a Duration holds is no limit.
        let timeout = Duration::try_from_secs_f64(options.tick_timeout.max(0.001)).unwrap_or(Duration::MAX);
        let wanted = match options.tick_ms {
            Some(ms) => Some(ms),
            None => config.time("step-length")?.map(|s| s * 1000.0),
        };
        let (mut client, process, begin_ms, tick_ms) = match &options.attach {
            Some(address) => {
                let mut client = TcpClient::attach_within(address, timeout).await?;
                client.set_timeout(Some(timeout));
                let step = client.get(simulation::DELTA_T, "").await? * 1000.0;
                if let Some(wanted) = options.tick_ms.filter(|ms| (ms - step).abs() > 0.5) {
                    return Err(BridgeError::AttachedTick { address: address.clone(), found: step, wanted });
                }
                let now = client.get(simulation::TIME, "").await? * 1000.0;
                (client, None, now, step)
            }
            None => {
                let tick_ms = wanted.unwrap_or(DEFAULT_TICK_MS).round();
                if !TICK_MS.contains(&tick_ms) {
                    return Err(BridgeError::Tick { found: tick_ms });
                }
                let effective = config.write_effective(&schema, &overrides(options, &config, tick_ms));
                let effective = effective.map_err(|error| match error {
                    ConfigError::Write { path, source } => BridgeError::Folder { path, source },
                    error => error.into(),
                })?;
                let launch = LaunchOptions {
                    gui: options.gui,
                    log_file: Some(options.output_dir.join("sumo.log")),
                    // What SUMO writes under a name of its own goes there too.
                    working_dir: Some(options.output_dir.clone()),
                    ..LaunchOptions::config(effective)
                };
                let (process, client) = SumoProcess::launch_with(&install, &launch).await?;
                let begin = config.time("begin")?.unwrap_or(0.0) * 1000.0;
                (client, Some(process), begin, tick_ms)
            }
        };
        client.set_timeout(Some(timeout));
        let traffic_seed = seeds::derive(options.seed, "traffic");
        let traffic_alone = !options.scenario;
        let traffic_roads = match options.closed_lanes.as_slice() {
            [] => Arc::clone(&network),
            closed => Arc::new(network.without_lanes(closed)),
        };
        let population = options.traffic.counts(&config.town());
        let population =
            population.map(|counts| population_of(&traffic_roads, counts, traffic_seed, traffic_alone));
        let core = process.as_ref().filter(|_| !options.gui).map(|process| SharedCore::with(process.id()));
        Ok(Self {
            client,
            process,
            core,
            signals: SignalWatch::new(&network, options.sight),
            network,
            config,
            catalog: ActorCatalog::default(),
            population,
            traffic_roads,
            traffic_seed,
            traffic_alone,
            egos: Vec::new(),
            guests: BTreeMap::new(),
            taken_out: 0,
            director: None,
            batch: Batch::new(),
            sight: options.sight,
            fetch: options.fetch,
            gui: options.gui,
            subscribed: false,
            begin_ms,
            tick_ms,
            ticks: 0,
            counts: (0, 0),
            in_network: 0,
            sumo_seconds: 0.0,
            answer_bytes: 0,
        })
    }

    /// The network.
    pub fn network(&self) -> &Arc<Network> {
        &self.network
    }

    /// The configuration that the run began from.
    pub fn config(&self) -> &SumoConfig {
        &self.config
    }

    /// Length of a tick (s).
    pub fn tick(&self) -> f64 {
        self.tick_ms / 1000.0
    }

    /// SUMO's clock (s).
    pub fn time(&self) -> f64 {
        (self.begin_ms + self.ticks as f64 * self.tick_ms) / 1000.0
    }

    /// Background vehicles and pedestrians in the network after the last step.
    pub fn counts(&self) -> (usize, usize) {
        self.counts
    }

    /// Time spent so far waiting for SUMO's answers to steps (s).
    pub fn sumo_seconds(&self) -> f64 {
        self.sumo_seconds
    }

    /// Size of SUMO's answers to steps so far (bytes): what it gathers, sends and we decode. It grows with
    /// what the egos see, not with the town.
    pub fn answer_bytes(&self) -> u64 {
        self.answer_bytes
    }

    /// Id of SUMO's process, None where attached.
    pub fn sumo_pid(&self) -> Option<u32> {
        self.process.as_ref().map(SumoProcess::id)
    }

    /// Sets the director that plays a scenario's events. Call it before the first spawn.
    pub fn set_director(&mut self, director: Box<dyn Director>) {
        self.director = Some(director);
    }

    /// Brings an ego into SUMO with its first step. The population appears round it.
    ///
    /// # Errors
    /// SUMO refuses the ego, or fails.
    pub async fn spawn(&mut self, ego: &mut Ego) -> Result<(), BridgeError> {
        self.spawn_all(&mut [ego]).await
    }

    /// Brings several egos into SUMO with one step; the population appears round them.
    ///
    /// # Errors
    /// SUMO refuses one of them, or fails.
    pub async fn spawn_all(&mut self, egos: &mut [&mut Ego]) -> Result<(), BridgeError> {
        if !self.subscribed {
            // Asked once: from then on departures and arrivals say it. SUMO's count costs it a copy of
            // every vehicle's id.
            let found = self.client.get(vehicle::ID_COUNT, "").await?;
            self.in_network = usize::try_from(found).unwrap_or(0);
            let wanted = self.population.as_ref().map(Population::wanted);
            let users = wanted.map_or(self.in_network, |counts| counts.vehicles + counts.pedestrians);
            self.fetch = self.fetch.resolve(egos.len(), users);
        }
        for ego in egos.iter_mut() {
            ego.params().check()?;
            ego.insert(&self.network, &mut self.batch);
            self.egos.push(ego.id.clone());
            if let Some(population) = &mut self.population {
                population.keep(&ego.id);
            }
            // What all that moves comes with is one ego's subscription.
            if self.fetch != Fetch::Once || self.egos.len() == 1 {
                observe::subscribe(&mut self.batch, &ego.id, self.sight, self.fetch);
            }
        }
        if !self.subscribed {
            self.subscribed = true;
            StepEvents::subscribe(&mut self.batch);
            // Whatever the traffic: a task's obstacle and a scenario's vehicles are of these types.
            Population::define_types(&mut self.batch);
            let (time, tick) = (self.ticks as f64 * self.tick(), self.tick());
            if let (Some(director), Some(ego)) = (&mut self.director, egos.first()) {
                // Before the population: what the scenario has put somewhere stands there.
                director.begin(&Scene { network: &self.network, time, tick, ego }, &mut self.batch);
            }
            if let Some(population) = &mut self.population {
                population.populate(&mut self.batch, &poses(egos));
            }
        }
        if let (true, Some(ego)) = (self.gui, egos.first()) {
            self.batch.set(gui::TRACK_VEHICLE, gui::MAIN_VIEW, &ego.id);
            self.batch.set(gui::SET_ZOOM, gui::MAIN_VIEW, 800.0);
        }
        let replies = self.exchange(egos).await?;
        if let Err(refusal) = replies.check() {
            return Err(sumo_traci::Error::from(refusal).into());
        }
        Ok(())
    }

    /// The connection, for commands that the bridge does not send. Do not step SUMO with it; what it sets
    /// holds from the next tick on.
    pub fn client_mut(&mut self) -> &mut TcpClient {
        &mut self.client
    }

    /// One SUMO step with the egos where their physics put them; each then has a new world.
    ///
    /// # Errors
    /// SUMO died, hung, sent garbage or lost an ego.
    pub async fn step(&mut self, egos: &mut [&mut Ego]) -> Result<(), BridgeError> {
        if let Some(core) = &mut self.core {
            core.settle();
        }
        let replies = self.exchange(egos).await?;
        for refusal in replies.failures() {
            tracing::debug!("SUMO refused: {refusal}");
        }
        Ok(())
    }

    /// Sends what is in the batch with the egos' poses and the step, and reads the new worlds.
    async fn exchange(&mut self, egos: &mut [&mut Ego]) -> Result<Replies, BridgeError> {
        let (time, tick) = (self.ticks as f64 * self.tick(), self.tick());
        if let (Some(director), Some(ego)) = (&mut self.director, egos.first()) {
            director.direct(&Scene { network: &self.network, time, tick, ego }, &mut self.batch);
        }
        let observers: Vec<Point> = egos.iter().map(|ego| ego.state().pose.xy()).collect();
        self.signals.follow(&self.network, &observers, &mut self.batch);
        let reported: Vec<_> =
            egos.iter_mut().map(|ego| ego.report(&self.network, &mut self.batch)).collect();
        if let Some(population) = &mut self.population {
            self.taken_out += population.taken_out();
        }
        self.batch.step();
        let sent = Instant::now();
        let replies = match self.client.send(&self.batch).await {
            Ok(replies) => replies,
            Err(error) => return Err(self.explain(error).await),
        };
        self.sumo_seconds += sent.elapsed().as_secs_f64();
        self.answer_bytes += replies.bytes() as u64;
        // From here on the batch is the next tick's.
        self.batch.clear();
        self.ticks += 1;
        let (time, tick) = (self.time(), self.tick());
        self.catalog.next_tick();
        for (ego, reported) in egos.iter_mut().zip(reported) {
            if let Err(refusal) = ego.confirm(reported, &replies) {
                let (id, why) = (ego.id.clone(), refusal.to_string());
                return Err(BridgeError::EgoLost { id, time: self.time(), why });
            }
        }
        let subscriptions = replies.subscriptions();
        self.signals.read(&self.network, &subscriptions);
        let events = StepEvents::read(&replies).map_err(sumo_traci::Error::from)?;
        for id in &events.departed {
            if let Some(is_there) = self.guests.get_mut(*id) {
                *is_there = true;
            }
        }
        let gone = events.arrived.len() + std::mem::take(&mut self.taken_out);
        self.in_network = (self.in_network + events.departed.len()).saturating_sub(gone);
        self.counts.0 = self.in_network.saturating_sub(egos.len());
        // SUMO's own number of persons also counts persons who have not departed yet.
        self.counts.1 =
            (self.counts.1 + events.departed_persons.len()).saturating_sub(events.arrived_persons.len());
        let once = self.fetch == Fetch::Once;
        if let Some(first) = self.egos.first().filter(|_| once) {
            let (client, network) = (&mut self.client, &self.network);
            if let Err(error) = self.catalog.observe_all(client, network, &replies, first, tick).await {
                return Err(self.explain(error).await);
            }
        }
        for ego in egos.iter_mut() {
            let Ego { id, world, previous, extras, vehicle, .. } = &mut **ego;
            std::mem::swap(world, previous);
            let reach = self.sight;
            let pose = vehicle.state().pose;
            if once {
                let front = pose.advanced(0.5 * vehicle.params().length);
                self.catalog.observe(id, front.xy(), reach, world);
            } else {
                let (client, network) = (&mut self.client, &self.network);
                let observed = self.catalog.observe_around(client, network, &replies, id, tick, world).await;
                if let Err(error) = observed {
                    return Err(self.explain(error).await);
                }
            }
            let position = pose.xy();
            for extra in extras.iter().filter(|e| (e.pose.xy() - position).norm() < reach) {
                let person = extra.actor_type.kind == sumo_network::world::ActorKind::Pedestrian;
                if person { &mut world.pedestrians } else { &mut world.vehicles }.push(extra.clone());
            }
            world.tick = self.ticks;
            world.time = time;
            world.traffic_lights.clear();
            world.traffic_lights.extend_from_slice(self.signals.states());
        }
        if let Some(population) = &mut self.population {
            let near: Vec<Point> = egos
                .iter()
                .flat_map(|ego| ego.world.vehicles.iter().chain(&ego.world.pedestrians))
                .map(|actor| actor.pose.xy())
                .collect();
            population.update(&events, &replies, &poses(egos), &near, &mut self.batch);
            // Road users that the population removed do not arrive.
            self.counts.1 = population.alive().pedestrians;
        }
        Ok(replies)
    }

    /// Sends `batch` at once, between the ticks; it must not step SUMO.
    ///
    /// # Errors
    /// SUMO died, hung or sent garbage.
    pub async fn ask(&mut self, batch: &Batch) -> Result<Replies, BridgeError> {
        match self.client.send(batch).await {
            Ok(replies) => Ok(replies),
            Err(error) => Err(self.explain(error).await),
        }
    }

    /// Commands that go to SUMO with the next step, before it.
    pub fn next_batch(&mut self) -> &mut Batch {
        &mut self.batch
    }

    /// Saves SUMO's state, persons and random generators included.
    ///
    /// # Errors
    /// SUMO fails or cannot write the file.
    pub async fn save_state(&mut self, file: &Path) -> Result<(), BridgeError> {
        Ok(self.client.save_state(&file.to_string_lossy()).await?)
    }

    /// A broken connection's error with SUMO's end and its last log lines, where SUMO was our child.
    async fn explain(&mut self, error: sumo_traci::Error) -> BridgeError {
        match &mut self.process {
            Some(process) if error.is_fatal() => process.explain(error).await.into(),
            _ => error.into(),
        }
    }

    /// Ends the co-simulation: closes the connection and waits for an own SUMO to end.
    ///
    /// # Errors
    /// SUMO did not close the connection properly. It has ended even so.
    pub async fn close(self) -> Result<(), BridgeError> {
        let closed = self.client.close().await;
        if let Some(mut process) = self.process {
            // Dropping it kills what is still there.
            process.wait_at_most(Duration::from_secs(5)).await;
        }
        Ok(closed?)
    }
}

fn poses(egos: &[&mut Ego]) -> Vec<Pose> {
    egos.iter().map(|ego| ego.state().pose).collect()
}

fn overrides(options: &BridgeOptions, config: &SumoConfig, tick_ms: f64) -> Overrides {
    let own = |pairs: &[(&str, &str)]| -> Vec<(String, String)> {
        pairs.iter().map(|(k, v)| ((*k).to_string(), (*v).to_string())).collect()
    };
    let mut default = own(&[
        ("collision.action", "warn"),
        ("collision.check-junctions", "true"),
        ("collision.mingap-factor", "0"),
        ("time-to-teleport", "-1"),
        // Pedestrians wait at an ego that blocks their crossing rather than squeeze through it.
        ("pedestrian.striping.jamtime.crossing", "300"),
    ]);
    if !config.has("lateral-resolution") {
        // Without it cars jump a lane within a tick; the sublane model has its own way.
        default.push(("lanechange.duration".to_string(), "2".to_string()));
    }
    let mut set = own(&[
        ("no-step-log", "true"),
        ("duration-log.disable", "true"),
        ("save-state.transportables", "true"),
        ("save-state.rng", "true"),
    ]);
    set.push(("step-length".to_string(), format!("{}", tick_ms / 1000.0)));
    set.push(("seed".to_string(), seeds::sumo(options.seed).to_string()));
    if options.gui {
        set.extend(own(&[("start", "true"), ("quit-on-end", "true")]));
    }
    Overrides {
        output_dir: options.output_dir.clone(),
        set,
        default,
        drop_demand: !options.traffic.keeps_config_demand() && !options.scenario,
        drop_type: options.scenario.then_some(EGO_TYPE),
    }
}
