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

/// The number before `unit` in a line, e.g. 4.5 before "m/s".
fn before(line: &str, unit: &str) -> f64 {
    let words: Vec<&str> = line.split([' ', ',']).filter(|word| !word.is_empty()).collect();
    let at = words.iter().position(|word| *word == unit).unwrap_or_else(|| panic!("no {unit} in {line}"));
    words[at - 1]
        .trim_start_matches('(')
        .parse()
        .unwrap_or_else(|_| panic!("no number before {unit}: {line}"))
}

#[test]
fn wad_sim_drives_two_egos() {
    let text = example("two_egos", &[Path::new("town3"), Path::new("200")]);
    for ego in ["first", "second"] {
        let poses: Vec<(f64, f64, f64, f64)> = text
            .lines()
            .filter(|line| line.contains(&format!(" s: {ego}: x ")))
            .map(|line| {
                let number = |label: &str| {
                    line.split_once(label).unwrap().1.split(' ').next().unwrap().parse().unwrap()
                };
                (before(line, "s:"), number(" x "), number(" y "), before(line, "m/s"))
            })
            .collect();
        assert_eq!(poses.len(), 200, "{text}");
        let mut way = 0.0;
        for pair in poses.windows(2) {
            let ((t0, x0, y0, v0), (t1, x1, y1, v1)) = (pair[0], pair[1]);
            // A second apart, and not further than the speed allows: it changes by less than 8 m/s2.
            let moved = (x1 - x0).hypot(y1 - y0);
            assert!((0.8..1.2).contains(&(t1 - t0)), "{pair:?}");
            assert!(moved <= (v0.max(v1) + 4.0) * (t1 - t0), "{ego}: {pair:?}");
            way += moved;
        }
        assert!(way > 500.0, "{ego} drove {way} m\n{text}");
        assert!(text.contains(&format!(" s: {ego}: Arrival")), "{text}");
    }
    assert!(!text.contains("Collision"), "{text}");
}

#[cfg(feature = "vision")]
#[test]
fn wad_see_sees_the_vehicle_in_front_at_a_red_light() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transformed.png");
    let text = example("eyes", &[Path::new("town3"), &path, Path::new("20")]);
    let looks: Vec<&str> = text.lines().filter(|line| line.contains(" sees ")).collect();
    assert_eq!(looks.len(), 20, "{text}");
    // A lorry waits at a red light, and the ego behind it.
    let last = looks[19];
    assert!(before(last, "m/s").abs() < 0.1, "{text}");
    let gap: f64 = last.split_once("gap ").unwrap().1.split(' ').next().unwrap().parse().unwrap();
    assert!((1.0..6.0).contains(&gap), "{text}");
    assert!(last.contains("Red in ") && last.contains("Truck: 1"), "{text}");

    let file = std::io::BufReader::new(std::fs::File::open(&path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    assert_eq!((info.width, info.height), (128, 128));
    let painted = |colour: [u8; 3]| bytes.chunks_exact(3).filter(|pixel| *pixel == colour).count();
    assert!(painted([0, 0, 255]) > 50, "the lorry is painted blue");
    assert!(painted([255, 0, 0]) > 50, "the way is painted red: the light is red");
}

#[cfg(feature = "vision")]
#[test]
fn wad_learn_names_the_terms_of_a_reward() {
    let text = example("episode", &[Path::new("town3"), Path::new("0.4")]);
    let terms = |line: &str| -> Vec<f64> {
        let terms = line.rsplit_once(": ").unwrap().1;
        terms.split(", ").map(|term| term.split_once(' ').unwrap().1.parse().unwrap()).collect()
    };
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[0], "an observation has 215 numbers");
    // A wheel that is held still leaves the lane.
    let end =
        lines.iter().find(|line| line.starts_with("terminated after ")).unwrap_or_else(|| panic!("{text}"));
    assert!(end.contains("outside_lane"), "{text}");
    let ticks: f64 = end.split(' ').nth(2).unwrap().parse().unwrap();
    let sums = terms(lines.iter().find(|line| line.starts_with("sums: ")).unwrap());
    assert_eq!(sums.len(), 6, "{text}");
    let total: f64 = lines.last().unwrap().strip_prefix("return: ").unwrap().parse().unwrap();
    assert!((sums.iter().sum::<f64>() - total).abs() < 0.01, "{text}");
    // It gets faster from second to second, and each tick gives the same for driving on.
    let driving: Vec<&str> = lines.iter().copied().filter(|line| line.contains("m/s: ")).collect();
    let speeds: Vec<f64> = driving.iter().map(|line| before(line, "m/s:")).collect();
    assert!(speeds.len() > 5 && speeds.windows(2).all(|pair| pair[0] < pair[1]), "{text}");
    assert!(driving.iter().all(|line| terms(line)[5] == terms(driving[0])[5]), "{text}");
    assert!((sums[5] - ticks * terms(driving[0])[5]).abs() < 0.01, "{text}");
}
