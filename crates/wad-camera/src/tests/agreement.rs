//! What the picture shows lies where the map and the boxes say.

use super::places::{KINDS, Place};
use crate::{Camera, CameraConfig, Outputs, Preset, View};
use nalgebra::Point3;
use sumo_network::geometry::{Pose, Vector};

const SIZE: usize = 512;

/// Where paint shows in a row near column `x`: pixels that are clearly brighter than what is round them.
fn nearest_paint(rgb: &[u8], x: f32, row: usize, reach: usize) -> Option<f32> {
    let light = |x: usize| -> u32 { rgb[3 * (row * SIZE + x)..][..3].iter().map(|&c| u32::from(c)).sum() };
    let middle = x as usize;
    let (from, to) = (middle.checked_sub(3 * reach)?, middle + 3 * reach);
    if to >= SIZE {
        return None;
    }
    let mut round: Vec<u32> = (from..=to).map(light).collect();
    round.sort_unstable();
    let asphalt = round[round.len() / 3];
    (middle - reach..=middle + reach)
        .filter(|&at| light(at) > asphalt + 54)
        .map(|at| (at as f32 + 0.5 - x).abs())
        .min_by(f32::total_cmp)
}

#[test]
fn lane_borders_of_the_map_fall_on_painted_pixels() {
    for town in ["town3", "town5"] {
        let mut place = Place::bundled(town);
        place.put(&[]);
        let mut lanes = 0;
        let (mut painted, mut points, mut off) = (0, 0, Vec::new());
        for lane in place.straight_lanes(60.0).step_by(2) {
            let pose = lane.shape.at(25.0);
            let frame = place.shoot(SIZE, &pose, Preset::CloudyNoon);
            let view = View::new(&CameraConfig::default(), &pose);
            lanes += 1;
            for side in [-0.5, 0.5] {
                let paint = |ahead: f64| -> Option<(Option<f32>, f32)> {
                    // Along the lane: even one that passes for straight leaves its heading by a pixel.
                    let p = lane.shape.at(25.7 + ahead).to_world(Vector::new(0.0, side * lane.width));
                    let ([x, y], depth) = view.pixel(&Point3::new(p.x, p.y, pose.position.z))?;
                    Some((nearest_paint(&frame.rgb, x, y as usize, 7), depth))
                };
                // A dash and its gap are 9 m long.
                for step in 0..18 {
                    let ahead = 11.0 + 0.5 * f64::from(step);
                    let Some((found, depth)) = paint(ahead) else { continue };
                    points += 1;
                    if let Some(distance) = found {
                        painted += 1;
                        // A dash ends slanting: its last row shows one of its corners only.
                        let goes_on = |at: f64| paint(at).is_some_and(|(found, _)| found.is_some());
                        if !goes_on(ahead - 0.6) || !goes_on(ahead + 0.6) {
                            continue;
                        }
                        // As if it were 15 m away.
                        off.push(distance * depth / 15.0);
                        if distance * depth / 15.0 > 1.5 {
                            eprintln!("{town} {} side {side} ahead {ahead}: {distance:.1}", lane.id);
                        }
                    }
                }
            }
        }
        off.sort_by(f32::total_cmp);
        let (median, most) = (off[off.len() / 2], off[off.len() * 98 / 100]);
        println!(
            "{town}: {lanes} places, paint at {painted} of {points}, median {median:.2} px, 98 % {most:.2} px"
        );
        assert!(lanes >= 10 && off.len() > 150, "{lanes} places, {} points", off.len());
        // Dashes cover a third of a border between lanes, lines all of the others.
        assert!(2 * painted > points, "{town}: paint at {painted} of {points} points");
        assert!(most <= 1.5, "{town}: {most} px");
    }
}

#[test]
fn boxes_hold_all_pixels_of_road_users_with_a_pixels_slack() {
    let mut place = Place::bundled("town5");
    let pose = place.straight_lanes(80.0).next().unwrap().shape.at(20.0);
    let users: Vec<(usize, Pose)> = (0..KINDS.len())
        .flat_map(|kind| {
            [(9.0, 0.4), (17.0, 2.2), (33.0, -1.2)].map(|(ahead, turn)| {
                let across = (kind as f64 - 3.5) * 0.21 * ahead;
                let p = pose.advanced(ahead).to_world(Vector::new(0.0, across));
                (kind, Pose::new(p.x, p.y, pose.position.z, pose.heading + turn + kind as f64))
            })
        })
        .collect();
    // All of them together, some behind others.
    place.put(&users);
    let crowd = place.shoot(SIZE, &pose, Preset::ClearNoon);
    check_boxes(&crowd, false);
    // One at a time, nothing before it: no box is larger than what shows.
    let mut bare = place.town.scene().clone();
    bare.chunks.clear();
    bare.index();
    let mut checked = 0;
    for user in &users {
        place.put(std::slice::from_ref(user));
        let mut camera = Camera::new(CameraConfig::default()).unwrap();
        let weather = Preset::ClearNoon.into();
        checked +=
            check_boxes(camera.render(&bare, place.town.actors(), &pose, &weather, Outputs::ALL), true);
    }
    assert!(checked >= users.len(), "{checked}");
}

/// Compares boxes with the pixels of their instances; returns how many road users were seen.
fn check_boxes(frame: &crate::Frame, alone: bool) -> usize {
    let mut seen = 0;
    for object in frame.objects.iter().filter(|o| o.id < crate::model::STATIC_IDS) {
        let mut found = [u32::MAX, u32::MAX, 0, 0];
        let mut count = 0;
        for (i, _) in frame.instance.iter().enumerate().filter(|(_, id)| **id == object.id) {
            let (x, y) = ((i % SIZE) as u32, (i / SIZE) as u32);
            found = [found[0].min(x), found[1].min(y), found[2].max(x + 1), found[3].max(y + 1)];
            count += 1;
        }
        assert_eq!((object.visible_box, object.visible_pixels), (found, count), "{object:?}");
        seen += 1;
        for (side, (full, found)) in object.full_box.into_iter().zip(found).enumerate() {
            let outside = (full - found as f32) * if side < 2 { -1.0 } else { 1.0 };
            assert!(outside > -1.0, "{object:?}");
            // A cycle's rider hides some of it.
            let users = frame.objects.iter().filter(|o| o.id < crate::model::STATIC_IDS);
            let whole = alone && users.count() == 1;
            assert!(!whole || outside <= 1.0, "side {side}: {object:?}");
        }
    }
    seen
}
