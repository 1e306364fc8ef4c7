//! Makes the pictures for the viewers, on its own thread: the simulation only hands over the world.

use super::hub::{Hub, Packet, Shot};
use super::protocol;
use crate::camera::{Camera, CameraConfig, CameraError, Frame, Outputs, Picture, Town, Weather};
use crate::eyes::Eyes;
use crate::geometry::Point;
use crate::latent::Decoder;
use crate::network::Network;
use crate::perception::{DrivableArea, EgoFacts, GroundPlane, Percept, stages};
use bytes::Bytes;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use serde_json::{Value, json};
use std::sync::Arc;

/// Size of the view from behind (pixels).
const CHASE: (usize, usize) = (720, 540);
/// Side of a mirror's picture (pixels).
const MIRROR: usize = 256;
/// JPEG quality: of the cameras, and of the stages, whose few colours must stay what they are.
const QUALITY: u8 = 80;
const STAGE_QUALITY: u8 = 92;

/// Eyes that have not looked for longer (s), or whose ego is farther away than it can have driven (m/s) meanwhile, begin anew.
const IDLE: f64 = 1.0;
const FASTEST: f64 = 70.0;

/// JPEGs by their names.
type Named = Vec<(&'static str, Vec<u8>)>;

/// The state needed to draw.
pub struct Artist {
    /// For the view from behind.
    town: Town,
    chase: Camera,
    /// For ticks of drivers that do not look.
    eyes: Eyes,
    /// Of their detector's faults.
    seed: u64,
    /// When (s) and where they looked last.
    looked: Option<(f64, Point)>,
    network: Arc<Network>,
    decoder: Option<Box<dyn Decoder>>,
    ground: GroundPlane,
    /// The ego's length (m).
    length: f64,
}

impl Artist {
    /// Draws `town`. A driver's own frames are shown as they are; for a blind driver `eyes`
    /// make them, with the detector's faults drawn from `seed`. A decoder adds the reconstruction.
    ///
    /// # Errors
    /// A camera cannot be made.
    pub fn new(
        town: Town,
        eyes: Eyes,
        seed: u64,
        network: Arc<Network>,
        length: f64,
        decoder: Option<Box<dyn Decoder>>,
    ) -> Result<Self, CameraError> {
        Ok(Self {
            town,
            chase: Camera::new(CameraConfig::chase(CHASE.0, CHASE.1))?,
            eyes,
            seed,
            looked: None,
            network,
            decoder,
            ground: GroundPlane::new(&CameraConfig::default()),
            length,
        })
    }

    /// Whether it can show the stages of perception, and the reconstruction.
    pub fn stages(&self) -> (bool, bool) {
        let sees = self.eyes.perception().is_some();
        (sees, sees && self.decoder.is_some())
    }

    /// Draws until the hub closes or the artist of another number has taken over.
    pub fn work(mut self, hub: &Hub, number: u64) {
        #[cfg(feature = "learn")]
        crate::torch::one_thread();
        while let Some(shot) = hub.next_shot(number) {
            if hub.viewers() > 0 {
                let packet = self.draw(hub, &shot);
                hub.packets.send_replace(Some(Arc::new(packet)));
            }
        }
    }

    fn draw(&mut self, hub: &Hub, shot: &Shot) -> Packet {
        let pose = &shot.ego.pose;
        let stages = hub.wants_stages();
        let mut more = protocol::around(&shot.world);
        let mut images = Vec::new();
        self.eyes.follow(&shot.world);
        if self.eyes.weather() != shot.weather {
            self.eyes.set_weather(shot.weather);
        }
        let percept = match &shot.look {
            Some(look) => {
                images.push(("front", jpeg(&look.frame)));
                if let Some(mirror) = &look.mirror {
                    more["mirror"] = json!(if mirror.left { "left" } else { "right" });
                    images.push(("mirror", small(&mirror.picture.scaled(MIRROR, MIRROR))));
                }
                stages.then(|| look.percept.clone())
            }
            None => {
                let looked = stages && self.look(shot);
                if !looked {
                    self.eyes.glance(pose);
                }
                images.extend(self.eyes.frame().map(|frame| ("front", jpeg(frame))));
                self.eyes.percept().filter(|_| looked).cloned()
            }
        };
        if let Some(percept) = percept {
            let (sees, pictures) = self.stages_of(&percept);
            more["sees"] = sees;
            images.extend(pictures);
        }
        self.town.follow(&shot.world, Some(&shot.ego));
        if hub.wants_chase() {
            let (scene, actors) = (self.town.scene(), self.town.actors());
            let weather = Weather::from(shot.weather);
            images.push(("chase", jpeg(self.chase.render(scene, actors, pose, &weather, Outputs::RGB))));
        }
        let bytes = Bytes::from(protocol::packet(&shot.state, more, &images));
        Packet { route_id: shot.state.route_id, bytes }
    }

    /// Looks in the driver's place; false where nothing can be made of the picture.
    fn look(&mut self, shot: &Shot) -> bool {
        let (Some((route, on_route)), true) = (&shot.way, self.eyes.perception().is_some()) else {
            return false;
        };
        let here = (shot.state.time, on_route.state.pose.xy());
        let tick = self.looked.and_then(|last| passed(last, here)).unwrap_or_else(|| {
            self.eyes.reset(shot.weather, self.seed);
            self.eyes.follow(&shot.world);
            shot.state.dt
        });
        self.looked = Some(here);
        let facts = EgoFacts {
            network: &self.network,
            route,
            on_route: *on_route,
            length: self.length,
            signals: &shot.world.traffic_lights,
            tick,
        };
        match self.eyes.look(&facts) {
            Ok(()) => true,
            Err(error) => {
                tracing::debug!("no stages in the view: {error}");
                false
            }
        }
    }

    /// What was made of a picture.
    fn stages_of(&mut self, percept: &Percept) -> (Value, Named) {
        let mut images = vec![("transformed", small(&stages::transformed(&percept.transformed)))];
        if let Some(decoder) = &mut self.decoder {
            match decoder.reconstruct(&percept.transformed) {
                Ok(image) => images.push(("reconstruction", small(&stages::transformed(&image)))),
                Err(error) => tracing::debug!("no reconstruction in the view: {error}"),
            }
        }
        let boxes: Vec<Value> = (percept.detections.iter())
            .map(|d| {
                let [l, t, r, b] = d.bounds.map(|v| v.round() as i32);
                json!([format!("{:?}", d.class), l, t, r, b, (100.0 * d.score).round()])
            })
            .collect();
        let lanes: Vec<Value> = [&percept.lanes.left, &percept.lanes.right]
            .into_iter()
            .flatten()
            .map(|lane| lane.pixels(&self.ground).iter().flat_map(|p| p.map(|v| v.round() as i32)).collect())
            .collect();
        let gap = percept.raw.lead.map(|lead| lead.gap);
        let light = percept.light.map(|light| json!({ "state": light.state, "distance": light.distance }));
        let red = percept.light_red;
        let signs: Vec<Value> = (percept.signs.iter())
            .map(|sign| {
                let [x, y] = sign.pixel.map(|v| v.round() as i32);
                json!([sign.sign.to_string(), x, y, (100.0 * sign.certainty).round()])
            })
            .collect();
        let limit = percept.limit;
        // Left, top, right, bottom of each stretch of cells.
        let road: Vec<[usize; 4]> = percept.area.iter().flat_map(DrivableArea::stretches).collect();
        let sees = json!({ "boxes": boxes, "lanes": lanes, "light": light, "red": red, "gap": gap, "signs": signs, "limit": limit, "road": road });
        (sees, images)
    }
}

/// The time (s) from one look to another, each with its time (s) and place; None if the same eyes cannot have made both.
fn passed(last: (f64, Point), here: (f64, Point)) -> Option<f64> {
    let (passed, driven) = (here.0 - last.0, (here.1 - last.1).norm());
    ((0.0..=IDLE).contains(&passed) && driven <= 1.0 + FASTEST * passed).then_some(passed)
}

fn small(picture: &Picture) -> Vec<u8> {
    encode(&picture.rgb, picture.width, picture.height, STAGE_QUALITY, SamplingFactor::F_1_1)
}

fn jpeg(frame: &Frame) -> Vec<u8> {
    encode(&frame.rgb, frame.width, frame.height, QUALITY, SamplingFactor::F_2_2)
}

/// Empty where it cannot be encoded, which a picture of the camera's always can.
fn encode(rgb: &[u8], width: usize, height: usize, quality: u8, sampling: SamplingFactor) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(rgb.len() / 12);
    let mut encoder = Encoder::new(&mut bytes, quality);
    encoder.set_sampling_factor(sampling);
    let (Ok(width), Ok(height)) = (u16::try_from(width), u16::try_from(height)) else { return Vec::new() };
    match encoder.encode(rgb, width, height, ColorType::Rgb) {
        Ok(()) => bytes,
        Err(error) => {
            tracing::debug!("a picture cannot be encoded: {error}");
            Vec::new()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Preset;
    use crate::camera::scene::Look;
    use crate::criteria::EgoOnRoute;
    use crate::geometry::direction;
    use crate::network::testing::{net, place};
    use crate::network::{Route, Shapes, VehicleClass};
    use crate::perception::{Detection, Detector, PerceptionError};
    use crate::vehicle::EgoState;
    use crate::view::protocol::State;
    use crate::world::{Actor, ActorKind, ActorType, VehicleSignals, WorldState};
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Counts its resets.
    struct Counting(Arc<AtomicUsize>);

    impl Detector for Counting {
        fn name(&self) -> &str {
            "counting"
        }

        fn reset(&mut self, _: u64) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }

        fn detect(
            &mut self,
            _: &Frame,
            _: &CameraConfig,
            found: &mut Vec<Detection>,
        ) -> Result<(), PerceptionError> {
            found.clear();
            Ok(())
        }
    }

    /// An ego at `s` (m) on its route at this time (s).
    fn shot(route: &Arc<Route>, time: f64, s: f64) -> Shot {
        let pose = route.at(s).pose;
        let (roll, pitch, speed) = (0.0, 0.0, 6.0);
        let (lateral_speed, yaw_rate, acceleration, steer_angle) = (0.0, 0.0, 0.0, 0.0);
        let velocity = direction(pose.heading) * speed;
        let state = EgoState {
            pose,
            roll,
            pitch,
            velocity,
            speed,
            lateral_speed,
            yaw_rate,
            acceleration,
            steer_angle,
        };
        let (kind, length, width) = (ActorKind::Car, 4.4, 1.8);
        let actor_type = ActorType { id: "x".to_string(), kind, length, width, height: 1.5, min_gap: 2.5 };
        let ego = Actor {
            id: Arc::from("ego"),
            key: 1,
            actor_type: Arc::new(actor_type),
            pose,
            speed,
            signals: VehicleSignals::default(),
            lane: None,
            lane_position: 0.0,
        };
        Shot {
            state: State { time, dt: 0.167, ..State::default() },
            world: WorldState { time, ..WorldState::default() },
            ego,
            weather: Preset::ClearNoon,
            look: None,
            way: Some((Arc::clone(route), EgoOnRoute { state, s, d: 0.0, front_s: s + 2.2 })),
        }
    }

    #[test]
    fn eyes_begin_anew_where_the_drive_does_not_go_on() {
        let network = Arc::new(net());
        let (from, to) = (place(&network, "ab_0", 20.0), place(&network, "bc_0", 200.0));
        let route = Arc::new(network.route(from, to, VehicleClass::Passenger).unwrap());
        let town = Town::new(&network, &Shapes::default(), Look::of(1));
        let resets = Arc::new(AtomicUsize::new(0));
        let detector = Box::new(Counting(Arc::clone(&resets)));
        let eyes = Eyes::new(town.share(), CameraConfig::default(), detector).unwrap();
        let mut artist = Artist::new(town, eyes, 3, network, 4.4, None).unwrap();
        let mut look = |time: f64, s: f64| {
            assert!(artist.look(&shot(&route, time, s)));
            resets.load(Ordering::Relaxed)
        };
        assert_eq!([look(10.0, 50.0), look(10.5, 53.0), look(10.5, 53.0)], [1; 3]);
        assert_eq!(look(9.0, 44.0), 2, "played again");
        assert_eq!(look(12.0, 62.0), 3, "nobody looked for 3 s");
        assert_eq!(look(12.2, 150.0), 4, "put elsewhere");
    }

    #[test]
    fn a_picture_becomes_a_jpeg() {
        let frame = Frame { width: 64, height: 48, rgb: vec![120; 64 * 48 * 3], ..Frame::default() };
        let bytes = jpeg(&frame);
        assert!(bytes.starts_with(&[0xff, 0xd8]) && bytes.ends_with(&[0xff, 0xd9]), "{}", bytes.len());
    }
}
