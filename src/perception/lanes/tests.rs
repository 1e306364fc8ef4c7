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
