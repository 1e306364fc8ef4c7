//! The way back to SUMO: its traffic sees the ego, waits for it and goes on after it.

mod town;

use std::path::PathBuf;
use tempfile::TempDir;
use wad_cosim::bridge::{Bridge, BridgeOptions, Ego, Lamps};
use wad_cosim::drive::{Drive, DriveOptions};
use wad_cosim::geometry::{Pose, Vector};
use wad_cosim::network::{LanePosition, Network, Route, VehicleClass};
use wad_cosim::traci::{SumoInstall, vehicle};
use wad_cosim::traffic::{Counts, TrafficSpec};
use wad_cosim::vehicle::{Control, EgoParams};
use wad_cosim::world::{Actor, ActorKind, VehicleSignals};

const STAND: Control = Control { throttle: 0.0, steer: 0.0, brake: 1.0, reverse: false };
const GO: Control = Control { throttle: 0.5, steer: 0.0, brake: 0.0, reverse: false };

const VEHICLE_TYPE: &str = r#"<vType id="car" length="4.5" width="1.8" sigma="0"/>"#;

/// A junction of two roads, west-east with right of way, each arm 250 m, and a crossing with right of
/// way over the southern arm.
const NODES: &str = r#"<nodes>
<node id="C" x="0" y="0" type="priority"/><node id="W" x="-250" y="0"/><node id="E" x="250" y="0"/>
<node id="S" x="0" y="-250"/><node id="N" x="0" y="250"/></nodes>"#;
const CROSSING: &str = r#"<connections><crossing node="C" edges="SC CS" priority="true"/></connections>"#;

fn edges() -> String {
    let mut text = String::from("<edges>");
    for (arm, priority) in [("W", 3), ("E", 3), ("S", 1), ("N", 1)] {
        for (id, from, to) in [(format!("{arm}C"), arm, "C"), (format!("C{arm}"), "C", arm)] {
            text += &format!(
                r#"<edge id="{id}" from="{from}" to="{to}" numLanes="1" speed="13.89" priority="{priority}" sidewalkWidth="2"/>"#
            );
        }
    }
    text + "</edges>"
}

/// A folder with a net and its demand; gone when dropped.
struct Scene {
    folder: TempDir,
}

impl Scene {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().expect("a folder") }
    }

    /// The junction, with `demand` inside `<routes>`.
    fn junction(demand: &str) -> Self {
        let scene = Self::new();
        let net = scene.path("x.net.xml");
        let mut command = SumoInstall::find().expect("SUMO").command("netconvert");
        command.arg("-n").arg(scene.write("x.nod.xml", NODES));
        command.arg("-e").arg(scene.write("x.edg.xml", &edges()));
        command.arg("-x").arg(scene.write("x.con.xml", CROSSING));
        run(command.arg("-o").arg(net));
        scene.write("x.rou.xml", &format!("<routes>{VEHICLE_TYPE}{demand}</routes>"));
        scene.write(
            "x.sumocfg",
            r#"<configuration><net-file value="x.net.xml"/><route-files value="x.rou.xml"/></configuration>"#,
        );
        scene
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, text).expect("written");
        path
    }

    async fn bridge(&self) -> Bridge {
        let options = BridgeOptions::new(self.path("x.sumocfg"), self.path("out"));
        Bridge::start(&options).await.expect("SUMO starts")
    }
}

