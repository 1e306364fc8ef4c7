//! What the answers of the road's heads say: the ego's lane, its light, and signs.
//!
//! Light: 4 channels of 80 x 128 cells of 4 pixels: whether a head of the ego is here that shows red, yellow, green (before the
//! sigmoid, as the heatmaps of objects); ln(1 + the stop line's distance / m). Lanes: left and right boundary, each 20 rows from
//! the horizon down, each 65 numbers before their softmax: columns of 8 pixels, then none. Signs: 14 channels of 40 x 128 cells of 4
//! pixels, round the horizon: whether a sign is here that says each of [`Sign`] (before the sigmoid); ln(1 + distance / m). Area:
//! 20 rows from the horizon down of 64 cells of 8 pixels: whether this is road (before the sigmoid).

use super::kind::{Backbone, STRIDE};
use crate::perception::area::{CELL, COLUMNS, HORIZON, ROWS};
use crate::perception::{DrivableArea, GroundPlane, LaneBoundary, LaneEstimate, Seen, SeenLight, SeenSign};
use nalgebra::{Matrix4, Vector4};
use sumo_network::world::SignalState;
use wad_camera::model::Sign;

/// Width of the light's map (cells).
const MAP_WIDTH: usize = COLUMNS * CELL / STRIDE;
/// Sides and their answers per row: a column each, and none.
pub(super) const ANSWERS: usize = COLUMNS + 1;
/// Channels of the light's map: whether a head of the ego is here that shows each of [`COLOURS`]; ln(1 + distance / m).
pub(super) const LIGHT: i64 = 1 + LAMPS as i64;
pub(super) const LAMPS: usize = COLOURS.len();
/// The lamps in the order of [`crate::perception::colour`].
const COLOURS: [SignalState; 3] = [SignalState::Red, SignalState::Yellow, SignalState::GreenMajor];

/// Channels of the signs' map.
pub(super) const SIGN_CHANNELS: i64 = 1 + Sign::KINDS as i64;
/// The rows of cells in which signs are looked for (of those that the network sees): 112 pixels above the horizon to 48 below.
pub(super) const SIGN_ROWS: [usize; 2] = [12, 52];

/// The first of these rows in the picture, and the one behind the last (pixels).
pub const SIGN_BAND: [usize; 2] = {
    let top = Backbone::Light.rows(2 * HORIZON).0;
    [top + SIGN_ROWS[0] * STRIDE, top + SIGN_ROWS[1] * STRIDE]
};

/// The middle of a row in the picture (pixels).
pub(super) fn row_y(row: usize) -> f32 {
    (HORIZON as f32) + (row as f32 + 0.5) * CELL as f32
}

/// Least certainty of a light, of a sign, and of a boundary in a row.
const LEAST_LIGHT: f32 = 0.3;
const LEAST_SIGN: f32 = 0.3;
const LEAST_ROW: f32 = 0.5;

/// What one picture's answers say: light, lanes, signs, area.
pub fn decode([light, lanes, signs, area]: &[Vec<f32>; 4], ground: &GroundPlane) -> Seen {
    let lanes = decode_lanes(lanes, ground);
    let light = decode_light(light, &lanes, ground);
    let is_road = |row: usize, column: usize| area[row * COLUMNS + column] > 0.0;
    Seen { lanes, light, signs: decode_signs(signs, ground), area: DrivableArea::new(is_road) }
}

pub(super) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// What [`sigmoid`] makes `p` of; beyond 0 and 1 nothing does.
pub(super) fn logit(p: f32) -> f32 {
    (p / (1.0 - p)).ln()
}

/// Two signs are at least this many cells apart.
const APART: usize = 3;

