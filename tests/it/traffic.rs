//! The background population in a real SUMO, on town5.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
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
        population.define_types(&mut batch);
        let placed = population.populate(&mut batch, ego);
        Self { process, client, network, population, placed, batch, log, _folder: folder }
    }

    /// One tick; SUMO must accept every command. Returns the ids that departed.
    async fn tick(&mut self, ego: Option<Pose>) -> Vec<String> {
        self.batch.step();
        let replies = self.client.send(&self.batch).await.unwrap();
        let failures: Vec<String> = replies.failures().map(ToString::to_string).collect();
        assert!(failures.is_empty(), "{failures:#?}");
        self.batch.clear();
        let events = StepEvents::read(&replies).unwrap();
        self.population.update(&events, &replies, ego, &[], &mut self.batch);
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
        process.wait_at_most(std::time::Duration::from_secs(10)).await;
        std::fs::read_to_string(log).unwrap()
    }
}

/// Trips and walks so short that many end within a test.
fn short_trips() -> Options {
    Options { trip_length: (500.0, 600.0), walk_length: (40.0, 80.0), ..Options::default() }
}

fn serial(id: &str) -> usize {
    id["wad_v".len()..].parse().unwrap()
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
    assert!(replaced.0 > 50 && replaced.1 > 50, "{replaced:?}");
    let log = run.close().await;
    println!("{log}");
    for bad in ["collision", "teleport", "Error"] {
        assert!(!log.contains(bad), "{log}");
    }
}
