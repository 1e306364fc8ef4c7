//! Motorcycles and bicycles, and their riders.

use super::palette::{PersonPalette, VehiclePalette};
use super::person::{Detail, Seat, rider};
use crate::model::Bone;
use crate::shape::{Shaper, V3, add, mix};
use std::f32::consts::TAU;

/// Sizes (m) as built: length, width, height with rider.
pub(super) const MOTORCYCLE: [f32; 3] = [2.15, 0.80, 1.60];
pub(super) const BICYCLE: [f32; 3] = [1.75, 0.60, 1.75];
/// Height of the cycles themselves (m).
pub(super) const MOTORCYCLE_TOP: f32 = 1.21;
pub(super) const BICYCLE_TOP: f32 = 1.055;
/// Radius of the wheels (m), and where their axles are (x; front and rear alike).
pub(super) const MOTORCYCLE_WHEEL: f32 = 0.31;
pub(super) const MOTORCYCLE_AXLE: f32 = 0.73;
pub(super) const BICYCLE_WHEEL: f32 = 0.34;
pub(super) const BICYCLE_AXLE: f32 = 0.53;

const MOTORCYCLE_SEAT: Seat = Seat {
    hip: [-0.28, 0.0, 0.86],
    shoulder: [-0.02, 0.0, 1.30],
    head: [0.06, 0.0, 1.47],
    elbow: [0.12, 0.30, 1.08],
    hand: [0.36, 0.31, 1.03],
    knees: [[0.14, 0.22, 0.70]; 2],
    feet: [[-0.10, 0.20, 0.32]; 2],
    helmet: true,
};

const BICYCLE_SEAT: Seat = Seat {
    hip: [-0.24, 0.0, 1.02],
    shoulder: [0.02, 0.0, 1.44],
    head: [0.10, 0.0, 1.63],
    elbow: [0.14, 0.26, 1.20],
    hand: [0.30, 0.26, 1.06],
    // Of the mean of a turn of the pedals, see `pedalling`.
    knees: [[0.0; 3]; 2],
    feet: [[0.0; 3]; 2],
    helmet: false,
};

/// Where the pedals turn, their radius, and the wheel's turns to one of theirs.
const CRANK: V3 = [-0.08, 0.0, 0.29];
const PEDAL: f32 = 0.17;
pub(super) const GEAR: f32 = 2.6;
/// Lengths of a thigh and of a shin (m).
const LEG: [f32; 2] = [0.44, 0.43];
/// An ankle's height over its pedal (m).
const ANKLE: f32 = 0.075;

/// Mean, amplitude and offset of an angle over a turn: its first harmonic.
#[derive(Clone, Copy, Debug)]
struct Swing {
    mean: f32,
    amplitude: f32,
    offset: f32,
}

/// How the left thigh turns about its hip and its shin about the knee (rad, about y, from hanging) while
/// the pedals turn: the leg that reaches from hip to pedal, its knee ahead.
fn pedalling() -> [Swing; 2] {
    const STEPS: usize = 48;
    let hip = BICYCLE_SEAT.hip;
    let [thigh, shin] = LEG;
    let angles: Vec<[f32; 2]> = (0..STEPS)
        .map(|k| {
            let (sin, cos) = (k as f32 / STEPS as f32 * TAU).sin_cos();
            let ankle = [CRANK[0] + PEDAL * cos, CRANK[2] - PEDAL * sin + ANKLE];
            let (x, z) = (ankle[0] - hip[0], ankle[1] - hip[2] + 0.02);
            let reach = x.hypot(z).min(0.999 * (thigh + shin));
            let at =
                |a: f32, b: f32, c: f32| ((a * a + b * b - c * c) / (2.0 * a * b)).clamp(-1.0, 1.0).acos();
            // What hangs swings backwards by a positive angle.
            let line = x.atan2(-z);
            [-(line + at(thigh, reach, shin)), std::f32::consts::PI - at(thigh, shin, reach)]
        })
        .collect();
    [0, 1].map(|joint| {
        let sum = |weight: &dyn Fn(f32) -> f32| {
            let total: f32 = angles
                .iter()
                .enumerate()
                .map(|(k, a)| a[joint] * weight(k as f32 / STEPS as f32 * TAU))
                .sum();
            total / STEPS as f32
        };
        let (sin, cos) = (2.0 * sum(&f32::sin), 2.0 * sum(&f32::cos));
        Swing { mean: sum(&|_| 1.0), amplitude: sin.hypot(cos), offset: cos.atan2(sin) }
    })
}