fn run(command: &mut std::process::Command) {
    let output = command.output().expect("it runs");
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// A route between the roads of two edges, from 5 m behind the first one's begin to 5 m before the last one's end.
fn route(network: &Network, from: &str, to: &str) -> Route {
    let lane = |id: &str| {
        let edge = network.edge(network.edge_by_id(id).expect("an edge"));
        *edge.lanes.last().expect("a lane")
    };
    let (from, to) = (lane(from), lane(to));
    let end = network.lane(to).shape.length() - 5.0;
    network
        .route(
            LanePosition { lane: from, s: 5.0 },
            LanePosition { lane: to, s: end },
            VehicleClass::Passenger,
        )
        .expect("a route")
}

async fn tick(bridge: &mut Bridge, ego: &mut Ego, control: Control) {
    let contacts = ego.advance(control, bridge.tick());
    assert!(contacts.is_empty(), "at {:.1} s: {contacts:?}", bridge.time());
    bridge.step(&mut [ego]).await.expect("a step");
}

fn find<'a>(ego: &'a Ego, id: &str) -> Option<&'a Actor> {
    ego.world().vehicles.iter().find(|v| &*v.id == id)
}

/// The other's place in the ego's frame (m): x forward, y left.
fn local(ego: &Ego, other: &Actor) -> Vector {
    ego.state().pose.to_local(other.pose.xy())
}

/// Bumper to bumper to one behind the ego on its lane (m).
fn gap_behind(ego: &Ego, other: &Actor) -> f64 {
    -local(ego, other).x - 0.5 * (ego.params().length + other.actor_type.length)
}

