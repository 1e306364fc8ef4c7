//! Poses, headings and polylines, and the only place where SUMO's angles exist.
//!
//! World frame: SUMO's, x east, y north, z up, metres. Headings are radians,
//! counter-clockwise from east. SUMO's own convention, degrees clockwise from
//! north with the position at the front bumper, is converted here and nowhere else.

use nalgebra::{Point2, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Room for rounding where a place is left out of a search because it is farther than the best one (m).
const SURELY_FARTHER: f64 = 1e-6;

/// A point in the world's horizontal plane (m).
pub type Point = Point2<f64>;
/// A direction or displacement in the world's horizontal plane (m).
pub type Vector = Vector2<f64>;

/// The angle brought into (-pi, pi].
pub fn wrap_angle(angle: f64) -> f64 {
    let wrapped = angle.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

/// Heading (rad, counter-clockwise from east) of a SUMO angle (degrees clockwise from north).
pub fn heading_from_sumo(degrees: f64) -> f64 {
    wrap_angle((90.0 - degrees).to_radians())
}

/// SUMO angle (degrees clockwise from north, 0..360) of a heading (rad, counter-clockwise from east).
pub fn heading_to_sumo(heading: f64) -> f64 {
    (90.0 - heading.to_degrees()).rem_euclid(360.0)
}

/// Unit vector of a heading (rad).
pub fn direction(heading: f64) -> Vector {
    Vector::new(heading.cos(), heading.sin())
}

/// Whether a closed polygon (last point joined to the first) holds `point`.
pub fn polygon_contains(outline: &[Point], point: Point) -> bool {
    let mut inside = false;
    for (i, a) in outline.iter().enumerate() {
        let b = &outline[(i + 1) % outline.len()];
        if (a.y > point.y) != (b.y > point.y) {
            let x = a.x + (point.y - a.y) / (b.y - a.y) * (b.x - a.x);
            inside ^= point.x < x;
        }
    }
    inside
}

/// Position and heading of a body in the world frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Reference point (m): for every vehicle in this crate the centre of its footprint on the ground.
    pub position: Point3<f64>,
    /// Heading (rad, counter-clockwise from east).
    pub heading: f64,
}

impl Pose {
    /// A pose from its coordinates (m, m, m, rad).
    pub fn new(x: f64, y: f64, z: f64, heading: f64) -> Self {
        Self { position: Point3::new(x, y, z), heading: wrap_angle(heading) }
    }

    /// The position without its height (m).
    pub fn xy(&self) -> Point {
        self.position.xy()
    }

    /// The pose moved along its own heading by `forward` (m; negative is backwards).
    pub fn advanced(&self, forward: f64) -> Self {
        let d = direction(self.heading) * forward;
        Self { position: self.position + Vector3::new(d.x, d.y, 0.0), heading: self.heading }
    }

    /// Centre pose of a vehicle of `length` (m) from what SUMO says: the front bumper's
    /// centre and degrees clockwise from north.
    pub fn from_sumo(front: Point3<f64>, degrees: f64, length: f64) -> Self {
        Self { position: front, heading: heading_from_sumo(degrees) }.advanced(-0.5 * length)
    }

    /// SUMO's position and angle of a vehicle of `length` (m) whose centre is here: the front
    /// bumper's centre and degrees clockwise from north.
    pub fn to_sumo(&self, length: f64) -> (Point3<f64>, f64) {
        (self.advanced(0.5 * length).position, heading_to_sumo(self.heading))
    }

    /// `point` in this pose's own frame: x forward, y left (m).
    pub fn to_local(&self, point: Point) -> Vector {
        let r = point - self.xy();
        let d = direction(self.heading);
        Vector::new(r.dot(&d), d.perp(&r))
    }

    /// The world point of local coordinates (x forward, y left, m).
    pub fn to_world(&self, local: Vector) -> Point {
        let d = direction(self.heading);
        self.xy() + d * local.x + Vector::new(-d.y, d.x) * local.y
    }
}

/// Where a point falls on a polyline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection {
    /// Distance along the polyline (m).
    pub s: f64,
    /// Signed lateral offset (m, left positive).
    pub d: f64,
    /// Distance from the point to the polyline (m). More than `|d|` beyond the polyline's ends.
    pub distance: f64,
}

