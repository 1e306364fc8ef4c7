//! People: limbs as tapered tubes on bones that swing in step, heads with hair, clothes.

use super::palette::PersonPalette;
use crate::model::{Bone, MaterialId};
use crate::shape::{Shaper, V3, add, mix};

/// A person's build; heights are of an adult of 1.75 m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Build {
    /// Breadth of shoulders and depth of the belly, 1 = average.
    pub broad: f32,
    pub stout: f32,
    /// Size of the head against the body (children: larger).
    pub head: f32,
    pub long_hair: bool,
    /// A skirt or coat to below the knees.
    pub skirt: bool,
    pub backpack: bool,
    pub handbag: bool,
}

/// Height of a person as built (m).
pub(super) const HEIGHT: f32 = 1.75;
/// Length of a full walking cycle (two steps) of such a person (m).
pub(super) const STRIDE: f32 = 1.45;

const HIP: f32 = 0.90;
const KNEE: f32 = 0.49;
const SHOULDER: f32 = 1.43;
const ELBOW: f32 = 1.13;

/// Swing of the thighs, and half of the bend of the knees, arms (rad).
const THIGH: f32 = 0.42;
const KNEE_BEND: f32 = 0.30;
const ARM: f32 = 0.38;

/// Bones of a walker: 1, 2 thighs (left, right), 3, 4 shins, 5, 6 upper arms, 7, 8 forearms.
pub(super) fn walking_bones() -> Vec<Bone> {
    let axis = [0.0, 1.0, 0.0];
    let bone = |y: f32, z: f32, amplitude: f32, offset: f32, parent: Option<u8>| Bone {
        pivot: [0.0, y, z],
        axis,
        amplitude,
        offset,
        spins: false,
        parent,
    };
    use std::f32::consts::PI;
    vec![
        Bone { axis, ..Bone::default() },
        bone(0.09, HIP, THIGH, 0.0, None),
        bone(-0.09, HIP, THIGH, PI, None),
        // A knee bends most while its thigh passes from behind to ahead.
        bone(0.09, KNEE, KNEE_BEND, -0.35 * PI, Some(1)),
        bone(-0.09, KNEE, KNEE_BEND, 0.65 * PI, Some(2)),
        bone(0.2, SHOULDER, ARM, PI, None),
        bone(-0.2, SHOULDER, ARM, 0.0, None),
        bone(0.22, ELBOW, 0.18, PI, Some(5)),
        bone(-0.22, ELBOW, 0.18, 0.0, Some(6)),
    ]
}

/// How far the hips sink (m) at a phase of the walk, so that the feet stay on the ground.
pub(super) fn hip_drop(phase: f32) -> f32 {
    0.85 * HIP * (1.0 - (THIGH * phase.sin()).cos())
}

/// `p` turned by `angle` (rad) about an axis along y through `pivot`: positive swings what hangs backwards.
fn about_y(p: V3, pivot: V3, angle: f32) -> V3 {
    let (s, c) = angle.sin_cos();
    let (x, z) = (p[0] - pivot[0], p[2] - pivot[2]);
    [pivot[0] + x * c + z * s, p[1], pivot[2] - x * s + z * c]
}

/// A limb from a to b with radii, and a ball at each end so that joints stay closed when bent.
fn limb(s: &mut Shaper, stops: &[(V3, f32)], sides: usize, material: MaterialId) {
    s.tube(stops, sides, true, material);
}

/// How finely a person is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Detail {
    Near,
    Middle,
    Far,
}

