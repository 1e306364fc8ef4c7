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
//! | [`nets`] | nets built, imported, enriched, looked over |
//! | [`world`] | one picture of the traffic round an ego per tick |
//! | [`traffic`] | the background population |
//! | [`vehicle`] | the ego's physics |
//! | [`bridge`] | one SUMO, one network, any number of egos, in lock-step |
//! | [`camera`] | the town and its traffic as pictures with ground truth |
//! | [`perception`] | detections, lanes and light: the transformed image |
//! | [`watch`] | front camera and perception in a run |
//! | [`dataset`] | frames by the autopilot, collected and read back |
//! | [`latent`] | the encoder-decoder: the transformed image as 200 numbers |
//! | [`observation`] | what an agent is given each tick |
//! | [`train`] | training of the networks |
//! | [`agent`] | agents that learn to drive |
//! | [`tasks`] | what is to be driven, and where on a net that can be done |
//! | [`scenario`] | situations drawn in netedit, and what makes them happen |
//! | [`reward`] | the paper's six reward terms |
//! | [`env`] | all of that as `reset` and `step` |
//! | [`eval`] | suites of episodes, driven in parallel |
//! | [`replay`] | recorded drives, to be played or driven again |
//! | [`autopilot`] | the rule-based expert |
//! | [`criteria`] | collisions, red lights, lane, blocking, arrival |
//! | [`learned_driver`] | a trained agent with camera, perception and encoder, for `run` |
//! | [`view`] | the live view: a run in the browser, and its wheel in people's hands |
//! | [`drive`] | `run`: from destination to destination, with telemetry |
//!
//! World frame: SUMO's, x east, y north, z up, metres. Headings in radians, counter-clockwise from
//! east. Speeds in m/s, times in s, impulses in N s. SUMO's own angles and bumper positions exist in
//! [`geometry`] only.

pub mod agent;
pub mod autopilot;
pub mod bench;
pub mod bench_tick;
pub mod bridge;
pub mod bundled;
pub mod camera;
pub mod clock;
pub mod cores;
pub mod cpu_time;
pub mod criteria;
pub mod dataset;
pub mod destination;
pub mod drive;
pub mod env;
pub mod eval;
pub mod geometry;
pub mod interrupt;
pub mod latent;
pub mod learned_driver;
pub mod nets;
pub mod network;
pub mod observation;
#[cfg(feature = "learn")]
pub mod optim;
pub mod perception;
pub mod record;
pub mod replay;
pub mod reward;
pub mod scenario;
pub mod seeds;
pub mod sight;
pub mod sumo_config;
pub mod tasks;
pub mod telemetry;
#[cfg(feature = "learn")]
pub mod torch;
pub mod traci;
pub mod traffic;
#[cfg(feature = "learn")]
pub mod train;
pub mod vehicle;
pub mod view;
pub mod watch;
pub mod world;
