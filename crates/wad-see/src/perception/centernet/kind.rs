//! The kinds of networks.

use crate::weights::{Weights, WeightsError};
use serde::{Deserialize, Serialize};
use wad_camera::CameraConfig;

/// Classes, in the order of [`crate::perception::coco::CLASSES`].
pub const CLASSES: i64 = 8;
/// Pixels of the picture per cell.
pub const STRIDE: usize = 4;

/// The backbone, which computes the features.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Backbone {
    /// Real time on one core; sees the rows from 96 to 416 of the picture.
    Light,
    /// The paper's; sees the whole picture.
    Resnet50V2,
}

impl Backbone {
    /// Its name in options and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Light => "light",
            Self::Resnet50V2 => "resnet50_v2",
        }
    }

    /// The rows of a picture of `height` rows that the network sees: first, and how many.
    ///
    /// The light one leaves out the sky and the bonnet: objects more than 32 degrees above or below are
    /// nearer than 6 m or higher than 8 m.
    pub const fn rows(self, height: usize) -> (usize, usize) {
        match self {
            Self::Light if height.is_multiple_of(512) => (height * 3 / 16, height * 5 / 8),
            _ => (0, height),
        }
    }
}

/// What a network sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sees {
    /// Objects: CenterNet.
    #[default]
    Objects,
    /// Objects, the boundaries of the ego's lane and its light: `eyes`. For the light backbone.
    Road,
}

impl Sees {
    /// What networks that see this are called in options and files.
    pub fn network(self) -> &'static str {
        match self {
            Self::Objects => "centernet",
            Self::Road => "eyes",
        }
    }

    /// The backbones that it works with: the road's heads fit the maps of the light one alone.
    pub fn backbones(self) -> &'static [Backbone] {
        match self {
            Self::Objects => &[Backbone::Light, Backbone::Resnet50V2],
            Self::Road => &[Backbone::Light],
        }
    }
}

/// A head that can learn alone, while all else of the network stays as it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// Signs.
    Signs,
    /// The drivable area.
    Area,
}

impl Part {
    /// Its name in options and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Signs => "signs",
            Self::Area => "area",
        }
    }

    /// Whether a parameter is of it.
    pub fn has(self, name: &str) -> bool {
        name.strip_prefix("road.").is_some_and(|rest| rest.starts_with(self.name()))
    }
}

/// What learns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Learns {
    /// Nothing: it is used.
    Nothing,
    /// One head.
    Only(Part),
    /// All of it.
    Everything,
}

impl Learns {
    /// Whether all learns.
    pub fn all(self) -> bool {
        self == Self::Everything
    }

    /// Whether a part learns.
    pub fn part(self, part: Part) -> bool {
        self.all() || self == Self::Only(part)
    }
}

/// The backbone of weights that see `known` through today's camera.
///
/// # Errors
/// They are of another network or of another camera, or of a backbone that cannot see that.
pub fn backbone(weights: &Weights, known: Sees) -> Result<Backbone, WeightsError> {
    let check = |key: &str, expected: &[&str]| {
        let found = weights.metadata.get(key).map_or("an unknown kind", String::as_str);
        expected.iter().position(|one| *one == found).ok_or_else(|| WeightsError::Mismatch {
            path: weights.path.clone(),
            found: format!("{key} {found}"),
            expected: format!("{key} {}", expected.join(" or ")),
        })
    };
    check("network", &[known.network()])?;
    check("camera", &[&CameraConfig::default().hash()])?;
    let all = known.backbones();
    let names: Vec<&str> = all.iter().map(|one| one.name()).collect();
    check("backbone", &names).map(|at| all[at])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;
    use std::path::PathBuf;

    #[test]
    fn the_papers_backbone_sees_objects_alone() {
        let found = |sees: Sees| {
            let metadata = HashMap::from([
                ("camera".to_string(), CameraConfig::default().hash()),
                ("network".to_string(), sees.network().to_string()),
                ("backbone".to_string(), Backbone::Resnet50V2.name().to_string()),
            ]);
            backbone(&Weights { path: PathBuf::new(), tensors: Vec::new(), metadata }, sees)
        };
        assert_eq!(found(Sees::Objects).unwrap(), Backbone::Resnet50V2);
        let error = found(Sees::Road).unwrap_err().to_string();
        assert!(error.contains("backbone resnet50_v2, expected backbone light"), "{error}");
    }
}
