//! The town's materials.

use crate::model::{
    Channel, Facade, GroundFloor, Library, Material, MaterialId, Rgb, SemanticTag, Texture, Tint, Wall, srgb,
};

/// The town's materials, apart from facades.
#[derive(Clone, Debug)]
pub(super) struct Materials {
    pub asphalt: MaterialId,
    pub worn: MaterialId,
    pub junction: MaterialId,
    pub parking: MaterialId,
    pub kerb: MaterialId,
    pub paving: MaterialId,
    pub slabs: MaterialId,
    pub plaza: MaterialId,
    pub path: MaterialId,
    pub grass: MaterialId,
    pub lawn: MaterialId,
    pub soil: MaterialId,
    pub water: MaterialId,
    pub pole: MaterialId,
    pub dark_pole: MaterialId,
    pub guard_rail: MaterialId,
    pub wood: MaterialId,
    pub iron: MaterialId,
    pub glass: MaterialId,
    pub bin: MaterialId,
    pub shelter: MaterialId,
    pub lamp_glass: MaterialId,
    pub foliage: MaterialId,
    pub conifer: MaterialId,
    pub hedge: MaterialId,
    pub bark: MaterialId,
    pub head_case: MaterialId,
    pub head_rim: MaterialId,
    pub red: MaterialId,
    pub yellow: MaterialId,
    pub green: MaterialId,
    pub sign_white: MaterialId,
    pub sign_red: MaterialId,
    pub sign_blue: MaterialId,
    pub sign_yellow: MaterialId,
    pub sign_black: MaterialId,
    pub sign_back: MaterialId,
    pub roofs: Vec<MaterialId>,
    pub flat_roof: MaterialId,
    pub trims: Vec<MaterialId>,
    pub brick: MaterialId,
    pub hills: [MaterialId; 2],
    pub skyline: MaterialId,
}

fn solid(name: &str, tag: SemanticTag, albedo: Rgb, texture: Texture) -> Material {
    Material { name: name.to_string(), albedo, texture, tag, wetness: 0.3, ..Material::default() }
}

fn shiny(name: &str, tag: SemanticTag, albedo: Rgb, gloss: f32) -> Material {
    Material { gloss, ..solid(name, tag, albedo, Texture::Plain) }
}

fn lamp(name: &str, albedo: Rgb, emission: Rgb, channel: Channel) -> Material {
    Material {
        emission,
        channel,
        gloss: 0.3,
        ..solid(name, SemanticTag::TrafficLight, albedo, Texture::Plain)
    }
}

