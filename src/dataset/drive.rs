//! Drives one segment and records its frames.

use super::collect::CollectOptions;
use super::error::DatasetError;
use super::image_codec::CameraCodec;
use super::noise::Disturber;
use super::plan::Segment;
use super::record::{BoxRecord, Frame, FrameRecord, Labels};
use super::shard::ShardWriter;
use crate::autopilot::{Autopilot, EgoModel};
use crate::bridge::{Bridge, BridgeOptions, Ego, Lamps};
use crate::camera::{Camera, CameraConfig, Outputs, Town, Weather, model};
use crate::destination::Destinations;
use crate::drive::{first_route, polygons};
use crate::network::{LanePosition, Network};
use crate::perception::{EgoFacts, Perception, TruthDetector};
use crate::traffic::TrafficSpec;
use crate::vehicle::{self, Control};
use crate::world::Actor;
use crate::{seeds, sight};
use std::path::Path;
use std::sync::Arc;

/// Driven before the first frame (s).
const WARM_UP: f64 = 8.0;
/// A standing ego's view is kept this seldom (s).
const STANDING_EVERY: f64 = 2.5;
/// Standing for so long it is put down elsewhere (s): enough for a red light.
const STUCK_AFTER: f64 = 75.0;
/// Frames go on for this long after a crash (s).
const AFTER_CRASH: f64 = 1.0;
/// An impulse that is a crash (N s), and how far off the route it is put back (m).
const CRASH: f64 = 200.0;
const LOST: f64 = 8.0;
/// A crash-free drive from one place lasts at most this long (s); then another place is seen.
const LONGEST_STAY: f64 = 240.0;

/// Half the width in front of the ego that counts as its lane (m).
const HALF_LANE: f64 = 1.6;
/// An object counts as seen from this many pixels of the camera on.
const SEEN_PIXELS: u32 = 16;

/// One segment under way.
pub struct SegmentDrive<'a> {
    options: &'a CollectOptions,
    segment: Segment,
    bridge: Bridge,
    network: Arc<Network>,
    ego: Ego,
    autopilot: Autopilot,
    noise: Disturber,
    destinations: Destinations,
    town: Town,
    camera: Camera,
    perception: Perception,
    weather: Weather,
    codec: CameraCodec,
    /// Time since the last frame, since the ego last moved, since a crash, at this place (s).
    since_frame: f64,
    standing: f64,
    crashed: Option<f64>,
    stay: f64,
    control: Control,
}

impl<'a> SegmentDrive<'a> {
    /// Starts SUMO and puts the ego somewhere.
    ///
    /// # Errors
    /// Bad input, or SUMO fails.
    pub async fn start(
        options: &'a CollectOptions,
        config: &Path,
        segment: Segment,
        scratch: &Path,
    ) -> Result<Self, DatasetError> {
        let mut bridge = Bridge::start(&BridgeOptions {
            seed: segment.seed,
            traffic: TrafficSpec::Counts(segment.traffic),
            ..BridgeOptions::new(config, scratch)
        })
        .await?;
        let network = bridge.network().clone();
        let mut destinations = Destinations::new(&network, seeds::rng(segment.seed, "route"))?;
        let route = first_route(&network, &mut destinations)?;
        let params = vehicle::EgoParams::default();
        let mut ego = Ego::new("ego", params.clone(), route, 0.0);
        let statics = vehicle::statics_from_network(&network, &polygons(&bridge, &network));
        ego.vehicle_mut().set_statics(statics);
        bridge.spawn(&mut ego).await?;
        let config = CameraConfig::default();
        let mut perception = Perception::new(Box::new(TruthDetector::new()), config)?;
        perception.reset(segment.seed);
        Ok(Self {
            options,
            segment,
            // One town for all segments: the buildings' faces do not change with the traffic.
            town: sight::town(&bridge, options.seed),
            bridge,
            network,
            autopilot: Autopilot::new(Default::default(), EgoModel::from(&params)),
            ego,
            noise: Disturber::new(options.noise, seeds::rng(segment.seed, "noise")),
            destinations,
            camera: Camera::new(config)?,
            perception,
            weather: Weather::from(segment.weather),
            codec: CameraCodec::best(),
            since_frame: 0.0,
            standing: 0.0,
            crashed: None,
            stay: 0.0,
            control: Control::default(),
        })
    }

    /// Drives until the next frame is due, and records it.
    ///
    /// # Errors
    /// SUMO fails, or the shard cannot be written.
    pub async fn next_frame(&mut self, shard: &mut ShardWriter) -> Result<(), DatasetError> {
        loop {
            self.tick().await?;
            let elapsed = self.bridge.tick();
            self.since_frame += elapsed;
            let due = if self.standing > 1.0 { STANDING_EVERY } else { self.options.every };
            if self.bridge.time() >= WARM_UP && self.since_frame >= due - 1e-6 {
                break;
            }
        }
        let frame = self.record()?;
        self.since_frame = 0.0;
        shard.add(&frame)
    }

    async fn tick(&mut self) -> Result<(), DatasetError> {
        let tick = self.bridge.tick();
        let before = self.ego.on_route();
        let decision = self.autopilot.control(
            &self.network,
            self.ego.route(),
            before.s,
            &before.state,
            self.ego.world(),
            tick,
        );
        self.ego.set_lamps(Lamps {
            blinker_left: decision.blinker_left,
            blinker_right: decision.blinker_right,
            brake: decision.brake_light,
        });
        let params = self.ego.params();
        let curvature = params.max_steer_angle.tan() / params.wheelbase;
        self.control = self.noise.disturb(decision.control, before.state.speed, curvature, tick);
        let contacts = self.ego.advance(self.control, tick);
        self.bridge.step(&mut [&mut self.ego]).await?;
        sight::follow(&mut self.town, &self.ego);
        self.stay += tick;
        self.standing = if self.ego.state().speed.abs() < 0.3 { self.standing + tick } else { 0.0 };
        if let Some(since) = &mut self.crashed {
            *since += tick;
        } else if contacts.iter().any(|contact| contact.impulse > CRASH) {
            self.crashed = Some(0.0);
        }
        self.go_on().await
    }

