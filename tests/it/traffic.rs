//! The background population in a real SUMO, on town5.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;
use wad_cosim::geometry::{Point, Pose};
use wad_cosim::network::{EdgeKind, Network};
use wad_cosim::traci::*;
use wad_cosim::traffic::{Counts, Options, Population, StepEvents};

fn town5() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("sumo_nets/town5/town5.net.xml")
}

/// A town with its population, one message per tick.
struct Run {
    process: SumoProcess,
    client: TcpClient,
    network: Arc<Network>,
    population: Population,
    placed: Counts,
    batch: Batch,
    log: PathBuf,
    /// How long the last update took.
    update: Duration,
    _folder: TempDir,
}

/// Where everybody is after a tick, by id.
#[derive(Clone, Debug, Default, PartialEq)]
struct Census {
    vehicles: BTreeMap<String, (u64, u64)>,
    persons: BTreeMap<String, (u64, u64)>,
}

fn point(bits: (u64, u64)) -> Point {
    Point::new(f64::from_bits(bits.0), f64::from_bits(bits.1))
}

impl Run {
    async fn new(net: &Path, counts: Counts, seed: u64, options: Options, ego: Option<Pose>) -> Self {
        Self::with(net, counts, seed, options, ego, &[]).await
    }

    async fn with(
        net: &Path,
        counts: Counts,
        seed: u64,
        options: Options,
        ego: Option<Pose>,
        sumo: &[(&str, &str)],
    ) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("sumo.log");
        let mut launch = LaunchOptions::net(net)
            .option("lanechange.duration", 2)
            .option("collision.action", "warn")
            .option("collision.check-junctions", true)
            .option("collision.mingap-factor", 0)
            .option("time-to-teleport", -1);
        for (name, value) in sumo {
            launch = launch.option(name, value);
        }
        launch.step_length = Some(0.167);
        launch.seed = Some(seed as i64);
        launch.log_file = Some(log.clone());
        let (process, client) = SumoProcess::launch(&launch).await.unwrap();
        let network = Arc::new(Network::load(net).unwrap());
        let mut population = Population::new(Arc::clone(&network), counts, seed, options);
        let mut batch = Batch::new();
        Population::subscribe(&mut batch);
        Population::define_types(&mut batch);
        let placed = population.populate(&mut batch, ego.as_slice());
        Self {
            process,
            client,
            network,
            population,
            placed,
            batch,
            log,
            update: Duration::ZERO,
            _folder: folder,
        }
    }

    /// One tick; SUMO must accept every command. Returns the ids that departed.
    async fn tick(&mut self, ego: Option<Pose>) -> Vec<String> {
        self.batch.step();
        let replies = self.client.send(&self.batch).await.unwrap();
        let failures: Vec<String> = replies.failures().map(ToString::to_string).collect();
        assert!(failures.is_empty(), "{failures:#?}");
        self.batch.clear();
        let events = StepEvents::read(&replies).unwrap();
        let started = Instant::now();
        self.population.update(&events, &replies, ego.as_slice(), &[], &mut self.batch);
        self.update = started.elapsed();
        events.departed.iter().chain(&events.departed_persons).map(|id| id.to_string()).collect()
    }

    /// Vehicles and persons in the network, as SUMO counts them.
    async fn counts(&mut self) -> Counts {
        let mut batch = Batch::new();
        let vehicles = batch.get(vehicle::ID_COUNT, "");
        let persons = batch.get(person::ID_COUNT, "");
        let replies = self.client.send(&batch).await.unwrap();
        Counts::new(replies.get(vehicles).unwrap() as usize, replies.get(persons).unwrap() as usize)
    }

    async fn census(&mut self) -> Census {
        let vehicles = self.client.get(vehicle::ID_LIST, "").await.unwrap();
        let persons = self.client.get(person::ID_LIST, "").await.unwrap();
        let mut batch = Batch::new();
        let v: Vec<_> = vehicles.iter().map(|id| batch.get(vehicle::POSITION, id)).collect();
        let p: Vec<_> = persons.iter().map(|id| batch.get(person::POSITION, id)).collect();
        let replies = self.client.send(&batch).await.unwrap();
        let bits = |ticket| {
            let p: Position2D = replies.get(ticket).unwrap();
            (p.x.to_bits(), p.y.to_bits())
        };
        Census {
            vehicles: vehicles.into_iter().zip(v.into_iter().map(bits)).collect(),
            persons: persons.into_iter().zip(p.into_iter().map(bits)).collect(),
        }
    }

    /// Ends SUMO; returns its log.
    async fn close(self) -> String {
        let Self { mut process, client, log, .. } = self;
        client.close().await.unwrap();
        process.wait_at_most(Duration::from_secs(10)).await;
        std::fs::read_to_string(log).unwrap()
    }
}

