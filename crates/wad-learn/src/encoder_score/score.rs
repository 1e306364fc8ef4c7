//! Scores of a reconstruction: PSNR, SSIM, and the share of painted objects that it keeps.

use crate::dataset::BoxRecord;
use serde::Serialize;
use wad_see::perception::paint::is_obstacle;
use wad_see::perception::{TRANSFORMED_SIZE, TransformedImage};

const SIDE: usize = TRANSFORMED_SIZE;

/// Peak signal to noise ratio over all three channels (dB); 100 for equal images.
pub fn psnr(a: &TransformedImage, b: &TransformedImage) -> f64 {
    let pairs = a.bytes().iter().zip(b.bytes());
    let sum: f64 = pairs.map(|(x, y)| (f64::from(*x) - f64::from(*y)).powi(2)).sum();
    let mean = sum / TransformedImage::BYTES as f64;
    if mean > 0.0 { (10.0 * (255.0 * 255.0 / mean).log10()).min(100.0) } else { 100.0 }
}

/// Structural similarity of the brightness: mean over windows of 8x8 pixels every 4, with the usual
/// constants (Wang et al. 2004).
pub fn ssim(a: &TransformedImage, b: &TransformedImage) -> f64 {
    const C1: f64 = (0.01 * 255.0) * (0.01 * 255.0);
    const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);
    let luma = |image: &TransformedImage| -> Vec<f64> {
        let weigh = |p: &[u8]| 0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2]);
        image.bytes().chunks_exact(3).map(weigh).collect()
    };
    let (a, b) = (luma(a), luma(b));
    let (mut sum, mut count) = (0.0, 0.0);
    for y in (0..=SIDE - 8).step_by(4) {
        for x in (0..=SIDE - 8).step_by(4) {
            let (mut ma, mut mb, mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for row in 0..8 {
                let at = (y + row) * SIDE + x;
                for (p, q) in a[at..at + 8].iter().zip(&b[at..at + 8]) {
                    ma += p;
                    mb += q;
                    aa += p * p;
                    bb += q * q;
                    ab += p * q;
                }
            }
            let n = 64.0;
            let (ma, mb) = (ma / n, mb / n);
            let (va, vb, cov) = (aa / n - ma * ma, bb / n - mb * mb, ab / n - ma * mb);
            sum += (2.0 * ma * mb + C1) * (2.0 * cov + C2) / ((ma * ma + mb * mb + C1) * (va + vb + C2));
            count += 1.0;
        }
    }
    sum / count
}

/// Whether a pixel is painted blue, or is bluish after blending or reconstruction.
pub fn is_blue(pixel: &[u8]) -> bool {
    pixel[2] >= 128 && i32::from(pixel[2]) - i32::from(pixel[0].max(pixel[1])) >= 80
}

/// Counts of painted objects and of kept ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Kept {
    /// Painted objects.
    pub objects: u64,
    /// Objects that the reconstruction keeps.
    pub kept: u64,
}

impl Kept {
    /// Share of kept objects; 0 without objects.
    pub fn share(&self) -> f64 {
        self.kept as f64 / self.objects.max(1) as f64
    }

    fn add(&mut self, kept: bool) {
        self.objects += 1;
        self.kept += u64::from(kept);
    }
}

/// Painted objects by size in the transformed image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ObjectScore {
    /// Both sides 6 pixels or more.
    pub large: Kept,
    /// Smaller, both sides 3 pixels or more.
    pub small: Kept,
    /// All smaller ones.
    pub tiny: Kept,
    /// Blue pixels in both images.
    pub both: u64,
    /// Blue pixels in either image.
    pub either: u64,
}

/// Overlap of the blue from which an object counts as kept.
const SAME: f64 = 0.5;
/// Objects that show less are not painted (camera pixels of 512 x 512).
const LEAST_PIXELS: u32 = 12;

