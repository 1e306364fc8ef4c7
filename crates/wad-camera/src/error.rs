//! Why there is no camera or no weather.

/// Why there is no camera or no weather.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// Too small or too large a picture.
    #[error(
        "cannot make a picture of {width}x{height} pixels: expected 1 to {max_side} along each side and \
         at most {max_pixels} in all"
    )]
    Size {
        /// Pixels asked for.
        width: usize,
        /// Pixels asked for.
        height: usize,
        /// Most pixels along a side.
        max_side: usize,
        /// Most pixels in all.
        max_pixels: usize,
    },
    /// An angle that no lens of this kind has.
    #[error("field of view: expected 1 to 170 degrees, found {found}")]
    FieldOfView {
        /// Degrees asked for.
        found: f64,
    },
    /// No weather of that name.
    #[error("no weather is called `{found}`; near names: {near}")]
    Weather {
        /// The name asked for.
        found: String,
        /// The nearest names.
        near: String,
    },
}
