//! Materials of road users. A material carries one semantic tag, so each kind has its own set.

use crate::model::{Channel, Library, Material, MaterialId, Rgb, SemanticTag, Texture, Tint, srgb};

/// Materials of vehicles of one tag.
#[derive(Clone, Debug)]
pub(super) struct VehiclePalette {
    /// The body's colour: tint 0.
    pub paint: MaterialId,
    /// A second colour (a truck's box, a bus's band): tint 1.
    pub second: MaterialId,
    pub glass: MaterialId,
    pub black: MaterialId,
    pub tyre: MaterialId,
    pub rim: MaterialId,
    pub chrome: MaterialId,
    pub head: MaterialId,
    pub tail: MaterialId,
    pub brake: MaterialId,
    pub blink_left: MaterialId,
    pub blink_right: MaterialId,
    pub plate: MaterialId,
    /// What is seen from below and in the arches.
    pub underside: MaterialId,
}

/// Materials of people of one tag; tints are 0 top, 1 legs, 2 skin, 3 hair. A rider's tint 0 is the
/// cycle's, 1 the top, and the legs are dark.
#[derive(Clone, Debug)]
pub(super) struct PersonPalette {
    pub top: MaterialId,
    pub legs: MaterialId,
    pub skin: MaterialId,
    pub hair: MaterialId,
    pub shoes: MaterialId,
    pub bag: MaterialId,
    /// Hard, shiny: a helmet in the hair's colour.
    pub helmet: MaterialId,
    pub visor: MaterialId,
}

fn tinted(name: &str, tag: SemanticTag, tint: u8, gloss: f32) -> Material {
    Material {
        name: format!("{tag:?} {name}"),
        albedo: [1.0; 3],
        tint: Tint::Instance(tint),
        texture: Texture::Plain,
        tag,
        gloss,
        wetness: 0.15,
        ..Material::default()
    }
}

fn plain(name: &str, tag: SemanticTag, albedo: Rgb, gloss: f32) -> Material {
    Material { albedo, tint: Tint::Own, ..tinted(name, tag, 0, gloss) }
}

fn lamp(name: &str, tag: SemanticTag, albedo: Rgb, emission: Rgb, channel: Channel) -> Material {
    Material { emission, channel, ..plain(name, tag, albedo, 0.45) }
}

/// Materials of barriers and cones.
#[derive(Clone, Debug)]
pub(super) struct ObjectPalette {
    pub red: MaterialId,
    pub white: MaterialId,
    pub foot: MaterialId,
    pub lamp: MaterialId,
}

impl ObjectPalette {
    pub fn new(library: &mut Library, tag: SemanticTag) -> Self {
        let mut m = |material| library.material(material);
        Self {
            red: m(plain("red sheet", tag, srgb(196, 30, 26), 0.3)),
            white: m(plain("white sheet", tag, srgb(236, 236, 230), 0.3)),
            foot: m(plain("rubber foot", tag, srgb(52, 52, 54), 0.05)),
            lamp: m(plain("amber lamp", tag, srgb(250, 168, 20), 0.5)),
        }
    }
}

impl VehiclePalette {
    pub fn new(library: &mut Library, tag: SemanticTag) -> Self {
        let mut m = |material| library.material(material);
        Self {
            paint: m(tinted("paint", tag, 0, 0.42)),
            second: m(tinted("second colour", tag, 1, 0.25)),
            glass: m(plain("glass", tag, srgb(34, 40, 44), 0.8)),
            black: m(plain("black plastic", tag, srgb(38, 38, 40), 0.12)),
            tyre: m(plain("tyre", tag, srgb(32, 32, 33), 0.03)),
            rim: m(plain("rim", tag, srgb(168, 170, 174), 0.4)),
            chrome: m(plain("chrome", tag, srgb(176, 178, 180), 0.7)),
            head: m(lamp("head lamp", tag, srgb(214, 220, 226), [2.4, 2.3, 2.0], Channel::Head)),
            tail: m(lamp("tail lamp", tag, srgb(140, 16, 20), [0.9, 0.04, 0.03], Channel::Tail)),
            brake: m(lamp("brake lamp", tag, srgb(150, 18, 22), [1.35, 0.07, 0.05], Channel::Brake)),
            blink_left: m(lamp(
                "left indicator",
                tag,
                srgb(148, 64, 22),
                [1.5, 0.62, 0.04],
                Channel::BlinkLeft,
            )),
            blink_right: m(lamp(
                "right indicator",
                tag,
                srgb(148, 64, 22),
                [1.5, 0.62, 0.04],
                Channel::BlinkRight,
            )),
            plate: m(Material {
                texture: Texture::Plate,
                ..plain("number plate", tag, srgb(232, 232, 226), 0.1)
            }),
            underside: m(plain("underside", tag, srgb(20, 20, 21), 0.0)),
        }
    }
}

