//! Makes a dataset's frames of the world, with camera and perception.

use super::error::DatasetError;
use super::image_codec::CameraCodec;
use super::options::CollectOptions;
use super::plan::Segment;
use super::record::{BoxRecord, Frame, FrameRecord, Labels};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::HashMap;
use sumo_network::network::Network;
use sumo_network::seeds;
use sumo_network::world::{Actor, WorldState};
use wad_camera::model::{self, PlacedSign};
use wad_camera::{CameraConfig, Outputs, Weather};
use wad_see::eyes::Eyes;
use wad_see::perception::{EgoFacts, Heads, NearGaps, RoadTruth, TruthDetector};
use wad_sim::assets::Assets;
use wad_sim::bridge::Ego;
use wad_vehicle::Control;

/// Half the width in front of the ego that counts as its lane (m).
const HALF_LANE: f64 = 1.6;
/// An object counts as seen from this many pixels of the camera on.
const SEEN_PIXELS: u32 = 16;

/// Camera and perception that make frames.
pub struct Eye {
    segment: Segment,
    weather: Weather,
    eyes: Eyes,
    heads: Heads,
    signs: Vec<PlacedSign>,
    /// The format of camera pictures; None: they are not kept.
    codec: Option<CameraCodec>,
    signals: Option<RandomSignals>,
    /// Draws gaps, where the ego is to be near; whether to vehicles and to people.
    near: Option<(NearGaps, [bool; 2])>,
}

/// A frame's facts that do not come from camera and perception.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// Simulation time, and time since the last frame (s).
    pub time: f64,
    pub since: f64,
    /// The ego's control.
    pub control: Control,
    /// See [`FrameRecord::disturbed`].
    pub disturbed: bool,
}

impl Eye {
    /// For the segment's weather and look of the town, with the camera's pictures and random signals where `options` say so.
    ///
    /// # Errors
    /// This build cannot detect lanes.
    pub fn new(assets: &Assets, segment: Segment, options: &CollectOptions) -> Result<Self, DatasetError> {
        let town = segment.varied_town(&options.vary, assets);
        let heads = Heads::new(assets.network(), town.scene());
        let signs = town.scene().signs.clone();
        let outputs = Outputs { boxes: true, depth: true, semantic: true, ..Outputs::RGB };
        let eyes = Eyes::new(town, CameraConfig::default(), Box::new(TruthDetector::new()))?;
        let eyes = eyes.with_outputs(outputs).with_image(options.image);
        let codec = options.camera.then(CameraCodec::best);
        let signals = options.random_signals.then(|| RandomSignals::new(segment.seed));
        let near = options.near.then(|| (NearGaps::new(segment.seed), options.shows()));
        let weather = segment.varied_weather(&options.vary);
        let mut eye = Self { segment, weather, eyes, heads, signs, codec, signals, near };
        eye.reset();
        Ok(eye)
    }

    /// Clears its memory, because the ego was moved to another place.
    pub fn reset(&mut self) {
        self.eyes.reset(self.weather.clone(), self.segment.seed);
    }

    /// The town's traffic after a tick.
    pub fn follow(&mut self, ego: &Ego) {
        self.eyes.follow(ego.world());
    }

