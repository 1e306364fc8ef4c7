//! Chooses what a frame draws: culled, nearest first, each object in the level of detail that its size
//! in the picture needs.

use super::model::{ActorFrame, Channel, Chunk, Instance, Lamps, Level, Library, Mesh, Model, Scene};
use super::raster::{CamVertex, Draw, Tri, Visibility, draw};
use super::simd::multiversion;
use super::stages::Watch;
use super::view::{NEAR, View};
use super::weather::Weather;
use nalgebra::Point3;
use std::borrow::Cow;
use sumo_network::network::SignalIndex;
use sumo_network::world::SignalState;

/// Something that was drawn: a chunk's mesh or an instance's.
pub struct Item<'a> {
    pub mesh: &'a Mesh,
    /// Where its vertices begin in [`Geometry::vertices`].
    pub first: u32,
    pub instance: Option<&'a Instance>,
    /// Cosine and sine of its heading.
    pub turn: [f32; 2],
    pub lamps: Lamps,
    /// Share of the sun's light that reaches it (instances; 1 for chunks).
    pub sun: f32,
}

/// The frame's geometry.
#[derive(Default)]
pub struct Geometry<'a> {
    pub items: Vec<Item<'a>>,
    pub tris: Vec<Tri>,
    /// Instances in sight, for shadows and glows.
    pub seen: Vec<Seen<'a>>,
    /// Chunks in sight, nearest first: number, distance (m).
    pub chunks: Vec<(u32, f32)>,
}

/// An instance in sight.
pub struct Seen<'a> {
    pub instance: &'a Instance,
    /// A road user, not a part of the town.
    pub moving: bool,
    pub lamps: Lamps,
}

/// Things farther than this (m) are not drawn.
pub const VIEW_DISTANCE: f32 = 280.0;

/// What hides this height of the ego's middle (m) hides it.
const EGO_MIDDLE: f64 = 0.7;

/// Gathers and draws.
pub struct Gather<'a, 'b> {
    pub view: &'b View,
    pub scene: &'a Scene,
    pub actors: &'a ActorFrame,
    pub weather: &'b Weather,
    pub visibility: &'b mut Visibility,
    pub vertices: &'b mut Vec<CamVertex>,
    /// Of each material: whether it is seen from both sides.
    pub sheets: &'b [bool],
    pub watch: &'b mut Watch,
    /// Share of sun (0..1) at a world point.
    pub sun_at: &'b dyn Fn(&Point3<f64>) -> f32,
    /// The ego is drawn too.
    pub shows_ego: bool,
}

