//! Contacts of the ego: partner, impulse and place.

use super::{Contact, EgoParams, MovingBody, PartnerKind};
use sumo_network::geometry::{Pose, Vector};

/// Contacts gathered over the sub-steps of a tick.
#[derive(Default)]
pub(super) struct ContactLog {
    entries: Vec<Contact>,
}

impl ContactLog {
    /// Adds an impulse (N s) at a point of the ego (x forward, y left, m). The point reported in the
    /// end is the impulses' mean.
    pub(super) fn add(&mut self, kind: PartnerKind, key: u64, impulse: f64, point: Vector) {
        match self.entries.iter_mut().find(|c| c.kind == kind && c.key == key) {
            Some(contact) => {
                let sum = contact.impulse + impulse;
                if impulse > 0.0 {
                    contact.point = (contact.point * contact.impulse + point * impulse) / sum;
                }
                contact.impulse = sum;
            }
            None => self.entries.push(Contact { kind, key, impulse, point }),
        }
    }

    /// The contacts with more than a touch (1 N s), by kind and key.
    pub(super) fn finish(mut self) -> Vec<Contact> {
        // A pedestrian who is touched counts, however softly.
        self.entries.retain(|c| c.impulse > 1.0 || c.kind == PartnerKind::Pedestrian);
        self.entries.sort_by_key(|c| (c.kind as u8, c.key));
        self.entries
    }
}

/// Pedestrians against the ego's footprint.
///
/// A pedestrian is an upright capsule that does not stop the ego: a hit gives both the
/// impulse of a perfectly plastic blow between the ego and 75 kg, once until they have been apart. Until then
/// they touch without impulse.
#[derive(Default)]
pub(super) struct PedestrianStrikes {
    /// Keys of pedestrians that were hit and still overlap the footprint.
    struck: Vec<u64>,
}

/// A blow to the ego: impulse on it (N s) and where (m), both in its own frame.
pub(super) struct Blow {
    pub(super) impulse: Vector,
    pub(super) point: Vector,
}

/// The ego's motion as a flat footprint: `velocity` (m/s) in its own frame.
pub(super) struct Footprint {
    pub(super) pose: Pose,
    pub(super) velocity: Vector,
    pub(super) yaw_rate: f64,
}

impl PedestrianStrikes {
    /// The blows of this moment; `elapsed` (s) since the tick's begin, when `pedestrians` were where
    /// they say.
    pub(super) fn check(
        &mut self,
        params: &EgoParams,
        ego: &Footprint,
        pedestrians: &[MovingBody],
        elapsed: f64,
        log: &mut ContactLog,
    ) -> Vec<Blow> {
        let half = Vector::new(0.5 * params.length, 0.5 * params.width);
        let mut blows = Vec::new();
        for body in pedestrians {
            let now = body.at(elapsed);
            let centre = ego.pose.to_local(now.xy());
            let radius = 0.25 * (body.length + body.width);
            let Some((point, outward)) = touch(half, centre, radius) else {
                self.struck.retain(|&key| key != body.key);
                continue;
            };
            if self.struck.contains(&body.key) {
                log.add(PartnerKind::Pedestrian, body.key, 0.0, point);
                continue;
            }
            let turn = body.pose.heading - ego.pose.heading;
            let walking = Vector::new(turn.cos(), turn.sin()) * body.speed;
            let ego_here = ego.velocity + Vector::new(-point.y, point.x) * ego.yaw_rate;
            let closing = (ego_here - walking).dot(&outward);
            if closing <= 0.0 {
                // They part: nobody touched anybody.
                continue;
            }
            self.struck.push(body.key);
            let reduced = params.mass * params.pedestrian_mass / (params.mass + params.pedestrian_mass);
            let impulse = reduced * closing;
            log.add(PartnerKind::Pedestrian, body.key, impulse, point);
            blows.push(Blow { impulse: -outward * impulse, point });
        }
        self.struck.retain(|key| pedestrians.iter().any(|body| body.key == *key));
        blows
    }
}

/// Where a disc touches a rectangle round the origin, and the rectangle's outward normal there.
fn touch(half: Vector, centre: Vector, radius: f64) -> Option<(Vector, Vector)> {
    let nearest = Vector::new(centre.x.clamp(-half.x, half.x), centre.y.clamp(-half.y, half.y));
    let apart = centre - nearest;
    let distance = apart.norm();
    if distance > radius {
        return None;
    }
    if distance > 1e-9 {
        return Some((nearest, apart / distance));
    }
    // The centre is inside: out through the nearest side.
    let depth = half - centre.abs();
    let outward = if depth.x < depth.y {
        Vector::new(1f64.copysign(centre.x), 0.0)
    } else {
        Vector::new(0.0, 1f64.copysign(centre.y))
    };
    Some((centre, outward))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reported_point_is_the_impulses_mean() {
        let mut log = ContactLog::default();
        log.add(PartnerKind::Static, 7, 100.0, Vector::new(2.0, 0.0));
        log.add(PartnerKind::Vehicle, 7, 50.0, Vector::new(0.0, 1.0));
        log.add(PartnerKind::Static, 7, 300.0, Vector::new(2.0, 0.8));
        log.add(PartnerKind::Static, 8, 0.5, Vector::new(0.0, 0.0));
        // Brushed twice without a push.
        log.add(PartnerKind::Pedestrian, 9, 0.0, Vector::new(1.0, 1.0));
        log.add(PartnerKind::Pedestrian, 9, 0.0, Vector::new(1.0, 1.0));
        let mut contacts = log.finish();
        let people: Vec<_> = contacts.extract_if(.., |c| c.kind == PartnerKind::Pedestrian).collect();
        assert_eq!((people.len(), people[0].impulse, people[0].point), (1, 0.0, Vector::new(1.0, 1.0)));
        assert_eq!(contacts.len(), 2);
        assert_eq!((contacts[0].kind, contacts[0].impulse), (PartnerKind::Vehicle, 50.0));
        assert_eq!(contacts[1].impulse, 400.0);
        assert!((contacts[1].point - Vector::new(2.0, 0.6)).norm() < 1e-12);
    }

    #[test]
    fn a_disc_touches_sides_corners_and_the_inside() {
        let half = Vector::new(2.0, 1.0);
        assert!(touch(half, Vector::new(2.4, 0.0), 0.3).is_none());
        let (point, outward) = touch(half, Vector::new(2.2, 0.5), 0.3).expect("side");
        assert_eq!((point, outward), (Vector::new(2.0, 0.5), Vector::new(1.0, 0.0)));
        assert!(touch(half, Vector::new(2.25, 1.25), 0.3).is_none());
        assert!(touch(half, Vector::new(2.2, 1.2), 0.3).is_some());
        let (_, outward) = touch(half, Vector::new(0.0, -0.9), 0.3).expect("inside");
        assert_eq!(outward, Vector::new(0.0, -1.0));
    }
}
