//! The targets and the loss of the road's heads.

use super::decode::{ANSWERS, LAMPS, SIGN_BAND, SIGN_ROWS, row_y};
use super::graph::PICTURE;
use super::kind::{Backbone, Part, STRIDE};
use super::loss::focal;
use super::road::{RoadAnswer, WHOLE};
use super::targets::{NO_MATTER, Wanted, corners, encode};
use crate::perception::area::{CELL, COLUMNS, HORIZON, ROWS};
use crate::perception::road_truth::y_at;
use crate::perception::{GroundPlane, RoadWanted};
use tch::{Device, Kind, Reduction, TchError, Tensor};
use wad_camera::model::Sign;

/// Deviation of a boundary's column in the target (cells).
const SPREAD: f32 = 0.7;

/// The targets of a batch of whole pictures, on the processor.
#[derive(Clone, Debug, Default)]
pub struct RoadTargets {
    pictures: usize,
    /// n x 3 x 80 x 128, as CenterNet's heatmap: lamps for classes.
    heat: Vec<f32>,
    /// Of each head's centre: picture * h * w + cell, and ln(1 + distance).
    cells: Vec<i64>,
    distances: Vec<f32>,
    /// n x 2 x 20 x 65: how likely each answer is to be; all 0 where a row does not count.
    lanes: Vec<f32>,
    /// n x 13 x 40 x 128, as CenterNet's heatmap: what signs say for classes.
    signs: Vec<f32>,
    /// As `cells` and `distances`, of signs.
    sign_cells: Vec<i64>,
    sign_distances: Vec<f32>,
    /// n x 20 x 64: 1 where road is, [`NO_MATTER`] where nobody knows.
    area: Vec<f32>,
}

/// Columns and rows of the signs' map.
const SIGN_MAP: [usize; 2] = [WHOLE[0] as usize, SIGN_ROWS[1] - SIGN_ROWS[0]];

impl RoadTargets {
    /// Adds a picture; None: nothing is known of its road.
    pub fn add(&mut self, wanted: Option<&RoadWanted>, ground: &GroundPlane) {
        let [w, h] = WHOLE.map(|side| side as usize);
        let (cells, answers) = (w * h, 2 * ROWS * ANSWERS);
        let planes = LAMPS * cells;
        let n = self.pictures;
        self.pictures += 1;
        self.heat.resize(self.pictures * planes, if wanted.is_some() { 0.0 } else { NO_MATTER });
        self.lanes.resize(self.pictures * answers, 0.0);
        self.add_signs(n, wanted);
        let area = wanted.and_then(|wanted| wanted.area);
        let value =
            |at| area.map_or(NO_MATTER, |area| f32::from(u8::from(area.has(at / COLUMNS, at % COLUMNS))));
        self.area.extend((0..ROWS * COLUMNS).map(value));
        let Some(wanted) = wanted else { return };
        let top = Backbone::Light.rows(PICTURE[1]).0 as f32;
        let lamp = wanted.light.map(|(lamp, _)| lamp);
        let mut boxes = Vec::new();
        for &([l, t, r, b], counts) in &wanted.heads {
            let bounds = [l, t - top, r, b - top];
            let one = |class, ignored| Wanted { class, bounds, ignored };
            match lamp.filter(|_| counts) {
                Some(lamp) => boxes.push(one(lamp, false)),
                None => boxes.extend((0..LAMPS).map(|class| one(class, true))),
            }
        }
        let centres = encode(&boxes, (w, h), &mut self.heat[n * planes..], corners);
        if let Some((_, distance)) = wanted.light {
            for centre in centres {
                self.cells.push((n * cells + centre.cell) as i64);
                self.distances.push(distance.max(0.0).ln_1p());
            }
        }
        for (side, rows) in self.lanes[n * answers..].chunks_exact_mut(ROWS * ANSWERS).enumerate() {
            for (row, out) in rows.chunks_exact_mut(ANSWERS).enumerate() {
                let line = wanted.boundaries.as_ref().map(|sides| sides[side].as_slice());
                match column(line, row, ground) {
                    Column::At(at) => {
                        let weight = |c: usize| (-0.5 * ((c as f32 - at) / SPREAD).powi(2)).exp();
                        let sum: f32 = (0..COLUMNS).map(weight).sum();
                        for (c, out) in out[..COLUMNS].iter_mut().enumerate() {
                            *out = weight(c) / sum;
                        }
                    }
                    Column::None => out[COLUMNS] = 1.0,
                    Column::Unknown => {}
                }
            }
        }
    }
}

