//! Road users: their models, and where SUMO says they are, with lamps lit and legs in step.

mod body;
mod car;
mod cycle;
mod lorry;
mod object;
mod palette;
mod person;
#[cfg(test)]
mod tests;
mod wheel;

use super::model::{
    ActorFrame, Bone, Box3, Channel, Instance, Lamps, Level, Library, Mesh, Model, ModelId, Object,
    ObjectClass, RIDER_IDS, Rgb, SemanticTag, srgb,
};
use crate::shape::{Shaper, bounds_of};
use car::Body;
use nalgebra::Vector3;
use palette::{CAR_COLOURS, HAIRS, LEGS, ObjectPalette, PersonPalette, SKINS, TOPS, VehiclePalette, pick};
use person::{Build, Detail};
use std::collections::HashMap;
use std::f32::consts::TAU;
use sumo_network::geometry::Pose;
use sumo_network::world::{Actor, ActorKind, VehicleSignals, WorldState};

/// A model and the sizes (m) that it was built with.
#[derive(Clone, Copy, Debug)]
struct Figure {
    model: ModelId,
    length: f32,
    width: f32,
    height: f32,
    /// How far it rolls or walks in a whole turn of the phase (m).
    turn: f32,
}

/// The models of all road users in a scene's library.
#[derive(Clone, Debug)]
pub struct Cast {
    cars: Vec<(Body, Figure)>,
    vans: Vec<(Body, Figure)>,
    bus: Figure,
    truck: Figure,
    /// With their riders.
    motorcycle: (Figure, Figure),
    bicycle: (Figure, Figure),
    /// Walking and standing, by build: adults first.
    people: Vec<(Figure, Figure)>,
    children: Vec<(Figure, Figure)>,
    barrier: Figure,
    cone: Figure,
}

/// Bounding-sphere radius in pixels from which the fine and the middle level are drawn, and anything at all.
const NEAR_PIXELS: f32 = 42.0;
const MIDDLE_PIXELS: f32 = 13.0;
const FAR_PIXELS: f32 = 1.2;

/// Smooths corners below this angle (degrees) on bodies of vehicles, and on people.
const VEHICLE_CREASE: f32 = 38.0;
const PERSON_CREASE: f32 = 70.0;

/// Below this speed (m/s) people stand.
const STANDING: f64 = 0.15;

fn shaped(crease: f32, build: impl FnOnce(&mut Shaper)) -> Mesh {
    let mut shaper = Shaper::new(crease);
    build(&mut shaper);
    shaper.finish()
}

fn spinning(pivot: [f32; 3]) -> Bone {
    // Rolling forward turns about y (left) with the right-hand rule.
    Bone { pivot, axis: [0.0, 1.0, 0.0], spins: true, ..Bone::default() }
}

fn model(name: &str, meshes: [Mesh; 3], bones: Vec<Bone>) -> Model {
    let bounds = bounds_of([&meshes[0]]);
    let pixels = [NEAR_PIXELS, MIDDLE_PIXELS, FAR_PIXELS];
    let levels =
        meshes.into_iter().zip(pixels).map(|(mesh, min_pixels)| Level { mesh, min_pixels }).collect();
    Model { name: name.to_string(), levels, bones, bounds, casts_shadow: true, ..Model::default() }
}

