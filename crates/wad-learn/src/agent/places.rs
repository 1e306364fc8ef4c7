//! Where transitions were driven, so that a batch can be drawn from where episodes end.

use std::collections::{HashMap, VecDeque};
use sumo_network::geometry::Pose;

/// A place: a square of ground, and the quarter of the compass that the ego faces there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Place(pub(crate) u32);

impl Place {
    /// Nowhere that is known: of recorded experience.
    pub const UNKNOWN: Self = Self(0);

    /// Side of a place (m).
    pub const SIDE: f64 = 10.0;

    /// The place of an ego.
    pub fn of(pose: &Pose) -> Self {
        let cell = |x: f64| ((x / Self::SIDE).floor() as i64 & 0x1fff) as u32;
        let quarter = (pose.heading / std::f64::consts::FRAC_PI_2).round() as i64 & 3;
        Self(1 << 31 | cell(pose.position.x) << 15 | cell(pose.position.y) << 2 | quarter as u32)
    }
}

/// The entries of a ring by place, oldest first.
#[derive(Debug, Default)]
pub(crate) struct Visits {
    entries: HashMap<Place, VecDeque<u32>>,
}

impl Visits {
    pub(crate) fn clear(&mut self) {
        self.entries.clear();
    }

    /// `entry`, the newest, is at `place`.
    pub(crate) fn add(&mut self, place: Place, entry: usize) {
        if place != Place::UNKNOWN {
            self.entries.entry(place).or_default().push_back(entry as u32);
        }
    }

    /// `entry`, the oldest of all, is forgotten.
    pub(crate) fn forget(&mut self, place: Place, entry: usize) {
        let Some(entries) = self.entries.get_mut(&place) else { return };
        if entries.front() == Some(&(entry as u32)) {
            entries.pop_front();
        }
        if entries.is_empty() {
            self.entries.remove(&place);
        }
    }

    /// All entries at `place`; None where it is unknown.
    pub(crate) fn at(&self, place: Place) -> Option<&VecDeque<u32>> {
        self.entries.get(&place)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_ten_metres_of_ground_in_one_direction() {
        let place = |x, y, heading| Place::of(&Pose::new(x, y, 0.0, heading));
        assert_eq!(place(12.0, -3.0, 0.1), place(18.0, -9.0, -0.3));
        for other in [place(21.0, -3.0, 0.1), place(12.0, 3.0, 0.1), place(12.0, -3.0, 1.6)] {
            assert!(other != place(12.0, -3.0, 0.1) && other != Place::UNKNOWN);
        }
        assert_eq!(place(5.0, 5.0, 3.1), place(5.0, 5.0, -3.1), "west from both sides");
    }

    #[test]
    fn what_the_ring_overwrites_is_forgotten() {
        let mut visits = Visits::default();
        let place = Place(7);
        visits.add(place, 3);
        visits.add(place, 9);
        visits.add(Place::UNKNOWN, 10);
        visits.forget(place, 3);
        assert_eq!(visits.at(place).map(|v| v.iter().copied().collect()), Some(vec![9]));
        visits.forget(place, 9);
        assert_eq!(visits.at(place), None);
        assert_eq!(visits.at(Place::UNKNOWN), None);
    }
}