    /// A new destination on arrival; another place after a crash, when stuck, lost or too long about.
    async fn go_on(&mut self) -> Result<(), DatasetError> {
        let at = self.ego.on_route();
        let over = self.crashed.is_some_and(|since| since > AFTER_CRASH)
            || self.standing > STUCK_AFTER
            || at.d.abs() > LOST
            || self.stay > LONGEST_STAY;
        if !over {
            if self.ego.route().length() - at.s > 5.0 {
                return Ok(());
            }
            // The new route begins a car's length behind the ego, on the lane that it is on.
            let lane = self.ego.lane();
            let here = self.network.lane(lane).shape.project(self.ego.state().pose.xy()).s;
            let from = LanePosition { lane, s: (here - self.ego.params().length).max(0.0) };
            if let Ok(route) = self.destinations.route_from(&self.network, from)
                && route.length() >= 60.0
            {
                self.ego.set_route(route, here - from.s);
                return Ok(());
            }
        }
        let mut route = first_route(&self.network, &mut self.destinations)?;
        for _ in 0..20 {
            if self.bridge.is_free(&[route.at(0.0).lane]).await? {
                break;
            }
            route = first_route(&self.network, &mut self.destinations)?;
        }
        self.ego.respawn(route, 0.0);
        let model = EgoModel::from(self.ego.params());
        self.autopilot = Autopilot::new(Default::default(), model);
        self.perception.reset(self.segment.seed);
        (self.crashed, self.stay, self.standing) = (None, 0.0, 0.0);
        Ok(())
    }

    fn record(&mut self) -> Result<Frame, DatasetError> {
        let outputs = Outputs { boxes: true, ..Outputs::RGB };
        let pose = self.ego.state().pose;
        let (scene, actors) = (self.town.scene(), self.town.actors());
        let frame = self.camera.render(scene, actors, &pose, &self.weather, outputs);
        let facts = EgoFacts::of(&self.network, &self.ego, self.since_frame);
        let percept = self.perception.perceive(frame, &facts)?;
        let world = self.ego.world();
        // The frame numbers road users by their place in the world; a shard by what they are.
        let keys: Vec<u64> = world.vehicles.iter().chain(&world.pedestrians).map(|a| a.key).collect();
        let key = |id: u32| match keys.get((id as usize).wrapping_sub(1)) {
            Some(key) if id < model::STATIC_IDS => *key as u32 + 1,
            _ => id,
        };
        let boxes = frame.objects.iter().map(|o| BoxRecord { id: key(o.id), ..o.into() }).collect();
        let pixels = |place: usize| {
            let id = place as u32 + 1;
            frame.objects.iter().find(|o| o.id == id).map_or(0, |o| o.visible_pixels)
        };
        let vehicles = world.vehicles.iter().enumerate().map(|(i, a)| (a, pixels(i)));
        let first = world.vehicles.len();
        let people = world.pedestrians.iter().enumerate().map(|(i, a)| (a, pixels(first + i)));
        let labels = Labels {
            lead: nearest_in_lane(&self.ego, vehicles),
            pedestrian: nearest_in_lane(&self.ego, people),
            red: percept.light_red,
        };
        let record = FrameRecord {
            time: self.bridge.time(),
            weather: self.segment.weather,
            ego: self.ego.state(),
            control: self.control,
            disturbed: self.noise.is_disturbed() || self.crashed.is_some(),
            boxes,
            light: percept.light.map(|light| (light.state, light.distance)),
            raw: percept.raw,
            labels,
            lanes: percept.lanes,
        };
        let camera = if self.options.camera {
            self.codec.encode(&frame.rgb, frame.width, frame.height)?
        } else {
            Vec::new()
        };
        Ok(Frame { record, transformed: percept.transformed.clone(), camera })
    }

    /// Ends SUMO.
    pub async fn finish(self) {
        if let Err(error) = self.bridge.close().await {
            tracing::warn!("SUMO did not close properly: {error}");
        }
    }
}

/// Gap from the ego's front bumper to the nearest seen actor in its lane (m).
fn nearest_in_lane<'w>(ego: &Ego, actors: impl Iterator<Item = (&'w Actor, u32)>) -> Option<f64> {
    const SIGHT: f64 = 60.0;
    let (route, at) = (ego.route(), ego.on_route());
    let front = at.s + 0.5 * ego.params().length;
    actors
        .filter(|(_, pixels)| *pixels >= SEEN_PIXELS)
        .filter_map(|(actor, _)| {
            let place = route.project_near(actor.pose.xy(), at.s, 10.0, SIGHT);
            let (centre, off) = (place.s, place.d);
            let turn = actor.pose.heading - route.at(centre).pose.heading;
            let t = &actor.actor_type;
            let along = 0.5 * (t.length * turn.cos().abs() + t.width * turn.sin().abs());
            let across = 0.5 * (t.length * turn.sin().abs() + t.width * turn.cos().abs());
            let rear = centre - along - front;
            // The projection's end is no place in the lane.
            let beyond = (actor.pose.xy() - route.at(centre).pose.xy()).norm() > off.abs() + 3.0;
            (!beyond && centre > front && off.abs() < HALF_LANE + across.min(1.0) && rear < SIGHT)
                .then_some(rear.max(0.0))
        })
        .min_by(f64::total_cmp)
}