impl RoadTargets {
    fn add_signs(&mut self, n: usize, wanted: Option<&RoadWanted>) {
        let [w, h] = SIGN_MAP;
        let signs = wanted.and_then(|wanted| wanted.signs.as_deref());
        let planes = Sign::KINDS * w * h;
        self.signs.resize((n + 1) * planes, if signs.is_some() { 0.0 } else { NO_MATTER });
        let Some(signs) = signs else { return };
        let (mut boxes, mut distances) = (Vec::new(), Vec::new());
        for sign in signs {
            let [l, t, r, b] = sign.bounds;
            let bounds = [l, t - SIGN_BAND[0] as f32, r, b - SIGN_BAND[0] as f32];
            let middle = 0.5 * (bounds[1] + bounds[3]);
            let one = |class, ignored| Wanted { class, bounds, ignored };
            if sign.is_plain && (0.0..(h * STRIDE) as f32).contains(&middle) {
                boxes.push(one(sign.sign.index(), false));
                distances.push(sign.distance.max(0.0).ln_1p());
            } else {
                boxes.extend((0..Sign::KINDS).map(|class| one(class, true)));
            }
        }
        // Centres come in the order of the boxes that count.
        let centres = encode(&boxes, (w, h), &mut self.signs[n * planes..], corners);
        self.sign_cells.extend(centres.iter().map(|centre| (n * w * h + centre.cell) as i64));
        self.sign_distances.extend(distances);
    }
}

/// Where a boundary meets a row.
enum Column {
    /// Cells from the middle of the first.
    At(f32),
    None,
    /// Beyond the picture's sides or farther away than is known.
    Unknown,
}

fn column(line: Option<&[[f32; 2]]>, row: usize, ground: &GroundPlane) -> Column {
    /// From here on (m) lanes are cut off, not ended.
    const FAR: f32 = 38.0;
    let Some(line) = line else { return Column::None };
    let Some([x, _]) = ground.point([HORIZON as f32, row_y(row)]) else { return Column::Unknown };
    let Some(end) = line.last() else { return Column::None };
    if x > end[0] {
        return if end[0] > FAR { Column::Unknown } else { Column::None };
    }
    match y_at(line, x).and_then(|y| ground.pixel([x, y])) {
        Some([u, _]) if (0.0..(COLUMNS * CELL) as f32).contains(&u) => Column::At(u / CELL as f32 - 0.5),
        _ => Column::Unknown,
    }
}

/// Where heads or signs are, and how far away: focal loss of the heatmap and L1 of the distance, per centre. `answer` has a plane
/// for each class, then the distance.
fn places_loss(
    answer: &Tensor,
    heat: &[f32],
    (cells, distances): (&[i64], &[f32]),
    device: Device,
) -> Result<Tensor, TchError> {
    let size = answer.size();
    let classes = size[1] - 1;
    let heat =
        Tensor::f_from_slice(heat)?.f_view([size[0], classes, size[2], size[3]])?.f_to_device(device)?;
    let centres = (cells.len() as f64).max(1.0);
    let found = focal(&answer.f_narrow(1, 0, classes)?, &heat)?.f_div_scalar(centres)?;
    if cells.is_empty() {
        return Ok(found);
    }
    let cells = Tensor::f_from_slice(cells)?.f_to_device(device)?;
    let seen = answer.f_select(1, classes)?.f_reshape([-1])?.f_index_select(0, &cells)?;
    let distances = Tensor::f_from_slice(distances)?.f_to_device(device)?;
    found.f_add(&seen.f_sub(&distances)?.f_abs()?.f_mean(Kind::Float)?)
}

/// The road's part of the loss: light, lanes, signs and area.
///
/// # Errors
/// torch fails.
pub fn road_loss(answer: &RoadAnswer, targets: &RoadTargets, device: Device) -> Result<Tensor, TchError> {
    let n = targets.pictures as i64;
    let lanes = Tensor::f_from_slice(&targets.lanes)?
        .f_view([n, 2, ROWS as i64, ANSWERS as i64])?
        .f_to_device(device)?;
    let rows = lanes.f_sum(Kind::Float)?.f_clamp_min(1.0)?;
    let log = answer.lanes.f_log_softmax(3, Kind::Float)?;
    let lanes = log.f_mul(&lanes)?.f_sum(Kind::Float)?.f_div(&rows)?.f_neg()?;
    let light = places_loss(&answer.light, &targets.heat, (&targets.cells, &targets.distances), device)?;
    let seen = lanes.f_add(&light)?.f_add(&signs_loss(answer, targets, device)?)?;
    seen.f_add(&area_loss(answer, targets, device)?)
}

