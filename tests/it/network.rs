//! Networks that SUMO's own tools make and ship: they all load, they mean what SUMO means, and
//! routes over them are smooth and accepted by SUMO.

pub mod nets;

use nets::{Measured, Nets, Random, drive, shipped_nets};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use wad_cosim::geometry::Point;
use wad_cosim::network::*;
use wad_cosim::traci::{LaunchOptions, SumoProcess, lane};

#[test]
fn every_shipped_net_loads_and_can_be_driven() {
    let mut total = Measured::default();
    for path in shipped_nets() {
        let network = Network::load(&path).unwrap_or_else(|error| panic!("{error}"));
        assert!(!network.edges.is_empty() && !network.junctions.is_empty());
        for class in [VehicleClass::Passenger, VehicleClass::Bicycle] {
            if network.drivable_lanes(class).is_empty() {
                let error = network.require_drivable(class).unwrap_err().to_string();
                assert!(error.contains("no drivable lane for class"), "{error}");
                continue;
            }
            let (measured, _) = drive(&network, class, 50, 7);
            println!("{} {class}: {measured:?}", path.display());
            total.samples += measured.samples;
            total.tight += measured.tight;
            total.routes += measured.routes;
        }
    }
    assert!(total.routes > 800, "{total:?}");
    // OpenStreetMap nets have hairpins that nothing can straighten.
    assert!(total.tight * 500 < total.samples, "{total:?}");
}

#[test]
fn routes_over_generated_nets_are_smooth_and_near_their_lanes() {
    let nets = Nets::new();
    let (_, grid) = nets.grid();
    let spider = ["--spider", "--spider.arm-number", "6", "--spider.circle-number", "3"];
    let (_, spider) = nets.make("netgenerate", &spider);
    let (_, left) = nets.make("netgenerate", &["--grid", "--lefthand", "-L", "3", "-j", "traffic_light"]);
    let (_, plain) = nets.make("netgenerate", &["--grid", "--no-internal-links", "-L", "2"]);
    let roundabout = roundabout(&nets);
    let mut all = vec![
        ("grid", grid),
        ("spider", spider),
        ("left", left),
        ("plain", plain),
        ("roundabout", roundabout),
    ];
    for seed in ["1", "2", "3", "4"] {
        let arguments = ["--rand", "--rand.iterations", "60", "-L", "2", "--seed", seed];
        all.push(("random", nets.make("netgenerate", &arguments).1));
    }
    for (name, network) in &all {
        let (measured, routes) = drive(network, VehicleClass::Passenger, 60, 3);
        println!("{name}: {measured:?}");
        assert!(routes.len() > 40, "{name}: {measured:?}");
        // Spiders and random nets have junctions with arms at such sharp angles that no car turns there
        // in one go.
        let sharp = matches!(*name, "spider" | "random");
        assert!(measured.max_curvature <= if sharp { 1.0 } else { 1.0 / 3.0 }, "{name}: {measured:?}");
        assert!(measured.tight * 100 <= measured.samples, "{name}: {measured:?}");
        assert!(measured.max_away <= 1.7 && measured.away * 10 <= measured.inside, "{name}: {measured:?}");
    }
}