/// A person on foot: walking (rest pose in mid-stride, see [`walking_bones`]) or standing.
pub(super) fn pedestrian(s: &mut Shaper, m: &PersonPalette, build: &Build, walking: bool, detail: Detail) {
    let near = detail == Detail::Near;
    let sides = match detail {
        Detail::Near => 10,
        Detail::Middle => 4,
        Detail::Far => 3,
    };
    let wide = build.broad;
    let deep = build.stout;
    torso(s, m, build, detail);
    head(s, m, build, [0.02, 0.0, 1.0], detail);
    let legs = if build.skirt { m.skin } else { m.legs };
    for (i, side) in [1.0, -1.0_f32].into_iter().enumerate() {
        let i = i as u8;
        let bend = if walking { KNEE_BEND } else { 0.0 };
        let hip: V3 = [0.0, side * 0.09 * wide, HIP];
        let knee: V3 = [0.015, side * 0.095 * wide, KNEE];
        let ankle: V3 = [0.0, side * 0.095, 0.09];
        let shin = |p: V3| about_y(p, knee, bend);
        s.bone = if walking { 1 + i } else { 0 };
        if detail == Detail::Far {
            s.tube(&[(hip, 0.095), (knee, 0.065)], 3, false, legs);
            s.bone = if walking { 3 + i } else { 0 };
            s.tube(&[(knee, 0.065), (shin([0.0, side * 0.095, 0.0]), 0.06)], 3, false, legs);
        } else {
            limb(
                s,
                &[
                    (add(hip, [0.0, 0.0, 0.05]), 0.075 * deep),
                    (hip, 0.090 * deep),
                    (mix(hip, knee, 0.5), 0.080 * deep),
                    (knee, 0.060),
                ],
                sides,
                legs,
            );
            s.bone = if walking { 3 + i } else { 0 };
            let calf = add(mix(knee, ankle, 0.35), [-0.015, 0.0, 0.0]);
            limb(
                s,
                &[
                    (add(knee, [0.0, 0.0, 0.03]), 0.052),
                    (knee, 0.061),
                    (shin(calf), 0.062),
                    (shin(mix(knee, ankle, 0.75)), 0.047),
                    (shin(ankle), 0.045),
                ],
                sides,
                legs,
            );
            shoe(s, m, &|p| shin(p), side * 0.095, near);
        }
        // Arms hang a little away from the body, elbows slightly bent.
        let shoulder: V3 = [0.0, side * 0.185 * wide, SHOULDER - 0.02];
        let elbow: V3 = [-0.02, side * 0.225 * wide, ELBOW];
        let wrist: V3 = [0.05, side * 0.235 * wide, 0.89];
        let hand = add(wrist, [0.02, 0.0, -0.075]);
        s.bone = if walking { 5 + i } else { 0 };
        if detail == Detail::Far {
            s.tube(&[(shoulder, 0.06), (wrist, 0.045)], 3, false, m.top);
            continue;
        }
        limb(
            s,
            &[
                (add(shoulder, [0.0, -side * 0.03, 0.03]), 0.045),
                (shoulder, 0.060),
                (mix(shoulder, elbow, 0.5), 0.052),
                (elbow, 0.044),
            ],
            sides,
            m.top,
        );
        s.bone = if walking { 7 + i } else { 0 };
        limb(
            s,
            &[
                (add(elbow, [0.0, 0.0, 0.02]), 0.040),
                (elbow, 0.045),
                (mix(elbow, wrist, 0.5), 0.041),
                (wrist, 0.031),
            ],
            sides,
            m.top,
        );
        let half = [0.026, 0.018, 0.075];
        s.ball(add(hand, [0.0; 3]), half, if near { (4, 6) } else { (2, 3) }, (-1.0, 1.0), m.skin);
        if build.handbag && side < 0.0 {
            s.cuboid(add(hand, [-0.14, -0.05, -0.30]), add(hand, [0.14, 0.04, -0.08]), true, m.bag);
        }
    }
    s.bone = 0;
}

fn shoe(s: &mut Shaper, m: &PersonPalette, bend: &dyn Fn(V3) -> V3, y: f32, near: bool) {
    let start = s.len();
    let rows = if near { (4, 8) } else { (2, 4) };
    s.ball([0.055, y, 0.045], [0.145, 0.05, 0.052], rows, (-0.75, 1.0), m.shoes);
    s.displace(start, bend);
}

