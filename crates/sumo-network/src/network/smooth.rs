//! Smoothing a finely sampled line, and relaxing its tight bends to curvatures that a car can steer.

use nalgebra::{Point3, Vector3};

/// Where the line is tighter than this (1/m), about what a car can steer, it is relaxed.
const CURVATURE: f64 = 0.22;
/// How far relaxing may take the line from where it was (m), the curvature (1/m) that is aimed at, and
/// the one that is good enough not to go further.
const LEEWAYS: [(f64, f64, f64); 4] =
    [(0.25, CURVATURE, 0.3), (0.5, 0.28, 0.34), (0.8, 0.3, 0.42), (1.6, 0.3, 0.3)];
/// Rounds of relaxing with each leeway, and how far round a tight spot it reaches (m).
const ROUNDS: usize = 40;
const REACH: f64 = 9.0;
/// Box width of the kernel that bending is measured with (m).
const BEND: f64 = 2.0;

/// The kernel's weights for offsets 0, 1, 2, ... fine samples.
pub(super) fn kernel(width: f64, fine: f64) -> Vec<f64> {
    let reach = (2.0 * width / fine) as usize;
    let weight = |i: usize| {
        let t = i as f64 * fine / width;
        if t < 1.0 { 2.0 / 3.0 - t * t + 0.5 * t * t * t } else { (2.0 - t).powi(3) / 6.0 }
    };
    let sum = weight(0) + 2.0 * (1..reach).map(weight).sum::<f64>();
    (0..reach).map(|i| weight(i) / sum).collect()
}

/// The kernel applied at sample `i`; near the ends it shrinks with what is there.
pub(super) fn filtered(points: &[Point3<f64>], i: usize, kernel: &[f64]) -> Point3<f64> {
    let reach = (kernel.len() - 1).min(i).min(points.len() - 1 - i);
    let mut sum = points[i].coords * kernel[0];
    let mut total = kernel[0];
    for (k, w) in kernel.iter().enumerate().take(reach + 1).skip(1) {
        sum += (points[i - k].coords + points[i + k].coords) * *w;
        total += 2.0 * w;
    }
    (sum / total).into()
}

/// Curvature (1/m) at sample `i`, over a metre.
pub(super) fn curvature(points: &[Point3<f64>], i: usize) -> f64 {
    if i < 2 || i + 2 >= points.len() {
        return 0.0;
    }
    let (a, b) = (points[i].xy() - points[i - 2].xy(), points[i + 2].xy() - points[i].xy());
    let span = 0.5 * (a.norm() + b.norm());
    if span < 1e-6 { 0.0 } else { a.perp(&b).atan2(a.dot(&b)) / span }
}

/// Straightens round each tight spot, as little as will do.
///
/// Each round takes away a part of the bending (the second difference of the second difference), which
/// makes the line swing out before and behind a bend rather than only cut it.
pub(super) fn relax(points: &mut [Point3<f64>], raw: &[Point3<f64>], fine: f64) {
    let kernel = kernel(BEND, fine);
    let reach = (REACH / fine) as usize;
    let mut i = 0;
    while i < points.len() {
        if curvature(points, i).abs() <= CURVATURE {
            i += 1;
            continue;
        }
        // The spot goes on as long as the next tight sample is near.
        let (first, mut last) = (i, i);
        while i < points.len() && i <= last + reach {
            if curvature(points, i).abs() > CURVATURE {
                last = i;
            }
            i += 1;
        }
        let from = first.saturating_sub(reach);
        let to = (last + reach + 1).min(points.len());
        spot(&mut points[from..to], &raw[from..to], (first - from, last - from), &kernel);
    }
}

/// Relaxes one tight spot, which is at `core` of these samples. The first and the last sample stay.
fn spot(points: &mut [Point3<f64>], raw: &[Point3<f64>], core: (usize, usize), kernel: &[f64]) {
    let tightest =
        |points: &[Point3<f64>]| (0..points.len()).map(|i| curvature(points, i).abs()).fold(0.0, f64::max);
    let weights: Vec<f64> = (0..points.len())
        .map(|i| {
            let before = i as f64 / core.0.max(1) as f64;
            let behind = (points.len() - 1 - i) as f64 / (points.len() - 1 - core.1).max(1) as f64;
            before.min(behind).min(1.0)
        })
        .collect();
    // Hairpins get tighter by smoothing: the best line found is kept.
    let mut best = (tightest(points), points.to_vec());
    for (leeway, aim, enough) in LEEWAYS {
        for _ in 0..ROUNDS {
            if tightest(points) <= aim {
                break;
            }
            let bend = |of: &[Point3<f64>]| -> Vec<Point3<f64>> {
                (0..of.len()).map(|i| Point3::from(filtered(of, i, kernel) - of[i])).collect()
            };
            let bending = bend(&bend(points));
            for (i, point) in points.iter_mut().enumerate() {
                let moved = *point - bending[i].coords * weights[i];
                let away = moved.xy() - raw[i].xy();
                let excess = (away.norm() / leeway).max(1.0);
                *point = raw[i] + Vector3::new(away.x / excess, away.y / excess, moved.z - raw[i].z);
            }
        }
        let tightness = tightest(points);
        if tightness < best.0 {
            best = (tightness, points.to_vec());
        }
        if tightness <= enough {
            break;
        }
    }
    points.copy_from_slice(&best.1);
}
