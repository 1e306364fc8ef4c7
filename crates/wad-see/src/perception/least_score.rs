//! How sure a detection must be to drive by it.

/// Which detections of a network are kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LeastScore {
    /// Those to drive by: of our networks 0.4 up to a height of 12 pixels, falling to 0.3 at 32; of others 0.3.
    Usual,
    /// Those with this score (0 to 1) or more.
    Fixed(f32),
}

/// The least score of a detection to drive by at these heights (pixels), in proportion between them. What is near has a higher
/// score where it is there, and a wrong one costs more: an ego that stands for it sees the same picture until its time is up.
/// What each of these bounds gave is in docs/detector.md ("How sure is sure enough").
const SMALL: [f32; 2] = [12.0, 0.4];
const LARGE: [f32; 2] = [32.0, 0.3];

impl LeastScore {
    /// For a detection of one of our networks of this height (pixels).
    pub fn of(self, height: f32) -> f32 {
        let share = ((height - SMALL[0]) / (LARGE[0] - SMALL[0])).clamp(0.0, 1.0);
        match self {
            Self::Usual => SMALL[1] + share * (LARGE[1] - SMALL[1]),
            Self::Fixed(score) => score,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_near_need_not_be_as_sure_as_what_is_far() {
        let usual = [5.0, 12.0, 22.0, 32.0, 300.0].map(|height| LeastScore::Usual.of(height));
        for (found, wanted) in usual.into_iter().zip([0.4, 0.4, 0.35, 0.3, 0.3]) {
            assert!((found - wanted).abs() < 1e-6, "{usual:?}");
        }
        assert_eq!([5.0, 300.0].map(|height| LeastScore::Fixed(0.05).of(height)), [0.05; 2]);
    }
}
