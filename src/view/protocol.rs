//! The messages on the WebSocket. From the page: [`Request`]s, one JSON object per message. To the page: text
//! messages (JSON with a `type`), and a binary one per tick:
//!
//! ```text
//! u32 length of the JSON (little endian) | JSON: State, Around, Sees, images: [[name, bytes], ...] | the
//! JPEGs
//! ```

use crate::camera::Preset;
use crate::criteria::Event;
use crate::network::RoadOption;
use crate::telemetry::{LeaderRecord, LightRecord};
use crate::vehicle::Control;
use crate::world::{ActorKind, VehicleSignals, WorldState};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Longest message that a page may send (bytes).
pub const LONGEST_REQUEST: usize = 2048;
/// Most background road users that a page may request, of each kind.
const MOST_TRAFFIC: usize = 1000;
/// Fastest speed that a page may request; 0 means as fast as possible.
const FASTEST: f64 = 50.0;

/// A viewer's request.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// Controls of the viewer who drives; sent at least twice a second.
    Drive {
        /// Steering, -1 to 1, left positive.
        steer: f64,
        /// Throttle, 0 to 1.
        throttle: f64,
        /// Brake, 0 to 1.
        brake: f64,
        /// Reverse gear.
        #[serde(default)]
        reverse: bool,
        /// From a gamepad or touch, not from keys.
        #[serde(default)]
        analog: bool,
    },
    /// Change the driver: `autopilot`, `manual` (this viewer) or an agent's name.
    Driver {
        /// The driver's name.
        name: String,
    },
    /// Pause or go on.
    Pause {
        /// True: pause.
        on: bool,
    },
    /// One tick, then pause.
    Step {},
    /// Change the speed, times real time; 0: as fast as possible.
    Speed {
        /// The factor.
        factor: f64,
    },
    /// Move the ego to another place.
    Respawn {},
    /// Draw another destination.
    NewRoute {},
    /// Change the weather.
    Weather {
        /// The weather.
        name: Preset,
    },
    /// Change the background traffic.
    Traffic {
        /// Number of vehicles.
        vehicles: usize,
        /// Number of pedestrians.
        pedestrians: usize,
    },
    /// Begin or end a film in the run's folder.
    Record {
        /// True: begin.
        on: bool,
    },
    /// Follow another ego: camera, gauges, reward and requests are then about it.
    Follow {
        /// Its number among the state's egos.
        ego: usize,
    },
    /// The pictures that this viewer wants beside the front camera.
    Look {
        /// The view from behind.
        chase: bool,
        /// Perception's stages.
        stages: bool,
    },
    /// This tick has been drawn.
    Shown {
        /// The number of the frame.
        seq: u64,
    },
    /// A replay: to this tick.
    Seek {
        /// The tick.
        tick: usize,
    },
    /// A replay: another episode.
    Open {
        /// The episode's id.
        episode: String,
    },
    /// Something changed for the page: show the present state again.
    #[serde(skip)]
    Refresh,
}

impl Request {
    /// Reads a message.
    ///
    /// # Errors
    /// The fault of the message.
    pub fn parse(text: &str) -> Result<Self, String> {
        let request: Self = serde_json::from_str(text).map_err(|e| e.to_string())?;
        match &request {
            Self::Drive { steer, throttle, brake, .. } => {
                let within = (-1.0..=1.0).contains(steer)
                    && (0.0..=1.0).contains(throttle)
                    && (0.0..=1.0).contains(brake);
                if !within {
                    return Err("steer is -1 to 1, throttle and brake are 0 to 1".to_string());
                }
            }
            Self::Speed { factor } if !(*factor == 0.0 || (0.05..=FASTEST).contains(factor)) => {
                return Err(format!("speed is 0.05 to {FASTEST}, or 0 for as fast as it goes"));
            }
            Self::Traffic { vehicles, pedestrians } if *vehicles.max(pedestrians) > MOST_TRAFFIC => {
                return Err(format!("at most {MOST_TRAFFIC} vehicles and {MOST_TRAFFIC} pedestrians"));
            }
            _ => {}
        }
        Ok(request)
    }
}

/// An event with its time (s) and a number of its own.
#[derive(Clone, Debug, Serialize)]
pub struct Noted {
    pub n: u64,
    pub time: f64,
    #[serde(flatten)]
    pub what: Note,
}

/// A note for the page's log.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Note {
    Event(Event),
    Said { said: String },
}

/// The ego's motion for the page.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct EgoNow {
    pub x: f64,
    pub y: f64,
    pub heading: f64,
    pub speed: f64,
    pub acceleration: f64,
    pub yaw_rate: f64,
    /// Front wheels (rad, left positive).
    pub steer_angle: f64,
    pub length: f64,
    pub width: f64,
}