/// The signs of one picture by the answers of their head, the surest first.
pub fn decode_signs(map: &[f32], ground: &GroundPlane) -> [Option<SeenSign>; 4] {
    let cells = map.len() / SIGN_CHANNELS as usize;
    let (heat, distances) = map.split_at(Sign::KINDS * cells);
    let mut most = vec![f32::MIN; cells];
    for plane in heat.chunks_exact(cells.max(1)) {
        most.iter_mut().zip(plane).for_each(|(most, x)| *most = x.max(*most));
    }
    // For each cell that may be one: that it is any, and which it is most likely.
    let least = logit(LEAST_SIGN / Sign::KINDS as f32);
    let likely = most.iter().enumerate().filter(|(_, most)| **most >= least);
    let kinds = |cell: usize| heat[cell..].iter().step_by(cells);
    let any = |cell: usize| 1.0 - kinds(cell).map(|x| 1.0 - sigmoid(*x)).product::<f32>();
    let best = |cell: usize, most: f32| kinds(cell).position(|x| *x == most).unwrap_or(0);
    let mut sure: Vec<(f32, usize, usize)> =
        likely.map(|(cell, most)| (any(cell), best(cell, *most), cell)).collect();
    sure.retain(|(certainty, ..)| *certainty >= LEAST_SIGN);
    sure.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut found = [None; 4];
    let mut taken: Vec<[usize; 2]> = Vec::new();
    for (certainty, index, cell) in sure {
        let at = [cell % MAP_WIDTH, cell / MAP_WIDTH];
        if taken.iter().any(|other| (0..2).all(|k| other[k].abs_diff(at[k]) < APART)) {
            continue;
        }
        let Some(place) = found.get_mut(taken.len()) else { break };
        let pixel = at.map(|cell| (cell * STRIDE + STRIDE / 2) as f32);
        let depth = distances[cell].clamp(0.0, 5.0).exp_m1();
        *place = Some(SeenSign {
            sign: Sign::of(index),
            at: ground.ahead(pixel[0], depth),
            pixel: [pixel[0], pixel[1] + SIGN_BAND[0] as f32],
            radius: ground.pixels(Sign::of(index).radius(), depth),
            certainty,
        });
        taken.push(at);
    }
    found
}

/// The heads over the ego's lane, as far as it is seen, count more than those beside it: the network finds heads that look like
/// the ego's, and which of two side by side it is shows where they hang. A head this far from the lane's middle (m) counts
/// exp(-0.5) as much, one at the roadside at least [`ASIDE`].
const BESIDE: f32 = 1.5;
const ASIDE: f32 = 0.05;
/// Heads at the ego's stop line count more than those across the junction or at the next one, which may be another's. At
/// the line a head hangs at least this much above the camera (heights of the camera above the ground); one that would hang
/// lower there is farther away, and counts less, at least [`FAR`].
const AT_LINE: f32 = 1.3;
const FAR: f32 = 0.02;
/// So much is left, at least, of the certainty of a head across the junction where no other is seen, and of a green one beside
/// the ego's lane, whose own may be red behind somebody tall: too little for green after red to be believed
/// ([`SeenLights`](crate::perception::SeenLights)).
const UNFIT: f32 = 0.3;
/// Share of the surest head's certainty from which on a head has a vote.
const VOTES: f32 = 0.3;
/// From the ego's centre to its front (m), from where lines are measured.
const FRONT: f32 = 2.3;

