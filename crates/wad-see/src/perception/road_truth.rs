//! What is true of the ego's lane and of its light: the labels of networks that see, and the measure of them.

use super::{DrivableArea, EgoFacts, LightAhead, SignTruth};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use sumo_network::geometry::{Pose, Vector, wrap_angle};
use sumo_network::network::{EdgeKind, LaneId, Network, SignalIndex};
use sumo_network::world::{SignalState, WorldState};
use wad_camera::model::{ObjectClass, PlacedSign, Scene};
use wad_camera::scene::painted_sides;
use wad_camera::{CameraConfig, Frame, View};

/// A boundary is known this far ahead of the ego's centre (m), at points this far apart along the lane (m).
const FAR: f64 = 40.0;
const STEP: f64 = 1.0;
/// Heads that face the ego's way this well show its light (rad).
const FACING: f64 = 0.7;

/// The ego's lane and light in a frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RoadTruth {
    /// Left and right boundary of the ego's lane up to its end: points (x ahead, y left, m, ego frame), near to
    /// far. None inside junctions.
    pub boundaries: Option<[Vec<[f32; 2]>; 2]>,
    /// The ids, as in [`wad_camera::Frame::objects`], of the signal heads that show the ego's light; where it has none,
    /// of those that face it where its lane ends.
    pub heads: Vec<u32>,
    /// The signs in the picture; None where nobody looked for them.
    #[serde(default)]
    pub signs: Option<Vec<SignTruth>>,
    /// What of the picture is road; None where nobody looked.
    #[serde(default)]
    pub area: Option<DrivableArea>,
}

impl RoadTruth {
    /// The truth for an ego in a world.
    pub fn find(facts: &EgoFacts<'_>, world: &WorldState, heads: &Heads) -> Self {
        Self { boundaries: boundaries(facts), heads: heads.of_ego(facts, world), signs: None, area: None }
    }

    /// With what `frame`, with depth and semantics, shows from the ego's `camera` at `pose`: of the town's `signs`, and of the road.
    #[must_use]
    pub fn with_frame(
        mut self,
        signs: &[PlacedSign],
        camera: &CameraConfig,
        pose: &Pose,
        frame: &Frame,
    ) -> Self {
        self.signs = Some(SignTruth::find(signs, &View::new(camera, pose), frame));
        self.area = DrivableArea::of(frame);
        self
    }
}

/// Lowest signal head that counts (pixels).
const LEAST_HEAD: f32 = 6.0;

impl RoadTruth {
    /// What is to be seen in a picture with these objects: id, visible box, and whether too much of it is hidden. `light`
    /// is the ego's: its state and the distance of its stop line (m).
    pub fn wanted(
        &self,
        objects: impl Iterator<Item = (u32, [f32; 4], bool)>,
        light: Option<(SignalState, f64)>,
    ) -> RoadWanted {
        let heads = objects.filter(|(id, ..)| self.heads.contains(id));
        let heads = heads.map(|(_, bounds, hidden)| (bounds, !hidden && bounds[3] - bounds[1] >= LEAST_HEAD));
        let light = light.and_then(|(state, distance)| Some((colour(state)?, distance as f32)));
        RoadWanted {
            boundaries: self.boundaries.clone(),
            heads: heads.collect(),
            light,
            signs: self.signs.clone(),
            area: self.area,
        }
    }
}

/// What a network that sees the road is to say of a whole picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RoadWanted {
    /// Left and right boundary of the ego's lane (m, ego frame), near to far; None inside junctions.
    pub boundaries: Option<[Vec<[f32; 2]>; 2]>,
    /// The boxes of [`RoadTruth::heads`] (left, top, right, bottom; pixels), and whether each is large and plain enough
    /// to count.
    pub heads: Vec<([f32; 4], bool)>,
    /// Its lamp (0 red, 1 yellow, 2 green) and the distance of its stop line (m).
    pub light: Option<(usize, f32)>,
    /// The signs in it; None where nobody looked for them.
    pub signs: Option<Vec<SignTruth>>,
    /// What is road; None where nobody looked.
    pub area: Option<DrivableArea>,
}

