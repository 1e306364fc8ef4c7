//! Scenarios on a real SUMO: their events happen, and every mistake is named.

use std::path::{Path, PathBuf};
use wad_cosim::autopilot::Reason;
use wad_cosim::bridge::BridgeOptions;
use wad_cosim::bundled;
use wad_cosim::drive::{Drive, DriveOptions};
use wad_cosim::env::{End, Ending};
use wad_cosim::scenario::{self, Scenario};
use wad_cosim::telemetry::TickRecord;
use wad_cosim::traci::{lane, traffic_light, vehicle};
use wad_cosim::world::Actor;

/// A shipped scenario's folder copied to where it may be changed, with the towns where it looks for them.
pub struct Copy {
    _dir: tempfile::TempDir,
    pub folder: PathBuf,
    pub name: String,
}

impl Copy {
    pub fn of(name: &str) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let shipped = bundled::resolve(name).unwrap();
        let from = shipped.parent().unwrap();
        let folder = dir.path().join("scenarios").join(name);
        std::fs::create_dir_all(&folder).unwrap();
        for file in std::fs::read_dir(from).unwrap() {
            let file = file.unwrap();
            std::fs::copy(file.path(), folder.join(file.file_name())).unwrap();
        }
        for town in ["town3", "town5"] {
            let to = dir.path().join("sumo_nets").join(town);
            std::fs::create_dir_all(&to).unwrap();
            for kind in ["net", "poly"] {
                let file = format!("{town}.{kind}.xml");
                std::fs::copy(from.join("../../sumo_nets").join(town).join(&file), to.join(file)).unwrap();
            }
        }
        Self { _dir: dir, folder, name: name.to_string() }
    }

    pub fn config(&self) -> PathBuf {
        self.folder.join(format!("{}.sumocfg", self.name))
    }

    /// Replaces the first `old` in the file with that ending.
    pub fn change(&self, ending: &str, old: &str, new: &str) -> &Self {
        let path = self.folder.join(format!("{}.{ending}", self.name));
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(old), "{}: no {old} in {text}", path.display());
        std::fs::write(&path, text.replacen(old, new, 1)).unwrap();
        self
    }

    /// What `check` says of it.
    fn problems(&self) -> String {
        let found = scenario::inspect(&self.config()).problems;
        found.iter().map(|problem| format!("{problem}\n")).collect()
    }
}

/// Drives a scenario under the autopilot to its end; `look` sees each tick.
fn drive(config: &Path, mut look: impl FnMut(&Drive, &TickRecord)) -> Ending {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let dir = tempfile::tempdir().unwrap();
    runtime.block_on(async {
        let mut drive = start(config, dir.path()).await;
        while drive.ending().is_none() {
            let status = drive.tick().await.unwrap();
            look(&drive, &status.record);
        }
        let ending = drive.ending().cloned().unwrap();
        drive.finish(false).await.unwrap();
        ending
    })
}

async fn start(config: &Path, out: &Path) -> Drive {
    let traffic = Scenario::load(config).unwrap().traffic;
    let bridge = BridgeOptions { traffic, scenario: true, ..BridgeOptions::new(config, out.join("sumo")) };
    Drive::start(DriveOptions::new(bridge, out.join("run"))).await.unwrap()
}

fn shipped(name: &str) -> PathBuf {
    bundled::resolve(name).unwrap()
}

fn others<'a>(drive: &'a Drive, begin: &str) -> Vec<&'a Actor> {
    let world = drive.ego().world();
    world.vehicles.iter().chain(&world.pedestrians).filter(|a| a.id.starts_with(begin)).collect()
}

#[test]
fn every_shipped_scenario_is_without_mistakes() {
    let names = bundled::scenarios();
    assert!(names.len() >= 12, "{names:?}");
    for name in names {
        let found = scenario::inspect(&shipped(&name));
        assert!(found.problems.is_empty(), "{name}: {:?}", found.problems);
        assert!(found.scenario.is_some(), "{name}");
    }
}

