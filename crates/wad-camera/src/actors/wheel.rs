//! Wheels: tyre, rim with spokes, hub.

use super::palette::VehiclePalette;
use crate::shape::{Shaper, V3};
use std::f32::consts::TAU;

/// A wheel about an axle along y: centre, radius, width (m). Its finely made face looks to `side`
/// (1 left, -1 right).
pub(super) fn wheel(
    s: &mut Shaper,
    m: &VehiclePalette,
    c: V3,
    radius: f32,
    width: f32,
    side: f32,
    sides: usize,
) {
    let ring = |r: f32, y: f32| -> Vec<V3> {
        (0..sides)
            .map(|i| {
                let (sin, cos) = (-side * i as f32 / sides as f32 * TAU).sin_cos();
                [c[0] + r * cos, c[1] + side * y, c[2] + r * sin]
            })
            .collect()
    };
    let h = 0.5 * width;
    if sides < 10 {
        let rings = [ring(radius, -h), ring(radius, h), ring(0.64 * radius, h)];
        s.loft(&rings, |_, _| Some(m.tyre));
        s.cap(&rings[2], m.rim);
        return;
    }
    // Inner edge, tread, shoulder, side wall, bead, then the dish of the rim.
    let profile = [
        ring(0.90 * radius, -h),
        ring(radius, -0.75 * h),
        ring(radius, 0.72 * h),
        ring(0.92 * radius, h),
        ring(0.68 * radius, 0.94 * h),
    ];
    s.loft(&profile, |_, _| Some(m.tyre));
    let dish = [ring(0.68 * radius, 0.94 * h), ring(0.60 * radius, 0.62 * h)];
    s.loft(&dish, |_, _| Some(m.rim));
    s.cap(&ring(0.60 * radius, 0.55 * h), m.underside);
    // Five broad spokes and a hub cap.
    for spoke in 0..5 {
        let angle = spoke as f32 / 5.0 * TAU;
        let at = |r: f32, turn: f32, y: f32| {
            let (sin, cos) = (angle + turn).sin_cos();
            [c[0] + r * cos, c[1] + side * y, c[2] + r * sin]
        };
        let mut corners = [
            at(0.16 * radius, -0.7, 0.82 * h),
            at(0.62 * radius, -0.24, 0.70 * h),
            at(0.62 * radius, 0.24, 0.70 * h),
            at(0.16 * radius, 0.7, 0.82 * h),
        ];
        if side > 0.0 {
            corners.reverse();
        }
        s.plate(corners, m.rim);
    }
}
