//! The renderer on one core of the processor.
//!
//! ```text
//! gather: cull, transform, draw into the visibility buffer (nearest triangle per pixel)
//! marks:  paint and road users' shadows, into buffers of their own
//! rows:   one after the other, while they are in the fastest cache: runs of one triangle are shaded;
//!         haze and display curve; wet ground mirrors; outlines smoothed; rain; bytes
//! glows of lamps and drops on the glass at last
//! ```

use super::effects;
use super::frame::{Frame, ObjectTruth, Outputs};
use super::gather::{Gather, Geometry};
use super::ground_marks::Marks;
use super::model::{Scene, SemanticTag};
use super::outlines;
use super::raster::{CamVertex, Visibility, settle};
use super::row::{Row, Run};
use super::shade::{self, Wall};
use super::shade_ground::{Ground, ground};
use super::shadow_map::{self, ShadowMap};
use super::simd::{multiversion, pack, tone};
use super::sky::{Look, Sky};
use super::stages::{Stages, Watch};
use super::surface::{FacadeNumbers, GroundNumbers, Kind, Lighting, Surface, facade_numbers, ground_numbers};
use super::view::View;
use super::{Renderer, Shot};

/// The buffers of a camera, kept from frame to frame.
#[derive(Default)]
pub struct CpuRenderer {
    visibility: Visibility,
    vertices: Vec<CamVertex>,
    sheets: Vec<bool>,
    borders: [effects::Places; 2],
    /// Where the runs of a row end.
    ends: effects::Places,
    marks: Marks,
    shadows: ShadowMap,
    /// The scene that the shadows are of.
    stamp: u64,
    sky: Option<Sky>,
    look: Look,
    /// The looks of what is seen, and by triangle their index + 1; 0: not worked out yet.
    surfaces: Vec<Surface>,
    looks: Vec<u32>,
    /// By look: the number of the thing and the material.
    groups: Vec<[u32; 2]>,
    facades: Vec<FacadeNumbers>,
    grounds: Vec<GroundNumbers>,
    row: Row,
    /// Packed colours of rows as in the visibility buffer: of all of them where wet ground mirrors them,
    /// else of this and the last one in turn.
    pixels: Vec<u32>,
    line: Vec<u32>,
    foot: Vec<i32>,
    seen: Vec<Extent>,
    watch: Watch,
}

/// What is the same for all ground of a frame: as [`Ground`] has it.
struct Still {
    eye: [f32; 2],
    height: f32,
}

/// Pixels of a row with one look.
#[derive(Clone, Copy)]
struct Stretch {
    look: usize,
    x0: usize,
    x1: usize,
}

/// The pixels of an item.
#[derive(Clone, Copy, Debug)]
struct Extent {
    pixels: u32,
    low: [u32; 2],
    high: [u32; 2],
}

const NOTHING: Extent = Extent { pixels: 0, low: [u32::MAX; 2], high: [0; 2] };

impl Renderer for CpuRenderer {
    fn render(&mut self, shot: &Shot<'_>, frame: &mut Frame) {
        let &Shot { scene, actors, view, weather, outputs, .. } = shot;
        self.watch.start();
        (frame.width, frame.height) = (view.width, view.height);
        if !outputs.draws() {
            frame.empty();
            if outputs.outlines {
                outlines::find(shot, &mut self.vertices, &mut frame.objects);
            }
            self.watch.lap(|s| &mut s.geometry);
            return;
        }
        if self.stamp != scene.grid.stamp() {
            self.stamp = scene.grid.stamp();
            self.shadows.forget();
            let materials = &scene.library.materials;
            self.sheets = materials.iter().map(|material| material.double_sided).collect();
            self.facades = materials.iter().map(facade_numbers).collect();
            self.grounds = materials.iter().map(ground_numbers).collect();
        }
        let sunny = weather.shadows > 0.02;
        if sunny && outputs.rgb {
            self.shadows.prepare(scene, view, weather.sun);
        }
        if outputs.rgb && !self.sky.as_ref().is_some_and(|sky| sky.is_of(weather)) {
            self.sky = Some(Sky::new(weather));
        }
        self.visibility.clear(view.width, view.height);
        let shadows = &self.shadows;
        let sun_at = |p: &nalgebra::Point3<f64>| if sunny { shadows.sun_at(p, 0.9) } else { 1.0 };
        let geometry = Gather {
            view,
            scene,
            actors,
            weather,
            visibility: &mut self.visibility,
            vertices: &mut self.vertices,
            sheets: &self.sheets,
            sun_at: &sun_at,
            watch: &mut self.watch,
            shows_ego: shot.shows_ego,
        }
        .run();
        let ground = self.ground_plane(scene, view, geometry.tris.len());
        self.watch.lap(|s| &mut s.raster);
        if outputs.rgb || outputs.semantic {
            self.mark(&geometry, shot, sunny);
        }
        self.rows(&geometry, shot, ground, frame);
        if outputs.rgb {
            add_lights(&geometry, shot, &self.visibility, &mut frame.rgb);
        }
        self.objects(&geometry, view, outputs, frame);
        if outputs.outlines && !outputs.boxes {
            outlines::find(shot, &mut self.vertices, &mut frame.objects);
        }
        self.watch.lap(|s| &mut s.effects);
    }