#[test]
fn a_pedestrian_steps_out_and_the_autopilot_brakes() {
    let (mut walked, mut braked, mut fastest, mut slowest) = (0.0_f64, false, 0.0_f64, f64::INFINITY);
    let mut first = None;
    let ending = drive(&shipped("pedestrian_steps_out"), |drive, record| {
        if let Some(person) = others(drive, "wad_scene_").first() {
            let from = *first.get_or_insert(person.pose.xy());
            walked = walked.max((person.pose.xy() - from).norm());
        }
        braked |= matches!(record.reason, Some(Reason::Pedestrian { .. } | Reason::Crossing { .. }));
        fastest = fastest.max(record.ego.speed);
        if braked {
            slowest = slowest.min(record.ego.speed);
        }
    });
    assert!(walked > 6.0, "across the road: {walked} m");
    assert!(braked && slowest < 0.5 * fastest, "from {fastest} to {slowest} m/s");
    assert_eq!((ending.end, ending.success), (End::Arrival, true), "{ending:?}");
}

#[test]
fn the_vehicle_ahead_brakes_hard_and_is_not_hit() {
    let (mut hardest, mut stood, mut last) = (0.0_f64, false, None);
    let ending = drive(&shipped("leader_brakes"), |drive, _| {
        let tick = drive.bridge().tick();
        if let Some(leader) = others(drive, "wad_scene_").first() {
            if let Some(last) = last {
                hardest = hardest.max((last - leader.speed) / tick);
            }
            stood |= hardest > 6.0 && leader.speed < 0.1;
            last = Some(leader.speed);
        }
    });
    assert!(hardest > 6.0 && stood, "{hardest} m/s2");
    assert_eq!((ending.end, ending.success), (End::Arrival, true), "{ending:?}");
}

/// It was once put at the begin of the road before the junction, on its sidewalk.
#[test]
fn a_vehicle_ahead_whose_gap_ends_in_a_junction_begins_behind_it() {
    let copy = Copy::of("leader_brakes");
    copy.change("rou.xml", "departPos=\"10.43\"", "departPos=\"285\"")
        .change("rou.xml", "to=\"f2f1\"", "to=\"f1D3\"")
        .change("rou.xml", "arrivalPos=\"289.64\"", "arrivalPos=\"45\"")
        .change("add.xml", "pos=\"128.95\"", "pos=\"288.95\"")
        .change("add.xml", "/>\n</add", "><param key=\"wad.gap\" value=\"12\"/></poi>\n</add");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let dir = tempfile::tempdir().unwrap();
    runtime.block_on(async {
        let mut drive = start(&copy.config(), dir.path()).await;
        for _ in 0..4 {
            drive.tick().await.unwrap();
        }
        let lane = others(&drive, "wad_scene_")[0].lane.unwrap();
        assert_eq!(drive.bridge().network().lane(lane).id, "f1D3_1");
    });
    copy.change("add.xml", "value=\"12\"", "value=\"90\"");
    let said = copy.problems();
    assert!(said.contains("`wad.gap` is `90`") && said.contains("choose a smaller gap"), "{said}");
}

