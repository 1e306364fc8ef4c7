//! Readers of what others wrote, on damaged input: an error or a value, never a panic, and never more memory than a
//! stated multiple of the input.
//!
//! Each target is a function of bytes with seeds in `tests/data/fuzz/TARGET`. `WAD_COSIM_FUZZ=N` tries N inputs of
//! each, other ones at every run; `scripts/fuzz` seeks inputs that take new ways through the code. An input that
//! fails is saved; as one more seed it is tried first from then on.

mod memory;
mod targets;

use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestCaseError, TestError, TestRng, TestRunner};
use std::path::Path;
use targets::Target;

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

/// Tries a target on its seeds, then on `cases` damaged ones.
fn fuzz(name: &str, cases: u32) {
    let target = Target::new(name, env!("CARGO_MANIFEST_DIR"));
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
    let seeds = &target.seeds;
    let outcome = runner.run(&(any::<prop::sample::Index>(), damage()), |(seed, damage)| {
        target.check(&damaged(&seeds[seed.index(seeds.len())], &damage)).map_err(TestCaseError::fail)
    });
    if let Err(TestError::Fail(why, (seed, damage))) = outcome {
        let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("fuzz-{name}"));
        std::fs::write(&file, damaged(&seeds[seed.index(seeds.len())], &damage)).expect("written");
        panic!("{name}: {why}; the input is {}", file.display());
    } else {
        outcome.expect("inputs are made");
    }
}

#[test]
fn traci_answers() {
    fuzz("traci", 2000);
}

#[test]
fn networks() {
    fuzz("net", 600);
}

#[test]
fn configurations() {
    fuzz("sumocfg", 2000);
}

#[test]
fn recordings() {
    fuzz("recording", 1500);
}

#[test]
fn shards() {
    fuzz("shard", 1500);
}

#[test]
fn weights() {
    fuzz("weights", 4000);
}

#[test]
fn onnx_files() {
    fuzz("onnx", 4000);
}

#[test]
fn requests_of_viewers() {
    fuzz("view", 4000);
}

#[test]
fn answers_of_external_agents() {
    fuzz("pipe", 4000);
}

#[test]
fn each_target_is_guided_by_coverage_too() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |file: &str| std::fs::read_to_string(root.join(file)).expect("a file");
    let (manifest, script) = (read("fuzz/Cargo.toml"), read("scripts/fuzz"));
    let list =
        script.lines().find_map(|line| line.strip_prefix("targets=(")?.strip_suffix(')')).expect("a list");
    for target in std::fs::read_dir(root.join("tests/data/fuzz")).expect("seeds") {
        let name = target.expect("a target").file_name().into_string().expect("a name");
        assert!(manifest.contains(&format!("name = \"{name}\"\npath")), "fuzz/Cargo.toml lacks {name}");
        assert!(list.split(' ').any(|listed| listed == name), "scripts/fuzz lacks {name}");
    }
}
