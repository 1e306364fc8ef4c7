//! From the picture to pieces of painted lines, as in the paper: region of interest, Canny edges, threshold,
//! probabilistic Hough transformation.

use super::Pieces;
use super::canny::Canny;
use super::hough::{Hough, Wanted};
use crate::perception::GroundPlane;
use wad_camera::Frame;

/// Finds pieces of lines; keeps its buffers.
#[derive(Debug, Default)]
pub struct EdgeFinder {
    grey: Vec<u8>,
    /// Pixels of stripes, and the pixels beside them.
    stripes: Vec<u8>,
    kept: Vec<u8>,
    canny: Canny,
    edges: Vec<u8>,
    hough: Hough,
    lines: Vec<[i32; 4]>,
}

/// Breadths (m) within which a stripe must be brighter than both sides: a single line, and a double one.
const SIDES: [f32; 2] = [0.13, 0.36];
/// By how much: grey levels, and a share of its own brightness.
const CONTRAST: (i16, i16) = (7, 12);
/// Canny's thresholds: weak, strong.
const EDGE: [i16; 2] = [25, 70];
/// Hough: votes, least length and largest gap of a line (pixels of a picture 512 wide).
const VOTES: f64 = 14.0;
const LEAST_LENGTH: f64 = 12.0;
const LARGEST_GAP: f64 = 4.0;

impl EdgeFinder {
    /// The pieces of lines between `near` and `far` (m ahead of the ego's centre).
    pub fn find(&mut self, frame: &Frame, ground: &GroundPlane, [near, far]: [f32; 2], pieces: &mut Pieces) {
        pieces.segments.clear();
        pieces.stripes.clear();
        let row = |x: f32| ground.pixel([x, 0.0]).map_or(frame.height as f32, |pixel| pixel[1]);
        let top = row(far).max(0.0) as usize;
        let bottom = (row(near).ceil() as usize).min(frame.height);
        if bottom < top + 8 || frame.rgb.len() != 3 * frame.width * frame.height {
            return;
        }
        self.find_stripes(frame, ground, top, bottom, pieces);
        self.find_segments(frame.width, ground, top, pieces);
    }

    /// Grey picture of the region, and its threshold: what is brighter than both sides.
    fn find_stripes(
        &mut self,
        frame: &Frame,
        ground: &GroundPlane,
        top: usize,
        bottom: usize,
        pieces: &mut Pieces,
    ) {
        let width = frame.width;
        let region = &frame.rgb[3 * top * width..3 * bottom * width];
        self.grey.clear();
        self.grey.extend(
            region
                .chunks_exact(3)
                .map(|p| ((77 * u32::from(p[0]) + 150 * u32::from(p[1]) + 29 * u32::from(p[2])) >> 8) as u8),
        );
        self.stripes.clear();
        self.stripes.resize(self.grey.len(), 0);
        for (y, (grey, stripes)) in
            self.grey.chunks_exact(width).zip(self.stripes.chunks_exact_mut(width)).enumerate()
        {
            let row = (top + y) as f32 + 0.5;
            let middle = 0.5 * width as f32;
            let (Some(a), Some(b)) = (ground.point([middle, row]), ground.point([middle + 1.0, row])) else {
                continue;
            };
            // m per pixel across.
            let across = (a[1] - b[1]).abs();
            for side in SIDES {
                let k = ((side / across).round() as usize).max(2);
                brighter(grey, k, stripes);
            }
            for (x, _) in stripes.iter().enumerate().filter(|(_, s)| **s != 0) {
                if let Some(place) = ground.point([x as f32 + 0.5, row]) {
                    pieces.stripes.push(place);
                }
            }
        }
    }

    fn find_segments(&mut self, width: usize, ground: &GroundPlane, top: usize, pieces: &mut Pieces) {
        self.canny.find(&self.grey, width, EDGE, &mut self.edges);
        // Edges of stripes only.
        self.kept.clear();
        self.kept.resize(self.grey.len(), 0);
        near_stripes(&self.edges, &self.stripes, width, &mut self.kept);
        let scale = width as f64 / 512.0;
        let wanted = Wanted {
            votes: ((VOTES * scale) as i16).max(6),
            length: (LEAST_LENGTH * scale).round_ties_even() as i32,
            gap: (LARGEST_GAP * scale.max(0.5)).round_ties_even() as i32,
        };
        self.hough.find(&self.kept, width, wanted, &mut self.lines);
        let place = |x: i32, y: i32| ground.point([x as f32 + 0.5, (top as i32 + y) as f32 + 0.5]);
        for line in &self.lines {
            if let (Some(a), Some(b)) = (place(line[0], line[1]), place(line[2], line[3])) {
                pieces.segments.push(if a[0] <= b[0] { [a, b] } else { [b, a] });
            }
        }
    }
}

/// Marks pixels that are brighter than the pixels `k` to both sides.
fn brighter(grey: &[u8], k: usize, stripes: &mut [u8]) {
    if grey.len() <= 2 * k {
        return;
    }
    let inner = grey.len() - 2 * k;
    let (left, middle, right) = (&grey[..inner], &grey[k..k + inner], &grey[2 * k..]);
    let out = &mut stripes[k..k + inner];
    for (((out, l), m), r) in out.iter_mut().zip(left).zip(middle).zip(right) {
        let m = i16::from(*m);
        let side = i16::from(*l.max(r));
        let needed = CONTRAST.0 + m / CONTRAST.1;
        *out |= if m - side > needed { 255 } else { 0 };
    }
}

/// The edge pixels with a stripe's pixel beside them.
fn near_stripes(edges: &[u8], stripes: &[u8], width: usize, kept: &mut [u8]) {
    for ((edges, stripes), kept) in
        edges.chunks_exact(width).zip(stripes.chunks_exact(width)).zip(kept.chunks_exact_mut(width))
    {
        if width < 5 {
            continue;
        }
        let out = &mut kept[2..width - 2];
        for (x, out) in out.iter_mut().enumerate() {
            let near = stripes[x] | stripes[x + 1] | stripes[x + 2] | stripes[x + 3] | stripes[x + 4];
            *out = edges[x + 2] & near;
        }
    }
}