/// A cyclist's seat with both legs in the mean of their turn, in which they rest.
fn cyclist() -> Seat {
    let [thigh, shin] = pedalling().map(|swing| swing.mean);
    let hip = BICYCLE_SEAT.hip;
    let hang = |angle: f32, length: f32| [-angle.sin() * length, 0.0, -angle.cos() * length];
    let knee = add([hip[0], 0.11, hip[2] - 0.02], hang(thigh, LEG[0]));
    let foot = add(knee, hang(thigh + shin, LEG[1]));
    Seat { knees: [knee; 2], feet: [foot; 2], ..BICYCLE_SEAT }
}

/// Bones of a cyclist: 1, 2 thighs (left, right), 3, 4 shins, 5 the pedals.
pub(super) fn cyclist_bones() -> Vec<Bone> {
    let [thigh, shin] = pedalling();
    let seat = cyclist();
    let bone = |at: V3, side: f32, swing: Swing, parent: Option<u8>| Bone {
        pivot: [at[0], side * 0.1, at[2]],
        axis: [0.0, 1.0, 0.0],
        amplitude: swing.amplitude,
        offset: swing.offset + if side < 0.0 { std::f32::consts::PI } else { 0.0 },
        spins: false,
        parent,
    };
    let hip = add(seat.hip, [0.0, 0.0, -0.02]);
    vec![
        Bone::default(),
        bone(hip, 1.0, thigh, None),
        bone(hip, -1.0, thigh, None),
        bone(seat.knees[0], 1.0, shin, Some(1)),
        bone(seat.knees[1], -1.0, shin, Some(2)),
        Bone { pivot: CRANK, axis: [0.0, 1.0, 0.0], spins: true, ..Bone::default() },
    ]
}

/// The rider of a motorcycle.
pub(super) fn motorcyclist(s: &mut Shaper, p: &PersonPalette, detail: Detail) {
    rider(s, p, &MOTORCYCLE_SEAT, false, detail);
}

/// The rider of a bicycle, with its pedals; see [`cyclist_bones`].
pub(super) fn bicyclist(s: &mut Shaper, v: &VehiclePalette, p: &PersonPalette, detail: Detail) {
    rider(s, p, &cyclist(), true, detail);
    if detail != Detail::Near {
        return;
    }
    s.bone = 5;
    for side in [1.0, -1.0_f32] {
        let end = add(CRANK, [side * PEDAL, side * 0.08, 0.0]);
        s.tube(&[(add(CRANK, [0.0, side * 0.07, 0.0]), 0.014), (end, 0.012)], 4, true, v.chrome);
        s.cuboid(add(end, [-0.045, -0.02, -0.012]), add(end, [0.045, 0.06, 0.012]), true, v.black);
    }
    s.bone = 0;
}

/// A ring about an axle along y.
fn tyre(s: &mut Shaper, m: &VehiclePalette, c: V3, radius: f32, thick: f32, sides: usize) {
    let ring = |r: f32, y: f32| -> Vec<V3> {
        (0..sides)
            .map(|i| {
                let (sin, cos) = (-(i as f32) / sides as f32 * TAU).sin_cos();
                [c[0] + r * cos, c[1] + y, c[2] + r * sin]
            })
            .collect()
    };
    let inner = radius - 2.2 * thick;
    if sides < 8 {
        for side in [-1.0, 1.0_f32] {
            let mut disc = ring(radius, side * thick);
            if side > 0.0 {
                disc.reverse();
            }
            s.cap(&disc, m.tyre);
        }
        return;
    }
    if sides < 10 {
        // Seen from the side mostly: the rim's inner face goes.
        let rings = [ring(inner, -thick), ring(radius, 0.0), ring(inner, thick)];
        s.loft(&rings, |_, _| Some(m.tyre));
        return;
    }
    let rings = [
        ring(inner, -thick),
        ring(radius, -0.6 * thick),
        ring(radius, 0.6 * thick),
        ring(inner, thick),
        ring(inner, -thick),
    ];
    s.loft(&rings, |i, _| Some(if i == 3 { m.rim } else { m.tyre }));
}

