//! The TraCI client against a real SUMO.

mod process;
mod setters;
mod subscriptions;
mod variables;

use std::path::PathBuf;
use std::time::Duration;
use tempfile::TempDir;
use wad_cosim::traci::vehicle::MoveToXy;
use wad_cosim::traci::*;

/// A 3x3 grid with signals, sidewalks and crossings, two routes, and a stream of cars; gone when dropped.
struct Town {
    folder: TempDir,
}

impl Town {
    fn new() -> Self {
        let town = Self { folder: tempfile::tempdir().unwrap() };
        let install = SumoInstall::find().unwrap();
        let net = town.path("net.net.xml");
        let made = install
            .command("netgenerate")
            .args(["--grid", "--grid.number", "3", "--grid.length", "150", "--default.lanenumber", "2"])
            .args(["--default.speed", "13.89", "--tls.guess", "--sidewalks.guess", "--crossings.guess"])
            .args(["--walkingareas", "--no-turnarounds", "--seed", "1", "--output-file"])
            .arg(&net)
            .output()
            .unwrap();
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let demand = r#"<routes>
            <vType id="car" length="5" minGap="2.5" sigma="0" lcSpeedGain="0" lcKeepRight="0"/>
            <route id="east" edges="A1B1 B1C1"/>
            <route id="north" edges="B0B1 B1B2"/>
            <vehicle id="first" type="car" route="east" depart="0" departLane="1" departPos="20" departSpeed="5"/>
            <vehicle id="second" type="car" route="east" depart="0" departLane="1" departPos="5" departSpeed="5"/>
            <flow id="flow" type="car" route="north" begin="0" end="200" period="5"/>
        </routes>"#;
        std::fs::write(town.path("demand.rou.xml"), demand).unwrap();
        let config = r#"<configuration>
            <net-file value="net.net.xml"/>
            <route-files value="demand.rou.xml"/>
        </configuration>"#;
        std::fs::write(town.path("town.sumocfg"), config).unwrap();
        town
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn options(&self) -> LaunchOptions {
        let mut options = LaunchOptions::config(self.path("town.sumocfg")).option("time-to-teleport", -1);
        options.seed = Some(42);
        options.step_length = Some(0.5);
        options
    }

    async fn launch(&self) -> (SumoProcess, TcpClient) {
        SumoProcess::launch(&self.options()).await.unwrap()
    }
}

/// Sends a batch, none of whose commands may fail.
async fn send(client: &mut TcpClient, batch: &Batch) -> Replies {
    let replies = client.send(batch).await.unwrap();
    let failures: Vec<String> = replies.failures().map(ToString::to_string).collect();
    assert!(failures.is_empty(), "{failures:#?}");
    replies
}

/// Steps a few times.
async fn steps(client: &mut TcpClient, n: usize) {
    for _ in 0..n {
        client.step().await.unwrap();
    }
}

#[tokio::test]
async fn vehicles_move_and_sumo_ends_on_close() {
    let town = Town::new();
    let (mut sumo, mut client) = town.launch().await;
    assert_eq!(client.version().software, "SUMO 1.28.0");
    steps(&mut client, 4).await;
    let mut batch = Batch::new();
    let speed = batch.get(vehicle::SPEED, "first");
    let time = batch.get(simulation::TIME, "");
    batch.step();
    let replies = send(&mut client, &batch).await;
    assert!(replies.get(speed).unwrap() > 5.0);
    assert_eq!(replies.get(time).unwrap(), 2.0);
    client.close().await.unwrap();
    let status = sumo.wait_at_most(Duration::from_secs(10)).await.unwrap();
    assert!(status.success(), "{}", sumo.post_mortem());
}

/// Puts a few things in, so that every domain has an object.
async fn furnish(client: &mut TcpClient) {
    let mut batch = Batch::new();
    let walk =
        person::WalkingStage { edges: &["A1B1", "B1C1"], arrival_position: 30.0, ..Default::default() };
    person::add(&mut batch, "walker", &person::Add { edge: "A1B1", position: 10.0, ..Default::default() });
    person::append_walking_stage(&mut batch, "walker", &walk);
    let square = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)].map(|(x, y)| Position2D { x, y });
    polygon::add(&mut batch, "park", &polygon::Add { shape: &square, fill: true, ..Default::default() });
    poi::add(&mut batch, "tree", &poi::Add { position: square[1], ..Default::default() });
    send(client, &batch).await;
    steps(client, 4).await;
}

/// Puts the ego on A1B1, as the bridge does.
async fn add_ego(client: &mut TcpClient) {
    let mut batch = Batch::new();
    route::add(&mut batch, "ego_route", &["A1B1", "B1C1"]);
    let add = vehicle::Add { route: "ego_route", depart_pos: "40", depart_lane: "1", ..Default::default() };
    vehicle::add(&mut batch, "ego", &add);
    batch.set(vehicle::SET_SPEED_MODE, "ego", 0);
    batch.set(vehicle::SET_LANE_CHANGE_MODE, "ego", 0);
    batch.set(vehicle::SET_COLOR, "ego", Color::rgb(255, 0, 0));
    batch.step();
    send(client, &batch).await;
}