#[test]
fn an_accident_blocks_the_lane_and_is_passed_on_the_next() {
    let mut seen = 0;
    let look = |drive: &Drive, _: &TickRecord| {
        let wrecks = others(drive, "wad_scene_");
        if wrecks.len() == 2 {
            seen += 1;
            assert!(wrecks.iter().all(|wreck| wreck.speed < 0.05), "{wrecks:?}");
            let askew = wrecks[0].pose.heading - wrecks[1].pose.heading;
            assert!(askew.abs() > 0.15, "{askew}");
        }
    };
    let ending = drive(&shipped("accident_ahead"), look);
    assert!(seen > 20, "{seen}");
    assert_eq!((ending.end, ending.success), (End::Arrival, true), "{ending:?}");

    // The same without the way round it: the ego stands behind the wrecks until its time is over.
    let copy = Copy::of("accident_ahead");
    let path = copy.folder.join("accident_ahead.rou.xml");
    let text = std::fs::read_to_string(&path).unwrap();
    let kept: Vec<&str> = text.lines().filter(|l| !l.contains("wad.via")).collect();
    let value =
        |name: &str| text.split(&format!("{name}=\"")).nth(1).unwrap().split('"').next().unwrap().to_string();
    let arrival = |lane: &str| format!("arrivalLane=\"{lane}\"");
    let kept = kept.join("\n").replace(&arrival(&value("arrivalLane")), &arrival(&value("departLane")));
    std::fs::write(&path, kept).unwrap();
    let mut nearest = f64::INFINITY;
    let ending = drive(&copy.config(), |_, record| {
        if let Some(leader) = record.leader {
            nearest = nearest.min(leader.gap);
        }
    });
    assert_eq!((ending.end, ending.success), (End::Timeout, false), "{ending:?}");
    assert!((0.5..6.0).contains(&nearest), "{nearest}");
}

/// SUMO once refused a scenario's vehicles in as-is traffic, because their types were not defined there.
#[test]
fn as_is_traffic_is_the_scenarios_own_vehicles() {
    let copy = Copy::of("accident_ahead");
    copy.change("rou.xml", "value=\"empty\"", "value=\"as-is\"");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let dir = tempfile::tempdir().unwrap();
    runtime.block_on(async {
        let mut drive = start(&copy.config(), dir.path()).await;
        for _ in 0..6 {
            drive.tick().await.unwrap();
        }
        let there = drive.bridge_mut().client_mut().get(vehicle::ID_COUNT, "").await.unwrap();
        assert_eq!(there, 3, "the ego and the two wrecks");
    });
}

#[test]
fn a_signal_goes_out_of_order() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let dir = tempfile::tempdir().unwrap();
    let config = shipped("signal_out_of_order");
    let scenario = Scenario::load(&config).unwrap();
    let lights: Vec<String> = scenario
        .things
        .iter()
        .filter_map(|thing| match &thing.kind {
            scenario::Kind::SignalOff { light, .. } => Some(light.clone()),
            _ => None,
        })
        .collect();
    assert_eq!(lights.len(), 1);
    runtime.block_on(async {
        let mut drive = start(&config, dir.path()).await;
        let mut seen_off = false;
        while drive.ending().is_none() {
            let record = drive.tick().await.unwrap().record;
            seen_off |= record.light.is_some_and(|light| light.state == wad_cosim::world::SignalState::Off);
        }
        let ending = drive.ending().cloned().unwrap();
        assert_eq!((ending.end, ending.success), (End::Arrival, true), "{ending:?}");
        assert!(seen_off, "the ego sees it");
    });
    // SUMO itself says so.
    let dir = tempfile::tempdir().unwrap();
    runtime.block_on(async {
        let mut drive = start(&config, dir.path()).await;
        drive.tick().await.unwrap();
        let client = drive.bridge_mut().client_mut();
        let state = client.get(traffic_light::STATE, &lights[0]).await.unwrap();
        assert!(state.chars().all(|c| matches!(c, 'o' | 'O')), "{state}");
    });
}

#[test]
fn a_closed_lane_is_closed_to_sumos_traffic_and_passed() {
    for name in ["lane_closed", "road_works"] {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let config = shipped(name);
        let scenario = Scenario::load(&config).unwrap();
        let closed = scenario.things[0].lane;
        runtime.block_on(async {
            let mut drive = start(&config, dir.path()).await;
            let lane_id = drive.bridge().network().lane(closed).id.clone();
            drive.tick().await.unwrap();
            let allowed = drive.bridge_mut().client_mut().get(lane::ALLOWED, &lane_id).await.unwrap();
            assert_eq!(allowed, ["authority"], "{name}");
            let mut barriers = 0;
            while drive.ending().is_none() {
                drive.tick().await.unwrap();
                barriers = barriers.max(others(&drive, "wad_scene_").len());
            }
            assert!(barriers >= 4, "{name}: {barriers}");
            let ending = drive.ending().cloned().unwrap();
            assert_eq!((ending.end, ending.success), (End::Arrival, true), "{name}: {ending:?}");
        });
    }
}

