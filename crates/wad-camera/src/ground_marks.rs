//! Marks on the ground that are not geometry: paint, and the shadows of road users.
//!
//! Convex polygons with exact coverage at their edges, written into two buffers that the shading of
//! ground surfaces reads.

use super::large::Large;
use super::model::{Chunk, Instance, Library, Paint};
use super::raster::{PAD, Visibility};
use super::simd::multiversion;
use super::view::{NEAR, View, cross, dot, sub};
use super::weather::Weather;

/// The buffers; rows as in the visibility buffer.
#[derive(Debug, Default)]
pub struct Marks {
    /// Coverage 0..255 of paint.
    pub paint: Large<u16>,
    /// Share of sun left by road users in the low byte, of sky light in the high byte.
    pub shade: Large<u16>,
    /// By row the pixels from .. to that may be touched.
    pub painted: Vec<[u32; 2]>,
    pub shaded: Vec<[u32; 2]>,
    stride: usize,
}

const UNTOUCHED: [u32; 2] = [u32::MAX, 0];

/// Paint farther than this (m) is not drawn.
const PAINT_DISTANCE: f32 = 140.0;
/// Road users farther than this (m) cast no shadow.
const SHADOW_DISTANCE: f32 = 90.0;

/// An edge of a polygon of the picture: distance inside = a x + b y + c, divided by the softness.
#[derive(Clone, Copy, Default)]
struct Edge([f32; 3]);

/// What a polygon does to a pixel.
#[derive(Clone, Copy)]
enum Ink {
    /// Strength (0..255).
    Paint(f32),
    /// What is left of sun and sky light in the middle (0..1).
    Shade(f32, f32),
}

const MOST: usize = 10;

/// A polygon ready to draw.
struct Shape {
    edges: [Edge; MOST],
    count: usize,
    /// Edges 0 and 1 bound a strip that may be thinner than a pixel.
    strip: bool,
    rows: (f32, f32),
    columns: (f32, f32),
    iz: [f32; 3],
    /// Largest difference of 1 / depth to what is seen, as a share.
    tolerance: f32,
    ink: Ink,
}

impl Marks {
    /// Empties the buffers.
    pub fn clear(&mut self, visibility: &Visibility) {
        let (stride, height) = (visibility.stride, visibility.height);
        if self.stride != stride || self.paint.len() != stride * height {
            self.stride = stride;
            self.paint.reset(stride * height, 0);
            self.shade.reset(stride * height, 0xffff);
        } else {
            wipe(&mut self.paint, &self.painted, stride, 0);
            wipe(&mut self.shade, &self.shaded, stride, 0xffff);
        }
        for rows in [&mut self.painted, &mut self.shaded] {
            rows.clear();
            rows.resize(height, UNTOUCHED);
        }
    }

    /// Draws a chunk's paint.
    pub fn paint(&mut self, chunk: &Chunk, view: &View, visibility: &Visibility) {
        let corner = view.point(&chunk.origin);
        for paint in &chunk.paint {
            if let Some(shape) = paint_shape(paint, corner, view) {
                draw(&shape, visibility, self);
            }
        }
    }