#[tokio::test]
async fn a_failing_command_does_not_stop_the_others() {
    let town = Town::new();
    let (_sumo, mut client) = town.launch().await;
    steps(&mut client, 2).await;
    let mut batch = Batch::new();
    let before = batch.get(vehicle::LANE_POSITION, "first");
    let nobody = batch.get(vehicle::SPEED, "nobody");
    let wrong = batch.set(vehicle::SET_ROUTE_ID, "first", "no such route");
    // A command that SUMO has never heard of.
    let unknown = batch.set_raw(vehicle::Vehicle, 0xfe, "nonsense", "first", 1.0);
    let after = batch.get(vehicle::ROUTE_ID, "first");
    batch.step();
    let replies = client.send(&batch).await.unwrap();
    assert!(replies.get(before).unwrap() > 20.0);
    let error = replies.get(nobody).unwrap_err();
    assert_eq!((error.object.as_str(), error.command.as_str()), ("nobody", "get vehicle SPEED"));
    assert_eq!(error.message, "Vehicle 'nobody' is not known.");
    assert!(replies.get(wrong).is_err() && replies.get(unknown).is_err());
    assert_eq!(replies.get(after).unwrap(), "east");
    assert_eq!(replies.check().unwrap_err().object, "nobody");
    assert_eq!(replies.failures().count(), 3);
    assert_eq!(client.get(simulation::TIME, "").await.unwrap(), 1.5);
}

#[tokio::test]
async fn the_ego_goes_exactly_where_it_is_put() {
    let town = Town::new();
    let (_sumo, mut client) = town.launch().await;
    add_ego(&mut client).await;
    let mut batch = Batch::new();
    for tick in 0..20 {
        let to = MoveToXy {
            x: 60.0 + f64::from(tick) * 3.0,
            y: 146.0,
            angle_deg: 92.0,
            keep_route: 3,
            ..Default::default()
        };
        batch.clear();
        vehicle::move_to_xy(&mut batch, "ego", &to);
        batch.step();
        send(&mut client, &batch).await;
        batch.clear();
        let place = batch.get(vehicle::POSITION, "ego");
        let angle = batch.get(vehicle::ANGLE, "ego");
        let speed = batch.get(vehicle::SPEED, "ego");
        let replies = send(&mut client, &batch).await;
        let place = replies.get(place).unwrap();
        assert!((place.x - to.x).abs() < 1e-6 && (place.y - to.y).abs() < 1e-6, "{place:?}");
        assert_eq!(replies.get(angle).unwrap(), 92.0);
        if tick > 0 {
            assert!((replies.get(speed).unwrap() - 6.0).abs() < 0.5);
        }
    }
    assert_eq!(client.get(vehicle::ROUTE, "ego").await.unwrap(), ["A1B1", "B1C1"]);
}

