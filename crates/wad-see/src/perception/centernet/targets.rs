//! The network's training targets for a picture (Zhou et al. 2019, section 3).

use super::kind::{Backbone, STRIDE};

/// A target box, or a box that does not count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// Index in [`crate::perception::coco::CLASSES`].
    pub class: usize,
    /// Left, top, right, bottom (pixels).
    pub bounds: [f32; 4],
    /// Too small or too hidden: neither object nor background.
    pub ignored: bool,
}

/// The heatmap's value of cells that do not count.
pub const NO_MATTER: f32 = -1.0;

/// A centre: where it is, what it is, and its numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Centre {
    /// y * width + x of the cell.
    pub cell: usize,
    /// Width and height in cells.
    pub size: [f32; 2],
    /// x and y from the cell's corner, in cells.
    pub offset: [f32; 2],
}

/// Overlap that a box keeps with the truth when its corners are off by the radius (CornerNet's 0.7).
const KEPT_IOU: f32 = 0.7;

/// The part of a picture that the network gets (pixels; the sides are multiples of 32).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub left: usize,
    /// First row.
    pub top: usize,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
}

/// Least share of a box's width and height inside the window for the box to be a target there.
const KEPT: [f32; 2] = [0.4, 0.9];

impl Window {
    /// The part of a picture that the backbone sees.
    pub fn whole(backbone: Backbone, (width, height): (usize, usize)) -> Self {
        let (top, height) = backbone.rows(height);
        Self { left: 0, top, width, height }
    }

    /// Width and height of the heatmap.
    pub fn cells(&self) -> (usize, usize) {
        (self.width / STRIDE, self.height / STRIDE)
    }

    /// A box of the picture as this window shows it; None where it is outside. What sticks out at the
    /// sides is cut off, as it is at the picture's. A box of which too little is left does not count.
    /// `cuts_rows` says whether the window leaves out rows that the backbone sees in use: those boxes do not
    /// count either.
    pub fn view(&self, one: &Wanted, cuts_rows: bool) -> Option<Wanted> {
        let [l, t, r, b] = one.bounds;
        let (l, r) = (l - self.left as f32, r - self.left as f32);
        let (t, b) = (t - self.top as f32, b - self.top as f32);
        let inside = |low: f32, high: f32, end: usize| high.min(end as f32) - low.max(0.0);
        let (wide, high) = (inside(l, r, self.width), inside(t, b, self.height));
        if wide <= 0.0 || high <= 0.0 {
            return None;
        }
        let is_cut = wide < KEPT[0] * (r - l) || (cuts_rows && high < KEPT[1] * (b - t));
        let bounds = [l.max(0.0), t, r.min(self.width as f32), b];
        Some(Wanted { bounds, ignored: one.ignored || is_cut, ..*one })
    }
}

/// The heatmap, classes x h x w written over `heat`, and the centres of boxes in the coordinates of a
/// window of (w, h) cells. `reach` says of a box of some cells how far its peak reaches: [`shares`] or [`corners`].
pub fn encode(
    wanted: &[Wanted],
    (w, h): (usize, usize),
    heat: &mut [f32],
    reach: impl Fn([f32; 2]) -> [usize; 2],
) -> Vec<Centre> {
    heat.fill(0.0);
    let cells = |bounds: [f32; 4]| bounds.map(|v| v / STRIDE as f32);
    for one in wanted.iter().filter(|o| o.ignored) {
        let [l, t, r, b] = cells(one.bounds);
        let plane = &mut heat[one.class * w * h..][..w * h];
        for y in (t.floor().max(0.0) as usize)..(b.ceil().max(0.0) as usize).min(h) {
            for x in (l.floor().max(0.0) as usize)..(r.ceil().max(0.0) as usize).min(w) {
                plane[y * w + x] = NO_MATTER;
            }
        }
    }
    let mut centres = Vec::new();
    for one in wanted.iter().filter(|o| !o.ignored) {
        let [l, t, r, b] = cells(one.bounds);
        let (cx, cy) = (0.5 * (l + r), 0.5 * (t + b));
        // A centre above or below what is seen belongs to the border's cell.
        let (cx, cy) = (cx.clamp(0.0, w as f32 - 0.01), cy.clamp(0.0, h as f32 - 0.01));
        let (x, y) = (cx as usize, cy as usize);
        let size = [r - l, b - t];
        splat(&mut heat[one.class * w * h..][..w * h], (w, h), (x, y), reach(size));
        centres.push(Centre { cell: y * w + x, size, offset: [cx - x as f32, cy - y as f32] });
    }
    centres
}