/// A one-lane roundabout with four arms of two-way roads.
fn roundabout(nets: &Nets) -> Network {
    let mut nodes = String::from("<nodes>");
    let mut edges = String::from("<edges>");
    for (i, (x, y)) in [(1, 0), (0, 1), (-1, 0), (0, -1)].into_iter().enumerate() {
        let next = (i + 1) % 4;
        writeln!(
            nodes,
            r#"<node id="r{i}" x="{}" y="{}"/><node id="o{i}" x="{}" y="{}"/>"#,
            18 * x,
            18 * y,
            150 * x,
            150 * y
        )
        .unwrap();
        let arc: Vec<String> = (1..9)
            .map(|k| {
                let angle = (i as f64 + k as f64 / 9.0) * std::f64::consts::FRAC_PI_2;
                format!("{:.2},{:.2}", 18.0 * angle.cos(), 18.0 * angle.sin())
            })
            .collect();
        writeln!(
            edges,
            r#"<edge id="ring{i}" from="r{i}" to="r{next}" speed="8.33" priority="9" shape="{} {} {}"/>"#,
            format_args!("{},{}", 18 * x, 18 * y),
            arc.join(" "),
            ["0,18", "-18,0", "0,-18", "18,0"][i]
        )
        .unwrap();
        writeln!(edges, r#"<edge id="in{i}" from="o{i}" to="r{i}" speed="13.89" numLanes="1"/><edge id="out{i}" from="r{i}" to="o{i}" speed="13.89" numLanes="1"/>"#).unwrap();
    }
    nets.write("r.nod.xml", &(nodes + "</nodes>"));
    nets.write(
        "r.edg.xml",
        &(edges + r#"<roundabout nodes="r0 r1 r2 r3" edges="ring0 ring1 ring2 ring3"/></edges>"#),
    );
    nets.make("netconvert", &["-n", "r.nod.xml", "-e", "r.edg.xml"]).1
}

#[test]
fn a_roundabout_is_entered_freely_and_left_to_the_right() {
    let nets = Nets::new();
    let network = roundabout(&nets);
    let place = |edge: &str| {
        let lane = network.edge(network.edge_by_id(edge).unwrap()).lanes[0];
        LanePosition { lane, s: 50.0 }
    };
    let route = network.route(place("in0"), place("out2"), VehicleClass::Passenger).unwrap();
    let names: Vec<&str> = route.edges.iter().map(|&e| network.edge(e).id.as_str()).collect();
    assert_eq!(names, ["in0", "ring0", "ring1", "out2"]);
    let options: Vec<RoadOption> =
        route.links.iter().map(|l| network.road_option(l.link, VehicleClass::Passenger)).collect();
    assert_eq!(options[2], RoadOption::Right, "{options:?}");
    let entry = network.link(route.links[0].link);
    assert!(!entry.must_yield_to.is_empty(), "traffic in the roundabout goes first");
}

#[test]
fn request_indices_are_those_of_the_internal_lanes() {
    // `intLanes` lists, by request index, the last internal lane of each link.
    let attribute = |line: &str, name: &str| {
        let start = line.find(&format!(" {name}=\""))? + name.len() + 3;
        Some(line[start..].split('"').next()?.to_owned())
    };
    let nets = Nets::new();
    let (grid, _) = nets.grid();
    let mut checked = 0;
    for path in shipped_nets().into_iter().filter(|p| p.extension().is_some_and(|e| e == "xml")).chain([grid])
    {
        let network = Network::load(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let mut inner: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for line in text.lines().filter(|l| l.contains("<junction ") && !l.contains("type=\"internal\"")) {
            let lanes = attribute(line, "intLanes").unwrap_or_default();
            inner.insert(
                attribute(line, "id").unwrap(),
                lanes.split_whitespace().map(str::to_owned).collect(),
            );
        }
        for link in &network.links {
            let lanes = &inner[&network.junction(link.junction).id];
            if let (Some(index), Some(&last)) = (link.request_index, link.via.last())
                && !lanes.is_empty()
            {
                assert_eq!(lanes.get(index), Some(&network.lane(last).id), "{}", path.display());
                checked += 1;
            }
        }
    }
    assert!(checked > 5000, "{checked}");
}

/// Whether two lines cross well inside both.
fn cross(a: &wad_cosim::geometry::Polyline, b: &wad_cosim::geometry::Polyline) -> bool {
    a.points().windows(2).any(|p| {
        b.points().windows(2).any(|q| {
            let (r, s) = (p[1].xy() - p[0].xy(), q[1].xy() - q[0].xy());
            let (k, between) = (r.perp(&s), q[0].xy() - p[0].xy());
            let (t, u) = (between.perp(&s) / k, between.perp(&r) / k);
            k.abs() > 1e-9 && (0.0..1.0).contains(&t) && (0.0..1.0).contains(&u)
        })
    })
}

#[test]
fn links_whose_paths_cross_are_foes_and_one_of_them_yields() {
    let nets = Nets::new();
    let (_, network) = nets.grid();
    let mut crossing = 0;
    for (i, a) in network.links.iter().enumerate() {
        let id = LinkId(i as u32);
        for &foe in &a.foes {
            assert!(network.link(foe).foes.contains(&id), "foes are mutual");
        }
        for &first in &a.must_yield_to {
            assert!(a.foes.contains(&first), "one yields to foes only");
        }
        for (j, b) in network.links.iter().enumerate().skip(i + 1) {
            let other = LinkId(j as u32);
            let apart = network.lane(a.from).edge == network.lane(b.from).edge;
            if a.junction == b.junction && !apart && cross(&network.link_path(id), &network.link_path(other))
            {
                crossing += 1;
                assert!(
                    a.foes.contains(&other),
                    "{} and {}",
                    network.lane(a.via[0]).id,
                    network.lane(b.via[0]).id
                );
                assert!(a.must_yield_to.contains(&other) || b.must_yield_to.contains(&id));
            }
        }
        // The road that the path leaves by lies under a crossing of its own.
        for &c in &a.crossings {
            assert_eq!(network.crossing(c).junction, a.junction);
        }
    }
    assert!(crossing > 150, "{crossing}");
    let mut turns = 0;
    let turning = network.links.iter().filter(|l| l.direction == LinkDirection::Right);
    for link in turning {
        let over = network.lane(link.to).edge;
        let own = |c: &&CrossingId| network.crossing(**c).crossed_edges.contains(&over);
        let cuts_own = link.crossings.iter().any(|c| own(&c));
        assert!(!cuts_own || link.yields_to_crossings.iter().any(|c| own(&c)), "a right turn lets them pass");
        turns += usize::from(cuts_own);
    }
    assert!(turns > 10, "{turns}");
    assert!(network.crossings.iter().all(|c| c.signal.is_some() && c.outline.len() >= 4));
    assert!(network.traffic_lights.iter().all(|t| t.signals > 0 && t.radius > 1.0 && t.radius < 40.0));
}

#[tokio::test]
async fn links_are_those_that_sumo_reports() {
    let nets = Nets::new();
    let (path, network) = nets.grid();
    let (_sumo, mut client) = SumoProcess::launch(&LaunchOptions::net(&path)).await.unwrap();
    let mut links = 0;
    for lane in network.lanes.iter().filter(|l| network.edge(l.edge).kind == EdgeKind::Normal) {
        let theirs = client.get(lane::LINKS, &lane.id).await.unwrap();
        let ours: BTreeSet<(String, String)> = (lane.outgoing.iter())
            .map(|&l| network.link(l))
            .map(|l| (network.lane(l.to).id.clone(), network.lane(l.via[0]).id.clone()))
            .collect();
        let road = |lane: &str| {
            network
                .lane_by_id(lane)
                .is_some_and(|l| network.edge(network.lane(l).edge).kind == EdgeKind::Normal)
        };
        let theirs: BTreeSet<(String, String)> = theirs
            .into_iter()
            .filter(|l| road(&l.approached_lane))
            .map(|l| (l.approached_lane, l.via))
            .collect();
        assert_eq!(ours, theirs, "links of {}", lane.id);
        for &link in &lane.outgoing {
            let link = network.link(link);
            let to = network.lane(link.to).id.clone();
            let theirs: BTreeSet<String> =
                client.get_with(lane::foes(&to), &lane.id).await.unwrap().into_iter().collect();
            let first: BTreeSet<String> =
                link.must_yield_to.iter().map(|&l| network.lane(network.link(l).from).id.clone()).collect();
            let theirs: BTreeSet<String> = theirs.into_iter().filter(|l| road(l)).collect();
            assert_eq!(first, theirs, "who goes before {} to {to}", lane.id);
            links += 1;
        }
    }
    assert!(links > 150, "{links}");
}

#[test]
fn sumo_drives_the_routes_edges() {
    let nets = Nets::new();
    let left = |nets: &Nets| nets.make("netgenerate", &["--grid", "--lefthand", "-L", "2"]);
    let random =
        |nets: &Nets| nets.make("netgenerate", &["--rand", "--rand.iterations", "80", "--seed", "5"]);
    for (path, network) in [nets.grid(), left(&nets), random(&nets)] {
        let (_, routes) = drive(&network, VehicleClass::Passenger, 60, 11);
        let mut demand = String::from("<routes>");
        for (i, route) in routes.iter().enumerate() {
            let edges: Vec<&str> = route.edges.iter().map(|&e| network.edge(e).id.as_str()).collect();
            writeln!(
                demand,
                r#"<vehicle id="v{i}" depart="0"><route edges="{}"/></vehicle>"#,
                edges.join(" ")
            )
            .unwrap();
        }
        nets.write("demand.rou.xml", &(demand + "</routes>"));
        // SUMO refuses a route with edges that do not follow each other.
        let net = path.display().to_string();
        nets.run("sumo", &["-n", &net, "-r", "demand.rou.xml", "--no-step-log", "--end", "5"]);
    }
}

#[test]
fn sumo_walks_the_walks() {
    let nets = Nets::new();
    let (path, network) = nets.grid();
    assert!(network.has_pedestrian_network());
    let edges = network.sidewalk_edges();
    assert_eq!(edges.len(), network.edges.iter().filter(|e| e.kind == EdgeKind::Normal).count());
    let mut random = Random(5);
    let mut demand = String::from("<routes>");
    for i in 0..40 {
        let (from, to) = (edges[random.below(edges.len())], edges[random.below(edges.len())]);
        let walk = network.walk_route(from, to).unwrap();
        assert_eq!((walk.first(), walk.last()), (Some(&from), Some(&to)));
        let walk: Vec<&str> = walk.iter().map(|&e| network.edge(e).id.as_str()).collect();
        writeln!(demand, r#"<person id="p{i}" depart="0"><walk edges="{}"/></person>"#, walk.join(" "))
            .unwrap();
    }
    nets.write("walks.rou.xml", &(demand + "</routes>"));
    let net = path.display().to_string();
    nets.run(
        "sumo",
        &[
            "-n",
            &net,
            "-r",
            "walks.rou.xml",
            "--no-step-log",
            "--end",
            "3000",
            "--tripinfo-output",
            "trips.xml",
        ],
    );
    let trips = std::fs::read_to_string(nets.path("trips.xml")).unwrap();
    assert_eq!(trips.matches("<walk ").count(), 40);
    assert!(!trips.contains("arrival=\"-1"), "all arrive");
}

#[test]
fn left_hand_traffic_changes_lanes_the_other_way() {
    let nets = Nets::new();
    let (_, network) = nets.make("netgenerate", &["--grid", "--grid.length", "300", "--lefthand", "-L", "2"]);
    assert!(network.left_hand);
    assert_eq!(network.turns_left(LinkDirection::TurnAround), Some(false), "over the opposite lanes");
    let edge = network.edge(network.edge_by_id("A0B0").unwrap());
    let (outer, inner) = (network.lane(edge.lanes[0]), network.lane(edge.lanes[1]));
    assert!(outer.shape.project(inner.shape.at(50.0).xy()).d < 0.0, "the outer lane is the left one");
    let place = |lane, s| LanePosition { lane, s };
    let go = |from, to| network.route(place(from, 10.0), place(to, 200.0), VehicleClass::Passenger).unwrap();
    let right = go(edge.lanes[0], edge.lanes[1]);
    let option = |route: &Route| route.sections.iter().find(|s| s.from_lane.is_some()).unwrap().option;
    assert_eq!(option(&right), RoadOption::ChangeLaneRight);
    assert_eq!(option(&go(edge.lanes[1], edge.lanes[0])), RoadOption::ChangeLaneLeft);
    // In the change the corridor reaches from centre to centre: from the left lane to the right one.
    let change = right.sections.iter().find(|s| s.from_lane.is_some()).unwrap();
    let begin = change.s_start + 1.5;
    assert!(right.corridor_offset(begin, -2.5) < 1e-9 && right.corridor_offset(begin, 1.0) > 0.9);
}

#[test]
fn roads_that_cross_over_each_other_are_told_apart() {
    let nets = Nets::new();
    nets.write(
        "b.nod.xml",
        r#"<nodes><node id="w" x="-200" y="0" z="0"/><node id="e" x="200" y="0" z="0"/>
        <node id="s" x="0" y="-200" z="7"/><node id="n" x="0" y="200" z="9"/></nodes>"#,
    );
    nets.write(
        "b.edg.xml",
        r#"<edges><edge id="below" from="w" to="e"/><edge id="above" from="s" to="n"/></edges>"#,
    );
    let (_, network) =
        nets.make("netconvert", &["-n", "b.nod.xml", "-e", "b.edg.xml", "--offset.disable-normalization"]);
    let near = |z| {
        let lanes = network.lanes_near(Point::new(0.0, 0.0), z, 5.0);
        lanes.iter().map(|l| network.edge(network.lane(l.lane).edge).id.as_str()).collect::<Vec<_>>()
    };
    assert_eq!(near(None).len(), 2);
    assert_eq!(near(Some(0.2)), ["below"]);
    assert_eq!(near(Some(8.5)), ["above"]);
    let above = network.edge(network.edge_by_id("above").unwrap()).lanes[0];
    let at = |s| LanePosition { lane: above, s };
    let route = network.route(at(0.0), at(400.0), VehicleClass::Passenger).unwrap();
    assert!((route.at(200.0).pose.position.z - 8.0).abs() < 0.05, "the climb is kept");
}
