//! An agent's input of each tick: the latent and the six raw states (spec.md "Observation").

use serde::{Deserialize, Serialize};
use sumo_network::geometry::{Pose, wrap_angle};
use sumo_network::network::{RoadOption, Route};
use wad_sim::criteria::EgoOnRoute;

/// Size of the latent (paper, section "Latent State Extraction").
pub const LATENT_SIZE: usize = 200;

/// Size of the surroundings, see [`crate::surroundings`].
pub const SURROUNDINGS_SIZE: usize = 172;

/// Size of the raw vector.
pub const RAW_SIZE: usize = 15;

/// Version of the raw vector: 1 scaled distances linearly, 2 scales them by [`nearness`], 3 gives rotation as
/// bearings. Agents, checkpoints and recordings store it; other versions are refused.
pub const RAW_MEANING: u32 = 3;

/// Files without a version of the raw vector have version 1.
pub fn first_meaning() -> u32 {
    1
}

/// Index in the raw vector of the vehicle in front's [`nearness`].
pub const LEAD_NEARNESS: usize = 11;
/// Index in the raw vector of the stop line's [`nearness`], 0 where no light requires to stop.
pub const LIGHT_NEARNESS: usize = 14;

/// The paper's six raw states by name, in units; [`RawState::vector`] scales them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RawState {
    /// Speed (m/s).
    pub speed: f64,
    /// Speed limit here (m/s); at most [`crate::perception::BY_SIGHT`] where the camera sees the lights.
    pub speed_limit: f64,
    /// Distance from the lane's centre (m), left positive.
    pub lateral: f64,
    /// The turn instruction of the route here.
    pub option: RoadOption,
    /// Heading of the waypoint ahead less the ego's (rad, left positive).
    pub heading_error: f64,
    /// The same for the waypoint 10 m further.
    pub heading_error_far: f64,
    /// Direction from the ego's centre to the waypoint ahead less the ego's heading (rad, left positive).
    #[serde(default)]
    pub bearing: f64,
    /// The same to the waypoint 10 m further.
    #[serde(default)]
    pub bearing_far: f64,
    /// Gap to the detected vehicle in the ego's path (m) and closing speed (m/s, positive when nearing).
    pub lead: Option<LeadState>,
    /// Red ahead, or yellow that the ego can and so must stop for: distance from the front bumper to the
    /// stop line (m).
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

impl LeadState {
    /// Its speed (m/s) where the ego drives at `ego` m/s; who comes towards the ego counts as standing.
    pub fn speed(&self, ego: f64) -> f64 {
        (ego - self.closing_speed).max(0.0)
    }
}

/// Speeds (m/s), distances (m) and angles (rad) that become 1.
pub(crate) const SPEED: f64 = 15.0;
const LATERAL: f64 = 1.75;
const ANGLE: f64 = std::f64::consts::FRAC_PI_4;
const SIGHT: f64 = 50.0;
const CLOSING: f64 = 10.0;

/// Distance of the waypoint ahead from the ego's centre at standstill (m).
pub const WAYPOINT_AHEAD: f64 = 5.0;
/// The waypoint ahead is farther away by this time (s) at the ego's speed.
pub const WAYPOINT_TIME: f64 = 0.5;
/// The second waypoint is this much further (m).
pub const WAYPOINT_FURTHER: f64 = 10.0;

/// Nearness of a distance (m), 1 at 0 m and 0 at 50 m: 1 - ln(1 + distance) / ln 51. Half of it lies in the last
/// 6 m: it is there that a metre decides.
pub fn nearness(distance: f64) -> f64 {
    (1.0 - distance.max(0.0).ln_1p() / SIGHT.ln_1p()).clamp(0.0, 1.0)
}

impl RawState {
    /// Standing where nothing is.
    pub const STANDING: Self = Self {
        speed: 0.0,
        speed_limit: 13.89,
        lateral: 0.0,
        option: RoadOption::LaneFollow,
        heading_error: 0.0,
        heading_error_far: 0.0,
        bearing: 0.0,
        bearing_far: 0.0,
        lead: None,
        stop_light: None,
    };

