//! Who is detected in front, and told to cross, against the truth.

use super::{Spread, share};
use crate::observation::LeadState;
use crate::perception::facts::REACH;
use crate::perception::lead::{HALF_WAY, SIGHT};
use crate::perception::truth::is_visible;
use crate::perception::{EgoFacts, crossing};
use serde::Serialize;
use sumo_network::geometry::{Vector, wrap_angle};
use sumo_network::world::{Actor, WorldState};
use wad_camera::Frame;

/// Who is in front: the nearest of `world` in the ego's path of which `frame` (with its objects) shows enough.
pub fn in_front(facts: &EgoFacts<'_>, world: &WorldState, frame: &Frame) -> Option<LeadState> {
    nearest_in_front(facts, world, |index| shows(frame, index))
}

/// The nearest in the ego's path, of those whose places in `world`, vehicles first, are `wanted`.
pub fn nearest_in_front(
    facts: &EgoFacts<'_>,
    world: &WorldState,
    wanted: impl Fn(usize) -> bool,
) -> Option<LeadState> {
    let actors = world.vehicles.iter().chain(&world.pedestrians).enumerate();
    let actors = actors.filter(|(index, _)| wanted(*index)).filter_map(|(_, one)| in_path(facts, one));
    actors.min_by(|a, b| a.gap.total_cmp(&b.gap))
}

/// Who will cross the ego's path: the nearest of `world` of which `frame` (with its objects) shows enough, and whether somebody
/// crosses of whom it does not.
pub fn who_crosses(facts: &EgoFacts<'_>, world: &WorldState, frame: &Frame) -> (Option<LeadState>, bool) {
    let actors = world.vehicles.iter().chain(&world.pedestrians).enumerate();
    let crossing = actors.filter_map(|(index, one)| Some((index, crossing::truth(one, facts)?)));
    let (shown, hidden): (Vec<_>, Vec<_>) = crossing.partition(|&(index, _)| shows(frame, index));
    let nearest = shown.into_iter().map(|(_, lead)| lead).min_by(|a, b| a.gap.total_cmp(&b.gap));
    (nearest, !hidden.is_empty())
}

/// Where `actor` is in the ego's path.
fn in_path(facts: &EgoFacts<'_>, actor: &Actor) -> Option<LeadState> {
    let on_route = &facts.on_route;
    let shape = &actor.actor_type;
    if (actor.pose.xy() - on_route.state.pose.xy()).norm() > REACH {
        return None;
    }
    let steps = (shape.length / 0.5).ceil().max(1.0) as usize;
    let mut nearest: Option<f64> = None;
    for i in 0..=steps {
        for side in [-0.5, -0.25, 0.0, 0.25, 0.5] {
            let along = shape.length * (i as f64 / steps as f64 - 0.5);
            let place = actor.pose.to_world(Vector::new(along, side * shape.width));
            let on = facts.ahead(place);
            // Beyond the ends of the searched stretch a point is off the route.
            if (on.distance - on.d.abs()).abs() > 0.1 || on.d.abs() > HALF_WAY {
                continue;
            }
            nearest = Some(nearest.map_or(on.s, |s: f64| s.min(on.s)));
        }
    }
    let gap = nearest? - on_route.front_s;
    if !(-1.0..=SIGHT).contains(&gap) {
        return None;
    }
    let course = facts.route.at(nearest?).pose.heading;
    let along = actor.speed * wrap_angle(actor.pose.heading - course).cos();
    Some(LeadState { gap: gap.max(0.0), closing_speed: on_route.state.speed - along })
}

/// Whether `frame` shows enough of the road user that has this place in the world.
fn shows(frame: &Frame, index: usize) -> bool {
    let id = index as u32 + 1;
    frame.objects.iter().any(|object| object.id == id && is_visible(object, frame))
}

/// Borders of the distances that are reported apart (m).
const BORDERS: [f64; 6] = [0.0, 5.0, 10.0, 20.0, 30.0, SIGHT];

/// Pairs of truth and detection over frames.
#[derive(Clone, Debug, Default)]
pub struct LeadScore {
    pairs: Vec<(Option<LeadState>, Option<LeadState>)>,
}

