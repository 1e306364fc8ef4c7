//! wad-cosim: a co-simulation bridge to SUMO traffic.
//!
//! SUMO supplies the town, the background traffic, the pedestrians and the signals over TraCI. This crate supplies
//! the ego vehicle and puts its pose back into SUMO. It re-exports the crates that it stands on; `ARCHITECTURE.md` in
//! the repository is the map.
//!
//! ```text
//! SUMO --TraCI--> traci --> network, world --> camera --> perception --> latent --> agent --> vehicle --TraCI--> SUMO
//!                     session: one tick for any number of egos;  eyes: what an ego sees
//! ```
//!
//! | from | modules |
//! |---|---|
//! | `sumo-traci` | [`traci`]: the TraCI client, SUMO as a child process |
//! | `sumo-network` | [`geometry`], [`network`], [`world`] (the traffic around an ego), [`signal_ahead`], [`seeds`] |
//! | `wad-vehicle` | [`vehicle`]: the ego's physics |
//! | `wad-camera` | [`camera`]: the town and its traffic as pictures with ground truth |
//! | `wad-sim` | [`session`], [`bridge`], [`assets`], [`autopilot`], [`criteria`], [`end`], [`traffic`], [`tasks`], [`scenario`], [`destination`], [`replay`], [`telemetry`], [`sumo_config`], [`nets`], [`bundled`], [`program`], [`stats`], [`cores`], [`cpu_time`] |
//! | `wad-see` | [`eyes`], [`perception`], [`latent`], [`observation`], [`record`], [`foxglove`], `torch` |
//! | `wad-learn` | [`mod@env`], [`reward`], [`driver`], [`drive`], [`agent`], [`dataset`], [`eval`], [`encoder_score`], [`tour`], `optim`, `train` |
//! | here | [`view`] (the live view), [`mod@bench`], [`bench_tick`], [`clock`], [`interrupt`], [`register_bundled`] |
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
pub use sumo_network::{geometry, network, seeds, signal_ahead, world};
pub use sumo_traci as traci;
pub use wad_camera as camera;
pub use wad_learn::{agent, dataset, drive, driver, encoder_score, env, eval, folder_lock, reward, tour};
#[cfg(feature = "learn")]
pub use wad_learn::{optim, train};
#[cfg(feature = "learn")]
pub use wad_see::torch;
pub use wad_see::{eyes, foxglove, inference, latent, observation, perception, record};
pub use wad_sim::{
    assets, autopilot, bridge, bundled, cores, cpu_time, criteria, destination, end, nets, program, replay,
    scenario, session, stats, sumo_config, tasks, telemetry, traffic,
};
pub use wad_vehicle as vehicle;
