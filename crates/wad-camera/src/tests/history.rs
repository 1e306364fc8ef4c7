//! A frame is a function of its shot: nothing that the camera saw before, and no way that it took, shows.

use super::places::Place;
use crate::{Camera, CameraConfig, Frame, Outputs, Preset, Weather};
use sumo_network::geometry::Pose;

fn render(camera: &mut Camera, place: &Place, pose: &Pose, weather: &Weather) -> Frame {
    camera.render(place.town.scene(), place.town.actors(), pose, weather, Outputs::ALL).clone()
}

/// Shadows lie in a map of 256 m that wraps round: what an earlier place left in it must not be read.
#[test]
fn a_camera_that_drove_about_sees_what_a_new_one_sees() {
    for (town, preset) in [("town5", Preset::ClearSunset), ("town3", Preset::ClearNoon)] {
        let mut place = Place::bundled(town);
        let weather = Weather::from(preset);
        let poses: Vec<Pose> = place
            .straight_lanes(40.0)
            .step_by(7)
            .take(12)
            // Askew as in a turn: the picture's corner then reaches farthest along one axis of the map.
            .flat_map(|lane| {
                [(0.0, 0.0), (12.0, 0.8), (30.0, -0.7)].map(|(s, turn)| (lane.shape.at(s), turn))
            })
            .map(|(pose, turn)| Pose { heading: pose.heading + turn, ..pose })
            .collect();
        let users: Vec<(usize, Pose)> = poses.iter().map(|pose| (0, pose.advanced(9.0))).collect();
        place.put(&users);
        let mut old = Camera::new(CameraConfig::default()).unwrap();
        for (number, pose) in poses.iter().enumerate() {
            let mut new = Camera::new(CameraConfig::default()).unwrap();
            let (old, new) =
                (render(&mut old, &place, pose, &weather), render(&mut new, &place, pose, &weather));
            let differ = old.rgb.chunks(3).zip(new.rgb.chunks(3)).filter(|(a, b)| a != b).count();
            assert_eq!(differ, 0, "{town}, pose {number}: pixels that show where the camera was before");
            assert_eq!(old.depth, new.depth);
            assert_eq!(old.objects, new.objects);
        }
    }
}
