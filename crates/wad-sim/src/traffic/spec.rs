//! How much background traffic: `as-is | empty | regular | dense | V,P`.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// Numbers of vehicles and pedestrians to keep alive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Background vehicles; the ego is not one of them.
    pub vehicles: usize,
    /// Background pedestrians.
    pub pedestrians: usize,
}

impl Counts {
    /// `vehicles` vehicles and `pedestrians` pedestrians.
    pub const fn new(vehicles: usize, pedestrians: usize) -> Self {
        Self { vehicles, pedestrians }
    }
}

/// The background traffic of a run, as the option `--traffic` names it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TrafficSpec {
    /// The SUMO config's own traffic, unchanged.
    #[default]
    AsIs,
    /// No background traffic.
    Empty,
    /// NoCrash's regular population of the town.
    Regular,
    /// NoCrash's dense population of the town.
    Dense,
    /// Exactly this many.
    Counts(Counts),
}

/// An unknown `--traffic` value.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "traffic {found:?} is not known: give one of as-is, empty, regular, dense, \
     or two counts V,P such as 70,100 for 70 vehicles and 100 pedestrians"
)]
pub struct TrafficSpecError {
    /// The given value.
    pub found: String,
}

/// The towns whose populations are NoCrash's "new town" ones.
const NEW_TOWNS: [&str; 2] = ["town5", "town7"];

impl TrafficSpec {
    /// Whether the config's own demand (route files, and what its additional files bring) stays in.
    ///
    /// False: launch SUMO with the config's net and additional files but without its
    /// `route-files`. Vehicles, flows and persons of additional files are still loaded:
    /// [`crate::traffic::Options::alone`] removes them as they appear.
    pub fn keeps_config_demand(self) -> bool {
        self == Self::AsIs
    }

    /// The population for a town; None for [`TrafficSpec::AsIs`].
    ///
    /// `town` is a bundled name or a path; what counts is its file name up to the first dot
    /// (`town5`, `nets/town5.sumocfg`, `x/town5.net.xml.gz`). Every town but town5 and town7 has
    /// the training town's populations.
    pub fn counts(self, town: &str) -> Option<Counts> {
        let name = town.rsplit(['/', '\\']).next().unwrap_or(town);
        let new_town = name.split('.').next().is_some_and(|name| NEW_TOWNS.contains(&name));
        match self {
            Self::AsIs => None,
            Self::Empty => Some(Counts::default()),
            Self::Regular if new_town => Some(Counts::new(15, 50)),
            Self::Regular => Some(Counts::new(20, 50)),
            Self::Dense if new_town => Some(Counts::new(70, 150)),
            Self::Dense => Some(Counts::new(100, 250)),
            Self::Counts(counts) => Some(counts),
        }
    }
}

impl FromStr for TrafficSpec {
    type Err = TrafficSpecError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let count = |part: &str| part.trim().parse::<u32>().ok().map(|n| n as usize);
        match text.trim() {
            "as-is" => Ok(Self::AsIs),
            "empty" => Ok(Self::Empty),
            "regular" => Ok(Self::Regular),
            "dense" => Ok(Self::Dense),
            other => other
                .split_once(',')
                .and_then(|(v, p)| Some(Self::Counts(Counts::new(count(v)?, count(p)?))))
                .ok_or_else(|| TrafficSpecError { found: text.to_string() }),
        }
    }
}

impl fmt::Display for TrafficSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AsIs => f.write_str("as-is"),
            Self::Empty => f.write_str("empty"),
            Self::Regular => f.write_str("regular"),
            Self::Dense => f.write_str("dense"),
            Self::Counts(counts) => write!(f, "{},{}", counts.vehicles, counts.pedestrians),
        }
    }
}

impl Serialize for TrafficSpec {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for TrafficSpec {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_is_read_and_written_back() {
        for text in ["as-is", "empty", "regular", "dense", "70,100", "0,0"] {
            let spec: TrafficSpec = text.parse().unwrap();
            assert_eq!(spec.to_string(), text);
            let json = serde_json::to_string(&spec).unwrap();
            assert_eq!(json, format!("{text:?}"));
            assert_eq!(serde_json::from_str::<TrafficSpec>(&json).unwrap(), spec);
        }
        assert_eq!("70, 100".parse(), Ok(TrafficSpec::Counts(Counts::new(70, 100))));
    }

    #[test]
    fn bad_text_names_the_forms() {
        for text in ["", "Dense", "70", "70,", "70,x", "-1,5", "1,2,3", "1.5,2", "99999999999,1"] {
            let error = text.parse::<TrafficSpec>().unwrap_err().to_string();
            for form in ["as-is", "empty", "regular", "dense", "V,P"] {
                assert!(error.contains(form), "{error}");
            }
            assert!(error.contains(&format!("{text:?}")), "{error}");
        }
    }

    #[test]
    fn populations_are_those_of_the_spec_table() {
        let counts = |spec: TrafficSpec, town| spec.counts(town).unwrap();
        for training in ["town3", "sumo_nets/town3.sumocfg", "fokr_bs.net.xml", "mytown5", "town50"] {
            assert_eq!(counts(TrafficSpec::Regular, training), Counts::new(20, 50), "{training}");
            assert_eq!(counts(TrafficSpec::Dense, training), Counts::new(100, 250), "{training}");
        }
        for new in ["town5", "nets/town5.sumocfg", "/x.y/town5.net.xml.gz", "C:\\n\\town5.net.xml", "town7"] {
            assert_eq!(counts(TrafficSpec::Regular, new), Counts::new(15, 50), "{new}");
            assert_eq!(counts(TrafficSpec::Dense, new), Counts::new(70, 150), "{new}");
        }
        assert_eq!(counts(TrafficSpec::Empty, "town5"), Counts::default());
        assert_eq!(TrafficSpec::AsIs.counts("town5"), None);
        assert!(TrafficSpec::AsIs.keeps_config_demand());
        assert!(!TrafficSpec::Empty.keeps_config_demand());
    }
}
