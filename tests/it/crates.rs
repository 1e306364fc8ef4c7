//! The examples of the crates that can be used alone, run as a user runs them.

use super::program::stderr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use wad_cosim::network::Network;

/// What an example prints. Built here, for `cargo test --test it` builds no examples; with the features that
/// the workspace's dependencies have together, so that none of them is built twice.
fn example(name: &str, arguments: &[&Path]) -> String {
    let binaries = Path::new(env!("CARGO_BIN_EXE_wad-cosim")).parent().unwrap();
    let profile = if binaries.ends_with("debug") { "dev" } else { "release" };
    let built = Command::new(env!("CARGO"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(["build", "--quiet", "--locked", "--workspace", "--profile", profile, "--example", name])
        .arg("--target-dir")
        .arg(binaries.parent().unwrap())
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(built.status.success(), "{name}: {}", stderr(&built));
    let output = Command::new(binaries.join("examples").join(name))
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(output.status.success(), "{name}: {}", stderr(&output));
    String::from_utf8(output.stdout).unwrap()
}

fn town5(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("sumo_nets/town5").join(file)
}

#[test]
fn sumo_traci_watches_a_sumo() {
    let text = example("watch", &[&town5("town5.sumocfg"), Path::new("120")]);
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 120, "{text}");
    // town5's step is 0.167 s long.
    assert!(lines[0].starts_with("0.167 s: ") && lines[119].starts_with("20.040 s: "), "{text}");
    let words: Vec<&str> = lines[119].split_whitespace().collect();
    let (vehicles, speed): (u32, f64) = (words[2].parse().unwrap(), words[4].parse().unwrap());
    assert!(vehicles >= 3, "{}", lines[119]);
    assert!((1.0..20.0).contains(&speed), "{}", lines[119]);
}

#[test]
fn sumo_network_finds_a_route() {
    let net = town5("town5.net.xml");
    let text = example("route", &[&net, Path::new("E3NE2"), Path::new("SE2SE1")]);
    let network = Network::load(&net).unwrap();
    let signals = format!("{} traffic lights", network.traffic_lights.len());
    assert!(text.lines().next().unwrap().ends_with(&signals), "{text}");
    let edges = text.lines().find_map(|line| line.strip_prefix("edges: ")).unwrap();
    let edges: Vec<_> = edges.split(' ').map(|id| network.edge_by_id(id).unwrap()).collect();
    assert_eq!(network.edge(edges[0]).id, "E3NE2");
    assert_eq!(network.edge(*edges.last().unwrap()).id, "SE2SE1");
    // Each edge begins at the junction at which the one before it ends.
    assert!(edges.windows(2).all(|pair| network.edge(pair[0]).to == network.edge(pair[1]).from), "{text}");
    let length: f64 = text.lines().last().unwrap().trim().split(' ').next().unwrap().parse().unwrap();
    let driven: f64 = edges[1..edges.len() - 1]
        .iter()
        .map(|&edge| network.lane(network.edge(edge).lanes[0]).shape.length())
        .sum();
    assert!(length > driven, "{length} m with {driven} m of whole edges");
}

#[test]
fn wad_vehicle_drives_a_circle() {
    let text = example("circle", &[Path::new("40")]);
    let rows: Vec<Vec<f64>> = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|number| number.parse().unwrap()).collect())
        .collect();
    assert_eq!(rows.len(), 40, "{text}");
    assert!(rows[10..].iter().all(|row| (row[4] - 8.0).abs() < 0.5), "{text}");
    // The middle of the second half of the way, and the distance of each place from it.
    let places = &rows[10..];
    let (first, turned) =
        (&places[0], |row: &[f64]| (row[3] - places[0][3]).rem_euclid(std::f64::consts::TAU));
    let opposite = places.iter().min_by(|a, b| {
        (turned(a) - std::f64::consts::PI).abs().total_cmp(&(turned(b) - std::f64::consts::PI).abs())
    });
    let opposite = opposite.unwrap();
    let radius = 0.5 * (first[1] - opposite[1]).hypot(first[2] - opposite[2]);
    assert!((8.0..40.0).contains(&radius), "{radius} m\n{text}");
    // The way in 30 s goes round more than once, and never further away than the circle is wide.
    assert!(29.0 * 8.0 > std::f64::consts::TAU * radius, "{radius} m\n{text}");
    let far = places.iter().map(|row| (row[1] - first[1]).hypot(row[2] - first[2])).fold(0.0, f64::max);
    assert!(far < 2.2 * radius, "{far} m away on a circle of {radius} m\n{text}");
}

#[test]
fn wad_camera_takes_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("town5.png");
    let text = example("picture", &[&town5("town5.net.xml"), &path]);
    // The car stands 15 m ahead of the footprint's middle, and the camera 0.7 m.
    let car =
        text.lines().find(|line| line.starts_with("Car 14.3 m ahead")).unwrap_or_else(|| panic!("{text}"));
    let corner: u32 = car.split([' ', ',']).nth(4).unwrap().parse().unwrap();
    assert!((150..256).contains(&corner), "{car}");
    let file = std::io::BufReader::new(std::fs::File::open(&path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    assert_eq!((info.width, info.height), (512, 512));
    let grey =
        |row: usize| bytes[3 * 512 * row..3 * 512 * (row + 1)].iter().map(|&b| u32::from(b)).sum::<u32>();
    assert!(grey(10) > grey(500), "the sky is brighter than the road");
}