impl Cast {
    /// Builds all road users' models into `library`.
    pub fn new(library: &mut Library) -> Self {
        let car = VehiclePalette::new(library, SemanticTag::Car);
        let truck_palette = VehiclePalette::new(library, SemanticTag::Truck);
        let bus_palette = VehiclePalette::new(library, SemanticTag::Bus);
        let motorcycle_palette = VehiclePalette::new(library, SemanticTag::Motorcycle);
        let bicycle_palette = VehiclePalette::new(library, SemanticTag::Bicycle);
        let people = PersonPalette::new(library, SemanticTag::Pedestrian);
        let riders = PersonPalette::new(library, SemanticTag::Rider);

        let mut cars = Vec::new();
        let mut vans = Vec::new();
        for body in Body::ALL {
            let figure = bodied(library, &format!("{body:?}"), body, &car);
            cars.push((body, figure));
            if matches!(body, Body::Minivan | Body::PanelVan) {
                vans.push((body, figure));
            }
        }
        let bus = heavy(library, "bus", &bus_palette, true);
        let truck = heavy(library, "truck", &truck_palette, false);
        let motorcycle = cycle(library, "motorcycle", &motorcycle_palette, &riders, true);
        let bicycle = cycle(library, "bicycle", &bicycle_palette, &riders, false);
        let average = Build {
            broad: 1.0,
            stout: 1.0,
            head: 1.0,
            long_hair: false,
            skirt: false,
            backpack: false,
            handbag: false,
        };
        let slim = Build { broad: 0.92, stout: 0.92, ..average };
        let adults = [
            average,
            Build { broad: 1.08, stout: 1.1, ..average },
            Build { backpack: true, ..average },
            Build { long_hair: true, ..slim },
            Build { long_hair: true, skirt: true, handbag: true, ..slim },
            Build { broad: 1.05, stout: 1.22, ..average },
        ];
        let child = Build { broad: 0.94, stout: 1.0, head: 1.25, ..average };
        let small = [child, Build { long_hair: true, ..child }, Build { backpack: true, ..child }];
        let mut walkers = |builds: &[Build]| builds.iter().map(|b| walker(library, &people, b)).collect();
        let (adults, children) = (walkers(&adults), walkers(&small));
        let objects = ObjectPalette::new(library, SemanticTag::Static);
        let (barrier, cone) = (thing(library, &objects, true), thing(library, &objects, false));
        Self { barrier, cone, cars, vans, bus, truck, motorcycle, bicycle, people: adults, children }
    }

    fn vehicle_figure(&self, actor: &Actor) -> Figure {
        let t = &actor.actor_type;
        let of = |set: &[(Body, Figure)], wanted: Body| {
            set.iter().find(|(body, _)| *body == wanted).or(set.first()).map(|(_, f)| *f)
        };
        match t.kind {
            ActorKind::Car => of(&self.cars, Body::of(&t.id, t.length, t.height, actor.key)),
            ActorKind::Van => of(&self.vans, if t.height > 2.15 { Body::PanelVan } else { Body::Minivan }),
            ActorKind::Truck => Some(self.truck),
            ActorKind::Bus => Some(self.bus),
            ActorKind::Motorcycle => Some(self.motorcycle.0),
            ActorKind::Bicycle => Some(self.bicycle.0),
            ActorKind::Object if t.id.contains("cone") => Some(self.cone),
            ActorKind::Object => Some(self.barrier),
            ActorKind::Pedestrian => None,
        }
        .unwrap_or(self.bus)
    }

    /// The rider's figure for `actor`; None for what is not a cycle.
    fn rider(&self, actor: &Actor) -> Option<Figure> {
        match actor.actor_type.kind {
            ActorKind::Motorcycle => Some(self.motorcycle.1),
            ActorKind::Bicycle => Some(self.bicycle.1),
            _ => None,
        }
    }

    /// A parked car at `pose` (centre), chosen by `key`, with its sizes (m): length, width, height.
    pub fn parked(&self, pose: Pose, key: u64) -> (Instance, [f64; 3]) {
        let common = [0, 1, 0, 2, 3, 1, 0, 4, 3, 5];
        let (_, figure) = self.cars[common[(key >> 16) as usize % common.len()] % self.cars.len()];
        let stretch = 0.96 + 0.08 * ((key >> 24 & 255) as f32 / 255.0);
        let mut instance = Instance::new(figure.model, pose);
        instance.scale = [stretch, 1.0, 1.0];
        instance.tints = vehicle_tints(key);
        let size = [figure.length * stretch, figure.width, figure.height].map(f64::from);
        (instance, size)
    }
}