    fn time_stages(&mut self, on: bool) {
        self.watch.switch(on);
    }

    fn stages(&self) -> Stages {
        self.watch.spent
    }
}

impl CpuRenderer {
    /// Draws the ground under everything; its material.
    fn ground_plane(&mut self, scene: &Scene, view: &View, tris: usize) -> Option<u32> {
        let plane = scene.ground.map(|(material, z)| (material, (view.eye.z - z) as f32));
        let Some((material, below)) = plane.filter(|(_, below)| *below >= 0.1) else {
            settle(&mut self.visibility, 0, [0.0; 3], f32::MAX);
            return None;
        };
        // 1 / depth of the plane: its normal over its distance.
        let n = view.direction([0.0, 0.0, 1.0]);
        let (dx, dy) = (-n[0] / (below * view.focal), n[1] / (below * view.focal));
        let iz = [dx, dy, -n[2] / below - dx * view.centre[0] - dy * view.centre[1]];
        settle(&mut self.visibility, tris as u32 + 1, iz, 1.0 / 1500.0);
        Some(material.0)
    }

    fn mark(&mut self, geometry: &Geometry<'_>, shot: &Shot<'_>, sunny: bool) {
        self.marks.clear(&self.visibility);
        for &(number, distance) in &geometry.chunks {
            if distance < 140.0 {
                self.marks.paint(&shot.scene.chunks[number as usize], shot.view, &self.visibility);
            }
        }
        if shot.outputs.rgb {
            for seen in &geometry.seen {
                if seen.moving || seen.instance.object.is_some() && seen.instance.signal.is_none() {
                    let library = &shot.scene.library;
                    let sunny = sunny && seen.moving;
                    self.marks.shadow(
                        seen.instance,
                        library,
                        shot.weather,
                        shot.view,
                        &self.visibility,
                        sunny,
                    );
                }
            }
        }
    }