/// Trips and walks so short that many end within a test.
fn short_trips() -> Options {
    Options { trip_length: (500.0, 600.0), walk_length: (40.0, 80.0), ..Options::default() }
}

#[tokio::test]
async fn counts_are_exact_at_every_tick_while_trips_end() {
    let wanted = Counts::new(70, 100);
    let mut run = Run::new(&town5(), wanted, 7, short_trips(), None).await;
    assert_eq!(run.placed, wanted);
    let mut replaced = (0, 0);
    for tick in 0..600 {
        for id in run.tick(None).await {
            let replaced = if id.starts_with("wad_v") { &mut replaced.0 } else { &mut replaced.1 };
            *replaced += usize::from(tick > 0);
        }
        assert_eq!(run.counts().await, wanted, "tick {tick}");
        assert_eq!(run.population.alive(), wanted, "tick {tick}");
    }
    println!("replaced in 100 s: {} vehicles, {} pedestrians", replaced.0, replaced.1);
    assert!(replaced.0 > 20 && replaced.1 > 50, "{replaced:?}");
    let log = run.close().await;
    for bad in ["collision", "teleport", "Error", "disconnect"] {
        assert!(!log.contains(bad), "{log}");
    }
}

#[tokio::test]
async fn a_dense_town_is_full_from_the_first_tick() {
    let wanted = Counts::new(100, 250);
    let ego = Some(Pose::new(250.0, 250.0, 0.0, 0.0));
    let mut run = Run::new(&town5(), wanted, 3, Options::default(), ego).await;
    assert_eq!(run.placed, wanted);
    for tick in 0..120 {
        let departed = run.tick(ego).await;
        assert_eq!(departed.len(), if tick == 0 { 350 } else { 0 }, "tick {tick}: {departed:?}");
        assert_eq!(run.counts().await, wanted, "tick {tick}");
    }
}

#[tokio::test]
async fn the_start_keeps_its_distance_from_the_ego() {
    let network = Network::load(&town5()).unwrap();
    let lane = network.lane(network.lane_by_id("B1B2_1").unwrap());
    let ego = lane.shape.at(20.0);
    let mut run = Run::new(&town5(), Counts::new(200, 200), 5, Options::default(), Some(ego)).await;
    run.tick(Some(ego)).await;
    let census = run.census().await;
    for (id, &place) in census.vehicles.iter().chain(&census.persons) {
        let local = ego.to_local(point(place));
        // Nobody moves more than 4 m in the first step.
        assert!(local.norm() > 21.0, "{id} at {local}");
        assert!(!(local.x > 0.0 && local.x < 36.0 && local.y.abs() < 1.0), "{id} ahead at {local}");
    }
}

#[tokio::test]
async fn an_arrived_vehicle_is_back_with_the_next_tick() {
    let wanted = Counts::new(70, 0);
    let mut run = Run::new(&town5(), wanted, 11, Options::default(), None).await;
    run.tick(None).await;
    // Five trips end where the vehicles are.
    for id in ["wad_v3", "wad_v14", "wad_v25", "wad_v36", "wad_v47"] {
        let road = run.client.get(vehicle::ROAD_ID, id).await.unwrap();
        let mut batch = Batch::new();
        vehicle::set_route(&mut batch, id, &[&road]);
        run.client.send(&batch).await.unwrap().check().unwrap();
    }
    let mut arrived = 0;
    let mut missing = 0;
    for tick in 0..400 {
        let departed = run.tick(None).await;
        assert_eq!(departed.len(), missing, "who was missing before tick {tick} must be back");
        missing = wanted.vehicles - run.counts().await.vehicles;
        arrived += missing;
    }
    assert_eq!(arrived, 5);
}