/// The state after a tick, without the traffic round the ego.
#[derive(Clone, Debug, Default, Serialize)]
pub struct State {
    /// Number of the message; not the tick.
    pub seq: u64,
    pub tick: u64,
    /// Simulation time (s).
    pub time: f64,
    /// Length of a tick (s).
    pub dt: f64,
    /// When the tick was over (ms since 1970).
    pub at: f64,
    pub paused: bool,
    pub speed_factor: f64,
    /// Simulation seconds per second, over the last ones.
    pub pace: f64,
    pub driver: String,
    /// The viewer who drives.
    pub holder: Option<u64>,
    /// The driver to whom a viewer gives the wheel back: who drove before.
    pub before: Option<String>,
    /// An agent that is loading.
    pub loading: Option<String>,
    pub weather: String,
    /// Background traffic that is kept alive; None: the config's own.
    pub wanted_traffic: Option<(usize, usize)>,
    pub traffic: (usize, usize),
    pub ego: EgoNow,
    /// Number of the ego that is followed.
    pub followed: usize,
    /// Where there are several: all egos, `(x, y, heading, speed, length, width)`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub egos: Vec<[f64; 6]>,
    pub control: Control,
    pub limit: f64,
    pub light: Option<LightRecord>,
    pub leader: Option<LeaderRecord>,
    pub option: Option<RoadOption>,
    pub lane: String,
    /// Way along the route, offset to its left, where the destination lies on it (m).
    pub route: (f64, f64, f64),
    pub route_id: u64,
    pub reason: Option<String>,
    /// The reward's terms in the paper's order, and their sums.
    pub reward: [f64; 6],
    pub sums: [f64; 6],
    pub notes: Vec<Noted>,
    /// The film under way.
    pub recording: Option<String>,
    pub viewers: usize,
    /// The run has ended; a replay is at its end.
    pub over: Option<String>,
}

/// Road users round the ego: `[key, kind, x, y, heading, length, width, speed, lights]`, lights 1 brake,
/// 2 left, 4 right; and the states of the traffic lights in sight.
pub fn around(world: &WorldState) -> Value {
    let place = |v: f64| (v * 100.0).round() / 100.0;
    let actors: Vec<Value> = (world.vehicles.iter().chain(&world.pedestrians))
        .map(|a| {
            let on = |bits, value| if a.signals.has(bits) { value } else { 0 };
            let lights = on(VehicleSignals::BRAKE_LIGHT, 1)
                | on(VehicleSignals::BLINKER_LEFT, 2)
                | on(VehicleSignals::BLINKER_RIGHT, 4);
            let (x, y) = (place(a.pose.position.x), place(a.pose.position.y));
            let (length, width) = (a.actor_type.length, a.actor_type.width);
            let (heading, speed) = ((a.pose.heading * 1000.0).round() / 1000.0, place(a.speed));
            json!([a.key, kind(a.actor_type.kind), x, y, heading, length, width, speed, lights])
        })
        .collect();
    let lights: Vec<Value> = (world.traffic_lights.iter().enumerate())
        .filter_map(|(i, state)| state.as_ref().map(|state| json!([i, &**state])))
        .collect();
    json!({ "actors": actors, "lights": lights })
}

fn kind(kind: ActorKind) -> u8 {
    match kind {
        ActorKind::Car => 0,
        ActorKind::Van => 1,
        ActorKind::Truck => 2,
        ActorKind::Bus => 3,
        ActorKind::Motorcycle => 4,
        ActorKind::Bicycle => 5,
        ActorKind::Pedestrian => 6,
        ActorKind::Object => 7,
    }
}

/// A message for one tick.
pub fn packet(state: &State, more: Value, images: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut value = serde_json::to_value(state).unwrap_or_default();
    if let (Value::Object(all), Value::Object(more)) = (&mut value, more) {
        all.extend(more);
        let list: Vec<Value> = images.iter().map(|(name, jpeg)| json!([name, jpeg.len()])).collect();
        all.insert("images".to_string(), Value::Array(list));
    }
    let text = value.to_string();
    let size = 4 + text.len() + images.iter().map(|(_, jpeg)| jpeg.len()).sum::<usize>();
    let mut bytes = Vec::with_capacity(size);
    bytes.extend_from_slice(&(text.len() as u32).to_le_bytes());
    bytes.extend_from_slice(text.as_bytes());
    for (_, jpeg) in images {
        bytes.extend_from_slice(jpeg);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_read_and_wild_ones_refused() {
        assert_eq!(Request::parse(r#"{"do":"step"}"#), Ok(Request::Step {}));
        assert_eq!(
            Request::parse(r#"{"do":"weather","name":"WetSunset"}"#),
            Ok(Request::Weather { name: Preset::WetSunset })
        );
        for wrong in [
            "",
            "[]",
            r#"{"do":"fly"}"#,
            r#"{"do":"refresh"}"#,
            r#"{"do":"speed","factor":1e9}"#,
            r#"{"do":"speed","factor":-1}"#,
            r#"{"do":"drive","steer":2,"throttle":0,"brake":0}"#,
            r#"{"do":"drive","steer":0,"throttle":0,"brake":0,"more":1}"#,
            r#"{"do":"traffic","vehicles":1000000,"pedestrians":0}"#,
            r#"{"do":"weather","name":"Snow"}"#,
        ] {
            assert!(Request::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_packet_says_where_its_pictures_are() {
        let state = State { tick: 7, ..State::default() };
        let bytes = packet(&state, json!({ "actors": [] }), &[("front", vec![1, 2, 3]), ("chase", vec![4])]);
        let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
        let value: Value = serde_json::from_slice(&bytes[4..4 + length]).unwrap();
        assert_eq!((&value["tick"], &value["images"]), (&json!(7), &json!([["front", 3], ["chase", 1]])));
        assert_eq!(&bytes[4 + length..], [1, 2, 3, 4]);
    }
}
