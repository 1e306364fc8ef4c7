//! The planned path ahead, sampled every metre, and the places of others on it.

use super::params::{AutopilotParams, EgoModel};
use sumo_network::geometry::{Point, Vector, wrap_angle};
use sumo_network::network::Route;

/// Spacing of the samples (m).
pub const STEP: f64 = 1.0;

/// One place on the planned path.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// On the route (m).
    pub s: f64,
    pub point: Point,
    /// Height (m).
    pub z: f64,
    /// Unit tangent.
    pub tangent: Vector,
    /// rad.
    pub heading: f64,
    /// 1/m, left positive.
    pub curvature: f64,
    /// Speed limit (m/s).
    pub limit: f64,
    /// What the ego's body sweeps on either side (m), without margins.
    pub half_width: f64,
}

/// A point in the path's frame.
#[derive(Clone, Copy, Debug)]
pub struct OnPath {
    /// On the route (m); goes on straight beyond the path's ends.
    pub s: f64,
    /// Left positive (m).
    pub d: f64,
    pub index: usize,
}

/// The planned path: the route's centre line moved sideways by the lateral plan.
#[derive(Clone, Debug, Default)]
pub struct Path {
    pub samples: Vec<Sample>,
}

impl Path {
    /// The path round `route_s` (m) from `behind` to `ahead` (m) of it; `offset(s, point)` moves it to the left (m).
    pub fn plan(
        &mut self,
        route: &Route,
        route_s: f64,
        (behind, ahead): (f64, f64),
        ego: &EgoModel,
        params: &AutopilotParams,
        offset: impl Fn(f64, Point) -> f64,
    ) {
        let from = (route_s - behind).max(0.0);
        let to = (route_s + ahead).min(route.length());
        let n = ((to - from) / STEP).floor().max(1.0) as usize;
        let points = (0..=n).map(|i| {
            let s = from + i as f64 * STEP;
            let at = route.at(s);
            let point = at.pose.xy();
            let left = offset(s, point);
            let normal = Vector::new(-at.pose.heading.sin(), at.pose.heading.cos());
            (s, point + normal * left, at.pose.position.z, at.speed_limit * params.speed_factor)
        });
        self.set(points, ego);
    }

    /// A path through points [`STEP`] apart, each with its s (m), place, height (m) and speed limit (m/s).
    pub fn set(&mut self, points: impl Iterator<Item = (f64, Point, f64, f64)>, ego: &EgoModel) {
        self.samples.clear();
        self.samples.extend(points.map(|(s, point, z, limit)| Sample {
            s,
            point,
            z,
            tangent: Vector::x(),
            heading: 0.0,
            curvature: 0.0,
            limit,
            half_width: 0.0,
        }));
        if self.samples.is_empty() {
            return;
        }
        let last = self.samples.len() - 1;
        for i in 0..=last {
            let (a, b) = (self.samples[i.saturating_sub(1)].point, self.samples[(i + 1).min(last)].point);
            let chord = b - a;
            let sample = &mut self.samples[i];
            if chord.norm() > 1e-6 {
                sample.tangent = chord.normalize();
                sample.heading = chord.y.atan2(chord.x);
            }
        }
        for i in 0..=last {
            let (a, b) = (i.saturating_sub(2), (i + 2).min(last));
            let turn = wrap_angle(self.samples[b].heading - self.samples[a].heading);
            let span = self.samples[a].point - self.samples[b].point;
            let curvature = if b > a && span.norm() > 0.5 { turn / ((b - a) as f64 * STEP) } else { 0.0 };
            let sample = &mut self.samples[i];
            sample.curvature = curvature;
            let swing = 0.25 * (0.5 * ego.length).powi(2) * curvature.abs();
            sample.half_width = 0.5 * ego.width + swing.min(0.6);
        }
    }

    /// Index of the sample at `s` (m), clamped.
    pub fn index_at(&self, s: f64) -> usize {
        let first = self.samples.first().map_or(0.0, |p| p.s);
        (((s - first) / STEP).round().max(0.0) as usize).min(self.samples.len().saturating_sub(1))
    }

    /// The sample at `s` (m), clamped.
    pub fn at(&self, s: f64) -> &Sample {
        &self.samples[self.index_at(s)]
    }

    /// Heading at `s` (m), between samples (rad).
    pub fn heading_at(&self, s: f64) -> f64 {
        let Some(first) = self.samples.first() else { return 0.0 };
        let x = ((s - first.s) / STEP).clamp(0.0, (self.samples.len() - 1) as f64);
        let i = (x.floor() as usize).min(self.samples.len().saturating_sub(2));
        let (Some(a), Some(b)) = (self.samples.get(i), self.samples.get(i + 1)) else { return first.heading };
        a.heading + wrap_angle(b.heading - a.heading) * (x - i as f64)
    }

    /// The sample nearest to `point`, if any is within about `radius` (m).
    pub fn nearest(&self, point: Point, radius: f64) -> Option<usize> {
        const STRIDE: usize = 8;
        let reach = radius + 0.5 * STRIDE as f64 * STEP;
        let mut best = (f64::INFINITY, 0);
        let n = self.samples.len();
        let mut i = 0;
        while i < n {
            let d = (self.samples[i].point - point).norm_squared();
            if d < best.0 {
                best = (d, i);
            }
            i += STRIDE;
        }
        if let Some(last) = self.samples.last() {
            let d = (last.point - point).norm_squared();
            if d < best.0 {
                best = (d, n - 1);
            }
        }
        (best.0 <= reach * reach).then(|| self.walk(point, best.1))
    }

    /// The nearest sample found by walking from `hint`.
    fn walk(&self, point: Point, hint: usize) -> usize {
        let distance = |i: usize| (self.samples[i].point - point).norm_squared();
        let mut i = hint;
        let mut d = distance(i);
        while i + 1 < self.samples.len() && distance(i + 1) < d {
            i += 1;
            d = distance(i);
        }
        while i > 0 && distance(i - 1) < d {
            i -= 1;
            d = distance(i);
        }
        i
    }

    /// Where `point` falls, from a sample near it.
    pub fn locate(&self, point: Point, hint: usize) -> OnPath {
        let index = self.walk(point, hint);
        let sample = &self.samples[index];
        let r = point - sample.point;
        OnPath { s: sample.s + r.dot(&sample.tangent), d: sample.tangent.perp(&r), index }
    }

    /// Last place that the path knows (m).
    pub fn end(&self) -> f64 {
        self.samples.last().map_or(0.0, |p| p.s)
    }
}