    /// The raw state of an ego on its route, with the perceived vehicle in front and light.
    ///
    /// The waypoint ahead is the route's point [`WAYPOINT_AHEAD`] + [`WAYPOINT_TIME`] x speed before the
    /// ego's centre; its road option is the one given.
    pub fn of(
        route: &Route,
        on_route: &EgoOnRoute,
        lead: Option<LeadState>,
        stop_light: Option<f64>,
    ) -> Self {
        let EgoOnRoute { state, s, d, .. } = *on_route;
        let ahead = s + WAYPOINT_AHEAD + WAYPOINT_TIME * state.speed.max(0.0);
        let (waypoint, further) = (route.at(ahead), route.at(ahead + WAYPOINT_FURTHER));
        let error = |heading: f64| wrap_angle(heading - state.pose.heading);
        let bearing = |point: &Pose| {
            let way = point.xy() - state.pose.xy();
            // Beyond the route's end no waypoint gives a direction.
            let heading = if way.norm() > 1.0 { way.y.atan2(way.x) } else { point.heading };
            error(heading)
        };
        Self {
            speed: state.speed,
            speed_limit: route.at(s).speed_limit,
            lateral: d,
            option: waypoint.option,
            heading_error: error(waypoint.pose.heading),
            heading_error_far: error(further.pose.heading),
            bearing: bearing(&waypoint.pose),
            bearing_far: bearing(&further.pose),
            lead,
            stop_light,
        }
    }

    /// The speed (m/s) in the fifteen numbers, as far as they hold it.
    pub fn speed_of(vector: &[f32]) -> f64 {
        vector.first().map_or(0.0, |v| f64::from(*v) * SPEED)
    }