impl PersonPalette {
    pub fn new(library: &mut Library, tag: SemanticTag) -> Self {
        let rides = tag == SemanticTag::Rider;
        let mut m = |material| library.material(material);
        Self {
            top: m(tinted("top", tag, u8::from(rides), 0.02)),
            legs: m(if rides {
                plain("legs", tag, srgb(44, 50, 66), 0.02)
            } else {
                tinted("legs", tag, 1, 0.02)
            }),
            skin: m(tinted("skin", tag, 2, 0.06)),
            hair: m(tinted("hair", tag, 3, 0.08)),
            shoes: m(plain("shoes", tag, srgb(52, 46, 42), 0.08)),
            bag: m(plain("bag", tag, srgb(86, 62, 44), 0.06)),
            helmet: m(tinted("helmet", tag, 3, 0.35)),
            visor: m(plain("visor", tag, srgb(24, 26, 30), 0.7)),
        }
    }
}

/// Body colours by how common they are: grey, white and black first, as on real streets.
pub(super) const CAR_COLOURS: [[u8; 3]; 20] = [
    [222, 224, 224],
    [240, 240, 238],
    [30, 31, 34],
    [44, 46, 50],
    [98, 102, 107],
    [132, 136, 140],
    [172, 176, 180],
    [60, 66, 74],
    [26, 48, 92],
    [38, 84, 150],
    [64, 118, 178],
    [160, 24, 28],
    [120, 18, 26],
    [192, 44, 34],
    [30, 74, 52],
    [92, 104, 72],
    [198, 152, 44],
    [196, 96, 30],
    [146, 124, 98],
    [84, 66, 54],
];

pub(super) const TOPS: [[u8; 3]; 16] = [
    [32, 34, 40],
    [52, 60, 82],
    [120, 28, 34],
    [200, 198, 192],
    [236, 234, 228],
    [86, 98, 74],
    [58, 92, 132],
    [166, 132, 92],
    [196, 168, 48],
    [92, 58, 92],
    [44, 78, 66],
    [134, 138, 144],
    [204, 96, 62],
    [88, 62, 46],
    [150, 176, 200],
    [214, 130, 142],
];

pub(super) const LEGS: [[u8; 3]; 8] = [
    [38, 48, 76],
    [58, 74, 108],
    [30, 30, 34],
    [84, 80, 76],
    [150, 134, 108],
    [104, 88, 70],
    [60, 62, 66],
    [92, 108, 138],
];

pub(super) const SKINS: [[u8; 3]; 6] =
    [[236, 194, 166], [222, 172, 140], [198, 146, 112], [158, 108, 78], [112, 74, 54], [84, 56, 42]];

pub(super) const HAIRS: [[u8; 3]; 7] =
    [[28, 22, 20], [58, 40, 28], [96, 66, 40], [160, 124, 72], [184, 182, 178], [122, 54, 28], [40, 34, 32]];

/// A colour of a table by a number.
pub(super) fn pick(table: &[[u8; 3]], key: u64) -> Rgb {
    let [r, g, b] = table[(key % table.len() as u64) as usize];
    srgb(r, g, b)
}
