//! Barriers and cones that close a lane.

use super::palette::ObjectPalette;
use crate::shape::Shaper;

/// Sizes (m) of the barrier as it is built: along the lane, across, height.
pub(super) const BARRIER: [f32; 3] = [0.5, 2.4, 1.0];
/// Sizes (m) of the cone as it is built.
pub(super) const CONE: [f32; 3] = [0.4, 0.4, 0.75];

/// Two striped boards on feet, a lamp at each end. It faces -x, towards the traffic.
pub(super) fn barrier(s: &mut Shaper, m: &ObjectPalette, stripes: usize) {
    let w = 0.5 * BARRIER[1];
    for y in [-0.8 * w, 0.8 * w] {
        s.cuboid([-0.25, y - 0.1, 0.0], [0.25, y + 0.1, 0.1], false, m.foot);
        s.cuboid([-0.03, y - 0.03, 0.1], [0.03, y + 0.03, 0.98], false, m.white);
    }
    let step = BARRIER[1] / stripes as f32;
    for (z0, z1) in [(0.28, 0.5), (0.68, 0.92)] {
        for i in 0..stripes {
            let y = -w + step * i as f32;
            let material = if i % 2 == 0 { m.red } else { m.white };
            s.cuboid([-0.06, y, z0], [-0.03, y + step, z1], true, material);
        }
    }
    for y in [-0.8 * w, 0.8 * w] {
        s.cuboid([-0.05, y - 0.07, 0.92], [0.05, y + 0.07, 1.0], true, m.lamp);
    }
}

/// A cone with a white collar.
pub(super) fn cone(s: &mut Shaper, m: &ObjectPalette, sides: usize) {
    let h = 0.5 * CONE[0];
    s.cuboid([-h, -h, 0.0], [h, h, 0.04], true, m.foot);
    let radius = |z: f32| 0.15 - 0.12 * z / CONE[2];
    for (z0, z1, material) in [(0.04, 0.28, m.red), (0.28, 0.48, m.white), (0.48, CONE[2], m.red)] {
        s.tube(&[([0.0, 0.0, z0], radius(z0)), ([0.0, 0.0, z1], radius(z1))], sides, true, material);
    }
}
