//! The renderer on small scenes of its own.

mod agreement;
mod golden;
mod history;
mod odd;
mod places;
pub mod towns;

use super::model::*;
use super::*;
use nalgebra::Point3;
use sumo_network::geometry::Pose;

/// An upright box as a model, `half` its footprint (m).
fn block(library: &mut Library, material: Material, size: [f32; 3]) -> ModelId {
    let material = library.material(material);
    let mut mesh = Mesh::default();
    let (x, y, z) = (0.5 * size[0], 0.5 * size[1], size[2]);
    let mut quad = |corners: [[f32; 3]; 4], normal: [f32; 3]| {
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend(corners.map(|position| Vertex { position, normal, ..Default::default() }));
        for corners in [[0, 1, 2], [0, 2, 3]] {
            mesh.triangles.push(Triangle { corners: corners.map(|i| first + i), material });
        }
    };
    quad([[x, -y, 0.0], [x, y, 0.0], [x, y, z], [x, -y, z]], [1.0, 0.0, 0.0]);
    quad([[-x, y, 0.0], [-x, -y, 0.0], [-x, -y, z], [-x, y, z]], [-1.0, 0.0, 0.0]);
    quad([[x, y, 0.0], [-x, y, 0.0], [-x, y, z], [x, y, z]], [0.0, 1.0, 0.0]);
    quad([[-x, -y, 0.0], [x, -y, 0.0], [x, -y, z], [-x, -y, z]], [0.0, -1.0, 0.0]);
    quad([[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]], [0.0, 0.0, 1.0]);
    library.model(Model {
        name: "block".to_string(),
        levels: vec![Level { mesh, min_pixels: 0.0 }],
        bounds: [[-x, -y, 0.0], [x, y, z]],
        casts_shadow: true,
        ..Default::default()
    })
}

/// A road along x, 8 m wide, with a white line 0.12 m wide in its middle, on a lawn.
fn road() -> Scene {
    let mut scene = Scene::default();
    let asphalt = scene.library.material(Material {
        albedo: [0.07; 3],
        texture: Texture::Asphalt { wear: 0.5, tracks: false },
        tag: SemanticTag::Road,
        wetness: 1.0,
        ..Default::default()
    });
    let grass = scene.library.material(Material {
        albedo: [0.07, 0.12, 0.03],
        texture: Texture::Grass,
        tag: SemanticTag::Terrain,
        ..Default::default()
    });
    scene.ground = Some((grass, -0.05));
    for i in -4..8 {
        let mut mesh = Mesh::default();
        for (x, y) in [(0.0, -4.0), (32.0, -4.0), (32.0, 4.0), (0.0, 4.0)] {
            let position = [x, y, 0.0];
            mesh.vertices.push(Vertex { position, normal: [0.0, 0.0, 1.0], ..Default::default() });
        }
        for corners in [[0, 1, 2], [0, 2, 3]] {
            mesh.triangles.push(Triangle { corners, material: asphalt });
        }
        let corners = [[0.0, -0.06, 0.0], [32.0, -0.06, 0.0], [32.0, 0.06, 0.0], [0.0, 0.06, 0.0]];
        let paint = Paint { corners, strength: 1.0, front_end: false, rear_end: false };
        scene.chunks.push(Chunk {
            origin: Point3::new(f64::from(i) * 32.0, 0.0, 0.0),
            bounds: [[0.0, -4.0, 0.0], [32.0, 4.0, 3.0]],
            levels: vec![(f32::INFINITY, mesh)],
            paint: vec![paint],
            ..Default::default()
        });
    }
    scene.index();
    scene
}

fn car(scene: &mut Scene) -> ModelId {
    let material =
        Material { albedo: [0.6, 0.1, 0.1], tag: SemanticTag::Car, gloss: 0.4, ..Default::default() };
    let model = block(&mut scene.library, material, [4.5, 1.8, 1.5]);
    scene.index();
    model
}

fn at(model: ModelId, id: u32, x: f64, y: f64) -> Instance {
    let pose = Pose::new(x, y, 0.0, 0.0);
    let bounds = Box3 { pose, size: [4.5, 1.8, 1.5] };
    Instance { object: Some(Object { class: ObjectClass::Car, id, bounds }), ..Instance::new(model, pose) }
}

fn camera(size: usize) -> Camera {
    Camera::new(CameraConfig::sized(size, size)).unwrap()
}

const EGO: fn() -> Pose = || Pose::new(0.0, -1.8, 0.0, 0.0);

