//! Recorded drives: the ego and the road users in its sight, tick by tick, to play or to drive again.
//!
//! A recording is one file, `states.jsonl.gz`: JSON Lines, compressed. Its first line is a [`Header`];
//! each further line is one tick. The ego is kept exactly; others to a millimetre, with a hash per
//! tick over every bit of the state ([`digest`]), to compare a second simulation with it.
//!
//! ```no_run
//! # fn example() -> Result<(), wad_sim::replay::ReplayError> {
//! use wad_sim::replay::Recording;
//! let recording = Recording::open("runs/nocrash/episodes/wad-t-000".as_ref())?;
//! for frame in recording.frames() {
//!     println!("{:.1} s: {:?}, {} others", frame.world.time, frame.ego.pose, frame.world.vehicles.len());
//! }
//! # Ok(())
//! # }
//! ```

mod format;
mod recorder;

pub use format::{Body, Header};
pub use recorder::{Moment, Recorder, digest};

use crate::bridge::TICK_MS;
use crate::criteria::{EgoOnRoute, Event};
use crate::tasks::Spot;
use flate2::read::GzDecoder;
use format::{FORMAT, Line, Memory};
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use sumo_network::world::{Actor, ActorKind, ActorType, VehicleSignals, WorldState};
use wad_vehicle::{Control, EgoParams, EgoState};

/// The recording's name in its folder.
pub const FILE: &str = "states.jsonl.gz";

/// Why a recording cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The file cannot be opened, read or written.
    #[error("cannot {what} the recording {}: {source}", path.display())]
    File {
        /// What failed: a verb.
        what: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file is not a recording.
    #[error(
        "{} is not a recording: {why}; expected a folder with {FILE}, as `eval` keeps of a failure, or that file",
        path.display()
    )]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
}

/// The state after one tick.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Ticks of the episode so far; 0 is the state before the first control.
    pub tick: u64,
    /// The tick's control, exactly.
    pub control: Control,
    /// The ego, exactly.
    pub ego: EgoState,
    /// Its place along its route (m).
    pub s: f64,
    /// Its offset to the left of its route (m).
    pub d: f64,
    /// Where its route was lengthened to since the tick before, in a drive without an end.
    pub onward: Vec<Spot>,
    /// The road users in its sight, to the millimetre, without their lanes; and the lights in its sight.
    pub world: WorldState,
    /// What happened in the tick.
    pub events: Vec<Event>,
    /// Hash of the whole state; see [`digest`].
    pub bits: u64,
}

impl Frame {
    /// The ego, `length` (m) long, on its route.
    pub fn on_route(&self, length: f64) -> EgoOnRoute {
        EgoOnRoute { state: self.ego, s: self.s, d: self.d, front_s: self.s + 0.5 * length }
    }

    /// Its size in memory (bytes).
    fn size(&self) -> usize {
        let world = &self.world;
        size_of::<Self>()
            + size_of_val(world.vehicles.as_slice())
            + size_of_val(world.pedestrians.as_slice())
            + size_of_val(world.traffic_lights.as_slice())
            + self.onward.iter().map(|spot| size_of_val(spot) + spot.lane.capacity()).sum::<usize>()
    }
}

/// A recording is as long as somebody made it: what is read of one is limited, line (bytes) and memory (bytes).
const LONGEST_LINE: u64 = 64 << 20;
const MOST_HELD: usize = 4 << 30;

/// Lines of at most [`LONGEST_LINE`].
struct Lines<R>(R);

impl<R: BufRead> Iterator for Lines<R> {
    type Item = std::io::Result<String>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut line = String::new();
        match self.0.by_ref().take(LONGEST_LINE).read_line(&mut line) {
            Ok(0) => None,
            Ok(_) if line.len() as u64 >= LONGEST_LINE => {
                let text = format!("a line is longer than {} MiB", LONGEST_LINE >> 20);
                Some(Err(std::io::Error::other(text)))
            }
            Ok(_) => Some(Ok(line)),
            Err(error) => Some(Err(error)),
        }
    }
}

/// A recording, read whole.
#[derive(Clone, Debug)]
pub struct Recording {
    header: Header,
    frames: Vec<Frame>,
}

