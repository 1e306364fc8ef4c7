//! Bodies of cars and vans as lofts of cross-sections along the length.
//!
//! A section is half an outline, from the middle of the floor over the sill, the shoulder and the roof's
//! edge to the middle of the roof; the other half mirrors it. Sections rise over the wheels, which makes
//! the arches.

use super::palette::VehiclePalette;
use super::wheel::wheel;
use crate::model::MaterialId;
use crate::shape::{Shaper, V3, mix};

/// The lines of a body seen from the side and from above (m); x is forward from the middle.
#[derive(Clone, Debug)]
pub(super) struct BodyLines {
    pub length: f32,
    pub width: f32,
    pub height: f32,
    /// Height of the floor above the ground.
    pub floor: f32,
    /// Height of the bonnet's front and rear end, and of the shoulder line at the cabin's rear.
    pub nose: f32,
    pub cowl: f32,
    pub shoulder: f32,
    /// Height of the boot lid's rear end.
    pub tail: f32,
    /// Where the windscreen begins and the roof begins and ends, and where the rear window ends (x).
    pub screen: f32,
    pub roof_front: f32,
    pub roof_rear: f32,
    pub deck: f32,
    /// Axles (x), radius and width of the wheels.
    pub front_axle: f32,
    pub rear_axle: f32,
    pub wheel: f32,
    pub tyre: f32,
    /// Half width of the roof over half width of the body.
    pub roof_width: f32,
    /// Where the window pillars stand (x), front to rear; between them is glass.
    pub pillars: &'static [f32],
    /// A panel instead of glass behind the last pillar.
    pub panel_van: bool,
}

const SECTION: usize = 10;

/// One cross-section: half outline (y, z), and what is there.
#[derive(Clone, Debug)]
struct Section {
    x: f32,
    half: [[f32; 2]; SECTION],
}

fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t.clamp(0.0, 1.0)
}