#[test]
fn the_obstacle_task_is_judged_by_where_the_ego_stands() {
    let ending = drive(&shipped("obstacle"), |_, _| {});
    assert_eq!((ending.end, ending.success), (End::Survived, true), "{ending:?}");
    assert!(ending.cause.contains("before the obstacle"), "{ending:?}");
}

/// Every mistake that netedit lets an author make: what is changed, and what `check` then says.
#[test]
fn every_mistake_is_named_with_file_element_and_fix() {
    type Change = (&'static str, &'static str, &'static str, &'static str, &'static [&'static str]);
    let changes: &[Change] = &[
        (
            "accident_ahead",
            "rou.xml",
            "wad.weather",
            "wad.wether",
            &["rou.xml:", "trip `ego`", "unknown parameter `wad.wether`", "did you mean wad.weather?"],
        ),
        (
            "accident_ahead",
            "rou.xml",
            "wad.weather",
            "weather",
            &["unknown parameter `weather`", "did you mean wad.weather?"],
        ),
        (
            "accident_ahead",
            "rou.xml",
            "ClearNoon",
            "ClearNon",
            &["`wad.weather` is `ClearNon`", "did you mean ClearNoon"],
        ),
        (
            "accident_ahead",
            "rou.xml",
            "value=\"navigation\"",
            "value=\"navigatoin\"",
            &["`wad.task` is `navigatoin`", "did you mean navigation?"],
        ),
        (
            "accident_ahead",
            "rou.xml",
            "value=\"empty\"",
            "value=\"many\"",
            &["`wad.traffic` is `many`", "VEHICLES,PEDESTRIANS"],
        ),
        (
            "accident_ahead",
            "rou.xml",
            "wad.time_limit\" value=\"",
            "wad.time_limit\" value=\"-",
            &["`wad.time_limit` is `-", "number of seconds from 1"],
        ),
        (
            "accident_ahead",
            "rou.xml",
            "type=\"ego\"",
            "type=\"car\"",
            &["accident_ahead.sumocfg", "no ego", "make a vehicle type `ego`"],
        ),
        (
            "accident_ahead",
            "rou.xml",
            "<vType id=\"ego\"",
            "<vType id=\"other\"",
            &["its type `ego` is not defined", "add <vType id=\"ego\"/>"],
        ),
        (
            "accident_ahead",
            "rou.xml",
            "</routes>",
            "<trip id=\"two\" type=\"ego\" from=\"a\" to=\"b\"/></routes>",
            &["trip `two`", "a second ego", "delete it"],
        ),
        (
            "accident_ahead",
            "rou.xml",
            "departPos=\"",
            "departPos=\"9",
            &["departPos is `9", "metres from 0 to the lane's"],
        ),
        (
            "accident_ahead",
            "rou.xml",
            "departLane=\"",
            "departLane=\"7",
            &["departLane is `7", "cars may use lane"],
        ),
        ("accident_ahead", "rou.xml", "from=\"", "from=\"X", &["its first edge `X", "did you mean"]),
        (
            "accident_ahead",
            "rou.xml",
            "<param key=\"wad.task",
            "<param key=\"wad.destination\" value=\"X\"/><param key=\"wad.task",
            &["`wad.destination` `X`", "neither an edge nor a lane"],
        ),
        (
            "accident_ahead",
            "rou.xml",
            "wad.via\" value=\"",
            "wad.via\" value=\"nowhere ",
            &["`wad.via` `nowhere`", "neither an edge nor a lane"],
        ),
        ("accident_ahead", "rou.xml", "@", "@x", &["position of", "metres from 0"]),
        (
            "accident_ahead",
            "rou.xml",
            "</routes>",
            "",
            &["accident_ahead.rou.xml", "not well-formed XML", "save it again in netedit"],
        ),
        (
            "accident_ahead",
            "add.xml",
            "event.accident",
            "event.acident",
            &["add.xml:", "poi `", "unknown type `event.acident`", "did you mean event.accident?"],
        ),
        // Both at once.
        (
            "accident_ahead",
            "add.xml",
            "event.accident\" lane=\"A3SW2_0\" pos=\"",
            "event.acident\" lane=\"A3SW2_0\" pos=\"9999",
            &["did you mean event.accident?", "pos is `9999", "metres from 0 to the lane's"],
        ),
        (
            "accident_ahead",
            "add.xml",
            "event.accident",
            "roadworks",
            &["type `roadworks` does not go with a point", "polygon"],
        ),
        (
            "accident_ahead",
            "add.xml",
            "pos=\"",
            "pos=\"9999",
            &["pos is `9999", "metres from 0 to the lane's"],
        ),
        ("accident_ahead", "add.xml", "lane=\"", "lane=\"X", &["its lane `X", "not in the net"]),
        (
            "accident_ahead",
            "add.xml",
            "pos=\"",
            "posLat=\"60\" pos=\"",
            &["lies off the road", "move it to within"],
        ),
        (
            "pedestrian_steps_out",
            "add.xml",
            "</poi>\n</additional>",
            "<param key=\"wad.speed\" value=\"fast\"/></poi>\n</additional>",
            &["`wad.speed` is `fast`", "metres a second"],
        ),
        (
            "pedestrian_steps_out",
            "add.xml",
            "</poi>\n</additional>",
            "<param key=\"wad.person\" value=\"chld\"/></poi>\n</additional>",
            &["`wad.person` is `chld`", "did you mean child?"],
        ),
        (
            "pedestrian_steps_out",
            "add.xml",
            "</poi>\n</additional>",
            "<param key=\"wad.gap\" value=\"3\"/></poi>\n</additional>",
            &["unknown parameter `wad.gap`"],
        ),
        (
            "signal_out_of_order",
            "add.xml",
            "/>\n</additional>",
            "><param key=\"wad.signal\" value=\"nowhere\"/></poi>\n</additional>",
            &["no traffic light `nowhere`", "leave it out"],
        ),
        (
            "obstacle",
            "add.xml",
            "obstacle.car",
            "obstacle.cone",
            &["trip `ego`", "no obstacle stands on its route"],
        ),
        (
            "straight",
            "sumocfg",
            "town5.net.xml",
            "town9.net.xml",
            &["straight.sumocfg", "town9.net.xml", "does not exist"],
        ),
    ];
    let mut failures = String::new();
    for (name, file, old, new, expected) in changes {
        let copy = Copy::of(name);
        copy.change(file, old, new);
        let said = copy.problems();
        for part in *expected {
            if !said.contains(part) {
                failures += &format!("{name} {file} {old:?} -> {new:?}: no {part:?} in {said:?}\n");
            }
        }
    }
    assert!(failures.is_empty(), "{failures}");
}