#[tokio::test]
async fn commands_to_vehicles_and_persons() {
    let town = Town::new();
    let (_sumo, mut client) = town.launch().await;
    steps(&mut client, 4).await;
    let mut batch = Batch::new();
    vehicle_type::copy(&mut batch, "car", "bus");
    batch.set(vehicle_type::SET_LENGTH, "bus", 12.0);
    route::add(&mut batch, "back", &["C1B1", "B1A1"]);
    vehicle::add(
        &mut batch,
        "bus0",
        &vehicle::Add { route: "back", vehicle_type: "bus", depart_pos: "30", ..Default::default() },
    );
    vehicle::change_lane(&mut batch, "second", 2, 10.0);
    vehicle::change_lane_relative(&mut batch, "first", 1, 10.0);
    vehicle::slow_down(&mut batch, "second", 2.0, 3.0);
    vehicle::set_acceleration(&mut batch, "first", 1.0, 1.0);
    vehicle::set_previous_speed(&mut batch, "first", 5.0, 0.5);
    vehicle::reroute_travel_time(&mut batch, "first");
    vehicle::reroute_effort(&mut batch, "first");
    vehicle::open_gap(&mut batch, "second", 3.0, 5.0, 10.0, 0.5, -1.0);
    vehicle::deactivate_gap_control(&mut batch, "second");
    vehicle::highlight(&mut batch, "first", Color::rgb(0, 255, 0), 3.0);
    vehicle::update_best_lanes(&mut batch, "first");
    vehicle::change_target(&mut batch, "first", "C1C2");
    vehicle::set_route(&mut batch, "second", &["A1B1", "B1B2"]);
    batch.set(vehicle::SET_SPEED, "first", 4.0);
    let stop = vehicle::SetStop {
        place: "A1B1",
        position: 110.0,
        lane_index: 2,
        duration: 5.0,
        ..Default::default()
    };
    vehicle::set_stop(&mut batch, "second", &stop);
    person::add(&mut batch, "p", &person::Add { edge: "A1B1", position: 5.0, ..Default::default() });
    person::append_waiting_stage(&mut batch, "p", 3.0, "looking", "");
    person::append_driving_stage(&mut batch, "p", "B1C1", "ANY", "");
    let edges = &["B1C1"];
    person::append_walking_stage(&mut batch, "p", &person::WalkingStage { edges, ..Default::default() });
    let stage = Stage {
        kind: StageKind::Walking,
        edges: vec!["A1B1".to_owned(), "B1B2".to_owned()],
        arrival_position: 20.0,
        ..Default::default()
    };
    person::replace_stage(&mut batch, "p", 1, &stage);
    let remaining = batch.get(person::STAGES_REMAINING, "p");
    batch.set(person::REMOVE_STAGE, "p", 2);
    let fewer = batch.get(person::STAGES_REMAINING, "p");
    let replaced = batch.get_with(person::stage(1), "p");
    batch.step();
    let replies = send(&mut client, &batch).await;
    assert_eq!((replies.get(remaining).unwrap(), replies.get(fewer).unwrap()), (4, 3));
    assert_eq!(replies.get(replaced).unwrap().edges, ["A1B1", "B1B2"]);
    steps(&mut client, 6).await;

    batch.clear();
    let speed = batch.get(vehicle::SPEED, "first");
    let target = batch.get(vehicle::ROUTE, "first");
    let length = batch.get(vehicle::LENGTH, "bus0");
    let lane = batch.get(vehicle::LANE_INDEX, "second");
    vehicle::move_to(&mut batch, "first", "B1C1_1", 30.0, 0);
    person::reroute_travel_time(&mut batch, "p");
    person::move_to(&mut batch, "p", "A1B1_0", 50.0, 0.0);
    person::move_to_xy(
        &mut batch,
        "p",
        &MoveToXy { x: 60.0, y: 141.0, angle_deg: 90.0, keep_route: 2, ..Default::default() },
    );
    polygon::add(
        &mut batch,
        "cloud",
        &polygon::Add { shape: &[Position2D { x: 0.0, y: 0.0 }; 3], ..Default::default() },
    );
    polygon::add_dynamics(&mut batch, "cloud", "first", &[0.0, 5.0], &[255.0, 0.0], false, true);
    poi::add(&mut batch, "mark", &poi::Add::default());
    poi::highlight(&mut batch, "mark", Color::rgb(0, 255, 0), 3.0, 255, 5.0);
    let lights = batch.get(traffic_light::PROGRAMS, "B1");
    batch.step();
    let replies = send(&mut client, &batch).await;
    assert_eq!(replies.get(speed).unwrap(), 4.0);
    assert_eq!(replies.get(target).unwrap().last().unwrap(), "C1C2");
    assert_eq!((replies.get(length).unwrap(), replies.get(lane).unwrap()), (12.0, 2));

    let mut program = replies.get(lights).unwrap().remove(0);
    program.id = "mine".to_owned();
    program.phases[0].duration = 99.0;
    batch.clear();
    traffic_light::set_program_definition(&mut batch, "B1", &program);
    let active = batch.get(traffic_light::PROGRAM, "B1");
    let programs = batch.get(traffic_light::PROGRAMS, "B1");
    let links = batch.get(traffic_light::CONTROLLED_LINKS, "B1");
    let state = batch.get(traffic_light::STATE, "B1");
    let place = batch.get(person::POSITION, "p");
    let lane = batch.get(vehicle::LANE_ID, "first");
    polygon::remove(&mut batch, "cloud", 0);
    poi::remove(&mut batch, "mark", 0);
    vehicle::remove(&mut batch, "first", RemoveReason::Vaporized);
    person::remove(&mut batch, "p", RemoveReason::Vaporized);
    route::remove(&mut batch, "back");
    batch.step();
    let replies = send(&mut client, &batch).await;
    assert_eq!(replies.get(active).unwrap(), "mine");
    assert!(replies.get(programs).unwrap().iter().any(|p| p.id == "mine" && p.phases[0].duration == 99.0));
    let links = replies.get(links).unwrap();
    assert_eq!(links.len(), replies.get(state).unwrap().len());
    assert!(
        links.iter().flatten().any(|link| link.from_lane == "A1B1_1" && link.via_lane.starts_with(":B1"))
    );
    assert!((replies.get(place).unwrap().x - 60.0).abs() < 2.0);
    // On that edge; it has since gone to the lane for its left turn.
    assert!(replies.get(lane).unwrap().starts_with("B1C1_"));
    let vehicles = client.get(vehicle::ID_LIST, "").await.unwrap();
    assert!(!vehicles.contains(&"first".to_owned()) && vehicles.contains(&"bus0".to_owned()), "{vehicles:?}");
    assert_eq!(client.get(person::ID_COUNT, "").await.unwrap(), 0);
}
