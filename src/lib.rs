//! wad-cosim: a co-simulation bridge to SUMO traffic.
//!
//! SUMO supplies the town, the background traffic, the pedestrians and the signals over TraCI; this
//! crate supplies the ego vehicle and puts its pose back into SUMO. The modules follow the data:
//!
//! ```text
//! SUMO --TraCI--> traci --> network, world --> autopilot --> vehicle --TraCI--> SUMO
//!                                 bridge closes the loop; criteria judge it; drive is `run`
//! ```
//!
//! | module | what it is |
//! |---|---|
//! | [`traci`] | the TraCI client: codec, connection, domains, SUMO as a child process |
//! | [`network`] | `.net.xml` into lanes, links, crossings, signals; routes in (s, d) |
//! | [`nets`] | builds, imports, enriches and checks nets |
//! | [`world`] | one picture of the traffic round an ego per tick |
//! | [`traffic`] | the background population |
//! | [`vehicle`] | the ego's physics |
//! | [`bridge`] | one SUMO, one network, any number of egos, in lock-step |
//! | [`camera`] | the town and its traffic as pictures with ground truth |
//! | [`perception`] | detections, lanes and light: the transformed image |
//! | [`watch`] | front camera and perception in a run |
//! | [`dataset`] | frames by the autopilot, collected and read back |
//! | [`latent`] | the encoder-decoder: the transformed image as 200 numbers |
//! | [`observation`] | an agent's inputs of each tick |
//! | [`train`] | training of the networks |
//! | [`agent`] | agents that learn to drive |
//! | [`tasks`] | the driving tasks, and their places on a net |
//! | [`scenario`] | situations drawn in netedit, and their events in SUMO |
//! | [`reward`] | the paper's six reward terms |
//! | [`env`] | all of that as `reset` and `step` |
//! | [`eval`] | suites of episodes, driven in parallel |
//! | [`replay`] | recorded drives, to be played or driven again |
//! | [`autopilot`] | the rule-based expert |
//! | [`criteria`] | collisions, red lights, lane, blocking, arrival |
//! | [`learned_driver`] | a trained agent with camera, perception and encoder, for `run` |
//! | [`view`] | the live view: a run in the browser, with manual driving |
//! | [`drive`] | `run`: from destination to destination, with telemetry |
//!
//! [`traci`], [`network`] (with [`geometry`], [`world`] and [`seeds`]), [`vehicle`] and [`camera`] are crates
//! of their own below `crates/`, under their old names here.
//!
//! World frame: SUMO's, x east, y north, z up, metres. Headings in radians, counter-clockwise from
//! east. Speeds in m/s, times in s, impulses in N s. SUMO's own angles and bumper positions exist in
//! [`geometry`] only.

pub mod bench;
pub mod bench_tick;
mod bundle;
pub mod clock;
pub mod interrupt;
pub mod view;

pub use bundle::register as register_bundled;
pub use sumo_network::{geometry, network, seeds, world};
pub use sumo_traci as traci;
pub use wad_camera as camera;
pub use wad_learn::{agent, dataset, drive, driver, encoder_score, env, eval, reward, tour};
#[cfg(feature = "learn")]
pub use wad_learn::{optim, train};
#[cfg(feature = "learn")]
pub use wad_see::torch;
pub use wad_see::{eyes, latent, observation, perception, record};
pub use wad_sim::{
    assets, autopilot, bridge, bundled, cores, cpu_time, criteria, destination, end, nets, program, replay,
    scenario, session, stats, sumo_config, tasks, telemetry, traffic,
};
pub use wad_vehicle as vehicle;
