//! Golden pictures: the camera's output when a person last approved it.
//!
//! `WAD_COSIM_GOLDEN=write cargo test --release --lib golden` writes them anew; look at them before
//! committing. The tolerance admits small changes of shading, texture and edges, as a faster renderer
//! brings: [`LIGHT`] grey levels of 255 in the mean, and [`BLOCK`] in nearly every block of 8 x 8 pixels.
//! It does not admit anything that is missing, moved by half a metre, or of another colour.

use super::places::Place;
use crate::{Frame, Preset};
use std::path::PathBuf;
use sumo_network::geometry::{Pose, Vector};

const SIZE: usize = 128;
/// Mean absolute difference of the channels (grey levels).
const LIGHT: f64 = 4.0;
/// Difference of a block's mean (grey levels), and the share of blocks that may exceed it.
const BLOCK: f64 = 8.0;
const STRAY: f64 = 0.03;

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(format!("{name}.png"))
}

/// Mean absolute difference, and the share of blocks whose means differ by more than [`BLOCK`].
fn difference(a: &[u8], b: &[u8]) -> (f64, f64) {
    let mean = a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64;
    let blocks = SIZE / 8;
    let block = |rgb: &[u8], n: usize, channel: usize| -> f64 {
        let (x0, y0) = (n % blocks * 8, n / blocks * 8);
        let pixel = |k: usize| rgb[3 * ((y0 + k / 8) * SIZE + x0 + k % 8) + channel];
        (0..64).map(|k| f64::from(pixel(k))).sum::<f64>() / 64.0
    };
    let strays = (0..blocks * blocks)
        .filter(|&n| (0..3).any(|c| (block(a, n, c) - block(b, n, c)).abs() > BLOCK))
        .count();
    (mean, strays as f64 / (blocks * blocks) as f64)
}

fn is_alike((mean, strays): (f64, f64)) -> bool {
    mean <= LIGHT && strays <= STRAY
}

fn read(name: &str) -> Vec<u8> {
    let file = std::fs::File::open(path(name)).unwrap_or_else(|e| panic!("{}: {e}", path(name).display()));
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().unwrap();
    let mut bytes = vec![0; 3 * SIZE * SIZE];
    reader.next_frame(&mut bytes).unwrap();
    bytes
}

/// The picture, and the same from half a metre to the side.
fn shots(town: &str, weather: Preset, ego: Pose, users: &[(usize, f64, f64, f64)]) -> [Frame; 2] {
    let mut place = Place::bundled(town);
    let at = |&(kind, ahead, left, turn): &(usize, f64, f64, f64)| {
        let p = ego.to_world(Vector::new(ahead, left));
        (kind, Pose::new(p.x, p.y, ego.position.z, ego.heading + turn))
    };
    place.put(&users.iter().map(at).collect::<Vec<_>>());
    let aside = ego.to_world(Vector::new(0.0, 0.5));
    let aside = Pose::new(aside.x, aside.y, ego.position.z, ego.heading);
    [ego, aside].map(|pose| place.shoot(SIZE, &pose, weather))
}

fn golden(name: &str, town: &str, weather: Preset, ego: Pose, users: &[(usize, f64, f64, f64)]) {
    let [frame, aside] = shots(town, weather, ego, users);
    if std::env::var_os("WAD_COSIM_GOLDEN").is_some_and(|v| v == "write") {
        crate::Picture::rgb(&frame).save(&path(name)).unwrap();
    }
    let kept = read(name);
    let found = difference(&frame.rgb, &kept);
    let hint = "look at target/golden, and see crates/wad-camera/src/tests/golden.rs on how to renew them";
    if !is_alike(found) {
        let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../target/golden");
        crate::Picture::rgb(&frame).save(&folder.join(format!("{name}.png"))).unwrap();
    }
    assert!(is_alike(found), "{name}: mean {:.1}, {:.0} % of blocks; {hint}", found.0, 100.0 * found.1);
    // The measure sees what it should see.
    assert!(!is_alike(difference(&aside.rgb, &kept)), "{name}: half a metre aside looks alike");
}

const RIGHT: f64 = -std::f64::consts::FRAC_PI_2;

#[test]
fn golden_straight_at_noon() {
    let ego = Pose::new(142.0, 60.0, 0.0, -RIGHT);
    golden(
        "straight-noon",
        "town5",
        Preset::ClearNoon,
        ego,
        &[(1, 14.0, 0.0, 0.0), (3, 16.0, 4.6, 2.0 * RIGHT), (6, 9.0, -1.8, 0.0)],
    );
}

#[test]
fn golden_crossing_at_sunset() {
    let ego = Pose::new(142.0, 120.0, 0.0, -RIGHT);
    golden(
        "crossing-sunset",
        "town5",
        Preset::ClearSunset,
        ego,
        &[(7, 6.0, 0.5, RIGHT), (7, 7.5, 1.8, -RIGHT), (0, 15.0, 3.4, 2.0 * RIGHT)],
    );
}

#[test]
fn golden_jam_in_the_rain() {
    let ego = Pose::new(137.9, 90.0, 0.0, RIGHT);
    golden(
        "jam-rain",
        "town5",
        Preset::HardRainNoon,
        ego,
        &[(0, 8.5, 0.0, 0.0), (4, 18.0, 0.0, 0.0), (5, 10.0, 4.0, 2.0 * RIGHT)],
    );
}