fn bodied(library: &mut Library, name: &str, body: Body, palette: &VehiclePalette) -> Figure {
    let lines = body.lines();
    let near = shaped(VEHICLE_CREASE, |s| {
        lines.body(s, palette, true);
        lines.fittings(s, palette);
        lines.wheels(s, palette, 18, true);
    });
    let middle = shaped(VEHICLE_CREASE, |s| {
        lines.body(s, palette, false);
        lines.wheels(s, palette, 7, false);
    });
    let far = shaped(VEHICLE_CREASE, |s| lines.far(s, palette));
    let mut bones = vec![Bone::default()];
    bones.extend(lines.axles().map(spinning));
    let mut made = model(name, [near, middle, far], bones);
    let (f, w) = (0.5 * lines.length, 0.5 * lines.width);
    made.bounds = [[-f, -w, 0.0], [f, w, lines.height]];
    // Shadow: the body and the cabin.
    let belt = lines.shoulder;
    made.shadow_boxes = vec![
        [[-f, -w, lines.floor], [f, w, belt]],
        [[lines.roof_rear - 0.2, -0.8 * w, belt], [lines.roof_front + 0.3, 0.8 * w, lines.height]],
    ];
    let (front, rear) = (lines.nose - 0.02, lines.tail - 0.12);
    for side in [1.0, -1.0_f32] {
        let blink = if side > 0.0 { Channel::BlinkLeft } else { Channel::BlinkRight };
        made.glows.extend([
            ([f, side * 0.75 * w, front], Channel::Head),
            ([-f, side * 0.75 * w, rear], Channel::Tail),
            ([-f, side * 0.75 * w, rear], Channel::Brake),
            ([-f, side * 0.85 * w, rear - 0.15], blink),
            ([f, side * 0.85 * w, front - 0.15], blink),
        ]);
    }
    Figure {
        model: library.model(made),
        length: lines.length,
        width: lines.width,
        height: lines.height,
        turn: TAU * lines.wheel,
    }
}

fn heavy(library: &mut Library, name: &str, palette: &VehiclePalette, is_bus: bool) -> Figure {
    let build = |s: &mut Shaper, fine: bool| {
        if is_bus { lorry::bus(s, palette, fine) } else { lorry::truck(s, palette, fine) }
    };
    let near = shaped(VEHICLE_CREASE, |s| build(s, true));
    let middle = shaped(VEHICLE_CREASE, |s| build(s, false));
    let far = shaped(VEHICLE_CREASE, |s| lorry::far(s, palette, is_bus));
    let ([length, width, height], axles) =
        if is_bus { (lorry::BUS, lorry::BUS_AXLES) } else { (lorry::TRUCK, lorry::TRUCK_AXLES) };
    let mut bones = vec![Bone::default()];
    bones.extend(axles.map(|x| spinning([x, 0.0, lorry::WHEEL])));
    let mut made = model(name, [near, middle, far], bones);
    let (f, w) = (0.5 * length, 0.5 * width);
    made.bounds = [[-f, -w, 0.0], [f, w, height]];
    made.shadow_boxes = vec![[[-f, -w, 0.3], [f, w, height]]];
    for side in [1.0, -1.0_f32] {
        made.glows.extend([
            ([f, side * 0.7 * w, 0.78], Channel::Head),
            ([-f, side * 0.8 * w, 0.9], Channel::Tail),
            ([-f, side * 0.8 * w, 0.95], Channel::Brake),
        ]);
    }
    Figure { model: library.model(made), length, width, height, turn: TAU * lorry::WHEEL }
}

/// A barrier or a cone.
fn thing(library: &mut Library, palette: &ObjectPalette, barrier: bool) -> Figure {
    let mesh = |fine: usize, coarse: usize| {
        shaped(VEHICLE_CREASE, |s| {
            if barrier { object::barrier(s, palette, fine) } else { object::cone(s, palette, coarse) }
        })
    };
    let (name, [length, width, height]) =
        if barrier { ("barrier", object::BARRIER) } else { ("cone", object::CONE) };
    let mut made = model(name, [mesh(8, 12), mesh(4, 6), mesh(2, 4)], vec![Bone::default()]);
    let (f, w) = (0.5 * length, 0.5 * width);
    made.bounds = [[-f, -w, 0.0], [f, w, height]];
    made.shadow_boxes = vec![[[-0.08, -w, 0.2], [0.08, w, height]]];
    Figure { model: library.model(made), length, width, height, turn: 1.0 }
}

