//! Readers of what others wrote, on damaged input: an error or a value, never a panic, and never more memory than a
//! stated multiple of the input.
//!
//! Each target is a function of bytes with seeds in `tests/data/fuzz/TARGET`. `WAD_COSIM_FUZZ=N` tries N inputs of
//! each, other ones at every run. An input that fails is saved; as one more seed it is tried first from then on.

mod memory;

use super::network::nets::Random;
use flate2::{Compression, write::GzEncoder};
use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestCaseError, TestError, TestRng, TestRunner};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use wad_cosim::geometry::Point;
use wad_cosim::network::{Network, VehicleClass};
use wad_cosim::sumo_config::{OptionSchema, SumoConfig};
use wad_cosim::traci::domains::vehicle;
use wad_cosim::traci::{Batch, Client, SumoInstall};

/// One change of an input: its kind, where, how long, and a byte.
type Damage = (u8, usize, usize, u8);

fn damage() -> impl Strategy<Value = Vec<Damage>> {
    proptest::collection::vec((any::<u8>(), any::<usize>(), any::<usize>(), any::<u8>()), 1..6)
}

/// What numbers and names are replaced with.
const WORDS: [&[u8]; 12] = [
    b"",
    b"-1",
    b"1e308",
    b"NaN",
    b"4294967295",
    b"18446744073709551615",
    b"99999999999999999999999",
    b"\xff\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    b"\x7f\xff\xff\xff",
    b"\0\0\0\0",
    b"\xf0\xff\xff\xff\xff\xff\xff\xff",
];

/// The input with bytes changed, parts cut out, doubled or repeated, numbers replaced, or its end cut off.
fn damaged(seed: &[u8], damage: &[Damage]) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for &(kind, at, length, byte) in damage {
        if bytes.is_empty() {
            break;
        }
        let at = at % bytes.len();
        let end = (at + length % 60).min(bytes.len());
        let word = WORDS[byte as usize % WORDS.len()];
        match kind % 8 {
            0 => bytes.truncate(at),
            1 => drop(bytes.drain(at..end)),
            2 => {
                let part = bytes[at..end].to_vec();
                bytes.splice(at..at, part);
            }
            3 => bytes[at..end].reverse(),
            4 => bytes[at] = byte,
            5 => drop(bytes.splice(at..(at + word.len()).min(bytes.len()), word.iter().copied())),
            6 => {
                // The next number or word as a whole.
                let is_part = |b: &u8| b.is_ascii_alphanumeric() || b"+-._".contains(b);
                let from = bytes[at..].iter().position(is_part).map_or(at, |skip| at + skip);
                let to = bytes[from..].iter().position(|b| !is_part(b)).map_or(bytes.len(), |n| from + n);
                bytes.splice(from..to, word.iter().copied());
            }
            _ => {
                let part = bytes[at..end].repeat(usize::from(byte) * 8);
                bytes.splice(at..at, part);
            }
        }
    }
    bytes
}

/// Most bytes that a reader may hold for any input.
#[derive(Clone, Copy)]
struct Memory {
    /// For each byte of the input.
    times: usize,
    /// On top: buffers that do not depend on the input.
    base: usize,
}

/// Tens of bytes for each of the input's, and buffers of a fixed size.
const USUAL: Memory = Memory { times: 10, base: 1 << 20 };

