//! What is round the ego as numbers of fixed places, from the world itself and without a camera (spec.md
//! "Vector observation"). It knows what no camera shows: who is hidden, and every speed.

use crate::observation::{LeadState, RawState, SPEED, SURROUNDINGS_SIZE, nearness};
use crate::perception::lead::{HALF_WAY, SIGHT};
use crate::perception::{EgoFacts, LightAhead, StopLight};
use sumo_network::geometry::{Point, Pose, wrap_angle};
use sumo_network::network::{Route, RouteLink};
use sumo_network::world::{Actor, ActorKind, SignalState, VehicleSignals, WorldState};

/// Points of the route ahead, and the way from each to the next (m).
pub const POINTS: usize = 10;
/// Way from one point to the next (m).
pub const POINT_STEP: f64 = 5.0;
/// Road users, the nearest first.
pub const USERS: usize = 12;
/// Numbers of each road user.
pub const USER_SIZE: usize = 12;
/// Index of the first road user's first number.
pub const FIRST_USER: usize = 2 * POINTS + 8;
const _: () = assert!(FIRST_USER + USERS * USER_SIZE == SURROUNDINGS_SIZE);

/// Road users farther than this from the ego's centre are left out (m).
pub const REACH: f64 = 50.0;
/// Way ahead of the second speed limit (m).
const LIMIT_AHEAD: f64 = 30.0;
/// Lengths and widths (m) that become 1.
const LENGTH: f64 = 10.0;
const WIDTH: f64 = 3.0;

/// A road user, as the last tick's world has it.
#[derive(Clone, Copy, Debug)]
struct User {
    pose: Pose,
    speed: f64,
    length: f64,
    width: f64,
    kind: ActorKind,
    brakes: bool,
}

impl User {
    fn of(actor: &Actor) -> Self {
        Self {
            pose: actor.pose,
            speed: actor.speed,
            length: actor.actor_type.length,
            width: actor.actor_type.width,
            kind: actor.actor_type.kind,
            brakes: actor.signals.has(VehicleSignals::BRAKE_LIGHT),
        }
    }

    /// As the vehicle in front of an ego on `route`, if it is in the ego's path.
    fn in_path(&self, route: &Route, facts: &EgoFacts<'_>) -> Option<LeadState> {
        let (s, front) = (facts.on_route.s, facts.on_route.front_s);
        let (long, broad) = (0.5 * self.length, 0.5 * self.width);
        let project = |[x, y]: [f64; 2]| {
            route.project_near(self.pose.to_world(Point::new(x, y).coords), s, 0.0, SIGHT + LENGTH)
        };
        let middle = project([0.0, 0.0]);
        if middle.distance > HALF_WAY + long.hypot(broad) {
            return None;
        }
        let corners = [[long, broad], [long, -broad], [-long, broad], [-long, -broad]].map(project);
        let places = [corners[0], corners[1], corners[2], corners[3], middle];
        // Beyond the ends of the searched stretch a point is off the route.
        let on = || places.iter().filter(|place| (place.distance - place.d.abs()).abs() < 0.1);
        let inside = on().any(|place| place.d.abs() < HALF_WAY);
        let crosses = on().any(|place| place.d > 0.0) && on().any(|place| place.d < 0.0);
        if !inside && !crosses {
            return None;
        }
        let near = on().map(|place| place.s).fold(f64::INFINITY, f64::min);
        let gap = (near - front).max(0.0);
        let turned = wrap_angle(self.pose.heading - route.at(near).pose.heading);
        let closing_speed = facts.on_route.state.speed - self.speed * turned.cos();
        // Whose middle is behind the ego's is not in front of it.
        let ahead = middle.s > s || near > s;
        (ahead && gap <= SIGHT).then_some(LeadState { gap, closing_speed })
    }
}

/// Keeps the surroundings of one ego.
#[derive(Debug, Default)]
pub struct Surroundings {
    users: Vec<User>,
    /// Distances to the ego, with indices in `users`.
    order: Vec<(f64, usize)>,
    stop_light: StopLight,
    light: Option<LightAhead>,
}

