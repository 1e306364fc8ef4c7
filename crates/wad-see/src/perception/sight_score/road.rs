//! What networks saw of lane and light against what is true of both.

use super::lanes::FOUND;
use super::light::{LightCounts, REACH};
use super::{MEASURED_AT, Spread, share};
use crate::perception::road_truth::y_at;
use crate::perception::{RoadWanted, Seen, SeenSign, SignTruth, colour};
use serde::{Deserialize, Serialize};

/// The error of the stop line's distance counts up to this far before it (m).
const LINE_REACH: f32 = 20.0;
/// A boundary that reaches less far ahead than this is no false one (m): the last of a lane before a junction.
const PHANTOM_REACH: f32 = 8.0;

/// A sign is seen where it is if both are within this, or half its height (pixels).
const NEAR_SIGN: f32 = 8.0;
/// Plates as wide as this can be read (pixels).
const LEGIBLE: f32 = 14.0;

/// Counts over frames.
#[derive(Clone, Debug, Default)]
pub struct RoadScore {
    frames: usize,
    boundaries: usize,
    found: usize,
    lateral: Vec<f64>,
    junctions: usize,
    phantom_lanes: usize,
    light: LightCounts,
    line: Vec<f64>,
    signs: usize,
    signs_found: usize,
    near_signs: usize,
    signs_right: usize,
    looked: usize,
    phantom_signs: usize,
    /// Cells of road both seen and there, and either.
    area: (usize, usize),
}

/// The figures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RoadReport {
    /// Frames.
    pub frames: usize,
    /// Boundaries of the ego's lane that reach 10 m ahead; painted or not, hidden or not.
    pub boundaries: usize,
    /// Share of them found within 0.5 m at 10 m.
    pub boundaries_found: Option<f64>,
    /// Absolute lateral error there (m).
    pub lateral_error: Spread,
    /// Frames inside junctions.
    pub junctions: usize,
    /// Share of them in which a lane is seen.
    pub phantom_lanes: Option<f64>,
    /// Frames whose light is within 40 m and in the picture (a head 6 pixels high or more, not hidden).
    pub lights: usize,
    /// Share of them with the right lamp.
    pub lights_right: Option<f64>,
    /// Share of them with no light seen.
    pub lights_missed: Option<f64>,
    /// Red ones among them.
    pub reds: usize,
    /// Red ones that were called green.
    pub red_as_green: usize,
    /// Frames in which no head of the ego's, nor one where its lane ends, is in the picture.
    pub without_light: usize,
    /// Share of them with a light seen.
    pub phantom_lights: Option<f64>,
    /// Absolute error of the stop line's distance within 20 m (m).
    pub line_error: Spread,
    /// Signs that are to be read: 7 pixels high or more, plain, facing the camera.
    #[serde(default)]
    pub signs: usize,
    /// Share of them that are seen.
    #[serde(default)]
    pub signs_found: Option<f64>,
    /// Those of them whose digits are 5 pixels high or more: within 12 m.
    #[serde(default)]
    pub near_signs: usize,
    /// Share of these that are seen to say what they say.
    #[serde(default)]
    pub signs_right: Option<f64>,
    /// Signs seen where none is, per frame.
    #[serde(default)]
    pub phantom_signs: Option<f64>,
    /// Intersection over union of the drivable area, of all frames together.
    #[serde(default)]
    pub area_iou: Option<f64>,
}

impl RoadScore {
    /// Counts a frame.
    pub fn add(&mut self, wanted: &RoadWanted, seen: &Seen) {
        self.frames += 1;
        let lanes = [seen.lanes.left, seen.lanes.right];
        match &wanted.boundaries {
            Some(sides) => {
                for (line, seen) in sides.iter().zip(lanes) {
                    let Some(y) = y_at(line, MEASURED_AT as f32) else { continue };
                    self.boundaries += 1;
                    let error = seen.map(|seen| f64::from((seen.y(MEASURED_AT as f32) - y).abs()));
                    self.found += usize::from(error.is_some_and(|e| e <= FOUND));
                    self.lateral.extend(error);
                }
            }
            None => {
                self.junctions += 1;
                let is_seen = lanes.iter().flatten().any(|line| line.reach[1] > PHANTOM_REACH);
                self.phantom_lanes += usize::from(is_seen);
            }
        }
        let shown = wanted.heads.iter().any(|(_, counts)| *counts);
        let lamp = seen.light.and_then(|light| colour(light.state));
        match wanted.light {
            Some((wanted, distance)) if shown && f64::from(distance) <= REACH => {
                self.light.add_lit(wanted, lamp);
                if distance <= LINE_REACH {
                    self.line.extend(seen.light.map(|light| (light.distance - f64::from(distance)).abs()));
                }
            }
            _ if wanted.heads.is_empty() => self.light.add_dark(lamp.is_some()),
            _ => {}
        }
        if let Some(signs) = &wanted.signs {
            self.add_signs(signs, seen);
        }
        if let Some(area) = &wanted.area {
            let (both, either) = area.overlap(&seen.area);
            self.area = (self.area.0 + both, self.area.1 + either);
        }
    }

