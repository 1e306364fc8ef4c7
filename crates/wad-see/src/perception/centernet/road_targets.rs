//! The targets and the loss of the road's heads.

use super::decode::{ANSWERS, CELL, COLUMNS, HORIZON, LAMPS, ROWS, row_y};
use super::graph::PICTURE;
use super::kind::Backbone;
use super::loss::focal;
use super::road::{RoadAnswer, WHOLE};
use super::targets::{NO_MATTER, Wanted, encode};
use crate::perception::road_truth::y_at;
use crate::perception::{GroundPlane, RoadWanted};
use tch::{Device, Kind, TchError, Tensor};

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
}

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
        let centres = encode(&boxes, (w, h), &mut self.heat[n * planes..]);
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

/// The road's part of the loss: light and lanes.
///
/// # Errors
/// torch fails.
pub fn road_loss(answer: &RoadAnswer, targets: &RoadTargets, device: Device) -> Result<Tensor, TchError> {
    let n = targets.pictures as i64;
    let [w, h] = WHOLE;
    let lanes = Tensor::f_from_slice(&targets.lanes)?
        .f_view([n, 2, ROWS as i64, ANSWERS as i64])?
        .f_to_device(device)?;
    let rows = lanes.f_sum(Kind::Float)?.f_clamp_min(1.0)?;
    let log = answer.lanes.f_log_softmax(3, Kind::Float)?;
    let mut loss = log.f_mul(&lanes)?.f_sum(Kind::Float)?.f_div(&rows)?.f_neg()?;
    let lamps = LAMPS as i64;
    let heat = Tensor::f_from_slice(&targets.heat)?.f_view([n, lamps, h, w])?.f_to_device(device)?;
    let centres = (targets.cells.len() as f64).max(1.0);
    let found = focal(&answer.light.f_narrow(1, 0, lamps)?, &heat)?.f_div_scalar(centres)?;
    loss = loss.f_add(&found)?;
    if targets.cells.is_empty() {
        return Ok(loss);
    }
    let cells = Tensor::f_from_slice(&targets.cells)?.f_to_device(device)?;
    let seen = answer.light.f_select(1, lamps)?.f_reshape([-1])?.f_index_select(0, &cells)?;
    let distances = Tensor::f_from_slice(&targets.distances)?.f_to_device(device)?;
    loss.f_add(&seen.f_sub(&distances)?.f_abs()?.f_mean(Kind::Float)?)
}

#[cfg(test)]
mod tests {
    use super::super::decode::{LIGHT, decode};
    use super::*;
    use crate::perception::Seen;
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
        let seen = decode(&light, &lanes, &ground());
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
        assert_eq!(decode(&light, &lanes, &ground()), Seen::default());
        // A lane that ends 12 m ahead is none in the rows beyond.
        let mut short = wanted();
        short.boundaries.iter_mut().flatten().for_each(|side| side.truncate(13));
        let mut targets = RoadTargets::default();
        targets.add(Some(&short), &ground());
        let lanes: Vec<f32> = targets.lanes.iter().map(|p| p.max(1e-9).ln()).collect();
        let reach = decode(&light, &lanes, &ground()).lanes.left.unwrap().reach;
        assert!(reach[1] < 12.5 && reach[1] > 8.0, "{reach:?}");
    }

    #[test]
    fn a_mirrored_picture_has_mirrored_targets() {
        let mirrored = wanted().mirrored(512.0);
        let [left, right] = mirrored.boundaries.clone().unwrap();
        assert!((left[0][1] - 1.7).abs() < 1e-6 && (right[0][1] + 1.6).abs() < 1e-6);
        assert_eq!(mirrored.heads[0].0, [250.0, 180.0, 262.0, 200.0]);
        assert_eq!(mirrored.heads[1].0, [200.0, 190.0, 212.0, 210.0]);
        let twice = mirrored.mirrored(512.0);
        assert_eq!(twice.boundaries, wanted().boundaries);
    }
}
