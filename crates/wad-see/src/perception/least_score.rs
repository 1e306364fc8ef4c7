//! How sure a detection must be to drive by it.

use super::{Detection, DrivableArea};

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

/// On free road: from which height on (pixels) and up to which score, and how much of what is there may be seen as road
/// (docs/detector.md, "What stands on free road").
const LARGE_ON_ROAD: f32 = 100.0;
const SURE_ON_ROAD: f32 = 0.5;
const MOST_ROAD: f32 = 0.5;

impl LeastScore {
    /// Whether a detection of one of our networks counts; `area` is the free road that the same network sees, if it sees roads.
    /// To drive by, something large that it is not sure of must not stand where it sees free road.
    pub fn keeps(self, detection: &Detection, area: Option<&DrivableArea>) -> bool {
        let height = detection.size()[1];
        let is_free_road = |area: &DrivableArea| {
            let is_unsure = height >= LARGE_ON_ROAD && detection.score < SURE_ON_ROAD;
            self == Self::Usual && is_unsure && area.share_within(detection.bounds) > MOST_ROAD
        };
        detection.score >= self.of(height) && !area.is_some_and(is_free_road)
    }

    /// The least score at this height (pixels), wherever it stands.
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

    #[test]
    fn who_is_unsure_and_large_on_free_road_is_not_there() {
        use wad_camera::model::ObjectClass;
        let road = DrivableArea::new(|_, _| true);
        let someone =
            |score, top| Detection { class: ObjectClass::Person, bounds: [320.0, top, 380.0, 420.0], score };
        fn is_free_road(least: LeastScore, detection: &Detection, area: &DrivableArea) -> bool {
            least.keeps(detection, None) && !least.keeps(detection, Some(area))
        }
        let (usual, nothing) = (LeastScore::Usual, DrivableArea::default());
        assert!(is_free_road(usual, &someone(0.43, 270.0), &road));
        assert!(!is_free_road(usual, &someone(0.5, 270.0), &road), "sure");
        assert!(!is_free_road(usual, &someone(0.43, 330.0), &road), "small");
        assert!(!is_free_road(usual, &someone(0.43, 270.0), &nothing), "something stands there");
        assert!(!is_free_road(LeastScore::Fixed(0.4), &someone(0.43, 270.0), &road), "a score and no more");
    }
}
