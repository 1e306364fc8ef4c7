//! The way to SUMO and back in the bundled towns, held to what SUMO says itself.

use super::{STAND, sumo_lane, tick};
use std::path::Path;
use wad_cosim::autopilot::{Autopilot, AutopilotParams, EgoModel};
use wad_cosim::bridge::{Bridge, BridgeOptions, Ego};
use wad_cosim::destination::Destinations;
use wad_cosim::network::LanePosition;
use wad_cosim::traci::{Batch, person, vehicle};
use wad_cosim::traffic::{Counts, TrafficSpec};
use wad_cosim::vehicle::EgoParams;

#[tokio::test]
async fn wherever_an_ego_is_put_down_sumo_has_it_on_its_lane() {
    let folder = tempfile::tempdir().expect("a folder");
    let (mut bridge, mut places, mut ego) = in_town("town3", Counts::new(0, 0), 7, folder.path()).await;
    let network = bridge.network().clone();
    for again in 0..40 {
        let from = places.place(&network);
        ego.respawn(places.route_from(&network, from).expect("a route"), 0.0);
        for _ in 0..6 {
            tick(&mut bridge, &mut ego, STAND).await;
        }
        let lane = ego.route().at(ego.on_route().front_s).lane;
        assert_eq!(sumo_lane(&mut bridge).await, network.lane(lane).id, "place {again}");
    }
    bridge.close().await.expect("closed");
}

/// A bundled town with `counts`, and an ego at the first of the places that are drawn from `seed`.
async fn in_town(town: &str, counts: Counts, seed: u64, folder: &Path) -> (Bridge, Destinations, Ego) {
    let net = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("sumo_nets/{town}/{town}.net.xml"));
    let options = BridgeOptions { traffic: TrafficSpec::Counts(counts), ..BridgeOptions::new(net, folder) };
    let mut bridge = Bridge::start(&options).await.expect("SUMO starts");
    let network = bridge.network();
    let mut places = Destinations::new(network, wad_cosim::seeds::rng(seed, "route")).expect("places");
    let from = places.place(network);
    let first = places.route_from(network, from).expect("a route");
    let mut ego = Ego::new("ego", EgoParams::default(), first, 0.0);
    bridge.spawn(&mut ego).await.expect("the ego is in");
    (bridge, places, ego)
}

/// Vehicles that the population takes out do not arrive: the count once grew with each, to 1,009 where SUMO had 71.
#[tokio::test]
async fn the_count_of_vehicles_is_sumos_own() {
    let dir = tempfile::tempdir().unwrap();
    let (mut bridge, _, mut ego) = in_town("town5", Counts::new(70, 20), 3, dir.path()).await;
    let mut seen = 0;
    for tick in 0..900 {
        match tick {
            300 => drop(bridge.resize_traffic(Counts::new(20, 20))),
            500 => drop(bridge.resize_traffic(Counts::new(60, 20))),
            700 => {
                let place = ego.state().pose.xy();
                let near: Vec<_> =
                    bridge.network().lanes_near(place, None, 60.0).iter().map(|n| n.lane).collect();
                bridge.clear(place, 60.0, &near).await.expect("an answer");
            }
            _ => {}
        }
        bridge.step(&mut [&mut ego]).await.expect("a step");
        if tick % 20 == 0 {
            let there = bridge.client_mut().get(vehicle::ID_COUNT, "").await.expect("a count");
            assert_eq!(
                bridge.counts().0 as i32,
                there - 1,
                "tick {tick}: background vehicles, counted and in SUMO"
            );
            seen = seen.max(there);
        }
    }
    assert!(seen > 40, "{seen}");
    bridge.close().await.expect("closed");
}