    fn add_signs(&mut self, wanted: &[SignTruth], seen: &Seen) {
        let is_there = |sign: &SignTruth, seen: &SeenSign| {
            sign.away(seen.pixel) <= (0.5 * (sign.bounds[2] - sign.bounds[0])).max(NEAR_SIGN)
        };
        let seen = || seen.signs.iter().flatten().filter(|sign| sign.is_sure());
        for sign in wanted.iter().filter(|sign| sign.is_plain) {
            // The surest comes first.
            let found = seen().find(|seen| is_there(sign, seen));
            self.signs += 1;
            self.signs_found += usize::from(found.is_some());
            if sign.bounds[2] - sign.bounds[0] >= LEGIBLE {
                self.near_signs += 1;
                self.signs_right += usize::from(found.is_some_and(|found| found.sign == sign.sign));
            }
        }
        self.looked += 1;
        self.phantom_signs += seen().filter(|seen| !wanted.iter().any(|sign| is_there(sign, seen))).count();
    }

    /// The figures.
    pub fn report(&self) -> RoadReport {
        let light = &self.light;
        RoadReport {
            frames: self.frames,
            boundaries: self.boundaries,
            boundaries_found: share(self.found, self.boundaries),
            lateral_error: Spread::of(&self.lateral),
            junctions: self.junctions,
            phantom_lanes: share(self.phantom_lanes, self.junctions),
            lights: light.ahead,
            lights_right: share(light.right, light.ahead),
            lights_missed: share(light.missed, light.ahead),
            reds: light.reds,
            red_as_green: light.red_as_green,
            without_light: light.without,
            phantom_lights: share(light.phantom, light.without),
            line_error: Spread::of(&self.line),
            signs: self.signs,
            signs_found: share(self.signs_found, self.signs),
            near_signs: self.near_signs,
            signs_right: share(self.signs_right, self.near_signs),
            phantom_signs: share(self.phantom_signs, self.looked),
            area_iou: share(self.area.0, self.area.1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::light::{GREEN, RED};
    use super::*;
    use crate::perception::{DrivableArea, LaneBoundary, LaneEstimate, SeenLight};
    use sumo_network::world::SignalState;

    #[test]
    fn hits_misses_and_phantoms_are_counted() {
        let line = |y: f32, far: usize| (0..far).map(|x| [x as f32, y]).collect::<Vec<_>>();
        let head = ([0.0, 0.0, 5.0, 12.0], true);
        let wanted = RoadWanted {
            boundaries: Some([line(1.6, 30), line(-1.6, 30)]),
            heads: vec![head],
            light: Some((RED, 15.0)),
            area: Some(DrivableArea::new(|row, column| row > 5 && column < 40)),
            ..RoadWanted::default()
        };
        let boundary = |offset| Some(LaneBoundary { offset, slope: 0.0, bend: 0.0, reach: [4.0, 20.0] });
        let light = |state| Some(SeenLight { state, distance: 16.0, certainty: 1.0 });
        let area = DrivableArea::new(|row, column| row > 5 && column < 20);
        let lanes = LaneEstimate { left: boundary(1.9), right: boundary(-3.0) };
        let mut score = RoadScore::default();
        score.add(&wanted, &Seen { lanes, light: light(SignalState::Red), area, ..Seen::default() });
        score.add(&wanted, &Seen { lanes, light: light(SignalState::GreenMajor), ..Seen::default() });
        score.add(&wanted, &Seen::default());
        let far = RoadWanted { light: Some((GREEN, 60.0)), heads: vec![head], ..RoadWanted::default() };
        score.add(&far, &Seen::default());
        score.add(&RoadWanted::default(), &Seen { lanes, light: light(SignalState::Red), ..Seen::default() });
        let r = score.report();
        assert_eq!((r.frames, r.boundaries, r.boundaries_found), (5, 6, Some(2.0 / 6.0)));
        assert_eq!((r.junctions, r.phantom_lanes), (2, Some(0.5)));
        assert_eq!((r.lights, r.lights_right, r.lights_missed), (3, Some(1.0 / 3.0), Some(1.0 / 3.0)));
        assert_eq!((r.reds, r.red_as_green), (3, 1));
        assert_eq!((r.without_light, r.phantom_lights), (1, Some(1.0)));
        assert_eq!(r.line_error.median, Some(1.0));
        assert_eq!(r.area_iou, Some(0.5 / 3.0));
    }
}