/// A cycle and its rider, as separate objects, because detectors separate them.
fn cycle(
    library: &mut Library,
    name: &str,
    v: &VehiclePalette,
    p: &PersonPalette,
    motor: bool,
) -> (Figure, Figure) {
    let build = |detail: Detail| {
        shaped(PERSON_CREASE, |s| {
            if motor { cycle::motorcycle(s, v, detail) } else { cycle::bicycle(s, v, detail) }
        })
    };
    let meshes = [build(Detail::Near), build(Detail::Middle), build(Detail::Far)];
    let (radius, axle, [length, width, height]) = if motor {
        (cycle::MOTORCYCLE_WHEEL, cycle::MOTORCYCLE_AXLE, cycle::MOTORCYCLE)
    } else {
        (cycle::BICYCLE_WHEEL, cycle::BICYCLE_AXLE, cycle::BICYCLE)
    };
    let bones = vec![Bone::default(), spinning([axle, 0.0, radius]), spinning([-axle, 0.0, radius])];
    let mut made = model(name, meshes, bones);
    made.shadow_boxes = vec![[[-0.5 * length, -0.08, 0.0], [0.5 * length, 0.08, 0.75]]];
    let f = 0.5 * length;
    if motor {
        made.glows = vec![
            ([f, 0.0, 0.95], Channel::Head),
            ([-f, 0.0, 0.76], Channel::Brake),
            ([-f, 0.0, 0.7], Channel::Tail),
        ];
    }
    let turn = TAU * radius;
    let cycle = Figure { model: library.model(made), length, width, height, turn };
    let build = |detail: Detail| {
        shaped(PERSON_CREASE, |s| {
            if motor { cycle::motorcyclist(s, p, detail) } else { cycle::bicyclist(s, v, p, detail) }
        })
    };
    let meshes = [build(Detail::Near), build(Detail::Middle), build(Detail::Far)];
    let bones = if motor { Vec::new() } else { cycle::cyclist_bones() };
    let mut made = model(&format!("{name} rider"), meshes, bones);
    made.shadow_boxes =
        vec![[[-0.4, -0.25, 0.6], [0.35, 0.25, 1.3]], [[-0.05, -0.1, 1.3], [0.2, 0.1, height]]];
    if !motor {
        // Feet go round.
        made.bounds[0][2] -= 0.25;
        made.bounds[1][0] += 0.2;
    }
    let rider = Figure { model: library.model(made), turn: cycle::GEAR * turn, ..cycle };
    (cycle, rider)
}

fn walker(library: &mut Library, palette: &PersonPalette, build: &Build) -> (Figure, Figure) {
    let mut figure = |walking: bool| {
        let mesh = |detail| shaped(PERSON_CREASE, |s| person::pedestrian(s, palette, build, walking, detail));
        let meshes = [mesh(Detail::Near), mesh(Detail::Middle), mesh(Detail::Far)];
        let bones = if walking { person::walking_bones() } else { Vec::new() };
        let name = if walking { "walker" } else { "bystander" };
        let mut made = model(name, meshes, bones);
        made.shadow_boxes = vec![
            [[-0.09, -0.14, 0.0], [0.09, 0.14, 0.8]],
            [[-0.12, -0.24, 0.8], [0.12, 0.24, 1.48]],
            [[-0.1, -0.09, 1.48], [0.1, 0.09, person::HEIGHT]],
        ];
        // Legs and arms swing out of the rest pose.
        made.bounds = [[-0.48, -0.30, 0.0], [0.48, 0.30, person::HEIGHT]];
        Figure {
            model: library.model(made),
            length: 0.5,
            width: 0.5,
            height: person::HEIGHT,
            turn: person::STRIDE,
        }
    };
    (figure(true), figure(false))
}