#[test]
fn depth_tags_and_ids_are_those_of_what_stands_there() {
    let mut scene = road();
    let model = car(&mut scene);
    scene.index();
    let actors = ActorFrame { instances: vec![at(model, 7, 22.95, -1.8)], ..Default::default() };
    let mut camera = camera(512);
    let frame = camera.render(&scene, &actors, &EGO(), &Weather::default(), Outputs::ALL);
    // The car's rear is 20 m before the camera, 0.1 m above the horizon's height at its top.
    let pixel = 258 * 512 + 256;
    assert!((frame.depth[pixel] - 20.0).abs() < 0.01, "{}", frame.depth[pixel]);
    assert_eq!((frame.semantic[pixel], frame.instance[pixel]), (SemanticTag::Car as u8, 7));
    // The road 10 m ahead is 1.4 / 10 x 256 pixels below the horizon.
    let road = (256 + 35) * 512 + 246;
    assert!((frame.depth[road] - 256.0 * 1.4 / 35.5).abs() < 0.02, "{}", frame.depth[road]);
    assert_eq!(frame.semantic[road], SemanticTag::Road as u8);
    assert_eq!(frame.semantic[300 * 512 + 2], SemanticTag::Terrain as u8);
    assert_eq!(frame.semantic[3], SemanticTag::Sky as u8);
    assert_eq!(frame.depth[3], f32::INFINITY);
}

#[test]
fn materials_beyond_65536_are_not_taken_for_the_first_ones() {
    let mut scene = road();
    scene.library.materials.resize(1 << 16, Material::default());
    let model = car(&mut scene);
    let actors = ActorFrame { instances: vec![at(model, 7, 22.95, -1.8)], ..Default::default() };
    let mut camera = camera(512);
    let frame = camera.render(&scene, &actors, &EGO(), &Weather::default(), Outputs::ALL);
    assert_eq!(frame.semantic[258 * 512 + 256], SemanticTag::Car as u8);
}

#[test]
fn boxes_hold_all_pixels_of_their_instance_and_no_more() {
    let mut scene = road();
    let model = car(&mut scene);
    let cars = vec![at(model, 1, 14.0, 1.8), at(model, 2, 25.0, 1.0), at(model, 3, 40.0, -1.8)];
    let actors = ActorFrame { instances: cars, ..Default::default() };
    let mut camera = camera(512);
    let frame = camera.render(&scene, &actors, &EGO(), &Weather::default(), Outputs::ALL);
    assert_eq!(frame.objects.iter().map(|o| o.id).collect::<Vec<_>>(), [1, 2, 3]);
    for object in &frame.objects {
        let pixels: Vec<(u32, u32)> = (0..512 * 512)
            .filter(|&i| frame.instance[i as usize] == object.id)
            .map(|i| (i % 512, i / 512))
            .collect();
        let least = |f: fn(&(u32, u32)) -> u32| pixels.iter().map(f).min().unwrap();
        let most = |f: fn(&(u32, u32)) -> u32| pixels.iter().map(f).max().unwrap() + 1;
        let found = [least(|p| p.0), least(|p| p.1), most(|p| p.0), most(|p| p.1)];
        assert_eq!((object.visible_pixels as usize, object.visible_box), (pixels.len(), found));
        for i in 0..4 {
            let slack = (object.full_box[i] - object.visible_box[i] as f32) * if i < 2 { -1.0 } else { 1.0 };
            assert!(slack > -1.0, "object {}: {:?} {:?}", object.id, object.full_box, object.visible_box);
            // The second car is partly behind the first.
            assert!(slack < 1.0 || object.id == 2, "{:?} {:?}", object.full_box, object.visible_box);
        }
    }
}

#[test]
fn the_chase_view_leaves_out_what_hides_the_ego() {
    let mut scene = road();
    let model = car(&mut scene);
    scene.index();
    let ego = Some(Instance::new(model, EGO()));
    let mut camera = Camera::new(CameraConfig::chase(320, 180)).unwrap();
    let mut ids = |behind: f64, higher: f32, ego: &Option<Instance>| {
        let follows = Instance { scale: [1.0, 1.0, higher], ..at(model, 7, -behind, -1.8) };
        let actors = ActorFrame {
            instances: vec![follows, at(model, 8, 12.0, 1.8)],
            ego: ego.clone(),
            ..Default::default()
        };
        let frame = camera.render(&scene, &actors, &EGO(), &Weather::default(), Outputs::ALL);
        frame.objects.iter().map(|o| o.id).collect::<Vec<_>>()
    };
    assert_eq!(ids(6.5, 2.0, &ego), [8], "a lorry 2 m behind the ego is in the way");
    assert_eq!(ids(6.5, 2.0, &None), [7, 8], "without an ego in the picture nothing is");
    assert_eq!(ids(6.5, 1.0, &ego), [7, 8], "the view goes over a car");
}