#[test]
fn five_mistakes_are_told_at_once() {
    let copy = Copy::of("accident_ahead");
    copy.change("rou.xml", "from=\"", "from=\"X")
        .change("rou.xml", "arrivalPos=\"", "arrivalPos=\"9")
        .change("rou.xml", "arrivalLane=\"", "arrivalLane=\"7")
        .change("rou.xml", "wad.via\" value=\"", "wad.via\" value=\"nowhere elsewhere ")
        .change("rou.xml", "ClearNoon", "ClearNon")
        .change("add.xml", "pos=\"", "posLat=\"60\" pos=\"")
        .change("add.xml", "car,truck", "tank,car");
    let said = copy.problems();
    for mistake in [
        "its first edge `X",
        "arrivalPos is `9",
        "arrivalLane is `7",
        "`wad.via` `nowhere`",
        "`wad.via` `elsewhere`",
        "`wad.weather` is `ClearNon`",
        "lies off the road",
        "`wad.vehicles` is `tank`",
    ] {
        assert!(said.contains(mistake), "{mistake} is missing in {said}");
    }
    assert_eq!(said.lines().count(), 8, "{said}");

    // Files that cannot be read: all of them, and no complaint that follows from it.
    let copy = Copy::of("accident_ahead");
    copy.change("sumocfg", ".net.xml", ".nett.xml").change("rou.xml", "</routes>", "");
    std::fs::remove_file(copy.folder.join("accident_ahead.add.xml")).unwrap();
    let said = copy.problems();
    for mistake in
        [".nett.xml`, which does not exist", "not well-formed XML", "accident_ahead.add.xml: cannot be read"]
    {
        assert!(said.contains(mistake), "{mistake} is missing in {said}");
    }
    assert_eq!(said.lines().count(), 3, "{said}");
}

