use super::*;
use std::sync::Arc;
use sumo_network::world::ActorType;

fn actor(kind: ActorKind, id: &str, size: [f64; 3]) -> Actor {
    Actor {
        id: id.into(),
        key: 7,
        actor_type: Arc::new(ActorType {
            id: id.into(),
            kind,
            length: size[0],
            width: size[1],
            height: size[2],
            min_gap: 2.0,
        }),
        pose: Pose::new(0.0, 0.0, 0.0, 0.0),
        speed: 1.4,
        signals: VehicleSignals(0),
        lane: None,
        lane_position: 0.0,
    }
}

const KINDS: [(ActorKind, &str, [f64; 3]); 10] = [
    (ActorKind::Car, "car.hatchback", [4.19, 1.80, 1.47]),
    (ActorKind::Car, "car.saloon.long", [5.36, 1.90, 1.45]),
    (ActorKind::Car, "car.estate", [4.61, 1.82, 1.55]),
    (ActorKind::Car, "car.suv", [4.86, 1.94, 1.72]),
    (ActorKind::Car, "car.coupe", [4.18, 1.84, 1.36]),
    (ActorKind::Van, "van.delivery", [5.92, 1.99, 2.56]),
    (ActorKind::Truck, "truck.box", [7.2, 2.4, 3.1]),
    (ActorKind::Bus, "bus.city", [10.27, 2.5, 3.1]),
    (ActorKind::Motorcycle, "motorcycle.sport", [2.03, 0.8, 1.55]),
    (ActorKind::Bicycle, "bicycle.city", [1.84, 0.6, 1.75]),
];

fn frame_of(actors: &[Actor]) -> (Library, ActorFrame) {
    let mut library = Library::default();
    let cast = Cast::new(&mut library);
    let (people, vehicles) =
        actors.iter().cloned().partition(|a: &Actor| a.actor_type.kind == ActorKind::Pedestrian);
    let world = WorldState { vehicles, pedestrians: people, ..WorldState::default() };
    let mut frame = ActorFrame::default();
    Animation::default().pose(&cast, &world, &mut frame);
    (library, frame)
}

/// Corners of all vertices of an instance's level (m, its own frame, scaled).
fn extent(library: &Library, instance: &Instance, level: usize) -> [[f32; 3]; 2] {
    let mesh = &library.models[instance.model.0 as usize].levels[level].mesh;
    let [lo, hi] = bounds_of([mesh]);
    [0, 1].map(|i| std::array::from_fn(|axis| [lo, hi][i][axis] * instance.scale[axis]))
}

#[test]
fn bodies_fill_the_box_of_their_type_at_every_level() {
    for (kind, id, size) in KINDS {
        let (library, frame) = frame_of(&[actor(kind, id, size)]);
        for level in 0..3 {
            // A cycle and its rider fill it together.
            let parts = frame.instances.iter().map(|part| extent(&library, part, level));
            let [lo, hi] = parts
                .reduce(|[lo, hi], [l, h]| {
                    [std::array::from_fn(|i| lo[i].min(l[i])), std::array::from_fn(|i| hi[i].max(h[i]))]
                })
                .unwrap();
            // Coarser levels may stand out a little less.
            let slack = if level == 0 { [0.06, 0.05, 0.06] } else { [0.35, 0.35, 0.25] };
            for axis in 0..3 {
                let half = if axis == 2 { size[2] } else { 0.5 * size[axis] } as f32;
                let low = if axis == 2 { 0.0 } else { -half };
                assert!(
                    hi[axis] <= half + 0.035 && hi[axis] >= half - slack[axis],
                    "{id} level {level} axis {axis}: {hi:?} of {half}"
                );
                assert!(
                    lo[axis] >= low - 0.035 && lo[axis] <= low + slack[axis].max(0.03),
                    "{id} level {level} axis {axis}: {lo:?}"
                );
            }
        }
    }
}

#[test]
fn levels_of_detail_get_smaller() {
    let mut library = Library::default();
    Cast::new(&mut library);
    for model in &library.models {
        let counts: Vec<usize> = model.levels.iter().map(|l| l.mesh.triangles.len()).collect();
        println!("{:12} {counts:?}", model.name);
        if ["barrier", "cone"].contains(&model.name.as_ref()) {
            // Small and plain as they are, they have less to lose.
            assert!(counts[0] <= 400 && counts.windows(2).all(|w| w[1] < w[0]), "{} {counts:?}", model.name);
        } else {
            assert!(counts[0] >= 450 && counts[0] <= 3200, "{} {counts:?}", model.name);
            assert!(counts[1] * 2 <= counts[0] && counts[1] <= 700, "{} {counts:?}", model.name);
            assert!(counts[2] * 2 <= counts[1] && counts[2] <= 140, "{} {counts:?}", model.name);
        }
        assert!(model.levels.windows(2).all(|w| w[0].min_pixels > w[1].min_pixels));
    }
}

#[test]
fn normals_point_away_from_a_cars_middle() {
    let mut library = Library::default();
    let cast = Cast::new(&mut library);
    for (body, figure) in &cast.cars {
        let mesh = &library.models[figure.model.0 as usize].levels[1].mesh;
        let volume: f32 = mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.corners.map(|i| mesh.vertices[i as usize].position);
                crate::shape::dot(a, crate::shape::cross(b, c)) / 6.0
            })
            .sum();
        let whole = figure.length * figure.width * figure.height;
        assert!((0.4..0.9).contains(&(volume / whole)), "{body:?}: {volume} of {whole}");
    }
}