/// Tries a target on its seeds, then on `cases` damaged ones. A target says whether it accepts an input; seeds are
/// accepted, but for those that earlier runs found (`found-...`).
fn fuzz(target: &str, cases: u32, memory: Memory, run: impl Fn(&[u8]) -> bool) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/fuzz").join(target);
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(&folder).expect("seeds").map(|entry| entry.expect("a seed").path()).collect();
    files.sort();
    let seeds: Vec<Vec<u8>> = files.iter().map(|file| std::fs::read(file).expect("a seed")).collect();
    let check = |input: &[u8]| {
        let limit = memory.base + memory.times * input.len();
        let peak = memory::peak(|| {
            run(input);
        });
        if peak <= limit { Ok(()) } else { Err(format!("{peak} bytes of memory for {} bytes", input.len())) }
    };
    // A seed that is refused at once leads nowhere. After this, what does not depend on the input (tables, caches)
    // is there too.
    for (file, seed) in files.iter().zip(&seeds) {
        let found = file.file_name().is_some_and(|name| name.to_string_lossy().starts_with("found-"));
        assert!(run(seed) || found, "{} is refused", file.display());
    }
    for (file, seed) in files.iter().zip(&seeds) {
        check(seed).unwrap_or_else(|why| panic!("{}: {why}", file.display()));
    }
    let asked = std::env::var("WAD_COSIM_FUZZ").ok().map(|n| n.parse().expect("WAD_COSIM_FUZZ is a number"));
    let config = ProptestConfig {
        cases: asked.unwrap_or(cases),
        failure_persistence: None,
        max_shrink_iters: 2000,
        ..ProptestConfig::default()
    };
    let mut runner = match asked {
        Some(_) => TestRunner::new(config),
        None => TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha)),
    };
    let outcome = runner.run(&(any::<prop::sample::Index>(), damage()), |(seed, damage)| {
        check(&damaged(&seeds[seed.index(seeds.len())], &damage)).map_err(TestCaseError::fail)
    });
    if let Err(TestError::Fail(why, (seed, damage))) = outcome {
        let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("fuzz-{target}"));
        std::fs::write(&file, damaged(&seeds[seed.index(seeds.len())], &damage)).expect("written");
        panic!("{target}: {why}; the input is {}", file.display());
    } else {
        outcome.expect("inputs are made");
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

#[test]
fn traci_answers() {
    let version = b"\x07\0\0\0\0\0\0\x0f\0\0\0\0\x16\0\0\0\x05SUMO9".to_vec();
    let order = b"\x07\x03\0\0\0\0\0".to_vec();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().expect("a runtime");
    fuzz("traci", 2000, USUAL, |input| {
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
    });
}

#[test]
fn networks() {
    // A network is tables for search over its lanes, whose points are text of a few bytes.
    let memory = Memory { times: 100, base: 4 << 20 };
    fuzz("net", 600, memory, |input| {
        let text = String::from_utf8_lossy(input);
        let network = Network::from_xml(Path::new("fuzz.net.xml"), &text);
        network.is_ok_and(|network| {
            exercise(&network);
            true
        })
    });
}

/// Uses all there is of a network that may be nonsense.
fn exercise(network: &Network) {
    network.lanes_near(Point::new(50.0, 50.0), Some(0.0), 100.0);
    let lanes = network.largest_component(VehicleClass::Passenger);
    let mut random = Random(1);
    for _ in 0..if lanes.is_empty() { 0 } else { 5 } {
        let (from, to) = (random.place(network, &lanes), random.place(network, &lanes));
        if let Ok(route) = network.route(from, to, VehicleClass::Passenger) {
            assert!(route.at(0.5 * route.length()).pose.position.x.is_finite());
        }
    }
    for &edge in network.sidewalk_edges().iter().take(3) {
        network.walk_route(edge, network.sidewalk_edges()[0]);
    }
}

#[test]
fn configurations() {
    let install = SumoInstall::find().expect("SUMO");
    let schema = OptionSchema::cached(&install, false).expect("SUMO's options");
    let read = on_file("fuzz.sumocfg", |file| {
        let Ok(config) = SumoConfig::load(file, &schema) else { return false };
        let _ = (config.route_files(), config.town(), config.time("begin"), config.seed());
        config.net_file().is_ok()
    });
    // A list of names of few letters becomes paths of 24 bytes and their text.
    fuzz("sumocfg", 2000, Memory { times: 100, base: 1 << 20 }, read);
}

#[test]
fn recordings() {
    let read = on_file("states.jsonl.gz", |file| wad_cosim::replay::Recording::open(file).is_ok());
    // Damage before compression, since damage after it is found by gzip's checksum.
    fuzz("recording", 1500, Memory { times: 100, base: 1 << 20 }, |text| {
        let mut gz = GzEncoder::new(Vec::new(), Compression::fast());
        gz.write_all(text).expect("memory");
        read(text);
        read(&gz.finish().expect("memory"))
    });
}

#[test]
fn shards() {
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
    fuzz("shard", 1500, USUAL, |input| read(input) & read(&with_checksums(input)));
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

#[test]
fn weights() {
    fuzz("weights", 4000, USUAL, |input| {
        let weights = wad_see::weights::Weights::parse(Path::new("fuzz.safetensors"), input);
        weights.is_ok_and(|weights| {
            weights.tensors.iter().any(|(name, _)| weights.floats(name, &[2, 3]).is_ok())
        })
    });
}

#[test]
fn onnx_files() {
    fuzz("onnx", 4000, USUAL, |input| wad_cosim::perception::onnx_file::input(input).is_ok());
}

#[test]
fn requests_of_viewers() {
    fuzz("view", 4000, USUAL, |input| {
        wad_cosim::view::Request::parse(&String::from_utf8_lossy(input)).is_ok()
    });
}

#[test]
fn answers_of_external_agents() {
    fuzz("pipe", 4000, USUAL, |input| {
        wad_cosim::agent::external::read_control(&String::from_utf8_lossy(input)).is_ok()
    });
}
