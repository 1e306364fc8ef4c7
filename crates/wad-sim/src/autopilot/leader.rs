//! Vehicles in the ego's way: their footprint lies in the swept corridor, or they are about to move
//! into it.

use super::params::{AutopilotParams, EgoModel};
use super::path::Path;
use sumo_network::geometry::{Point, Vector, direction, wrap_angle};
use sumo_network::world::{Actor, WorldState};

/// Height above or below the path beyond which a vehicle is on another road (m).
const LEVEL: f64 = 3.0;

/// Something to stay behind.
#[derive(Clone, Copy, Debug)]
pub struct Obstacle {
    pub key: u64,
    /// Its nearest point on the path (m on the route).
    pub near_s: f64,
    /// Speed along the path (m/s), negative when it comes towards the ego.
    pub speed: f64,
    pub length: f64,
    /// Whether it only is about to come into the way.
    pub predicted: bool,
    /// Whether it crosses the path, or comes towards the ego, rather than goes its way.
    pub crossing: bool,
    /// When it will have left the path at its sideways speed (s); infinite when it stays.
    pub clear_time: f64,
}

/// A vehicle in the path's frame.
#[derive(Clone, Copy, Debug)]
pub struct Located {
    /// Index in [`WorldState::vehicles`].
    pub vehicle: usize,
    /// Its centre (m on the route; m, left positive).
    pub s: f64,
    pub d: f64,
    /// Speed along and across the path (m/s).
    pub along: f64,
    pub across: f64,
    /// Half of what it takes along and across the path (m).
    pub half_along: f64,
    pub half_across: f64,
}

/// Remembers where vehicles were, to know how they move sideways.
#[derive(Clone, Debug, Default)]
pub struct Tracker {
    /// Key and lateral position at the last tick, by key.
    last: Vec<(u64, f64)>,
    next: Vec<(u64, f64)>,
}

impl Tracker {
    fn lateral_before(&self, key: u64) -> Option<f64> {
        self.last.binary_search_by_key(&key, |e| e.0).ok().map(|i| self.last[i].1)
    }
    fn finish(&mut self) {
        self.next.sort_unstable_by_key(|e| e.0);
        std::mem::swap(&mut self.last, &mut self.next);
        self.next.clear();
    }
}

fn corners(actor: &Actor, out: &mut Vec<Point>) {
    out.clear();
    let (l, w) = (actor.actor_type.length, actor.actor_type.width);
    let forward = direction(actor.pose.heading);
    let left = Vector::new(-forward.y, forward.x);
    let centre = actor.pose.xy();
    let n = (l / 2.0).ceil().max(1.0) as usize;
    for i in 0..=n {
        let x = l * (i as f64 / n as f64 - 0.5);
        for y in [-0.5 * w, 0.0, 0.5 * w] {
            out.push(centre + forward * x + left * y);
        }
    }
}

/// All vehicles near the path in its frame, and the vehicles in the way or about to be, nearest first.
pub fn find(
    path: &Path,
    ego_s: f64,
    world: &WorldState,
    tracker: &mut Tracker,
    tick_s: f64,
    ego: &EgoModel,
    params: &AutopilotParams,
) -> (Vec<Located>, Vec<Obstacle>) {
    let mut located = Vec::new();
    let mut obstacles = Vec::new();
    let mut points = Vec::new();
    for (index, actor) in world.vehicles.iter().enumerate() {
        let shape = &actor.actor_type;
        let Some(hint) = path.nearest(actor.pose.xy(), 9.0 + 0.5 * shape.length) else { continue };
        let centre = path.locate(actor.pose.xy(), hint);
        let sample = &path.samples[centre.index];
        if (sample.z - actor.pose.position.z).abs() > LEVEL {
            continue;
        }
        let turn = wrap_angle(actor.pose.heading - sample.heading);
        let (sin, cos) = turn.sin_cos();
        let before = tracker.lateral_before(actor.key);
        tracker.next.push((actor.key, centre.d));
        let across = match before {
            Some(d) if (centre.d - d).abs() < 1.5 => (centre.d - d) / tick_s,
            _ => actor.speed * sin,
        };
        let here = Located {
            vehicle: index,
            s: centre.s,
            d: centre.d,
            along: actor.speed * cos,
            across,
            half_along: 0.5 * (shape.length * cos.abs() + shape.width * sin.abs()),
            half_across: 0.5 * (shape.length * sin.abs() + shape.width * cos.abs()),
        };
        located.push(here);
        if here.s < ego_s || centre.d.abs() > 12.0 + 0.5 * shape.length {
            continue;
        }
        corners(actor, &mut points);
        let mut near = f64::INFINITY;
        for point in &points {
            let p = path.locate(*point, centre.index);
            if p.d.abs() <= path.samples[p.index].half_width + params.side_margin && p.s > path.samples[0].s {
                near = near.min(p.s);
            }
        }
        let crossing = cos < 0.7;
        if near.is_finite() {
            if near > ego_s {
                obstacles.push(Obstacle {
                    key: actor.key,
                    near_s: near,
                    speed: here.along,
                    length: shape.length,
                    predicted: false,
                    crossing,
                    clear_time: clear_time(path, &here, actor, centre.index, 0.2),
                });
            }
        } else if let Some(obstacle) = cut_in(path, &here, actor, ego_s, ego) {
            obstacles.push(obstacle);
        }
    }
    tracker.finish();
    obstacles.sort_by(|a, b| a.near_s.total_cmp(&b.near_s).then(a.key.cmp(&b.key)));
    (located, obstacles)
}

