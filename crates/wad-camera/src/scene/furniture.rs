//! Street lamps, benches, bins, bus shelters, signs: small things that are placed many times.

use super::materials::Materials;
use crate::model::{Channel, LIMITS, Level, Library, MaterialId, Model, ModelId, Sign};
use crate::shape::{Shaper, V3, bounds_of};
use std::f32::consts::TAU;

/// Their models. x is towards the road.
#[derive(Clone, Debug)]
pub(super) struct Furniture {
    pub lamp: ModelId,
    pub bench: ModelId,
    pub bin: ModelId,
    pub shelter: ModelId,
    /// A post with a plate for each sign, by [`crate::model::Sign::index`].
    pub signs: Vec<ModelId>,
    pub priority: ModelId,
    pub crossing: ModelId,
    pub signal: ModelId,
    pub pedestrian_signal: ModelId,
}

/// Length (m) of a bench, and its height.
pub(super) const BENCH: [f64; 3] = [0.62, 1.8, 0.85];
/// Sizes of a signal head (m): depth, width, height.
pub(super) const HEAD: [f64; 3] = [0.30, 0.40, 1.06];
/// Sizes of a pedestrians' head (m).
pub(super) const SMALL_HEAD: [f64; 3] = [0.22, 0.30, 0.62];
/// Height of a lamp's light (m), and how far it reaches out.
const LAMP_HEIGHT: f64 = 7.0;
const LAMP_REACH: f64 = 1.9;

fn made(
    library: &mut Library,
    name: &str,
    crease: f32,
    pixels: &[f32],
    build: impl Fn(&mut Shaper, usize),
) -> ModelId {
    let levels: Vec<Level> = pixels
        .iter()
        .enumerate()
        .map(|(level, &min_pixels)| {
            let mut s = Shaper::new(crease);
            build(&mut s, level);
            Level { mesh: s.finish(), min_pixels }
        })
        .collect();
    let bounds = bounds_of([&levels[0].mesh]);
    library.model(Model { name: name.to_string(), levels, bounds, casts_shadow: true, ..Model::default() })
}

/// A flat disc with `n` corners that faces -x (towards the traffic), `turn` in turns.
fn disc(s: &mut Shaper, x: f32, z: f32, radius: f32, n: usize, turn: f32, material: MaterialId) {
    let ring: Vec<V3> = (0..n)
        .map(|i| {
            let (sin, cos) = ((i as f32 / n as f32 + turn) * TAU).sin_cos();
            [x, -radius * cos, z + radius * sin]
        })
        .collect();
    s.cap(&ring, material);
}

fn disc_back(s: &mut Shaper, x: f32, z: f32, radius: f32, n: usize, turn: f32, material: MaterialId) {
    let ring: Vec<V3> = (0..n)
        .map(|i| {
            let (sin, cos) = ((i as f32 / n as f32 + turn) * TAU).sin_cos();
            [x, radius * cos, z + radius * sin]
        })
        .collect();
    s.cap(&ring, material);
}

/// The strokes of a digit in a box of 1 x 2: left, low, right, high.
fn strokes(digit: u32) -> Vec<[f32; 4]> {
    const T: f32 = 0.26;
    let all = [
        [0.0, 2.0 - T, 1.0, 2.0],
        [1.0 - T, 1.0, 1.0, 2.0],
        [1.0 - T, 0.0, 1.0, 1.0],
        [0.0, 0.0, 1.0, T],
        [0.0, 0.0, T, 1.0],
        [0.0, 1.0, T, 2.0],
        [0.0, 1.0 - 0.5 * T, 1.0, 1.0 + 0.5 * T],
    ];
    let lit = [0x3f, 0x06, 0x5b, 0x4f, 0x66, 0x6d, 0x7d, 0x07, 0x7f, 0x6f][digit as usize % 10];
    (0..7).filter(|i| lit >> i & 1 == 1).map(|i| all[i]).collect()
}

/// Height of a sign's middle (m).
pub const SIGN: f32 = 2.35;

fn post(s: &mut Shaper, m: &Materials, level: usize) {
    s.tube(
        &[([0.05, 0.0, 0.0], 0.032), ([0.05, 0.0, SIGN + 0.25], 0.032)],
        [6, 3][level.min(1)],
        false,
        m.pole,
    );
}

/// Levels of small things: near, and from afar.
const SMALL: [f32; 2] = [26.0, 3.0];

