//! The readers of what others wrote, each as a function of bytes: for the tests beside this file, and for `fuzz/`.

use super::memory;
use flate2::{Compression, write::GzEncoder};
use std::io::Write;
use std::path::Path;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use wad_cosim::geometry::Point;
use wad_cosim::network::{LanePosition, Network, VehicleClass};
use wad_cosim::sumo_config::{OptionSchema, SumoConfig};
use wad_cosim::traci::domains::vehicle;
use wad_cosim::traci::{Batch, Client, SumoInstall};

/// A reader: whether it accepts these bytes.
type Read = Box<dyn Fn(&[u8]) -> bool>;

/// Most bytes that a reader may hold for any input.
struct Memory {
    /// For each byte of the input.
    times: usize,
    /// On top: buffers that do not depend on the input.
    base: usize,
}

/// Tens of bytes for each of the input's, and buffers of a fixed size.
const USUAL: Memory = Memory { times: 10, base: 1 << 20 };
/// Text of a few bytes becomes points and rows of tables, or paths of 24 bytes and their text.
const TABLES: Memory = Memory { times: 100, base: 1 << 20 };

/// A reader, what it may hold, and inputs to begin with.
pub struct Target {
    read: Read,
    memory: Memory,
    /// What to begin with: `tests/data/fuzz/NAME`.
    pub seeds: Vec<Vec<u8>>,
}

impl Target {
    /// The target of this name in the checkout at `root`, after it has read each seed without an error. Seeds are
    /// accepted, but for those that earlier runs found (`found-...`): a seed that is refused at once leads nowhere.
    pub fn new(name: &str, root: &str) -> Self {
        let (memory, read) = match name {
            "net" => (Memory { base: 4 << 20, ..TABLES }, networks()),
            "onnx" => (USUAL, onnx_files()),
            "pipe" => (USUAL, answers_of_external_agents()),
            "recording" => (TABLES, recordings()),
            "shard" => (USUAL, shards()),
            "sumocfg" => (TABLES, configurations()),
            "traci" => (USUAL, traci_answers()),
            "view" => (USUAL, requests_of_viewers()),
            "weights" => (USUAL, weights()),
            _ => panic!("no target {name}"),
        };
        let folder = Path::new(root).join("tests/data/fuzz").join(name);
        let mut files: Vec<_> =
            std::fs::read_dir(&folder).expect("seeds").map(|entry| entry.expect("a seed").path()).collect();
        files.sort();
        let seeds = files.iter().map(|file| std::fs::read(file).expect("a seed")).collect();
        let target = Target { read, memory, seeds };
        // After this, what does not depend on the input (tables, caches) is there too.
        for (file, seed) in files.iter().zip(&target.seeds) {
            let found = file.file_name().is_some_and(|name| name.to_string_lossy().starts_with("found-"));
            assert!((target.read)(seed) || found, "{} is refused", file.display());
        }
        for (file, seed) in files.iter().zip(&target.seeds) {
            target.check(seed).unwrap_or_else(|why| panic!("{}: {why}", file.display()));
        }
        target
    }

    /// Reads the input, which may panic. The error is that it held too much memory.
    pub fn check(&self, input: &[u8]) -> Result<(), String> {
        let limit = self.memory.base + self.memory.times * input.len();
        let peak = memory::peak(|| {
            (self.read)(input);
        });
        if peak <= limit { Ok(()) } else { Err(format!("{peak} bytes of memory for {} bytes", input.len())) }
    }
}

/// A reader that takes a file: what it does with a file of these bytes.
fn on_file(name: &str, read: impl Fn(&Path) -> bool) -> impl Fn(&[u8]) -> bool {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join(name);
    move |input| {
        let _ = &folder;
        std::fs::write(&file, input).expect("written");
        read(&file)
    }
}

/// A length field and a body, as TraCI frames a message.
fn message(body: &[u8]) -> Vec<u8> {
    [&(body.len() as u32 + 4).to_be_bytes()[..], body].concat()
}

fn traci_answers() -> Read {
    let version = b"\x07\0\0\0\0\0\0\x0f\0\0\0\0\x16\0\0\0\x05SUMO9".to_vec();
    let order = b"\x07\x03\0\0\0\0\0".to_vec();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().expect("a runtime");
    Box::new(move |input| {
        runtime.block_on(async {
            let (ours, mut theirs) = tokio::io::duplex(1 << 16);
            let serve = async {
                for body in [&version[..], &order, input] {
                    let length = theirs.read_u32().await?;
                    theirs.read_exact(&mut vec![0; length as usize - 4]).await?;
                    theirs.write_all(&message(body)).await?;
                }
                drop(theirs);
                std::io::Result::Ok(())
            };
            let ask = async {
                let mut client = Client::handshake(ours, 1, Duration::from_secs(60)).await.expect("a client");
                let mut batch = Batch::new();
                let speed = batch.get(vehicle::SPEED, "v");
                batch.step();
                let Ok(replies) = client.send(&batch).await else { return false };
                let _ = (replies.get(speed), replies.check());
                for result in replies.subscriptions().iter() {
                    for object in result.objects() {
                        let _ = (object.value(vehicle::SPEED), object.str(vehicle::ROAD_ID));
                        let _ = object.strings(vehicle::ROUTE);
                    }
                }
                true
            };
            tokio::join!(serve, ask).1
        })
    })
}

