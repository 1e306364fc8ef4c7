//! What an agent is given each tick: the latent and the six raw states (spec.md "Observation").

use crate::network::RoadOption;
use serde::{Deserialize, Serialize};

/// Numbers in the latent (paper, section "Latent State Extraction").
pub const LATENT_SIZE: usize = 200;

/// Numbers in the raw vector.
pub const RAW_SIZE: usize = 15;

/// The paper's six raw states by name, in units; [`RawState::vector`] scales them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RawState {
    /// Speed (m/s), and the speed limit here (m/s).
    pub speed: f64,
    pub speed_limit: f64,
    /// Distance from the lane's centre (m), left positive.
    pub lateral: f64,
    pub option: RoadOption,
    /// Heading of the waypoint ahead less the ego's (rad, left positive), and of the one 10 m further.
    pub heading_error: f64,
    pub heading_error_far: f64,
    /// Gap to the detected vehicle in the ego's path (m) and closing speed (m/s, positive when nearing).
    pub lead: Option<LeadState>,
    /// Red or yellow ahead: distance from the front bumper to its stop line (m).
    pub stop_light: Option<f64>,
}

/// The vehicle in front, as the detector in use sees it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeadState {
    /// m.
    pub gap: f64,
    /// m/s.
    pub closing_speed: f64,
}

/// Speeds (m/s), distances (m) and angles (rad) that become 1.
const SPEED: f64 = 15.0;
const LATERAL: f64 = 1.75;
const ANGLE: f64 = std::f64::consts::FRAC_PI_4;
const SIGHT: f64 = 50.0;
const CLOSING: f64 = 10.0;

impl RawState {
    /// The fifteen numbers, each about -1 to 1:
    ///
    /// | index | what | scaling |
    /// |---|---|---|
    /// | 0, 1 | speed; speed over limit | / 15 m/s; ratio - 1 |
    /// | 2 | lateral distance, left positive | / 1.75 m |
    /// | 3-8 | road option, one-hot | LaneFollow, Left, Right, Straight, ChangeLaneLeft, ChangeLaneRight |
    /// | 9, 10 | heading errors | / 45 degrees |
    /// | 11, 12 | vehicle in front: nearness 1 - gap / 50 m (0: none); closing speed | / 10 m/s |
    /// | 13, 14 | red or yellow ahead (0, 1); nearness 1 - distance / 50 m | |
    ///
    /// Everything is cut to -2 to 2.
    pub fn vector(&self) -> [f32; RAW_SIZE] {
        let mut v = [0.0; RAW_SIZE];
        v[0] = self.speed / SPEED;
        v[1] = self.speed / self.speed_limit.max(1.0) - 1.0;
        v[2] = self.lateral / LATERAL;
        v[3 + option_index(self.option)] = 1.0;
        v[9] = self.heading_error / ANGLE;
        v[10] = self.heading_error_far / ANGLE;
        if let Some(lead) = self.lead {
            v[11] = (1.0 - lead.gap / SIGHT).clamp(0.0, 1.0);
            v[12] = lead.closing_speed / CLOSING;
        }
        if let Some(distance) = self.stop_light {
            v[13] = 1.0;
            v[14] = (1.0 - distance / SIGHT).clamp(0.0, 1.0);
        }
        v.map(|x| x.clamp(-2.0, 2.0) as f32)
    }
}

fn option_index(option: RoadOption) -> usize {
    match option {
        RoadOption::LaneFollow => 0,
        RoadOption::Left => 1,
        RoadOption::Right => 2,
        RoadOption::Straight => 3,
        RoadOption::ChangeLaneLeft => 4,
        RoadOption::ChangeLaneRight => 5,
    }
}

/// What an agent sees.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// [`LATENT_SIZE`] numbers.
    pub latent: Vec<f32>,
    pub raw: [f32; RAW_SIZE],
}

impl Observation {
    /// Latent and raw vector in one: [`LATENT_SIZE`] + [`RAW_SIZE`] numbers.
    pub fn concat(&self) -> Vec<f32> {
        [self.latent.as_slice(), &self.raw].concat()
    }
}
