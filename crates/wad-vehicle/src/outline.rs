//! Cuts simple polygons into convex ones, because the physics engine only takes convex shapes.

use sumo_network::geometry::Point;

/// The convex pieces of a simple polygon, counter-clockwise each. Fewer than three corners,
/// or no area, give none. A polygon that crosses itself gives pieces that cover most of it.
pub(super) fn convex_pieces(outline: &[Point]) -> Vec<Vec<Point>> {
    let outline = cleaned(outline);
    if outline.len() < 3 {
        return Vec::new();
    }
    if is_convex(&outline) {
        return vec![outline];
    }
    merged(triangles(&outline))
}

/// Twice the signed area of the triangle a b c; positive when counter-clockwise.
fn turn(a: Point, b: Point, c: Point) -> f64 {
    (b - a).perp(&(c - a))
}

/// Twice the signed area of a polygon.
fn area2(outline: &[Point]) -> f64 {
    let n = outline.len();
    (0..n).map(|i| outline[i].coords.perp(&outline[(i + 1) % n].coords)).sum()
}

/// Counter-clockwise, finite, without repeated corners; empty when there is no area.
fn cleaned(outline: &[Point]) -> Vec<Point> {
    let mut corners: Vec<Point> = Vec::with_capacity(outline.len());
    for &p in outline.iter().filter(|p| p.x.is_finite() && p.y.is_finite()) {
        if corners.last().is_none_or(|last| (p - last).norm() > 1e-3) {
            corners.push(p);
        }
    }
    while corners.len() > 1 && (corners[0] - corners[corners.len() - 1]).norm() <= 1e-3 {
        corners.pop();
    }
    let Some(&base) = corners.first() else { return corners };
    let local: Vec<Point> = corners.iter().map(|p| Point::from(p - base)).collect();
    let area = area2(&local);
    if area.abs() < 1e-6 {
        return Vec::new();
    }
    if area < 0.0 {
        corners.reverse();
    }
    corners
}

fn is_convex(outline: &[Point]) -> bool {
    let n = outline.len();
    (0..n).all(|i| turn(outline[i], outline[(i + 1) % n], outline[(i + 2) % n]) >= -1e-9)
}

/// Ear clipping.
fn triangles(outline: &[Point]) -> Vec<Vec<Point>> {
    let mut rest = outline.to_vec();
    let mut cut = Vec::new();
    while rest.len() > 3 {
        let n = rest.len();
        let ear = (0..n).find(|&i| {
            let (a, b, c) = (rest[(i + n - 1) % n], rest[i], rest[(i + 1) % n]);
            turn(a, b, c) > 1e-9
                && !rest.iter().any(|&p| {
                    p != a
                        && p != b
                        && p != c
                        && turn(a, b, p) >= 0.0
                        && turn(b, c, p) >= 0.0
                        && turn(c, a, p) >= 0.0
                })
        });
        // No ear is left only where the outline crosses or doubles itself: drop the flattest corner.
        let index = ear.unwrap_or_else(|| {
            let size = |i: usize| turn(rest[(i + n - 1) % n], rest[i], rest[(i + 1) % n]).abs();
            (0..n).min_by(|&i, &j| size(i).total_cmp(&size(j))).unwrap_or(0)
        });
        if ear.is_some() {
            cut.push(vec![rest[(index + n - 1) % n], rest[index], rest[(index + 1) % n]]);
        }
        rest.remove(index);
    }
    if area2(&rest) > 1e-9 {
        cut.push(rest);
    }
    cut
}

/// Joins neighbours for as long as the result stays convex.
fn merged(mut pieces: Vec<Vec<Point>>) -> Vec<Vec<Point>> {
    let mut i = 0;
    while i < pieces.len() {
        let joined = (i + 1..pieces.len()).find_map(|j| join(&pieces[i], &pieces[j]).map(|piece| (j, piece)));
        match joined {
            Some((j, piece)) => {
                pieces[i] = piece;
                pieces.remove(j);
            }
            None => i += 1,
        }
    }
    pieces
}

/// One convex polygon from two that share an edge.
fn join(a: &[Point], b: &[Point]) -> Option<Vec<Point>> {
    for i in 0..a.len() {
        let (p, q) = (a[i], a[(i + 1) % a.len()]);
        let Some(j) = (0..b.len()).find(|&j| b[j] == q && b[(j + 1) % b.len()] == p) else { continue };
        let mut piece: Vec<Point> = (1..=a.len()).map(|k| a[(i + k) % a.len()]).collect();
        piece.extend((2..b.len()).map(|k| b[(j + k) % b.len()]));
        if is_convex(&piece) {
            return Some(piece);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points(corners: &[[f64; 2]]) -> Vec<Point> {
        corners.iter().map(|c| Point::new(c[0], c[1])).collect()
    }

    #[test]
    fn an_l_shape_becomes_two_pieces_of_the_same_area() {
        let l = points(&[[0.0, 0.0], [10.0, 0.0], [10.0, 4.0], [4.0, 4.0], [4.0, 10.0], [0.0, 10.0]]);
        let pieces = convex_pieces(&l);
        assert_eq!(pieces.len(), 2);
        assert!(pieces.iter().all(|p| is_convex(p)));
        let area: f64 = pieces.iter().map(|p| 0.5 * area2(p)).sum();
        assert!((area - 64.0).abs() < 1e-9, "{area}");
    }

    #[test]
    fn a_clockwise_closed_square_is_one_counter_clockwise_piece() {
        let square = points(&[[0.0, 0.0], [0.0, 2.0], [2.0, 2.0], [2.0, 0.0], [0.0, 0.0]]);
        let pieces = convex_pieces(&square);
        assert_eq!(pieces.len(), 1);
        assert_eq!(pieces[0].len(), 4);
        assert!(area2(&pieces[0]) > 0.0);
    }

    #[test]
    fn degenerate_outlines_give_nothing() {
        assert!(convex_pieces(&[]).is_empty());
        assert!(convex_pieces(&points(&[[0.0, 0.0], [1.0, 1.0]])).is_empty());
        assert!(convex_pieces(&points(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])).is_empty());
        assert!(convex_pieces(&points(&[[f64::NAN, 0.0], [1.0, 1.0], [2.0, 2.0]])).is_empty());
    }

    proptest! {
        #[test]
        fn star_shaped_polygons_keep_their_area(radii in prop::collection::vec(1.0..20.0f64, 3..30)) {
            let n = radii.len() as f64;
            let outline: Vec<Point> = radii
                .iter()
                .enumerate()
                .map(|(i, r)| {
                    let angle = i as f64 / n * std::f64::consts::TAU;
                    Point::new(500.0 + r * angle.cos(), -300.0 + r * angle.sin())
                })
                .collect();
            let pieces = convex_pieces(&outline);
            prop_assert!(pieces.iter().all(|p| is_convex(p)));
            let area: f64 = pieces.iter().map(|p| 0.5 * area2(p)).sum();
            prop_assert!((area - 0.5 * area2(&outline)).abs() < 1e-6 * area.abs().max(1.0));
        }
    }
}
