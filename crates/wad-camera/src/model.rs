//! The renderer's input: meshes, materials, models, chunks of the town, and the actors of a frame.
//!
//! The scene and actor builders fill these types; the renderer only reads them. World frame: x east,
//! y north, z up, metres. Model frame: x forward, y left, z up, the origin on the ground in the middle
//! of the footprint. Front faces are counter-clockwise seen from outside.

pub use super::material::{
    Channel, Facade, GroundFloor, Material, MaterialId, Rgb, SemanticTag, Texture, Tint, Wall, srgb,
};
pub use super::mesh::{Mesh, Triangle, Vertex};

use super::grid::Grid;
use super::mesh::Faces;
use super::walls::Walls;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::OnceLock;
use sumo_network::geometry::Pose;
use sumo_network::network::SignalIndex;

/// Index into [`Library::models`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ModelId(pub u16);

/// The channels that shine on one instance (a bit set by [`Channel`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lamps(pub u32);

impl Lamps {
    /// This set with `channel` in it.
    #[must_use]
    pub fn with(self, channel: Channel) -> Self {
        Self(self.0 | 1 << channel as u32)
    }
    /// Whether `channel` shines.
    pub fn has(self, channel: Channel) -> bool {
        self.0 >> channel as u32 & 1 == 1
    }
}

/// A level of detail: a mesh and the least size at which it is drawn.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Level {
    /// The triangles.
    pub mesh: Mesh,
    /// Used while the model's bounding sphere is at least this many pixels in radius.
    pub min_pixels: f32,
}

/// A part of a model that swings about an axis through `pivot`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bone {
    /// m, model frame.
    pub pivot: [f32; 3],
    /// Unit axis of the turn, model frame.
    pub axis: [f32; 3],
    /// The turn is `amplitude` x sin(phase + `offset`) (rad); an amplitude of 0 stays.
    pub amplitude: f32,
    /// Shift of the phase (rad).
    pub offset: f32,
    /// Turns with the whole phase instead (wheels).
    pub spins: bool,
    /// Bone that this one hangs on (a shin on its thigh); must be smaller than its own index.
    pub parent: Option<u8>,
}

/// Something that is placed many times: a car, a person, a tree, a lamp.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Model {
    /// For readers of a dump.
    pub name: String,
    /// Finest first, `min_pixels` falling. Below the last one's nothing is drawn.
    pub levels: Vec<Level>,
    /// Its moving parts; may be empty.
    pub bones: Vec<Bone>,
    /// Corners of the bounding box (m, model frame).
    pub bounds: [[f32; 3]; 2],
    /// Casts a sun shadow of its shape (static) or of its boxes (actors).
    pub casts_shadow: bool,
    /// Boxes (m, model frame) whose shadow stands for an actor's; empty: `bounds`.
    pub shadow_boxes: Vec<[[f32; 3]; 2]>,
    /// Where lamps dazzle: centre (m, model frame), channel. Drawn as a glow at night and in rain.
    pub glows: Vec<([f32; 3], Channel)>,
}

/// All materials and models of a scene.
#[derive(Clone, Debug, Default)]
pub struct Library {
    /// By [`MaterialId`].
    pub materials: Vec<Material>,
    /// By [`ModelId`].
    pub models: Vec<Model>,
}

impl Library {
    /// Adds a material.
    pub fn material(&mut self, material: Material) -> MaterialId {
        self.materials.push(material);
        MaterialId(self.materials.len() as u32 - 1)
    }
    /// Adds a model.
    pub fn model(&mut self, model: Model) -> ModelId {
        self.models.push(model);
        ModelId(self.models.len() as u16 - 1)
    }
}

/// The eight classes that detectors know.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObjectClass {
    /// Cars and vans.
    Car,
    /// Motorcycles.
    Motorcycle,
    /// Bicycles.
    Bicycle,
    /// People.
    Person,
    /// Buses.
    Bus,
    /// Lorries.
    Truck,
    /// Signal heads.
    TrafficLight,
    /// Benches.
    Bench,
}

impl ObjectClass {
    /// About the share (0..1) of its box in a picture that an object of this class fills.
    pub fn fills(self) -> f32 {
        match self {
            Self::Car => 0.75,
            Self::Bus | Self::Truck => 0.85,
            Self::Motorcycle | Self::Bicycle | Self::Bench => 0.45,
            Self::Person => 0.4,
            Self::TrafficLight => 0.7,
        }
    }
}

