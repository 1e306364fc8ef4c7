//! Drives a circle with the wheel held still, at 8 m/s, and prints the pose once a second.
//!
//!     cargo run --release --example circle -- 30

use std::error::Error;
use sumo_network::geometry::Pose;
use wad_vehicle::{Control, EgoParams, EgoVehicle};

/// How long a tick is (s). Inside it the physics takes steps of 1/60 s.
const TICK: f64 = 0.1;
/// m/s.
const WANTED: f64 = 8.0;

fn main() -> Result<(), Box<dyn Error>> {
    let seconds: u32 = std::env::args().nth(1).map_or(Ok(30), |seconds| seconds.parse())?;
    let mut ego = EgoVehicle::new(EgoParams::default(), Pose::new(0.0, 0.0, 0.0, 0.0), WANTED);
    println!("time_s,x_m,y_m,heading_rad,speed_mps");
    for second in 1..=seconds {
        for _ in 0..(1.0 / TICK) as u32 {
            let throttle = (0.3 + 0.5 * (WANTED - ego.state().speed)).clamp(0.0, 1.0);
            let contacts = ego.tick(Control { throttle, steer: 0.3, brake: 0.0, reverse: false }, TICK, &[]);
            assert!(contacts.is_empty(), "there is nothing to hit");
        }
        let state = ego.state();
        let (at, heading) = (state.pose.position, state.pose.heading);
        println!("{second},{:.2},{:.2},{heading:.3},{:.2}", at.x, at.y, state.speed);
    }
    Ok(())
}