#[test]
fn lamps_follow_sumos_signals() {
    let mut car = actor(ActorKind::Car, "car", [4.5, 1.8, 1.5]);
    car.signals = VehicleSignals(VehicleSignals::BRAKE_LIGHT | VehicleSignals::BLINKER_LEFT);
    let (_, frame) = frame_of(&[car]);
    let lamps = frame.instances[0].lamps;
    assert!(lamps.has(Channel::Brake) && lamps.has(Channel::BlinkLeft) && !lamps.has(Channel::BlinkRight));
}

#[test]
fn people_step_in_time_with_the_ground_and_stop_when_they_stand() {
    let mut library = Library::default();
    let cast = Cast::new(&mut library);
    let mut walker = actor(ActorKind::Pedestrian, "p", [0.3, 0.5, 1.75]);
    let mut animation = Animation::default();
    let mut frame = ActorFrame::default();
    let mut phases = Vec::new();
    for tick in 0..2 {
        walker.pose = Pose::new(0.25 * f64::from(tick), 0.0, 0.0, 0.0);
        let world = WorldState { pedestrians: vec![walker.clone()], ..WorldState::default() };
        animation.pose(&cast, &world, &mut frame);
        phases.push(frame.instances[0].phase);
    }
    let scale = frame.instances[0].scale[2];
    let turned = (phases[1] - phases[0]).rem_euclid(TAU);
    assert!((turned - 0.25 / (person::STRIDE * scale) * TAU).abs() < 1e-3);
    let walking = frame.instances[0].model;
    walker.speed = 0.0;
    let world = WorldState { pedestrians: vec![walker], ..WorldState::default() };
    animation.pose(&cast, &world, &mut frame);
    assert_ne!(frame.instances[0].model, walking);
    assert!(library.models[frame.instances[0].model.0 as usize].bones.is_empty());
}

#[test]
fn riders_count_as_persons_beside_their_cycles() {
    let kinds = [KINDS[8], KINDS[9], KINDS[0]];
    let actors: Vec<Actor> = kinds.iter().map(|(kind, id, size)| actor(*kind, id, *size)).collect();
    let (_, frame) = frame_of(&actors);
    let objects: Vec<Object> = frame.instances.iter().filter_map(|i| i.object).collect();
    use ObjectClass as C;
    assert_eq!(
        objects.iter().map(|o| o.class).collect::<Vec<_>>(),
        [C::Person, C::Motorcycle, C::Person, C::Bicycle, C::Car]
    );
    // An id is the place in the world, whoever rides.
    assert_eq!(objects.iter().map(|o| o.id).collect::<Vec<_>>(), [RIDER_IDS + 1, 1, RIDER_IDS + 2, 2, 3]);
    assert!(objects[2].bounds.size[2] > 1.7 && objects[3].bounds.size[2] < 1.1);
}

#[test]
fn a_cyclists_feet_stay_on_the_pedals() {
    let mut library = Library::default();
    let cast = Cast::new(&mut library);
    let model = &library.models[cast.bicycle.1.model.0 as usize];
    let mesh = &model.levels[0].mesh;
    // The lowest vertex of the left shin is the shoe's sole; the pedal belongs to bone 5.
    let sole = mesh
        .vertices
        .iter()
        .filter(|v| v.bone == 3)
        .min_by(|a, b| a.position[2].total_cmp(&b.position[2]))
        .unwrap();
    let turned = |p: [f32; 3], pivot: [f32; 3], angle: f32| {
        let (s, c) = angle.sin_cos();
        let (x, z) = (p[0] - pivot[0], p[2] - pivot[2]);
        [pivot[0] + x * c + z * s, p[1], pivot[2] - x * s + z * c]
    };
    for step in 0..12 {
        let phase = step as f32 / 12.0 * TAU;
        let mut foot = sole.position;
        for bone in [&model.bones[3], &model.bones[1]] {
            foot = turned(foot, bone.pivot, bone.amplitude * (phase + bone.offset).sin());
        }
        let crank = model.bones[5].pivot;
        let pedal = turned([crank[0] + 0.17, 0.1, crank[2]], crank, phase);
        let off = (foot[0] - pedal[0]).hypot(foot[2] - pedal[2]);
        assert!(off < 0.13, "{phase}: foot {foot:?} pedal {pedal:?}");
    }
}

#[test]
fn ids_are_unique_and_colours_stay_with_the_actor() {
    let actors: Vec<Actor> =
        (0..40).map(|key| Actor { key, ..actor(ActorKind::Car, "car", [4.5, 1.8, 1.5]) }).collect();
    let (_, frame) = frame_of(&actors);
    let mut ids: Vec<u32> = frame.instances.iter().filter_map(|i| i.object.map(|o| o.id)).collect();
    ids.dedup();
    assert_eq!(ids.len(), 40);
    let (_, later) = frame_of(&actors[20..]);
    assert_eq!(frame.instances[20].tints, later.instances[0].tints);
    let mut colours: Vec<String> = frame.instances.iter().map(|i| format!("{:?}", i.tints[0])).collect();
    colours.sort();
    colours.dedup();
    assert!(colours.len() > 8);
}
