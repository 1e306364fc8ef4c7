//! The driving tasks: the paper's five in rising difficulty, composite, and navigation.
//!
//! A [`TaskSpec`] describes a task. [`Places`] draws a place for it on a net, from a seed. A [`Placement`] is
//! such a place, and has everything to drive it again.
//!
//! | task | route | traffic | tick limit | success |
//! |---|---|---|---|---|
//! | straight | 400 m, no turn, no lane change; lights green | none | 600 | arrival, or alive with progress |
//! | one_turn | 400 m, one turn left or right, no lane change; lights green | none | 600 | the same |
//! | roundabout | in by the first arm, out by the third, 40 to 160 m before and after | none | 600 | the same |
//! | obstacle | a road user of one of six kinds 60 to 120 m ahead in the lane | none | 300 | standing 1 to 10 m before it at the limit |
//! | cross | 500 m over at least one signalled junction of four arms | none | 1000 | arrival, or alive with progress |
//! | composite | random, 500 m or more | 70 / 100 | 1000 | arrival or alive |
//! | navigation | random, 500 m or more | none | the route at 10 km/h | arrival |
//!
//! The first three are about steering and speed: neither town has 400 m of straight road without a signal,
//! so the lights on the route are held at green.
//! Lengths are met to within a tenth. *Progress* is half of the route. At 167 ms a tick, 600 ticks are
//! 100 s: 400 m at 4 m/s. The cross task's 167 s leave room for one red phase (a cycle takes 110 s).

mod curriculum;
mod error;
mod place;
mod survey;

pub use curriculum::{Curriculum, CurriculumError, Passed, Progress, Stage};
pub use error::TaskError;
pub use place::{ObstacleKind, ObstaclePlacement, Placement, Places, Spot};

use crate::traffic::{Counts, TrafficSpec};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use wad_camera::Preset;

/// The driving tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TaskKind {
    /// 400 m without a turn.
    Straight,
    /// 400 m with one turn.
    OneTurn,
    /// Through a roundabout, out by the third arm.
    Roundabout,
    /// Stop before an obstacle in the lane.
    Obstacle,
    /// 500 m over signalled junctions.
    Cross,
    /// A random route in traffic.
    Composite,
    /// A random route to its end.
    Navigation,
}

impl TaskKind {
    /// All, easiest first.
    pub const ALL: [Self; 7] = [
        Self::Straight,
        Self::OneTurn,
        Self::Roundabout,
        Self::Obstacle,
        Self::Cross,
        Self::Composite,
        Self::Navigation,
    ];

    /// The paper's five (its figure 7 and table 1).
    pub const FIVE: [Self; 5] =
        [Self::Straight, Self::OneTurn, Self::Roundabout, Self::Obstacle, Self::Cross];

    /// Its name in options and results, e.g. `one_turn`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Straight => "straight",
            Self::OneTurn => "one_turn",
            Self::Roundabout => "roundabout",
            Self::Obstacle => "obstacle",
            Self::Cross => "cross",
            Self::Composite => "composite",
            Self::Navigation => "navigation",
        }
    }

    /// The background traffic that belongs to it.
    pub fn traffic(self) -> TrafficSpec {
        match self {
            Self::Composite => TrafficSpec::Counts(Counts::new(70, 100)),
            _ => TrafficSpec::Empty,
        }
    }

    /// Whether the lights on its route are held at green: `cross` is the first task with red lights.
    pub fn lights_are_green(self) -> bool {
        matches!(self, Self::Straight | Self::OneTurn | Self::Roundabout)
    }

    /// Its tick limit for a route of `length` (m) and ticks of `tick` (s).
    pub fn tick_limit(self, length: f64, tick: f64) -> u64 {
        match self {
            Self::Straight | Self::OneTurn | Self::Roundabout => 600,
            Self::Obstacle => 300,
            Self::Cross | Self::Composite => 1000,
            Self::Navigation => (length / (10.0 / 3.6) / tick).ceil() as u64,
        }
    }
}

impl fmt::Display for TaskKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for TaskKind {
    type Err = TaskError;

    fn from_str(text: &str) -> Result<Self, TaskError> {
        let folded = text.trim().replace(['-', ' '], "_").to_ascii_lowercase();
        Self::ALL
            .into_iter()
            .find(|kind| kind.name() == folded)
            .ok_or_else(|| TaskError::Unknown { found: text.to_string() })
    }
}

/// An episode to drive: the task, traffic and weather, and its place if it is fixed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskSpec {
    /// Which task.
    pub kind: TaskKind,
    /// Background traffic; None: the task's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub traffic: Option<TrafficSpec>,
    /// The weather.
    #[serde(default)]
    pub weather: Preset,
    /// None: the task's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tick_limit: Option<u64>,
    /// None: drawn from the seed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub placement: Option<Placement>,
    /// The route never ends: a further destination is drawn before each is reached.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub endless: bool,
}

impl TaskSpec {
    /// The task with its own traffic and limit, in ClearNoon, at a place drawn from the seed.
    pub fn new(kind: TaskKind) -> Self {
        Self {
            kind,
            traffic: None,
            weather: Preset::ClearNoon,
            tick_limit: None,
            placement: None,
            endless: false,
        }
    }

    /// In another weather.
    #[must_use]
    pub fn in_weather(self, weather: Preset) -> Self {
        Self { weather, ..self }
    }

    /// The background traffic.
    pub fn traffic(&self) -> TrafficSpec {
        self.traffic.unwrap_or_else(|| self.kind.traffic())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_as_they_are_written() {
        for kind in TaskKind::ALL {
            assert_eq!(kind.name().parse::<TaskKind>().unwrap(), kind);
            assert_eq!(serde_json::to_value(kind).unwrap(), kind.name());
        }
        let error = "loop".parse::<TaskKind>().unwrap_err().to_string();
        assert!(error.contains("loop") && error.contains("one_turn"), "{error}");
    }

    #[test]
    fn a_navigation_route_is_allowed_ten_kilometres_an_hour() {
        assert_eq!(TaskKind::Navigation.tick_limit(1000.0, 0.167), 2156);
    }
}
