//! What surfaces are made of: colours, textures, tags, what shines.

/// Linear-light colour or reflectance, 0..1 per channel (red, green, blue).
pub type Rgb = [f32; 3];

/// A linear colour from 8-bit sRGB, as colour pickers show it.
pub fn srgb(red: u8, green: u8, blue: u8) -> Rgb {
    [red, green, blue].map(|c| (f32::from(c) / 255.0).powf(2.2))
}

/// Index into [`Library::materials`](super::model::Library::materials).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MaterialId(pub u32);

/// CARLA's semantic tags, by its numbers (0.9.14 and later).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u8)]
pub enum SemanticTag {
    /// Nothing of the others.
    #[default]
    Unlabeled = 0,
    /// Where vehicles drive.
    Road = 1,
    /// Where people walk beside the road.
    SideWalk = 2,
    /// Houses.
    Building = 3,
    /// Walls that stand alone.
    Wall = 4,
    /// Fences.
    Fence = 5,
    /// Poles of lamps, signs and signals.
    Pole = 6,
    /// Signal heads.
    TrafficLight = 7,
    /// Signs.
    TrafficSign = 8,
    /// Trees, hedges, bushes.
    Vegetation = 9,
    /// Grass, soil, sand.
    Terrain = 10,
    /// The sky.
    Sky = 11,
    /// People on foot.
    Pedestrian = 12,
    /// People on cycles.
    Rider = 13,
    /// Cars and vans.
    Car = 14,
    /// Lorries.
    Truck = 15,
    /// Buses.
    Bus = 16,
    /// Trains.
    Train = 17,
    /// Motorcycles.
    Motorcycle = 18,
    /// Bicycles.
    Bicycle = 19,
    /// Things that stand still: benches, bins.
    Static = 20,
    /// Things that can move: barriers, cones.
    Dynamic = 21,
    /// Anything else.
    Other = 22,
    /// Lakes, rivers.
    Water = 23,
    /// Paint on the road.
    RoadLine = 24,
    /// Ground of no other kind.
    Ground = 25,
    /// Bridges.
    Bridge = 26,
    /// Rails.
    RailTrack = 27,
    /// Guard rails.
    GuardRail = 28,
}

/// What a building's wall is made of between its windows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wall {
    /// Plaster.
    Plaster,
    /// Brick.
    Brick,
    /// Concrete.
    Concrete,
    /// A curtain wall: glass with a thin grid.
    Glass,
}

/// What the ground floor of a facade shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GroundFloor {
    /// Windows as above, with a door in every `door_every`-th bay.
    Homes,
    /// Wide shop windows with a fascia above.
    Shops,
    /// No openings.
    Blank,
}

/// A grid of windows over a wall; `uv` = (m along the wall, m above the ground).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facade {
    /// What is between the windows.
    pub wall: Wall,
    /// What the ground floor shows.
    pub ground_floor: GroundFloor,
    /// Height of a storey and width of a bay (m). A bay holds one window in its middle.
    pub storey: f32,
    /// Width of a bay (m).
    pub bay: f32,
    /// Width and height of a window (m); 0 for a wall without windows.
    pub window: [f32; 2],
    /// Height of the sill above the storey's floor (m).
    pub sill: f32,
    /// A door in every n-th bay of the ground floor (0: none).
    pub door_every: u32,
    /// Colour of frames, doors and fascias.
    pub trim: Rgb,
    /// Share of windows lit when lamps are on.
    pub lit_share: f32,
    /// Varies which windows have curtains or light.
    pub seed: u32,
}

/// The procedural pattern over a surface. Patterns that say `world` ignore uv and use the world's x, y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Texture {
    /// One colour, lit per vertex (smooth over shared normals). For actors and small things.
    Plain,
    /// World. Grain, patches and cracks by `wear` 0..1. Where `tracks`, uv = (m along the lane, m left
    /// of the lane's centre) and the wheels' tracks show.
    Asphalt {
        /// 0 new .. 1 worn.
        wear: f32,
        /// Whether wheels have left tracks.
        tracks: bool,
    },
    /// Slabs of `size` (m) with joints; uv = (m along, m across).
    Paving {
        /// Along and across (m).
        size: [f32; 2],
    },
    /// World. Fine grain, stains.
    Concrete,
    /// World. Blades and patches.
    Grass,
    /// World. Earth or gravel.
    Soil,
    /// Windows, doors, storeys.
    Facade(Facade),
    /// World. Tiles or tar.
    Roof,
    /// Leaves: light and dark clumps; uv in metres on the surface.
    Foliage,
    /// Brick without openings; uv in metres.
    Brick,
    /// A licence plate or a sign's small print: dark marks on the albedo; uv 0..1 over the plate.
    Plate,
}

/// What makes a surface shine by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Channel {
    /// Never.
    #[default]
    None = 0,
    /// Brake lamps.
    Brake = 1,
    /// Head lamps.
    Head = 2,
    /// Rear lamps: on with the head lamps.
    Tail = 3,
    /// Left blinkers.
    BlinkLeft = 4,
    /// Right blinkers.
    BlinkRight = 5,
    /// Red of a signal.
    SignalRed = 6,
    /// Yellow of a signal.
    SignalYellow = 7,
    /// Green of a signal.
    SignalGreen = 8,
    /// Street lamps.
    StreetLamp = 9,
}

/// Where a material's colour comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tint {
    /// The material's albedo.
    #[default]
    Own,
    /// The albedo times the instance's colour of this index (0..4).
    Instance(u8),
}

/// What a triangle is made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// For readers of a dump.
    pub name: String,
    /// Share of light reflected diffusely.
    pub albedo: Rgb,
    /// Whether an instance colours it.
    pub tint: Tint,
    /// The pattern over it.
    pub texture: Texture,
    /// What ground truth calls it.
    pub tag: SemanticTag,
    /// Mirror-like reflection of sky and sun, 0 (chalk) .. 1 (glass, chrome).
    pub gloss: f32,
    /// How much the surface darkens and mirrors when wet, 0 (leaves) .. 1 (asphalt, where puddles form).
    pub wetness: f32,
    /// Colour emitted while `channel` shines (1 = as bright as sunlit white).
    pub emission: Rgb,
    /// When `emission` shines.
    pub channel: Channel,
    /// Seen from both sides (leaves, sheets).
    pub double_sided: bool,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: String::new(),
            albedo: [0.5; 3],
            tint: Tint::Own,
            texture: Texture::Plain,
            tag: SemanticTag::Unlabeled,
            gloss: 0.0,
            wetness: 0.3,
            emission: [0.0; 3],
            channel: Channel::None,
            double_sided: false,
        }
    }
}
