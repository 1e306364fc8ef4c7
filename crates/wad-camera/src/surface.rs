//! The look of a visible triangle, computed once per frame: its lit colour and how its texture lies in
//! the picture.

use super::gather::{Geometry, Item};
use super::model::{Channel, GroundFloor, Library, Material, Rgb, Texture, Tint, Vertex, Wall};
use super::raster::CamVertex;
use super::sky::mirrored;
use super::view::{NEAR, View, cross, dot, sub};
use super::weather::Weather;

/// Which shading a surface gets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kind {
    #[default]
    Unknown,
    /// Colour linear over the surface.
    Smooth,
    /// One colour.
    Flat,
    /// Horizontal, textured by the world's x and y: shadows, paint and puddles lie on it.
    Asphalt,
    Slabs,
    Lawn,
    Rough,
    /// Textured by its own s and t.
    Leaves,
    Bricks,
    Facade,
    Plate,
}

impl Kind {
    pub fn is_ground(self) -> bool {
        matches!(self, Self::Asphalt | Self::Slabs | Self::Lawn | Self::Rough)
    }
}

/// A visible triangle's looks.
#[derive(Clone, Copy, Debug, Default)]
pub struct Surface {
    pub kind: Kind,
    pub material: u32,
    /// Smooth: red, green, blue. Textured: s, t. Value = depth (v[0] x + v[1] y + v[2]) + v[3].
    pub planes: [[f32; 4]; 3],
    /// Own colour of textured surfaces; the lit colour of flat ones.
    pub albedo: Rgb,
    /// Light of sky and ground on it, and of the sun where no shadow falls.
    pub ambient: Rgb,
    pub sun: Rgb,
    /// Ground: horizontal and low, so that shadows and puddles lie on it.
    pub lies: bool,
    /// The face's corners in the picture (pixels), across and down, a triangle's last one twice; None where it is cut by the
    /// near plane.
    pub outline: Option<[[f32; 4]; 2]>,
}

impl Surface {
    /// Whether another is of the same stuff in the same light.
    pub fn is_lit_as(&self, other: &Self) -> bool {
        (self.kind, self.material, self.lies) == (other.kind, other.material, other.lies)
            && (self.ambient, self.sun) == (other.ambient, other.sun)
    }

    /// Whether the texture of another lies as this one's at a pixel (across, down) of 1 / depth `iz`.
    pub fn maps_as(&self, other: &Self, [x, y]: [f32; 2], iz: f32) -> bool {
        (0..2).all(|i| {
            let [a, b] = [&self.planes[i], &other.planes[i]]
                .map(|plane| plane[0] * (x + 0.5) + plane[1] * y + plane[2] + plane[3] * iz);
            (a - b).abs() < 0.01 * iz
        })
    }
}

/// What lights a frame.
pub struct Lighting<'a> {
    pub weather: &'a Weather,
    pub library: &'a Library,
    pub view: &'a View,
}