    fn rows(&mut self, geometry: &Geometry<'_>, shot: &Shot<'_>, plane: Option<u32>, frame: &mut Frame) {
        let &Shot { scene, view, weather, outputs, .. } = shot;
        let (width, height, stride) = (view.width, view.height, self.visibility.stride);
        let library = &scene.library;
        let lighting = Lighting { weather, library, view };
        self.surfaces.clear();
        self.groups.clear();
        self.looks.clear();
        self.looks.resize(geometry.tris.len() + 1, 0);
        if let Some(material) = plane {
            self.surfaces.push(lighting.ground(material));
            self.groups.push([u32::MAX; 2]);
            self.looks[geometry.tris.len()] = 1;
        }
        self.seen.clear();
        self.seen.resize(geometry.items.len(), NOTHING);
        self.row.resize(width);
        let wet = weather.wetness > 0.0;
        self.pixels.resize(if wet { height.max(2) } else { 2 } * stride, 0);
        self.line.resize(stride, 0);
        let mirrored = wet && view.ahead[2].abs() < 0.3;
        let horizon = (view.centre[1] + view.focal * view.ahead[2] / view.up[2].max(0.1)) as i32;
        self.foot.clear();
        self.foot.resize(width, horizon);
        let rain = (weather.rain > 0.0).then(|| {
            let [r, g, b] = weather.horizon.map(|c| tone(c * 0.9));
            effects::Rain::new(weather.rain, shot.actors.time, pack(r, g, b))
        });
        let plane_height = scene.ground.map_or(0.0, |g| g.1);
        let still = Still {
            eye: [ShadowMap::wrap(view.eye.x), ShadowMap::wrap(view.eye.y)],
            height: ((view.eye.z - plane_height) as f32).max(0.3),
        };
        let size = |wanted: bool| if wanted { width * height } else { 0 };
        frame.rgb.resize(3 * size(outputs.rgb), 0);
        frame.depth.resize(size(outputs.depth), 0.0);
        frame.semantic.resize(size(outputs.semantic), 0);
        frame.instance.resize(size(outputs.instance), 0);
        if let (Some(sky), true) = (&self.sky, outputs.rgb) {
            sky.look(view, &mut self.look);
        }
        let mut row = std::mem::take(&mut self.row);
        let follow = outputs.boxes || outputs.instance;
        for y in 0..height {
            let ids = &self.visibility.id[y * stride..][..stride];
            let iz = &self.visibility.iz[y * stride..][..stride];
            let at = y * width;
            let line = if wet { y } else { y & 1 } * stride;
            if outputs.rgb && wet {
                row.mirror.fill(0);
            }
            if outputs.depth {
                depths(&iz[..width], &mut frame.depth[at..at + width]);
            }
            if outputs.semantic {
                frame.semantic[at..at + width].fill(SemanticTag::Sky as u8);
            }
            if outputs.instance {
                frame.instance[at..at + width].fill(0);
            }
            // The first and the end of the pixels that show something.
            let (mut x, mut any, mut last) = (0, width, 0);
            let mut waiting = None;
            let mut ends = std::mem::take(&mut self.ends);
            effects::find_runs(ids, width, &mut ends);
            for &end in ends.found() {
                let x0 = x;
                let id = ids[x0];
                x = end as usize;
                let Some(index) = (id as usize).checked_sub(1) else {
                    self.shade(waiting.take(), iz, &mut row, shot, &still, y);
                    if let (true, Some(sky)) = (outputs.rgb, &self.sky) {
                        sky.row(view, &self.look, y, (x0, x), &mut self.pixels[line..line + stride]);
                    }
                    continue;
                };
                any = any.min(x0);
                last = x;
                if outputs.rgb {
                    if self.looks[index] == 0 {
                        self.surfaces.push(lighting.surface(geometry, &self.vertices, index));
                        self.groups.push(group(geometry, index));
                        self.looks[index] = self.surfaces.len() as u32;
                    }
                    let look = self.looks[index] as usize - 1;
                    let stretch = Stretch { look, x0, x1: x };
                    waiting = match waiting {
                        Some(before) if self.go_on(before, stretch, iz, y) => {
                            Some(Stretch { x1: x, ..before })
                        }
                        before => {
                            self.shade(before, iz, &mut row, shot, &still, y);
                            Some(stretch)
                        }
                    };
                }
                let tri = geometry.tris.get(index);
                if outputs.semantic {
                    let material = tri.map_or(plane.unwrap_or(0), |tri| {
                        let item = &geometry.items[tri.item as usize];
                        item.mesh.faces.list[tri.face as usize].material
                    });
                    let tag = library.materials[material as usize].tag;
                    let tags = &mut frame.semantic[at + x0..at + x];
                    tags.fill(tag as u8);
                    if matches!(tag, SemanticTag::Road | SemanticTag::SideWalk) {
                        for (tag, paint) in tags.iter_mut().zip(&self.marks.paint[y * stride + x0..]) {
                            if *paint >= 128 {
                                *tag = SemanticTag::RoadLine as u8;
                            }
                        }
                    }
                }
                if follow
                    && let Some(tri) = tri
                    && let Some(object) = geometry.items[tri.item as usize].instance.and_then(|i| i.object)
                {
                    let extent = &mut self.seen[tri.item as usize];
                    extent.pixels += (x - x0) as u32;
                    extent.low = [extent.low[0].min(x0 as u32), extent.low[1].min(y as u32)];
                    extent.high = [extent.high[0].max(x as u32), extent.high[1].max(y as u32 + 1)];
                    if outputs.instance {
                        frame.instance[at + x0..at + x].fill(object.id);
                    }
                }
            }
            self.ends = ends;
            self.shade(waiting, iz, &mut row, shot, &still, y);
            if outputs.rgb {
                if any < last {
                    let pixels = &mut self.pixels[line..line + stride];
                    shade::finish(&row, iz, &self.look.haze, weather.fog, (any, last), pixels);
                }
                self.watch.lap(|s| &mut s.shade);
                if mirrored && y as i32 >= horizon {
                    effects::mirror(&mut self.pixels, &row.mirror, y, stride, &mut self.foot);
                }
                if let Some(above) = y.checked_sub(1) {
                    self.develop(above, wet, rain.as_ref(), &mut frame.rgb);
                }
                self.watch.lap(|s| &mut s.effects);
            }
        }
        self.watch.lap(|s| &mut s.shade);
        if outputs.rgb {
            self.develop(height - 1, wet, rain.as_ref(), &mut frame.rgb);
        }
        self.row = row;
    }

