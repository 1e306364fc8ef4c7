//! Which side caused a collision (spec.md "Events").

use super::{Event, Situation};
use serde::{Deserialize, Serialize};
use sumo_network::geometry::{Vector, direction};
use sumo_network::network::{EdgeKind, LinkId};
use sumo_network::world::Actor;
use wad_vehicle::{Contact, PartnerKind};

/// Which side caused a collision.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// The ego's front or side ran into the other while it was moving, lacked right of way, or was off its lane.
    Ego,
    /// The other drove into the ego.
    Other,
}

/// Below this the ego counts as standing (m/s).
const STANDING: f64 = 0.3;

/// The collision event of a contact; `outside_lane` (m) from its lane the ego is off it.
pub fn collision(now: &Situation<'_>, contact: &Contact, outside_lane: f64) -> Event {
    let other = match contact.kind {
        PartnerKind::Vehicle => now.world.vehicles.iter().find(|a| a.key == contact.key),
        PartnerKind::Pedestrian => now.world.pedestrians.iter().find(|a| a.key == contact.key),
        PartnerKind::Static => None,
    };
    let (cause, reason) = judge(now, contact, other, outside_lane);
    Event::Collision {
        kind: contact.kind,
        partner: other.map_or_else(|| (now.static_label)(contact.key), |a| a.id.to_string()),
        impulse: contact.impulse,
        cause,
        point: contact.point,
        ego_speed: now.before.state.speed,
        partner_speed: other.map_or(0.0, |a| a.speed),
        reason: reason.to_string(),
    }
}

fn judge(
    now: &Situation<'_>,
    contact: &Contact,
    other: Option<&Actor>,
    outside_lane: f64,
) -> (Cause, &'static str) {
    let Some(other) = other else { return (Cause::Ego, "ran into a fixed object") };
    let ego = &now.before.state;
    if now.route.corridor_offset(now.before.s, now.before.d) > outside_lane {
        return (Cause::Ego, "the ego was off its lane");
    }
    if ego.speed.abs() < STANDING {
        return (Cause::Other, "the other drove into the standing ego");
    }
    // Closing speeds along the line between the two at the contact.
    let point = ego.pose.to_world(contact.point);
    let towards_other = {
        let line = other.pose.xy() - ego.pose.xy();
        if line.norm() > 1e-6 { line.normalize() } else { Vector::zeros() }
    };
    let ego_closing = ego.velocity.dot(&towards_other);
    let other_closing = -(direction(other.pose.heading) * other.speed).dot(&towards_other);
    let half = 0.5 * now.length;
    if contact.point.x < -half + 0.4 && other_closing > 0.0 {
        return (Cause::Other, "the other ran into the ego's rear");
    }
    if lacks_right_of_way(now, other) {
        return (Cause::Ego, "the ego lacked right of way");
    }
    // Where the ego was struck on the other: at its front, the other did the striking.
    let on_other = other.pose.to_local(point);
    let by_front_of_other = on_other.x > 0.5 * other.actor_type.length - 0.6;
    let at_ego_front = contact.point.x > half - 0.6;
    if !at_ego_front && by_front_of_other && other_closing > ego_closing {
        return (Cause::Other, "the other's front ran into the ego's side");
    }
    if contact.kind == PartnerKind::Pedestrian && !at_ego_front {
        return (Cause::Other, "the pedestrian walked into the ego's side");
    }
    (Cause::Ego, "the moving ego's front or side ran into the other")
}

/// Whether the ego's link had to let the other's link pass.
fn lacks_right_of_way(now: &Situation<'_>, other: &Actor) -> bool {
    let Some(link) = now.route.link_at(now.before.front_s) else { return false };
    let yields = &now.network.link(link.link).must_yield_to;
    let Some(lane) = other.lane else { return false };
    let edge = now.network.edge(now.network.lane(lane).edge);
    match edge.kind {
        EdgeKind::Internal => {
            let incoming: &[LinkId] = &now.network.lane(lane).incoming;
            incoming.iter().any(|l| yields.contains(l))
        }
        EdgeKind::Crossing => {
            let crossings = &now.network.link(link.link).yields_to_crossings;
            crossings.iter().any(|c| now.network.crossing(*c).lane == lane)
        }
        _ => false,
    }
}
