//! The result of a run: counts during the run, the summary at its end.

use crate::env::is_ego;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use wad_sim::autopilot::Decision;
use wad_sim::criteria::{Cause, Event};
use wad_sim::end::End;
use wad_vehicle::{EgoState, PartnerKind};

/// Counts by partner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CollisionCounts {
    /// With vehicles.
    pub vehicle: u64,
    /// With pedestrians.
    pub pedestrian: u64,
    /// With fixed objects.
    #[serde(rename = "static")]
    pub fixed: u64,
}

impl CollisionCounts {
    fn add_all(&mut self, other: &Self) {
        self.vehicle += other.vehicle;
        self.pedestrian += other.pedestrian;
        self.fixed += other.fixed;
    }

    fn add(&mut self, kind: PartnerKind) {
        match kind {
            PartnerKind::Vehicle => self.vehicle += 1,
            PartnerKind::Pedestrian => self.pedestrian += 1,
            PartnerKind::Static => self.fixed += 1,
        }
    }
}

/// `summary.json`, and the last line of `run --json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Summary {
    /// The town's name.
    pub town: String,
    /// The run's seed.
    pub seed: u64,
    /// Ticks driven.
    pub ticks: u64,
    /// Length of a tick (ms).
    pub tick_ms: f64,
    /// Simulated time (s).
    pub sim_seconds: f64,
    /// Wall time (s).
    pub wall_seconds: f64,
    /// Ticks per second of wall time.
    pub ticks_per_second: f64,
    /// Way of the ego (m).
    pub distance_m: f64,
    /// Mean speed over all ticks (m/s).
    pub mean_speed_mps: f64,
    /// Mean speed over the ticks in which neither a light nor other traffic held the ego.
    pub mean_free_speed_mps: f64,
    /// Ticks in which a light or other traffic held the ego.
    pub held_ticks: u64,
    /// Highest speed (m/s).
    pub top_speed_mps: f64,
    /// Destinations reached.
    pub destinations_reached: u64,
    /// All collisions.
    pub collisions: CollisionCounts,
    /// Collisions that the ego caused.
    pub collisions_caused: CollisionCounts,
    /// Red lights run.
    pub red_lights_run: u64,
    /// Ticks outside the lane.
    pub outside_lane_ticks: u64,
    /// Times that a wheel left the road.
    pub sidewalk_events: u64,
    /// Times blocked: standing too long without a reason.
    pub vehicle_blocked: u64,
    /// Times the ego was moved to another place because it was blocked or its route could not go on.
    pub respawns: u64,
    /// Mean number of background vehicles.
    pub vehicles_mean: f64,
    /// Mean number of pedestrians.
    pub pedestrians_mean: f64,
    /// How the run ended.
    pub end: End,
    /// Of a scenario: whether its task counts the end as a success, and why it ended.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub success: Option<bool>,
    /// Of a scenario: why it ended.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cause: Option<String>,
    /// The user interrupted the run.
    pub interrupted: bool,
    /// Of several egos: collisions with each other; a crash of two counts once for each.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub collisions_among_egos: u64,
    /// Of several egos: each one's own. The counts above are then their sums, the means those over all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub egos: Vec<EgoSummary>,
    /// The run's folder.
    pub out: PathBuf,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes it so")]
fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// One ego of a run with several.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct EgoSummary {
    /// SUMO's id of it.
    pub id: String,
    /// Its way (m).
    pub distance_m: f64,
    /// Its mean speed (m/s).
    pub mean_speed_mps: f64,
    /// Destinations reached.
    pub destinations_reached: u64,
    /// All its collisions.
    pub collisions: CollisionCounts,
    /// Collisions that it caused.
    pub collisions_caused: CollisionCounts,
    /// Its collisions with other egos.
    pub collisions_among_egos: u64,
    /// Red lights run.
    pub red_lights_run: u64,
    /// Ticks outside the lane.
    pub outside_lane_ticks: u64,
    /// Times moved to another place.
    pub respawns: u64,
}

/// What is counted while driving.
#[derive(Debug, Default)]
pub(super) struct Totals {
    pub ticks: u64,
    pub distance: f64,
    pub free: (u64, f64),
    pub top_speed: f64,
    pub destinations: u64,
    pub collisions: CollisionCounts,
    pub caused: CollisionCounts,
    pub among_egos: u64,
    pub red_lights: u64,
    pub outside_ticks: u64,
    pub sidewalk: u64,
    pub blocked: u64,
    pub respawns: u64,
    pub vehicles: u64,
    pub pedestrians: u64,
}

impl Totals {
    pub fn add(
        &mut self,
        decision: &Decision,
        before: &EgoState,
        after: &EgoState,
        tick: f64,
        counts: (usize, usize),
    ) {
        let step = (after.pose.position - before.pose.position).xy().norm();
        self.ticks += 1;
        self.distance += step;
        if !decision.held {
            self.free.0 += 1;
            self.free.1 += step / tick;
        }
        self.top_speed = self.top_speed.max(after.speed);
        self.vehicles += counts.0 as u64;
        self.pedestrians += counts.1 as u64;
    }

    /// Adds another ego's: its ticks are further ones.
    pub fn add_all(&mut self, other: &Self) {
        self.ticks += other.ticks;
        self.distance += other.distance;
        self.free.0 += other.free.0;
        self.free.1 += other.free.1;
        self.top_speed = self.top_speed.max(other.top_speed);
        self.destinations += other.destinations;
        self.collisions.add_all(&other.collisions);
        self.caused.add_all(&other.caused);
        self.among_egos += other.among_egos;
        self.red_lights += other.red_lights;
        self.outside_ticks += other.outside_ticks;
        self.sidewalk += other.sidewalk;
        self.blocked += other.blocked;
        self.respawns += other.respawns;
        self.vehicles += other.vehicles;
        self.pedestrians += other.pedestrians;
    }

    /// As the summary of the ego of that name; `tick` in s.
    pub fn of_ego(&self, id: &str, tick: f64) -> EgoSummary {
        EgoSummary {
            id: id.to_string(),
            distance_m: self.distance,
            mean_speed_mps: self.distance / (self.ticks.max(1) as f64 * tick),
            destinations_reached: self.destinations,
            collisions: self.collisions,
            collisions_caused: self.caused,
            collisions_among_egos: self.among_egos,
            red_lights_run: self.red_lights,
            outside_lane_ticks: self.outside_ticks,
            respawns: self.respawns,
        }
    }

    pub fn judge(&mut self, events: &[Event]) {
        for event in events {
            match event {
                Event::Collision { kind, cause, partner, .. } => {
                    self.collisions.add(*kind);
                    self.among_egos += u64::from(*kind == PartnerKind::Vehicle && is_ego(partner));
                    if *cause == Cause::Ego {
                        self.caused.add(*kind);
                    }
                }
                Event::RedLight { .. } => self.red_lights += 1,
                Event::OutsideLane { .. } => {}
                Event::Sidewalk => self.sidewalk += 1,
                Event::VehicleBlocked => self.blocked += 1,
                Event::Arrival => self.destinations += 1,
            }
        }
    }
}
