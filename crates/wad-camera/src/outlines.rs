//! What of each road user would be seen, worked out without drawing: its mesh's outline in the picture, less
//! what nearer road users and the town's walls hide.
//!
//! Against the drawn boxes: nearer road users hide as boxes, trees and lamps hide nothing, and static objects
//! (parked cars, benches, signal heads) are left out and hide nothing.

use super::Shot;
use super::frame::ObjectTruth;
use super::gather::placed;
use super::model::{Object, ObjectClass};
use super::raster::CamVertex;
use super::view::{NEAR, View};

/// Road users beyond this depth (m) are left out.
const REACH: f32 = 90.0;
/// Points of an outline that are looked at, across and up.
const POINTS: [usize; 2] = [8, 6];

/// A road user in the picture.
struct Outline {
    object: Object,
    full: [f32; 4],
    /// Left, top, right, bottom of what it hides.
    hides: [f32; 4],
    depth: f32,
}

/// Finds the visible objects of a shot, by id. `vertices` is scratch memory.
pub fn find(shot: &Shot<'_>, vertices: &mut Vec<CamVertex>, objects: &mut Vec<ObjectTruth>) {
    objects.clear();
    let mut found: Vec<Outline> = Vec::new();
    for instance in &shot.actors.instances {
        let Some(object) = instance.object else { continue };
        vertices.clear();
        if placed(shot.view, &shot.scene.library, instance, REACH, vertices)
            && let Some(outline) = outline(shot.view, object, vertices)
        {
            found.push(outline);
        }
    }
    found.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    for number in 0..found.len() {
        let (nearer, rest) = found.split_at(number);
        objects.extend(seen(shot, &rest[0], nearer));
    }
    objects.sort_by_key(|object| object.id);
}

/// The outline of vertices in the picture; None where it is outside.
fn outline(view: &View, object: Object, vertices: &[CamVertex]) -> Option<Outline> {
    let full = full_box(view, vertices);
    let [left, top, right, bottom] = full;
    if right - left < 1.0 || bottom - top < 1.0 {
        return None;
    }
    // Upright and thin ones hide the middle of their box only.
    let slim = match object.class {
        ObjectClass::Person | ObjectClass::Motorcycle | ObjectClass::Bicycle => 0.25,
        _ => 0.04,
    };
    let aside = slim * (right - left);
    let hides = [left + aside, top, right - aside, bottom];
    Some(Outline { object, full, hides, depth: depth(view, &object) })
}

/// The box of vertices in the picture, cut at its borders: left, top, right, bottom (pixels).
pub fn full_box(view: &View, vertices: &[CamVertex]) -> [f32; 4] {
    let mut full = [f32::MAX, f32::MAX, f32::MIN, f32::MIN];
    for vertex in vertices.iter().filter(|v| v.p[2] >= NEAR) {
        for axis in 0..2 {
            full[axis] = full[axis].min(vertex.s[axis]);
            full[axis + 2] = full[axis + 2].max(vertex.s[axis]);
        }
    }
    let (w, h) = (view.width as f32, view.height as f32);
    [full[0].clamp(0.0, w), full[1].clamp(0.0, h), full[2].clamp(0.0, w), full[3].clamp(0.0, h)]
}

/// Depth of an object's middle (m).
pub fn depth(view: &View, object: &Object) -> f32 {
    let middle = object.bounds.pose.position + nalgebra::Vector3::new(0.0, 0.0, 0.5 * object.bounds.size[2]);
    view.point(&middle)[2]
}

/// The visible part of an outline behind `nearer` ones.
fn seen(shot: &Shot<'_>, outline: &Outline, nearer: &[Outline]) -> Option<ObjectTruth> {
    let Shot { view, scene, .. } = *shot;
    let [left, top, right, bottom] = outline.full;
    let cell = [(right - left) / POINTS[0] as f32, (bottom - top) / POINTS[1] as f32];
    let eye = [view.eye.x, view.eye.y];
    let mut visible = [f32::MAX, f32::MAX, f32::MIN, f32::MIN];
    let mut count = 0;
    for column in 0..POINTS[0] {
        let low = left + column as f32 * cell[0];
        let x = low + 0.5 * cell[0];
        let ray = view.ray(x, 0.5 * (top + bottom)).map(f64::from);
        let depth = f64::from(outline.depth);
        if scene.walls().between(eye, [eye[0] + depth * ray[0], eye[1] + depth * ray[1]]) {
            continue;
        }
        for row in 0..POINTS[1] {
            let high = top + row as f32 * cell[1];
            let y = high + 0.5 * cell[1];
            let hidden = nearer.iter().any(|other| {
                let [l, t, r, b] = other.hides;
                (l..r).contains(&x) && (t..b).contains(&y)
            });
            if !hidden {
                count += 1;
                visible = [
                    visible[0].min(low),
                    visible[1].min(high),
                    visible[2].max(low + cell[0]),
                    visible[3].max(high + cell[1]),
                ];
            }
        }
    }
    let area = (right - left) * (bottom - top);
    let share = count as f32 / (POINTS[0] * POINTS[1]) as f32;
    let visible_pixels = (outline.object.class.fills() * area * share).round() as u32;
    // Pixels count where their middle is covered.
    let [l, t, r, b] = visible.map(|v| v.round().max(0.0) as u32);
    (visible_pixels > 0 && r > l && b > t).then_some(ObjectTruth {
        class: outline.object.class,
        id: outline.object.id,
        visible_pixels,
        visible_box: [l, t, r, b],
        full_box: outline.full,
        bounds: outline.object.bounds,
        depth: outline.depth,
    })
}
