//! Where pixels meet a flat road.

use nalgebra::Point3;
use sumo_network::geometry::Pose;
use wad_camera::{CameraConfig, View};

/// The road as a camera sees it while the vehicle stands level on it.
///
/// Ego frame: x ahead and y left of the centre of the vehicle's footprint (m), on the ground.
#[derive(Clone, Debug)]
pub struct GroundPlane {
    view: View,
}

impl GroundPlane {
    /// The ground under a camera.
    pub fn new(camera: &CameraConfig) -> Self {
        Self { view: View::new(camera, &Pose::new(0.0, 0.0, 0.0, 0.0)) }
    }

    /// The place (m, ego frame) that a pixel position shows; None at and above the horizon.
    pub fn point(&self, [x, y]: [f32; 2]) -> Option<[f32; 2]> {
        let ray = self.view.ray(x, y);
        if ray[2] > -1e-3 {
            return None;
        }
        let eye = &self.view.eye;
        let far = eye.z as f32 / -ray[2];
        Some([eye.x as f32 + ray[0] * far, eye.y as f32 + ray[1] * far])
    }

    /// The pixel position of a place (m, ego frame); None behind the camera.
    pub fn pixel(&self, [x, y]: [f32; 2]) -> Option<[f32; 2]> {
        self.view.pixel(&Point3::new(f64::from(x), f64::from(y), 0.0)).map(|(pixel, _)| pixel)
    }

    /// The place (m, ego frame) of something in the picture's column `u` that is `depth` (m) before the camera along its
    /// axis, at any height.
    pub fn ahead(&self, u: f32, depth: f32) -> [f32; 2] {
        let ray = self.view.ray(u, self.view.centre[1]);
        let eye = &self.view.eye;
        [eye.x as f32 + ray[0] * depth, eye.y as f32 + ray[1] * depth]
    }

    /// Which sides of a box (left, top, right, bottom; pixels) the picture's border cuts: left, right, bottom.
    pub fn cuts(&self, [left, _, right, bottom]: [f32; 4]) -> [bool; 3] {
        let [width, height] = self.view.centre.map(|half| 2.0 * half);
        [left < 1.0, right > width - 1.0, bottom > height - 1.0]
    }

    /// How large (pixels) something of this size (m) is that is `depth` (m) before the camera along its axis.
    pub fn pixels(&self, size: f32, depth: f32) -> f32 {
        self.view.focal * size / depth.max(0.1)
    }

    /// How much nearer (m) than a point on the ground at `x` (m ahead) that is which hides the ground up to there, at this
    /// `height` (m).
    pub fn hides(&self, x: f32, height: f32) -> f32 {
        let eye = &self.view.eye;
        (x - eye.x as f32).max(0.0) * height / eye.z as f32
    }

    /// Change of distance (m) per pixel up or down, for a point on the ground at `x` (m ahead).
    pub fn metres_per_row(&self, x: f32) -> f32 {
        let ahead = (x - self.view.eye.x as f32).max(0.5);
        ahead * ahead / (self.view.focal * self.view.eye.z as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_and_places_belong_together() {
        for config in [CameraConfig::default(), CameraConfig::sized(256, 256)] {
            let ground = GroundPlane::new(&config);
            for place in [[5.0, 0.0], [10.0, 1.75], [30.0, -4.0]] {
                let pixel = ground.pixel(place).unwrap();
                let back = ground.point(pixel).unwrap();
                assert!((back[0] - place[0]).abs() < 0.01 && (back[1] - place[1]).abs() < 0.01, "{back:?}");
            }
            let middle = 0.5 * config.height as f32;
            assert!(ground.point([10.0, middle]).is_none() && ground.point([10.0, middle - 5.0]).is_none());
            assert!(ground.pixel([-3.0, 0.0]).is_none());
        }
    }

    #[test]
    fn left_is_positive() {
        let ground = GroundPlane::new(&CameraConfig::default());
        assert!(ground.point([100.0, 400.0]).unwrap()[1] > 0.0);
    }
}
