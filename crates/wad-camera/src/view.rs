//! A camera's place in a frame, and the rays of its pixels.
//!
//! Camera frame: x right, y up, z ahead (m). Pixels count from the picture's upper left corner; a
//! pixel's centre is half a pixel in.

use super::config::CameraConfig;
use nalgebra::{Point3, Vector3};
use sumo_network::geometry::Pose;

/// Nothing nearer than this (m, ahead) is drawn.
pub const NEAR: f32 = 0.25;

/// A camera's place and projection.
#[derive(Clone, Debug)]
pub struct View {
    /// m, world frame.
    pub eye: Point3<f64>,
    /// Unit axes in the world frame.
    pub right: [f32; 3],
    /// Up in the picture.
    pub up: [f32; 3],
    /// Along the optical axis.
    pub ahead: [f32; 3],
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// Focal length and principal point (pixels).
    pub focal: f32,
    /// Principal point (pixels).
    pub centre: [f32; 2],
    /// Heading of the optical axis (rad).
    pub heading: f64,
}

impl View {
    /// The view of a camera mounted on a vehicle at `pose`.
    pub fn new(config: &CameraConfig, pose: &Pose) -> Self {
        let m = &config.mount;
        let (sin, cos) = pose.heading.sin_cos();
        let eye = pose.position
            + Vector3::new(m.forward * cos - m.left * sin, m.forward * sin + m.left * cos, m.up);
        let heading = pose.heading + m.yaw;
        let ((s, c), (sp, cp)) = (heading.sin_cos(), m.pitch.sin_cos());
        let f = |v: [f64; 3]| v.map(|x| x as f32);
        Self {
            eye,
            right: f([s, -c, 0.0]),
            up: f([-sp * c, -sp * s, cp]),
            ahead: f([cp * c, cp * s, sp]),
            width: config.width,
            height: config.height,
            focal: config.focal() as f32,
            centre: [0.5 * config.width as f32, 0.5 * config.height as f32],
            heading,
        }
    }

    /// A world direction in the camera's frame.
    #[inline]
    pub fn direction(&self, v: [f32; 3]) -> [f32; 3] {
        [dot(self.right, v), dot(self.up, v), dot(self.ahead, v)]
    }

    /// A world point in the camera's frame (m).
    #[inline]
    pub fn point(&self, p: &Point3<f64>) -> [f32; 3] {
        let r = p - self.eye;
        self.direction([r.x as f32, r.y as f32, r.z as f32])
    }

    /// Pixel coordinates of a camera-frame point ahead of the camera.
    #[inline]
    pub fn project(&self, p: [f32; 3]) -> [f32; 2] {
        let scale = self.focal / p[2];
        [self.centre[0] + p[0] * scale, self.centre[1] - p[1] * scale]
    }

    /// Pixel coordinates and depth (m) of a world point; None behind the camera.
    pub fn pixel(&self, p: &Point3<f64>) -> Option<([f32; 2], f32)> {
        let local = self.point(p);
        (local[2] >= NEAR).then(|| (self.project(local), local[2]))
    }

    /// Whether a ball (camera frame, m) can touch the picture.
    #[inline]
    pub fn sees_ball(&self, centre: [f32; 3], radius: f32) -> bool {
        if centre[2] < NEAR - radius {
            return false;
        }
        // Planes through the eye and the picture's borders.
        let side = |half: f32, across: f32| {
            let slope = half / self.focal;
            across.abs() - slope * centre[2] <= radius * (1.0 + slope * slope).sqrt()
        };
        side(self.centre[0], centre[0]) && side(self.centre[1], centre[1])
    }

    /// The world direction of a pixel's ray, its camera-frame depth 1.
    pub fn ray(&self, x: f32, y: f32) -> [f32; 3] {
        let (rx, ry) = ((x - self.centre[0]) / self.focal, (self.centre[1] - y) / self.focal);
        std::array::from_fn(|i| self.ahead[i] + rx * self.right[i] + ry * self.up[i])
    }
}

/// Dot product.
#[inline(always)]
pub fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Cross product.
#[inline(always)]
pub fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `a - b`.
#[inline(always)]
pub fn sub(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ground_20_m_ahead_is_below_the_middle() {
        let view = View::new(&CameraConfig::default(), &Pose::new(100.0, 50.0, 0.0, 0.5));
        let ahead = Pose::new(100.0, 50.0, 0.0, 0.5).advanced(20.7);
        let ([x, y], depth) = view.pixel(&ahead.position).unwrap();
        assert!((x - 256.0).abs() < 1e-3 && (depth - 20.0).abs() < 1e-4);
        assert!((y - (256.0 + 256.0 * 1.4 / 20.0)).abs() < 1e-3);
        let left = ahead.to_world(nalgebra::Vector2::new(0.0, 2.0));
        assert!(view.pixel(&Point3::new(left.x, left.y, 0.0)).unwrap().0[0] < 256.0);
        assert!(view.pixel(&Pose::new(100.0, 50.0, 0.0, 0.5).advanced(-5.0).position).is_none());
    }
}