impl Recording {
    /// Reads the recording at `path`: the file, or the folder that it lies in.
    ///
    /// # Errors
    /// It cannot be read, is not a recording, or is cut short.
    pub fn open(path: &Path) -> Result<Self, ReplayError> {
        let path = if path.is_dir() { path.join(FILE) } else { path.to_path_buf() };
        let broken = |why: String| ReplayError::Format { path: path.clone(), why };
        let file = File::open(&path).map_err(|source| ReplayError::File {
            what: "open",
            path: path.clone(),
            source,
        })?;
        let mut lines = Lines(BufReader::new(GzDecoder::new(BufReader::new(file))));
        let first = match lines.next() {
            Some(Ok(line)) => line,
            Some(Err(error)) => return Err(broken(error.to_string())),
            None => return Err(broken("it is empty".to_string())),
        };
        let header: Header = serde_json::from_str(&first).map_err(|e| broken(format!("its header: {e}")))?;
        if header.format != FORMAT {
            return Err(broken(format!("expected the format `{FORMAT}`, found `{}`", header.format)));
        }
        // Films and players wait for so long between two ticks.
        if !TICK_MS.contains(&header.tick_ms) {
            let (low, high) = (TICK_MS.start(), TICK_MS.end());
            return Err(broken(format!(
                "expected ticks of {low} to {high} ms, found {:?} ms",
                header.tick_ms
            )));
        }
        let mut memory = Memory::new(header.lights.len());
        let mut frames: Vec<Frame> = Vec::new();
        let mut held = 0;
        for (index, line) in lines.enumerate() {
            let line = line.map_err(|e| broken(format!("it is cut short after tick {index}: {e}")))?;
            let line: Line =
                serde_json::from_str(&line).map_err(|e| broken(format!("line {}: {e}", index + 2)))?;
            let frame = memory.frame(line).map_err(|why| broken(format!("line {}: {why}", index + 2)))?;
            held += frame.size();
            if held > MOST_HELD {
                return Err(broken(format!(
                    "its first {index} ticks take {} GiB of memory",
                    MOST_HELD >> 30
                )));
            }
            frames.push(frame);
        }
        if frames.is_empty() {
            return Err(broken("it has no ticks".to_string()));
        }
        Ok(Self { header, frames })
    }

    /// Its header.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The ticks, the state before the first control in front.
    pub fn frames(&self) -> &[Frame] {
        &self.frames
    }

    /// The ego of a frame as others see it, for cameras that look from outside.
    pub fn ego_actor(&self, frame: &Frame) -> Actor {
        self.header.ego.actor(&frame.ego)
    }
}

impl Body {
    /// The ego's.
    pub fn of(ego: &EgoParams) -> Self {
        Self { length: ego.length, width: ego.width, height: ego.height }
    }

    /// A car of this size in the motion `ego`, its brake lights lit when it slows down.
    pub fn actor(&self, ego: &EgoState) -> Actor {
        let actor_type = ActorType {
            id: "ego".to_string(),
            kind: ActorKind::Car,
            length: self.length,
            width: self.width,
            height: self.height,
            min_gap: 0.0,
        };
        let braking = if ego.acceleration < -0.5 { VehicleSignals::BRAKE_LIGHT } else { 0 };
        Actor {
            id: Arc::from("ego"),
            key: u64::MAX,
            actor_type: Arc::new(actor_type),
            pose: ego.pose,
            speed: ego.speed,
            signals: VehicleSignals(braking),
            lane: None,
            lane_position: 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumo_network::geometry::{Pose, Vector};
    use sumo_network::network::testing;
    use wad_camera::Preset;

    fn ego(x: f64) -> EgoState {
        EgoState {
            pose: Pose::new(x, 2.0, 0.0, 0.1),
            roll: 0.0,
            pitch: 0.0,
            velocity: Vector::zeros(),
            speed: 1.0 / 3.0,
            lateral_speed: 0.0,
            yaw_rate: 0.0,
            acceleration: -1.0,
            steer_angle: 0.0,
        }
    }

    fn other(id: &str, key: u64, x: f64) -> Actor {
        let actor_type = ActorType {
            id: "passenger".into(),
            kind: ActorKind::Car,
            length: 4.3,
            width: 1.8,
            height: 1.5,
            min_gap: 2.5,
        };
        Actor {
            id: Arc::from(id),
            key,
            actor_type: Arc::new(actor_type),
            pose: Pose::new(x, 0.1 + 0.2, 0.0, 3.0),
            speed: 7.123_456,
            signals: VehicleSignals(8),
            lane: None,
            lane_position: 0.0,
        }
    }

    fn header() -> Header {
        let ego = Body { length: 4.5, width: 1.9, height: 1.5 };
        let lights = vec!["near".to_string(), "far".to_string()];
        Header { lights, ..Header::new("town3", "town3", 167.0, Preset::WetNoon, ego) }
    }

    fn recorded() -> Recorder {
        let network = Arc::new(testing::net());
        let destinations = ["ab_0", "bc_0", "ca_0"].map(|lane| testing::place(&network, lane, 9.0));
        let mut recorder = Recorder::new(&header(), network);
        for tick in 0..3_u64 {
            let mut world = WorldState { tick, time: tick as f64 * 0.167, ..WorldState::default() };
            world.vehicles.push(other("car 1", 4, tick as f64));
            if tick > 0 {
                world.vehicles.push(other("car 2", 7, 5.0));
            }
            let state: Arc<str> = Arc::from(if tick < 2 { "rG" } else { "Gr" });
            world.traffic_lights = vec![None, (tick > 0).then_some(state)];
            let control = Control { throttle: 0.1 + 0.2, steer: -1.0 / 7.0, brake: 0.0, reverse: false };
            let events = if tick == 2 { vec![Event::Sidewalk] } else { Vec::new() };
            let ego = ego(tick as f64 / 3.0);
            recorder.add(&Moment {
                tick,
                control,
                ego: &ego,
                s: 1.0,
                d: 0.1,
                // The route is lengthened in the third tick.
                destinations: &destinations[..if tick < 2 { 1 } else { 3 }],
                world: &world,
                events: &events,
            });
        }
        recorder
    }

    #[test]
    fn what_was_recorded_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(FILE), recorded().bytes()).unwrap();
        let recording = Recording::open(folder.path()).unwrap();
        assert_eq!((recording.header().town.as_str(), recording.frames().len()), ("town3", 3));
        let last = &recording.frames()[2];
        assert_eq!(last.ego, ego(2.0 / 3.0));
        assert_eq!(
            last.control,
            Control { throttle: 0.1 + 0.2, steer: -1.0 / 7.0, brake: 0.0, reverse: false }
        );
        let ids: Vec<&str> = last.world.vehicles.iter().map(|actor| &*actor.id).collect();
        assert_eq!(ids, ["car 1", "car 2"]);
        assert!((last.world.vehicles[0].pose.position.x - 2.0).abs() < 1e-3);
        assert_eq!(last.world.vehicles[1].actor_type.length, 4.3);
        assert_eq!(recording.frames()[0].world.traffic_lights.get(1), Some(&None));
        assert_eq!(last.world.traffic_lights[1].as_deref(), Some("Gr"));
        assert_eq!(last.events, [Event::Sidewalk]);
        let onward = |tick: usize| -> Vec<(&str, f64)> {
            recording.frames()[tick].onward.iter().map(|spot| (&*spot.lane, spot.s)).collect()
        };
        assert_eq!((onward(0), onward(1)), (vec![], vec![]));
        assert_eq!(onward(2), [("bc_0", 9.0), ("ca_0", 9.0)]);
    }

