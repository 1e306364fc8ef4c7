//! The paper's reward for any driver: terms of each tick, and their sums.

use crate::criteria::{EgoOnRoute, Event};
use crate::drive::{Drive, Status};
use crate::network::{Network, Route};
use crate::observation::LeadState;
use crate::perception::{EgoFacts, LightAhead};
use crate::reward::{self, Facts, Light, RewardParams, RewardTerms};
use crate::telemetry::LeaderRecord;
use crate::vehicle::{Control, EgoParams};
use std::sync::Arc;

/// Keeps the score of a drive.
#[derive(Debug, Default)]
pub struct Score {
    params: RewardParams,
    steer: f64,
    acceleration: f64,
    /// Of the last tick.
    pub terms: RewardTerms,
    /// Since the begin.
    pub sums: RewardTerms,
}

/// A tick to be counted: the state after it.
pub struct Tick<'a> {
    /// The town's roads.
    pub network: &'a Network,
    /// The ego's route.
    pub route: &'a Route,
    /// Its motion and its place on the route.
    pub at: EgoOnRoute,
    /// Its measures.
    pub ego: &'a EgoParams,
    /// The states of the signals.
    pub signals: &'a [Option<Arc<str>>],
    /// Its length (s).
    pub dt: f64,
    /// What was driven.
    pub control: Control,
    /// The vehicle in front as the autopilot sees it, which sees the whole world.
    pub leader: Option<LeaderRecord>,
    /// What happened.
    pub events: &'a [Event],
}

impl<'a> Tick<'a> {
    /// The last tick of a drive.
    pub fn of(drive: &'a Drive, status: &'a Status) -> Self {
        let (ego, record) = (drive.ego(), &status.record);
        Self {
            network: drive.bridge().network(),
            route: ego.route(),
            at: ego.on_route(),
            ego: ego.params(),
            signals: &ego.world().traffic_lights,
            dt: drive.bridge().tick(),
            control: record.control,
            leader: record.leader,
            events: &record.events,
        }
    }
}

impl Score {
    /// Counts a tick, and says which light is ahead.
    pub fn count(&mut self, tick: &Tick<'_>) -> Option<LightAhead> {
        let Tick { network, route, at, ego, events, .. } = *tick;
        let here = route.at(at.s);
        let facts = EgoFacts {
            network,
            route,
            on_route: at,
            length: ego.length,
            signals: tick.signals,
            tick: tick.dt,
        };
        let ahead = LightAhead::find(&facts);
        let bend = (ego.wheelbase * here.curvature).atan() / ego.max_steer_angle;
        let worst = |worst: Option<f64>, event: &Event| match event {
            Event::Collision { impulse, .. } => Some(worst.map_or(*impulse, |worst| worst.max(*impulse))),
            _ => worst,
        };
        let left = |event: &Event| matches!(event, Event::OutsideLane { .. } | Event::Sidewalk);
        let state = at.state;
        let facts = Facts {
            speed: state.speed,
            acceleration: state.acceleration,
            previous_acceleration: self.acceleration,
            steer: tick.control.steer,
            previous_steer: self.steer,
            speed_limit: here.speed_limit,
            curve_speed: reward::curve_speed(&self.params, reward::bends(route, at.s, state.speed)),
            curve_steer: bend.clamp(-1.0, 1.0),
            offset: route.corridor_offset(at.s, at.d),
            lead: tick.leader.map(|l| LeadState { gap: l.gap, closing_speed: state.speed - l.speed }),
            light: ahead
                .filter(LightAhead::stops)
                .map(|light| Light { distance: light.distance, red: light.state.is_red() }),
            ran_red: events.iter().any(|event| matches!(event, Event::RedLight { .. })),
            collision: events.iter().fold(None, worst),
            blocked: events.contains(&Event::VehicleBlocked),
            left_road: events.iter().any(left),
        };
        (self.steer, self.acceleration) = (tick.control.steer, state.acceleration);
        self.terms = reward::compute(&self.params, &facts);
        self.sums.add(&self.terms);
        ahead
    }

    /// Starts again from zero.
    pub fn reset(&mut self) {
        *self = Self::default();
    }
}