    /// Smooths a row's outlines, when the row below it has its colours too, and puts it into the picture.
    fn develop(&mut self, y: usize, wet: bool, rain: Option<&effects::Rain>, rgb: &mut [u8]) {
        let Visibility { width, height, stride, .. } = self.visibility;
        let row = |y: usize| {
            let from = y * stride;
            (&self.visibility.id[from..from + stride], &self.visibility.iz[from..from + stride])
        };
        let (own, below) = (row(y), row((y + 1).min(height - 1)));
        let at = |y: usize| if wet { y } else { y & 1 } * stride;
        let (upper, lower) = if y + 1 == height {
            // Nothing is below it: neighbours of the same triangles are not smoothed.
            (&mut self.pixels[at(y)..at(y) + stride], &mut self.line[..])
        } else if at(y) < at(y + 1) {
            let (upper, lower) = self.pixels.split_at_mut(at(y + 1));
            (&mut upper[at(y)..], &mut lower[..stride])
        } else {
            let (lower, upper) = self.pixels.split_at_mut(at(y));
            (&mut upper[..stride], &mut lower[at(y + 1)..])
        };
        let outline = effects::Outline { looks: &self.looks, surfaces: &self.surfaces, groups: &self.groups };
        let seam = |pixels, (ids, iz)| effects::Seam { pixels, ids, iz };
        effects::smooth_edges(seam(upper, own), seam(lower, below), (y, width), &outline, &mut self.borders);
        let mut colours = &self.pixels[at(y)..at(y) + width];
        if let Some(rain) = rain {
            effects::fall(colours, y, rain, &mut self.line[..width]);
            colours = &self.line[..width];
        }
        effects::unpack(colours, &mut rgb[3 * y * width..][..3 * width]);
    }

    /// Whether `next` continues the ground of `before`: then both are shaded at once.
    fn go_on(&self, before: Stretch, next: Stretch, iz: &[f32], y: usize) -> bool {
        let (a, b) = (&self.surfaces[before.look], &self.surfaces[next.look]);
        if !a.kind.is_ground() || !a.is_lit_as(b) || before.x1 < before.x0 + 2 {
            return false;
        }
        // In one plane: 1 / depth is linear over both.
        let [first, last] = [before.x1 - 2, before.x1 - 1].map(|x| iz[x]);
        if (2.0 * last - first - iz[next.x0]).abs() > 1e-3 * last {
            return false;
        }
        let numbers = &self.grounds[a.material as usize];
        let textured = a.kind == Kind::Slabs || a.kind == Kind::Asphalt && numbers.tracks;
        !textured || [next.x0, next.x1 - 1].iter().all(|&x| a.maps_as(b, [x as f32, y as f32 + 0.5], iz[x]))
    }