fn spokes(s: &mut Shaper, m: &VehiclePalette, c: V3, radius: f32, count: usize, thick: f32) {
    for i in 0..count {
        let (sin, cos) = (i as f32 / count as f32 * TAU).sin_cos();
        s.tube(&[(c, thick), (add(c, [radius * cos, 0.0, radius * sin]), thick)], 3, false, m.rim);
    }
    s.tube(&[(add(c, [0.0, -0.05, 0.0]), 0.03), (add(c, [0.0, 0.05, 0.0]), 0.03)], 6, true, m.chrome);
}

/// A motorcycle; bones 1 and 2 are its wheels.
pub(super) fn motorcycle(s: &mut Shaper, v: &VehiclePalette, detail: Detail) {
    let near = detail == Detail::Near;
    let sides = match detail {
        Detail::Near => 18,
        Detail::Middle => 8,
        Detail::Far => 5,
    };
    for (i, x) in [MOTORCYCLE_AXLE, -MOTORCYCLE_AXLE].into_iter().enumerate() {
        let c = [x, 0.0, MOTORCYCLE_WHEEL];
        s.bone = if near { i as u8 + 1 } else { 0 };
        tyre(s, v, c, MOTORCYCLE_WHEEL, 0.06, sides);
        if near {
            spokes(s, v, c, 0.2, 5, 0.016);
        }
        s.bone = 0;
    }
    if detail == Detail::Far {
        s.cuboid([-0.95, -0.12, 0.45], [0.60, 0.12, 0.90], false, v.paint);
        s.plate(
            [[-0.97, 0.08, 0.65], [-0.97, -0.08, 0.65], [-0.97, -0.08, 0.82], [-0.97, 0.08, 0.82]],
            v.brake,
        );
        return;
    }
    let round = if near { 10 } else { 5 };
    let rows = |fine: usize| if near { fine } else { 3 };
    let front = [MOTORCYCLE_AXLE, 0.0, MOTORCYCLE_WHEEL];
    let head = [0.42, 0.0, 0.95];
    {
        for y in [-0.09, 0.09] {
            s.tube(
                &[(add(front, [0.0, y, 0.0]), 0.028), (add(head, [-0.02, y, 0.0]), 0.03)],
                round.min(6),
                true,
                v.chrome,
            );
        }
        // Mudguards, engine, exhaust.
        s.ball(add(front, [0.0, 0.0, 0.14]), [0.28, 0.075, 0.20], (rows(4), round), (0.1, 1.0), v.paint);
        s.ball([0.05, 0.0, 0.42], [0.26, 0.17, 0.20], (rows(5), round), (-1.0, 1.0), v.chrome);
        if near {
            s.tube(
                &[([0.0, -0.17, 0.30], 0.045), ([-0.5, -0.19, 0.32], 0.05), ([-0.92, -0.2, 0.40], 0.058)],
                round,
                true,
                v.chrome,
            );
            s.tube(
                &[([-0.1, 0.0, 0.40], 0.05), ([-MOTORCYCLE_AXLE, 0.12, MOTORCYCLE_WHEEL], 0.035)],
                5,
                true,
                v.black,
            );
        }
        // Handlebar and mirrors.
        s.tube(
            &[([0.36, -0.34, 1.02], 0.016), ([0.40, 0.0, 0.99], 0.018), ([0.36, 0.34, 1.02], 0.016)],
            5,
            true,
            v.black,
        );
        for y in if near { &[-0.33, 0.33_f32][..] } else { &[] } {
            let y = *y;
            s.tube(&[([0.38, 0.8 * y, 1.0], 0.01), ([0.42, y, 1.15], 0.01)], 4, false, v.black);
            s.ball([0.42, y, 1.17], [0.02, 0.06, 0.04], (3, 6), (-1.0, 1.0), v.black);
        }
        s.tube(
            &[([0.45, 0.0, 0.98], 0.10), ([0.56, 0.0, 0.96], 0.095), ([0.60, 0.0, 0.955], 0.085)],
            round,
            true,
            v.chrome,
        );
    }
    // Tank, seat, tail.
    s.ball([0.16, 0.0, 0.78], [0.30, 0.16, 0.16], (rows(6), round), (-1.0, 1.0), v.paint);
    s.oval_tube(
        &[
            ([0.05, 0.0, 0.72], 0.12, 0.06),
            ([-0.35, 0.0, 0.74], 0.15, 0.06),
            ([-0.75, 0.0, 0.80], 0.09, 0.05),
        ],
        round,
        true,
        v.black,
    );
    s.oval_tube(
        &[([-0.3, 0.0, 0.64], 0.12, 0.08), ([-0.6, 0.0, 0.70], 0.11, 0.08), ([-0.95, 0.0, 0.76], 0.06, 0.05)],
        round,
        true,
        v.paint,
    );
    // Lamps.
    let disc = |s: &mut Shaper, c: V3, r: f32, forward: f32, material| {
        let ring: Vec<V3> = (0..8)
            .map(|i| {
                let (sin, cos) = (forward * i as f32 / 8.0 * TAU).sin_cos();
                add(c, [0.0, r * cos, r * sin])
            })
            .collect();
        s.cap(&ring, material);
    };
    disc(s, [0.605, 0.0, 0.955], 0.08, 1.0, v.head);
    disc(s, [-1.0, 0.0, 0.77], 0.055, -1.0, v.brake);
    disc(s, [-0.99, 0.0, 0.70], 0.03, -1.0, v.tail);
    if near {
        for (side, material) in [(1.0, v.blink_left), (-1.0, v.blink_right)] {
            s.ball([-0.93, side * 0.14, 0.74], [0.035, 0.04, 0.03], (3, 6), (-1.0, 1.0), material);
            s.ball([0.50, side * 0.19, 0.90], [0.035, 0.04, 0.03], (3, 6), (-1.0, 1.0), material);
        }
        s.plate(
            [[-1.02, 0.10, 0.50], [-1.02, -0.10, 0.50], [-0.99, -0.10, 0.62], [-0.99, 0.10, 0.62]],
            v.plate,
        );
    }
}