/// The part of the loss that one head has.
///
/// # Errors
/// torch fails.
pub fn part_loss(
    part: Part,
    answer: &RoadAnswer,
    targets: &RoadTargets,
    device: Device,
) -> Result<Tensor, TchError> {
    match part {
        Part::Signs => signs_loss(answer, targets, device),
        Part::Area => area_loss(answer, targets, device),
    }
}

/// The area's part of it: cross entropy, the mean over the cells that are known.
fn area_loss(answer: &RoadAnswer, targets: &RoadTargets, device: Device) -> Result<Tensor, TchError> {
    let wanted = Tensor::f_from_slice(&targets.area)?.f_view([-1])?.f_to_device(device)?;
    let known = wanted.f_ge(0.0)?.f_to_kind(Kind::Float)?;
    let cells = known.f_sum(Kind::Float)?.f_clamp_min(1.0)?;
    let seen = answer.area.f_reshape([-1])?;
    let weight = Some(&known);
    let loss = seen.f_binary_cross_entropy_with_logits(&wanted, weight, None::<&Tensor>, Reduction::Sum)?;
    loss.f_div(&cells)
}

/// The signs' part of it.
fn signs_loss(answer: &RoadAnswer, targets: &RoadTargets, device: Device) -> Result<Tensor, TchError> {
    let centres = (targets.sign_cells.as_slice(), targets.sign_distances.as_slice());
    places_loss(&answer.signs, &targets.signs, centres, device)
}

/// What plates say that do not count.
pub const UNKNOWN: i64 = -100;

/// The loss of reading: cross entropy of `answer` (n, 14) and what the plates say, by [`Sign::index`], that they are none,
/// or [`UNKNOWN`].
///
/// # Errors
/// torch fails.
pub fn reading_loss(answer: &Tensor, said: &[i64], device: Device) -> Result<Tensor, TchError> {
    answer.f_cross_entropy_loss::<Tensor>(
        &Tensor::f_from_slice(said)?.f_to_device(device)?,
        None,
        Reduction::Mean,
        UNKNOWN,
        0.0,
    )
}

#[cfg(test)]
mod tests {
    use super::super::decode::{LIGHT, decode};
    use super::*;
    use crate::perception::{DrivableArea, Seen, SignTruth};
    use sumo_network::world::SignalState;
    use wad_camera::CameraConfig;

    fn ground() -> GroundPlane {
        GroundPlane::new(&CameraConfig::default())
    }

    fn wanted() -> RoadWanted {
        let line = |y: f32| (0..30).map(|i| [i as f32, y + 0.002 * (i * i) as f32]).collect::<Vec<_>>();
        RoadWanted {
            boundaries: Some([line(1.6), line(-1.7)]),
            heads: vec![([250.0, 180.0, 262.0, 200.0], true), ([300.0, 190.0, 312.0, 210.0], true)],
            light: Some((2, 17.5)),
            signs: Some(vec![SignTruth {
                sign: Sign::Limit(50),
                bounds: [350.0, 222.0, 362.0, 234.0],
                distance: 15.0,
                is_plain: true,
            }]),
            area: Some(DrivableArea::new(|row, column| row + column > 40)),
        }
    }