fn torso(s: &mut Shaper, m: &PersonPalette, build: &Build, detail: Detail) {
    let (w, d) = (build.broad, build.stout);
    let sides = match detail {
        Detail::Near => 14,
        Detail::Middle => 7,
        Detail::Far => 4,
    };
    // Height, half breadth, half depth, forward.
    let all = [
        (0.84, 0.13, 0.09, -0.01),
        (0.90, 0.168, 0.118, -0.01),
        (0.99, 0.160 + 0.02 * (d - 1.0), 0.112 * d, 0.0),
        (1.08, 0.148 + 0.05 * (d - 1.0), 0.112 * d * d, 0.01),
        (1.22, 0.162, 0.122 * d, 0.01),
        (1.34, 0.178, 0.118, 0.0),
        (1.43, 0.172, 0.092, -0.01),
        (1.475, 0.112, 0.068, -0.012),
        (1.50, 0.062, 0.056, -0.008),
    ];
    let keep: &[usize] = match detail {
        Detail::Near => &[0, 1, 2, 3, 4, 5, 6, 7, 8],
        Detail::Middle => &[0, 2, 4, 6, 8],
        Detail::Far => &[0, 4, 6],
    };
    let stops: Vec<(V3, f32, f32)> =
        keep.iter().map(|&i| all[i]).map(|(z, b, depth, x)| ([x, 0.0, z], b * w, depth)).collect();
    // The waistband: below it trousers, above it the top.
    let split = keep.iter().position(|&i| i >= 2).unwrap_or(1);
    upright(s, &stops[split..], sides, m.top);
    let below = if build.skirt { m.top } else { m.legs };
    upright(s, &stops[..=split], sides, below);
    if build.skirt {
        let hem = [
            ([0.0, 0.0, 0.50], 0.235 * w, 0.19),
            ([0.0, 0.0, 0.75], 0.205 * w, 0.155),
            ([0.0, 0.0, 1.0], 0.163 * w, 0.118 * d),
        ];
        upright(s, &hem, sides, m.top);
    }
    if build.backpack && detail != Detail::Far {
        let n = if detail == Detail::Near { (6, 10) } else { (3, 6) };
        s.ball([-0.19, 0.0, 1.22], [0.11, 0.15, 0.23], n, (-1.0, 1.0), m.bag);
    }
    if detail == Detail::Near {
        s.tube(&[([0.0, 0.0, 1.47], 0.052), ([0.012, 0.0, 1.57], 0.048)], 8, false, m.skin);
    }
}

/// An upright tube whose first radius is along y and second along x, open below.
fn upright(s: &mut Shaper, stops: &[(V3, f32, f32)], sides: usize, material: MaterialId) {
    let rings: Vec<Vec<V3>> = stops
        .iter()
        .map(|&(c, ry, rx)| {
            (0..sides)
                .map(|i| {
                    let (sin, cos) = ((i as f32 + 0.5) / sides as f32 * std::f32::consts::TAU).sin_cos();
                    // A little squarer than an ellipse.
                    let square = |v: f32| v.signum() * v.abs().powf(0.85);
                    add(c, [rx * square(cos), ry * square(sin), 0.0])
                })
                .collect()
        })
        .collect();
    s.loft(&rings, |_, _| Some(material));
    if let (Some(top), Some(bottom)) = (rings.last(), rings.first()) {
        s.cap(top, material);
        let mut bottom = bottom.clone();
        bottom.reverse();
        s.cap(&bottom, material);
    }
}

/// A head over `at` (x, y; z scales nothing): skull, face, hair.
fn head(s: &mut Shaper, m: &PersonPalette, build: &Build, at: V3, detail: Detail) {
    let k = build.head;
    let centre = [at[0], at[1], HEIGHT - 0.125 * k];
    let (rows, sides) = match detail {
        Detail::Near => (8, 12),
        Detail::Middle => (4, 6),
        Detail::Far => (2, 4),
    };
    s.ball(centre, [0.098 * k, 0.078 * k, 0.122 * k], (rows, sides), (-1.0, 1.0), m.skin);
    // Hair: a cap set back, leaving the face free.
    let back = add(centre, [-0.018 * k, 0.0, 0.012 * k]);
    let start = s.len();
    s.ball(back, [0.094 * k, 0.086 * k, 0.113 * k], (rows / 2 + 1, sides), (-0.35, 1.0), m.hair);
    s.displace(start, |p| {
        // The lower rim rises towards the forehead.
        let front = ((p[0] - back[0]) / (0.09 * k)).max(0.0);
        let low = ((back[2] + 0.05 * k - p[2]) / (0.1 * k)).max(0.0);
        [
            p[0] - 0.02 * k * front * low.min(1.0),
            p[1],
            (p[2] + 0.075 * k * front * low).min(back[2] + 0.113 * k),
        ]
    });
    if build.long_hair && detail != Detail::Far {
        s.ball(add(centre, [-0.062 * k, 0.0, -0.10]), [0.05, 0.082 * k, 0.16], (4, 8), (-1.0, 1.0), m.hair);
    }
    if detail == Detail::Near {
        // Nose: enough for a profile.
        s.ball(add(centre, [0.094 * k, 0.0, -0.012]), [0.022, 0.015, 0.026], (3, 5), (-1.0, 1.0), m.skin);
    }
}