#[tokio::test]
async fn one_seed_gives_one_population() {
    let mut runs = Vec::new();
    for seed in [21, 21, 22] {
        let mut run = Run::new(&town5(), Counts::new(70, 100), seed, short_trips(), None).await;
        let mut ticks = Vec::new();
        for _ in 0..300 {
            run.tick(None).await;
            ticks.push(run.census().await);
        }
        runs.push(ticks);
    }
    assert_eq!(runs[0].len(), 300);
    assert!(runs[0] == runs[1], "equal seeds differ");
    assert!(runs[0][0] != runs[2][0], "different seeds agree");
}

#[tokio::test]
async fn nobody_comes_or_goes_in_the_egos_sight() {
    // A watcher that hurries through the town; it is not in SUMO, so nobody minds it.
    let watcher = |tick: usize| {
        let angle = tick as f64 * 0.002;
        Pose::new(230.0 + 150.0 * angle.cos(), 230.0 + 150.0 * angle.sin(), 0.0, angle)
    };
    let wanted = Counts::new(70, 100);
    let mut run = Run::new(&town5(), wanted, 13, short_trips(), Some(watcher(0))).await;
    let mut before = Census::default();
    let (mut came, mut went) = (0, 0);
    for tick in 0..900 {
        let departed = run.tick(Some(watcher(tick))).await;
        let census = run.census().await;
        // The population acts on the ego of the tick before; a step is at most 5 m.
        let seen = |place| (watcher(tick).xy() - point(place)).norm() < 95.0;
        if tick > 0 {
            for id in &departed {
                let place = census.vehicles.get(id).or_else(|| census.persons.get(id)).unwrap();
                assert!(!seen(*place), "{id} came in sight at tick {tick}");
                came += 1;
            }
        }
        for (id, place) in before.vehicles.iter().chain(&before.persons) {
            if !census.vehicles.contains_key(id) && !census.persons.contains_key(id) {
                assert!(!seen(*place), "{id} went in sight at tick {tick}");
                went += 1;
            }
        }
        before = census;
        assert_eq!(run.counts().await, wanted, "tick {tick}");
    }
    println!("{came} came, {went} went");
    assert!(came > 50 && went > 50, "{came} came, {went} went");
}

#[tokio::test]
async fn pedestrians_use_the_crossings() {
    let mut run = Run::new(&town5(), Counts::new(0, 100), 17, Options::default(), None).await;
    let mut crossing = 0;
    for _ in 0..20 {
        for _ in 0..30 {
            run.tick(None).await;
        }
        for id in run.client.get(person::ID_LIST, "").await.unwrap() {
            let road = run.client.get(person::ROAD_ID, &id).await.unwrap();
            let edge = run.network.edge_by_id(&road).unwrap();
            crossing += usize::from(run.network.edge(edge).kind == EdgeKind::Crossing);
        }
    }
    println!("{crossing} of 2000 pedestrians met were on a crossing");
    assert!(crossing > 20, "{crossing}");
}

/// A net that netgenerate makes with these arguments.
fn generated(folder: &TempDir, arguments: &[&str]) -> PathBuf {
    let net = folder.path().join("net.net.xml");
    let install = SumoInstall::find().unwrap();
    let made =
        install.command("netgenerate").args(arguments).arg("--output-file").arg(&net).output().unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    net
}

#[tokio::test]
async fn a_net_without_sidewalks_goes_on_without_pedestrians() {
    let folder = tempfile::tempdir().unwrap();
    let net = generated(&folder, &["--grid", "--grid.number", "4", "--grid.length", "120"]);
    let mut run = Run::new(&net, Counts::new(20, 50), 1, Options::default(), None).await;
    assert_eq!(run.placed, Counts::new(20, 0));
    for tick in 0..100 {
        run.tick(None).await;
        assert_eq!(run.counts().await, Counts::new(20, 0), "tick {tick}");
    }
}