#[tokio::test]
async fn sumo_knows_the_egos_way_beyond_the_next_junction_all_along() {
    let folder = tempfile::tempdir().expect("a folder");
    let (mut bridge, mut places, mut ego) = in_town("town5", Counts::new(10, 0), 3, folder.path()).await;
    let network = bridge.network().clone();
    let mut pilot = Autopilot::new(AutopilotParams::default(), EgoModel::from(ego.params()));
    let (mut edges_seen, mut arrivals) = (std::collections::BTreeSet::new(), 0);
    for _ in 0..1500 {
        let s = ego.on_route().s;
        let decision = pilot.control(&network, ego.route(), s, &ego.state(), ego.world(), bridge.tick());
        ego.advance(decision.control, bridge.tick());
        bridge.step(&mut [&mut ego]).await.expect("the ego is not lost");
        let mut batch = Batch::new();
        let (way, index) = (batch.get(vehicle::ROUTE, "ego"), batch.get(vehicle::ROUTE_INDEX, "ego"));
        let replies = bridge.client_mut().send(&batch).await.expect("SUMO answers");
        let way = replies.get(way).expect("a route");
        let index = replies.get(index).expect("an index").max(0) as usize;
        // SUMO's vehicle is where its front bumper is.
        let at = ego.route().edge_index_at(ego.on_route().front_s);
        let current = &network.edge(ego.route().edges[at]).id;
        assert!(way.len() > index + 1, "tick {}: {way:?} ends at {current}", bridge.time());
        assert!(way.len() <= 6, "what is behind it is kept, which move_to_xy pays for: {way:?}");
        assert!(way[index..].iter().take(2).any(|e| e == current), "{way:?} from {index} for {current}");
        if let Some(&next) = ego.route().edges.get(at + 1) {
            assert!(way[index..].contains(&network.edge(next).id), "{way:?} lacks the next edge");
        }
        edges_seen.insert(current.clone());
        if ego.on_route().s > ego.route().length() - 6.0 {
            arrivals += 1;
            let lane = ego.lane();
            let here = network.lane(lane).shape.project(ego.state().pose.xy()).s;
            let from = LanePosition { lane, s: (here - 4.0).max(0.0) };
            let on = places.route_from(&network, from).expect("a way on");
            ego.set_route(on, here - from.s);
        }
    }
    assert!(edges_seen.len() > 10 && arrivals > 0, "{edges_seen:?}, {arrivals} arrivals");
    bridge.close().await.expect("closed");
}

/// What the bridge shows against what SUMO says of everybody, across jumps too.
#[tokio::test]
async fn it_sees_each_person_within_sight_and_nobody_else() {
    let folder = tempfile::tempdir().expect("a folder");
    let (mut bridge, mut places, mut ego) = in_town("town5", Counts::new(0, 300), 5, folder.path()).await;
    let network = bridge.network().clone();
    let mut pilot = Autopilot::new(AutopilotParams::default(), EgoModel::from(ego.params()));
    let (mut came, mut before) = (0, std::collections::BTreeSet::new());
    for tick in 0..900 {
        let decision =
            pilot.control(&network, ego.route(), ego.on_route().s, &ego.state(), ego.world(), bridge.tick());
        ego.advance(decision.control, bridge.tick());
        if tick % 300 == 299 {
            // Elsewhere within a tick: nobody there is known yet.
            let from = places.place(&network);
            ego.respawn(places.route_from(&network, from).expect("a route"), 0.0);
        }
        bridge.step(&mut [&mut ego]).await.expect("a step");
        let mut batch = Batch::new();
        let ids = batch.get(person::ID_LIST, "");
        let all = bridge.client_mut().send(&batch).await.expect("SUMO answers").get(ids).expect("ids");
        let mut batch = Batch::new();
        let tickets: Vec<_> = all.iter().map(|id| batch.get(person::POSITION, id)).collect();
        let replies = bridge.client_mut().send(&batch).await.expect("SUMO answers");
        let (front, _) = ego.state().pose.to_sumo(ego.params().length);
        let near = all.iter().zip(tickets).filter(|(_, ticket)| {
            let p = replies.get(*ticket).expect("a position");
            (p.x - front.x).hypot(p.y - front.y) <= 100.0
        });
        let there: std::collections::BTreeSet<String> = near.map(|(id, _)| id.clone()).collect();
        let seen = ego.world().pedestrians.iter().map(|actor| actor.id.to_string()).collect();
        assert_eq!(there, seen, "tick {tick}");
        came += there.difference(&before).count();
        before = there;
    }
    assert!(came > 50, "too quiet a place: {came} came into sight");
    bridge.close().await.expect("closed");
}
