//! Nets' plane polygons of any shape: triangulates them, and cuts them along tiles.

use sumo_network::geometry::Point;

/// Twice the signed area (m2) of a triangle; positive counter-clockwise.
pub(super) fn turn(a: Point, b: Point, c: Point) -> f64 {
    (b - a).perp(&(c - a))
}

/// Signed area (m2); positive counter-clockwise.
pub(super) fn area(outline: &[Point]) -> f64 {
    let n = outline.len();
    (0..n).map(|i| outline[i].coords.perp(&outline[(i + 1) % n].coords)).sum::<f64>() * 0.5
}

/// The outline counter-clockwise, without repeated and non-finite points; empty where nothing is left.
pub(super) fn cleaned(outline: &[Point]) -> Vec<Point> {
    let mut kept: Vec<Point> = Vec::with_capacity(outline.len());
    for &p in outline {
        let finite = p.x.is_finite() && p.y.is_finite() && p.coords.amax() < 1e7;
        if finite && kept.last().is_none_or(|q| (p - q).norm() > 1e-3) {
            kept.push(p);
        }
    }
    while kept.len() > 1 && (kept[0] - kept[kept.len() - 1]).norm() <= 1e-3 {
        kept.pop();
    }
    if kept.len() < 3 {
        return Vec::new();
    }
    if area(&kept) < 0.0 {
        kept.reverse();
    }
    kept
}

fn in_triangle(p: Point, [a, b, c]: [Point; 3]) -> bool {
    turn(a, b, p) >= 0.0 && turn(b, c, p) >= 0.0 && turn(c, a, p) >= 0.0
}

/// Counter-clockwise triangles that cover a polygon: ear clipping. A polygon that crosses itself gives
/// triangles that cover about what it covers; what has no area gives none.
pub(super) fn triangulate(outline: &[Point]) -> Vec<[Point; 3]> {
    let mut ring = cleaned(outline);
    let mut triangles = Vec::new();
    while ring.len() > 3 {
        let n = ring.len();
        let corner = |i: usize| [ring[(i + n - 1) % n], ring[i], ring[(i + 1) % n]];
        let is_ear = |i: usize| {
            let t = corner(i);
            turn(t[0], t[1], t[2]) > 1e-9
                && (0..n).all(|k| {
                    let others = k != i && k != (i + 1) % n && k != (i + n - 1) % n;
                    !others || ring[k] == t[0] || ring[k] == t[2] || !in_triangle(ring[k], t)
                })
        };
        // No ear: the outline crosses itself. Its flattest corner goes, with the triangle if it turns left.
        let flattest = || {
            (0..n).min_by(|&i, &k| {
                let size = |i: usize| {
                    let t = corner(i);
                    turn(t[0], t[1], t[2]).abs()
                };
                size(i).total_cmp(&size(k))
            })
        };
        let Some(i) = (0..n).find(|&i| is_ear(i)).or_else(flattest) else { break };
        let t = corner(i);
        if turn(t[0], t[1], t[2]) > 1e-9 {
            triangles.push(t);
        }
        ring.remove(i);
    }
    if let [a, b, c] = ring[..]
        && turn(a, b, c) > 1e-9
    {
        triangles.push([a, b, c]);
    }
    triangles
}

/// The part of a convex polygon within an upright rectangle.
pub(super) fn clipped(polygon: &[Point], lo: Point, hi: Point) -> Vec<Point> {
    let mut current = polygon.to_vec();
    for (axis, limit, sign) in [(0, lo.x, 1.0), (0, hi.x, -1.0), (1, lo.y, 1.0), (1, hi.y, -1.0)] {
        let depth = |p: &Point| sign * (p[axis] - limit);
        let mut next = Vec::with_capacity(current.len() + 2);
        for i in 0..current.len() {
            let (a, b) = (current[i], current[(i + 1) % current.len()]);
            let (da, db) = (depth(&a), depth(&b));
            if da >= 0.0 {
                next.push(a);
            }
            if (da > 0.0 && db < 0.0) || (da < 0.0 && db > 0.0) {
                next.push(a + (b - a) * (da / (da - db)));
            }
        }
        current = next;
        if current.len() < 3 {
            return Vec::new();
        }
    }
    current
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn covered(triangles: &[[Point; 3]]) -> f64 {
        triangles.iter().map(|t| 0.5 * turn(t[0], t[1], t[2])).sum()
    }

    #[test]
    fn a_concave_polygon_is_covered_exactly() {
        let l = [(0., 0.), (4., 0.), (4., 1.), (1., 1.), (1., 3.), (0., 3.), (0., 0.)]
            .map(|(x, y)| Point::new(x, y));
        let triangles = triangulate(&l);
        assert!((covered(&triangles) - 6.0).abs() < 1e-9 && triangles.len() == 4);
        let mut backwards = l;
        backwards.reverse();
        assert!((covered(&triangulate(&backwards)) - 6.0).abs() < 1e-9);
    }

    #[test]
    fn shapes_without_area_give_nothing() {
        let p = Point::new(3.0, 4.0);
        assert!(triangulate(&[]).is_empty());
        assert!(triangulate(&[p, p, p, p]).is_empty());
        assert!(triangulate(&[p, Point::new(5.0, 4.0), Point::new(9.0, 4.0)]).is_empty());
        assert!(triangulate(&[p, Point::new(f64::NAN, 4.0), Point::new(9.0, 5.0)]).is_empty());
    }

    proptest! {
        /// Points in any order: spikes, crossings, repeats.
        #[test]
        fn any_outline_gives_counter_clockwise_triangles_within_it(
            points in prop::collection::vec((-50.0..50.0f64, -50.0..50.0f64), 0..24),
            repeat in 0..4usize,
        ) {
            let mut outline: Vec<Point> = points.iter().map(|&(x, y)| Point::new(x, y)).collect();
            for _ in 0..repeat {
                outline.extend(outline.first().copied());
            }
            let triangles = triangulate(&outline);
            prop_assert!(triangles.len() <= outline.len());
            for t in &triangles {
                prop_assert!(turn(t[0], t[1], t[2]) > 0.0);
                prop_assert!(t.iter().all(|p| outline.contains(p)));
            }
        }

        /// Star-shaped outlines do not cross themselves: their area is kept.
        #[test]
        fn a_simple_outline_keeps_its_area(radii in prop::collection::vec(1.0..30.0f64, 3..30)) {
            let n = radii.len() as f64;
            let outline: Vec<Point> = radii
                .iter()
                .enumerate()
                .map(|(i, r)| {
                    let (s, c) = (i as f64 / n * std::f64::consts::TAU).sin_cos();
                    Point::new(r * c, r * s)
                })
                .collect();
            prop_assert!((covered(&triangulate(&outline)) - area(&outline)).abs() < 1e-6 * area(&outline));
        }

        /// Tiles cut a triangle without loss.
        #[test]
        fn tiles_share_a_triangle(x in prop::collection::vec(-40.0..40.0f64, 6)) {
            let t = [Point::new(x[0], x[1]), Point::new(x[2], x[3]), Point::new(x[4], x[5])];
            let mut sum = 0.0;
            for i in -3..3 {
                for j in -3..3 {
                    let lo = Point::new(f64::from(i) * 16.0, f64::from(j) * 16.0);
                    sum += area(&clipped(&t, lo, lo + sumo_network::geometry::Vector::new(16.0, 16.0)));
                }
            }
            prop_assert!((sum - area(&t)).abs() < 1e-6);
        }
    }
}
