//! What a camera is, and where it sits.

use super::error::CameraError;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Where a camera sits on a vehicle: relative to the centre of the footprint, in its frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Mount {
    /// Ahead of the centre (m).
    pub forward: f64,
    /// Left of the centre (m).
    pub left: f64,
    /// Above the ground (m).
    pub up: f64,
    /// Turned to the left (rad).
    pub yaw: f64,
    /// Tilted up (rad).
    pub pitch: f64,
}

impl Default for Mount {
    fn default() -> Self {
        Self { forward: 0.7, left: 0.0, up: 1.4, yaw: 0.0, pitch: 0.0 }
    }
}

/// A camera. The default is the one that all trained weights belong to: behind the windscreen,
/// 90 degrees wide, 512 x 512.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct CameraConfig {
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// Horizontal field of view (degrees).
    pub fov_deg: f64,
    /// Where it sits on the vehicle.
    pub mount: Mount,
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self { width: 512, height: 512, fov_deg: 90.0, mount: Mount::default() }
    }
}

/// Most pixels along a side.
const MAX_SIDE: usize = 8192;
/// Most pixels of a picture in all.
pub const MAX_PIXELS: usize = 1 << 25;

impl CameraConfig {
    /// The default camera with another size in pixels.
    pub fn sized(width: usize, height: usize) -> Self {
        Self { width, height, ..Self::default() }
    }

    /// Behind and above the vehicle, for people.
    pub fn chase(width: usize, height: usize) -> Self {
        let mount = Mount { forward: -9.0, up: 3.7, pitch: -0.17, ..Mount::default() };
        Self { width, height, fov_deg: 75.0, mount }
    }

    /// Straight down on the vehicle, for people; the vehicle's front is up.
    pub fn bird(width: usize, height: usize) -> Self {
        let mount =
            Mount { forward: 12.0, up: 55.0, pitch: -std::f64::consts::FRAC_PI_2, ..Mount::default() };
        Self { width, height, fov_deg: 60.0, mount }
    }

    /// Whether the vehicle that it is mounted on is in the picture: the camera is outside it.
    pub fn shows_ego(&self) -> bool {
        self.mount.forward.abs() > 2.5 || self.mount.up > 2.0
    }

    /// Focal length in pixels.
    pub fn focal(&self) -> f64 {
        0.5 * self.width as f64 / (0.5 * self.fov_deg.to_radians()).tan()
    }

    /// Identifies the definition: weights trained on one camera's pictures belong to it alone.
    pub fn hash(&self) -> String {
        // FNV-1a: stable over releases of the standard library.
        let hash = format!("camera 1: {self}")
            .bytes()
            .fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
        format!("{hash:016x}")
    }

    /// Whether a picture can be made of it.
    ///
    /// # Errors
    /// The size is zero or too large for memory, or the field of view is not between 1 and 170 degrees.
    pub fn check(&self) -> Result<(), CameraError> {
        let (width, height) = (self.width, self.height);
        if !(1..=MAX_SIDE).contains(&width)
            || !(1..=MAX_SIDE).contains(&height)
            || width * height > MAX_PIXELS
        {
            return Err(CameraError::Size { width, height, max_side: MAX_SIDE, max_pixels: MAX_PIXELS });
        }
        if !(1.0..=170.0).contains(&self.fov_deg) {
            return Err(CameraError::FieldOfView { found: self.fov_deg });
        }
        Ok(())
    }
}

/// Size (pixels), field of view (degrees), mount (m, then rad): all that the hash goes by.
impl fmt::Display for CameraConfig {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let m = &self.mount;
        write!(
            f,
            "{}x{} fov {:.4} mount {:.4} {:.4} {:.4} {:.5} {:.5}",
            self.width, self.height, self.fov_deg, m.forward, m.left, m.up, m.yaw, m.pitch
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_tells_definitions_apart() {
        let one = CameraConfig::default();
        assert_eq!(one.hash(), CameraConfig::sized(512, 512).hash());
        assert_ne!(one.hash(), CameraConfig::sized(512, 256).hash());
        let higher = CameraConfig { mount: Mount { up: 1.5, ..one.mount }, ..one };
        assert_ne!(one.hash(), higher.hash());
        assert_eq!(one.focal().round(), 256.0);
    }

    #[test]
    fn impossible_sizes_are_errors_that_name_the_limits() {
        for (width, height) in [(0, 512), (512, 0), (100_000, 10), (8000, 8000)] {
            let error = CameraConfig::sized(width, height).check().unwrap_err().to_string();
            assert!(error.contains(&format!("{width}x{height}")) && error.contains("8192"), "{error}");
        }
        assert!(CameraConfig { fov_deg: 180.0, ..Default::default() }.check().is_err());
    }
}
