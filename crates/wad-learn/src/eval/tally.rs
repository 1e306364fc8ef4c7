//! Sums over an episode.

use crate::env::{Info, is_ego};
use crate::reward::RewardTerms;
use serde::{Deserialize, Serialize};
use sumo_network::geometry::Point;
use wad_sim::bridge::Ego;
use wad_sim::criteria::{Cause, Event};
use wad_vehicle::PartnerKind;

/// Events of an episode by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct EventCounts {
    /// Collisions with vehicles.
    pub collisions_vehicle: u64,
    /// Of these, with other egos.
    #[serde(skip_serializing_if = "is_zero")]
    pub collisions_ego: u64,
    /// Collisions with pedestrians.
    pub collisions_pedestrian: u64,
    /// Collisions with fixed objects.
    pub collisions_static: u64,
    /// Collisions that the ego caused.
    pub collisions_caused: u64,
    /// Red lights run.
    pub red_lights: u64,
    /// Times outside the lane.
    pub outside_lane: u64,
    /// Times that a wheel left the road.
    pub sidewalk: u64,
    /// Times blocked: standing too long without a reason.
    pub vehicle_blocked: u64,
}

fn is_zero(n: &u64) -> bool {
    *n == 0
}

impl EventCounts {
    /// The name of collisions with other egos, which only an evaluation with several egos has.
    pub const WITH_EGOS: &str = "of these with other egos";

    /// Kinds by name, in the order of tables.
    pub fn named(&self) -> [(&'static str, u64); 8] {
        [
            ("collisions with vehicles", self.collisions_vehicle),
            (Self::WITH_EGOS, self.collisions_ego),
            ("collisions with pedestrians", self.collisions_pedestrian),
            ("collisions with fixed things", self.collisions_static),
            ("red lights run", self.red_lights),
            ("times outside the lane", self.outside_lane),
            ("times off the road", self.sidewalk),
            ("times blocked", self.vehicle_blocked),
        ]
    }

    /// Adds another episode's.
    pub fn add(&mut self, other: &Self) {
        self.collisions_vehicle += other.collisions_vehicle;
        self.collisions_ego += other.collisions_ego;
        self.collisions_pedestrian += other.collisions_pedestrian;
        self.collisions_static += other.collisions_static;
        self.collisions_caused += other.collisions_caused;
        self.red_lights += other.red_lights;
        self.outside_lane += other.outside_lane;
        self.sidewalk += other.sidewalk;
        self.vehicle_blocked += other.vehicle_blocked;
    }

    fn note(&mut self, event: &Event) {
        match event {
            Event::Collision { kind, cause, partner, .. } => {
                self.collisions_ego += u64::from(*kind == PartnerKind::Vehicle && is_ego(partner));
                self.collisions_caused += u64::from(*cause == Cause::Ego);
                *match kind {
                    PartnerKind::Vehicle => &mut self.collisions_vehicle,
                    PartnerKind::Pedestrian => &mut self.collisions_pedestrian,
                    PartnerKind::Static => &mut self.collisions_static,
                } += 1;
            }
            Event::RedLight { .. } => self.red_lights += 1,
            Event::OutsideLane { .. } => self.outside_lane += 1,
            Event::Sidewalk => self.sidewalk += 1,
            Event::VehicleBlocked => self.vehicle_blocked += 1,
            Event::Arrival => {}
        }
    }
}

/// Ticks by the size of something: [`Histogram::BINS`] bins of equal width from 0; the last holds the rest.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Histogram(pub Vec<u64>);

impl Histogram {
    /// Number of bins.
    pub const BINS: usize = 12;
    /// Width of a bin: of speeds (km/h), and of gaps (m).
    pub const SPEED: f64 = 5.0;
    /// Width of a bin of gaps (m).
    pub const GAP: f64 = 5.0;

    fn note(&mut self, value: f64, width: f64) {
        self.0.resize(Self::BINS, 0);
        self.0[((value / width).max(0.0) as usize).min(Self::BINS - 1)] += 1;
    }

