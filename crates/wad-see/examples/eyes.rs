//! Drives some seconds under the expert, prints once a second what the ego sees, and writes the last
//! transformed image.
//!
//!     cargo run --release --example eyes -- town3 transformed.png 30

use std::collections::BTreeMap;
use std::error::Error;
use std::path::PathBuf;
use sumo_network::seeds;
use wad_camera::{CameraConfig, Picture, Preset};
use wad_see::eyes::Eyes;
use wad_see::perception::{self, EgoFacts, TRANSFORMED_SIZE};
use wad_sim::assets::Assets;
use wad_sim::autopilot::AutopilotParams;
use wad_sim::bridge::BridgeOptions;
use wad_sim::criteria::CriteriaParams;
use wad_sim::session::{Act, Itinerary, Seat, Session};
use wad_sim::traffic::{Counts, TrafficSpec};
use wad_vehicle::EgoParams;

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let usage = "usage: eyes CONFIG PICTURE.png [SECONDS [SEED]]";
    let config = arguments.next().ok_or(usage)?;
    let path = PathBuf::from(arguments.next().ok_or(usage)?);
    let seconds: f64 = arguments.next().map_or(Ok(30.0), |seconds| seconds.parse())?;
    let seed: u64 = arguments.next().map_or(Ok(6), |seed| seed.parse())?;

    let assets = Assets::load(&config)?;
    let route = Itinerary::new(assets.network(), seeds::rng(seed, "route"))?.first_route(assets.network())?;
    let (autopilot, criteria) = (AutopilotParams::default(), CriteriaParams::default());
    let seat = Seat::new(&assets, "ego", EgoParams::default(), autopilot, criteria, route);
    let folder = tempfile::tempdir()?; // for SUMO's files
    let options = BridgeOptions {
        seed,
        traffic: TrafficSpec::Counts(Counts::new(70, 30)),
        ..BridgeOptions::new(assets.config(), folder.path())
    };
    let mut session = Session::start(&assets, &options, vec![seat]).await?;

    // `truth`: the renderer's own boxes.
    let detector = perception::detector("truth", perception::LeastScore::Usual)?;
    let mut eyes = Eyes::new(assets.town(), CameraConfig::default(), detector)?;
    eyes.reset(Preset::ClearNoon, seed);

    let mut printed = 0.0;
    while session.bridge().time() < seconds {
        session.step_one(Act::Expert).await?;
        let (ego, tick) = (session.ego(0), session.bridge().tick());
        eyes.follow(ego.world());
        eyes.look(&EgoFacts::of(session.network(), ego, tick))?;
        let time = session.bridge().time();
        if time < printed + 1.0 {
            continue;
        }
        printed = time.floor();
        let percept = eyes.percept().ok_or("these eyes do not perceive")?;
        let lead = percept.lead.map_or("nobody in front".to_owned(), |lead| format!("gap {:.1} m", lead.gap));
        let light = percept.light.map_or("no light ahead".to_owned(), |light| {
            format!("{:?} in {:.1} m", light.state, light.distance)
        });
        let mut seen = BTreeMap::new();
        for found in &percept.detections {
            *seen.entry(found.class).or_insert(0) += 1;
        }
        println!("{time:.3} s: {:.2} m/s, {lead}, {light}, sees {seen:?}", ego.state().speed);
    }
    session.close().await?;

    let image = eyes.image().ok_or("no tick was driven: ask for more seconds")?;
    let picture = Picture { rgb: image.bytes().to_vec(), ..Picture::new(TRANSFORMED_SIZE, TRANSFORMED_SIZE) };
    picture.save(&path)?;
    println!("{}: {TRANSFORMED_SIZE} x {TRANSFORMED_SIZE} pixels", path.display());
    Ok(())
}