    /// The colours of a stretch, if there is one.
    fn shade(
        &self,
        stretch: Option<Stretch>,
        iz: &[f32],
        row: &mut Row,
        shot: &Shot<'_>,
        still: &Still,
        y: usize,
    ) {
        let Some(Stretch { look, x0, x1 }) = stretch else { return };
        let run = &Run { surface: &self.surfaces[look], x0, x1, y: y as f32 + 0.5, iz };
        let (view, weather) = (shot.view, shot.weather);
        let material = run.surface.material as usize;
        match run.surface.kind {
            Kind::Unknown => {}
            Kind::Flat => shade::flat(run, row),
            Kind::Smooth => shade::smooth(run, row),
            Kind::Asphalt | Kind::Slabs | Kind::Lawn | Kind::Rough => {
                let start = y * self.visibility.stride;
                let end = start + self.visibility.stride;
                let ry = (view.centre[1] - run.y) / view.focal;
                let left = (0.5 - view.centre[0]) / view.focal;
                let base = |i: usize| view.ahead[i] + ry * view.up[i] + left * view.right[i];
                let lies = run.surface.lies;
                let site = Ground {
                    eye: still.eye,
                    base: [base(0), base(1)],
                    step: [view.right[0] / view.focal, view.right[1] / view.focal],
                    height: still.height,
                    focal: view.focal,
                    shadows: self.shadows.texels(),
                    weather,
                    paint: &self.marks.paint[start..end],
                    shade: &self.marks.shade[start..end],
                    painted: self.marks.painted[y],
                    shaded: self.marks.shaded[y],
                    shadow_reach: if lies && weather.shadows > 0.02 { shadow_map::REACH } else { 1e-3 },
                    numbers: &self.grounds[material],
                    lies,
                };
                ground(run, &site, row);
            }
            Kind::Leaves | Kind::Bricks | Kind::Plate => {
                let wall = Wall { per_focal: 1.0 / view.focal, weather, facade: &self.facades[material] };
                shade::pattern(run, &wall, row);
            }
            Kind::Facade => {
                let wall = Wall { per_focal: 1.0 / view.focal, weather, facade: &self.facades[material] };
                shade::facade(run, &wall, row);
            }
        }
    }

    fn objects(&self, geometry: &Geometry<'_>, view: &View, outputs: Outputs, frame: &mut Frame) {
        frame.objects.clear();
        if !outputs.boxes {
            return;
        }
        for (number, extent) in self.seen.iter().enumerate().filter(|(_, extent)| extent.pixels > 0) {
            let item = &geometry.items[number];
            let Some(object) = item.instance.and_then(|i| i.object) else { continue };
            let end = geometry.items.get(number + 1).map_or(self.vertices.len(), |next| next.first as usize);
            frame.objects.push(ObjectTruth {
                class: object.class,
                id: object.id,
                visible_pixels: extent.pixels,
                visible_box: [extent.low[0], extent.low[1], extent.high[0], extent.high[1]],
                full_box: outlines::full_box(view, &self.vertices[item.first as usize..end]),
                bounds: object.bounds,
                depth: outlines::depth(view, &object),
            });
        }
        frame.objects.sort_by_key(|object| object.id);
    }
}

/// Tells faces of one material of one thing from others.
fn group(geometry: &Geometry<'_>, index: usize) -> [u32; 2] {
    let tri = &geometry.tris[index];
    let face = &geometry.items[tri.item as usize].mesh.faces.list[tri.face as usize];
    [tri.item, face.material]
}

/// What lies over the whole picture: glows of lamps, drops on the glass.
fn add_lights(geometry: &Geometry<'_>, shot: &Shot<'_>, visibility: &Visibility, rgb: &mut [u8]) {
    let &Shot { scene, actors, view, weather, .. } = shot;
    if weather.lamps {
        let gain = weather.lamp_gain * 0.6;
        effects::glow(rgb, &geometry.seen, &scene.library, view, visibility, gain);
    }
    if weather.rain > 0.0 {
        effects::drops(rgb, view, weather.rain, actors.time);
    }
}

multiversion! {
    fn depths(iz: &[f32], out: &mut [f32]) {
        for (depth, iz) in out.iter_mut().zip(iz) {
            *depth = 1.0 / iz;
        }
    }
}