/// How far (cells) both corners of a box may be off, in the worst directions, so that it still overlaps
/// the truth by [`KEPT_IOU`] (Law and Deng 2018, "CornerNet"): the smallest of the three cases.
fn radius([w, h]: [f32; 2]) -> f32 {
    let o = KEPT_IOU;
    let root = |a: f32, b: f32, c: f32| (b - (b * b - 4.0 * a * c).max(0.0).sqrt()) / (2.0 * a);
    // One corner inside, one outside: both shifted.
    let shifted = root(1.0, w + h, w * h * (1.0 - o) / (1.0 + o));
    // Both inside: the box is smaller.
    let smaller = root(4.0, 2.0 * (w + h), (1.0 - o) * w * h);
    // Both outside: the box is larger.
    let b = 2.0 * o * (w + h);
    let larger = (-b + (b * b + 16.0 * o * (1.0 - o) * w * h).sqrt()) / (8.0 * o);
    shifted.min(smaller).min(larger).max(0.0)
}

/// How far (cells, across and down) a peak may be from a lamp's or a sign's centre: CornerNet's radius.
pub fn corners([w, h]: [f32; 2]) -> [usize; 2] {
    [radius([w, h]) as usize; 2]
}

/// The same of an object: in proportion to its width and to its height (Liu et al. 2020, "Training-Time-Friendly Network").
/// CornerNet's radius of somebody seen from the side, 3 cells wide and 16 high, is less than one cell, so whoever says a cell
/// higher or lower is as wrong as whoever sees somebody where nobody is; and where on such a column the middle is, no network
/// tells to a cell. It says nothing then.
pub fn shares(size: [f32; 2]) -> [usize; 2] {
    size.map(|side| (SHARE * side) as usize)
}

/// Share of an object's width and height.
const SHARE: f32 = 0.27;