/// Figures of a range of true gaps.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LeadBin {
    /// Lower border of the true gap (m).
    pub from: f64,
    /// Upper border of the true gap (m).
    pub to: f64,
    /// Frames with a true gap in this range.
    pub frames: usize,
    /// Share in which a vehicle in front was reported within 3 m or a quarter of the gap.
    pub recall: Option<f64>,
    /// Absolute errors of the gap (m), whatever was reported.
    pub gap_error: Spread,
    /// Mean error of the gap (m), reported less true.
    pub gap_bias: Option<f64>,
    /// Absolute errors of the closing speed (m/s).
    pub closing_error: Spread,
}

/// All figures.
#[derive(Clone, Debug, Serialize)]
pub struct LeadReport {
    /// By the true gap.
    pub bins: Vec<LeadBin>,
    /// Frames in which nobody is there.
    pub free_frames: usize,
    /// The share of them in which somebody was reported.
    pub false_leads: Option<f64>,
}

impl LeadScore {
    /// Counts a frame.
    pub fn add(&mut self, truth: Option<LeadState>, seen: Option<LeadState>) {
        self.pairs.push((truth, seen));
    }

    /// The figures.
    pub fn report(&self) -> LeadReport {
        let bins = BORDERS.windows(2).map(|border| self.bin(border[0], border[1])).collect();
        let free: Vec<_> = self.pairs.iter().filter(|(truth, _)| truth.is_none()).collect();
        let wrong = free.iter().filter(|(_, seen)| seen.is_some()).count();
        LeadReport { bins, free_frames: free.len(), false_leads: share(wrong, free.len()) }
    }

    fn bin(&self, from: f64, to: f64) -> LeadBin {
        let (mut frames, mut found) = (0, 0);
        let (mut gaps, mut closings) = (Vec::new(), Vec::new());
        for (truth, seen) in &self.pairs {
            let Some(truth) = truth.filter(|t| t.gap >= from && t.gap < to) else { continue };
            frames += 1;
            if let Some(seen) = seen {
                let error = seen.gap - truth.gap;
                found += usize::from(error.abs() <= 3.0_f64.max(0.25 * truth.gap));
                gaps.push(error);
                closings.push(seen.closing_speed - truth.closing_speed);
            }
        }
        let bias = (!gaps.is_empty()).then(|| gaps.iter().sum::<f64>() / gaps.len() as f64);
        LeadBin {
            from,
            to,
            frames,
            recall: share(found, frames),
            gap_error: Spread::of(&gaps),
            gap_bias: bias,
            closing_error: Spread::of(&closings),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumo_network::geometry::Pose;
    use wad_camera::ObjectTruth;
    use wad_camera::model::{Box3, ObjectClass};

    #[test]
    fn who_shows_enough_to_be_detected_counts_whatever_the_pictures_size() {
        let shows_in = |side: usize, visible_pixels: u32| {
            let bounds = Box3 { pose: Pose::new(0.0, 0.0, 0.0, 0.0), size: [4.5, 1.8, 1.5] };
            let (visible_box, full_box) = ([0, 0, 4, 4], [0.0, 0.0, 4.0, 4.0]);
            let class = ObjectClass::Car;
            let one =
                ObjectTruth { class, id: 1, visible_pixels, visible_box, full_box, bounds, depth: 20.0 };
            shows(&Frame { width: side, height: side, objects: vec![one], ..Frame::default() }, 0)
        };
        assert_eq!([shows_in(512, 11), shows_in(512, 12)], [false, true]);
        assert_eq!([shows_in(256, 2), shows_in(256, 3)], [false, true]);
    }

    #[test]
    fn misses_lower_recall_and_leave_errors_alone() {
        let mut score = LeadScore::default();
        let truth = Some(LeadState { gap: 15.0, closing_speed: 2.0 });
        score.add(truth, Some(LeadState { gap: 15.5, closing_speed: 1.0 }));
        score.add(truth, None);
        score.add(None, Some(LeadState { gap: 4.0, closing_speed: 0.0 }));
        score.add(None, None);
        let report = score.report();
        let bin = report.bins[2];
        assert_eq!((bin.frames, bin.recall, bin.gap_error.median), (2, Some(0.5), Some(0.5)));
        assert_eq!((report.free_frames, report.false_leads), (2, Some(0.5)));
        assert_eq!(report.bins[0].recall, None);
    }
}