#[tokio::test]
async fn a_follower_stops_behind_a_standing_ego_and_drives_on_after_it() {
    let scene =
        Scene::junction(r#"<trip id="follower" type="car" depart="1" departSpeed="max" from="WC" to="CE"/>"#);
    let mut bridge = scene.bridge().await;
    let mut ego = Ego::new("ego", EgoParams::default(), route(bridge.network(), "WC", "CE"), 150.0);
    bridge.spawn(&mut ego).await.expect("the ego is in");
    let mut nearest = f64::INFINITY;
    for _ in 0..240 {
        tick(&mut bridge, &mut ego, STAND).await;
        if let Some(follower) = find(&ego, "follower") {
            assert!(local(&ego, follower).y.abs() < 0.3, "it stays behind");
            nearest = nearest.min(gap_behind(&ego, follower));
        }
    }
    let follower = find(&ego, "follower").expect("it is behind the ego");
    assert!(follower.speed < 0.05, "still at {} m/s", follower.speed);
    // SUMO's standard minGap is 2.5 m.
    assert!((1.5..4.0).contains(&nearest), "came as near as {nearest:.2} m");
    let stood_at = follower.pose.position.x;
    for _ in 0..60 {
        tick(&mut bridge, &mut ego, GO).await;
    }
    let follower = find(&ego, "follower").expect("it comes along");
    assert!(follower.speed > 5.0 && follower.pose.position.x > stood_at + 15.0, "{follower:?}");
    assert!(gap_behind(&ego, follower) > 1.5);
    bridge.close().await.expect("closed");
}

#[tokio::test]
async fn cross_traffic_with_right_of_way_waits_for_an_ego_in_the_junction() {
    let scene = Scene::junction(
        r#"<trip id="east" type="car" depart="3" departSpeed="max" from="WC" to="CE"/>
           <trip id="west" type="car" depart="3" departSpeed="max" from="EC" to="CW"/>"#,
    );
    let mut bridge = scene.bridge().await;
    let way = route(bridge.network(), "SC", "CN");
    let link = way.links[0];
    let mut ego = Ego::new("ego", EgoParams::default(), way, 0.5 * (link.stop_s + link.end_s));
    bridge.spawn(&mut ego).await.expect("the ego is in");
    for _ in 0..240 {
        tick(&mut bridge, &mut ego, STAND).await;
    }
    for id in ["east", "west"] {
        let other = find(&ego, id).expect("it waits near by");
        let at = local(&ego, other);
        assert!(other.speed < 0.05, "{id} still at {} m/s", other.speed);
        assert!((4.0..25.0).contains(&at.y.abs()), "{id} waits at {at:?}");
    }
    for _ in 0..150 {
        let control = if ego.state().speed < 6.0 { GO } else { Control::default() };
        tick(&mut bridge, &mut ego, control).await;
        if ego.on_route().s > link.end_s + 60.0 {
            break;
        }
    }
    let junction = bridge.network().junction(bridge.network().junction_by_id("C").expect("C")).position;
    for _ in 0..60 {
        tick(&mut bridge, &mut ego, STAND).await;
    }
    for (id, side) in [("east", 1.0), ("west", -1.0)] {
        let beyond = find(&ego, id).is_none_or(|v| side * (v.pose.position.x - junction.x) > 10.0);
        assert!(beyond, "{id} has not gone on: {:?}", find(&ego, id));
    }
    bridge.close().await.expect("closed");
}

#[tokio::test]
async fn pedestrians_wait_while_the_ego_blocks_their_crossing() {
    let person = |i: usize| {
        format!(
            r#"<person id="p{i}" depart="{i}" departPos="215"><walk edges="WC CE" arrivalPos="60"/></person>"#
        )
    };
    let scene = Scene::junction(&(0..4).map(person).collect::<String>());
    let mut bridge = scene.bridge().await;
    let network = bridge.network().clone();
    let crossing = &network.crossings[0];
    let line = &network.lane(crossing.lane).shape;
    let way = route(&network, "SC", "CN");
    let middle = way.project_near(line.at(0.5 * line.length()).xy(), way.links[0].stop_s, 20.0, 20.0).s;
    let mut ego = Ego::new("ego", EgoParams::default(), way, middle);
    bridge.spawn(&mut ego).await.expect("the ego is in");
    let beyond = |ego: &Ego, p: &Actor| local(ego, p).y < -0.5 * ego.params().width;
    for _ in 0..360 {
        tick(&mut bridge, &mut ego, STAND).await;
        for p in &ego.world().pedestrians {
            assert!(!beyond(&ego, p), "{} squeezed past at {:.0} s", p.id, bridge.time());
        }
    }
    assert_eq!(ego.world().pedestrians.len(), 4, "all wait");
    let stood = ego.state().pose;
    for _ in 0..240 {
        let far = ego.on_route().s > middle + 25.0;
        tick(&mut bridge, &mut ego, if far { STAND } else { GO }).await;
    }
    let crossed = |p: &&Actor| stood.to_local(p.pose.xy()).y < -3.0;
    let waiting = ego.world().pedestrians.iter().filter(|p| !crossed(p)).count();
    assert_eq!(waiting, 0, "{:?}", ego.world().pedestrians);
    bridge.close().await.expect("closed");
}

#[tokio::test]
async fn an_ego_off_the_road_is_ignored_and_seen_again_after_its_return() {
    let scene = Scene::junction(
        r#"<trip id="first" type="car" depart="1" departSpeed="max" from="WC" to="CE"/>
           <trip id="second" type="car" depart="30" departSpeed="max" from="WC" to="CE"/>"#,
    );
    let mut bridge = scene.bridge().await;
    let mut ego = Ego::new("ego", EgoParams::default(), route(bridge.network(), "WC", "CE"), 150.0);
    bridge.spawn(&mut ego).await.expect("the ego is in");
    for _ in 0..12 {
        tick(&mut bridge, &mut ego, STAND).await;
    }
    let lane = |bridge: &Bridge, ego: &Ego| bridge.network().lane(ego.lane()).id.clone();
    let home = ego.state().pose;
    let meadow = home.to_world(Vector::new(0.0, -20.0));
    ego.vehicle_mut().respawn(Pose::new(meadow.x, meadow.y, 0.0, home.heading + 1.0), 0.0);
    let mut slowest = f64::INFINITY;
    for _ in 0..160 {
        tick(&mut bridge, &mut ego, STAND).await;
        if let Some(first) = find(&ego, "first") {
            slowest = slowest.min(first.speed);
        }
    }
    assert!(slowest > 10.0, "traffic slowed down to {slowest:.1} m/s for an ego in the meadow");
    assert_eq!(sumo_lane(&mut bridge).await, "");
    ego.vehicle_mut().respawn(home, 0.0);
    let mut followed = f64::INFINITY;
    for _ in 0..220 {
        tick(&mut bridge, &mut ego, STAND).await;
        if let Some(second) = find(&ego, "second") {
            followed = followed.min(gap_behind(&ego, second));
        }
    }
    assert_eq!(sumo_lane(&mut bridge).await, lane(&bridge, &ego));
    let second = find(&ego, "second").expect("it waits behind the ego");
    assert!(second.speed < 0.05 && (1.5..4.0).contains(&followed), "{followed:.2} m, {second:?}");
    bridge.close().await.expect("closed");
}

/// The first of each are called "0" by randomTrips.py. One once took the other's type.
#[tokio::test]
async fn a_vehicle_and_a_person_of_one_id_are_two_road_users() {
    let scene = Scene::junction(
        r#"<trip id="0" type="car" depart="0" departPos="200" from="WC" to="CE"/>
           <person id="0" depart="0" departPos="170"><walk edges="WC CE" arrivalPos="60"/></person>"#,
    );
    let mut bridge = scene.bridge().await;
    let mut ego = Ego::new("ego", EgoParams::default(), route(bridge.network(), "WC", "CE"), 150.0);
    bridge.spawn(&mut ego).await.expect("the ego is in");
    for _ in 0..6 {
        tick(&mut bridge, &mut ego, STAND).await;
    }
    let car = find(&ego, "0").expect("a car");
    let person = ego.world().pedestrians.iter().find(|p| &*p.id == "0").expect("a person");
    assert_eq!((car.actor_type.kind, person.actor_type.kind), (ActorKind::Car, ActorKind::Pedestrian));
    assert_ne!(car.key, person.key);
    bridge.close().await.expect("closed");
}

/// SUMO keeps a vehicle off the road whose route does not lead where it stands: nobody sees it there.
#[tokio::test]
async fn an_ego_put_down_on_another_road_is_seen_there() {
    let scene =
        Scene::junction(r#"<trip id="second" type="car" depart="5" departSpeed="max" from="SC" to="CN"/>"#);
    let mut bridge = scene.bridge().await;
    let mut ego = Ego::new("ego", EgoParams::default(), route(bridge.network(), "WC", "CE"), 150.0);
    bridge.spawn(&mut ego).await.expect("the ego is in");
    tick(&mut bridge, &mut ego, STAND).await;
    ego.respawn(route(bridge.network(), "SC", "CN"), 150.0);
    for _ in 0..240 {
        tick(&mut bridge, &mut ego, STAND).await;
    }
    assert_eq!(sumo_lane(&mut bridge).await, bridge.network().lane(ego.lane()).id);
    let second = find(&ego, "second").expect("it waits behind the ego");
    let gap = gap_behind(&ego, second);
    assert!(second.speed < 0.05 && (1.5..4.0).contains(&gap), "{gap:.2} m, {second:?}");
    bridge.close().await.expect("closed");
}

/// The lane that SUMO has the ego on; empty off the road.
async fn sumo_lane(bridge: &mut Bridge) -> String {
    bridge.client_mut().get(vehicle::LANE_ID, "ego").await.expect("the ego is there")
}

#[tokio::test]
async fn two_egos_see_each_other_and_each_others_lamps() {
    let scene = Scene::junction("");
    let mut bridge = scene.bridge().await;
    let network = bridge.network().clone();
    let mut a = Ego::new("ego", EgoParams::default(), route(&network, "WC", "CE"), 100.0);
    let shorter = EgoParams { length: 4.0, ..EgoParams::default() };
    let mut b = Ego::new("other", shorter, route(&network, "WC", "CE"), 130.0);
    bridge.spawn_all(&mut [&mut a, &mut b]).await.expect("both are in");
    let lamps = [
        (Lamps { brake: true, ..Lamps::default() }, VehicleSignals::BRAKE_LIGHT),
        (Lamps { blinker_left: true, ..Lamps::default() }, VehicleSignals::BLINKER_LEFT),
        (
            Lamps { blinker_right: true, brake: true, ..Lamps::default() },
            VehicleSignals::BLINKER_RIGHT | VehicleSignals::BRAKE_LIGHT,
        ),
        (Lamps::default(), 0),
    ];
    let all = VehicleSignals::BRAKE_LIGHT | VehicleSignals::BLINKER_LEFT | VehicleSignals::BLINKER_RIGHT;
    for (shown, bits) in lamps {
        b.set_lamps(shown);
        for _ in 0..6 {
            a.advance(GO, bridge.tick());
            b.advance(Control { throttle: 0.8, ..GO }, bridge.tick());
            bridge.step(&mut [&mut a, &mut b]).await.expect("a step");
        }
        let seen = find(&a, "other").expect("a sees b");
        assert_eq!(seen.signals.0 & all, bits, "{shown:?}");
    }
    for (me, other) in [(&a, &b), (&b, &a)] {
        assert!(find(me, &me.id).is_none(), "nobody sees itself");
        let seen = find(me, &other.id).expect("one sees the other");
        let (seen_at, is_at) = (seen.pose, other.state().pose);
        assert!((seen_at.xy() - is_at.xy()).norm() < 0.05, "{seen_at:?} for {is_at:?}");
        assert!((seen_at.heading - is_at.heading).abs() < 0.01);
        assert!((seen.speed - other.state().speed).abs() < 0.5, "{} for {}", seen.speed, other.state().speed);
        assert_eq!(seen.actor_type.length, other.params().length);
    }
    assert_eq!(bridge.counts().0, 0, "egos are no background");
    bridge.close().await.expect("closed");
}

#[tokio::test]
async fn it_drives_on_the_left_where_that_is_the_rule() {
    let scene = Scene::new();
    let net = scene.path("left.net.xml");
    let mut command = SumoInstall::find().expect("SUMO").command("netgenerate");
    command.args(["--grid", "--grid.number", "4", "--grid.length", "150", "--lefthand", "-L", "2"]);
    command.args([
        "-j",
        "traffic_light",
        "--default.speed",
        "13.89",
        "--sidewalks.guess",
        "--crossings.guess",
    ]);
    run(command.arg("-o").arg(&net));
    let bridge = BridgeOptions {
        traffic: TrafficSpec::Counts(Counts::new(15, 15)),
        ..BridgeOptions::new(&net, scene.path("out"))
    };
    let mut drive = Drive::start(DriveOptions::new(bridge, scene.path("out"))).await.expect("a drive");
    assert!(drive.bridge().network().left_hand);
    for _ in 0..600 {
        drive.tick().await.expect("a tick");
    }
    let summary = drive.finish(false).await.expect("a summary");
    assert!(summary.distance_m > 250.0, "{summary:?}");
    assert_eq!(summary.collisions, Default::default(), "{summary:?}");
    assert_eq!(
        (summary.outside_lane_ticks, summary.sidewalk_events, summary.red_lights_run),
        (0, 0, 0),
        "{summary:?}"
    );
}

/// Ticks of half a second and a second, as SUMO's own demo configs have them.
#[tokio::test]
async fn long_ticks_keep_it_on_the_road() {
    let net = SumoInstall::find().expect("SUMO").home().join("tools/game/A10KW.sumocfg");
    for tick_ms in [500.0, 1000.0] {
        let folder = tempfile::tempdir().expect("a folder");
        // Alone: the physics moves others at constant speed through the tick, into the ego where they brake.
        let bridge = BridgeOptions {
            tick_ms: Some(tick_ms),
            traffic: TrafficSpec::Empty,
            ..BridgeOptions::new(&net, folder.path().join("out"))
        };
        let mut drive =
            Drive::start(DriveOptions::new(bridge, folder.path().join("out"))).await.expect("a drive");
        for _ in 0..300 {
            drive.tick().await.expect("a tick");
        }
        let summary = drive.finish(false).await.expect("a summary");
        assert!(summary.distance_m > 150.0, "{summary:?}");
        assert_eq!((summary.outside_lane_ticks, summary.collisions), (0, Default::default()), "{summary:?}");
    }
}

/// The junction with an ego that stands and a car that waits behind it; `far`: and a second junction 3 km
/// away, full of cars and walkers. Size of an answer (bytes), who is in sight, vehicles in the net.
async fn answers(far: bool) -> (Vec<u64>, usize, usize) {
    let scene = Scene::new();
    let mut nodes = NODES.to_string();
    let mut ways = edges();
    let mut demand =
        r#"<trip id="near" type="car" depart="0" departSpeed="max" from="WC" to="CE"/>"#.to_string();
    if far {
        let copy = |text: &str| {
            let mut text = text.to_string();
            for id in ["WC", "CW", "EC", "CE", "SC", "CS", "NC", "CN", "C", "W", "E", "S", "N"] {
                text = text.replace(&format!("\"{id}\""), &format!("\"far{id}\""));
            }
            text
        };
        let moved = copy(NODES).replace("x=\"", "x=\"3").replace("x=\"3-250\"", "x=\"2750\"");
        let moved = moved.replace("x=\"30\"", "x=\"3000\"");
        nodes = nodes.replace("</nodes>", "") + &moved.replace("<nodes>", "");
        ways = ways.replace("</edges>", "") + &copy(&edges()).replace("<edges>", "");
        for (from, to) in [("WC", "CE"), ("EC", "CW"), ("SC", "CN"), ("NC", "CS")] {
            demand += &format!(
                r#"<flow id="far{from}" type="car" begin="0" end="60" period="3" from="far{from}" to="far{to}"/>"#
            );
        }
    }
    let net = scene.path("x.net.xml");
    let mut command = SumoInstall::find().expect("SUMO").command("netconvert");
    command.arg("-n").arg(scene.write("x.nod.xml", &nodes));
    command.arg("-e").arg(scene.write("x.edg.xml", &ways));
    run(command.arg("-o").arg(net));
    scene.write("x.rou.xml", &format!("<routes>{VEHICLE_TYPE}{demand}</routes>"));
    scene.write(
        "x.sumocfg",
        r#"<configuration><net-file value="x.net.xml"/><route-files value="x.rou.xml"/></configuration>"#,
    );
    let mut bridge = scene.bridge().await;
    let mut ego = Ego::new("ego", EgoParams::default(), route(bridge.network(), "WC", "CE"), 150.0);
    bridge.spawn(&mut ego).await.expect("the ego is in");
    let mut sizes = Vec::new();
    for number in 0..120 {
        let before = bridge.answer_bytes();
        tick(&mut bridge, &mut ego, STAND).await;
        if number >= 100 {
            sizes.push(bridge.answer_bytes() - before);
        }
    }
    sizes.sort_unstable();
    let seen = ego.world().vehicles.len() + ego.world().pedestrians.len();
    let counts = bridge.counts();
    bridge.close().await.expect("it ends");
    (sizes, seen, counts.0)
}

#[tokio::test]
async fn a_tick_brings_what_is_near_the_ego_and_nothing_of_a_larger_town() {
    let ((small, near, alone), (large, near_too, crowd)) = (answers(false).await, answers(true).await);
    assert_eq!((near, near_too), (1, 1), "the one that waits behind the ego");
    assert!(alone == 1 && crowd > 20, "{alone} and {crowd} vehicles in the net");
    // Ticks in which nobody departs or arrives anywhere.
    assert_eq!(small[0], large[0], "bytes: {small:?} and {large:?}");
    assert!(large[large.len() / 2] < large[0] + 60, "{large:?}");
}