/// A box with one heading, upright.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Box3 {
    /// Centre of the footprint on the ground and heading.
    pub pose: Pose,
    /// Length along the heading, width, height (m).
    pub size: [f64; 3],
}

/// The ground truth of an instance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Object {
    /// What it is.
    pub class: ObjectClass,
    /// Instance id, not 0, unique in the frame. A road user's is its place in the world + 1, vehicles before
    /// pedestrians; its rider has [`RIDER_IDS`] more. Static objects count from [`STATIC_IDS`].
    pub id: u32,
    /// The box round it.
    pub bounds: Box3,
}

/// The first instance id of static objects; actors stay below.
pub const STATIC_IDS: u32 = 1 << 24;
/// Added to a vehicle's id, it gives the rider's.
pub const RIDER_IDS: u32 = 1 << 23;

/// A placed model, for one frame or for the whole scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Instance {
    /// Which model.
    pub model: ModelId,
    /// Where the model's origin is.
    pub pose: Pose,
    /// Size of the model, 1 as built: x, y, z.
    pub scale: [f32; 3],
    /// Colours for [`Tint::Instance`].
    pub tints: [Rgb; 4],
    /// The channels that shine on it.
    pub lamps: Lamps,
    /// Phase of the walk or of the wheels (rad).
    pub phase: f32,
    /// A signal head's lamps follow this (static instances).
    pub signal: Option<SignalIndex>,
    /// Ground truth; None for objects outside the eight classes.
    pub object: Option<Object>,
}

impl Instance {
    /// `model` at `pose` as it was built.
    pub fn new(model: ModelId, pose: Pose) -> Self {
        Self {
            model,
            pose,
            scale: [1.0; 3],
            tints: [[0.5; 3]; 4],
            lamps: Lamps::default(),
            phase: 0.0,
            signal: None,
            object: None,
        }
    }
}

/// White paint on the road: a convex quadrilateral, drawn with exact coverage however thin it is.
///
/// A bent line is a chain of quads: corners 0-1 and 2-3 are its sides, 1-2 its front end, 3-0 its rear
/// end. Ends shared with the next quad of the chain are not softened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paint {
    /// Counter-clockwise seen from above (m, chunk frame), on the surface (no offset needed).
    pub corners: [[f32; 3]; 4],
    /// 0 worn off .. 1 fresh.
    pub strength: f32,
    /// Whether the front end (1-2) and the rear end (3-0) are the line's own ends.
    pub front_end: bool,
    /// See `front_end`.
    pub rear_end: bool,
}

/// A piece of the town, about [`CHUNK_SIZE`] wide. Everything in it that is not instanced is baked into
/// its meshes.
#[derive(Clone, Debug, Default)]
pub struct Chunk {
    /// Origin of its frame (m, world).
    pub origin: Point3<f64>,
    /// Corners of the box that holds all of it, instances included (m, chunk frame).
    pub bounds: [[f32; 3]; 2],
    /// Roads, sidewalks, lawns, buildings. Finest first; a level is used to its distance (m) from the
    /// camera to the chunk's box; the last one's is usually infinite.
    pub levels: Vec<(f32, Mesh)>,
    /// Lines and marks on the ground.
    pub paint: Vec<Paint>,
    /// The models placed in it.
    pub instances: Vec<Instance>,
}

impl Chunk {
    /// The middle of its box (x, y in m, world).
    fn middle(&self) -> [f64; 2] {
        let middle = |axis: usize| 0.5 * f64::from(self.bounds[0][axis] + self.bounds[1][axis]);
        [self.origin.x + middle(0), self.origin.y + middle(1)]
    }
}

/// What a traffic sign says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sign {
    /// No faster than this (km/h): one of [`LIMITS`].
    Limit(u32),
    /// Give way.
    GiveWay,
    /// Stop, then give way.
    Stop,
}

/// The speed limits that signs show (km/h).
pub const LIMITS: [u32; 11] = [20, 30, 40, 50, 60, 70, 80, 90, 100, 120, 130];

impl Sign {
    /// How many there are.
    pub const KINDS: usize = LIMITS.len() + 2;

    /// Its number, below [`Self::KINDS`]: the limits, give way, stop.
    pub fn index(self) -> usize {
        match self {
            Self::Limit(kmh) => LIMITS.iter().position(|limit| *limit == kmh).unwrap_or(0),
            Self::GiveWay => LIMITS.len(),
            Self::Stop => LIMITS.len() + 1,
        }
    }