fn decode_light(map: &[f32], lanes: &LaneEstimate, ground: &GroundPlane) -> Option<SeenLight> {
    let cells = map.len() / LIGHT as usize;
    let (heat, distances) = map.split_at(LAMPS * cells);
    let surest = sigmoid(heat.iter().copied().fold(f32::MIN, f32::max));
    if surest < LEAST_LIGHT {
        return None;
    }
    // In the rows that the network sees.
    let horizon = (HORIZON - Backbone::Light.rows(2 * HORIZON).0) as f32;
    // How well a head fits the ego's stop line by its height, and its lane.
    let weights = |cell: usize, distance: f32| {
        let x = distance.exp_m1().max(0.0) + FRONT;
        let middle = middle_of(lanes, x);
        let pixels = [middle, middle + 1.0].map(|y| ground.pixel([x, y]));
        let [Some([own, ground_y]), Some([metre, _])] = pixels else { return (1.0, 1.0) };
        let [row, column] = [cell / MAP_WIDTH, cell % MAP_WIDTH].map(|at| (at * STRIDE + STRIDE / 2) as f32);
        let away = (column - own) / (metre - own);
        let high = (horizon - row) / (ground_y - HORIZON as f32).max(1.0);
        let near = (high / AT_LINE).clamp(0.0, 1.0).powi(2);
        (FAR + near, ASIDE + (-0.5 * (away / BESIDE).powi(2)).exp())
    };
    // Before the sigmoid: of thousands of cells a few have a vote.
    let least = logit(VOTES * surest);
    let vote = |(lamp, state): (&[f32], SignalState)| {
        let (mut sum, mut distance, mut certainty) = (0.0, 0.0, 0.0_f32);
        for (cell, (x, d)) in lamp.iter().zip(distances).enumerate().filter(|(_, (x, _))| **x >= least) {
            let (near, own) = weights(cell, *d);
            let p = sigmoid(*x);
            let fits = if state.stops() { near } else { near * own };
            certainty = certainty.max(p * fits.clamp(UNFIT, 1.0));
            let p = p * near * own;
            (sum, distance) = (sum + p, distance + p * d);
        }
        (sum, distance, certainty, state)
    };
    let votes = heat.chunks_exact(cells).zip(COLOURS).map(vote);
    let (sum, distance, certainty, state) = votes.max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(SeenLight { state, distance: f64::from((distance / sum).exp_m1().max(0.0)), certainty })
}

/// y (m, left positive) of the lane's middle at `x` m ahead or where the lane ends; 0 where a side is not seen.
fn middle_of(lanes: &LaneEstimate, x: f32) -> f32 {
    let (Some(left), Some(right)) = (lanes.left, lanes.right) else { return 0.0 };
    let x = x.min(left.reach[1].max(right.reach[1]));
    0.5 * (left.y(x) + right.y(x))
}

fn decode_lanes(answers: &[f32], ground: &GroundPlane) -> LaneEstimate {
    let mut points: [Vec<([f32; 2], f32)>; 2] = Default::default();
    for (side, rows) in answers.chunks_exact(ROWS * ANSWERS).enumerate() {
        for (row, answers) in rows.chunks_exact(ANSWERS).enumerate() {
            let top = answers.iter().copied().fold(f32::MIN, f32::max);
            let all: f32 = answers.iter().map(|x| (x - top).exp()).sum();
            let p = |c: usize| (answers[c] - top).exp() / all;
            let best = (0..COLUMNS).max_by(|&a, &b| answers[a].total_cmp(&answers[b])).unwrap_or(0);
            let near = best.saturating_sub(2)..(best + 3).min(COLUMNS);
            let mass: f32 = near.clone().map(p).sum();
            if mass < LEAST_ROW {
                continue;
            }
            let at: f32 = near.map(|c| c as f32 * p(c)).sum::<f32>() / mass;
            let place = ground.point([(at + 0.5) * CELL as f32, row_y(row)]);
            points[side].extend(place.map(|place| (place, mass)));
        }
    }
    fit(&points)
}