impl Materials {
    pub fn new(library: &mut Library) -> Self {
        use SemanticTag as Tag;
        let mut m = |material: Material| library.material(material);
        let asphalt = |name: &str, grey: u8, wear: f32, tracks: bool| Material {
            wetness: 1.0,
            ..solid(
                name,
                Tag::Road,
                srgb(grey, grey, grey.saturating_add(1)),
                Texture::Asphalt { wear, tracks },
            )
        };
        let leaf = |name: &str, tag: Tag, albedo: Rgb| Material {
            tint: Tint::Instance(0),
            double_sided: true,
            wetness: 0.0,
            ..solid(name, tag, albedo, Texture::Foliage)
        };
        let plain = |name: &str, tag: Tag, albedo: Rgb| solid(name, tag, albedo, Texture::Plain);
        let sign = |name: &str, albedo: Rgb| plain(name, Tag::TrafficSign, albedo);
        Self {
            asphalt: m(asphalt("asphalt", 112, 0.35, true)),
            worn: m(asphalt("worn asphalt", 120, 0.8, true)),
            junction: m(asphalt("asphalt of junctions", 111, 0.45, false)),
            parking: m(asphalt("asphalt of car parks", 108, 0.7, false)),
            kerb: m(Material {
                wetness: 0.5,
                ..solid("kerb", Tag::SideWalk, srgb(168, 164, 156), Texture::Concrete)
            }),
            paving: m(Material {
                wetness: 0.7,
                ..solid("sidewalk", Tag::SideWalk, srgb(150, 146, 140), Texture::Paving { size: [0.6, 0.6] })
            }),
            slabs: m(Material {
                wetness: 0.7,
                ..solid(
                    "sidewalk corner",
                    Tag::SideWalk,
                    srgb(152, 148, 141),
                    Texture::Paving { size: [0.4, 0.4] },
                )
            }),
            plaza: m(Material {
                wetness: 0.7,
                ..solid("plaza", Tag::Ground, srgb(172, 160, 142), Texture::Paving { size: [0.9, 0.45] })
            }),
            path: m(solid("path", Tag::SideWalk, srgb(150, 136, 112), Texture::Soil)),
            grass: m(solid("grass", Tag::Terrain, srgb(104, 120, 62), Texture::Grass)),
            lawn: m(solid("lawn", Tag::Vegetation, srgb(92, 126, 58), Texture::Grass)),
            soil: m(solid("soil", Tag::Terrain, srgb(124, 112, 96), Texture::Soil)),
            water: m(Material { gloss: 0.6, ..solid("water", Tag::Water, srgb(44, 66, 70), Texture::Plain) }),
            pole: m(shiny("pole", Tag::Pole, srgb(142, 146, 148), 0.25)),
            dark_pole: m(shiny("dark pole", Tag::Pole, srgb(58, 62, 60), 0.2)),
            guard_rail: m(shiny("guard rail", Tag::GuardRail, srgb(160, 164, 166), 0.35)),
            wood: m(plain("wood", Tag::Static, srgb(122, 88, 56))),
            iron: m(shiny("cast iron", Tag::Static, srgb(48, 52, 54), 0.15)),
            glass: m(shiny("shelter glass", Tag::Static, srgb(96, 112, 116), 0.7)),
            bin: m(shiny("bin", Tag::Static, srgb(52, 74, 60), 0.1)),
            shelter: m(shiny("shelter frame", Tag::Static, srgb(70, 76, 82), 0.2)),
            lamp_glass: m(Material {
                emission: [2.0, 1.7, 1.1],
                channel: Channel::StreetLamp,
                ..shiny("lamp glass", Tag::Pole, srgb(220, 218, 206), 0.3)
            }),
            foliage: m(leaf("leaves", Tag::Vegetation, [1.0; 3])),
            conifer: m(leaf("needles", Tag::Vegetation, [0.75, 0.85, 0.95])),
            hedge: m(Material { tint: Tint::Own, ..leaf("hedge", Tag::Vegetation, srgb(62, 88, 42)) }),
            bark: m(plain("bark", Tag::Vegetation, srgb(88, 74, 60))),
            head_case: m(shiny("signal case", Tag::TrafficLight, srgb(34, 36, 36), 0.1)),
            head_rim: m(shiny("signal visor", Tag::TrafficLight, srgb(24, 25, 25), 0.05)),
            red: m(lamp("red lamp", srgb(74, 18, 18), [2.6, 0.08, 0.05], Channel::SignalRed)),
            yellow: m(lamp("yellow lamp", srgb(78, 58, 16), [2.5, 1.25, 0.06], Channel::SignalYellow)),
            green: m(lamp("green lamp", srgb(12, 58, 42), [0.06, 2.2, 1.0], Channel::SignalGreen)),
            sign_white: m(sign("sign white", srgb(236, 236, 232))),
            sign_red: m(sign("sign red", srgb(190, 26, 32))),
            sign_blue: m(sign("sign blue", srgb(24, 82, 158))),
            sign_yellow: m(sign("sign yellow", srgb(240, 188, 24))),
            sign_black: m(sign("sign black", srgb(26, 26, 28))),
            sign_back: m(shiny("sign back", Tag::TrafficSign, srgb(134, 138, 140), 0.2)),
            roofs: [(138, 74, 56), (118, 62, 48), (150, 90, 66), (86, 84, 86), (104, 92, 84), (74, 72, 78)]
                .into_iter()
                .map(|(r, g, b)| m(solid("tiles", Tag::Building, srgb(r, g, b), Texture::Roof)))
                .collect(),
            flat_roof: m(solid("flat roof", Tag::Building, srgb(112, 110, 106), Texture::Concrete)),
            trims: [(222, 216, 204), (196, 186, 168), (146, 142, 138), (92, 90, 92)]
                .into_iter()
                .map(|(r, g, b)| m(solid("trim", Tag::Building, srgb(r, g, b), Texture::Plain)))
                .collect(),
            brick: m(solid("brick", Tag::Building, srgb(142, 84, 66), Texture::Brick)),
            hills: [
                m(Material { wetness: 0.0, ..plain("near hills", Tag::Terrain, srgb(88, 108, 78)) }),
                m(Material { wetness: 0.0, ..plain("far hills", Tag::Terrain, srgb(122, 140, 140)) }),
            ],
            skyline: m(plain("skyline", Tag::Building, srgb(140, 146, 154))),
        }
    }
}

/// How facades of a kind of house look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum House {
    Residential,
    Commercial,
    Industrial,
    Church,
}

const PLASTERS: [[u8; 3]; 12] = [
    [226, 214, 190],
    [238, 230, 214],
    [214, 190, 152],
    [204, 170, 136],
    [190, 200, 192],
    [224, 196, 176],
    [196, 186, 172],
    [236, 220, 176],
    [178, 192, 204],
    [216, 208, 200],
    [200, 150, 122],
    [232, 234, 230],
];
const BRICKS: [[u8; 3]; 4] = [[150, 84, 64], [126, 66, 52], [170, 112, 84], [112, 78, 68]];
const CONCRETES: [[u8; 3]; 5] =
    [[172, 170, 164], [148, 150, 152], [190, 186, 176], [126, 130, 134], [164, 156, 148]];