/// Puts a Gaussian (its deviations a third of how far it reaches) with its peak of 1 at the cell; the larger value stays.
fn splat(plane: &mut [f32], (w, h): (usize, usize), (x, y): (usize, usize), reach: [usize; 2]) {
    let deviation = reach.map(|reach| (2 * reach + 1) as f32 / 6.0);
    for yy in y.saturating_sub(reach[1])..(y + reach[1] + 1).min(h) {
        for xx in x.saturating_sub(reach[0])..(x + reach[0] + 1).min(w) {
            let away = [xx.abs_diff(x) as f32 / deviation[0], yy.abs_diff(y) as f32 / deviation[1]];
            let cell = &mut plane[yy * w + xx];
            *cell = cell.max((-0.5 * (away[0] * away[0] + away[1] * away[1])).exp());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::heads::{Head, Tensor, decode};

    fn overlap(a: [f32; 4], b: [f32; 4]) -> f32 {
        let found = crate::perception::Detection {
            class: wad_camera::model::ObjectClass::Car,
            bounds: a,
            score: 1.0,
        };
        found.iou(&b)
    }

    #[test]
    fn corners_off_by_the_radius_keep_the_overlap() {
        for [w, h] in [[10.0, 10.0], [30.0, 8.0], [5.0, 40.0]] {
            let r = radius([w, h]);
            let truth = [0.0, 0.0, w, h];
            for found in [[r, r, w + r, h + r], [r, r, w - r, h - r], [-r, -r, w + r, h + r]] {
                assert!(overlap(truth, found) >= KEPT_IOU - 1e-3, "{w} x {h}, radius {r}: {found:?}");
            }
            assert!(overlap(truth, [2.0 * r, 2.0 * r, w + 2.0 * r, h + 2.0 * r]) < KEPT_IOU);
        }
    }

    #[test]
    fn what_is_encoded_is_decoded() {
        let window = Window::whole(Backbone::Light, (512, 512));
        let boxes = [[100.0, 200.0, 161.0, 243.0], [300.0, 230.0, 317.0, 270.0], [0.0, 150.0, 90.0, 390.0]];
        let wanted: Vec<Wanted> = boxes
            .iter()
            .zip([0, 3, 4])
            .map(|(&bounds, class)| Wanted { class, bounds, ignored: false })
            .collect();
        let (w, h) = window.cells();
        assert_eq!((w, h), (128, 80));
        let mut heat = vec![9.0; 8 * w * h];
        let shown: Vec<Wanted> = wanted.iter().filter_map(|o| window.view(o, false)).collect();
        let centres = encode(&shown, (w, h), &mut heat, shares);
        let (mut size, mut offset) = (vec![0.0; 2 * w * h], vec![0.0; 2 * w * h]);
        for c in &centres {
            for k in 0..2 {
                size[k * w * h + c.cell] = c.size[k];
                offset[k * w * h + c.cell] = c.offset[k];
            }
        }
        let outputs = [
            Tensor { name: "heat", shape: &[8, h, w], values: &heat },
            Tensor { name: "size", shape: &[2, h, w], values: &size },
            Tensor { name: "offset", shape: &[2, h, w], values: &offset },
        ];
        let head = Head::SizeOffset { heat: 0, size: 1, offset: 2, classes: 8 };
        let found = decode(&head, &outputs, 512, 0.99);
        assert_eq!(found.len(), 3);
        for (one, bounds) in wanted.iter().zip(boxes) {
            let moved = [bounds[0], bounds[1] - 96.0, bounds[2], bounds[3] - 96.0];
            assert!(
                found
                    .iter()
                    .any(|d| crate::perception::coco::class_index(d.class) == one.class
                        && d.iou(&moved) > 0.999),
                "{bounds:?} in {found:?}"
            );
        }
    }

    #[test]
    fn where_the_middle_of_somebody_tall_and_narrow_is_need_not_be_told_to_a_cell() {
        let (w, h) = (20, 30);
        let person = Wanted { class: 3, bounds: [32.0, 24.0, 44.0, 88.0], ignored: false };
        let map = |reach: fn([f32; 2]) -> [usize; 2]| {
            let mut heat = vec![0.0; 8 * w * h];
            let centres = encode(&[person], (w, h), &mut heat, reach);
            let cell = (3 * w * h + centres[0].cell) as i64;
            move |dx: i64, dy: i64| heat[(cell + dy * w as i64 + dx) as usize]
        };
        let wide = map(shares);
        assert_eq!(wide(0, 0), 1.0);
        assert!(wide(0, 1) > 0.75 && wide(0, -2) > 0.4 && wide(0, 4) > 0.0 && wide(0, 5) == 0.0);
        assert!(wide(1, 0) == 0.0 && wide(-1, 0) == 0.0, "beside it may be another");
        let narrow = map(corners);
        assert!(narrow(0, 0) == 1.0 && narrow(0, 1) == 0.0 && narrow(0, -1) == 0.0);
    }

    #[test]
    fn what_does_not_count_is_no_background_but_never_hides_an_object() {
        let ignored = Wanted { class: 0, bounds: [100.0, 200.0, 140.0, 240.0], ignored: true };
        let object = Wanted { class: 0, bounds: [104.0, 204.0, 136.0, 236.0], ignored: false };
        let mut heat = vec![0.0; 8 * 128 * 80];
        encode(&[object, ignored], (128, 80), &mut heat, shares);
        assert_eq!(heat.iter().filter(|v| **v == 1.0).count(), 1);
        assert!(heat[..128 * 80].contains(&NO_MATTER));
        assert!(!heat[128 * 80..].contains(&NO_MATTER));
    }

    #[test]
    fn a_window_cuts_at_its_sides_and_does_not_teach_what_it_hardly_shows() {
        let window = Window { left: 100, top: 150, width: 256, height: 192 };
        let view = |bounds: [f32; 4], cuts| {
            window.view(&Wanted { class: 2, bounds, ignored: false }, cuts).map(|w| (w.bounds, w.ignored))
        };
        assert_eq!(view([110.0, 160.0, 150.0, 180.0], true), Some(([10.0, 10.0, 50.0, 30.0], false)));
        // Half of its width is left, then a quarter.
        assert_eq!(view([80.0, 160.0, 120.0, 180.0], true), Some(([0.0, 10.0, 20.0, 30.0], false)));
        assert_eq!(view([70.0, 160.0, 110.0, 180.0], true), Some(([0.0, 10.0, 10.0, 30.0], true)));
        // Half of its height is left: fine only where nothing more of it is ever seen.
        assert_eq!(view([110.0, 140.0, 150.0, 160.0], true), Some(([10.0, -10.0, 50.0, 10.0], true)));
        assert_eq!(view([110.0, 140.0, 150.0, 160.0], false), Some(([10.0, -10.0, 50.0, 10.0], false)));
        assert_eq!(view([10.0, 160.0, 100.0, 180.0], true), None);
    }
}