/// A line of straight segments in space with its arc length measured in the horizontal plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Polyline {
    points: Vec<Point3<f64>>,
    /// Arc length at each point (m), starting with 0.
    lengths: Vec<f64>,
}

impl Polyline {
    /// A polyline through `points` (m); neighbours closer than 1 mm are merged.
    /// Fewer than two distinct points give a line of length 0.
    pub fn new(points: impl IntoIterator<Item = Point3<f64>>) -> Self {
        let mut kept: Vec<Point3<f64>> = Vec::new();
        let mut lengths: Vec<f64> = Vec::new();
        for point in points {
            match (kept.last(), lengths.last()) {
                (Some(last), Some(length)) => {
                    let step = (point.xy() - last.xy()).norm();
                    if step > 1e-3 {
                        lengths.push(length + step);
                        kept.push(point);
                    }
                }
                _ => {
                    kept.push(point);
                    lengths.push(0.0);
                }
            }
        }
        Self { points: kept, lengths }
    }

    /// The points (m).
    pub fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// Arc length at each point (m).
    pub fn arc_lengths(&self) -> &[f64] {
        &self.lengths
    }

    /// Total length (m).
    pub fn length(&self) -> f64 {
        self.lengths.last().copied().unwrap_or(0.0)
    }

    /// True when the line has no segment to walk on.
    pub fn is_degenerate(&self) -> bool {
        self.points.len() < 2
    }

    /// Index of the segment that holds arc length `s` (m), clamped to the line.
    pub fn segment_at(&self, s: f64) -> usize {
        let after = self.lengths.partition_point(|&l| l <= s);
        after.saturating_sub(1).min(self.points.len().saturating_sub(2))
    }

    /// Heading (rad) of segment `index`; 0 on a degenerate line.
    pub fn segment_heading(&self, index: usize) -> f64 {
        match (self.points.get(index), self.points.get(index + 1)) {
            (Some(a), Some(b)) => (b.y - a.y).atan2(b.x - a.x),
            _ => 0.0,
        }
    }

    /// The pose at arc length `s` (m), clamped to the line's ends.
    pub fn at(&self, s: f64) -> Pose {
        let Some(first) = self.points.first() else {
            return Pose::new(0.0, 0.0, 0.0, 0.0);
        };
        if self.is_degenerate() {
            return Pose { position: *first, heading: 0.0 };
        }
        let i = self.segment_at(s);
        let (a, b) = (self.points[i], self.points[i + 1]);
        let span = self.lengths[i + 1] - self.lengths[i];
        let t = ((s - self.lengths[i]) / span).clamp(0.0, 1.0);
        Pose { position: a + (b - a) * t, heading: self.segment_heading(i) }
    }

    /// The nearest point of the line to `point`.
    pub fn project(&self, point: Point) -> Projection {
        self.project_within(point, 0.0, self.length())
    }

