//! Buses and trucks: rounded boxes with windows, doors, lamps and double tyres.

use super::palette::VehiclePalette;
use super::wheel::wheel;
use crate::model::MaterialId;
use crate::shape::{Shaper, V3};

/// A box along x with rounded edges: corners (m), radius of the long edges, how much the ends shrink.
pub(super) fn rounded_box(s: &mut Shaper, lo: V3, hi: V3, radius: f32, ends: f32, material: MaterialId) {
    let (cy, w) = (0.5 * (lo[1] + hi[1]), 0.5 * (hi[1] - lo[1]));
    let ring = |x: f32, inset: f32| -> Vec<V3> {
        let w = w - inset;
        let (z0, z1) = (lo[2] + 0.6 * inset, hi[2] - inset);
        let r = radius.min(0.45 * w);
        let mut half = vec![[0.0, z0], [w, z0], [w, z1 - r]];
        for step in 1..3 {
            let (sin, cos) = (step as f32 / 3.0 * std::f32::consts::FRAC_PI_2).sin_cos();
            half.push([w - r + r * cos, z1 - r + r * sin]);
        }
        half.push([w - r, z1]);
        let left = half.iter().map(|p| [x, cy + p[0], p[1]]);
        let right = half[1..].iter().rev().map(|p| [x, cy - p[0], p[1]]);
        left.chain(right).collect()
    };
    let rings = [
        ring(lo[0], ends),
        ring(lo[0] + 0.4 * ends, 0.35 * ends),
        ring(lo[0] + 1.2 * ends, 0.0),
        ring(hi[0] - 1.2 * ends, 0.0),
        ring(hi[0] - 0.4 * ends, 0.35 * ends),
        ring(hi[0], ends),
    ];
    s.loft(&rings, |_, _| Some(material));
    s.cap(&rings[5], material);
    let mut back = rings[0].clone();
    back.reverse();
    s.cap(&back, material);
}

/// A flat piece on a side (1 left, -1 right) of a vehicle.
fn on_side(s: &mut Shaper, side: f32, y: f32, x: [f32; 2], z: [f32; 2], material: MaterialId) {
    let y = side * y;
    let mut q = [[x[0], y, z[0]], [x[1], y, z[0]], [x[1], y, z[1]], [x[0], y, z[1]]];
    if side > 0.0 {
        q.reverse();
    }
    s.plate(q, material);
}

/// A flat piece on the front (1) or rear (-1); may lean back by `lean` (m) at its top.
fn on_end(s: &mut Shaper, end: f32, x: f32, y: [f32; 2], z: [f32; 2], lean: f32, material: MaterialId) {
    let top = x - end * lean;
    let mut q = [[x, y[0], z[0]], [x, y[1], z[0]], [top, y[1], z[1]], [top, y[0], z[1]]];
    if end < 0.0 {
        q.reverse();
    }
    s.plate(q, material);
}

/// Lamps and plates at both ends of something of half width `w` between `rear` and `front` (x).
fn lamps(s: &mut Shaper, m: &VehiclePalette, front: f32, rear: f32, w: f32, height: [f32; 2]) {
    let (lo, hi) = (height[0], height[1]);
    for side in [-1.0, 1.0_f32] {
        let y = |a: f32, b: f32| {
            let (a, b) = (side * a * w, side * b * w);
            [a.min(b), a.max(b)]
        };
        let blink = if side > 0.0 { m.blink_left } else { m.blink_right };
        on_end(s, 1.0, front, y(0.58, 0.86), [lo, lo + 0.20], 0.0, m.head);
        on_end(s, 1.0, front, y(0.87, 0.96), [lo, lo + 0.20], 0.0, blink);
        on_end(s, -1.0, rear, y(0.74, 0.94), [hi, hi + 0.17], 0.0, m.brake);
        on_end(s, -1.0, rear, y(0.74, 0.94), [hi + 0.18, hi + 0.27], 0.0, blink);
        on_end(s, -1.0, rear, y(0.74, 0.94), [hi - 0.14, hi - 0.01], 0.0, m.tail);
    }
    on_end(s, 1.0, front, [-0.26, 0.26], [lo - 0.16, lo - 0.05], 0.0, m.plate);
    on_end(s, -1.0, rear, [-0.26, 0.26], [hi - 0.12, hi - 0.01], 0.0, m.plate);
}

fn wheels(s: &mut Shaper, m: &VehiclePalette, axles: &[f32], w: f32, radius: f32, sides: usize, spin: bool) {
    for (i, &x) in axles.iter().enumerate() {
        s.bone = if spin { i as u8 + 1 } else { 0 };
        for side in [1.0, -1.0_f32] {
            wheel(s, m, [x, side * (w - 0.16), radius], radius, 0.3, side, sides);
        }
    }
    s.bone = 0;
}