impl RoadWanted {
    /// The same in a mirror, for pictures of `width` pixels.
    #[must_use]
    pub fn mirrored(mut self, width: f32) -> Self {
        if let Some(sides) = &mut self.boundaries {
            sides.reverse();
            sides.iter_mut().flatten().for_each(|point| point[1] = -point[1]);
        }
        for ([l, _, r, _], _) in &mut self.heads {
            (*l, *r) = (width - *r, width - *l);
        }
        for sign in self.signs.iter_mut().flatten() {
            let [l, _, r, _] = &mut sign.bounds;
            (*l, *r) = (width - *r, width - *l);
            // In a mirror nobody can read.
            sign.is_plain = false;
        }
        self.area = self.area.map(|area| area.mirrored());
        self
    }
}

/// y (m, left positive) of a boundary at `x` m ahead; None where it does not reach.
pub(super) fn y_at(line: &[[f32; 2]], x: f32) -> Option<f32> {
    let pair = line.windows(2).find(|pair| (pair[0][0]..=pair[1][0]).contains(&x))?;
    let t = (x - pair[0][0]) / (pair[1][0] - pair[0][0]).max(1e-3);
    Some(pair[0][1] + t * (pair[1][1] - pair[0][1]))
}

/// The lane of its edge that the ego is nearest to: it may be half-way to the next one. None inside junctions.
pub(super) fn ego_lane(facts: &EgoFacts<'_>) -> Option<LaneId> {
    let network = facts.network;
    let pose = facts.on_route.state.pose;
    let s = facts.on_route.s;
    let on = network.lane(facts.route.section_at(s).lane);
    // Nets without internal lanes have junctions too.
    if network.edge(on.edge).kind != EdgeKind::Normal || facts.route.link_at(s).is_some() {
        return None;
    }
    let away = |id: &LaneId| network.lane(*id).shape.project(pose.xy()).distance;
    let lanes = network.edge(on.edge).lanes.iter().copied();
    lanes.filter(|id| painted_sides(network, *id) != [None; 2]).min_by(|a, b| away(a).total_cmp(&away(b)))
}

/// The painted line where there is one, else the lane's edge.
fn boundaries(facts: &EgoFacts<'_>) -> Option<[Vec<[f32; 2]>; 2]> {
    let id = ego_lane(facts)?;
    let lane = facts.network.lane(id);
    let [left, right] = painted_sides(facts.network, id);
    let pose = facts.on_route.state.pose;
    let begin = lane.shape.project(pose.xy()).s;
    let end = (lane.shape.length() - begin).min(FAR);
    let points = |d: f64| {
        let places = (0..).map(|i| f64::from(i) * STEP).take_while(|ahead| *ahead < end);
        let place = |ahead| pose.to_local(lane.shape.at(begin + ahead).to_world(Vector::new(0.0, d)));
        places.map(place).map(|p| [p.x as f32, p.y as f32]).collect()
    };
    let half = 0.5 * lane.width;
    Some([points(left.unwrap_or(half)), points(right.unwrap_or(-half))])
}

/// The signal heads of a town: what each shows, and to whom.
#[derive(Clone, Debug, Default)]
pub struct Heads {
    /// By id: the signal, and the heading of the traffic that it faces (rad).
    by_id: HashMap<u32, (SignalIndex, f64)>,
}

impl Heads {
    /// The heads for vehicles in a scene of `network`.
    pub fn new(network: &Network, scene: &Scene) -> Self {
        let walkers: Vec<SignalIndex> = network.crossings.iter().filter_map(|c| c.signal).collect();
        let head = |instance: &wad_camera::model::Instance| {
            let (signal, object) = (instance.signal?, instance.object?);
            let counts = object.class == ObjectClass::TrafficLight && !walkers.contains(&signal);
            counts.then_some((object.id, (signal, instance.pose.heading)))
        };
        let by_id = scene.chunks.iter().flat_map(|chunk| &chunk.instances).filter_map(head).collect();
        Self { by_id }
    }