    /// The frame of this moment.
    ///
    /// # Errors
    /// A stage of perception fails.
    pub fn record(&mut self, network: &Network, ego: &Ego, moment: Moment) -> Result<Frame, DatasetError> {
        let drawn = self.signals.as_mut().map(|signals| signals.draw(network, ego.world()));
        let world = drawn.as_ref().unwrap_or(ego.world());
        if drawn.is_some() {
            self.eyes.follow(world);
        }
        let mut facts =
            EgoFacts { signals: &world.traffic_lights, ..EgoFacts::of(network, ego, moment.since) };
        if let Some((gaps, counts)) = &mut self.near {
            // Whoever is there, for nobody has looked yet.
            let kinds =
                [&world.vehicles, &world.pedestrians].into_iter().zip(*counts).filter(|(_, count)| *count);
            let all = kinds.flat_map(|(actors, _)| actors).map(|actor| (actor, u32::MAX));
            if let Some(gap) = nearest_in_lane(&facts, all) {
                facts = facts.moved(gap - gaps.draw());
            }
        }
        self.eyes.look(&facts)?;
        let (Some(frame), Some(percept)) = (self.eyes.frame(), self.eyes.percept()) else {
            return Err(DatasetError::Image("the camera gave no frame".to_string()));
        };
        // The frame numbers road users by their place in the world; a shard by what they are.
        let keys: Vec<u64> = world.vehicles.iter().chain(&world.pedestrians).map(|a| a.key).collect();
        let key = |id: u32| {
            let riders = id & model::RIDER_IDS;
            match keys.get(((id - riders) as usize).wrapping_sub(1)) {
                Some(key) if id < model::STATIC_IDS => riders + *key as u32 + 1,
                _ => id,
            }
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
            lead: nearest_in_lane(&facts, vehicles),
            pedestrian: nearest_in_lane(&facts, people),
            red: percept.light_red,
        };
        let road = RoadTruth::find(&facts, world, &self.heads);
        let road = road.with_frame(&self.signs, &CameraConfig::default(), &facts.on_route.state.pose, frame);
        let record = FrameRecord {
            time: moment.time,
            weather: self.segment.weather,
            ego: facts.on_route.state,
            control: moment.control,
            disturbed: moment.disturbed,
            boxes,
            light: percept.light.map(|light| (light.state, light.distance)),
            raw: percept.raw,
            labels,
            lanes: percept.lanes,
            road: Some(road),
        };
        let camera = match &self.codec {
            Some(codec) => codec.encode(&frame.rgb, frame.width, frame.height)?,
            None => Vec::new(),
        };
        Ok(Frame { record, transformed: percept.transformed.clone(), camera })
    }
}

/// Lamps drawn at random. Real programs show yellow for three seconds a minute, and who stands at a line sees red: a network
/// would learn the place instead of the lamp.
struct RandomSignals {
    rng: ChaCha8Rng,
}

/// What is drawn, as SUMO writes it: two in five are red or green.
const LAMPS: [char; 5] = ['r', 'r', 'y', 'G', 'G'];

impl RandomSignals {
    fn new(seed: u64) -> Self {
        Self { rng: seeds::rng(seed, "signals") }
    }

    fn lamp(&mut self) -> char {
        LAMPS[self.rng.random_range(0..LAMPS.len())]
    }

    /// The world with other lamps: the links that leave one lane show the same, every second lane what its road shows, crossings
    /// what they showed.
    fn draw(&mut self, network: &Network, world: &WorldState) -> WorldState {
        let mut world = world.clone();
        for (program, states) in network.traffic_lights.iter().zip(&mut world.traffic_lights) {
            let Some(shown) = states else { continue };
            let mut shown: Vec<char> = shown.chars().collect();
            let (mut roads, mut lanes) = (HashMap::new(), HashMap::new());
            for link in program.links.iter().map(|link| network.link(*link)) {
                let road = *roads.entry(network.lane(link.from).edge).or_insert_with(|| self.lamp());
                let lamp = *lanes
                    .entry(link.from)
                    .or_insert_with(|| if self.rng.random() { road } else { self.lamp() });
                if let Some(state) = link.signal.and_then(|signal| shown.get_mut(signal.index)) {
                    *state = lamp;
                }
            }
            *states = Some(shown.into_iter().collect::<String>().into());
        }
        world
    }
}

/// Gap from the ego's front bumper to the nearest seen actor in its lane (m).
fn nearest_in_lane<'w>(facts: &EgoFacts<'_>, actors: impl Iterator<Item = (&'w Actor, u32)>) -> Option<f64> {
    const SIGHT: f64 = 60.0;
    let (route, at) = (facts.route, facts.on_route);
    let front = at.s + 0.5 * facts.length;
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