    /// Draws the shadow of a road user on the ground it stands on.
    pub fn shadow(
        &mut self,
        instance: &Instance,
        library: &Library,
        weather: &Weather,
        view: &View,
        visibility: &Visibility,
        sunny: bool,
    ) {
        let model = &library.models[instance.model.0 as usize];
        let own = [model.bounds];
        let boxes: &[[[f32; 3]; 2]] = if model.shadow_boxes.is_empty() { &own } else { &model.shadow_boxes };
        let origin = view.point(&instance.pose.position);
        if origin[2] > SHADOW_DISTANCE {
            return;
        }
        let (sin, cos) = (instance.pose.heading.sin() as f32, instance.pose.heading.cos() as f32);
        let s = instance.scale;
        let world = |x: f32, y: f32| [cos * x * s[0] - sin * y * s[1], sin * x * s[0] + cos * y * s[1]];
        let up = view.direction([0.0, 0.0, 1.0]);
        let height = -dot(origin, up);
        let place = |p: [f32; 2]| {
            let d = view.direction([p[0], p[1], 0.0]);
            [origin[0] + d[0], origin[1] + d[1], origin[2] + d[2]]
        };
        let mut cast = |outline: &[[f32; 2]], soft: f32, ink: Ink| {
            let corners: Vec<[f32; 3]> = outline.iter().map(|p| place(*p)).collect();
            if let Some(shape) = soft_shape(&corners, view, soft, height, ink) {
                draw(&shape, visibility, self);
            }
        };
        if sunny && weather.shadows > 0.05 {
            let throw =
                [-weather.sun[0] / weather.sun[2].max(0.1), -weather.sun[1] / weather.sun[2].max(0.1)];
            for b in boxes {
                let mut points: Vec<[f32; 2]> = (0..8)
                    .map(|corner| {
                        let [x, y] = world(b[corner & 1][0], b[corner >> 1 & 1][1]);
                        let h = b[corner >> 2][2].max(0.0) * s[2];
                        [x + throw[0] * h, y + throw[1] * h]
                    })
                    .collect();
                let outline = hull(&mut points);
                cast(&outline, 0.06, Ink::Shade(1.0 - weather.shadows, 1.0));
            }
        }
        // Under it the sky's light is missing too.
        let [low, high] = model.bounds;
        let grow = if high[0] - low[0] > 1.2 { -0.05 } else { 0.02 };
        let outline = [
            world(low[0] - grow, low[1] - grow),
            world(high[0] + grow, low[1] - grow),
            world(high[0] + grow, high[1] + grow),
            world(low[0] - grow, high[1] + grow),
        ];
        let thin = if high[0] - low[0] > 1.2 { 0.22 } else { 0.55 };
        cast(&outline, 0.5, Ink::Shade(thin, thin));
    }
}

fn wipe(words: &mut [u16], touched: &[[u32; 2]], stride: usize, value: u16) {
    for (row, &[from, to]) in words.chunks_exact_mut(stride).zip(touched) {
        if from < to {
            row[from as usize..(to as usize).min(stride)].fill(value);
        }
    }
}

/// Convex hull, counter-clockwise.
fn hull(points: &mut [[f32; 2]]) -> Vec<[f32; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let turn =
        |a: [f32; 2], b: [f32; 2], c: [f32; 2]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    let mut out: Vec<[f32; 2]> = Vec::with_capacity(10);
    for pass in 0..2 {
        let start = out.len();
        let mut add = |p: [f32; 2]| {
            while out.len() >= start + 2 && turn(out[out.len() - 2], out[out.len() - 1], p) <= 1e-6 {
                out.pop();
            }
            out.push(p);
        };
        if pass == 0 {
            points.iter().for_each(|p| add(*p));
        } else {
            points.iter().rev().for_each(|p| add(*p));
        }
        out.pop();
    }
    out
}

/// A polygon cut at the near plane, each corner with the number of the edge that begins there.
fn cut(corners: &[[f32; 3]], out: &mut [([f32; 3], usize); MOST]) -> usize {
    let mut count = 0;
    let mut push = |p: [f32; 3], edge: usize| {
        if count < MOST {
            out[count] = (p, edge);
            count += 1;
        }
    };
    for (i, &from) in corners.iter().enumerate() {
        let to = corners[(i + 1) % corners.len()];
        let (from_in, to_in) = (from[2] >= NEAR, to[2] >= NEAR);
        if from_in {
            push(from, i);
        }
        if from_in != to_in {
            let t = (NEAR - from[2]) / (to[2] - from[2]);
            let p = std::array::from_fn(|k| from[k] + (to[k] - from[k]) * t);
            // Leaving: the cut's own edge begins here.
            push(p, if from_in { usize::MAX } else { i });
        }
    }
    count
}

fn plane(corners: &[[f32; 3]], view: &View) -> Option<[f32; 3]> {
    let (a, c) = (corners[0], corners[corners.len() / 2]);
    let normal = cross(sub(corners[1], a), sub(c, a));
    let distance = dot(normal, a);
    // From above only; the camera's frame is left-handed.
    if distance <= 1e-9 {
        return None;
    }
    let scale = 1.0 / (distance * view.focal);
    let (dx, dy) = (normal[0] * scale, -normal[1] * scale);
    Some([dx, dy, normal[2] / distance - dx * view.centre[0] - dy * view.centre[1]])
}