impl Furniture {
    pub fn new(library: &mut Library, m: &Materials) -> Self {
        let lamp = made(library, "street lamp", 50.0, &[50.0, 6.0], |s, level| {
            let sides = [8, 3][level];
            let top = LAMP_HEIGHT as f32;
            s.tube(
                &[
                    ([0.0; 3], 0.10),
                    ([0.0, 0.0, 1.0], 0.085),
                    ([0.0, 0.0, 1.05], 0.065),
                    ([0.0, 0.0, top - 0.4], 0.05),
                ],
                sides,
                false,
                m.pole,
            );
            s.tube(
                &[
                    ([0.0, 0.0, top - 0.42], 0.05),
                    ([0.4, 0.0, top - 0.05], 0.04),
                    ([1.3, 0.0, top + 0.08], 0.035),
                ],
                sides,
                false,
                m.pole,
            );
            s.cuboid([1.2, -0.13, top], [2.0, 0.13, top + 0.12], false, m.pole);
            s.plate(
                [
                    [1.25, 0.11, top - 0.01],
                    [1.95, 0.11, top - 0.01],
                    [1.95, -0.11, top - 0.01],
                    [1.25, -0.11, top - 0.01],
                ],
                m.lamp_glass,
            );
        });
        if let Some(model) = library.models.get_mut(usize::from(lamp.0)) {
            model
                .glows
                .push(([LAMP_REACH as f32 - 0.3, 0.0, LAMP_HEIGHT as f32 - 0.05], Channel::StreetLamp));
        }
        let bench = made(library, "bench", 30.0, &SMALL, |s, level| {
            let w = 0.5 * BENCH[1] as f32;
            for x in [-0.12, 0.04, 0.20] {
                s.cuboid([x - 0.065, -w, 0.42], [x + 0.065, w, 0.46], true, m.wood);
            }
            for z in [0.56, 0.72] {
                s.cuboid([-0.28, -w, z], [-0.24, w, z + 0.11], true, m.wood);
            }
            if level == 0 {
                for y in [-0.8 * w, 0.8 * w] {
                    s.cuboid([-0.26, y - 0.03, 0.0], [-0.20, y + 0.03, 0.84], false, m.iron);
                    s.cuboid([0.18, y - 0.03, 0.0], [0.24, y + 0.03, 0.42], false, m.iron);
                    s.cuboid([-0.26, y - 0.03, 0.38], [0.26, y + 0.03, 0.42], true, m.iron);
                }
            }
        });
        let bin = made(library, "bin", 50.0, &SMALL, |s, level| {
            let sides = [10, 5][level];
            s.tube(
                &[
                    ([0.0, 0.0, 0.05], 0.2),
                    ([0.0, 0.0, 0.82], 0.24),
                    ([0.0, 0.0, 0.88], 0.25),
                    ([0.0, 0.0, 0.95], 0.14),
                ],
                sides,
                true,
                m.bin,
            );
        });
        let shelter = made(library, "bus shelter", 30.0, &[40.0, 8.0], |s, level| {
            // Open towards the road (+x).
            let (w, d, h) = (2.0, 0.7, 2.4);
            s.cuboid([-d, -w, h], [d, w, h + 0.14], true, m.shelter);
            for (x, y) in
                [(-d + 0.06, -w + 0.06), (-d + 0.06, w - 0.06), (d - 0.06, -w + 0.06), (d - 0.06, w - 0.06)]
            {
                s.cuboid([x - 0.04, y - 0.04, 0.0], [x + 0.04, y + 0.04, h], false, m.shelter);
            }
            s.cuboid([-d + 0.03, -w + 0.1, 0.25], [-d + 0.06, w - 0.1, h - 0.1], true, m.glass);
            s.cuboid([-d + 0.1, -w + 0.02, 0.25], [d - 0.3, -w + 0.05, h - 0.1], true, m.glass);
            if level == 0 {
                s.cuboid([-d + 0.14, -1.2, 0.44], [-d + 0.5, 1.2, 0.49], true, m.wood);
                s.cuboid([-d + 0.1, w - 0.1, 0.3], [d - 0.35, w - 0.04, 2.1], true, m.sign_blue);
            }
        });
        let mut signs: Vec<ModelId> = LIMITS
            .into_iter()
            .map(|limit: u32| {
                made(library, "speed limit", 30.0, &SMALL, |s, level| {
                    post(s, m, level);
                    let (n, radius) = ([20, 8][level], Sign::Limit(limit).radius());
                    disc(s, 0.0, SIGN, radius, n, 0.0, m.sign_red);
                    disc_back(s, 0.015, SIGN, radius, n, 0.0, m.sign_back);
                    disc(s, -0.008, SIGN, 0.25, n, 0.0, m.sign_white);
                    let text = limit.to_string();
                    let (w, gap) = (0.115, 0.045);
                    let whole = text.len() as f32 * (w + gap) - gap;
                    for (i, c) in text.chars().enumerate() {
                        let left = -0.5 * whole + i as f32 * (w + gap);
                        for [a, b, c, d] in strokes(c.to_digit(10).unwrap_or(0)) {
                            // Seen from ahead, y runs to the left.
                            let (y0, y1) = (-(left + a * w), -(left + c * w));
                            let (z0, z1) = (SIGN + (b - 1.0) * 0.115, SIGN + (d - 1.0) * 0.115);
                            let x = -0.014;
                            s.plate([[x, y0, z0], [x, y1, z0], [x, y1, z1], [x, y0, z1]], m.sign_black);
                        }
                    }
                })
            })
            .collect();
        let sign = |library: &mut Library, name: &str, parts: Vec<(f32, usize, f32, MaterialId)>| {
            made(library, name, 30.0, &SMALL, |s, level| {
                post(s, m, level);
                for (i, &(radius, corners, turn, material)) in parts.iter().enumerate() {
                    let n = if corners > 8 && level > 0 { 8 } else { corners };
                    disc(s, -0.006 * i as f32, SIGN, radius, n, turn, material);
                    if i == 0 {
                        disc_back(s, 0.015, SIGN, radius, n, turn, m.sign_back);
                    }
                }
            })
        };
        signs.extend([
            sign(
                library,
                "give way",
                vec![(Sign::GiveWay.radius(), 3, 0.75, m.sign_red), (0.33, 3, 0.75, m.sign_white)],
            ),
            sign(
                library,
                "stop",
                vec![(Sign::Stop.radius(), 8, 0.0625, m.sign_white), (0.37, 8, 0.0625, m.sign_red)],
            ),
        ]);
        let priority =
            sign(library, "priority", vec![(0.42, 4, 0.0, m.sign_white), (0.31, 4, 0.0, m.sign_yellow)]);
        let crossing = made(library, "crossing sign", 30.0, &SMALL, |s, level| {
            post(s, m, level);
            disc(s, 0.0, SIGN, 0.44, 4, 0.125, m.sign_blue);
            disc_back(s, 0.015, SIGN, 0.44, 4, 0.125, m.sign_back);
            disc(s, -0.006, SIGN - 0.03, 0.25, 3, 0.25, m.sign_white);
        });
        let signal = made(library, "signal head", 50.0, &[14.0, 2.0], |s, level| head(s, m, level, false));
        let pedestrian_signal =
            made(library, "pedestrians' signal", 50.0, &[14.0, 2.0], |s, level| head(s, m, level, true));
        for (id, lamps) in [(signal, 3), (pedestrian_signal, 2)] {
            if let Some(model) = library.models.get_mut(usize::from(id.0)) {
                model.casts_shadow = false;
                let [depth, _, _] = if lamps == 3 { HEAD } else { SMALL_HEAD };
                let x = -0.5 * depth as f32 - 0.02;
                let channels = if lamps == 3 {
                    vec![
                        (0.86, Channel::SignalRed),
                        (0.53, Channel::SignalYellow),
                        (0.20, Channel::SignalGreen),
                    ]
                } else {
                    vec![(0.46, Channel::SignalRed), (0.17, Channel::SignalGreen)]
                };
                model.glows = channels.into_iter().map(|(z, c)| ([x, 0.0, z], c)).collect();
            }
        }
        Self { lamp, bench, bin, shelter, signs, priority, crossing, signal, pedestrian_signal }
    }
}

