//! The live view: a page in the browser that shows a run or a recorded episode, with manual driving.
//!
//! ```text
//! simulation --Shot--> latest only --> artist thread: camera, stages, JPEG --Packet--> server thread -->
//! viewers
//!     ^                                                                                    |
//!     +------------------ requests, the wheel's position, before the next tick ------------+
//! ```
//!
//! The simulation hands over the state after a tick, and goes on: a picture that is not ready in time
//! is left out, and so is one that a viewer cannot take. The simulation never waits.

mod artist;
mod crowd;
mod guard;
mod hub;
mod net;
mod player;
mod protocol;
pub mod score;
mod server;
mod session;
mod wheel;

pub use artist::Artist;
pub use crowd::{Crowd, Got};
pub use guard::Token;
pub use net::street_map;
pub use player::{Listed, Next, Played, Player};
pub use protocol::Request;
pub use server::{Listener, ViewAddress, ViewError};
pub use session::{MakeDriver, Ready, RunSetting, RunView};

/// The default address of the page.
pub const DEFAULT_ADDRESS: &str = "127.0.0.1:8765";
