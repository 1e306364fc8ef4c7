//! A road, an ego on it, and pictures of it, for the unit tests.

use super::EgoFacts;
#[cfg(feature = "vision")]
use super::{GroundPlane, LaneBoundary};
#[cfg(feature = "vision")]
use crate::camera::{CameraConfig, Frame};
use crate::criteria::EgoOnRoute;
use crate::geometry::Vector;
use crate::network::testing::{net, place};
use crate::network::{Network, Route, VehicleClass};
use crate::vehicle::EgoState;
use std::sync::Arc;

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
        let network = net();
        let (from, to) = (place(&network, "ab_0", 20.0), place(&network, "bc_0", 200.0));
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
            velocity: crate::geometry::direction(pose.heading) * speed,
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

/// A picture of a grey road with white lines, a line 0.12 m broad.
#[cfg(feature = "vision")]
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
