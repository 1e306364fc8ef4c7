//! One episode: its clock, its criteria, and the facts for its reward.

use crate::reward::{self, Facts, Light, RewardParams};
use sumo_network::geometry::{Pose, Vector};
use wad_see::eyes::Eyes;
use wad_sim::bridge::Ego;
use wad_sim::criteria::Event;
use wad_sim::end::{self, End, Ending};
use wad_sim::tasks::{Placement, TaskSpec};
use wad_vehicle::{Control, EgoState};

pub struct Episode {
    pub task: TaskSpec,
    pub placement: Placement,
    pub limit: u64,
    pub tick: u64,
    pub over: bool,
    /// Of the last tick: steering (-1..1) and acceleration (m/s2).
    steer: f64,
    acceleration: f64,
}

impl Episode {
    pub fn new(task: TaskSpec, placement: Placement, limit: u64) -> Self {
        Self { task, placement, limit, tick: 0, over: false, steer: 0.0, acceleration: 0.0 }
    }

    /// An ending other than a timeout.
    pub fn ending(&self, end: End, cause: String) -> Ending {
        end::ending(self.task.kind, end, cause)
    }

    /// The facts for the reward of this tick; keeps what the next tick needs.
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
        let impulses = events.iter().filter_map(|event| match event {
            Event::Collision { impulse, .. } => Some(*impulse),
            _ => None,
        });
        let end = ending.map(|ending| ending.end);
        let light = eyes.light().filter(|light| light.stops());
        let facts = Facts {
            speed: state.speed,
            acceleration: state.acceleration,
            previous_acceleration: self.acceleration,
            steer: control.steer,
            previous_steer: self.steer,
            speed_limit: here.speed_limit,
            curve_speed: reward::curve_speed(params, reward::bends(route, at.s, state.speed)),
            curve_steer: bend.clamp(-1.0, 1.0),
            offset: route.corridor_offset(at.s, at.d),
            lead: eyes.raw().lead,
            light: light.map(|light| Light { distance: light.distance, red: light.state.is_red() }),
            ran_red: events.iter().any(|event| matches!(event, Event::RedLight { .. })),
            collision: impulses.max_by(f64::total_cmp),
            blocked: events.contains(&Event::VehicleBlocked),
            left_road: matches!(end, Some(End::OutsideLane | End::Sidewalk)),
        };
        (self.steer, self.acceleration) = (control.steer, state.acceleration);
        facts
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