impl Lighting<'_> {
    /// The looks of face `index`.
    pub fn surface(&self, geometry: &Geometry<'_>, vertices: &[CamVertex], index: usize) -> Surface {
        let tri = &geometry.tris[index];
        let item = &geometry.items[tri.item as usize];
        let face = &item.mesh.faces.list[tri.face as usize];
        let material = &self.library.materials[face.material as usize];
        let [a, b, c, _] = face.corners;
        let corners = [a, b, c].map(|i| &item.mesh.vertices[i as usize]);
        let seen = face.corners.map(|i| vertices[item.first as usize + i as usize]);
        let p = [seen[0].p, seen[1].p, seen[2].p];
        let mut surface = Surface { material: face.material, ..Surface::default() };
        if seen.iter().all(|v| v.p[2] >= NEAR) {
            surface.outline = Some([0, 1].map(|axis| seen.map(|v| v.s[axis])));
        }
        let emission = item.lamps.has(material.channel) && material.channel != Channel::None;
        let albedo = tinted(material, item);
        if emission || material.texture == Texture::Plain {
            self.smooth(&mut surface, material, item, corners, p, albedo, emission);
            return surface;
        }
        surface.kind = match material.texture {
            Texture::Plain => Kind::Smooth,
            Texture::Asphalt { .. } => Kind::Asphalt,
            Texture::Paving { .. } => Kind::Slabs,
            Texture::Grass => Kind::Lawn,
            Texture::Concrete | Texture::Soil | Texture::Roof => Kind::Rough,
            Texture::Foliage => Kind::Leaves,
            Texture::Brick => Kind::Bricks,
            Texture::Facade(_) => Kind::Facade,
            Texture::Plate => Kind::Plate,
        };
        surface.albedo = albedo;
        let n = self.normal(item, corners[0], p[0]);
        surface.ambient = self.ambient(n);
        surface.lies = n[2] > 0.7 && material.texture != Texture::Roof;
        let facing = dot(n, self.weather.sun).max(0.0);
        if surface.kind == Kind::Rough && n[2] < 0.5 {
            // The world's x and y would draw streaks down it.
            surface.kind = Kind::Flat;
            surface.albedo = std::array::from_fn(|i| {
                albedo[i] * (surface.ambient[i] + self.weather.sun_light[i] * facing * item.sun)
            });
            return surface;
        }
        // Leaves let light through.
        let facing = if surface.kind == Kind::Leaves { 0.35 + 0.55 * facing } else { facing };
        surface.sun = self.weather.sun_light.map(|c| c * facing * item.sun);
        for axis in 0..2 {
            surface.planes[axis] = self.plane(p, corners.map(|c| c.uv[axis]));
        }
        surface
    }

    fn normal(&self, item: &Item<'_>, vertex: &Vertex, p: [f32; 3]) -> [f32; 3] {
        let [x, y, z] = vertex.normal;
        let [cos, sin] = item.turn;
        let n = [cos * x - sin * y, sin * x + cos * y, z];
        // A sheet's other side.
        if dot(self.view.direction(n), p) > 0.0 { n.map(|c| -c) } else { n }
    }

    fn ambient(&self, n: [f32; 3]) -> Rgb {
        let up = 0.5 + 0.5 * n[2];
        let w = self.weather;
        std::array::from_fn(|i| w.ground_light[i] + (w.sky_light[i] - w.ground_light[i]) * up)
    }

    #[allow(clippy::too_many_arguments)]
    fn smooth(
        &self,
        surface: &mut Surface,
        material: &Material,
        item: &Item<'_>,
        corners: [&Vertex; 3],
        p: [[f32; 3]; 3],
        albedo: Rgb,
        emission: bool,
    ) {
        let w = self.weather;
        let lit = |vertex: &Vertex, p: [f32; 3]| -> Rgb {
            let n = self.normal(item, vertex, p);
            let facing = dot(n, w.sun).max(0.0) * item.sun;
            let ambient = self.ambient(n);
            // The lower parts of things see less sky.
            let low =
                if item.instance.is_some() { (0.55 + vertex.position[2] * 0.6).clamp(0.4, 1.0) } else { 1.0 };
            let mut c: Rgb =
                std::array::from_fn(|i| albedo[i] * (ambient[i] * low + w.sun_light[i] * facing));
            if material.gloss > 0.0 {
                let v = &self.view;
                let scale = -1.0 / dot(p, p).sqrt().max(1e-3);
                let to_eye: [f32; 3] =
                    std::array::from_fn(|i| (v.right[i] * p[0] + v.up[i] * p[1] + v.ahead[i] * p[2]) * scale);
                let cosine = dot(n, to_eye).clamp(0.0, 1.0);
                let grazing = (1.0 - cosine).powi(5);
                let share = material.gloss * (0.07 + 0.6 * grazing);
                let r: [f32; 3] = std::array::from_fn(|i| 2.0 * cosine * n[i] - to_eye[i]);
                let sky = mirrored(w, r);
                let glint = dot(r, w.sun).max(0.0).powi(40) * material.gloss * 1.3 * item.sun;
                c = std::array::from_fn(|i| c[i] + (sky[i] - c[i]) * share + w.sun_light[i] * glint);
            }
            if emission {
                c = std::array::from_fn(|i| c[i] + material.emission[i] * w.lamp_gain);
            }
            c
        };
        let colours = [lit(corners[0], p[0]), lit(corners[1], p[1]), lit(corners[2], p[2])];
        surface.albedo = std::array::from_fn(|i| (colours[0][i] + colours[1][i] + colours[2][i]) / 3.0);
        let spread = (0..3)
            .map(|i| {
                let c = colours.map(|c| c[i]);
                c[0].max(c[1]).max(c[2]) - c[0].min(c[1]).min(c[2])
            })
            .fold(0.0, f32::max);
        if spread < 0.01 {
            surface.kind = Kind::Flat;
            return;
        }
        surface.kind = Kind::Smooth;
        for i in 0..3 {
            surface.planes[i] = self.plane(p, colours.map(|c| c[i]));
        }
    }

    /// Coefficients of a quantity that is linear over the triangle: depth (v[0] x + v[1] y + v[2]) + v[3].
    fn plane(&self, p: [[f32; 3]; 3], value: [f32; 3]) -> [f32; 4] {
        let (e1, e2) = (sub(p[1], p[0]), sub(p[2], p[0]));
        let n = cross(e1, e2);
        let size = dot(n, n);
        if size < 1e-20 {
            return [0.0, 0.0, 0.0, value[0]];
        }
        let (a, b) = (cross(e2, n), cross(n, e1));
        let (v1, v2) = ((value[1] - value[0]) / size, (value[2] - value[0]) / size);
        let g: [f32; 3] = std::array::from_fn(|i| a[i] * v1 + b[i] * v2);
        let (dx, dy) = (g[0] / self.view.focal, -g[1] / self.view.focal);
        [dx, dy, g[2] - dx * self.view.centre[0] - dy * self.view.centre[1], value[0] - dot(g, p[0])]
    }

    /// The looks of the ground plane under everything.
    pub fn ground(&self, material: u32) -> Surface {
        let m = &self.library.materials[material as usize];
        let up = [0.0, 0.0, 1.0];
        let kind = match m.texture {
            Texture::Asphalt { .. } => Kind::Asphalt,
            Texture::Grass => Kind::Lawn,
            _ => Kind::Rough,
        };
        Surface {
            kind,
            material,
            albedo: m.albedo,
            ambient: self.ambient(up),
            sun: self.weather.sun_light.map(|c| c * self.weather.sun[2]),
            lies: true,
            ..Surface::default()
        }
    }
}

