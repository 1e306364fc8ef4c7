//! From the picture to pieces of painted lines, with OpenCV as in the paper: region of interest, Canny
//! edges, threshold, probabilistic Hough transformation.

use super::Pieces;
use crate::perception::{GroundPlane, PerceptionError};
use opencv::core::{Mat, Vec4i, Vector};
use opencv::imgproc;
use opencv::prelude::MatTraitConstManual;
use wad_camera::Frame;

/// Finds pieces of lines; keeps its buffers.
#[derive(Debug, Default)]
pub struct EdgeFinder {
    grey: Vec<u8>,
    /// Pixels of stripes, and the pixels beside them.
    stripes: Vec<u8>,
    kept: Vec<u8>,
    edges: Mat,
    lines: Vector<Vec4i>,
}

/// Breadths (m) within which a stripe must be brighter than both sides: a single line, and a double one.
const SIDES: [f32; 2] = [0.13, 0.36];
/// By how much: grey levels, and a share of its own brightness.
const CONTRAST: (i16, i16) = (7, 12);
/// Canny's thresholds.
const WEAK_EDGE: f64 = 25.0;
const STRONG_EDGE: f64 = 70.0;
/// Hough: votes, least length and largest gap of a line (pixels of a picture 512 wide).
const VOTES: i32 = 14;
const LEAST_LENGTH: f64 = 12.0;
const LARGEST_GAP: f64 = 4.0;

impl EdgeFinder {
    /// The pieces of lines between `near` and `far` (m ahead of the ego's centre).
    pub fn find(
        &mut self,
        frame: &Frame,
        ground: &GroundPlane,
        [near, far]: [f32; 2],
        pieces: &mut Pieces,
    ) -> Result<(), PerceptionError> {
        pieces.segments.clear();
        pieces.stripes.clear();
        let row = |x: f32| ground.pixel([x, 0.0]).map_or(frame.height as f32, |pixel| pixel[1]);
        let top = row(far).max(0.0) as usize;
        let bottom = (row(near).ceil() as usize).min(frame.height);
        if bottom < top + 8 || frame.rgb.len() != 3 * frame.width * frame.height {
            return Ok(());
        }
        self.find_stripes(frame, ground, top, bottom, pieces);
        self.find_segments(frame.width, ground, top, pieces)
            .map_err(|error| PerceptionError::Lanes(format!("OpenCV: {}", error.message)))
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

    fn find_segments(
        &mut self,
        width: usize,
        ground: &GroundPlane,
        top: usize,
        pieces: &mut Pieces,
    ) -> opencv::Result<()> {
        let rows = (self.grey.len() / width) as i32;
        let grey = Mat::new_rows_cols_with_data(rows, width as i32, &self.grey)?;
        imgproc::canny(&grey, &mut self.edges, WEAK_EDGE, STRONG_EDGE, 3, false)?;
        // Edges of stripes only.
        self.kept.clear();
        self.kept.resize(self.grey.len(), 0);
        near_stripes(self.edges.data_bytes()?, &self.stripes, width, &mut self.kept);
        let kept = Mat::new_rows_cols_with_data(rows, width as i32, &self.kept)?;
        let scale = width as f64 / 512.0;
        imgproc::hough_lines_p(
            &kept,
            &mut self.lines,
            1.0,
            std::f64::consts::PI / 180.0,
            ((f64::from(VOTES) * scale) as i32).max(6),
            LEAST_LENGTH * scale,
            LARGEST_GAP * scale.max(0.5),
        )?;
        let place = |x: i32, y: i32| ground.point([x as f32 + 0.5, (top as i32 + y) as f32 + 0.5]);
        for line in &self.lines {
            if let (Some(a), Some(b)) = (place(line[0], line[1]), place(line[2], line[3])) {
                pieces.segments.push(if a[0] <= b[0] { [a, b] } else { [b, a] });
            }
        }
        Ok(())
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