impl Surroundings {
    /// Begins an episode.
    pub fn reset(&mut self) {
        self.stop_light.reset();
        self.users.clear();
    }

    /// Takes the road users of `world`.
    pub fn follow(&mut self, world: &WorldState) {
        self.users.clear();
        self.users.extend(world.vehicles.iter().chain(&world.pedestrians).map(User::of));
    }

    /// The next signal on the route at the last look.
    pub fn light(&self) -> Option<LightAhead> {
        self.light
    }

    /// Writes the surroundings into `numbers`, [`SURROUNDINGS_SIZE`] of them; the raw states. All numbers are
    /// within -2 to 2; a part that is not there is 0:
    ///
    /// | index | what | scaling |
    /// |---|---|---|
    /// | 0-19 | points of the route 5, 10, ... 50 m ahead of the ego's centre: ahead, left | / 50 m |
    /// | 20, 21 | speed limit here, and 30 m ahead | / 15 m/s |
    /// | 22-24 | the next signal within 50 m: red, yellow, green | 0, 1 |
    /// | 25 | [`nearness`] of its stop line | |
    /// | 26, 27 | the next junction within 50 m where the ego gives way, unless its signal is red: 1; [`nearness`] of its stop line | |
    /// | 28 + 12 k | road user k of the twelve nearest within 50 m, nearest first: 1 | |
    /// | + 1, 2 | its centre ahead and left of the ego's | / 50 m |
    /// | + 3, 4 | cosine and sine of its heading less the ego's | |
    /// | + 5 | its speed | / 15 m/s |
    /// | + 6, 7 | length; width | / 10 m; / 3 m |
    /// | + 8-10 | motor vehicle; two-wheeler; person (none: barrier or cone) | 0, 1 |
    /// | + 11 | its brake lights are on | 0, 1 |
    pub fn look(&mut self, facts: &EgoFacts<'_>, numbers: &mut Vec<f32>) -> RawState {
        let state = &facts.on_route.state;
        let (route, front) = (facts.route, facts.on_route.front_s);
        let here = state.pose;
        let local = |pose: &Pose| {
            let way = pose.xy() - here.xy();
            let (sin, cos) = here.heading.sin_cos();
            [cos * way.x + sin * way.y, cos * way.y - sin * way.x]
        };
        numbers.clear();
        numbers.resize(SURROUNDINGS_SIZE, 0.0);
        let mut put = |index: usize, value: f64| numbers[index] = value.clamp(-2.0, 2.0) as f32;
        for point in 0..POINTS {
            let at = route.at(facts.on_route.s + POINT_STEP * (point + 1) as f64);
            let [ahead, left] = local(&at.pose);
            put(2 * point, ahead / REACH);
            put(2 * point + 1, left / REACH);
        }
        let rest = 2 * POINTS;
        put(rest, route.at(facts.on_route.s).speed_limit / SPEED);
        put(rest + 1, route.at(facts.on_route.s + LIMIT_AHEAD).speed_limit / SPEED);
        self.light = LightAhead::find(facts);
        if let Some(light) = self.light.filter(|light| light.distance <= SIGHT) {
            let index = match light.state {
                state if state.is_red() => Some(0),
                SignalState::Yellow => Some(1),
                SignalState::GreenMinor | SignalState::GreenMajor => Some(2),
                _ => None,
            };
            if let Some(index) = index {
                put(rest + 2 + index, 1.0);
                put(rest + 5, nearness(light.distance));
            }
        }
        // A red light whose line is farther away is another junction's.
        let red = self.light.filter(|light| light.state.is_red());
        let yields = |(link, distance): &(&RouteLink, f64)| {
            !facts.network.link(link.link).must_yield_to.is_empty()
                && *distance <= SIGHT
                && red.is_none_or(|light| light.distance > *distance)
        };
        let next = route.links.partition_point(|link| link.stop_s < front);
        let next = route.links.get(next).map(|link| (link, link.stop_s - front));
        if let Some((_, distance)) = next.filter(yields) {
            put(rest + 6, 1.0);
            put(rest + 7, nearness(distance));
        }
        self.order.clear();
        let far = |user: &User| (user.pose.xy() - here.xy()).norm();
        self.order.extend(self.users.iter().enumerate().map(|(index, user)| (far(user), index)));
        self.order.retain(|(distance, _)| *distance <= REACH);
        // Equally far ones keep the world's order, which is by id.
        self.order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut lead: Option<LeadState> = None;
        for (rank, &(_, index)) in self.order.iter().enumerate() {
            let user = &self.users[index];
            if let Some(found) = user.in_path(route, facts)
                && lead.is_none_or(|lead| found.gap < lead.gap)
            {
                lead = Some(found);
            }
            if rank >= USERS {
                continue;
            }
            let first = FIRST_USER + USER_SIZE * rank;
            let [ahead, left] = local(&user.pose);
            let (sin, cos) = wrap_angle(user.pose.heading - here.heading).sin_cos();
            let class = match user.kind {
                ActorKind::Car | ActorKind::Van | ActorKind::Truck | ActorKind::Bus => Some(8),
                ActorKind::Motorcycle | ActorKind::Bicycle => Some(9),
                ActorKind::Pedestrian => Some(10),
                ActorKind::Object => None,
            };
            let values =
                [1.0, ahead / REACH, left / REACH, cos, sin, user.speed / SPEED, user.length / LENGTH];
            for (offset, value) in values.into_iter().enumerate() {
                put(first + offset, value);
            }
            put(first + 7, user.width / WIDTH);
            if let Some(class) = class {
                put(first + class, 1.0);
            }
            put(first + 11, f64::from(u8::from(user.brakes)));
        }
        let stop = self.stop_light.update(self.light.as_ref(), false, state.speed).filter(|d| *d <= SIGHT);
        RawState::of(route, &facts.on_route, lead, stop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::testing::{self, LENGTH as EGO_LENGTH, Road};
    use sumo_network::network::testing::net;

    fn user(road: &Road, s: f64, d: f64, speed: f64, kind: ActorKind) -> Actor {
        testing::user(road.facts(s, d, 0.0, 0.0).on_route.state.pose, speed, kind)
    }

    fn look(road: &Road, users: Vec<Actor>, s: f64, turn: f64, speed: f64) -> (Vec<f32>, RawState) {
        let mut surroundings = Surroundings::default();
        let (pedestrians, vehicles) =
            users.into_iter().partition(|user| user.actor_type.kind == ActorKind::Pedestrian);
        surroundings.follow(&WorldState { vehicles, pedestrians, ..WorldState::default() });
        let mut numbers = Vec::new();
        let raw = surroundings.look(&road.facts(s, 0.0, turn, speed), &mut numbers);
        (numbers, raw)
    }

    #[test]
    fn each_number_has_its_place() {
        let road = Road::new("rGG");
        let s = road.route.links[0].stop_s - 20.0 - 0.5 * EGO_LENGTH;
        let users = vec![
            user(&road, s + 15.0, 0.0, 5.0, ActorKind::Car),
            user(&road, s + 8.0, 4.0, 1.5, ActorKind::Pedestrian),
            user(&road, s - 60.0, 0.0, 5.0, ActorKind::Car),
        ];
        let (numbers, raw) = look(&road, users, s, 0.0, 8.0);
        assert_eq!(numbers.len(), SURROUNDINGS_SIZE);
        // The route goes straight on.
        assert!((numbers[0] - 0.1).abs() < 1e-6 && numbers[1].abs() < 1e-6, "{numbers:?}");
        assert!((numbers[18] - 1.0).abs() < 0.01, "{numbers:?}");
        assert!((numbers[20] - 10.0 / 15.0).abs() < 1e-6);
        assert_eq!(&numbers[22..25], [1.0, 0.0, 0.0]);
        assert!((f64::from(numbers[25]) - nearness(20.0)).abs() < 1e-6);
        // The person is nearer than the car.
        let person = &numbers[FIRST_USER..FIRST_USER + USER_SIZE];
        assert!((person[1] - 8.0 / 50.0).abs() < 1e-6 && (person[2] - 4.0 / 50.0).abs() < 1e-6, "{person:?}");
        assert_eq!((person[0], person[8], person[9], person[10]), (1.0, 0.0, 0.0, 1.0));
        let car = &numbers[FIRST_USER + USER_SIZE..FIRST_USER + 2 * USER_SIZE];
        let expected = [1.0, 0.3, 0.0, 1.0, 0.0, 5.0 / 15.0, 0.5, 0.6, 1.0, 0.0, 0.0, 1.0];
        assert!(car.iter().zip(expected).all(|(a, b): (&f32, f32)| (a - b).abs() < 1e-6), "{car:?}");
        // The third is out of reach.
        assert!(numbers[FIRST_USER + 2 * USER_SIZE..].iter().all(|x| *x == 0.0));
        let lead = raw.lead.unwrap();
        assert!((lead.gap - (15.0 - 2.5 - 0.5 * EGO_LENGTH)).abs() < 1e-6, "{lead:?}");
        assert!((lead.closing_speed - 3.0).abs() < 1e-6, "{lead:?}");
        assert!((raw.stop_light.unwrap() - 20.0).abs() < 1e-6);
    }

    #[test]
    fn the_ego_gives_way_unless_this_junctions_signal_is_red() {
        let told = |road: &Road| {
            let (numbers, _) = look(road, vec![], road.route.links[0].stop_s - 20.0, 0.0, 8.0);
            let is_near = (f64::from(numbers[27]) - nearness(20.0 - 0.5 * EGO_LENGTH)).abs() < 1e-6;
            (numbers[26], is_near)
        };
        let left = |state: &str| Road::of(net(), "ab_1", "bl_0", state);
        assert_eq!([told(&left("GGG")), told(&left("GGr"))], [(1.0, true), (0.0, false)]);
        // A junction without a signal, and behind it one with a red light.
        let mut road = left("rGG");
        let first = road.route.links[0];
        road.network.links[first.link.index()].signal = None;
        let (link, line) = (Road::new("rGG").route.links[0].link, first.end_s + 20.0);
        road.route.links.push(RouteLink { link, stop_s: line, end_s: line + 10.0 });
        assert_eq!(told(&road), (1.0, true));
    }

    #[test]
    fn places_are_in_the_egos_frame() {
        let road = Road::new("GGG");
        let turn = 0.5;
        let (numbers, _) = look(&road, vec![user(&road, 70.0, 0.0, 5.0, ActorKind::Bus)], 60.0, turn, 8.0);
        let bus = &numbers[FIRST_USER..FIRST_USER + USER_SIZE];
        // Turned to the left, what is ahead on the road is to the right.
        let expected = [0.2 * turn.cos(), -0.2 * turn.sin(), turn.cos(), -turn.sin()];
        assert!(bus[1..5].iter().zip(expected).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-6), "{bus:?}");
    }

    #[test]
    fn who_is_beside_the_path_or_behind_is_not_in_front() {
        let road = Road::new("GGG");
        let lead =
            |s: f64, d: f64| look(&road, vec![user(&road, s, d, 5.0, ActorKind::Car)], 60.0, 0.0, 8.0).1.lead;
        assert!(lead(75.0, 0.0).is_some() && lead(75.0, 2.0).is_some());
        assert!(lead(75.0, 2.3).is_none() && lead(75.0, -2.3).is_none());
        assert!(lead(50.0, 0.0).is_none() && lead(125.0, 0.0).is_none());
    }

    #[test]
    fn a_second_look_is_like_the_first() {
        let road = Road::new("rGG");
        let users = || vec![user(&road, 75.0, 0.0, 5.0, ActorKind::Motorcycle)];
        let mut surroundings = Surroundings::default();
        let mut episode = || {
            surroundings.reset();
            surroundings.follow(&WorldState { vehicles: users(), ..WorldState::default() });
            let mut numbers = vec![9.0; 3];
            let raw = surroundings.look(&road.facts(60.0, 0.0, 0.0, 8.0), &mut numbers);
            (numbers, raw)
        };
        let first = episode();
        assert_eq!(first, episode());
        assert!(first.0.iter().all(|x| (-2.0..=2.0).contains(x)));
    }
}