    /// Adds another one's.
    pub fn add(&mut self, other: &Self) {
        self.0.resize(Self::BINS.max(other.0.len()), 0);
        for (mine, theirs) in self.0.iter_mut().zip(&other.0) {
            *mine += theirs;
        }
    }
}

/// Sums over an episode's ticks.
#[derive(Default)]
pub struct Tally {
    pub events: EventCounts,
    pub speeds: Histogram,
    pub gaps: Histogram,
    pub speed: f64,
    pub top_speed: f64,
    pub acceleration: f64,
    steer: f64,
    pub steer_change: f64,
    pub terms: RewardTerms,
    pub vehicles: f64,
    pub pedestrians: f64,
    pub distance: f64,
    pub last: Option<Point>,
}

impl Tally {
    /// Begins at the ego's position.
    pub fn at(place: Option<Point>) -> Self {
        let (speeds, gaps) = (Histogram(vec![0; Histogram::BINS]), Histogram(vec![0; Histogram::BINS]));
        Self { last: place, speeds, gaps, ..Self::default() }
    }

    /// Adds a tick with steering `steer`.
    pub fn add(&mut self, info: &Info, ego: Option<&Ego>, steer: f64) {
        let state = &info.ego;
        let speed = state.speed.max(0.0);
        self.speed += speed;
        self.top_speed = self.top_speed.max(speed);
        self.acceleration += state.acceleration.powi(2);
        self.steer_change += (steer - self.steer).powi(2);
        self.steer = steer;
        self.terms.add(&info.reward);
        self.vehicles += info.traffic.0 as f64;
        self.pedestrians += info.traffic.1 as f64;
        info.events.iter().for_each(|event| self.events.note(event));
        self.speeds.note(3.6 * speed, Histogram::SPEED);
        if let Some(gap) = ego.and_then(gap) {
            self.gaps.note(gap, Histogram::GAP);
        }
        let here = state.pose.xy();
        self.distance += self.last.map_or(0.0, |last| (here - last).norm());
        self.last = Some(here);
    }
}

/// How far vehicles in front are looked for (m), and how far beside the route's line their centres may be.
const AHEAD: f64 = 55.0;
const BESIDE: f64 = 1.5;

/// True gap to the next vehicle on the ego's route (m).
fn gap(ego: &Ego) -> Option<f64> {
    let at = ego.on_route();
    let here = at.state.pose;
    let near = |actor: &&sumo_network::world::Actor| {
        let local = here.to_local(actor.pose.xy());
        local.x > 0.0 && local.norm() < AHEAD
    };
    let gaps = ego.world().vehicles.iter().filter(near).filter_map(|actor| {
        let place = ego.route().project_near(actor.pose.xy(), at.s, 0.0, AHEAD);
        let gap = place.s - 0.5 * actor.actor_type.length - at.front_s;
        (place.d.abs() < BESIDE && place.s > at.s).then_some(gap.max(0.0))
    });
    gaps.min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn egos_that_are_hit_are_counted_apart() {
        let mut events = EventCounts::default();
        for partner in ["ego2", "vehicle7", "ego"] {
            let partner = partner.to_string();
            let kind = PartnerKind::Vehicle;
            events.note(&Event::Collision {
                kind,
                partner,
                impulse: 1.0,
                cause: Cause::Ego,
                point: sumo_network::geometry::Vector::zeros(),
                ego_speed: 3.0,
                partner_speed: 0.0,
                reason: String::new(),
            });
        }
        assert_eq!((events.collisions_vehicle, events.collisions_ego), (3, 2));
        let alone = serde_json::to_string(&EventCounts::default()).unwrap();
        assert!(!alone.contains("ego\""), "{alone}");
    }

    #[test]
    fn bins_hold_everything() {
        let mut speeds = Histogram::default();
        for speed in [0.0, 4.9, 5.0, 54.0, 59.9, 300.0, -1.0] {
            speeds.note(speed, Histogram::SPEED);
        }
        assert_eq!(speeds.0, [3, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2]);
        let mut both = Histogram::default();
        both.add(&speeds);
        both.add(&speeds);
        assert_eq!(both.0.iter().sum::<u64>(), 14);
    }
}
