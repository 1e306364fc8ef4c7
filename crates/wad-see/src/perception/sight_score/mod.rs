//! Measures perception against the simulator's ground truth. For measuring only: an agent never sees any
//! of it.

mod lanes;
mod lead;
mod light;
mod limit;
mod road;

pub use lanes::{LaneScore, LaneTruth, MEASURED_AT};
pub use lead::{LeadBin, LeadReport, LeadScore, in_front, nearest_in_front, who_crosses};
pub use light::LightCounts;
pub use limit::LimitCounts;
pub use road::{RoadReport, RoadScore};

use serde::{Deserialize, Serialize};
use wad_sim::stats::quantile;

/// The middle and the 90th percentile of absolute errors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// The median; None without errors.
    pub median: Option<f64>,
    /// The 90th percentile; None without errors.
    pub p90: Option<f64>,
    /// Number of errors.
    pub n: usize,
}

impl Spread {
    /// Of errors, signs aside.
    pub fn of(errors: &[f64]) -> Self {
        let at = |share: f64| {
            let sizes = errors.iter().map(|e| e.abs()).collect();
            (!errors.is_empty()).then(|| quantile(sizes, share))
        };
        Self { median: at(0.5), p90: at(0.9), n: errors.len() }
    }
}

/// A share, None of nothing.
fn share(part: usize, whole: usize) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_of_errors() {
        let errors: Vec<f64> = (0..=10).map(|i| f64::from(i) * if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        assert_eq!(Spread::of(&errors), Spread { median: Some(5.0), p90: Some(9.0), n: 11 });
        assert!((Spread::of(&[0.1, -0.9]).median.unwrap() - 0.5).abs() < 1e-12);
        assert_eq!(Spread::of(&[]).median, None);
        assert_eq!((share(1, 4), share(0, 0)), (Some(0.25), None));
    }
}
