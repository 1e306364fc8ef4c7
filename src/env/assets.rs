//! What all environments in a town share: it is read and built once.

use super::EnvError;
use crate::bundled;
use crate::camera::Town;
use crate::network::{Network, Shapes};
use crate::scenario::{self, Scenario};
use crate::sumo_config::{OptionSchema, SumoConfig};
use crate::tasks::{Placement, Places, TaskError, TaskKind};
use crate::traci::process::SumoInstall;
use crate::vehicle::{self, StaticBody};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// A town: its configuration, network, fixed bodies, look, and the places for the tasks.
pub struct Assets {
    config: PathBuf,
    net_hash: String,
    name: String,
    town_name: String,
    /// Where the config is a scenario's.
    scenario: Option<Arc<Scenario>>,
    network: Arc<Network>,
    statics: Vec<StaticBody>,
    shapes: Shapes,
    places: Places,
    /// Built when the first camera needs it.
    town: OnceLock<Town>,
}

/// Every town looks the same in every run: weights are trained on that look.
const LOOK: u64 = 0;

impl Assets {
    /// The town of a CONFIG: a .sumocfg, a .net.xml(.gz), a folder or a bundled name.
    ///
    /// # Errors
    /// There is no such town, or its network is broken.
    pub fn load(config: &str) -> Result<Arc<Self>, EnvError> {
        let config = bundled::resolve(config)?;
        let schema = OptionSchema::cached(&SumoInstall::find()?, false)?;
        let loaded = SumoConfig::load(&config, &schema)?;
        let net_file = loaded.net_file()?;
        let network = Network::load(&net_file)?;
        let net_hash = hash(&net_file);
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
        let scenario = match scenario::has_ego(&loaded) {
            true => Some(Arc::new(scenario::inspect_on(&loaded, &network).into_scenario()?)),
            false => None,
        };
        Ok(Arc::new(Self {
            config,
            net_hash,
            name: loaded.name(),
            town_name: loaded.town(),
            scenario,
            statics: vehicle::statics_from_network(&network, &shapes.polygons),
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

    /// The town's name, e.g. `town3`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The name of the net alone: a scenario's town.
    pub fn town_name(&self) -> &str {
        &self.town_name
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
    pub fn polygons(&self) -> &[crate::network::Polygon] {
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
}

/// CRC 32 and length of a file that was read a moment ago.
fn hash(path: &Path) -> String {
    let bytes = std::fs::read(path).unwrap_or_default();
    format!("{:08x}-{}", crc32fast::hash(&bytes), bytes.len())
}