/// A bicycle; bones 1 and 2 are its wheels.
pub(super) fn bicycle(s: &mut Shaper, v: &VehiclePalette, detail: Detail) {
    let near = detail == Detail::Near;
    let sides = match detail {
        Detail::Near => 20,
        Detail::Middle => 8,
        Detail::Far => 5,
    };
    let axle = |x: f32| [x, 0.0, BICYCLE_WHEEL];
    let (front, rear) = (axle(BICYCLE_AXLE), axle(-BICYCLE_AXLE));
    for (i, c) in [front, rear].into_iter().enumerate() {
        s.bone = if near { i as u8 + 1 } else { 0 };
        tyre(s, v, c, BICYCLE_WHEEL, 0.018, sides);
        if near {
            spokes(s, v, c, 0.31, 8, 0.004);
        }
        s.bone = 0;
    }
    if detail == Detail::Far {
        s.cuboid([-0.35, -0.03, 0.35], [0.40, 0.03, 0.85], false, v.paint);
        return;
    }
    let crank = CRANK;
    let saddle = [-0.26, 0.0, 0.94];
    let head = [0.38, 0.0, 0.88];
    let low = mix(head, front, 0.18);
    let bar = |s: &mut Shaper, a: V3, b: V3, r: f32| {
        s.tube(&[(a, r), (b, r)], if near { 6 } else { 3 }, near, v.paint)
    };
    bar(s, crank, mix(crank, saddle, 0.9), 0.018);
    bar(s, crank, low, 0.021);
    bar(s, mix(crank, saddle, 0.82), head, 0.018);
    for y in [-0.045, 0.045] {
        bar(s, add(front, [0.0, y, 0.0]), add(low, [0.0, 0.4 * y, 0.0]), 0.013);
        bar(s, add(rear, [0.0, y, 0.0]), crank, 0.011);
        bar(s, add(rear, [0.0, y, 0.0]), mix(crank, saddle, 0.8), 0.010);
    }
    bar(s, head, [0.36, 0.0, 1.02], 0.015);
    s.tube(
        &[([0.30, -0.28, 1.04], 0.014), ([0.38, 0.0, 1.03], 0.014), ([0.30, 0.28, 1.04], 0.014)],
        4,
        true,
        v.black,
    );
    s.ball(saddle, [0.14, 0.07, 0.035], (4, 6), (-1.0, 1.0), v.black);
    if detail != Detail::Far {
        s.ball([0.46, 0.0, 0.93], [0.03, 0.03, 0.03], (3, 6), (-1.0, 1.0), v.head);
        s.ball([-0.62, 0.0, 0.72], [0.02, 0.03, 0.03], (3, 6), (-1.0, 1.0), v.tail);
    }
}