fn smooth(t: f32) -> f32 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl BodyLines {
    /// Height of the upper surface in the middle, at `x`.
    fn top(&self, x: f32) -> f32 {
        let front = 0.5 * self.length;
        if x >= self.screen {
            let t = (front - x) / (front - self.screen);
            // The bonnet falls steeply at the very front.
            lerp(self.nose, self.cowl, t.powf(0.62))
        } else if x >= self.roof_front {
            let t = (self.screen - x) / (self.screen - self.roof_front);
            lerp(self.cowl, self.height - 0.05, t) + 0.035 * (t * std::f32::consts::PI).sin()
        } else if x >= self.roof_rear {
            let t = (self.roof_front - x) / (self.roof_front - self.roof_rear);
            self.height - 0.05 * (2.0 * t - 0.85).powi(2).min(1.0) * 0.9
        } else if x >= self.deck {
            let t = (self.roof_rear - x) / (self.roof_rear - self.deck);
            lerp(self.height - 0.055, self.deck_height(), t) + 0.03 * (t * std::f32::consts::PI).sin()
        } else {
            let t = (self.deck - x) / (self.deck + front).max(0.01);
            lerp(self.deck_height(), self.tail, t.powf(1.5))
        }
    }

    fn deck_height(&self) -> f32 {
        self.shoulder + 0.04
    }

    /// Height of the shoulder line (window sills) at `x`.
    fn belt(&self, x: f32) -> f32 {
        let t = (self.screen - x) / (self.screen - self.roof_rear);
        lerp(self.cowl - 0.05, self.shoulder, t).min(self.top(x) - 0.03)
    }

    /// Half width at `x`: rounded in plan at both ends.
    fn half_width(&self, x: f32) -> f32 {
        let front = 0.5 * self.length;
        // Room for the mirrors within the type's width.
        let full = 0.5 * self.width - 0.035;
        let round = |from_end: f32, depth: f32, by: f32| {
            let t = (from_end / depth).clamp(0.0, 1.0);
            1.0 - by * (1.0 - t).powi(2)
        };
        full * round(front - x, 0.75, 0.17) * round(x + front, 0.7, 0.12)
    }

    /// How high the wheel arches lift the sill at `x`; 0 away from them.
    fn arch(&self, x: f32) -> f32 {
        let radius = self.wheel + 0.055;
        [self.front_axle, self.rear_axle]
            .into_iter()
            .map(|axle| {
                let d = (x - axle) / radius;
                if d.abs() >= 1.0 { 0.0 } else { self.wheel + radius * (1.0 - d * d).sqrt() }
            })
            .fold(0.0, f32::max)
    }

    fn section(&self, x: f32) -> Section {
        let front = 0.5 * self.length;
        let w = self.half_width(x);
        let top = self.top(x);
        let belt = self.belt(x);
        // Bumpers curve up from below.
        let end = ((front - x.abs()) / 0.32).clamp(0.0, 1.0);
        let floor = self.floor + 0.10 * (1.0 - end).powi(2);
        let arch = self.arch(x);
        let sill = floor.max(arch);
        let mid = lerp(sill, belt, 0.52).max(sill + 0.02);
        // How much of a cabin rises over the shoulder here.
        let cabin = smooth((top - belt - 0.03) / 0.25);
        let rise = ((top - belt - 0.05) / (self.height - self.shoulder)).clamp(0.0, 1.0);
        let roof = lerp(0.93, self.roof_width, rise) * w;
        let edge = top - lerp(0.012, 0.07, cabin);
        // Beside a window the roof's rail is as narrow as a pillar.
        let sloped = x >= self.roof_front || x <= self.roof_rear;
        Section {
            x,
            half: [
                [0.0, floor.max(arch)],
                [0.74 * w, floor.max(arch)],
                [lerp(0.95, 0.985, arch * 4.0) * w, sill + 0.015],
                [0.992 * w, lerp(sill, mid, 0.55)],
                [w, mid],
                [0.99 * w, lerp(mid, belt, 0.62)],
                [0.955 * w, belt],
                [lerp(0.945 * w, roof, 0.97), lerp(belt + 0.012, edge, 0.985).max(belt + 0.005)],
                [roof * lerp(0.72, if sloped { 0.93 } else { 0.80 }, cabin), top - lerp(0.006, 0.012, cabin)],
                [0.0, top],
            ],
        }
    }

    /// Where sections are needed: the ends, the arches, the pillars.
    fn stations(&self, fine: bool) -> Vec<f32> {
        let front = 0.5 * self.length;
        let mut xs: Vec<f32> = Vec::new();
        if fine {
            xs.extend([front, front - 0.03, front - 0.10, front - 0.24, front - 0.42]);
            xs.extend([-front, -front + 0.025, -front + 0.09, -front + 0.22]);
            let radius = self.wheel + 0.055;
            for axle in [self.front_axle, self.rear_axle] {
                for d in [-1.001, -0.985, -0.85, -0.55, 0.0, 0.55, 0.85, 0.985, 1.001] {
                    xs.push(axle + d * radius);
                }
            }
            xs.push(0.5 * (self.screen + self.roof_front));
            xs.push(self.last_side_window());
            xs.push(0.45 * self.roof_rear + 0.55 * self.deck);
        } else {
            xs.extend([front, front - 0.15, -front, -front + 0.12]);
        }
        xs.extend([self.screen, self.roof_front, self.roof_rear, self.deck]);
        for &p in self.pillars {
            if fine {
                xs.extend([p + 0.04, p - 0.04]);
            }
        }
        xs.retain(|x| x.abs() <= front + 1e-4);
        xs.sort_by(f32::total_cmp);
        xs.dedup_by(|a, b| (*a - *b).abs() < 0.003);
        xs
    }

    /// Where the side windows end before the rear pillar (x).
    fn last_side_window(&self) -> f32 {
        0.72 * self.roof_rear + 0.28 * self.deck
    }

    fn is_pillar(&self, x: f32) -> bool {
        self.pillars.iter().any(|p| (x - p).abs() < 0.06)
    }

    /// The body without wheels.
    pub fn body(&self, s: &mut Shaper, m: &VehiclePalette, fine: bool) {
        let sections: Vec<Section> = self.stations(fine).iter().map(|&x| self.section(x)).collect();
        let keep: &[usize] = if fine { &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9] } else { &[0, 2, 4, 6, 7, 9] };
        // Rear to front; up the left side, over the roof, down the right: counter-clockwise from ahead.
        let ring = |section: &Section| -> Vec<V3> {
            let point = |side: f32, i: usize| [section.x, side * section.half[i][0], section.half[i][1]];
            let left = keep.iter().map(|&i| point(1.0, i));
            let right = keep[1..keep.len() - 1].iter().rev().map(|&i| point(-1.0, i));
            left.chain(right).collect()
        };
        let rings: Vec<Vec<V3>> = sections.iter().map(ring).collect();
        let n = rings[0].len();
        let h = keep.len();
        // Which gap of the half section a face is in, from whichever side.
        let gap = |j: usize| if j < h - 1 { keep[j] } else { keep[n - 1 - j] };
        let front = 0.5 * self.length;
        s.loft(&rings, |i, j| {
            let (x0, x1) = (sections[i].x, sections[i + 1].x);
            let x = 0.5 * (x0 + x1);
            let g = gap(j);
            let lifted = self.arch(x0).max(self.arch(x1)) > self.floor;
            Some(self.material(m, x, g, lifted, fine, front))
        });
        self.end(s, m, &sections[sections.len() - 1], true, fine);
        self.end(s, m, &sections[0], false, fine);
    }

    fn material(
        &self,
        m: &VehiclePalette,
        x: f32,
        gap: usize,
        lifted: bool,
        fine: bool,
        front: f32,
    ) -> MaterialId {
        let from_front = front - x;
        let from_rear = front + x;
        match gap {
            0 => m.underside,
            1 => {
                if lifted {
                    m.underside
                } else {
                    m.black
                }
            }
            2 if fine && !lifted => m.black,
            // Lamps wrap round the corners.
            5 if fine && from_front < 0.30 && from_front > 0.03 => m.head,
            5 if fine && from_rear < 0.20 && self.tail > self.shoulder - 0.3 => m.tail,
            6 if self.panel_van && x < self.pillars.last().copied().unwrap_or(0.0) => m.paint,
            6 if x < self.screen - 0.10
                && x > self.last_side_window()
                && self.top(x) > self.belt(x) + 0.12 =>
            {
                if fine && self.is_pillar(x) {
                    m.black
                } else {
                    m.glass
                }
            }
            // The pillars beside windscreen and rear window keep the body's colour.
            7 | 8 if x < self.screen && x > self.roof_front => {
                if gap == 7 {
                    m.paint
                } else {
                    m.glass
                }
            }
            8 if !self.panel_van && x < self.roof_rear && x > self.deck => m.glass,
            _ => m.paint,
        }
    }

    /// The flat end of the body with its lamps, grille, bumper.
    fn end(&self, s: &mut Shaper, m: &VehiclePalette, section: &Section, is_front: bool, fine: bool) {
        let half = &section.half;
        let columns: &[f32] =
            if fine { &[-1.0, -0.60, -0.42, 0.42, 0.60, 1.0] } else { &[-1.0, -0.5, 0.5, 1.0] };
        let row: &[usize] = if fine { &[1, 2, 3, 4, 5, 6, 9] } else { &[2, 4, 6, 9] };
        let at = |i: usize, c: f32| -> V3 {
            let [y, z] = if i == 9 { [half[8][0] * 0.8, half[9][1]] } else { half[i] };
            [section.x, c * y, z]
        };
        let grid: Vec<Vec<u32>> =
            row.iter().map(|&i| columns.iter().map(|&c| s.point(at(i, c))).collect()).collect();
        for r in 0..row.len() - 1 {
            for c in 0..columns.len() - 1 {
                let outer = c == 0 || c == columns.len() - 2;
                let middle = columns[c] < 0.0 && columns[c + 1] > 0.0;
                let left = columns[c] > 0.0;
                let blink = if left { m.blink_left } else { m.blink_right };
                let gap = row[r];
                let material = match (is_front, gap) {
                    (true, 1) => m.black,
                    (true, 2) => {
                        if middle {
                            m.black
                        } else {
                            m.paint
                        }
                    }
                    (true, 3) => {
                        if outer && fine {
                            blink
                        } else {
                            m.paint
                        }
                    }
                    (true, 4) => {
                        if middle {
                            m.black
                        } else {
                            m.paint
                        }
                    }
                    (true, 5) => {
                        if middle {
                            m.black
                        } else {
                            m.head
                        }
                    }
                    (false, 1 | 2) => m.black,
                    (false, 4) if fine && outer => blink,
                    (false, 5) if outer || !fine && !middle => m.brake,
                    _ => m.paint,
                };
                let q = [grid[r][c], grid[r][c + 1], grid[r + 1][c + 1], grid[r + 1][c]];
                if is_front {
                    s.quad(q, material);
                } else {
                    s.quad([q[1], q[0], q[3], q[2]], material);
                }
            }
        }
    }

    /// Plates, mirrors, handles, lamps that are not part of the surface.
    pub fn fittings(&self, s: &mut Shaper, m: &VehiclePalette) {
        let front = 0.5 * self.length;
        let section = self.section(front);
        let bumper = mix([0.0, 0.0, section.half[2][1]], [0.0, 0.0, section.half[3][1]], 0.8)[2];
        let plate = |s: &mut Shaper, x: f32, z: f32, side: f32| {
            let (w, h) = (0.26, 0.055);
            s.plate(
                [[x, -side * w, z - h], [x, side * w, z - h], [x, side * w, z + h], [x, -side * w, z + h]],
                m.plate,
            );
        };
        plate(s, front - 0.002, bumper, 1.0);
        let rear = self.section(-front);
        plate(s, -front + 0.002 - 0.008, 0.5 * (rear.half[4][1] + rear.half[5][1]), -1.0);
        // Third brake lamp at the rear window's upper edge.
        let (x, z) = (self.roof_rear - 0.05, self.top(self.roof_rear - 0.05) + 0.004);
        s.plate(
            [
                [x - 0.05, 0.17, z - 0.03],
                [x - 0.05, -0.17, z - 0.03],
                [x, -0.17, z + 0.006],
                [x, 0.17, z + 0.006],
            ],
            m.brake,
        );
        // Mirrors, within the type's width.
        let x = self.screen - 0.32;
        let (y, z) = (0.5 * self.width, self.belt(x) + 0.10);
        for side in [-1.0, 1.0_f32] {
            let (a, b) = (side * (y - 0.19), side * y);
            s.cuboid([x - 0.06, a.min(b), z - 0.065], [x + 0.05, a.max(b), z + 0.065], true, m.paint);
            let (a, b) = (side * (y - 0.17), side * (y - 0.015));
            let (lo, hi) = (a.min(b), a.max(b));
            s.plate(
                [
                    [x - 0.063, hi, z - 0.05],
                    [x - 0.063, lo, z - 0.05],
                    [x - 0.063, lo, z + 0.05],
                    [x - 0.063, hi, z + 0.05],
                ],
                m.chrome,
            );
            // Door handles and the seam of the doors.
            let w = side * (self.half_width(0.0) + 0.002);
            for &p in self.pillars.iter().skip(1).take(2) {
                let z = self.belt(p) - 0.10;
                let mut handle =
                    [[p + 0.12, w, z], [p + 0.30, w, z], [p + 0.30, w, z + 0.03], [p + 0.12, w, z + 0.03]];
                if side > 0.0 {
                    handle.reverse();
                }
                s.plate(handle, m.chrome);
            }
        }
    }

    /// The four wheels, each on its own bone (1..=4) where `spin`.
    pub fn wheels(&self, s: &mut Shaper, m: &VehiclePalette, sides: usize, spin: bool) {
        let mut bone = 0;
        for axle in [self.front_axle, self.rear_axle] {
            for side in [1.0, -1.0_f32] {
                bone += 1;
                s.bone = if spin { bone } else { 0 };
                let y = side * (self.half_width(axle) * 0.985 - 0.5 * self.tyre);
                wheel(s, m, [axle, y, self.wheel], self.wheel, self.tyre, side, sides);
            }
        }
        s.bone = 0;
    }

    /// The wheels' axles, for the bones of [`Self::wheels`].
    pub fn axles(&self) -> [[f32; 3]; 4] {
        let at = |x: f32, y: f32| [x, y, self.wheel];
        [
            at(self.front_axle, 0.8),
            at(self.front_axle, -0.8),
            at(self.rear_axle, 0.8),
            at(self.rear_axle, -0.8),
        ]
    }

    /// A box with a cabin, for where few pixels remain.
    pub fn far(&self, s: &mut Shaper, m: &VehiclePalette) {
        let front = 0.5 * self.length;
        let w = 0.5 * self.width - 0.03;
        let ring = |x: f32, w: f32, lo: f32, hi: f32| -> Vec<V3> {
            vec![[x, -w, lo], [x, w, lo], [x, w * 0.96, hi], [x, -w * 0.96, hi]]
        };
        let floor = self.floor + 0.02;
        let rings = [
            ring(-front, 0.88 * w, floor, self.tail),
            ring(-front + 0.3, w, floor, self.deck_height()),
            ring(self.screen, w, floor, self.cowl - 0.03),
            ring(front, 0.84 * w, floor, self.nose),
        ];
        s.loft(&rings, |_, j| Some(if j == 0 { m.underside } else { m.paint }));
        s.cap(&rings[3], m.black);
        let mut rear = rings[0].clone();
        rear.reverse();
        s.cap(&rear, m.brake);
        let belt = self.shoulder - 0.02;
        let r = self.roof_width * w;
        let base = [
            [self.deck.max(-front + 0.02), -0.93 * w, belt],
            [self.screen, -0.93 * w, belt],
            [self.screen, 0.93 * w, belt],
            [self.deck.max(-front + 0.02), 0.93 * w, belt],
        ];
        let roof = [
            [self.roof_rear, -r, self.height],
            [self.roof_front, -r, self.height],
            [self.roof_front, r, self.height],
            [self.roof_rear, r, self.height],
        ];
        s.loft(&[base.to_vec(), roof.to_vec()], |_, j| {
            Some(if self.panel_van && j != 1 { m.paint } else { m.glass })
        });
        s.cap(&roof, m.paint);
        for axle in [self.front_axle, self.rear_axle] {
            for side in [-1.0, 1.0_f32] {
                let (y, r) = (side * (w + 0.005), self.wheel);
                let mut p = [
                    [axle - r, y, 0.02],
                    [axle + r, y, 0.02],
                    [axle + 0.7 * r, y, 1.8 * r],
                    [axle - 0.7 * r, y, 1.8 * r],
                ];
                if side > 0.0 {
                    p.reverse();
                }
                s.plate(p, m.tyre);
            }
        }
    }
}
