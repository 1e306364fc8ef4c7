use super::*;

fn line(offset: f32, slope: f32, bend: f32) -> LaneBoundary {
    LaneBoundary { offset, slope, bend, reach: [3.0, 25.0] }
}

#[test]
fn a_boundary_moves_with_the_ego() {
    let was = Pose::new(100.0, 50.0, 0.0, 0.7);
    let is = Pose { heading: 0.75, ..was.advanced(1.5) };
    let old = line(1.6, 0.02, 0.004);
    let new = moved(&old, &was, &is).unwrap();
    for x in [6.0, 10.0, 16.0] {
        let place = was.to_world(Vector::new(f64::from(x), f64::from(old.y(x))));
        let seen = is.to_local(place);
        assert!((f64::from(new.y(seen.x as f32)) - seen.y).abs() < 0.02, "{new:?} at {seen:?}");
    }
    assert!((new.reach[1] - 23.5).abs() < 1e-3);
    assert!(moved(&old, &was, &was.advanced(40.0)).is_none(), "a jump is no motion");
}

/// Detection on a synthetic road.
mod found {
    use super::*;
    use crate::perception::testing::{Road, picture};
    use wad_camera::CameraConfig;

    fn see(lines: &[LaneBoundary], s: f64) -> LaneEstimate {
        let camera = CameraConfig::default();
        let road = Road::new("GGG");
        let frame = picture(&camera, lines);
        let ground = GroundPlane::new(&camera);
        LaneDetector::default().find(&frame, &ground, &road.facts(s, 0.0, 0.0, 8.0))
    }

    fn check(seen: Option<LaneBoundary>, painted: &LaneBoundary) {
        let seen = seen.expect("the line is found");
        for x in [6.0, 10.0, 15.0] {
            let error = seen.y(x) - painted.y(x);
            assert!(error.abs() < 0.08, "{error:.3} m off at {x} m: {seen:?}, painted {painted:?}");
        }
    }

    #[test]
    fn straight_lines_and_bends_are_found_where_they_are() {
        for (slope, bend) in [(0.0, 0.0), (0.1, 0.0), (-0.06, 0.004), (0.0, 0.02), (0.02, -0.03)] {
            let painted = [line(1.5, slope, bend), line(-1.45, slope, bend)];
            let seen = see(&painted, 60.0);
            check(seen.left, &painted[0]);
            check(seen.right, &painted[1]);
        }
    }

    #[test]
    fn the_lines_of_other_lanes_are_not_taken_for_the_egos() {
        let painted = [line(4.7, 0.0, 0.0), line(1.55, 0.0, 0.0), line(-1.6, 0.0, 0.0), line(-4.8, 0.0, 0.0)];
        let seen = see(&painted, 60.0);
        check(seen.left, &painted[1]);
        check(seen.right, &painted[2]);
    }

    #[test]
    fn one_dash_is_enough_and_a_plain_road_has_no_lines() {
        let dash = LaneBoundary { reach: [7.0, 10.0], ..line(1.6, 0.0, 0.0) };
        let next = LaneBoundary { reach: [16.0, 19.0], ..dash };
        let seen = see(&[dash, next, line(-1.4, 0.0, 0.0)], 60.0);
        check(seen.left, &dash);
        assert_eq!(see(&[], 60.0), LaneEstimate::default());
    }

    #[test]
    fn nothing_is_looked_for_in_and_just_before_junctions() {
        let painted = [line(1.5, 0.0, 0.0), line(-1.5, 0.0, 0.0)];
        let stop = Road::new("GGG").route.links[0].stop_s;
        assert!(see(&painted, stop - 20.0).left.is_some());
        assert_eq!(see(&painted, stop - 4.0), LaneEstimate::default());
        assert_eq!(see(&painted, stop + 5.0), LaneEstimate::default());
    }

    #[test]
    fn a_line_out_of_sight_is_remembered_for_three_ticks() {
        let camera = CameraConfig::default();
        let (road, ground) = (Road::new("GGG"), GroundPlane::new(&camera));
        let lines = [line(1.5, 0.0, 0.0), line(-1.5, 0.0, 0.0)];
        let (both, one) = (picture(&camera, &lines), picture(&camera, &lines[..1]));
        let mut detector = LaneDetector::default();
        let mut look = |frame: &Frame, tick: usize| {
            let facts = road.facts(60.0 + tick as f64, 0.0, 0.0, 6.0);
            detector.find(frame, &ground, &facts).right
        };
        assert!(look(&both, 0).is_some());
        let remembered: Vec<bool> = (1..6).map(|tick| look(&one, tick).is_some()).collect();
        assert_eq!(remembered, [true, true, true, false, false]);
        assert!(look(&both, 6).is_some());
    }
}

/// Canny and Hough, held to OpenCV's.
#[cfg(feature = "vision")]
mod as_opencv {
    use super::super::canny::Canny;
    use super::super::hough::{Hough, Wanted};
    use opencv::core::{Mat, Vec4i, Vector};
    use opencv::imgproc;
    use opencv::prelude::MatTraitConstManual;
    use rand::RngExt;
    use sumo_network::seeds;

    /// Stripes, blobs and noise.
    fn picture(n: u64, width: usize, height: usize) -> Vec<u8> {
        let mut rng = seeds::rng(n, "picture");
        let noise = [0, 3, 20, 120][(n % 4) as usize];
        let waves: [f32; 6] = std::array::from_fn(|_| 0.3 * rng.random::<f32>() - 0.15);
        let mut pixels = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let [x, y] = [x as f32, y as f32];
                let wave: f32 =
                    waves.chunks_exact(2).map(|w| 30.0 * (x * w[0] + y * w[1]).sin().signum()).sum();
                let grain = if noise > 0 { rng.random_range(-noise..=noise) } else { 0 };
                pixels.push((110.0 + wave + grain as f32).clamp(0.0, 255.0) as u8);
            }
        }
        pixels
    }

    #[test]
    fn edges_and_lines_equal_those_of_opencv() {
        let (mut canny, mut hough) = (Canny::default(), Hough::default());
        let (mut edges, mut lines) = (Vec::new(), Vec::new());
        let (mut edges_seen, mut lines_seen) = (0, 0);
        for n in 0..24 {
            let (width, height) = [(512, 190), (256, 97), (64, 64), (40, 9)][n as usize % 4];
            let grey = picture(n / 4 + n % 4, width, height);
            canny.find(&grey, width, [25, 70], &mut edges);
            let grey = Mat::new_rows_cols_with_data(height as i32, width as i32, &grey).unwrap();
            let mut expected = Mat::default();
            imgproc::canny(&grey, &mut expected, 25.0, 70.0, 3, false).unwrap();
            assert_eq!(edges, expected.data_bytes().unwrap(), "edges of picture {n}");
            let wanted = Wanted { votes: 14, length: 12, gap: 4 };
            hough.find(&edges, width, wanted, &mut lines);
            let mut expected: Vector<Vec4i> = Vector::new();
            let step = std::f64::consts::PI / 180.0;
            let found = Mat::new_rows_cols_with_data(height as i32, width as i32, &edges).unwrap();
            imgproc::hough_lines_p(&found, &mut expected, 1.0, step, 14, 12.0, 4.0).unwrap();
            let expected: Vec<[i32; 4]> = expected.iter().map(|line| line.0).collect();
            assert_eq!(lines, expected, "lines of picture {n}");
            edges_seen += edges.iter().filter(|edge| **edge != 0).count();
            lines_seen += lines.len();
        }
        assert!(edges_seen > 10_000 && lines_seen > 500, "{edges_seen} {lines_seen}");
    }
}