/// The line of a polygon's side from screen point `p` to `q`, its distance positive inside.
fn line(p: [f32; 2], q: [f32; 2]) -> Option<[f32; 3]> {
    let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
    let length = (dx * dx + dy * dy).sqrt();
    // Counter-clockwise from above is clockwise in the picture's y-down sense reversed: inside is left.
    (length > 1e-6).then(|| {
        let (a, b) = (dy / length, -dx / length);
        [a, b, -(a * p[0] + b * p[1])]
    })
}

fn extent(points: &[[f32; 2]], margin: f32, view: &View) -> Option<((f32, f32), (f32, f32))> {
    let least = |i: usize| points.iter().fold(f32::MAX, |m, p| m.min(p[i])) - margin;
    let most = |i: usize| points.iter().fold(f32::MIN, |m, p| m.max(p[i])) + margin;
    let (columns, rows) = ((least(0), most(0)), (least(1), most(1)));
    let inside =
        columns.1 > 0.0 && columns.0 < view.width as f32 && rows.1 > 0.0 && rows.0 < view.height as f32;
    inside.then_some((rows, columns))
}

fn paint_shape(paint: &Paint, origin: [f32; 3], view: &View) -> Option<Shape> {
    let mut corners = [[0.0; 3]; 4];
    let (mut ahead, mut near) = (false, true);
    for (corner, from) in corners.iter_mut().zip(paint.corners) {
        let d = view.direction(from);
        *corner = std::array::from_fn(|i| origin[i] + d[i]);
        ahead |= corner[2] > NEAR;
        near &= corner[2] > PAINT_DISTANCE;
    }
    if !ahead || near {
        return None;
    }
    // Quick look: wholly beside the picture.
    let beside =
        |side: f32| corners.iter().all(|c| c[0] * side > c[2].max(0.0) * view.centre[0] / view.focal + 0.5);
    if beside(1.0) || beside(-1.0) {
        return None;
    }
    let iz = plane(&corners, view)?;
    let mut cut_corners = [([0.0; 3], 0); MOST];
    let count = cut(&corners, &mut cut_corners);
    let mut points = [[0.0; 2]; MOST];
    for (point, (corner, _)) in points.iter_mut().zip(&cut_corners[..count]) {
        *point = view.project(*corner);
    }
    let points = &points[..count];
    let (rows, columns) = extent(points, 1.0, view)?;
    // The strip's sides first.
    let mut edges = [Edge::default(); MOST];
    let (mut filled, mut sides) = (0, 0);
    for want_side in [true, false] {
        for i in 0..count {
            let own = cut_corners[i].1;
            if (own == 0 || own == 2) != want_side {
                continue;
            }
            let Some(mut l) = line(points[i], points[(i + 1) % count]) else { continue };
            let soft = want_side || own == 1 && paint.front_end || own == 3 && paint.rear_end;
            if !soft {
                // Shared with the chain's next quad: sharp, a hair wide.
                l = [l[0] * 64.0, l[1] * 64.0, l[2] * 64.0 + 0.5];
            }
            edges[filled] = Edge([l[0], l[1], l[2] + 0.5]);
            filled += 1;
            sides += usize::from(want_side);
        }
    }
    let ink = Ink::Paint(255.0 * paint.strength);
    Some(Shape { edges, count: filled, strip: sides == 2, rows, columns, iz, tolerance: 0.02, ink })
}

/// A polygon on the ground whose edge fades over `soft` (m); the eye is `height` (m) above it.
fn soft_shape(corners: &[[f32; 3]], view: &View, soft: f32, height: f32, ink: Ink) -> Option<Shape> {
    if corners.len() < 3 || corners.len() + 2 > MOST {
        return None;
    }
    let iz = plane(corners, view)?;
    let mut cut_corners = [([0.0; 3], 0); MOST];
    let count = cut(corners, &mut cut_corners);
    if count < 3 {
        return None;
    }
    let points: Vec<[f32; 2]> = cut_corners[..count].iter().map(|(c, _)| view.project(*c)).collect();
    let depth = cut_corners[..count].iter().map(|(c, _)| c[2]).sum::<f32>() / count as f32;
    let scale = view.focal * soft / depth;
    let (rows, columns) = extent(&points, 0.5 * scale + 1.0, view)?;
    let mut edges = [Edge::default(); MOST];
    let mut filled = 0;
    for i in 0..count {
        let Some(l) = line(points[i], points[(i + 1) % count]) else { continue };
        let flat = (height / depth).clamp(0.02, 1.0);
        let width = (scale * (l[0].abs() + l[1].abs() * flat)).max(1.0);
        edges[filled] = Edge([l[0] / width, l[1] / width, l[2] / width + 0.5]);
        filled += 1;
    }
    Some(Shape { edges, count: filled, strip: false, rows, columns, iz, tolerance: 0.2, ink })
}