const GLASSES: [[u8; 3]; 3] = [[92, 112, 124], [78, 96, 104], [104, 118, 116]];
const TRIMS: [[u8; 3]; 6] =
    [[240, 238, 232], [84, 66, 52], [60, 66, 72], [204, 196, 182], [52, 78, 62], [120, 36, 38]];

fn of(table: &[[u8; 3]], n: u32) -> Rgb {
    let [r, g, b] = table[n as usize % table.len()];
    srgb(r, g, b)
}

/// A facade of a kind, varied by `seed`. `storey` is fitted so that whole storeys fill `height` (m).
pub(super) fn facade(kind: House, height: f64, seed: u32) -> (Facade, Rgb) {
    let pick = |shift: u32, n: u32| (seed >> shift) % n;
    let trim = of(&TRIMS, pick(4, 97));
    let whole = |storey: f64| {
        let storeys = (height / storey).round().max(1.0);
        (height / storeys) as f32
    };
    let base = Facade {
        wall: Wall::Plaster,
        ground_floor: GroundFloor::Homes,
        storey: whole(3.0),
        bay: 2.8,
        window: [1.1, 1.4],
        sill: 0.85,
        door_every: 4,
        trim,
        lit_share: 0.3,
        seed,
    };
    match kind {
        House::Residential => {
            let brick = pick(8, 10) < 4;
            let (wall, colour) = if brick {
                (Wall::Brick, of(&BRICKS, pick(12, 97)))
            } else {
                (Wall::Plaster, of(&PLASTERS, pick(12, 97)))
            };
            let wide = [0.95, 1.1, 1.3, 1.7][pick(16, 4) as usize];
            let bay = [2.6, 2.8, 3.2, 3.6][pick(18, 4) as usize];
            (Facade { wall, bay, window: [wide, [1.3, 1.45, 1.6][pick(20, 3) as usize]], ..base }, colour)
        }
        House::Commercial => match pick(8, 10) {
            0..=2 => (
                Facade {
                    wall: Wall::Glass,
                    ground_floor: GroundFloor::Shops,
                    storey: whole(3.6),
                    bay: 1.8,
                    window: [1.62, 3.1],
                    sill: 0.25,
                    lit_share: 0.5,
                    ..base
                },
                of(&GLASSES, pick(12, 97)),
            ),
            3..=6 => (
                Facade {
                    wall: Wall::Concrete,
                    ground_floor: GroundFloor::Shops,
                    storey: whole(3.4),
                    bay: 3.4,
                    window: [[2.2, 2.6, 1.5][pick(16, 3) as usize], 1.7],
                    sill: 0.9,
                    lit_share: 0.4,
                    ..base
                },
                of(&CONCRETES, pick(12, 97)),
            ),
            _ => (
                Facade {
                    wall: if pick(9, 2) == 0 { Wall::Brick } else { Wall::Plaster },
                    ground_floor: GroundFloor::Shops,
                    storey: whole(3.4),
                    bay: 2.7,
                    window: [1.25, 1.8],
                    sill: 0.75,
                    lit_share: 0.35,
                    ..base
                },
                if pick(9, 2) == 0 { of(&BRICKS, pick(12, 97)) } else { of(&PLASTERS, pick(12, 97)) },
            ),
        },
        House::Industrial => (
            Facade {
                wall: if pick(8, 3) == 0 { Wall::Brick } else { Wall::Concrete },
                ground_floor: if pick(10, 2) == 0 { GroundFloor::Blank } else { GroundFloor::Homes },
                storey: whole(4.5),
                bay: 4.8,
                window: [3.0, 1.2],
                sill: 2.2,
                door_every: 3,
                lit_share: 0.2,
                ..base
            },
            if pick(8, 3) == 0 { of(&BRICKS, pick(12, 97)) } else { of(&CONCRETES, pick(12, 97)) },
        ),
        House::Church => (
            Facade {
                wall: Wall::Brick,
                ground_floor: GroundFloor::Blank,
                storey: whole(12.0),
                bay: 5.0,
                window: [1.6, 7.0],
                sill: 2.6,
                door_every: 0,
                lit_share: 0.0,
                ..base
            },
            srgb(176, 166, 146),
        ),
    }
}

impl Materials {
    /// Blocks on flat roofs.
    pub fn concrete_roof(&self) -> MaterialId {
        self.flat_roof
    }
    /// Railings.
    pub fn balcony(&self) -> MaterialId {
        self.trims[3]
    }
}