/// Sizes (m) of the bus as it is built.
pub(super) const BUS: [f32; 3] = [10.3, 2.5, 3.1];
pub(super) const BUS_AXLES: [f32; 2] = [2.65, -3.2];
/// Sizes (m) of the truck as it is built.
pub(super) const TRUCK: [f32; 3] = [7.4, 2.45, 3.2];
pub(super) const TRUCK_AXLES: [f32; 2] = [2.35, -2.1];
/// Radius of their wheels (m).
pub(super) const WHEEL: f32 = 0.48;

/// A city bus. `fine` is for near by.
pub(super) fn bus(s: &mut Shaper, m: &VehiclePalette, fine: bool) {
    let [length, width, height] = BUS;
    let (f, w) = (0.5 * length - 0.012, 0.5 * width - 0.06);
    let lowest = 0.34;
    rounded_box(s, [-f, -w, lowest], [f, w, height], 0.22, 0.10, m.paint);
    // A band of the second colour along the skirt.
    let glass = [1.12, 2.52];
    for side in [-1.0, 1.0_f32] {
        let y = w + 0.006;
        on_side(s, side, y, [-f + 0.2, f - 0.2], [lowest + 0.02, 0.62], m.second);
        let door = |x: f32| side < 0.0 && [3.9, 0.2].iter().any(|d: &f32| (x - d).abs() < 0.7);
        let bays = if fine { 8 } else { 1 };
        let (from, to) = (-f + 0.45, f - 0.35);
        let bay = (to - from) / bays as f32;
        for i in 0..bays {
            let x0 = from + bay * i as f32;
            let gap = if fine { 0.05 } else { 0.0 };
            on_side(s, side, y + 0.004, [x0 + gap, x0 + bay - gap], glass, m.glass);
        }
        on_side(s, side, y + 0.001, [from, to], [glass[0] - 0.06, glass[1] + 0.08], m.black);
        if fine {
            for centre in [3.9, 0.2] {
                if door(centre) {
                    on_side(s, side, y + 0.008, [centre - 0.68, centre + 0.68], [0.40, 2.56], m.black);
                    on_side(s, side, y + 0.012, [centre - 0.62, centre - 0.04], [0.52, 2.46], m.glass);
                    on_side(s, side, y + 0.012, [centre + 0.04, centre + 0.62], [0.52, 2.46], m.glass);
                }
            }
            // Arches.
            for x in BUS_AXLES {
                on_side(s, side, y + 0.010, [x - 0.60, x + 0.60], [0.34, 1.06], m.underside);
            }
            // Mirrors on arms.
            let (a, b) = (side * (w - 0.12), side * (w + 0.055));
            s.cuboid([f - 0.16, a.min(b), 1.85], [f - 0.02, a.max(b), 2.35], true, m.black);
        }
    }
    let front = f + 0.008;
    on_end(s, 1.0, front, [-w + 0.14, w - 0.14], [1.02, 2.62], 0.0, m.glass);
    on_end(s, 1.0, front, [-w + 0.14, w - 0.14], [2.66, 2.94], 0.0, m.black);
    on_end(s, 1.0, front, [-w + 0.14, w - 0.14], [0.42, 0.60], 0.0, m.black);
    on_end(s, -1.0, -front, [-w + 0.22, w - 0.22], [1.45, 2.55], 0.0, m.glass);
    on_end(s, -1.0, -front, [-w + 0.12, w - 0.12], [0.42, 0.62], 0.0, m.black);
    if fine {
        on_end(s, 1.0, front + 0.004, [-0.8, 0.55], [2.70, 2.90], 0.0, m.plate);
        s.cuboid([-2.8, -0.7, height - 0.11], [0.6, 0.7, height], false, m.second);
    }
    lamps(s, m, front + 0.002, -front - 0.002, w, [0.68, 0.92]);
    s.cuboid([-f + 0.3, -w + 0.3, 0.22], [f - 0.3, w - 0.3, lowest], true, m.underside);
    let (sides, spin) = if fine { (18, true) } else { (8, false) };
    wheels(s, m, &BUS_AXLES, w + 0.045, WHEEL, sides, spin);
}