fn hash(key: u64) -> u64 {
    sumo_network::seeds::derive(key, "actor")
}

fn vehicle_tints(key: u64) -> [Rgb; 4] {
    let h = hash(key);
    // Squared: the front of the table, greys and whites, is more common.
    let u = (h % 1000) as f64 / 1000.0;
    let index = (u * u.sqrt() * CAR_COLOURS.len() as f64) as u64;
    let second = srgb(226, 226, 222);
    [pick(&CAR_COLOURS, index), second, pick(&SKINS, h >> 20), pick(&HAIRS, h >> 30)]
}

fn person_tints(key: u64) -> [Rgb; 4] {
    let h = hash(key);
    [pick(&TOPS, h), pick(&LEGS, h >> 12), pick(&SKINS, h >> 24), pick(&HAIRS, h >> 36)]
}

fn bus_tints(key: u64) -> [Rgb; 4] {
    const LIVERIES: [([u8; 3], [u8; 3]); 4] = [
        ([206, 166, 36], [92, 92, 96]),
        ([186, 32, 34], [226, 224, 218]),
        ([232, 232, 228], [34, 88, 150]),
        ([44, 112, 74], [226, 224, 214]),
    ];
    let ([r, g, b], [r2, g2, b2]) = LIVERIES[(hash(key) % 4) as usize];
    [srgb(r, g, b), srgb(r2, g2, b2), [0.5; 3], [0.1; 3]]
}

/// Follows road users from tick to tick: how far each has gone, which moves wheels and legs.
#[derive(Clone, Debug, Default)]
pub struct Animation {
    gone: HashMap<u64, (Pose, f64, u64)>,
    generation: u64,
}

/// A jump further than this (m) in a tick does not count as motion.
const JUMP: f64 = 15.0;

impl Animation {
    /// Distance (m) that `actor` has gone since it was first seen.
    fn distance(&mut self, actor: &Actor) -> f64 {
        let generation = self.generation;
        let (pose, gone, seen) = self
            .gone
            .entry(actor.key)
            // People who start together do not step together.
            .or_insert((actor.pose, (hash(actor.key) % 97) as f64 * 0.03, generation));
        let moved = (actor.pose.xy() - pose.xy()).norm();
        if moved < JUMP {
            *gone += moved;
        }
        *pose = actor.pose;
        *seen = generation;
        *gone
    }

    /// Fills `frame` with the road users of `world`, in its order: vehicles (a rider comes before its
    /// cycle), then pedestrians.
    pub fn pose(&mut self, cast: &Cast, world: &WorldState, frame: &mut ActorFrame) {
        self.generation += 1;
        frame.time = world.time;
        frame.instances.clear();
        frame.traffic_lights.clone_from(&world.traffic_lights);
        for (id, actor) in (1..).zip(world.vehicles.iter().chain(&world.pedestrians)) {
            let gone = self.distance(actor);
            if let Some(figure) = cast.rider(actor) {
                frame.instances.push(rider(cast, figure, actor, gone, RIDER_IDS + id));
            }
            let instance = if actor.actor_type.kind == ActorKind::Pedestrian {
                pedestrian(cast, actor, gone, id)
            } else {
                vehicle(cast, actor, gone, id)
            };
            frame.instances.push(instance);
        }
        // Forget road users that have left.
        if self.gone.len() > 2 * frame.instances.len() + 64 {
            let generation = self.generation;
            self.gone.retain(|_, (_, _, seen)| *seen == generation);
        }
    }
}

fn phase(gone: f64, turn: f64) -> f32 {
    ((gone / turn).fract() * std::f64::consts::TAU) as f32
}