    #[test]
    fn every_bit_counts_in_the_digest() {
        let (folder, mut changed) = (tempfile::tempdir().unwrap(), recorded());
        let (ego, mut world) = (ego(1.0), WorldState::default());
        world.vehicles.push(other("car 1", 4, 1.0));
        let moment = Moment {
            tick: 3,
            control: Control::default(),
            ego: &ego,
            s: 0.0,
            d: 0.0,
            destinations: &[],
            world: &world,
            events: &[],
        };
        changed.add(&moment);
        let mut second = world.clone();
        second.vehicles[0].pose.position.x = f64::from_bits(1.0_f64.to_bits() + 1);
        let other = Moment { world: &second, ..moment };
        assert_ne!(digest(&moment), digest(&other));
        std::fs::write(folder.path().join(FILE), changed.bytes()).unwrap();
        let recording = Recording::open(folder.path()).unwrap();
        assert_eq!(recording.frames()[3].bits, digest(&moment));
    }

    #[test]
    fn a_recording_that_would_fill_the_memory_or_has_no_ticks_or_odd_ones_is_refused() {
        use std::io::Write;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        std::fs::write(&path, recorded().bytes()).unwrap();
        let mut text = String::new();
        GzDecoder::new(File::open(&path).unwrap()).read_to_string(&mut text).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        let open = |lines: &[&str]| {
            let mut file = flate2::write::GzEncoder::new(File::create(&path).unwrap(), Default::default());
            lines.iter().for_each(|line| writeln!(file, "{line}").unwrap());
            file.finish().unwrap();
            Recording::open(&path).map(|recording| recording.frames().len()).map_err(|e| e.to_string())
        };
        assert_eq!(open(&lines), Ok(lines.len() - 1));
        assert!(open(&lines[..1]).unwrap_err().contains("no ticks"));
        let long = " ".repeat((LONGEST_LINE + 1) as usize);
        assert!(open(&[lines[0], &long]).unwrap_err().contains("longer than 64 MiB"));
        let lit = lines.iter().find(|line| line.contains("\"lights\":[[1")).unwrap();
        let far = lit.replace("\"lights\":[[1", "\"lights\":[[4000000000");
        assert!(open(&[lines[0], lines[1], &far]).unwrap_err().contains("light 4000000000 of 2"));
        // `replay` panicked, and a film never ended.
        for ms in ["-1.0", "0.0", "1e-300", "1e300"] {
            let odd = lines[0].replace("\"tick_ms\":167.0", &format!("\"tick_ms\":{ms}"));
            assert!(open(&[&odd, lines[1]]).unwrap_err().contains("ticks of 1 to 1000 ms"), "{ms}");
        }
    }

    #[test]
    fn a_recording_that_is_cut_short_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        let error = Recording::open(&path).unwrap_err().to_string();
        assert!(error.contains("states.jsonl.gz"), "{error}");
        std::fs::write(&path, recorded().bytes()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for keep in [0, 10, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..keep]).unwrap();
            assert!(Recording::open(&path).is_err(), "{keep} of {} bytes", bytes.len());
        }
    }
}
