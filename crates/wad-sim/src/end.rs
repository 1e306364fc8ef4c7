//! How episodes end (spec.md "Ends"): the paper's hard termination, and the clock.

use crate::bridge::Ego;
use crate::criteria::Event;
use crate::tasks::{Placement, TaskKind};
use serde::{Deserialize, Serialize};
use std::fmt;
use sumo_network::network::Network;
use wad_vehicle::PartnerKind;

/// How an episode ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// Within 5 m of the route's end.
    Arrival,
    /// Alive at the tick limit, which the task counts as a success.
    Survived,
    /// A collision.
    Collision,
    /// The ego ran a red light.
    RedLight,
    /// The ego left its lane.
    OutsideLane,
    /// A wheel left the road surface.
    Sidewalk,
    /// The ego stood too long without a reason.
    VehicleBlocked,
    /// The tick limit, which the task counts as a failure.
    Timeout,
    /// SUMO died; the episode does not count.
    Error,
}

impl End {
    /// All of them, in the order of tables.
    pub const ALL: [Self; 9] = [
        Self::Arrival,
        Self::Survived,
        Self::Collision,
        Self::RedLight,
        Self::OutsideLane,
        Self::Sidewalk,
        Self::VehicleBlocked,
        Self::Timeout,
        Self::Error,
    ];

    /// Its name in spec.md and in results, e.g. `red_light`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Arrival => "arrival",
            Self::Survived => "survived",
            Self::Collision => "collision",
            Self::RedLight => "red_light",
            Self::OutsideLane => "outside_lane",
            Self::Sidewalk => "sidewalk",
            Self::VehicleBlocked => "vehicle_blocked",
            Self::Timeout => "timeout",
            Self::Error => "error",
        }
    }

    /// Whether the ego's own driving ended the episode (`terminated`); the other ends truncate it (`truncated`).
    pub fn is_terminal(self) -> bool {
        matches!(
            self,
            Self::Collision | Self::RedLight | Self::OutsideLane | Self::Sidewalk | Self::VehicleBlocked
        )
    }
}

impl fmt::Display for End {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// How an episode ended, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ending {
    /// The kind of end.
    pub end: End,
    /// The reason as text: partner and impulse of a collision, the light that was run, ...
    pub cause: String,
    /// Whether the task counts it as a success.
    pub success: bool,
}

/// Which events end an episode. The default is the paper's hard termination; the thresholds of the
/// events are [`crate::criteria::CriteriaParams`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Termination {
    /// A collision ends it.
    pub collision: bool,
    /// A red light that was run ends it.
    pub red_light: bool,
    /// Leaving the lane ends it.
    pub outside_lane: bool,
    /// Leaving the road surface with a wheel ends it.
    pub sidewalk: bool,
    /// Standing too long without a reason ends it.
    pub vehicle_blocked: bool,
}

impl Default for Termination {
    fn default() -> Self {
        Self { collision: true, red_light: true, outside_lane: true, sidewalk: true, vehicle_blocked: true }
    }
}

impl Termination {
    /// Only collisions and blocking end an episode (for the ablation).
    pub fn soft() -> Self {
        Self { red_light: false, outside_lane: false, sidewalk: false, ..Self::default() }
    }

    /// Nothing but arrival and the clock ends an episode (CoRL2017).
    pub fn none() -> Self {
        Self { collision: false, vehicle_blocked: false, ..Self::soft() }
    }

    /// The end that the events of a tick bring, and why: the gravest first.
    pub fn decide(&self, events: &[Event]) -> Option<(End, String)> {
        let rank = |end: End| End::ALL.iter().position(|e| *e == end);
        events.iter().filter_map(|event| self.end_of(event)).min_by_key(|(end, _)| match end {
            // What ended badly did not arrive.
            End::Arrival => Some(End::ALL.len()),
            end => rank(*end),
        })
    }

