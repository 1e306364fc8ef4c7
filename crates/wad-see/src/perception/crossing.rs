//! Road users who will be in the ego's path: the prediction of those who are followed.
//!
//! One picture does not show whether somebody moves or waits. So [`RoadUsers`] has place and velocity
//! of each detected vehicle and person on the ground, and a straight line predicts the way. Where the ego has to give
//! way, and the prediction meets its route while the ego can be there, that road user counts as the vehicle in front.
//! So an ego that turns left stops for oncoming vehicles, and one that turns right for who walks across. Who is on a crossing
//! is taken to walk along it, and who is on a lane that goes first to drive along it: the filter needs seconds to know how
//! somebody moves. Nothing here comes from SUMO except the map, the ego's route and its right of way.

use super::EgoFacts;
use super::road_users::{Kind, RoadUser, RoadUsers};
use crate::observation::LeadState;
use crate::perception::lead::{HALF_WAY, SIGHT};
use sumo_network::geometry::{Point, Vector, direction};
use sumo_network::network::{Link, RouteLink};
use sumo_network::world::{Actor, ActorKind};

/// Time (s) that vehicles are predicted ahead, and its steps.
const HORIZON: f64 = 4.5;
const STEP: f64 = 0.25;
/// Between one leaving a place and the other coming there (s).
const MARGIN: f64 = 1.0;
/// The ego's possible acceleration on its way there (m/s2).
const EGO_ACCELERATION: f64 = 1.5;
/// A crossing reaches this far to each side of its middle (m).
const CROSSING: f64 = 3.0;
/// Detections before a velocity is used, and before who is on a crossing or lane is taken to come along it.
const BELIEVED: u32 = 4;
const LOOKS: u32 = 2;
/// Somebody within this distance (m) of a crossing's middle line is on it, and as much more as it is unsure, to this most.
const HALF_CROSSING: f64 = 2.0;
const UNSURE: f64 = 1.5;
/// How near the crossing's end somebody who walks towards it is about to step onto it (m).
const KERB: f64 = 2.0;
/// Who walks is faster than the first (m/s), and is taken to be as fast as the second.
const SLOW: f64 = 0.6;
const WALKS: f64 = 1.1;
/// How fast vehicles with right of way are, as a share of what is allowed, and the standard deviation of that (m/s).
const USUAL: f64 = 0.7;
const USUAL_DOUBT: f64 = 4.0;
/// How far beside a crossing's middle people walk, and beside their lane's vehicles drive (m): standard deviations.
const OFF_CROSSING: f64 = 1.0;
const OFF_LANE: f64 = 0.4;

/// The ways over junctions on the ego's route, as far as it can see.
fn links_ahead<'a>(facts: &EgoFacts<'a>) -> impl Iterator<Item = &'a Link> {
    let network = facts.network;
    let (from, to) = (facts.on_route.front_s - CROSSING, facts.on_route.front_s + SIGHT);
    let links = facts.route.links.iter().filter(move |link| link.end_s > from && link.stop_s < to);
    links.map(|link| network.link(link.link))
}

/// The nearest who will be in the ego's path, as a vehicle in front.
pub fn nearest(users: &RoadUsers, facts: &EgoFacts<'_>) -> Option<LeadState> {
    let found = users.iter().filter_map(|user| user.crosses(facts));
    found.min_by(|a, b| a.gap.total_cmp(&b.gap))
}

/// What a tracker that knows all would tell of `actor`, if it will be in the ego's path.
pub fn truth(actor: &Actor, facts: &EgoFacts<'_>) -> Option<LeadState> {
    let kind = match actor.actor_type.kind {
        ActorKind::Car | ActorKind::Van | ActorKind::Truck | ActorKind::Bus => Kind::Vehicle,
        ActorKind::Motorcycle | ActorKind::Bicycle => Kind::TwoWheeler,
        ActorKind::Pedestrian => Kind::Person,
        ActorKind::Object => return None,
    };
    let (place, velocity) = (actor.pose.xy().coords, direction(actor.pose.heading) * actor.speed);
    meets(kind, place, velocity, facts)
}

