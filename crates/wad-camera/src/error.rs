//! Why there is no camera or no weather.

/// Why there is no camera or no weather.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraError {
    #[error(
        "a picture of {width}x{height} pixels cannot be made: expected 1 to {max_side} along each side and \
         at most {max_pixels} in all"
    )]
    Size { width: usize, height: usize, max_side: usize, max_pixels: usize },
    #[error("a field of view of {found} degrees cannot be drawn: expected 1 to 170")]
    FieldOfView { found: f64 },
    #[error("no weather is called `{found}`; near names: {near}")]
    Weather { found: String, near: String },
}