multiversion! {
    fn draw(shape: &Shape, visibility: &Visibility, marks: &mut Marks) {
        let Marks { paint, shade, painted, shaded, .. } = marks;
        let touched = match shape.ink {
            Ink::Paint(..) => painted,
            Ink::Shade(..) => shaded,
        };
        let stride = visibility.stride;
        let rows = (shape.rows.0.max(0.0) as usize, (shape.rows.1.max(0.0) as usize + 1).min(visibility.height));
        let columns = (shape.columns.0.max(0.0), shape.columns.1.min(visibility.width as f32));
        let edges = &shape.edges[..shape.count];
        for (y, range) in touched.iter_mut().enumerate().take(rows.1).skip(rows.0) {
            let yc = y as f32 + 0.5;
            // Where the row is within all edges' reach.
            let (mut left, mut right) = columns;
            for Edge([a, b, c]) in edges {
                let rest = b * yc + c;
                if *a > 1e-6 {
                    left = left.max(-rest / a - 0.5);
                } else if *a < -1e-6 {
                    right = right.min(-rest / a + 0.5);
                } else if rest <= 0.0 {
                    right = -1.0;
                }
            }
            if left >= right {
                continue;
            }
            let (x0, x1) = (left.max(0.0) as usize, (right as usize + 1).min(visibility.width));
            *range = [range[0].min(x0 as u32), range[1].max(x1 as u32)];
            let base = shape.iz[1] * yc + shape.iz[2] + 0.5 * shape.iz[0];
            let mut x = x0;
            while x < x1 {
                let at = y * stride + x;
                let Some(seen) = visibility.iz[at..].first_chunk::<{ PAD }>() else { break };
                let begin = x as f32 + 0.5;
                let mut cover = [1.0_f32; PAD];
                for (number, Edge([a, b, c])) in edges.iter().enumerate() {
                    let first = a * begin + b * yc + c;
                    for (lane, cover) in cover.iter_mut().enumerate() {
                        let d = first + a * lane as f32;
                        let d = if d > 0.0 { d } else { 0.0 };
                        let d = if d < 1.0 { d } else { 1.0 };
                        if shape.strip && number == 1 {
                            let both = *cover + d - 1.0;
                            *cover = if both > 0.0 { both } else { 0.0 };
                        } else {
                            *cover *= d;
                        }
                    }
                }
                for (lane, cover) in cover.iter_mut().enumerate() {
                    let z = base + shape.iz[0] * (x as f32 + lane as f32);
                    let gap = (seen[lane] - z).abs();
                    let on = (gap < shape.tolerance * z) & (x + lane < x1);
                    *cover = if on { *cover } else { 0.0 };
                }
                match shape.ink {
                    Ink::Paint(strength) => {
                        let Some(paint) = paint[at..].first_chunk_mut::<{ PAD }>() else { break };
                        for (pixel, cover) in paint.iter_mut().zip(cover) {
                            let new = (cover * strength) as u16;
                            *pixel = if new > *pixel { new } else { *pixel };
                        }
                    }
                    Ink::Shade(sun, sky) => {
                        let Some(shade) = shade[at..].first_chunk_mut::<{ PAD }>() else { break };
                        for (pixel, cover) in shade.iter_mut().zip(cover) {
                            // Boxes of one road user overlap: the darkest counts for the sun.
                            let left = |share: f32, old: u16| {
                                let new = (255.0 * (1.0 - cover * (1.0 - share))) as u16;
                                if new < old { new } else { old }
                            };
                            *pixel = left(sun, *pixel & 0xff) | left(sky, *pixel >> 8) << 8;
                        }
                    }
                }
                x += PAD;
            }
        }
    }
}
