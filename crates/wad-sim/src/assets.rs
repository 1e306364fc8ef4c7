//! A town, read and built once, and shared by its egos and cameras.

use crate::bundled::{self, ResolveError};
use crate::scenario::{self, Scenario, ScenarioError};
use crate::sumo_config::{ConfigError, OptionSchema, SumoConfig};
use crate::tasks::{Placement, Places, TaskError, TaskKind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use sumo_network::network::{Network, NetworkError, Shapes};
use sumo_traci::process::{InstallError, SumoInstall};
use wad_camera::Town;
use wad_camera::scene::Look;
use wad_vehicle::StaticBody;

/// A town: its configuration, network, fixed bodies, look, and the places for the tasks.
pub struct Assets {
    config: PathBuf,
    net_hash: String,
    files_hash: String,
    name: String,
    town_name: String,
    seed: Option<u64>,
    /// If the config is a scenario.
    scenario: Option<Arc<Scenario>>,
    network: Arc<Network>,
    statics: Vec<StaticBody>,
    shapes: Shapes,
    places: Places,
    /// Built when the first camera needs it.
    town: OnceLock<Town>,
}

/// Every town looks the same in every run, picture and data set: weights are trained on that look.
pub const LOOK: Look = Look::of(0);

/// Why there is no such town.
#[derive(Debug, thiserror::Error)]
pub enum AssetsError {
    /// No such town or scenario.
    #[error(transparent)]
    Resolve(#[from] ResolveError),
    /// The `.sumocfg` cannot be used.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The `.net.xml` cannot be read.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// SUMO is not installed, or its version is too old.
    #[error(transparent)]
    Install(#[from] InstallError),
    /// The scenario has mistakes.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
}

impl AssetsError {
    /// True where the user's input is at fault, not SUMO.
    pub fn is_input(&self) -> bool {
        !matches!(self, Self::Install(_))
    }
}

impl Assets {
    /// The town of a CONFIG: a .sumocfg, a .net.xml(.gz), a folder or a bundled name. If it is a
    /// scenario, the scenario too.
    ///
    /// # Errors
    /// There is no such town, or its network is broken.
    pub fn load(config: &str) -> Result<Arc<Self>, AssetsError> {
        Self::open(&bundled::resolve(config)?, true)
    }

    /// The town of a .sumocfg or .net.xml(.gz); `plays`: with its scenario, where it is one.
    ///
    /// # Errors
    /// As [`Assets::load`].
    pub fn open(config: &Path, plays: bool) -> Result<Arc<Self>, AssetsError> {
        let schema = OptionSchema::cached(&SumoInstall::find()?, false)?;
        let loaded = SumoConfig::load(config, &schema)?;
        let net_file = loaded.net_file()?;
        let network = Network::load(&net_file)?;
        let net_hash = hash_of(&net_file);
        // A bare net is its own configuration.
        let config_file = Some(config.to_path_buf()).filter(|file| *file != net_file);
        let files = [loaded.route_files(), loaded.additional_files()].concat();
        let hashes: Vec<String> = config_file.iter().chain(&files).map(|file| hash_of(file)).collect();
        let files_hash = hash(hashes.join(" ").as_bytes());
        network.require_drivable(crate::destination::EGO_CLASS)?;
        let mut shapes = Shapes::default();
        for file in loaded.additional_files() {
            match Shapes::load(&file, &network) {
                Ok(found) => {
                    shapes.polygons.extend(found.polygons);
                    shapes.points.extend(found.points);
                }
                Err(error) => tracing::warn!("no polygons from an additional file: {error}"),
            }
        }
        let scenario = match plays && scenario::has_ego(&loaded) {
            true => Some(Arc::new(scenario::inspect_on(&loaded, &network).into_scenario()?)),
            false => None,
        };
        Ok(Arc::new(Self {
            config: config.to_path_buf(),
            net_hash,
            files_hash,
            name: loaded.name(),
            town_name: loaded.town(),
            seed: loaded.seed(),
            scenario,
            statics: wad_vehicle::statics_from_network(&network, &shapes.polygons),
            network: Arc::new(network),
            shapes,
            places: Places::default(),
            town: OnceLock::new(),
        }))
    }

    /// The configuration's file.
    pub fn config(&self) -> &Path {
        &self.config
    }

    /// Stands for the bytes of the net's file.
    pub fn net_hash(&self) -> &str {
        &self.net_hash
    }

    /// Stands for the bytes of the configuration and the files that it names beside the net: routes, polygons, a
    /// scenario's ego and events.
    pub fn files_hash(&self) -> &str {
        &self.files_hash
    }

    /// The town's name, e.g. `town3`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The name of the net alone: a scenario's town.
    pub fn town_name(&self) -> &str {
        &self.town_name
    }

    /// The configuration's seed, if it has one.
    pub fn seed(&self) -> Option<u64> {
        self.seed
    }

    /// The scenario, where the config is one.
    pub fn scenario(&self) -> Option<&Arc<Scenario>> {
        self.scenario.as_ref()
    }

    /// The network.
    pub fn network(&self) -> &Arc<Network> {
        &self.network
    }

    /// Buildings and areas of the config's additional files.
    pub fn polygons(&self) -> &[sumo_network::network::Polygon] {
        &self.shapes.polygons
    }

    /// Buildings, poles, kerbs.
    pub fn statics(&self) -> &[StaticBody] {
        &self.statics
    }

    /// A place for a task, drawn from a seed; in a scenario always the scenario's own.
    ///
    /// # Errors
    /// The net has none.
    pub fn place(&self, task: TaskKind, seed: u64) -> Result<Placement, TaskError> {
        if let Some(scenario) = &self.scenario {
            return Ok(scenario.placement.clone());
        }
        self.places.draw(&self.network, task, seed)
    }

    /// How many different ways the net has for a task; see [`Places::count`].
    pub fn count(&self, task: TaskKind) -> Option<usize> {
        self.places.count(&self.network, task)
    }

    /// The town as cameras see it, to be followed on its own; what stands is shared.
    pub fn town(&self) -> Town {
        self.town.get_or_init(|| Town::new(&self.network, &self.shapes, LOOK)).share()
    }

    /// The town with another look (colours, façades, trees) than the one that agents know: variety for a detector's
    /// training.
    pub fn town_with(&self, look: Look) -> Town {
        if look == LOOK { self.town() } else { Town::new(&self.network, &self.shapes, look) }
    }
}

/// Stands for some bytes: their CRC 32 and length.
pub fn hash(bytes: &[u8]) -> String {
    format!("{:08x}-{}", crc32fast::hash(bytes), bytes.len())
}

/// [`hash`] of a file that was read a moment ago.
fn hash_of(path: &Path) -> String {
    hash(&std::fs::read(path).unwrap_or_default())
}
