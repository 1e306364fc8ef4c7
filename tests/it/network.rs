//! Networks that SUMO's own tools made: they all load, and routes over them can be driven.

use std::path::{Path, PathBuf};
use std::time::Instant;
use wad_cosim::geometry::wrap_angle;
use wad_cosim::network::{EdgeKind, LaneId, LanePosition, Network, Route, RouteError, VehicleClass};

fn sumo_home() -> PathBuf {
    PathBuf::from(std::env::var_os("SUMO_HOME").expect("SUMO_HOME names SUMO"))
}

/// All net files below SUMO's tools.
fn shipped_nets() -> Vec<PathBuf> {
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
    collect(&sumo_home().join("tools"), &mut found);
    found.sort();
    found
}

/// Small numbers that look random and are the same in every run.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % n.max(1)
    }
}

fn random_place(network: &Network, lanes: &[LaneId], random: &mut Random) -> LanePosition {
    let lane = lanes[random.below(lanes.len())];
    LanePosition { lane, s: network.lane(lane).shape.length() * random.below(100) as f64 / 100.0 }
}

#[derive(Default, Debug)]
struct Stats {
    routes: usize,
    unreachable: usize,
    max_gap: f64,
    max_curvature: f64,
    max_curvature_turn: f64,
    max_away: f64,
    tight: usize,
    samples: usize,
    metres: f64,
    search_ms: f64,
}

fn measure(network: &Network, route: &Route, stats: &mut Stats) {
    stats.routes += 1;
    stats.metres += route.length();
    for pair in route.centre_line.points().windows(2) {
        stats.max_gap = stats.max_gap.max((pair[1].xy() - pair[0].xy()).norm());
    }
    let mut s = 0.0;
    while s <= route.length() {
        let here = route.at(s);
        let turn = route
            .link_at(s)
            .is_some_and(|l| network.link(l.link).direction == wad_cosim::network::LinkDirection::TurnAround);
        stats.samples += 1;
        if turn {
            stats.max_curvature_turn = stats.max_curvature_turn.max(here.curvature.abs());
        } else {
            if here.curvature.abs() > stats.max_curvature {
                stats.max_curvature = here.curvature.abs();
                if here.curvature.abs() > 0.34 {
                    eprintln!(
                        "   k {:.2} at {:.1} {:.1} on {} {:?}",
                        here.curvature,
                        here.pose.position.x,
                        here.pose.position.y,
                        network.lane(here.lane).id,
                        here.option
                    );
                }
            }
            if here.curvature.abs() > 0.25 {
                stats.tight += 1;
            }
        }
        if let Some(link) = route.link_at(s)
            && !turn
        {
            let away = network
                .link(link.link)
                .via
                .iter()
                .map(|&l| network.lane(l).shape.project(here.pose.xy()).distance)
                .fold(f64::INFINITY, f64::min);
            if away.is_finite() {
                stats.max_away = stats.max_away.max(away);
            }
        }
        s += 0.5;
    }
}

#[test]
fn every_shipped_net_loads_and_is_driven() {
    for path in shipped_nets() {
        let start = Instant::now();
        let network = Network::load(&path).unwrap_or_else(|e| panic!("{e}"));
        let ms = start.elapsed().as_secs_f64() * 1e3;
        eprintln!(
            "{} {:.1} ms, {} edges {} lanes {} links {} crossings {} tls",
            path.file_name().unwrap().to_string_lossy(),
            ms,
            network.edges.len(),
            network.lanes.len(),
            network.links.len(),
            network.crossings.len(),
            network.traffic_lights.len()
        );
        for class in [VehicleClass::Passenger, VehicleClass::Bicycle] {
            let lanes = network.drivable_lanes(class);
            if lanes.is_empty() {
                continue;
            }
            let mut random = Random(7);
            let mut stats = Stats::default();
            for _ in 0..100 {
                let (a, b) =
                    (random_place(&network, lanes, &mut random), random_place(&network, lanes, &mut random));
                let start = Instant::now();
                match network.route(a, b, class) {
                    Ok(route) => {
                        stats.search_ms += start.elapsed().as_secs_f64() * 1e3;
                        measure(&network, &route, &mut stats)
                    }
                    Err(RouteError::Unreachable { .. }) => stats.unreachable += 1,
                    Err(e) => panic!("{e}"),
                }
            }
            stats.search_ms /= stats.routes.max(1) as f64;
            eprintln!("   {stats:?}");
        }
    }
}