/// One parabola for both sides, which differ in their offset: the lane's boundaries run side by side. A point weighs
/// less far away, where a column is broader.
fn fit(points: &[Vec<([f32; 2], f32)>; 2]) -> LaneEstimate {
    /// Points that a side needs.
    const LEAST: usize = 3;
    /// Keeps slope and bend small where points do not say.
    const CALM: [f64; 2] = [1e-3, 1.0];
    let has = [0, 1].map(|side| points[side].len() >= LEAST);
    let (mut a, mut b) = (Matrix4::<f64>::zeros(), Vector4::<f64>::zeros());
    for side in (0..2).filter(|&side| has[side]) {
        for &([x, y], mass) in &points[side] {
            let x = f64::from(x);
            let mut row = Vector4::new(0.0, 0.0, x, 0.5 * x * x);
            row[side] = 1.0;
            let weight = f64::from(mass) / (x * x).max(1.0);
            a += weight * row * row.transpose();
            b += weight * f64::from(y) * row;
        }
    }
    for side in (0..2).filter(|&side| !has[side]) {
        a[(side, side)] = 1.0;
    }
    (a[(2, 2)], a[(3, 3)]) = (a[(2, 2)] + CALM[0], a[(3, 3)] + CALM[1]);
    let Some(found) = a.cholesky().map(|a| a.solve(&b)) else { return LaneEstimate::default() };
    let side = |side: usize| {
        let xs = || points[side].iter().map(|([x, _], _)| *x);
        has[side].then(|| LaneBoundary {
            offset: found[side] as f32,
            slope: found[2] as f32,
            bend: found[3] as f32,
            reach: [xs().fold(f32::MAX, f32::min), xs().fold(f32::MIN, f32::max)],
        })
    };
    LaneEstimate { left: side(0), right: side(1) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wad_camera::CameraConfig;

    const CELLS: usize = MAP_WIDTH * 80;

    /// The light's answers where no head is, with the stop line everywhere at `distance` m.
    fn no_light(distance: f32) -> Vec<f32> {
        let mut light = vec![-9.0; LIGHT as usize * CELLS];
        light[LAMPS * CELLS..].fill(distance.ln_1p());
        light
    }

    fn light_in(light: &[f32], lanes: &LaneEstimate) -> Option<SeenLight> {
        decode_light(light, lanes, &GroundPlane::new(&CameraConfig::default()))
    }

    #[test]
    fn of_heads_side_by_side_the_one_over_the_ego_s_lane_counts() {
        let mut light = no_light(20.0);
        let mut head = |lamp: usize, column: usize, x: f32| light[lamp * CELLS + 30 * MAP_WIDTH + column] = x;
        // Two green ones 4 and 8 m to the right of a red one, at 20 m; the picture's middle is column 64.
        head(2, 75, 1.5);
        head(2, 86, 1.5);
        head(0, 64, 1.0);
        let seen = |light: &[f32]| light_in(light, &LaneEstimate::default()).unwrap();
        assert_eq!(seen(&light).state, SignalState::Red);
        assert!(seen(&light).certainty > 0.7);
        // Where somebody tall hides it, those at the roadside say what counts, but unsurely.
        light[30 * MAP_WIDTH + 64] = -9.0;
        assert_eq!(seen(&light).state, SignalState::GreenMajor);
        assert!(seen(&light).certainty <= UNFIT);
        // The ego's lane lies 4 m to the right: it is told by its boundaries.
        light[30 * MAP_WIDTH + 64] = 1.0;
        let side = |offset| Some(LaneBoundary { offset, slope: 0.0, bend: 0.0, reach: [4.0, 20.0] });
        let lanes = LaneEstimate { left: side(-2.2), right: side(-5.5) };
        let own = light_in(&light, &lanes).unwrap();
        assert_eq!(own.state, SignalState::GreenMajor);
        assert!(own.certainty > 0.7);
    }

    #[test]
    fn of_heads_one_behind_the_other_the_one_at_the_line_counts() {
        let mut light = no_light(6.0);
        let state = |light: &[f32]| light_in(light, &LaneEstimate::default()).map(|light| light.state);
        // A red one beyond the junction, just above the horizon, is surer than the green one above the ego.
        light[36 * MAP_WIDTH + 74] = 0.3;
        assert_eq!(state(&light), Some(SignalState::Red));
        light[2 * CELLS + MAP_WIDTH + 64] = -0.6;
        assert_eq!(state(&light), Some(SignalState::GreenMajor));
    }
}