fn tinted(material: &Material, item: &Item<'_>) -> Rgb {
    match (material.tint, item.instance) {
        (Tint::Instance(index), Some(instance)) => {
            let tint = instance.tints[usize::from(index.min(3))];
            std::array::from_fn(|i| material.albedo[i] * tint[i])
        }
        _ => material.albedo,
    }
}

/// A facade's numbers as the shading reads them.
#[derive(Clone, Copy, Debug, Default)]
pub struct FacadeNumbers {
    pub storey: f32,
    pub bay: f32,
    pub window: [f32; 2],
    pub sill: f32,
    /// 0: no doors.
    pub door_every: f32,
    pub shops: bool,
    pub blank: bool,
    pub bricks: bool,
    pub trim: Rgb,
    pub lit_share: f32,
    pub seed: u32,
    /// 1 / bay, 1 / storey, the windows' share of the wall.
    pub per_bay: f32,
    pub per_storey: f32,
    pub glazed: f32,
}

/// The numbers of a material's texture.
pub fn facade_numbers(material: &Material) -> FacadeNumbers {
    let Texture::Facade(f) = &material.texture else { return FacadeNumbers::default() };
    let (storey, bay) = (f.storey.max(1.0), f.bay.max(0.5));
    let (per_bay, per_storey) = (1.0 / bay, 1.0 / storey);
    let has_windows = f.window[0] > 0.0 && f.window[1] > 0.0;
    FacadeNumbers {
        storey,
        bay,
        per_bay,
        per_storey,
        glazed: if has_windows { f.window[0] * f.window[1] * per_bay * per_storey } else { 0.0 },
        window: f.window,
        sill: f.sill,
        door_every: if f.ground_floor == GroundFloor::Homes { f.door_every as f32 } else { 0.0 },
        shops: f.ground_floor == GroundFloor::Shops,
        blank: f.ground_floor == GroundFloor::Blank,
        bricks: f.wall == Wall::Brick,
        trim: f.trim,
        lit_share: f.lit_share,
        seed: f.seed,
    }
}

/// A ground material's numbers as the shading reads them.
#[derive(Clone, Copy, Debug, Default)]
pub struct GroundNumbers {
    /// Joints of slabs (m).
    pub slabs: [f32; 2],
    pub wear: f32,
    pub tracks: bool,
    pub wetness: f32,
}

/// The numbers of a material's texture.
pub fn ground_numbers(material: &Material) -> GroundNumbers {
    let (slabs, wear, tracks) = match material.texture {
        Texture::Paving { size } => (size.map(|s| s.max(0.05)), 0.2, false),
        Texture::Asphalt { wear, tracks } => ([1.0; 2], wear, tracks),
        _ => ([1.0; 2], 0.2, false),
    };
    GroundNumbers { slabs, wear, tracks, wetness: material.wetness }
}
