//! Records a drive in memory, until it is clear whether to keep it.

use super::format::{ActorLine, Header, Line, NewLine, TypeLine, ego_numbers};
use crate::criteria::Event;
use crate::tasks::Spot;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::collections::HashSet;
use std::io::Write;
use std::sync::Arc;
use sumo_network::network::{LanePosition, Network};
use sumo_network::world::{Actor, WorldState};
use wad_vehicle::{Control, EgoState};

/// The state after one tick, to be recorded.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    /// Ticks so far; 0 before the first control.
    pub tick: u64,
    /// The control that was driven in the tick.
    pub control: Control,
    /// The ego's motion after the tick.
    pub ego: &'a EgoState,
    /// The ego's place along its route (m).
    pub s: f64,
    /// The ego's offset to the left of its route (m).
    pub d: f64,
    /// Where the ego's route was led to, one after the other ([`sumo_network::network::Route::destinations`]).
    pub destinations: &'a [LanePosition],
    /// The road users and lights in the ego's sight.
    pub world: &'a WorldState,
    /// What happened in the tick.
    pub events: &'a [Event],
}

/// A recording under way.
#[derive(Debug)]
pub struct Recorder {
    network: Arc<Network>,
    text: Vec<u8>,
    /// How many destinations are known.
    destinations: Option<usize>,
    types: HashSet<String>,
    /// Keys are given again when actors are forgotten: what counts is the pair.
    actors: HashSet<(u64, Arc<str>)>,
    lights: Vec<Option<Arc<str>>>,
}

impl Recorder {
    /// Begins a recording on a net.
    pub fn new(header: &Header, network: Arc<Network>) -> Self {
        let mut recorder = Self {
            network,
            text: Vec::new(),
            destinations: None,
            types: HashSet::new(),
            actors: HashSet::new(),
            lights: Vec::new(),
        };
        recorder.write(header);
        recorder
    }

    /// Adds a tick.
    pub fn add(&mut self, moment: &Moment<'_>) {
        let Moment { tick, control, ego, s, d, destinations, world, events } = *moment;
        let (mut types, mut new) = (Vec::new(), Vec::new());
        for actor in world.vehicles.iter().chain(&world.pedestrians) {
            if !self.actors.contains(&(actor.key, Arc::clone(&actor.id))) {
                let t = &actor.actor_type;
                if self.types.insert(t.id.clone()) {
                    types.push(TypeLine(t.id.clone(), t.kind, t.length, t.width, t.height, t.min_gap));
                }
                new.push(NewLine(actor.key, actor.id.to_string(), t.id.clone()));
                self.actors.insert((actor.key, Arc::clone(&actor.id)));
            }
        }
        let mut lights = Vec::new();
        self.lights.resize(world.traffic_lights.len().max(self.lights.len()), None);
        for (index, (old, now)) in self.lights.iter_mut().zip(&world.traffic_lights).enumerate() {
            if old != now {
                lights.push((index, now.as_deref().unwrap_or_default().to_string()));
                old.clone_from(now);
            }
        }
        // Those of the start are the episode's own.
        let known = self.destinations.replace(destinations.len()).unwrap_or(destinations.len());
        let onward = destinations.iter().skip(known).map(|&at| Spot::at(&self.network, at)).collect();
        self.write(&Line {
            tick,
            time: world.time,
            control: [control.throttle, control.steer, control.brake].map(|x| x.to_string()),
            reverse: control.reverse,
            ego: ego_numbers(ego).map(|x| x.to_string()),
            s: rounded(s, 1e3),
            d: rounded(d, 1e3),
            onward,
            types,
            new,
            vehicles: world.vehicles.iter().map(line).collect(),
            pedestrians: world.pedestrians.iter().map(line).collect(),
            lights,
            events: events.to_vec(),
            bits: format!("{:016x}", digest(moment)),
        });
    }

    /// Writing into memory cannot fail, and every line is made of things that JSON can say.
    fn write(&mut self, line: &impl serde::Serialize) {
        let before = self.text.len();
        match serde_json::to_writer(&mut self.text, line) {
            Ok(()) => self.text.push(b'\n'),
            Err(_) => self.text.truncate(before),
        }
    }

    /// The file's bytes.
    pub fn bytes(&self) -> Vec<u8> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
        // Writing into memory cannot fail.
        let _ = encoder.write_all(&self.text);
        encoder.finish().unwrap_or_default()
    }
}

fn rounded(x: f64, to: f64) -> f64 {
    (x * to).round() / to
}

fn line(actor: &Actor) -> ActorLine {
    let p = actor.pose.position;
    let [x, y, z] = [p.x, p.y, p.z].map(|x| rounded(x, 1e3));
    let heading = rounded(actor.pose.heading, 1e4);
    ActorLine(actor.key, x, y, z, heading, rounded(actor.speed, 1e2), actor.signals.0)
}

/// A 64-bit hash (FNV-1a) over every bit of a state: the control, the ego's motion, all road users in its
/// sight with id, pose, speed and lamps, and the lights.
pub fn digest(moment: &Moment<'_>) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    let mut add = |word: u64| hash = (hash ^ word).wrapping_mul(0x0100_0000_01b3).rotate_left(29);
    let c = moment.control;
    for x in [c.throttle, c.steer, c.brake, moment.world.time, moment.s, moment.d] {
        add(x.to_bits());
    }
    ego_numbers(moment.ego).iter().for_each(|x| add(x.to_bits()));
    for actor in moment.world.vehicles.iter().chain(&moment.world.pedestrians) {
        actor.id.bytes().for_each(|b| add(u64::from(b)));
        let p = actor.pose.position;
        for x in [p.x, p.y, p.z, actor.pose.heading, actor.speed] {
            add(x.to_bits());
        }
        add(u64::from(actor.signals.0));
    }
    for state in &moment.world.traffic_lights {
        state.as_deref().unwrap_or("-").bytes().for_each(|b| add(u64::from(b)));
        add(0);
    }
    hash
}