impl ObjectScore {
    /// Adds a frame: `boxes` in pixels of a camera of `width` x `height`.
    ///
    /// For each painted object the blue of both images is compared within its box and 2 pixels round
    /// it.
    pub fn add(
        &mut self,
        wanted: &TransformedImage,
        made: &TransformedImage,
        boxes: &[BoxRecord],
        (width, height): (usize, usize),
    ) {
        let blue =
            |image: &TransformedImage| -> Vec<bool> { image.bytes().chunks_exact(3).map(is_blue).collect() };
        let (wanted, made) = (blue(wanted), blue(made));
        for (w, m) in wanted.iter().zip(&made) {
            self.both += u64::from(*w && *m);
            self.either += u64::from(*w || *m);
        }
        let scale = [SIDE as f64 / width as f64, SIDE as f64 / height as f64];
        for object in boxes.iter().filter(|b| is_obstacle(b.class) && b.pixels >= LEAST_PIXELS) {
            let [l, t, r, b] = object.visible.map(f64::from);
            let (l, r) = (l * scale[0], r * scale[0]);
            let (t, b) = (t * scale[1], b * scale[1]);
            let columns = (l - 2.0).max(0.0) as usize..((r + 2.0).ceil() as usize).min(SIDE);
            let rows = (t - 2.0).max(0.0) as usize..((b + 2.0).ceil() as usize).min(SIDE);
            let (mut both, mut either, mut there) = (0_u32, 0_u32, 0_u32);
            for y in rows {
                for x in columns.clone() {
                    let (w, m) = (wanted[y * SIDE + x], made[y * SIDE + x]);
                    both += u32::from(w && m);
                    either += u32::from(w || m);
                    there += u32::from(w);
                }
            }
            // Under the red mark, or too thin to be blue anywhere.
            if there == 0 {
                continue;
            }
            let kept = f64::from(both) / f64::from(either) >= SAME;
            match (r - l).min(b - t) {
                side if side >= 6.0 => self.large.add(kept),
                side if side >= 3.0 => self.small.add(kept),
                _ => self.tiny.add(kept),
            }
        }
    }

    /// Intersection over union of all blue pixels.
    pub fn blue_iou(&self) -> f64 {
        self.both as f64 / self.either.max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wad_camera::model::ObjectClass;

    fn grey() -> TransformedImage {
        let mut image = TransformedImage::default();
        image.bytes_mut().fill(120);
        image
    }

    fn paint(image: &mut TransformedImage, [l, t, r, b]: [usize; 4]) {
        for y in t..b {
            for x in l..r {
                image.bytes_mut()[3 * (y * SIDE + x)..][..3].copy_from_slice(&[0, 0, 255]);
            }
        }
    }

    fn object(visible: [u32; 4]) -> BoxRecord {
        let full = visible.map(|v| v as f32);
        BoxRecord { class: ObjectClass::Car, id: 1, visible, full, pixels: 500, depth: 10.0 }
    }

    #[test]
    fn equal_images_score_best_and_noise_lowers_both() {
        let mut image = grey();
        paint(&mut image, [40, 40, 60, 60]);
        assert_eq!(psnr(&image, &image), 100.0);
        assert!((ssim(&image, &image) - 1.0).abs() < 1e-9);
        let mut noisy = image.clone();
        for (i, byte) in noisy.bytes_mut().iter_mut().enumerate() {
            *byte = byte.saturating_add((i * 7919 % 21) as u8);
        }
        assert!((20.0..40.0).contains(&psnr(&image, &noisy)), "{}", psnr(&image, &noisy));
        assert!(ssim(&image, &noisy) < 0.9);
    }

    #[test]
    fn a_lost_object_is_counted_by_its_size() {
        let (mut wanted, mut made) = (grey(), grey());
        // 10x10, kept with its edge off by one; 4x4, lost; 8x8, moved away.
        paint(&mut wanted, [10, 10, 20, 20]);
        paint(&mut made, [10, 10, 19, 20]);
        paint(&mut wanted, [40, 40, 44, 44]);
        paint(&mut wanted, [70, 70, 78, 78]);
        paint(&mut made, [75, 75, 83, 83]);
        let boxes = [[40, 40, 80, 80], [160, 160, 176, 176], [280, 280, 312, 312]].map(object);
        let mut score = ObjectScore::default();
        score.add(&wanted, &made, &boxes, (512, 512));
        assert_eq!(score.large, Kept { objects: 2, kept: 1 });
        assert_eq!(score.small, Kept { objects: 1, kept: 0 });
        assert_eq!(score.tiny, Kept::default());
    }
}