    /// The sign with a number below [`Self::KINDS`].
    pub fn of(index: usize) -> Self {
        match LIMITS.get(index) {
            Some(limit) => Self::Limit(*limit),
            None if index == LIMITS.len() => Self::GiveWay,
            None => Self::Stop,
        }
    }

    /// From the middle of its plate to its rim, a triangle's corners (m).
    pub const fn radius(self) -> f32 {
        match self {
            Self::Limit(_) => 0.33,
            Self::GiveWay => 0.5,
            Self::Stop => 0.4,
        }
    }

    /// The limit that is nearest to one (km/h).
    pub fn limit(kmh: u32) -> Self {
        Self::Limit(LIMITS.into_iter().min_by_key(|limit| limit.abs_diff(kmh)).unwrap_or(kmh))
    }
}

impl fmt::Display for Sign {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Limit(kmh) => write!(f, "{kmh}"),
            Self::GiveWay => f.write_str("give way"),
            Self::Stop => f.write_str("stop"),
        }
    }
}

/// A sign at the roadside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedSign {
    /// What it says.
    pub sign: Sign,
    /// The middle of its plate, and the heading of the traffic that it faces.
    pub pose: Pose,
}

/// Width of a chunk of the town (m).
pub const CHUNK_SIZE: f64 = 32.0;

/// The town without its road users.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Materials and models.
    pub library: Library,
    /// Lies under everything, to the horizon: its material and height (m).
    pub ground: Option<(MaterialId, f64)>,
    /// Fill and then call [`Scene::index`].
    pub chunks: Vec<Chunk>,
    /// Speed limits, give-way and stop signs.
    pub signs: Vec<PlacedSign>,
    pub(super) grid: Grid,
    /// Worked out when they are first asked for.
    walls: OnceLock<Walls>,
}

impl Scene {
    /// Rebuilds the spatial index and what is drawn after `chunks` or the library changed.
    pub fn index(&mut self) {
        self.grid = Grid::new(self.chunks.iter().map(Chunk::middle));
        self.walls = OnceLock::new();
        let materials = &self.library.materials;
        let models = self.library.models.iter_mut().flat_map(|m| &mut m.levels).map(|level| &mut level.mesh);
        let chunks = self.chunks.iter_mut().flat_map(|c| &mut c.levels).map(|(_, mesh)| mesh);
        for mesh in models.chain(chunks) {
            mesh.faces = Faces::of(mesh, materials);
        }
    }

    /// What hides at the height of eyes.
    pub(super) fn walls(&self) -> &Walls {
        // Instances (trees, lamps) are too thin; the finest level of a chunk is its first.
        self.walls.get_or_init(|| {
            Walls::of(self.chunks.iter().filter_map(|c| Some((c.origin, &c.levels.first()?.1))))
        })
    }

    /// The town `times` times, side by side to the east: for measuring what a larger town costs.
    #[must_use]
    pub fn repeated(&self, times: usize) -> Self {
        let ends = |f: fn(f64, f64) -> f64, start: f64, corner: usize| {
            self.chunks.iter().map(|c| c.origin.x + f64::from(c.bounds[corner][0])).fold(start, f)
        };
        let width = ends(f64::max, f64::MIN, 1) - ends(f64::min, f64::MAX, 0);
        let mut town = Self { chunks: Vec::with_capacity(self.chunks.len() * times), ..self.clone() };
        for copy in 0..times {
            let shift = width * copy as f64;
            town.chunks.extend(self.chunks.iter().cloned().map(|mut chunk| {
                chunk.origin.x += shift;
                chunk.instances.iter_mut().for_each(|i| i.pose.position.x += shift);
                chunk
            }));
        }
        town.index();
        town
    }
}

/// The road users of one tick.
#[derive(Clone, Debug, Default)]
pub struct ActorFrame {
    /// The scene's time (s): rain falls and blinkers blink by it.
    pub time: f64,
    /// In the order of the world's vehicles and pedestrians.
    pub instances: Vec<Instance>,
    /// The ego itself, seen only by cameras outside it.
    pub ego: Option<Instance>,
    /// State strings of the traffic lights, as [`sumo_network::world::WorldState::traffic_lights`] has them.
    pub traffic_lights: Vec<Option<std::sync::Arc<str>>>,
}
