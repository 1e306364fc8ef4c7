//! Nets to test with, and driving random routes over them.

use std::path::{Path, PathBuf};
use std::time::Instant;
use tempfile::TempDir;
use wad_cosim::geometry::wrap_angle;
use wad_cosim::network::*;
use wad_cosim::traci::SumoInstall;

/// A folder with nets in it; gone when dropped.
pub struct Nets {
    folder: TempDir,
    sumo: SumoInstall,
}

impl Nets {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap(), sumo: SumoInstall::find().unwrap() }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    /// Runs one of SUMO's programs to its successful end.
    pub fn run(&self, program: &str, arguments: &[&str]) {
        let mut command = self.sumo.command(program);
        let output = command.args(arguments).current_dir(self.folder.path()).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{program} {arguments:?}: {said}");
    }

    /// A net made by netgenerate (or netconvert).
    pub fn make(&self, program: &str, arguments: &[&str]) -> (PathBuf, Network) {
        let count = std::fs::read_dir(self.folder.path()).unwrap().count();
        let path = self.path(&format!("made{count}.net.xml"));
        self.run(program, &[arguments, &["-o", &path.display().to_string()]].concat());
        let network = Network::load(&path).unwrap();
        (path, network)
    }

    /// A town grid with signals, two lanes each way, sidewalks and crossings.
    pub fn grid(&self) -> (PathBuf, Network) {
        self.make(
            "netgenerate",
            &[
                "--grid",
                "--grid.number",
                "4",
                "--grid.length",
                "160",
                "-L",
                "2",
                "-j",
                "traffic_light",
                "--default.speed",
                "13.89",
                "--sidewalks.guess",
                "--crossings.guess",
                "--walkingareas",
            ],
        )
    }
}

/// All net files below SUMO's tools.
pub fn shipped_nets() -> Vec<PathBuf> {
    fn collect(folder: &Path, found: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                collect(&path, found);
            } else if name.ends_with(".net.xml") || name.ends_with(".net.xml.gz") {
                found.push(path);
            }
        }
    }
    let mut found = Vec::new();
    collect(&SumoInstall::find().unwrap().home().join("tools"), &mut found);
    found.sort();
    assert!(found.len() > 20, "SUMO ships its game nets");
    found
}

/// Small numbers that look random and are the same in every run.
pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % n.max(1)
    }

    pub fn place(&mut self, network: &Network, lanes: &[LaneId]) -> LanePosition {
        let lane = lanes[self.below(lanes.len())];
        LanePosition { lane, s: network.lane(lane).shape.length() * self.below(100) as f64 / 100.0 }
    }
}

/// What was measured along routes, turn-arounds and their surroundings left out.
#[derive(Default, Debug)]
pub struct Measured {
    pub routes: usize,
    pub samples: usize,
    /// Samples tighter than 1/3 per metre.
    pub tight: usize,
    pub max_curvature: f64,
    /// Largest distance from the internal lanes (m).
    pub max_away: f64,
    /// Samples inside junctions, and those of them over 0.3 m from the internal lanes.
    pub inside: usize,
    pub away: usize,
    /// Time that the routes took (ms).
    pub ms: f64,
}

/// Checks what must hold on every route, and measures the rest.
fn check_route(network: &Network, route: &Route, measured: &mut Measured) {
    measured.routes += 1;
    let length = route.length();
    for pair in route.centre_line.points().windows(2) {
        let gap = (pair[1].xy() - pair[0].xy()).norm();
        assert!(gap < 1.5, "gap of {gap} m");
    }
    // Sections and links cover the route in order.
    let mut end = 0.0;
    for section in &route.sections {
        assert_eq!(section.s_start, end);
        assert!(section.s_end >= end);
        end = section.s_end;
    }
    assert!((end - length).abs() < 1e-9);
    for pair in route.links.windows(2) {
        assert!(pair[0].end_s <= pair[1].stop_s + 1e-9);
        let (a, b) = (network.link(pair[0].link), network.link(pair[1].link));
        assert_eq!(network.lane(a.to).edge, network.lane(b.from).edge);
    }
    for pair in route.edges.windows(2) {
        assert_eq!(network.edge(pair[0]).to, network.edge(pair[1]).from);
    }
    let begin = network.lane(route.from.lane).shape.at(route.from.s);
    // In a hairpin the line may be 1.6 m off.
    assert!((route.at(0.0).pose.xy() - begin.xy()).norm() < 1.7, "begins where it should");
    let goal = network.lane(route.to.lane).shape.at(route.to.s);
    assert!((route.at(length).pose.xy() - goal.xy()).norm() < 1.7, "ends where it should");
    let around: Vec<(f64, f64)> = (route.links.iter())
        .filter(|l| network.link(l.link).direction == LinkDirection::TurnAround)
        .map(|l| (l.stop_s - 10.0, l.end_s + 10.0))
        .collect();
    let mut before: Option<RoutePoint> = None;
    for i in 0..=(length / 0.5) as usize {
        let s = 0.5 * i as f64;
        let here = route.at(s);
        let found = route.project_near(here.pose.xy(), s, 1.0, 1.0);
        assert!((found.s - s).abs() < 1e-6 && found.distance < 1e-6, "projects onto itself");
        assert!(network.edge(route.edges[route.edge_index_at(s)]).kind == EdgeKind::Normal);
        if around.iter().any(|&(from, to)| (from..to).contains(&s)) {
            before = None;
            continue;
        }
        measured.samples += 1;
        let mut curvature = here.curvature.abs();
        if let Some(before) = before {
            let step = (here.pose.xy() - before.pose.xy()).norm().max(0.1);
            curvature = curvature.max(wrap_angle(here.pose.heading - before.pose.heading).abs() / step);
        }
        measured.max_curvature = measured.max_curvature.max(curvature);
        measured.tight += usize::from(curvature > 1.0 / 3.0);
        if let Some(link) = route.link_at(s).filter(|l| !network.link(l.link).via.is_empty()) {
            let away = network.link_path(link.link).project(here.pose.xy()).distance;
            measured.max_away = measured.max_away.max(away);
            measured.inside += 1;
            measured.away += usize::from(away > 0.3);
        }
        before = Some(here);
    }
}

/// Drives `count` random routes of the largest connected part, or of the whole net where little is connected.
pub fn drive(network: &Network, class: VehicleClass, count: usize, seed: u64) -> (Measured, Vec<Route>) {
    let all = network.drivable_lanes(class);
    let component = network.largest_component(class);
    let lanes = if 2 * component.len() > all.len() { &component[..] } else { all };
    let mut random = Random(seed);
    let mut measured = Measured::default();
    let mut routes = Vec::new();
    for _ in 0..count {
        let (from, to) = (random.place(network, lanes), random.place(network, lanes));
        let start = Instant::now();
        match network.route(from, to, class) {
            Ok(route) => {
                measured.ms += start.elapsed().as_secs_f64() * 1e3;
                check_route(network, &route, &mut measured);
                routes.push(route);
            }
            // Edges that are too short for the lane changes.
            Err(RouteError::Unreachable { .. }) => {}
            Err(error) => panic!("{error}"),
        }
    }
    (measured, routes)
}