/// Time until a vehicle leaves the swept corridor at its present motion (s); infinite if it does not leave
/// within three seconds.
fn clear_time(path: &Path, v: &Located, actor: &Actor, hint: usize, margin: f64) -> f64 {
    if v.across.abs() < 0.5 && v.along >= -0.5 {
        return f64::INFINITY;
    }
    let velocity = direction(actor.pose.heading) * actor.speed;
    let mut index = hint;
    for k in 1..=12 {
        let t = 0.25 * k as f64;
        let on = path.locate(actor.pose.xy() + velocity * t, index);
        index = on.index;
        let sample = &path.samples[on.index];
        let turn = actor.pose.heading - sample.heading;
        let half =
            0.5 * (actor.actor_type.length * turn.sin().abs() + actor.actor_type.width * turn.cos().abs());
        if on.d.abs() > sample.half_width + margin + half {
            return t;
        }
    }
    f64::INFINITY
}

/// A vehicle beside the path that drifts into it within the next seconds.
fn cut_in(path: &Path, v: &Located, actor: &Actor, ego_s: f64, ego: &EgoModel) -> Option<Obstacle> {
    // Only vehicles in the ego's direction whose front is half a car ahead of the ego's centre.
    let rear = v.s - v.half_along;
    if v.along < 0.5 || rear < ego_s - 0.1 * ego.length || v.across.abs() < 0.2 {
        return None;
    }
    if v.across * v.d >= 0.0 || v.along < v.across.abs() {
        return None;
    }
    for k in 1..=4 {
        let t = 0.4 * k as f64;
        let s = v.s + v.along * t;
        let d = v.d + v.across * t;
        let half = path.at(s).half_width + 0.2;
        if d.abs() - v.half_across < half {
            return Some(Obstacle {
                key: actor.key,
                near_s: rear,
                speed: v.along,
                length: actor.actor_type.length,
                predicted: true,
                crossing: false,
                clear_time: f64::INFINITY,
            });
        }
        if s > path.end() || d * v.d < 0.0 {
            break;
        }
    }
    None
}

/// Room (m) between `from_s` and the place where the vehicles ahead will have closed up behind the first
/// one that stands or crawls; None where none does within `reach` (m).
pub fn room_behind_queue(
    obstacles: &[Obstacle],
    front_s: f64,
    from_s: f64,
    reach: f64,
    min_gap: f64,
) -> Option<f64> {
    let queue_tail =
        obstacles.iter().filter(|o| !o.predicted && !o.crossing && o.near_s > front_s).find(|o| {
            let stop = o.near_s + o.speed.max(0.0).powi(2) / (2.0 * 2.0);
            o.speed < 1.5 && stop < from_s + reach
        })?;
    let between: f64 = obstacles
        .iter()
        .filter(|o| !o.predicted && !o.crossing && o.near_s > front_s && o.near_s < queue_tail.near_s)
        .map(|o| o.length + min_gap)
        .sum();
    Some(queue_tail.near_s - between - from_s)
}