    /// The nearest point of the part between arc lengths `from` and `to` (m) to `point`.
    pub fn project_within(&self, point: Point, from: f64, to: f64) -> Projection {
        let mut best = Projection { s: 0.0, d: 0.0, distance: f64::INFINITY };
        if self.is_degenerate() {
            if let Some(p) = self.points.first() {
                best.distance = (point - p.xy()).norm();
            }
            return best;
        }
        let (first, last) = (self.segment_at(from), self.segment_at(to));
        let mut i = first;
        while i <= last {
            let a = self.points[i].xy();
            // No place of the line is nearer than `a` by more than the way to it.
            let spare = (point - a).norm() - best.distance - SURELY_FARTHER;
            if spare > self.lengths[i + 1] - self.lengths[i] {
                let searched = self.lengths[i] + spare;
                while i <= last && self.lengths[i + 1] <= searched {
                    i += 1;
                }
                continue;
            }
            let ab = self.points[i + 1].xy() - a;
            let span = self.lengths[i + 1] - self.lengths[i];
            let lo = if i == first { ((from - self.lengths[i]) / span).clamp(0.0, 1.0) } else { 0.0 };
            let hi = if i == last { ((to - self.lengths[i]) / span).clamp(lo, 1.0) } else { 1.0 };
            let t = ((point - a).dot(&ab) / ab.norm_squared()).clamp(lo, hi);
            let r = point - (a + ab * t);
            let distance = r.norm();
            if distance < best.distance {
                let side = ab.perp(&(point - a));
                best = Projection { s: self.lengths[i] + t * span, d: distance.copysign(side), distance };
            }
            i += 1;
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sumo_angles_round_trip() {
        assert_eq!(heading_from_sumo(90.0), 0.0);
        assert!((heading_from_sumo(0.0) - PI / 2.0).abs() < 1e-12);
        for degrees in [0.0, 12.5, 90.0, 180.0, 270.0, 359.0] {
            assert!((heading_to_sumo(heading_from_sumo(degrees)) - degrees).abs() < 1e-9);
        }
    }

    #[test]
    fn sumo_position_is_the_front_bumper() {
        let centre = Pose::new(10.0, 20.0, 0.0, PI / 2.0);
        let (front, degrees) = centre.to_sumo(4.0);
        assert!((front - Point3::new(10.0, 22.0, 0.0)).norm() < 1e-12);
        assert!(degrees.abs() < 1e-12);
        let back = Pose::from_sumo(front, degrees, 4.0);
        assert!((back.position - centre.position).norm() < 1e-12);
    }

    #[test]
    fn left_is_positive() {
        let line = Polyline::new([Point3::new(0.0, 0.0, 0.0), Point3::new(10.0, 0.0, 0.0)]);
        let p = line.project(Point::new(4.0, 2.0));
        assert_eq!((p.s, p.d), (4.0, 2.0));
        assert_eq!(
            Pose::new(0.0, 0.0, 0.0, PI / 2.0).to_local(Point::new(-1.0, 3.0)).map(|v| v.round()),
            Vector::new(3.0, 1.0)
        );
    }

    #[test]
    fn a_point_beyond_the_end_keeps_its_distance() {
        let line = Polyline::new([Point3::new(0.0, 0.0, 0.0), Point3::new(10.0, 0.0, 0.0)]);
        let p = line.project(Point::new(13.0, 4.0));
        assert_eq!((p.s, p.distance), (10.0, 5.0));
    }

    /// The search leaves out what is surely farther; it finds what a look at every segment finds.
    #[test]
    fn a_search_that_skips_finds_the_same_place() {
        let wave = |i: i32| {
            let t = f64::from(i);
            Point3::new(12.0 * (t / 9.0).sin() + 0.4 * t, 30.0 * (t / 17.0).cos(), 0.01 * t)
        };
        let line = Polyline::new((0..200).map(wave));
        for i in 0..2000 {
            let t = f64::from(i);
            let point = Point::new(40.0 + 90.0 * (t * 0.7).sin(), 70.0 * (t * 0.31).cos());
            let (from, to) = (line.length() * (t * 0.13).sin().abs() * 0.7, line.length());
            let found = line.project_within(point, from, to);
            let pieces = (line.segment_at(from)..=line.segment_at(to)).map(|segment| {
                let [begin, end] = [segment, segment + 1].map(|i| line.arc_lengths()[i]);
                line.project_within(point, begin.max(from), end.min(to).next_down())
            });
            let nearest = pieces.min_by(|a, b| a.distance.total_cmp(&b.distance)).unwrap();
            assert!((found.distance - nearest.distance).abs() < 1e-9, "{i}: {found:?} {nearest:?}");
            let at = line.at(found.s).position.xy();
            assert!(((at - point).norm() - found.distance).abs() < 1e-9);
        }
    }
}
