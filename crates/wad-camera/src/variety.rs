//! What may differ from one drive to the next without being another town: so that networks learn a street, not a picture.

use super::scene::Look;
use super::weather::{Preset, Weather};
use serde::{Deserialize, Serialize};
use std::f32::consts::TAU;
use sumo_network::seeds;

/// A thing that is drawn anew for each drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Varied {
    /// Façades, colours, kinds and places of trees, models and colours of parked cars.
    Houses,
    /// Paint on the road: from as new to mostly gone.
    Paint,
    /// How many streets have cars parked along them: none to all.
    Parked,
    /// Trees: none to all streets, some with crowns over the road.
    Trees,
    /// Where the sun stands: any direction, half as high to a third higher.
    Sun,
    /// Every third drive is at night.
    Night,
    /// Many more signs, which say anything.
    Signs,
}

impl Varied {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::Houses, Self::Paint, Self::Parked, Self::Trees, Self::Sun, Self::Night, Self::Signs];

    /// `houses`, `paint`, `parked`, `trees`, `sun`, `night` or `signs`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Houses => "houses",
            Self::Paint => "paint",
            Self::Parked => "parked",
            Self::Trees => "trees",
            Self::Sun => "sun",
            Self::Night => "night",
            Self::Signs => "signs",
        }
    }

    /// Those of a list of names with commas between; `all`: all of them.
    ///
    /// # Errors
    /// There is none of such a name.
    pub fn list(names: &str) -> Result<Vec<Self>, String> {
        if names == "all" {
            return Ok(Self::ALL.to_vec());
        }
        let named = |name: &str| {
            Self::ALL.into_iter().find(|varied| varied.name() == name).ok_or_else(|| {
                format!("expected all or some of {}, found `{name}`", Self::ALL.map(Self::name).join(","))
            })
        };
        names.split(',').map(|name| named(name.trim())).collect()
    }
}

/// 0..1, a number of its own for each `part`.
fn unit(seed: u64, part: &str) -> f32 {
    (seeds::derive(seed, part) >> 40) as f32 / (1_u32 << 24) as f32
}

/// The look `usual`, with what varies drawn from `seed`.
pub fn look(varied: &[Varied], usual: Look, seed: u64) -> Look {
    let mut look = usual;
    for part in varied {
        let drawn = unit(seed, part.name());
        match part {
            Varied::Houses => look.seed = seeds::derive(seed, part.name()),
            Varied::Paint => look.paint = drawn.sqrt(),
            Varied::Parked => look.parked = 1.5 * drawn,
            Varied::Trees => look.trees = 2.0 * drawn,
            Varied::Signs => look.many_signs = true,
            Varied::Sun | Varied::Night => {}
        }
    }
    look
}

/// The weather `preset`, with what varies drawn from `seed`.
pub fn weather(varied: &[Varied], preset: Preset, seed: u64) -> Weather {
    let mut weather = Weather::from(preset);
    if varied.contains(&Varied::Sun) {
        weather.turn_sun(TAU * unit(seed, "azimuth"), 0.5 + 0.85 * unit(seed, "altitude"));
    }
    if varied.contains(&Varied::Night) && unit(seed, "night") < 1.0 / 3.0 {
        weather.be_night();
    }
    weather
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_asked_for_varies_and_equal_seeds_give_equal_drives() {
        let usual = Look::of(0);
        assert_eq!(look(&[], usual, 5), usual);
        assert_eq!(weather(&[], Preset::WetNoon, 5), Weather::from(Preset::WetNoon));
        let other = look(&[Varied::Paint], usual, 5);
        assert_eq!(Look { paint: usual.paint, ..other }, usual);
        assert!((0.0..1.0).contains(&other.paint));
        assert_eq!(look(&Varied::ALL, usual, 5), look(&Varied::ALL, usual, 5));
        assert_ne!(look(&Varied::ALL, usual, 5), look(&Varied::ALL, usual, 6));
        let nights = (0..300).filter(|seed| {
            let night = weather(&[Varied::Night], Preset::ClearNoon, *seed);
            night.zenith[2] < 0.2 * Weather::from(Preset::ClearNoon).zenith[2]
        });
        assert!((70..130).contains(&nights.count()));
        assert_eq!(Varied::list("sun,paint"), Ok(vec![Varied::Sun, Varied::Paint]));
        assert_eq!(Varied::list(&Varied::ALL.map(Varied::name).join(",")), Varied::list("all"));
        assert!(Varied::list("sun,pain").unwrap_err().contains("found `pain`"));
    }
}