    fn end_of(&self, event: &Event) -> Option<(End, String)> {
        match event {
            Event::Collision { kind, partner, impulse, reason, .. } if self.collision => {
                let kind = match kind {
                    PartnerKind::Vehicle => "vehicle",
                    PartnerKind::Pedestrian => "pedestrian",
                    PartnerKind::Static => "static",
                };
                Some((End::Collision, format!("{kind} {partner}, {impulse:.0} N s: {reason}")))
            }
            Event::RedLight { traffic_light, speed } if self.red_light => {
                Some((End::RedLight, format!("light {traffic_light} at {speed:.1} m/s")))
            }
            Event::OutsideLane { offset } if self.outside_lane => {
                Some((End::OutsideLane, format!("{offset:.2} m from the centre")))
            }
            Event::Sidewalk if self.sidewalk => {
                Some((End::Sidewalk, "a wheel left the road surface".to_string()))
            }
            Event::VehicleBlocked if self.vehicle_blocked => {
                Some((End::VehicleBlocked, "stood with no red light and nobody ahead".to_string()))
            }
            Event::Arrival => Some((End::Arrival, "the route's end".to_string())),
            _ => None,
        }
    }
}

/// At the tick limit a task that wants progress counts as survived from this share of the route on.
const PROGRESS: f64 = 0.5;
/// The obstacle task is passed at this distance before the obstacle (m).
const STAND: std::ops::RangeInclusive<f64> = 1.0..=10.0;
/// Below this the ego stands (m/s).
const STANDING: f64 = 0.3;
/// The ending of an episode that ends before its tick limit.
pub fn ending(task: TaskKind, end: End, cause: String) -> Ending {
    Ending { end, cause, success: end == End::Arrival && task != TaskKind::Obstacle }
}

/// The ending of an episode at its tick limit, after `ticks`.
pub fn judge_limit(
    task: TaskKind,
    placement: &Placement,
    ticks: u64,
    network: &Network,
    ego: &Ego,
) -> Ending {
    let at = ego.on_route();
    let share = at.s / ego.route().length().max(1.0);
    let ending = |success: bool, cause: String| Ending {
        end: if success { End::Survived } else { End::Timeout },
        cause,
        success,
    };
    match task {
        TaskKind::Composite => ending(true, format!("alive after {ticks} ticks")),
        TaskKind::Navigation => ending(false, format!("{:.0} % of the route driven", 100.0 * share)),
        TaskKind::Obstacle => {
            let obstacle = placement.obstacle.as_ref().and_then(|o| o.at.on(network).ok());
            let way = obstacle.map_or(0.0, |at| {
                let place = network.lane(at.lane).shape.at(at.s).xy();
                ego.route().centre_line.project(place).s
            });
            let gap = way - at.s - 0.5 * ego.params().length;
            let stands = at.state.speed.abs() < STANDING;
            let cause =
                format!("{} {gap:.1} m before the obstacle", if stands { "standing" } else { "moving" });
            ending(stands && STAND.contains(&gap), cause)
        }
        _ => ending(share >= PROGRESS, format!("{:.0} % of the route driven", 100.0 * share)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_ends_badly_did_not_arrive() {
        let events =
            [Event::Arrival, Event::OutsideLane { offset: 1.9 }, Event::VehicleBlocked, Event::Sidewalk];
        let end = |termination: Termination| termination.decide(&events).map(|(end, _)| end);
        assert_eq!(end(Termination::default()), Some(End::OutsideLane));
        assert_eq!(end(Termination::soft()), Some(End::VehicleBlocked));
        assert_eq!(end(Termination::none()), Some(End::Arrival));
        assert_eq!(Termination::default().decide(&[]), None);
    }

    #[test]
    fn names_in_results_are_those_of_the_spec() {
        for end in End::ALL {
            assert_eq!(serde_json::to_value(end).unwrap(), end.name());
        }
        assert_eq!(End::ALL.iter().filter(|end| end.is_terminal()).count(), 5);
    }
}