impl<'a> Gather<'a, '_> {
    /// Draws the frame.
    pub fn run(mut self) -> Geometry<'a> {
        let mut out = Geometry::default();
        self.vertices.clear();
        self.find_chunks(&mut out);
        let mut actors: Vec<(f32, &'a Instance)> = Vec::new();
        let ego = self.actors.ego.as_ref().filter(|_| self.shows_ego);
        // Who drives close behind would fill the chase view.
        let others = self.actors.instances.iter();
        let others = others.filter(|instance| !ego.is_some_and(|ego| self.stands_before(instance, ego)));
        for instance in others.chain(ego) {
            if let Some(distance) = self.distance(instance) {
                actors.push((distance, instance));
            }
        }
        actors.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut actors = actors.into_iter().peekable();
        let chunks = std::mem::take(&mut out.chunks);
        // After these distances (m) the picture so far is used to cull hidden chunks.
        let mut looks = [16.0, 45.0, 110.0].into_iter().peekable();
        for &(number, distance) in &chunks {
            while let Some((_, actor)) = actors.next_if(|actor| actor.0 < distance) {
                self.instance(actor, true, &mut out);
            }
            if looks.next_if(|look| distance > *look).is_some() {
                self.visibility.update_tiles();
            }
            self.chunk(&self.scene.chunks[number as usize], distance, &mut out);
        }
        for (_, actor) in actors {
            self.instance(actor, true, &mut out);
        }
        out.chunks = chunks;
        self.watch.lap(|s| &mut s.geometry);
        out
    }

    fn find_chunks(&self, out: &mut Geometry<'a>) {
        let mut numbers = Vec::new();
        let eye = self.view.eye;
        self.scene.grid.near(eye.x, eye.y, f64::from(VIEW_DISTANCE), &mut numbers);
        for number in numbers {
            let chunk = &self.scene.chunks[number as usize];
            let (centre, radius) = ball(&chunk.bounds);
            let middle = chunk.origin + nalgebra::Vector3::from(centre.map(f64::from));
            if !self.view.sees_ball(self.view.point(&middle), radius) {
                continue;
            }
            let r = eye - chunk.origin;
            let local = [r.x as f32, r.y as f32, r.z as f32];
            let gap = |i: usize| (chunk.bounds[0][i] - local[i]).max(local[i] - chunk.bounds[1][i]).max(0.0);
            let distance = (gap(0).powi(2) + gap(1).powi(2) + gap(2).powi(2)).sqrt();
            if distance < VIEW_DISTANCE {
                // By the middle, so that what hides comes before what it hides.
                let order = distance.max(((middle - eye).norm() as f32 - radius).max(0.0));
                out.chunks.push((number, order));
            }
        }
        out.chunks.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    }

    fn chunk(&mut self, chunk: &'a Chunk, distance: f32, out: &mut Geometry<'a>) {
        let corner = self.view.point(&chunk.origin);
        let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|a| self.view.direction(a));
        if self.is_hidden(corner, axes, &chunk.bounds) {
            return;
        }
        // The levels' distances are for a focal length of 256 pixels: small pictures show less.
        let apparent = distance * (256.0 / self.view.focal).max(1.0);
        if let Some((_, mesh)) = chunk.levels.iter().find(|(to, _)| apparent <= *to) {
            self.mesh(mesh, &[Place { axes, origin: corner }], None, [1.0, 0.0], 1.0, out);
        }
        for instance in &chunk.instances {
            self.instance(instance, false, out);
        }
    }

    /// Depth of the nearest point of an instance's ball, None where out of the picture.
    fn distance(&self, instance: &Instance) -> Option<f32> {
        let model = &self.scene.library.models[instance.model.0 as usize];
        let (centre, radius) = placed_ball(self.view, model, instance, turn(instance));
        (self.view.sees_ball(centre, radius) && centre[2] - radius < VIEW_DISTANCE)
            .then_some(centre[2] - radius)
    }

    /// Whether the line from the camera to the middle of the ego, [`EGO_MIDDLE`] above the ground, goes through an
    /// instance's box.
    fn stands_before(&self, instance: &Instance, ego: &Instance) -> bool {
        let bounds = &self.scene.library.models[instance.model.0 as usize].bounds;
        let pose = &instance.pose;
        let local = |p: Point3<f64>| {
            let flat = pose.to_local(p.xy());
            [flat.x, flat.y, p.z - pose.position.z].map(|x| x as f32)
        };
        let middle = ego.pose.position + nalgebra::Vector3::new(0.0, 0.0, EGO_MIDDLE);
        let (from, to) = (local(self.view.eye), local(middle));
        // The part of the line, 0 at the camera and 1 at the ego, that is within the box along each axis.
        let (mut enters, mut leaves) = (0.0_f32, 1.0_f32);
        for axis in 0..3 {
            let way = to[axis] - from[axis];
            let cut = |side: usize| (bounds[side][axis] * instance.scale[axis] - from[axis]) / way;
            let (near, far) = if way >= 0.0 { (cut(0), cut(1)) } else { (cut(1), cut(0)) };
            (enters, leaves) = (enters.max(near), leaves.min(far));
        }
        enters < leaves
    }

    fn instance(&mut self, instance: &'a Instance, moving: bool, out: &mut Geometry<'a>) {
        let view = self.view;
        let model: &'a Model = &self.scene.library.models[instance.model.0 as usize];
        let turn = turn(instance);
        let Some(level) = level(view, model, instance, turn, VIEW_DISTANCE) else { return };
        let lamps = self.lamps(Some(instance));
        out.seen.push(Seen { instance, moving, lamps });
        let Some(level) = level else { return };
        let place = Place::of(view, instance, turn);
        if self.is_hidden(place.origin, place.axes, &model.bounds) {
            return;
        }
        // What casts a shadow into the map itself is not darkened by it.
        let sun = if moving { (self.sun_at)(&instance.pose.position) } else { 1.0 };
        let places = bone_places(model, &place, instance.phase);
        self.mesh(&level.mesh, &places, Some(instance), turn, sun, out);
    }

    /// Whether a box is behind what was drawn before.
    fn is_hidden(&self, origin: [f32; 3], axes: [[f32; 3]; 3], bounds: &[[f32; 3]; 2]) -> bool {
        let (mut low, mut high, mut nearest) = ([f32::MAX; 2], [f32::MIN; 2], f32::MAX);
        for corner in 0..8 {
            let at = |i: usize| bounds[corner >> i & 1][i];
            let p: [f32; 3] = std::array::from_fn(|k| {
                origin[k] + axes[0][k] * at(0) + axes[1][k] * at(1) + axes[2][k] * at(2)
            });
            if p[2] < NEAR {
                return false;
            }
            let s = self.view.project(p);
            for i in 0..2 {
                low[i] = low[i].min(s[i]);
                high[i] = high[i].max(s[i]);
            }
            nearest = nearest.min(p[2]);
        }
        self.visibility.hides(low, high, 1.0 / nearest)
    }

    fn mesh(
        &mut self,
        mesh: &'a Mesh,
        places: &[Place],
        instance: Option<&'a Instance>,
        turn: [f32; 2],
        sun: f32,
        out: &mut Geometry<'a>,
    ) {
        let first = self.vertices.len();
        let nearest = transform(mesh, places, self.view, self.vertices);
        let job = Draw {
            faces: &mesh.faces.list,
            vertices: &self.vertices[first..],
            sheets: self.sheets,
            item: out.items.len() as u32,
            focal: self.view.focal,
            centre: self.view.centre,
            whole: nearest >= NEAR,
        };
        let before = out.tris.len();
        self.watch.lap(|s| &mut s.geometry);
        draw(&job, self.visibility, &mut out.tris);
        self.watch.lap(|s| &mut s.raster);
        if out.tris.len() == before {
            self.vertices.truncate(first);
            return;
        }
        let lamps = self.lamps(instance);
        out.items.push(Item { mesh, first: first as u32, instance, turn, lamps, sun });
    }

    fn lamps(&self, instance: Option<&Instance>) -> Lamps {
        let mut lamps = instance.map_or(Lamps::default(), |i| i.lamps);
        if self.weather.lamps {
            lamps = lamps.with(Channel::StreetLamp);
            if instance.is_some_and(|i| i.signal.is_none()) {
                lamps = lamps.with(Channel::Tail).with(Channel::Head);
            }
        }
        // Blinkers blink three times in two seconds.
        if (self.actors.time * 1.5).fract() >= 0.5 {
            lamps = Lamps(lamps.0 & !(1 << Channel::BlinkLeft as u32 | 1 << Channel::BlinkRight as u32));
        }
        match instance.and_then(|i| i.signal).and_then(|s| signal_state(self.actors, s)) {
            None | Some(SignalState::Off) => lamps,
            Some(SignalState::Red | SignalState::StopThenGo) => lamps.with(Channel::SignalRed),
            Some(SignalState::RedYellow) => lamps.with(Channel::SignalRed).with(Channel::SignalYellow),
            Some(SignalState::Yellow) => lamps.with(Channel::SignalYellow),
            Some(SignalState::GreenMinor | SignalState::GreenMajor) => lamps.with(Channel::SignalGreen),
        }
    }
}