/// A box truck, or a fire engine's like.
pub(super) fn truck(s: &mut Shaper, m: &VehiclePalette, fine: bool) {
    let [length, width, height] = TRUCK;
    let (f, w) = (0.5 * length - 0.012, 0.5 * width - 0.05);
    // Cab, then the box behind it, wider and higher.
    let cab_rear = f - 1.75;
    let cab_w = w - 0.06;
    let cab_top = 2.62;
    rounded_box(s, [cab_rear, -cab_w, 0.42], [f, cab_w, cab_top], 0.20, 0.10, m.paint);
    rounded_box(s, [-f, -w, 0.95], [cab_rear - 0.12, w, height], 0.04, 0.02, m.second);
    s.cuboid([-f + 0.1, -0.45, 0.50], [cab_rear, 0.45, 0.96], true, m.underside);
    let front = f + 0.008;
    on_end(s, 1.0, front, [-cab_w + 0.14, cab_w - 0.14], [1.42, 2.30], 0.0, m.glass);
    on_end(s, 1.0, front, [-cab_w + 0.3, cab_w - 0.3], [0.95, 1.30], 0.0, m.black);
    on_end(s, 1.0, front, [-cab_w + 0.1, cab_w - 0.1], [0.44, 0.60], 0.0, m.black);
    for side in [-1.0, 1.0_f32] {
        on_side(s, side, cab_w + 0.006, [cab_rear + 0.55, f - 0.22], [1.42, 2.26], m.glass);
        if fine {
            on_side(s, side, cab_w + 0.006, [cab_rear + 0.58, cab_rear + 0.76], [1.22, 1.26], m.black);
            let (a, b) = (side * (cab_w - 0.1), side * (w + 0.045));
            s.cuboid([f - 0.24, a.min(b), 1.6], [f - 0.12, a.max(b), 2.15], true, m.black);
            // Side guard, tank and the frame of the box.
            let (a, b) = (side * (w - 0.16), side * (w - 0.04));
            s.cuboid([-1.2, a.min(b), 0.48], [1.2, a.max(b), 0.88], true, m.black);
            on_side(s, side, w + 0.004, [-f + 0.05, cab_rear - 0.15], [0.98, 1.06], m.chrome);
        }
        on_side(
            s,
            side,
            cab_w + 0.004,
            [TRUCK_AXLES[0] - 0.58, TRUCK_AXLES[0] + 0.58],
            [0.42, 1.05],
            m.underside,
        );
    }
    // Rear doors, bumper.
    if fine {
        for y in [[-w + 0.08, -0.01], [0.01, w - 0.08]] {
            on_end(s, -1.0, -front, y, [1.05, height - 0.1], 0.0, m.second);
            on_end(
                s,
                -1.0,
                -front - 0.003,
                [
                    y[0].abs().min(y[1].abs()).copysign(y[0] + y[1]) - 0.02,
                    y[0].abs().min(y[1].abs()).copysign(y[0] + y[1]) + 0.02,
                ],
                [1.1, height - 0.2],
                0.0,
                m.chrome,
            );
        }
    }
    s.cuboid([-f, -w + 0.05, 0.52], [-f + 0.12, w - 0.05, 0.86], true, m.black);
    lamps(s, m, front + 0.002, -front - 0.002, w - 0.06, [0.66, 0.68]);
    let (sides, spin) = if fine { (18, true) } else { (8, false) };
    wheels(s, m, &TRUCK_AXLES, w - 0.0, WHEEL, sides, spin);
}

/// Either from afar: boxes.
pub(super) fn far(s: &mut Shaper, m: &VehiclePalette, is_bus: bool) {
    let [length, width, height] = if is_bus { BUS } else { TRUCK };
    let (f, w) = (0.5 * length, 0.5 * width);
    if is_bus {
        s.cuboid([-f, -w, 0.3], [f, w, height], false, m.paint);
        for side in [-1.0, 1.0_f32] {
            on_side(s, side, w + 0.01, [-f + 0.4, f - 0.3], [1.1, 2.5], m.glass);
        }
        on_end(s, 1.0, f + 0.01, [-w + 0.1, w - 0.1], [1.0, 2.7], 0.0, m.glass);
        on_end(s, -1.0, -f - 0.01, [-w + 0.2, w - 0.2], [1.5, 2.5], 0.0, m.glass);
    } else {
        s.cuboid([f - 1.75, -w + 0.05, 0.4], [f, w - 0.05, 2.62], false, m.paint);
        s.cuboid([-f, -w, 0.9], [f - 1.9, w, height], true, m.second);
        on_end(s, 1.0, f + 0.01, [-w + 0.15, w - 0.15], [1.4, 2.3], 0.0, m.glass);
    }
    let axles = if is_bus { BUS_AXLES } else { TRUCK_AXLES };
    for x in axles {
        for side in [-1.0, 1.0_f32] {
            on_side(s, side, w + 0.012, [x - 0.45, x + 0.45], [0.02, 0.92], m.tyre);
        }
    }
    for side in [-1.0, 1.0_f32] {
        let y = [side * 0.9 * w, side * 0.6 * w];
        on_end(s, -1.0, -f - 0.012, [y[0].min(y[1]), y[0].max(y[1])], [0.6, 0.9], 0.0, m.brake);
    }
}