fn networks() -> Read {
    Box::new(|input| {
        let text = String::from_utf8_lossy(input);
        let network = Network::from_xml(Path::new("fuzz.net.xml"), &text);
        network.is_ok_and(|network| {
            exercise(&network);
            true
        })
    })
}

/// Uses all there is of a network that may be nonsense.
fn exercise(network: &Network) {
    network.lanes_near(Point::new(50.0, 50.0), Some(0.0), 100.0);
    let lanes = network.largest_component(VehicleClass::Passenger);
    let place = |n: usize| {
        let lane = lanes[n % lanes.len()];
        LanePosition { lane, s: network.lane(lane).shape.length() * (n % 10) as f64 / 10.0 }
    };
    for n in 0..if lanes.is_empty() { 0 } else { 5 } {
        if let Ok(route) = network.route(place(7 * n), place(13 * n + 3), VehicleClass::Passenger) {
            assert!(route.at(0.5 * route.length()).pose.position.x.is_finite());
        }
    }
    for &edge in network.sidewalk_edges().iter().take(3) {
        network.walk_route(edge, network.sidewalk_edges()[0]);
    }
}

fn configurations() -> Read {
    let install = SumoInstall::find().expect("SUMO");
    let schema = OptionSchema::cached(&install, false).expect("SUMO's options");
    Box::new(on_file("fuzz.sumocfg", move |file| {
        let Ok(config) = SumoConfig::load(file, &schema) else { return false };
        let _ = (config.route_files(), config.town(), config.time("begin"), config.seed());
        config.net_file().is_ok()
    }))
}

/// Damage before compression, since damage after it is found by gzip's checksum.
fn recordings() -> Read {
    let read = on_file("states.jsonl.gz", |file| wad_cosim::replay::Recording::open(file).is_ok());
    Box::new(move |text| {
        let mut gz = GzEncoder::new(Vec::new(), Compression::fast());
        gz.write_all(text).expect("memory");
        read(text);
        read(&gz.finish().expect("memory"))
    })
}

fn shards() -> Read {
    let read = on_file("fuzz.wads", |file| {
        let Ok(mut shard) = wad_cosim::dataset::ShardReader::open(file) else { return false };
        let mut frames = 0;
        while let Ok(Some(_)) = shard.next_frame() {
            frames += 1;
        }
        let Ok(mut shard) = wad_cosim::dataset::ShardReader::open(file) else { return false };
        while let Ok(Some((_, place))) = shard.next_place() {
            let _ = place.read();
        }
        frames > 0
    });
    Box::new(move |input| read(input) & read(&with_checksums(input)))
}

/// A shard whose frames have the checksums of what they hold, so that damage gets past them.
fn with_checksums(shard: &[u8]) -> Vec<u8> {
    let mut shard = shard.to_vec();
    let number = |shard: &[u8], at: usize| {
        shard.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize)
    };
    let mut at = number(&shard, 8).map_or(usize::MAX, |header| 12_usize.saturating_add(header));
    while let Some(length) = at.checked_add(8).and_then(|_| number(&shard, at)) {
        let Some(payload) = shard.get(at + 8..at.saturating_add(8).saturating_add(length)) else { break };
        let sum = crc32fast::hash(payload).to_le_bytes();
        shard[at + 4..at + 8].copy_from_slice(&sum);
        at += 8 + length;
    }
    shard
}

fn weights() -> Read {
    Box::new(|input| {
        let weights = wad_see::weights::Weights::parse(Path::new("fuzz.safetensors"), input);
        weights.is_ok_and(|weights| {
            weights.tensors.iter().any(|(name, _)| weights.floats(name, &[2, 3]).is_ok())
        })
    })
}

fn onnx_files() -> Read {
    Box::new(|input| wad_cosim::perception::onnx_file::input(input).is_ok())
}

fn requests_of_viewers() -> Read {
    Box::new(|input| wad_cosim::view::Request::parse(&String::from_utf8_lossy(input)).is_ok())
}

fn answers_of_external_agents() -> Read {
    Box::new(|input| wad_cosim::agent::external::read_control(&String::from_utf8_lossy(input)).is_ok())
}