    #[test]
    fn what_is_encoded_is_decoded() {
        let mut targets = RoadTargets::default();
        targets.add(Some(&wanted()), &ground());
        let lanes: Vec<f32> = targets.lanes.iter().map(|p| p.max(1e-9).ln()).collect();
        let cells = (WHOLE[0] * WHOLE[1]) as usize;
        let mut light = vec![-9.0; LIGHT as usize * cells];
        for (out, heat) in light.iter_mut().zip(&targets.heat) {
            *out = if *heat == 1.0 { 3.0 } else { -9.0 };
        }
        for (&cell, distance) in targets.cells.iter().zip(&targets.distances) {
            light[LAMPS * cells + cell as usize] = *distance;
        }
        assert_eq!(targets.cells.len(), 2);
        let [w, h] = SIGN_MAP;
        let mut signs = vec![-9.0; (Sign::KINDS + 1) * w * h];
        for (out, heat) in signs.iter_mut().zip(&targets.signs) {
            *out = if *heat == 1.0 { 3.0 } else { -9.0 };
        }
        signs[Sign::KINDS * w * h + targets.sign_cells[0] as usize] = targets.sign_distances[0];
        let area: Vec<f32> = targets.area.iter().map(|x| x - 0.5).collect();
        let seen = decode(&[light, lanes, signs, area], &ground());
        assert_eq!(Some(seen.area), wanted().area);
        let [Some(sign), None, ..] = seen.signs else { panic!("{:?}", seen.signs) };
        assert!(sign.sign == Sign::Limit(50) && (sign.pixel[0] - 356.0).abs() <= 2.0, "{sign:?}");
        // 100 pixels right of the middle, 15 m ahead of the camera, which is 0.7 m before the ego's centre.
        assert!((sign.at[0] - 15.7).abs() < 0.1 && (sign.at[1] + 5.9).abs() < 0.2, "{sign:?}");
        let light = seen.light.unwrap();
        assert!(light.state == SignalState::GreenMajor && (light.distance - 17.5).abs() < 0.01, "{light:?}");
        let (left, right) = (seen.lanes.left.unwrap(), seen.lanes.right.unwrap());
        for x in [6.0, 10.0, 15.0] {
            let bend = 0.002 * x * x;
            assert!((left.y(x) - 1.6 - bend).abs() < 0.1, "{x}: {left:?}");
            assert!((right.y(x) + 1.7 - bend).abs() < 0.1, "{x}: {right:?}");
        }
    }

    #[test]
    fn where_there_is_no_lane_none_is_seen() {
        let mut targets = RoadTargets::default();
        targets.add(Some(&RoadWanted::default()), &ground());
        let lanes: Vec<f32> = targets.lanes.iter().map(|p| p.max(1e-9).ln()).collect();
        let light = vec![-9.0; (LIGHT * WHOLE[0] * WHOLE[1]) as usize];
        let answers = [light, lanes, Vec::new(), targets.area.clone()];
        assert_eq!(decode(&answers, &ground()), Seen::default());
        // A lane that ends 12 m ahead is none in the rows beyond.
        let mut short = wanted();
        short.boundaries.iter_mut().flatten().for_each(|side| side.truncate(13));
        let mut targets = RoadTargets::default();
        targets.add(Some(&short), &ground());
        let [light, _, signs, area] = answers;
        let lanes: Vec<f32> = targets.lanes.iter().map(|p| p.max(1e-9).ln()).collect();
        let reach = decode(&[light, lanes, signs, area], &ground()).lanes.left.unwrap().reach;
        assert!(reach[1] < 12.5 && reach[1] > 8.0, "{reach:?}");
    }

    #[test]
    fn plates_that_fill_up_change_no_loss() {
        let answer = Tensor::from_slice(&[2.0_f32, 0.5, -1.0, 0.0, 1.0, 3.0]).view([2, 3]);
        let filled = Tensor::cat(&[&answer, &answer.ones_like()], 0);
        let loss = |answer: &Tensor, said: &[i64]| {
            reading_loss(answer, said, Device::Cpu).unwrap().double_value(&[])
        };
        let (without, with) = (loss(&answer, &[0, 1]), loss(&filled, &[0, 1, UNKNOWN, UNKNOWN]));
        assert!(without > 1.0 && (with - without).abs() < 1e-6, "{without} {with}");
    }

    #[test]
    fn a_mirrored_picture_has_mirrored_targets() {
        let mirrored = wanted().mirrored(512.0);
        let [left, right] = mirrored.boundaries.clone().unwrap();
        assert!((left[0][1] - 1.7).abs() < 1e-6 && (right[0][1] + 1.6).abs() < 1e-6);
        assert_eq!(mirrored.heads[0].0, [250.0, 180.0, 262.0, 200.0]);
        assert_eq!(mirrored.heads[1].0, [200.0, 190.0, 212.0, 210.0]);
        assert!(mirrored.signs.iter().flatten().all(|sign| !sign.is_plain), "in a mirror nobody can read");
        assert_eq!(mirrored.area, Some(DrivableArea::new(|row, column| row + 63 - column > 40)));
        let twice = mirrored.mirrored(512.0);
        assert_eq!(twice.boundaries, wanted().boundaries);
    }
}
