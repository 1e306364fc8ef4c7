//! The TraCI client against a real SUMO.

use std::path::PathBuf;
use std::time::{Duration, Instant};
use tempfile::TempDir;
use wad_cosim::traci::vehicle::{self, MoveToXy, Vehicle};
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
            <vType id="car" length="5" minGap="2.5" sigma="0"/>
            <route id="east" edges="A1B1 B1C1"/>
            <route id="north" edges="B0B1 B1B2"/>
            <vehicle id="first" type="car" route="east" depart="0" departPos="20" departSpeed="5"/>
            <vehicle id="second" type="car" route="east" depart="0" departPos="5" departSpeed="5"/>
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