/// Where a rider's joints are (m, model frame; left side, y mirrored).
#[derive(Clone, Copy, Debug)]
pub(super) struct Seat {
    pub hip: V3,
    pub shoulder: V3,
    pub head: V3,
    pub elbow: V3,
    pub hand: V3,
    /// Knee and foot, left and right.
    pub knees: [V3; 2],
    pub feet: [V3; 2],
    pub helmet: bool,
}

/// A person on a cycle. With `pedals`, bones 1 and 2 are the thighs, 3 and 4 the shins.
pub(super) fn rider(s: &mut Shaper, m: &PersonPalette, seat: &Seat, pedals: bool, detail: Detail) {
    let (sides, near) = match detail {
        Detail::Near => (10, true),
        Detail::Middle => (4, false),
        Detail::Far => (3, false),
    };
    let (hip, shoulder) = (seat.hip, seat.shoulder);
    let up = |t: f32| mix(hip, shoulder, t);
    let stops = [
        (up(-0.12), 0.12, 0.10),
        (up(0.08), 0.165, 0.12),
        (up(0.45), 0.15, 0.11),
        (up(0.80), 0.18, 0.115),
        (up(1.0), 0.15, 0.09),
        (up(1.1), 0.06, 0.055),
    ];
    if detail == Detail::Far {
        s.oval_tube(&[stops[0], stops[3]], 4, true, m.top);
    } else {
        s.oval_tube(&stops, sides + 2, true, m.top);
    }
    let k = 1.0;
    let (rows, round) = match detail {
        Detail::Near => (8, 12),
        Detail::Middle => (3, 6),
        Detail::Far => (2, 4),
    };
    if detail != Detail::Far || !seat.helmet {
        s.ball(seat.head, [0.095 * k, 0.078 * k, 0.118 * k], (rows, round), (-1.0, 1.0), m.skin);
    }
    if seat.helmet {
        s.ball(
            add(seat.head, [-0.005, 0.0, 0.01]),
            [0.135, 0.118, 0.135],
            (rows, round),
            (-0.6, 1.0),
            m.helmet,
        );
        if detail != Detail::Far {
            s.ball(add(seat.head, [0.035, 0.0, 0.0]), [0.108, 0.10, 0.07], (4, round), (-1.0, 1.0), m.visor);
        }
    } else {
        s.ball(
            add(seat.head, [-0.012, 0.0, 0.02]),
            [0.105, 0.09, 0.112],
            (rows / 2 + 1, round),
            (-0.1, 1.0),
            m.hair,
        );
    }
    for (i, side) in [1.0, -1.0_f32].into_iter().enumerate() {
        let to = |p: V3| [p[0], side * p[1], p[2]];
        let (elbow, hand) = (to(seat.elbow), to(seat.hand));
        let joint = [shoulder[0], side * 0.185, shoulder[2] - 0.02];
        if detail == Detail::Far {
            s.tube(&[(joint, 0.06), (hand, 0.04)], 3, false, m.top);
            let knee = to(seat.knees[i]);
            s.bone = if pedals { 1 + i as u8 } else { 0 };
            s.tube(&[([hip[0], side * 0.095, hip[2]], 0.09), (knee, 0.06)], 3, false, m.legs);
            s.bone = if pedals { 3 + i as u8 } else { 0 };
            s.tube(&[(knee, 0.06), (to(seat.feet[i]), 0.05)], 3, false, m.legs);
            s.bone = 0;
            continue;
        }
        limb(s, &[(joint, 0.062), (elbow, 0.047), (hand, 0.036)], sides.min(8), m.top);
        if near {
            s.ball(hand, [0.05, 0.035, 0.035], (3, 6), (-1.0, 1.0), m.skin);
        }
        let (knee, foot) = (to(seat.knees[i]), to(seat.feet[i]));
        let thigh = [hip[0], side * 0.095, hip[2] - 0.02];
        s.bone = if pedals { 1 + i as u8 } else { 0 };
        limb(s, &[(thigh, 0.092), (mix(thigh, knee, 0.5), 0.082), (knee, 0.062)], sides.min(8), m.legs);
        s.bone = if pedals { 3 + i as u8 } else { 0 };
        limb(s, &[(knee, 0.062), (mix(knee, foot, 0.35), 0.060), (foot, 0.043)], sides.min(8), m.legs);
        if detail != Detail::Far {
            s.ball(
                add(foot, [0.06, 0.0, -0.03]),
                [0.14, 0.048, 0.045],
                if near { (4, 8) } else { (2, 5) },
                (-1.0, 1.0),
                m.shoes,
            );
        }
        s.bone = 0;
    }
}