fn vehicle(cast: &Cast, actor: &Actor, gone: f64, id: u32) -> Instance {
    let t = &actor.actor_type;
    let figure = cast.vehicle_figure(actor);
    let mut instance = Instance::new(figure.model, actor.pose);
    let sizes = [t.length as f32, t.width as f32, t.height as f32];
    instance.scale = [sizes[0] / figure.length, sizes[1] / figure.width, sizes[2] / figure.height];
    instance.phase = phase(gone, f64::from(figure.turn * instance.scale[2]));
    instance.tints = match t.kind {
        ActorKind::Bus => bus_tints(actor.key),
        ActorKind::Motorcycle | ActorKind::Bicycle => {
            let person = person_tints(actor.key);
            [vehicle_tints(actor.key)[0], person[0], person[2], person[3]]
        }
        _ if t.id.contains("fire") => [srgb(186, 26, 22), srgb(186, 26, 22), [0.5; 3], [0.1; 3]],
        _ => vehicle_tints(actor.key),
    };
    let signals = actor.signals;
    let mut lamps = Lamps::default();
    for (bit, channel) in [
        (VehicleSignals::BRAKE_LIGHT, Channel::Brake),
        (VehicleSignals::BLINKER_LEFT, Channel::BlinkLeft),
        (VehicleSignals::BLINKER_RIGHT, Channel::BlinkRight),
    ] {
        if signals.has(bit) {
            lamps = lamps.with(channel);
        }
    }
    instance.lamps = lamps;
    let class = match t.kind {
        ActorKind::Bus => ObjectClass::Bus,
        ActorKind::Truck => ObjectClass::Truck,
        ActorKind::Motorcycle => ObjectClass::Motorcycle,
        ActorKind::Bicycle => ObjectClass::Bicycle,
        _ => ObjectClass::Car,
    };
    let mut bounds = Box3 { pose: actor.pose, size: [t.length, t.width, t.height] };
    // Its own height, without the rider.
    match t.kind {
        ActorKind::Motorcycle => bounds.size[2] *= f64::from(cycle::MOTORCYCLE_TOP / figure.height),
        ActorKind::Bicycle => bounds.size[2] *= f64::from(cycle::BICYCLE_TOP / figure.height),
        _ => {}
    }
    // Nothing that a detector knows the name of.
    instance.object = (t.kind != ActorKind::Object).then_some(Object { class, id, bounds });
    instance
}

/// The rider of `actor`: a person, as in COCO.
fn rider(cast: &Cast, figure: Figure, actor: &Actor, gone: f64, id: u32) -> Instance {
    let mut instance = vehicle(cast, actor, gone, id);
    instance.model = figure.model;
    instance.phase = phase(gone, f64::from(figure.turn * instance.scale[2]));
    let t = &actor.actor_type;
    let size = [0.5 * t.length, t.width, t.height];
    instance.object =
        Some(Object { class: ObjectClass::Person, id, bounds: Box3 { pose: actor.pose, size } });
    instance
}

fn pedestrian(cast: &Cast, actor: &Actor, gone: f64, id: u32) -> Instance {
    let t = &actor.actor_type;
    let set = if t.height < 1.45 { &cast.children } else { &cast.people };
    let h = hash(actor.key);
    let (walking, standing) = set[(h >> 48) as usize % set.len()];
    let moving = actor.speed > STANDING;
    let figure = if moving { walking } else { standing };
    // People of one type are not all of one height.
    let tall = 0.95 + 0.08 * ((h >> 40 & 255) as f32 / 255.0);
    let scale = t.height as f32 / figure.height * tall;
    let mut instance = Instance::new(figure.model, actor.pose);
    instance.scale = [scale; 3];
    if moving {
        instance.phase = phase(gone, f64::from(figure.turn * scale));
        let drop = person::hip_drop(instance.phase) * scale;
        instance.pose.position -= Vector3::new(0.0, 0.0, f64::from(drop));
    }
    instance.tints = person_tints(actor.key);
    let size = [t.length.max(0.5), t.width.max(0.5), f64::from(figure.height * scale)];
    instance.object =
        Some(Object { class: ObjectClass::Person, id, bounds: Box3 { pose: actor.pose, size } });
    instance
}
