//! Two egos under the expert in one SUMO: prints their poses once a second, and what happens to them.
//!
//!     cargo run --release --example two_egos -- town3 60

use std::error::Error;
use sumo_network::seeds;
use wad_sim::assets::Assets;
use wad_sim::autopilot::AutopilotParams;
use wad_sim::bridge::BridgeOptions;
use wad_sim::criteria::{CriteriaParams, Event};
use wad_sim::session::{Act, Itinerary, Seat, Session};
use wad_sim::traffic::{Counts, TrafficSpec};
use wad_vehicle::EgoParams;

const SEED: u64 = 5;

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let config = arguments.next().ok_or("usage: two_egos CONFIG [SECONDS]")?;
    let seconds: f64 = arguments.next().map_or(Ok(60.0), |seconds| seconds.parse())?;

    let assets = Assets::load(&config)?;
    let mut itinerary = Itinerary::new(assets.network(), seeds::rng(SEED, "route"))?;
    let route = itinerary.first_route(assets.network())?;
    // Both on one route, the second 25 m ahead of the first.
    let seats = [("first", 5.0), ("second", 30.0)].map(|(id, s)| {
        let (autopilot, criteria) = (AutopilotParams::default(), CriteriaParams::default());
        let mut seat = Seat::new(&assets, id, EgoParams::default(), autopilot, criteria, route.clone());
        seat.place(route.clone(), s, (0.0, 0.0));
        seat
    });
    let folder = tempfile::tempdir()?; // for SUMO's files
    let options = BridgeOptions {
        seed: SEED,
        traffic: TrafficSpec::Counts(Counts::new(20, 0)),
        ..BridgeOptions::new(assets.config(), folder.path())
    };
    let mut session = Session::start(&assets, &options, Vec::from(seats)).await?;

    let mut printed = 0.0;
    while session.bridge().time() < seconds {
        let ticks = session.step(&[Act::Expert, Act::Expert]).await?;
        let time = session.bridge().time();
        for (index, tick) in ticks.iter().enumerate() {
            for event in &tick.events {
                println!("{time:.3} s: {}: {event:?}", session.ego(index).id);
            }
            let arrived = tick.events.iter().any(|event| matches!(event, Event::Arrival));
            if arrived && !itinerary.go_on(&mut session, index) {
                itinerary.start_elsewhere(&mut session, index).await?;
            }
            itinerary.plan_ahead(&mut session, index);
        }
        if time >= printed + 1.0 {
            printed = time.floor();
            for seat in session.seats() {
                let (id, state) = (&seat.ego().id, seat.ego().state());
                let (at, heading) = (state.pose.position, state.pose.heading);
                println!(
                    "{time:.3} s: {id}: x {:.2} m, y {:.2} m, heading {heading:.3} rad, {:.2} m/s",
                    at.x, at.y, state.speed
                );
            }
        }
    }
    session.close().await?;
    Ok(())
}