impl RoadUser {
    /// Where it is or will be in the ego's path while the ego can be there, as a vehicle in front.
    fn crosses(&self, facts: &EgoFacts<'_>) -> Option<LeadState> {
        let on_way = self.walk(facts).or_else(|| self.drive(facts));
        let (place, velocity) = on_way.or_else(|| Some((self.place, self.sure_velocity()?)))?;
        meets(self.kind, place, velocity, facts)
    }

    /// Its velocity (m/s), once that is known well enough.
    fn sure_velocity(&self) -> Option<Vector> {
        // Along its own way: how far off somebody is, is known less well than where beside the ray.
        let (speed, doubt) = self.along(self.velocity.try_normalize(1e-6)?);
        (self.seen >= BELIEVED && speed >= 2.0 * doubt).then_some(self.velocity)
    }

    /// Place (m) and velocity (m/s) of somebody who walks over a crossing at which the ego has to give way, or is about to step
    /// onto it. Who is on one walks along it, so that two looks tell more than many do elsewhere.
    fn walk(&self, facts: &EgoFacts<'_>) -> Option<(Vector, Vector)> {
        if self.kind != Kind::Person || self.seen < LOOKS {
            return None;
        }
        let crossings = links_ahead(facts).flat_map(|link| &link.yields_to_crossings);
        crossings.copied().find_map(|crossing| {
            let line = &facts.network.lane(facts.network.crossing(crossing).lane).shape;
            let (from, to) = (line.at(0.0).xy(), line.at(line.length()).xy());
            let way = (to - from).try_normalize(1e-6)?;
            let place = Point::from(self.place);
            let side = Vector::new(-way.y, way.x);
            let off = line.project(place).distance;
            if off > HALF_CROSSING + self.unsure(side).min(UNSURE) {
                return None;
            }
            // The way along it that leads to the ego's path.
            let to_path = |place: Point| facts.ahead(place).d.abs();
            let way = if to_path(place + 0.5 * way) < to_path(place) { way } else { -way };
            let (comes, doubt) = self.along(way);
            let on = (place - from).dot(&way) * (place - to).dot(&way) < 0.0;
            let to_it = (from + 0.5 * (to - from) - place).dot(&way) > 0.0;
            let walks = if on {
                // Unless it surely stands or leaves.
                comes + doubt > SLOW
            } else {
                off < KERB && to_it && comes > SLOW.max(doubt)
            };
            let place = self.nearer(side, (place - from).dot(&side), OFF_CROSSING);
            walks.then(|| (place, way * comes.max(WALKS)))
        })
    }

    /// Place (m) and velocity (m/s) of a vehicle on a lane to whose vehicles the ego has to give way: along the lane, and as
    /// fast as is usual there while it is not known better.
    fn drive(&self, facts: &EgoFacts<'_>) -> Option<(Vector, Vector)> {
        if self.kind == Kind::Person || self.seen < LOOKS {
            return None;
        }
        let network = facts.network;
        let foes = links_ahead(facts).flat_map(|link| &link.must_yield_to).map(|&foe| network.link(foe));
        let lanes = foes.flat_map(|foe| std::iter::once(foe.from).chain(foe.via.iter().copied()));
        lanes.map(|lane| network.lane(lane)).find_map(|lane| {
            let on = lane.shape.project(Point::from(self.place));
            let way = direction(lane.shape.at(on.s).heading);
            let side = Vector::new(-way.y, way.x);
            if on.distance > 0.5 * lane.width + self.unsure(side).min(UNSURE) {
                return None;
            }
            let (comes, doubt) = self.along(way);
            // Unless it surely stands or leaves.
            if comes + doubt < self.kind.slowest() {
                return None;
            }
            let known = USUAL_DOUBT.powi(2) / (USUAL_DOUBT.powi(2) + doubt * doubt);
            let usual = USUAL * lane.speed_limit;
            let place = self.nearer(side, on.d, OFF_LANE);
            Some((place, way * (usual + known * (comes - usual)).max(self.kind.slowest())))
        })
    }

    /// Its place, `off` (m) beside the line that it follows, to which `side` is at right angles: drawn to it, as far as it is
    /// unsure. Others are `usual` (m) beside it.
    fn nearer(&self, side: Vector, off: f64, usual: f64) -> Vector {
        let doubt = self.unsure(side).powi(2);
        self.place - side * (off * doubt / (doubt + usual * usual))
    }
}