    /// Those of the ego's traffic light that face it and show what its link shows, by id. Where no light is ahead on the
    /// route, because it ends before, those at the end of the ego's lane, whatever they show: no picture says that a
    /// light in front is none.
    fn of_ego(&self, facts: &EgoFacts<'_>, world: &WorldState) -> Vec<u32> {
        let (state, lights, heading) = match LightAhead::with_signal(facts) {
            Some((light, signal, heading)) => {
                (Some(colour(light.state)), vec![signal.traffic_light], heading)
            }
            None => {
                let Some(lane) = ego_lane(facts).map(|id| facts.network.lane(id)) else { return Vec::new() };
                let signals = lane.outgoing.iter().filter_map(|link| facts.network.link(*link).signal);
                let end = lane.shape.at(lane.shape.length());
                (None, signals.map(|signal| signal.traffic_light).collect(), end.heading)
            }
        };
        let shows = |index: SignalIndex| state.is_none() || world.signal(index).map(colour) == state;
        let is_his = |(index, faces): &(SignalIndex, f64)| {
            lights.contains(&index.traffic_light)
                && wrap_angle(faces - heading).abs() < FACING
                && shows(*index)
        };
        let mut ids: Vec<u32> =
            self.by_id.iter().filter(|(_, head)| is_his(head)).map(|(id, _)| *id).collect();
        ids.sort_unstable();
        ids
    }
}

/// The lamp that is lit: 0 red, 1 yellow, 2 green; None for a light that is off or blinks.
pub fn colour(state: SignalState) -> Option<usize> {
    match state {
        SignalState::Red | SignalState::RedYellow => Some(0),
        SignalState::Yellow => Some(1),
        SignalState::GreenMinor | SignalState::GreenMajor => Some(2),
        SignalState::StopThenGo | SignalState::Off => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::testing::Road;
    use sumo_network::network::testing::place;
    use sumo_network::network::{Shapes, VehicleClass};
    use wad_camera::Town;

    #[test]
    fn boundaries_lie_beside_the_ego_and_end_with_the_lane() {
        let road = Road::new("rGG");
        let stop = road.route.links[0].stop_s;
        let truth = |before: f64, d: f64| boundaries(&road.facts(stop - before, d, 0.0, 5.0));
        let [left, right] = truth(60.0, 0.0).unwrap();
        assert!(left[0][1] > 1.2 && left[0][1] < 2.2 && right[0][1] < -1.2, "{left:?} {right:?}");
        assert!(left.len() == 40 && (left[39][0] - 39.0).abs() < 0.1);
        // Half a metre to the left, all of it is half a metre further right.
        let [moved, _] = truth(60.0, 0.5).unwrap();
        assert!((left[10][1] - moved[10][1] - 0.5).abs() < 1e-3);
        let [near, _] = truth(8.0, 0.0).unwrap();
        assert!(near.len() <= 9, "{near:?}");
        assert!(truth(-3.0, 0.0).is_none(), "inside the junction");
    }

    #[test]
    fn the_egos_heads_face_it_and_show_what_its_link_shows() {
        let road = Road::new("rGG");
        let stop = road.route.links[0].stop_s;
        let town = Town::new(&road.network, &Shapes::default(), wad_camera::scene::Look::of(1));
        let heads = Heads::new(&road.network, town.scene());
        let world = WorldState { traffic_lights: road.signals.clone(), ..WorldState::default() };
        let truth = RoadTruth::find(&road.facts(stop - 30.0, 0.0, 0.0, 5.0), &world, &heads);
        assert!(!truth.heads.is_empty());
        for id in &truth.heads {
            assert_eq!(world.signal(heads.by_id[id].0), Some(SignalState::Red));
        }
        assert!(heads.by_id.len() > truth.heads.len(), "others show green");
        // Past the line there is no light.
        assert!(RoadTruth::find(&road.facts(stop + 3.0, 0.0, 0.0, 5.0), &world, &heads).heads.is_empty());
        // A route that ends before the light: it has none, but those in front are not nothing.
        let mut short = road.facts(stop - 30.0, 0.0, 0.0, 5.0);
        let (from, to) = (place(&road.network, "ab_0", 20.0), place(&road.network, "ab_0", 260.0));
        let route = road.network.route(from, to, VehicleClass::Passenger).unwrap();
        short.route = &route;
        let in_front = RoadTruth::find(&short, &world, &heads).heads;
        assert!(LightAhead::find(&short).is_none());
        assert!(truth.heads.iter().all(|id| in_front.contains(id)), "{in_front:?}");
        assert!(in_front.len() > truth.heads.len(), "whatever they show");
    }
}