#[test]
fn a_destination_moved_in_netedit_wins_over_the_parameter() {
    let copy = Copy::of("straight");
    let drawn = Scenario::load(&copy.config()).unwrap().placement.to;
    let edge = drawn.lane.rsplit_once('_').unwrap().0.to_string();
    let param =
        |value: &str| format!("<param key=\"wad.destination\" value=\"{value}\"/><param key=\"wad.task");
    copy.change("rou.xml", "<param key=\"wad.task", &param("NW2A4_0@20"));
    assert_eq!(Scenario::load(&copy.config()).unwrap().placement.to, drawn);
    // On the drawn edge it says the lane, and what is drawn of lane and position wins again.
    let lane = format!("{edge}_1");
    copy.change("rou.xml", "NW2A4_0@20", &format!("{lane}@12"));
    assert_eq!(Scenario::load(&copy.config()).unwrap().placement.to, drawn);
}

#[test]
fn a_destination_that_cannot_be_reached_is_said_so() {
    let copy = Copy::of("straight");
    // A net of two roads that nothing joins.
    std::fs::write(
        copy.folder.join("apart.net.xml"),
        r#"<net version="1.20"><location netOffset="0,0" convBoundary="0,0,300,50" origBoundary="0,0,300,50" projParameter="!"/>
        <edge id="a" from="a0" to="a1" priority="1"><lane id="a_0" index="0" speed="13.9" length="300" shape="0,0 300,0"/></edge>
        <edge id="b" from="b0" to="b1" priority="1"><lane id="b_0" index="0" speed="13.9" length="300" shape="0,50 300,50"/></edge>
        <junction id="a0" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0 0,-3"/><junction id="a1" type="dead_end" x="300" y="0" incLanes="a_0" intLanes="" shape="300,0 300,-3"/>
        <junction id="b0" type="dead_end" x="0" y="50" incLanes="" intLanes="" shape="0,50 0,47"/><junction id="b1" type="dead_end" x="300" y="50" incLanes="b_0" intLanes="" shape="300,50 300,47"/></net>"#,
    )
    .unwrap();
    let text = std::fs::read_to_string(copy.config()).unwrap();
    let net = text.split("net-file value=\"").nth(1).unwrap().split('"').next().unwrap().to_string();
    copy.change("sumocfg", &net, "apart.net.xml");
    std::fs::write(
        copy.folder.join("straight.rou.xml"),
        r#"<routes><vType id="ego"/><trip id="ego" type="ego" depart="0" from="a" to="b"/></routes>"#,
    )
    .unwrap();
    let said = copy.problems();
    assert!(said.contains("its destination cannot be reached") && said.contains("trip `ego`"), "{said}");
}
