//! Starts a SUMO, subscribes to every vehicle that departs, and prints how fast the traffic moves.
//!
//!     cargo run --release --example watch -- town.sumocfg 100

use std::error::Error;
use sumo_traci::{Batch, LaunchOptions, SumoProcess, simulation, vehicle};

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let config = arguments.next().ok_or("usage: watch CONFIG.sumocfg [STEPS]")?;
    let steps: usize = arguments.next().map_or(Ok(100), |steps| steps.parse())?;

    let mut options = LaunchOptions::config(config);
    options.seed = Some(1);
    let (mut sumo, mut client) = SumoProcess::launch(&options).await?;
    eprintln!("{} answers on port {}", client.version().software, sumo.port());

    let mut batch = Batch::new();
    let clock = [simulation::TIME.id(), simulation::DEPARTED_IDS.id()];
    batch.subscribe(simulation::Simulation, "", &clock);
    for _ in 0..steps {
        batch.step(); // the last command of its message
        let replies = match client.send(&batch).await {
            Ok(replies) => replies,
            Err(error) => return Err(sumo.explain(error).await.into()),
        };
        replies.check()?;
        batch.clear();

        let results = replies.subscriptions();
        let now = results.object(simulation::Simulation, "").ok_or("SUMO sent no time")?;
        for id in now.strings(simulation::DEPARTED_IDS)? {
            batch.subscribe(vehicle::Vehicle, id, &[vehicle::SPEED.id()]);
        }
        let speeds: Vec<f64> = results
            .objects(vehicle::Vehicle)
            .map(|car| car.value(vehicle::SPEED))
            .collect::<Result<_, _>>()?;
        let mean = speeds.iter().sum::<f64>() / speeds.len().max(1) as f64;
        println!("{:.3} s: {} vehicles, {mean:.2} m/s", now.value(simulation::TIME)?, speeds.len());
    }
    client.close().await?;
    sumo.wait_at_most(std::time::Duration::from_secs(10)).await;
    Ok(())
}