/// A signal head that faces -x: case, back plate, lamps with visors. Its bottom is at z = 0.
fn head(s: &mut Shaper, m: &Materials, level: usize, small: bool) {
    let size = if small { SMALL_HEAD } else { HEAD };
    let [depth, width, height] = size.map(|v| v as f32);
    // Visors stand out in front of the case.
    let visor = 0.14;
    let (front, back) = (-0.5 * depth + visor, 0.5 * depth);
    let w = 0.5 * width;
    s.cuboid([front, -w + 0.04, 0.0], [back, w - 0.04, height], true, m.head_case);
    if !small {
        s.cuboid([front + 0.02, -w, -0.02], [front + 0.04, w, height + 0.02], true, m.head_case);
    }
    let lamps: &[(f32, MaterialId)] = if small {
        &[(0.46, m.red), (0.17, m.green)]
    } else {
        &[(0.86, m.red), (0.53, m.yellow), (0.20, m.green)]
    };
    let radius = if small { 0.10 } else { 0.125 };
    let n = [14, 6][level];
    for &(z, material) in lamps {
        disc(s, front - 0.006, z, radius, n, 0.0, material);
        if level > 0 {
            continue;
        }
        // A half tube over each lamp.
        let arc = |x: f32| -> Vec<V3> {
            (0..=8)
                .map(|i| {
                    let (sin, cos) = ((i as f32 / 8.0 * 0.56 - 0.03) * TAU).sin_cos();
                    [x, -(radius + 0.012) * cos, z + (radius + 0.012) * sin]
                })
                .collect()
        };
        let (near, far) = (arc(front), arc(front - visor));
        for k in 0..8 {
            let q = [near[k], far[k], far[k + 1], near[k + 1]];
            s.plate(q, m.head_rim);
            s.plate([q[3], q[2], q[1], q[0]], m.head_rim);
        }
    }
}