/// Where somebody at `place` (m) is or will be in the ego's path with this velocity (m/s) while the ego can be there, as a
/// vehicle in front.
fn meets(kind: Kind, place: Vector, velocity: Vector, facts: &EgoFacts<'_>) -> Option<LeadState> {
    let speed = velocity.norm();
    if speed < kind.slowest() {
        return None;
    }
    let on_route = &facts.on_route;
    let steps = (HORIZON / STEP) as usize;
    // When it is in the path, and where that begins and ends.
    let mut times: Option<(f64, f64)> = None;
    let (mut begin, mut end, mut course) = (f64::INFINITY, f64::NEG_INFINITY, Vector::zeros());
    for k in 0..=steps {
        let t = k as f64 * STEP;
        let place = Point::from(place + velocity * t);
        let on = facts.ahead(place);
        // Beyond the ends of the searched stretch a point is off the route.
        if (on.distance - on.d.abs()).abs() > 0.1 {
            continue;
        }
        let way = direction(facts.route.at(on.s).pose.heading);
        let along = (velocity.dot(&way) / speed).abs().min(1.0);
        let across = (1.0 - along * along).sqrt();
        let [long, broad] = kind.half();
        if on.d.abs() - (across * long + along * broad) > HALF_WAY {
            continue;
        }
        // What is there now and goes the ego's way is in front already.
        if k == 0 && velocity.dot(&way) > 0.7 * speed {
            return None;
        }
        let first = times.map_or(t, |(first, _)| first);
        times = Some((first, t));
        let half = along * long + across * broad;
        let near = on.s - half;
        end = end.max(on.s + half);
        if near < begin {
            (begin, course) = (near, way);
        }
    }
    let (first, last) = times?;
    let gap = begin - on_route.front_s;
    // Whose front is beyond the middle of where they meet does better to go on.
    if gap > SIGHT || on_route.front_s > 0.5 * (begin + end) {
        return None;
    }
    // To the ego it stands where it will cross, unless it goes the ego's way.
    let closing_speed = on_route.state.speed - velocity.dot(&course).max(0.0);
    // Only where the ego has to give way: elsewhere oncoming vehicles would seem to cross in each bend.
    let near = |link: &&RouteLink| begin > link.stop_s - 3.0 && begin < link.end_s + 3.0;
    let mut links = facts.route.links.iter().filter(near).map(|link| facts.network.link(link.link));
    let has_to_yield = links.any(|link| match kind {
        Kind::Vehicle | Kind::TwoWheeler => !link.must_yield_to.is_empty(),
        Kind::Person => {
            let place = facts.route.at(begin).pose.xy();
            link.yields_to_crossings.iter().any(|&crossing| {
                let middle = &facts.network.lane(facts.network.crossing(crossing).lane).shape;
                middle.project(place).distance < CROSSING
            })
        }
    });
    if !has_to_yield {
        return None;
    }
    // The ego there: as early as it can, and at its present pace.
    let v = on_route.state.speed.max(0.0);
    let gap = gap.max(0.0);
    let earliest = ((v * v + 2.0 * EGO_ACCELERATION * gap).sqrt() - v) / EGO_ACCELERATION;
    let latest = gap / v.max(0.5) + 1.0;
    let meet = earliest < last + MARGIN && latest > first - MARGIN;
    meet.then_some(LeadState { gap, closing_speed })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::GroundPlane;
    use crate::perception::testing::{LENGTH, Road, seen, user};
    use nalgebra::Point3;
    use sumo_network::geometry::{Polyline, Pose};
    use sumo_network::network::{CrossingId, testing};
    use wad_camera::CameraConfig;
    use wad_camera::model::ObjectClass;

    /// The prediction of each tick for an ego that drives at `speed` from `s` on, and a vehicle that moves
    /// from `place` on with `velocity` (world; m, m/s).
    fn foretold(
        road: &Road,
        (s, speed): (f64, f64),
        class: ObjectClass,
        (place, velocity): ([f64; 2], [f64; 2]),
    ) -> Vec<Option<LeadState>> {
        let camera = CameraConfig::default();
        let ground = GroundPlane::new(&camera);
        let mut users = RoadUsers::default();
        let tick = |tick: u32| {
            let t = f64::from(tick) * TICK;
            let facts = road.facts(s + speed * t, 0.0, 0.0, speed);
            let place = Point::new(place[0] + velocity[0] * t, place[1] + velocity[1] * t);
            let at = facts.on_route.state.pose.to_local(place);
            let detection = seen(class, at.x as f32, at.y as f32, 1.8, 1.6);
            users.update(&[detection], &ground, &facts.on_route.state.pose, facts.tick);
            nearest(&users, &facts)
        };
        (0..12).map(tick).collect()
    }

    const TICK: f64 = 0.167;

    /// The first tick with a crossing vehicle, and its lead state.
    fn first(told: &[Option<LeadState>]) -> (f64, LeadState) {
        let at = told.iter().position(Option::is_some).unwrap();
        (at as f64, told[at].unwrap())
    }

    #[test]
    fn who_turns_left_is_told_of_those_who_come_the_other_way() {
        let road = Road::turning_left();
        assert!(!road.network.link(road.route.links[0].link).must_yield_to.is_empty());
        let ego = (road.route.links[0].stop_s - 20.0, 6.0);
        let told = foretold(&road, ego, ObjectClass::Car, ([326.0, 1.6], [-10.0, 0.0]));
        assert!(told[..BELIEVED as usize - 1].iter().all(Option::is_none), "too few looks to be believed");
        let (tick, lead) = first(&told);
        // Its path meets the ego's 4.5 m beyond the line; its breadth begins before that.
        let line = 20.0 - 6.0 * tick * TICK - 0.5 * LENGTH;
        assert!((line - 1.0..line + 4.5).contains(&lead.gap), "{lead:?}, the line at {line}");
        assert!((lead.closing_speed - 6.0).abs() < 0.1, "to the ego it stands there: {lead:?}");
    }

    #[test]
    fn who_comes_on_a_lane_that_goes_first_is_told_from_two_looks_on_unless_it_stands() {
        let mut road = Road::turning_left();
        // The far road's lane comes the other way, up to the junction.
        let foe = road.network.lane_by_id("ca_0").unwrap();
        road.network.lanes[foe.index()].shape =
            Polyline::new([600.0, 305.0].map(|x| Point3::new(x, 1.6, 0.0)));
        let link = road.route.links[0].link;
        road.network.links[link.index()].must_yield_to = road.network.lane(foe).outgoing.clone();
        let ego = (road.route.links[0].stop_s - 20.0, 6.0);
        let told = |x: f64, speed: f64| foretold(&road, ego, ObjectClass::Car, ([x, 1.6], [-speed, 0.0]));
        assert_eq!(first(&told(326.0, 9.0)).0, 1.0);
        let beside = foretold(&road, ego, ObjectClass::Car, ([326.0, 8.0], [-9.0, 0.0]));
        assert!(beside[..3].iter().all(Option::is_none), "beside the lane: {beside:?}");
        assert!(told(318.0, 0.0)[8..].iter().all(Option::is_none), "it stands");
    }

    #[test]
    fn who_has_rolled_into_the_way_stands_until_the_other_has_passed() {
        let road = Road::turning_left();
        let comes = |beyond: f64| {
            let ego = (road.route.links[0].stop_s + beyond - 0.5 * LENGTH, 0.5);
            let told = foretold(&road, ego, ObjectClass::Car, ([335.0, 1.6], [-10.0, 0.0]));
            told[10..].iter().all(|lead| lead.is_some_and(|lead| lead.gap == 0.0))
        };
        assert!(comes(3.5) && comes(5.0), "its front is in the way");
        assert!(!comes(9.0), "its front is beyond: it does better to go on");
    }

    #[test]
    fn who_walks_over_a_crossing_counts_where_the_ego_has_to_yield() {
        let text = testing::text("").replace(
            "</net>",
            r#"<edge id=":B_c0" function="crossing" crossingEdges="bc">
               <lane id=":B_c0_0" index="0" allow="pedestrian" speed="1" length="14" width="4" shape="306,4 306,-10"/></edge></net>"#,
        );
        let mut road = Road::of(testing::parsed(&text).unwrap(), "ab_0", "bc_0", "GGG");
        let ego = (road.route.links[0].stop_s - 16.0, 6.0);
        let walks = |road: &Road| foretold(road, ego, ObjectClass::Person, ([306.0, 1.0], [0.0, -1.3]));
        assert!(walks(&road).iter().all(Option::is_none), "where cars go first, who walks waits");
        let link = road.route.links[0].link;
        road.network.links[link.index()].yields_to_crossings.push(CrossingId(0));
        let (tick, lead) = first(&walks(&road));
        let gap = 16.0 + 16.0 - 6.0 * tick * TICK - 0.5 * LENGTH;
        assert!((lead.gap - gap).abs() < 1.5 && tick < 8.0, "{tick}: {lead:?}, {gap}");
        assert!((lead.closing_speed - 6.0).abs() < 0.3, "to the ego it stands there: {lead:?}");
        assert_eq!(tick, 1.0, "on a crossing two looks are enough");
        let away = foretold(&road, ego, ObjectClass::Person, ([306.0, -8.0], [0.0, -1.3]));
        assert!(away[5..].iter().all(Option::is_none), "it has crossed: {away:?}");
        let stands = foretold(&road, ego, ObjectClass::Person, ([306.0, 1.0], [0.0, 0.0]));
        assert!(stands[10..].iter().all(Option::is_none), "it waits: {stands:?}");
        let at_kerb = |speed| foretold(&road, ego, ObjectClass::Person, ([306.0, -11.2], [0.0, speed]));
        assert!(at_kerb(1.3).iter().any(Option::is_some), "it steps onto it");
        assert!(
            at_kerb(0.0).iter().chain(&at_kerb(-1.3)).all(Option::is_none),
            "it stands at the kerb, or walks off"
        );
    }

    #[test]
    fn who_stands_is_past_or_gives_way_is_not_in_the_way() {
        let nobody = |road: &Road, before: f64, speed: f64, place: [f64; 2], velocity: [f64; 2]| {
            let ego = (road.route.links[0].stop_s - before, speed);
            foretold(road, ego, ObjectClass::Car, (place, velocity)).iter().all(Option::is_none)
        };
        let left = Road::turning_left();
        assert!(nobody(&left, 20.0, 6.0, [318.0, 1.6], [0.0, 0.0]), "it stands");
        assert!(nobody(&left, 35.0, 3.0, [305.0, 1.6], [-14.0, 0.0]), "it has passed before the ego comes");
        assert!(nobody(&Road::new("GGG"), 25.0, 6.0, [302.0, 14.0], [0.0, -3.0]), "the ego goes first");
    }

    #[test]
    fn who_crosses_between_two_junctions_counts_by_either_of_them() {
        let mut road = Road::new("GGG");
        let (own, line) = (road.route.links[0].link, road.route.links[0].stop_s);
        let other = road.network.lane(road.network.lane_by_id("ab_1").unwrap()).outgoing[0];
        road.network.links[own.index()].must_yield_to.push(other);
        let comes = |road: &Road| {
            let at = road.route.at(line - 1.0).pose.position;
            let pose = Pose::new(at.x, at.y + 13.6, 0.0, -std::f64::consts::FRAC_PI_2);
            truth(&user(pose, 8.0, ActorKind::Car), &road.facts(line - 20.0, 0.0, 0.0, 6.0)).is_some()
        };
        assert!(comes(&road));
        // Where the ego goes first, up to 4 m before the one where it gives way.
        road.route.links.insert(0, RouteLink { link: other, stop_s: line - 16.0, end_s: line - 4.0 });
        assert!(comes(&road));
        road.route.links[1].stop_s += 10.0;
        assert!(!comes(&road), "it is no junction's where the ego gives way");
    }

    #[test]
    fn who_knows_all_needs_no_looks() {
        let road = Road::turning_left();
        let facts = road.facts(road.route.links[0].stop_s - 20.0, 0.0, 0.0, 6.0);
        let there = |kind: ActorKind, speed: f64| {
            truth(&user(Pose::new(326.0, 1.6, 0.0, std::f64::consts::PI), speed, kind), &facts)
        };
        let line = 20.0 - 0.5 * LENGTH;
        assert!(there(ActorKind::Car, 10.0).is_some_and(|lead| (line..line + 4.5).contains(&lead.gap)));
        assert_eq!((there(ActorKind::Car, 0.0), there(ActorKind::Object, 10.0)), (None, None));
    }
}