#[tokio::test]
async fn a_full_town_says_how_many_fit() {
    let folder = tempfile::tempdir().unwrap();
    let net = generated(&folder, &["--grid", "--grid.number", "3", "--grid.length", "60"]);
    let mut run = Run::new(&net, Counts::new(1000, 0), 1, Options::default(), None).await;
    assert!((40..300).contains(&run.placed.vehicles), "{:?}", run.placed);
    run.tick(None).await;
    assert_eq!(run.counts().await, run.placed);
    assert_eq!(run.population.alive(), run.placed);
}

#[tokio::test]
async fn a_stuck_vehicle_is_replaced() {
    let options = Options { stuck_after: 20.0, ..Options::default() };
    let mut run = Run::new(&town5(), Counts::new(30, 0), 4, options, None).await;
    run.tick(None).await;
    run.client.set(vehicle::SET_SPEED, "wad_v5", 0.0).await.unwrap();
    let mut gone = None;
    for tick in 0..600 {
        run.tick(None).await;
        assert_eq!(run.counts().await.vehicles, 30, "tick {tick}");
        if gone.is_none() && !run.population.owns("wad_v5") {
            gone = Some(tick);
        }
    }
    let gone = f64::from(gone.expect("the stopped vehicle stays for ever")) * 0.167;
    assert!((20.0..60.0).contains(&gone), "gone after {gone} s");
}

#[tokio::test]
async fn an_additional_files_own_vehicles_are_taken_out_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("extra.add.xml");
    let demand = r#"<additional><route id="r" edges="B1B2 B2B3"/>
        <flow id="own" route="r" begin="0" end="100" period="2"/></additional>"#;
    std::fs::write(&file, demand).unwrap();
    let options = Options { alone: true, ..Options::default() };
    let extra = [("additional-files", file.to_str().unwrap())];
    let mut run = Run::with(&town5(), Counts::new(20, 0), 4, options, None, &extra).await;
    let mut own = 0;
    for _ in 0..200 {
        own += run.tick(None).await.iter().filter(|id| id.starts_with("own")).count();
        assert!(run.counts().await.vehicles <= 21);
        assert_eq!(run.population.alive().vehicles, 20);
    }
    assert!(own > 10, "{own}");
}

/// What the population costs; the figures are printed, what is judged does not depend on the machine.
#[tokio::test]
async fn quiet_ticks_ask_next_to_nothing() {
    for (vehicles, pedestrians) in [(70, 100), (100, 250), (500, 500)] {
        let wanted = Counts::new(vehicles, pedestrians);
        // Two equal towns, stepped in turn: one followed, one left to SUMO alone.
        let mut run = Run::new(&town5(), wanted, 9, Options::default(), None).await;
        let mut other = Run::new(&town5(), wanted, 9, Options::default(), None).await;
        let started = Instant::now();
        let mut again = Population::new(Arc::clone(&run.network), wanted, 9, Options::default());
        again.populate(&mut Batch::new(), &[]);
        let populate = started.elapsed();
        let started = Instant::now();
        run.tick(None).await;
        let first = started.elapsed();
        other.tick(None).await;
        let mut step = Batch::new();
        step.step();
        let mut commands = 0;
        let (mut followed, mut alone, mut update) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..300 {
            let started = Instant::now();
            run.tick(None).await;
            followed.push(started.elapsed());
            update.push(run.update);
            commands += run.batch.len() as u32;
            let started = Instant::now();
            other.client.send(&step).await.unwrap();
            alone.push(started.elapsed());
        }
        let median = |times: &mut Vec<Duration>| {
            times.sort();
            times[times.len() / 2].as_secs_f64() * 1000.0
        };
        let (followed, alone, update) = (median(&mut followed), median(&mut alone), median(&mut update));
        println!(
            "{vehicles}/{pedestrians}: populate {populate:.1?}, first tick {first:.1?}, then {followed:.3} ms a \
             tick, {alone:.3} without us (ratio {:.3}), of it update {update:.4} ms, {:.1} commands a tick",
            followed / alone,
            f64::from(commands) / 300.0
        );
        // Each vehicle is asked five things every half minute, and three edges a tick at the most.
        assert!(f64::from(commands) < 300.0 * (3.5 + 0.06 * vehicles as f64), "{commands}");
    }
}
