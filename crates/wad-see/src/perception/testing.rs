//! A road, an ego on it, and pictures of it, for the unit tests.

use super::LaneBoundary;
use super::{Detection, EgoFacts, GroundPlane};
use std::sync::Arc;
use sumo_network::geometry::{Pose, Vector};
use sumo_network::network::testing::{net, place};
use sumo_network::network::{Network, Route, VehicleClass};
use sumo_network::world::{Actor, ActorKind, ActorType, VehicleSignals};
use wad_camera::CameraConfig;
use wad_camera::Frame;
use wad_camera::model::ObjectClass;
use wad_sim::criteria::EgoOnRoute;
use wad_vehicle::EgoState;

/// Length of the ego (m).
pub const LENGTH: f64 = 4.4;

/// A straight road of 270 m, then a junction with a signal.
pub struct Road {
    pub network: Network,
    pub route: Route,
    pub signals: Vec<Option<Arc<str>>>,
}

impl Road {
    /// With the light's state string: the first head is the ego's.
    pub fn new(state: &str) -> Self {
        Self::between("ab_0", "bc_0", state)
    }

    /// Left at the junction, on green, where others have right of way.
    pub fn turning_left() -> Self {
        Self::between("ab_1", "bl_0", "GGG")
    }

    fn between(from: &str, to: &str, state: &str) -> Self {
        Self::of(net(), from, to, state)
    }

    /// From lane to lane of a net.
    pub fn of(network: Network, from: &str, to: &str, state: &str) -> Self {
        let (from, to) = (place(&network, from, 20.0), place(&network, to, 200.0));
        let route = network.route(from, to, VehicleClass::Passenger).unwrap();
        Self { network, route, signals: vec![Some(Arc::from(state))] }
    }

    /// The ego's centre at `s` (m) on the route, `d` (m) to its left, turned left by `turn` (rad).
    pub fn facts(&self, s: f64, d: f64, turn: f64, speed: f64) -> EgoFacts<'_> {
        let mut pose = self.route.at(s).pose;
        let xy = pose.to_world(Vector::new(0.0, d));
        (pose.position.x, pose.position.y) = (xy.x, xy.y);
        pose.heading += turn;
        let state = EgoState {
            pose,
            roll: 0.0,
            pitch: 0.0,
            velocity: sumo_network::geometry::direction(pose.heading) * speed,
            speed,
            lateral_speed: 0.0,
            yaw_rate: 0.0,
            acceleration: 0.0,
            steer_angle: 0.0,
        };
        EgoFacts {
            network: &self.network,
            route: &self.route,
            on_route: EgoOnRoute { state, s, d, front_s: s + 0.5 * LENGTH },
            length: LENGTH,
            signals: &self.signals,
            tick: 0.167,
        }
    }
}

/// The box of something `near` m ahead of the ego's centre, `y` m to the left, on level ground.
pub fn seen(class: ObjectClass, near: f32, y: f32, breadth: f32, height: f32) -> Detection {
    let ground = GroundPlane::new(&CameraConfig::default());
    let [l, b] = ground.pixel([near, y + 0.5 * breadth]).unwrap();
    let [r, _] = ground.pixel([near, y - 0.5 * breadth]).unwrap();
    let t = b - 256.0 * height / (near - 0.7);
    Detection { class, bounds: [l, t, r, b], score: 1.0 }
}

/// A picture of a grey road with white lines, a line 0.12 m broad.
pub fn picture(camera: &CameraConfig, lines: &[LaneBoundary]) -> Frame {
    let ground = GroundPlane::new(camera);
    let mut rgb = Vec::with_capacity(3 * camera.width * camera.height);
    for y in 0..camera.height {
        for x in 0..camera.width {
            let grain = (x * 7919 + y * 104_729) % 13;
            let value = match ground.point([x as f32 + 0.5, y as f32 + 0.5]) {
                None => 170,
                Some([ahead, left]) => {
                    let on = lines.iter().any(|line| {
                        (line.reach[0]..line.reach[1]).contains(&ahead) && (left - line.y(ahead)).abs() < 0.06
                    });
                    if on { 205 } else { 84 }
                }
            };
            rgb.extend([value + grain as u8; 3]);
        }
    }
    Frame { width: camera.width, height: camera.height, rgb, ..Frame::default() }
}

/// A road user that brakes.
pub fn user(pose: Pose, speed: f64, kind: ActorKind) -> Actor {
    let [length, width] = if kind == ActorKind::Pedestrian { [0.3, 0.5] } else { [5.0, 1.8] };
    let actor_type = ActorType { id: "x".to_string(), kind, length, width, height: 1.5, min_gap: 2.5 };
    Actor {
        id: Arc::from(format!("{} {}", pose.position.x, pose.position.y)),
        key: 1,
        actor_type: Arc::new(actor_type),
        pose,
        speed,
        signals: VehicleSignals(VehicleSignals::BRAKE_LIGHT),
        lane: None,
        lane_position: 0.0,
    }
}
