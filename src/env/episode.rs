//! One episode: its clock, its judge, and what its reward is made from.

use super::eyes::Eyes;
use super::{End, Ending};
use crate::bridge::Ego;
use crate::criteria::{Criteria, CriteriaParams, Event};
use crate::geometry::{Pose, Vector};
use crate::network::{Network, Route};
use crate::reward::{self, Facts, Light, RewardParams};
use crate::tasks::{Placement, TaskKind, TaskSpec};
use crate::vehicle::{Control, EgoState};

/// At the tick limit a task that wants progress counts as survived from this share of the route on.
const PROGRESS: f64 = 0.5;
/// The obstacle task wants the ego to stand so far before it (m).
const STAND: std::ops::RangeInclusive<f64> = 1.0..=10.0;
/// Below this the ego stands (m/s).
const STANDING: f64 = 0.3;
/// How far ahead bends are looked at (m, and s of driving), and how closely (m).
const BENDS: (f64, f64) = (15.0, 4.0);
const BEND_STEP: f64 = 2.0;

pub struct Episode {
    pub task: TaskSpec,
    pub placement: Placement,
    pub limit: u64,
    pub tick: u64,
    pub over: bool,
    pub criteria: Criteria,
    /// Of the last tick: steering (-1..1) and acceleration (m/s2).
    steer: f64,
    acceleration: f64,
}

impl Episode {
    pub fn new(task: TaskSpec, placement: Placement, limit: u64, criteria: CriteriaParams) -> Self {
        Self {
            task,
            placement,
            limit,
            tick: 0,
            over: false,
            criteria: Criteria::new(criteria),
            steer: 0.0,
            acceleration: 0.0,
        }
    }

    /// An ending that is no matter of the clock.
    pub fn ending(&self, end: End, cause: String) -> Ending {
        ending(self.task.kind, end, cause)
    }

    /// What the reward of this tick is made from; remembers what the next one needs.
    pub fn facts(
        &mut self,
        params: &RewardParams,
        ego: &Ego,
        eyes: &Eyes,
        control: &Control,
        events: &[Event],
        ending: Option<&Ending>,
    ) -> Facts {
        let at = ego.on_route();
        let (state, route) = (at.state, ego.route());
        let here = route.at(at.s);
        let bend = (ego.params().wheelbase * here.curvature).atan() / ego.params().max_steer_angle;
        let worst = |impulse: f64, event: &Event| match event {
            Event::Collision { impulse: other, .. } => impulse.max(*other),
            _ => impulse,
        };
        let impulse = events.iter().fold(0.0, worst);
        let end = ending.map(|ending| ending.end);
        let light = eyes.light().filter(|light| light.stops());
        let facts = Facts {
            speed: state.speed,
            acceleration: state.acceleration,
            previous_acceleration: self.acceleration,
            steer: control.steer,
            previous_steer: self.steer,
            speed_limit: here.speed_limit,
            curve_speed: reward::curve_speed(params, bends(route, at.s, state.speed)),
            curve_steer: bend.clamp(-1.0, 1.0),
            offset: route.corridor_offset(at.s, at.d),
            lead: eyes.raw().lead,
            light: light.map(|light| Light { distance: light.distance, red: light.state.is_red() }),
            ran_red: events.iter().any(|event| matches!(event, Event::RedLight { .. })),
            collision: (impulse > 0.0).then_some(impulse),
            blocked: events.contains(&Event::VehicleBlocked),
            left_road: matches!(end, Some(End::OutsideLane | End::Sidewalk)),
        };
        (self.steer, self.acceleration) = (control.steer, state.acceleration);
        facts
    }
}

/// Distance (m) and curvature (1/m) of what the route has ahead.
pub(crate) fn bends(route: &Route, s: f64, speed: f64) -> impl Iterator<Item = (f64, f64)> + '_ {
    let reach = (BENDS.0 + BENDS.1 * speed.max(0.0)).min(route.length() - s);
    let count = (reach.max(0.0) / BEND_STEP) as usize;
    (0..=count).map(move |i| {
        let ahead = i as f64 * BEND_STEP;
        (ahead, route.at(s + ahead).curvature)
    })
}

/// An ending that is no matter of the clock.
pub fn ending(task: TaskKind, end: End, cause: String) -> Ending {
    Ending { end, cause, success: end == End::Arrival && task != TaskKind::Obstacle }
}

/// How an episode ends whose clock has run out after `ticks`.
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

/// The motion of an ego that does not exist.
pub fn nowhere() -> EgoState {
    EgoState {
        pose: Pose::new(0.0, 0.0, 0.0, 0.0),
        roll: 0.0,
        pitch: 0.0,
        velocity: Vector::zeros(),
        speed: 0.0,
        lateral_speed: 0.0,
        yaw_rate: 0.0,
        acceleration: 0.0,
        steer_angle: 0.0,
    }
}
