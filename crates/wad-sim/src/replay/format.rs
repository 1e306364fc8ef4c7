//! The lines of a recording.

use super::Frame;
use crate::criteria::Event;
use crate::tasks::Spot;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use sumo_network::geometry::Pose;
use sumo_network::world::{Actor, ActorKind, ActorType, VehicleSignals, WorldState};
use wad_camera::Preset;
use wad_vehicle::{Control, EgoState};

/// The format's name and version.
pub const FORMAT: &str = "wad-cosim recording 1";

/// The first line: what holds for the whole recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// The format's name and version.
    pub format: String,
    /// The CONFIG that was driven on, as it was given.
    pub config: String,
    /// The town's name.
    pub town: String,
    /// Length of a tick (ms).
    pub tick_ms: f64,
    /// The weather.
    pub weather: Preset,
    /// The ego's size.
    pub ego: Body,
    /// The route's centre line as it was at the start, a point every few metres (m).
    pub route: Vec<[f64; 2]>,
    /// Ids of the town's traffic lights, in the order of a world's `traffic_lights`.
    pub lights: Vec<String>,
}

impl Header {
    /// A header without route and lights.
    pub fn new(config: &str, town: &str, tick_ms: f64, weather: Preset, ego: Body) -> Self {
        let (config, town) = (config.to_string(), town.to_string());
        Self {
            format: FORMAT.to_string(),
            config,
            town,
            tick_ms,
            weather,
            ego,
            route: Vec::new(),
            lights: Vec::new(),
        }
    }
}

/// The ego's size (m).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Body {
    /// Front to rear (m).
    pub length: f64,
    /// Side to side (m).
    pub width: f64,
    /// Above the ground (m).
    pub height: f64,
}

/// A vehicle type, when first seen: id, kind, length, width, height, minimum gap (m).
#[derive(Debug, Serialize, Deserialize)]
pub struct TypeLine(pub String, pub ActorKind, pub f64, pub f64, pub f64, pub f64);

/// An actor, when first seen: key, id, type's id.
#[derive(Debug, Serialize, Deserialize)]
pub struct NewLine(pub u64, pub String, pub String);

/// An actor in a tick: key, x, y, z (m), heading (rad), speed (m/s), signals.
#[derive(Debug, Serialize, Deserialize)]
pub struct ActorLine(pub u64, pub f64, pub f64, pub f64, pub f64, pub f64, pub u32);

/// One tick.
#[derive(Debug, Serialize, Deserialize)]
pub struct Line {
    pub tick: u64,
    pub time: f64,
    /// Throttle, steering and brake: as text, so that no reader rounds them.
    pub control: [String; 3],
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub reverse: bool,
    pub ego: EgoText,
    pub s: f64,
    pub d: f64,
    /// What the route was lengthened to since the tick before.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub onward: Vec<Spot>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub types: Vec<TypeLine>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub new: Vec<NewLine>,
    pub vehicles: Vec<ActorLine>,
    pub pedestrians: Vec<ActorLine>,
    /// Lights that changed: index and state; an empty state is out of sight.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lights: Vec<(usize, String)>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub events: Vec<Event>,
    /// [`super::digest`], hexadecimal.
    pub bits: String,
}

/// x, y, z, heading, roll, pitch, velocity x, y, speed, lateral speed, yaw rate, acceleration, steering angle.
pub type EgoText = [String; 13];

/// The numbers of an ego's motion, in the order of [`EgoText`].
pub fn ego_numbers(ego: &EgoState) -> [f64; 13] {
    let p = ego.pose.position;
    [
        p.x,
        p.y,
        p.z,
        ego.pose.heading,
        ego.roll,
        ego.pitch,
        ego.velocity.x,
        ego.velocity.y,
        ego.speed,
        ego.lateral_speed,
        ego.yaw_rate,
        ego.acceleration,
        ego.steer_angle,
    ]
}

fn ego_state(text: &EgoText) -> Result<EgoState, String> {
    let mut n = [0.0; 13];
    for (number, text) in n.iter_mut().zip(text) {
        *number = exact(text)?;
    }
    let [x, y, z, heading, roll, pitch, vx, vy, speed, lateral_speed, yaw_rate, acceleration, steer_angle] =
        n;
    Ok(EgoState {
        // Not Pose::new: the heading is wrapped already, and must not change in its last bit.
        pose: Pose { position: nalgebra::Point3::new(x, y, z), heading },
        roll,
        pitch,
        velocity: sumo_network::geometry::Vector::new(vx, vy),
        speed,
        lateral_speed,
        yaw_rate,
        acceleration,
        steer_angle,
    })
}

fn exact(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| format!("`{text}` is not a number"))
}

/// What earlier lines defined.
#[derive(Debug, Default)]
pub struct Memory {
    types: BTreeMap<String, Arc<ActorType>>,
    actors: BTreeMap<u64, (Arc<str>, Arc<ActorType>)>,
    lights: Vec<Option<Arc<str>>>,
}

impl Memory {
    /// For a town with this many traffic lights, none of them in sight.
    pub fn new(lights: usize) -> Self {
        Self { lights: vec![None; lights], ..Self::default() }
    }

    /// The frame that a line means.
    pub fn frame(&mut self, line: Line) -> Result<Frame, String> {
        for TypeLine(id, kind, length, width, height, min_gap) in line.types {
            let of_type = ActorType { id: id.clone(), kind, length, width, height, min_gap };
            self.types.insert(id, Arc::new(of_type));
        }
        for NewLine(key, id, type_id) in line.new {
            let of_type = self.types.get(&type_id).ok_or(format!("no type `{type_id}` was given"))?;
            self.actors.insert(key, (Arc::from(id), Arc::clone(of_type)));
        }
        for (index, state) in line.lights {
            let lights = self.lights.len();
            let light = self.lights.get_mut(index).ok_or(format!("light {index} of {lights}"))?;
            *light = (!state.is_empty()).then(|| Arc::from(state));
        }
        let [throttle, steer, brake] = &line.control;
        Ok(Frame {
            tick: line.tick,
            control: Control {
                throttle: exact(throttle)?,
                steer: exact(steer)?,
                brake: exact(brake)?,
                reverse: line.reverse,
            },
            ego: ego_state(&line.ego)?,
            s: line.s,
            d: line.d,
            onward: line.onward,
            world: WorldState {
                tick: line.tick,
                time: line.time,
                vehicles: self.actors(line.vehicles)?,
                pedestrians: self.actors(line.pedestrians)?,
                traffic_lights: self.lights.clone(),
            },
            events: line.events,
            bits: u64::from_str_radix(&line.bits, 16).map_err(|e| format!("bits `{}`: {e}", line.bits))?,
        })
    }

    fn actors(&self, lines: Vec<ActorLine>) -> Result<Vec<Actor>, String> {
        let actor = |ActorLine(key, x, y, z, heading, speed, signals)| {
            let (id, actor_type) = self.actors.get(&key).ok_or(format!("no actor {key} was given"))?;
            Ok(Actor {
                id: Arc::clone(id),
                key,
                actor_type: Arc::clone(actor_type),
                pose: Pose::new(x, y, z, heading),
                speed,
                signals: VehicleSignals(signals),
                lane: None,
                lane_position: 0.0,
            })
        };
        lines.into_iter().map(actor).collect()
    }
}