    /// The fifteen numbers, each about -1 to 1:
    ///
    /// | index | what | scaling |
    /// |---|---|---|
    /// | 0, 1 | speed; speed over limit | / 15 m/s; ratio - 1 |
    /// | 2 | lateral distance, left positive | / 1.75 m |
    /// | 3-8 | road option, one-hot | LaneFollow, Left, Right, Straight, ChangeLaneLeft, ChangeLaneRight |
    /// | 9, 10 | rotation: bearings of the waypoint ahead and of the one 10 m further | / 45 degrees |
    /// | 11, 12 | vehicle in front: [`nearness`] of its rear (0: none); closing speed | / 10 m/s |
    /// | 13, 14 | light ahead that must be stopped for (0, 1); [`nearness`] of the stop line | |
    ///
    /// Everything is cut to -2 to 2.
    pub fn vector(&self) -> [f32; RAW_SIZE] {
        let mut v = [0.0; RAW_SIZE];
        v[0] = self.speed / SPEED;
        v[1] = self.speed / self.speed_limit.max(1.0) - 1.0;
        v[2] = self.lateral / LATERAL;
        v[3 + option_index(self.option)] = 1.0;
        v[9] = self.bearing / ANGLE;
        v[10] = self.bearing_far / ANGLE;
        if let Some(lead) = self.lead {
            v[11] = nearness(lead.gap);
            v[12] = lead.closing_speed / CLOSING;
        }
        if let Some(distance) = self.stop_light {
            v[13] = 1.0;
            v[14] = nearness(distance);
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

/// The parts of an observation. Sizes never change: a part that is left out is zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObservationMode {
    /// The latent and the six raw states, as in the paper.
    #[default]
    LatentAndRaw,
    /// The same from the route, the ego's own motion and the camera alone: the light too is what the camera shows, so it takes a
    /// detector that sees it ([`crate::perception::sees_the_road`]).
    Camera,
    /// The raw states alone (ablation); without lane detection and encoding.
    RawOnly,
    /// The latent alone (ablation).
    LatentOnly,
    /// The surroundings as numbers from the world itself in place of the latent, and the raw states of the same
    /// source: no camera, no detector ([`crate::surroundings`]).
    Vector,
    /// Nothing is seen: latent zero, raw states without a vehicle in front. For drivers that do not look
    /// (autopilot, random): several times faster.
    Blind,
}

impl ObservationMode {
    /// Whether the camera runs at all.
    pub fn looks(self) -> bool {
        !matches!(self, Self::Blind | Self::Vector)
    }

    /// Size of [`Observation::latent`].
    pub const fn latent_size(self) -> usize {
        if matches!(self, Self::Vector) { SURROUNDINGS_SIZE } else { LATENT_SIZE }
    }

    /// Whether images are encoded.
    pub fn encodes(self) -> bool {
        matches!(self, Self::LatentAndRaw | Self::Camera | Self::LatentOnly)
    }
}

/// An agent's input.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// [`LATENT_SIZE`] numbers; with [`ObservationMode::Vector`] the [`SURROUNDINGS_SIZE`] of the surroundings.
    pub latent: Vec<f32>,
    /// The raw states, scaled: [`RawState::vector`].
    pub raw: [f32; RAW_SIZE],
}

impl Observation {
    /// Latent and raw vector in one: [`ObservationMode::latent_size`] + [`RAW_SIZE`] numbers.
    pub fn concat(&self) -> Vec<f32> {
        [self.latent.as_slice(), &self.raw].concat()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::testing::Road;

    #[test]
    fn the_raw_state_says_where_the_ego_is_on_its_route() {
        let road = Road::new("GGG");
        let facts = road.facts(60.0, 0.5, 0.1, 8.0);
        let raw = RawState::of(facts.route, &facts.on_route, None, Some(25.0));
        assert_eq!((raw.lateral, raw.speed, raw.speed_limit), (0.5, 8.0, 10.0));
        // Turned left by 0.1: the way goes to the right.
        assert!((raw.heading_error + 0.1).abs() < 1e-6 && (raw.heading_error_far + 0.1).abs() < 1e-6);
        // The waypoint is 9 m ahead and 0.5 m to the right, the other 19 m.
        assert!((raw.bearing + 0.1 + (0.5_f64 / 9.0).atan()).abs() < 1e-6, "{raw:?}");
        assert!((raw.bearing_far + 0.1 + (0.5_f64 / 19.0).atan()).abs() < 1e-6, "{raw:?}");
        assert_eq!(raw.option, RoadOption::LaneFollow);
        let v = raw.vector();
        assert!((v[0] - 8.0 / 15.0).abs() < 1e-6 && (v[1] + 0.2).abs() < 1e-6 && v[3] == 1.0, "{v:?}");
        assert_eq!((v[11], v[13]), (0.0, 1.0));
        assert!((f64::from(v[14]) - (1.0 - 26.0_f64.ln() / 51.0_f64.ln())).abs() < 1e-6, "{v:?}");
    }

    #[test]
    fn nearness_is_finest_where_a_metre_decides() {
        assert_eq!((nearness(-0.5), nearness(0.0), nearness(50.0), nearness(90.0)), (1.0, 1.0, 0.0, 0.0));
        assert!((nearness(6.0) - 0.5).abs() < 0.01);
        assert!(nearness(0.5) - nearness(1.5) > 0.1 && nearness(30.0) - nearness(31.0) < 0.01);
    }

    #[test]
    fn the_option_is_that_of_the_waypoint_ahead() {
        let road = Road::new("GGG");
        // Announced 15 m before the stop line; at 8 m/s the waypoint is 9 m ahead.
        let announced = road.route.links[0].stop_s - 15.0;
        let at = |s: f64| {
            let facts = road.facts(s, 0.0, 0.0, 8.0);
            RawState::of(facts.route, &facts.on_route, None, None).option
        };
        assert_eq!(at(announced - 9.5), RoadOption::LaneFollow);
        assert_eq!(at(announced - 8.5), RoadOption::Straight);
    }

    #[test]
    fn wild_numbers_stay_within_two() {
        let wild = RawState {
            speed: 400.0,
            speed_limit: 0.0,
            lateral: -90.0,
            heading_error: 9.0,
            bearing: 9.0,
            lead: Some(LeadState { gap: 900.0, closing_speed: -300.0 }),
            stop_light: Some(1e9),
            ..RawState::STANDING
        };
        assert!(wild.vector().iter().all(|x| (-2.0..=2.0).contains(x)));
    }
}