fn signal_state(actors: &ActorFrame, signal: SignalIndex) -> Option<SignalState> {
    let state = actors.traffic_lights.get(signal.traffic_light.index())?.as_ref()?;
    state.as_bytes().get(signal.index).map(|&c| SignalState::from_sumo(c))
}

/// Centre and radius of a box's ball.
fn ball(bounds: &[[f32; 3]; 2]) -> ([f32; 3], f32) {
    let centre: [f32; 3] = std::array::from_fn(|i| 0.5 * (bounds[0][i] + bounds[1][i]));
    let half = (0..3).map(|i| (0.5 * (bounds[1][i] - bounds[0][i])).powi(2)).sum::<f32>().sqrt();
    (centre, half)
}

/// Cosine and sine of an instance's heading.
fn turn(instance: &Instance) -> [f32; 2] {
    let (sin, cos) = instance.pose.heading.sin_cos();
    [cos as f32, sin as f32]
}

/// The ball round an instance, in the camera's frame.
fn placed_ball(view: &View, model: &Model, instance: &Instance, [cos, sin]: [f32; 2]) -> ([f32; 3], f32) {
    let (centre, radius) = ball(&model.bounds);
    let [x, y, z]: [f32; 3] = std::array::from_fn(|i| centre[i] * instance.scale[i]);
    let offset = view.direction([cos * x - sin * y, sin * x + cos * y, z]);
    let origin = view.point(&instance.pose.position);
    let scale = instance.scale.iter().fold(0.0_f32, |a, b| a.max(*b));
    (std::array::from_fn(|i| origin[i] + offset[i]), radius * scale)
}