#[test]
fn a_painted_line_falls_where_the_map_says() {
    let scene = road();
    let mut camera = camera(512);
    let actors = ActorFrame::default();
    let frame = camera.render(&scene, &actors, &EGO(), &Weather::default(), Outputs::ALL);
    let view = View::new(&CameraConfig::default(), &EGO());
    for ahead in [5.0, 8.0, 15.0, 30.0, 60.0] {
        let ([x, y], _) = view.pixel(&Point3::new(0.7 + ahead, 0.0, 0.0)).unwrap();
        let row = y as usize;
        // The middle of what is brighter than the asphalt in that row.
        let light = |x: usize| u32::from(frame.rgb[3 * (row * 512 + x)]);
        let near = x as usize;
        let brightest = (near - 12..near + 12).map(light).max().unwrap();
        let asphalt = light(near - 12);
        assert!(brightest > asphalt + 15, "{ahead} m ahead the line is too faint");
        let half = (brightest + asphalt) / 2;
        let line: Vec<usize> = (near - 12..near + 12).filter(|&x| light(x) > half).collect();
        let off = line.iter().map(|&at| at as f32 + 0.5).sum::<f32>() / line.len() as f32 - x;
        assert!(off.abs() <= 1.0, "{ahead} m ahead the line is {off} pixels off");
    }
}

#[test]
fn equal_shots_give_equal_bits_whatever_was_rendered_before() {
    let mut scene = road();
    let model = car(&mut scene);
    scene.index();
    let actors = ActorFrame { instances: vec![at(model, 7, 18.0, 1.0)], time: 3.5, ..Default::default() };
    for preset in [Preset::ClearNoon, Preset::HardRainNoon, Preset::WetSunset] {
        let weather = Weather::from(preset);
        let mut first = camera(200);
        first.render(&scene, &actors, &EGO(), &weather, Outputs::ALL);
        let mut second = camera(200);
        second.render(
            &scene,
            &ActorFrame::default(),
            &EGO().advanced(40.0),
            &Weather::default(),
            Outputs::RGB,
        );
        second.render(&scene, &actors, &EGO(), &weather, Outputs::ALL);
        assert_eq!(first.frame().rgb, second.frame().rgb, "{preset}");
        assert_eq!(first.frame().depth, second.frame().depth);
        assert_eq!(first.frame().objects, second.frame().objects);
    }
}

#[test]
fn shared_edges_are_neither_missed_nor_drawn_over() {
    // A fan of slivers fills the picture: every pixel shows it and not the sky behind.
    let mut scene = Scene::default();
    let material = scene.library.material(Material { albedo: [1.0, 0.0, 1.0], ..Default::default() });
    let mut mesh = Mesh::default();
    mesh.vertices.push(Vertex { position: [10.0, 0.3, 1.2], normal: [-1.0, 0.0, 0.0], ..Default::default() });
    let count = 97;
    for i in 0..count {
        let angle = i as f32 / count as f32 * std::f32::consts::TAU;
        let position = [10.0, 40.0 * angle.cos(), 1.4 + 40.0 * angle.sin()];
        mesh.vertices.push(Vertex { position, normal: [-1.0, 0.0, 0.0], ..Default::default() });
    }
    for i in 0..count {
        mesh.triangles.push(Triangle { corners: [0, 1 + (i + 1) % count, 1 + i], material });
    }
    scene.chunks.push(Chunk {
        bounds: [[9.9, -40.0, -40.0], [10.1, 40.0, 40.0]],
        levels: vec![(f32::INFINITY, mesh)],
        ..Default::default()
    });
    scene.index();
    let mut camera = camera(256);
    let frame = camera.render(&scene, &ActorFrame::default(), &EGO(), &Weather::default(), Outputs::ALL);
    assert!(frame.depth.iter().all(|z| (z - 9.3).abs() < 0.01));
}

#[test]
fn an_empty_scene_is_sky() {
    let scene = Scene::default();
    let mut camera = camera(33);
    let frame = camera.render(&scene, &ActorFrame::default(), &EGO(), &Weather::default(), Outputs::ALL);
    assert_eq!(frame.rgb.len(), 33 * 33 * 3);
    assert!(frame.semantic.iter().all(|&tag| tag == SemanticTag::Sky as u8) && frame.objects.is_empty());
}