/// The level of detail of an instance: the outer option is None where it is out of the picture or farther than
/// `reach` (m), the inner one where it is too small to be drawn.
fn level<'a>(
    view: &View,
    model: &'a Model,
    instance: &Instance,
    turn: [f32; 2],
    reach: f32,
) -> Option<Option<&'a Level>> {
    let (centre, radius) = placed_ball(view, model, instance, turn);
    if !view.sees_ball(centre, radius) || centre[2] - radius > reach {
        return None;
    }
    let pixels = view.focal * radius / centre[2].max(NEAR + radius * 0.5);
    Some(model.levels.iter().find(|level| pixels >= level.min_pixels))
}

/// Appends the vertices of an instance as it is drawn, in the camera's frame; false where it is not drawn or is
/// farther than `reach` (m).
pub fn placed(
    view: &View,
    library: &Library,
    instance: &Instance,
    reach: f32,
    out: &mut Vec<CamVertex>,
) -> bool {
    let model = &library.models[instance.model.0 as usize];
    let turn = turn(instance);
    let Some(level) = level(view, model, instance, turn, reach).flatten() else { return false };
    transform(&level.mesh, &bone_places(model, &Place::of(view, instance, turn), instance.phase), view, out);
    true
}

/// Model frame to camera frame: images of the axes and of the origin.
#[derive(Clone, Copy, Debug, Default)]
pub struct Place {
    pub axes: [[f32; 3]; 3],
    pub origin: [f32; 3],
}

impl Place {
    fn of(view: &View, instance: &Instance, [cos, sin]: [f32; 2]) -> Self {
        let [sx, sy, sz] = instance.scale;
        let axes = [
            view.direction([cos * sx, sin * sx, 0.0]),
            view.direction([-sin * sy, cos * sy, 0.0]),
            view.direction([0.0, 0.0, sz]),
        ];
        Self { axes, origin: view.point(&instance.pose.position) }
    }
    #[inline(always)]
    fn direction(&self, v: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|k| self.axes[0][k] * v[0] + self.axes[1][k] * v[1] + self.axes[2][k] * v[2])
    }
    #[inline(always)]
    fn point(&self, p: [f32; 3]) -> [f32; 3] {
        let d = self.direction(p);
        std::array::from_fn(|k| self.origin[k] + d[k])
    }
}

/// A place for each bone at a phase; that of the whole where there are none.
fn bone_places<'a>(model: &Model, root: &'a Place, phase: f32) -> Cow<'a, [Place]> {
    // Nearly all of a town's things: nothing is allocated for them.
    if model.bones.is_empty() {
        return Cow::Borrowed(std::slice::from_ref(root));
    }
    let mut places: Vec<Place> = Vec::with_capacity(model.bones.len());
    for (index, bone) in model.bones.iter().enumerate() {
        let parent =
            bone.parent.filter(|&p| usize::from(p) < index).map_or(*root, |p| places[usize::from(p)]);
        let angle = if bone.spins { phase } else { bone.amplitude * (phase + bone.offset).sin() };
        if angle == 0.0 {
            places.push(parent);
            continue;
        }
        let (sin, cos) = angle.sin_cos();
        let [x, y, z] = bone.axis;
        let t = 1.0 - cos;
        let columns = [
            [cos + x * x * t, y * x * t + z * sin, z * x * t - y * sin],
            [x * y * t - z * sin, cos + y * y * t, z * y * t + x * sin],
            [x * z * t + y * sin, y * z * t - x * sin, cos + z * z * t],
        ];
        let local = Place { axes: columns, origin: [0.0; 3] };
        let turned = local.direction(bone.pivot);
        let shift: [f32; 3] = std::array::from_fn(|i| bone.pivot[i] - turned[i]);
        places.push(Place { axes: columns.map(|c| parent.direction(c)), origin: parent.point(shift) });
    }
    Cow::Owned(places)
}

multiversion! {
    /// Appends a mesh's vertices in the camera's frame; the smallest depth (m).
    fn transform(mesh: &Mesh, places: &[Place], view: &View, out: &mut Vec<CamVertex>) -> f32 {
        let mut nearest = f32::MAX;
        let last = places.len() - 1;
        let first = out.len();
        out.resize(first + mesh.faces.corners.len(), CamVertex::default());
        // No iterator's closures: they would not be compiled for the faster instructions.
        for (&(position, bone), out) in mesh.faces.corners.iter().zip(&mut out[first..]) {
            let place = &places[(bone as usize).min(last)];
            let [x, y, z] = position;
            let mut p = place.origin;
            for (k, p) in p.iter_mut().enumerate() {
                *p += place.axes[0][k] * x + place.axes[1][k] * y + place.axes[2][k] * z;
            }
            nearest = if p[2] < nearest { p[2] } else { nearest };
            *out = CamVertex { p, s: view.project(p) };
        }
        nearest
    }
}
